"""Exact sensitivities against central differences: base wrench, contact frame and position, every parameter."""

from dataclasses import replace

import numpy as np
import pytest
from rods import CONE, PROFILE, bending_force

from probedesign.rod.kernels import PARAMETERS

GRAVITY = np.array([6.0, 5.0, -6.0])
STEPS = {"force": 1e-4, "s_contact": 1e-5, "gravity": 1e-3, "log": 1e-4}
"""Of the differences: of the force's size, of the length, of the standard gravity, of the logarithm."""
CASES = {
    "cone": (CONE, 0.6),
    "cone at its tip's end": (CONE, 0.97),
    "rigid root": (PROFILE, 0.45),
    "beyond the last knot": (PROFILE, 0.9),
}


def step_of(name, rod, force):
    kind = next(k for k in STEPS if name.startswith(k))
    size = {"force": np.linalg.norm(force), "s_contact": rod.length, "gravity": 9.81, "log": 1.0}[kind]
    return STEPS[kind] * size


def moved(name, h, rod, gravity, force, s_c):
    """The problem with one parameter moved by h."""
    if name == "log_diameter":  # the rigid root is so many radii long
        rod = replace(rod, radius=rod.radius * np.exp(h), rigid_length=rod.rigid_length * np.exp(h))
    elif name.startswith("log_"):
        key = {"log_E": "youngs_modulus", "log_G": "shear_modulus", "log_density": "density"}[name]
        rod = replace(rod, **{key: getattr(rod, key) * np.exp(h)})
    elif name == "s_contact":
        s_c = s_c + h
    else:
        by = h * np.eye(3)["xyz".index(name[-1])]
        gravity, force = (gravity + by, force) if name.startswith("gravity") else (gravity, force + by)
    return rod, gravity, force, s_c


def frame_of(eq):
    """[tangent, x axis, position, y axis] at the contact, (12,)."""
    R = eq.R_at(eq.load[9])
    return np.concatenate([R[:, 2], R[:, 0], eq.p_contact_base, R[:, 1]])


def measured(eq, rod):
    """All that has a derivative, in units of its own size: the base moment's is force times length."""
    return np.concatenate([eq.wrench_base, frame_of(eq)])


def assert_close(found, wanted, force, length, rtol):
    """Each group (force, moment, tangent, axes, position) within rtol of its own largest.

    A group that hardly answers (G moves only what shear bends) is held to a hundredth of its natural size.
    """
    natural = [(0, 3, np.linalg.norm(force)), (3, 6, np.linalg.norm(force) * length),
               (6, 12, 1.0), (12, 15, length), (15, 18, 1.0)]  # fmt: skip
    for low, high, size in natural:
        scale = max(np.abs(wanted[low:high]).max(), 1e-2 * size)
        np.testing.assert_allclose(found[low:high], wanted[low:high], atol=rtol * scale, rtol=0.0)


@pytest.mark.parametrize("name", PARAMETERS)
@pytest.mark.parametrize("case", CASES)
def test_derivatives_are_those_of_differences(case, name):
    rod, fraction = CASES[case]
    s_c = fraction * rod.length
    force = bending_force(rod, s_c, 0.8) * np.array([0.6, -0.7, 0.4])
    problem = (rod, GRAVITY, force, s_c)
    h = step_of(name, rod, force)

    def at(x):
        moved_rod, *load = moved(name, x, *problem)
        eq = moved_rod.solve(*load, mode="reference")
        assert eq.result == "ok"
        return measured(eq, rod)

    # Richardson's two central differences: error O(h⁴), 1e-12 reached; what rounds is 1e-12/h = 1e-7.
    differences = (8.0 * (at(h) - at(-h)) - (at(2 * h) - at(-2 * h))) / (12.0 * h)
    j = PARAMETERS.index(name)
    for mode, rtol in (("reference", 1e-6), ("fast", 1e-5)):  # fast: its steps lose 1e-7 each
        d = rod.solve(GRAVITY, force, s_c, mode=mode, columns="all").sensitivity
        found = np.concatenate([d.d_wrench[:, j], d.d_contact[:, j]])
        unit = h / STEPS[next(k for k in STEPS if name.startswith(k))]
        assert_close(found * unit, differences * unit, force, rod.length, rtol)


def test_the_load_columns_are_the_first_of_all():
    s_c = 0.5 * PROFILE.length
    force = bending_force(PROFILE, s_c, 0.8) * np.array([0.6, -0.7, 0.4])
    some = PROFILE.solve(GRAVITY, force, s_c, mode="reference", columns="load").sensitivity
    everything = PROFILE.solve(GRAVITY, force, s_c, mode="reference", columns="all").sensitivity
    assert some.d_wrench.shape == (6, 4) and everything.d_wrench.shape == (6, len(PARAMETERS))
    # The same steps: error control looks at the state alone, so only rounding differs.
    np.testing.assert_allclose(some.d_contact, everything.d_contact[:, :4], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(some.frame, everything.frame, rtol=1e-12, atol=1e-14)


def test_the_frame_is_the_equilibriums():
    s_c = 0.5 * PROFILE.length
    force = bending_force(PROFILE, s_c, 0.8) * np.array([0.6, -0.7, 0.4])
    eq = PROFILE.solve(GRAVITY, force, s_c, columns="load")
    np.testing.assert_allclose(eq.sensitivity.frame, frame_of(eq), atol=1e-15)
    np.testing.assert_array_equal(eq.sensitivity.d_position, eq.sensitivity.d_contact[6:9])


def test_nothing_is_carried_unasked():
    assert CONE.solve(GRAVITY).sensitivity is None


@pytest.mark.parametrize("mode", ["fast", "reference"])
def test_on_the_rigid_root_the_moment_knows_the_contact_by_its_arm_alone(mode):
    """∂M/∂s = p' × F, the root still shears and stretches: p' = e_z + K_se⁻¹ n."""
    s_c = 0.5 * PROFILE.rigid_length
    force = np.array([0.3, 0.2, 0.1])
    d = PROFILE.solve((0, 0, 0), force, s_c, mode=mode, columns="load").sensitivity
    assert d is not None
    area = np.pi * np.interp(s_c, PROFILE.s, PROFILE.radius) ** 2
    shear = PROFILE.shear_coefficient * PROFILE.shear_modulus * area
    p_s = np.array([0, 0, 1.0]) + force / [shear, shear, PROFILE.youngs_modulus * area]
    np.testing.assert_allclose(d.d_moment[:, 3], np.cross(p_s, force), atol=1e-7)  # the fast steps' own
