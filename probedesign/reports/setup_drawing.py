"""Drawing of a test's set-up as SVG: mount, probe as it will bend, gravity, and the weight or the touching edge."""

import math

import numpy as np

from probedesign.core.frames import Array
from probedesign.core.svg import Anchor, Canvas
from probedesign.core.units import MM
from probedesign.estimation.model import ProbeModel
from probedesign.planning.candidates import CandidateTest
from probedesign.prediction.touches import DIRECTIONS

WIDTH, HEIGHT, MARGIN = 360.0, 230.0, 26.0
#: Colours of `reports.chart`.
PROBE, LOAD, MARK, GREY = "#0072B2", "#D55E00", "#000000", "#666666"
#: That of the load darkened, for words.
LOAD_INK = "#A34700"
#: Oblique view of the world with x to the right, z up and y away from the viewer, in pixels downwards.
PROJECTION = np.array([[1.0, 0.35, 0.0], [0.0, -0.28, -1.0]])
STATIONS = 60
SENSOR, MOUNT = 0.10, 0.18  #: Lengths of the drawn sensor and robot adapter over the probe's.


def set_up_drawing(model: ProbeModel, candidate: CandidateTest) -> bytes:
    """Return the drawing of a test with a shape: a free hang, a weight or a touch."""
    test, shape = candidate.test, candidate.shape
    assert test is not None and shape is not None
    T, rod = test.T_world_base, model.rod
    R, base, axis = T[:3, :3], T[:3, 3], T[:3, 2]
    s = np.linspace(0.0, rod.length, STATIONS)
    line = shape.p_at(s) @ R.T + base
    straight = base + np.outer([0.0, rod.length], axis)
    touched = int(np.searchsorted(s, candidate.mark)) if math.isfinite(candidate.mark) else 0
    hanging = line[touched] - [0.0, 0.0, 0.275 * rod.length if candidate.mass else 0.0]
    behind = base - (SENSOR + MOUNT) * rod.length * axis
    flat = np.concatenate([line, straight, [behind, hanging]]) @ PROJECTION.T
    low, high = flat.min(axis=0), flat.max(axis=0)
    size = np.array([WIDTH, HEIGHT])
    scale = float(np.min((size - 2.0 * MARGIN) / np.maximum(high - low, 1e-6)))

    def at(points: Array) -> Array:
        """Return pixels of points of the world, (..., 2)."""
        return np.asarray((points @ PROJECTION.T - 0.5 * (low + high)) * scale + 0.5 * size)

    canvas = Canvas(WIDTH, HEIGHT, title=candidate.words)
    side = T[:3, 0] if abs(T[2, 0]) > abs(T[2, 1]) else T[:3, 1]
    side = np.array([1.0, 0.0, 0.0]) if abs(axis[2]) > 0.9 else side
    for start, end, half, fill in ((0.0, SENSOR, 1.45, "#999999"), (SENSOR, SENSOR + MOUNT, 2.6, "#cccccc")):
        corners = [base - k * rod.length * axis + sign * half * float(rod.radius[0]) * side
                   for k, sign in ((start, -1.0), (start, 1.0), (end, 1.0), (end, -1.0))]  # fmt: skip
        canvas.area([at(np.array(corners))], fill, stroke="#555")
    canvas.polylines([at(straight)], 1.0, GREY, "4 4")
    pixels = at(line)
    along = np.gradient(pixels, axis=0)
    along /= np.maximum(np.linalg.norm(along, axis=1), 1e-9)[:, None]
    normal = np.stack([-along[:, 1], along[:, 0]], axis=1)
    width = np.maximum(rod.radius_at(s) * scale, 1.2)[:, None]
    canvas.area([np.concatenate([pixels + width * normal, (pixels - width * normal)[::-1]])], PROBE)
    if math.isfinite(candidate.mark):
        _load(canvas, candidate, pixels[touched], normal[touched], float(width[touched, 0]), PROJECTION @ R)
    corner = np.array([WIDTH - 18.0, 14.0])
    _arrow(canvas, corner, corner + np.array([0.0, 30.0]), GREY, 2.0)
    _text(canvas, corner + np.array([-12.0, 22.0]), "g", GREY)
    corner = np.array([34.0, HEIGHT - 34.0])  # the axes of the base
    for i, name in enumerate("xyz"):
        seen = 22.0 * (PROJECTION @ R[:, i])
        _arrow(canvas, corner, corner + seen, MARK, 1.2)
        _text(canvas, corner + 1.55 * seen + np.array([0.0, 4.0]), name)
    return f"{canvas}\n".encode()


def _load(canvas: Canvas, candidate: CandidateTest, at: Array, normal: Array, width: float, view: Array) -> None:
    """Draw the mark across the probe with its arclength, and the weight or the edge that pushes there.

    Args:
        canvas: to draw on.
        candidate: a weight or a touch.
        at, normal, width: the marked section in pixels: centre (2,), unit vector across the probe (2,), half width.
        view: projection of vectors in base axes, (2, 3).
    """
    test = candidate.test
    assert test is not None
    reach = (width + 4.0) * normal
    canvas.polylines([[at - reach, at + reach]], 1.5, MARK)
    label = np.array([1.0, -1.0]) / math.sqrt(2.0)
    if candidate.mass:
        end = at + np.array([0.0, 34.0])
        canvas.polylines([[at, end]], 1.2, LOAD)
        canvas.area([end + np.array([[-6.0, 0.0], [6.0, 0.0], [9.0, 16.0], [-9.0, 16.0]])], LOAD)
        _text(canvas, end + np.array([14.0, 13.0]), f"{1e3 * candidate.mass:g} g", LOAD_INK, "start")
    else:
        angle = DIRECTIONS[test.direction]
        push = view @ [math.cos(angle), math.sin(angle), 0.0]
        label = push = push / float(np.linalg.norm(push))
        across, tip = np.array([-push[1], push[0]]), at - width * push
        canvas.area([[tip, tip - 16.0 * push + 7.0 * across, tip - 16.0 * push - 7.0 * across]], LOAD)
        start = tip - 44.0 * push
        _arrow(canvas, start, tip - 20.0 * push, LOAD, 2.0)
        words = f"{candidate.displacement / MM:g} mm {test.direction}"
        _text(canvas, start - 10.0 * push + np.array([0.0, 4.0]), words, LOAD_INK)
    _text(canvas, at + np.array([34.0, 18.0]) * label + np.array([0.0, 4.0]), f"s = {candidate.mark / MM:g} mm")


def _arrow(canvas: Canvas, start: Array, end: Array, colour: str, width: float) -> None:
    along = (end - start) / max(float(np.linalg.norm(end - start)), 1e-9)
    across = np.array([-along[1], along[0]])
    canvas.polylines([[start, end]], width, colour)
    canvas.area([[end + 3.0 * along, end - 6.0 * along + 4.0 * across, end - 6.0 * along - 4.0 * across]], colour)


def _text(
    canvas: Canvas, pixel: Array, words: str, colour: str = MARK, anchor: Anchor = "middle", size: float = 12.0
) -> None:
    """Write words at a pixel, moved into the drawing."""
    half = 0.5 * 0.58 * size * len(words)
    x = float(np.clip(pixel[0], half + 2.0, WIDTH - half - 2.0)) if anchor == "middle" else float(pixel[0])
    y = float(np.clip(pixel[1], size, HEIGHT - 4.0))
    canvas.text((x, y), words, size, anchor, fill=colour, stroke="#fff", stroke_width="3", paint_order="stroke")
