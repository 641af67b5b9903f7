"""Compare the first natural frequency with closed forms."""

import math

import numpy as np
import pytest

from probedesign.rod.rod import Rod
from probedesign.rod.vibration import natural_frequency


def cylinder(**changes):
    values = {"youngs_modulus": 2e6, "shear_modulus": 0.7e6, "density": 1000.0, **changes}
    return Rod(s=np.array([0.0, 0.1]), radius=np.array([0.003, 0.003]), **values)


def test_a_uniform_cantilever_has_the_frequency_of_the_textbook():
    rod = cylinder()
    # ω = 1.875104² √(E I / (ρ A L⁴)), I / A = r² / 4. Source: L. Meirovitch, Fundamentals of Vibrations, 2001, 8.5.
    exact = 1.8751040687**2 * math.sqrt(2e6 * 0.003**2 / 4.0 / 1000.0) / 0.1**2 / (2.0 * math.pi)
    # 160 elements: the error falls with their number squared and is 5e-5 here.
    assert natural_frequency(rod) == pytest.approx(exact, rel=2e-4)


def test_a_cone_has_the_frequency_of_kirchhoffs_solution():
    rod = Rod(np.array([0.0, 0.1]), np.array([0.003, 3e-6]), 2e6, 0.7e6, 1000.0)
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


def test_a_yielding_root_lowers_the_frequency_as_a_longer_rod_does():
    stiff, soft = (cylinder(rigid_length=x) for x in (2e-4, -2e-4))
    # f ∝ L⁻² in the limit of a short change at the root, where nearly all curvature is: 4 × 0.2 mm of 100 mm less mass.
    assert natural_frequency(stiff) > natural_frequency(cylinder()) > natural_frequency(soft)
