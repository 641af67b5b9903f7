"""The distance that 95 % of a three-dimensional Gaussian error stays within."""

import numpy as np
from scipy.special import gammainc, ndtri

from probedesign.frames import Array

_NODES = 24


def radius_95(cov: Array, share: float = 0.95) -> float:
    """Radius r with P(|e| ≤ r) = share for e normal with zero mean and this covariance.

    Writes e by its direction and length: |e|² = ρ² (uᵀ cov u) with ρ² chi-square of three degrees of
    freedom, independent of the direction u, which is uniform on the sphere; P is the mean over u of
    the chi-square distribution at r²/(uᵀ cov u), by Gauss-Legendre and the trapezoidal rule on one octant.

    Args:
        cov: [m²], (3, 3), positive semidefinite.
        share: in (0, 1).

    Returns:
        Radius [m]; NaN or infinite where the covariance is.
    """
    if not np.isfinite(cov).all():
        return float("nan" if np.isnan(cov).any() else "inf")
    eigenvalues = np.sort(np.clip(np.linalg.eigvalsh(cov), 0.0, None))
    largest = float(eigenvalues[2])
    if largest == 0.0:
        return 0.0
    x, w = np.polynomial.legendre.leggauss(_NODES)
    # u = (cos c along the largest axis); squeezing nodes to c → 0 keeps needle-like ellipsoids exact.
    c, weight = ((x + 1.0) / 2.0) ** 3, 3.0 * ((x + 1.0) / 2.0) ** 2 * w / 2.0
    phi = (np.arange(_NODES) + 0.5) * (np.pi / 2.0 / _NODES)
    across = eigenvalues[0] * np.cos(phi) ** 2 + eigenvalues[1] * np.sin(phi) ** 2
    spread = (c[:, None] ** 2 * largest + (1.0 - c[:, None] ** 2) * across) / largest
    low, high = 0.0, 4.0 * float(-ndtri((1.0 - share) / 2.0))
    for _ in range(60):
        middle = (low + high) / 2.0
        inside = gammainc(1.5, 0.5 * middle**2 / np.maximum(spread, 1e-300)).mean(axis=1) @ weight
        low, high = (middle, high) if inside < share else (low, middle)
    return float(np.sqrt(largest) * (low + high) / 2.0)
