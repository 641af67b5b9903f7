"""Dimensions of the adapters: between probe and sensor, and between sensor and robot.

Sensor adapter, from bottom to top in the sensor frame: foot on the tool face; floor with countersunk screws into the
sensor; recess with the probe's flange, clocked by a peg at +X; clamp ring on the flange's lip; M2 screws into nuts
outside.

Flange adapter: the rigid plate between the sensor's mounting side and the robot's flange. Its frame is the robot
flange's: origin at the centre of the robot's face, z out of the robot, x through the dowel. The sensor is turned so
that its cable leaves midway between two robot bolts.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from probedesign.core.errors import InputError
from probedesign.core.frames import Array, pose, rotation_z
from probedesign.core.units import MM
from probedesign.design.catalog import M2, M2_NUT_AF, M2_NUT_HEIGHT, RobotFlange
from probedesign.design.sensors import DowelPattern, ScrewPattern, SensorModel
from probedesign.geometry import FLANGE_LIP, Flange, ProbeGeometry
from probedesign.mount.engraving import HEIGHT, XY, Engraving, engrave, free_arcs

HEAD_SUNK = 0.2 * MM
"""A head lies this far below the face, so that it cannot dent the part that rests on it."""
NUT_PROTRUSION = 0.4 * MM  # one pitch of M2 beyond the nut
FOOT_HEIGHT = 1.0 * MM
"""Height of the wide plate above the tool face: clearance to the sensor's body and its cable."""
SLIP = 0.2 * MM  # on the diameter, rigid resin (assumed)
SQUEEZE = 0.2 * MM
"""Compression of the flange's lip when the ring rests on the wall; the lip is drawn uncompressed."""
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
        tool, dowels: the holes in the sensor's tool face.
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
    dowels: DowelPattern
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
    tool, dowels = sensor.interface.tool, sensor.interface.dowels
    floor = tool.grip + tool.screw.head_height + HEAD_SUNK
    body_top = floor + flange.thickness - SQUEEZE
    seated_top = body_top + RING_THICKNESS
    ring_screw = max(n * MM for n in M2.stock_mm if seated_top - n * MM >= FOOT_HEIGHT)
    bore_d = _ring_bore_d(geometry)
    rim_d = flange.diameter + 2 * (RING_SCREW_OUT + RIM_OUT)
    head_clear_d = rim_d - 2 * RIM_OUT - M2.counterbore_d  # the heads need a seat beside the bore
    peg_x, peg_hole_d = (flange.diameter - FLANGE_LIP) / 2 - PEG_INWARD, PEG_D + 0.1 * MM
    letters = flange.diameter / 2 + RING_SCREW_OUT + LETTERS_OUT

    def engraved(radius: float, top: float, azimuths_deg: Iterable[float], hole_d: float) -> Engraving:
        arcs = free_arcs(radius, [float(a) for a in np.radians(list(azimuths_deg))], hole_d / 2 + LETTER_EDGE)
        return engrave(geometry.fingerprint, name, radius, top, arcs)

    return SensorAdapter(
        tool=tool,
        dowels=dowels,
        floor=floor,
        foot_d=tool.face_d,
        foot_height=FOOT_HEIGHT,
        body_d=rim_d,
        body_top=body_top,
        recess_d=flange.diameter + SLIP,
        mark_x=rim_d / 2 - MARK_FLAT,
        dowel_d=dowels.diameter + 0.1 * MM,  # prints undersize by as much: a press or slip fit
        dowel_depth=dowels.pin_length - dowels.depth + 0.2 * MM,
        p_dowels=on_circle(dowels.circle_d, dowels.azimuths_deg),
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
        on_wall=engraved(letters, body_top, RING_AZIMUTHS_DEG, M2.clearance_d),
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


ENTRY_MARGIN = 0.5 * MM
"""Margin of the robot bolts to the deepest allowed entry, in case the plate prints thin."""
PAD_HEIGHT = 1.0 * MM
"""Height of the pad under the sensor, so that its cable clears the plate."""
PAD_EDGE = 0.42 * MM
"""Inset of the pad from the sensor's rim: 0.51 mm of clearance to the cable, which leaves 0.3 mm above it, and
0.63 mm of wall outside the screws."""
EDGE = 1.8 * MM  # wall outside the pin slot
MAX_SPIGOT_HEIGHT = 10.0 * MM
"""Deepest recess of any robot flange; ISO 9409-1 has 4 to 6 mm (assumed)."""
PLATE_LETTER_EDGE = 0.2 * MM  # from the characters to the pad and to the bolts' heads
_NANO = 1e-9  # tolerance for round-off of sums [m]
HEAD_EDGE = 1.5 * MM  # plate outside a bolt's head


@dataclass(frozen=True)
class FlangeAdapter:
    """Dimensions of the plate, in the robot flange's frame [m].

    Attributes:
        robot: the flange pattern.
        mounting: the threaded holes in the sensor's mounting face.
        plate_d, plate_top: the plate from the robot's face to `plate_top`.
        pad_d, pad_top: seat of the sensor.
        p_mounting_screws, p_bolts: (x, y) of the screws into the sensor and into the robot.
        on_plate: engraving around the pad; empty where it does not fit between pad and bolts.
        T_sensor_robotflange: pose of this frame in the sensor frame, (4, 4).
    """

    robot: RobotFlange
    mounting: ScrewPattern
    plate_d: float
    plate_top: float
    pad_d: float
    pad_top: float
    p_mounting_screws: tuple[XY, ...]
    p_bolts: tuple[XY, ...]
    on_plate: Engraving
    T_sensor_robotflange: Array

    @property
    def counterbore_top(self) -> float:
        """Return z of the seat of the sensor's mounting screws, whose heads lie below it [m]."""
        return self.pad_top - self.mounting.grip


def flange_adapter_for(
    sensor: SensorModel, robot: RobotFlange, fingerprint: str = "", name: str = ""
) -> FlangeAdapter:
    """Return the plate for a sensor and a robot, engraved with a geometry's fingerprint and a design's name."""
    _check_room(sensor, robot)
    interface, mounting = sensor.interface, sensor.interface.mounting
    plate_top = robot.bolt_length - (robot.max_bolt_entry - ENTRY_MARGIN)
    pad_top = plate_top + PAD_HEIGHT
    # The cable bisects the first two bolts; the dowel's azimuth in the sensor frame follows.
    dowel_deg = interface.cable.azimuth_deg - (robot.bolt_azimuths_deg[0] + robot.bolt_azimuths_deg[1]) / 2
    reach = robot.bolt_circle_d / 2
    rim = max(
        robot.face_d / 2,
        reach + robot.screw.head_d / 2 + HEAD_EDGE,
        float(np.hypot(reach + robot.pin_slot[1] / 2, robot.pin_slot[0] / 2)) + EDGE,
    )
    return FlangeAdapter(
        robot=robot,
        mounting=mounting,
        plate_d=2 * rim,
        plate_top=plate_top,
        pad_d=mounting.face_d - 2 * PAD_EDGE,
        pad_top=pad_top,
        p_mounting_screws=on_circle(mounting.bolt_circle_d, (a - dowel_deg for a in mounting.azimuths_deg)),
        p_bolts=on_circle(robot.bolt_circle_d, robot.bolt_azimuths_deg),
        on_plate=_engraving(sensor, robot, fingerprint, name, plate_top),
        T_sensor_robotflange=pose(rotation_z(np.radians(dowel_deg)), [0.0, 0.0, -interface.height - pad_top]),
    )


def _check_room(sensor: SensorModel, robot: RobotFlange) -> None:
    """Refuse a bolt pattern that leaves too little space for the sensor, the screws or the cable.

    Raises:
        InputError: names the design file's key, its value and the nearest allowed value.
    """
    bolt, body_r, mounting = robot.screw, sensor.interface.body_d / 2, sensor.interface.mounting
    reach, head = robot.bolt_circle_d / 2, bolt.head_d / 2
    circle = 2 * (body_r + head + 0.5 * MM)
    entry = 0.8 * bolt.nominal_d + ENTRY_MARGIN
    thinnest = robot.max_bolt_entry - ENTRY_MARGIN + mounting.grip
    stock = [n for n in bolt.stock_mm if n * MM >= thinnest]
    spigot = mounting.bolt_circle_d + mounting.screw.counterbore_d + 1.0 * MM
    azimuths = robot.bolt_azimuths_deg
    cable = 2 * (sensor.interface.cable.half_width_deg + float(np.degrees(np.arcsin(min(1.0, head / reach)))))
    between_first = (azimuths[1] - azimuths[0]) % 360.0
    p = np.array(on_circle(robot.bolt_circle_d, azimuths))
    apart = np.linalg.norm(p[:, None] - p[None], axis=2) + 1.0 * np.eye(len(p))
    on_slot = np.hypot(np.maximum(np.abs(p[:, 0] - reach) - robot.pin_slot[1] / 2, 0.0), p[:, 1])
    slot_clear = robot.pin_slot[0] / 2 + bolt.clearance_d / 2 + 1.0 * MM
    longest = max(bolt.stock_mm) * MM - mounting.grip + ENTRY_MARGIN
    widest = 2 * (reach - max(bolt.clearance_d, robot.pin_slot[1]) / 2) - 1.0 * MM
    slot = 2 * (reach - body_r - 0.5 * MM)
    given, mm = ", ".join(f"{a:g}" for a in azimuths), float(apart.min()) / MM
    for wrong, key, value, allowed in (
        (robot.bolt_circle_d < circle, "bolt_circle_d_mm", f"{robot.bolt_circle_d / MM:g}",
         f"at least {circle / MM:g} mm, or heads touch the sensor"),
        (robot.max_bolt_entry < entry - _NANO, "max_bolt_entry_mm", f"{robot.max_bolt_entry / MM:g}",
         f"at least {entry / MM:g} mm, or the thread is too short"),
        (robot.max_bolt_entry > longest + _NANO, "max_bolt_entry_mm", f"{robot.max_bolt_entry / MM:g}",
         f"at most {longest / MM:g} mm, or no stock {robot.bolt} is long enough"),
        (not any(abs(robot.bolt_length - n * MM) < _NANO for n in stock), "bolt_length_mm",
         f"{robot.bolt_length / MM:g}", f"of {robot.bolt} these will do: {', '.join(map(str, stock))} mm"),
        (0.0 < robot.spigot[0] < spigot, "spigot_mm", f"{robot.spigot[0] / MM:g}",
         f"at least {spigot / MM:g} mm, or none"),
        (robot.spigot[0] > widest, "spigot_mm", f"{robot.spigot[0] / MM:g}",
         f"at most {widest / MM:g} mm, or it meets bolts or pin"),
        (robot.spigot[1] > MAX_SPIGOT_HEIGHT, "spigot_mm", f"{robot.spigot[1] / MM:g}",
         f"at most {MAX_SPIGOT_HEIGHT / MM:g} mm high"),
        (robot.pin_slot[1] > slot, "pin_slot_mm", f"{robot.pin_slot[1] / MM:g}",
         f"at most {slot / MM:g} mm long, or it meets the sensor's pad"),
        (not cable <= between_first <= 360.0 - cable, "bolt_azimuths_deg", given,
         f"the first two at least {np.ceil(cable):g}° apart: the cable leaves between"),
        (float(apart.min()) < bolt.head_d, "bolt_azimuths_deg", given,
         f"heads {mm:.3g} mm apart, at least {bolt.head_d / MM:g} mm"),
        (robot.pin_slot[0] > 0.0 and float(on_slot.min()) < slot_clear, "bolt_azimuths_deg", given,
         f"a bolt {float(on_slot.min()) / MM:.3g} mm from the pin's slot, at least {slot_clear / MM:g} mm"),
    ):  # fmt: skip
        if wrong:
            raise InputError(f"mount.flange.{key} = {value} leaves no room; {allowed}")


def _engraving(sensor: SensorModel, robot: RobotFlange, fingerprint: str, name: str, top: float) -> Engraving:
    """Return the engraving around the pad, starting at the dowel."""
    inner = sensor.interface.body_d / 2
    outer = robot.bolt_circle_d / 2 - max(robot.screw.head_d, robot.pin_slot[1]) / 2
    radius = (inner + outer) / 2
    if outer - inner < HEIGHT + 2 * PLATE_LETTER_EDGE:
        fingerprint = name = ""
    return engrave(fingerprint, name, radius, top, free_arcs(radius, (0.0,), 1.0 * MM))
