"""Technical drawing of each printed part: edges from its solid, dimensions from its data.

A rigid part has a section on top, views from above and below under it, and a table of its holes.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from probedesign.cad.model import CadModel, CadPart
from probedesign.cad.sheet import (
    ABOVE,
    BELOW,
    EDGE,
    FRONT,
    HEIGHT,
    SMALL,
    TITLE_HEIGHT,
    WIDTH,
    Sheet,
    SheetView,
    ViewDirection,
    cut,
    number,
    scale_for,
    scale_text,
    seen,
)
from probedesign.core.units import MM
from probedesign.design.catalog import ALUMINIUM, MILLED_TOLERANCE, RIGID_RESIN
from probedesign.mount.engraving import XY
from probedesign.mount.flange_adapter import TIE_SLOT
from probedesign.mount.sensor_adapter import DOWEL_SLOT, PEG_D, UNDERSIDE_DEG, VENT_WIDTH

TOLERANCE = "±0.5 %, at least ±0.15 (assumed)"
"""Tolerance of a stereolithography print; the manufacturer publishes none for the soft resin."""
MILLED = f"±{number(MILLED_TOLERANCE / MM)} (ISO 2768-1, fine)"
BOTTOM = HEIGHT - EDGE - TITLE_HEIGHT
"""Upper edge of the title block on the paper [mm]."""
STACK = 7.5
"""Distance between dimension lines [mm of paper]."""


def titled_sheet(model: CadModel, part: CadPart, scale: float) -> Sheet:
    """Return an empty sheet for a part at a scale."""
    milled = part.name != "probe" and model.adapter.options.milled
    resin = model.design.resin.name if part.name == "probe" else ALUMINIUM if milled else RIGID_RESIN
    return Sheet(f"{model.design.name}: {part.name.replace('_', ' ')}", [
        ("geometry", model.geometry.fingerprint), ("material", resin), ("file", f"{part.name}.stl"),
        ("scale", scale_text(scale)), ("units", "mm"), ("frame", part.frame.replace("_", " ")),
        ("tolerance", MILLED if milled else TOLERANCE), ("angles", "about +z from +x, seen from above"),
    ])  # fmt: skip


NOTE_SPACING = 7.0
"""Minimum distance between two notes [mm of paper]."""


def probe_sheet(model: CadModel, part: CadPart) -> Sheet:
    """Return the drawing of the probe: upright, with the underside of its flange beside it."""
    g = model.geometry
    length, rim, thick = g.length / MM, g.flange.diameter / MM, g.flange.thickness / MM
    scale = scale_for((rim, length + thick), (70.0, BOTTOM - EDGE - 50.0))
    sheet = titled_sheet(model, part, scale)
    middle = (EDGE + BOTTOM) / 2
    front = SheetView(sheet, (90.0, middle + scale * (length - thick) / 2), scale)
    front.outline(seen(part.shape, FRONT))
    front.axis((0.0, -thick), (0.0, length))
    front.dimension_v(0.0, length, rim / 2, 2 * STACK, number(length), top_u=g.tip_radius / MM)
    front.dimension_v(-thick, 0.0, rim / 2, STACK, number(thick))
    front.dimension_u(-rim / 2, rim / 2, -thick, -STACK, f"⌀{number(rim)}")
    for s, r, words in _stations(model, NOTE_SPACING / scale):
        front.leader((-r, s), (-10.0 - scale * (rim / 2 - r), 5.0), words)
    front.caption("from the front (+x to the right)", -thick, 18.0)
    _underside(model, part, sheet)
    return sheet


def _stations(model: CadModel, apart: float) -> Iterable[tuple[float, float, str]]:
    """Yield height and half-width [mm] with its text, of both ends and of knots at least `apart` [mm] from others.

    A plain taper also gets a reference dimension in brackets halfway.
    """
    g = model.geometry
    knots = [(float(s) / MM, float(r) / MM) for s, r in zip(g.s, g.radius, strict=True)]
    last = -apart
    for s, r in knots:
        if s - last >= apart and (knots[-1][0] - s >= apart or s == knots[-1][0]):
            yield s, r, f"{_width(model, r)} at s = {number(s)}"
            last = s
    if len(knots) == 2:
        s, r = g.length / 2 / MM, float(g.radius_at(g.length / 2)) / MM
        yield s, r, f"({_width(model, r)}) at s = {number(s)}"


def _width(model: CadModel, r: float) -> str:
    section = model.geometry.cross_section
    if section.hollow:
        return f"⌀{number(2 * r)} / bore {number(2 * r * section.bore_ratio)}"
    if section.flatness != 1.0:
        return f"{number(2 * r)} × {number(2 * r * section.flatness)}"
    return f"⌀{number(2 * r)}"


def _underside(model: CadModel, part: CadPart, sheet: Sheet) -> None:
    a, rim = model.adapter, model.geometry.flange.diameter / MM
    scale = scale_for((rim, rim), (46.0, 46.0))
    view = SheetView(sheet, (163.0, (EDGE + BOTTOM) / 2), scale)
    view.outline(seen(part.shape, BELOW))
    view.axis((-rim / 2, 0.0), (rim / 2, 0.0))
    view.axis((0.0, -rim / 2), (0.0, rim / 2))
    peg = a.peg_x / MM
    view.dimension_u(0.0, peg, rim / 2, STACK, number(peg))
    view.caption(f"from below, {scale_text(scale)}", -rim / 2)
    x, y = view.at((-rim / 2, -rim / 2))
    sheet.note((x, y + 20.0), [
        f"hole ⌀{number(a.peg_hole_d / MM)} through the flange:",
        "it marks +x of the base frame;",
        "s = 0 is the flange's top",
    ], SMALL)  # fmt: skip


@dataclass(frozen=True)
class Holes:
    """Equal holes, tagged in a view and described in the table.

    Attributes:
        points: (x, y) of each [m].
        size: largest diameter [m].
        words: description of one hole.
        on_circle: whether they form a hole circle that is drawn and dimensioned.
    """

    points: Sequence[XY]
    size: float
    words: str
    on_circle: bool = True

    @property
    def text(self) -> str:
        """Return the table's text: number, description, position."""
        count = f"{len(self.points)} × " if len(self.points) > 1 else ""
        degrees = (number(float(np.degrees(np.arctan2(y, x))) % 360.0) for x, y in self.points)
        circle = 2 * float(np.hypot(*self.points[0]))
        where = f", on ⌀{_mm(circle)} at {', '.join(f'{d}°' for d in degrees)}" if self.on_circle else ""
        return f"{count}{self.words}{where}"


def part_drawings(model: CadModel) -> dict[str, bytes]:
    """Return the SVG drawing of each printed part, by the part's name."""
    drawers: dict[str, Callable[[CadModel, CadPart], Sheet]] = {
        "probe": probe_sheet,
        "sensor_adapter": _sensor_adapter,
        "clamp_ring": _clamp_ring,
        "flange_adapter": _flange_adapter,
    }
    return {name: bytes(build_cad(model, model.parts[name]).svg) for name, build_cad in drawers.items()}


def _sensor_adapter(model: CadModel, part: CadPart) -> Sheet:
    a = model.adapter
    bore, room = a.tool.screw.clearance_d, a.tool.screw.counterbore_d
    above = [
        Holes(a.p_tool_screws, room, f"⌀{_mm(bore)} through, ⌀{_mm(room)} from z = {_mm(a.tool.grip)} up"),
        Holes(a.p_ring_screws, a.ring_screw.clearance_d,
              f"⌀{_mm(a.ring_screw.clearance_d)} to z = {_mm(a.ring_hole_bottom)}"),
        Holes([(a.peg_x, 0.0)], PEG_D, f"peg ⌀{_mm(PEG_D)} at x = {_mm(a.peg_x)}, top at z = {_mm(a.peg_top)}", False),
    ]  # fmt: skip
    z0, z1 = a.nut_slot_z
    inner = a.ring_circle_d / 2 - a.nut_slot_reach
    slot = f"slot {_mm(a.nut_slot_width)} wide, z = {_mm(z0)} to {_mm(z1)}, round end about r = {_mm(inner)}"
    second = f"the second a slot {_mm(a.dowel_d)} × {_mm(a.dowel_d + DOWEL_SLOT)} towards the first"
    below = [
        Holes(a.p_ring_screws, a.nut_slot_width, slot),
        Holes(a.p_dowels, a.dowel_d, f"⌀{_mm(a.dowel_d)}, {_mm(a.dowel_depth)} deep, {second}"),
    ]
    heights, tops = [a.foot_height, a.cone_top, a.floor, a.peg_top, a.body_top], [a.recess_d, a.body_d]
    notes = [
        f"flat at x = {_mm(a.mark_x)} shows +x; z = 0 rests on the sensor's tool face",
        f"notch {_mm(VENT_WIDTH)} wide from the recess to the flat; underside at {UNDERSIDE_DEG:g}° to the horizontal",
    ]
    return _disc(model, part, (0.0, a.body_top), heights, tops, [a.foot_d, a.cone_d], (above, below), notes)


def _clamp_ring(model: CadModel, part: CadPart) -> Sheet:
    a = model.adapter
    top = a.ring_thickness
    hole_d = a.ring_screw.clearance_d
    above = [Holes(a.p_ring_screws, hole_d, f"⌀{_mm(hole_d)} through")]
    tops, bottoms = [a.ring_bore_top_d, a.body_d], [a.ring_bore_d]
    notes = ["the wide end of the bore faces the tip"]
    return _disc(model, part, (0.0, top), [top], tops, bottoms, (above, []), notes)


def _flange_adapter(model: CadModel, part: CadPart) -> Sheet:
    p, bolt, screw = model.plate, model.plate.robot.screw, model.plate.mounting.screw
    spigot_d, spigot = p.robot.spigot
    width, length = p.robot.pin_slot
    reach = p.robot.bolt_circle_d / 2
    above = [
        Holes(p.p_bolts, bolt.clearance_d, f"⌀{_mm(bolt.clearance_d)} through"),
        Holes(p.p_mounting_screws, screw.clearance_d, f"⌀{_mm(screw.clearance_d)} through"),
    ]
    slot = f"slot {_mm(width)} × {_mm(length)} through, middle at x = {_mm(reach)}: the robot's dowel pin"
    bore = f"counterbore ⌀{_mm(screw.counterbore_d)} up to z = {_mm(p.counterbore_top)}"
    below = [Holes(p.p_mounting_screws, screw.counterbore_d, bore)]
    if p.p_centring_pins:
        d, bottom = p.centring_hole
        above.append(Holes(p.p_centring_pins, d, f"⌀{_mm(d)} down to z = {_mm(bottom)}"))
    radial, across = TIE_SLOT
    above.append(Holes(p.p_tie_slots, across, f"slot {_mm(radial)} × {_mm(across)} through", False))
    below += [Holes([(reach, 0.0)], 0.0, slot, False)] if width > 0.0 else []
    heights, bottoms = [-spigot, p.plate_top], [spigot_d, p.plate_d]
    (r0, r1), (v0, v1), (z0, z1) = p.cable_pocket
    notes = [
        f"z = 0 rests on the robot: {p.robot.source}; the sensor sits on the top face",
        f"pocket for the cable at {number(p.cable_deg)}°: r = {_mm(r0)} to {_mm(r1)}, {_mm(v1 - v0)} wide, "
        f"{_mm(z1 - z0)} deep",
    ]
    return _disc(model, part, (-spigot, p.plate_top), heights, [], bottoms, (above, below), notes)


def _disc(
    model: CadModel, part: CadPart, z: tuple[float, float], heights: Sequence[float],
    tops: Sequence[float], bottoms: Sequence[float],
    holes: tuple[list[Holes], list[Holes]], notes: list[str],
) -> Sheet:  # fmt: skip
    """Return the sheet of a flat part; all in [m]: its lowest and highest z, heights and diameters to dimension."""
    box = part.shape.BoundingBox()
    rim, low, high = max(box.xmax, -box.xmin, box.ymax), z[0] / MM, z[1] / MM
    scale = scale_for((2 * rim, high - low), (66.0, 60.0))
    sheet = titled_sheet(model, part, scale)
    top = EDGE + 14.0 + STACK * len(tops)
    section = SheetView(sheet, (WIDTH / 2, top + scale * high), scale)
    edges, faces = cut(part.shape)
    section.hatch(faces)
    section.outline(edges)
    section.axis((0.0, low), (0.0, high))
    for i, h in enumerate(sorted(heights), 1):
        section.dimension_v(min(0.0, h / MM), max(0.0, h / MM), rim, STACK * i, _mm(abs(h)))
    for i, d in enumerate(sorted(tops), 1):
        section.dimension_u(-d / 2 / MM, d / 2 / MM, high, STACK * i, f"⌀{_mm(d)}")
    for i, d in enumerate(sorted(bottoms), 1):
        section.dimension_u(-d / 2 / MM, d / 2 / MM, low, -STACK * i, f"⌀{_mm(d)}")
    section.caption("section in the plane y = 0", low, STACK * len(bottoms) + 9.0)
    middle = section.at((0.0, low))[1] + STACK * len(bottoms) + 9.0 + 26.0 + scale * rim
    _plans(sheet, part, holes, (rim, scale, middle))
    text = [f"{letter}  {hole.text}" for letter, hole in _lettered([*holes[0], *holes[1]])]
    sheet.note((EDGE + 6.0, BOTTOM - 5.0 * (len(text) + len(notes))), [*text, *notes])
    return sheet


def _plans(
    sheet: Sheet, part: CadPart, holes: tuple[list[Holes], list[Holes]], where: tuple[float, float, float]
) -> None:
    """Draw the views from above and, if it has holes to show, from below, at one height of the paper."""
    rim, scale, y = where
    lettered = _lettered([*holes[0], *holes[1]])
    views: list[tuple[str, ViewDirection, list[tuple[str, Holes]]]] = [
        ("above", ABOVE, lettered[: len(holes[0])])
    ]
    if holes[1]:
        views.append(("below", BELOW, lettered[len(holes[0]) :]))
    for i, (name, side, tagged) in enumerate(views):
        view = SheetView(
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
    """Return the point whose direction from the centre is farthest from those taken, so that tags do not overlap."""

    def room(p: XY) -> float:
        return min((abs(float(np.angle(complex(*p) / other))) for other in taken), default=np.pi)

    return max(points, key=lambda p: round(room(p), 6))


def _lettered(holes: Iterable[Holes]) -> list[tuple[str, Holes]]:
    return [(chr(ord("A") + i), hole) for i, hole in enumerate(holes)]


def _mm(value: float) -> str:
    return number(value / MM)
