"""Covariance of a located touch, in plain numpy: the oracle of `probedesign/estimation/uncertainty_kernel.py`.

The reading of a touch y is w = h(y) + D m + ε with unit m and cov ε = R, its point x(y) + Q m, and the friction ratios
have the prior N(0, μ²) each. The estimate weights the reading by Σ = R + D Dᵀ and never solves for m:

    ŷ - y = K (D m + ε) + (prior's part),   K = C Hᵀ Σ⁻¹,   C = (Hᵀ Σ⁻¹ H + Π)⁻¹,   Π = diag(0, 0, 0, μ⁻², μ⁻²),
    x̂ - x = X (ŷ - y) - Q m.

With E[m mᵀ] = 1 and the ratios drawn from their prior, cov(ŷ - y) = C and cov(ŷ - y, m) = K D.
"""

import numpy as np

from probedesign.core.frames import Array


def reading_covariance(noise: Array, D: Array) -> Array:
    """Σ = R + D Dᵀ, (6, 6), of noise and drift R (6, 6) and error columns D (6, J)."""
    return noise + D @ D.T


def information(H: Array, sigma: Array, friction: float) -> Array:
    """Hᵀ Σ⁻¹ H + Π, (5, 5), of derivatives H (6, 5) and the prior standard deviation of the ratio."""
    prior = np.zeros(5)
    if np.isfinite(friction):
        prior[3:] = 1.0 / max(friction, 1e-4) ** 2
    return H.T @ np.linalg.solve(sigma, H) + np.diag(prior)


def inverse(A: Array) -> Array:
    """Of a symmetric matrix whose rows have different units, scaled to a unit diagonal first."""
    scale = np.sqrt(np.diag(A))
    return np.linalg.inv(A / np.outer(scale, scale)) / np.outer(scale, scale)


def point_covariance(H: Array, X: Array, D: Array, Q: Array, noise: Array, friction: float) -> Array:
    """cov(x̂ - x) to first order, (3, 3).

    Args:
        H, X: derivatives of wrench and point by the touch, (6, 5) and (3, 5).
        D, Q: one standard deviation of each error source as it moves them, (6, J) and (3, J).
        noise: covariance of the reading by noise and drift, (6, 6).
        friction: prior standard deviation of the ratio; inf: none.
    """
    sigma = reading_covariance(noise, D)
    C = inverse(information(H, sigma, friction))
    K = C @ H.T @ np.linalg.inv(sigma)
    cross = X @ K @ D @ Q.T
    return np.asarray(X @ C @ X.T + Q @ Q.T - cross - cross.T)
