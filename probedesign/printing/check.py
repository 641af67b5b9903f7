"""Print check: rules with the sources of their limits, their findings on all parts, and scale compensation.

The check applies every rule to every part before anything is drawn. Lengths [mm], angles from the horizontal [deg].
Formlabs' published limits were measured on a Form 2 with rigid resin. Nothing is published for soft resin: twice the
rigid resin's figure is taken as good, the figure itself as the minimum.

Scale compensation enlarges printed parts by their shrinkage. It changes only the files to print: not the mechanics, the
fingerprint, the STEP file or the check of the drawn parts.
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple

import numpy as np

from probedesign.core.errors import InputError
from probedesign.core.frames import Array
from probedesign.core.units import MM
from probedesign.design import Design
from probedesign.design.catalog import GUIDE, PRINT_TOLERANCE, PRINTERS, Printer, PrintLimits
from probedesign.geometry import FLANGE_LIP, ProbeGeometry
from probedesign.mount import FlangeAdapter, Mount, SensorAdapter
from probedesign.mount.engraving import CELL, DEPTH, XY
from probedesign.mount.flange_adapter import TIE_SLOT
from probedesign.mount.lip import MAX_BENDING_SHARE
from probedesign.mount.sensor_adapter import MAX_OVERHANG, PEG_D
from probedesign.mount.tolerance_stack import clamp_force, tolerance_stacks

Severity = Literal["ok", "warning", "error"]
Confidence = Literal["high", "medium", "low"]
Bound = Literal["at least", "at most"]
ROUNDING = 1e-9  #: Relative tolerance: sums such as 1.75 - 1.05 are off in the sixteenth digit.


@dataclass(frozen=True)
class Finding:
    """The result of one rule on one part."""

    rule: str  #: name of the rule.
    part: str  #: of the export.
    severity: Severity  #: `error` is not expected to print; `warning` may fail or print badly.
    what: str  #: the measured feature.
    measured: float | None  #: its value in `unit`; None where the part could not be laid out.
    limit: float | None  #: the value it is compared with.
    bound: Bound  #: the side of the limit on which it must lie.
    unit: str  #: mm, mm², mm³, deg, N or 1.
    remedy: str  #: the nearest change that meets the limit; empty if the finding is ok.
    source: str  #: of the limit.
    confidence: Confidence  #: in the limit.

    def as_record(self) -> dict[str, Any]:
        """Return the finding as a dictionary for JSON and the manifest; numbers to a nanometre."""
        record = {key: value for key, value in vars(self).items() if value != ""}
        numbers = {key: record[key] for key in ("measured", "limit")}
        rounded = {key: None if value is None else round(value, 6) for key, value in numbers.items()}
        return record | rounded | {"message": self.message}

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
        worst = good if bad is None else bad
        room = ROUNDING * max(abs(good), abs(worst))
        if measured < worst - room:
            return self.finding(part, what, "error", remedy, measured, worst, "at least")
        return self.finding(
            part, what, "ok" if measured >= good - room else "warning", remedy, measured, good, "at least"
        )

    def at_most(
        self, part: str, what: str, measured: float, most: float, remedy: str = "", beyond: Severity = "error"
    ) -> Finding:
        """Return a finding of severity `beyond` above `most`."""
        return self.finding(
            part, what, beyond if measured > most + ROUNDING * abs(most) else "ok", remedy, measured, most
        )

    def finding(
        self, part: str, what: str, severity: Severity, remedy: str = "", measured: float | None = None,
        limit: float | None = None, bound: Bound = "at most",
    ) -> Finding:  # fmt: skip
        """Return a finding; without a number `what` is the whole message."""
        remedy = "" if severity == "ok" else remedy
        return Finding(
            self.name, part, severity, what, measured, limit, bound, self.unit, remedy, self.source, self.confidence
        )


# rules

DOUBLED = f"twice {GUIDE}, for soft resin (assumed)"

MAX_CUP_D = 10.0  #: Widest cup that the peel of a rigid resin stands [mm] (assumed).
#: Longest bridge without supports [mm]: about half of the guide's 21 mm for a beam 5 mm wide and 3 mm thick (assumed).
MAX_BRIDGE = 10.0

#: Raft of 2 mm and supports of 5 mm below the base, margin around it (assumed), and distance between parts.
SUPPORT_HEIGHT, RAFT_MARGIN, BETWEEN = 7.0, 5.0, 5.0
PLATFORM_SETUP = f"raft 2 mm, supports 5 mm, margin {RAFT_MARGIN:g} mm (assumed)"

SOFT_FACTOR = 2.0  #: Factor on a printer's limits of walls and holes for soft resin (assumed).
#: Diameter over the height above it: vertical wires print from Ø0.3 (7 mm tall) to Ø1.5 (30 mm tall).
GOOD_SLENDERNESS, MIN_SLENDERNESS = 0.05, 0.025
#: Lateral stiffness at the tip of its longest wire, Ø1.5 mm and 30 mm tall, 3 E I/L³ with E = 2.8 GPa (Grey V4) [N/m].
WIRE_STIFFNESS = 77.0
MIN_SOFT_OVERHANG = 45.0

BUILD_VOLUME = Rule("build_volume", "mm", f"PreForm's build volumes; {PLATFORM_SETUP}", "high")
STACK = Rule("tolerance_stack", "mm", "worst case of the tolerances of prints and bought parts", "high")
RING_BENDING = Rule("ring_bending", "mm", "Roark's formulas for annular plates, mean of two supports", "medium")
CLAMP = Rule("clamp_force", "N", "Gent and Lindley 1959, compared with finite elements", "medium")
SLENDERNESS = Rule("slenderness", "1", "wires of Formlabs' design guide; an error below half of it (assumed)", "low")
SMALLEST_FEATURE = Rule("smallest_feature", "mm", f"assumed beside {GUIDE}: nothing is published for soft resin", "low")
WALL = Rule("wall", "mm", GUIDE, "medium")
SOFT_WALL = Rule("wall", "mm", DOUBLED, "low")
OPEN_HOLE = Rule("hole", "mm", GUIDE, "medium")
SOFT_HOLE = Rule("hole", "mm", DOUBLED, "low")
NO_OVERHANG = Rule("overhang", "deg", f"{GUIDE}; a warning below {MIN_SOFT_OVERHANG:g} for soft resin (assumed)", "low")
TRAPPED_VOLUME = Rule("trapped_volume", "mm", f"drain hole of {GUIDE}", "medium")
LAYER_OVERHANG = Rule("overhang", "mm", "Formlabs' design guide: 1 mm, or 19° to the horizontal", "medium")
BRIDGE = Rule("bridge", "mm", "half of the 21 mm of Formlabs' design guide (assumed)", "low")
ISLAND = Rule("island", "mm", "what begins in mid-air is lost", "high")
CUP = Rule("cup", "mm", "assumed: suction of a shallow cup that a rigid resin stands", "low")
ENGRAVING = Rule("engraving", "mm", GUIDE, "low")
LAYER = Rule("layer", "mm", "the tolerance that the mount assumes of a printed height (assumed)", "medium")
MOUNT = Rule("mount", "mm", "the adapter's own dimensions", "high")


def size_findings(part: str, printer: Printer, width: float, height: float, remedy: str = "") -> list[Finding]:
    """Return the findings on width and height [mm] of a part, as printed, without raft and supports."""
    width, height = width + 2 * RAFT_MARGIN, height + SUPPORT_HEIGHT
    fitting = (
        f"it fits a {other.name}"
        for other in sorted(PRINTERS.values(), key=lambda other: math.prod(other.build_volume_mm))
        if width <= min(other.build_volume_mm[:2]) and height <= other.build_volume_mm[2]
    )
    larger = next(fitting, "it fits no known printer")
    x, y, z = printer.build_volume_mm
    return [
        BUILD_VOLUME.at_most(part, "width with its raft", width, min(x, y), larger),
        BUILD_VOLUME.at_most(part, "height with its supports", height, z, "; ".join(filter(None, (remedy, larger)))),
    ]


def longest_mm(design: Design, flange: float) -> float:
    """Return the largest length of a straight probe that fits upright [mm], for the thickness of its flange [m]."""
    return (design.printer.build_volume_mm[2] - SUPPORT_HEIGHT) / design.print_.scale_z - flange / MM


def probe_findings(geometry: ProbeGeometry, limits: PrintLimits) -> list[Finding]:
    """Return the findings on the flexible part above the flange, as drawn."""
    section, part = geometry.cross_section, "probe"
    s, d = geometry.s / MM, 2.0 * geometry.radius / MM
    thin, bore_ratio = section.flatness * d, section.bore_ratio
    flank = s <= geometry.flank_end / MM  # a rounded tip is not a wire
    i = int(np.argmin(thin[flank]))
    findings = [SMALLEST_FEATURE.at_least(
        part, f"minimum thickness, at s = {s[i]:g} mm", float(thin[i]), limits.soft_feature_mm,
        remedy=f"make it {limits.soft_feature_mm:g} mm there",
    )]  # fmt: skip
    # Each knot's diameter over the height above it; between knots the ratio has no minimum.
    height = s[-1] - s[:-1]
    ratio = thin[:-1] / height
    i = int(np.argmin(ratio))
    wanted = math.ceil(10 * GOOD_SLENDERNESS * height[i]) / 10
    findings.append(SLENDERNESS.at_least(
        part, f"diameter at s = {s[i]:g} mm over the {height[i]:g} mm above it", float(ratio[i]),
        GOOD_SLENDERNESS, MIN_SLENDERNESS,
        f"make it {wanted:g} mm there, or {thin[i] / GOOD_SLENDERNESS:.3g} mm of length above it",
    ))  # fmt: skip
    # The flattest downward surface: outside where the body widens, inside a bore where it narrows.
    rise, out = np.diff(s), np.diff(d) / 2.0
    angle = np.degrees(np.arctan2(rise, np.maximum(out, -bore_ratio * out).clip(0.0)))
    i = int(np.argmin(angle))
    limit = 2.0 * rise[i] / (1.0 if out[i] >= 0.0 else bore_ratio or 1.0)  # 45 degrees
    findings.append(NO_OVERHANG.at_least(
        part, f"surface from s = {s[i]:g} to {s[i + 1]:g} mm that faces down, angle to the horizontal",
        float(angle[i]), MIN_SOFT_OVERHANG, limits.overhang_deg,
        f"change the diameter by at most {limit:.3g} mm there, or supports must be placed on it",
    ))  # fmt: skip
    if not section.hollow:
        return findings
    i = int(np.argmin(d))
    wall, bore, at = (1.0 - bore_ratio) * float(d[i]) / 2.0, bore_ratio * float(d[i]), f"at s = {s[i]:g} mm"
    return [
        *findings,
        SOFT_WALL.at_least(part, f"wall {at}", wall, SOFT_FACTOR * limits.supported_wall_mm, limits.supported_wall_mm,
                           "take a smaller bore_ratio or a wider tip"),
        SOFT_HOLE.at_least(part, f"bore {at}", bore, SOFT_FACTOR * limits.hole_mm, limits.hole_mm,
                           "take a larger bore_ratio or a wider tip"),
        TRAPPED_VOLUME.at_least(part, f"bore {at}, as a drain hole", bore, limits.drain_mm, 0.0,
                                "flush it with a syringe before curing"),
    ]  # fmt: skip


def bounds(geometry: ProbeGeometry) -> Array:
    """Return the lowest and highest corner of the box around a probe and its flange in the base frame [m], (2, 3)."""
    s = np.unique(np.concatenate([geometry.s, np.linspace(0.0, geometry.length, 400)]))
    T, r, flange = geometry.axis.frames(s), geometry.radius_at(s)[:, None], geometry.flange
    # A section reaches r hypot(X, flatness Y) in each direction of the base frame.
    reach = r * np.hypot(T[:, :3, 0], geometry.cross_section.flatness * T[:, :3, 1])
    rim, p = flange.diameter / 2.0, T[:, :3, 3]
    return np.array([np.minimum((p - reach).min(axis=0), [-rim, -rim, -flange.thickness]),
                     np.maximum((p + reach).max(axis=0), [rim, rim, 0.0])])  # fmt: skip


class Scar(NamedTuple):
    """Where supports touch the body of a probe that is printed upright."""

    s_mm: XY  #: from where to where [mm].
    azimuth_deg: XY  #: of the side in the section there, from X, the clocking mark, towards Y, at both ends.
    hangs: bool  #: whether a curved body leans there by more than 45°; otherwise it is so soft that a peel moves it.

    @property
    def text(self) -> str:
        """Return where supports touch, and which sides stay free."""
        a, b = self.azimuth_deg
        turn = (b - a + 180.0) % 360.0 - 180.0
        side = f"{a:.0f}°" if abs(turn) < 1.0 else f"{a:.0f}° at the begin and {b:.0f}° at the end of that"
        return (
            f"from s = {self.s_mm[0]:.0f} to {self.s_mm[1]:.0f} mm at {side} from the clocking mark, from X towards Y "
            "in the section: sand the scar, and work with the sides at right angles to it"
        )


def lateral_stiffness(geometry: ProbeGeometry, modulus: float) -> Array:
    """Return arclengths [m] and the force there over its deflection, as if the axis were straight [N/m], (2, n)."""
    s = np.linspace(0.0, geometry.length, 400)
    d, section = 2.0 * geometry.radius_at(s), geometry.cross_section
    EI = modulus * np.pi / 64.0 * d**4 * (section.flatness**3 - section.bore_ratio**4)
    lever = np.maximum(s[1:, None] - s[:-1], 0.0)
    return np.stack([s[1:], 1.0 / (lever**2 / EI[:-1] * s[1]).sum(axis=1)])


def support_scar(geometry: ProbeGeometry, modulus: float) -> Scar | None:
    """Return where supports touch the body: below what hangs over, or else, leaning on one side, where a probe of
    modulus E [Pa] is softer than the longest wire that prints; None where no supports are needed."""
    s = np.linspace(0.0, geometry.length, 400)
    T = geometry.axis.frames(s)
    leans = np.flatnonzero(T[:, 2, 2] < math.cos(math.radians(MIN_SOFT_OVERHANG)))
    if not len(leans):
        at, stiffness = lateral_stiffness(geometry, modulus)
        soft = at[stiffness < WIRE_STIFFNESS] / MM
        return Scar((round(float(soft[0]), 1), geometry.length / MM), (180.0, 180.0), False) if len(soft) else None
    ends = leans[[0, -1]]
    # -z of the base frame in the axes of the section
    azimuths = np.degrees(np.arctan2(-T[ends, 2, 1], -T[ends, 2, 0])).round() + 0.0
    (first, last), (a, b) = s[ends] / MM, azimuths
    return Scar((float(first), float(last)), (float(a), float(b)), True)


def flange_findings(adapter: SensorAdapter, limits: PrintLimits) -> list[Finding]:
    """Return the findings on the flange with its clocking hole."""
    flange, hole, part = adapter.flange, adapter.peg_hole_d, "probe"
    web = (flange.diameter / 2 - adapter.peg_x - hole / 2) / MM
    return [
        SOFT_WALL.at_least(part, "flange thickness", flange.thickness / MM, SOFT_FACTOR * limits.wall_mm,
                           limits.wall_mm, "make it thicker"),
        SOFT_WALL.at_least(part, "flange between the clocking hole and its rim", web,
                           SOFT_FACTOR * limits.supported_wall_mm, limits.supported_wall_mm,
                           "inspect it after washing: it may tear or close"),
        SOFT_HOLE.at_least(part, "clocking hole in the flange", hole / MM, SOFT_FACTOR * limits.hole_mm, limits.hole_mm,
                           "open it with a hand drill"),
    ]  # fmt: skip


def mount_findings(a: SensorAdapter, plate: FlangeAdapter, limits: PrintLimits) -> list[Finding]:
    """Return the findings on the rigid parts, as drawn."""
    screw, robot = plate.mounting.screw, plate.robot
    ring, hole = _reach(a.p_ring_screws), a.ring_screw.clearance_d / 2
    dowel_d = a.dowel_d if a.p_dowels else 0.0
    ring_walls: Walls = [
        ("thickness", a.ring_thickness, limits.wall_mm),
        ("between screw hole and rim", a.body_d / 2 - ring - hole, limits.wall_mm),
        ("between screw hole and bore", ring - hole - a.ring_bore_top_d / 2, limits.wall_mm),
    ]
    parts = {
        "sensor_adapter": (_adapter_walls(a, limits), {"screw hole": 2 * hole, "dowel hole": dowel_d}),
        "clamp_ring": (ring_walls, {"screw hole": 2 * hole}),
        "flange_adapter": (_plate_walls(plate, limits), {"sensor screw hole": screw.clearance_d,
                                                 "bolt hole": robot.screw.clearance_d, "pin slot": robot.pin_slot[0]}),
    }  # fmt: skip
    nearest = min(math.dist((a.peg_x, 0.0), p) for p in a.p_tool_screws)
    findings = [
        LAYER.at_most("mount", "half a layer", limits.layer_mm / 2, PRINT_TOLERANCE / MM, "print thinner layers",
                      "warning"),
        ENGRAVING.at_least("mount", "strokes of the engraving, width and depth", min(CELL, DEPTH) / MM,
                           limits.engraving_mm, 0.0, "mark each part by hand as well"),
        SLENDERNESS.at_least("sensor_adapter", "clocking peg, diameter over height",
                             PEG_D / (a.peg_top - a.groove_floor), GOOD_SLENDERNESS, remedy="make it thicker"),
        ISLAND.at_least("sensor_adapter", "clocking peg, beside the room of a screw's head",
                        (nearest - PEG_D / 2 - a.tool.screw.counterbore_d / 2) / MM, 0.0,
                        remedy="change mount.flange_lip_mm"),
        LAYER_OVERHANG.at_most("sensor_adapter", "roof of a nut's slot beside the screw's hole",
                                  a.roof_overhang / MM, MAX_OVERHANG / MM, "take M2 screws", "warning"),
    ]  # fmt: skip
    # Voids whose width follows from sensor and robot: a roof, and those that the platform closes.
    (r0, r1), (v0, v1), _ = plate.cable_pocket
    cut = r1 >= plate.plate_d / 2  # the pocket is open at the rim
    pocket = v1 - v0 if cut else min(r1 - r0, v1 - v0)
    heads = "rooms of the screws' heads"
    for part, roof, span, cups in (
        ("sensor_adapter", "roof of a dowel hole", dowel_d,
         {heads: a.tool.screw.counterbore_d, "dowel holes": dowel_d}),
        ("flange_adapter", "roof of the cable's pocket", pocket,
         {heads: screw.counterbore_d, "pin slot": min(robot.pin_slot), "cable's pocket": 0.0 if cut else pocket}),
    ):  # fmt: skip
        findings.append(BRIDGE.at_most(part, roof, span / MM, MAX_BRIDGE, "supports must carry it", "warning"))
        findings += [CUP.at_most(part, f"{what}, cups on the platform", d / MM, MAX_CUP_D, "drill a vent", "warning")
                     for what, d in cups.items() if d > 0.0]  # fmt: skip
    for part, (walls, holes) in parts.items():
        for what, thickness, limit in walls:
            findings.append(WALL.at_least(part, what, thickness / MM, limit, remedy="make it thicker"))
        findings += [OPEN_HOLE.at_least(part, what, d / MM, limits.hole_mm, remedy="make it wider")
                     for what, d in holes.items() if d > 0.0]  # fmt: skip
    beyond = "beyond its limits at the worst corner of the tolerances"
    return findings + [STACK.at_most("mount", f"{stack.what}, {beyond}", stack.outside / MM, 0.0, stack.remedy)
                       for stack in tolerance_stacks(a, plate)]  # fmt: skip


def clamp_findings(a: SensorAdapter, plate: FlangeAdapter, modulus: float) -> list[Finding]:
    """Return the finding on the preload of the ring's screws: a warning where the tolerances of the lip's force reach
    it, an error where its nominal force does; modulus E of the probe's resin [Pa]."""
    clamp = clamp_force(a, plate, modulus)
    more = "" if a.ring_screw.thread == "M3" else 'set mount.ring_screw = "M3", '
    narrower = "reduce mount.flange_lip_mm, " if a.options.lip > FLANGE_LIP else ""
    remedy = f"{more}{narrower}or increase mount.flange_thickness_mm".removeprefix("or ")
    what = f"preload of the ring's {clamp.screws} screws at {clamp.torque:g} N·m, to compress the flange's lip"
    return [
        CLAMP.at_least("mount", what, clamp.preload, clamp.range[1], clamp.nominal, remedy),
        RING_BENDING.at_most("clamp_ring", "bending under the force of the lip, instead of compressing it",
                                sum(clamp.bending) / 2 / MM, MAX_BENDING_SHARE * clamp.squeeze / MM,
                                f"{more}increase mount.flange_thickness_mm, or reduce probe.base_d_mm", "warning"),
    ]  # fmt: skip


Walls = list[tuple[str, float, float]]  #: Thin features: name, thickness [m] and its limit [mm].


def _adapter_walls(a: SensorAdapter, limits: PrintLimits) -> Walls:
    ring, rim, recess, roof_hole = _reach(a.p_ring_screws), a.body_d / 2, a.recess_d / 2, a.roof_hole_d / 2
    hole, inner = a.ring_screw.clearance_d / 2, ring - a.nut_slot_reach - a.nut_slot_width / 2
    tool, dowel, foot = _reach(a.p_tool_screws), _reach(a.p_dowels), a.foot_d / 2
    land = a.land_d / 2 - tool - a.tool.screw.counterbore_d / 2  # below zero its edge crosses the heads' room
    apart = min((math.dist(p, q) for p in a.p_tool_screws for q in a.p_dowels), default=0.0)
    apart -= (a.tool.screw.counterbore_d + a.dowel_d) / 2
    # The cone below a ring screw's blind hole, and below the floor of a nut's slot at the rim.
    cone = a.foot_height + (ring + hole - a.cone_d / 2) * (a.cone_top - a.foot_height) / (rim - a.cone_d / 2)
    return [
        ("rim around the recess, at the flat", a.mark_x - recess, limits.wall_mm),
        ("between ring screw and recess", ring - roof_hole - recess, limits.supported_wall_mm),
        ("between ring screw and rim", rim - ring - roof_hole, limits.wall_mm),
        ("between nut slot and recess", inner - recess, limits.supported_wall_mm),
        ("above a nut", a.nut_roof, limits.supported_wall_mm),
        ("below a nut slot, at the rim", a.nut_slot_z[0] - a.cone_top, limits.wall_mm),
        ("below a ring screw's hole", a.ring_hole_bottom - cone, limits.supported_wall_mm),
        ("between sensor screw and edge of the foot", foot - tool - a.tool.screw.clearance_d / 2, limits.wall_mm),
        *([("between a head's room and edge of the land", land, limits.wall_mm)] if land >= 0.0 else []),
        *(
            [
                ("between dowel hole and edge of the foot", foot - dowel - a.dowel_d / 2, limits.wall_mm),
                ("over a dowel hole", a.groove_floor - a.dowel_depth, limits.supported_wall_mm),
                ("between dowel hole and a head's room", apart, limits.supported_wall_mm),
            ]
            if a.p_dowels
            else []
        ),
        ("below the groove, at the notch", a.groove_floor - a.cone_top, limits.wall_mm),
        ("under the heads of the sensor screws", a.tool.grip, limits.supported_wall_mm),
    ]


def _plate_walls(p: FlangeAdapter, limits: PrintLimits) -> Walls:
    robot, rim, screw = p.robot, p.plate_d / 2, p.mounting.screw
    bolts, screws = _reach(p.p_bolts), _reach(p.p_mounting_screws)
    (width, length), spigot_d = robot.pin_slot, robot.spigot[0]
    walls = [
        ("thickness", p.plate_top, limits.wall_mm),
        ("between bolt and rim", rim - bolts - robot.screw.clearance_d / 2, limits.wall_mm),
        ("between the opening for the cable tie and rim", rim - _reach(p.p_tie_slots) - max(TIE_SLOT) / 2,
         limits.wall_mm),
        ("under the heads of the sensor screws", p.mounting.grip, limits.supported_wall_mm),
    ]  # fmt: skip
    if width > 0.0:
        slot = rim - math.hypot(bolts + length / 2, width / 2)
        walls.append(("between pin slot and rim", slot, limits.wall_mm))
    if p.p_centring_pins and p.centring_hole[1] < p.counterbore_top:
        nearest = min(math.dist(a, b) for a in p.p_centring_pins for b in p.p_mounting_screws)
        apart = nearest - p.centring_hole[0] / 2 - screw.counterbore_d / 2
        walls.append(("between pin and head's room", apart, limits.supported_wall_mm))
    if spigot_d > 0.0:
        edge = spigot_d / 2 - screws - screw.counterbore_d / 2
        walls.append(("between a head's room and edge of the spigot", edge, limits.supported_wall_mm))
    return walls


def _reach(points: Iterable[XY]) -> float:
    """Return the distance of equal features from the axis [m]; 0 without any."""
    return max((math.hypot(*p) for p in points), default=0.0)


def print_scale(design: Design, part: str) -> tuple[float, float, float]:
    """Return the printed size over the drawn size, along x, y and z, of a printed part."""
    of = design.print_
    xy, z = (of.scale_xy, of.scale_z) if part == "probe" else (of.rigid_scale_xy, of.rigid_scale_z)
    return xy, xy, z


def scale_note(design: Design, part: str) -> str:
    """Return the note for a part's file; empty if the part is printed as drawn."""
    scale, offset = print_scale(design, part), design.print_.offset_xy_mm if part == "probe" else 0.0
    narrower = f" offset {-offset:g}" if offset else ""
    return (
        "" if scale == (1.0, 1.0, 1.0) and not offset else f" scaled {scale[0]:g} {scale[1]:g} {scale[2]:g}{narrower}"
    )


class Orientation(NamedTuple):
    """How a part stands on the platform."""

    side: Literal["upright", "upside down"]  #: whether its z axis points away from the platform or towards it.
    rests_on: str  #: the face on the platform.
    supports: bool = False  #: whether it stands on a raft and supports instead of directly on the platform.

    @property
    def upright(self) -> bool:
        """Return whether the part's z axis points away from the platform."""
        return self.side == "upright"


#: The orientation of each part. A test cuts the rigid parts of every known sensor and flange into layers: nothing
#: hangs, begins in mid-air or encloses resin, so that no supports touch a face that carries a dimension. What another
#: sensor or flange can change of this has the rules `bridge`, `island` and `cup`.
ORIENTATIONS = {
    "probe": Orientation("upright", "its flange", supports=True),
    "sensor_adapter": Orientation("upright", "its foot"),
    "clamp_ring": Orientation("upright", "its underside"),
    "flange_adapter": Orientation("upside down", "the sensor's seat"),
}


@dataclass(frozen=True)
class PrintCheck:
    """The findings of all rules on a design."""

    name: str  #: of the design.
    fingerprint: str  #: of its geometry.
    printer: str  #: printer, resin: the rules depend on.
    resin: str
    findings: tuple[Finding, ...]  #: one per rule and feature, passed ones included.
    layer_mm: float  #: height of a layer.
    scar: Scar | None  #: where supports touch the body of the probe.
    advice: tuple[str, ...]  #: for what no rule can measure.
    post_processing: Mapping[str, str]  #: what to do with the print of the probe, by step, in order.
    #: parts of each platform, the probe's first, with the position of their axes from its corner [mm].
    platforms: tuple[dict[str, XY], ...]

    @property
    def errors(self) -> list[Finding]:
        """Return the findings that are not expected to print."""
        return [finding for finding in self.findings if finding.severity == "error"]

    @property
    def warnings(self) -> list[Finding]:
        """Return the findings that may fail or print badly."""
        return [finding for finding in self.findings if finding.severity == "warning"]

    @property
    def passed(self) -> list[Finding]:
        """Return the findings that meet their limit."""
        return [finding for finding in self.findings if finding.severity == "ok"]

    @property
    def fits(self) -> bool:
        """Return whether the flexible part fits the printer's build volume."""
        return not any(f.rule == BUILD_VOLUME.name and f.part == "probe" for f in self.errors)

    def as_record(self) -> dict[str, Any]:
        """Return the check for JSON and the manifest, without the passed findings."""
        return {
            "ok": not self.errors,
            "printer": self.printer,
            "resin": self.resin,
            "layer_mm": self.layer_mm,
            "errors": len(self.errors),
            "warnings": len(self.warnings),
            "findings": [f.as_record() for f in (*self.errors, *self.warnings)],
            "advice": list(self.advice),
            "scar": None if self.scar is None else self.scar._asdict(),
            "post_processing": dict(self.post_processing),
            "orientation": {part: {**stands._asdict(), "z_direction": [0.0, 0.0, 1.0 if stands.upright else -1.0]}
                            for part, stands in ORIENTATIONS.items()},
            "platforms": [{part: list(axis) for part, axis in platform.items()} for platform in self.platforms],
        }  # fmt: skip


def check_print(design: Design) -> PrintCheck:
    """Check a design against the rules of its printer and of both resins."""
    mount, printer, limits = Mount.of(design), design.printer, design.printer.limits
    geometry, scale = mount.geometry, print_scale(design, "probe")
    low, high = np.array(scale) * bounds(geometry) / MM
    width, height = float((high - low)[:2].max()), float(high[2] - low[2])
    longest = longest_mm(design, geometry.flange.thickness)
    straight = geometry.axis.is_straight
    remedy = f"the longest probe for a {printer.name} is {int(longest)} mm" if longest > 0 and straight else ""
    findings = [*size_findings("probe", printer, width, height, remedy), *probe_findings(geometry, limits)]
    modulus, scar = design.youngs_modulus.value, support_scar(geometry, design.youngs_modulus.value)
    platforms = packed({"probe": width}, printer)
    x, y = np.round(np.array(platforms[0]["probe"]) - (low + high)[:2] / 2, 3).tolist()
    platforms[0]["probe"] = (x, y)
    plate = mount.flange_adapter
    try:
        a = mount.sensor_adapter
    except InputError as error:
        findings.append(MOUNT.finding("clamp_ring", str(error), "error"))
    else:
        findings += [*flange_findings(a, limits), *mount_findings(a, plate, limits)]
        findings += clamp_findings(a, plate, modulus)
        sx, _, sz = print_scale(design, "rigid parts")
        rigid = {
            "flange_adapter": (plate.plate_d, plate.plate_top + plate.robot.spigot[1]),
            "sensor_adapter": (a.body_d, a.body_top),
            "clamp_ring": (a.body_d, a.ring_thickness),
        }
        for part, (width, height) in rigid.items():
            findings += size_findings(part, printer, sx * width / MM, sz * height / MM)
        platforms += packed({part: sx * width / MM for part, (width, _) in rigid.items()}, printer)
    upright = f"print the probe upright on its flange, {limits.layer_mm:g} mm layers, supports below the flange"
    lateral = lateral_stiffness(geometry, modulus)[1, -1]
    advice = (
        f"{upright} and below the bend, {scar.text}" if scar is not None and scar.hangs else f"{upright} only",
        *([f"its tip has a lateral stiffness of {lateral:.2g} N/m, that of the guide's longest rigid wire divided by "
           f"{WIRE_STIFFNESS / lateral:.0f}: if the peel or the wiper moves it, lean supports on one side, {scar.text}"]
          if scar is not None and not scar.hangs else []),
        *(
            f"print the {part.replace('_', ' ')} {stands.side}, on {stands.rests_on}, without supports and raft"
            for part, stands in ORIENTATIONS.items()
            if not stands.supports
        ),
        *([f"the rigid parts do not fit on one platform of a {printer.name}: print all {len(platforms) - 1} packages, "
           f"adapters.3mf to adapters_{len(platforms) - 1}.3mf"] if len(platforms) > 2 else []),
    )  # fmt: skip
    post = design.resin.post
    marks = "" if scar is None else f"; on the body, where there were any, {scar.text}"
    hung = (
        "hang it by its flange, the tip down, or lay it in a V-groove: lying flat, its weight bends it"
        if straight
        else "upright on its flange on its supports, which hold the bend: hanging or lying down "
        "its own weight would change it"
    )
    axis = "" if straight else "; measure its axis too (measured --axis): it places the firmer touches"
    post_processing = {
        "wash": post.wash,
        "dry": post.dry,
        "cure": f"{post.cure}; {hung}",
        "supports": f"trim their marks on the flange's underside flush{marks}",
        "calipers": f"washed, dried and cured, and not before: the diameters determine the stiffness{axis}",
        "ageing": post.ageing,
        "storage": post.storage,
    }
    if (source := limits.source) != GUIDE:
        findings = [replace(finding, source=finding.source.replace(GUIDE, source)) for finding in findings]
    return PrintCheck(
        design.name, geometry.fingerprint, printer.name, design.resin.name, tuple(findings), limits.layer_mm, scar,
        advice, post_processing, tuple(platforms),
    )  # fmt: skip


def packed(diameters_mm: Mapping[str, float], printer: Printer) -> list[dict[str, XY]]:
    """Return the parts of each platform with the position of their axes from its corner [mm].

    Args:
        diameters_mm: of the parts, the widest first.
        printer: whose platform they are on, in rows about its middle, `BETWEEN` apart and `RAFT_MARGIN` from its edges.
    """
    width, depth = (side - 2 * RAFT_MARGIN for side in printer.build_volume_mm[:2])
    platforms: list[dict[str, XY]] = [{}]
    x = y = row = 0.0
    for part, d in diameters_mm.items():
        if x > 0.0 and x + d > width:
            x, y, row = 0.0, y + row + BETWEEN, 0.0
        widest = max((diameters_mm[other] for other in platforms[-1]), default=0.0)
        if widest > min(width, depth) or (y > 0.0 and y + d > depth):  # one that is too wide lies alone
            platforms.append({})
            x = y = row = 0.0
        platforms[-1][part] = (x + d / 2, y + d / 2)
        x, row = x + d + BETWEEN, max(row, d)
    for platform in platforms:
        axes, radii = np.array([*platform.values()]), np.array([[diameters_mm[part] / 2] for part in platform])
        middle = ((axes - radii).min(axis=0) + (axes + radii).max(axis=0)) / 2
        centred = np.round(axes - middle + np.array(printer.build_volume_mm[:2]) / 2, 3).tolist()
        platform.update({part: (x, y) for part, (x, y) in zip(platform, centred, strict=True)})
    return platforms
