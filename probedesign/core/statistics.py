"""Limits of test statistics, each named by the chance of a false decision, and functions of a covariance."""

import math
from functools import cache

import numpy as np
from scipy.special import chdtri

from probedesign.core.frames import Array

MISFIT_CHANCE = 1e-3  #: Chance that a true single contact, or true touches of one fixed point, are called inconsistent.
#: Chance that a free reading is called a contact, or stationary readings moving: one an hour at 7000/36 readings/s.
FALSE_ALARM = 1.4e-6
RIVAL_CHI2 = 9.0  #: Solutions whose misfit χ² lies within 3² of the best explain the readings about as well.
#: Standard deviation of a quantity somewhere in its range, over the range: a place known no better is not located.
UNIFORM_STD = 1.0 / math.sqrt(12.0)
UNIFORM_95 = 0.95  #: Length of its 95 % interval, over the range.
#: Standard deviations σ of the force below which a place is stated as an interval alone. s follows M/F: a measured
#: force of F + δ σ puts s outside 1.96 of its standard deviations, as they are then stated, if δ (1 + δ σ/F) > 1.96.
#: For that to happen once in twenty, δ = 1.645, F must be 8.6 σ; so that no lighter touch passes once in twenty
#: either, 1.645 are added.
NORMAL_FORCE = 10.25
#: What the far side of a place is that follows from a force of `NORMAL_FORCE`: growth of the misfit √3 standard
#: deviations away, over that of a normal error, and end of the 95 % interval in standard deviations.
NORMAL_GROWTH, NORMAL_95 = (1.0 + math.sqrt(3.0) / NORMAL_FORCE) ** -2, 1.96 / (1.0 - 1.96 / NORMAL_FORCE)


def is_normal(force_share: float, s: float, std_s: float) -> bool:
    """Return whether the error of a touched place is about normal.

    s is a moment over a force, with the skew of 1/F; but the place on a curved axis follows from the moments, whatever
    the force. Then it is known better than the force, and its own relative error counts.

    Args:
        force_share: standard deviation of the force over the force.
        s, std_s: arclength of the place and its standard deviation [m].
    """
    return NORMAL_FORCE * min(force_share, std_s / max(s, 1e-300)) < 1.0


@cache
def max_chi2(dof: int, chance: float) -> float:
    """Return the value that χ² with `dof` degrees of freedom exceeds with the given chance."""
    return float(chdtri(dof, chance))


def whiten(cov: Array) -> Array:
    """Return lower triangular W with Wᵀ W = cov⁻¹, of each covariance, (..., n, n)."""
    return np.linalg.inv(np.linalg.cholesky(cov))


def positive_part(A: Array) -> Array:
    """Return a symmetric matrix (n, n) without its directions of negative eigenvalues."""
    values, vectors = np.linalg.eigh(A)
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T)


def rms(cov: Array) -> float:
    """Return the RMS length of an error of zero mean with a covariance (n, n): the square root of its trace."""
    return math.sqrt(max(float(cov.trace()), 0.0))


def rms_each(cov: Array) -> Array:
    """Return `rms` of each covariance, (..., n, n)."""
    return np.asarray(np.sqrt(np.maximum(np.trace(cov, axis1=-2, axis2=-1), 0.0)))


def sigmas_95(dimensions: int) -> float:
    """Return the half-axes of a 95 % ellipse (2) or ellipsoid (3), √χ², in standard deviations."""
    return math.sqrt(max_chi2(dimensions, 0.05))


def ellipsoid_95(cov: Array) -> tuple[Array, Array]:
    """Return the region that contains 95 % of a normal error: an ellipse (n = 2) or an ellipsoid (n = 3).

    Args:
        cov: covariance of the error, (n, n).

    Returns:
        Half-axes in ascending order, (n,), and their directions as columns of a rotation, (n, n).
    """
    variances, axes = np.linalg.eigh(cov)
    if np.linalg.det(axes) < 0.0:
        axes[:, 0] = -axes[:, 0]
    return sigmas_95(len(cov)) * np.sqrt(np.maximum(variances, 0.0)), axes
