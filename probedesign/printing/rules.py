"""Rules of printing: their limits with sources, and their findings on the probe and on the rigid parts.

Lengths [mm], angles from the horizontal [deg]. Formlabs' published limits were measured on a Form 2 with rigid resin.
Nothing is published for soft resin: twice the rigid resin's figure is taken as good, the figure itself as the minimum.
"""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np

from probedesign.core.frames import Array
from probedesign.core.units import MM
from probedesign.design.catalog import M2, PRINTERS, Printer
from probedesign.geometry import ProbeGeometry
from probedesign.mount import FlangeAdapter, SensorAdapter
from probedesign.mount.adapters import PEG_D
from probedesign.mount.engraving import XY

Severity = Literal["ok", "warning", "error"]
Confidence = Literal["high", "medium", "low"]
ROUNDING = 1e-9
"""Relative tolerance: sums such as 1.75 - 1.05 are off in the sixteenth digit."""


@dataclass(frozen=True)
class Finding:
    """The result of one rule on one part.

    Attributes:
        rule: name of the rule.
        part: of the export.
        severity: `error` is not expected to print; `warning` may fail or print badly.
        what: the measured feature.
        measured: its value in `unit`; None where the part could not be laid out.
        limit: the value it is compared with.
        bound: the side of the limit on which it must lie.
        unit: mm, deg or 1.
        remedy: the nearest change that meets the limit; empty if the finding is ok.
        source: of the limit.
        confidence: in the limit.
    """

    rule: str
    part: str
    severity: Severity
    what: str
    measured: float | None
    limit: float | None
    bound: Literal["at least", "at most"]
    unit: str
    remedy: str
    source: str
    confidence: Confidence

    def as_record(self) -> dict[str, Any]:
        """Return the finding as a dictionary for JSON and the manifest; numbers to a nanometre."""
        record = {key: value for key, value in vars(self).items() if value != ""}
        numbers = {key: _rounded(record[key]) for key in ("measured", "limit")}
        return record | numbers | {"message": self.message}

    @property
    def message(self) -> str:
        """Return one line: part, value, limit, remedy."""
        if self.measured is None or self.limit is None:
            return f"{self.part}: {self.what}"
        unit = "" if self.unit == "1" else f" {self.unit}"
        numbers = f"{self.measured:.4g}{unit}, required {self.bound} {self.limit:.4g}{unit}"
        return f"{self.part}: {self.what}: {numbers}{f'; {self.remedy}' if self.remedy else ''}"


@dataclass(frozen=True)
class Rule:
    """A rule with the source of its limits and the confidence in them."""

    name: str
    unit: str
    source: str
    confidence: Confidence

    def at_least(
        self, part: str, what: str, measured: float, good: float, bad: float | None = None, remedy: str = ""
    ) -> Finding:
        """Return a warning below `good` and an error below `bad`; without `bad` an error below `good`."""
        severity = _severity(measured, good, good if bad is None else bad)
        limit = bad if severity == "error" and bad is not None else good
        return self._finding(part, what, measured, limit, "at least", severity, remedy)

    def at_most(self, part: str, what: str, measured: float, bad: float, remedy: str = "") -> Finding:
        """Return an error above `bad`."""
        severity = _severity(-measured, -bad, -bad)
        return self._finding(part, what, measured, bad, "at most", severity, remedy)

    def impossible(self, part: str, what: str) -> Finding:
        """Return an error without a number; `what` is the whole message."""
        return Finding(
            self.name, part, "error", what, None, None, "at most", self.unit, "", self.source, self.confidence
        )

    def _finding(
        self,
        part: str,
        what: str,
        measured: float,
        limit: float,
        bound: Literal["at least", "at most"],
        severity: Severity,
        remedy: str,
    ) -> Finding:
        remedy = "" if severity == "ok" else remedy
        return Finding(
            self.name, part, severity, what, measured, limit, bound, self.unit, remedy, self.source, self.confidence
        )  # fmt: skip


def _severity(measured: float, good: float, bad: float) -> Severity:
    room = ROUNDING * max(abs(good), abs(bad))
    if measured < bad - room:
        return "error"
    return "warning" if measured < good - room else "ok"


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 6)


GUIDE = "Formlabs' design guide, Form 2, rigid resin"
DOUBLED = f"twice {GUIDE}, for soft resin (assumed)"

LAYER = 0.1
"""Elastic 50A has no other layer height. Source: PreForm's list of materials."""

RAFT_THICKNESS = 2.0
HEIGHT_ABOVE_RAFT = 5.0
RAFT_MARGIN = 5.0
"""Raft and supports below the base and around it (assumed); `print` requests the first two from PreForm."""
PLATFORM_SETUP = (
    f"raft {RAFT_THICKNESS:g} mm, supports {HEIGHT_ABOVE_RAFT:g} mm, margin {RAFT_MARGIN:g} mm (assumed)"
)

SUPPORTED_WALL, UNSUPPORTED_WALL, MIN_HOLE_D = 0.4, 0.6, 0.5
"""Formlabs' limits for rigid resin: wall supported on two or more sides, wall supported on one side, open hole."""
SOFT_FACTOR = 2.0
"""Factor on these three for soft resin (assumed)."""
MIN_THICKNESS = 1.5
"""Minimum thickness of soft resin that stands by itself (assumed)."""
GOOD_SLENDERNESS, MIN_SLENDERNESS = 0.05, 0.025
"""Diameter over the height above it: vertical wires print from Ø0.3 (7 mm tall) to Ø1.5 (30 mm tall)."""
MIN_OVERHANG, MIN_SOFT_OVERHANG = 19.0, 45.0
MIN_DRAIN_D = 3.5

BUILD_VOLUME = Rule("build_volume", "mm", f"PreForm's build volumes; {PLATFORM_SETUP}", "high")
SLENDERNESS = Rule(
    "slenderness", "1", f"about the wires of {GUIDE}; an error below half of it (assumed)", "low"
)
SMALLEST_FEATURE = Rule("smallest_feature", "mm", "assumed: nothing is published for soft resin", "low")
WALL = Rule("wall", "mm", GUIDE, "medium")
SOFT_WALL = Rule("wall", "mm", DOUBLED, "low")
OPEN_HOLE = Rule("hole", "mm", GUIDE, "medium")
SOFT_HOLE = Rule("hole", "mm", DOUBLED, "low")
NO_OVERHANG = Rule(
    "overhang", "deg", f"{GUIDE}; a warning below {MIN_SOFT_OVERHANG:g} for soft resin (assumed)", "low"
)
TRAPPED_VOLUME = Rule("trapped_volume", "mm", f"drain hole of {GUIDE}", "medium")
MOUNT = Rule("mount", "mm", "the adapter's own dimensions", "high")


SUPPORT_HEIGHT = RAFT_THICKNESS + HEIGHT_ABOVE_RAFT


def probe_fits(printer: Printer, width: float, below: float, length: float, scale_z: float) -> list[Finding]:
    """Return the findings on width and height of a probe in its printer.

    Args:
        printer: of the design.
        width: of flange and body, as printed [mm].
        below: flange, as drawn [mm].
        length: of the flexible part, as drawn [mm].
        scale_z: printed over drawn.
    """
    height = scale_z * (below + length) + SUPPORT_HEIGHT
    longest = (_height(printer) - SUPPORT_HEIGHT) / scale_z - below
    remedy = f"the longest probe for a {printer.name} is {int(longest)} mm"
    return [
        _across("probe", printer, width, height),
        _upright("probe", printer, width, height, remedy if longest > 0 else ""),
    ]


def part_fits(part: str, printer: Printer, width: float, height: float) -> list[Finding]:
    """Return the findings on width and height [mm] of another part, as printed."""
    height += SUPPORT_HEIGHT
    return [_across(part, printer, width, height), _upright(part, printer, width, height, "")]


def _across(part: str, printer: Printer, width: float, height: float) -> Finding:
    room = _platform(printer)
    return BUILD_VOLUME.at_most(
        part, "width with its raft", width + 2 * RAFT_MARGIN, room, _smallest_printer(width, height)
    )


def _upright(part: str, printer: Printer, width: float, height: float, remedy: str) -> Finding:
    larger = _smallest_printer(width, height)
    remedies = "; ".join(filter(None, (remedy, larger)))
    return BUILD_VOLUME.at_most(part, "height with its supports", height, _height(printer), remedies)


def _smallest_printer(width: float, height: float) -> str:
    """Return which printer is the smallest that takes a part."""
    for printer in sorted(PRINTERS.values(), key=_volume):
        if width + 2 * RAFT_MARGIN <= _platform(printer) and height <= _height(printer):
            return f"it fits a {printer.name}"
    return "it fits no known printer"


def _platform(printer: Printer) -> float:
    return min(printer.build_volume_mm[:2])


def _height(printer: Printer) -> float:
    return printer.build_volume_mm[2]


def _volume(printer: Printer) -> float:
    x, y, z = printer.build_volume_mm
    return x * y * z


PART = "probe"


def probe_findings(geometry: ProbeGeometry) -> list[Finding]:
    """Return the findings on the flexible part above the flange, as drawn."""
    s, d = geometry.s / MM, 2.0 * geometry.radius / MM
    thin = geometry.cross_section.flatness * d
    flank = s <= geometry.flank_end / MM  # a rounded tip is not a wire
    findings = [
        _tip(s[flank], thin[flank]),
        _slenderness(s, thin),
        _overhang(s, d, geometry.cross_section.bore_ratio),
    ]
    if geometry.cross_section.hollow:
        findings += _bore(s, d, geometry.cross_section.bore_ratio)
    return findings


def flange_findings(adapter: SensorAdapter) -> list[Finding]:
    """Return the findings on the flange with its clocking hole."""
    flange, hole = adapter.flange, adapter.peg_hole_d
    web = (flange.diameter / 2 - adapter.peg_x - hole / 2) / MM
    supported, free = SUPPORTED_WALL, UNSUPPORTED_WALL
    return [
        SOFT_WALL.at_least(
            PART, "flange thickness", flange.thickness / MM, SOFT_FACTOR * free, free, "make it thicker"
        ),
        SOFT_WALL.at_least(
            PART, "flange between the clocking hole and its rim", web, SOFT_FACTOR * supported, supported,
            "inspect it after washing: it may tear or close",
        ),
        SOFT_HOLE.at_least(
            PART, "clocking hole in the flange", hole / MM, SOFT_FACTOR * MIN_HOLE_D, MIN_HOLE_D,
            "open it with a hand drill",
        ),
    ]  # fmt: skip


def _tip(s: Array, thin: Array) -> Finding:
    i = int(np.argmin(thin))
    return SMALLEST_FEATURE.at_least(
        PART, f"minimum thickness, at s = {s[i]:g} mm", float(thin[i]), MIN_THICKNESS,
        remedy=f"make it {MIN_THICKNESS:g} mm there",
    )  # fmt: skip


def _slenderness(s: Array, thin: Array) -> Finding:
    """Compare each knot's diameter with the height above it; between knots the ratio has no minimum."""
    height = s[-1] - s[:-1]
    ratio = thin[:-1] / height
    i = int(np.argmin(ratio))
    wanted = math.ceil(10 * GOOD_SLENDERNESS * height[i]) / 10
    return SLENDERNESS.at_least(
        PART, f"diameter at s = {s[i]:g} mm over the {height[i]:g} mm above it", float(ratio[i]),
        GOOD_SLENDERNESS, MIN_SLENDERNESS,
        remedy=f"make it {wanted:g} mm there, or {thin[i] / GOOD_SLENDERNESS:.3g} mm of length above it",
    )  # fmt: skip


def _overhang(s: Array, d: Array, bore_ratio: float) -> Finding:
    """Find the flattest downward surface: outside where the body widens, inside a bore where it narrows."""
    rise, out = np.diff(s), np.diff(d) / 2.0
    lean = np.maximum(out, -bore_ratio * out)
    angle = np.degrees(np.arctan2(rise, lean.clip(0.0)))
    i = int(np.argmin(angle))
    limit = 2.0 * rise[i] / (1.0 if out[i] >= 0.0 else bore_ratio or 1.0)  # 45 degrees
    return NO_OVERHANG.at_least(
        PART, f"surface from s = {s[i]:g} to {s[i + 1]:g} mm that faces down, angle to the horizontal",
        float(angle[i]), MIN_SOFT_OVERHANG, MIN_OVERHANG,
        remedy=f"change the diameter by at most {limit:.3g} mm there, or supports must be placed on it",
    )  # fmt: skip


def _bore(s: Array, d: Array, bore_ratio: float) -> list[Finding]:
    i = int(np.argmin(d))
    wall, bore = (1.0 - bore_ratio) * d[i] / 2.0, bore_ratio * d[i]
    at = f"at s = {s[i]:g} mm"
    return [
        SOFT_WALL.at_least(
            PART, f"wall {at}", float(wall), SOFT_FACTOR * SUPPORTED_WALL, SUPPORTED_WALL,
            "take a smaller bore_ratio or a wider tip"
        ),
        SOFT_HOLE.at_least(
            PART, f"bore {at}", float(bore), SOFT_FACTOR * MIN_HOLE_D, MIN_HOLE_D,
            "take a larger bore_ratio or a wider tip",
        ),
        TRAPPED_VOLUME.at_least(
            PART, f"bore {at}, as a drain hole", float(bore), MIN_DRAIN_D, 0.0,
            "flush it with a syringe before curing",
        ),
    ]  # fmt: skip


class Wall(NamedTuple):
    """A thin feature: its name, its thickness [m], and whether one of its sides is unsupported."""

    what: str
    thickness: float
    free: bool = False


def mount_findings(adapter: SensorAdapter, plate: FlangeAdapter) -> list[Finding]:
    """Return the findings on the rigid parts, as drawn."""
    parts = {
        "sensor_adapter": (_adapter_walls(adapter), _adapter_holes(adapter)),
        "clamp_ring": (_ring_walls(adapter), {"screw hole": M2.clearance_d}),
        "flange_adapter": (_plate_walls(plate), _plate_holes(plate)),
    }
    findings = [_peg(adapter)]
    for part, (walls, holes) in parts.items():
        findings += [_wall(part, wall) for wall in walls]
        findings += [_hole(part, what, d) for what, d in holes.items()]
    return findings


def _wall(part: str, wall: Wall) -> Finding:
    limit = UNSUPPORTED_WALL if wall.free else SUPPORTED_WALL
    return WALL.at_least(part, wall.what, wall.thickness / MM, limit, remedy="make it thicker")


def _hole(part: str, what: str, diameter: float) -> Finding:
    return OPEN_HOLE.at_least(part, what, diameter / MM, MIN_HOLE_D, remedy="make it wider")


def _peg(a: SensorAdapter) -> Finding:
    return SLENDERNESS.at_least(
        "sensor_adapter", "clocking peg, diameter over height", PEG_D / (a.peg_top - a.floor), GOOD_SLENDERNESS,
        remedy="make it thicker",
    )  # fmt: skip


def _adapter_walls(a: SensorAdapter) -> Iterator[Wall]:
    ring, rim, recess = _reach(a.p_ring_screws), a.body_d / 2, a.recess_d / 2
    pocket = a.nut_pocket_af / math.sqrt(3.0)  # to its corners
    tool, dowel, foot = _reach(a.p_tool_screws), _reach(a.p_dowels), a.foot_d / 2
    yield Wall("rim around the recess, at the flat", a.mark_x - recess, free=True)
    yield Wall("between ring screw and recess", ring - M2.clearance_d / 2 - recess)
    yield Wall("between nut pocket and rim", rim - ring - pocket, free=True)
    if ring - pocket < recess:  # the pocket extends below the recess
        yield Wall("between nut pocket and recess", a.floor - a.nut_pocket_top)
    yield Wall(
        "between sensor screw and edge of the foot", foot - tool - a.tool.screw.clearance_d / 2, free=True
    )
    yield Wall("between dowel hole and edge of the foot", foot - dowel - a.dowel_d / 2, free=True)
    yield Wall("over a dowel hole", a.floor - a.dowel_depth)
    yield Wall("under the heads of the sensor screws", a.tool.grip)


def _adapter_holes(a: SensorAdapter) -> dict[str, float]:
    return {"screw hole": M2.clearance_d, "dowel hole": a.dowel_d}


def _ring_walls(a: SensorAdapter) -> Iterator[Wall]:
    ring, hole = _reach(a.p_ring_screws), M2.clearance_d / 2
    yield Wall("thickness", a.ring_thickness, free=True)
    yield Wall("between screw hole and rim", a.body_d / 2 - ring - hole, free=True)
    yield Wall("between screw hole and bore", ring - hole - a.ring_bore_top_d / 2, free=True)


def _plate_walls(p: FlangeAdapter) -> Iterator[Wall]:
    robot, rim, pad = p.robot, p.plate_d / 2, p.pad_d / 2
    bolts, screws = _reach(p.p_bolts), _reach(p.p_mounting_screws)
    width, length = robot.pin_slot
    yield Wall("thickness", p.plate_top, free=True)
    yield Wall("between bolt and rim", rim - bolts - robot.screw.clearance_d / 2, free=True)
    if width > 0.0:
        yield Wall("between pin slot and rim", rim - math.hypot(bolts + length / 2, width / 2), free=True)
    yield Wall(
        "between sensor screw and edge of the pad", pad - screws - p.mounting.screw.clearance_d / 2, free=True
    )
    if robot.spigot[0] > 0.0:
        edge = robot.spigot[0] / 2 - screws - p.mounting.screw.counterbore_d / 2
        yield Wall("between a head's room and edge of the spigot", edge)
    yield Wall("under the heads of the sensor screws", p.mounting.grip)


def _plate_holes(p: FlangeAdapter) -> dict[str, float]:
    slot = {"pin slot": p.robot.pin_slot[0]} if p.robot.pin_slot[0] > 0.0 else {}
    return {"sensor screw hole": p.mounting.screw.clearance_d, "bolt hole": p.robot.screw.clearance_d, **slot}


def _reach(points: Iterable[XY]) -> float:
    """Return the distance of equal features from the axis [m]."""
    return max(math.hypot(*p) for p in points)
