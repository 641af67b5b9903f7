"""First natural frequency of a rod that hangs free."""

import math

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import cho_factor, cho_solve

from probedesign.rod.rod import Rod

_ELEMENTS = 160
"""Elements of equal length: the frequency of a uniform cantilever is within 1e-4 of the exact one."""
_MAX_ITERATIONS, _TOLERANCE = 200, 1e-9
"""Power iteration for the first mode. The second frequency of a beam is some times the first, its square ten times or
more, so that a few iterations suffice."""


def natural_frequency(rod: Rod, gravity: ArrayLike = (0.0, 0.0, 0.0)) -> float:
    """Return the first natural frequency of bending about the straight rod [Hz].

    The eigenvalue problem of ω² of the Euler–Bernoulli beam in its curvatures κ: with the deflection w = A κ and the
    slope w' = B κ,

        (E I / f + Bᵀ T B) κ = ω² Aᵀ ρ A_s A κ,

    where f is the rod's root factor and T(s) the tension by the weight beyond s. Shear, rotary inertia, damping and
    the sag across the axis are neglected. The softer axis counts.

    Args:
        rod: clamped at its base.
        gravity: in base axes [m/s²], (3,); its component along z stretches or compresses the rod.

    Returns:
        The frequency; NaN where the weight buckles the straight rod.
    """
    ends = np.linspace(0.0, rod.length, _ELEMENTS + 1)
    s, ds = (ends[1:] + ends[:-1]) / 2.0, np.diff(ends)
    r = rod.radius_at(s)
    area, xx, yy, _ = rod.factors
    depth, reach = rod.root
    soft = np.ones_like(s) if reach <= 0.0 else 1.0 - depth * np.clip(1.0 - s / reach, 0.0, None) ** 3
    stiffness = rod.youngs_modulus * min(xx, yy) * np.pi / 4.0 * r**4 / soft
    mass = rod.density * area * np.pi * r**2 * ds
    slope = np.where(s[:, None] > s, ds, 0.0) + np.diag(ds / 2.0)
    beyond = np.cumsum(mass[::-1])[::-1] - mass / 2.0
    tension = float(np.asarray(gravity, dtype=float)[2]) * beyond * ds
    try:
        K = cho_factor(np.diag(stiffness * ds) + slope.T @ (tension[:, None] * slope), lower=True)
    except np.linalg.LinAlgError:  # K is not positive definite: the weight buckles the rod
        return math.nan
    arm = np.clip(s[:, None] - s, 0.0, None) * ds  # w at the middle of i by the curvature of j
    curvature, largest = np.ones(len(s)), 0.0
    for _ in range(_MAX_ITERATIONS):
        curvature = cho_solve(K, arm.T @ (mass * (arm @ curvature)))
        before, largest = largest, float(np.abs(curvature).max())  # of a vector whose largest entry was 1
        curvature /= largest
        if abs(largest - before) < _TOLERANCE * largest:
            break
    return 1.0 / (2.0 * math.pi * math.sqrt(largest))
