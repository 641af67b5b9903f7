"""One dot in a photograph: its centre to a fraction of a pixel, from the grey levels about it.

The picture is taken for an ellipse with an edge as soft as the lens makes it, bent round the probe, on a ground whose
grey varies smoothly. Least squares on the grey levels tell where the painted centre is, and how well it is known.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.special import erfc

from probedesign.frames import Array

FLOOR_PX = 0.06
"""What the fit errs by even in flat light, without noise and gloss [px, RMS an axis] (measured on synthetic photographs
of dots from 5 to 30 px: 0.04 to 0.09)."""
AROUND = 1.45
"""Radius of what is looked at, in radii of the dot: its ground, but not the probe's edge."""
SHADED_PX = 8.0
"""Diameter from which on the light across a dot is told apart from where it lies."""
STRAY = 0.25
"""A centre farther from where the spot was seen, in diameters and half a pixel more, is not that spot's."""
SMALL_PX, SMALL_STD_PX = 7.0, 0.4
"""A smaller dot has no outline to fit when the lens blurs it; the middle of its dark pixels is known to less than half
a pixel (measured on synthetic photographs)."""
LEAST_SOFT_PX = 0.1  # no pixel tells a sharper edge
SOFT_PX = 0.8  # a usual lens' blur, to start from
ROBUST = 3.0  # grey levels beyond which a pixel counts less: an edge, a speck
SUNK = 0.125
"""Standard deviation of a dot's radius over the probe's diameter, as known beforehand: at most a quarter
(docs/stereo.md), with the sign of the side that the dot is seen from."""
SINK, SOFT, GROUND, INK = 5, 6, slice(8, 14), slice(14, 16)  # among the fitted values


@dataclass(frozen=True)
class Dot:
    """A dot as it was fitted.

    Attributes:
        pixel: painted centre, on the probe's surface [px], (2,).
        std_px: standard deviation of a coordinate [px].
        shape: matrix M with |M (x - centre)| = 1 on its outline [1/px], symmetric, (2, 2).
    """

    pixel: Array
    std_px: float
    shape: Array

    @property
    def diameter_px(self) -> float:
        """Its largest."""
        return float(2 / np.linalg.eigvalsh(self.shape)[0])


def fit_dot(grey: NDArray[np.uint8], pixel: Array, diameter_px: float, along: Array) -> Dot | None:
    """Fit a dot.

    Args:
        grey: the photograph, (height, width).
        pixel: about its centre [px], (2,).
        diameter_px: about its diameter [px].
        along: way of the probe's axis in the picture, of any length, (2,).

    Returns:
        None if nothing there looks like a dot.
    """
    dot = _fitted(grey, pixel, np.eye(2) * 2 / diameter_px, along)
    # Again, with a window that has the shape of the dot instead of a circle.
    dot = None if dot is None else _fitted(grey, dot.pixel, dot.shape, along)
    if dot is None or np.linalg.norm(dot.pixel - pixel) > STRAY * diameter_px + 0.5:
        small = diameter_px < SMALL_PX
        return Dot(pixel, SMALL_STD_PX, np.eye(2) * 2 / diameter_px) if small else None
    return dot


def _fitted(grey: NDArray[np.uint8], pixel: Array, shape: Array, along: Array) -> Dot | None:
    """A dot fitted in a window about an ellipse."""
    offsets, levels = _window(grey, pixel, shape)
    start = _start(offsets, levels, shape)
    if start is None or len(levels) < len(start) + 10:
        return None
    sight, radius = _sight(shape, along), float(1 / np.sqrt(np.linalg.det(shape)))
    weight = ROBUST / SUNK

    def misfit(values: Array) -> Array:
        return np.append(_model(values, offsets, sight) - levels, weight * values[SINK])

    def by_values(values: Array) -> Array:
        return np.vstack([_by_values(values, offsets, sight), weight * np.eye(len(values))[SINK]])

    found = least_squares(
        misfit,
        start,
        by_values,
        loss="soft_l1",
        f_scale=ROBUST,
        x_scale=np.abs(start) + 0.1,
        xtol=1e-5,
        ftol=1e-6,
        max_nfev=60,
    )
    values = found.x
    fitted = np.array([[values[2], values[3]], [values[3], values[4]]])
    if not (np.linalg.eigvalsh(fitted) > 0).all() or np.hypot(*values[:2]) > radius:
        return None
    if not 0.5 < radius * np.sqrt(np.linalg.det(fitted)) < 2:
        return None
    std = _std(misfit(values), by_values(values), patch_of(misfit(values)[:-1], offsets))
    return Dot(pixel + values[:2], float(np.hypot(std, FLOOR_PX)), fitted)


def _std(misfit: Array, by_values: Array, patch: float) -> float:
    """Standard deviation of a coordinate of a fit by soft_l1 [px]: that of an M-estimate, H⁻¹ Jᵀ ψ² J H⁻¹ with
    H = Jᵀ ψ' J (Huber 1981), which needs no law of the noise, of as many observations as there are patches of pixels
    that err together."""
    n, k = by_values.shape
    share = 1 + (misfit / ROBUST) ** 2
    answer = np.linalg.pinv(by_values.T @ (by_values / share[:, None] ** 1.5))[:2] @ by_values.T
    seen = np.sum((answer * misfit / np.sqrt(share))[:, :-1] ** 2) / 2
    sink = ROBUST**2 * np.sum(answer[:, -1] ** 2) / 2  # as known beforehand, the last row
    return float(np.sqrt(seen * patch * n / max(n - k * patch, patch) + sink))


def patch_of(misfit: Array, offsets: Array) -> float:
    """How many pixels err together: the sum of the misfits' correlation over lags, out to where it has died away. What
    the model does not know, as a highlight, is common to neighbours, which are then not so many observations (Bartlett
    1935, of a series in time)."""
    places = np.round(offsets - offsets.min(axis=0)).astype(int)
    size = 2 * (places.max(axis=0) + 1)
    seen, there = np.zeros((2, *size))
    seen[tuple(places.T)], there[tuple(places.T)] = misfit, 1.0
    products, pairs = (np.fft.irfft2(np.abs(np.fft.rfft2(x)) ** 2, s=size) for x in (seen, there))
    correlation = products / np.maximum(pairs, 0.5) / np.mean(misfit**2)
    lag = np.hypot(*np.meshgrid(*(np.fft.fftfreq(n, 1 / n) for n in size), indexing="ij")).round().astype(int)
    by_lag = np.bincount(lag.ravel(), correlation.ravel()) / np.bincount(lag.ravel())
    end = int(np.argmax(by_lag <= 0)) if (by_lag <= 0).any() else len(by_lag)
    return max(float(correlation[lag < end].sum()), 1.0)


def _sight(shape: Array, along: Array) -> tuple[Array, Array]:
    """How a dot on a round probe is seen: what tells how far round the probe a place of it lies, in its radii [1/px],
    (2,), and what its centre would move by in the picture if it sank by its radius [px], (2,)."""
    axis = shape @ along
    around = np.array([-axis[1], axis[0]]) / np.linalg.norm(axis) @ shape
    (wide, narrow), ways = np.linalg.eigh(shape)
    return np.asarray(around), np.asarray(ways[:, 1] / wide * np.sqrt(1 - (wide / narrow) ** 2))


def _window(grey: NDArray[np.uint8], pixel: Array, shape: Array) -> tuple[Array, Array]:
    """Pixels about an ellipse, from its centre (n, 2), and their grey levels (n,)."""
    reach = AROUND / np.linalg.eigvalsh(shape)[0] + 1.5
    low = np.maximum(np.ceil(pixel - reach), 0).astype(int)
    high = np.minimum(np.floor(pixel + reach), np.array(grey.shape[::-1]) - 1).astype(int)
    v, u = np.mgrid[low[1] : high[1] + 1, low[0] : high[0] + 1]
    offsets = np.column_stack([u.ravel(), v.ravel()]) - pixel
    away = np.linalg.norm(offsets @ shape, axis=1)
    # A pixel and a half of ground at least, all around a dot however small.
    close = away <= np.maximum(AROUND, 1 + 1.5 * np.sqrt(np.linalg.det(shape)))
    return offsets[close], grey[v, u].ravel()[close].astype(float)


def _start(offsets: Array, levels: Array, shape: Array) -> Array | None:
    """Values to start from: centre, shape, softness, grey of the dot and of the ground, how the two vary."""
    away = np.linalg.norm(offsets @ shape, axis=1)
    inner, outer = levels[away < 0.5], levels[away > 1.2]
    if not len(inner) or not len(outer):
        return None
    large = 2 / np.sqrt(np.linalg.det(shape)) >= SHADED_PX
    values = [0.0, 0.0, shape[0, 0], shape[0, 1], shape[1, 1], 0.0, SOFT_PX]
    return np.array([*values, np.median(inner), np.median(outer), *(7 if large else 5) * [0.0]])


def _model(values: Array, offsets: Array, sight: tuple[Array, Array]) -> Array:
    """Grey levels of a dot with a soft edge on a smooth ground."""
    share = 0.5 * erfc(_beyond(values, offsets, sight)[0] / (np.sqrt(2) * _softness(values)))
    ground, inked = _greys(values, offsets)
    return np.asarray(ground + share * (inked - ground))


def _by_values(values: Array, offsets: Array, sight: tuple[Array, Array]) -> Array:
    """Derivatives of the grey levels by the values, (n, k); differences would cost the model k times."""
    soft = _softness(values)
    beyond, by_outline = _beyond(values, offsets, sight)
    share = 0.5 * erfc(beyond / (np.sqrt(2) * soft))
    ground, inked = _greys(values, offsets)
    by_beyond = (ground - inked) * np.exp(-0.5 * (beyond / soft) ** 2) / (np.sqrt(2 * np.pi) * soft)
    softer = -by_beyond * beyond / soft * np.sign(values[SOFT]) * (soft > LEAST_SOFT_PX)
    u, v = offsets.T
    rest = (1 - share)[:, None] * np.column_stack([np.ones_like(u), u, v, u * u, u * v, v * v])
    varies = share[:, None] * offsets[:, : 2 * (len(values) > INK.start)]
    return np.column_stack([by_beyond[:, None] * by_outline, softer, share, rest, varies])


def _softness(values: Array) -> float:
    return max(abs(float(values[SOFT])), LEAST_SOFT_PX)


def _greys(values: Array, offsets: Array) -> tuple[Array, Array]:
    """Of the ground and of the dot."""
    u, v = offsets.T
    c, d = values[GROUND], values[INK]
    ground = c[0] + c[1] * u + c[2] * v + c[3] * u * u + c[4] * u * v + c[5] * v * v
    inked = values[SOFT + 1] + (d[0] * u + d[1] * v if len(d) else np.zeros_like(u))
    return ground, inked


def _beyond(values: Array, offsets: Array, sight: tuple[Array, Array]) -> tuple[Array, Array]:
    """How far places lie beyond the outline, to first order [px], (n,), and its derivatives by centre, shape and sink,
    (n, 6). The outline is an ellipse whose places sink with the square of how far round the probe they lie."""
    around, down = sight
    away = offsets - values[:2]
    round_ = away @ around
    beyond, by_place, by_shape = _beyond_ellipse(
        values[2:5], away + (values[SINK] * round_**2)[:, None] * down
    )
    by_down = by_place @ down
    by_centre = -by_place - (2 * values[SINK] * round_ * by_down)[:, None] * around
    return beyond, np.column_stack([by_centre, by_shape, round_**2 * by_down])


def _beyond_ellipse(shape: Array, places: Array) -> tuple[Array, Array, Array]:
    """How far places lie beyond an ellipse about 0, to first order [px], (n,), and its derivatives by place (n, 2) and
    by shape (n, 3)."""
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
