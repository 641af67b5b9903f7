"""Markers in a photograph: dots, the row of them along the probe from base to tip, and a picture to inspect them.

The model of a dot is an ellipse with a blurred edge, bent round the probe, on a ground whose grey varies smoothly.
Least squares on the grey levels estimate its centre and the standard deviation.
"""

import itertools
import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import approx_fprime, least_squares
from scipy.special import erfc

from probedesign.core.errors import InputError
from probedesign.core.files import write_atomically
from probedesign.core.frames import Array
from probedesign.vision import require_opencv

# dots: detected as round spots, then fitted to a fraction of a pixel

MIN_AREA_PX = 3.0  #: Smallest area within the outermost pixels' centres; a smaller spot has neither shape nor centre.
MAX_SIZE_FRACTION = 0.1  #: Largest diameter of a dot over the picture's height.
MIN_CONTRAST = 24.0  #: Contrast of a dot in grey levels of 255: four times the noise of a dim photograph (assumed).
GRAIN_PX = 0.8  #: Standard deviation of the smoothing before detection, as wide as a usual lens' blur.
MAX_SPOTS = 300  #: More spots are a texture.
#: Error of the fit in flat light, without noise and gloss [px, RMS per axis] (measured on synthetic photographs of dots
#: from 5 to 30 px: 0.04 to 0.09).
FLOOR_PX = 0.06
#: Radius of the fitted window, in radii of the dot: it includes the ground, but not the probe's edge.
WINDOW_RADII = 1.45
SHADED_PX = 8.0  #: Diameter from which on a light gradient across a dot can be separated from its position.
MAX_SHIFT = 0.25  #: Largest distance of a fitted centre from the detected spot, in diameters, plus half a pixel.
#: A smaller dot has no outline to fit when the lens blurs it; the centre of its dark pixels has an error of less than
#: half a pixel (measured on synthetic photographs).
SMALL_PX, SMALL_STD_PX = 7.0, 0.4
MIN_SOFT_PX = 0.1  # no pixel resolves a sharper edge
SOFT_PX = 0.8  # a usual lens' blur, to start from
ROBUST = 3.0  # grey levels beyond which a pixel has less weight: an edge, a speck
#: Prior standard deviation of a dot's radius over the probe's diameter: at most a quarter (docs/stereo.md), with the
#: sign of the side that the dot is seen from.
SUNK = 0.125
SINK, SOFT, GROUND, INK = 5, 6, slice(8, 14), slice(14, 16)  # among the fitted values


@dataclass(frozen=True)
class DetectedSpots:
    """Round spots of a photograph, darker or lighter than their surroundings."""

    pixels: Array  #: centres, to about half a pixel [px], (n, 2).
    diameter_px: Array  #: (n,).
    dark: bool  #: whether they are darker.


def detect_spots(grey: NDArray[np.uint8], dark: bool) -> DetectedSpots:
    """Return all round spots of a photograph, dots of the probe and others."""
    import cv2

    settings = cv2.SimpleBlobDetector.Params()
    settings.filterByColor, settings.blobColor = True, 0 if dark else 255
    settings.filterByArea, settings.minArea = True, MIN_AREA_PX
    settings.maxArea = float(np.pi / 4 * (MAX_SIZE_FRACTION * grey.shape[0]) ** 2)
    settings.filterByCircularity = False  # the perimeter of a few pixels is not meaningful
    settings.filterByInertia, settings.minInertiaRatio = True, 0.15  # a dot seen at 67° from its normal
    settings.filterByConvexity, settings.minConvexity = True, 0.8
    settings.thresholdStep, settings.minRepeatability = MIN_CONTRAST / 4, 4
    settings.minThreshold, settings.maxThreshold = 5, 250
    settings.minDistBetweenBlobs = 3
    # Unsmoothed grain has ten thousand outlines per threshold and takes nine tenths of the time.
    spots = cv2.SimpleBlobDetector.create(settings).detect(cv2.GaussianBlur(grey, (3, 3), GRAIN_PX))
    spots = sorted(spots, key=lambda spot: -spot.size)[:MAX_SPOTS]
    pixels = np.array([spot.pt for spot in spots], dtype=float).reshape(-1, 2)
    return DetectedSpots(pixels, np.array([spot.size for spot in spots], dtype=float), dark)


@dataclass(frozen=True)
class Dot:
    """A fitted dot."""

    pixel: Array  #: centre of the dot on the probe's surface [px], (2,).
    std_px: float  #: standard deviation of a coordinate [px].
    shape: Array  #: matrix M with |M (x - centre)| = 1 on its outline [1/px], symmetric, (2, 2).

    @property
    def diameter_px(self) -> float:
        """Its largest diameter [px]."""
        return float(2 / np.linalg.eigvalsh(self.shape)[0])


def fit_dot(grey: NDArray[np.uint8], pixel: Array, diameter_px: float, along: Array) -> Dot | None:
    """Fit a dot to the grey levels (height, width) about a spot; None if they do not fit one.

    Args:
        grey: the photograph.
        pixel: approximate centre [px], (2,).
        diameter_px: approximate diameter [px].
        along: direction of the probe's axis in the picture, of any length, (2,).
    """
    dot = _fitted(grey, pixel, np.eye(2) * 2 / diameter_px, along)
    # The second fit has a window of the dot's shape instead of a circle.
    dot = None if dot is None else _fitted(grey, dot.pixel, dot.shape, along)
    if dot is None or np.linalg.norm(dot.pixel - pixel) > MAX_SHIFT * diameter_px + 0.5:
        small = diameter_px < SMALL_PX
        return Dot(pixel, SMALL_STD_PX, np.eye(2) * 2 / diameter_px) if small else None
    return dot


def _fitted(grey: NDArray[np.uint8], pixel: Array, shape: Array, along: Array) -> Dot | None:
    """Fit a dot in a window about an ellipse; None if it does not converge to one."""
    offsets, levels = _window(grey, pixel, shape)
    start = _start(offsets, levels, shape)
    if start is None or len(levels) < len(start) + 10:
        return None
    # On a round probe: the vector whose product with an offset is its distance round the probe, in radii of the dot
    # [1/px], and the displacement of a point that sinks by the dot's radius [px].
    axis, ((wide, narrow), axes) = shape @ along, np.linalg.eigh(shape)
    around = np.array([-axis[1], axis[0]]) / np.linalg.norm(axis) @ shape
    view = around, axes[:, 1] / wide * np.sqrt(1 - (wide / narrow) ** 2)
    weight, radius = ROBUST / SUNK, float(1 / np.sqrt(np.linalg.det(shape)))

    def residual(values: Array) -> Array:
        return np.append(_model(values, offsets, view) - levels, weight * values[SINK])

    values = least_squares(residual, start, loss="soft_l1", f_scale=ROBUST, x_scale=np.abs(start) + 0.1, xtol=1e-5,
                           ftol=1e-6, max_nfev=60).x  # fmt: skip
    fitted = np.array([[values[2], values[3]], [values[3], values[4]]])
    if not (np.linalg.eigvalsh(fitted) > 0).all() or np.hypot(*values[:2]) > radius:
        return None
    if not 0.5 < radius * np.sqrt(np.linalg.det(fitted)) < 2:
        return None
    std = _std(residual(values), approx_fprime(values, residual), patch_of(residual(values)[:-1], offsets))
    return Dot(pixel + values[:2], float(np.hypot(std, FLOOR_PX)), fitted)


def _std(residual: Array, by_values: Array, patch: float) -> float:
    """Return the standard deviation of a coordinate of a fit by soft_l1 [px]: that of an M-estimate, H⁻¹ Jᵀ ψ² J H⁻¹
    with H = Jᵀ ψ' J (Huber 1981), for any noise, with one observation per patch of correlated pixels."""
    n, k = by_values.shape
    share = 1 + (residual / ROBUST) ** 2
    gain = np.linalg.pinv(by_values.T @ (by_values / share[:, None] ** 1.5))[:2] @ by_values.T
    seen = np.sum((gain * residual / np.sqrt(share))[:, :-1] ** 2) / 2
    sink = ROBUST**2 * np.sum(gain[:, -1] ** 2) / 2  # the prior, the last row
    return float(np.sqrt(seen * patch * n / max(n - k * patch, patch) + sink))


def patch_of(residual: Array, offsets: Array) -> float:
    """Return the number of pixels whose errors are correlated: the sum of the residuals' autocorrelation over lags, up
    to its first zero. Unmodelled effects, as a highlight, are common to neighbours, which are then fewer independent
    observations (Bartlett 1935, for time series)."""
    places = np.round(offsets - offsets.min(axis=0)).astype(int)
    size = 2 * (places.max(axis=0) + 1)
    seen, there = np.zeros((2, *size))
    seen[tuple(places.T)], there[tuple(places.T)] = residual, 1.0
    products, pairs = (np.fft.irfft2(np.abs(np.fft.rfft2(x)) ** 2, s=size) for x in (seen, there))
    correlation = products / np.maximum(pairs, 0.5) / np.mean(residual**2)
    lag = np.hypot(*np.meshgrid(*(np.fft.fftfreq(n, 1 / n) for n in size), indexing="ij")).round().astype(int)
    by_lag = np.bincount(lag.ravel(), correlation.ravel()) / np.bincount(lag.ravel())
    end = int(np.argmax(by_lag <= 0)) if (by_lag <= 0).any() else len(by_lag)
    return max(float(correlation[lag < end].sum()), 1.0)


def _window(grey: NDArray[np.uint8], pixel: Array, shape: Array) -> tuple[Array, Array]:
    """Return the pixels about an ellipse, from its centre (n, 2), and their grey levels (n,)."""
    reach = WINDOW_RADII / np.linalg.eigvalsh(shape)[0] + 1.5
    low = np.maximum(np.ceil(pixel - reach), 0).astype(int)
    high = np.minimum(np.floor(pixel + reach), np.array(grey.shape[::-1]) - 1).astype(int)
    v, u = np.mgrid[low[1] : high[1] + 1, low[0] : high[0] + 1]
    offsets = np.column_stack([u.ravel(), v.ravel()]) - pixel
    away = np.linalg.norm(offsets @ shape, axis=1)
    # Even a small dot needs a pixel and a half of ground all around.
    close = away <= np.maximum(WINDOW_RADII, 1 + 1.5 * np.sqrt(np.linalg.det(shape)))
    return offsets[close], grey[v, u].ravel()[close].astype(float)


def _start(offsets: Array, levels: Array, shape: Array) -> Array | None:
    """Return initial values: centre, shape, sink, softness, grey of the dot and of the ground, and their gradients."""
    away = np.linalg.norm(offsets @ shape, axis=1)
    inner, outer = levels[away < 0.5], levels[away > 1.2]
    if not len(inner) or not len(outer):
        return None
    large = 2 / np.sqrt(np.linalg.det(shape)) >= SHADED_PX
    values = [0.0, 0.0, shape[0, 0], shape[0, 1], shape[1, 1], 0.0, SOFT_PX]
    return np.array([*values, np.median(inner), np.median(outer), *(7 if large else 5) * [0.0]])


def _model(values: Array, offsets: Array, view: tuple[Array, Array]) -> Array:
    soft = max(abs(float(values[SOFT])), MIN_SOFT_PX)
    share = 0.5 * erfc(_outline_distance(values, offsets, view) / (np.sqrt(2) * soft))
    u, v = offsets.T
    c, d = values[GROUND], values[INK]
    ground = c[0] + c[1] * u + c[2] * v + c[3] * u * u + c[4] * u * v + c[5] * v * v
    inked = values[SOFT + 1] + (d[0] * u + d[1] * v if len(d) else np.zeros_like(u))
    return np.asarray(ground + share * (inked - ground))


def _outline_distance(values: Array, offsets: Array, view: tuple[Array, Array]) -> Array:
    """Return the distance of points beyond the outline, to first order [px], (n,). The outline is an ellipse whose
    points sink with the square of their distance round the probe."""
    around, down = view
    away = offsets - values[:2]
    sunk = away + (values[SINK] * (away @ around) ** 2)[:, None] * down
    shape = np.array([[values[2], values[3]], [values[3], values[4]]])
    seen = sunk @ shape
    size = np.linalg.norm(seen, axis=1) + 1e-9
    return np.asarray((size - 1) * size / (np.linalg.norm(seen @ shape, axis=1) + 1e-9))


# rows of dots

ImageSide = Literal["left", "right", "top", "bottom"]

#: Direction in the picture away from each of its sides.
AWAY = {"left": (1, 0), "right": (-1, 0), "top": (0, 1), "bottom": (0, -1)}

#: Largest change of the step from dot to dot, relative to its length: 35° of bending, or as much of foreshortening.
MAX_STEP_CHANGE = 0.6
MAX_GROWTH = 1.7  #: Largest ratio of the sizes of neighbouring dots.
NEXT = 0.35  #: Distance, in steps, within which a spot at the end of the row is one more dot.
NEIGHBOURS = 8  #: Nearest spots that may follow the first of a row.
BEAM = 400  #: Rows kept in each step of the search.
MAX_BYTES = 300_000_000  #: Size of a photograph (assumed).
GREEN, YELLOW = (80, 220, 60), (0, 220, 255)  # blue, green, red
WIDTH_PX = 1200  #: Minimum width of the drawn part of a photograph.
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
        return np.asarray(np.diff(self.s) / np.mean(np.diff(self.s)))

    def best(self) -> MarkerSequence:
        """Return the longest row with the least cost, at most as long as the dots; empty if there are no two spots."""
        rows, best = self._pairs(), MarkerSequence(())
        while rows:
            best = rows[0]
            if len(best.chosen) == len(self.s):
                break
            longer = itertools.chain.from_iterable(map(self._longer, rows))
            rows = sorted(longer, key=lambda row: row.cost)[:BEAM]
        return best

    def continues_beyond(self, row: MarkerSequence) -> bool:
        """Return whether one more dot follows the last, so that there are more dots than expected."""
        points = self.spots.pixels[list(row.chosen)]
        step = points[-1] - points[-2]
        near = np.linalg.norm(self.spots.pixels - (points[-1] + step), axis=1) < NEXT * np.linalg.norm(step)
        return bool(np.any(near & self._alike(row.chosen[-1])))

    def _pairs(self) -> list[MarkerSequence]:
        rows, pixels = [], self.spots.pixels
        for i, pixel in enumerate(pixels):
            alike = self._alike(i)
            nearest = np.argsort(np.where(alike, np.linalg.norm(pixels - pixel, axis=1), np.inf))
            for j in nearest[: NEIGHBOURS + 1]:
                if j != i and alike[j] and self._base_distance(pixel) < self._base_distance(pixels[j]):
                    cost = 0.0
                    if not isinstance(self.base, str):  # how far the row, extended to s = 0, misses the base
                        step = (pixels[j] - pixel) / self._steps[0]
                        extrapolated = pixel - step * self.s[0] / np.mean(np.diff(self.s))
                        cost = float(np.sum((extrapolated - self.base) ** 2) / np.sum(step**2))
                    rows.append(MarkerSequence((i, int(j)), cost))
        return sorted(rows, key=lambda row: row.cost)

    def _base_distance(self, pixel: Array) -> float:
        if isinstance(self.base, str):
            return float(np.dot(pixel, AWAY[self.base]))
        return float(np.linalg.norm(pixel - self.base))

    def _longer(self, row: MarkerSequence) -> list[MarkerSequence]:
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
    search, row = min(complete, key=lambda pair: pair[1].cost)
    if search.continues_beyond(row):
        raise InputError(
            f"{path}: more dots in a row than the {len(places)} expected (the markers' s_mm); cover spots that are not "
            "dots"
        )
    dots, spots = list[Dot](), search.spots
    directions = np.gradient(spots.pixels[list(row.chosen)], axis=0)
    for number, (i, direction) in enumerate(zip(row.chosen, directions, strict=True), 1):
        dot = fit_dot(grey, spots.pixels[i], float(spots.diameter_px[i]), direction)
        if dot is None:
            u, v = spots.pixels[i]
            raise InputError(f"{path}: dot {number} at u {u:.0f}, v {v:.0f} px is not a whole ellipse; it may be half "
                             "hidden or touch the probe's edge")  # fmt: skip
        dots.append(dot)
    pixels, std_px = np.array([dot.pixel for dot in dots]), np.array([dot.std_px for dot in dots])
    return DetectedMarkers(pixels, std_px, tuple(dots), spots.dark)


# the picture


def overlay(grey: NDArray[np.uint8], markers: DetectedMarkers) -> NDArray[np.uint8]:
    """Return the part of a photograph about its markers, with their outlines, centres and numbers.

    The picture is blue, green, red (height, width, 3).
    """
    require_opencv()
    import cv2

    margin = 0.12 * float(np.ptp(markers.pixels, axis=0).max()) + 20.0
    size = np.array(grey.shape[::-1])
    low = np.clip(np.floor(markers.pixels.min(axis=0) - margin), 0, size - 1).astype(np.int64)
    high = np.clip(np.ceil(markers.pixels.max(axis=0) + margin), low + 1, size).astype(np.int64)
    part = grey[low[1] : high[1], low[0] : high[0]]
    scale = max(1, int(np.ceil(WIDTH_PX / part.shape[1])))
    large = cv2.resize(part, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
    picture = cv2.cvtColor(large, cv2.COLOR_GRAY2BGR)
    # (0, 0) is the centre of a pixel in the photograph and in its enlarged part
    pixels = np.array([dot.pixel for dot in markers.dots])
    points = np.asarray((pixels - low + 0.5) * scale - 0.5, dtype=np.float64)
    cv2.polylines(picture, [_fixed(points)], False, YELLOW, 1, cv2.LINE_AA, _FRACTION)
    along, angle = np.gradient(points, axis=0), np.linspace(0.0, 2 * np.pi, 60, endpoint=False)
    normals = np.column_stack([along[:, 1], -along[:, 0]]) / np.linalg.norm(along, axis=1, keepdims=True)
    circle = np.array([np.cos(angle), np.sin(angle)])
    for number, (dot, point) in enumerate(zip(markers.dots, points, strict=True), 1):
        outline = _fixed(point + scale * np.linalg.solve(dot.shape, circle).T)
        cv2.polylines(picture, [outline], True, GREEN, 1, cv2.LINE_AA, _FRACTION)
        # The number is beside the dot, outside the probe, on the outer side of its bend.
        far = 10 + scale * dot.diameter_px * 1.6
        text = tuple(round(float(c)) for c in point + far * normals[number - 1] - (6.0, -6.0))
        cv2.putText(picture, str(number), text, cv2.FONT_HERSHEY_SIMPLEX, 0.6, YELLOW, 1, cv2.LINE_AA)
    return np.asarray(picture, dtype=np.uint8)


def _fixed(points: Array) -> NDArray[np.int32]:
    return np.asarray(np.round(points * 2**_FRACTION), dtype=np.int32).reshape(-1, 1, 2)
