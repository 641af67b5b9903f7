"""Markers in a photograph: the row of dots along the probe, from base to tip, and a picture to inspect them."""

import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from probedesign.core.errors import InputError
from probedesign.core.files import write_atomically
from probedesign.core.frames import Array
from probedesign.vision import require_opencv
from probedesign.vision.dots import DetectedSpots, Dot, detect_spots, fit_dot

ImageSide = Literal["left", "right", "top", "bottom"]

AWAY = {"left": (1, 0), "right": (-1, 0), "top": (0, 1), "bottom": (0, -1)}
"""Direction in the picture away from each of its sides."""

MAX_STEP_CHANGE = 0.6
"""Largest change of the step from dot to dot, relative to its length: 35° of bending, or as much of foreshortening."""
MAX_GROWTH = 1.7
"""Largest ratio of the sizes of neighbouring dots."""
NEXT = 0.35
"""Distance, in steps, within which a spot at the end of the row is one more dot."""
NEIGHBOURS = 8
"""Nearest spots that may follow the first of a row."""
BEAM = 400
"""Rows kept in each step of the search."""
MAX_BYTES = 300_000_000
"""Size of a photograph (assumed)."""
GREEN, YELLOW = (80, 220, 60), (0, 220, 255)  # blue, green, red
WIDTH_PX = 1200
"""Minimum width of the drawn part of a photograph."""
_FRACTION = 4  # bits of a pixel's fraction, for lines that lie between pixels


# image files

SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp")


def read_grey(path: Path) -> NDArray[np.uint8]:
    """Return the grey levels of a photograph (height, width), rotated by its EXIF orientation.

    Raises:
        InputError: it is missing, or not an image.
    """
    require_opencv()
    import cv2

    try:
        if path.stat().st_size > MAX_BYTES:
            raise InputError(f"{path}: is larger than {MAX_BYTES // 1_000_000} MB; save the photograph as PNG or JPEG")
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
    """Write an image, grey (height, width) or blue, green, red (height, width, 3), atomically."""
    require_opencv()
    import cv2

    write_atomically(path, cv2.imencode(".png", picture)[1].tobytes())


# the search among spots


@dataclass(frozen=True)
class MarkerSequence:
    """Spots in a row."""

    chosen: tuple[int, ...]  #: which spots, first to last, (k,).
    cost: float = 0.0  #: sum of squared changes of steps and sizes along it.


@dataclass(frozen=True)
class SequenceSearch:
    """Beam search for the row of dots among spots."""

    spots: DetectedSpots  #: of the photograph.
    s: Array  #: arclength of the dots, first to last [m], (m,).
    base: Array | ImageSide  #: the projected base [px], (2,), or the side of the picture nearer to it.

    @cached_property
    def _steps(self) -> Array:
        """Lengths of the steps, in units of their mean, (m - 1,)."""
        return np.asarray(np.diff(self.s) / np.mean(np.diff(self.s)))

    def best(self) -> MarkerSequence:
        """Return the longest row with the least cost, at most as long as the dots; empty if there are no two spots."""
        rows, best = self._pairs(), MarkerSequence(())
        while rows:
            best = rows[0]
            if len(best.chosen) == len(self.s):
                break
            longer = [one for row in rows for one in self._longer(row)]
            rows = sorted(longer, key=lambda row: row.cost)[:BEAM]
        return best

    def continues_beyond(self, row: MarkerSequence) -> bool:
        """Return whether one more dot follows the last, so that there are more dots than expected."""
        points = self.spots.pixels[list(row.chosen)]
        step = points[-1] - points[-2]
        near = np.linalg.norm(self.spots.pixels - (points[-1] + step), axis=1) < NEXT * np.linalg.norm(step)
        return bool(np.any(near & self._alike(row.chosen[-1])))

    def _pairs(self) -> list[MarkerSequence]:
        """Return every spot with each of its neighbours, from the base onwards."""
        rows, pixels = [], self.spots.pixels
        for i, pixel in enumerate(pixels):
            alike = self._alike(i)
            nearest = np.argsort(np.where(alike, np.linalg.norm(pixels - pixel, axis=1), np.inf))
            for j in nearest[: NEIGHBOURS + 1]:
                if j != i and alike[j] and self._base_distance(pixel) < self._base_distance(pixels[j]):
                    rows.append(MarkerSequence((i, int(j)), self._start_cost(pixel, pixels[j])))
        return sorted(rows, key=lambda row: row.cost)

    def _base_distance(self, pixel: Array) -> float:
        """Return a measure that increases with the distance of a pixel from the base."""
        if isinstance(self.base, str):
            return float(np.dot(pixel, AWAY[self.base]))
        return float(np.linalg.norm(pixel - self.base))

    def _start_cost(self, first: Array, second: Array) -> float:
        """Return the squared distance of the base from its extrapolation by the first step, in steps."""
        if isinstance(self.base, str):
            return 0.0
        step = (second - first) / self._steps[0]
        extrapolated = first - step * self.s[0] / np.mean(np.diff(self.s))
        return float(np.sum((extrapolated - self.base) ** 2) / np.sum(step**2))

    def _longer(self, row: MarkerSequence) -> list[MarkerSequence]:
        """Return the row with one more spot, for each spot that continues it."""
        number, last = len(row.chosen), row.chosen[-1]
        points = self.spots.pixels[list(row.chosen[-2:])]
        step = (points[1] - points[0]) / self._steps[number - 2] * self._steps[number - 1]
        turn = np.linalg.norm(self.spots.pixels - (points[1] + step), axis=1) / max(math.hypot(*step), 1e-9)
        growth = np.log(self.spots.diameter_px / self.spots.diameter_px[last])
        good = (turn < MAX_STEP_CHANGE) & self._alike(last)
        good[list(row.chosen)] = False
        cost = row.cost + turn**2 + growth**2
        return [MarkerSequence((*row.chosen, int(j)), float(cost[j])) for j in np.flatnonzero(good)]

    def _alike(self, i: int) -> NDArray[np.bool_]:
        """Return which spots may be neighbours of a spot, by their size."""
        ratio = self.spots.diameter_px / self.spots.diameter_px[i]
        return np.asarray((ratio < MAX_GROWTH) & (ratio > 1 / MAX_GROWTH))


# the markers


@dataclass(frozen=True)
class DetectedMarkers:
    """Dots of a probe in one photograph."""

    pixels: Array  #: centres from base to tip [px], (m, 2).
    std_px: Array  #: standard deviation of a coordinate of each [px], (m,).
    dots: tuple[Dot, ...]  #: the fitted dots, (m,).
    dark: bool  #: whether they are darker than the probe.


def find_markers(path: Path, s: ArrayLike, base: Array | ImageSide, dark: bool | None = None) -> DetectedMarkers:
    """Find the dots of a probe in a photograph.

    Args:
        path: of the photograph, in a format that OpenCV reads.
        s: arclength of the dots from base to tip, their number and their spacing [m], (m,).
        base: pixel of the projected base (2,), or the side of the picture nearer to it.
        dark: whether the dots are darker than the probe; either if None.

    Raises:
        InputError: no such photograph, or it has no row of that many dots.
    """
    places = np.asarray(s, dtype=float)
    if len(places) < 3 or not (np.diff(places) > 0).all():
        raise InputError(
            f"{path}: a row has at least three dots, from base to tip; the markers' s_mm name {len(places)}"
        )
    grey = read_grey(path)
    tried = []
    for shade in (True, False) if dark is None else (dark,):
        search = SequenceSearch(detect_spots(grey, shade), places, base)
        tried.append((search, search.best()))
    complete = [(search, row) for search, row in tried if len(row.chosen) == len(places)]
    if not complete:
        longest = max((row for _, row in tried), key=lambda row: len(row.chosen))
        count = "no row of dots" if len(longest.chosen) < 3 else f"{len(longest.chosen)} dots in a row"
        raise InputError(
            f"{path}: {count}, but {len(places)} are expected (the markers' s_mm); dots must be sharp, round and all "
            "visible; otherwise click them into pixels.csv"
        )
    search, row = min(complete, key=lambda one: one[1].cost)
    if search.continues_beyond(row):
        raise InputError(
            f"{path}: more dots in a row than the {len(places)} expected (the markers' s_mm); cover spots that are not "
            "dots"
        )
    return _fitted(path, grey, search.spots, row)


def _fitted(path: Path, grey: NDArray[np.uint8], seen: DetectedSpots, row: MarkerSequence) -> DetectedMarkers:
    """Return the markers of a row, each dot fitted; refuse one that does not fit."""
    dots: list[Dot] = []
    directions = np.gradient(seen.pixels[list(row.chosen)], axis=0)
    for number, (i, direction) in enumerate(zip(row.chosen, directions, strict=True), 1):
        dot = fit_dot(grey, seen.pixels[i], float(seen.diameter_px[i]), direction)
        if dot is None:
            u, v = seen.pixels[i]
            raise InputError(
                f"{path}: dot {number} at u {u:.0f}, v {v:.0f} px is not a whole ellipse; it may be half hidden "
                "or touch the probe's edge"
            )
        dots.append(dot)
    pixels = np.array([dot.pixel for dot in dots])
    return DetectedMarkers(pixels, np.array([dot.std_px for dot in dots]), tuple(dots), seen.dark)


# the picture


def overlay(grey: NDArray[np.uint8], found: DetectedMarkers) -> NDArray[np.uint8]:
    """Return the part of a photograph about its markers, with their outlines, centres and numbers.

    The picture is blue, green, red (height, width, 3).
    """
    require_opencv()
    import cv2

    low, high = _part(grey, found)
    part = grey[low[1] : high[1], low[0] : high[0]]
    scale = max(1, int(np.ceil(WIDTH_PX / part.shape[1])))
    large = cv2.resize(part, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
    picture = cv2.cvtColor(large, cv2.COLOR_GRAY2BGR)
    # (0, 0) is the centre of a pixel in the photograph and in its enlarged part
    pixels = np.array([dot.pixel for dot in found.dots])
    points = np.asarray((pixels - low + 0.5) * scale - 0.5, dtype=np.float64)
    cv2.polylines(picture, [_fixed(points)], False, YELLOW, 1, cv2.LINE_AA, _FRACTION)
    normals, angle = _normals(points), np.linspace(0.0, 2 * np.pi, 60, endpoint=False)
    circle = np.array([np.cos(angle), np.sin(angle)])
    for number, (dot, point) in enumerate(zip(found.dots, points, strict=True), 1):
        outline = _fixed(point + scale * np.linalg.solve(dot.shape, circle).T)
        cv2.polylines(picture, [outline], True, GREEN, 1, cv2.LINE_AA, _FRACTION)
        # The number is beside the dot, outside the probe, on the outer side of its bend.
        far = 10 + scale * dot.diameter_px * 1.6
        text = tuple(round(float(c)) for c in point + far * normals[number - 1] - (6.0, -6.0))
        cv2.putText(picture, str(number), text, cv2.FONT_HERSHEY_SIMPLEX, 0.6, YELLOW, 1, cv2.LINE_AA)
    return np.asarray(picture, dtype=np.uint8)


def _part(grey: NDArray[np.uint8], found: DetectedMarkers) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the upper left and lower right corner of the drawn part."""
    margin = 0.12 * float(np.ptp(found.pixels, axis=0).max()) + 20.0
    size = np.array(grey.shape[::-1])
    low = np.clip(np.floor(found.pixels.min(axis=0) - margin), 0, size - 1).astype(np.int64)
    high = np.clip(np.ceil(found.pixels.max(axis=0) + margin), low + 1, size).astype(np.int64)
    return low, high


def _fixed(points: Array) -> NDArray[np.int32]:
    """Return points between pixels in OpenCV's fixed-point format."""
    return np.asarray(np.round(points * 2**_FRACTION), dtype=np.int32).reshape(-1, 1, 2)


def _normals(points: Array) -> Array:
    """Return unit vectors across the row, (m, 2)."""
    along = np.gradient(points, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    return np.column_stack([along[:, 1], -along[:, 0]])
