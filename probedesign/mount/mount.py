"""The geometry of a design, and the mount that holds it: the choices of `[mount]` and both adapters."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from probedesign.core.units import MM
from probedesign.design import Design
from probedesign.design.catalog import SCREWS
from probedesign.geometry import FLANGE_LIP, FLANGE_THICKNESS, Flange, ProbeGeometry, flange_for
from probedesign.mount.flange_adapter import FlangeAdapter, flange_adapter_for
from probedesign.mount.lip import STIFF_RESIN
from probedesign.mount.sensor_adapter import MountOptions, SensorAdapter, sensor_adapter_for


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
        return sensor_adapter_for(self.geometry, self.design.sensor_model, self.design.name, self.options)

    @cached_property
    def flange_adapter(self) -> FlangeAdapter:
        """The plate between robot and sensor, engraved."""
        d = self.design
        return flange_adapter_for(d.sensor_model, d.robot_flange, self.geometry.fingerprint, d.name)
