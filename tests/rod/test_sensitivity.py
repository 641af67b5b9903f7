"""Compare sensitivities with central differences: base wrench, contact, centreline; by load and rod."""

from dataclasses import replace

import numpy as np
import pytest
from rods import CONE, CURVED, ELLIPTIC, EVERYTHING, FINITE, HOLLOW, PROFILE, ROOTED_CONE, YIELDING, bending_force

from probedesign.core.errors import InputError
from probedesign.rod.kernels.equations import PARAMETERS

GRAVITY = np.array([6.0, 5.0, -6.0])
#: Of the differences: of the force's size, of the length, of their product, of the standard gravity, of the logarithm,
#: of a radian over the length.
STEPS = {"force": 1e-4, "s_contact": 1e-5, "couple": 1e-4, "gravity": 1e-3, "log": 1e-4, "rest": 1e-4}
CASES = {
    # rod, s_c/L, couple as a share of force times length
    "cone at its tip's end": (CONE, 0.97, (0.0, 0.0, 0.0)),
    "rooted": (ROOTED_CONE, 0.6, (0.02, -0.03, 0.05)),
    "contact on the root": (PROFILE, 0.1, (0.02, -0.03, 0.05)),
    "yielding root": (YIELDING, 0.5, (0.0, 0.0, 0.0)),
    "beyond the last knot": (PROFILE, 0.9, (0.01, 0.02, 0.01)),
    "finite strain": (FINITE, 0.55, (-0.03, 0.02, 0.04)),
    "hollow": (HOLLOW, 0.6, (0.02, -0.03, 0.05)),
    "elliptic": (ELLIPTIC, 0.6, (0.02, -0.03, 0.05)),
    "curved at rest": (CURVED, 0.8, (0.0, 0.0, 0.0)),
    "everything": (EVERYTHING, 0.5, (0.02, 0.01, 0.03)),
}
#: Places on the centreline over the length: on both sides of every contact, and at the end of the root.
PLACES = np.array([0.05, 0.3, 0.53, 0.7, 0.95, 1.0])


def problem(case):
    rod, fraction, couple = CASES[case]
    s_c = fraction * rod.length
    force = bending_force(rod, s_c, 0.8) * np.array([0.6, -0.7, 0.4])
    return rod, GRAVITY, force, np.linalg.norm(force) * rod.length * np.array(couple), s_c


def solve(rod, gravity, force, couple, s_c, mode="reference", columns="none"):
    eq = rod.solve(gravity, force, s_c, couple=couple, mode=mode, columns=columns)
    assert eq.result == "ok"
    return eq


def names_of(rod):
    return (*PARAMETERS, *(f"log_diameter_{i}" for i in range(len(rod.s))))


def kind_of(name):
    return next(k for k in STEPS if name.startswith(k))


def size_of(name, rod, force):
    F, L = np.linalg.norm(force), rod.length
    return {"force": F, "s_contact": L, "couple": F * L, "gravity": 9.81, "log": 1.0, "rest": 1.0 / L}[kind_of(name)]


def moved(name, h, rod, gravity, force, couple, s_c):
    """Return the problem with one parameter changed by h."""
    if name.startswith("log_diameter"):
        grown = rod.radius.copy()
        grown[int(name[13:]) if name[13:] else slice(None)] *= np.exp(h)
        # the root is so many base radii long
        rod = replace(rod, radius=grown, rigid_length=rod.rigid_length * grown[0] / rod.radius[0])
    elif name.startswith("log_"):
        key = {"log_E": "youngs_modulus", "log_G": "shear_modulus", "log_density": "density"}[name]
        rod = replace(rod, **{key: getattr(rod, key) * np.exp(h)})
    elif name == "s_contact":
        s_c = s_c + h
    elif name.startswith("rest"):
        rest = np.zeros((len(rod.s), 3)) if rod.rest_curvature is None else rod.rest_curvature
        rod = replace(rod, rest_curvature=rest + h * np.eye(3)["xy".index(name[-1])])
    else:
        by = h * np.eye(3)["xyz".index(name[-1])]
        gravity = gravity + by if name.startswith("gravity") else gravity
        force = force + by if name.startswith("force") else force
        couple = couple + by if name.startswith("couple") else couple
    return rod, gravity, force, couple, s_c


def frame_of(eq):
    """Return [tangent, x axis, position, y axis] at the contact, (12,)."""
    R = eq.R_at(eq.s_contact)
    return np.concatenate([R[:, 2], R[:, 0], eq.p_contact_base, R[:, 1]])


def measured(eq, rod):
    """Return all quantities with derivatives: base wrench, contact, centreline."""
    return np.concatenate([eq.wrench_base, frame_of(eq), eq.p_at(PLACES * rod.length).ravel()])


def claimed(eq, rod):
    """Return their derivatives, (6 + 12 + 3 · places, k)."""
    d = eq.sensitivity
    return np.vstack([d.d_wrench, d.d_contact, np.vstack(list(eq.d_p_at(PLACES * rod.length)))])


def differences(at, h):
    """Return Richardson's extrapolation of two central differences."""
    return (8.0 * (at(h) - at(-h)) - (at(2 * h) - at(-2 * h))) / (12.0 * h)


def assert_close(found, wanted, force, length, rtol):
    """Each group (force, moment, tangent, axes, position, centreline) within rtol of its own largest.

    A group that hardly answers (G moves only what shear bends) is compared to a hundredth of its natural size.
    """
    natural = [(0, 3, np.linalg.norm(force)), (3, 6, np.linalg.norm(force) * length),
               (6, 12, 1.0), (12, 15, length), (15, 18, 1.0), (18, len(wanted), length)]  # fmt: skip
    for low, high, size in natural:
        scale = max(np.abs(wanted[low:high]).max(), 1e-2 * size)
        np.testing.assert_allclose(found[low:high], wanted[low:high], atol=rtol * scale, rtol=0.0)


@pytest.mark.parametrize(("case", "name"), [(case, name) for case in CASES for name in names_of(CASES[case][0])])
def test_derivatives_are_those_of_differences(case, name):
    start = problem(case)
    rod, _gravity, force, _couple, _s_c = start
    unit = size_of(name, rod, force)
    h = STEPS[kind_of(name)] * unit

    def at(x):
        other = moved(name, x, *start)
        return measured(solve(*other), rod)

    # Error O(h⁴) = 1e-12; what rounds is 1e-13 or so over h, and over the hundredth of `assert_close`.
    wanted = differences(at, h)
    # 2e-9 measured. Fast: columns take the state's steps, which lose 1e-6 each, some ten of them; 2e-5 measured.
    for mode, rtol in (("reference", 1e-8), ("fast", 3e-5)):
        eq = solve(*start, mode=mode, columns="all")
        j = eq.sensitivity.names.index(name)
        assert_close(claimed(eq, rod)[:, j] * unit, wanted * unit, force, rod.length, rtol)


@pytest.mark.parametrize(("columns", "k"), [("load", 4), ("contact", 7)])
@pytest.mark.parametrize("case", ["beyond the last knot", "everything"])
def test_fewer_columns_are_the_first_of_all(case, columns, k):
    start = problem(case)
    some = solve(*start, columns=columns)
    everything = solve(*start, columns="all")
    assert everything.sensitivity.names == names_of(start[0])
    assert some.sensitivity.names == PARAMETERS[:k] and some.sensitivity.d_wrench.shape == (6, k)
    # Steps are chosen by the state and the tip's turns alone, which are carried by all of them: not a bit differs.
    np.testing.assert_array_equal(some.sensitivity.d_wrench, everything.sensitivity.d_wrench[:, :k])
    np.testing.assert_array_equal(some.sensitivity.d_contact, everything.sensitivity.d_contact[:, :k])
    np.testing.assert_array_equal(some.sensitivity.frame, everything.sensitivity.frame)
    s = PLACES * start[0].length
    np.testing.assert_array_equal(some.d_p_at(s), everything.d_p_at(s)[:, :, :k])


@pytest.mark.parametrize("case", ["rooted", "everything"])
def test_every_diameter_together_is_the_diameter(case):
    start = problem(case)
    found = claimed(solve(*start, columns="all"), start[0])
    j = PARAMETERS.index("log_diameter")
    together = found[:, len(PARAMETERS) :].sum(axis=1)
    np.testing.assert_allclose(together, found[:, j], rtol=0.0, atol=1e-12 * np.abs(found[:, j]).max())  # rounding


@pytest.mark.parametrize("mode", ["fast", "reference"])
@pytest.mark.parametrize("case", CASES)
def test_the_frame_is_the_equilibriums(case, mode):
    eq = solve(*problem(case), mode=mode, columns="load")
    # The same numbers, turned about the tangent by the same angle: the last bit of a sine.
    np.testing.assert_allclose(eq.sensitivity.frame, frame_of(eq), atol=1e-15)
    np.testing.assert_array_equal(eq.sensitivity.d_position, eq.sensitivity.d_contact[6:9])


def test_the_centreline_at_the_contact_moves_as_the_contact_does_but_for_s_contact():
    start = problem("everything")
    eq = solve(*start, columns="all")
    there = np.delete(eq.d_p_at(start[-1])[0], 3, axis=1)
    # Differences of two sums of the same numbers.
    wanted = np.delete(eq.sensitivity.d_position, 3, axis=1)
    np.testing.assert_allclose(there, wanted, rtol=0.0, atol=1e-14 * np.abs(wanted).max())


def test_only_requested_columns_are_computed():
    eq = CONE.solve(GRAVITY)
    assert eq.sensitivity is None
    with pytest.raises(InputError, match="columns"):
        eq.d_p_at(0.1)


def test_off_the_rod_there_are_no_derivatives():
    eq = CONE.solve(GRAVITY, columns="load")
    assert np.isnan(eq.d_p_at([-1e-3, 0.151])).all() and np.isfinite(eq.d_p_at([0.0, 0.15])).all()
    np.testing.assert_array_equal(eq.d_p_at([0.0]), 0.0)


@pytest.mark.parametrize("mode", ["fast", "reference"])
def test_at_clamp_moment_depends_on_lever_only(mode):
    """∂M/∂s = p' × F with p' = e_z + K_se⁻¹ F: the root bends less, but shears and stretches."""
    force = np.array([0.3, 0.2, 0.1])
    d = PROFILE.solve((0, 0, 0), force, 0.0, mode=mode, columns="load").sensitivity
    assert d is not None
    area = np.pi * PROFILE.radius[0] ** 2
    shear = PROFILE.shear_coefficient * PROFILE.shear_modulus * area
    p_s = np.array([0, 0, 1.0]) + force / [shear, shear, PROFILE.youngs_modulus * area]
    # Nothing is integrated on the way: rounding.
    np.testing.assert_allclose(d.d_moment[:, 3], np.cross(p_s, force), atol=1e-15)
