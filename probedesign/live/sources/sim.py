"""`sim:`: the rod itself under a contact that moves along it, without friction or sliding with it, read with the
sensor's noise."""

import math
from collections.abc import Generator, Iterator

import numpy as np

from probedesign.errors import InputError
from probedesign.estimation.force_moment import surface_point
from probedesign.estimation.model import ProbeModel
from probedesign.frames import Array
from probedesign.live.processing.blocks import FREE, Block, Reading, Truth, blocks_of, paced
from probedesign.live.sources.parameters import MOST, SPEED, TICK, Parameter, parse_parameters
from probedesign.rod.contact import solve_frictionless
from probedesign.rod.friction import MAX_FRICTION, line_of_action, solve_surface_force
from probedesign.rod.rod import Rod
from probedesign.units import MILLINEWTON, MM

PARAMETERS = {
    "force_mN": Parameter(math.nan, 1e-3, 1e5),  # see bearable
    "angle_deg": Parameter(30.0, -360.0, 360.0),
    "period_s": Parameter(20.0, 0.1, 3600.0),
    "seconds": Parameter(20.0, 0.01, 1e7),
    "rate_hz": Parameter(50.0, 0.1, 7000.0),
    "seed": Parameter(1, 0, 1e9, whole=True),
    "friction": Parameter(0.0, 0.0, MAX_FRICTION),
    "speed": SPEED,
}

USUAL_FORCE = 20.0 * MILLINEWTON
"""Of the contact where none is said [N], if the probe bears it."""
BENT = 0.85
"""F s² r(0)/(E I(0) r(s)) that a probe bears well: one radian or so of bending, under any lean of the force."""

PHASE = (0.0, 0.10, 0.15, 0.50, 0.85, 0.90, 1.0)
WHERE = (0.3, 0.30, 0.30, 0.95, 0.30, 0.30, 0.3)
PRESS = (0.0, 0.00, 1.00, 1.00, 1.00, 0.00, 0.0)
"""One period: free, pressed at 0.3 of the length, moved to 0.95 and back, released, free. Linear between."""


class Simulation:
    """A contact that sweeps along the probe. Iterating again gives the same readings again.

    Attributes:
        title: one line that says what it is.
        notes: nothing to say.
    """

    notes: tuple[str, ...] = ()

    def __init__(self, model: ProbeModel, query: str = "") -> None:
        """Read the parameters.

        Args:
            model: the probe.
            query: parameters, as `PARAMETERS` has them.

        Raises:
            InputError: a parameter is wrong; and, once it is iterated, the probe does not bear that force.
        """
        said = parse_parameters("sim:", query, PARAMETERS)
        self._model = model
        self._force = said["force_mN"] * MILLINEWTON
        if math.isnan(self._force):
            self._force = bearable(model.rod)
        self._angle = math.radians(said["angle_deg"])
        self._period, self._rate, self._speed = said["period_s"], said["rate_hz"], said["speed"]
        self._count = max(1, round(said["seconds"] * said["rate_hz"]))
        self._seed, self._friction = int(said["seed"]), said["friction"]
        low, high = min(WHERE) * model.rod.length / MM, max(WHERE) * model.rod.length / MM
        self.title = (
            f"simulated contact of {self._force / MILLINEWTON:.3g} mN sweeping s = {low:.1f} ... {high:.1f} mm, "
            f"{said['seconds']:g} s at {self._rate:g} readings/s, noise seed {self._seed}"
        )

    def __iter__(self) -> Generator[Block, None, None]:
        return paced(blocks_of(self._readings(), MOST, TICK * self._speed), self._speed)

    def _readings(self) -> Iterator[Reading]:
        for where in np.linspace(min(WHERE), max(WHERE), 8):  # an unbearable force fails here, not halfway
            self._touched(where * self._model.rod.length, self._force)
        noise = np.random.default_rng(self._seed)
        std = np.sqrt(np.diag(self._model.noise.covariance()))
        gravity = self._model.gravity_base
        for i in range(self._count):
            time = i / self._rate
            wrench, truth = self._at(time)
            wrench_sensor = self._model.to_sensor(wrench, gravity) + std * noise.standard_normal(6)
            yield Reading(time, wrench_sensor, gravity, truth)

    def _at(self, time: float) -> tuple[Array, Truth]:
        """Base wrench (6,) and truth at a time [s]."""
        phase = time / self._period % 1.0
        press = float(np.interp(phase, PHASE, PRESS))
        if press == 0.0:
            return self._model.rod.solve(self._model.gravity_base, mode="reference").wrench_base, FREE
        where = float(np.interp(phase, PHASE, WHERE))
        slides = float(np.sign(np.diff(WHERE)[np.searchsorted(PHASE, phase, side="right") - 1]))
        return self._touched(where * self._model.rod.length, press * self._force, slides)

    def _touched(self, s: float, force: float, slides: float = 0.0) -> tuple[Array, Truth]:
        """Base wrench (6,) and truth under a normal force [N] at s [m].

        Args:
            s: of the contact; with friction, of the touched section.
            force: normal to the surface.
            slides: 1 where the contact slides towards the tip, -1 towards the base, 0 where it is pressed on the spot.

        Raises:
            InputError: there is no equilibrium.
        """
        rod, gravity = self._model.rod, self._model.gravity_base
        result, truth = "ok", FREE
        if self._friction > 0.0:
            ratio = (slides * self._friction, 0.0)
            rubbed = solve_surface_force(rod, gravity, s, self._angle + math.pi, force, ratio, "reference")
            result, eq = rubbed.result, rubbed.equilibrium
            if result == "ok":
                on_axis = line_of_action(rod, eq, rubbed.p_surface_base)
                truth = Truth(on_axis, eq.p_at(on_axis), rubbed.force_base, rubbed.p_surface_base)
        else:
            contact = solve_frictionless(rod, gravity, s, self._angle, force, mode="reference")
            result, eq = contact.result, contact.equilibrium
            truth = Truth(s, eq.p_contact_base, contact.force_base, surface_point(rod, eq))
        if result != "ok":
            at = f"{force / MILLINEWTON:g} mN at s = {s / MM:.1f} mm"
            raise InputError(f"sim: the probe does not bear {at} ({result}); say a smaller force_mN")
        return eq.wrench_base, truth


def bearable(rod: Rod) -> float:
    """The usual force [N], or a smaller one on a probe that it would bend too far."""
    s = max(WHERE) * rod.length
    radius, base = float(np.interp(s, rod.s, rod.radius)), float(rod.radius[0])
    softer_way = min(rod.factors[1:3])
    stiffness = softer_way * rod.youngs_modulus * math.pi / 4.0 * base**4 * radius / base
    return min(USUAL_FORCE, BENT * stiffness / s**2)
