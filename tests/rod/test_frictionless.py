"""Test the frictionless contact: the force is normal to the bent surface."""

import math

import numpy as np
import pytest
from rods import CONE, CYLINDER, ELLIPTIC, PROFILE, ROOTED_CONE, bending_force

from probedesign.rod.contact import solve_frictionless

GRAVITY = (9.81, 0.0, 0.0)
RODS = {"cone": CONE, "rooted": ROOTED_CONE, "cylinder": CYLINDER, "profile": PROFILE, "elliptic": ELLIPTIC}
STRENGTH = 0.4  #: Bending angle [rad]; at 0.6 the profile, pushed up at its tip against gravity, buckles sideways.
PLACES = [(0.2, 0.0), (0.5, 2.0), (0.8, -1.0), (1.0, math.pi)]


def pushed(rod, fraction, angle, strength=STRENGTH, mode="reference"):
    s = fraction * rod.length
    return solve_frictionless(rod, GRAVITY, s, angle, bending_force(rod, s, strength), mode)


def outward_normal(rod, s, angle, R):
    """Return the normal of the bent frustum at s, at an angle about its axis, tilted towards the tip."""
    alpha = math.atan(rod.taper_at(s) * math.hypot(math.cos(angle), rod.flatness * math.sin(angle)))
    out = math.cos(angle) * R[:, 0] + math.sin(angle) * R[:, 1]
    return math.cos(alpha) * out + math.sin(alpha) * R[:, 2]


@pytest.mark.parametrize("name", RODS)
@pytest.mark.parametrize(("fraction", "angle"), PLACES)
def test_the_push_is_against_the_surfaces_normal(name, fraction, angle):
    rod = RODS[name]
    touch = pushed(rod, fraction, angle)
    assert touch.result == "ok"
    s = fraction * rod.length
    normal = outward_normal(rod, s, angle + math.pi, touch.equilibrium.R_at(s))
    magnitude = np.linalg.norm(touch.force_base)
    # Newton stops at 1e-10; the last solve is as exact as reference mode.
    np.testing.assert_allclose(touch.force_base / magnitude, -normal, atol=1e-9)
    np.testing.assert_allclose(magnitude, bending_force(rod, s, STRENGTH), rtol=1e-9)


def test_the_push_leans_towards_the_base_and_on_a_cylinder_not_at_all():
    for rod, tan_alpha in ((CONE, 5.0 / 150.0), (CYLINDER, 0.0)):
        touch = pushed(rod, 0.5, 0.3)
        along = touch.equilibrium.R_at(0.5 * rod.length)[:, 2] @ touch.force_base
        across = math.sqrt(touch.force_base @ touch.force_base - along**2)
        assert along / across == pytest.approx(-tan_alpha, abs=1e-9)


def test_the_equilibrium_is_that_of_the_force_it_names():
    touch = pushed(PROFILE, 0.6, 1.0)
    eq = PROFILE.solve(GRAVITY, touch.force_base, 0.6 * PROFILE.length, mode="reference")
    # Both to reference accuracy, magnified by the thin tip; no torque about z comes of either.
    np.testing.assert_allclose(touch.equilibrium.wrench_base, eq.wrench_base, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(touch.equilibrium.p_base[-1], eq.p_base[-1], atol=1e-10 * PROFILE.length)


def test_fast_is_within_a_micrometre_of_reference():
    for name, rod in RODS.items():
        for fraction, angle in PLACES:
            fast, reference = pushed(rod, fraction, angle, mode="fast"), pushed(rod, fraction, angle)
            s = np.linspace(0.0, rod.length, 7)
            off = np.linalg.norm(fast.equilibrium.p_at(s) - reference.equilibrium.p_at(s), axis=1).max()
            assert off <= 1e-6, (name, fraction, angle)  # the documented accuracy of mode "fast"


@pytest.mark.parametrize("magnitude", [0.0, 1e-9])
def test_a_push_of_next_to_nothing_leaves_the_free_rod(magnitude):
    touch = solve_frictionless(CONE, GRAVITY, 0.1, 0.0, magnitude)
    assert touch.result == "ok"
    free = CONE.solve(GRAVITY)
    # 1e-9 N at 0.1 m bends by nanometres; both are fast.
    np.testing.assert_allclose(touch.equilibrium.p_base[-1], free.p_base[-1], atol=1e-6)


@pytest.mark.parametrize("magnitude", [1.0, 1e3, 1e9])
@pytest.mark.parametrize("fraction", [0.5, 1.0])
def test_a_push_that_the_rod_cannot_hold_gets_a_code_and_no_numbers(magnitude, fraction):
    touch = solve_frictionless(CONE, GRAVITY, fraction * CONE.length, 0.3, magnitude)
    assert touch.result in ("not_converged", "unstable")
    assert np.isnan(touch.force_base).all() and np.isnan(touch.p_surface_base).all()
