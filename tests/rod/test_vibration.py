"""Compare the first natural frequency with closed forms."""

import math
from dataclasses import replace

import numpy as np
import pytest

from probedesign.rod.rod import Rod, natural_frequency


def cylinder(**changes):
    """Return Bernoulli's beam: the closed forms know no shear, which lowers this one's frequency by 0.15 %."""
    values = {"youngs_modulus": 2e6, "shear_modulus": 0.7e6, "density": 1000.0, "inextensible": True, **changes}
    return Rod(s=np.array([0.0, 0.1]), radius=np.array([0.003, 0.003]), **values)


def test_a_uniform_cantilever_has_the_frequency_of_the_textbook():
    rod = cylinder()
    # ω = 1.875104² √(E I / (ρ A L⁴)), I / A = r² / 4. Source: L. Meirovitch, Fundamentals of Vibrations, 2001, 8.5.
    exact = 1.8751040687**2 * math.sqrt(2e6 * 0.003**2 / 4.0 / 1000.0) / 0.1**2 / (2.0 * math.pi)
    assert natural_frequency(rod) == pytest.approx(exact, rel=2e-6)  # of quadrature at 16 places: 3e-7


def test_a_cone_has_the_frequency_of_kirchhoffs_solution():
    rod = Rod(np.array([0.0, 0.1]), np.array([0.003, 3e-6]), 2e6, 0.7e6, 1000.0, inextensible=True)
    # A full cone, ω = 8.7193 √(E I₀ / (ρ A₀ L⁴)). Source: G. Kirchhoff, Monatsberichte der Akademie Berlin, 1879.
    exact = 8.7193 * math.sqrt(2e6 * 0.003**2 / 4.0 / 1000.0) / 0.1**2 / (2.0 * math.pi)
    assert natural_frequency(rod) == pytest.approx(exact, rel=2e-3)  # a tip of a thousandth, not of zero


def test_weight_raises_the_frequency_hanging_and_lowers_it_upright_to_zero_at_buckling():
    rod = cylinder()
    free = natural_frequency(rod)
    assert natural_frequency(rod, (0.0, 0.0, 9.81)) > free > natural_frequency(rod, (0.0, 0.0, -9.81))
    # A. G. Greenhill 1881: an upright column buckles under its own weight at ρ A g L³ = 7.8373 E I.
    critical = 7.8373 * 2e6 * 0.003**2 / 4.0 / (1000.0 * 0.1**3)
    assert natural_frequency(rod, (0.0, 0.0, -0.999 * critical)) < 0.05 * free
    assert math.isnan(natural_frequency(rod, (0.0, 0.0, -1.001 * critical)))


def test_an_arc_swings_out_of_its_plane_as_a_polar_integral_says():
    """The flexibility of an arc across its plane, by Castigliano: ∫ (M² / E I + T² / G J) ds of unit forces; and a beam
    that is bent by a millionth is straight."""
    rod, n = cylinder(), 200
    assert natural_frequency(arc(rod, 1e-6)) == pytest.approx(natural_frequency(rod), rel=1e-9)
    angle, EI = 1.2, 2e6 * math.pi / 4.0 * 0.003**4
    GJ, R = 0.7 / 2.0 * 2.0 * EI, rod.length / angle
    at = (np.arange(n) + 0.5) / n * angle
    # A force at φ_i bends by M = -R sin(φ_i - φ) and twists by T = R (1 - cos(φ_i - φ)) at φ < φ_i.
    apart = at[:, None] - at
    M, T = (np.where(apart > 0.0, of, 0.0) for of in (R * np.sin(apart), R * (1.0 - np.cos(apart))))
    G = (M @ M.T / EI + T @ T.T / GJ) * rod.length / n
    mass = 1000.0 * math.pi * 0.003**2 * rod.length / n
    across = 1.0 / (2.0 * math.pi * math.sqrt(mass * np.linalg.eigvalsh(G)[-1]))
    assert natural_frequency(arc(rod, angle)) == pytest.approx(across, rel=1e-4)  # of the midpoints


def arc(rod, angle):
    return replace(rod, rest_curvature=np.tile([0.0, angle / rod.length, 0.0], (2, 1)))


def test_a_yielding_root_lowers_the_frequency_as_a_longer_rod_does():
    stiff, soft = (cylinder(rigid_length=x) for x in (2e-4, -2e-4))
    # f ∝ L⁻² in the limit of a short change at the root, where nearly all curvature is: 4 × 0.2 mm of 100 mm less mass.
    assert natural_frequency(stiff) > natural_frequency(cylinder()) > natural_frequency(soft)
