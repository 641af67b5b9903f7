"""Page of an inspection sheet: projections of solids, drawn to scale on A4 with dimensions, labels and notes, as SVG.

Paper in millimetres, y down. Points of the part are (u, v) in millimetres, v up.
"""

import math
import textwrap
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import cadquery as cq
import numpy as np
from OCP.BRepLib import BRepLib
from OCP.gp import gp_Ax2, gp_Dir, gp_Pnt
from OCP.HLRAlgo import HLRAlgo_Projector
from OCP.HLRBRep import HLRBRep_Algo, HLRBRep_HLRToShape

from probedesign.core.frames import Array
from probedesign.core.svg import Anchor, Canvas, number

XY = tuple[float, float]

# ---- projections

CURVE_POINTS = 48  #: Points of a curved edge: a full circle Ø60 mm is drawn within 0.07 mm, less than its line width.
SAME_MM = 1e-4  #: End points closer than this coincide.
Lines = list[Array]  #: Polylines, each (k, 2), in millimetres: u to the right, v up.


@dataclass(frozen=True)
class ViewDirection:
    """A direction of view."""

    eye: tuple[float, float, float]  #: direction from the part to the eye.
    right: tuple[float, float, float]  #: direction drawn to the right.


FRONT = ViewDirection((0.0, -1.0, 0.0), (1.0, 0.0, 0.0))
SIDE = ViewDirection((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
ABOVE = ViewDirection((0.0, 0.0, 1.0), (1.0, 0.0, 0.0))
BELOW = ViewDirection((0.0, 0.0, -1.0), (1.0, 0.0, 0.0))  #: Keeps x to the right, so y points down.


def seen(shape: cq.Shape, side: ViewDirection) -> Lines:
    """Return the visible edges and silhouettes of a solid."""
    algorithm = HLRBRep_Algo()
    algorithm.Add(shape.wrapped)
    axes = gp_Ax2(gp_Pnt(), gp_Dir(*side.eye), gp_Dir(*side.right))
    algorithm.Projector(HLRAlgo_Projector(axes))
    algorithm.Update()
    algorithm.Hide()
    lines = HLRBRep_HLRToShape(algorithm)
    drawn: Lines = []
    for kind in (lines.VCompound(), lines.OutLineVCompound()):
        if kind is not None and not kind.IsNull():
            BRepLib.BuildCurves3d_s(kind)
            drawn += [_points(edge)[:, :2] for edge in cq.Shape.cast(kind).Edges()]
    return drawn


def cut(shape: cq.Shape) -> tuple[Lines, list[Lines]]:
    """Return the half at y > 0, seen from the front, and the faces in the plane y = 0.

    Returns:
        Visible edges, and the closed outlines of each section face.
    """
    box = shape.BoundingBox()
    reach = 2.0 * box.DiagonalLength
    half = shape.intersect(cq.Solid.makeBox(2 * reach, reach, 2 * reach, cq.Vector(-reach, 0.0, box.center.z - reach)))
    faces = [face for face in half.Faces() if face.Center().y < SAME_MM]  # of a half at y > 0: those in the plane
    return seen(half, FRONT), [[_loop(wire, [0, 2]) for wire in face.Wires()] for face in faces]


def _loop(wire: cq.Wire, axes: list[int]) -> Array:
    """Return two coordinates of a closed outline; its edges are in order, but of either orientation."""
    edges = [_points(edge)[:, axes] for edge in wire]
    if len(edges) == 1:
        return edges[0]
    first, second = edges[0], edges[1]
    turn = min(math.dist(first[-1], end) for end in second[[0, -1]]) > SAME_MM
    line = [first[::-1] if turn else first]
    for edge in edges[1:]:
        line.append(edge if math.dist(line[-1][-1], edge[0]) < math.dist(line[-1][-1], edge[-1]) else edge[::-1])
    return np.concatenate(line)


def _points(edge: cq.Edge) -> Array:
    count = 2 if edge.geomType() == "LINE" else CURVE_POINTS
    ends = np.linspace(0.0, 1.0, count)
    return np.array([p.toTuple() for p in edge.positions(ends)])


# ---- paper

WIDTH, HEIGHT, EDGE = 210.0, 297.0, 12.0
BOTTOM = HEIGHT - EDGE - 28.0  #: Upper edge of the title block on the paper [mm].
SCALES = (10.0, 5.0, 2.0, 1.0, 0.5, 0.2, 0.1)  # ISO 5455
TEXT, SMALL = 3.2, 2.6
LINE = 1.42  #: Distance of two baselines over the size of the text.
#: Widths of a character of a sans-serif font over its size: of digits, and the mean of prose.
TEXT_WIDTH, PROSE_WIDTH = 0.58, 0.5
THICK, THIN, CHAIN = 0.4, 0.18, "6 1.2 0.8 1.2"  #: Widths of lines (ISO 128), and the dashes of a centre line.
#: Colour of cut material.
CUT = "#dde3ea"
ARROW = 2.6
#: Gap between the outline and an extension line, and its length beyond the dimension line.
EXTENSION_GAP, EXTENSION_BEYOND = 1.2, 1.5
STACK = 7.5  #: Distance between dimension lines.


def scale_for(size: XY, room: XY) -> float:
    """Return the largest standard scale at which a size [mm] fits into the space on paper [mm]."""
    fits = [s for s in SCALES if s * size[0] <= room[0] and s * size[1] <= room[1]]
    return fits[0] if fits else min(room[0] / size[0], room[1] / size[1])


def scale_text(scale: float) -> str:
    """Return a scale as written on drawings."""
    return f"{scale:g} : 1" if scale >= 1.0 else f"1 : {number(1.0 / scale)}"


def page(title: str, lines: Sequence[str]) -> Canvas:
    """Return a sheet with its frame, and title and lines of the title block."""
    sheet = Canvas(WIDTH, HEIGHT, "mm", title)
    left, right, bottom = EDGE, WIDTH - EDGE, HEIGHT - EDGE
    frame = [(left, EDGE), (right, EDGE), (right, bottom), (left, bottom), (left, EDGE)]
    sheet.polylines([frame, [(left, BOTTOM), (right, BOTTOM)]], THICK)
    size = min(5.0, (right - left - 8) / (TEXT_WIDTH * len(title)))
    sheet.text((left + 4, BOTTOM + 8), title, size, "start", bold=True)
    note(sheet, (left + 4, BOTTOM + 14.5), lines)
    return sheet


def rows_of(lines: Iterable[str], room: float, size: float = TEXT) -> list[str]:
    """Return lines of text as rows that fit into a width on paper [mm]."""
    return [row for line in lines for row in textwrap.wrap(line, int(room / (PROSE_WIDTH * size)))]


def note(sheet: Canvas, at: XY, lines: Sequence[str], size: float = TEXT) -> None:
    """Write lines of text, the first baseline at a point."""
    for i, line in enumerate(lines):
        sheet.text((at[0], at[1] + LINE * size * i), line, size, "start")


@dataclass(frozen=True)
class View:
    """A view on a sheet with its dimensions."""

    sheet: Canvas  #: that it is drawn on.
    origin: XY  #: position of the part's origin on the paper.
    scale: float  #: paper over part.

    def at(self, p: XY) -> XY:
        """Return a point of the part on paper."""
        return self.origin[0] + self.scale * p[0], self.origin[1] - self.scale * p[1]

    def _on_paper(self, lines: Lines) -> list[list[XY]]:
        return [[self.at((float(u), float(v))) for u, v in line] for line in lines]

    def outline(self, lines: Lines) -> None:
        """Draw visible edges."""
        self.sheet.polylines(self._on_paper(lines), THICK)

    def section(self, faces: list[Lines]) -> None:
        """Fill section faces."""
        for loops in faces:
            self.sheet.area(self._on_paper(loops), CUT)

    def caption(self, words: str, below_v: float, drop: float = 12.0) -> None:
        """Write the view's caption below its lowest v."""
        x, y = self.at((0.0, below_v))
        self.sheet.text((x, y + drop), words, TEXT, bold=True)

    def axis(self, low: float, high: float, upright: bool = True) -> None:
        """Draw a line of symmetry through the origin, 3 mm of paper beyond its ends [mm of the part]."""
        ends = np.array([low, high]) + np.array([-3.0, 3.0]) / self.scale
        self.sheet.polylines([[self.at((0.0, t) if upright else (t, 0.0)) for t in ends]], THIN, dashes=CHAIN)

    def cross(self, half: float) -> None:
        """Draw both axes of a round view of that half-width [mm of the part]."""
        self.axis(-half, half)
        self.axis(-half, half, upright=False)

    def dimension_u(self, u0: float, u1: float, from_v: float, offset: float, words: str) -> None:
        """Draw a dimension along u, `offset` above (+) or below (-) v [mm of paper]."""
        feet = (self.at((u0, from_v)), self.at((u1, from_v)))
        level = feet[0][1] - offset
        self._dimension((feet[0][0], level), (feet[1][0], level), feet, words)

    def dimension_v(
        self, v0: float, v1: float, from_u: float, offset: float, words: str, top_u: float | None = None,
        below: bool = False,
    ) -> None:  # fmt: skip
        """Draw a dimension along v, `offset` to the right (+) or left (-) of u [mm of paper].

        At v1 the extension line starts at `top_u`, if given. A text that does not fit between the arrows is `below`
        v0, or else above v1: where no other extension line crosses it.
        """
        low, high = self.at((from_u, v0)), self.at((from_u if top_u is None else top_u, v1))
        level = low[0] + offset
        self._dimension((level, high[1]), (level, low[1]), (high, low), words, below)

    def _dimension(self, a: XY, b: XY, feet: tuple[XY, XY], words: str, below: bool = False) -> None:
        """Draw line, arrows and text from a to b, which lies to the right of a or below it.

        The arrows of a short dimension are outside, and so is a text that does not fit between them: to the right of
        b, above a, or `below` b.
        """
        upright = a[0] == b[0]
        along = np.array([0.0, 1.0] if upright else [1.0, 0.0])
        length = float(np.dot(along, np.subtract(b, a)))
        outward = 1.0 if length >= 3 * ARROW else -1.0
        lines: list[Iterable[Iterable[float]]] = [[a, b]]
        for end, foot, side in ((a, feet[0], -outward), (b, feet[1], outward)):
            across = np.sign(np.subtract(end, foot) * (1.0 - along))
            lines.append([foot + EXTENSION_GAP * across, end + EXTENSION_BEYOND * across])
            if outward < 0.0:
                lines.append([end - 2 * ARROW * side * along, end])
            self._arrow(end, side * along)
        self.sheet.polylines(lines, THIN)
        x, y = np.add(a, b) / 2 - along[::-1]
        anchor: Anchor = "middle"
        if TEXT_WIDTH * TEXT * len(words) > length - 1.0:
            beyond, anchor = length / 2 + 2 * ARROW + 0.8, "end" if below else "start"
            x, y = (x, y + (beyond if below else -beyond)) if upright else (x + beyond, y + 2.1)
        self.sheet.text((x, y), words, TEXT, anchor, turned=upright)

    def _arrow(self, tip: Iterable[float], direction: Iterable[float]) -> None:
        tip, direction = np.array(tip), np.array(direction)
        side = ARROW / 6 * np.array([-direction[1], direction[0]])
        self.sheet.area([[tip, tip - ARROW * direction + side, tip - ARROW * direction - side]], "#000")

    def leader(self, p: XY, to: XY, words: str) -> None:
        """Draw a note to the left of a point with an arrow to it; `to` is the offset of the text [mm of paper, y up].

        Further lines of the note are above the first, and smaller.
        """
        tip = np.array(self.at(p))
        offset = np.array([to[0], -to[1]])
        elbow = tip + offset
        self.sheet.polylines([[tip, elbow]], THIN)
        self._arrow(tip, -offset / np.hypot(*offset))
        for i, line in enumerate(words.splitlines()):
            self.sheet.text((elbow[0] - 1.0, elbow[1] + 1.1 - 1.5 * SMALL * i), line, SMALL if i else TEXT, "end")
