"""A cloud as a still picture: SVG."""

import math
from html import escape

import numpy as np

from probedesign.frames import Array
from probedesign.mapping.colour import hex_of
from probedesign.mapping.contact_map import WITHIN_95, Point
from probedesign.reports.map_camera import View
from probedesign.reports.map_legend import STROKE_COLOUR, TRUTH_COLOUR, legend
from probedesign.reports.map_scene import FEWEST_MM, Scene
from probedesign.units import MM

WIDTH, HEIGHT, EDGE, TOP = 760.0, 640.0, 46.0, 126.0
"""Of the picture, and what is left free at its sides and, for the legend, at its top."""
BARS_MM = (0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
NORMAL = 14.0
"""Length of a stroke along the object's normal where it lies in the picture, in its units."""


def svg_of(scene: Scene, view: View | None = None) -> bytes:
    """The picture.

    Args:
        scene: its points are drawn with 95 % ellipsoids, numbered.
        view: where it is seen from.
    """
    view, points, times = view or View(), scene.cloud.points, scene.times
    polygons = [view.seen(polygon) / MM for polygon in scene.truth]
    p = view.seen(np.array([point.p_world for point in points]).reshape(-1, 3)) / MM
    reach = times * np.array([_reach(point, view) for point in points]).reshape(-1, 2)
    seen = np.concatenate([p - reach, p + reach, *polygons])
    scale, origin = _fit(seen if len(seen) else np.zeros((1, 2)))

    def at(flat: Array) -> Array:
        placed: Array = (flat - origin) * (scale, -scale) + (0.5 * WIDTH, 0.5 * (HEIGHT + TOP - EDGE))
        return placed

    body = [_polygon(at(polygon)) for polygon in polygons]
    body += [_normal(point, at(flat), view) for point, flat in zip(points, p, strict=True)]
    body += [_ellipse(point, at(flat), times * scale, view) for point, flat in zip(points, p, strict=True)]
    body += [_number(i, at(flat)) for i, flat in enumerate(p, 1)]
    body += [_axes(view), _bar(scale), _legend(times, bool(polygons))]
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH:g} {HEIGHT:g}" '
        'font-family="Helvetica,Arial,sans-serif">'
    )
    return (
        head + f'<rect width="{WIDTH:g}" height="{HEIGHT:g}" fill="#fff"/>' + "\n".join(body) + "</svg>\n"
    ).encode()


def _fit(flat: Array) -> tuple[float, Array]:
    """Pixels to a millimetre, and what is in the middle."""
    low, high = flat.min(axis=0), flat.max(axis=0)
    span = np.maximum(high - low, FEWEST_MM)
    room = np.array([WIDTH - 2.0 * EDGE, HEIGHT - EDGE - TOP])
    return float((room / span).min()), 0.5 * (low + high)


def _reach(point: Point, view: View) -> Array:
    """How far its ellipsoid goes to the right and up [mm], (2,)."""
    flat = view.axes @ point.cov_world @ view.axes.T
    reach: Array = np.sqrt(WITHIN_95 * np.diag(flat)) / MM
    return reach


def _polygon(flat: Array) -> str:
    told = [f"{x:.1f},{y:.1f}" for x, y in flat]
    return (
        f'<polygon points="{" ".join(told)}" fill="#c9b98a" fill-opacity="0.10" stroke="{TRUTH_COLOUR}" '
        f'stroke-width="0.6"/><path d="M{told[0]}L{told[1]}" stroke="{TRUTH_COLOUR}" stroke-width="2"/>'
    )


def _ellipse(point: Point, at: Array, scale: float, view: View) -> str:
    long, short, angle = view.ellipse(point.cov_world)
    wide, high = (math.sqrt(WITHIN_95) * half / MM * scale for half in (long, short))
    colour = hex_of(point.rms / MM)
    x, y = at
    return (
        f'<g transform="translate({x:.1f} {y:.1f}) rotate({-math.degrees(angle):.1f})"><ellipse rx="{wide:.1f}" '
        f'ry="{max(high, 0.4):.1f}" fill="{colour}" fill-opacity="0.25" stroke="{colour}"/>'
        f'<circle r="2" fill="{colour}"/></g>'
    )


def _normal(point: Point, at: Array, view: View) -> str:
    """A stroke along the outward normal, always as long in space."""
    if point.direction is None:
        return ""
    right, up = NORMAL * (view.axes @ point.direction)
    return f'<path d="M{at[0]:.1f} {at[1]:.1f}l{right:.1f} {-up:.1f}" stroke="{STROKE_COLOUR}"/>'


def _number(i: int, at: Array) -> str:
    return f'<text x="{at[0] + 5:.1f}" y="{at[1] - 5:.1f}" font-size="10" fill="#333">{i}</text>'


def _axes(view: View) -> str:
    drawn = []
    for name, (right, up) in zip("xyz", 30.0 * view.axes.T, strict=True):
        x, y = 50.0, HEIGHT - 50.0
        drawn.append(
            f'<path d="M{x:g} {y:g}l{right:.1f} {-up:.1f}" stroke="#555"/><text x="{x + 1.25 * right - 3:.1f}" '
            f'y="{y - 1.25 * up + 4:.1f}" font-size="11" fill="#555">{name}</text>'
        )
    return "".join(drawn)


def _bar(scale: float) -> str:
    length = max((bar for bar in BARS_MM if bar * scale <= 0.25 * WIDTH), default=BARS_MM[0])
    right, y = WIDTH - 30.0, HEIGHT - 30.0
    return (
        f'<path d="M{right - length * scale:.1f} {y:g}H{right:g}" stroke="#111" stroke-width="2"/>'
        f'<text x="{right:g}" y="{y - 6:g}" font-size="12" text-anchor="end">{length:g} mm</text>'
    )


def _legend(times: int, truth: bool) -> str:
    size = "in scale" if times == 1 else f"drawn {times} times as large"
    lines = []
    for i, entry in enumerate(legend(size, truth)):
        lines.append(
            f'<g transform="translate(16 {12 + 18 * i})">{entry.mark}<text x="42" y="11" font-size="11" '
            f'fill="#333">{escape(entry.words)}</text></g>'
        )
    return "".join(lines)
