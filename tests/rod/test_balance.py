"""Test the equilibrium equations between nodes and of the whole rod about its base."""

from dataclasses import replace

import numpy as np
import pytest
from rods import ALL_RODS, CONE, CYLINDER, bending_force, rest_shape

from probedesign.rod.rod import FINITE_BEND, FINITE_STRETCH, ROOT_CENTRE

G = 9.81
LOADS = {
    "planar": ((G, 0, 0), (1.0, 0.0, 0.0), 0.6, 0.8),
    "oblique": ((3, 4, -8), (1.0, -2.0, 0.6), 0.83, 0.9),
    "tip": ((0, G, 0), (-1.0, 0.3, -0.5), 1.0, 0.7),
    "root": ((-G, 0, 0), (0.0, 1.0, 0.0), 0.1, 1.0),
}
CASES = [(rod, load) for rod in ALL_RODS for load in LOADS]
NODES, WEIGHTS = np.polynomial.legendre.leggauss(8)


def solved(rod_name, load_name):
    rod = ALL_RODS[rod_name]
    gravity, way, fraction, strength = LOADS[load_name]
    s_c = fraction * rod.length
    force = bending_force(rod, s_c, strength) * np.array(way) / np.linalg.norm(way)
    eq = rod.solve(gravity, force, s_c, mode="reference")
    assert eq.result == "ok"
    return rod, np.array(gravity), force, eq


def integral(f, low, high):
    """Return ∫ f ds over [low, high] by Gauss–Legendre quadrature; f maps (j,) to (j, 3)."""
    s = low + (high - low) * (NODES + 1.0) / 2.0
    return (high - low) / 2.0 * (WEIGHTS @ f(s))


def line_weight(rod, gravity):
    """ρ A(s) g [N/m], (j, 3)."""
    line = rod.density * rod.factors[0] * np.pi
    return lambda s: line * rod.radius_at(s)[:, None] ** 2 * gravity


@pytest.mark.parametrize(("rod_name", "load_name"), CASES)
def test_each_piece_between_two_nodes_is_in_balance(rod_name, load_name):
    rod, gravity, _force, eq = solved(rod_name, load_name)
    s, n, m = eq.s, eq.n_base.copy(), eq.m_base
    weight = line_weight(rod, gravity)
    for low, high, n0, n1, m0, m1, p0, p1 in zip(
        s[:-1], s[1:], n[:-1], n[1:], m[:-1], m[1:], eq.p_base[:-1], eq.p_base[1:], strict=True
    ):
        if low == eq.s_contact:  # at s_c itself the force is counted; just beyond it is not
            n0 = n0 - eq.load[0:3]
        force = n1 - n0 + integral(weight, low, high)

        def lever(s, p0=p0):
            return np.cross(eq.p_at(s) - p0, weight(s))

        moment = m1 - m0 + np.cross(p1 - p0, n1) + integral(lever, low, high)
        # Rounding of the sums, and 1e-13 a step of the integration.
        assert np.abs(force).max() <= 1e-12 * np.abs(n).max()
        assert np.abs(moment).max() <= 1e-11 * np.abs(m).max()


@pytest.mark.parametrize(("rod_name", "load_name"), CASES)
def test_the_base_carries_force_and_weight_where_they_act(rod_name, load_name):
    rod, gravity, force, eq = solved(rod_name, load_name)
    weight = line_weight(rod, gravity)
    pieces = list(zip(eq.s[:-1], eq.s[1:], strict=True))
    mg = sum(integral(weight, *piece) for piece in pieces)
    turning = sum(integral(lambda s: np.cross(eq.p_at(s), weight(s)), *piece) for piece in pieces)
    # Quadrature is exact for the cone's volume; p between nodes is as good as a step, 1e-13.
    np.testing.assert_allclose(eq.wrench_base[:3], force + mg, atol=1e-13 * np.linalg.norm(force))
    moment = np.cross(eq.p_contact_base, force) + turning
    np.testing.assert_allclose(eq.wrench_base[3:], moment, atol=1e-11 * np.linalg.norm(moment))


def strains(rod, s, n, m):
    """v - e_z and u at s from n and m in section axes, (j, 3) each: linear elasticity, root, finite strain, rest."""
    r = rod.radius_at(s)
    A, I_xx, I_yy, J = np.outer(rod.factors, np.ones_like(s)) * [
        np.pi * r**2,
        *[np.pi / 4.0 * r**4] * 2,
        np.pi / 2.0 * r**4,
    ]
    shear, E = rod.shear_coefficient * rod.shear_modulus * A, rod.youngs_modulus
    v = n / np.stack([shear, shear, E * A], axis=1)
    u = m / np.stack([E * I_xx, E * I_yy, rod.shear_modulus * J], axis=1)
    depth, reach = rod.root
    keeps = np.where(s < reach, 1.0 - depth * (1.0 - s / reach) ** 3, 1.0)
    if rod.finite_strain:  # docs/decisions/0006
        e, large = v[:, 2].copy(), (u[:, 0] ** 2 + u[:, 1] ** 2) * r**2
        v[:, 2] += e**2 + FINITE_STRETCH * keeps * large
        u[:, :2] *= (1.0 + 3.0 * e + FINITE_BEND * large)[:, None]
    u[:, :2] *= keeps[:, None]
    return v, u + rest_shape(rod, s)


@pytest.mark.parametrize(("rod_name", "load_name"), CASES)
def test_strains_are_those_of_the_stiffness(rod_name, load_name):
    """v = e_z + K_se⁻¹ Rᵀn and u = f K_bt⁻¹ Rᵀm + u_rest, by differences along the rod."""
    rod, _gravity, _force, eq = solved(rod_name, load_name)
    h = 1e-5 * rod.length
    s = np.array([0.011, 0.055, 0.31, 0.47, 0.71, 0.93]) * rod.length
    R = eq.R_at(s)
    p_s = (eq.p_at(s + h) - eq.p_at(s - h)) / (2.0 * h)
    R_s = (eq.R_at(s + h) - eq.R_at(s - h)) / (2.0 * h)
    n = np.einsum("kji,kj->ki", R, eq.n_at(s))
    m = np.einsum("kji,kj->ki", R, eq.states_at(s)[:, 3:6])
    v, u = strains(rod, s, n, m)
    u_hat = np.einsum("kji,kjl->kil", R, R_s)
    found_u = np.stack([u_hat[:, 2, 1], u_hat[:, 0, 2], u_hat[:, 1, 0]], axis=1)
    # Central differences over 1e-5 L: h² of the third derivative (1e-9), rounding 1e-13/1e-5 = 1e-8.
    np.testing.assert_allclose(np.einsum("kji,kj->ki", R, p_s), v + np.eye(3)[2], atol=1e-7)
    np.testing.assert_allclose(found_u * rod.length, u * rod.length, atol=1e-6)


@pytest.mark.parametrize("rigid_length", [0.72e-3, 4e-3, -2e-3])
def test_the_root_lacks_its_rigid_length(rigid_length):
    """∫(1 - f) ds is the rigid length, and f stays a share of a stiffness."""
    rod = replace(CONE, rigid_length=rigid_length)
    depth, reach = rod.root
    s = reach * (NODES + 1.0) / 2.0
    missing = depth * (1.0 - s / reach) ** 3
    assert reach / 2.0 * (WEIGHTS @ missing) == pytest.approx(rigid_length, rel=1e-13)  # exact for a cubic
    assert depth <= 0.9 * (1.0 + 1e-15)
    if depth < 0.9:
        centre = reach / 2.0 * (WEIGHTS @ (s * missing)) / rigid_length
        assert centre == pytest.approx(ROOT_CENTRE * rod.radius[0], rel=1e-13)


def test_the_root_turns_the_rod_less_by_its_rigid_length():
    """At small bending the root reduces the tip rotation by m(0)/(E I) times the rigid length, except for taper."""
    force, rigid = 1e-6, 0.12 * CYLINDER.radius[0]
    slope = [
        replace(CYLINDER, rigid_length=x).solve(force=(force, 0, 0), mode="reference").tip_tangent[0]
        for x in (0.0, rigid)
    ]
    EI = CYLINDER.youngs_modulus * np.pi / 4.0 * CYLINDER.radius[0] ** 4
    # ∫ (1 - f) (L - s) ds: the rigid length sits at ROOT_CENTRE radii. (F L²/EI)² = 1e-7 is left out of the theory.
    lacks = force * rigid * (CYLINDER.length - ROOT_CENTRE * CYLINDER.radius[0]) / EI
    assert slope[0] - slope[1] == pytest.approx(lacks, rel=1e-6)
