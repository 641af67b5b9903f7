"""The distance that 95 % of a three-dimensional Gaussian error stays within."""

import math

import numpy as np
from scipy.special import chdtri, erf

from probedesign.frames import Array

_NODES = 16
_AT_ONCE = 512  # covariances: what fits into a cache
_HALLEY = 3  # steps, each of which trebles the digits
# u is at angle arccos c from the longest axis. Nodes squeezed towards c = 0 keep needle-like ellipsoids exact.
_X, _W = np.polynomial.legendre.leggauss(_NODES)
_PHI = (np.arange(_NODES // 2) + 0.5) * (np.pi / _NODES)
_C2 = np.repeat(((_X + 1.0) / 2.0) ** 6, len(_PHI))
_COS2 = np.tile(np.cos(_PHI) ** 2, _NODES)
_WEIGHT = np.repeat(1.5 * ((_X + 1.0) / 2.0) ** 2 * _W, len(_PHI)) / len(_PHI)


def radius_95(cov: Array, share: float = 0.95) -> float:
    """Radius r with P(|e| ≤ r) = share for e normal with zero mean and this covariance; see `radii_95`.

    Args:
        cov: [m²], (3, 3), positive semidefinite.
        share: in (0, 1).

    Returns:
        Radius [m]; NaN or infinite where the covariance is.
    """
    return float(radii_95(np.asarray(cov, dtype=float)[None], share)[0])


def radii_95(cov: Array, share: float = 0.95) -> Array:
    """Radii of many covariances.

    Writes e by its direction and length: |e|² = ρ² (uᵀ cov u) with ρ² chi-square of three degrees of
    freedom, independent of the direction u, which is uniform on the sphere; P is the mean over u of
    the chi-square distribution at r²/(uᵀ cov u), by Gauss-Legendre and the trapezoidal rule on one octant.
    Halley's method on r, from between those of a line, a disc and a ball.

    Args:
        cov: [m²], (n, 3, 3), each positive semidefinite.
        share: in (0, 1).

    Returns:
        Radii [m], (n,); NaN or infinite where a covariance is.
    """
    finite = np.asarray(np.isfinite(cov).all(axis=(1, 2)))
    radii = np.where(np.isnan(cov).any(axis=(1, 2)), np.nan, np.inf)
    eigenvalues = np.clip(np.linalg.eigvalsh(np.where(finite[:, None, None], cov, 0.0)), 0.0, None)
    radii[finite] = 0.0
    for first in range(0, len(cov), _AT_ONCE):
        part = np.arange(first, min(first + _AT_ONCE, len(cov)))
        part = part[eigenvalues[part, 2] > 0.0]
        radii[part] = np.sqrt(eigenvalues[part, 2]) * _of_largest(eigenvalues[part], share)
    return np.asarray(radii)


def _of_largest(eigenvalues: Array, share: float) -> Array:
    """Radii over the longest axis, (n,), of ascending eigenvalues (n, 3)."""
    low, middle = (eigenvalues[:, i, None] / eigenvalues[:, 2, None] for i in (0, 1))
    across = low * _COS2 + middle * (1.0 - _COS2)
    inverse = 1.0 / np.sqrt(np.maximum(_C2 + (1.0 - _C2) * across, 1e-300))
    line, disc, ball = (math.sqrt(float(chdtri(dof, 1.0 - share))) for dof in (1, 2, 3))
    r = (line**2 + (disc**2 - line**2) * middle + (ball**2 - disc**2) * low)[:, 0] ** 0.5
    for _ in range(_HALLEY):
        x = r[:, None] * inverse
        square = x * x
        bell = math.sqrt(2.0 / math.pi) * x * np.exp(-0.5 * square)
        slopes = bell * inverse
        off = (erf(x * math.sqrt(0.5)) - bell) @ _WEIGHT - share
        slope = (slopes * x) @ _WEIGHT
        bend = (slopes * inverse * (2.0 - square)) @ _WEIGHT
        r = r - 2.0 * off * slope / (2.0 * slope * slope - off * bend)
    return r
