"""The compiled rod against the plain one: two formulations, two integrators, shot from opposite ends."""

import numpy as np
import pytest
from rods import RODS, bending_force

from probedesign.errors import CheckFailedError
from probedesign.rod import plain
from probedesign.rod.plain import solve_plain

G = 9.81
CASES = [
    # rod, gravity, way of the force, s_c/L, strength of its bending [rad], tip moment [N·m]
    ("cone", (G, 0, 0), (1, 0, 0), 0.533, 0.3, (0, 0, 0)),
    ("cone", (G, 0, 0), (-1, 0.5, 0), 0.4, 1.0, (0, 0, 0)),
    ("cone", (3, 4, -8), (1, -2, 0.5), 0.133, 1.2, (0, 0, 0)),
    ("cone", (0, 0, G), (0, 1, 0.3), 1.0, 1.0, (0, 0, 0)),
    ("rooted", (G, 0, 0), (1, 1, -0.3), 0.266, 0.7, (0, 0, 0)),
    ("rooted", (0, -G, 0), (1, 0, 0), 0.8, 1.0, (0, 0, 0)),
    ("cylinder", (3, 4, -8), (1, 2, 3), 0.7, 0.5, (0, 0, 0)),
    ("cylinder", (0, 0, 0), (0, 0, 1), 1.0, 0.5, (1e-5, 2e-5, 3e-5)),
    ("profile", (3, 4, -8), (1, -2, 0.6), 0.83, 0.3, (0, 0, 0)),
    ("profile", (3, 4, -8), (1, -2, 0.6), 7 / 12, 0.3, (1e-5, 2e-5, 3e-5)),  # on a knot, twisted
    ("profile", (5, 5, 5), (-1, -1, 1), 0.2, 0.5, (0, 0, 0)),
    ("profile", (5, 5, 5), (-1, -1, 1), 0.02, 1e-3, (0, 0, 0)),  # on the rigid root
]


@pytest.mark.parametrize(("name", "gravity", "way", "fraction", "strength", "tip_moment"), CASES)
def test_two_formulations_one_answer(name, gravity, way, fraction, strength, tip_moment):
    rod = RODS[name]
    s_c = fraction * rod.length
    force = bending_force(rod, s_c, strength) * np.array(way) / np.linalg.norm(way)
    s = np.linspace(0.0, rod.length, 7)
    found = solve_plain(rod, gravity, force, s_c, tip_moment, s)
    eq = rod.solve(gravity, force, s_c, tip_moment=tip_moment, mode="reference")
    assert eq.result == "ok"
    # Both integrate to 1e-13 a step of some hundred and are led to 1e-12 at one end; the thin tip magnifies
    # an error at the base some ten times on the way out. Agreement measured: 1e-13 L, 4e-12, 1e-13.
    np.testing.assert_allclose(eq.p_at(s), found.p, atol=1e-11 * rod.length)
    np.testing.assert_allclose(eq.R_at(s), found.R, atol=1e-10)
    np.testing.assert_allclose(eq.n_at(s), found.n, atol=1e-12 * np.linalg.norm(found.n[0]))
    moment = np.linalg.norm(found.m, axis=1).max()
    np.testing.assert_allclose(eq.states_at(s)[:, 3:6], found.m, atol=1e-11 * moment)
    np.testing.assert_allclose(eq.wrench_base[3:], found.wrench_base[3:], atol=1e-11 * moment)


def test_the_plain_rod_unloaded_is_straight():
    rod = RODS["profile"]
    found = solve_plain(rod, (0, 0, 0), (0, 0, 0), 0.05)
    np.testing.assert_array_equal(found.p[:, :2], 0.0)
    np.testing.assert_allclose(found.p[:, 2], found.s, rtol=1e-14)
    assert found.misfit == 0.0


def test_the_plain_rod_says_when_it_cannot_follow(monkeypatch):
    monkeypatch.setattr(plain, "LEAST_STEP", 0.2)
    rod = RODS["cylinder"]
    # A quarter of this load turns the tip by more than the 0.6 rad that one step may.
    force = (bending_force(rod, rod.length, 10.0), 0, 0)
    with pytest.raises(CheckFailedError, match="gave way at 0 of the load"):
        solve_plain(rod, (0, 0, 0), force, rod.length)
