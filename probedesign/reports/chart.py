"""Charts as data, drawn as an SVG element; `reports.notebook` draws them into matplotlib axes.

A chart lists axes, lines, areas, boxes and labels. The SVG has real text and needs no plotting library, so a page with
a dozen charts takes a few milliseconds; it is legible at half size and in print.
"""

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from probedesign.core.svg import element, number, path_data

#: Distinct colours for colour-blind readers; markers and dashes distinguish lines in grey. Source: M. Okabe, K. Ito,
#: Color Universal Design, 2008.
COLOURS = ("#000000", "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
#: Ordered colours from low to high, for colour-blind readers and in grey. Source: viridis, S. van der Walt, N. Smith,
#: 2015.
ORDERED = ("#440154", "#443983", "#31688e", "#21918c", "#35b779", "#90d743", "#fde725")
_LINES_TO = 3.5  # of `ORDERED`: lighter colours have a contrast below 3 on white paper (WCAG 2.2, 1.4.11)
DASHES = ("", "7 4", "2 3", "9 3 2 3", "5 2", "1 2", "12 4")
NO_LINE = "0 99"  # dashes of a legend entry that shows a marker only
MARKS = "osd^vx+"
_WIDTH, _HEIGHT, _LEFT, _RIGHT, _TOP, _BOTTOM = 440.0, 290.0, 58.0, 16.0, 10.0, 46.0
_LEGEND = 19.0  # height of a legend row
_LETTER = 7.8  # mean width of a letter in the legend
_LETTERS = 7  # maximum length of a y tick label in the normal size
_SMALL = 6.0  # mean width of a letter in vertical tick labels


@dataclass(frozen=True)
class ChartAxis:
    """One axis of a chart."""

    label: str  #: with the unit.
    low: float  #: low, high: its ends.
    high: float
    log: bool = False  #: whether it is logarithmic.
    ticks: tuple[float, ...] | None = None  #: values with a tick; chosen automatically if None.
    names: tuple[str, ...] = ()  #: labels of the ticks; their numbers if empty.
    upright: bool = False  #: of an x axis, whether its tick labels are small and vertical, for many of them.

    @classmethod
    def spanning(
        cls, label: str, values: ArrayLike, log: bool = False, ticks: tuple[float, ...] | None = None
    ) -> "ChartAxis":
        """Return an axis that shows all finite (on a logarithmic axis, positive) values, with margins."""
        shown = [v for v in _floats(values) if math.isfinite(v) and (v > 0.0 or not log)]
        low, high = (min(shown), max(shown)) if shown else (1.0, 10.0)
        if log:
            return cls(label, low / 1.3, high * 1.3, True, ticks)
        margin = 0.05 * (high - low) or 1.0
        return cls(label, low - margin, high + margin, ticks=ticks)

    @classmethod
    def named(cls, label: str, names: Sequence[str], upright: bool = False) -> "ChartAxis":
        """Return an axis with one category per name, the first at 1."""
        n = len(names)
        ticks = tuple(float(k) for k in range(1, n + 1))
        return cls(label, 0.5, n + 0.5, ticks=ticks, names=tuple(names), upright=upright)

    def share(self, value: float) -> float:
        """Return the position of a value as a share of the axis' length."""
        low, high, v = (math.log(x) if self.log else x for x in (self.low, self.high, value))
        return (v - low) / (high - low)

    @property
    def shown_ticks(self) -> tuple[float, ...]:
        """Return the values with a tick."""
        if self.ticks is not None:
            return tuple(t for t in self.ticks if self.low <= t <= self.high)
        if self.log:  # powers of ten over more than three decades, else 1, 2 and 5 times them; more where too few
            powers = range(math.floor(math.log10(self.low)), math.ceil(math.log10(self.high)) + 1)
            wide = math.log10(self.high / self.low) > 3.2
            for digits in ((1,),) if wide else ((1, 2, 5), range(1, 10)):
                candidates = [float(f"{digit * 10.0**k:.3g}") for k in powers for digit in digits]
                ticks = tuple(v for v in candidates if self.low * 0.999 <= v <= self.high * 1.001)
                if len(ticks) > 1:
                    return ticks
        raw = (self.high - self.low) / 5.0  # also for a logarithmic axis within one step of the first digit
        power = 10.0 ** math.floor(math.log10(raw))
        step = next(k * power for k in (1.0, 2.0, 5.0, 10.0) if k * power >= 0.999 * raw)
        first = math.ceil(self.low / step - 1e-9)
        return tuple(round(k * step, 12) for k in range(first, math.floor(self.high / step + 1e-9) + 1))

    @property
    def tick_labels(self) -> tuple[str, ...]:
        """Return the labels of the ticks."""
        return self.names or tuple(f"{v:g}" for v in self.shown_ticks)

    @property
    def extra_height(self) -> float:
        """Return the height that vertical tick labels need beyond horizontal ones, in the drawing's units."""
        return _SMALL * max(map(len, self.names), default=0) if self.upright else 0.0


def ink_on(fill: str, dark: bool = False) -> str:
    """Return black or white, whichever is legible on a colour #rrggbb: their contrast is at least 4.5.

    The better of both has a contrast of at least √(1.05/0.05) = 4.58. Source: WCAG 2.2, relative luminance.

    Args:
        fill: the colour.
        dark: whether the drawing is shown on a dark page, which inverts it and turns its hues back by 180°.
    """
    shown = np.array([int(fill[i : i + 2], 16) / 255.0 for i in (1, 3, 5)])
    if dark:
        shown = np.clip(_HALF_TURN @ (1.0 - shown), 0.0, 1.0)
    linear = np.where(shown <= 0.04045, shown / 12.92, ((shown + 0.055) / 1.055) ** 2.4)
    light = linear @ (0.2126, 0.7152, 0.0722) + 0.05 > math.sqrt(1.05 * 0.05)
    return "#000" if light != dark else "#fff"


_WEIGHTS = np.array([0.213, 0.715, 0.072])
#: Of all hues. Source: Filter Effects Module Level 1, hue-rotate, with cos 180° = -1.
_HALF_TURN = 2.0 * np.tile(_WEIGHTS, (3, 1)) - np.eye(3)


def _floats(values: ArrayLike) -> list[float]:
    numbers: list[float] = np.asarray(values, dtype=float).ravel().tolist()
    return numbers


def line_colours(n: int) -> list[str]:
    """Return ordered colours of n lines, the first one darkest."""
    colours = []
    for level in (_LINES_TO * i / max(n - 1, 1) for i in range(n)):
        k = int(level)
        below, above = ([int(colour[i : i + 2], 16) for i in (1, 3, 5)] for colour in ORDERED[k : k + 2])
        mixed = (round(a + (level - k) * (b - a)) for a, b in zip(below, above, strict=True))
        colours.append("#" + "".join(f"{value:02x}" for value in mixed))
    return colours


class LegendEntry(NamedTuple):
    """One entry of a legend; dashes are None for an area."""

    name: str
    colour: str
    dashes: str | None = None
    mark: str = ""


class ChartLine(NamedTuple):
    x: list[float]
    y: list[float]
    colour: str
    dashes: str
    mark: str
    width: float
    name: str


class ChartArea(NamedTuple):
    points: Sequence[Sequence[float]]
    colour: str
    opacity: float


class _Rectangle(NamedTuple):
    x: tuple[float, float]
    y: tuple[float, float]
    fill: str
    edge: str


class _Label(NamedTuple):
    x: float
    y: float
    text: str
    colour: str
    dark: str
    size: float


@dataclass
class Chart:
    """Axes and the elements drawn in them, the first one lowest."""

    x: ChartAxis  #: x, y: the axes; y upwards unless `down`.
    y: ChartAxis
    square: bool = False  #: whether both axes have the same scale; the shorter axis is then extended at both ends.
    down: bool = False  #: whether y grows downwards.
    legend: list[LegendEntry] = field(default_factory=list)  #: its entries.
    elements: list[ChartLine | ChartArea | _Rectangle | _Label] = field(default_factory=list)

    @classmethod
    def side_view(cls, points: ArrayLike, across: int) -> "Chart":
        """Return an empty chart of points (n, 2) [mm] along z and along the axis `across`; x grows downwards."""
        along, aside = np.asarray(points, dtype=float).T
        z = ChartAxis.spanning("z, along the undeformed axis [mm]", along)
        lateral = ChartAxis.spanning(f"{'xyz'[across]} [mm]", aside)
        return cls(z, lateral, square=True, down=across == 0)

    def __post_init__(self) -> None:
        """Extend the axes of a square chart to the same scale."""
        if self.square:
            wide, high = _WIDTH - _LEFT - _RIGHT, _HEIGHT - _TOP - _BOTTOM - 2 * _LEGEND
            unit = max((self.x.high - self.x.low) / wide, (self.y.high - self.y.low) / high)
            self.x = _extended(self.x, unit * wide)
            self.y = _extended(self.y, unit * high)

    def line(
        self, x: ArrayLike, y: ArrayLike, colour: str, dashes: str = "", mark: str = "", name: str = "",
        width: float = 2.0,
    ) -> None:  # fmt: skip
        """Add a line, broken where a point is not finite, and its legend entry if it is named."""
        self.elements.append(ChartLine(_floats(x), _floats(y), colour, dashes, mark, width, name))
        if name:
            self.legend.append(LegendEntry(name, colour, dashes, mark))

    def points(self, x: ArrayLike, y: ArrayLike, colour: str, mark: str, name: str = "") -> None:
        """Add markers without a line at all finite points, and their legend entry if they are named."""
        for a, b in zip(_floats(x), _floats(y), strict=True):
            if math.isfinite(a) and math.isfinite(b):
                self.elements.append(ChartLine([a], [b], colour, "", mark, 2.0, name))
        if name:
            self.legend.append(LegendEntry(name, colour, NO_LINE, mark))

    def area(self, points: Sequence[Sequence[float]], colour: str, opacity: float = 0.2, name: str = "") -> None:
        """Add a filled polygon."""
        self.elements.append(ChartArea(points, colour, opacity))
        if name:
            self.legend.append(LegendEntry(name, colour))

    def box(self, x: tuple[float, float], y: tuple[float, float], fill: str, edge: str = "#fff") -> None:
        """Add a filled rectangle."""
        self.elements.append(_Rectangle(x, y, fill, edge))

    def text(self, x: float, y: float, text: str, size: float = 12.0, on: str = "") -> None:
        """Add a label centred on a point; the fill `on` below it chooses its colour."""
        dark = ink_on(on, dark=True) if on else ""
        self.elements.append(_Label(x, y, text, ink_on(on) if on else "#111", dark, size))

    def cell(self, i: int, j: int, text: str, fill: str, size: float = 12.0, edge: str = "#fff") -> None:
        """Add a filled cell of two axes with categories, and its text."""
        self.box((i - 0.5, i + 0.5), (j - 0.5, j + 0.5), fill, edge)
        self.text(i, j, text, size, fill)

    def at(self, x: float, y: float) -> tuple[float, float]:
        """Return the position of a point in the SVG, below the legend."""
        up = self.y.share(y)
        return (
            _LEFT + self.x.share(x) * (_WIDTH - _LEFT - _RIGHT),
            _TOP + (up if self.down else 1.0 - up) * self._high,
        )

    @property
    def _high(self) -> float:
        return _HEIGHT - _TOP - _BOTTOM - (2 * _LEGEND if self.square else 0.0)

    def svg(self) -> bytes:
        """Return the SVG element, with the legend on as few rows as possible above the axes."""
        legend, x, row = list[str](), _WIDTH, 0
        for name, colour, dashes, mark in self.legend:
            wide = 42.0 + _LETTER * len(name)
            if x + wide > _WIDTH:
                x, row = _LEFT, row + 1
            y = _LEGEND * (row - 0.3)
            if dashes is None:  # of an area
                legend.append(element("rect", x=x + 6, y=y - 6, width=14, height=12, fill=colour))
            else:
                legend.append(element("path", d=f"M{number(x)} {number(y)}h26", stroke=colour, stroke_width=2,
                                      stroke_dasharray=dashes or None))  # fmt: skip
                legend.append(_mark(mark, x + 13, y, colour))
            legend.append(element("text", text=name, x=x + 31, y=y + 4.5))
            x += wide
        above = _LEGEND * row
        whole = above + _TOP + self._high + _BOTTOM + self.x.extra_height
        drawn = [part for item in self.elements for part in self._drawn(item)]
        body = element("g", *self._grid(), *drawn, *self._frame(), transform=f"translate(0 {number(above)})")
        return element("svg", *legend, body, xmlns="http://www.w3.org/2000/svg", font_size=13,
                       viewBox=f"0 0 {number(_WIDTH)} {number(whole)}",
                       font_family="Helvetica, Arial, sans-serif").encode()  # fmt: skip

    def _drawn(self, item: ChartLine | ChartArea | _Rectangle | _Label) -> Iterator[str]:
        match item:
            case ChartLine(x, y, colour, dashes, mark, width, name):
                places = [self.at(a, b) if math.isfinite(a) and math.isfinite(b) else None
                          for a, b in zip(x, y, strict=True)]  # fmt: skip
                for _, run in itertools.groupby(places, lambda at: at is None):
                    if len(line := [at for at in run if at is not None]) > 1:
                        yield element("path", d=path_data([line]), fill="none", stroke=colour, stroke_width=width,
                                      stroke_dasharray=dashes or None, stroke_linejoin="round")  # fmt: skip
                for at, a, b in zip(places, x, y, strict=True):
                    if mark and at is not None:
                        tip = f"{name}\n" * bool(name) + f"{self.x.label}: {a:.4g}\n{self.y.label}: {b:.3g}"
                        target = element("circle", cx=at[0], cy=at[1], r=8, fill="transparent")
                        yield element("g", element("title", text=tip), target, _mark(mark, *at, colour))
            case ChartArea(points, colour, opacity):
                corners = path_data([[self.at(*point) for point in points]], closed=True)
                yield element("path", d=corners, fill=colour, fill_opacity=opacity)
            case _Rectangle(x, y, fill, edge):
                (a, b), (c, d) = self.at(x[0], y[0]), self.at(x[1], y[1])
                yield element("rect", x=min(a, c), y=min(b, d), width=abs(c - a), height=abs(d - b), fill=fill,
                              stroke=edge)  # fmt: skip
            case _Label(x, y, text, colour, dark, size):
                p, q = self.at(x, y)
                yield element("text", text=text, x=p, y=q + 0.36 * size, text_anchor="middle", fill=colour,
                              font_size=size, style=f"--dark: {dark}" if dark else None)  # fmt: skip

    def _grid(self) -> Iterator[str]:
        if not self.x.names:  # otherwise boxes fill the chart
            x, y = (self.x.low, self.x.high), (self.y.low, self.y.high)
            across = [[self.at(end, v) for end in x] for v in self.y.shown_ticks]
            up = [[self.at(v, end) for end in y] for v in self.x.shown_ticks]
            yield element("path", d=path_data([*across, *up]), stroke="#ddd", fill="none")

    def _frame(self) -> Iterator[str]:
        left, right, top, high = _LEFT, _WIDTH - _RIGHT, _TOP, self._high
        yield element("rect", x=left, y=top, width=right - left, height=high, fill="none", stroke="#111")
        bottom, upright = top + high, self.x.upright
        for v, text in zip(self.x.shown_ticks, self.x.tick_labels, strict=True):
            x = self.at(v, self.y.low)[0]
            turn = f"rotate(-90 {number(x + 3.5)} {number(bottom + 7)})"
            yield (element("text", text=text, x=x + 3.5, y=bottom + 7, text_anchor="end", font_size=10, transform=turn)
                   if upright else element("text", text=text, x=x, y=bottom + 17, text_anchor="middle"))  # fmt: skip
        for v, text in zip(self.y.shown_ticks, self.y.tick_labels, strict=True):
            yield element("text", text=text, x=left - 6, y=self.at(self.x.low, v)[1] + 4.5, text_anchor="end",
                          font_size=10 if len(text) > _LETTERS else None)  # fmt: skip
        half = top + high / 2.0
        yield element("text", text=self.x.label, x=(left + right) / 2.0, y=bottom + 38 + self.x.extra_height,
                      text_anchor="middle", font_size=14)  # fmt: skip
        yield element("text", text=self.y.label, x=15, y=half, text_anchor="middle", font_size=14,
                      transform=f"rotate(-90 15 {number(half)})")  # fmt: skip


def _extended(axis: ChartAxis, length: float) -> ChartAxis:
    more = (length - (axis.high - axis.low)) / 2.0
    return replace(axis, low=axis.low - more, high=axis.high + more)


def _mark(mark: str, x: float, y: float, colour: str) -> str:
    if mark == "o":
        return element("circle", cx=x, cy=y, r=3.4, fill=colour)
    shapes = {"s": "M-3.2-3.2h6.4v6.4h-6.4z", "d": "M0-4.4l4.4 4.4-4.4 4.4-4.4-4.4z", "^": "M0-4.2l4.2 7.4h-8.4z",
              "v": "M0 4.2l4.2-7.4h-8.4z", "x": "M-4-4l8 8m0-8l-8 8", "+": "M-4 0h8m-4-4v8"}  # fmt: skip
    if mark not in shapes:
        return ""
    ink = {"fill": "none", "stroke": colour, "stroke_width": "2"} if mark in "x+" else {"fill": colour}
    return element("path", transform=f"translate({number(x)} {number(y)})", d=shapes[mark], **ink)
