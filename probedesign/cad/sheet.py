"""Technical drawings on A4 sheets: SVG canvas, projected edges and sections, views to scale, dimensions and notes.

Paper in millimetres, y down. Numbers are rounded, so equal drawings are equal bytes.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from xml.etree import ElementTree as ET

import cadquery as cq
import numpy as np
from OCP.BRepLib import BRepLib
from OCP.gp import gp_Ax2, gp_Dir, gp_Pnt
from OCP.HLRAlgo import HLRAlgo_Projector
from OCP.HLRBRep import HLRBRep_Algo, HLRBRep_HLRToShape

from probedesign.core.frames import Array

XY = tuple[float, float]
FONT = "Helvetica, Arial, 'Liberation Sans', 'DejaVu Sans', sans-serif"


class Svg:
    """An SVG picture to which elements are added; x to the right, y down.

    Args:
        width, height: in `unit`, which is also the unit of every coordinate.
        unit: CSS unit, "mm" or "px".
        title: text alternative.
    """

    def __init__(self, width: float, height: float, unit: str, title: str) -> None:
        self.root = ET.Element(
            "svg",
            {
                "xmlns": "http://www.w3.org/2000/svg",
                "width": f"{_n(width)}{unit}",
                "height": f"{_n(height)}{unit}",
                "viewBox": f"0 0 {_n(width)} {_n(height)}",
                "font-family": FONT,
            },
        )
        ET.SubElement(self.root, "title").text = title
        self._add("rect", width=_n(width), height=_n(height), fill="#fff")

    def line(self, a: XY, b: XY, width: float, colour: str = "#000", dash: str = "") -> None:
        """Draw a straight line from a to b."""
        self.polylines([[a, b]], width, colour, dash)

    def polylines(
        self, lines: Iterable[Iterable[XY]], width: float, colour: str = "#000", dash: str = ""
    ) -> None:
        """Draw lines of one style as one element."""
        path = "".join("M" + "L".join(f"{_n(x)} {_n(y)}" for x, y in line) for line in lines)
        dashes = {"stroke-dasharray": dash} if dash else {}
        self._add("path", {"stroke-width": _n(width), "stroke-linecap": "round", **dashes},
                  d=path, fill="none", stroke=colour)  # fmt: skip

    def area(self, loops: Iterable[Iterable[XY]], fill: str) -> None:
        """Fill closed outlines; an outline inside another is a hole."""
        path = "".join("M" + "L".join(f"{_n(x)} {_n(y)}" for x, y in loop) + "Z" for loop in loops)
        self._add("path", {"fill-rule": "evenodd"}, d=path, fill=fill)

    def hatched(self, loops: Iterable[Iterable[XY]]) -> None:
        """Hatch closed outlines as cut material."""
        if self.root.find("defs") is None:
            pattern = ET.SubElement(ET.SubElement(self.root, "defs"), "pattern", {
                "id": "hatch", "width": "1.6", "height": "1.6",
                "patternUnits": "userSpaceOnUse", "patternTransform": "rotate(-45)",
            })  # fmt: skip
            ET.SubElement(pattern, "rect", {"width": "1.6", "height": "1.6", "fill": "#f3f5f7"})
            ET.SubElement(pattern, "path", {"d": "M0 0H1.6", "stroke": "#667", "stroke-width": "0.18"})
        self.area(loops, "url(#hatch)")

    def circle(
        self, centre: XY, r: float, fill: str = "none", colour: str = "none", width: float = 0.0
    ) -> None:
        """Draw a circle."""
        self._add("circle", {"stroke-width": _n(width)}, cx=_n(centre[0]), cy=_n(centre[1]), r=_n(r),
                  fill=fill, stroke=colour)  # fmt: skip

    def text(
        self,
        at: XY,
        words: str,
        size: float,
        anchor: str = "middle",
        turned: bool = False,
        bold: bool = False,
    ) -> None:
        """Write text on a baseline at a point; `turned` reads from the right."""
        x, y = _n(at[0]), _n(at[1])
        how = {"font-size": _n(size), "text-anchor": anchor}
        how |= {"transform": f"rotate(-90 {x} {y})"} if turned else {}
        how |= {"font-weight": "bold"} if bold else {}
        self._add("text", how, x=x, y=y).text = words

    def image(self, x: float, y: float, width: float, height: float, png_base64: str) -> None:
        """Embed a PNG."""
        self._add("image", x=_n(x), y=_n(y), width=_n(width), height=_n(height),
                  href=f"data:image/png;base64,{png_base64}")  # fmt: skip

    def _add(self, tag: str, how: dict[str, str] | None = None, **more: str) -> ET.Element:
        return ET.SubElement(self.root, tag, {**(how or {}), **more})

    def __str__(self) -> str:
        """Return the element as text for an HTML page."""
        return ET.tostring(self.root, encoding="unicode")

    def __bytes__(self) -> bytes:
        """Return the content of an SVG file."""
        return b"<?xml version='1.0' encoding='utf-8'?>\n" + str(self).encode() + b"\n"


def _n(value: float) -> str:
    return f"{round(value, 3) + 0.0:g}"


CURVE_POINTS = 48
"""Points of a curved edge: a full circle Ø60 mm is drawn within 0.07 mm, less than its line width."""
SAME_MM = 1e-4
"""End points closer than this coincide."""
Lines = list[Array]
"""Polylines, each (k, 2), in millimetres: u to the right, v up."""


@dataclass(frozen=True)
class ViewDirection:
    """A direction of view.

    Attributes:
        eye: direction from the part to the eye.
        right: direction drawn to the right.
    """

    eye: tuple[float, float, float]
    right: tuple[float, float, float]


FRONT = ViewDirection((0.0, -1.0, 0.0), (1.0, 0.0, 0.0))
ABOVE = ViewDirection((0.0, 0.0, 1.0), (1.0, 0.0, 0.0))
BELOW = ViewDirection((0.0, 0.0, -1.0), (1.0, 0.0, 0.0))
"""Keeps x to the right, so y points down."""


def seen(shape: cq.Shape, side: ViewDirection) -> Lines:
    """Return the visible edges and silhouettes of a solid."""
    algorithm = HLRBRep_Algo()
    algorithm.Add(shape.wrapped)
    axes = gp_Ax2(gp_Pnt(), gp_Dir(*side.eye), gp_Dir(*side.right))
    algorithm.Projector(HLRAlgo_Projector(axes))
    algorithm.Update()
    algorithm.Hide()
    found = HLRBRep_HLRToShape(algorithm)
    kinds = (found.VCompound(), found.OutLineVCompound())
    return [line for kind in kinds if kind is not None and not kind.IsNull() for line in _flat(kind)]


def cut(shape: cq.Shape) -> tuple[Lines, list[Lines]]:
    """Return the half at y > 0, seen from the front, and the faces in the plane y = 0.

    Returns:
        Visible edges, and the closed outlines of each section face.
    """
    box = shape.BoundingBox()
    reach = 2.0 * box.DiagonalLength
    half = cq.Solid.makeBox(2 * reach, reach, 2 * reach, cq.Vector(-reach, 0.0, box.center.z - reach))
    plane = cq.Face.makePlane(
        2 * reach, 2 * reach, cq.Vector(0.0, 0.0, box.center.z), cq.Vector(0.0, -1.0, 0.0)
    )
    faces = shape.intersect(plane).Faces()
    loops = [[_loop(wire) for wire in face.Wires()] for face in faces]
    return seen(shape.intersect(half), FRONT), loops


def _flat(wrapped: object) -> Lines:
    BRepLib.BuildCurves3d_s(wrapped)
    return [_points(edge)[:, :2] for edge in cq.Shape.cast(wrapped).Edges()]


def _loop(wire: cq.Wire) -> Array:
    """Return a closed outline in the plane y = 0 as (x, z); its edges are in order, but of either orientation."""
    edges = [_points(edge)[:, [0, 2]] for edge in wire]
    if len(edges) == 1:
        return edges[0]
    first, second = edges[0], edges[1]
    turn = min(_gap(first[-1], second[0]), _gap(first[-1], second[-1])) > SAME_MM
    line = [first[::-1] if turn else first]
    for edge in edges[1:]:
        line.append(edge if _gap(line[-1][-1], edge[0]) < _gap(line[-1][-1], edge[-1]) else edge[::-1])
    return np.concatenate(line)


def _gap(a: Array, b: Array) -> float:
    return float(np.hypot(*(a - b)))


def _points(edge: cq.Edge) -> Array:
    count = 2 if edge.geomType() == "LINE" else CURVE_POINTS
    ends = np.linspace(0.0, 1.0, count)
    return np.array([p.toTuple() for p in edge.positions(ends)])


WIDTH, HEIGHT, EDGE = 210.0, 297.0, 12.0
TITLE_HEIGHT = 32.0
COLUMNS = (4.0, 74.0, 110.0)
"""Columns of the title block, from its left edge."""
SCALES = (10.0, 5.0, 2.0, 1.0, 0.5, 0.2, 0.1)  # ISO 5455
THICK, THIN = 0.4, 0.18  # line widths, ISO 128
TEXT, SMALL = 3.2, 2.6
ARROW = 2.6
EXTENSION_GAP = 1.2
"""Gap between the outline and an extension line."""
CENTRE_DASH = "6 1.2 0.8 1.2"


def number(value: float) -> str:
    """Return a dimension in millimetres, to the hundredth."""
    return f"{round(value, 2) + 0.0:g}"


class Sheet:
    """One A4 sheet with frame and title block.

    Args:
        title: of the part.
        rows: name and value of the title block's other fields.
    """

    def __init__(self, title: str, rows: Sequence[tuple[str, str]]) -> None:
        self.svg = Svg(WIDTH, HEIGHT, unit="mm", title=title)
        left, right, bottom = EDGE, WIDTH - EDGE, HEIGHT - EDGE
        top = bottom - TITLE_HEIGHT
        for y in (EDGE, top):
            frame = [(left, y), (right, y), (right, bottom), (left, bottom), (left, y)]
            self.svg.polylines([frame], THICK)
        self.svg.text((left + 4, top + 9), title, 5.0, anchor="start", bold=True)
        for i, (name, value) in enumerate(rows):
            x, y = left + COLUMNS[i // 3], top + 16.5 + 6.2 * (i % 3)
            self.svg.text((x, y), name, SMALL, anchor="start")
            self.svg.text((x + 17, y), value, TEXT, anchor="start")

    def note(self, at: XY, lines: Sequence[str], size: float = TEXT) -> None:
        """Write lines of text, the first baseline at a point."""
        for i, line in enumerate(lines):
            self.svg.text((at[0], at[1] + 1.55 * size * i), line, size, anchor="start")


def scale_for(size: tuple[float, float], room: tuple[float, float]) -> float:
    """Return the largest standard scale at which a size [mm] fits into the space on paper [mm]."""
    fits = [s for s in SCALES if s * size[0] <= room[0] and s * size[1] <= room[1]]
    return fits[0] if fits else min(room[0] / size[0], room[1] / size[1])


def scale_text(scale: float) -> str:
    """Return a scale as written on drawings."""
    return f"{scale:g} : 1" if scale >= 1.0 else f"1 : {number(1.0 / scale)}"


@dataclass(frozen=True)
class SheetView:
    """A view on a sheet with its dimensions; points of the part are (u, v) [mm], v up.

    Attributes:
        sheet: that it is drawn on.
        origin: position of the part's origin on the paper.
        scale: paper over part.
    """

    sheet: Sheet
    origin: XY
    scale: float

    def at(self, p: XY) -> XY:
        """Return a point of the part on paper."""
        return self.origin[0] + self.scale * p[0], self.origin[1] - self.scale * p[1]

    def outline(self, lines: Lines) -> None:
        """Draw visible edges."""
        self.sheet.svg.polylines([self._line(line) for line in lines], THICK)

    def hatch(self, faces: list[Lines]) -> None:
        """Hatch section faces."""
        for loops in faces:
            self.sheet.svg.hatched([self._line(loop) for loop in loops])

    def _line(self, line: Array) -> list[XY]:
        return [self.at((float(u), float(v))) for u, v in line]

    def caption(self, words: str, below_v: float, drop: float = 12.0) -> None:
        """Write the view's caption below its lowest v."""
        x, y = self.at((0.0, below_v))
        self.sheet.svg.text((x, y + drop), words, TEXT, bold=True)

    def axis(self, a: XY, b: XY) -> None:
        """Draw a line of symmetry, slightly beyond its ends."""
        (x0, y0), (x1, y1) = self.at(a), self.at(b)
        length = max(float(np.hypot(x1 - x0, y1 - y0)), 1e-9)
        dx, dy = 3.0 * (x1 - x0) / length, 3.0 * (y1 - y0) / length
        self.sheet.svg.line((x0 - dx, y0 - dy), (x1 + dx, y1 + dy), THIN, dash=CENTRE_DASH)

    def centres(self, points: Sequence[XY], size: float) -> None:
        """Draw a centre mark on each hole; `size` is the length of its arms [mm of the part]."""
        for u, v in points:
            self.sheet.svg.polylines(
                [[self.at((u - size, v)), self.at((u + size, v))], [self.at((u, v - size)), self.at((u, v + size))]],
                THIN,
            )  # fmt: skip

    def bolt_circle(self, diameter: float) -> None:
        """Draw the circle of a hole pattern."""
        angle = np.linspace(0.0, 2.0 * np.pi, 97)
        ring = [self.at((float(diameter / 2 * np.cos(a)), float(diameter / 2 * np.sin(a)))) for a in angle]
        self.sheet.svg.polylines([ring], THIN, dash=CENTRE_DASH)

    def tag(self, p: XY, out_to: float, letter: str) -> None:
        """Draw a letter outside the part with a line to a hole; `out_to` is the radius of the part [mm]."""
        angle = np.arctan2(p[1], p[0])
        direction = (float(np.cos(angle)), float(-np.sin(angle)))
        x, y = self.at((out_to * direction[0], -out_to * direction[1]))
        foot = (x + 6.0 * direction[0], y + 6.0 * direction[1])
        middle = (x + 8.8 * direction[0], y + 8.8 * direction[1])
        self.sheet.svg.line(self.at(p), foot, THIN)
        self.sheet.svg.circle(middle, 2.8, fill="#fff", colour="#000", width=THIN)
        self.sheet.svg.text((middle[0], middle[1] + 1.15), letter, TEXT, bold=True)

    def dimension_u(self, u0: float, u1: float, from_v: float, offset: float, words: str) -> None:
        """Draw a dimension along u, `offset` above (+) or below (-) v [mm of paper]."""
        (x0, y), (x1, _) = self.at((u0, from_v)), self.at((u1, from_v))
        level, direction = y - offset, np.sign(offset)
        for x in (x0, x1):
            self.sheet.svg.line((x, y - EXTENSION_GAP * direction), (x, level - 1.5 * direction), THIN)
        self._dimension((x0, level), (x1, level), words)

    def dimension_v(
        self, v0: float, v1: float, from_u: float, offset: float, words: str, top_u: float | None = None
    ) -> None:
        """Draw a dimension along v, `offset` to the right (+) or left (-) of u [mm of paper].

        At v1 the extension line starts at `top_u`, if given.
        """
        (foot, y0), (_, y1) = self.at((from_u, v0)), self.at((from_u, v1))
        head, _ = self.at((from_u if top_u is None else top_u, v1))
        level, direction = foot + offset, np.sign(offset)
        for x, y in ((foot, y0), (head, y1)):
            self.sheet.svg.line((x + EXTENSION_GAP * direction, y), (level + 1.5 * direction, y), THIN)
        self._dimension((level, y1), (level, y0), words)

    def _dimension(self, a: XY, b: XY, words: str) -> None:
        """Draw a dimension line from a to b, to the right or down, with its text.

        The arrows are outside of a short line; the text is beyond its end where it does not fit between the arrows.
        """
        svg, length, upright = self.sheet.svg, b[0] - a[0] + b[1] - a[1], a[0] == b[0]
        along = (0.0, 1.0) if upright else (1.0, 0.0)
        if length >= 3 * ARROW:
            svg.line(a, b, THIN)
            self._arrow(b, along)
            self._arrow(a, (-along[0], -along[1]))
        else:
            for tip, sign in ((a, 1.0), (b, -1.0)):
                tail = (tip[0] - sign * 2 * ARROW * along[0], tip[1] - sign * 2 * ARROW * along[1])
                svg.line(tail, tip, THIN)
                self._arrow(tip, (sign * along[0], sign * along[1]))
            svg.line(a, b, THIN)
        x, y = (a[0] + b[0]) / 2 - along[1], (a[1] + b[1]) / 2 - along[0]
        beyond = length / 2 + 2 * ARROW + 0.8
        if 0.58 * TEXT * len(words) <= length - 1.0:  # mean width of a sans-serif font
            svg.text((x, y), words, TEXT, turned=upright)
        elif upright:
            svg.text((x, y - beyond), words, TEXT, anchor="start", turned=True)
        else:
            svg.text((x + beyond, y + 2.1), words, TEXT, anchor="start")

    def leader(self, p: XY, to: XY, words: str) -> None:
        """Draw a note with an arrow to a point; `to` is the offset of the text from that point [mm of paper, y up]."""
        x, y = self.at(p)
        elbow = (x + to[0], y - to[1])
        length = max(float(np.hypot(*to)), 1e-9)
        self._arrow((x, y), (-to[0] / length, to[1] / length))
        self.sheet.svg.line((x, y), elbow, THIN)
        anchor, gap = ("start", 1.0) if to[0] >= 0 else ("end", -1.0)
        self.sheet.svg.text((elbow[0] + gap, elbow[1] + 1.1), words, TEXT, anchor=anchor)

    def _arrow(self, tip: XY, direction: XY) -> None:
        back = (tip[0] - ARROW * direction[0], tip[1] - ARROW * direction[1])
        side = (-direction[1] * ARROW / 6, direction[0] * ARROW / 6)
        self.sheet.svg.area(
            [[tip, (back[0] + side[0], back[1] + side[1]), (back[0] - side[0], back[1] - side[1])]], "#000"
        )
