"""What can be asked for, and all that a campaign shares and does not know: one vector of parameters."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from probedesign.errors import InputError
from probedesign.estimation.error_sources import parameters_of
from probedesign.estimation.model import ProbeModel
from probedesign.estimation.tolerances import Tolerances
from probedesign.frames import Array
from probedesign.naming import unknown
from probedesign.units import MM

DEGREE = math.pi / 180.0
ROOT = "root"


@dataclass(frozen=True)
class Askable:
    """What `--for` may name.

    Attributes:
        name: as it is asked for.
        words: as it is spoken of.
        parts: its parameters.
        logarithm: whether they are logarithms of factors on the design's value.
        told: a standard deviation that tells nothing: wider, and it is not reported [unit of the parameters].
    """

    name: str
    words: str
    parts: tuple[str, ...]
    logarithm: bool
    told: float


ASKABLE = {
    one.name: one
    for one in (
        Askable("E", "Young's modulus", ("E",), True, 0.3),
        Askable("density", "density", ("density",), True, 0.1),
        Askable("G", "shear modulus", ("G",), True, 0.1),
        Askable(ROOT, "root_rigid_radii", (ROOT,), False, 0.3),
        Askable("tilt", "tilt of the base", ("tilt_x", "tilt_y"), False, 2.0 * DEGREE),
        Askable("clocking", "clocking of the base", ("clocking",), False, 5.0 * DEGREE),
        Askable("offset", "place of the base", ("offset_x", "offset_y", "offset_z"), False, 2.0 * MM),
        Askable("gravity", "direction of gravity", ("gravity_1", "gravity_2"), False, 2.0 * DEGREE),
        Askable("diameters", "factor on all diameters", ("diameters",), True, 0.1),
    )
}
"""In order: of two that cannot be told apart, the later one stays at the design's value. A value worse known than
`told` would mislead. E: published values of one resin, 1.6 to 3.2 MPa, spread by 30 %. G: a tenth, since a full round
probe shows it by a shear of a tenth of a millimetre alone, which any other small error of the model makes as well. The
others are assumed."""

DEFAULT = ("E", "G")
"""The paper's."""

PARTS = ("E", "G", "density", "diameters", ROOT, "tilt_x", "tilt_y", "clocking", "offset_x", "offset_y", "offset_z",
         "gravity_1", "gravity_2", "seat_tilt_x", "seat_tilt_y", "seat_clocking", "seat_x", "seat_y", "seat_z",
         "bias_Fx", "bias_Fy", "bias_Fz", "bias_Mx", "bias_My", "bias_Mz")  # fmt: skip
"""Of the vector, before the print's own. E, G, density and diameters are logarithms of factors; base and seat turn
about their own axes [rad] and shift along them [m]; gravity turns about two axes across it [rad]; the bias is at the
base [N, N·m]."""
TURN, SHIFT, FALL, SEAT_TURN, SEAT_SHIFT, BIAS = (
    slice(5, 8), slice(8, 11), slice(11, 13), slice(13, 16), slice(16, 19), slice(19, 25)
)  # fmt: skip
PRINT = len(PARTS)
TARE_SHARE = 0.05
"""Of the free probe's wrench: what a tare with the probe free as mounted takes away of its own weight's error. Covers
1 % of density, 2 % of area and what a third of E changes of the sag (assumed)."""


def asked_for(names: Sequence[str]) -> tuple[str, ...]:
    """Names of `--for`, checked, in the order of `ASKABLE`.

    Raises:
        InputError: none, or one that is unknown.
    """
    for name in names:
        if name not in ASKABLE:
            raise unknown("--for", name, ASKABLE)
    if not names:
        raise InputError(f"--for: nothing is asked for; known: {', '.join(ASKABLE)}")
    return tuple(name for name in ASKABLE if name in names)


def parts_of(names: Sequence[str]) -> list[int]:
    """Places of their parameters."""
    return [PARTS.index(part) for name in names for part in ASKABLE[name].parts]


@dataclass(frozen=True)
class Shared:
    """All that the tests of a campaign share, and how well it is known without them.

    Attributes:
        model: of the probe, as designed.
        tolerances: of probe, seat and gravity.
        std_base, std_tilt: of the base's pose in the world, as the campaign has it [m, rad].
    """

    model: ProbeModel
    tolerances: Tolerances
    std_base: float
    std_tilt: float

    @cached_property
    def print_rows(self) -> Array:
        """What unit normal numbers do to the logarithms of the knots' diameters, (q, K): all diameters together, each
        for itself, and the length, which at a given place of a cone changes the diameter."""
        rod = self.model.rod
        causes = parameters_of(rod, self.tolerances)
        slope = np.gradient(rod.radius, rod.s)
        thicker = -slope * rod.s / rod.radius * causes["length"][0, 3]
        rows = np.concatenate([causes["diameter"][:, 4:], causes["diameter scatter"][:, 4:], thicker[None]])
        return np.asarray(rows[np.abs(rows).max(axis=1) > 0.0], dtype=float)

    @property
    def size(self) -> int:
        """Of the vector."""
        return PRINT + len(self.print_rows)

    @cached_property
    def prior(self) -> Array:
        """Standard deviations of the vector about nothing, (size,); zero for what is taken as designed."""
        t, std = self.tolerances, np.zeros(self.size)
        std[0:3] = (0.0, t.shear_modulus, t.density)
        std[TURN], std[SHIFT] = self.std_tilt, self.std_base
        std[FALL] = t.gravity_deg * DEGREE
        std[SEAT_TURN] = np.array([t.tilt_deg, t.tilt_deg, t.clocking_deg]) * DEGREE
        std[SEAT_SHIFT] = t.base_mm * MM
        std[BIAS] = self._bias
        std[PRINT:] = 1.0
        return std

    @cached_property
    def drift(self) -> Array:
        """Covariance of what the bias wanders between tests, at the base, (6, 6)."""
        steps = self.tolerances.drift_steps**2 * self.model.averaging_samples
        return np.asarray(steps * self.model.noise_base())

    @property
    def _bias(self) -> Array:
        """Of a bias that all tests share: what it has drifted, and what a tare has swallowed."""
        swallowed = np.zeros(6)
        free = self.model.rod.solve(self.model.gravity_base)
        if self.tolerances.tared and free.ok:
            force, moment = np.linalg.norm(free.wrench_base.reshape(2, 3), axis=1)
            swallowed[:] = TARE_SHARE * np.repeat([force, moment], 3)
        return np.asarray(np.sqrt(np.diag(self.drift) + swallowed**2))

    def prior_of(self, asked: Sequence[str]) -> Array:
        """The same where some are asked for: nothing is known of those beforehand, (size,)."""
        std = self.prior.copy()
        std[parts_of(asked)] = math.inf
        together = self.tolerances.diameter_mm > 0.0 or self.tolerances.diameter_share > 0.0
        if "diameters" in asked and together:  # else two numbers would stand for one
            std[PRINT] = 0.0
        return std
