"""Charts as data, drawn as an SVG element; `reports.png` draws them into matplotlib axes.

A chart lists axes, lines, areas, boxes and labels. The SVG has real text and needs no plotting library, so a page with
a dozen charts takes a few milliseconds; both drawings are legible at half size and in print.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from html import escape
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

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
        return _log_ticks(self.low, self.high) if self.log else _even_ticks(self.low, self.high)

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


def _log_ticks(low: float, high: float) -> tuple[float, ...]:
    """Return powers of ten over more than three decades, else 1, 2 and 5 times them; more where these are too few."""
    powers = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    wide = math.log10(high / low) > 3.2
    for digits in ((1,),) if wide else ((1, 2, 5), range(1, 10)):
        candidates = [float(f"{digit * 10.0**k:.3g}") for k in powers for digit in digits]
        ticks = tuple(v for v in candidates if low * 0.999 <= v <= high * 1.001)
        if len(ticks) > 1:
            return ticks
    return _even_ticks(low, high)  # within one step of the first digit


def _even_ticks(low: float, high: float) -> tuple[float, ...]:
    raw = (high - low) / 5.0
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(k * power for k in (1.0, 2.0, 5.0, 10.0) if k * power >= 0.999 * raw)
    first = math.ceil(low / step - 1e-9)
    return tuple(round(k * step, 12) for k in range(first, math.floor(high / step + 1e-9) + 1))


def line_colours(n: int) -> list[str]:
    """Return ordered colours of n lines, the first one darkest."""
    colours = []
    for place in (_LINES_TO * i / max(n - 1, 1) for i in range(n)):
        k = int(place)
        one, two = ([int(colour[i : i + 2], 16) for i in (1, 3, 5)] for colour in ORDERED[k : k + 2])
        mixed = (round(a + (place - k) * (b - a)) for a, b in zip(one, two, strict=True))
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
    points: Sequence[tuple[float, float]]
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
    turned: bool


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
        """Return an empty chart of points (n, 3) [mm] along z and along the axis `across`; x grows downwards."""
        p = np.asarray(points, dtype=float)
        z = ChartAxis.spanning("z, along the undeformed axis [mm]", p[:, 2])
        lateral = ChartAxis.spanning(f"{'xyz'[across]} [mm]", p[:, across])
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

    def area(self, points: Sequence[tuple[float, float]], colour: str, opacity: float = 0.2, name: str = "") -> None:
        """Add a filled polygon."""
        self.elements.append(ChartArea(points, colour, opacity))
        if name:
            self.legend.append(LegendEntry(name, colour))

    def box(self, x: tuple[float, float], y: tuple[float, float], fill: str, edge: str = "#fff") -> None:
        """Add a filled rectangle."""
        self.elements.append(_Rectangle(x, y, fill, edge))

    def text(
        self, x: float, y: float, text: str, colour: str = "#111", size: float = 12.0, turned: bool = False,
        on: str = "",
    ) -> None:  # fmt: skip
        """Add a label centred on a point; `turned` reads upwards, the fill `on` below it chooses its colour."""
        dark = ink_on(on, dark=True) if on else ""
        self.elements.append(_Label(x, y, text, ink_on(on) if on else colour, dark, size, turned))

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
        """Return the SVG element."""
        rows = _legend_rows(self.legend)
        above = _LEGEND * len(rows)
        whole = above + _TOP + self._high + _BOTTOM + self.x.extra_height
        legend = "".join(_legend_row(row, _LEGEND * (i + 0.7)) for i, row in enumerate(rows))
        drawn = "".join(map(self._element, self.elements))
        return (
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH:g} {whole:g}" '
            f'font-family="Helvetica, Arial, sans-serif" font-size="13">{legend}'
            f'<g transform="translate(0 {above:g})">{self._grid()}{drawn}{self._frame()}</g></svg>'
        ).encode()

    def _element(self, element: ChartLine | ChartArea | _Rectangle | _Label) -> str:
        match element:
            case ChartLine():
                return self._polyline(element)
            case ChartArea(points, colour, opacity):
                corners = " ".join(f"{p:.1f},{q:.1f}" for p, q in (self.at(*point) for point in points))
                return f'<polygon points="{corners}" fill="{colour}" fill-opacity="{opacity:g}"/>'
            case _Rectangle(x, y, fill, edge):
                (a, b), (c, d) = self.at(x[0], y[0]), self.at(x[1], y[1])
                return (f'<rect x="{min(a, c):.1f}" y="{min(b, d):.1f}" width="{abs(c - a):.1f}" '
                        f'height="{abs(d - b):.1f}" fill="{fill}" stroke="{edge}"/>')  # fmt: skip
            case _Label(x, y, text, colour, dark, size, turned):
                swap = f' style="--dark: {dark}"' if dark else ""
                p, q = self.at(x, y)
                turn = f' transform="rotate(-90 {p:.1f} {q:.1f})"' if turned else ""
                return (f'<text x="{p:.1f}" y="{q + 0.36 * size:.1f}" text-anchor="middle" fill="{colour}" '
                        f'font-size="{size:g}"{turn}{swap}>{escape(text)}</text>')  # fmt: skip

    def _polyline(self, line: ChartLine) -> str:
        drawn, run = [], list[tuple[float, float]]()
        for a, b in [*zip(line.x, line.y, strict=True), (math.nan, math.nan)]:
            if math.isfinite(a) and math.isfinite(b):
                run.append(self.at(a, b))
                continue
            if len(run) > 1:
                path = "M" + "L".join(f"{p:.1f} {q:.1f}" for p, q in run)
                drawn.append(f'<path d="{path}" fill="none" stroke="{line.colour}" '
                             f'stroke-width="{line.width:g}" stroke-dasharray="{line.dashes}" '
                             'stroke-linejoin="round"/>')  # fmt: skip
            run = []
        drawn += [self._tipped_mark(line, a, b) for a, b in zip(line.x, line.y, strict=True)
                  if line.mark and math.isfinite(a) and math.isfinite(b)]  # fmt: skip
        return "".join(drawn)

    def _tipped_mark(self, line: ChartLine, x: float, y: float) -> str:
        p, q = self.at(x, y)
        name = f"{line.name}\n" if line.name else ""
        tip = escape(f"{name}{self.x.label}: {x:.4g}\n{self.y.label}: {y:.3g}")
        target = f'<circle cx="{p:.1f}" cy="{q:.1f}" r="8" fill="transparent"/>'
        return f"<g><title>{tip}</title>{target}{_mark(line.mark, p, q, line.colour)}</g>"

    def _grid(self) -> str:
        left, right, top, bottom = _LEFT, _WIDTH - _RIGHT, _TOP, _TOP + self._high
        if self.x.names:  # boxes fill the chart
            return ""
        across = "".join(f"M{left} {self.at(self.x.low, v)[1]:.1f}H{right}" for v in self.y.shown_ticks)
        up = "".join(f"M{self.at(v, self.y.low)[0]:.1f} {top}V{bottom}" for v in self.x.shown_ticks)
        return f'<path d="{across}{up}" stroke="#ddd" fill="none"/>'

    def _x_label(self, x: float, y: float, text: str) -> str:
        if not self.x.upright:
            return f'<text x="{x:.1f}" y="{y + 17}" text-anchor="middle">{escape(text)}</text>'
        return (
            f'<text x="{x + 3.5:.1f}" y="{y + 7}" text-anchor="end" font-size="10" '
            f'transform="rotate(-90 {x + 3.5:.1f} {y + 7})">{escape(text)}</text>'
        )

    def _frame(self) -> str:
        left, top, high = _LEFT, _TOP, self._high
        parts = [f'<rect x="{left}" y="{top}" width="{_WIDTH - _LEFT - _RIGHT}" height="{high}" fill="none" '
                 'stroke="#111"/>']  # fmt: skip
        for v, text in zip(self.x.shown_ticks, self.x.tick_labels, strict=True):
            parts.append(self._x_label(self.at(v, self.y.low)[0], top + high, text))
        for v, text in zip(self.y.shown_ticks, self.y.tick_labels, strict=True):
            size = ' font-size="10"' if len(text) > _LETTERS else ""
            parts.append(f'<text x="{left - 6}" y="{self.at(self.x.low, v)[1] + 4.5:.1f}" '
                         f'text-anchor="end"{size}>{escape(text)}</text>')  # fmt: skip
        middle, half = (_LEFT + _WIDTH - _RIGHT) / 2.0, top + high / 2.0
        parts.append(f'<text x="{middle}" y="{top + high + 38 + self.x.extra_height:g}" text-anchor="middle" '
                     f'font-size="14">{escape(self.x.label)}</text>')  # fmt: skip
        parts.append(f'<text x="15" y="{half}" text-anchor="middle" font-size="14" '
                     f'transform="rotate(-90 15 {half})">{escape(self.y.label)}</text>')  # fmt: skip
        return "".join(parts)


def _extended(axis: ChartAxis, length: float) -> ChartAxis:
    more = (length - (axis.high - axis.low)) / 2.0
    return replace(axis, low=axis.low - more, high=axis.high + more)


def _legend_rows(legend: Sequence[LegendEntry]) -> list[list[tuple[float, LegendEntry]]]:
    """Distribute entries with their x positions over as few rows as possible."""
    rows: list[list[tuple[float, LegendEntry]]] = []
    x = _WIDTH
    for entry in legend:
        wide = 42.0 + _LETTER * len(entry.name)
        if x + wide > _WIDTH:
            rows.append([])
            x = _LEFT
        rows[-1].append((x, entry))
        x += wide
    return rows


def _legend_row(row: Sequence[tuple[float, LegendEntry]], y: float) -> str:
    """Return one row of a legend: a stroke for a line, a square for an area."""
    parts = []
    for x, (name, colour, dashes, mark) in row:
        if dashes is None:
            parts.append(f'<rect x="{x + 6:g}" y="{y - 6:g}" width="14" height="12" fill="{colour}"/>')
        else:
            parts.append(f'<path d="M{x:g} {y:g}h26" stroke="{colour}" stroke-width="2" stroke-dasharray="{dashes}"/>')
            parts.append(_mark(mark, x + 13, y, colour))
        parts.append(f'<text x="{x + 31:g}" y="{y + 4.5:g}">{escape(name)}</text>')
    return "".join(parts)


def _mark(mark: str, x: float, y: float, colour: str) -> str:
    """Return a marker about a point."""
    if mark == "o":
        return f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3.4" fill="{colour}"/>'
    shapes = {"s": "M-3.2-3.2h6.4v6.4h-6.4z", "d": "M0-4.4l4.4 4.4-4.4 4.4-4.4-4.4z", "^": "M0-4.2l4.2 7.4h-8.4z",
              "v": "M0 4.2l4.2-7.4h-8.4z", "x": "M-4-4l8 8m0-8l-8 8", "+": "M-4 0h8m-4-4v8"}  # fmt: skip
    if mark not in shapes:
        return ""
    ink = f'fill="none" stroke="{colour}" stroke-width="2"' if mark in "x+" else f'fill="{colour}"'
    return f'<path transform="translate({x:.1f} {y:.1f})" d="{shapes[mark]}" {ink}/>'
