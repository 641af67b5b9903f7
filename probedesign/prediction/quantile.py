"""The distance that 95 % of a three-dimensional Gaussian error stays within."""

import numpy as np
from scipy.special import gammainc, ndtri

from probedesign.frames import Array

_NODES = 16
_BISECTIONS = 24  # of at most four standard deviations: 2e-7 of one
# u is at angle arccos c from the longest axis. Nodes squeezed towards c = 0 keep needle-like ellipsoids exact.
_X, _W = np.polynomial.legendre.leggauss(_NODES)
_C, _WEIGHT = ((_X + 1.0) / 2.0) ** 3, 1.5 * ((_X + 1.0) / 2.0) ** 2 * _W
_PHI = (np.arange(_NODES) + 0.5) * (np.pi / 2.0 / _NODES)


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
    across = eigenvalues[0] * np.cos(_PHI) ** 2 + eigenvalues[1] * np.sin(_PHI) ** 2
    spread = (_C[:, None] ** 2 * largest + (1.0 - _C[:, None] ** 2) * across) / largest
    half = 0.5 / np.maximum(spread, 1e-300)
    # At most the corner of the box that holds each of the three with a third of the rest.
    low, high = 0.0, float(np.sqrt(3.0) * -ndtri((1.0 - share) / 6.0))
    for _ in range(_BISECTIONS):
        middle = (low + high) / 2.0
        inside = gammainc(1.5, middle**2 * half).mean(axis=1) @ _WEIGHT
        low, high = (middle, high) if inside < share else (low, middle)
    return float(np.sqrt(largest) * (low + high) / 2.0)
