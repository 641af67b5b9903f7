"""Solids of the parts: probe, adapters, clamp ring, screws and nuts; and how deep each screw enters."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import cadquery as cq

from probedesign.cad.kernel import block, cylinder, engraving_cuts, frusta, hexagon, revolved, single_solid
from probedesign.core.errors import CheckFailedError
from probedesign.core.frames import Array
from probedesign.core.units import MM
from probedesign.design.catalog.sensors import SensorModel
from probedesign.geometry import ProbeGeometry
from probedesign.mount import SensorAdapter
from probedesign.mount.engraving import XY
from probedesign.mount.fasteners import (
    M2,
    M2_CLEARANCE_D,
    M2_COUNTERBORE_D,
    M2_GRIP,
    M2_LENGTH,
    M2_NUT_AF,
    M2_NUT_HEIGHT,
    SCREWS,
    SocketScrew,
)
from probedesign.mount.flange_adapter import FlangeAdapter
from probedesign.mount.sensor_adapter import PEG_D


@dataclass(frozen=True)
class ScrewGroup:
    """Equal screws that fasten one part to another; lengths [m], positions in the sensor frame.

    Attributes:
        name: of the group.
        into: the part or thread that they enter.
        screw: dimensions of the standard.
        length: under the head.
        grip: thickness between head and thread.
        entry_limits: minimum and maximum allowed entry.
        points: (x, y) of each.
        seat: z of the face under the heads.
        up: whether the screws point to +z.
    """

    name: str
    into: str
    screw: SocketScrew
    length: float
    grip: float
    entry_limits: tuple[float, float]
    points: tuple[XY, ...]
    seat: float
    up: bool

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
            raise CheckFailedError(
                f"{self.name}: {self.screw.thread}×{self.length / MM:g} is not a stock length"
            )

    def as_record(self) -> dict[str, Any]:
        """Return the record of the manifest, in millimetres."""
        return {
            "name": self.name,
            "screw": f"ISO 4762 {self.screw.thread}x{self.length / MM:g}",
            "count": len(self.points),
            "into": self.into,
            "length_mm": round(self.length / MM, 6),
            "grip_mm": round(self.grip / MM, 6),
            "entry_mm": round(self.entry / MM, 6),
            "entry_allowed_mm": [round(limit / MM, 6) for limit in self.entry_limits],
        }


def screw_groups(a: SensorAdapter, plate: FlangeAdapter, sensor: SensorModel) -> list[ScrewGroup]:
    """Return all screws of the assembly, checked.

    Raises:
        CheckFailedError: a screw enters too little or too deep.
    """
    T = plate.T_sensor_robotflange
    robot = plate.robot
    bolt = SCREWS[robot.bolt]
    mounting = (sensor.mounting.min_entry, sensor.mounting.max_entry)
    ring_grip = a.ring_thickness + a.body_top - a.nut_pocket_top  # with the ring pressed onto the wall
    nut = (M2_NUT_HEIGHT, a.nut_pocket_top - a.foot_height)
    thread = (
        0.8 * float(robot.bolt[1:]) * MM,
        robot.max_bolt_entry,
    )  # 0.8 d of thread engagement suffices in aluminium
    uses = [
        ScrewGroup("sensor_adapter_screws", "sensor tool side", M2, M2_LENGTH, M2_GRIP,
                 (a.tool.min_entry, a.tool.max_entry), a.p_tool_screws, M2_GRIP, up=False),
        ScrewGroup("ring_screws", "nuts in the sensor adapter", M2, a.ring_screw_length, ring_grip,
                 nut, a.p_ring_screws, a.ring_top, up=False),
        ScrewGroup("mounting_screws", "sensor mounting side", M2, M2_LENGTH, M2_GRIP, mounting,
                 _in_frame(plate.p_mounting_screws, T), float(T[2, 3]) + plate.counterbore_top, up=True),
        ScrewGroup("robot_bolts", "robot flange", bolt, robot.bolt_length, plate.plate_top,
                 thread, _in_frame(plate.p_bolts, T), float(T[2, 3]) + plate.plate_top, up=False),
    ]  # fmt: skip
    for use in uses:
        use.check()
    return uses


def screw_solids(use: ScrewGroup) -> cq.Compound:
    """Return the screws as solids, in millimetres in the sensor frame; threads drawn at their pitch diameter."""
    return cq.Compound.makeCompound([_screw(use, p) for p in use.points])


def nut_solids(a: SensorAdapter) -> cq.Compound:
    """Return the nuts at the top of their pockets."""
    z = (a.nut_pocket_top - M2_NUT_HEIGHT, a.nut_pocket_top)
    return cq.Compound.makeCompound(
        [single_solid(hexagon(M2_NUT_AF, *z, p).cut(cylinder(M2.pitch_d, *z, p))) for p in a.p_ring_screws]
    )


def _screw(use: ScrewGroup, p: XY) -> cq.Solid:
    s, seat = use.screw, use.seat
    axis = 1.0 if use.up else -1.0  # from head to point
    top = seat - axis * s.head_height
    head = cylinder(s.head_d, *_between(seat, top), p)
    shank = cylinder(s.pitch_d, *_between(seat, seat + axis * use.length), p)
    socket = hexagon(s.socket_af, *_between(top, top + axis * s.socket_depth), p)
    return single_solid(head.fuse(shank).cut(socket))


def _between(a: float, b: float) -> tuple[float, float]:
    return min(a, b), max(a, b)


def _in_frame(points: Iterable[XY], T_a_b: Array) -> tuple[XY, ...]:
    """Return points (x, y) of frame b in frame a; the z axes are parallel."""
    R, t = T_a_b[:2, :2], T_a_b[:2, 3]
    return tuple((float(q[0]), float(q[1])) for q in (R @ p + t for p in points))


def probe_solid(geometry: ProbeGeometry, adapter: SensorAdapter) -> cq.Solid:
    """Return the flexible part and its flange in one solid.

    Args:
        geometry: of the probe.
        adapter: its peg passes through the flange, where the hole at +x is the clocking mark; it also defines the
            engraving of the lip.

    Returns:
        The solid in millimetres in the base frame: flexible part above z = 0, flange below.
    """
    mark = cylinder(adapter.peg_hole_d, -geometry.flange.thickness, 0.0, (adapter.peg_x, 0.0))
    body = _turned(geometry) if geometry.cross_section.full_round else _ruled(geometry)
    return single_solid(body.cut(mark, *engraving_cuts(adapter.on_flange)))


def _turned(geometry: ProbeGeometry) -> cq.Shape:
    rim, underside = geometry.flange.diameter / 2, -geometry.flange.thickness
    taper = _taper(geometry)
    return revolved([(0.0, underside), (rim, underside), (rim, 0.0), *taper, (0.0, geometry.length)])


def _ruled(geometry: ProbeGeometry) -> cq.Shape:
    """Loft a body of any cross-section.

    A hollow one is not revolved: the kernel confuses a cone of a thin bore with a cylinder, and meshes it with hundreds
    of thousands of triangles.
    """
    section, taper = geometry.cross_section, _taper(geometry)
    disc = cylinder(geometry.flange.diameter, -geometry.flange.thickness, 0.0)
    body = disc.fuse(frusta(taper, section.flatness))
    if not section.hollow:
        return body
    # Open from tip to underside, so that resin drains at both ends.
    bore = [(section.bore_ratio * r, s) for r, s in taper]
    return body.cut(frusta([(geometry.bore_radius, -geometry.flange.thickness), *bore]))


def _taper(geometry: ProbeGeometry) -> list[XY]:
    """Return (radius, s) at the knots [m]."""
    return [(float(r), float(s)) for s, r in zip(geometry.s, geometry.radius, strict=True)]


def sensor_adapter_solid(a: SensorAdapter) -> cq.Solid:
    """Return the sensor adapter, in millimetres in the sensor frame: its foot rests on the tool face, z = 0."""
    foot, rim, recess = a.foot_d / 2, a.body_d / 2, a.recess_d / 2
    outline = [
        (0.0, 0.0), (foot, 0.0), (foot, a.foot_height), (rim, a.foot_height),
        (rim, a.body_top), (recess, a.body_top), (recess, a.floor), (0.0, a.floor),
    ]  # fmt: skip
    holes = [
        block((a.mark_x, rim), (-rim, rim), (0.0, a.body_top)),
        *(cylinder(M2_CLEARANCE_D, 0.0, M2_GRIP, p) for p in a.p_tool_screws),
        *(cylinder(M2_COUNTERBORE_D, M2_GRIP, a.floor, p) for p in a.p_tool_screws),
        *(cylinder(a.dowel_d, 0.0, a.dowel_depth, p) for p in a.p_dowels),
        *(cylinder(M2_CLEARANCE_D, a.nut_pocket_top, a.body_top, p) for p in a.p_ring_screws),
        *(hexagon(a.nut_pocket_af, a.foot_height, a.nut_pocket_top, p) for p in a.p_ring_screws),
        *engraving_cuts(a.on_wall),
    ]
    peg = cylinder(PEG_D, a.floor, a.peg_top, (a.peg_x, 0.0))
    return single_solid(revolved(outline).cut(*holes).fuse(peg))


def clamp_ring_solid(a: SensorAdapter) -> cq.Solid:
    """Return the clamp ring, in millimetres in its own frame: underside at z = 0, which lies on the base plane."""
    bore, top = a.ring_bore_d / 2, a.ring_bore_top_d / 2
    height = a.ring_thickness
    body = cylinder(a.body_d, 0.0, height).cut(
        revolved([(0.0, 0.0), (bore, 0.0), (top, height), (0.0, height)]),
        *(cylinder(M2_CLEARANCE_D, 0.0, height, p) for p in a.p_ring_screws),
        *engraving_cuts(a.on_ring),
    )
    return single_solid(body)


def flange_adapter_solid(a: FlangeAdapter) -> cq.Solid:
    """Return the flange adapter, in millimetres in the robot flange's frame: spigot below z = 0, sensor pad on top."""
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
        *engraving_cuts(a.on_plate),
    ]
    if width:
        sides = (reach - length / 2, reach + length / 2), (-width / 2, width / 2)
        holes.append(block(*sides, (0.0, a.plate_top)))
    return single_solid(body.cut(*holes))
