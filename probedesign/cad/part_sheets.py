"""The drawing of each printed part: what it looks like, and the dimensions that its data give, not its solid."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from probedesign.cad.assembly import Part
from probedesign.cad.drawing import Drawing
from probedesign.cad.projection import ABOVE, BELOW, FRONT, Side, cut, seen
from probedesign.cad.sheet import (
    EDGE,
    HEIGHT,
    SMALL,
    TITLE_HEIGHT,
    WIDTH,
    Sheet,
    View,
    number,
    scale_for,
    scale_text,
)
from probedesign.materials import RIGID_RESIN
from probedesign.mounting.adapter import PEG_D
from probedesign.mounting.fasteners import M2_CLEARANCE_D, M2_COUNTERBORE_D, M2_GRIP
from probedesign.mounting.prism import Point
from probedesign.units import MM

TOLERANCE = "±0.5 %, at least ±0.15 (assumed)"
"""What a stereolithography print holds; the printer's maker publishes none for the soft resin."""
BOTTOM = HEIGHT - EDGE - TITLE_HEIGHT
SPACED = 7.0
"""Paper between two notes beside each other."""
STACK = 7.5
"""From one dimension line to the next."""


@dataclass(frozen=True)
class Holes:
    """Equal holes, tagged in a view and described under it.

    Attributes:
        points: (x, y) of each [m].
        size: largest diameter [m].
        words: what they are.
        on_circle: whether their circle is drawn.
    """

    points: Sequence[Point]
    size: float
    words: str
    on_circle: bool = True


def sheets_of(drawing: Drawing) -> dict[str, bytes]:
    """The SVG drawing of each printed part, by the part's name."""
    drawers: dict[str, Callable[[Drawing, Part], Sheet]] = {
        "probe": _probe,
        "sensor_adapter": _sensor_adapter,
        "clamp_ring": _clamp_ring,
        "flange_adapter": _flange_adapter,
    }
    return {name: bytes(draw(drawing, drawing.parts[name]).svg) for name, draw in drawers.items()}


def _sheet(drawing: Drawing, part: Part, scale: float) -> Sheet:
    resin = drawing.design.resin.name if part.name == "probe" else RIGID_RESIN
    return Sheet(f"{drawing.design.name}: {part.name.replace('_', ' ')}", [
        ("geometry", drawing.geometry.fingerprint), ("material", resin), ("file", f"{part.name}.stl"),
        ("scale", scale_text(scale)), ("units", "mm"), ("frame", part.frame.replace("_", " ")),
        ("tolerance", TOLERANCE), ("angles", "about +z from +x, seen from above"),
    ])  # fmt: skip


# ---- the probe: upright, with its underside beside it


def _probe(drawing: Drawing, part: Part) -> Sheet:
    g = drawing.geometry
    length, rim, thick = g.length / MM, g.flange.diameter / MM, g.flange.thickness / MM
    scale = scale_for((rim, length + thick), (70.0, BOTTOM - EDGE - 50.0))
    sheet = _sheet(drawing, part, scale)
    middle = (EDGE + BOTTOM) / 2
    front = View(sheet, (90.0, middle + scale * (length - thick) / 2), scale)
    front.outline(seen(part.shape, FRONT))
    front.axis((0.0, -thick), (0.0, length))
    front.upright(0.0, length, rim / 2, 2 * STACK, number(length), top_u=g.tip_radius / MM)
    front.upright(-thick, 0.0, rim / 2, STACK, number(thick))
    front.across(-rim / 2, rim / 2, -thick, -STACK, f"⌀{number(rim)}")
    for s, r, words in _stations(drawing, SPACED / scale):
        front.pointed((-r, s), (-10.0 - scale * (rim / 2 - r), 5.0), words)
    front.caption("from the front (+x to the right)", -thick, 18.0)
    _underside(drawing, part, sheet)
    return sheet


def _stations(drawing: Drawing, apart: float) -> Iterable[tuple[float, float, str]]:
    """Height and half-width [mm] of the ends, and of the knots that are so far apart, with their dimensions.

    A plain taper has none: there, one in brackets to measure halfway.
    """
    g = drawing.geometry
    knots = [(float(s) / MM, float(r) / MM) for s, r in zip(g.s, g.radius, strict=True)]
    last = -apart
    for s, r in knots:
        if s - last >= apart and (knots[-1][0] - s >= apart or s == knots[-1][0]):
            yield s, r, f"{_width(drawing, r)} at s = {number(s)}"
            last = s
    if len(knots) == 2:
        s, r = g.length / 2 / MM, float(g.radius_at(g.length / 2)) / MM
        yield s, r, f"({_width(drawing, r)}) at s = {number(s)}"


def _width(drawing: Drawing, r: float) -> str:
    section = drawing.geometry.cross_section
    if section.hollow:
        return f"⌀{number(2 * r)} / bore {number(2 * r * section.bore_ratio)}"
    if section.flatness != 1.0:
        return f"{number(2 * r)} × {number(2 * r * section.flatness)}"
    return f"⌀{number(2 * r)}"


def _underside(drawing: Drawing, part: Part, sheet: Sheet) -> None:
    a, rim = drawing.adapter, drawing.geometry.flange.diameter / MM
    scale = scale_for((rim, rim), (46.0, 46.0))
    view = View(sheet, (163.0, (EDGE + BOTTOM) / 2), scale)
    view.outline(seen(part.shape, BELOW))
    view.axis((-rim / 2, 0.0), (rim / 2, 0.0))
    view.axis((0.0, -rim / 2), (0.0, rim / 2))
    peg = a.peg_x / MM
    view.across(0.0, peg, rim / 2, STACK, number(peg))
    view.caption(f"from below, {scale_text(scale)}", -rim / 2)
    x, y = view.at((-rim / 2, -rim / 2))
    sheet.note((x, y + 20.0), [
        f"hole ⌀{number(a.peg_hole_d / MM)} through the flange:",
        "it marks +x of the base frame;",
        "s = 0 is the flange's top",
    ], SMALL)  # fmt: skip


# ---- the rigid parts: a section above, views from above and below under it


def _sensor_adapter(drawing: Drawing, part: Part) -> Sheet:
    a, sensor = drawing.adapter, drawing.design.sensor_model
    heights = [a.foot_height, a.floor, a.peg_top, a.body_top]
    tops = [(a.recess_d, "⌀"), (a.body_d, "⌀")]
    above = [
        Holes(a.p_tool_screws, M2_COUNTERBORE_D,
              f"3 × ⌀{_mm(M2_CLEARANCE_D)} through, ⌀{_mm(M2_COUNTERBORE_D)} from z = {_mm(M2_GRIP)} up, "
              f"on ⌀{_mm(a.tool.bolt_circle_d)} at {_degrees(a.p_tool_screws)}"),
        Holes(a.p_ring_screws, M2_CLEARANCE_D, f"4 × ⌀{_mm(M2_CLEARANCE_D)} through, on ⌀{_circle(a.p_ring_screws)} "
              f"at {_degrees(a.p_ring_screws)}"),
        Holes([(a.peg_x, 0.0)], PEG_D, f"peg ⌀{_mm(PEG_D)} at x = {_mm(a.peg_x)}, top at z = {_mm(a.peg_top)}", False),
    ]  # fmt: skip
    below = [
        Holes(a.p_ring_screws, a.nut_pocket_af, f"4 × nut pocket {_mm(a.nut_pocket_af)} across flats, "
              f"up to z = {_mm(a.nut_pocket_top)}"),
        Holes(a.p_dowels, a.dowel_d, f"{len(a.p_dowels)} × ⌀{_mm(a.dowel_d)}, {_mm(a.dowel_depth)} deep, "
              f"at {_degrees(a.p_dowels)}"),
    ]  # fmt: skip
    notes = [
        f"flat at x = {_mm(a.mark_x)} shows +x; z = 0 rests on the sensor's tool face (⌀{_mm(sensor.body_d)})"
    ]
    return _disc(drawing, part, (0.0, a.body_top), heights, tops, [(a.foot_d, "⌀")], (above, below), notes)


def _clamp_ring(drawing: Drawing, part: Part) -> Sheet:
    a = drawing.adapter
    above = [Holes(a.p_ring_screws, M2_CLEARANCE_D, f"4 × ⌀{_mm(M2_CLEARANCE_D)} through, "
                   f"on ⌀{_circle(a.p_ring_screws)} at {_degrees(a.p_ring_screws)}")]  # fmt: skip
    tops, bottoms = [(a.ring_bore_top_d, "⌀"), (a.body_d, "⌀")], [(a.ring_bore_d, "⌀")]
    notes = ["the wide end of the bore faces the tip"]
    return _disc(
        drawing, part, (0.0, a.ring_thickness), [a.ring_thickness], tops, bottoms, (above, []), notes
    )


def _flange_adapter(drawing: Drawing, part: Part) -> Sheet:
    p = drawing.plate
    spigot_d, spigot = p.robot.spigot
    width, length = p.robot.pin_slot
    above = [
        Holes(p.p_bolts, p.robot.bolt_clearance_d, f"{len(p.p_bolts)} × ⌀{_mm(p.robot.bolt_clearance_d)} through, "
              f"on ⌀{_mm(p.robot.bolt_circle_d)} at {_degrees(p.p_bolts)}"),
        Holes(p.p_mounting_screws, M2_CLEARANCE_D, f"3 × ⌀{_mm(M2_CLEARANCE_D)} through, "
              f"on ⌀{_circle(p.p_mounting_screws)} at {_degrees(p.p_mounting_screws)}"),
    ]  # fmt: skip
    below = [
        Holes(p.p_mounting_screws, M2_COUNTERBORE_D, f"3 × counterbore ⌀{_mm(M2_COUNTERBORE_D)} "
              f"up to z = {_mm(p.counterbore_top)}"),
        Holes([(p.robot.bolt_circle_d / 2, 0.0)], 0.0, f"slot {_mm(width)} × {_mm(length)} through, "
              f"middle at x = {_mm(p.robot.bolt_circle_d / 2)}: the robot's dowel pin", False),
    ]  # fmt: skip
    notes = [f"z = 0 rests on the robot: {p.robot.source}; the sensor sits on the pad ⌀{_mm(p.pad_d)}"]
    return _disc(drawing, part, (-spigot, p.pad_top), [-spigot, p.plate_top, p.pad_top], [(p.pad_d, "⌀")],
                 [(spigot_d, "⌀"), (p.plate_d, "⌀")], (above, below), notes)  # fmt: skip


def _disc(
    drawing: Drawing, part: Part, z: tuple[float, float], heights: Sequence[float],
    tops: Sequence[tuple[float, str]], bottoms: Sequence[tuple[float, str]],
    holes: tuple[list[Holes], list[Holes]], notes: list[str],
) -> Sheet:  # fmt: skip
    """A sheet of a flat part; all in [m]: its lowest and highest z, heights and diameters to write."""
    box = part.shape.BoundingBox()
    rim, low, high = max(box.xmax, -box.xmin, box.ymax), z[0] / MM, z[1] / MM
    scale = scale_for((2 * rim, high - low), (66.0, 60.0))
    sheet = _sheet(drawing, part, scale)
    top = EDGE + 14.0 + STACK * len(tops)
    section = View(sheet, (WIDTH / 2, top + scale * high), scale)
    edges, faces = cut(part.shape)
    section.hatch(faces)
    section.outline(edges)
    section.axis((0.0, low), (0.0, high))
    for i, h in enumerate(sorted(heights), 1):
        section.upright(min(0.0, h / MM), max(0.0, h / MM), rim, STACK * i, _mm(abs(h)))
    for i, (d, sign) in enumerate(sorted(tops), 1):
        section.across(-d / 2 / MM, d / 2 / MM, high, STACK * i, sign + _mm(d))
    for i, (d, sign) in enumerate(sorted(bottoms), 1):
        section.across(-d / 2 / MM, d / 2 / MM, low, -STACK * i, sign + _mm(d))
    section.caption("section in the plane y = 0", low, STACK * len(bottoms) + 9.0)
    middle = section.at((0.0, low))[1] + STACK * len(bottoms) + 9.0 + 26.0 + scale * rim
    _plans(sheet, part, holes, (rim, scale, middle))
    text = [f"{letter}  {hole.words}" for letter, hole in _lettered([*holes[0], *holes[1]])]
    sheet.note((EDGE + 6.0, BOTTOM - 5.0 * (len(text) + len(notes))), [*text, *notes])
    return sheet


def _plans(
    sheet: Sheet, part: Part, holes: tuple[list[Holes], list[Holes]], where: tuple[float, float, float]
) -> None:
    """The views from above and, where it has something to show, from below, at one height of the paper."""
    rim, scale, y = where
    lettered = _lettered([*holes[0], *holes[1]])
    views: list[tuple[str, Side, list[tuple[str, Holes]]]] = [("above", ABOVE, lettered[: len(holes[0])])]
    if holes[1]:
        views.append(("below", BELOW, lettered[len(holes[0]) :]))
    for i, (name, side, tagged) in enumerate(views):
        view = View(
            sheet, (WIDTH * (2 * i + 1) / (2 * len(views)) + (5.0 - 10.0 * i) * (len(views) - 1), y), scale
        )
        view.outline(seen(part.shape, side))
        view.axis((-rim, 0.0), (rim, 0.0))
        view.axis((0.0, -rim), (0.0, rim))
        flip = -1.0 if side is BELOW else 1.0
        taken: list[complex] = []
        for letter, hole in tagged:
            points = [(x / MM, flip * v / MM) for x, v in hole.points]
            if hole.on_circle:
                view.bolt_circle(2 * float(np.hypot(*points[0])))
            view.centres(points, 0.6 * hole.size / MM)
            chosen = _free(points, taken)
            taken.append(complex(*chosen))
            view.tag(chosen, rim, letter)
        view.caption(f"from {name}, +x to the right", -rim, 18.0)


def _free(points: Sequence[Point], taken: Sequence[complex]) -> Point:
    """The point whose direction from the middle is farthest from those taken: tags must not meet."""

    def room(p: Point) -> float:
        return min((abs(float(np.angle(complex(*p) / other))) for other in taken), default=np.pi)

    return max(points, key=lambda p: round(room(p), 6))


def _lettered(holes: Iterable[Holes]) -> list[tuple[str, Holes]]:
    return [(chr(ord("A") + i), hole) for i, hole in enumerate(holes)]


def _mm(value: float) -> str:
    return number(value / MM)


def _circle(points: Sequence[Point]) -> str:
    return _mm(2 * float(np.hypot(*points[0])))


def _degrees(points: Sequence[Point]) -> str:
    return ", ".join(f"{number(float(np.degrees(np.arctan2(y, x))) % 360.0)}°" for x, y in points)
