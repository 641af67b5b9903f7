"""First natural frequency of a rod that hangs free."""

import math

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import cho_solve_banded, cholesky_banded

from probedesign.rod.rod import Rod

_ELEMENTS = 160  #: Elements of equal length: the frequency of a uniform cantilever is within 1e-4 of the exact one.
#: Power iteration for the first mode. The second frequency of a beam is some times the first, its square ten times or
#: more, so that a few iterations suffice.
_MAX_ITERATIONS, _TOLERANCE = 200, 1e-9


def natural_frequency(rod: Rod, gravity: ArrayLike = (0.0, 0.0, 0.0)) -> float:
    """Return the first natural frequency of bending about the straight rod [Hz].

    The eigenvalue problem of ω² of the Euler–Bernoulli beam in the slopes θ at the ends of its elements: with the
    curvature D θ, the slope M θ and the deflection C θ in their middles,

        (Dᵀ E I / f D + Mᵀ T M) θ = ω² Cᵀ ρ A_s C θ,

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
    tension = float(np.asarray(gravity, dtype=float)[2]) * (np.cumsum(mass[::-1])[::-1] - mass / 2.0) * ds
    # The slope is 0 at the clamped end. K is tridiagonal: row 0 holds its diagonal, row 1 what is beside it.
    diagonal, beside = stiffness / ds + tension / 4.0, tension / 4.0 - stiffness / ds
    K = np.array([diagonal + np.append(diagonal[1:], 0.0), np.append(beside[1:], 0.0)])
    try:
        factor = cholesky_banded(K, lower=True)
    except np.linalg.LinAlgError:  # K is not positive definite: the weight buckles the rod
        return math.nan
    h = float(ds[0])
    slope, largest = np.ones(len(s)), 0.0
    for _ in range(_MAX_ITERATIONS):
        deflection = h * np.append(0.0, np.cumsum(slope)[:-1])
        force = mass * deflection
        slope = cho_solve_banded((factor, True), h * np.append(np.cumsum(force[:0:-1])[::-1], 0.0))
        before, largest = largest, float(np.abs(slope).max())  # of a vector whose largest entry was 1
        slope /= largest
        if abs(largest - before) < _TOLERANCE * largest:
            break
    return 1.0 / (2.0 * math.pi * math.sqrt(largest))
