"""The geometry of a design, the mount that holds it (options and both adapters), and how much its root yields there."""

import math
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np

from probedesign.core.errors import InputError
from probedesign.core.units import MM
from probedesign.design import Design
from probedesign.design.catalog import SCREWS
from probedesign.geometry import FLANGE_LIP, FLANGE_THICKNESS, Flange, ProbeGeometry, fingerprint_of, flange_for
from probedesign.geometry.mass import MassProperties
from probedesign.mount.flange_adapter import FlangeAdapter, flange_adapter_for
from probedesign.mount.lip import STIFF_RESIN
from probedesign.mount.mass import mount_mass_properties
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
        None if design.probe.designed_axis.is_straight else design.probe.designed_axis,
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

    @classmethod
    def of(cls, design: Design) -> "Mount":
        """Return the mount of a design."""
        return cls(design, build_geometry(design))

    @cached_property
    def sensor_adapter(self) -> SensorAdapter:
        """The adapter between sensor and probe, with its clamp ring, engraved."""
        d = self.design
        adapter = sensor_adapter_for(self.geometry, d.sensor_model, d.name, mount_options(d))
        axis = self.geometry.axis
        if axis.is_straight or not (touched := touched_part(self.geometry, adapter)):
            return adapter
        key, value, most, factor = d.probe.largest_curvature(
            lambda bent: not touched_part(replace(self.geometry, curved=bent), adapter)
        )
        radius = 1.0 / float(np.linalg.norm(axis.curvature, axis=1).max())
        raise InputError(
            f"probe.{key} {value}bends the body to a radius of {radius / MM:.3g} mm, where it touches {touched}; at "
            f"most {most}, a radius of at least {radius / max(factor, 1e-3) / MM:.3g} mm"
        )

    @cached_property
    def flange_adapter(self) -> FlangeAdapter:
        """The plate between robot and sensor, engraved."""
        d = self.design
        return flange_adapter_for(d.sensor_model, d.robot_flange, d.name)

    @cached_property
    def payload(self) -> MassProperties:
        """What hangs on the sensor below s = 0, in the sensor frame."""
        return mount_mass_properties(self.geometry, self.sensor_adapter, self.design.density.value)

    @property
    def fingerprints(self) -> dict[str, str]:
        """Return the fingerprints of the printed parts (the probe has that of its geometry) and of the payload.

        Together they identify a frozen probe. That of a flange adapter which cannot be made is left out.
        """
        probe, plate = {"probe": self.geometry.fingerprint}, dict[str, str]()
        with suppress(InputError):
            plate = {"flange_adapter": self.flange_adapter.fingerprint}
        return {**probe, **self.sensor_adapter.fingerprints, **plate, "payload": payload_fingerprint(self.payload)}


def payload_fingerprint(payload: MassProperties) -> str:
    """Return the fingerprint of a payload: of its mass to a milligram and its centre of mass to a micrometre."""
    return fingerprint_of([1e-3 * round(1e6 * payload.mass), *(1e-3 * np.round(1e6 * payload.p_com))])


# the compliance of the root in the exported mount, computed by finite elements

Hold = Literal["clamped", "glued", "bonded"]

_RATIO = (0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 4.1667, 6.6667, 10.0)
#: `root_rigid_radii` by base radius over the flange's thickness. Source: `benchmarks/clamp.py` of commit 04ffc97,
#: linear finite elements of full round bases at ν = 0.49 with a flange of 3 mm.
_MISSING: dict[Hold, tuple[float, ...]] = {
    "clamped": (-0.3686, -0.338, -0.3069, -0.2761, -0.2204, -0.1754, -0.1125, -0.0686, -0.0207, 0.0076),
    "glued": (-0.3684, -0.3342, -0.293, -0.2484, -0.1699, -0.1118, -0.0383, 0.006, 0.0479, 0.07),
}
#: Least standard deviation of these values [base radii]: friction below the flange moves the clamped one by that much,
#: the other thicknesses and Poisson's ratios less. The land, which supports the inner part of the lip alone, moves them
#: by 0.006 at most (decision 0006); the squeezed lip is not modelled (assumed).
ROOT_STD = 0.05
#: Clamped root of wide bases, 16 to 25 mm, on a floor with the rooms of the screw heads, which the table leaves out:
#: finite elements give -0.15 to -0.16. The difference is the standard deviation where it is more than `ROOT_STD`.
OPEN_FLOOR = -0.155
#: Estimated softening of the root [base radii] by a lip that is not pressed at all, in proportion: 0.03 for a quarter.
UNPRESSED = 0.12
BONDED = 0.12  #: `root_rigid_radii` of a face that is bonded to something rigid at s = 0 (decision 0006).
#: Standard deviation of the shift of s = 0 along z by the squeeze of the lip, over the squeeze. The resin that the ring
#: displaces inwards lifts the base by a third of the squeeze at most, and by nothing where it all moves outwards; half
#: of that range (assumed).
SQUEEZE_SHIFT = 1.0 / 6.0


def exported_root_radii(geometry: ProbeGeometry, hold: Hold = "clamped") -> float:
    """Return `root_rigid_radii` of a probe in the exported mount; negative where its soft flange yields.

    Computed, not measured. A face that is bonded at s = 0 to something rigid has 0.12; a flange of 3 mm below it yields
    more even if its underside is glued (docs/decisions/0006).

    Args:
        geometry: of the probe; bores and elliptic sections were not computed.
        hold: clamped: lip stuck between ring and adapter, underside without friction; glued: the underside as well;
            bonded: no flange between s = 0 and something rigid.
    """
    if hold == "bonded":
        return BONDED
    return float(np.interp(geometry.base_radius / geometry.flange.thickness, _RATIO, _MISSING[hold]))


def exported_root_std(geometry: ProbeGeometry, pressed_share: float = 1.0) -> float:
    """Return the standard deviation of the computed root of the exported mount [base radii].

    Args:
        geometry: of the probe.
        pressed_share: of the land, see `SensorAdapter.pressed_share`.
    """
    computed = max(ROOT_STD, exported_root_radii(geometry) - OPEN_FLOOR)
    return math.hypot(computed, UNPRESSED * (1.0 - pressed_share))


def root_radii(design: Design, geometry: ProbeGeometry) -> float:
    """Return `root_rigid_radii` of a design: as stated, or as computed for its `hold`, to two decimals."""
    stated = design.mount.root_rigid_radii
    return round(exported_root_radii(geometry, design.mount.hold), 2) if stated is None else stated


def held_tolerances(mount: Mount, base_mm: float, clocking_deg: float) -> dict[str, float]:
    """Return the defaults of `[tolerances]` that follow from the hold: of a computed root, of the squeezed base and of
    an adapter that fewer than two dowel pins place, which lies anywhere in the play of its screws.

    Other sections and a base with a fillet were not computed: their root keeps the general default, which is larger.

    Args:
        mount: of the probe.
        base_mm, clocking_deg: standard deviations of the base without a squeeze and with two dowel pins.
    """
    design, adapter, computed = mount.design, mount.sensor_adapter, dict[str, float]()
    if design.mount.hold == "bonded":
        return computed
    if (
        design.mount.root_rigid_radii is None
        and design.probe.cross_section.full_round
        and design.probe.base_fillet_mm is None
    ):
        computed["root_radii"] = round(exported_root_std(mount.geometry, adapter.pressed_share), 3)
    aside = adapter.tool_play / 2 if len(adapter.p_dowels) < 2 else 0.0  # ±, as uniform distributions
    computed["base_mm"] = round(math.hypot(base_mm, SQUEEZE_SHIFT * adapter.squeeze / MM, aside / MM / 3**0.5), 3)
    if aside:
        computed["clocking_deg"] = round(math.hypot(clocking_deg, adapter.tool_play_deg / 3**0.5), 3)
    return computed


def root_contradiction(design: Design) -> str:
    """Return why the stated `root_rigid_radii` of a design contradicts its `hold`, in one sentence; empty if not.

    A value contradicts that is further from the computed one than two standard deviations of both, its own as far as
    the design states it. 0, the paper's rod, and a root that may have been identified, do not contradict.
    """
    stated, hold = design.mount.root_rigid_radii, design.mount.hold
    if not stated or hold == "bonded" or design.material.provenance.youngs_modulus_mpa == "identified":
        return ""
    geometry = build_geometry(design)
    computed, std = exported_root_radii(geometry, hold), exported_root_std(geometry)
    if abs(stated - computed) <= 2.0 * math.hypot(std, design.tolerances.root_radii or 0.0):
        return ""
    return (
        f"mount.root_rigid_radii = {stated:g}, but {computed:.2f} ± {std:.2g} is computed for the {hold} flange of "
        'this design; remove the key, or write hold = "bonded" if the probe is bonded to a rigid part at s = 0, or '
        "state the standard deviation as tolerances.root_radii if you measured the root"
    )
