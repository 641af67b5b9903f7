"""Every part of the bent rod is in balance: the equations between nodes, and the whole about its base."""

import numpy as np
import pytest
from rods import RODS, bending_force

G = 9.81
LOADS = {
    "planar": ((G, 0, 0), (1.0, 0.0, 0.0), 0.6, 0.8),
    "oblique": ((3, 4, -8), (1.0, -2.0, 0.6), 0.83, 0.9),
    "tip": ((0, G, 0), (-1.0, 0.3, -0.5), 1.0, 0.7),
    "root": ((-G, 0, 0), (0.0, 1.0, 0.0), 0.1, 1.0),
}
CASES = [(rod, load) for rod in RODS for load in LOADS]
NODES, WEIGHTS = np.polynomial.legendre.leggauss(8)


def solved(rod_name, load_name):
    rod = RODS[rod_name]
    gravity, way, fraction, strength = LOADS[load_name]
    s_c = fraction * rod.length
    force = bending_force(rod, s_c, strength) * np.array(way) / np.linalg.norm(way)
    eq = rod.solve(gravity, force, s_c, mode="reference")
    assert eq.result == "ok"
    return rod, np.array(gravity), force, eq


def integral(f, low, high):
    """∫ f ds over [low, high] by Gauss-Legendre; f of (j,) gives (j, 3)."""
    s = low + (high - low) * (NODES + 1.0) / 2.0
    return (high - low) / 2.0 * (WEIGHTS @ f(s))


def line_weight(rod, gravity):
    """ρ A(s) g [N/m], (j, 3)."""
    return lambda s: rod.density * np.pi * np.interp(s, rod.s, rod.radius)[:, None] ** 2 * gravity


@pytest.mark.parametrize(("rod_name", "load_name"), CASES)
def test_each_piece_between_two_nodes_is_in_balance(rod_name, load_name):
    rod, gravity, _force, eq = solved(rod_name, load_name)
    s, n, m = eq.s, eq.n_base.copy(), eq.m_base
    weight = line_weight(rod, gravity)
    for low, high, n0, n1, m0, m1, p0, p1 in zip(
        s[:-1], s[1:], n[:-1], n[1:], m[:-1], m[1:], eq.p_base[:-1], eq.p_base[1:], strict=True
    ):
        if low == eq.load[9]:  # at s_c itself the force is counted; just beyond it is not
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


@pytest.mark.parametrize(("rod_name", "load_name"), CASES)
def test_strains_are_those_of_the_stiffness(rod_name, load_name):
    """v = e_z + K_se⁻¹ Rᵀn and u = K_bt⁻¹ Rᵀm, by differences along the rod."""
    rod, _gravity, _force, eq = solved(rod_name, load_name)
    h = 1e-5 * rod.length
    s = np.array([0.055, 0.31, 0.47, 0.71, 0.93]) * rod.length
    R, n, m = eq.R_at(s), eq.n_at(s), eq.states_at(s)[:, 3:6]
    p_s = (eq.p_at(s + h) - eq.p_at(s - h)) / (2.0 * h)
    R_s = (eq.R_at(s + h) - eq.R_at(s - h)) / (2.0 * h)
    area = np.pi * np.interp(s, rod.s, rod.radius) ** 2
    inertia = area**2 / (4.0 * np.pi)
    shear = rod.shear_coefficient * rod.shear_modulus * area
    v = np.einsum("kji,kj->ki", R, n) / np.stack([shear, shear, rod.youngs_modulus * area], axis=1)
    EI, GJ = rod.youngs_modulus * inertia, rod.shear_modulus * 2.0 * inertia
    u = np.einsum("kji,kj->ki", R, m) / np.stack([EI, EI, GJ], axis=1)
    u_hat = np.einsum("kji,kjl->kil", R, R_s)
    found_u = np.stack([u_hat[:, 2, 1], u_hat[:, 0, 2], u_hat[:, 1, 0]], axis=1)
    # Central differences over 1e-5 L: h² of the third derivative (1e-9), rounding 1e-13/1e-5 = 1e-8.
    np.testing.assert_allclose(np.einsum("kji,kj->ki", R, p_s), v + np.eye(3)[2], atol=1e-7)
    bends = s >= rod.rigid_length
    np.testing.assert_allclose(found_u * rod.length, u * bends[:, None] * rod.length, atol=1e-6)
