"""Dimensions of the flange adapter: the rigid plate between the sensor's mounting side and the robot's flange.

Its frame is the robot flange's: origin at the centre of the robot's face, z out of the robot, x through the dowel. The
sensor is turned so that its cable leaves midway between two robot bolts. The plate prints upside down: its flat top,
the sensor's seat, lies on the platform, and the robot's face with its spigot is on top.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from probedesign.core.errors import InputError
from probedesign.core.frames import Array, pose, rotation_z
from probedesign.core.units import MM
from probedesign.design.catalog import CUSTOM, PRINT_TOLERANCE, ROBOT_FLANGES, RobotFlange
from probedesign.design.sensors import ScrewPattern, SensorModel
from probedesign.geometry import fingerprint_of
from probedesign.mount.engraving import HEIGHT, NOTHING_CUT, XY, Engraving, engrave, free_arcs
from probedesign.mount.sensor_adapter import FACE_LOSS, PRINTED_PIN_PLAY, SETTLING, length_tolerance, on_circle

#: Depth of the pocket below the cable's exit, and 0.6 mm of it on every side: more than the 0.5 mm that are checked.
CABLE_ROOM = 1.0 * MM
CABLE_SIDE = 0.6 * MM
#: Azimuths of the pins that centre the sensor's body, from the cable: between screws of the Nano17, clear of the
#: cable's sector, and on all sides of the body.
CENTRING_DEG = (35.0, 125.0, 245.0)
SENSOR_BODY_TOLERANCE = 0.05 * MM  #: Tolerance ± of the diameter of the sensor's body (assumed).
#: Stock pins, ISO 2338; their length above the plate stays far below the sensor's split line.
CENTRING_PIN_D, CENTRING_PIN_LENGTH, CENTRING_ABOVE = 2.0 * MM, 6.0 * MM, 2.5 * MM
TIE_SLOT = (1.6 * MM, 3.2 * MM)  #: Radial and tangential width of a slot for a cable tie of 2.5 mm.
TIE_APART = 7.0 * MM  #: Distance between the middles of the two slots, across the cable.
EDGE = 1.8 * MM  # wall outside the pin slot
MAX_SPIGOT_HEIGHT = 10.0 * MM  #: Deepest recess of any robot flange; ISO 9409-1 has 4 to 6 mm (assumed).
PLATE_LETTER_EDGE = 0.2 * MM  # from the characters to the pad and to the bolts' heads
_NANO = 1e-9  # tolerance for round-off of sums [m]
HEAD_EDGE = 1.5 * MM  # plate outside a bolt's head


@dataclass(frozen=True)
class FlangeAdapter:
    """Dimensions of the plate, in the robot flange's frame [m]."""

    robot: RobotFlange  #: the flange pattern.
    mounting: ScrewPattern  #: the threaded holes in the sensor's mounting face.
    plate_d: float  #: plate_d, plate_top: the plate from the robot's face to `plate_top`.
    plate_top: float
    cable_deg: float  #: azimuth of the cable.
    #: ranges of radius, of the distance across and of z, of the pocket below the cable's exit.
    cable_pocket: tuple[XY, XY, XY]
    #: p_centring_pins, centring_hole: pins around the sensor's body, none where bolts leave no room; diameter of their
    #: blind holes and z of the bottom, on which they stand.
    p_centring_pins: tuple[XY, ...]
    centring_hole: XY
    #: body_d, free_height: diameter of the sensor's body, and height up to which pins may stand beside it.
    body_d: float
    free_height: float
    p_tie_slots: tuple[XY, ...]  #: (x, y) of the slots for the cable tie.
    #: p_mounting_screws, p_bolts: (x, y) of the screws into the sensor and into the robot.
    p_mounting_screws: tuple[XY, ...]
    p_bolts: tuple[XY, ...]
    T_sensor_robotflange: Array  #: pose of this frame in the sensor frame, (4, 4).
    on_plate: Engraving = NOTHING_CUT  #: engraving around the pad; empty where it does not fit between pad and bolts.

    @property
    def fingerprint(self) -> str:
        """Return the fingerprint of the plate, of all its dimensions."""
        points = (*self.p_centring_pins, *self.p_tie_slots, *self.p_mounting_screws, *self.p_bolts, *self.cable_pocket)
        return fingerprint_of([
            self.plate_d, self.plate_top, self.counterbore_top, self.cable_deg * MM, *self.centring_hole,
            self.mounting.screw.clearance_d, self.mounting.screw.counterbore_d, self.robot.screw.clearance_d,
            *self.robot.spigot, *self.robot.pin_slot, *(x for p in points for x in p),
        ])  # fmt: skip

    @property
    def counterbore_top(self) -> float:
        """Return z of the seat of the sensor's mounting screws, whose heads lie below it [m]."""
        return self.plate_top - self.mounting.grip


def bolt_margin(robot: RobotFlange, length: float) -> float:
    """Return the margin [m] to the deepest allowed entry of a robot bolt: tolerances of bolt and plate, and a head that
    settles."""
    return robot.screw.length_tolerance(length) + PRINT_TOLERANCE + FACE_LOSS + SETTLING


def T_sensor_robotflange(sensor: SensorModel, robot: RobotFlange) -> Array:
    """Return the pose of the robot flange's frame in the sensor frame, (4, 4)."""
    turn = rotation_z(np.radians(_dowel_deg(sensor, robot)))
    return pose(turn, [0.0, 0.0, -sensor.interface.height - _plate_top(robot)])


def _dowel_deg(sensor: SensorModel, robot: RobotFlange) -> float:
    """Return the azimuth of the robot's dowel in the sensor frame: the cable bisects the first two bolts."""
    return sensor.interface.cable.azimuth_deg - (robot.bolt_azimuths_deg[0] + robot.bolt_azimuths_deg[1]) / 2


def _plate_top(robot: RobotFlange) -> float:
    return robot.bolt_length - (robot.max_bolt_entry - bolt_margin(robot, robot.bolt_length))


def flange_adapter_for(sensor: SensorModel, robot: RobotFlange, name: str = "") -> FlangeAdapter:
    """Return the plate for a sensor and a robot, with its fingerprint and the name engraved.

    Raises:
        InputError: the robot's flange leaves too little room.
    """
    problem = _no_room(sensor, robot)
    if problem and robot.name == CUSTOM:
        raise InputError(f"mount.flange.{problem}")
    if problem:
        others = ", ".join(fitting_flanges(sensor)) or "none that is known"
        raise InputError(
            f"mount.robot_flange = {robot.name!r} does not fit the sensor {sensor.name}: {problem}. What fits: "
            f"{others}; describe another one in [mount.flange], with robot_flange = {CUSTOM!r}"
        )
    interface, mounting = sensor.interface, sensor.interface.mounting
    cable, plate_top = interface.cable, _plate_top(robot)
    dowel_deg = _dowel_deg(sensor, robot)
    cable_deg = cable.azimuth_deg - dowel_deg
    reach, body_r = robot.bolt_circle_d / 2, interface.body_d / 2
    # The body passes between its pins, which enclose up to 2 % more, at every corner of the tolerances.
    play = (length_tolerance(1.02 * interface.body_d) + PRINTED_PIN_PLAY + SENSOR_BODY_TOLERANCE) / 2
    pins_r = body_r + play + CENTRING_PIN_D / 2
    room = pins_r + CENTRING_PIN_D / 2 + 0.3 * MM < reach - robot.screw.head_d / 2
    pins = on_circle(2 * pins_r, (cable_deg + a for a in CENTRING_DEG)) if room else ()
    pocket = (
        (body_r - CABLE_SIDE, max(cable.reach, body_r) + CABLE_SIDE),
        (-cable.width / 2 - CABLE_SIDE, cable.width / 2 + CABLE_SIDE),
        (plate_top - CABLE_ROOM, plate_top),
    )
    rim = max(
        robot.face_d / 2,
        reach + robot.screw.head_d / 2 + HEAD_EDGE,
        float(np.hypot(reach + robot.pin_slot[1] / 2, robot.pin_slot[0] / 2)) + EDGE,
    )
    tie_r, half = rim - EDGE - TIE_SLOT[0] / 2 - 0.5 * MM, TIE_APART / 2
    c, s = math.cos(math.radians(cable_deg)), math.sin(math.radians(cable_deg))
    plain = FlangeAdapter(
        robot=robot,
        mounting=mounting,
        plate_d=2 * rim,
        plate_top=plate_top,
        cable_deg=cable_deg,
        cable_pocket=pocket,
        p_centring_pins=pins,
        centring_hole=(CENTRING_PIN_D + PRINTED_PIN_PLAY, plate_top - (CENTRING_PIN_LENGTH - CENTRING_ABOVE)),
        body_d=interface.body_d,
        free_height=interface.cable.free_height,
        p_tie_slots=tuple((tie_r * c - side * s, tie_r * s + side * c) for side in (-half, half)),
        p_mounting_screws=on_circle(mounting.bolt_circle_d, (a - dowel_deg for a in mounting.azimuths_deg)),
        p_bolts=on_circle(robot.bolt_circle_d, robot.bolt_azimuths_deg),
        T_sensor_robotflange=T_sensor_robotflange(sensor, robot),
    )
    around = (body_r, pins, pocket, cable_deg)
    return replace(plain, on_plate=_engraving(robot, plain.fingerprint, name, plate_top, around))


def fitting_flanges(sensor: SensorModel) -> list[str]:
    """Return the names of the known robot flanges that leave room for a sensor, the usual one first."""
    return [name for name, robot in ROBOT_FLANGES.items() if not _no_room(sensor, robot)]


def _no_room(sensor: SensorModel, robot: RobotFlange) -> str:
    """Return why a robot flange leaves no room: key, value and the nearest allowed value; empty if it does."""
    bolt, body_r, mounting = robot.screw, sensor.interface.body_d / 2, sensor.interface.mounting
    reach, head = robot.bolt_circle_d / 2, bolt.head_d / 2
    circle = 2 * (body_r + head + 0.5 * MM)
    margin = bolt_margin(robot, robot.bolt_length)
    entry = 0.8 * bolt.nominal_d + margin
    thinnest = robot.max_bolt_entry - margin + mounting.grip
    stock = [n for n in bolt.stock_mm if n * MM >= thinnest]
    spigot = mounting.bolt_circle_d + mounting.screw.counterbore_d + 1.0 * MM
    azimuths = robot.bolt_azimuths_deg
    cable = 2 * (sensor.interface.cable.half_width_deg + float(np.degrees(np.arcsin(min(1.0, head / reach)))))
    between_first = (azimuths[1] - azimuths[0]) % 360.0
    p = np.array(on_circle(robot.bolt_circle_d, azimuths))
    apart = np.linalg.norm(p[:, None] - p[None], axis=2) + 1.0 * np.eye(len(p))
    on_slot = np.hypot(np.maximum(np.abs(p[:, 0] - reach) - robot.pin_slot[1] / 2, 0.0), p[:, 1])
    slot_clear = robot.pin_slot[0] / 2 + bolt.clearance_d / 2 + 1.0 * MM
    longest = max(bolt.stock_mm) * MM - mounting.grip + bolt_margin(robot, max(bolt.stock_mm) * MM)
    widest = 2 * (reach - max(bolt.clearance_d, robot.pin_slot[1]) / 2) - 1.0 * MM
    slot = 2 * (reach - body_r - 0.5 * MM)
    given, mm = ", ".join(f"{a:g}" for a in azimuths), float(apart.min()) / MM
    for wrong, key, value, allowed in (
        (robot.bolt_circle_d < circle, "bolt_circle_d_mm", f"{robot.bolt_circle_d / MM:g}",
         f"at least {circle / MM:g} mm, or heads touch the sensor"),
        (robot.face_d < robot.bolt_circle_d + bolt.nominal_d, "face_d_mm", f"{robot.face_d / MM:g}",
         f"at least {(robot.bolt_circle_d + bolt.nominal_d) / MM:g} mm, or the threads lie outside of the face"),
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
            return f"{key} = {value} leaves no room; {allowed}"
    return ""


def _engraving(
    robot: RobotFlange, fingerprint: str, name: str, top: float,
    around: tuple[float, tuple[XY, ...], tuple[XY, XY, XY], float],
) -> Engraving:  # fmt: skip
    inner, pins, (reach, across, _), cable_deg = around
    outer = robot.bolt_circle_d / 2 - max(robot.screw.head_d, robot.pin_slot[1]) / 2
    radius = (inner + outer) / 2
    if outer - inner < HEIGHT + 2 * PLATE_LETTER_EDGE:
        fingerprint = name = ""
    below = radius - HEIGHT / 2 - PLATE_LETTER_EDGE
    obstacles = {0.0: 1.0 * MM}
    if below < reach[1]:
        obstacles[math.radians(cable_deg)] = across[1] + PLATE_LETTER_EDGE
    if pins and below < math.hypot(*pins[0]) + CENTRING_PIN_D / 2:
        obstacles |= {math.atan2(y, x): CENTRING_PIN_D / 2 + 0.3 * MM for x, y in pins}
    arcs = free_arcs(radius, list(obstacles), list(obstacles.values()))
    return engrave(fingerprint, name, radius, top, arcs)
