"""Rules of the rigid parts: every thin place and every hole of the adapters and the clamp ring."""

import math
from collections.abc import Iterable, Iterator
from typing import NamedTuple

from probedesign.mount import FlangeAdapter, SensorAdapter
from probedesign.mount.engraving import XY
from probedesign.mount.fasteners import M2_CLEARANCE_D, M2_COUNTERBORE_D, M2_GRIP
from probedesign.mount.sensor_adapter import PEG_D
from probedesign.printing import limits
from probedesign.printing.rule import Finding
from probedesign.units import MM


class Wall(NamedTuple):
    """A thin place: which, how thick [m], and whether it stands free on one side."""

    what: str
    thickness: float
    free: bool = False


def mount_findings(adapter: SensorAdapter, plate: FlangeAdapter) -> list[Finding]:
    """What the rules say of the rigid parts, as drawn."""
    parts = {
        "sensor_adapter": (_adapter_walls(adapter), _adapter_holes(adapter)),
        "clamp_ring": (_ring_walls(adapter), {"screw hole": M2_CLEARANCE_D}),
        "flange_adapter": (_plate_walls(plate), _plate_holes(plate)),
    }
    findings = [_peg(adapter)]
    for part, (walls, holes) in parts.items():
        findings += [_wall(part, wall) for wall in walls]
        findings += [_hole(part, what, d) for what, d in holes.items()]
    return findings


def _wall(part: str, wall: Wall) -> Finding:
    limit = limits.FREE_WALL if wall.free else limits.HELD_WALL
    return limits.WALL.at_least(part, wall.what, wall.thickness / MM, limit, remedy="make it thicker")


def _hole(part: str, what: str, diameter: float) -> Finding:
    return limits.OPEN_HOLE.at_least(part, what, diameter / MM, limits.HOLE, remedy="make it wider")


def _peg(a: SensorAdapter) -> Finding:
    return limits.SLENDERNESS.at_least(
        "sensor_adapter", "clocking peg, diameter over height", PEG_D / (a.peg_top - a.floor), limits.SLENDER,
        remedy="make it thicker",
    )  # fmt: skip


def _adapter_walls(a: SensorAdapter) -> Iterator[Wall]:
    ring, rim, recess = _reach(a.p_ring_screws), a.body_d / 2, a.recess_d / 2
    pocket = a.nut_pocket_af / math.sqrt(3.0)  # to its corners
    tool, dowel, foot = _reach(a.p_tool_screws), _reach(a.p_dowels), a.foot_d / 2
    yield Wall("rim around the recess, at the flat", a.mark_x - recess, free=True)
    yield Wall("between ring screw and recess", ring - M2_CLEARANCE_D / 2 - recess)
    yield Wall("between nut pocket and rim", rim - ring - pocket, free=True)
    if ring - pocket < recess:  # the pocket reaches under the recess
        yield Wall("between nut pocket and recess", a.floor - a.nut_pocket_top)
    yield Wall("between sensor screw and edge of the foot", foot - tool - M2_CLEARANCE_D / 2, free=True)
    yield Wall("between dowel hole and edge of the foot", foot - dowel - a.dowel_d / 2, free=True)
    yield Wall("over a dowel hole", a.floor - a.dowel_depth)
    yield Wall("under the heads of the sensor screws", M2_GRIP)


def _adapter_holes(a: SensorAdapter) -> dict[str, float]:
    return {"screw hole": M2_CLEARANCE_D, "dowel hole": a.dowel_d}


def _ring_walls(a: SensorAdapter) -> Iterator[Wall]:
    ring, hole = _reach(a.p_ring_screws), M2_CLEARANCE_D / 2
    yield Wall("thickness", a.ring_thickness, free=True)
    yield Wall("between screw hole and rim", a.body_d / 2 - ring - hole, free=True)
    yield Wall("between screw hole and bore", ring - hole - a.ring_bore_top_d / 2, free=True)


def _plate_walls(p: FlangeAdapter) -> Iterator[Wall]:
    robot, rim, pad = p.robot, p.plate_d / 2, p.pad_d / 2
    bolts, screws = _reach(p.p_bolts), _reach(p.p_mounting_screws)
    width, length = robot.pin_slot
    yield Wall("thickness", p.plate_top, free=True)
    yield Wall("between bolt and rim", rim - bolts - robot.bolt_clearance_d / 2, free=True)
    if width > 0.0:
        yield Wall("between pin slot and rim", rim - math.hypot(bolts + length / 2, width / 2), free=True)
    yield Wall("between sensor screw and edge of the pad", pad - screws - M2_CLEARANCE_D / 2, free=True)
    if robot.spigot[0] > 0.0:
        edge = robot.spigot[0] / 2 - screws - M2_COUNTERBORE_D / 2
        yield Wall("between a head's room and edge of the spigot", edge)
    yield Wall("under the heads of the sensor screws", M2_GRIP)


def _plate_holes(p: FlangeAdapter) -> dict[str, float]:
    slot = {"pin slot": p.robot.pin_slot[0]} if p.robot.pin_slot[0] > 0.0 else {}
    return {"sensor screw hole": M2_CLEARANCE_D, "bolt hole": p.robot.bolt_clearance_d, **slot}


def _reach(points: Iterable[XY]) -> float:
    """How far out equal features lie [m]."""
    return max(math.hypot(*p) for p in points)
