"""Source `sim:`: a simulated contact that moves along the rod, with or without friction, and the sensor's noise; or a
free probe that a robot turns, to rehearse `calibrate`."""

import math
from collections.abc import Generator, Iterator

import numpy as np

from probedesign.core.errors import InputError
from probedesign.core.frames import Array
from probedesign.core.units import GRAM, MILLINEWTON, MM
from probedesign.estimation.model import ProbeModel
from probedesign.geometry.mass import MassProperties
from probedesign.live import Log
from probedesign.live.blocks import NO_CONTACT, Block, TrueContact, WrenchReading
from probedesign.live.poses.base_poses import GRAVITY_WORLD, BasePoses, TimedPose
from probedesign.live.sources.source import SPEED, SourceParameter, parse_parameters, played
from probedesign.rod.contact import OUTERMOST, safe_force, solve_contact
from probedesign.rod.friction import MAX_FRICTION

PARAMETERS = {
    "force_mN": SourceParameter(math.nan, 1e-3, 1e5),  # see safe_force
    "angle_deg": SourceParameter(30.0, -360.0, 360.0),
    "period_s": SourceParameter(20.0, 0.1, 3600.0),
    "seconds": SourceParameter(20.0, 0.01, 1e7),
    "rate_hz": SourceParameter(50.0, 0.1, 7000.0),
    "seed": SourceParameter(1, 0, 1e9, integer=True),
    "friction": SourceParameter(0.0, 0.0, MAX_FRICTION),
    "orientations": SourceParameter(0, 0, 100, integer=True),
    "payload_g": SourceParameter(0.0, -1000.0, 1000.0),
    "speed": SPEED,
}

#: Time at rest in each orientation, and of the turn to the next [s]; time between poses [s].
REST, TURN, POSE_STEP = 4.0, 3.0, 0.02
PAYLOAD_AT = 30.0 * MM  #: Height of `payload_g` above the sensor's origin [m].

PHASE = (0.0, 0.10, 0.15, 0.50, 0.85, 0.90, 1.0)
POSITION = (0.3, 0.30, 0.30, OUTERMOST, 0.30, 0.30, 0.3)
#: One period: free, loaded at 0.3 of the length, moved to 0.95 and back, released, free. Linear in between.
LOAD = (0.0, 0.00, 1.00, 1.00, 1.00, 0.00, 0.0)


def open_simulation(model: ProbeModel, target: str, query: str, log: Log) -> "SimulatedSource":
    """Open the source `sim:`, which has no target; see `SimulatedSource`."""
    if target:
        raise InputError(f"sim: takes parameters only, as sim:?force_mN=20; found {target!r}")
    return SimulatedSource(model, query)


class SimulatedSource:
    """A contact that sweeps along the probe; see `Source`. Each iteration yields the same readings."""

    notes: tuple[str, ...] = ()

    def __init__(self, model: ProbeModel, query: str = "") -> None:
        """Parse the parameters of `PARAMETERS`.

        Raises:
            InputError: a parameter is invalid; during iteration: the probe has no equilibrium under the force.
        """
        parameters, _ = parse_parameters("sim:", query, PARAMETERS)
        self._model = model
        self._force = parameters["force_mN"] * MILLINEWTON
        if math.isnan(self._force):
            self._force = safe_force(model.rod)
        self._angle = math.radians(parameters["angle_deg"])
        self._period, self._rate = parameters["period_s"], parameters["rate_hz"]
        self._speed = parameters["speed"]
        self._count = max(1, round(parameters["seconds"] * parameters["rate_hz"]))
        self._seed, self._friction = int(parameters["seed"]), parameters["friction"]
        self._payload, n = parameters["payload_g"] * GRAM, int(parameters["orientations"])
        self.poses = self._turning(n) if n else None
        if n:
            self._count = round(n * (REST + TURN) * self._rate)
            self.title = f"simulated robot that turns the free probe to {n} orientations, {self._rate:g} readings/s"
            return
        low, high = min(POSITION) * model.rod.length / MM, max(POSITION) * model.rod.length / MM
        self.title = (
            f"simulated contact of {self._force / MILLINEWTON:.3g} mN sweeping s = {low:.1f} ... {high:.1f} mm, "
            f"{parameters['seconds']:g} s at {self._rate:g} readings/s, noise seed {self._seed}"
        )

    def __iter__(self) -> Generator[Block, None, None]:
        return played(self._readings(), self._speed)

    def _turning(self, n: int) -> BasePoses:
        """Return poses of a base that rests in `n` orientations: gravity along ± x, ± y, ± z, then anywhere."""
        from scipy.spatial.transform import Rotation, Slerp

        angles = np.radians([[0, 0, 0], [180, 0, 0], [90, 0, 0], [-90, 0, 0], [0, 90, 0], [0, -90, 0]])
        more = Rotation.random(max(n - 6, 0), rng=np.random.default_rng(self._seed)).as_rotvec()
        at = Rotation.from_rotvec(np.concatenate([angles, more])[:n])
        t = np.arange(-POSE_STEP, n * (REST + TURN) + 2.0 * POSE_STEP, POSE_STEP)
        k, since = np.clip(t // (REST + TURN), 0, n - 1), np.maximum(t % (REST + TURN) - REST, 0.0) / TURN
        share = since**3 * (10.0 - 15.0 * since + 6.0 * since**2)  # minimum jerk
        quats = Slerp(np.arange(n), at)(np.clip(k + share, 0.0, n - 1.0) * (t > 0.0)).as_quat()
        stated = [TimedPose(a, (0.0, 0.0, 0.5), tuple(q)) for a, q in zip(t.tolist(), quats.tolist(), strict=True)]
        return BasePoses("simulated poses", stated)

    def _free(self, T: Array) -> Array:
        """Return the reading of the free probe and `payload_g` under T_world_base, without noise, (6,)."""
        gravity = T[:3, :3].T @ np.array(GRAVITY_WORLD)
        added = MassProperties(0.0, self._payload, np.array([0.0, 0.0, PAYLOAD_AT]), np.zeros((3, 3)))
        free = self._model.rod.solve(gravity).wrench_base
        return self._model.to_sensor(free, gravity) + added.wrench(self._model.T_sensor_base[:3, :3] @ gravity)

    def _readings(self) -> Iterator[WrenchReading]:
        if self.poses is not None:
            noise = np.random.default_rng(self._seed)
            last, free = np.zeros((4, 4)), np.zeros(6)
            for i in range(self._count):
                T = self.poses.track.at(i / self._rate)
                assert T is not None
                if not np.array_equal(T, last):
                    last, free = T, self._free(T)
                wrench = free + self._model.noise.std * noise.standard_normal(6)
                yield WrenchReading(i / self._rate, wrench, self._model.gravity_base, NO_CONTACT)
            return
        # A force without equilibrium fails here, not during the run.
        for position in np.linspace(min(POSITION), max(POSITION), 8):
            self._loaded(position * self._model.rod.length, self._force)
        noise = np.random.default_rng(self._seed)
        gravity = self._model.gravity_base
        for i in range(self._count):
            time = i / self._rate
            wrench, truth = self._at(time)
            wrench_sensor = self._model.to_sensor(wrench, gravity) + self._model.noise.std * noise.standard_normal(6)
            yield WrenchReading(time, wrench_sensor, gravity, truth)

    def _at(self, time: float) -> tuple[Array, TrueContact]:
        """Return base wrench (6,) and true contact at a time [s]."""
        phase = time / self._period % 1.0
        press = float(np.interp(phase, PHASE, LOAD))
        if press == 0.0:
            return self._model.rod.solve(self._model.gravity_base, mode="reference").wrench_base, NO_CONTACT
        position = float(np.interp(phase, PHASE, POSITION))
        sliding = float(np.sign(np.diff(POSITION)[np.searchsorted(PHASE, phase, side="right") - 1]))
        return self._loaded(position * self._model.rod.length, press * self._force, sliding)

    def _loaded(self, s: float, force: float, sliding: float = 0.0) -> tuple[Array, TrueContact]:
        """Return base wrench (6,) and true contact under a force normal to the surface [N] at arclength s [m].

        With friction, s is that of the touched section. `sliding` is 1 towards the tip, -1 towards the base.
        """
        rod, gravity = self._model.rod, self._model.gravity_base
        ratios = (sliding * self._friction, 0.0) if self._friction > 0.0 else None
        contact = solve_contact(rod, gravity, s, self._angle, force, ratios, "reference")
        if contact.result != "ok":
            at = f"{force / MILLINEWTON:g} mN at s = {s / MM:.1f} mm"
            raise InputError(f"sim: no equilibrium under {at} ({contact.result}); reduce force_mN")
        return contact.equilibrium.wrench_base, TrueContact(*contact[2:])  # the fields after the equilibrium
