"""Test rods that are not round, solid or straight: beam theory, shape at rest, and limits of round rods."""

from dataclasses import replace

import numpy as np
import pytest
from rods import CONE, CYLINDER, ELLIPTIC, EVERYTHING, FLAT, PROFILE, TUBE, bending_force, turned
from scipy.spatial.transform import Rotation

from probedesign.rod.rod import Rod

GRAVITY = np.array([3.0, 4.0, -8.0])
LOAD = (GRAVITY, bending_force(PROFILE, 0.07, 0.5) * np.array([1.0, 0.5, -0.3]), 0.07)
LITTLE = 1e-7  #: A force [N] that bends the cylinder by 1e-5: the square is left out of linear theory.


def deflections(rod, s_c):
    """Return the compliance of a cylinder at its contact along x and y in linear theory: s³/(3 E I) + s/(k G A)."""
    A, I_xx, I_yy = np.array(rod.factors[:3]) * np.pi * rod.radius[0] ** np.array([2, 4, 4]) / [1.0, 4.0, 4.0]
    shear = s_c / (rod.shear_coefficient * rod.shear_modulus * A)
    return s_c**3 / (3.0 * rod.youngs_modulus * np.array([I_yy, I_xx])) + shear


@pytest.mark.parametrize("factors", [FLAT, TUBE, (1.0, 1.0, 1.0, 1.0)], ids=["flat", "tube", "round"])
@pytest.mark.parametrize("fraction", [0.3, 1.0])
@pytest.mark.parametrize("angle", [0.0, 0.5, 1.2, 2.5])
def test_a_small_push_moves_each_way_by_its_own_stiffness(factors, fraction, angle):
    rod, way = (replace(CYLINDER, factors=factors, shear_coefficient=0.85), np.array([np.cos(angle), np.sin(angle)]))
    s_c = fraction * rod.length
    eq = rod.solve(force=LITTLE * np.array([*way, 0.0]), s_contact=s_c, mode="reference")
    wanted = deflections(rod, s_c) * way * LITTLE
    # (F L²/EI)² = 1e-8 at the flat one's most.
    np.testing.assert_allclose(eq.p_contact_base[:2], wanted, rtol=0.0, atol=1e-8 * np.linalg.norm(wanted))


def test_a_flat_rod_gives_way_towards_its_softer_side():
    """Also at large bending the rod leaves the plane of the force towards y, its thin direction."""
    eq = ELLIPTIC.solve(force=bending_force(ELLIPTIC, 0.1, 0.5) * np.array([1.0, 1.0, 0.0]), s_contact=0.1)
    x, y, _z = eq.p_contact_base
    assert y > 1.5 * x > 0.0


@pytest.mark.parametrize("factors", [FLAT, TUBE], ids=["flat", "tube"])
def test_a_small_couple_turns_each_way_by_its_own_stiffness(factors):
    rod = replace(CYLINDER, factors=factors)
    couple = 1e-9 * np.array([1.0, -2.0, 3.0])
    eq = rod.solve(couple=couple, s_contact=rod.length, mode="reference")
    I_round = np.pi / 4.0 * rod.radius[0] ** 4
    E, G = rod.youngs_modulus, rod.shear_modulus
    stiffness = I_round * np.array([E * rod.factors[1], E * rod.factors[2], 2.0 * G * rod.factors[3]])
    turn = Rotation.from_matrix(eq.R_base[-1]).as_rotvec()
    # Turns of 1e-5 rad: their products are left out, the tip agrees to 1e-12 of them.
    np.testing.assert_allclose(turn, couple * rod.length / stiffness, rtol=3e-5)


def test_a_load_turned_by_a_right_angle_turns_the_answer_if_the_section_turns_too():
    area, xx, yy, torsion = FLAT
    flat, upright = (replace(PROFILE, factors=f) for f in (FLAT, (area, yy, xx, torsion)))
    gravity, force, s_c = LOAD
    quarter = np.pi / 2.0
    one = flat.solve(gravity, force, s_c, mode="reference")
    other = upright.solve(turned(quarter, gravity), turned(quarter, force), s_c, mode="reference")
    s = np.linspace(0.0, PROFILE.length, 5)
    # Reference accuracy, 1e-12 in the tangent at the base; the thin tip magnifies it some ten times.
    np.testing.assert_allclose(
        other.p_at(s), [turned(quarter, p) for p in one.p_at(s)], rtol=0.0, atol=1e-11 * PROFILE.length
    )
    moment = one.wrench_base[3:]
    np.testing.assert_allclose(
        other.wrench_base[3:], turned(quarter, moment), rtol=0.0, atol=1e-11 * np.linalg.norm(moment)
    )


@pytest.mark.parametrize("angle", [0.4, -2.0])
def test_a_round_curved_rod_turned_about_its_axis_is_the_same_rod(angle):
    """Rotating curvature at rest and load together rotates the solution for any axes of the section."""
    rest = EVERYTHING.rest_curvature
    rod = replace(PROFILE, rest_curvature=rest)
    other = replace(PROFILE, rest_curvature=np.array([turned(angle, u) for u in rest]))
    gravity, force, s_c = LOAD
    one = rod.solve(gravity, force, s_c, mode="reference")
    two = other.solve(turned(angle, gravity), turned(angle, force), s_c, mode="reference")
    s = np.linspace(0.0, PROFILE.length, 5)
    np.testing.assert_allclose(
        two.p_at(s),
        [turned(angle, p) for p in one.p_at(s)],
        rtol=0.0,
        atol=1e-11 * PROFILE.length,  # as above
    )


@pytest.mark.parametrize("mode", ["fast", "reference"])
def test_no_curvature_and_no_flatness_are_the_round_rod_to_the_bit(mode):
    plain = PROFILE.solve(*LOAD, mode=mode, columns="all")
    other = replace(PROFILE, factors=(1.0, 1.0, 1.0, 1.0), rest_curvature=np.zeros((4, 3)))
    same = other.solve(*LOAD, mode=mode, columns="all")
    np.testing.assert_array_equal(same.nodes, plain.nodes)
    np.testing.assert_array_equal(same.wrench_base, plain.wrench_base)
    np.testing.assert_array_equal(same.sensitivity.d_wrench, plain.sensitivity.d_wrench)


@pytest.mark.parametrize(
    "almost", [{"factors": (1.0, 1.0, 1.0 + 1e-15, 1.0)}, {"rest_curvature": np.full((4, 3), 1e-14)}]
)
def test_hardly_flat_or_curved_is_the_round_rod(almost):
    """The solvers with and without section axes agree."""
    plain = PROFILE.solve(*LOAD, mode="reference", columns="all")
    other = replace(PROFILE, **almost).solve(*LOAD, mode="reference", columns="all")
    s = np.linspace(0.0, PROFILE.length, 9)
    np.testing.assert_allclose(other.p_at(s), plain.p_at(s), rtol=0.0, atol=1e-11 * PROFILE.length)  # as above
    np.testing.assert_allclose(other.R_at(s), plain.R_at(s), rtol=0.0, atol=1e-10)
    one, two = plain.sensitivity, other.sensitivity
    for a, b in ((one.d_wrench, two.d_wrench), (one.d_contact, two.d_contact)):
        # Derivatives of either are as good as its steps, 1e-13 each.
        np.testing.assert_allclose(b, a, rtol=0.0, atol=1e-10 * np.abs(a).max())
    for a, b in zip(plain.d_p_at(s), other.d_p_at(s), strict=True):
        np.testing.assert_allclose(b, a, rtol=0.0, atol=1e-10 * max(np.abs(a).max(), 1e-3))


def helix(u, s):
    """Return the centreline of an unloaded rod with constant curvature and twist, (j, 3), by summation."""
    k, z = np.linalg.norm(u), np.array([0.0, 0.0, 1.0])
    axis = u / k
    along = axis * axis[2]
    cosine, sine = np.sin(k * s) / k, (1.0 - np.cos(k * s)) / k  # their integrals
    return np.outer(s, along) + np.outer(cosine, z - along) + np.outer(sine, np.cross(axis, z))


SHAPES = {
    "arc": (0.0, 5.0, 0.0),
    "oblique arc": (-8.0, 3.0, 0.0),
    "twist": (0.0, 0.0, 10.0),
    "helix": (4.0, 3.0, 6.0),
    "most of a ring": (0.0, 30.0, 0.0),
    "a whole twist": (0.0, 0.0, 45.0),
    "winding helix": (20.0, 10.0, 40.0),
}


@pytest.mark.parametrize("mode", ["fast", "reference"])
@pytest.mark.parametrize("factors", [FLAT, (1.0, 1.0, 1.0, 1.0)], ids=["flat", "round"])
@pytest.mark.parametrize("curvature", SHAPES.values(), ids=SHAPES)
def test_unloaded_the_rod_has_the_shape_it_is_made_in(curvature, factors, mode):
    u = np.array(curvature)
    rod = replace(CONE, factors=factors, rigid_length=1e-3, rest_curvature=np.tile(u, (2, 1)))
    eq = rod.solve(mode=mode)
    assert eq.result == "ok"
    s = np.linspace(0.0, rod.length, 9)
    # The documented accuracy of "fast"; 1e-13 a step.
    atol = 1e-6 if mode == "fast" else 1e-12
    np.testing.assert_allclose(eq.p_at(s), helix(u, s), rtol=0.0, atol=atol)
    wanted = Rotation.from_rotvec(np.outer(s, u)).as_matrix()
    np.testing.assert_allclose(eq.R_at(s), wanted, rtol=0.0, atol=1e-5 if mode == "fast" else 1e-11)
    np.testing.assert_array_equal(eq.wrench_base, 0.0)
    assert eq.margin == pytest.approx(1.0, abs=1e-12)  # nothing pulls: the tip's turn is the base's


def test_arc_deflection_matches_castigliano():
    """A quarter of a ring of radius R pushed at its end along the clamp's axis, and out of its plane.

    The arms about the end are R cos φ, and R (1 - sin φ) for the twist, φ from the clamp: ∫cos² = π/4,
    ∫(1 - sin)² = 3π/4 - 2. Stretch and shear add theirs.
    """
    R, r, F, E, G = 0.08, 2e-3, 1e-7, 2e6, 0.7e6
    rest = np.tile([0.0, 1.0 / R, 0.0], (2, 1))
    rod = Rod(np.array([0.0, np.pi / 2.0 * R]), np.array([r, r]), E, G, 0.0, rest_curvature=rest)
    inertia, area = np.pi / 4.0 * r**4, np.pi * r**2

    def end(force):
        return rod.solve(force=force, mode="reference").p_base[-1]

    along = (end((0, 0, F)) - end((0, 0, -F)))[2] / 2.0
    sideways = (end((0, F, 0)) - end((0, -F, 0)))[1] / 2.0
    # F R²/(E I) = 3e-5 turns: its square is left out of the theory, what is even in F drops out of the difference.
    bent = R**2 * np.pi / 4.0 / (E * inertia)
    twisted = R**2 * (3.0 * np.pi / 4.0 - 2.0) / (2.0 * G * inertia)
    assert along == pytest.approx(F * R * (bent + np.pi / 4.0 * (1.0 / (E * area) + 1.0 / (G * area))), rel=1e-8)
    assert sideways == pytest.approx(F * R * (bent + twisted + np.pi / 2.0 / (G * area)), rel=1e-8)


@pytest.mark.parametrize("modulus", [0.2e6, 2e6])
@pytest.mark.parametrize("gravity", [(2.0, 0.5, -9.6), (5.0, 5.0, -6.0), (0.1, -9.0, 4.0)])
@pytest.mark.parametrize("factors", [(1.0, 1.0, 1.0, 1.0), FLAT], ids=["round", "flat"])
def test_a_thin_rod_that_hangs_over_is_stable(factors, gravity, modulus):
    """The rod hangs from the clamp, so it cannot buckle at any rotation of the tip."""
    rod = Rod(np.array([0.0, 0.15]), np.array([1e-3, 1e-3]), modulus, 0.33 * modulus, 1000.0, factors=factors)
    eq = rod.solve(gravity)
    assert eq.result == "ok" and eq.margin > 0.5
    assert eq.tip_tangent @ gravity > 0.99 * np.linalg.norm(gravity)


def test_a_couple_at_the_tip_is_the_tips_moment():
    couple = (1e-5, -2e-5, 3e-5)
    for rod in (CONE, EVERYTHING):
        one = rod.solve(GRAVITY, (0.01, 0, 0), couple=couple, mode="reference")
        two = rod.solve(GRAVITY, (0.01, 0, 0), tip_moment=couple, mode="reference")
        assert one.result == two.result == "ok"
        # Reached over other paths: what is left is Newton's own misfit, 1e-12 relative to the bend.
        np.testing.assert_allclose(one.wrench_base, two.wrench_base, rtol=1e-10)
        np.testing.assert_allclose(one.p_base[-1], two.p_base[-1], rtol=1e-10)
