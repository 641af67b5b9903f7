"""Every dimension of the sensor adapter and its clamp ring, from the probe's geometry and the sensor.

Sensor frame, bottom to top: foot on the tool face, floor with three sunk M2 screws, flange of the probe
in a recess (clocked by a peg at +X), clamp ring on the flange's lip, four M2 screws into nuts outside.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from probedesign.errors import InputError
from probedesign.frames import Array, pose
from probedesign.geometry import FLANGE_LIP, Flange, ProbeGeometry
from probedesign.mounting.engraving import Engraving, between, engrave
from probedesign.mounting.fasteners import (
    HEAD_SUNK,
    M2,
    M2_CLEARANCE_D,
    M2_COUNTERBORE_D,
    M2_GRIP,
    M2_NUT_AF,
    M2_NUT_HEIGHT,
    NUT_PROTRUSION,
)
from probedesign.mounting.prism import Point
from probedesign.sensor import ScrewPattern, SensorModel
from probedesign.units import MM

FOOT_HEIGHT = 1.0 * MM
"""The wide plate starts that much above the tool face: air to the sensor's body and to its cable."""
SLIP = 0.2 * MM  # on the diameter, rigid resin (assumed)
SQUEEZE = 0.2 * MM
"""The ring stops hard on the wall after pressing the lip by this much (drawn unpressed)."""
DOWEL_PIN_LENGTH = 6.0 * MM
PEG_D = 1.9 * MM
RING_THICKNESS = 2.5 * MM
RING_AIR = 0.5 * MM
"""Between the ring's bore and the probe at s = 0; the bore then widens by 45°, so that bending finds air."""
MIN_LIP = 1.5 * MM
RING_AZIMUTHS_DEG = (45.0, 135.0, 225.0, 315.0)
RING_SCREW_OUT = 2.3 * MM
"""From the flange's rim out to the ring's screws: half a slip, 1.0 mm of wall, half a clearance hole."""
RIM_OUT = 3.1 * MM
"""From the ring's screws out to the rim: half a nut pocket and 1.0 mm of wall."""
LETTER_EDGE = 0.8 * MM
"""From a hole, or from the seat of a head, to the nearest character."""
LETTERS_OUT = 0.3 * MM
"""From the ring's screws out to the middle of the characters between them: midway between recess and flat."""
PEG_INWARD = 0.05 * MM
"""From the middle of the lip: outside its hole the soft lip keeps 0.8 mm, twice what a wall needs (assumed), and the
ring presses all around it."""
MARK_FLAT = 0.8 * MM
"""Depth of the flat on the adapter's rim that shows +X from outside."""


@dataclass(frozen=True)
class SensorAdapter:
    """Dimensions of the adapter on the tool side, in the sensor frame [m].

    Attributes:
        tool: the sensor's screw holes.
        floor: tool face to the flange's underside.
        foot_d, foot_height: what rests on the tool face.
        body_d, body_top: the plate from `foot_height` to `body_top`.
        recess_d: takes the flange, from `floor` up.
        mark_x: distance of the +X flat from the axis.
        dowel_d, dowel_depth, p_dowels: blind holes from below for the sensor's dowel pins.
        peg_top, peg_x: the clocking peg on the floor, at y = 0.
        peg_hole_d: in the flange.
        flange: of the probe.
        ring_bore_d, ring_bore_top_d, ring_thickness: of the clamp ring; its rim is `body_d`.
        ring_screw_length: stock length.
        nut_pocket_af, nut_pocket_top: hexagon open at the plate's underside.
        on_flange, on_wall, on_ring: what is engraved on the flange's lip (base frame), on the wall around the recess
            (sensor frame) and on the ring's top (its own frame).
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
    p_dowels: tuple[Point, ...]
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
        """Pose of the base frame in the sensor frame, (4, 4): straight up, x stays x."""
        return pose(p=[0.0, 0.0, self.floor + self.flange.thickness])

    @property
    def p_tool_screws(self) -> tuple[Point, ...]:
        """(x, y) of the screws into the sensor [m]."""
        return on_circle(self.tool.bolt_circle_d, self.tool.azimuths_deg)

    @property
    def p_ring_screws(self) -> tuple[Point, ...]:
        """(x, y) of the ring's screws [m]."""
        return on_circle(self.body_d - 2 * RIM_OUT, RING_AZIMUTHS_DEG)

    @property
    def ring_top(self) -> float:
        """Where the heads of the ring's screws rest, the lip unpressed [m]."""
        return self.floor + self.flange.thickness + self.ring_thickness


def on_circle(diameter: float, azimuths_deg: Iterable[float]) -> tuple[Point, ...]:
    """Points on a circle about the origin; diameter [m], azimuths [deg]."""
    angles = np.radians(list(azimuths_deg))
    return tuple((float(diameter / 2 * np.cos(a)), float(diameter / 2 * np.sin(a))) for a in angles)


def sensor_adapter_for(geometry: ProbeGeometry, sensor: SensorModel, name: str = "") -> SensorAdapter:
    """The adapter that fixes a probe to a sensor.

    Args:
        geometry: of the probe.
        sensor: whose tool side it screws to.
        name: of the design, engraved after the geometry's fingerprint as far as there is room.

    Raises:
        InputError: the probe is so much wider further up that no ring over it could hold the flange.
    """
    flange = geometry.flange
    floor = M2_GRIP + M2.head_height + HEAD_SUNK
    body_top = floor + flange.thickness - SQUEEZE
    seated_top = body_top + RING_THICKNESS
    ring_screw = max(n * MM for n in M2.stock_mm if seated_top - n * MM >= FOOT_HEIGHT)
    bore_d = _ring_bore_d(geometry)
    rim_d = flange.diameter + 2 * (RING_SCREW_OUT + RIM_OUT)
    head_free_d = rim_d - 2 * RIM_OUT - M2_COUNTERBORE_D  # the bore must leave the heads their seat
    peg_x, peg_hole_d = (flange.diameter - FLANGE_LIP) / 2 - PEG_INWARD, PEG_D + 0.1 * MM
    letters = flange.diameter / 2 + RING_SCREW_OUT + LETTERS_OUT

    def engraved(radius: float, top: float, azimuths_deg: Iterable[float], hole_d: float) -> Engraving:
        arcs = between(radius, [float(a) for a in np.radians(list(azimuths_deg))], hole_d / 2 + LETTER_EDGE)
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
        ring_bore_top_d=min(bore_d + 2 * RING_THICKNESS, head_free_d),
        ring_thickness=RING_THICKNESS,
        ring_screw_length=ring_screw,
        nut_pocket_af=M2_NUT_AF + SLIP,
        nut_pocket_top=seated_top - ring_screw + NUT_PROTRUSION + M2_NUT_HEIGHT,
        on_flange=engraved(peg_x, 0.0, (0.0,), peg_hole_d),
        on_wall=engraved(letters, body_top, RING_AZIMUTHS_DEG, M2_CLEARANCE_D),
        on_ring=engraved(letters, RING_THICKNESS, RING_AZIMUTHS_DEG, M2.head_d),
    )


def _ring_bore_d(geometry: ProbeGeometry) -> float:
    """Narrowest diameter of the ring's bore [m]: the ring comes on over the tip, past the widest section."""
    bore_d = 2.0 * (float(geometry.radius.max()) + RING_AIR)
    most = widest_through_ring(geometry.flange)
    if bore_d - 2 * RING_AIR > most:
        raise InputError(
            f"probe.profile_mm: {(bore_d - 2 * RING_AIR) / MM:g} mm at its widest, "
            f"so the clamp ring cannot pass; at most {most / MM:g} mm "
            f"with a base of {2 * geometry.base_radius / MM:g} mm"
        )
    return bore_d


def widest_through_ring(flange: Flange) -> float:
    """Diameter of the widest section over which a clamp ring comes that still holds the flange [m]."""
    return flange.diameter - 2 * MIN_LIP - 2 * RING_AIR
