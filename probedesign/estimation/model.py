"""Model of a probe for estimation: the rod, the payload of the sensor and the sensor; no design, no CAD."""

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from probedesign.core.errors import InputError
from probedesign.core.frames import Array, inverse, wrench_map
from probedesign.design.catalog import ELASTIC_FRICTION, Provenance, Quantity
from probedesign.design.sensors import NANO17, Noise
from probedesign.geometry import Flange
from probedesign.geometry.cross_section import FULL_ROUND, CrossSection
from probedesign.geometry.mass import MassProperties
from probedesign.rod.rod import Rod

if TYPE_CHECKING:
    from probedesign.estimation.tolerances import Tolerances

FULL_SCALE = 1e-3
"""Fraction of the range: a channel closer to its end counts as saturated. The resolution is 1/3840 of the range."""


@dataclass(frozen=True)
class ProbeModel:
    """One probe on one sensor.

    Attributes:
        name: of the design.
        fingerprint: of the geometry that was printed.
        flange: the disc below the base, which the fingerprint counts.
        rod: the flexible part from s = 0, clamped.
        gravity_base: default gravity in base axes [m/s²], (3,).
        T_sensor_base: pose of the base in the sensor frame, (4, 4).
        payload: mass properties of the rigid parts on the sensor below s = 0 (flange, adapter, screws), in the sensor
            frame.
        wrench_range: largest reading of each channel [N, N·m], (6,).
        noise: covariance of one reading, the mean of averaging_samples samples.
        averaging_samples: how many the noise is counted for.
        material: E, G and density with where they come from.
        assumptions: what of the design is assumed, for every report.
        cross_section: which the fingerprint counts; the rod has its factors.
        stiffness_spread: standard deviation of a common factor on E and G; None: by where E comes from.
        creep_spread: likewise of how far it relaxes while touches are fused.
        tolerances: how well all of it is known; None: as `Tolerances.of` has it from the material.
        friction: standard deviation of the tangential over the normal force of a touch, per tangential direction [-]:
            t₁, t₂ ~ N(0, (friction Fₙ)²). 0 is the frictionless contact, inf leaves the direction of the force free.
        friction_provenance, friction_source: where the friction comes from.
        resin: name of the resin, for the sources of the tolerances; empty if unknown.
        sensor: name of the sensor, for its shape in the view.
    """

    name: str
    fingerprint: str
    flange: Flange
    rod: Rod
    gravity_base: Array
    T_sensor_base: Array
    payload: MassProperties
    wrench_range: Array
    noise: Noise
    averaging_samples: int = 1
    material: dict[str, Quantity] = field(default_factory=dict)
    assumptions: tuple[str, ...] = ()
    cross_section: CrossSection = FULL_ROUND
    stiffness_spread: float | None = None
    creep_spread: float = 0.0
    tolerances: "Tolerances | None" = None
    friction: float = ELASTIC_FRICTION.value
    friction_provenance: Provenance = ELASTIC_FRICTION.provenance
    friction_source: str = ELASTIC_FRICTION.source
    resin: str = ""
    sensor: str = NANO17.name

    def __post_init__(self) -> None:
        """Raises InputError where the friction is negative or not a number."""
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
        weight: Array = self.payload_by_gravity @ np.asarray(gravity_base, dtype=float)
        return weight

    @cached_property
    def payload_by_gravity(self) -> Array:
        """Return the derivative of that wrench by gravity in base axes, (6, 3)."""
        R = self.T_sensor_base[:3, :3]
        return np.stack([self.payload.wrench(R[:, i]) for i in range(3)], axis=1)

    @cached_property
    def _sensor_from_base(self) -> Array:
        """Return the map of wrenches from the base's origin to the sensor's, (6, 6)."""
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
        own = np.asarray(wrench_sensor, dtype=float) - self.gravity_wrench_sensor(gravity_base)
        carried: Array = own @ self._base_from_sensor.T
        return carried

    def in_range(self, wrench_sensor: Array) -> bool:
        """Return whether a reading (6,) is possible: finite and within every channel's range."""
        return bool(
            np.isfinite(wrench_sensor).all() and (np.abs(wrench_sensor) <= self.saturation_limit).all()
        )

    @cached_property
    def saturation_limit(self) -> Array:
        """Return the largest reading of each channel that does not count as saturated [N, N·m], (6,)."""
        return np.asarray(self.wrench_range, dtype=float) * (1.0 - FULL_SCALE)

    def noise_base(self) -> Array:
        """Return the covariance of a reading about the base origin, (6, 6)."""
        return self._noise_base.copy()

    @cached_property
    def _noise_base(self) -> Array:
        X = self._base_from_sensor
        return np.asarray(X @ self.noise.cov @ X.T, dtype=float)

    @cached_property
    def whiten(self) -> Array:
        """Return lower triangular whiten with whitenᵀ whiten = noise_base⁻¹, (6, 6)."""
        return np.asarray(np.linalg.inv(np.linalg.cholesky(self._noise_base)), dtype=float)

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
