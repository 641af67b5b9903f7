"""A photograph with what was found in it drawn on it, for a person to check."""

import cv2
import numpy as np
from numpy.typing import NDArray

from probedesign.frames import Array
from probedesign.vision.finder import Found

GREEN, YELLOW = (80, 220, 60), (0, 220, 255)  # blue, green, red
WIDTH_PX = 1200
"""The part of a photograph that holds the row is drawn at least that wide."""
_FRACTION = 4  # bits of a pixel's fraction, for lines that lie between pixels


def overlay(grey: NDArray[np.uint8], found: Found) -> NDArray[np.uint8]:
    """The part of a photograph about the row of dots, with their outlines, centres and numbers.

    Args:
        grey: the photograph (height, width).
        found: in it.

    Returns:
        Blue, green, red (height, width, 3).
    """
    low, high = _part(grey, found)
    part = grey[low[1] : high[1], low[0] : high[0]]
    scale = max(1, int(np.ceil(WIDTH_PX / part.shape[1])))
    large = cv2.resize(part, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
    picture = cv2.cvtColor(large, cv2.COLOR_GRAY2BGR)
    points = np.array([_at(dot.pixel, low, scale) for dot in found.dots])
    cv2.polylines(picture, [_fixed(points)], False, YELLOW, 1, cv2.LINE_AA, _FRACTION)
    beside = _beside(points)
    for number, (dot, point) in enumerate(zip(found.dots, points, strict=True), 1):
        outline = _fixed(point + scale * _outline(dot.shape))
        cv2.polylines(picture, [outline], True, GREEN, 1, cv2.LINE_AA, _FRACTION)
        # As far from the dot as the row is wide there, on the outer side of its bend.
        far = 10 + scale * dot.diameter_px * 1.6
        text = tuple(round(float(c)) for c in point + far * beside[number - 1] - (6.0, -6.0))
        cv2.putText(picture, str(number), text, cv2.FONT_HERSHEY_SIMPLEX, 0.6, YELLOW, 1, cv2.LINE_AA)
    return np.asarray(picture, dtype=np.uint8)


def _part(grey: NDArray[np.uint8], found: Found) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Upper left and lower right corner of what is drawn."""
    margin = 0.12 * float(np.ptp(found.pixels, axis=0).max()) + 20.0
    size = np.array(grey.shape[::-1])
    low = np.clip(np.floor(found.pixels.min(axis=0) - margin), 0, size - 1).astype(np.int64)
    high = np.clip(np.ceil(found.pixels.max(axis=0) + margin), low + 1, size).astype(np.int64)
    return low, high


def _at(pixel: Array, low: NDArray[np.int64], scale: int) -> Array:
    """A place of the photograph in the part enlarged; (0, 0) is the centre of a pixel in both."""
    return np.asarray((pixel - low + 0.5) * scale - 0.5)


def _fixed(points: Array) -> NDArray[np.int32]:
    """As OpenCV wants places between pixels."""
    return np.asarray(np.round(points * 2**_FRACTION), dtype=np.int32).reshape(-1, 1, 2)


def _outline(shape: Array) -> Array:
    """Points |M x| = 1, (60, 2)."""
    angle = np.linspace(0.0, 2 * np.pi, 60, endpoint=False)
    return np.asarray(np.linalg.solve(shape, np.array([np.cos(angle), np.sin(angle)])).T)


def _beside(points: Array) -> Array:
    """Unit vectors across the row, (m, 2)."""
    along = np.gradient(points, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    return np.column_stack([along[:, 1], -along[:, 0]])
