"""Test invariance under rotation and scaling, symmetry, and orthonormal frames."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rods import CONE, PROFILE, RODS, bending_force, turned

GRAVITY = np.array([3.0, 4.0, -8.0])


def sideways(rod, fraction=0.6, strength=0.8):
    """Return a force [N] that bends the rod considerably, and its place."""
    return bending_force(rod, fraction * rod.length, strength) * np.array([1.0, 0.5, -0.3]), fraction * rod.length


@settings(max_examples=20)
@given(st.floats(-np.pi, np.pi))
def test_a_load_turned_about_the_axis_turns_the_answer(angle):
    force, s_c = sideways(PROFILE)
    eq = PROFILE.solve(GRAVITY, force, s_c, mode="reference")
    turn = PROFILE.solve(turned(angle, GRAVITY), turned(angle, force), s_c, mode="reference")
    s = np.linspace(0.0, PROFILE.length, 5)
    # Reference accuracy, 1e-12 in the tangent at the base; the thin tip magnifies it some ten times.
    np.testing.assert_allclose(turn.p_at(s), [turned(angle, p) for p in eq.p_at(s)], atol=1e-11 * PROFILE.length)
    moment = eq.wrench_base[3:]
    np.testing.assert_allclose(turn.wrench_base[3:], turned(angle, moment), atol=1e-11 * np.linalg.norm(moment))


@pytest.mark.parametrize("k", [0.1, 3.0])
@pytest.mark.parametrize("e", [0.2, 50.0])
def test_dimensions(k, e):
    """Lengths by k and stiffness by e, forces by e k², gravity by e/k: the same shape, k times as large."""
    force, s_c = sideways(PROFILE)
    eq = PROFILE.solve(GRAVITY, force, s_c, mode="reference")
    other = replace(
        PROFILE,
        s=k * PROFILE.s,
        radius=k * PROFILE.radius,
        youngs_modulus=e * PROFILE.youngs_modulus,
        shear_modulus=e * PROFILE.shear_modulus,
        rigid_length=k * PROFILE.rigid_length,
    ).solve(e / k * GRAVITY, e * k**2 * force, k * s_c, mode="reference")
    s = np.linspace(0.0, PROFILE.length, 5)
    size = PROFILE.length
    np.testing.assert_allclose(other.p_at(k * s) / k, eq.p_at(s), atol=1e-11 * size)  # as above
    moment = eq.wrench_base[3:]
    np.testing.assert_allclose(other.wrench_base[3:] / (e * k**3), moment, atol=1e-11 * np.linalg.norm(moment))


def test_density_and_gravity_matter_only_as_their_product():
    force, s_c = sideways(CONE)
    eq = CONE.solve(GRAVITY, force, s_c, mode="reference")
    other = replace(CONE, density=4.0 * CONE.density).solve(GRAVITY / 4.0, force, s_c, mode="reference")
    np.testing.assert_allclose(other.wrench_base, eq.wrench_base, rtol=1e-12)  # rounding alone


@pytest.mark.parametrize("rod", RODS.values(), ids=RODS)
@pytest.mark.parametrize("angle", [0.0, 0.7])
def test_a_planar_load_keeps_the_rod_in_its_plane(rod, angle):
    force, s_c = sideways(rod)
    load = turned(angle, [9.81, 0, 2.0]), turned(angle, [force[0], 0.0, force[2]]), s_c
    eq = rod.solve(*load, mode="reference")
    across = turned(angle, [0.0, 1.0, 0.0])
    assert eq.result == "ok"
    # Nothing drives the rod out of the plane: rounding only.
    np.testing.assert_allclose(eq.p_base @ across, 0.0, atol=1e-14 * rod.length)
    np.testing.assert_allclose(eq.R_base[:, :, 2] @ across, 0.0, atol=1e-13)
    in_plane = eq.m_base - np.outer(eq.m_base @ across, across)
    np.testing.assert_allclose(in_plane, 0.0, atol=1e-13 * np.abs(eq.m_base).max())
    # Every section has turned about `across` alone; 1e-11 is what its x axis loses over the steps.
    np.testing.assert_allclose(eq.R_base @ across, np.tile(across, (len(eq.s), 1)), atol=1e-11)


@pytest.mark.parametrize("rod", RODS.values(), ids=RODS)
def test_a_mirrored_load_mirrors_the_rod(rod):
    force, s_c = sideways(rod)
    mirror = np.array([1.0, -1.0, 1.0])
    one = rod.solve(GRAVITY, force, s_c, mode="reference")
    other = rod.solve(mirror * GRAVITY, mirror * force, s_c, mode="reference")
    s = np.linspace(0.0, rod.length, 5)
    np.testing.assert_allclose(other.p_at(s), one.p_at(s) * mirror, atol=1e-11 * rod.length)  # as above


@pytest.mark.parametrize("rod", RODS.values(), ids=RODS)
def test_a_load_along_the_axis_only_stretches(rod):
    eq = rod.solve((0, 0, 9.81), (0, 0, 0.01), rod.length)
    assert np.abs(eq.p_base[:, :2]).max() == 0.0 and eq.p_base[-1, 2] > rod.length
    np.testing.assert_allclose(eq.R_base, np.tile(np.eye(3), (len(eq.s), 1, 1)), atol=1e-16)  # cos(π/2)


@pytest.mark.parametrize("mode", ["fast", "reference"])
@pytest.mark.parametrize("rod", RODS.values(), ids=RODS)
def test_frames_are_frames(rod, mode):
    force, s_c = sideways(rod)
    eq = rod.solve(GRAVITY, force, s_c, mode=mode)
    R = eq.R_at(np.linspace(0.0, rod.length, 21))
    # t and d are integrated without being put straight again: they lose of length and right angle what the
    # steps lose, 1e-7 and 1e-13 each; in the base the solve's own misfit is smaller.
    atol = 1e-5 if mode == "fast" else 1e-11
    np.testing.assert_allclose(np.einsum("kij,kil->kjl", R, R), np.tile(np.eye(3), (21, 1, 1)), atol=atol)
    np.testing.assert_allclose(np.linalg.det(R), 1.0, atol=atol)
    np.testing.assert_allclose(R[0], np.eye(3), atol=atol)
    np.testing.assert_array_equal(R[:, :, 2], eq.states_at(np.linspace(0.0, rod.length, 21))[:, 0:3])


@pytest.mark.parametrize("rod", RODS.values(), ids=RODS)
def test_no_torsion_without_a_moment_about_the_axis(rod):
    """A straight round rod loaded on its centreline has no twist, so its frames do not rotate about the axis."""
    force, s_c = sideways(rod)
    eq = rod.solve(GRAVITY, force, s_c, mode="reference")
    torsion = np.einsum("ki,ki->k", eq.m_base, eq.R_base[:, :, 2])
    # Exactly conserved by the equations: what is left is the integration's 1e-13 a step.
    assert np.abs(torsion).max() <= 1e-11 * np.abs(eq.m_base).max()
    h = 1e-5 * rod.length
    s = np.linspace(0.1, 0.9, 9) * rod.length
    turning = np.einsum("ki,ki->k", eq.R_at(s)[:, :, 1], eq.R_at(s + h)[:, :, 0] - eq.R_at(s - h)[:, :, 0])
    np.testing.assert_allclose(turning / (2 * h) * rod.length, 0.0, atol=1e-7)  # rounding 1e-13/1e-5 and h²


def test_an_inextensible_rod_keeps_its_length():
    force, s_c = sideways(CONE)
    eq = replace(CONE, inextensible=True).solve(GRAVITY, force, s_c, mode="reference")
    s = np.linspace(0.0, CONE.length, 401)
    step = np.linalg.norm(np.diff(eq.p_at(s), axis=0), axis=1)
    # A chord is shorter than its arc by h³κ²/24: κ L < 3 here, h = L/400.
    np.testing.assert_allclose(step, s[1], rtol=3.0**2 / 400**2 / 24)
