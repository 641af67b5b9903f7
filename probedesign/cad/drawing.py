"""Model of a technical drawing: one A4 sheet of views to scale, with dimensions, symbols and notes.

Paper in millimetres, y down; first-angle projection (ISO 5456-2). A sheet is a list of items, which
`drawing_files` writes as SVG, PDF and DXF. `titled_sheet` is the empty sheet of a part with its title block.
"""

import datetime
import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from probedesign.cad.kernel import mass_properties
from probedesign.cad.model import CadModel, CadPart
from probedesign.cad.projection import Lines
from probedesign.core.errors import InputError
from probedesign.core.frames import Array
from probedesign.core.units import MM
from probedesign.design import Design
from probedesign.design.catalog import ALUMINIUM, MILLED_TOLERANCE, RIGID_RESIN
from probedesign.mount.engraving import DEPTH, Engraving
from probedesign.mount.engraving import HEIGHT as LETTER_HEIGHT

XY = tuple[float, float]
Anchor = Literal["start", "middle", "end"]

WIDTH, HEIGHT, EDGE = 210.0, 297.0, 12.0
TITLE_HEIGHT = 38.0
BOTTOM = HEIGHT - EDGE - TITLE_HEIGHT
"""Upper edge of the title block on the paper [mm]."""
COLUMNS = (4.0, 70.0, 110.0)
"""Columns of the title block, from its left edge."""
ROWS = 4
SCALES = (10.0, 5.0, 2.0, 1.0, 0.5, 0.2, 0.1)  # ISO 5455
TEXT, SMALL = 3.2, 2.6
TEXT_WIDTH = 0.58
"""Mean width of a character of a sans-serif font, over its size."""
ARROW = 2.6
EXTENSION_GAP, EXTENSION_BEYOND = 1.2, 1.5
"""Gap between the outline and an extension line, and its length beyond the dimension line."""
TAG_ANGLE = np.radians(15.0)
"""Least angle of a hole's label from the horizontal axis."""
STACK = 7.5
"""Distance between dimension lines."""


@dataclass(frozen=True)
class Pen:
    """A kind of line, which is also its layer in a CAD file."""

    layer: str  #: name of the layer.
    width: float  #: [mm], ISO 128.
    dash: tuple[float, ...] = ()  #: lengths of strokes and gaps [mm]; empty for a continuous line.


OUTLINE = Pen("OUTLINE", 0.4)
CENTRE = Pen("CENTRE", 0.18, (6.0, 1.2, 0.8, 1.2))
HATCH = Pen("HATCH", 0.18)
DIMENSIONS = Pen("DIMENSIONS", 0.18)
SYMBOLS = Pen("SYMBOLS", 0.18)
SECTION = Pen("SYMBOLS", 0.6)
FRAME = Pen("FRAME", 0.4)
NOTES = Pen("TEXT", 0.18)
PENS = (OUTLINE, CENTRE, HATCH, DIMENSIONS, SYMBOLS, FRAME, NOTES)
"""One pen of each layer."""


@dataclass(frozen=True)
class Strokes:
    """Polylines of one pen."""

    pen: Pen
    lines: list[list[XY]]


@dataclass(frozen=True)
class Arrowhead:
    """A filled polygon, of an arrow or of a datum triangle."""

    pen: Pen
    corners: list[XY]


@dataclass(frozen=True)
class Hatching:
    """Closed outlines of cut material; an outline inside another is a hole."""

    loops: list[list[XY]]


@dataclass(frozen=True)
class Ring:
    """A circle, white inside if it frames a letter."""

    pen: Pen
    centre: XY
    radius: float
    white: bool = False


@dataclass(frozen=True)
class Text:
    """Text on a baseline at a point; `turned` reads from the right."""

    at: XY
    words: str
    size: float = TEXT
    anchor: Anchor = "middle"
    turned: bool = False
    bold: bool = False
    pen: Pen = NOTES


@dataclass(frozen=True)
class Dimension:
    """A linear dimension."""

    a: XY  #: a, b: ends of the dimension line, b to the right of or below a.
    b: XY
    feet: tuple[XY, XY]  #: the points of the outline that are measured, at a and at b.
    words: str  #: the text.
    scale: float  #: of its view.

    @property
    def upright(self) -> bool:
        """Return whether the dimension line is vertical."""
        return self.a[0] == self.b[0]

    @property
    def value(self) -> float:
        """Return the measured length of the part [mm]."""
        return (self.b[0] - self.a[0] + self.b[1] - self.a[1]) / self.scale

    @property
    def text(self) -> Text:
        """Return the text: above the middle of the line, or beyond its end where it does not fit between the arrows."""
        a, b = self.a, self.b
        along = (0.0, 1.0) if self.upright else (1.0, 0.0)
        length = b[0] - a[0] + b[1] - a[1]
        x, y = (a[0] + b[0]) / 2 - along[1], (a[1] + b[1]) / 2 - along[0]
        beyond = length / 2 + 2 * ARROW + 0.8
        if width_of(self.words) <= length - 1.0:
            return Text((x, y), self.words, turned=self.upright, pen=DIMENSIONS)
        if self.upright:
            return Text((x, y - beyond), self.words, anchor="start", turned=True, pen=DIMENSIONS)
        return Text((x + beyond, y + 2.1), self.words, anchor="start", pen=DIMENSIONS)

    def expanded(self) -> Iterator["Item"]:
        """Yield lines, arrows and text; the arrows of a short dimension are outside."""
        a, b = self.a, self.b
        along = (0.0, 1.0) if self.upright else (1.0, 0.0)
        outward = 1.0 if b[0] - a[0] + b[1] - a[1] >= 3 * ARROW else -1.0
        lines = [[a, b]]
        for tip, foot, side in ((a, self.feet[0], -outward), (b, self.feet[1], outward)):
            level = np.sign(tip[0] - foot[0] if self.upright else tip[1] - foot[1])
            across = (float(level), 0.0) if self.upright else (0.0, float(level))
            lines.append([_shifted(foot, across, EXTENSION_GAP), _shifted(tip, across, EXTENSION_BEYOND)])
            if outward < 0.0:
                lines.append([_shifted(tip, along, -2 * ARROW * side), tip])
            yield arrowhead(tip, (side * along[0], side * along[1]), DIMENSIONS)
        yield Strokes(DIMENSIONS, lines)
        yield self.text


Item = Strokes | Arrowhead | Hatching | Ring | Text | Dimension


def _shifted(p: XY, direction: XY, by: float) -> XY:
    return p[0] + by * direction[0], p[1] + by * direction[1]


def width_of(words: str, size: float = TEXT) -> float:
    """Return the approximate width of a text [mm]."""
    return TEXT_WIDTH * size * len(words)


def arrowhead(tip: XY, direction: XY, pen: Pen) -> Arrowhead:
    """Return an arrowhead that points in a direction of unit length."""
    back, side = _shifted(tip, direction, -ARROW), (-direction[1], direction[0])
    return Arrowhead(pen, [tip, _shifted(back, side, ARROW / 6), _shifted(back, side, -ARROW / 6)])


def number(value: float) -> str:
    """Return a dimension in millimetres, to the hundredth."""
    return f"{round(value, 2) + 0.0:g}"


@dataclass
class Sheet:
    """One A4 sheet with frame and title block."""

    title: str  #: of the part.
    scale: float  #: of its main views.
    items: list[Item] = field(default_factory=list)  #: in the order in which they are drawn.

    def frame(self, rows: Sequence[tuple[str, str]]) -> None:
        """Draw the frame and the title block with name and value of each field, and the symbol of the projection."""
        left, right, bottom = EDGE, WIDTH - EDGE, HEIGHT - EDGE
        for y in (EDGE, BOTTOM):
            self.items.append(Strokes(FRAME, [[(left, y), (right, y), (right, bottom), (left, bottom), (left, y)]]))
        self.items.append(Text((left + 4, BOTTOM + 9), self.title, 5.0, "start", bold=True))
        for i, (name, value) in enumerate(rows):
            x, y = left + COLUMNS[i // ROWS], BOTTOM + 16.5 + 6.2 * (i % ROWS)
            self.items.append(Text((x, y), name, SMALL, "start"))
            self.items.append(Text((x + 17, y), value, anchor="start"))
        self._projection_symbol((right - 22.0, BOTTOM + 7.5))

    def _projection_symbol(self, at: XY) -> None:
        """Draw a truncated cone and its view from the left to the right of it: first angle, ISO 5456-2."""
        (x, y), small, large, half = at, 1.5, 3.0, 4.0
        cone = [(x - half, y - small), (x + half, y - large), (x + half, y + large), (x - half, y + small)]
        end = (x + half + 8.0, y)
        axes = [[(x - half - 1.5, y), (x + half + 1.5, y)], [(end[0] - 4.5, y), (end[0] + 4.5, y)],
                [(end[0], y - 4.5), (end[0], y + 4.5)]]  # fmt: skip
        self.items += [Strokes(SYMBOLS, [[*cone, cone[0]]]), Ring(SYMBOLS, end, small), Ring(SYMBOLS, end, large)]
        self.items.append(Strokes(CENTRE, axes))

    def note(self, at: XY, lines: Sequence[str], size: float = TEXT) -> None:
        """Write lines of text, the first baseline at a point."""
        self.items += [Text((at[0], at[1] + 1.55 * size * i), line, size, "start") for i, line in enumerate(lines)]

    def expanded(self) -> Iterator[Strokes | Arrowhead | Hatching | Ring | Text]:
        """Yield the items, dimensions as lines, arrows and text."""
        for item in self.items:
            if isinstance(item, Dimension):
                yield from item.expanded()  # type: ignore[misc]  # no dimension contains another
            else:
                yield item


def scale_for(size: tuple[float, float], room: tuple[float, float]) -> float:
    """Return the largest standard scale at which a size [mm] fits into the space on paper [mm]."""
    fits = [s for s in SCALES if s * size[0] <= room[0] and s * size[1] <= room[1]]
    return fits[0] if fits else min(room[0] / size[0], room[1] / size[1])


def scale_text(scale: float) -> str:
    """Return a scale as written on drawings."""
    return f"{scale:g} : 1" if scale >= 1.0 else f"1 : {number(1.0 / scale)}"


@dataclass(frozen=True)
class SheetView:
    """A view on a sheet with its dimensions; points of the part are (u, v) [mm], v up."""

    sheet: Sheet  #: that it is drawn on.
    origin: XY  #: position of the part's origin on the paper.
    scale: float  #: paper over part.

    def at(self, p: XY) -> XY:
        """Return a point of the part on paper."""
        return self.origin[0] + self.scale * p[0], self.origin[1] - self.scale * p[1]

    def outline(self, lines: Lines) -> None:
        """Draw visible edges."""
        self.sheet.items.append(Strokes(OUTLINE, [self._line(line) for line in lines]))

    def section(self, faces: list[Lines]) -> None:
        """Hatch section faces."""
        self.sheet.items += [Hatching([self._line(loop) for loop in loops]) for loops in faces]

    def _line(self, line: Array) -> list[XY]:
        return [self.at((float(u), float(v))) for u, v in line]

    def _add(self, pen: Pen, lines: Iterable[Iterable[XY]]) -> None:
        self.sheet.items.append(Strokes(pen, [list(line) for line in lines]))

    def caption(self, words: str, below_v: float, drop: float = 12.0) -> None:
        """Write the view's caption below its lowest v."""
        x, y = self.at((0.0, below_v))
        self.sheet.items.append(Text((x, y + drop), words, bold=True))

    def axis(self, a: XY, b: XY) -> None:
        """Draw a line of symmetry, slightly beyond its ends."""
        (x0, y0), (x1, y1) = self.at(a), self.at(b)
        length = max(float(np.hypot(x1 - x0, y1 - y0)), 1e-9)
        along = ((x1 - x0) / length, (y1 - y0) / length)
        self._add(CENTRE, [[_shifted((x0, y0), along, -3.0), _shifted((x1, y1), along, 3.0)]])

    def cross(self, half: float) -> None:
        """Draw both axes of a round view of that half-width [mm of the part]."""
        self.axis((-half, 0.0), (half, 0.0))
        self.axis((0.0, -half), (0.0, half))

    def centres(self, points: Sequence[XY], size: float) -> None:
        """Draw a centre mark on each hole; `size` is the length of its arms [mm of the part]."""
        for u, v in points:
            self._add(SYMBOLS, [[self.at((u - size, v)), self.at((u + size, v))],
                                [self.at((u, v - size)), self.at((u, v + size))]])  # fmt: skip

    def bolt_circle(self, diameter: float) -> None:
        """Draw the circle of a hole pattern."""
        self.sheet.items.append(Ring(CENTRE, self.at((0.0, 0.0)), self.scale * diameter / 2))

    def tag(self, p: XY, out_to: float, label: str) -> None:
        """Draw a label outside the part with a line to a hole; `out_to` is the radius of the part [mm].

        It is beside the horizontal axis, whose ends are for the arrows of a section.
        """
        angle = float(np.arctan2(p[1], p[0]))
        if abs(np.sin(angle)) < np.sin(TAG_ANGLE):
            angle = float(np.arctan2(-np.sin(TAG_ANGLE), np.copysign(np.cos(TAG_ANGLE), p[0])))
        direction = (float(np.cos(angle)), float(-np.sin(angle)))
        rim = self.at((out_to * direction[0], -out_to * direction[1]))
        middle = _shifted(rim, direction, 8.8)
        self._add(SYMBOLS, [[self.at(p), _shifted(rim, direction, 6.0)]])
        self.sheet.items.append(Ring(SYMBOLS, middle, 2.8, white=True))
        self.sheet.items.append(Text((middle[0], middle[1] + 1.15), label, bold=True))

    def dimension_u(self, u0: float, u1: float, from_v: float, offset: float, words: str) -> None:
        """Draw a dimension along u, `offset` above (+) or below (-) v [mm of paper]."""
        feet = (self.at((u0, from_v)), self.at((u1, from_v)))
        level = feet[0][1] - offset
        self.sheet.items.append(Dimension((feet[0][0], level), (feet[1][0], level), feet, words, self.scale))

    def dimension_v(
        self, v0: float, v1: float, from_u: float, offset: float, words: str, top_u: float | None = None
    ) -> None:
        """Draw a dimension along v, `offset` to the right (+) or left (-) of u [mm of paper].

        At v1 the extension line starts at `top_u`, if given.
        """
        low, high = self.at((from_u, v0)), self.at((from_u if top_u is None else top_u, v1))
        level = low[0] + offset
        item = Dimension((level, high[1]), (level, low[1]), (high, low), words, self.scale)
        self.sheet.items.append(item)

    def leader(self, p: XY, to: XY, words: str) -> None:
        """Draw a note with an arrow to a point; `to` is the offset of the text from that point [mm of paper, y up].

        Further lines of the note are above the first, and smaller.
        """
        tip = self.at(p)
        elbow = (tip[0] + to[0], tip[1] - to[1])
        length = max(float(np.hypot(*to)), 1e-9)
        self._add(DIMENSIONS, [[tip, elbow]])
        self.sheet.items.append(arrowhead(tip, (-to[0] / length, to[1] / length), DIMENSIONS))
        anchor: Anchor = "start" if to[0] >= 0 else "end"
        x, y = elbow[0] + (1.0 if to[0] >= 0 else -1.0), elbow[1] + 1.1
        for i, line in enumerate(words.splitlines()):
            size = SMALL if i else TEXT
            self.sheet.items.append(Text((x, y - 1.5 * SMALL * i), line, size, anchor, pen=DIMENSIONS))

    def cutting_plane(self, half: float, v: float, letter: str, up: bool = True) -> None:
        """Draw the line of a section at height v, thick at its ends, with arrows in the direction of view and letters.

        Args:
            half: half the width of the view [mm of the part].
            v: of the plane [mm of the part].
            letter: of the section.
            up: whether it is viewed towards the top of the paper.
        """
        towards = -1.0 if up else 1.0
        for side in (-1.0, 1.0):
            x, y = self.at((side * half, v))
            inner, outer = (x + 4.0 * side, y), (x + 10.0 * side, y)
            tip = (x + 8.5 * side, y + 7.0 * towards)
            self._add(SECTION, [[inner, outer]])
            self._add(SYMBOLS, [[(tip[0], y), tip]])
            self.sheet.items.append(arrowhead(tip, (0.0, towards), SYMBOLS))
            self.sheet.items.append(Text((tip[0] + 3.0 * side, tip[1] - 2.0 * towards + 1.1), letter, bold=True))

    def viewing_arrow(self, p: XY, letter: str) -> None:
        """Draw the arrow of a view from below, under a point, with its letter."""
        tip = _shifted(self.at(p), (0.0, 1.0), 3.0)
        self._add(SYMBOLS, [[tip, (tip[0], tip[1] + 7.0)]])
        self.sheet.items.append(arrowhead(tip, (0.0, -1.0), SYMBOLS))
        self.sheet.items.append(Text((tip[0] + 3.0, tip[1] + 6.0), letter, bold=True))

    def datum(self, p: XY, letter: str, offset: float) -> None:
        """Draw the symbol of a datum on an extension of a horizontal face at p, `offset` to the left [mm of paper]."""
        x, y = self.at(p)
        foot = (x - offset, y)
        box = [(foot[0] - 2.4, y + 6.0), (foot[0] + 2.4, y + 6.0), (foot[0] + 2.4, y + 10.8), (foot[0] - 2.4, y + 10.8)]
        lines = [[(x - EXTENSION_GAP, y), (foot[0] - 3.0, y)], [(foot[0], y + 2.4), (foot[0], y + 6.0)], [*box, box[0]]]
        self._add(SYMBOLS, lines)
        self.sheet.items.append(Arrowhead(SYMBOLS, [foot, (foot[0] - 1.5, y + 2.4), (foot[0] + 1.5, y + 2.4)]))
        self.sheet.items.append(Text((foot[0], y + 9.5), letter))


TOLERANCE = "±0.5 %, at least ±0.15 (assumed)"
"""Tolerance of a stereolithography print; the manufacturer publishes none for the soft resin."""
MILLED = f"±{number(MILLED_TOLERANCE / MM)}, all lengths"
DATE_VARIABLE = "SOURCE_DATE_EPOCH"
"""Environment variable with the time of the sources in seconds since 1970 (reproducible-builds.org)."""


def titled_sheet(model: CadModel, part: CadPart, scale: float) -> Sheet:
    """Return an empty sheet for a part at a scale."""
    design, milled = model.design, part.name != "probe" and model.adapter.options.milled
    resin = design.resin.name if part.name == "probe" else ALUMINIUM if milled else RIGID_RESIN
    grams = 1e3 * mass_properties(part.shape, part.density).mass
    sheet = Sheet(f"{design.name}: {part.name.replace('_', ' ')}", scale)
    sheet.frame([
        ("revision", model.geometry.fingerprint), ("material", resin), ("mass", f"{grams:.3g} g"),
        ("file", f"{part.name}.stl"),
        ("scale", scale_text(scale)), ("units", "mm"), ("frame", part.frame.replace("_", " ")),
        ("date", drawing_date(design)),
        ("tolerance", MILLED if milled else TOLERANCE), ("angles", "about +z from +x"),
        ("edges", "broken, at most 0.2" if milled else "as printed"),
        ("projection", "first angle, ISO 5456-2"),
    ])  # fmt: skip
    return sheet


def drawing_date(design: Design) -> str:
    """Return the date of a drawing: that of the design, or of SOURCE_DATE_EPOCH; empty without either, because equal
    designs have equal files.

    Raises:
        InputError: SOURCE_DATE_EPOCH is not a number of seconds.
    """
    if design.date is not None:
        return design.date
    value = os.environ.get(DATE_VARIABLE)
    if value is None:
        return ""
    try:
        return datetime.datetime.fromtimestamp(int(value), datetime.UTC).date().isoformat()
    except (ValueError, OverflowError, OSError):
        raise InputError(f"{DATE_VARIABLE} = {value!r} is not a number of seconds since 1970; unset it") from None


def engraving_note(engraving: Engraving, where: str) -> list[str]:
    """Return the note on an engraving, or none if nothing is engraved."""
    if not engraving.text:
        return []
    return [f"engraved on {where}: {engraving.text}, {number(LETTER_HEIGHT / MM)} high, {number(DEPTH / MM)} deep"]
