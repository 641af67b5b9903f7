"""Interior of the rigid parts: whether a point lies in a part's material, from its dimensions and without CAD.

The print check cuts the parts into layers with it. Arguments x and y [m] are arrays of one shape, z [m] is one height.
"""

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from probedesign.core.frames import Array
from probedesign.mount.engraving import XY
from probedesign.mount.flange_adapter import TIE_SLOT, FlangeAdapter
from probedesign.mount.sensor_adapter import PEG_D, RING_VENT_HEIGHT, VENT_WIDTH, SensorAdapter

Mask = NDArray[np.bool_]


def sensor_adapter_interior(a: SensorAdapter, x: Array, y: Array, z: float) -> Mask:
    """Return which points lie in the sensor adapter, in the sensor frame; the engraving is left out."""
    r = np.hypot(x, y)
    if not 0.0 <= z < a.body_top:
        return np.zeros(x.shape, dtype=bool)
    rise = (a.body_d - a.cone_d) / 2 / (a.cone_top - a.foot_height)
    if z < a.foot_height:
        solid = r < a.foot_d / 2
    else:
        solid = r < min(a.cone_d / 2 + rise * (z - a.foot_height), a.body_d / 2)
    if z >= a.cone_top:
        solid &= x < a.mark_x
    if z < a.tool.grip:
        solid &= ~_near(x, y, a.p_tool_screws, a.tool.screw.clearance_d)
    elif z < a.floor:
        solid &= ~_near(x, y, a.p_tool_screws, a.tool.screw.counterbore_d)
    if z >= a.groove_floor:
        solid &= (r >= a.recess_d / 2) | ((r < a.land_d / 2) & (z < a.floor))
        solid &= ~((np.abs(y) < VENT_WIDTH / 2) & (x > a.vent_x))
        if z < a.peg_top:
            solid |= _near(x, y, [(a.peg_x, 0.0)], PEG_D)
    if z < a.dowel_depth:
        for number, p in enumerate(a.p_dowels):
            direction = a.dowel_slot_deg(number)
            u, v = _along(x, y, p, direction or 0.0)
            half = 0.0 if direction is None else a.dowel_slot / 2
            solid &= np.hypot(np.maximum(np.abs(u) - half, 0.0), v) >= a.dowel_d / 2
    if a.nut_slot_z[0] <= z < a.nut_slot_z[1]:
        for px, py in a.p_ring_screws:
            u, v = _along(x, y, (0.0, 0.0), math.degrees(math.atan2(py, px)))
            start = a.ring_circle_d / 2 - a.nut_slot_reach
            solid &= np.hypot(np.minimum(u - start, 0.0), v) >= a.nut_slot_width / 2
    elif z >= a.ring_hole_bottom:
        hole_d = a.roof_hole_d if z >= a.nut_slot_z[1] else a.ring_screw.clearance_d
        solid &= ~_near(x, y, a.p_ring_screws, hole_d)
    return solid


def clamp_ring_interior(a: SensorAdapter, x: Array, y: Array, z: float) -> Mask:
    """Return which points lie in the clamp ring, in its own frame; the engraving is left out."""
    if not 0.0 <= z < a.ring_thickness:
        return np.zeros(x.shape, dtype=bool)
    bore = a.ring_bore_d + (a.ring_bore_top_d - a.ring_bore_d) * z / a.ring_thickness
    r = np.hypot(x, y)
    solid = (r < a.body_d / 2) & (r >= bore / 2) & ~_near(x, y, a.p_ring_screws, a.ring_screw.clearance_d)
    if z < RING_VENT_HEIGHT:
        solid &= ~((np.abs(y) < a.ring_vent_width / 2) & (x > 0.0))
    return solid


def flange_adapter_interior(p: FlangeAdapter, x: Array, y: Array, z: float) -> Mask:
    """Return which points lie in the flange adapter, in the robot flange's frame; the engraving is left out."""
    robot, screw = p.robot, p.mounting.screw
    r = np.hypot(x, y)
    if -robot.spigot[1] <= z < 0.0:
        return (r < robot.spigot[0] / 2) & ~_near(x, y, p.p_mounting_screws, screw.counterbore_d)
    if not 0.0 <= z < p.plate_top:
        return np.zeros(x.shape, dtype=bool)
    solid = r < p.plate_d / 2
    solid &= ~_near(x, y, p.p_bolts, robot.screw.clearance_d)
    d = screw.counterbore_d if z < p.counterbore_top else screw.clearance_d
    solid &= ~_near(x, y, p.p_mounting_screws, d)
    width, length = robot.pin_slot
    solid &= ~((np.abs(x - robot.bolt_circle_d / 2) < length / 2) & (np.abs(y) < width / 2))
    for slot in p.p_tie_slots:
        u, v = _along(x, y, slot, p.cable_deg)
        solid &= ~((np.abs(u) < TIE_SLOT[0] / 2) & (np.abs(v) < TIE_SLOT[1] / 2))
    reach, across, (bottom, _) = p.cable_pocket
    if z >= bottom:
        u, v = _along(x, y, (0.0, 0.0), p.cable_deg)
        solid &= ~((u > reach[0]) & (u < reach[1]) & (v > across[0]) & (v < across[1]))
    if z >= p.centring_hole[1]:
        solid &= ~_near(x, y, p.p_centring_pins, p.centring_hole[0])
    return solid


def _near(x: Array, y: Array, points: Iterable[XY], d: float) -> Mask:
    """Return which points lie within a circle of diameter d about one of the given points."""
    inside = np.zeros(x.shape, dtype=bool)
    for px, py in points:
        inside |= (x - px) ** 2 + (y - py) ** 2 < d * d / 4
    return inside


def _along(x: Array, y: Array, p: XY, azimuth_deg: float) -> tuple[Array, Array]:
    """Return the coordinates about p along an azimuth and across it."""
    c, s = math.cos(math.radians(azimuth_deg)), math.sin(math.radians(azimuth_deg))
    return c * (x - p[0]) + s * (y - p[1]), c * (y - p[1]) - s * (x - p[0])
