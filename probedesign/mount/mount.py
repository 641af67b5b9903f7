"""The geometry of a design, the mount that holds it (options and both adapters), and how much its root yields there."""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np

from probedesign.core.errors import InputError
from probedesign.core.units import MM
from probedesign.design import Design
from probedesign.design.catalog import SCREWS
from probedesign.design.io import check_design
from probedesign.geometry import FLANGE_LIP, FLANGE_THICKNESS, Axis, Flange, ProbeGeometry, flange_for
from probedesign.mount.flange_adapter import FlangeAdapter, flange_adapter_for
from probedesign.mount.lip import STIFF_RESIN
from probedesign.mount.sensor_adapter import MountOptions, SensorAdapter, sensor_adapter_for, touched_part


def flange_of(design: Design, base_d: float) -> Flange:
    """Return the flange that a design's mount gives to a probe of that base diameter [m]."""
    mount = design.mount
    thickness = FLANGE_THICKNESS if mount.flange_thickness_mm is None else mount.flange_thickness_mm * MM
    return flange_for(base_d, design.sensor_model.interface.tool.face_d, thickness, mount_options(design).lip)


def build_geometry(design: Design) -> ProbeGeometry:
    """Return the geometry of a design, in SI units."""
    knots = np.array(design.probe.knots_mm, dtype=float) * MM
    radius = knots[:, 1] / 2.0
    return ProbeGeometry(
        knots[:, 0],
        radius,
        flange_of(design, 2.0 * float(radius[0])),
        design.probe.cross_section,
        None if design.probe.tip == "blunt" else design.probe.flank_end_mm * MM,
        None if design.probe.centreline.is_straight else design.probe.centreline,
    )


def mount_options(design: Design) -> MountOptions:
    """Return the choices of a design."""
    mount = design.mount
    lip = FLANGE_LIP if mount.flange_lip_mm is None else mount.flange_lip_mm * MM
    squeeze = None if mount.squeeze_mm is None else mount.squeeze_mm * MM
    return MountOptions(SCREWS[mount.ring_screw], lip, squeeze, max(STIFF_RESIN, design.youngs_modulus.value))


@dataclass(frozen=True)
class Mount:
    """What holds the probe of a design. The adapters are computed when they are asked for.

    Each raises InputError where it cannot be made: the sensor adapter where the flange cannot be clamped, the flange
    adapter where the robot's flange leaves no room for the sensor.
    """

    design: Design
    geometry: ProbeGeometry  #: of the design.
    options: MountOptions  #: choices of the design.

    @classmethod
    def of(cls, design: Design) -> "Mount":
        """Return the mount of a design."""
        return cls(design, build_geometry(design), mount_options(design))

    @cached_property
    def sensor_adapter(self) -> SensorAdapter:
        """The adapter between sensor and probe, with its clamp ring, engraved."""
        adapter = sensor_adapter_for(self.geometry, self.design.sensor_model, self.design.name, self.options)
        axis = self.geometry.axis
        if axis.is_straight or not (touched := touched_part(self.geometry, adapter)):
            return adapter
        low, high = 0.0, 1.0  # of all curvature, between which the body just passes
        for _ in range(12):
            middle = 0.5 * (low + high)
            bent = replace(self.geometry, curved=Axis(axis.s, middle * axis.curvature))
            low, high = (low, middle) if touched_part(bent, adapter) else (middle, high)
        bend, radius = self.design.probe.axis_bend_deg, 1.0 / float(np.linalg.norm(axis.curvature, axis=1).max())
        key, most = ("axis_knots_mm_1_m", f"{low:.0%} of this curvature") if bend is None else (
            f"axis_bend_deg = {bend:g}", f"{math.floor(10.0 * low * bend) / 10.0:g}")  # fmt: skip
        raise InputError(
            f"probe.{key}: the body, with a radius of curvature of {radius / MM:.3g} mm, touches {touched}; at most "
            f"{most}, a radius of at least {radius / max(low, 1e-3) / MM:.3g} mm"
        )

    @cached_property
    def flange_adapter(self) -> FlangeAdapter:
        """The plate between robot and sensor, engraved."""
        d = self.design
        return flange_adapter_for(d.sensor_model, d.robot_flange, self.geometry.fingerprint, d.name)


# the compliance of the root in the exported mount, computed by finite elements

Hold = Literal["clamped", "glued"]

_RATIO = (0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 4.1667, 6.6667, 10.0)
#: `root_rigid_radii` by base radius over the flange's thickness. Source: `benchmarks/clamp.py` of commit 04ffc97,
#: linear finite elements of full round bases at ν = 0.49 with a flange of 3 mm.
_MISSING: dict[Hold, tuple[float, ...]] = {
    "clamped": (-0.3686, -0.338, -0.3069, -0.2761, -0.2204, -0.1754, -0.1125, -0.0686, -0.0207, 0.0076),
    "glued": (-0.3684, -0.3342, -0.293, -0.2484, -0.1699, -0.1118, -0.0383, 0.006, 0.0479, 0.07),
}
_ROUNDING = 0.0051  #: Error of a value that `new` rounded to two decimals.
#: Greatest difference of a value that `new` wrote from the one computed now: rounding, and the interpolation in base
#: radius over thickness, 0.005 each.
_NUMERICAL = 0.01
#: Standard deviation of these values [base radii]: friction below the flange moves the clamped one by that much, the
#: other thicknesses and Poisson's ratios less. The land, which supports the inner part of the lip alone, moves them by
#: 0.006 at most (decision 0006); the rooms of the screw heads in it, which are not modelled, soften the root by an
#: estimated 0.03. The squeezed lip is not modelled either (assumed).
ROOT_STD = 0.05


def exported_root_radii(geometry: ProbeGeometry, hold: Hold = "clamped") -> float:
    """Return `root_rigid_radii` of a probe in the exported mount; negative where its soft flange yields.

    Computed, not measured, with a standard deviation of `ROOT_STD`. A face that is bonded at s = 0 to something rigid
    has 0.12; a flange of 3 mm below it yields more even if its underside is glued (docs/decisions/0006).

    Args:
        geometry: of the probe; bores and elliptic sections were not computed.
        hold: clamped: lip stuck between ring and adapter, underside without friction; glued: the underside as well.
    """
    return float(np.interp(geometry.base_radius / geometry.flange.thickness, _RATIO, _MISSING[hold]))


def stated_root_radii(design: Design) -> float:
    """Return the computed `root_rigid_radii` of a design to two decimals, as `new` writes it."""
    return round(exported_root_radii(build_geometry(design), design.mount.hold), 2)


def root_contradiction(design: Design) -> str:
    """Return why `root_rigid_radii` of a design contradicts its `hold`, in one sentence; empty if it does not.

    The value of another hold contradicts, the default beside a stated hold, and a value that is further from the
    computed one than its accuracy. That of a value which `new` wrote, with `hold` and without a standard deviation of
    the user, is numerical: it differs where base, flange or thickness were changed afterwards. That of any other value
    is two of its standard deviations, where the design states them. 0, the paper's rod, and a root that may have been
    identified, do not contradict.
    """
    mount, computed = design.mount, stated_root_radii(design)
    stated, others = mount.root_rigid_radii, [hold for hold in _MISSING if hold != mount.hold]
    geometry = build_geometry(design)
    remedy = f"set it to {computed:g}, or change mount.hold"
    difference = abs(stated - computed)
    for other in others:
        of_other = exported_root_radii(geometry, other)
        if abs(stated - of_other) <= _ROUNDING < difference:
            return (
                f"mount.root_rigid_radii = {stated:g} is that of a {other} flange, but mount.hold is "
                f"{mount.hold!r}; {remedy}"
            )
    if "root_rigid_radii" not in mount.model_fields_set and "hold" in mount.model_fields_set:
        return f"mount.root_rigid_radii is not stated, so {stated:g} is used, of a base bonded at s = 0; {remedy}"
    std = design.tolerances.root_radii
    if stated == 0.0 or design.material.provenance.youngs_modulus_mpa == "identified":
        return ""
    if "hold" in mount.model_fields_set and std in (None, ROOT_STD):
        if abs(stated - exported_root_radii(geometry, mount.hold)) <= _NUMERICAL:
            return ""
        return (
            f"mount.root_rigid_radii = {stated:g}, but {computed:g} is computed for the {mount.hold} flange of this "
            f"design; {remedy}, or state its standard deviation as tolerances.root_radii if you measured it"
        )
    if std is None or difference <= 2.0 * math.hypot(ROOT_STD, std):
        return ""
    return (
        f"mount.root_rigid_radii = {stated:g}, but {computed:g} ± {ROOT_STD:g} is computed for the exported "
        f"{mount.hold} flange; {remedy}, unless the probe is mounted in another way"
    )


def with_computed_root(design: Design, hold: Hold) -> tuple[Design, dict[str, str]]:
    """Return a design with the computed compliance of its exported mount and its uncertainty.

    The uncertainty of other sections and of a base with a fillet stays the default, which is larger: they were not
    computed.

    Returns:
        The design, and notes for `render_design`.
    """
    data = design.model_dump(by_alias=True, exclude_none=True, mode="json")
    data["mount"]["hold"] = hold
    data["mount"]["root_rigid_radii"] = stated_root_radii(check_design(data))
    notes = {"mount.root_rigid_radii": f"computed for the exported {hold} flange, not measured; 0.12: bonded at s = 0"}
    if design.probe.cross_section.full_round and design.probe.base_fillet_mm is None:
        data["tolerances"]["root_radii"] = ROOT_STD
        notes["tolerances.root_radii"] = "computed: friction below the flange; docs/decisions/0006"
    return check_design(data), notes
