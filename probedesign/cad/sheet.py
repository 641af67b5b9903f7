"""An A4 sheet: frame, title block, views to scale, dimensions and notes. Paper in millimetres, y down."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from probedesign.cad.projection import Lines
from probedesign.cad.svg import Point, Svg
from probedesign.frames import Array

WIDTH, HEIGHT, EDGE = 210.0, 297.0, 12.0
TITLE_HEIGHT = 32.0
COLUMNS = (4.0, 74.0, 110.0)
"""Of the title block, from its left."""
SCALES = (10.0, 5.0, 2.0, 1.0, 0.5, 0.2, 0.1)  # ISO 5455
THICK, THIN = 0.4, 0.18  # line widths, ISO 128
TEXT, SMALL = 3.2, 2.6
ARROW = 2.6
AROUND = 1.2
"""From the outline to the foot of an extension line."""
CENTRE_DASH = "6 1.2 0.8 1.2"


def number(value: float) -> str:
    """A dimension in millimetres, to the hundredth."""
    return f"{round(value, 2) + 0.0:g}"


@dataclass(frozen=True)
class Box:
    """A rectangle of paper."""

    x: float
    y: float
    width: float
    height: float


class Sheet:
    """One A4 sheet.

    Args:
        title: of the part.
        rows: name and value of the title block's other fields.
    """

    def __init__(self, title: str, rows: Sequence[tuple[str, str]]) -> None:
        self.svg = Svg(WIDTH, HEIGHT, unit="mm", title=title)
        left, right, bottom = EDGE, WIDTH - EDGE, HEIGHT - EDGE
        top = bottom - TITLE_HEIGHT
        self._rectangle(left, EDGE, right, bottom, THICK)
        self._rectangle(left, top, right, bottom, THICK)
        self.svg.text((left + 4, top + 9), title, 5.0, anchor="start", bold=True)
        for i, (name, value) in enumerate(rows):
            x, y = left + COLUMNS[i // 3], top + 16.5 + 6.2 * (i % 3)
            self.svg.text((x, y), name, SMALL, anchor="start")
            self.svg.text((x + 17, y), value, TEXT, anchor="start")

    def _rectangle(self, x0: float, y0: float, x1: float, y1: float, width: float) -> None:
        self.svg.polylines([[(x0, y0), (x1, y0), (x1, y1), (x0, y1), (x0, y0)]], width)

    def note(self, at: Point, lines: Sequence[str], size: float = TEXT) -> None:
        """Lines of text, the first baseline at a point."""
        for i, line in enumerate(lines):
            self.svg.text((at[0], at[1] + 1.55 * size * i), line, size, anchor="start")


def scale_for(size: tuple[float, float], room: tuple[float, float]) -> float:
    """The largest standard scale at which something [mm] goes into the room on paper [mm]."""
    fits = [s for s in SCALES if s * size[0] <= room[0] and s * size[1] <= room[1]]
    return fits[0] if fits else min(room[0] / size[0], room[1] / size[1])


def scale_text(scale: float) -> str:
    """As it is written on drawings."""
    return f"{scale:g} : 1" if scale >= 1.0 else f"1 : {number(1.0 / scale)}"


@dataclass(frozen=True)
class View:
    """A view on a sheet, and the dimensions drawn to it; points of the part are (u, v) [mm], v up.

    Attributes:
        sheet: it lies on.
        origin: where the part's origin lies on the paper.
        scale: of it.
    """

    sheet: Sheet
    origin: Point
    scale: float

    def at(self, p: Point) -> Point:
        """On paper."""
        return self.origin[0] + self.scale * p[0], self.origin[1] - self.scale * p[1]

    def outline(self, lines: Lines) -> None:
        """Visible edges."""
        self.sheet.svg.polylines([self._line(line) for line in lines], THICK)

    def hatch(self, faces: list[Lines]) -> None:
        """Cut faces."""
        for loops in faces:
            self.sheet.svg.hatched([self._line(loop) for loop in loops])

    def _line(self, line: Array) -> list[Point]:
        return [self.at((float(u), float(v))) for u, v in line]

    def caption(self, words: str, below_v: float, drop: float = 12.0) -> None:
        """What is seen, under the view's lowest v."""
        x, y = self.at((0.0, below_v))
        self.sheet.svg.text((x, y + drop), words, TEXT, bold=True)

    def axis(self, a: Point, b: Point) -> None:
        """A line of symmetry, drawn a little beyond its ends."""
        (x0, y0), (x1, y1) = self.at(a), self.at(b)
        length = max(float(np.hypot(x1 - x0, y1 - y0)), 1e-9)
        dx, dy = 3.0 * (x1 - x0) / length, 3.0 * (y1 - y0) / length
        self.sheet.svg.line((x0 - dx, y0 - dy), (x1 + dx, y1 + dy), THIN, dash=CENTRE_DASH)

    def centres(self, points: Sequence[Point], size: float) -> None:
        """A cross on each hole, `size` from its middle to its ends [mm of the part]."""
        for u, v in points:
            self.sheet.svg.polylines(
                [[self.at((u - size, v)), self.at((u + size, v))], [self.at((u, v - size)), self.at((u, v + size))]],
                THIN,
            )  # fmt: skip

    def bolt_circle(self, diameter: float) -> None:
        """The circle that holes lie on."""
        angle = np.linspace(0.0, 2.0 * np.pi, 97)
        ring = [self.at((float(diameter / 2 * np.cos(a)), float(diameter / 2 * np.sin(a)))) for a in angle]
        self.sheet.svg.polylines([ring], THIN, dash=CENTRE_DASH)

    def tag(self, p: Point, out_to: float, letter: str) -> None:
        """A letter outside the part, with a line to a hole; `out_to` is the radius where it stands [mm of the part]."""
        angle = np.arctan2(p[1], p[0])
        direction = (float(np.cos(angle)), float(-np.sin(angle)))
        x, y = self.at((out_to * direction[0], -out_to * direction[1]))
        foot = (x + 6.0 * direction[0], y + 6.0 * direction[1])
        middle = (x + 8.8 * direction[0], y + 8.8 * direction[1])
        self.sheet.svg.line(self.at(p), foot, THIN)
        self.sheet.svg.circle(middle, 2.8, fill="#fff", colour="#000", width=THIN)
        self.sheet.svg.text((middle[0], middle[1] + 1.15), letter, TEXT, bold=True)

    def across(self, u0: float, u1: float, from_v: float, offset: float, words: str) -> None:
        """A dimension along u, `offset` above (+) or below (-) v [mm of paper]."""
        (x0, y), (x1, _) = self.at((u0, from_v)), self.at((u1, from_v))
        level, way = y - offset, np.sign(offset)
        for x in (x0, x1):
            self.sheet.svg.line((x, y - AROUND * way), (x, level - 1.5 * way), THIN)
        if x1 - x0 >= 3 * ARROW:
            self._arrow_line((x0, level), (x1, level))
        else:
            self._arrows_outside((x0, level), (x1, level), (1.0, 0.0))
        self._words(((x0 + x1) / 2, level - 1.0), x1 - x0, words, turned=False)

    def upright(
        self, v0: float, v1: float, from_u: float, offset: float, words: str, top_u: float | None = None
    ) -> None:
        """A dimension along v, `offset` to the right (+) or left (-) of u [mm of paper].

        At v1 the part is as wide as `top_u`, if that is another u.
        """
        (foot, y0), (_, y1) = self.at((from_u, v0)), self.at((from_u, v1))
        head, _ = self.at((from_u if top_u is None else top_u, v1))
        level, way = foot + offset, np.sign(offset)
        for x, y in ((foot, y0), (head, y1)):
            self.sheet.svg.line((x + AROUND * way, y), (level + 1.5 * way, y), THIN)
        if y0 - y1 >= 3 * ARROW:
            self._arrow_line((level, y1), (level, y0))
        else:
            self._arrows_outside((level, y1), (level, y0), (0.0, 1.0))
        self._words((level - 1.0, (y0 + y1) / 2), y0 - y1, words, turned=True)

    def pointed(self, p: Point, to: Point, words: str) -> None:
        """A note with an arrow to a point; `to` is where the words begin, from that point [mm of paper, y up]."""
        x, y = self.at(p)
        elbow = (x + to[0], y - to[1])
        length = max(float(np.hypot(*to)), 1e-9)
        self._arrow((x, y), (-to[0] / length, to[1] / length))
        self.sheet.svg.line((x, y), elbow, THIN)
        anchor, gap = ("start", 1.0) if to[0] >= 0 else ("end", -1.0)
        self.sheet.svg.text((elbow[0] + gap, elbow[1] + 1.1), words, TEXT, anchor=anchor)

    def _arrow_line(self, a: Point, b: Point) -> None:
        self.sheet.svg.line(a, b, THIN)
        length = float(np.hypot(b[0] - a[0], b[1] - a[1]))
        way = ((b[0] - a[0]) / length, (b[1] - a[1]) / length)
        self._arrow(b, way)
        self._arrow(a, (-way[0], -way[1]))

    def _arrows_outside(self, a: Point, b: Point, way: Point) -> None:
        for tip, sign in ((a, 1.0), (b, -1.0)):
            tail = (tip[0] - sign * 2 * ARROW * way[0], tip[1] - sign * 2 * ARROW * way[1])
            self.sheet.svg.line(tail, tip, THIN)
            self._arrow(tip, (sign * way[0], sign * way[1]))
        self.sheet.svg.line(a, b, THIN)

    def _arrow(self, tip: Point, way: Point) -> None:
        back = (tip[0] - ARROW * way[0], tip[1] - ARROW * way[1])
        side = (-way[1] * ARROW / 6, way[0] * ARROW / 6)
        self.sheet.svg.area(
            [[tip, (back[0] + side[0], back[1] + side[1]), (back[0] - side[0], back[1] - side[1])]], "#000"
        )

    def _words(self, at: Point, room: float, words: str, turned: bool) -> None:
        """On the dimension line, or beyond its end where they would not go between the arrows."""
        wide = 0.58 * TEXT * len(words)  # of a common sans-serif
        if wide <= room - 1.0:
            self.sheet.svg.text(at, words, TEXT, turned=turned)
        elif turned:
            self.sheet.svg.text(
                (at[0], at[1] - room / 2 - 2 * ARROW - 0.8), words, TEXT, anchor="start", turned=True
            )
        else:
            self.sheet.svg.text(
                (at[0] + room / 2 + 2 * ARROW + 0.8, at[1] + 2.1), words, TEXT, anchor="start"
            )
