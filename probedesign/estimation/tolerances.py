"""How well a probe, its mount and its sensor are known: standard deviations, each with where it comes from."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, Protocol

from probedesign.core.errors import InputError
from probedesign.core.units import MM
from probedesign.design.catalog import OBJECT_COMPLIANCE, RESINS, STIFFNESS_SPREAD, Quantity
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


class KnownModel(Protocol):
    """What `Tolerances.of` asks of the model of a probe."""

    @property
    def tolerances(self) -> "Tolerances | None":
        """How well all of it is known; None: as its material has it."""

    @property
    def material(self) -> Mapping[str, Quantity]:
        """E, G and density with where they come from."""

    @property
    def rod(self) -> Rod:
        """The flexible part."""

    @property
    def stiffness_spread(self) -> float | None:
        """Standard deviation of E and of G, relative; None: by where E comes from."""

    @property
    def resin(self) -> str:
        """Name of the resin; empty if unknown."""

    @property
    def creep_spread(self) -> float:
        """Standard deviation of how far it relaxes while touches are fused, relative."""


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
    def of(cls, model: KnownModel, given: Mapping[str, Any] | None = None) -> "Tolerances":
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
    def exact_probe(cls, model: KnownModel) -> "Tolerances":
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
