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

FLOOR_PX = 0.1
"""What a dot that is no ellipse, on a probe that is round and shines, adds to a centre's standard deviation [px]
(measured on synthetic photographs)."""
AROUND = 1.45
"""Radius of what is looked at, in radii of the dot: its ground, but not the probe's edge."""
SOFT_PX = 0.8  # a usual lens' blur, to start from
ROBUST = 3.0  # grey levels beyond which a pixel counts less: an edge, a speck


@dataclass(frozen=True)
class Dot:
    """A dot as it was fitted.

    Attributes:
        pixel: centre [px], (2,).
        std_px: standard deviation of a coordinate [px].
        shape: matrix M with |M (x - centre)| = 1 on its outline [1/px], symmetric, (2, 2).
        contrast: of dot and ground, grey levels of 255.
    """

    pixel: Array
    std_px: float
    shape: Array
    contrast: float

    @property
    def diameter_px(self) -> float:
        """Its largest."""
        return float(2 / np.linalg.eigvalsh(self.shape)[0])

    @property
    def flatness(self) -> float:
        """Smallest diameter over the largest."""
        least, most = np.linalg.eigvalsh(self.shape)
        return float(least / most)


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
    return None if dot is None else _fitted(grey, dot.pixel, dot.shape)


def _fitted(grey: NDArray[np.uint8], pixel: Array, shape: Array) -> Dot | None:
    """A dot fitted in a window about an ellipse."""
    offsets, levels = _window(grey, pixel, shape)
    start = _start(offsets, levels, shape)
    if start is None or len(levels) < len(start) + 10:
        return None

    def misfit(values: Array) -> Array:
        return np.asarray(_model(values, offsets) - levels)

    found = least_squares(
        misfit,
        start,
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
    contrast = float(abs(values[6] - values[7]))
    return Dot(pixel + values[:2], float(np.hypot(std, FLOOR_PX)), fitted, contrast)


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
    """Values to start from: centre, shape, softness, the dot's grey, the ground's and how it varies."""
    away = np.linalg.norm(offsets @ shape, axis=1)
    inner, outer = levels[away < 0.5], levels[away > 1.2]
    if not len(inner) or not len(outer):
        return None
    values = [0.0, 0.0, shape[0, 0], shape[0, 1], shape[1, 1], SOFT_PX]
    return np.array([*values, np.median(inner), np.median(outer), *5 * [0.0]])


def _model(values: Array, offsets: Array) -> Array:
    """Grey levels of an ellipse with a soft edge on a smooth ground."""
    x, y = (offsets - values[:2]).T
    a, b, c = values[2:5]
    p, q = a * x + b * y, b * x + c * y
    away = np.sqrt(p * p + q * q) + 1e-9
    steep = np.hypot(a * p + b * q, b * p + c * q) / away + 1e-9
    share = 0.5 * erfc((away - 1) / steep / (np.sqrt(2) * max(abs(values[5]), 0.1)))
    u, v = offsets.T
    ground = (
        values[7]
        + values[8] * u
        + values[9] * v
        + values[10] * u * u
        + values[11] * u * v
        + values[12] * v * v
    )
    return np.asarray(ground + share * (values[6] - ground))
