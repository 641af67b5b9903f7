"""Dimensions of the sensor adapter and its clamp ring, derived from the probe's geometry and the sensor.

From bottom to top, in the sensor frame: foot on the tool face; floor with three countersunk M2 screws; recess with
the probe's flange, clocked by a peg at +X; clamp ring on the flange's lip; four M2 screws into nuts outside.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from probedesign.core.errors import InputError
from probedesign.core.frames import Array, pose
from probedesign.core.units import MM
from probedesign.design.catalog.sensors import ScrewPattern, SensorModel
from probedesign.geometry import FLANGE_LIP, Flange, ProbeGeometry
from probedesign.mount.engraving import XY, Engraving, engrave, free_arcs
from probedesign.mount.fasteners import (
    HEAD_SUNK,
    M2,
    M2_CLEARANCE_D,
    M2_COUNTERBORE_D,
    M2_GRIP,
    M2_NUT_AF,
    M2_NUT_HEIGHT,
    NUT_PROTRUSION,
)

FOOT_HEIGHT = 1.0 * MM
"""Height of the wide plate above the tool face: clearance to the sensor's body and its cable."""
SLIP = 0.2 * MM  # on the diameter, rigid resin (assumed)
SQUEEZE = 0.2 * MM
"""Compression of the flange's lip when the ring rests on the wall; the lip is drawn uncompressed."""
DOWEL_PIN_LENGTH = 6.0 * MM
PEG_D = 1.9 * MM
RING_THICKNESS = 2.5 * MM
RING_CLEARANCE = 0.5 * MM
"""Radial clearance of the ring's bore to the probe at s = 0; the bore then widens by 45° to clear the bending probe."""
MIN_LIP = 1.5 * MM
RING_AZIMUTHS_DEG = (45.0, 135.0, 225.0, 315.0)
RING_SCREW_OUT = 2.3 * MM
"""From the flange's rim out to the ring's screws: half a slip fit, 1.0 mm of wall, half a clearance hole."""
RIM_OUT = 3.1 * MM
"""From the ring's screws out to the rim: half a nut pocket and 1.0 mm of wall."""
LETTER_EDGE = 0.8 * MM
"""Distance from a hole or a screw head's seat to the nearest character."""
LETTERS_OUT = 0.3 * MM
"""From the ring's screws out to the centre of the characters: midway between recess and flat."""
PEG_INWARD = 0.05 * MM
"""Offset inward from the middle of the lip: outside the hole the soft lip keeps 0.8 mm, twice the minimum wall
(assumed), and the ring presses all around it."""
MARK_FLAT = 0.8 * MM
"""Depth of the flat on the adapter's rim that marks +X on the outside."""


@dataclass(frozen=True)
class SensorAdapter:
    """Dimensions of the adapter on the tool side, in the sensor frame [m].

    Attributes:
        tool: the sensor's screw holes.
        floor: tool face to the flange's underside.
        foot_d, foot_height: the disc that rests on the tool face.
        body_d, body_top: the plate from `foot_height` to `body_top`.
        recess_d: diameter of the flange's seat, from `floor` up.
        mark_x: distance of the +X flat from the axis.
        dowel_d, dowel_depth, p_dowels: blind holes from below for the sensor's dowel pins.
        peg_top, peg_x: the clocking peg on the floor, at y = 0.
        peg_hole_d: in the flange.
        flange: the probe's flange.
        ring_bore_d, ring_bore_top_d, ring_thickness: of the clamp ring; its rim is `body_d`.
        ring_screw_length: a stock length under the head.
        nut_pocket_af, nut_pocket_top: hexagon open at the plate's underside.
        on_flange, on_wall, on_ring: engravings of the flange's lip (base frame), of the wall around the recess (sensor
            frame) and of the ring's top (its own frame).
    """

    tool: ScrewPattern
    floor: float
    foot_d: float
    foot_height: float
    body_d: float
    body_top: float
    recess_d: float
    mark_x: float
    dowel_d: float
    dowel_depth: float
    p_dowels: tuple[XY, ...]
    peg_top: float
    peg_x: float
    peg_hole_d: float
    flange: Flange
    ring_bore_d: float
    ring_bore_top_d: float
    ring_thickness: float
    ring_screw_length: float
    nut_pocket_af: float
    nut_pocket_top: float
    on_flange: Engraving
    on_wall: Engraving
    on_ring: Engraving

    @property
    def T_sensor_base(self) -> Array:
        """Return the pose of the base frame in the sensor frame, (4, 4): along the axis, x axes parallel."""
        return pose(p=[0.0, 0.0, self.floor + self.flange.thickness])

    @property
    def p_tool_screws(self) -> tuple[XY, ...]:
        """Return (x, y) of the screws into the sensor [m]."""
        return on_circle(self.tool.bolt_circle_d, self.tool.azimuths_deg)

    @property
    def p_ring_screws(self) -> tuple[XY, ...]:
        """Return (x, y) of the ring's screws [m]."""
        return on_circle(self.body_d - 2 * RIM_OUT, RING_AZIMUTHS_DEG)

    @property
    def ring_top(self) -> float:
        """Return z of the face under the heads of the ring's screws, the lip uncompressed [m]."""
        return self.floor + self.flange.thickness + self.ring_thickness


def on_circle(diameter: float, azimuths_deg: Iterable[float]) -> tuple[XY, ...]:
    """Return points on a circle about the origin; diameter [m], azimuths [deg]."""
    angles = np.radians(list(azimuths_deg))
    return tuple((float(diameter / 2 * np.cos(a)), float(diameter / 2 * np.sin(a))) for a in angles)


def sensor_adapter_for(geometry: ProbeGeometry, sensor: SensorModel, name: str = "") -> SensorAdapter:
    """Return the adapter that mounts a probe on a sensor.

    Args:
        geometry: of the probe.
        sensor: whose tool side it screws to.
        name: of the design, engraved after the geometry's fingerprint as far as it fits.

    Raises:
        InputError: the probe is too wide above its base for any ring that could still clamp the flange.
    """
    flange = geometry.flange
    floor = M2_GRIP + M2.head_height + HEAD_SUNK
    body_top = floor + flange.thickness - SQUEEZE
    seated_top = body_top + RING_THICKNESS
    ring_screw = max(n * MM for n in M2.stock_mm if seated_top - n * MM >= FOOT_HEIGHT)
    bore_d = _ring_bore_d(geometry)
    rim_d = flange.diameter + 2 * (RING_SCREW_OUT + RIM_OUT)
    head_clear_d = rim_d - 2 * RIM_OUT - M2_COUNTERBORE_D  # the heads need a seat beside the bore
    peg_x, peg_hole_d = (flange.diameter - FLANGE_LIP) / 2 - PEG_INWARD, PEG_D + 0.1 * MM
    letters = flange.diameter / 2 + RING_SCREW_OUT + LETTERS_OUT

    def engraved(radius: float, top: float, azimuths_deg: Iterable[float], hole_d: float) -> Engraving:
        arcs = free_arcs(radius, [float(a) for a in np.radians(list(azimuths_deg))], hole_d / 2 + LETTER_EDGE)
        return engrave(geometry.fingerprint, name, radius, top, arcs)

    return SensorAdapter(
        tool=sensor.tool,
        floor=floor,
        foot_d=sensor.body_d,
        foot_height=FOOT_HEIGHT,
        body_d=rim_d,
        body_top=body_top,
        recess_d=flange.diameter + SLIP,
        mark_x=rim_d / 2 - MARK_FLAT,
        dowel_d=sensor.dowel_d + 0.1 * MM,  # prints undersize by as much: a press or slip fit
        dowel_depth=DOWEL_PIN_LENGTH - sensor.dowel_depth + 0.2 * MM,
        p_dowels=on_circle(sensor.tool.bolt_circle_d, sensor.dowel_azimuths_deg),
        peg_top=floor + flange.thickness - 0.5 * MM,  # stays below the pressed lip
        peg_x=peg_x,
        peg_hole_d=peg_hole_d,
        flange=flange,
        ring_bore_d=bore_d,
        ring_bore_top_d=min(bore_d + 2 * RING_THICKNESS, head_clear_d),
        ring_thickness=RING_THICKNESS,
        ring_screw_length=ring_screw,
        nut_pocket_af=M2_NUT_AF + SLIP,
        nut_pocket_top=seated_top - ring_screw + NUT_PROTRUSION + M2_NUT_HEIGHT,
        on_flange=engraved(peg_x, 0.0, (0.0,), peg_hole_d),
        on_wall=engraved(letters, body_top, RING_AZIMUTHS_DEG, M2_CLEARANCE_D),
        on_ring=engraved(letters, RING_THICKNESS, RING_AZIMUTHS_DEG, M2.head_d),
    )


def _ring_bore_d(geometry: ProbeGeometry) -> float:
    """Return the narrowest diameter of the ring's bore [m]: the ring passes over the tip and the widest section."""
    bore_d = 2.0 * (float(geometry.radius.max()) + RING_CLEARANCE)
    max_d = max_ring_passage_d(geometry.flange)
    if bore_d - 2 * RING_CLEARANCE > max_d:
        raise InputError(
            f"probe.profile_mm: {(bore_d - 2 * RING_CLEARANCE) / MM:g} mm at its widest, "
            f"so the clamp ring cannot pass; at most {max_d / MM:g} mm "
            f"with a base of {2 * geometry.base_radius / MM:g} mm"
        )
    return bore_d


def max_ring_passage_d(flange: Flange) -> float:
    """Return the largest probe diameter over which a ring passes that still clamps the flange [m]."""
    return flange.diameter - 2 * MIN_LIP - 2 * RING_CLEARANCE


def exported_root_radii(geometry: ProbeGeometry) -> float:
    """Return `root_rigid_radii` of a probe whose soft flange the exported ring clamps; negative, since it yields.

    -0.428 exp(-0.44 r₀/h) with h the flange's thickness: computed, not measured. Linear finite elements of full round
    bases Ø3 ... 25 mm at ν = 0.49, the lip fixed on both sides, the centre supported by the adapter without friction;
    the fit is within 0.003 of them; the assumptions leave an uncertainty of about 0.05 (docs/decisions/0006).

    Args:
        geometry: of the probe; bores and elliptic sections were not computed.
    """
    return -0.428 * math.exp(-0.44 * geometry.base_radius / geometry.flange.thickness)
