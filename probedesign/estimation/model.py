"""Model of a probe for estimation (the rod, the payload of the sensor and the sensor; no design, no CAD), and its
observations: one wrench reading at the base or the mean of a window, with its covariance."""

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from probedesign.core import statistics
from probedesign.core.errors import InputError
from probedesign.core.frames import Array, inverse, wrench_map
from probedesign.core.notebook import Displayed
from probedesign.design.catalog import ELASTIC_FRICTION, Provenance, Quantity
from probedesign.design.sensors import DEFAULT_SENSOR, NANO17_BODY, Noise
from probedesign.estimation.tolerances import Tolerances
from probedesign.geometry import Flange
from probedesign.geometry.axis import Axis
from probedesign.geometry.cross_section import FULL_ROUND, CrossSection
from probedesign.geometry.mass import MassProperties
from probedesign.rod.kernels import kernel
from probedesign.rod.rod import Rod

#: Fraction of the range: a channel closer to its end counts as saturated. The resolution is 1/3840 of the range.
FULL_SCALE = 1e-3


@dataclass(frozen=True)
class ProbeModel(Displayed):
    """One probe on one sensor."""

    name: str  #: of the design.
    fingerprint: str  #: of the geometry that was printed.
    flange: Flange  #: the disc below the base, which the fingerprint counts.
    rod: Rod  #: the flexible part from s = 0, clamped.
    gravity_base: Array  #: default gravity in base axes [m/s²], (3,).
    T_sensor_base: Array  #: pose of the base in the sensor frame, (4, 4).
    #: mass properties of the rigid parts on the sensor below s = 0 (flange, adapter, screws), in the sensor frame.
    payload: MassProperties
    wrench_range: Array  #: largest reading of each channel [N, N·m], (6,).
    noise: Noise  #: covariance of one reading, the mean of averaging_samples samples.
    averaging_samples: int = 1  #: how many the noise is counted for.
    material: dict[str, Quantity] = field(default_factory=dict)  #: E, G and density with where they come from.
    assumptions: tuple[str, ...] = ()  #: what of the design is assumed, for every report.
    cross_section: CrossSection = FULL_ROUND  #: which the fingerprint counts; the rod has its factors.
    axis: Axis | None = None  #: as designed, which the fingerprint counts; None if straight.
    #: standard deviation of a common factor on E and G; None: by where E comes from.
    stiffness_spread: float | None = None
    creep_spread: float = 0.0  #: standard deviation of how far it relaxes while touches are fused, relative.
    #: how well all of it is known; None: as `Tolerances.of` has it from the material.
    tolerances: Tolerances | None = None
    #: standard deviation of the tangential over the normal force of a touch, per tangential direction [-]: t₁, t₂ ~
    #: N(0, (friction Fₙ)²). 0 is the frictionless contact, inf leaves the direction of the force free.
    friction: float = ELASTIC_FRICTION.value
    #: friction_provenance, friction_source: where the friction comes from.
    friction_provenance: Provenance = ELASTIC_FRICTION.provenance
    friction_source: str = ELASTIC_FRICTION.source
    resin: str = ""  #: name of the resin, for the sources of the tolerances; empty if unknown.
    sensor: str = DEFAULT_SENSOR  #: name of the sensor.
    sensor_d: float = NANO17_BODY[0]  #: sensor_d, sensor_height: of its body, for the view [m].
    sensor_height: float = NANO17_BODY[1]
    #: fingerprints of the printed parts, by their names, and of the payload as designed; empty if unknown.
    parts: dict[str, str] = field(default_factory=dict)
    T_robotflange_base: Array | None = None  #: pose of the base in the robot flange's frame, (4, 4); None if unknown.
    #: `campaigns.Test.digest` of the tests that the parameters were identified from.
    identified_tests: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not self.friction >= 0.0:
            raise InputError(
                f"friction = {self.friction} must be 0 or greater; inf leaves the direction of the force free"
            )

    @cached_property
    def mass(self) -> float:
        """Return the mass of the flexible part [kg]."""
        return float(self.rod.density * self.rod.body.volume_beyond[0])

    def gravity_wrench_sensor(self, gravity_base: ArrayLike) -> Array:
        """Return the wrench that the rigid parts between sensor face and s = 0 exert on the sensor, (6,)."""
        return np.asarray(self.payload_by_gravity @ np.asarray(gravity_base, dtype=float))

    @cached_property
    def payload_by_gravity(self) -> Array:
        """Return the derivative of that wrench by gravity in base axes, (6, 3)."""
        R = self.T_sensor_base[:3, :3]
        return np.stack([self.payload.wrench(R[:, i]) for i in range(3)], axis=1)

    @cached_property
    def _sensor_from_base(self) -> Array:
        return wrench_map(self.T_sensor_base)

    @cached_property
    def _base_from_sensor(self) -> Array:
        return wrench_map(inverse(self.T_sensor_base))

    def to_sensor(self, wrench_base: ArrayLike, gravity_base: ArrayLike) -> Array:
        """Return the sensor's reading without bias: base wrenches (6,) or (n, 6) in the sensor frame, with the weight
        of the parts between."""
        carried = np.asarray(wrench_base, dtype=float) @ self._sensor_from_base.T
        return carried + self.gravity_wrench_sensor(gravity_base)

    def to_base(self, wrench_sensor: ArrayLike, gravity_base: ArrayLike) -> Array:
        """Return the wrench of the flexible part on its mount from the sensor's reading, (6,) or (n, 6)."""
        flexible = np.asarray(wrench_sensor, dtype=float) - self.gravity_wrench_sensor(gravity_base)
        return np.asarray(flexible @ self._base_from_sensor.T)

    def in_range(self, wrench_sensor: Array) -> bool:
        """Return whether a reading (6,) is possible: finite and within every channel's range."""
        return bool(np.isfinite(wrench_sensor).all() and (np.abs(wrench_sensor) <= self.saturation_limit).all())

    @cached_property
    def saturation_limit(self) -> Array:
        """Return the largest reading of each channel that does not count as saturated [N, N·m], (6,)."""
        return np.asarray(self.wrench_range, dtype=float) * (1.0 - FULL_SCALE)

    def noise_base(self) -> Array:
        """Return the covariance of a reading about the base origin, (6, 6)."""
        return self._noise_base.copy()

    @cached_property
    def _noise_base(self) -> Array:
        return np.asarray(self._base_from_sensor @ self.noise.cov @ self._base_from_sensor.T, dtype=float)

    @cached_property
    def whiten(self) -> Array:
        """Return lower triangular whiten with whitenᵀ whiten = noise_base⁻¹, (6, 6)."""
        return statistics.whiten(self._noise_base)

    @cached_property
    def observation_map(self) -> tuple[Array, Array, Array, Array]:
        """Return the arguments of `observe`: the map of wrenches to the sensor (6, 6), the payload's wrench by gravity
        (6, 3), the saturation limit (6,) and the whitening of one reading (6, 6)."""
        contiguous = np.ascontiguousarray
        return (contiguous(self._sensor_from_base), contiguous(self.payload_by_gravity),
                contiguous(self.saturation_limit), contiguous(self.whiten))  # fmt: skip

    def with_noise(self, noise: Noise) -> "ProbeModel":
        """Return the model with another noise."""
        return replace(self, noise=noise)


NUMERICAL = 1e-6  #: Relative error of the fast solver's base moment, the lower bound of a reading's standard deviation.
NEGLIGIBLE = 1e-2  #: Fraction of the moment's standard deviation below which this error is neglected.


#: What `observe` finds: the mean wrench, the flexible part's weight, the misfit of the free probe, the size of the
#: moment, the misfit of a reading of zero, and the mean's whitening.
OBSERVATION = np.dtype([
    ("wrench", "f8", 6), ("weight", "f8", 3), ("chi2", "f8"), ("moment", "f8"), ("zero_chi2", "f8"),
    ("whiten", "f8", (6, 6)),
])  # fmt: skip


@kernel
def observe(
    window: Array, gravity: Array, free: Array, mass: float, sensor_from_base: Array, payload: Array, limit: Array,
    whiten: Array, std: Array, found: Any,
) -> bool:  # fmt: skip
    """Evaluate a window of readings.

    Args:
        window: base wrenches, (n, 6).
        gravity: base axes [m/s²], (3,).
        free: the free probe's wrench, (6,).
        mass: of the flexible part [kg].
        sensor_from_base: map of wrenches, (6, 6); payload: its wrench on the sensor, by gravity, (6, 3).
        limit: saturation limit of each channel, (6,).
        whiten: of one reading, lower triangular, (6, 6).
        std: standard deviation of each channel of one reading [N, N·m], (6,).
        found: filled, OBSERVATION, (1,).

    Returns:
        Whether all of them are finite and below the saturation limit.
    """
    row, n = found[0], window.shape[0]
    for i in range(6):
        row.wrench[i] = 0.0
    for k in range(n):
        for i in range(6):
            reading = 0.0
            for j in range(6):
                reading += sensor_from_base[i, j] * window[k, j]
            for j in range(3):
                reading += payload[i, j] * gravity[j]
            if not abs(reading) <= limit[i] or not math.isfinite(window[k, i]):
                return False
            row.wrench[i] += window[k, i] / n
    for q in range(3):
        row.weight[q] = mass * gravity[q]
    root, chi2, sensor_chi2, base_chi2 = math.sqrt(n), 0.0, 0.0, 0.0
    for i in range(6):
        reading = 0.0
        for j in range(6):
            reading += sensor_from_base[i, j] * row.wrench[j]
        for j in range(3):
            reading += payload[i, j] * gravity[j]
        sensor_chi2 += n * (reading / std[i]) ** 2
        off, from_zero = 0.0, 0.0
        for j in range(6):
            row.whiten[i, j] = root * whiten[i, j]
            off += root * whiten[i, j] * (row.wrench[j] - free[j])
            from_zero += root * whiten[i, j] * row.wrench[j]
        chi2 += off * off
        base_chi2 += from_zero * from_zero
    row.chi2, row.zero_chi2 = chi2, min(sensor_chi2, base_chi2)
    row.moment = math.sqrt(row.wrench[3] ** 2 + row.wrench[4] ** 2 + row.wrench[5] ** 2)
    return True


def covariance(model: ProbeModel, wrench: Array, readings: int = 1) -> Array:
    """Return the covariance of the mean of so many independent readings near a wrench (6,), with the solver's own
    error, (6, 6)."""
    cov = model._noise_base / readings
    moment = wrench[3:]
    numerical = NUMERICAL**2 * float(moment @ moment)
    if numerical > (NEGLIGIBLE * model.noise.moment) ** 2 / readings:
        cov[[3, 4, 5], [3, 4, 5]] += numerical
    return cov


@dataclass(frozen=True)
class Observation:
    """A base wrench with its covariance."""

    wrench: Array  #: [N, N·m], (6,).
    whiten: Array  #: lower triangular, with whitenᵀ whiten the inverse of its covariance, (6, 6).
    gravity: Array  #: base axes [m/s²], (3,).
    weight: Array  #: of the flexible part [N], (3,).
    chi2: float  #: how far it is from the free probe's, six degrees of freedom.
    #: how far the reading of the sensor, or that at the base, is from zero, the less of both; six degrees of freedom.
    zero_chi2: float = math.inf

    @classmethod
    def of(cls, model: ProbeModel, window: Array, gravity: Array, free: Array) -> "Observation | None":
        """Return the mean of independent readings, each with the model's noise; None if one is out of range.

        Args:
            model: the probe.
            window: base wrenches, (n, 6).
            gravity: base axes [m/s²], (3,).
            free: the free probe's wrench under it, (6,).
        """
        rows = np.empty(1, dtype=OBSERVATION)
        if not observe(window, gravity, free, model.mass, *model.observation_map, model.noise.std, rows):
            return None
        row, readings = rows[0], len(window)
        wrench, whiten, numerical = row["wrench"], row["whiten"], NUMERICAL * float(row["moment"])
        if numerical > NEGLIGIBLE * model.noise.moment / math.sqrt(readings):
            whiten = statistics.whiten(covariance(model, wrench, readings))
        return cls(wrench, whiten, gravity, row["weight"], float(row["chi2"]), float(row["zero_chi2"]))

    @property
    def cov(self) -> Array:
        """Return the covariance of the wrench, (6, 6)."""
        coloured = np.linalg.inv(self.whiten)
        return np.asarray(coloured @ coloured.T, dtype=float)

    @property
    def force(self) -> Array:
        """Return the force of the contact by the paper's equation 5 [N], (3,)."""
        return self.wrench[0:3] - self.weight
