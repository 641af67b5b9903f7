"""Solids of the printed parts, screws, nuts and pins, and the volumes around the sensor; in millimetres."""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from typing import Any

import cadquery as cq
import numpy as np

from probedesign.cad.kernel import (
    block,
    cylinder,
    engraving_cuts,
    frusta,
    hexagon,
    on_foot,
    placed,
    revolved,
    round_slot,
    single_solid,
)
from probedesign.core.errors import CheckFailedError
from probedesign.core.frames import Array, pose, rotation_z
from probedesign.core.units import MM
from probedesign.design.catalog import SocketScrew
from probedesign.design.sensors import ScrewPattern, SensorInterface
from probedesign.geometry import ProbeGeometry
from probedesign.mount import FlangeAdapter, SensorAdapter
from probedesign.mount.engraving import XY
from probedesign.mount.flange_adapter import CENTRING_PIN_D, CENTRING_PIN_LENGTH, TIE_SLOT
from probedesign.mount.sensor_adapter import PEG_D, RING_VENT_HEIGHT, VENT_WIDTH, on_circle

#: Minimum clearance to the sensor's body and cable: a contact across the split line would bypass the strain gauges.
MIN_CLEARANCE = 0.5 * MM
#: Distance from the sensor's body up to which the cable's sector is checked; it exceeds every part of the mount.
SECTOR_REACH = 31.5 * MM


@dataclass(frozen=True)
class ScrewGroup:
    """Equal screws that fasten one part to another; lengths [m], positions in the sensor frame."""

    name: str  #: of the group.
    into: str  #: the part or thread that they enter.
    screw: SocketScrew  #: dimensions of the standard.
    length: float  #: under the head.
    grip: float  #: thickness between head and thread.
    entry_limits: tuple[float, float]  #: minimum and maximum allowed entry.
    points: tuple[XY, ...]  #: (x, y) of each.
    seat: float  #: z of the face under the heads.
    up: bool  #: whether the screws point to +z.

    @property
    def entry(self) -> float:
        """Return the depth of thread engagement [m]."""
        return self.length - self.grip

    def check(self) -> None:
        """Check that the length is a stock length and the entry within its limits.

        Raises:
            CheckFailedError: names the screw, its entry and the allowed range.
        """
        low, high = self.entry_limits
        if not low - 1e-9 <= self.entry <= high + 1e-9:  # a nanometre for round-off of sums
            raise CheckFailedError(
                f"{self.name}: {self.screw.thread}×{self.length / MM:g} would enter {self.into} by "
                f"{self.entry / MM:.2f} mm; allowed {low / MM:g} to {high / MM:g} mm"
            )
        if not any(abs(self.length - n * MM) < 1e-9 for n in self.screw.stock_mm):
            raise CheckFailedError(f"{self.name}: {self.screw.thread}×{self.length / MM:g} is not a stock length")

    @property
    def standard(self) -> str:
        """Return the designation of one screw."""
        return f"ISO 4762 {self.screw.thread}x{self.length / MM:g}"

    @property
    def poses(self) -> tuple[Array, ...]:
        """Return the pose of each screw in the sensor frame: its seat at the origin, its head towards +z."""
        turned = pose(np.diag([1.0, -1.0, -1.0]) if self.up else None)
        return tuple(T @ turned for T in _upright(self.points, self.seat))

    def as_record(self) -> dict[str, Any]:
        """Return the record of the manifest, in millimetres."""
        return {
            "name": self.name,
            "screw": self.standard,
            "count": len(self.points),
            "into": self.into,
            "length_mm": round(self.length / MM, 6),
            "grip_mm": round(self.grip / MM, 6),
            "entry_mm": round(self.entry / MM, 6),
            "entry_allowed_mm": [round(limit / MM, 6) for limit in self.entry_limits],
        }


def screw_groups(a: SensorAdapter, plate: FlangeAdapter) -> list[ScrewGroup]:
    """Return all screws of the assembly, checked.

    Raises:
        CheckFailedError: a screw enters too little or too deep.
    """
    T, robot, tool, mounting = plate.T_sensor_robotflange, plate.robot, a.tool, plate.mounting
    bolt = robot.screw
    ring_grip = a.ring_thickness + a.nut_roof  # with the ring pressed onto the wall
    nut = (a.options.nut.height, a.nut_slot_z[1] - a.ring_hole_bottom)
    thread = (0.8 * bolt.nominal_d, robot.max_bolt_entry)  # 0.8 d of thread engagement suffices in aluminium
    uses = [
        ScrewGroup("sensor_adapter_screws", "sensor tool side", tool.screw, tool.length, tool.grip,
                   (tool.min_entry, tool.max_entry), a.p_tool_screws, tool.grip, up=False),
        ScrewGroup("ring_screws", "nuts in the sensor adapter", a.ring_screw, a.ring_screw_length, ring_grip,
                   nut, a.p_ring_screws, a.ring_top, up=False),
        ScrewGroup("mounting_screws", "sensor mounting side", mounting.screw, mounting.length, mounting.grip,
                   (mounting.min_entry, mounting.max_entry), _in_frame(plate.p_mounting_screws, T),
                   float(T[2, 3]) + plate.counterbore_top, up=True),
        ScrewGroup("robot_bolts", "robot flange", bolt, robot.bolt_length, plate.plate_top,
                   thread, _in_frame(plate.p_bolts, T), float(T[2, 3]) + plate.plate_top, up=False),
    ]  # fmt: skip
    for use in uses:
        use.check()
    return uses


def fasteners(
    a: SensorAdapter, plate: FlangeAdapter, screws: list[ScrewGroup]
) -> list[tuple[str, str, cq.Solid, tuple[Array, ...]]]:
    """Return all screws, nuts and pins of the assembly: of each group of equal ones the name, the standard such as
    ISO 4762 M2x6, the solid of a piece, which groups of one standard share, and the poses in the sensor frame."""
    d, length, nut = a.dowels.diameter, a.dowels.pin_length, a.options.nut

    def drawn_nut() -> cq.Solid:
        """Return a nut about z on z = 0, two sides along x."""
        hole = cylinder(a.ring_screw.pitch_d, 0.0, nut.height)
        return single_solid(hexagon(nut.af, 0.0, nut.height, (0.0, 0.0), 30.0).cut(hole))

    groups: list[tuple[str, str, Callable[[], cq.Solid], tuple[Array, ...]]] = [
        *((use.name, use.standard, partial(_screw, use.screw, use.length), use.poses) for use in screws),
        ("ring_nuts", f"ISO 4032 {a.ring_screw.thread}", drawn_nut,
         _upright(a.p_ring_screws, a.nut_slot_z[1] - nut.height)),
        # h8 is a slip fit in the sensor's hole; m6 would be a press fit
        ("dowel_pins", f"ISO 2338 {d / MM:g} h8x{length / MM:g}", partial(cylinder, d, 0.0, length),
         _upright(a.p_dowels, -a.dowels.depth)),
    ]  # fmt: skip
    if plate.p_centring_pins:
        T, pin = plate.T_sensor_robotflange, f"{CENTRING_PIN_D / MM:g} h8x{CENTRING_PIN_LENGTH / MM:g}"
        poses = _upright(_in_frame(plate.p_centring_pins, T), float(T[2, 3]) + plate.centring_hole[1])
        cylindrical = partial(cylinder, CENTRING_PIN_D, 0.0, CENTRING_PIN_LENGTH)
        groups.append(("centring_pins", f"ISO 2338 {pin}", cylindrical, poses))
    solids: dict[str, cq.Solid] = {}
    for _, standard, draw, poses in groups:
        if poses and standard not in solids:
            solids[standard] = draw()
    return [(name, standard, solids[standard], poses) for name, standard, _, poses in groups if poses]


def _screw(screw: SocketScrew, length: float) -> cq.Solid:
    """Return a screw about z, its seat at z = 0 and its point below; the thread is drawn at its pitch diameter."""
    head, shank = cylinder(screw.head_d, 0.0, screw.head_height), cylinder(screw.pitch_d, -length, 0.0)
    socket = hexagon(screw.socket_af, screw.head_height - screw.socket_depth, screw.head_height, (0.0, 0.0))
    return single_solid(head.fuse(shank).cut(socket))


def _upright(points: Iterable[XY], z: float) -> tuple[Array, ...]:
    return tuple(pose(rotation_z(math.atan2(p[1], p[0])), [*p, z]) for p in points)


def _in_frame(points: Iterable[XY], T_a_b: Array) -> tuple[XY, ...]:
    R, t = T_a_b[:2, :2], T_a_b[:2, 3]
    return tuple((float(q[0]), float(q[1])) for q in (R @ p + t for p in points))


def probe_solid(geometry: ProbeGeometry, adapter: SensorAdapter, ruled: bool = False) -> cq.Solid:
    """Return the flexible part and its flange in one solid, with the hole of the adapter's peg and the engraving.

    Args:
        geometry: of the probe.
        adapter: that it is mounted on.
        ruled: whether a curved body is drawn for its facets, see `kernel.on_foot`.

    Returns:
        The solid in millimetres in the base frame: flexible part above z = 0, flange below.
    """
    mark = cylinder(adapter.peg_hole_d, -geometry.flange.thickness, 0.0, (adapter.peg_x, 0.0))
    section, flange, underside = geometry.cross_section, geometry.flange, -geometry.flange.thickness
    taper = [(float(r), float(s)) for s, r in zip(geometry.s, geometry.radius, strict=True)]
    if not geometry.axis.is_straight:
        foot = cylinder(flange.diameter, underside, 0.0).cut(mark, *engraving_cuts(adapter.on_flange))
        return on_foot(geometry, single_solid(foot), ruled)
    if section.full_round:
        rim = flange.diameter / 2
        body = revolved([(0.0, underside), (rim, underside), (rim, 0.0), *taper, (0.0, geometry.length)])
    else:
        # A hollow one is not revolved: the kernel confuses a cone of a thin bore with a cylinder, and meshes it with
        # hundreds of thousands of triangles.
        body = cylinder(flange.diameter, underside, 0.0).fuse(frusta(taper, section.flatness))
        if section.hollow:  # open from tip to underside, so that resin drains at both ends
            bore = [(section.bore_ratio * r, s) for r, s in taper]
            body = body.cut(frusta([(geometry.bore_radius, underside), *bore]))
    return single_solid(body.cut(mark, *engraving_cuts(adapter.on_flange)))


def sensor_adapter_solid(a: SensorAdapter) -> cq.Solid:
    """Return the sensor adapter, in millimetres in the sensor frame: its foot rests on the tool face, z = 0."""
    foot, cone, rim, recess, land = (d / 2 for d in (a.foot_d, a.cone_d, a.body_d, a.recess_d, a.land_d))
    outline = [
        (0.0, 0.0), (foot, 0.0), (foot, a.foot_height), (cone, a.foot_height), (rim, a.cone_top),
        (rim, a.body_top), (recess, a.body_top), (recess, a.groove_floor), (land, a.groove_floor), (land, a.floor),
        (0.0, a.floor),
    ]  # fmt: skip
    hole_d, (slot_z0, slot_z1) = a.ring_screw.clearance_d, a.nut_slot_z
    circle = a.ring_circle_d / 2
    holes = [
        block((a.mark_x, rim), (-rim, rim), (a.cone_top, a.body_top)),
        block(((a.land_d + a.recess_d) / 4, a.mark_x),  # the vent: from the groove through the recess's wall
              (-VENT_WIDTH / 2, VENT_WIDTH / 2), (a.groove_floor, a.body_top)),
        block((-1.2 * rim, 0.0), (-a.window_half, a.window_half), (a.groove_floor, a.body_top)).cut(
            cylinder(a.recess_d, a.groove_floor, a.body_top)),
        *(cylinder(a.tool.screw.clearance_d, 0.0, a.tool.grip, p) for p in a.p_tool_screws),
        *(cylinder(a.tool.screw.counterbore_d, a.tool.grip, a.floor, p) for p in a.p_tool_screws),
        *(_dowel_hole(a, number) for number in range(len(a.p_dowels))),
        *(cylinder(a.roof_hole_d, slot_z1, a.body_top, p) for p in a.p_ring_screws),
        *(cylinder(hole_d, a.ring_hole_bottom, slot_z0, p) for p in a.p_ring_screws),
        *(round_slot(a.nut_slot_width, (circle - a.nut_slot_reach, 1.2 * rim), a.nut_slot_z, (0.0, 0.0),
                     math.degrees(math.atan2(p[1], p[0]))) for p in a.p_ring_screws),
        *engraving_cuts(a.on_wall),
    ]  # fmt: skip
    peg = cylinder(PEG_D, a.groove_floor, a.peg_top, (a.peg_x, 0.0))
    return single_solid(revolved(outline).cut(*holes).fuse(peg))


def _dowel_hole(a: SensorAdapter, number: int) -> cq.Solid:
    slot_deg, p, half = a.dowel_slot_deg(number), a.p_dowels[number], a.dowel_slot / 2
    if slot_deg is None:
        return cylinder(a.dowel_d, 0.0, a.dowel_depth, p)
    return round_slot(a.dowel_d, (-half, half), (0.0, a.dowel_depth), p, slot_deg, both_ends=True)


def clamp_ring_solid(a: SensorAdapter) -> cq.Solid:
    """Return the clamp ring, in millimetres in its own frame: underside at z = 0, which lies on the base plane."""
    bore, top = a.ring_bore_d / 2, a.ring_bore_top_d / 2
    height = a.ring_thickness
    body = cylinder(a.body_d, 0.0, height).cut(
        revolved([(0.0, 0.0), (bore, 0.0), (top, height), (0.0, height)]),
        *(cylinder(a.ring_screw.clearance_d, 0.0, height, p) for p in a.p_ring_screws),
        block((0.0, a.body_d), (-a.ring_vent_width / 2, a.ring_vent_width / 2), (0.0, RING_VENT_HEIGHT)),
        *engraving_cuts(a.on_ring),
    )
    return single_solid(body)


def flange_adapter_solid(a: FlangeAdapter) -> cq.Solid:
    """Return the flange adapter, in millimetres in the robot flange's frame: spigot below z = 0, flat top."""
    spigot_d, spigot_height = a.robot.spigot
    width, length = a.robot.pin_slot
    reach, screw, top = a.robot.bolt_circle_d / 2, a.mounting.screw, a.plate_top
    body = cylinder(a.plate_d, 0.0, top)
    if spigot_height:
        body = body.fuse(cylinder(spigot_d, -spigot_height, 0.0))
    radial, tangential = (side / 2 for side in TIE_SLOT)
    holes = [
        *(cylinder(a.robot.screw.clearance_d, 0.0, top, p) for p in a.p_bolts),
        *(cylinder(screw.counterbore_d, -spigot_height, a.counterbore_top, p) for p in a.p_mounting_screws),
        *(cylinder(screw.clearance_d, a.counterbore_top, top, p) for p in a.p_mounting_screws),
        _turned_to(block(*a.cable_pocket), a.cable_deg),
        *(cylinder(a.centring_hole[0], a.centring_hole[1], top, p) for p in a.p_centring_pins),
        *(_turned_to(block((-radial, radial), (-tangential, tangential), (0.0, top)), a.cable_deg, p)
          for p in a.p_tie_slots),
        *engraving_cuts(a.on_plate),
    ]  # fmt: skip
    if width:
        sides = (reach - length / 2, reach + length / 2), (-width / 2, width / 2)
        holes.append(block(*sides, (0.0, a.plate_top)))
    return single_solid(body.cut(*holes))


def _turned_to(shape: cq.Shape, azimuth_deg: float, p: XY = (0.0, 0.0)) -> cq.Shape:
    """Return a shape turned about z and moved to p [m]."""
    return placed(shape.rotate((0, 0, 0), (0, 0, 1), azimuth_deg), pose(p=[*p, 0.0]))


def sensor_envelope(sensor: SensorInterface) -> cq.Shape:
    """Return the sensor's body with its holes and its cable's exit, in the sensor frame."""
    h, cable, dowels = sensor.height, sensor.cable, sensor.dowels
    low, high = cable.heights
    exit_block = block((0.0, cable.reach), (-cable.width / 2, cable.width / 2), (low - h, high - h))
    return cylinder(sensor.body_d, -h, 0.0).fuse(_turned_to(exit_block, cable.azimuth_deg)).cut(
        *_threads(sensor.tool, -sensor.tool.max_entry, 0.0),
        *_threads(sensor.mounting, -h, sensor.mounting.max_entry - h),
        *(cylinder(dowels.diameter, -dowels.depth, 0.0, p) for p in on_circle(dowels.circle_d, dowels.azimuths_deg)),
    )  # fmt: skip


def _threads(pattern: ScrewPattern, z0: float, z1: float) -> list[cq.Solid]:
    d, points = pattern.screw.nominal_d, on_circle(pattern.bolt_circle_d, pattern.azimuths_deg)
    return [cylinder(d, z0, z1, p) for p in points]


def clearance_volumes(sensor: SensorInterface) -> list[cq.Shape]:
    """Return the volumes around the sensor's body, tool face and cable exit that must stay empty."""
    h, r, cable, gap = sensor.height, sensor.body_d / 2, sensor.cable, MIN_CLEARANCE
    # The centring pins touch the mounting side only, below the cable's free height.
    shell = cylinder(2 * (r + gap), cable.free_height - h, gap).cut(cylinder(2 * r, cable.free_height - h, gap))
    side, (low, high) = cable.width / 2 + gap, cable.heights
    # Within the rim no part lies above the mounting face; from there the clearance is measured obliquely.
    inward = math.sqrt(max(gap**2 - low**2, 0.0))
    exit_room = block((r - inward, cable.reach + gap), (-side, side), (low - gap - h, high + gap - h))
    return [shell, _turned_to(exit_room, cable.azimuth_deg)]


def cable_sector(sensor: SensorInterface) -> cq.Shape:
    """Return the sector around the cable that only the sensor may occupy, in the sensor frame."""
    cable, z = sensor.cable, -sensor.height
    wedge = cq.Solid.makeCylinder(
        (sensor.body_d / 2 + SECTOR_REACH) / MM, cable.free_height / MM, cq.Vector(0, 0, z / MM),
        angleDegrees=2 * cable.half_width_deg,
    )  # fmt: skip
    return _turned_to(wedge, cable.azimuth_deg - cable.half_width_deg).cut(cylinder(sensor.body_d, z, 0.0))
