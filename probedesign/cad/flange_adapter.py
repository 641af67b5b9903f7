"""The rigid plate between the sensor's mounting side and the robot's flange."""

import cadquery as cq

from probedesign.cad.kernel import block, cylinder, engraved, single
from probedesign.mount.fasteners import M2_CLEARANCE_D, M2_COUNTERBORE_D
from probedesign.mount.flange_adapter import FlangeAdapter


def flange_adapter_solid(a: FlangeAdapter) -> cq.Solid:
    """The plate, in millimetres in the robot flange's frame: spigot below z = 0, sensor pad on top."""
    spigot_d, spigot_height = a.robot.spigot
    width, length = a.robot.pin_slot
    reach = a.robot.bolt_circle_d / 2
    body = cylinder(a.plate_d, 0.0, a.plate_top).fuse(cylinder(a.pad_d, a.plate_top, a.pad_top))
    if spigot_height:
        body = body.fuse(cylinder(spigot_d, -spigot_height, 0.0))
    holes = [
        *(cylinder(a.robot.bolt_clearance_d, 0.0, a.plate_top, p) for p in a.p_bolts),
        *(cylinder(M2_COUNTERBORE_D, -spigot_height, a.counterbore_top, p) for p in a.p_mounting_screws),
        *(cylinder(M2_CLEARANCE_D, a.counterbore_top, a.pad_top, p) for p in a.p_mounting_screws),
        *engraved(a.on_plate),
    ]
    if width:
        sides = (reach - length / 2, reach + length / 2), (-width / 2, width / 2)
        holes.append(block(*sides, (0.0, a.plate_top)))
    return single(body.cut(*holes))
