"""Model of a probe for estimation (the rod, the payload of the sensor and the sensor; no design, no CAD), how well all
of it is known, and observations: one wrench reading at the base or the mean of a window, with its covariance."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from probedesign.core import statistics
from probedesign.core.errors import InputError
from probedesign.core.frames import Array, inverse, wrench_map
from probedesign.core.notebook import Displayed
from probedesign.core.units import MM
from probedesign.design.catalog import (
    ELASTIC_FRICTION,
    OBJECT_COMPLIANCE,
    RESINS,
    STIFFNESS_SPREAD,
    Provenance,
    Quantity,
)
from probedesign.design.sensors import DEFAULT_SENSOR, NANO17_BODY, Noise
from probedesign.geometry import Flange
from probedesign.geometry.axis import Axis
from probedesign.geometry.cross_section import FULL_ROUND, CrossSection
from probedesign.geometry.mass import MassProperties
from probedesign.rod.kernels import kernel
from probedesign.rod.rod import Rod

IDENTIFIED = 0.005  #: What an identification on the bench leaves of the stiffness, relative. Assumed.
#: What an hour on the bench leaves of the stiffness, relative. `plan --minutes 60` expects 3.0 to 3.4 % of the large
#: probe with cameras of 1 mm or a stage of 0.05 mm, 4.4 % of the small one; two hours leave 1.2 to 3.7 %.
AFTER_AN_HOUR = 0.03

#: Time [s] for which `drift_steps` and `walk_steps` are given. Assumed: the detector's walk of 0.05 steps a root of a
#: second makes the default 0.2 steps of it.
WALK_SECONDS = 16.0

#: Deviation of a print's tip from the axis over the length, standard deviation in each of two directions. Assumed: no
#: straightness of slender elastic prints is published; 1 mm of 150 mm, and similar probes are bent in proportion.
BOW_SHARE = 1.0 / 150.0

#: Source of each default, with the product of the resin and the sources of its stiffness and density in the places
#: of the braces.
SOURCES = {
    "drift_steps": "assumed, as in fusion",
    "walk_steps": "assumed: 0.05 steps a root of a second over a quarter of a minute, as drift_steps",
    "youngs_modulus": "assumed: {stiffness}; 0.005 where E is identified",
    "shear_modulus": "assumed, as E",
    "youngs_modulus_by_diameter": "assumed: E is known apart from the diameters",
    "density": "{density}",
    "diameter_mm": "assumed: no tolerance is published for {product}; half of ±0.15 mm",
    "diameter_share": "assumed: half of ±0.5 %, where that is more",
    "diameter_scatter_mm": "assumed: one pixel of a Form 3",
    "bore_mm": "assumed, as the diameters: holes print narrower by an amount that is not published",
    "length_mm": "assumed, as the diameters",
    "length_share": "assumed, as the diameters",
    "bow_mm": "assumed: no straightness is published for {product}; 1 mm of 150 mm of length",
    "base_mm": "assumed, as in fusion, and a sixth of the lip's squeeze (assumed) where a clamp ring presses it",
    "tilt_deg": "assumed: 0.05 mm on a seat of 15 mm",
    "clocking_deg": "assumed: play of the screws",
    "pose_deg": "assumed: as tilt_deg, of the seat of the sensor on the robot",
    "gravity_deg": "assumed: a machine levelled by hand",
    "root_radii": "assumed: half the distance from a bonded face (0.12) to the exported soft flange (about -0.18); "
    "that of a root computed for the hold by finite elements, docs/decisions/0006",
    "gain": "assumed: calibration certificates bound the error to 1.0-1.75 % of full scale; a third of it",
    "creep": "assumed: nothing is published for {product}",
    "stiffness_scatter": "assumed: creep and hysteresis from touch to touch; nothing is published for {product}",
    "object_compliance": f"{OBJECT_COMPLIANCE.provenance}: {OBJECT_COMPLIANCE.source}",
    "object_walk_mm": "assumed: the object stands firm; [contact] object_walk_mm",
    "robot_mm": "assumed: ISO 9283 repeatability of ±0.03 mm of a small arm, taken as three standard deviations",
}


@dataclass(frozen=True)
class Tolerances:
    """Standard deviations of the parameters of a probe model, each normal and independent of the others."""

    #: of the sensor's bias since a tare of a quarter of a minute ago, on each channel, in steps of its resolution;
    #: `Estimator.with_tare_age` lets it grow with the root of time.
    drift_steps: float = 0.2
    #: youngs_modulus, shear_modulus, density: relative, each by itself.
    youngs_modulus: float = STIFFNESS_SPREAD.value
    shear_modulus: float = STIFFNESS_SPREAD.value
    density: float = 0.01
    #: diameter_mm, diameter_share: of all diameters together, the greater of millimetres and share of each.
    diameter_mm: float = 0.075
    diameter_share: float = 0.0025
    diameter_scatter_mm: float = 0.025  #: of each knot's diameter for itself.
    length_mm: float = 0.075  #: length_mm, length_share: of the length, the greater of both.
    length_share: float = 0.0025
    #: of the tip's deviation from the designed axis, in each of two directions: a curvature that is constant along the
    #: probe; 1/150 of the length where a design gives none.
    bow_mm: float = 1.0
    #: of the base's place, on each axis: on the sensor and, independently, as the robot reports it.
    base_mm: float = 0.05
    tilt_deg: float = 0.2  #: of the base about its x and its y axis.
    clocking_deg: float = 0.5  #: of the base about its z axis.
    #: of the base's rotation as the robot reports it, about each of its axes, the same at all poses; it matters where
    #: points count in the world.
    pose_deg: float = 0.2
    gravity_deg: float = 0.2  #: of gravity's direction, about each of two axes across it.
    #: of how far the stiffness has relaxed at the reading, relative; of several touches at the last.
    creep: float = 0.01
    #: of several touches, of the base's place at each for itself, on each axis; one touch does not see it.
    robot_mm: float = 0.01
    #: whether the sensor was tared with the probe free, as mounted: what the free probe's reading has of an error is
    #: then gone.
    tared: bool = True
    #: no standard deviation: the power of the base diameter with which E goes where all diameters are other than
    #: designed together. About -4 where E was identified with the design's diameters, for it is E·d⁴ that was measured;
    #: 0: E is known apart from them.
    youngs_modulus_by_diameter: float = 0.0
    root_radii: float = 0.15  #: of the bending compliance that the base lacks, `root_rigid_radii`, in base radii.
    gain: float = 0.005  #: of the gain of each channel of the sensor by itself, relative.
    stiffness_scatter: float = 0.01  #: of the stiffness at each touch for itself, relative; a single touch has it too.
    #: of the step that the bias takes in `WALK_SECONDS` between the readings of a fusion, in the same steps; its
    #: variance grows with time.
    walk_steps: float = 0.2
    #: scale of the half-normal prior of the compliance of the touched object [m/N]; 0 is a rigid object. One touch does
    #: not see it.
    object_compliance: float = OBJECT_COMPLIANCE.value
    object_walk_mm: float = 0.0  #: of the step of a loose object between two touches, on each axis.
    #: of the bore's diameter in all sections of a hollow probe together, the outer one being as it is.
    bore_mm: float = 0.075

    def __post_init__(self) -> None:
        if not math.isfinite(self.youngs_modulus_by_diameter):
            raise InputError(f"youngs_modulus_by_diameter = {self.youngs_modulus_by_diameter} must be finite")
        for entry in fields(self):
            value = 0.0 if entry.name == "youngs_modulus_by_diameter" else getattr(self, entry.name)
            if not 0.0 <= value < float("inf"):
                raise InputError(f"{entry.name} = {value} must be a standard deviation: finite, not negative")

    @classmethod
    def of(cls, model: "ProbeModel", given: Mapping[str, Any] | None = None) -> "Tolerances":
        """Return the tolerances of a design; what it leaves out comes from the material, or is the default.

        Args:
            model: of the probe; its own tolerances are returned unchanged.
            given: values given by the design, by name; None if it gives none.
        """
        if model.tolerances is not None:
            return model.tolerances
        spread, E = model.stiffness_spread, model.material.get("youngs_modulus")
        if spread is None:
            spread = IDENTIFIED if E is not None and E.provenance == "identified" else _unidentified(model.resin).value
        own = cls(
            youngs_modulus=spread,
            shear_modulus=spread,
            creep=model.creep_spread or cls.creep,
            bow_mm=BOW_SHARE * model.rod.length / MM,
        )
        return replace(own, **{name: value for name, value in (given or {}).items() if value is not None})

    @classmethod
    def none(cls) -> "Tolerances":
        """Return the tolerances of an exact model: zeros."""
        nothing: dict[str, Any] = {entry.name: 0.0 for entry in fields(cls) if entry.name != "tared"}
        return cls(**nothing)

    @classmethod
    def exact_probe(cls, model: "ProbeModel") -> "Tolerances":
        """Return priors in which probe, mount and bench are exact; bias and poses scatter as in `of`."""
        known = cls.of(model)
        return replace(cls.none(), drift_steps=known.drift_steps, walk_steps=known.walk_steps, robot_mm=known.robot_mm)

    @property
    def exact(self) -> bool:
        """Return whether a single reading has no model error."""
        of_one = replace(
            self, robot_mm=0.0, pose_deg=0.0, walk_steps=0.0, object_compliance=0.0, object_walk_mm=0.0, tared=True,
            youngs_modulus_by_diameter=0.0,
        )  # fmt: skip
        return of_one == Tolerances.none()

    def sources(self, resin: str = "", length: float = 0.15) -> dict[str, str]:
        """Return the source of each value, by name.

        Args:
            resin: of the probe, as in its design; empty if unknown.
            length: of the probe [m].
        """
        known = RESINS.get(resin)
        product = "the resin" if known is None else known.product
        density = "assumed" if known is None else known.density_tolerance_source
        spread = _unidentified(resin)
        usual = {"youngs_modulus": spread.value, "shear_modulus": spread.value, "bow_mm": BOW_SHARE * length / MM}
        return {
            name: text.format(product=product, density=density, stiffness=spread.source)
            if math.isclose(getattr(self, name), usual.get(name, getattr(Tolerances, name)))
            else "design"
            for name, text in SOURCES.items()
        }


def _unidentified(resin: str) -> Quantity:
    """Return the standard deviation of E of a print of a resin that was not identified, relative."""
    return RESINS[resin].stiffness_spread if resin in RESINS else STIFFNESS_SPREAD


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
