"""First natural frequency of a rod that hangs free."""

import math

import numpy as np
from numpy.typing import ArrayLike

from probedesign.rod.rod import Rod

#: Places of Gauss–Legendre quadrature along the rod: the frequency of a uniform cantilever is within 1e-6 of the exact
#: one, those of the paper's cones within 1e-4.
_PLACES = 16


def natural_frequency(rod: Rod, gravity: ArrayLike = (0.0, 0.0, 0.0)) -> float:
    """Return the first natural frequency of small oscillations about the equilibrium under gravity [Hz].

    A force at s' moves the axis at s by the flexibility G(s, s'), (3, 3), the derivative of the equilibrium. The
    eigenvalue problem u(s) = ω² ∫ G(s, s') ρ A(s') u(s') ds' is solved by quadrature. Rotary inertia and damping are
    neglected.

    Args:
        rod: clamped at its base, straight or curved.
        gravity: in base axes [m/s²], (3,).

    Returns:
        The frequency; NaN where the weight buckles the rod.

    Source: L. M. Delves, J. L. Mohamed, Computational Methods for Integral Equations, 1985, 4 (Nyström's method).
    """
    x, weights = np.polynomial.legendre.leggauss(_PLACES)
    s = rod.length * (x + 1.0) / 2.0
    mass = rod.density * rod.factors[0] * np.pi * rod.radius_at(s) ** 2 * weights * rod.length / 2.0
    flexibility = np.empty((_PLACES, 3, _PLACES, 3))
    for j in range(_PLACES):
        rest = rod.solve(gravity, s_contact=float(s[j]), columns="contact")
        if not rest.ok:
            return math.nan
        flexibility[:, :, j] = rest.d_p_at(s)[:, :, :3]
    root = np.repeat(np.sqrt(mass), 3)
    largest = np.linalg.eigvalsh(root[:, None] * flexibility.reshape(3 * _PLACES, -1) * root)[-1]
    return 1.0 / (2.0 * math.pi * math.sqrt(largest))
