"""One figure as an SVG element with real text: axes, lines, cells and areas, made to be read at half size and in print.

Light on purpose: a page draws a dozen of them in a few milliseconds, and asks for no plotting library.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from html import escape
from typing import NamedTuple

COLOURS = ("#000000", "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
"""Okabe and Ito's, for colour-blind readers; markers and dashes tell them apart in grey. Source: M. Okabe, K. Ito,
Color Universal Design, 2008."""
ORDERED = ("#440154", "#443983", "#31688e", "#21918c", "#35b779", "#90d743", "#fde725")
"""From little to much, in order for colour-blind readers and in grey.
Source: viridis, S. van der Walt, N. Smith, 2015."""
DASHES = ("", "7 4", "2 3", "9 3 2 3", "5 2", "1 2", "12 4")
MARKS = "osd^vx+"
_WIDTH, _HEIGHT, _LEFT, _RIGHT, _TOP, _BOTTOM = 440.0, 290.0, 58.0, 10.0, 10.0, 46.0
_LEGEND = 19.0  # height of a line of it
_LETTER = 7.2  # mean width of a letter at the size of a legend
_LETTERS = 7  # that stand beside a y axis; more are written smaller
_SMALL = 6.0  # likewise of upright names


@dataclass(frozen=True)
class Axis:
    """One axis.

    Attributes:
        label: with the unit.
        low, high: its ends.
        log: whether it is logarithmic.
        ticks: values that are told; 1, 2 and 5 times the powers of ten or even steps if None.
        names: of the ticks; their numbers if empty.
        upright: of an x axis, whether its names are small and read upwards, as many do.
    """

    label: str
    low: float
    high: float
    log: bool = False
    ticks: tuple[float, ...] | None = None
    names: tuple[str, ...] = ()
    upright: bool = False

    @classmethod
    def named(cls, label: str, names: Sequence[str], upright: bool = False) -> "Axis":
        """One place for each name, the first at 1."""
        n = len(names)
        ticks = tuple(float(k) for k in range(1, n + 1))
        return cls(label, 0.5, n + 0.5, ticks=ticks, names=tuple(names), upright=upright)

    def share(self, value: float) -> float:
        """Of the axis' length from its low end."""
        low, high, v = (math.log(x) if self.log else x for x in (self.low, self.high, value))
        return (v - low) / (high - low)

    @property
    def told(self) -> tuple[float, ...]:
        """Values with a tick."""
        if self.ticks is not None:
            return tuple(t for t in self.ticks if self.low <= t <= self.high)
        return _decades(self.low, self.high) if self.log else _even(self.low, self.high)

    @property
    def room(self) -> float:
        """That upright names take below the others' line, in the drawing's units."""
        return _SMALL * max(map(len, self.names), default=0) if self.upright else 0.0

    @property
    def words(self) -> tuple[str, ...]:
        """What stands at them."""
        return self.names or tuple(f"{v:g}" for v in self.told)


def _decades(low: float, high: float) -> tuple[float, ...]:
    powers = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    wide = math.log10(high / low) > 3.2
    found = (digit * 10.0**k for k in powers for digit in ((1,) if wide else (1, 2, 5)))
    return tuple(float(f"{v:.3g}") for v in found if low * 0.999 <= v <= high * 1.001)


def _even(low: float, high: float) -> tuple[float, ...]:
    raw = (high - low) / 5.0
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(k * power for k in (1.0, 2.0, 5.0, 10.0) if k * power >= 0.999 * raw)
    first = math.ceil(low / step - 1e-9)
    return tuple(round(k * step, 12) for k in range(first, math.floor(high / step + 1e-9) + 1))


def span_of(values: Sequence[float], log: bool) -> tuple[float, float]:
    """Ends of an axis that shows all of these, with some room; what is not finite or, on a logarithmic axis, not
    positive is left out."""
    shown = [v for v in values if math.isfinite(v) and (v > 0.0 or not log)]
    low, high = (min(shown), max(shown)) if shown else (1.0, 10.0)
    if log:
        return low / 1.3, high * 1.3
    room = 0.05 * (high - low) or 1.0
    return low - room, high + room


class Entry(NamedTuple):
    """Of a legend; dashes are None for an area."""

    name: str
    colour: str
    dashes: str | None = None
    mark: str = ""


@dataclass
class Chart:
    """Axes and what is drawn in them, first drawn lowest.

    Attributes:
        x, y: the axes; y upwards unless `down`.
        square: whether a unit is as long on both; the wider axis is then made longer at its high end.
        down: whether y grows downwards.
        legend: what is told above the axes.
    """

    x: Axis
    y: Axis
    square: bool = False
    down: bool = False
    legend: list[Entry] = field(default_factory=list)
    _drawn: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        """Widens what must be square."""
        if self.square:
            wide, high = _WIDTH - _LEFT - _RIGHT, _HEIGHT - _TOP - _BOTTOM - 2 * _LEGEND
            unit = max((self.x.high - self.x.low) / wide, (self.y.high - self.y.low) / high)
            self.x = _widened(self.x, unit * wide)
            self.y = _widened(self.y, unit * high)

    def at(self, x: float, y: float) -> tuple[float, float]:
        """Where a point stands in the drawing, below the legend's place."""
        up = self.y.share(y)
        high = self._high
        return (
            _LEFT + self.x.share(x) * (_WIDTH - _LEFT - _RIGHT),
            _TOP + (up if self.down else 1.0 - up) * high,
        )

    @property
    def _high(self) -> float:
        return _HEIGHT - _TOP - _BOTTOM - (2 * _LEGEND if self.square else 0.0)

    def line(
        self, x: Sequence[float], y: Sequence[float], colour: str, dashes: str = "", mark: str = "", name: str = "",
        width: float = 2.0,
    ) -> None:  # fmt: skip
        """Points in a line, broken where one is not finite; named in the legend."""
        run: list[tuple[float, float]] = []
        for a, b in [*zip(x, y, strict=True), (math.nan, math.nan)]:
            if math.isfinite(a) and math.isfinite(b):
                run.append(self.at(a, b))
                continue
            if len(run) > 1:
                path = "M" + "L".join(f"{p:.1f} {q:.1f}" for p, q in run)
                self._drawn.append(f'<path d="{path}" fill="none" stroke="{colour}" stroke-width="{width:g}" '
                                   f'stroke-dasharray="{dashes}" stroke-linejoin="round"/>')  # fmt: skip
            self._drawn += [_mark(mark, p, q, colour) for p, q in run if mark]
            run = []
        if name:
            self.legend.append(Entry(name, colour, dashes, mark))

    def area(
        self, points: Sequence[tuple[float, float]], colour: str, opacity: float = 0.2, name: str = ""
    ) -> None:
        """A filled polygon."""
        corners = " ".join(f"{p:.1f},{q:.1f}" for p, q in (self.at(*point) for point in points))
        self._drawn.append(f'<polygon points="{corners}" fill="{colour}" fill-opacity="{opacity:g}"/>')
        if name:
            self.legend.append(Entry(name, colour))

    def box(self, x: tuple[float, float], y: tuple[float, float], fill: str, edge: str = "#fff") -> None:
        """A filled rectangle."""
        (a, b), (c, d) = self.at(x[0], y[0]), self.at(x[1], y[1])
        self._drawn.append(f'<rect x="{min(a, c):.1f}" y="{min(b, d):.1f}" width="{abs(c - a):.1f}" '
                           f'height="{abs(d - b):.1f}" fill="{fill}" stroke="{edge}"/>')  # fmt: skip

    def text(
        self, x: float, y: float, words: str, colour: str = "#111", size: float = 12.0, turned: bool = False
    ) -> None:
        """Words about a point; turned to read upwards."""
        p, q = self.at(x, y)
        turn = f' transform="rotate(-90 {p:.1f} {q:.1f})"' if turned else ""
        self._drawn.append(f'<text x="{p:.1f}" y="{q + 0.36 * size:.1f}" text-anchor="middle" fill="{colour}" '
                           f'font-size="{size:g}"{turn}>{escape(words)}</text>')  # fmt: skip

    def svg(self) -> bytes:
        """The element."""
        rows = _rows(self.legend)
        above = _LEGEND * len(rows)
        whole = above + _TOP + self._high + _BOTTOM + self.x.room
        told = "".join(_told(row, _LEGEND * (i + 0.7)) for i, row in enumerate(rows))
        return (
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH:g} {whole:g}" '
            f'font-family="Helvetica, Arial, sans-serif" font-size="13">{told}'
            f'<g transform="translate(0 {above:g})">{self._grid()}{"".join(self._drawn)}{self._frame()}</g></svg>'
        ).encode()

    def _grid(self) -> str:
        left, right, top, bottom = _LEFT, _WIDTH - _RIGHT, _TOP, _TOP + self._high
        if self.x.names:  # boxes stand there
            return ""
        across = "".join(f"M{left} {self.at(self.x.low, v)[1]:.1f}H{right}" for v in self.y.told)
        up = "".join(f"M{self.at(v, self.y.low)[0]:.1f} {top}V{bottom}" for v in self.x.told)
        return f'<path d="{across}{up}" stroke="#ddd" fill="none"/>'

    def _below(self, x: float, y: float, word: str) -> str:
        """A name of the x axis, under its tick."""
        if not self.x.upright:
            return f'<text x="{x:.1f}" y="{y + 17}" text-anchor="middle">{escape(word)}</text>'
        return (
            f'<text x="{x + 3.5:.1f}" y="{y + 7}" text-anchor="end" font-size="10" '
            f'transform="rotate(-90 {x + 3.5:.1f} {y + 7})">{escape(word)}</text>'
        )

    def _frame(self) -> str:
        left, top, high = _LEFT, _TOP, self._high
        words = [f'<rect x="{left}" y="{top}" width="{_WIDTH - _LEFT - _RIGHT}" height="{high}" fill="none" '
                 'stroke="#111"/>']  # fmt: skip
        for v, word in zip(self.x.told, self.x.words, strict=True):
            words.append(self._below(self.at(v, self.y.low)[0], top + high, word))
        for v, word in zip(self.y.told, self.y.words, strict=True):
            size = ' font-size="10"' if len(word) > _LETTERS else ""
            words.append(f'<text x="{left - 6}" y="{self.at(self.x.low, v)[1] + 4.5:.1f}" '
                         f'text-anchor="end"{size}>{escape(word)}</text>')  # fmt: skip
        middle, half = (_LEFT + _WIDTH - _RIGHT) / 2.0, top + high / 2.0
        words.append(f'<text x="{middle}" y="{top + high + 38 + self.x.room:g}" text-anchor="middle" font-size="14">'
                     f"{escape(self.x.label)}</text>")  # fmt: skip
        words.append(f'<text x="15" y="{half}" text-anchor="middle" font-size="14" '
                     f'transform="rotate(-90 15 {half})">{escape(self.y.label)}</text>')  # fmt: skip
        return "".join(words)


def _widened(axis: Axis, length: float) -> Axis:
    """The same axis with both ends as far out as makes it so long."""
    more = (length - (axis.high - axis.low)) / 2.0
    return Axis(axis.label, axis.low - more, axis.high + more, axis.log, axis.ticks)


def _rows(
    legend: Sequence[Entry],
) -> list[list[tuple[float, Entry]]]:
    """Entries with where each begins, as many in a row as there is room for."""
    rows: list[list[tuple[float, Entry]]] = []
    place = _WIDTH
    for entry in legend:
        wide = 38.0 + _LETTER * len(entry[0])
        if place + wide > _WIDTH:
            rows.append([])
            place = _LEFT
        rows[-1].append((place, entry))
        place += wide
    return rows


def _told(row: Sequence[tuple[float, Entry]], y: float) -> str:
    """One row of a legend: a stroke for a line, a square for an area."""
    parts = []
    for x, (name, colour, dashes, mark) in row:
        if dashes is None:
            parts.append(f'<rect x="{x + 6:g}" y="{y - 6:g}" width="14" height="12" fill="{colour}"/>')
        else:
            parts.append(
                f'<path d="M{x:g} {y:g}h26" stroke="{colour}" stroke-width="2" stroke-dasharray="{dashes}"/>'
            )
            parts.append(_mark(mark, x + 13, y, colour))
        parts.append(f'<text x="{x + 31:g}" y="{y + 4.5:g}">{escape(name)}</text>')
    return "".join(parts)


def _mark(mark: str, x: float, y: float, colour: str) -> str:
    """A small sign about a point."""
    if mark == "o":
        return f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3.4" fill="{colour}"/>'
    shapes = {"s": "M-3.2-3.2h6.4v6.4h-6.4z", "d": "M0-4.4l4.4 4.4-4.4 4.4-4.4-4.4z", "^": "M0-4.2l4.2 7.4h-8.4z",
              "v": "M0 4.2l4.2-7.4h-8.4z", "x": "M-4-4l8 8m0-8l-8 8", "+": "M-4 0h8m-4-4v8"}  # fmt: skip
    if mark not in shapes:
        return ""
    ink = f'fill="none" stroke="{colour}" stroke-width="2"' if mark in "x+" else f'fill="{colour}"'
    return f'<path transform="translate({x:.1f} {y:.1f})" d="{shapes[mark]}" {ink}/>'
