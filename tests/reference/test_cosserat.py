"""Compare the reference rod with the rod of the package, and its presses with solves of the same touches."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from probedesign.geometry.cross_section import CrossSection
from probedesign.rod.contact import solve_frictionless
from probedesign.rod.rod import Rod
from tests.reference.cosserat import press, solve
from tests.reference.round_rods import Probes

GRAVITY = np.array([9.81, 0.0, 0.0])
LARGE = Rod(
    np.array([0.0, 0.15]), np.array([6e-3, 1e-3]), 2.32e6, 0.761e6, 1010.0, rigid_length=0.72e-3, finite_strain=True
)
PROFILE = Rod(np.array([0.0, 0.03, 0.07, 0.12]), np.array([6e-3, 5e-3, 2e-3, 1.5e-3]), 1e6, 0.3e6, 1100.0, 0.9, 4e-3)
RODS = {
    "large": LARGE,
    "linear": Rod(LARGE.s, LARGE.radius, 2.32e6, 0.761e6, 1010.0),
    "compliant root": Rod(LARGE.s, LARGE.radius, 2.32e6, 0.761e6, 1010.0, rigid_length=-1.5e-3, finite_strain=True),
    "cylinder": Rod(np.array([0.0, 0.1]), np.array([2e-3, 2e-3]), 2.32e6, 0.761e6, 1010.0),
    "profile": PROFILE,
    "elliptic": Rod(LARGE.s, LARGE.radius, 2.32e6, 0.761e6, 1010.0, factors=CrossSection(flatness=0.6).factors),
    "curved": replace(
        PROFILE, rest_curvature=np.array([[6.0, -4.0, 5.0], [-4.0, 8.0, 20.0], [0.0, 6.0, -8.0], [10.0, 0.0, 2.0]])
    ),
    "arc of a right angle": replace(LARGE, rest_curvature=np.tile([0.0, np.pi / 2.0 / LARGE.length, 0.0], (2, 1))),
}


def drawn(rod, n, rng):
    """Draw touches on the surface with forces of any direction that bend the rod by up to about 1 rad."""
    s = rng.uniform(0.2, 1.0, n) * rod.length
    stiffness = rod.factors[1] * rod.youngs_modulus * np.pi / 4.0 * rod.radius[0] ** 3 * rod.radius_at(s) / s**2
    direction = rng.normal(size=(n, 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    return s, rng.uniform(-np.pi, np.pi, n), (rng.uniform(0.1, 1.0, n) * stiffness)[:, None] * direction


@pytest.mark.parametrize("rod", RODS.values(), ids=RODS)
def test_a_force_on_the_surface_agrees_with_the_rod_under_force_and_couple(rod):
    n = 10
    s, phi, force = drawn(rod, n, np.random.default_rng(0))
    found = solve(Probes.of([rod] * n), GRAVITY, s, phi, force)
    for i in np.flatnonzero(found.ok):
        arm = found.p_surface[i] - found.p_centre[i]
        eq = rod.solve(GRAVITY, force[i], s[i], couple=np.cross(arm, force[i]), mode="reference")
        assert eq.result == "ok"
        # The Runge-Kutta error of the grid: 1e-6 of the moment and of the length.
        error = np.linalg.norm(found.wrench[i] - eq.wrench_base)
        assert error <= 1e-6 * np.linalg.norm(eq.wrench_base)
        assert_allclose(found.p_centre[i], eq.p_contact_base, atol=1e-6 * rod.length)
        assert_allclose(found.R[i], eq.R_at(s[i]), atol=5e-6)
    assert found.ok.sum() >= 9


def test_without_friction_it_agrees_with_the_contact_of_the_package():
    s, force = 0.7 * LARGE.length, 0.02
    touch = solve_frictionless(LARGE, GRAVITY, s, np.pi / 2.0, force, "reference")
    e = -touch.equilibrium.R_at(touch.equilibrium.s_contact).T @ touch.force_base
    # The package's force acts where the normal meets the axis, r tan α nearer the base than the touched point.
    tan = LARGE.taper_at(s)
    on = s + LARGE.radius_at(s) * tan / (1.0 + tan * tan)
    assert abs(LARGE.radius_at(on) * tan + s - on) < 1e-9
    found = solve(Probes.of(LARGE), GRAVITY, on, np.arctan2(e[1], e[0]), (force, 0.0, 0.0), axes="surface")
    # Between the two sections, 0.1 mm apart, the rod and its normal rotate by 1e-3 rad.
    assert_allclose(found.wrench[0], touch.equilibrium.wrench_base, atol=2e-3 * force)


def test_a_pressed_probe_touches_the_point_with_the_friction_given():
    n = 6
    rng = np.random.default_rng(1)
    probes = Probes.of([LARGE] * n)
    phi, ratios = rng.uniform(-np.pi, np.pi, n), rng.normal(0.0, 0.4, (n, 2))
    first = solve(
        probes, GRAVITY, 0.6 * LARGE.length, phi, 0.01 * np.column_stack([np.ones(n), ratios]), axes="surface"
    )
    assert first.ok.all()
    goal = first.p_surface + 3e-3 * first.frame[:, :, 0]
    found = press(probes, GRAVITY, goal, first, friction=ratios)
    assert found.ok.all()
    assert_allclose(found.p_surface, goal, atol=1e-9)
    assert_allclose(found.surface_force[:, 1:] / found.surface_force[:, :1], ratios, atol=1e-7)
    again = solve(probes, GRAVITY, found.s, found.phi, found.force)
    assert_allclose(again.wrench, found.wrench, atol=1e-9)


def test_a_sticking_touch_keeps_its_place_on_the_probe():
    probes = Probes.of(LARGE)
    first = solve(probes, GRAVITY, 0.5 * LARGE.length, 0.3, (0.02, 0.0, 0.0), axes="surface")
    goal = first.p_surface + 1e-3 * first.frame[:, :, 0]
    found = press(probes, GRAVITY, goal, first, sticks=True)
    assert found.ok.all() and found.s[0] == first.s[0] and found.phi[0] == first.phi[0]
    assert_allclose(found.p_surface, goal, atol=1e-9)
    # Bending without sliding stretches the rod, so that the touch pulls it towards the base.
    assert found.surface_force[0, 2] < -0.1 * found.surface_force[0, 0]
