"""What a synthetic campaign is made of: how it is measured, and which touches."""

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from probedesign.errors import InputError
from probedesign.estimation.model import ProbeModel
from probedesign.prediction.table_one import measured
from probedesign.prediction.touches import DIRECTIONS
from probedesign.rod.friction import ASSUMED_SPREAD, MAX_FRICTION
from probedesign.rod.rod import Rod
from probedesign.units import MM

Kind = Literal["cameras", "stage"]
LARGE_LENGTH, LARGE_BASE_RADIUS, LARGE_TIP_RADIUS = 150.0 * MM, 6.0 * MM, 1.0 * MM
LARGE_MODULUS = 2.32e6
"""Of the paper's large probe [m], [Pa], which its forces are scaled from."""
MARKERS_APART = 10.0 * MM
"""The paper's markers are equidistant, about a centimetre [m]."""
END = 2.0 * MM
"""The last marker keeps that far from the tip [m]: assumed, a dot needs room."""
WEIGHTS = ((0.4, 0.014), (0.4, 0.05), (0.6, 0.01), (0.8, 0.005))
"""Weights hung on the large probe, fraction of the length and [N]: the first is that of the paper's figure 3."""


@dataclass(frozen=True)
class Plan:
    """How a campaign is measured.

    Attributes:
        kind: "cameras": free, with weights and touched, the shape seen, as in the paper; "stage": touched at places
            that are known to a twentieth of a millimetre, without cameras.
        seed: of all that is drawn.
        youngs_modulus, shear_modulus: of the true probe [Pa]; None draws them about the design's, as its tolerances
            have it.
        marker_noise: of markers that another reference told, on each axis [m]; None has two cameras see them.
        readings: of the sensor in each test, each the mean of the design's averaging_samples.
        exact: the true probe is the design's and stands where it is said to; only readings and pictures are noisy.
        images: make photographs too.
        friction: median friction coefficient μ of what touches; 0 is without friction.
        friction_spread: standard deviation of ln μ from test to test.
    """

    kind: Kind = "cameras"
    seed: int = 0
    youngs_modulus: float | None = None
    shear_modulus: float | None = None
    marker_noise: float | None = None
    readings: int = 5
    exact: bool = False
    images: bool = False
    friction: float = 0.0
    friction_spread: float = ASSUMED_SPREAD

    def __post_init__(self) -> None:
        """Raises InputError where a number makes no sense or two wishes exclude each other."""
        for name, modulus in (("youngs", self.youngs_modulus), ("shear", self.shear_modulus)):
            if modulus is not None and not 1e3 <= modulus <= 1e11:
                raise InputError(f"--{name}-modulus-mpa {modulus / 1e6:g} must lie in 0.001 ... 100000")
        if self.marker_noise is not None and not 0.001 * MM <= self.marker_noise <= 20.0 * MM:
            raise InputError(f"--marker-noise-mm {self.marker_noise / MM:g} must lie in 0.001 ... 20")
        if not 1 <= self.readings <= 1000:
            raise InputError(f"--readings {self.readings} must lie in 1 ... 1000")
        if not 0.0 <= self.friction <= MAX_FRICTION:
            raise InputError(f"--friction {self.friction:g} must lie in 0 ... {MAX_FRICTION:g}")
        if not 0.0 <= self.friction_spread <= 1.0:
            raise InputError(f"--friction-spread {self.friction_spread:g} must lie in 0 ... 1")
        if self.seed < 0:
            raise InputError(f"--seed {self.seed} must not be negative")
        if self.kind == "stage" and (self.images or self.marker_noise is not None):
            raise InputError("--stage has no markers: leave out --images and --marker-noise-mm")
        if self.images and self.marker_noise is not None:
            raise InputError("--marker-noise-mm is of another reference than cameras: leave out --images")


class Touch(NamedTuple):
    """A touch that is planned: where along the probe, how hard [N], which way."""

    fraction: float
    force: float
    direction: str


def touches_of(model: ProbeModel) -> list[Touch]:
    """The touches of Table I, for the paper's probes their own, for any other those of the large one, as hard as bend
    it alike: force over E d⁴ / L² at the touched place."""
    own = [row for row in measured() if row["probe"] == model.name]
    rows = own or [row for row in measured() if row["probe"] == "large"]
    found = []
    for i, row in enumerate(rows):
        fraction, force = float(row["contact_fraction"]), float(row["force_N"])
        direction = list(DIRECTIONS)[i % len(DIRECTIONS)]
        found.append(
            Touch(fraction, force if own else force * stiffness_ratio(model.rod, fraction), direction)
        )
    return found


def weights_of(model: ProbeModel) -> list[tuple[float, float]]:
    """Weights to hang on a probe: fraction and force [N]."""
    return [(fraction, force * stiffness_ratio(model.rod, fraction)) for fraction, force in WEIGHTS]


def stiffness_ratio(rod: Rod, fraction: float) -> float:
    """How much harder a push at that fraction is needed to bend a rod like the paper's large probe."""
    radius = float(np.interp(fraction * rod.length, rod.s, rod.radius))
    large = LARGE_BASE_RADIUS + fraction * (LARGE_TIP_RADIUS - LARGE_BASE_RADIUS)
    return (rod.youngs_modulus / LARGE_MODULUS) * (radius / large) ** 4 * (LARGE_LENGTH / rod.length) ** 2


def marker_arclengths(length: float) -> list[float]:
    """Where the markers sit [m]."""
    count = int(np.floor((length - END) / MARKERS_APART + 1e-9))
    return [MARKERS_APART * (i + 1) for i in range(count)] or [0.5 * length]
