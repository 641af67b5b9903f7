"""Limits of test statistics, each named by the chance of a false decision, and whitening."""

import math
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

MISFIT_CHANCE = 1e-3
"""Chance that a true single contact, or true touches of one fixed point, are called inconsistent."""
FALSE_ALARM = 1.4e-6
"""Chance that a free reading is called a contact, or stationary readings moving: one an hour at 7000/36 readings/s."""
RIVAL_CHI2 = 9.0
"""Solutions whose misfit χ² lies within 3² of the best explain the readings about as well."""
UNIFORM_STD = 1.0 / math.sqrt(12.0)
"""Standard deviation of a quantity somewhere in its range, over the range: a place known no better is not located."""


@cache
def max_chi2(dof: int, chance: float) -> float:
    """Return the value that χ² with `dof` degrees of freedom exceeds with the given chance."""
    return float(chdtri(dof, chance))


def whiten(cov: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return lower triangular W with Wᵀ W = cov⁻¹, of each covariance, (..., n, n)."""
    return np.linalg.inv(np.linalg.cholesky(cov))
