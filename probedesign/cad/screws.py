"""Every screw of an assembly: where it sits, how deep it enters, how deep it may."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import cadquery as cq

from probedesign.cad.kernel import cylinder, hexagon, single
from probedesign.errors import CheckFailedError
from probedesign.frames import Array
from probedesign.mount import FlangeAdapter, SensorAdapter
from probedesign.mount.engraving import XY
from probedesign.mount.fasteners import (
    M2,
    M2_GRIP,
    M2_LENGTH,
    M2_NUT_AF,
    M2_NUT_HEIGHT,
    SCREWS,
    SocketScrew,
)
from probedesign.sensor import SensorModel
from probedesign.units import MM


@dataclass(frozen=True)
class ScrewUse:
    """Equal screws that hold one part on another; lengths [m], places in the sensor frame.

    Attributes:
        name: of the group.
        into: what their threads enter.
        screw: the standard.
        length: under the head.
        grip: what lies between head and thread.
        entry_limits: least useful and deepest allowed entry.
        points: (x, y) of each.
        seat: z of the face that the heads rest on.
        up: whether they point to +z.
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
        """How deep the thread is entered [m]."""
        return self.length - self.grip

    def check(self) -> None:
        """Refuse a screw that is no stock length, or enters too little or too deep.

        Raises:
            CheckFailedError: naming the screw, its entry and what is allowed.
        """
        low, high = self.entry_limits
        if not low - 1e-9 <= self.entry <= high + 1e-9:  # a nanometre for the rounding of sums
            raise CheckFailedError(
                f"{self.name}: {self.screw.thread}×{self.length / MM:g} would enter {self.into} by "
                f"{self.entry / MM:.2f} mm; allowed {low / MM:g} to {high / MM:g} mm"
            )
        if not any(abs(self.length - n * MM) < 1e-9 for n in self.screw.stock_mm):
            raise CheckFailedError(
                f"{self.name}: {self.screw.thread}×{self.length / MM:g} is no stock length"
            )

    def as_record(self) -> dict[str, Any]:
        """For the manifest, in millimetres."""
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


def screws_of(a: SensorAdapter, plate: FlangeAdapter, sensor: SensorModel) -> list[ScrewUse]:
    """All screws of the assembly, checked.

    Raises:
        CheckFailedError: one enters too little or too deep.
    """
    T = plate.T_sensor_robotflange
    robot = plate.robot
    bolt = SCREWS[robot.bolt]
    mounting = (sensor.mounting.min_entry, sensor.mounting.max_entry)
    ring_grip = a.ring_thickness + a.body_top - a.nut_pocket_top  # the ring pressed down on the wall
    nut = (M2_NUT_HEIGHT, a.nut_pocket_top - a.foot_height)
    thread = (
        0.8 * float(robot.bolt[1:]) * MM,
        robot.max_bolt_entry,
    )  # 0.8 d of thread is enough in aluminium
    uses = [
        ScrewUse("sensor_adapter_screws", "sensor tool side", M2, M2_LENGTH, M2_GRIP,
                 (a.tool.min_entry, a.tool.max_entry), a.p_tool_screws, M2_GRIP, up=False),
        ScrewUse("ring_screws", "nuts in the sensor adapter", M2, a.ring_screw_length, ring_grip,
                 nut, a.p_ring_screws, a.ring_top, up=False),
        ScrewUse("mounting_screws", "sensor mounting side", M2, M2_LENGTH, M2_GRIP, mounting,
                 _told(plate.p_mounting_screws, T), float(T[2, 3]) + plate.counterbore_top, up=True),
        ScrewUse("robot_bolts", "robot flange", bolt, robot.bolt_length, plate.plate_top,
                 thread, _told(plate.p_bolts, T), float(T[2, 3]) + plate.plate_top, up=False),
    ]  # fmt: skip
    for use in uses:
        use.check()
    return uses


def screw_solids(use: ScrewUse) -> cq.Compound:
    """The screws as solids, in millimetres in the sensor frame; threads drawn at their pitch diameter."""
    return cq.Compound.makeCompound([_screw(use, p) for p in use.points])


def nut_solids(a: SensorAdapter) -> cq.Compound:
    """The nuts at the top of their pockets."""
    z = (a.nut_pocket_top - M2_NUT_HEIGHT, a.nut_pocket_top)
    return cq.Compound.makeCompound(
        [single(hexagon(M2_NUT_AF, *z, p).cut(cylinder(M2.pitch_d, *z, p))) for p in a.p_ring_screws]
    )


def _screw(use: ScrewUse, p: XY) -> cq.Solid:
    s, seat = use.screw, use.seat
    way = 1.0 if use.up else -1.0  # from head to point
    top = seat - way * s.head_height
    head = cylinder(s.head_d, *_between(seat, top), p)
    shank = cylinder(s.pitch_d, *_between(seat, seat + way * use.length), p)
    socket = hexagon(s.socket_af, *_between(top, top + way * s.socket_depth), p)
    return single(head.fuse(shank).cut(socket))


def _between(a: float, b: float) -> tuple[float, float]:
    return min(a, b), max(a, b)


def _told(points: Iterable[XY], T_a_b: Array) -> tuple[XY, ...]:
    """Points (x, y) of frame b in frame a, whose z axes agree."""
    R, t = T_a_b[:2, :2], T_a_b[:2, 3]
    return tuple((float(q[0]), float(q[1])) for q in (R @ p + t for p in points))
