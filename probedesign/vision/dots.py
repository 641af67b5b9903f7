"""Dots in a photograph: detected as round spots, then fitted to a fraction of a pixel.

The model of a dot is an ellipse with a blurred edge, bent round the probe, on a ground whose grey varies smoothly.
Least squares on the grey levels estimate its centre and the standard deviation.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.special import erfc

from probedesign.core.frames import Array

MIN_AREA_PX = 3.0
"""Smallest area within the outermost pixels' centres; a smaller spot has neither shape nor centre."""
MAX_SIZE_FRACTION = 0.1
"""Largest diameter of a dot over the picture's height."""
MIN_CONTRAST = 24.0
"""Contrast of a dot in grey levels of 255: four times the noise of a dim photograph (assumed)."""
GRAIN_PX = 0.8
"""Standard deviation of the smoothing before detection, as wide as a usual lens' blur."""
MAX_SPOTS = 300
"""More spots are a texture."""
FLOOR_PX = 0.06
"""Error of the fit in flat light, without noise and gloss [px, RMS per axis] (measured on synthetic photographs of dots
from 5 to 30 px: 0.04 to 0.09)."""
WINDOW_RADII = 1.45
"""Radius of the fitted window, in radii of the dot: it includes the ground, but not the probe's edge."""
SHADED_PX = 8.0
"""Diameter from which on a light gradient across a dot can be separated from its position."""
MAX_SHIFT = 0.25
"""Largest distance of a fitted centre from the detected spot, in diameters, plus half a pixel."""
SMALL_PX, SMALL_STD_PX = 7.0, 0.4
"""A smaller dot has no outline to fit when the lens blurs it; the centre of its dark pixels has an error of less than
half a pixel (measured on synthetic photographs)."""
MIN_SOFT_PX = 0.1  # no pixel resolves a sharper edge
SOFT_PX = 0.8  # a usual lens' blur, to start from
ROBUST = 3.0  # grey levels beyond which a pixel has less weight: an edge, a speck
SUNK = 0.125
"""Prior standard deviation of a dot's radius over the probe's diameter: at most a quarter (docs/stereo.md), with the
sign of the side that the dot is seen from."""
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
    found = cv2.SimpleBlobDetector.create(settings).detect(cv2.GaussianBlur(grey, (3, 3), GRAIN_PX))
    found = sorted(found, key=lambda spot: -spot.size)[:MAX_SPOTS]
    pixels = np.array([spot.pt for spot in found], dtype=float).reshape(-1, 2)
    return DetectedSpots(pixels, np.array([spot.size for spot in found], dtype=float), dark)


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
    view, radius = _view(shape, along), float(1 / np.sqrt(np.linalg.det(shape)))
    weight = ROBUST / SUNK

    def residual(values: Array) -> Array:
        """Return the grey levels' residuals and the prior's."""
        return np.append(_model(values, offsets, view) - levels, weight * values[SINK])

    def by_values(values: Array) -> Array:
        """Return the derivatives of the residuals."""
        return np.vstack([_by_values(values, offsets, view), weight * np.eye(len(values))[SINK]])

    found = least_squares(residual, start, by_values, loss="soft_l1", f_scale=ROBUST, x_scale=np.abs(start) + 0.1,
                          xtol=1e-5, ftol=1e-6, max_nfev=60)  # fmt: skip
    values = found.x
    fitted = np.array([[values[2], values[3]], [values[3], values[4]]])
    if not (np.linalg.eigvalsh(fitted) > 0).all() or np.hypot(*values[:2]) > radius:
        return None
    if not 0.5 < radius * np.sqrt(np.linalg.det(fitted)) < 2:
        return None
    std = _std(residual(values), by_values(values), patch_of(residual(values)[:-1], offsets))
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


def _view(shape: Array, along: Array) -> tuple[Array, Array]:
    """Return the view of a dot on a round probe: the vector whose product with an offset is its distance round the
    probe, in radii of the dot [1/px], (2,), and the displacement of a point that sinks by the dot's radius
    [px], (2,)."""
    axis = shape @ along
    around = np.array([-axis[1], axis[0]]) / np.linalg.norm(axis) @ shape
    (wide, narrow), ways = np.linalg.eigh(shape)
    return np.asarray(around), np.asarray(ways[:, 1] / wide * np.sqrt(1 - (wide / narrow) ** 2))


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
    """Return the grey levels of a dot with a soft edge on a smooth ground."""
    share = 0.5 * erfc(_outline_distance(values, offsets, view)[0] / (np.sqrt(2) * _softness(values)))
    ground, inked = _greys(values, offsets)
    return np.asarray(ground + share * (inked - ground))


def _by_values(values: Array, offsets: Array, view: tuple[Array, Array]) -> Array:
    """Return derivatives of the grey levels by the values, (n, k); differences would cost k times the model."""
    soft = _softness(values)
    beyond, by_outline = _outline_distance(values, offsets, view)
    share = 0.5 * erfc(beyond / (np.sqrt(2) * soft))
    ground, inked = _greys(values, offsets)
    by_beyond = (ground - inked) * np.exp(-0.5 * (beyond / soft) ** 2) / (np.sqrt(2 * np.pi) * soft)
    softer = -by_beyond * beyond / soft * np.sign(values[SOFT]) * (soft > MIN_SOFT_PX)
    u, v = offsets.T
    rest = (1 - share)[:, None] * np.column_stack([np.ones_like(u), u, v, u * u, u * v, v * v])
    varies = share[:, None] * offsets[:, : 2 * (len(values) > INK.start)]
    return np.column_stack([by_beyond[:, None] * by_outline, softer, share, rest, varies])


def _softness(values: Array) -> float:
    return max(abs(float(values[SOFT])), MIN_SOFT_PX)


def _greys(values: Array, offsets: Array) -> tuple[Array, Array]:
    """Return the grey levels of the ground and of the dot."""
    u, v = offsets.T
    c, d = values[GROUND], values[INK]
    ground = c[0] + c[1] * u + c[2] * v + c[3] * u * u + c[4] * u * v + c[5] * v * v
    inked = values[SOFT + 1] + (d[0] * u + d[1] * v if len(d) else np.zeros_like(u))
    return ground, inked


def _outline_distance(values: Array, offsets: Array, view: tuple[Array, Array]) -> tuple[Array, Array]:
    """Return the distance of points beyond the outline, to first order [px], (n,), and its derivatives by centre, shape
    and sink, (n, 6). The outline is an ellipse whose points sink with the square of their distance round the probe."""
    around, down = view
    away = offsets - values[:2]
    round_ = away @ around
    sunk = away + (values[SINK] * round_**2)[:, None] * down
    beyond, by_place, by_shape = _ellipse_distance(values[2:5], sunk)
    by_down = by_place @ down
    by_centre = -by_place - (2 * values[SINK] * round_ * by_down)[:, None] * around
    return beyond, np.column_stack([by_centre, by_shape, round_**2 * by_down])


def _ellipse_distance(shape: Array, places: Array) -> tuple[Array, Array, Array]:
    """Return the distance of points beyond an ellipse about 0, to first order [px], (n,), and its derivatives by point
    (n, 2) and by shape (n, 3)."""
    a, b, c = shape
    x, y = places.T
    p, q = a * x + b * y, b * x + c * y
    away = np.sqrt(p * p + q * q) + 1e-9
    g, h = a * p + b * q, b * p + c * q
    steep = np.hypot(g, h) + 1e-9
    beyond = (away - 1) * away / steep
    none = np.zeros_like(x)
    dp, dq = np.array([none + a, none + b, x, y, none]), np.array([none + b, none + c, none, x, y])
    dg = a * dp + b * dq + np.array([none, none, p, q, none])
    dh = b * dp + c * dq + np.array([none, none, none, p, q])
    by = ((2 * away - 1) * (p * dp + q * dq) / away - beyond * (g * dg + h * dh) / steep) / steep
    return beyond, by[:2].T, by[2:].T
