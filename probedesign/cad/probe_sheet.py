"""The drawing of the probe: upright, with its flange's underside beside it."""

from collections.abc import Iterable

from probedesign.cad.assembly import Part
from probedesign.cad.drawing import Drawing
from probedesign.cad.projection import BELOW, FRONT, seen
from probedesign.cad.sheet import EDGE, SMALL, Sheet, View, number, scale_for, scale_text
from probedesign.cad.title_block import BOTTOM, STACK, titled_sheet
from probedesign.units import MM

SPACED = 7.0
"""Paper between two notes above each other [mm]."""


def probe_sheet(drawing: Drawing, part: Part) -> Sheet:
    """The sheet, drawn."""
    g = drawing.geometry
    length, rim, thick = g.length / MM, g.flange.diameter / MM, g.flange.thickness / MM
    scale = scale_for((rim, length + thick), (70.0, BOTTOM - EDGE - 50.0))
    sheet = titled_sheet(drawing, part, scale)
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
