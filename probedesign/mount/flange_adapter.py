"""Dimensions of the rigid plate between the sensor's mounting side and the robot's flange.

Its frame is the robot flange's: origin at the centre of the robot's face, z out of the robot, x through the
dowel. The sensor is turned so that its cable leaves midway between two robot bolts.
"""

from dataclasses import dataclass

import numpy as np

from probedesign.core.errors import InputError
from probedesign.core.frames import Array, pose, rotation_z
from probedesign.core.units import MM
from probedesign.design.catalog.robot_flanges import RobotFlange
from probedesign.design.catalog.sensors import SensorModel
from probedesign.mount.engraving import HEIGHT, XY, Engraving, engrave, free_arcs
from probedesign.mount.fasteners import M2_COUNTERBORE_D, M2_GRIP, SCREWS
from probedesign.mount.sensor_adapter import on_circle

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
LETTER_EDGE = 0.2 * MM  # from the characters to the pad and to the bolts' heads
_NANO = 1e-9  # tolerance for round-off of sums [m]
HEAD_EDGE = 1.5 * MM  # plate outside a bolt's head


@dataclass(frozen=True)
class FlangeAdapter:
    """Dimensions of the plate, in the robot flange's frame [m].

    Attributes:
        robot: the flange pattern.
        plate_d, plate_top: the plate from the robot's face to `plate_top`.
        pad_d, pad_top: seat of the sensor.
        p_mounting_screws, p_bolts: (x, y) of the screws into the sensor and into the robot.
        on_plate: engraving around the pad; empty where it does not fit between pad and bolts.
        T_sensor_robotflange: pose of this frame in the sensor frame, (4, 4).
    """

    robot: RobotFlange
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
        return self.pad_top - M2_GRIP


def flange_adapter_for(
    sensor: SensorModel, robot: RobotFlange, fingerprint: str = "", name: str = ""
) -> FlangeAdapter:
    """Return the plate for a sensor and a robot, engraved with a geometry's fingerprint and a design's name."""
    _check_room(sensor, robot)
    plate_top = robot.bolt_length - (robot.max_bolt_entry - ENTRY_MARGIN)
    pad_top = plate_top + PAD_HEIGHT
    # The cable bisects the first two bolts; the dowel's azimuth in the sensor frame follows.
    dowel_deg = sensor.cable_azimuth_deg - (robot.bolt_azimuths_deg[0] + robot.bolt_azimuths_deg[1]) / 2
    reach = robot.bolt_circle_d / 2
    rim = max(
        robot.face_d / 2,
        reach + robot.bolt_head_d / 2 + HEAD_EDGE,
        float(np.hypot(reach + robot.pin_slot[1] / 2, robot.pin_slot[0] / 2)) + EDGE,
    )
    return FlangeAdapter(
        robot=robot,
        plate_d=2 * rim,
        plate_top=plate_top,
        pad_d=sensor.body_d - 2 * PAD_EDGE,
        pad_top=pad_top,
        p_mounting_screws=on_circle(
            sensor.mounting.bolt_circle_d, (a - dowel_deg for a in sensor.mounting.azimuths_deg)
        ),
        p_bolts=on_circle(robot.bolt_circle_d, robot.bolt_azimuths_deg),
        on_plate=_engraving(sensor, robot, fingerprint, name, plate_top),
        T_sensor_robotflange=pose(rotation_z(np.radians(dowel_deg)), [0.0, 0.0, -sensor.height - pad_top]),
    )


def _check_room(sensor: SensorModel, robot: RobotFlange) -> None:
    """Refuse a bolt pattern that leaves too little space for the sensor, the screws or the cable.

    Raises:
        InputError: names the design file's key, its value and the nearest allowed value.
    """
    reach, head = robot.bolt_circle_d / 2, robot.bolt_head_d / 2
    circle = 2 * (sensor.body_d / 2 + head + 0.5 * MM)
    entry = 0.8 * float(robot.bolt[1:]) * MM + ENTRY_MARGIN
    thinnest = robot.max_bolt_entry - ENTRY_MARGIN + M2_GRIP
    stock = [n for n in SCREWS[robot.bolt].stock_mm if n * MM >= thinnest]
    spigot = sensor.mounting.bolt_circle_d + M2_COUNTERBORE_D + 1.0 * MM
    azimuths = robot.bolt_azimuths_deg
    cable = 2 * (sensor.cable_half_width_deg + float(np.degrees(np.arcsin(min(1.0, head / reach)))))
    between_first = (azimuths[1] - azimuths[0]) % 360.0
    p = np.array(on_circle(robot.bolt_circle_d, azimuths))
    apart = np.linalg.norm(p[:, None] - p[None], axis=2) + 1.0 * np.eye(len(p))
    on_slot = np.hypot(np.maximum(np.abs(p[:, 0] - reach) - robot.pin_slot[1] / 2, 0.0), p[:, 1])
    slot_clear = robot.pin_slot[0] / 2 + robot.bolt_clearance_d / 2 + 1.0 * MM
    longest = max(SCREWS[robot.bolt].stock_mm) * MM - M2_GRIP + ENTRY_MARGIN
    widest = 2 * (reach - max(robot.bolt_clearance_d, robot.pin_slot[1]) / 2) - 1.0 * MM
    slot = 2 * (reach - sensor.body_d / 2 - 0.5 * MM)
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
        (float(apart.min()) < robot.bolt_head_d, "bolt_azimuths_deg", given,
         f"heads {mm:.3g} mm apart, at least {robot.bolt_head_d / MM:g} mm"),
        (robot.pin_slot[0] > 0.0 and float(on_slot.min()) < slot_clear, "bolt_azimuths_deg", given,
         f"a bolt {float(on_slot.min()) / MM:.3g} mm from the pin's slot, at least {slot_clear / MM:g} mm"),
    ):  # fmt: skip
        if wrong:
            raise InputError(f"mount.flange.{key} = {value} leaves no room; {allowed}")


def _engraving(sensor: SensorModel, robot: RobotFlange, fingerprint: str, name: str, top: float) -> Engraving:
    """Return the engraving around the pad, starting at the dowel."""
    inner = sensor.body_d / 2
    outer = robot.bolt_circle_d / 2 - max(robot.bolt_head_d, robot.pin_slot[1]) / 2
    radius = (inner + outer) / 2
    if outer - inner < HEIGHT + 2 * LETTER_EDGE:
        fingerprint = name = ""
    return engrave(fingerprint, name, radius, top, free_arcs(radius, (0.0,), 1.0 * MM))
