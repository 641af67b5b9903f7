"""One dot in a photograph: its centre to a fraction of a pixel, from the grey levels about it.

The picture is taken for an ellipse with an edge as soft as the lens makes it, on a ground whose grey varies smoothly.
Least squares on the grey levels tell the centre and how well it is known.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.special import erfc

from probedesign.frames import Array

FLOOR_PX = 0.12
"""What a dot that is no ellipse, on a probe that is round and shines, adds to a centre's standard deviation [px]
(measured on synthetic photographs)."""
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


@dataclass(frozen=True)
class Dot:
    """A dot as it was fitted.

    Attributes:
        pixel: centre [px], (2,).
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


def fit_dot(grey: NDArray[np.uint8], pixel: Array, diameter_px: float) -> Dot | None:
    """Fit a dot.

    Args:
        grey: the photograph, (height, width).
        pixel: about its centre [px], (2,).
        diameter_px: about its diameter [px].

    Returns:
        None if nothing there looks like a dot.
    """
    dot = _fitted(grey, pixel, np.eye(2) * 2 / diameter_px)
    # Again, with a window that has the shape of the dot instead of a circle.
    dot = None if dot is None else _fitted(grey, dot.pixel, dot.shape)
    if dot is None or np.linalg.norm(dot.pixel - pixel) > STRAY * diameter_px + 0.5:
        small = diameter_px < SMALL_PX
        return Dot(pixel, SMALL_STD_PX, np.eye(2) * 2 / diameter_px) if small else None
    return dot


def _fitted(grey: NDArray[np.uint8], pixel: Array, shape: Array) -> Dot | None:
    """A dot fitted in a window about an ellipse."""
    offsets, levels = _window(grey, pixel, shape)
    start = _start(offsets, levels, shape)
    if start is None or len(levels) < len(start) + 10:
        return None

    def misfit(values: Array) -> Array:
        return np.asarray(_model(values, offsets) - levels)

    def by_values(values: Array) -> Array:
        return _by_values(values, offsets)

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
    values, radius = found.x, float(1 / np.sqrt(np.linalg.det(shape)))
    fitted = np.array([[values[2], values[3]], [values[3], values[4]]])
    if not (np.linalg.eigvalsh(fitted) > 0).all() or np.hypot(*values[:2]) > radius:
        return None
    if not 0.5 < radius * np.sqrt(np.linalg.det(fitted)) < 2:
        return None
    rms = np.sqrt(np.mean(misfit(values) ** 2) * len(levels) / (len(levels) - len(values)))
    by_centre = np.linalg.pinv(np.asarray(found.jac, dtype=float))[:2]
    std = float(rms * np.sqrt(np.sum(by_centre**2) / 2))
    return Dot(pixel + values[:2], float(np.hypot(std, FLOOR_PX)), fitted)


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
    values = [0.0, 0.0, shape[0, 0], shape[0, 1], shape[1, 1], SOFT_PX]
    return np.array([*values, np.median(inner), np.median(outer), *(7 if large else 5) * [0.0]])


def _model(values: Array, offsets: Array) -> Array:
    """Grey levels of an ellipse with a soft edge on a smooth ground."""
    share = 0.5 * erfc(_beyond(values, offsets)[0] / (np.sqrt(2) * _softness(values)))
    ground, inked = _greys(values, offsets)
    return np.asarray(ground + share * (inked - ground))


def _by_values(values: Array, offsets: Array) -> Array:
    """Derivatives of the grey levels by the values, (n, k); differences would cost the model k times."""
    soft = _softness(values)
    beyond, by_ellipse = _beyond(values, offsets)
    share = 0.5 * erfc(beyond / (np.sqrt(2) * soft))
    ground, inked = _greys(values, offsets)
    by_beyond = (ground - inked) * np.exp(-0.5 * (beyond / soft) ** 2) / (np.sqrt(2 * np.pi) * soft)
    softer = -by_beyond * beyond / soft * np.sign(values[5]) * (soft > LEAST_SOFT_PX)
    u, v = offsets.T
    rest = (1 - share)[:, None] * np.column_stack([np.ones_like(u), u, v, u * u, u * v, v * v])
    varies = share[:, None] * offsets[:, : 2 * (len(values) > 13)]
    return np.column_stack([by_beyond[:, None] * by_ellipse, softer, share, rest, varies])


def _softness(values: Array) -> float:
    return max(abs(float(values[5])), LEAST_SOFT_PX)


def _greys(values: Array, offsets: Array) -> tuple[Array, Array]:
    """Of the ground and of the dot."""
    u, v = offsets.T
    c = values[7:13]
    ground = c[0] + c[1] * u + c[2] * v + c[3] * u * u + c[4] * u * v + c[5] * v * v
    inked = values[6] + (values[13] * u + values[14] * v if len(values) > 13 else np.zeros_like(u))
    return ground, inked


def _beyond(values: Array, offsets: Array) -> tuple[Array, Array]:
    """How far places lie beyond the outline, to first order [px], (n,), and its derivatives by centre and shape,
    (n, 5)."""
    a, b, c = values[2:5]
    x, y = (offsets - values[:2]).T
    p, q = a * x + b * y, b * x + c * y
    away = np.sqrt(p * p + q * q) + 1e-9
    g, h = a * p + b * q, b * p + c * q
    steep = np.hypot(g, h) + 1e-9
    beyond = (away - 1) * away / steep
    none = np.zeros_like(x)
    dp, dq = np.array([none - a, none - b, x, y, none]), np.array([none - b, none - c, none, x, y])
    dg = a * dp + b * dq + np.array([none, none, p, q, none])
    dh = b * dp + c * dq + np.array([none, none, none, p, q])
    by = ((2 * away - 1) * (p * dp + q * dq) / away - beyond * (g * dg + h * dh) / steep) / steep
    return beyond, by.T
