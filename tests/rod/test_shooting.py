"""Compare the compiled rod with shooting from the base: two formulations, two integrators, opposite directions."""

import numpy as np
import pytest
from rods import ALL_RODS, bending_force

from probedesign.core.errors import CheckFailedError
from tests.reference import shooting
from tests.reference.shooting import solve_by_shooting

G = 9.81
NONE = (0, 0, 0)
CASES = [
    # rod, gravity, way of the force, s_c/L, strength of its bending [rad], tip moment, couple at s_c [N·m]
    ("cone", (G, 0, 0), (1, 0, 0), 0.533, 0.3, NONE, NONE),
    ("cone", (G, 0, 0), (-1, 0.5, 0), 0.4, 1.0, NONE, NONE),
    ("cone", (3, 4, -8), (1, -2, 0.5), 0.133, 1.2, NONE, NONE),
    ("cone", (0, 0, G), (0, 1, 0.3), 1.0, 1.0, NONE, NONE),
    ("rooted", (G, 0, 0), (1, 1, -0.3), 0.266, 0.7, NONE, NONE),
    ("rooted", (0, -G, 0), (1, 0, 0), 0.8, 1.0, NONE, NONE),
    ("cylinder", (3, 4, -8), (1, 2, 3), 0.7, 0.5, NONE, NONE),
    ("cylinder", (0, 0, 0), (0, 0, 1), 1.0, 0.5, (1e-5, 2e-5, 3e-5), NONE),
    ("profile", (3, 4, -8), (1, -2, 0.6), 0.83, 0.3, NONE, NONE),
    ("profile", (3, 4, -8), (1, -2, 0.6), 7 / 12, 0.3, (1e-5, 2e-5, 3e-5), NONE),  # on a knot, twisted
    ("profile", (5, 5, 5), (-1, -1, 1), 0.2, 0.5, NONE, NONE),
    ("profile", (5, 5, 5), (-1, -1, 1), 0.02, 1e-3, NONE, NONE),  # on the rigid root
    ("cone", (3, 4, -8), (1, -2, 0.5), 0.6, 0.5, NONE, (2e-4, -1e-4, 3e-4)),
    ("profile", (3, 4, -8), (1, -2, 0.6), 7 / 12, 0.3, (1e-5, 2e-5, 3e-5), (-2e-4, 1e-4, 3e-4)),
    ("cylinder", NONE, (0, 0, 1), 1.0, 0.5, NONE, (1e-5, 2e-5, 3e-5)),  # at the tip itself
    ("yielding", (3, 4, -8), (1, -2, 0.6), 0.7, 0.8, NONE, NONE),
    ("yielding", (0, -G, 0), (1, 0, 0), 0.02, 0.01, NONE, NONE),
    ("finite", (3, 4, -8), (1, -2, 0.6), 0.7, 1.0, NONE, (2e-4, -1e-4, 3e-4)),
    ("finite", (0, 0, G), (0, 1, 0.3), 1.0, 1.0, NONE, NONE),
    ("hollow", (3, 4, -8), (1, -2, 0.6), 0.7, 0.8, NONE, NONE),
    ("elliptic", (3, 4, -8), (1, -2, 0.6), 0.7, 0.8, NONE, (1e-4, -1e-4, 2e-4)),
    ("elliptic", (G, 0, 0), (1, 1, -0.3), 0.4, 1.0, (1e-5, 2e-5, 3e-5), NONE),
    ("curved", (3, 4, -8), (1, -2, 0.6), 0.83, 0.5, NONE, NONE),
    ("curved", (0, 0, G), NONE, 1.0, 0.0, NONE, (1e-4, -1e-4, 2e-4)),
    ("everything", (3, 4, -8), (1, -2, 0.6), 0.3, 0.8, NONE, (1e-4, -1e-4, 2e-4)),
    ("everything", (G, 0, 0), (-1, 0.5, -0.3), 0.9, 0.5, (1e-5, 2e-5, 3e-5), NONE),
]


@pytest.mark.parametrize(("name", "gravity", "way", "fraction", "strength", "tip_moment", "couple"), CASES)
def test_both_formulations_agree(name, gravity, way, fraction, strength, tip_moment, couple):
    rod = ALL_RODS[name]
    s_c = fraction * rod.length
    force = bending_force(rod, s_c, strength) * np.array(way) / max(np.linalg.norm(way), 1.0)
    s = np.linspace(0.0, rod.length, 7)
    found = solve_by_shooting(rod, gravity, force, s_c, tip_moment, s, couple)
    eq = rod.solve(gravity, force, s_c, couple=couple, tip_moment=tip_moment, mode="reference")
    assert eq.result == "ok"
    # Both integrate to 1e-13 a step of some hundred and are led to 1e-12 at one end; the thin tip magnifies
    # an error at the base some ten times on the way out. Agreement measured: 1e-13 L, 4e-12, 1e-13.
    np.testing.assert_allclose(eq.p_at(s), found.p, atol=1e-11 * rod.length)
    np.testing.assert_allclose(eq.R_at(s), found.R, atol=1e-10)
    np.testing.assert_allclose(eq.n_at(s), found.n, atol=1e-12 * np.linalg.norm(found.n[0]))
    moment = np.linalg.norm(found.m, axis=1).max()
    np.testing.assert_allclose(eq.states_at(s)[:, 3:6], found.m, atol=1e-11 * moment)
    np.testing.assert_allclose(eq.wrench_base[3:], found.wrench_base[3:], atol=1e-11 * moment)


def test_unloaded_rod_is_straight():
    rod = ALL_RODS["profile"]
    found = solve_by_shooting(rod, (0, 0, 0), (0, 0, 0), 0.05)
    np.testing.assert_array_equal(found.p[:, :2], 0.0)
    np.testing.assert_allclose(found.p[:, 2], found.s, rtol=1e-14)
    assert found.misfit == 0.0


def test_shooting_fails_at_too_large_load_steps(monkeypatch):
    monkeypatch.setattr(shooting, "MIN_LOAD_STEP", 0.2)
    rod = ALL_RODS["cylinder"]
    # A quarter of this load turns the tip by more than the 0.6 rad that one step may.
    force = (bending_force(rod, rod.length, 10.0), 0, 0)
    with pytest.raises(CheckFailedError, match="reached 0 of the load only"):
        solve_by_shooting(rod, (0, 0, 0), force, rod.length)
