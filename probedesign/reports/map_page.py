"""A contact map as an HTML page with points to rotate and their table, and as a still picture (SVG)."""

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from probedesign.core import statistics
from probedesign.core.frames import Array, pose
from probedesign.core.svg import Canvas, element
from probedesign.core.units import MILLINEWTON, MM
from probedesign.live.processing.estimates import COVARIANCE
from probedesign.mapping.contact_map import (
    MAX_RMS_MM,
    MIN_RMS_MM,
    ContactMap,
    point_line,
    rms_colour,
    touch_numbers,
    unlocated_lines,
)
from probedesign.mapping.shapes import Shape
from probedesign.mapping.touch_point import LocatedTouch
from probedesign.reports.html_page import HtmlTable, html_document

# Scene

MIN_SPAN_MM = 10.0  #: Minimum extent of what is shown, so that a single point is not magnified without bounds.
MAGNIFICATIONS = (1, 5, 10)  #: Magnifications of ellipsoids that can be chosen.
MIN_VISIBLE = 0.02  #: Half-axis over the radius of the scene from which an ellipsoid is visible: about five pixels.


@dataclass(frozen=True)
class MapScene:
    """What page and picture show."""

    contact_map: ContactMap  #: its located points are shown.
    #: outlines of the touched objects, if a simulation states them [m], (k, 3) each, closed; the first side is the
    #: touched edge.
    truth: tuple[Array, ...] = ()
    shapes: tuple[Shape, ...] = ()  #: shapes that the touches support.
    #: lines of text on the shapes and the next touch.
    lines: tuple[str, ...] = ()
    #: the probe at the suggested touch: its axis from base to tip and its radius [m], (k, 4).
    ghost: Array | None = None

    @property
    def strokes(self) -> dict[str, str]:
        """Return the colour of the normals of each probe that located a point, by its name."""
        probes = sorted({point.touches[0].probe for point in self.contact_map.points}) or [""]
        return {probe: STROKE_COLOURS[i % len(STROKE_COLOURS)] for i, probe in enumerate(probes)}

    @property
    def film(self) -> list[tuple[str, str, int | None]]:
        """Return the touches in order of time: label, one line of text, and the number of the point from 0."""
        points = enumerate(self.contact_map.points)
        touches: list[tuple[LocatedTouch, int | None]] = [(touch, i) for i, point in points for touch in point.touches]
        touches += [(touch, None) for touch in self.contact_map.unlocated]
        touches.sort(key=lambda pair: pair[0].segment.start)
        return [(touch.label, f"touch {touch.label} at {touch.segment.start:.1f} s: "
                 + (touch.result if i is None else f"point {i + 1}"), i) for touch, i in touches]  # fmt: skip

    @property
    def centre_mm(self) -> Array:
        """Return the centre of everything shown [mm], (3,)."""
        corners = self._corners_mm
        return np.asarray(0.5 * (corners.min(axis=0) + corners.max(axis=0)))

    @property
    def radius_mm(self) -> float:
        """Return the radius about the centre [mm]."""
        distances = np.linalg.norm(self._corners_mm - self.centre_mm, axis=1)
        return max(float(distances.max()), 0.5 * MIN_SPAN_MM)

    @property
    def magnification(self) -> int:
        """Return the initial magnification of ellipsoids: the smallest with which half of them are visible."""
        longest = [np.linalg.eigvalsh(point.cov_world)[-1] for point in self.contact_map.points]
        half = statistics.sigmas_95(3) * math.sqrt(float(np.median(longest))) / MM if longest else self.radius_mm
        visible = (times for times in MAGNIFICATIONS if times * half >= MIN_VISIBLE * self.radius_mm)
        return next(visible, MAGNIFICATIONS[-1])

    @property
    def _corners_mm(self) -> Array:
        points = np.array([point.p_world for point in self.contact_map.points]).reshape(-1, 3)
        drawn = [line for shape in self.shapes for line in shape.outlines]
        corners = (
            np.concatenate([points, *self.truth, *drawn, *([] if self.ghost is None else [self.ghost[:, :3]])]) / MM
        )
        return corners if len(corners) else np.zeros((1, 3))


#: View of the still picture, and of the page before it is turned: azimuth of the eye about the world's z axis, from
#: where it looks along y, and its elevation above the ground [rad].
AZIMUTH, ELEVATION = math.radians(28.0), math.radians(22.0)
#: Directions to the right and up in the picture, in the world.
VIEW = np.array([
    (math.cos(AZIMUTH), math.sin(AZIMUTH), 0.0),
    (-math.sin(AZIMUTH) * math.sin(ELEVATION), math.cos(AZIMUTH) * math.sin(ELEVATION), math.cos(ELEVATION)),
])  # fmt: skip


TRUTH_COLOUR, SHAPE_COLOUR, GHOST_COLOUR = "#a08c5a", "#0b7a4b", "#8a4fbf"
STROKE_COLOURS = ("#999", "#c2188a", "#0097a7", "#b35c00")  #: Of the normals, by the probe of a point's first touch.
SYMBOL_SIZE = (34, 14)  #: Width and height of a symbol of the legend, in units of SVG.


def map_symbols(ellipsoids: str, scene: MapScene) -> list[tuple[str, str]]:
    """Return the symbols of the legend: SVG within `SYMBOL_SIZE`, and its meaning as plain text.

    `ellipsoids` states their magnification; truth, shapes and the next touch are explained where the scene has them.
    """
    blue, steps = hex_colour(MIN_RMS_MM), 8
    width = (SYMBOL_SIZE[0] - 4) / steps
    shades = [MIN_RMS_MM * (MAX_RMS_MM / MIN_RMS_MM) ** (i / (steps - 1)) for i in range(steps)]
    colour_scale = "".join(
        element("rect", x=2 + i * width, y=4, width=width, height=6, fill=hex_colour(shade))
        for i, shade in enumerate(shades)
    )
    symbols = [
        (element("circle", cx=17, cy=7, r=2, fill=blue), "point of the surface, with its number"),
        (element("ellipse", cx=17, cy=7, rx=12, ry=5, fill=blue, fill_opacity=0.25, stroke=blue),
         f"its 95 % ellipsoid, {ellipsoids}"),
        (colour_scale, f"RMS error from {MIN_RMS_MM:g} mm or less (blue) to {MAX_RMS_MM:g} mm or more (red)"),
    ]  # fmt: skip
    for probe, colour in scene.strokes.items():
        meaning = "outward normal of the object, from the force on the probe" + (f" {probe}" if probe else "")
        symbols.append((element("path", d="M6 7H28", stroke=colour), f"{meaning}; its length has no meaning"))
    if scene.shapes:
        line = element("path", d="M4 7H30", stroke=SHAPE_COLOUR, stroke_width=2)
        symbols.append((line, "shape by its touches; ellipses at its ends: its 95 % region across, magnified alike"))
    if scene.ghost is not None:
        line = element("path", d="M4 7H30", stroke=GHOST_COLOUR, stroke_width=3, stroke_opacity=0.5)
        symbols.append((line, "ghost of the probe at the suggested next touch"))
    if scene.truth:
        outline = element("path", d="M5 12L12 3H30L23 12Z", fill="none", stroke=TRUTH_COLOUR, stroke_width=0.8)
        edge = element("path", d="M5 12L12 3", stroke=TRUTH_COLOUR, stroke_width=2)
        meaning = "the simulated truth, not measured: touched objects, touched edges thick"
        symbols.append((outline + edge, meaning))
    return symbols


def hex_colour(rms_mm: float) -> str:
    """Return the colour of an RMS error [mm] as #rrggbb."""
    return "#{:02x}{:02x}{:02x}".format(*rms_colour(rms_mm))


def map_mesh(scene: MapScene) -> bytes:
    """Return shapes and points as PLY in millimetres with colours: meshes of what was touched and 95 % ellipsoids.

    Edges are bars of 1 mm, corners and tips balls of 2 mm, planes 0.2 mm thick.

    Raises:
        ImportError: trimesh is missing.
    """
    import trimesh
    from trimesh.creation import box, cylinder, icosphere
    from trimesh.exchange.ply import export_ply

    meshes = []
    for shape in scene.shapes:
        extent, middle = np.ptp(shape.extent, axis=1) / MM, np.zeros(3)
        if shape.kind == "plane":
            mesh, middle[:2] = box((*np.maximum(extent, 0.2), 0.2)), shape.extent.mean(axis=1)
        elif shape.kind in ("edge", "cylinder"):
            mesh, middle[2] = cylinder(shape.radius / MM or 0.5, max(float(extent[0]), 0.2)), shape.extent[0].mean()
        else:
            mesh = icosphere(3, shape.radius / MM or 1.0)
        mesh.apply_transform(pose(shape.frame, (shape.p + shape.frame @ middle) / MM))
        meshes.append((mesh, SHAPE_COLOUR))
    for point in scene.contact_map.points:
        half_axes, axes = statistics.ellipsoid_95(point.cov_world)
        T = pose(axes, point.p_world / MM)
        T[:3, :3] *= half_axes / MM
        meshes.append((icosphere(2).apply_transform(T), hex_colour(point.rms / MM)))
    for mesh, colour in meshes:
        mesh.visual.vertex_colors = trimesh.visual.color.hex_to_rgba(colour)
    whole = trimesh.util.concatenate([mesh for mesh, _ in meshes]) if meshes else trimesh.Trimesh()
    return bytes(export_ply(whole))


# Still picture

#: Size of the picture, its margin, and the height of a line of the legend at its top.
WIDTH, HEIGHT, MARGIN, LEGEND_STEP = 760.0, 640.0, 46.0, 18.0
SCALE_BARS_MM = (0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
NORMAL_LENGTH = 14.0  #: Length of a normal that lies in the plane of the picture, in its units.


def map_svg(scene: MapScene) -> bytes:
    """Return the picture of a scene: points with 95 % ellipsoids and numbers."""
    points, times = scene.contact_map.points, scene.magnification
    polygons = [polygon @ VIEW.T / MM for polygon in scene.truth]
    drawn = [line @ VIEW.T / MM for shape in scene.shapes for line in shape.outlines]
    ghost = [] if scene.ghost is None else [scene.ghost[:, :3] @ VIEW.T / MM]
    p = np.array([point.p_world for point in points]).reshape(-1, 3) @ VIEW.T / MM
    covs = VIEW @ np.array([point.cov_world for point in points]).reshape(-1, 3, 3) @ VIEW.T
    extents = times * statistics.sigmas_95(3) * np.sqrt(np.diagonal(covs, axis1=1, axis2=2)) / MM
    shown = np.concatenate([p - extents, p + extents, *polygons, *drawn, *ghost])
    low, high = (shown.min(axis=0), shown.max(axis=0)) if len(shown) else (np.zeros(2), np.zeros(2))
    symbols = map_symbols("in scale" if times == 1 else f"drawn {times} times as large", scene)
    above = LEGEND_STEP * (len(symbols) + 1)
    space = np.array([WIDTH - 2.0 * MARGIN, HEIGHT - MARGIN - above])
    scale, origin = float((space / np.maximum(high - low, MIN_SPAN_MM)).min()), 0.5 * (low + high)

    def at(flat: Array) -> Array:
        centre = np.array([0.5 * WIDTH, 0.5 * (HEIGHT + above - MARGIN)])
        return np.asarray((flat - origin) * (scale, -scale) + centre)

    canvas, placed = Canvas(WIDTH, HEIGHT), [at(flat) for flat in p]
    for polygon in map(at, polygons):
        canvas.area([polygon], "#c9b98a", fill_opacity="0.10", stroke=TRUTH_COLOUR, stroke_width="0.6")
        canvas.polylines([polygon[:2]], 2.0, TRUTH_COLOUR)
    canvas.polylines([at(line) for line in drawn], 2.0, SHAPE_COLOUR)
    canvas.polylines([at(line) for line in ghost], 4.0, GHOST_COLOUR)
    for point, (x, y) in zip(points, placed, strict=True):
        if point.direction is not None:
            end = (x, y) + NORMAL_LENGTH * (VIEW @ point.direction) * (1.0, -1.0)
            canvas.polylines([((x, y), end)], 1.0, scene.strokes[point.touches[0].probe])
        half_axes, axes = statistics.ellipsoid_95(VIEW @ point.cov_world @ VIEW.T)
        ry, rx = half_axes / MM * times * scale
        colour, turn = hex_colour(point.rms / MM), -math.degrees(math.atan2(axes[1, 1], axes[0, 1]))
        ellipse = element("ellipse", rx=rx, ry=max(ry, 0.4), fill=colour, fill_opacity=0.25, stroke=colour)
        centre = element("circle", r=2, fill=colour)
        canvas.add("g", ellipse, centre, transform=f"translate({x:.1f} {y:.1f}) rotate({turn:.1f})")
    for i, (x, y) in enumerate(placed, 1):
        canvas.text((x + 5, y - 5), str(i), 10, "start", fill="#333")
    corner = np.array([50.0, HEIGHT - 50.0])
    for name, end in zip("xyz", 30.0 * VIEW.T * (1.0, -1.0), strict=True):
        canvas.polylines([(corner, corner + end)], 1.0, "#555")
        canvas.text(corner + 1.25 * end + (-3.0, 4.0), name, 11, "start", fill="#555")
    length = max((bar for bar in SCALE_BARS_MM if bar * scale <= 0.25 * WIDTH), default=SCALE_BARS_MM[0])
    right, y = WIDTH - 30.0, HEIGHT - 30.0
    canvas.polylines([((right - length * scale, y), (right, y))], 2.0, "#111")
    canvas.text((right, y - 6), f"{length:g} mm", 12, "end")
    for i, (symbol, meaning) in enumerate(symbols):
        words = element("text", text=meaning, x=42, y=11, font_size=11, fill="#333")
        canvas.add("g", symbol, words, transform=f"translate(16 {12 + LEGEND_STEP * i:g})")
    return str(canvas).encode()


# Page

SCRIPT = Path(__file__).with_suffix(".js")
ORBIT = SCRIPT.with_name("orbit.js")
STYLE = """canvas { width: 100%; height: 150mm; border: 0.4pt solid #bbb; color: #111; touch-action: none; cursor: grab;
  display: block; box-sizing: border-box }
#status { color: var(--soft); min-height: 1.4em; margin: 1mm 0 3mm; font-size: 9.5pt }
#times, #film { margin: 0 0 1.5mm } #times label, #film label { margin-left: 3mm } #times input { vertical-align: -1px }
#film input { width: min(90mm, 50%); vertical-align: middle } #film button { min-width: 5em }
.legend { list-style: none; padding: 0; margin: 0 0 5mm; color: var(--soft); font-size: 9.5pt }
.legend svg { vertical-align: -2px; margin-right: 1.5mm }
.still { display: none }
"""
#: On paper and without scripts: the still picture, which has its own legend.
STILL_STYLE = "canvas, #times, #film, #status, .legend { display: none } .still { display: block }"
HINT = "Drag or use the arrow keys to rotate, scroll to zoom, double-click to reset; point at a point to read it."
HEAD = ("point", "x [mm]", "y [mm]", "z [mm]", "± [mm]", "common part [mm]", "force [mN]", "touches")


def map_page(scene: MapScene, title: str, about: Sequence[str]) -> bytes:
    """Return the page with lines about the data and the assumptions below its title."""
    data = json.dumps(_data(scene), allow_nan=False).replace("<", "\\u003c")
    choices = "".join(
        f'<label><input type="radio" name="times" value="{times}"{" checked" if times == scene.magnification else ""}>'
        f"×{times}{' (in scale)' if times == 1 else ''}</label>"
        for times in MAGNIFICATIONS
    )
    width, height = SYMBOL_SIZE
    symbols = "".join(
        f'<li><svg width="{width}" height="{height}" aria-hidden="true">{svg}</svg> {escape(meaning)}</li>'
        for svg, meaning in map_symbols("magnified as chosen above", scene)
    )
    below = (*unlocated_lines(scene.contact_map), *scene.lines)
    unlocated = "".join(f"<p>{escape(line)}.</p>" for line in below)
    steps = len(scene.film)
    film = (
        '<form id="film"><button type="button">Play</button><label>Touches in order of time '
        f'<input type="range" min="1" max="{steps}" value="{steps}"></label></form>\n'
    )
    body = (
        f'<form id="times">Magnification of ellipsoids {choices}</form>\n'
        '<canvas id="map" role="img" tabindex="0" aria-label="points and their ellipsoids"></canvas>'
        f'<div class="still">{map_svg(scene).decode()}</div>\n<p id="status">{HINT}</p>\n'
        f"{film if steps > 1 else ''}"
        f'<ul class="legend">{symbols}</ul>\n'
        f"{_table(scene.contact_map)}{unlocated}\n"
        f'<script type="application/json" id="data">{data}</script>\n'
        f"<script>\n{ORBIT.read_text('utf-8')}{SCRIPT.read_text('utf-8')}</script>"
    )
    style = f"{STYLE}@media print {{ {STILL_STYLE} }}\n"
    head = f"<noscript><style>{STILL_STYLE}</style></noscript>"
    return html_document(title, list(map(escape, about)), body, style, head)


def _data(scene: MapScene) -> dict[str, Any]:
    film = scene.film
    step = {label: k for k, (label, _, _) in enumerate(film)}
    return {
        "azimuth": AZIMUTH, "elevation": ELEVATION, "flat": 1.0, "centre": scene.centre_mm.tolist(),
        "radius": scene.radius_mm, "radius_95": statistics.sigmas_95(3), "normal": NORMAL_LENGTH, "hint": HINT,
        "truth": [(polygon / MM).tolist() for polygon in scene.truth], "truth_colour": TRUTH_COLOUR,
        "film": [[text, i] for _, text, i in film], "shape_colour": SHAPE_COLOUR, "ghost_colour": GHOST_COLOUR,
        "ghost": None if scene.ghost is None else (scene.ghost / MM).tolist(),
        "shapes": [
            {
                "lines": [(line / MM).tolist() for line in shape.outlines],
                "ends": (shape.ends / MM).tolist(),
                "step": max(step.get(label, 0) for label in shape.touches),
                "covs": [[float(cov[i, j] / MM**2) for _, i, j in COVARIANCE] for cov in shape.end_covs],
            }
            for shape in scene.shapes
        ],
        "points": [
            {
                "p": (point.p_world / MM).tolist(),
                "cov": [float(point.cov_world[i, j] / MM**2) for _, i, j in COVARIANCE],
                "step": min(step[touch.label] for touch in point.touches),
                "stroke": scene.strokes[point.touches[0].probe],
                "colour": hex_colour(point.rms / MM), "text": point_line(number, point),
                "normal": None if point.direction is None else point.direction.tolist(),
            }
            for number, point in enumerate(scene.contact_map.points, 1)
        ],
    }  # fmt: skip


def _table(contact_map: ContactMap) -> str:
    rows = []
    for number, point in enumerate(contact_map.points, 1):
        common = statistics.rms(point.cov_common) / MM
        lengths = (f"{value:z.2f}" for value in (*point.p_world / MM, point.rms / MM, common))
        force = f"{point.force / MILLINEWTON:.1f}"
        rows.append([str(number), *lengths, force, touch_numbers(point, ", ")])
    return HtmlTable(HEAD, rows).html()
