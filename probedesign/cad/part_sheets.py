"""The drawing of each printed part: edges from its solid, dimensions from its data.

A rigid part has a section above, views from above and below under it, and its holes in a table.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from probedesign.cad.assembly import Part
from probedesign.cad.drawing import Drawing
from probedesign.cad.probe_sheet import probe_sheet
from probedesign.cad.projection import ABOVE, BELOW, Side, cut, seen
from probedesign.cad.sheet import (
    EDGE,
    WIDTH,
    Sheet,
    View,
    number,
    scale_for,
)
from probedesign.cad.title_block import BOTTOM, STACK, titled_sheet
from probedesign.mount.engraving import XY
from probedesign.mount.fasteners import M2_CLEARANCE_D, M2_COUNTERBORE_D, M2_GRIP
from probedesign.mount.sensor_adapter import PEG_D
from probedesign.units import MM


@dataclass(frozen=True)
class Holes:
    """Equal holes, tagged in a view and described under it.

    Attributes:
        points: (x, y) of each [m].
        size: largest diameter [m].
        words: what one of them is.
        on_circle: whether they lie on one that is drawn and told.
    """

    points: Sequence[XY]
    size: float
    words: str
    on_circle: bool = True

    @property
    def text(self) -> str:
        """How many, what, and where."""
        count = f"{len(self.points)} × " if len(self.points) > 1 else ""
        degrees = (number(float(np.degrees(np.arctan2(y, x))) % 360.0) for x, y in self.points)
        circle = 2 * float(np.hypot(*self.points[0]))
        where = f", on ⌀{_mm(circle)} at {', '.join(f'{d}°' for d in degrees)}" if self.on_circle else ""
        return f"{count}{self.words}{where}"


def sheets_of(drawing: Drawing) -> dict[str, bytes]:
    """The SVG drawing of each printed part, by the part's name."""
    drawers: dict[str, Callable[[Drawing, Part], Sheet]] = {
        "probe": probe_sheet,
        "sensor_adapter": _sensor_adapter,
        "clamp_ring": _clamp_ring,
        "flange_adapter": _flange_adapter,
    }
    return {name: bytes(draw(drawing, drawing.parts[name]).svg) for name, draw in drawers.items()}


def _sensor_adapter(drawing: Drawing, part: Part) -> Sheet:
    a, hole = drawing.adapter, f"⌀{_mm(M2_CLEARANCE_D)} through"
    above = [
        Holes(a.p_tool_screws, M2_COUNTERBORE_D, f"{hole}, ⌀{_mm(M2_COUNTERBORE_D)} from z = {_mm(M2_GRIP)} up"),
        Holes(a.p_ring_screws, M2_CLEARANCE_D, hole),
        Holes([(a.peg_x, 0.0)], PEG_D, f"peg ⌀{_mm(PEG_D)} at x = {_mm(a.peg_x)}, top at z = {_mm(a.peg_top)}", False),
    ]  # fmt: skip
    pocket = f"nut pocket {_mm(a.nut_pocket_af)} across flats, up to z = {_mm(a.nut_pocket_top)}"
    below = [
        Holes(a.p_ring_screws, a.nut_pocket_af, pocket),
        Holes(a.p_dowels, a.dowel_d, f"⌀{_mm(a.dowel_d)}, {_mm(a.dowel_depth)} deep"),
    ]
    heights, tops = [a.foot_height, a.floor, a.peg_top, a.body_top], [a.recess_d, a.body_d]
    notes = [f"flat at x = {_mm(a.mark_x)} shows +x; z = 0 rests on the sensor's tool face"]
    return _disc(drawing, part, (0.0, a.body_top), heights, tops, [a.foot_d], (above, below), notes)


def _clamp_ring(drawing: Drawing, part: Part) -> Sheet:
    a = drawing.adapter
    top = a.ring_thickness
    above = [Holes(a.p_ring_screws, M2_CLEARANCE_D, f"⌀{_mm(M2_CLEARANCE_D)} through")]
    tops, bottoms = [a.ring_bore_top_d, a.body_d], [a.ring_bore_d]
    notes = ["the wide end of the bore faces the tip"]
    return _disc(drawing, part, (0.0, top), [top], tops, bottoms, (above, []), notes)


def _flange_adapter(drawing: Drawing, part: Part) -> Sheet:
    p = drawing.plate
    spigot_d, spigot = p.robot.spigot
    width, length = p.robot.pin_slot
    reach = p.robot.bolt_circle_d / 2
    above = [
        Holes(p.p_bolts, p.robot.bolt_clearance_d, f"⌀{_mm(p.robot.bolt_clearance_d)} through"),
        Holes(p.p_mounting_screws, M2_CLEARANCE_D, f"⌀{_mm(M2_CLEARANCE_D)} through"),
    ]
    slot = f"slot {_mm(width)} × {_mm(length)} through, middle at x = {_mm(reach)}: the robot's dowel pin"
    bore = f"counterbore ⌀{_mm(M2_COUNTERBORE_D)} up to z = {_mm(p.counterbore_top)}"
    below = [Holes(p.p_mounting_screws, M2_COUNTERBORE_D, bore)]
    below += [Holes([(reach, 0.0)], 0.0, slot, False)] if width > 0.0 else []
    heights, bottoms = [-spigot, p.plate_top, p.pad_top], [spigot_d, p.plate_d]
    notes = [f"z = 0 rests on the robot: {p.robot.source}; the sensor sits on the pad ⌀{_mm(p.pad_d)}"]
    return _disc(drawing, part, (-spigot, p.pad_top), heights, [p.pad_d], bottoms, (above, below), notes)


def _disc(
    drawing: Drawing, part: Part, z: tuple[float, float], heights: Sequence[float],
    tops: Sequence[float], bottoms: Sequence[float],
    holes: tuple[list[Holes], list[Holes]], notes: list[str],
) -> Sheet:  # fmt: skip
    """A sheet of a flat part; all in [m]: its lowest and highest z, heights and diameters to write."""
    box = part.shape.BoundingBox()
    rim, low, high = max(box.xmax, -box.xmin, box.ymax), z[0] / MM, z[1] / MM
    scale = scale_for((2 * rim, high - low), (66.0, 60.0))
    sheet = titled_sheet(drawing, part, scale)
    top = EDGE + 14.0 + STACK * len(tops)
    section = View(sheet, (WIDTH / 2, top + scale * high), scale)
    edges, faces = cut(part.shape)
    section.hatch(faces)
    section.outline(edges)
    section.axis((0.0, low), (0.0, high))
    for i, h in enumerate(sorted(heights), 1):
        section.upright(min(0.0, h / MM), max(0.0, h / MM), rim, STACK * i, _mm(abs(h)))
    for i, d in enumerate(sorted(tops), 1):
        section.across(-d / 2 / MM, d / 2 / MM, high, STACK * i, f"⌀{_mm(d)}")
    for i, d in enumerate(sorted(bottoms), 1):
        section.across(-d / 2 / MM, d / 2 / MM, low, -STACK * i, f"⌀{_mm(d)}")
    section.caption("section in the plane y = 0", low, STACK * len(bottoms) + 9.0)
    middle = section.at((0.0, low))[1] + STACK * len(bottoms) + 9.0 + 26.0 + scale * rim
    _plans(sheet, part, holes, (rim, scale, middle))
    text = [f"{letter}  {hole.text}" for letter, hole in _lettered([*holes[0], *holes[1]])]
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


def _free(points: Sequence[XY], taken: Sequence[complex]) -> XY:
    """The point whose direction from the middle is farthest from those taken: tags must not meet."""

    def room(p: XY) -> float:
        return min((abs(float(np.angle(complex(*p) / other))) for other in taken), default=np.pi)

    return max(points, key=lambda p: round(room(p), 6))


def _lettered(holes: Iterable[Holes]) -> list[tuple[str, Holes]]:
    return [(chr(ord("A") + i), hole) for i, hole in enumerate(holes)]


def _mm(value: float) -> str:
    return number(value / MM)
