"""The schema of a design file: its tables with their checks, and the design that they make up.

The tables check types, ranges and their own consistency; `Design` checks the tables against each other and
returns the quantities in SI units with their provenance.
"""

import datetime
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, replace
from itertools import pairwise
from typing import Annotated, ClassVar, Literal, NamedTuple, Self, get_args

import numpy as np
from pydantic import Field, field_validator, model_validator

from probedesign.core.errors import InputError, quoted
from probedesign.core.files import is_plain_name
from probedesign.core.notebook import Displayed
from probedesign.core.units import MM, MPA
from probedesign.design.catalog import (
    CUSTOM,
    ELASTIC_FRICTION,
    GUIDE,
    OBJECT_COMPLIANCE,
    PRINTERS,
    RESINS,
    ROBOT_FLANGES,
    UNMEASURED_SPREAD,
    PostProcessing,
    Printer,
    PrintLimits,
    Provenance,
    Quantity,
    Resin,
    RobotFlange,
    find,
)
from probedesign.design.diagnostics import FromArray, Inconsistent, Table
from probedesign.design.sensor_catalog import SENSORS, Millimetres, SensorRecord, Text
from probedesign.design.sensors import DEFAULT_SENSOR, SensorCalibration, SensorModel
from probedesign.geometry.axis import Axis
from probedesign.geometry.cross_section import CrossSection
from probedesign.geometry.probe_geometry import filleted, rounded, rounding_height_mm

ProbeShape = Literal["cone", "cylinder", "profile"]
SectionKind = Literal["round", "hollow", "elliptic"]
TipKind = Literal["blunt", "rounded"]
AxisKind = Literal["straight", "arc", "helix", "knots"]
AXIS_KINDS: tuple[AxisKind, ...] = get_args(AxisKind)
MAX_GRAVITY = 30.0  #: Largest accepted gravity [m/s²]; a larger one is given in another unit.
MAX_PROFILE_POINTS = 64

MIN_DIAMETER_MM, MAX_DIAMETER_MM = 0.3, 60.0

Length = Annotated[float, Field(ge=5.0, le=400.0)]
Diameter = Annotated[float, Field(ge=MIN_DIAMETER_MM, le=MAX_DIAMETER_MM)]
RelativeStd = Annotated[float, Field(ge=0.0, le=0.5)]
BoreRatio = Annotated[float, Field(ge=0.05, le=0.9)]
Flatness = Annotated[float, Field(ge=0.2, le=1.0)]
#: Printed over drawn size. Resins shrink by a percent or two, so more than a tenth is a mistake (assumed).
SCALE_RANGE = (0.9, 1.1)
Scale = Annotated[float, Field(ge=SCALE_RANGE[0], le=SCALE_RANGE[1])]


class KindKey(NamedTuple):
    """A key of `[probe]` for some kinds of section or axis only.

    A kind of axis is a case of `ProbeTable.designed_axis` and its keys.
    """

    kinds: tuple[str, ...]  #: of section or axis to which it belongs.
    needed: str  #: message when it is missing; empty where it may be.
    comment: str = ""  #: beside it in a design file.
    slider: tuple[str, float, float, float] | None = None  #: label, lowest, highest and step in the studio.
    start: float | None = None  #: value where the kind of axis is chosen in the studio.


SECTION_KEYS = {
    "bore_ratio": KindKey(("hollow",), "a hollow section needs its inner over its outer diameter"),
    "flatness": KindKey(("elliptic",), "an elliptic section needs its diameter along y over that along x"),
}
AXIS_KEYS = {
    "axis_bend_deg": KindKey(("arc", "helix"), "a curved axis needs its total bending angle",
                             "total bending angle, curvature times length", ("bend [deg]", 0.0, 180.0, 1.0), 60.0),
    "axis_turns": KindKey(("helix",), "a helix needs the turns of its plane of bending",
                          "of the plane of bending, from base to tip", ("turns of the bend", -1.5, 1.5, 0.05), 0.5),
    "axis_azimuth_deg": KindKey(("arc", "helix"), "", "of the plane of bending at the base, from x towards y",
                                ("azimuth of the bend [deg]", -180.0, 180.0, 1.0), 0.0),
    "axis_knots_mm_1_m": KindKey(("knots",), "the axis needs triples [s, curvature towards X, towards Y]",
                                 "s [mm], curvature towards X and Y [1/m]"),
}  # fmt: skip


class ProbeTable(Table):
    """`[probe]`: the flexible part. Lengths are in millimetres; diameters of an elliptic section are along x."""

    shape: ProbeShape = "cone"
    length_mm: Length
    base_d_mm: Diameter
    tip_d_mm: Diameter | None = None
    profile_mm: Annotated[tuple[tuple[float, float], ...] | None, FromArray] = None
    tip: TipKind = "blunt"
    section: SectionKind = "round"
    bore_ratio: BoreRatio | None = None
    flatness: Flatness | None = None
    base_fillet_mm: Annotated[float, Field(ge=0.2, le=5.0)] | None = None
    bow_mm: Annotated[tuple[float, float] | None, FromArray] = None
    axis: AxisKind = "straight"
    axis_bend_deg: Annotated[float, Field(ge=0.0, le=1440.0)] | None = None
    axis_turns: Annotated[float, Field(ge=-10.0, le=10.0)] | None = None
    axis_azimuth_deg: Annotated[float, Field(ge=-360.0, le=360.0)] | None = None
    axis_knots_mm_1_m: Annotated[tuple[tuple[float, float, float], ...] | None, FromArray] = None
    assumed: Annotated[tuple[str, ...], FromArray] = ()
    measured: Annotated[tuple[Literal["base_d_mm", "tip_d_mm", "profile_mm", "bow_mm"], ...], FromArray] = ()

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        for name in self.assumed:
            if name not in ("length_mm", "base_d_mm", "tip_d_mm", "profile_mm", *SECTION_KEYS):
                raise Inconsistent("assumed", f"'{name}' is not a dimension of [probe]")
        if self.shape == "profile":
            self._check_profile()
        elif self.profile_mm is not None:
            raise Inconsistent("profile_mm", 'is only for shape = "profile"; remove it or change the shape')
        elif self.shape == "cylinder":
            if self.tip_d_mm not in (None, self.base_d_mm):
                raise Inconsistent(
                    "tip_d_mm",
                    f"= {self.tip_d_mm!r} differs from base_d_mm = {self.base_d_mm!r}; "
                    "a cylinder has one diameter: leave it out",
                )
        elif self.tip_d_mm is None:
            raise Inconsistent("tip_d_mm", f"is missing; a {self.shape} needs its tip diameter")
        elif self.tip_d_mm > self.base_d_mm:
            raise Inconsistent(
                "tip_d_mm",
                f"= {self.tip_d_mm!r} is wider than base_d_mm = {self.base_d_mm!r}; a {self.shape} tapers to its tip",
            )
        self._check_keys("section", SECTION_KEYS)
        self._check_tip()
        self._check_fillet()
        if self.bow_mm is not None and not math.hypot(*self.bow_mm) < self.length_mm:
            raise Inconsistent(
                "bow_mm", f"= {list(self.bow_mm)} must be smaller than the length of the probe, {self.length_mm:g} mm"
            )
        self._check_keys("axis", AXIS_KEYS)
        if self.axis != "straight":
            self._check_axis()
        return self

    def _check_keys(self, choice: str, keys: Mapping[str, KindKey]) -> None:
        kind = getattr(self, choice)
        for key, of in keys.items():
            given = getattr(self, key) is not None
            if given and kind not in of.kinds:
                allowed = " or ".join(f'"{name}"' for name in of.kinds)
                raise Inconsistent(key, f"is only for {choice} = {allowed}; remove it or change the {choice}")
            if not given and of.needed and kind in of.kinds:
                raise Inconsistent(key, f"is missing; {of.needed}")

    def _check_axis(self) -> None:
        if self.axis_knots_mm_1_m is not None:
            columns = "[s, towards X, towards Y]"
            self._check_rows("axis_knots_mm_1_m", self.axis_knots_mm_1_m, "triple", columns)
        s, d = MM * np.array(self.knots_mm).T
        if reason := self.designed_axis.conflict(s, d / 2.0):
            key, value, most, _ = self.largest_curvature(lambda axis: not axis.conflict(s, d / 2.0))
            raise Inconsistent(key, f"{value}{reason}; at most {most}")

    def largest_curvature(self, fits: Callable[[Axis], bool]) -> tuple[str, str, str, float]:
        """Return the key of the curvature, its value, the largest one with which the axis fits, and that factor.

        Args:
            fits: whether the body can follow an axis.
        """
        low, high, (key, bend) = 0.0, 1.0, self.scaled_axis(1.0)  # of all curvature, between which it just fits
        for _ in range(12):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if fits(self.designed_axis.scaled(middle)) else (low, middle)
        if not isinstance(bend, float):
            return key, "", f"{low:.0%} of this curvature", low
        return key, f"= {bend:g} ", f"{math.floor(10.0 * low * bend) / 10.0:g}", low

    def scaled_axis(self, factor: float) -> tuple[str, float | list[list[float]]]:
        """Return the key that states the curvature of the axis, and its value with all curvature times a factor."""
        if self.axis_knots_mm_1_m is not None:
            return "axis_knots_mm_1_m", [[s, factor * x, factor * y] for s, x, y in self.axis_knots_mm_1_m]
        return "axis_bend_deg", factor * (self.axis_bend_deg or 0.0)

    def _check_rows(self, key: str, rows: Sequence[tuple[float, ...]], row: str, columns: str) -> None:
        """Refuse rows that do not begin with values of s which increase from 0 to the length."""
        if not 2 <= len(rows) <= MAX_PROFILE_POINTS:
            raise Inconsistent(key, f"needs 2 to {MAX_PROFILE_POINTS} {row}s {columns}")
        for i, ((before, *_), (after, *_)) in enumerate(pairwise(rows), 2):
            if after <= before:
                raise Inconsistent(key, f"{row} {i}: s = {after!r} does not increase after {before!r}")
        for end, value, name, wanted in (("first", rows[0][0], "0", 0.0),
                                         ("last", rows[-1][0], "length_mm", self.length_mm)):  # fmt: skip
            if value != wanted:
                raise Inconsistent(key, f"s of the {end} {row} is {value!r}, it must equal {name} = {wanted!r}")

    @property
    def designed_axis(self) -> Axis:
        """Return the axis without load; lengths in metres."""
        if self.axis_knots_mm_1_m is not None:
            s, x, y = np.array(self.axis_knots_mm_1_m, dtype=float).T
            return Axis(s * MM, np.stack([x, y], axis=1))
        bend, azimuth = (math.radians(angle or 0.0) for angle in (self.axis_bend_deg, self.axis_azimuth_deg))
        return Axis.helix(self.length_mm * MM, bend, self.axis_turns or 0.0, azimuth)

    def _check_profile(self) -> None:
        points = self.profile_mm or ()
        self._check_rows("profile_mm", points, "pair", "[s, diameter]")
        for i, (_, d) in enumerate(points, 1):
            if not MIN_DIAMETER_MM <= d <= MAX_DIAMETER_MM:
                allowed = f"{MIN_DIAMETER_MM:g} ... {MAX_DIAMETER_MM:g} mm"
                raise Inconsistent("profile_mm", f"pair {i}: diameter {d!r} is outside {allowed}")
        first, last = points[0][1], points[-1][1]
        for end, value, key, wanted in (
            ("first", first, "base_d_mm", self.base_d_mm),
            ("last", last, "tip_d_mm", last if self.tip_d_mm is None else self.tip_d_mm),
        ):
            if value != wanted:
                raise Inconsistent("profile_mm", f"the {end} diameter is {value!r}, it must equal {key} = {wanted!r}")

    def _check_tip(self) -> None:
        if self.tip == "blunt":
            return
        if self.section == "hollow":
            raise Inconsistent("tip", '= "rounded" would close the bore of a hollow probe; use tip = "blunt"')
        before, last = self.blunt_mm[-2:]
        straight, height = last[0] - before[0], rounding_height_mm(before, last)
        if straight < height:
            raise Inconsistent(
                "tip",
                f'= "rounded" takes the last {height:g} mm and only {straight:g} mm are straight; '
                f'at most {last[1] * straight / height:g} mm wide there, or tip = "blunt"',
            )

    def _check_fillet(self) -> None:
        if self.base_fillet_mm is None:
            return
        if self.section == "elliptic":
            raise Inconsistent("base_fillet_mm", "is only for round and hollow sections; remove it")
        second = self.blunt_mm[1]
        height = filleted(self.blunt_mm, self.base_fillet_mm)[1]
        end = self.length_mm if len(self.blunt_mm) > 2 or self.tip == "blunt" else self._rounded_mm[1][0]
        straight = min(second[0], end)
        if height > straight - 1e-6:  # a nanometre for round-off
            raise Inconsistent(
                "base_fillet_mm",
                f"= {self.base_fillet_mm:g} ends at s = {height:.3g} mm, beyond the first straight piece, up to "
                f"{straight:g} mm; take a smaller one",
            )

    @property
    def _rounded_mm(self) -> tuple[tuple[float, float], ...]:
        """Return (s, diameter) of the knots without the fillet [mm]."""
        return self.blunt_mm if self.tip == "blunt" else rounded(self.blunt_mm)

    @property
    def knots_mm(self) -> tuple[tuple[float, float], ...]:
        """Return (s, diameter) of the knots between which the diameter is linear [mm], rounding and fillet included."""
        if self.base_fillet_mm is None:
            return self._rounded_mm
        fillet, _ = filleted(self.blunt_mm, self.base_fillet_mm)
        return (*fillet, *self._rounded_mm[1:])

    @property
    def flank_end_mm(self) -> float:
        """Return the arclength at which the flank ends and a rounded tip begins [mm]; the length for a blunt tip."""
        return self._rounded_mm[len(self.blunt_mm) - 1][0]

    @property
    def blunt_mm(self) -> tuple[tuple[float, float], ...]:
        """Return (s, diameter) of the knots of the body with a blunt tip [mm]."""
        if self.profile_mm is not None:
            return self.profile_mm
        tip = self.base_d_mm if self.tip_d_mm is None else self.tip_d_mm
        return ((0.0, self.base_d_mm), (self.length_mm, tip))

    @property
    def cross_section(self) -> CrossSection:
        """Return the proportions of the cross section."""
        return CrossSection(self.bore_ratio or 0.0, self.flatness or 1.0)


class ProvenanceTable(Table):
    """`[material.provenance]`: provenance of each number of `[material]`."""

    youngs_modulus_mpa: Provenance = "assumed"
    shear_modulus_mpa: Provenance = "assumed"
    density_kg_m3: Provenance = "assumed"


Digest = Annotated[str, Field(pattern="^[0-9a-f]{8}$")]  #: `campaigns.Test.digest` of a test.


class ResinRecord(Table):
    """A resin file: `source` is of its numbers; without a shear modulus that of an incompressible resin is assumed."""

    name: Text
    product: Text
    source: Text
    youngs_modulus_mpa: Annotated[float, Field(ge=0.01, le=1e5)]
    shear_modulus_mpa: Annotated[float, Field(ge=0.003, le=1e5)] | None = None
    density_kg_m3: Annotated[float, Field(ge=100.0, le=20000.0)]
    stiffness_spread: Annotated[float, Field(ge=0.0, le=0.5)] = UNMEASURED_SPREAD.value
    friction: Annotated[float, Field(ge=0.0, le=5.0)] = ELASTIC_FRICTION.value
    provenance: Provenance = "assumed"
    wash: Text = PostProcessing.wash
    dry: Text = PostProcessing.dry
    cure: Text = PostProcessing.cure
    ageing: Text = PostProcessing.ageing
    storage: Text = PostProcessing.storage

    @property
    def record(self) -> Resin:
        """Return the resin in SI units."""
        E, G = self.youngs_modulus_mpa, self.shear_modulus_mpa
        return Resin(
            self.name, self.product, Quantity(E * MPA, self.provenance, self.source),
            Quantity(E * MPA / 3.0, "assumed", "E/3, the incompressible limit")
            if G is None else Quantity(G * MPA, self.provenance, self.source),
            Quantity(self.stiffness_spread, "assumed", self.source),
            Quantity(self.density_kg_m3, self.provenance, self.source),
            Quantity(self.friction, "assumed", self.source), "assumed: 1 %, as of Elastic 50A V1",
            PostProcessing(self.wash, self.dry, self.cure, self.ageing, self.storage),
        )  # fmt: skip


Feature = Annotated[float, Field(gt=0.0, le=20.0)]
Platform = Annotated[float, Field(gt=0.0, le=2000.0)]


class PrinterRecord(Table):
    """A printer file; a limit that it leaves out is that of Formlabs' printers."""

    name: Text
    product: Text
    source: Text
    build_volume_mm: Annotated[tuple[Platform, Platform, Platform], FromArray]
    layer_mm: Feature | None = None
    supported_wall_mm: Feature | None = None
    wall_mm: Feature | None = None
    hole_mm: Feature | None = None
    drain_mm: Feature | None = None
    engraving_mm: Feature | None = None
    soft_feature_mm: Feature | None = None
    overhang_deg: Annotated[float, Field(ge=0.0, le=90.0)] | None = None

    @property
    def record(self) -> Printer:
        """Return the printer with its limits."""
        given = self.model_dump(exclude_none=True, exclude={"name", "product", "source", "build_volume_mm"})
        left = "" if len(given) == len(fields(PrintLimits)) - 1 else f"; limits that it leaves out: {GUIDE}"
        return Printer(self.name, self.product, self.build_volume_mm,
                       PrintLimits(**given, source=f"{self.source}{left}"))  # fmt: skip


class ChoiceTable(Table):
    """A table with a key that names a record of the catalog, or is `CUSTOM` where another key describes it."""

    choice: ClassVar[str]
    description: ClassVar[str] = "own"

    @model_validator(mode="after")
    def _described(self) -> Self:
        own, described, choice = self.description, getattr(self, self.description), self.choice
        if (described is not None) != (getattr(self, choice) == CUSTOM):
            file = ", or name its file: file = ..." if own == "own" else ""
            missing = f"is missing beside {choice} = {CUSTOM!r}; describe it there{file}"
            unused = f"is only for {choice} = {CUSTOM!r}; remove it or change {choice}"
            raise Inconsistent(own, missing if described is None else unused)
        return self


class MaterialTable(ChoiceTable):
    """`[material]`: a resin by name; numbers given here replace those of the resin.

    In a file, `file` names a resin file, which `io` reads into `own`.
    """

    choice = "resin"
    resin: str = "elastic-50a"
    own: ResinRecord | None = None
    youngs_modulus_mpa: Annotated[float, Field(ge=0.01, le=1e5)] | None = None
    shear_modulus_mpa: Annotated[float, Field(ge=0.003, le=1e5)] | None = None
    density_kg_m3: Annotated[float, Field(ge=100.0, le=20000.0)] | None = None
    shear_coefficient: Annotated[float, Field(ge=0.1, le=1.2)] = 1.0
    stiffness_spread: Annotated[float, Field(ge=0.0, le=0.5)] | None = None
    creep_spread: Annotated[float, Field(ge=0.0, le=0.5)] = 0.0
    identified_tests: Annotated[tuple[Digest, ...], FromArray] = ()
    provenance: ProvenanceTable = ProvenanceTable()


class SensorTable(ChoiceTable):
    """`[sensor]`: the sensor, its calibration and the number of samples averaged to one reading.

    In a file, `file` names a sensor file, which `io` reads into `own`.
    """

    choice = "model"
    model: str = DEFAULT_SENSOR
    calibration: str | None = None
    averaging_samples: Annotated[int, Field(ge=1, le=70000)] = 36
    own: SensorRecord | None = None


class FlangeTable(Table):
    """`[mount.flange]`, a robot flange that is not in the catalog.

    Azimuths are measured from the dowel; `recess_d_mm` is of the recess that takes the spigot.
    """

    bolt: Literal["M4", "M5", "M6", "M8"]
    bolt_circle_d_mm: Millimetres
    bolt_azimuths_deg: Annotated[tuple[float, ...], FromArray]
    max_bolt_entry_mm: Millimetres
    bolt_length_mm: Millimetres
    face_d_mm: Millimetres
    pin_slot_mm: Annotated[tuple[Millimetres, Millimetres] | None, FromArray] = None
    spigot_mm: Annotated[tuple[Millimetres, Millimetres] | None, FromArray] = None
    recess_d_mm: Millimetres | None = None

    @model_validator(mode="after")
    def _bolted(self) -> Self:
        if not 2 <= len(self.bolt_azimuths_deg) <= 12:
            raise Inconsistent("bolt_azimuths_deg", "needs 2 to 12 angles from the dowel")
        spigot_d, _ = self.spigot_mm or (math.inf, 0.0)
        if self.recess_d_mm is not None and self.recess_d_mm <= spigot_d:
            raise Inconsistent("recess_d_mm", f"= {self.recess_d_mm:g} needs a spigot_mm that is narrower")
        return self

    @property
    def record(self) -> RobotFlange:
        """Return the flange in SI units; without the robot's recess that of a play of 0.2 mm is assumed."""
        slot, spigot = ((pair[0] * MM, pair[1] * MM) for pair in (self.pin_slot_mm or (0, 0), self.spigot_mm or (0, 0)))
        flange = RobotFlange(
            CUSTOM, self.bolt_circle_d_mm * MM, self.bolt_azimuths_deg, self.bolt, self.max_bolt_entry_mm * MM,
            self.bolt_length_mm * MM, slot, spigot, self.face_d_mm * MM, "design file, mount.flange",
        )  # fmt: skip
        return flange if self.recess_d_mm is None else replace(flange, spigot_play=self.recess_d_mm * MM - spigot[0])


class MountTable(ChoiceTable):
    """`[mount]`: robot flange, gravity, compliance of the root, and how the flange is held.

    Lengths that are not given take the defaults of the mount, and a root that is not given is computed for `hold`
    (`mount.root_radii`).
    """

    choice, description = "robot_flange", "flange"
    robot_flange: str = "iso-9409-1-50-4-m6"
    flange: FlangeTable | None = None
    gravity_base_m_s2: Annotated[tuple[float, float, float], FromArray] = (9.81, 0.0, 0.0)
    root_rigid_radii: Annotated[float, Field(ge=-1.0, le=2.0)] | None = None
    hold: Literal["clamped", "glued", "bonded"] = "clamped"
    ring_screw: Literal["M2", "M3"] = "M2"
    flange_thickness_mm: Annotated[float, Field(ge=1.0, le=10.0)] | None = None
    flange_lip_mm: Annotated[float, Field(ge=3.5, le=10.0)] | None = None
    squeeze_mm: Annotated[float, Field(ge=0.0, le=2.0)] | None = None

    @model_validator(mode="after")
    def _plausible(self) -> Self:
        if math.hypot(*self.gravity_base_m_s2) > MAX_GRAVITY:
            given = f"= {list(self.gravity_base_m_s2)} is longer than {MAX_GRAVITY:g} m/s²"
            raise Inconsistent("gravity_base_m_s2", f"{given}; give it in m/s², e.g. [9.81, 0.0, 0.0]")
        return self


class ContactProvenanceTable(Table):
    """`[contact.provenance]`: provenance of each number of `[contact]`."""

    friction: Provenance = "assumed"
    object_compliance_m_N: Provenance = "assumed"


class ContactTable(Table):
    """`[contact]`: friction of a touch, and the touched object.

    A friction of `inf` leaves the direction of the force free, 0 is frictionless; a compliance of 0 is a rigid object.
    """

    friction: Annotated[float, Field(ge=0.0, allow_inf_nan=True)] | None = None
    object_compliance_m_N: Annotated[float, Field(ge=0.0, le=10.0)] | None = None
    object_walk_mm: Annotated[float, Field(ge=0.0, le=50.0)] | None = None
    provenance: ContactProvenanceTable = ContactProvenanceTable()


class PrintTable(ChoiceTable):
    """`[print]`: the printer, and the printed over the drawn size that compensates shrinkage.

    In a file, `file` names a printer file, which `io` reads into `own`.
    """

    choice = "printer"
    printer: str = "form-3"
    own: PrinterRecord | None = None
    scale_xy: Scale = 1.0
    scale_z: Scale = 1.0
    offset_xy_mm: Annotated[float, Field(ge=-0.5, le=0.5)] = 0.0
    rigid_scale_xy: Scale = 1.0
    rigid_scale_z: Scale = 1.0


class TolerancesTable(Table):
    """`[tolerances]`: standard deviations of the model parameters; missing ones take their defaults."""

    drift_steps: Annotated[float, Field(ge=0.0, le=100.0)] | None = None
    walk_steps: Annotated[float, Field(ge=0.0, le=100.0)] | None = None
    youngs_modulus: RelativeStd | None = None
    youngs_modulus_by_diameter: Annotated[float, Field(ge=-20.0, le=20.0)] | None = None
    shear_modulus: RelativeStd | None = None
    density: RelativeStd | None = None
    diameter_mm: Annotated[float, Field(ge=0.0, le=1.0)] | None = None
    diameter_share: RelativeStd | None = None
    diameter_scatter_mm: Annotated[float, Field(ge=0.0, le=1.0)] | None = None
    bore_mm: Annotated[float, Field(ge=0.0, le=1.0)] | None = None
    length_mm: Annotated[float, Field(ge=0.0, le=5.0)] | None = None
    length_share: RelativeStd | None = None
    bow_mm: Annotated[float, Field(ge=0.0, le=100.0)] | None = None
    base_mm: Annotated[float, Field(ge=0.0, le=5.0)] | None = None
    tilt_deg: Annotated[float, Field(ge=0.0, le=10.0)] | None = None
    clocking_deg: Annotated[float, Field(ge=0.0, le=10.0)] | None = None
    pose_deg: Annotated[float, Field(ge=0.0, le=10.0)] | None = None
    gravity_deg: Annotated[float, Field(ge=0.0, le=10.0)] | None = None
    root_radii: Annotated[float, Field(ge=0.0, le=1.0)] | None = None
    gain: RelativeStd | None = None
    creep: RelativeStd | None = None
    stiffness_scatter: RelativeStd | None = None
    robot_mm: Annotated[float, Field(ge=0.0, le=5.0)] | None = None
    tared: bool | None = None


class Design(Table, Displayed):
    """A probe as its design file describes it: the checked tables, and their quantities in SI units."""

    schema_version: Literal[1] = Field(alias="schema")
    name: str
    date: str | None = None
    owner: Annotated[str, Field(max_length=60, pattern=r"^[^\x00-\x1f\x7f]*$")] | None = None
    probe: ProbeTable
    material: MaterialTable = MaterialTable()
    sensor: SensorTable = SensorTable()
    mount: MountTable = MountTable()
    contact: ContactTable = ContactTable()
    print_: PrintTable = Field(default=PrintTable(), alias="print")
    tolerances: TolerancesTable = TolerancesTable()

    @field_validator("name")
    @classmethod
    def _plain(cls, value: str) -> str:
        check_name(value)
        return value

    @field_validator("date")
    @classmethod
    def _calendar_date(cls, value: str | None) -> str | None:
        try:
            return None if value is None else datetime.date.fromisoformat(value).isoformat()
        except ValueError:
            raise Inconsistent("date", f'= {value!r} is not a date; write it as "2026-01-31"') from None

    @model_validator(mode="after")
    def _fits(self) -> Self:
        root = self.mount.root_rigid_radii or 0.0
        rigid = root * self.probe.base_d_mm / 2.0
        if rigid >= self.probe.length_mm:
            limit = 2.0 * self.probe.length_mm / self.probe.base_d_mm
            raise Inconsistent(
                "mount.root_rigid_radii", f"= {root:g} makes {rigid:g} mm rigid, the whole probe; stay below {limit:g}"
            )
        bow, length = self.tolerances.bow_mm, self.probe.length_mm
        if bow is not None and bow >= length:
            raise Inconsistent(
                "tolerances.bow_mm",
                f"= {bow:g} is a deviation of the tip as large as the probe is long; stay below {length:g}",
            )
        return self

    @model_validator(mode="after")
    def _known(self) -> Self:
        try:
            _ = self.resin, self.calibration, self.robot_flange, self.printer
        except InputError as error:
            key, _, rest = str(error).partition(": ")
            raise Inconsistent(key, rest) from None
        face = self.sensor_model.interface
        if face.tool.bolt_circle_d == 0.0 and not face.dowels.azimuths_deg and self.tolerances.clocking_deg is None:
            raise Inconsistent(
                "tolerances.clocking_deg",
                "is missing: the sensor's one screw on the axis leaves any turn of the adapter; "
                "describe a dowel hole as interface.dowels of the sensor, or measure the turn and state its std here",
            )
        return self

    @property
    def resin(self) -> Resin:
        """Return the resin of `[material]`."""
        described = self.material.own
        return find(RESINS, self.material.resin, "material.resin", CUSTOM) if described is None else described.record

    @property
    def sensor_model(self) -> SensorModel:
        """Return the sensor of the catalog, or that of `[sensor.own]`."""
        described = self.sensor.own
        return find(SENSORS, self.sensor.model, "sensor.model", CUSTOM) if described is None else described.sensor

    @property
    def calibration(self) -> SensorCalibration:
        """Return the calibration of `[sensor]`: the finest if none is named."""
        name = self.sensor.calibration
        return self.sensor_model.calibrations[0] if name is None else self.sensor_model.calibration(name)

    @property
    def robot_flange(self) -> RobotFlange:
        """Return the robot flange of the catalog, or that of `[mount.flange]`."""
        custom = self.mount.flange
        if custom is not None:
            return custom.record
        return find(ROBOT_FLANGES, self.mount.robot_flange, "mount.robot_flange", CUSTOM)

    @property
    def printer(self) -> Printer:
        """Return the printer of `[print]`."""
        described = self.print_.own
        return find(PRINTERS, self.print_.printer, "print.printer", CUSTOM) if described is None else described.record

    @property
    def youngs_modulus(self) -> Quantity:
        """Return E [Pa] with its provenance."""
        return self._quantity("material", "youngs_modulus_mpa", MPA, self.resin.youngs_modulus)

    @property
    def shear_modulus(self) -> Quantity:
        """Return G [Pa] with its provenance."""
        return self._quantity("material", "shear_modulus_mpa", MPA, self.resin.shear_modulus)

    @property
    def density(self) -> Quantity:
        """Return the density [kg/m³] with its provenance."""
        return self._quantity("material", "density_kg_m3", 1.0, self.resin.density)

    @property
    def friction(self) -> Quantity:
        """Return the friction of a touch, tangential over normal force [-], with its provenance."""
        return self._quantity("contact", "friction", 1.0, self.resin.friction)

    @property
    def object_compliance(self) -> Quantity:
        """Return the scale of the prior on the compliance of the touched object [m/N], with its provenance."""
        return self._quantity("contact", "object_compliance_m_N", 1.0, OBJECT_COMPLIANCE)

    def _quantity(self, table: str, key: str, unit: float, default: Quantity) -> Quantity:
        values = getattr(self, table)
        given = getattr(values, key)
        if given is None:
            return default
        return Quantity(given * unit, getattr(values.provenance, key), f"design file, {table}.{key}")

    @property
    def assumptions(self) -> tuple[str, ...]:
        """Return the keys whose values are assumed, each as `table.key`, for all reports."""
        dimensions = [f"probe.{key}" for key in self.probe.assumed]
        material = {
            "youngs_modulus_mpa": self.youngs_modulus,
            "shear_modulus_mpa": self.shear_modulus,
            "density_kg_m3": self.density,
        }
        root = ("mount.root_rigid_radii",) if self.mount.root_rigid_radii != 0.0 else ()
        # An infinite friction leaves the direction of the force free: no number is assumed.
        friction, free = self.friction, math.isinf(self.friction.value)
        contact: tuple[str, ...] = ("contact.friction",) if friction.provenance == "assumed" and not free else ()
        if self.object_compliance.value != 0.0 and self.object_compliance.provenance == "assumed":
            contact += ("contact.object_compliance_m_N",)
        return (
            *dimensions,
            *(f"material.{key}" for key, q in material.items() if q.provenance == "assumed"),
            *root,
            *contact,
            *(f"sensor.{key}" for key in ("model", "calibration") if key not in self.sensor.model_fields_set),
            *(f"sensor.{key}" for key in self.sensor_model.assumed),
        )


def check_name(name: str) -> None:
    """Refuse a design name that is not a plain file name.

    Raises:
        InputError: the name has a path, a space or odd characters in it.
    """
    if not is_plain_name(name):
        allowed = "letters, digits, '-', '_' and '.', at most 64, no path, no extension"
        raise InputError(f"name: {quoted(name)} is not a plain name; use {allowed}")
