"""Technical drawing of the probe: upright, with its cross-section halfway and the underside of its flange beside it."""

from collections.abc import Iterable

from probedesign.cad.drawing import (
    BOTTOM,
    EDGE,
    SMALL,
    STACK,
    Sheet,
    SheetView,
    engraving_note,
    number,
    scale_for,
    scale_text,
    titled_sheet,
)
from probedesign.cad.model import CadModel, CadPart
from probedesign.cad.projection import BELOW, FRONT, SAME_MM, Lines, cross_section, cut, seen
from probedesign.core.frames import Array
from probedesign.core.units import MM
from probedesign.geometry.probe_geometry import DEVIATION_MM, filleted, rounding_radius_mm

NOTE_SPACING = 7.0
"""Minimum distance between two notes [mm of paper]."""
SIDE_X, SIDE_ROOM = 163.0, 42.0
"""Middle of the views beside the probe, and the width of each [mm of paper]."""


def probe_sheet(model: CadModel, part: CadPart) -> Sheet:
    """Return the drawing of the probe."""
    g = model.geometry
    length, rim, thick = g.length / MM, g.flange.diameter / MM, g.flange.thickness / MM
    scale = scale_for((rim, length + thick), (70.0, BOTTOM - EDGE - 54.0))
    sheet = titled_sheet(model, part, scale)
    middle = (EDGE + BOTTOM) / 2 - 4.0
    front = SheetView(sheet, (88.0, middle + scale * (length - thick) / 2), scale)
    hollow = g.cross_section.hollow
    if hollow:
        edges, faces = cut(part.shape)
        front.section(faces)
        front.outline(_without_facets(model, edges))
    else:
        front.outline(_without_facets(model, seen(part.shape, FRONT)))
    front.axis((0.0, -thick), (0.0, length))
    front.dimension_v(0.0, length, rim / 2, 2 * STACK, number(length), top_u=g.tip_radius / MM)
    front.dimension_v(-thick, 0.0, rim / 2, STACK, number(thick))
    front.dimension_u(-rim / 2, rim / 2, -thick, -STACK, f"⌀{number(rim)}")
    front.datum((-rim / 2, 0.0), "A", 8.0)
    front.viewing_arrow((rim / 2 + 19.0 / scale, -thick), "B")  # beyond the dimensions
    for s, r, words in _stations(model, NOTE_SPACING / scale):
        front.leader((-r, s), (-10.0 - scale * (rim / 2 - r), 5.0), words)
    side = "C–C, the plane y = 0" if hollow else "from the front"
    front.caption(f"{side} (+x to the right)", -thick, 20.0)
    if not g.cross_section.full_round:
        front.cutting_plane(float(g.radius_at(g.length / 2)) / MM, length / 2, "D", up=False)
        _halfway(model, part, sheet)
    _underside(model, part, sheet)
    return sheet


def _without_facets(model: CadModel, lines: Lines) -> Lines:
    """Return edges without those between the facets of a rounded tip and of a fillet, which approximate one surface."""
    g, probe = model.geometry, model.design.probe
    fillet = 0.0 if probe.base_fillet_mm is None else filleted(probe.blunt_mm, probe.base_fillet_mm)[1]
    inside = [(0.0, fillet), (g.flank_end / MM, g.length / MM)]

    def facet(line: Array) -> bool:
        low, high = float(line[:, 1].min()), float(line[:, 1].max())
        return high - low < SAME_MM and any(a + SAME_MM < low < b - SAME_MM for a, b in inside)

    return [line for line in lines if not facet(line)]


def _stations(model: CadModel, apart: float) -> Iterable[tuple[float, float, str]]:
    """Yield height and half-width [mm] with its text: both ends and the middle of the flank, which calipers measure,
    knots at least `apart` [mm] from others, and the radii of a rounded tip and of a fillet.

    The diameter halfway is a reference dimension in brackets.
    """
    probe, g = model.design.probe, model.geometry
    length, end = g.length / MM, g.flank_end / MM
    knots = [(s, d / 2) for s, d in probe.blunt_mm[:-1]] + [(end, float(g.radius_at(g.flank_end)) / MM)]
    half = length / 2
    wanted = [knots[0], knots[-1], (half, float(g.radius_at(g.length / 2)) / MM), *knots[1:-1]]
    placed: list[float] = []
    tip = [length] if g.rounded_from is not None else []
    for s, r in wanted:
        if all(abs(s - other) >= apart for other in (*placed, *(t for t in tip if s != end))):
            placed.append(s)
            words = f"{_width(model, r)} at s = {number(s)}"
            if s == 0.0 and probe.base_fillet_mm is not None:
                words = f"{words}\nfillet R{number(probe.base_fillet_mm)}"
            if s == end and tip:
                radius = rounding_radius_mm(*probe.blunt_mm[-2:])
                words = f"{words}\nround tip R{number(radius)}, facets within {DEVIATION_MM:g}"
            yield s, r, f"({words})" if s == half and (s, r) not in knots else words


def _width(model: CadModel, r: float) -> str:
    section = model.geometry.cross_section
    if section.hollow:
        return f"⌀{number(2 * r)} / bore {number(2 * r * section.bore_ratio)}"
    if section.flatness != 1.0:
        return f"{number(2 * r)} × {number(2 * r * section.flatness)}"
    return f"⌀{number(2 * r)}"


def _halfway(model: CadModel, part: CadPart, sheet: Sheet) -> None:
    """Draw the cross-section of a hollow or elliptic probe at half its length."""
    g = model.geometry
    section, r = g.cross_section, float(g.radius_at(g.length / 2)) / MM
    scale = scale_for((2 * r, 2 * r), (0.7 * SIDE_ROOM, 0.7 * SIDE_ROOM))
    view = SheetView(sheet, (SIDE_X, EDGE + 45.0), scale)
    faces = cross_section(part.shape, g.length / 2 / MM)
    view.section(faces)
    view.outline([loop for loops in faces for loop in loops])
    view.cross(r)
    y = section.flatness * r
    view.dimension_u(-r, r, y, STACK, f"{'' if section.flatness != 1.0 else '⌀'}{number(2 * r)}")
    if section.hollow:
        bore = section.bore_ratio * r
        view.dimension_u(-bore, bore, -y, -STACK, f"⌀{number(2 * bore)}")
    else:
        view.dimension_v(-y, y, r, STACK, number(2 * y))
    view.caption(f"D–D at s = {number(g.length / 2 / MM)}, {scale_text(scale)}", -y, 17.0)


def _underside(model: CadModel, part: CadPart, sheet: Sheet) -> None:
    a, rim = model.adapter, model.geometry.flange.diameter / MM
    scale = scale_for((rim, rim), (SIDE_ROOM, SIDE_ROOM))
    view = SheetView(sheet, (SIDE_X, (EDGE + BOTTOM) / 2 + 10.0), scale)
    view.outline(seen(part.shape, BELOW))
    view.cross(rim / 2)
    peg = a.peg_x / MM
    view.dimension_u(0.0, peg, rim / 2, STACK, number(peg))
    if model.geometry.cross_section.hollow:
        # seen from below y points down: the half at y > 0, which the section shows, lies below the line
        view.cutting_plane(rim / 2, 0.0, "C", up=False)
    view.caption(f"B (from below), {scale_text(scale)}", -rim / 2, 14.0)
    x, y = view.at((-rim / 2, -rim / 2))
    sheet.note((min(x, SIDE_X - SIDE_ROOM / 2), y + 22.0), [
        f"hole ⌀{number(a.peg_hole_d / MM)} through the flange:",
        "it marks +x of the base frame;",
        "A: s = 0, the flange's top, which",
        "the clamp ring presses",
        *(text for note in engraving_note(a.on_flange, "the flange's top") for text in _broken(note)),
        "(…): to measure with calipers",
    ], SMALL)  # fmt: skip


def _broken(note: str) -> list[str]:
    """Return a note in two lines, broken at its colon."""
    head, _, rest = note.partition(": ")
    return [f"{head}:", rest]
