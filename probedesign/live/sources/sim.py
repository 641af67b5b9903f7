"""Source `sim:`: a simulated contact that moves along the rod, with or without friction, and the sensor's noise."""

import math
from collections.abc import Generator, Iterator

import numpy as np

from probedesign.core.errors import InputError
from probedesign.core.frames import Array
from probedesign.core.units import MILLINEWTON, MM
from probedesign.estimation.model import ProbeModel
from probedesign.live import Log
from probedesign.live.blocks import NO_CONTACT, Block, TrueContact, WrenchReading
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
    "speed": SPEED,
}

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
        low, high = min(POSITION) * model.rod.length / MM, max(POSITION) * model.rod.length / MM
        self.title = (
            f"simulated contact of {self._force / MILLINEWTON:.3g} mN sweeping s = {low:.1f} ... {high:.1f} mm, "
            f"{parameters['seconds']:g} s at {self._rate:g} readings/s, noise seed {self._seed}"
        )

    def __iter__(self) -> Generator[Block, None, None]:
        return played(self._readings(), self._speed)

    def _readings(self) -> Iterator[WrenchReading]:
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
