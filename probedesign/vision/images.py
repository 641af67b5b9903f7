"""Images: photographs read as grey levels, written as PNG, and drawn with the detected markers for inspection."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from probedesign.core.errors import InputError
from probedesign.core.files import write_atomically
from probedesign.core.frames import Array
from probedesign.vision import require

if TYPE_CHECKING:
    from probedesign.vision.marker_sequence import DetectedMarkers

MAX_BYTES = 300_000_000
"""Size of a photograph (assumed)."""
GREEN, YELLOW = (80, 220, 60), (0, 220, 255)  # blue, green, red
WIDTH_PX = 1200
"""Minimum width of the drawn part of a photograph."""
_FRACTION = 4  # bits of a pixel's fraction, for lines that lie between pixels


def read_grey(path: Path) -> NDArray[np.uint8]:
    """Return the grey levels of a photograph (height, width), rotated by its EXIF orientation.

    Raises:
        InputError: it is missing, or not an image.
        MissingDependencyError: OpenCV is not installed.
    """
    require()
    import cv2

    try:
        if path.stat().st_size > MAX_BYTES:
            raise InputError(
                f"{path}: is larger than {MAX_BYTES // 1_000_000} MB; save the photograph as PNG or JPEG"
            )
        content = np.fromfile(path, dtype=np.uint8)
    except FileNotFoundError:
        raise InputError(f"{path}: no such photograph") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_ERROR)  # its warnings are in our own message
    try:
        picture = cv2.imdecode(content, cv2.IMREAD_GRAYSCALE) if len(content) else None
    except cv2.error:
        picture = None
    if picture is None:
        raise InputError(f"{path}: is not an image that can be read; save it as PNG or JPEG")
    return np.asarray(picture, dtype=np.uint8)


def write_png(path: Path, picture: NDArray[np.uint8]) -> None:
    """Write an image, grey (height, width) or blue, green, red (height, width, 3), atomically.

    Raises:
        InputError: the folder cannot be written to.
        MissingDependencyError: OpenCV is not installed.
    """
    require()
    import cv2

    write_atomically(path, cv2.imencode(".png", picture)[1].tobytes())


def overlay(grey: NDArray[np.uint8], found: "DetectedMarkers") -> NDArray[np.uint8]:
    """Return the part of a photograph about the markers, with their outlines, centres and numbers.

    Args:
        grey: the photograph (height, width).
        found: markers in it.

    Returns:
        Blue, green, red (height, width, 3).

    Raises:
        MissingDependencyError: OpenCV is not installed.
    """
    require()
    import cv2

    low, high = _part(grey, found)
    part = grey[low[1] : high[1], low[0] : high[0]]
    scale = max(1, int(np.ceil(WIDTH_PX / part.shape[1])))
    large = cv2.resize(part, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
    picture = cv2.cvtColor(large, cv2.COLOR_GRAY2BGR)
    points = np.array([_at(dot.pixel, low, scale) for dot in found.dots])
    cv2.polylines(picture, [_fixed(points)], False, YELLOW, 1, cv2.LINE_AA, _FRACTION)
    normals = _normals(points)
    for number, (dot, point) in enumerate(zip(found.dots, points, strict=True), 1):
        outline = _fixed(point + scale * _outline(dot.shape))
        cv2.polylines(picture, [outline], True, GREEN, 1, cv2.LINE_AA, _FRACTION)
        # The number is beside the dot, outside the probe, on the outer side of its bend.
        far = 10 + scale * dot.diameter_px * 1.6
        text = tuple(round(float(c)) for c in point + far * normals[number - 1] - (6.0, -6.0))
        cv2.putText(picture, str(number), text, cv2.FONT_HERSHEY_SIMPLEX, 0.6, YELLOW, 1, cv2.LINE_AA)
    return np.asarray(picture, dtype=np.uint8)


def _part(grey: NDArray[np.uint8], found: "DetectedMarkers") -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the upper left and lower right corner of the drawn part."""
    margin = 0.12 * float(np.ptp(found.pixels, axis=0).max()) + 20.0
    size = np.array(grey.shape[::-1])
    low = np.clip(np.floor(found.pixels.min(axis=0) - margin), 0, size - 1).astype(np.int64)
    high = np.clip(np.ceil(found.pixels.max(axis=0) + margin), low + 1, size).astype(np.int64)
    return low, high


def _at(pixel: Array, low: NDArray[np.int64], scale: int) -> Array:
    """Return a pixel of the photograph in the enlarged part; (0, 0) is the centre of a pixel in both."""
    return np.asarray((pixel - low + 0.5) * scale - 0.5)


def _fixed(points: Array) -> NDArray[np.int32]:
    """Return points between pixels in OpenCV's fixed-point format."""
    return np.asarray(np.round(points * 2**_FRACTION), dtype=np.int32).reshape(-1, 1, 2)


def _outline(shape: Array) -> Array:
    """Return points |M x| = 1, (60, 2)."""
    angle = np.linspace(0.0, 2 * np.pi, 60, endpoint=False)
    return np.asarray(np.linalg.solve(shape, np.array([np.cos(angle), np.sin(angle)])).T)


def _normals(points: Array) -> Array:
    """Return unit vectors across the row, (m, 2)."""
    along = np.gradient(points, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    return np.column_stack([along[:, 1], -along[:, 0]])
