"""A contact map as a still picture (SVG), with the scene, projection and legend that it shares with the HTML page."""

import math
from dataclasses import dataclass
from html import escape
from typing import NamedTuple

import numpy as np

from probedesign.core.frames import Array
from probedesign.core.units import MM
from probedesign.mapping.contact_map import CHI2_95, ContactMap, MapPoint
from probedesign.mapping.map_files import MAX_RMS_MM, MIN_RMS_MM, rms_colour

# scene

MIN_SPAN_MM = 10.0
"""Minimum extent of what is shown, so that a single point is not magnified without bounds."""
MAGNIFICATIONS = (1, 5, 10)
"""Magnifications of ellipsoids that can be chosen."""
MIN_VISIBLE = 0.02
"""Half-axis over the radius of the scene from which an ellipsoid is visible: about five pixels."""


@dataclass(frozen=True)
class MapScene:
    """What page and picture show.

    Attributes:
        contact_map: its located points are shown.
        truth: outlines of the touched objects, if a simulation states them [m], (k, 3) each, closed; the first side is
            the touched edge.
    """

    contact_map: ContactMap
    truth: tuple[Array, ...] = ()

    @property
    def centre_mm(self) -> Array:
        """Centre of everything shown [mm], (3,)."""
        corners = self._corners_mm
        return np.asarray(0.5 * (corners.min(axis=0) + corners.max(axis=0)))

    @property
    def radius_mm(self) -> float:
        """Radius about the centre [mm]."""
        distances = np.linalg.norm(self._corners_mm - self.centre_mm, axis=1)
        return max(float(distances.max()), 0.5 * MIN_SPAN_MM)

    @property
    def magnification(self) -> int:
        """Initial magnification of ellipsoids: the smallest with which half of them are visible."""
        longest = [np.linalg.eigvalsh(point.cov_world)[-1] for point in self.contact_map.points]
        half = math.sqrt(CHI2_95 * float(np.median(longest))) / MM if longest else self.radius_mm
        visible = (times for times in MAGNIFICATIONS if times * half >= MIN_VISIBLE * self.radius_mm)
        return next(visible, MAGNIFICATIONS[-1])

    @property
    def _corners_mm(self) -> Array:
        points = np.array([point.p_world for point in self.contact_map.points]).reshape(-1, 3)
        corners = np.concatenate([points, *self.truth]) / MM
        return corners if len(corners) else np.zeros((1, 3))


@dataclass(frozen=True)
class ParallelProjection:
    """A parallel projection of the world.

    Attributes:
        azimuth: of the eye about the world's z axis, from where it looks along y [rad].
        elevation: of the eye above the ground [rad].
    """

    azimuth: float = math.radians(28.0)
    elevation: float = math.radians(22.0)

    @property
    def axes(self) -> Array:
        """Directions to the right and up in the picture, in the world, (2, 3)."""
        a, e = self.azimuth, self.elevation
        right = (math.cos(a), math.sin(a), 0.0)
        up = (-math.sin(a) * math.sin(e), math.cos(a) * math.sin(e), math.cos(e))
        return np.array([right, up])

    def project(self, points: Array) -> Array:
        """Return points (n, 3) in the picture, right and up, (n, 2)."""
        flat: Array = np.asarray(points) @ self.axes.T
        return flat

    def ellipse(self, cov: Array) -> tuple[float, float, float]:
        """Return the outline of the ellipsoid of a covariance (3, 3), at one standard deviation.

        Returns:
            Both half-axes, and the angle of the first one from the right, counter-clockwise [rad].
        """
        flat = self.axes @ cov @ self.axes.T
        values, vectors = np.linalg.eigh(flat)
        long, short = np.sqrt(np.maximum(values[::-1], 0.0))
        return float(long), float(short), math.atan2(float(vectors[1, 1]), float(vectors[0, 1]))


# legend

TRUTH_COLOUR, STROKE_COLOUR = "#a08c5a", "#999"
SYMBOL_SIZE = (34, 14)
"""Width and height of a symbol of the legend, in units of SVG."""


class MapSymbol(NamedTuple):
    """A symbol of the legend: SVG within `SYMBOL_SIZE`, and its meaning as plain text."""

    svg: str
    meaning: str


def map_symbols(ellipsoids: str, truth: bool) -> tuple[MapSymbol, ...]:
    """Return the symbols of the legend.

    Args:
        ellipsoids: magnification of the ellipsoids, as text.
        truth: whether the simulated truth is shown.
    """
    blue = hex_colour(MIN_RMS_MM)
    symbols = (
        MapSymbol(f'<circle cx="17" cy="7" r="2" fill="{blue}"/>', "point of the surface, with its number"),
        MapSymbol(
            f'<ellipse cx="17" cy="7" rx="12" ry="5" fill="{blue}" fill-opacity="0.25" stroke="{blue}"/>',
            f"its 95 % ellipsoid, {ellipsoids}",
        ),
        MapSymbol(
            _colour_bar(),
            f"RMS error from {MIN_RMS_MM:g} mm or less (blue) to {MAX_RMS_MM:g} mm or more (red)",
        ),
        MapSymbol(
            f'<path d="M6 7H28" stroke="{STROKE_COLOUR}"/>',
            "outward normal of the object, from the force on the probe; its length has no meaning",
        ),
    )
    outline = f'<path d="M5 12L12 3H30L23 12Z" fill="none" stroke="{TRUTH_COLOUR}" stroke-width="0.8"/>'
    edge = f'<path d="M5 12L12 3" stroke="{TRUTH_COLOUR}" stroke-width="2"/>'
    known = MapSymbol(
        outline + edge, "the simulated truth, not measured: touched objects, touched edges thick"
    )
    return (*symbols, known) if truth else symbols


def _colour_bar() -> str:
    """Return the colour scale as adjacent rectangles."""
    steps = 8
    width = (SYMBOL_SIZE[0] - 4) / steps
    shades = [MIN_RMS_MM * (MAX_RMS_MM / MIN_RMS_MM) ** (i / (steps - 1)) for i in range(steps)]
    return "".join(
        f'<rect x="{2 + i * width:.2f}" y="4" width="{width:.2f}" height="6" fill="{hex_colour(shade)}"/>'
        for i, shade in enumerate(shades)
    )


def hex_colour(rms_mm: float) -> str:
    """Return the colour of an RMS error [mm] as #rrggbb."""
    return "#{:02x}{:02x}{:02x}".format(*rms_colour(rms_mm))


# picture

WIDTH, HEIGHT, MARGIN, LEGEND_HEIGHT = 760.0, 640.0, 46.0, 126.0
"""Size of the picture, its margin, and the space for the legend at the top."""
SCALE_BARS_MM = (0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
NORMAL_LENGTH = 14.0
"""Length of a normal that lies in the plane of the picture, in its units."""


def map_svg(scene: MapScene, projection: ParallelProjection | None = None) -> bytes:
    """Return the picture.

    Args:
        scene: its points are drawn with 95 % ellipsoids and numbers.
        projection: direction of view.
    """
    view, points, times = projection or ParallelProjection(), scene.contact_map.points, scene.magnification
    polygons = [view.project(polygon) / MM for polygon in scene.truth]
    p = view.project(np.array([point.p_world for point in points]).reshape(-1, 3)) / MM
    extents = times * np.array([_extent(point, view) for point in points]).reshape(-1, 2)
    shown = np.concatenate([p - extents, p + extents, *polygons])
    scale, origin = _fit(shown if len(shown) else np.zeros((1, 2)))

    def at(flat: Array) -> Array:
        centre = np.array([0.5 * WIDTH, 0.5 * (HEIGHT + LEGEND_HEIGHT - MARGIN)])
        pixels: Array = (flat - origin) * (scale, -scale) + centre
        return pixels

    body = [_polygon(at(polygon)) for polygon in polygons]
    body += [_normal(point, at(flat), view) for point, flat in zip(points, p, strict=True)]
    body += [_ellipse(point, at(flat), times * scale, view) for point, flat in zip(points, p, strict=True)]
    body += [
        f'<text x="{x + 5:.1f}" y="{y - 5:.1f}" font-size="10" fill="#333">{i}</text>'
        for i, (x, y) in enumerate((at(flat) for flat in p), 1)
    ]
    body += [_axes(view), _scale_bar(scale), _legend(times, bool(polygons))]
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH:g} {HEIGHT:g}" '
        'font-family="Helvetica,Arial,sans-serif">'
    )
    return (
        head + f'<rect width="{WIDTH:g}" height="{HEIGHT:g}" fill="#fff"/>' + "\n".join(body) + "</svg>\n"
    ).encode()


def _fit(flat: Array) -> tuple[float, Array]:
    """Return the pixels per millimetre, and the centre [mm], (2,)."""
    low, high = flat.min(axis=0), flat.max(axis=0)
    span = np.maximum(high - low, MIN_SPAN_MM)
    space = np.array([WIDTH - 2.0 * MARGIN, HEIGHT - MARGIN - LEGEND_HEIGHT])
    return float((space / span).min()), 0.5 * (low + high)


def _extent(point: MapPoint, view: ParallelProjection) -> Array:
    """Return the extent of the ellipsoid of a point to the right and up [mm], (2,)."""
    flat = view.axes @ point.cov_world @ view.axes.T
    extent: Array = np.sqrt(CHI2_95 * np.diag(flat)) / MM
    return extent


def _polygon(flat: Array) -> str:
    corners = [f"{x:.1f},{y:.1f}" for x, y in flat]
    return (
        f'<polygon points="{" ".join(corners)}" fill="#c9b98a" fill-opacity="0.10" stroke="{TRUTH_COLOUR}" '
        f'stroke-width="0.6"/><path d="M{corners[0]}L{corners[1]}" stroke="{TRUTH_COLOUR}" stroke-width="2"/>'
    )


def _ellipse(point: MapPoint, at: Array, scale: float, view: ParallelProjection) -> str:
    long, short, angle = view.ellipse(point.cov_world)
    rx, ry = (math.sqrt(CHI2_95) * half / MM * scale for half in (long, short))
    colour = hex_colour(point.rms / MM)
    x, y = at
    return (
        f'<g transform="translate({x:.1f} {y:.1f}) rotate({-math.degrees(angle):.1f})"><ellipse rx="{rx:.1f}" '
        f'ry="{max(ry, 0.4):.1f}" fill="{colour}" fill-opacity="0.25" stroke="{colour}"/>'
        f'<circle r="2" fill="{colour}"/></g>'
    )


def _normal(point: MapPoint, at: Array, view: ParallelProjection) -> str:
    """Return a stroke along the outward normal, of constant length in space."""
    if point.direction is None:
        return ""
    right, up = NORMAL_LENGTH * (view.axes @ point.direction)
    return f'<path d="M{at[0]:.1f} {at[1]:.1f}l{right:.1f} {-up:.1f}" stroke="{STROKE_COLOUR}"/>'


def _axes(view: ParallelProjection) -> str:
    drawn = []
    for name, (right, up) in zip("xyz", 30.0 * view.axes.T, strict=True):
        x, y = 50.0, HEIGHT - 50.0
        drawn.append(
            f'<path d="M{x:g} {y:g}l{right:.1f} {-up:.1f}" stroke="#555"/><text x="{x + 1.25 * right - 3:.1f}" '
            f'y="{y - 1.25 * up + 4:.1f}" font-size="11" fill="#555">{name}</text>'
        )
    return "".join(drawn)


def _scale_bar(scale: float) -> str:
    length = max((bar for bar in SCALE_BARS_MM if bar * scale <= 0.25 * WIDTH), default=SCALE_BARS_MM[0])
    right, y = WIDTH - 30.0, HEIGHT - 30.0
    return (
        f'<path d="M{right - length * scale:.1f} {y:g}H{right:g}" stroke="#111" stroke-width="2"/>'
        f'<text x="{right:g}" y="{y - 6:g}" font-size="12" text-anchor="end">{length:g} mm</text>'
    )


def _legend(times: int, truth: bool) -> str:
    size = "in scale" if times == 1 else f"drawn {times} times as large"
    return "".join(
        f'<g transform="translate(16 {12 + 18 * i})">{symbol.svg}<text x="42" y="11" font-size="11" '
        f'fill="#333">{escape(symbol.meaning)}</text></g>'
        for i, symbol in enumerate(map_symbols(size, truth))
    )
