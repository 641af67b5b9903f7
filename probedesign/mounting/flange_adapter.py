"""Every dimension of the rigid plate between the sensor's mounting side and the robot's flange.

Its frame is the robot flange's: origin at the centre of the robot's face, z out of the robot, x through
the dowel. The sensor sits above, turned so that its cable leaves midway between two robot bolts.
"""

from dataclasses import dataclass

import numpy as np

from probedesign.frames import Array, pose, rotation_z
from probedesign.mounting.adapter import on_circle
from probedesign.mounting.fasteners import M2_GRIP
from probedesign.mounting.prism import Point
from probedesign.robot_flange import RobotFlange
from probedesign.sensor import SensorModel
from probedesign.units import MM

ENTRY_MARGIN = 0.5 * MM
"""The robot bolts stay that far short of the deepest entry: the plate may print thin."""
PAD_HEIGHT = 1.0 * MM
"""The sensor sits on a pad of its own diameter, so that its cable clears the plate."""
EDGE = 1.8 * MM  # wall outside the pin slot
HEAD_EDGE = 1.5 * MM  # plate outside a bolt's head


@dataclass(frozen=True)
class FlangeAdapter:
    """Dimensions of the plate, in the robot flange's frame [m].

    Attributes:
        robot: the flange pattern.
        plate_d, plate_top: the plate from the robot's face to `plate_top`.
        pad_d, pad_top: the sensor's seat.
        p_mounting_screws, p_bolts: (x, y) of the screws into the sensor and into the robot.
        T_sensor_robotflange: pose of this frame in the sensor frame, (4, 4).
    """

    robot: RobotFlange
    plate_d: float
    plate_top: float
    pad_d: float
    pad_top: float
    p_mounting_screws: tuple[Point, ...]
    p_bolts: tuple[Point, ...]
    T_sensor_robotflange: Array

    @property
    def counterbore_top(self) -> float:
        """Where the heads of the sensor's mounting screws rest, from below [m]."""
        return self.pad_top - M2_GRIP


def flange_adapter_for(sensor: SensorModel, robot: RobotFlange) -> FlangeAdapter:
    """The plate for that sensor on that robot."""
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
        pad_d=sensor.body_d,
        pad_top=pad_top,
        p_mounting_screws=on_circle(
            sensor.mounting.bolt_circle_d, (a - dowel_deg for a in sensor.mounting.azimuths_deg)
        ),
        p_bolts=on_circle(robot.bolt_circle_d, robot.bolt_azimuths_deg),
        T_sensor_robotflange=pose(rotation_z(np.radians(dowel_deg)), [0.0, 0.0, -sensor.height - pad_top]),
    )
