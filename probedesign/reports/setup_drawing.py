"""Drawing of a test's set-up as SVG: mount, probe as it will bend, gravity, and the weight or the touching edge."""

import math
from dataclasses import dataclass, field
from html import escape

import numpy as np

from probedesign.core.frames import Array
from probedesign.core.units import MM
from probedesign.estimation.model import ProbeModel
from probedesign.planning.candidates import CandidateTest
from probedesign.prediction.touches import DIRECTIONS

WIDTH, HEIGHT, MARGIN = 360.0, 230.0, 26.0
PROBE, LOAD, MARK, GREY = "#0072B2", "#D55E00", "#000000", "#666666"
"""Colours of `reports.chart`."""
LOAD_INK = "#A34700"
"""That of the load darkened, for words."""
PROJECTION = np.array([[1.0, 0.35, 0.0], [0.0, -0.28, -1.0]])
"""Oblique view of the world with x to the right, z up and y away from the viewer, in pixels downwards."""
STATIONS = 60
SENSOR, MOUNT = 0.10, 0.18
"""Lengths of the drawn sensor and robot adapter over the probe's."""


@dataclass
class _Canvas:
    """Elements of the drawing, and its map from the world to pixels."""

    origin: Array  #: origin, scale: of the map.
    scale: float
    elements: list[str] = field(default_factory=list)  #: SVG elements.

    @classmethod
    def fitting(cls, points: Array) -> "_Canvas":
        """Return a canvas that shows all points of the world, (n, 3)."""
        flat = points @ PROJECTION.T
        low, high = flat.min(axis=0), flat.max(axis=0)
        space = np.array([WIDTH - 2.0 * MARGIN, HEIGHT - 2.0 * MARGIN])
        scale = float(np.min(space / np.maximum(high - low, 1e-6)))
        return cls(0.5 * (low + high) - 0.5 * np.array([WIDTH, HEIGHT]) / scale, scale)

    def at(self, points: Array) -> Array:
        """Return pixels of points of the world, (..., 2)."""
        return np.asarray((points @ PROJECTION.T - self.origin) * self.scale)

    def polygon(self, pixels: Array, fill: str, stroke: str = "none") -> None:
        """Draw a filled polygon."""
        text = " ".join(f"{x:.1f},{y:.1f}" for x, y in pixels)
        self.elements.append(f'<polygon points="{text}" fill="{fill}" stroke="{stroke}"/>')

    def line(self, pixels: Array, colour: str, width: float = 1.5, dashes: str = "", arrow: bool = False) -> None:
        """Draw a line through pixels, with an arrow head at its end on request."""
        text = " ".join(f"{x:.1f},{y:.1f}" for x, y in pixels)
        dashed = f' stroke-dasharray="{dashes}"' if dashes else ""
        self.elements.append(
            f'<polyline points="{text}" fill="none" stroke="{colour}" stroke-width="{width}"{dashed}/>'
        )
        if arrow:
            tip, back = pixels[-1], pixels[-1] - pixels[-2]
            along = back / max(float(np.linalg.norm(back)), 1e-9)
            across = np.array([-along[1], along[0]])
            self.polygon(np.array([tip + 3.0 * along, tip - 6.0 * along + 4.0 * across,
                                   tip - 6.0 * along - 4.0 * across]), colour)  # fmt: skip

    def text(self, pixel: Array, words: str, colour: str = MARK, anchor: str = "middle", size: float = 12.0) -> None:
        """Write words at a pixel, moved into the drawing."""
        half = 0.5 * 0.58 * size * len(words)
        x = float(np.clip(pixel[0], half + 2.0, WIDTH - half - 2.0)) if anchor == "middle" else float(pixel[0])
        y = float(np.clip(pixel[1], size, HEIGHT - 4.0))
        self.elements.append(f'<text x="{x:.1f}" y="{y:.1f}" font-size="{size:g}" text-anchor="{anchor}" '
                             f'fill="{colour}" stroke="#fff" stroke-width="3" paint-order="stroke">'
                             f"{escape(words)}</text>")  # fmt: skip

    def svg(self, label: str) -> bytes:
        """Return the document."""
        return (f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH:g} {HEIGHT:g}" role="img" '
                f'aria-label="{escape(label)}" font-family="Helvetica, Arial, sans-serif">'
                f'<rect width="{WIDTH:g}" height="{HEIGHT:g}" fill="#fff"/>{"".join(self.elements)}</svg>\n'
                ).encode()  # fmt: skip


def set_up_drawing(model: ProbeModel, candidate: CandidateTest) -> bytes:
    """Return the drawing of a test.

    Args:
        model: of the probe as designed.
        candidate: a test with a shape: a free hang, a weight or a touch.
    """
    test, shape = candidate.test, candidate.shape
    assert test is not None and shape is not None
    T, rod = test.T_world_base, model.rod
    s = np.linspace(0.0, rod.length, STATIONS)
    line = shape.p_at(s) @ T[:3, :3].T + T[:3, 3]
    axis = T[:3, 2]
    straight = T[:3, 3] + np.outer([0.0, rod.length], axis)
    behind = T[:3, 3] - (SENSOR + MOUNT) * rod.length * axis
    down = np.array([0.0, 0.0, -0.25 * rod.length])
    loaded = line[np.searchsorted(s, candidate.mark)] if math.isfinite(candidate.mark) else line[0]
    room = [loaded + (1.1 * down if candidate.mass else 0.0 * down)]
    canvas = _Canvas.fitting(np.concatenate([line, straight, [behind], room]))
    _mount(canvas, T, rod.length, float(rod.radius[0]))
    canvas.line(canvas.at(straight), GREY, 1.0, "4 4")
    pixels = canvas.at(line)
    normal = _normals(pixels)
    width = np.maximum(rod.radius_at(s) * canvas.scale, 1.2)[:, None]
    canvas.polygon(np.concatenate([pixels + width * normal, (pixels - width * normal)[::-1]]), PROBE)
    push = np.array([-1.0, 1.0]) / math.sqrt(2.0)  # of the load in the drawing
    if test.force_world is None:
        angle = DIRECTIONS[test.direction]
        flat = PROJECTION @ T[:3, :3] @ np.array([math.cos(angle), math.sin(angle), 0.0])
        push = flat / float(np.linalg.norm(flat))
    if math.isfinite(candidate.mark):
        i = int(np.searchsorted(s, candidate.mark))
        away = push if test.force_world is None else -push
        _mark(canvas, candidate.mark, pixels[i], normal[i], float(width[i, 0]), away)
        if candidate.mass:
            _weight(canvas, pixels[i], candidate.mass)
        else:
            _edge(canvas, pixels[i], push, candidate, float(width[i, 0]))
    _gravity(canvas)
    _axes(canvas, T)
    return canvas.svg(candidate.words)


def _normals(pixels: Array) -> Array:
    along = np.gradient(pixels, axis=0)
    along /= np.maximum(np.linalg.norm(along, axis=1), 1e-9)[:, None]
    return np.stack([-along[:, 1], along[:, 0]], axis=1)


def _mount(canvas: _Canvas, T: Array, length: float, radius: float) -> None:
    """Draw sensor and robot adapter behind the base."""
    base, axis = T[:3, 3], T[:3, 2]
    side = T[:3, 0] if abs(T[2, 0]) > abs(T[2, 1]) else T[:3, 1]
    if abs(axis[2]) > 0.9:
        side = np.array([1.0, 0.0, 0.0])
    for start, end, half, fill in ((0.0, SENSOR, 1.45, "#999999"), (SENSOR, SENSOR + MOUNT, 2.6, "#cccccc")):
        corners = [base - k * length * axis + sign * half * radius * side
                   for k, sign in ((start, -1.0), (start, 1.0), (end, 1.0), (end, -1.0))]  # fmt: skip
        canvas.polygon(canvas.at(np.array(corners)), fill, "#555")


def _mark(canvas: _Canvas, mark: float, at: Array, normal: Array, width: float, label: Array) -> None:
    """Draw the mark across the probe, with its arclength in the direction of `label`."""
    reach = (width + 4.0) * normal
    canvas.line(np.array([at - reach, at + reach]), MARK, 1.5)
    side = np.array([34.0, 18.0]) * label
    canvas.text(at + side + np.array([0.0, 4.0]), f"s = {mark / MM:g} mm")


def _weight(canvas: _Canvas, at: Array, mass: float) -> None:
    end = at + np.array([0.0, 34.0])
    canvas.line(np.array([at, end]), LOAD, 1.2)
    canvas.polygon(end + np.array([[-6.0, 0.0], [6.0, 0.0], [9.0, 16.0], [-9.0, 16.0]]), LOAD)
    canvas.text(end + np.array([14.0, 13.0]), f"{1e3 * mass:g} g", LOAD_INK, "start")


def _edge(canvas: _Canvas, at: Array, along: Array, candidate: CandidateTest, width: float) -> None:
    """Draw the touching edge on the side that it pushes from, with an arrow along its displacement."""
    assert candidate.test is not None
    across, tip = np.array([-along[1], along[0]]), at - width * along
    canvas.polygon(np.array([tip, tip - 16.0 * along + 7.0 * across, tip - 16.0 * along - 7.0 * across]), LOAD)
    start = tip - 44.0 * along
    canvas.line(np.array([start, tip - 20.0 * along]), LOAD, 2.0, arrow=True)
    words = f"{candidate.displacement / MM:g} mm {candidate.test.direction}"
    canvas.text(start - 10.0 * along + np.array([0.0, 4.0]), words, LOAD_INK)


def _gravity(canvas: _Canvas) -> None:
    start = np.array([WIDTH - 18.0, 14.0])
    canvas.line(np.array([start, start + np.array([0.0, 30.0])]), GREY, 2.0, arrow=True)
    canvas.text(start + np.array([-12.0, 22.0]), "g", GREY)


def _axes(canvas: _Canvas, T: Array) -> None:
    """Draw the axes of the base in a corner."""
    origin = np.array([34.0, HEIGHT - 34.0])
    for i, name in enumerate("xyz"):
        flat = 22.0 * (PROJECTION @ T[:3, i])
        canvas.line(np.array([origin, origin + flat]), MARK, 1.2, arrow=True)
        canvas.text(origin + 1.45 * flat + np.array([0.0, 4.0]), name, size=11.0)
