"""The rod pressed against a fixed point or edge without friction: geometry, limit cases and energy."""

import math
from dataclasses import replace

import numpy as np
import pytest
from rods import CONE, CYLINDER, ELLIPTIC, PROFILE, ROOTED_CONE, approach, surface_point

from probedesign.core.errors import InputError
from probedesign.rod.contact import line_of_action, press_poses, solve_frictionless
from probedesign.rod.friction import CoulombSolver, press_against_line, press_against_point
from probedesign.rod.rod import Rod

GRAVITY = np.array([6.0, 5.0, -6.0])
RODS = {"cone": CONE, "rooted": ROOTED_CONE, "cylinder": CYLINDER, "profile": PROFILE, "elliptic": ELLIPTIC}
PLACES = [(name, fraction) for name in RODS for fraction in (0.2, 0.5, 0.85)]


def flank_press(rod, fraction, depth, line=False, moved=(0, 0, 0), mode="reference"):
    """Press at a fraction of the free rod by `depth` radii."""
    point, travel, direction = approach(rod, GRAVITY, fraction, depth, line=line)
    if direction is not None:
        return press_against_line(rod, GRAVITY, point + moved, direction, travel, mode)
    return press_against_point(rod, GRAVITY, point + moved, travel, mode)


@pytest.mark.parametrize("line", [False, True])
@pytest.mark.parametrize(("name", "fraction"), PLACES)
def test_the_object_touches_the_surface_and_pushes_along_its_normal(name, fraction, line):
    rod = RODS[name]
    press = flank_press(rod, fraction, 0.5, line)
    assert press.result == "ok" and press.normal_force > 0.0
    touched, normal = surface_point(rod, press.equilibrium, press.s, press.angle)
    np.testing.assert_allclose(press.p_surface_base, touched, atol=1e-9 * rod.length)
    np.testing.assert_allclose(press.normal, normal, atol=1e-9)
    assert press.tangential_force <= 1e-9 * press.normal_force
    if line:
        assert abs(press.force_base @ press.direction) < 1e-9 * press.magnitude


@pytest.mark.parametrize("line", [False, True])
@pytest.mark.parametrize("name", ["cone", "rooted", "cylinder", "elliptic"])
def test_the_push_found_is_the_push_that_was_given(name, line):
    """`solve_frictionless` puts the force where its line meets the axis, r tan α from the touched section: on a
    cylinder the same place, elsewhere the bending over that length, 1e-4 of the force, is the difference."""
    rod = RODS[name]
    press = flank_press(rod, 0.5, 0.5, line)
    s = line_of_action(rod, press.equilibrium, press.p_surface_base)
    given = solve_frictionless(rod, GRAVITY, s, press.angle + math.pi, press.magnitude, "reference")
    close = 1e-8 if name == "cylinder" else 1e-3
    np.testing.assert_allclose(press.force_base, given.force_base, atol=close * press.magnitude)
    np.testing.assert_allclose(
        press.equilibrium.wrench_base, given.equilibrium.wrench_base, atol=close * press.magnitude
    )


@pytest.mark.parametrize("fraction", [0.3, 0.8])
def test_a_little_press_bends_as_beams_bend(fraction):
    """f cos α = 3 E I(0) (r(s)/r(0)) δ/s³, exact for a cone bent little."""
    rod = replace(CONE, inextensible=True, density=0.0)
    L, tan = rod.length, rod.taper_at(0.0)
    z, depth = fraction * L, 1e-6 * L
    r = float(rod.radius_at(z))
    press = press_against_point(rod, (0, 0, 0), (r - depth, 0.0, z), (-2.0 * r, 0.0, 0.0), "reference")
    s = z - r * tan
    stiffness = 3.0 * rod.youngs_modulus * math.pi / 4.0 * 6e-3**3 * float(rod.radius_at(s)) / s**3
    assert press.s == pytest.approx(z, rel=1e-5)
    assert press.angle == pytest.approx(0.0, abs=1e-9)
    # The flank yields along its normal by δ cos α: the axis by δ. What f sin α does to it is of the order α².
    assert press.magnitude == pytest.approx(stiffness * depth * math.hypot(1.0, tan), rel=1e-3)


@pytest.mark.parametrize("name", ["cone", "profile"])
def test_in_its_plane_an_edge_across_it_is_a_point(name):
    rod, gravity = RODS[name], (9.81, 0.0, 0.0)
    p = rod.solve(gravity).p_at(0.7 * rod.length)
    travel = (-0.02, 0.0, 0.0)
    point = press_against_point(rod, gravity, p, travel, "reference")
    line = press_against_line(rod, gravity, p, (0.0, -3.0, 0.0), travel, "reference")
    assert point.result == line.result == "ok"
    np.testing.assert_allclose(line.equilibrium.wrench_base, point.equilibrium.wrench_base, rtol=1e-9, atol=1e-12)
    assert line.s == pytest.approx(point.s, abs=1e-10)


def energy(rod, press):
    """Return the energy [J]: ∫ (m - t (m·t))²/(2 E I) + (m·t)²/(2 G J) - ρ A g·p ds, inextensible."""
    x, w = np.polynomial.legendre.leggauss(10)
    ends = np.unique(np.concatenate([rod.s, np.linspace(0.0, rod.length, 31), [press.s]]))
    h = np.diff(ends)
    s, w = (ends[:-1, None] + h[:, None] * (x + 1) / 2).ravel(), (h[:, None] * w / 2).ravel()
    y, p = press.equilibrium.states_at(s), press.equilibrium.p_at(s)
    t, m = y[:, 0:3], y[:, 3:6]
    twist = np.einsum("ij,ij->i", t, m)
    bend2 = np.einsum("ij,ij->i", m, m) - twist**2
    area = math.pi * rod.radius_at(s) ** 2
    EI = rod.youngs_modulus * area**2 / (4.0 * math.pi)
    GJ = rod.shear_modulus * area**2 / (2.0 * math.pi)
    elastic = (bend2 / EI + twist**2 / GJ) / 2.0
    return float(w @ (elastic - rod.density * area * (p @ GRAVITY)))


@pytest.mark.parametrize("line", [False, True])
@pytest.mark.parametrize("name", ["cylinder", "cone", "profile"])
def test_force_equals_energy_gradient(name, line):
    """dE = F · dq as the object moves by dq, whatever slides on whatever: without friction nothing is lost.

    With shear and stretch the normal, which leans against the tangent and not against p', costs a little more; so the
    rod is inextensible here.
    """
    rod = replace(RODS[name], inextensible=True, rigid_length=0.0)
    press = flank_press(rod, 0.5, 0.5, line)
    h = 1e-4 * rod.length
    for dq in np.eye(3):
        at = [energy(rod, flank_press(rod, 0.5, 0.5, line, moved=k * h * dq)) for k in (-2, -1, 1, 2)]
        slope = (8.0 * (at[2] - at[1]) - (at[3] - at[0])) / (12.0 * h)
        assert slope == pytest.approx(press.force_base @ dq, abs=1e-6 * press.magnitude)


@pytest.mark.parametrize("height", [0.03, 0.149])
@pytest.mark.parametrize("offset", [0.0, 0.7])
def test_the_first_touch_is_where_the_surface_is(height, offset):
    r = float(CONE.radius_at(height))
    point = (r * math.sqrt(1.0 - offset**2), offset * r, height)
    before, after = (press_against_point(CONE, (0, 0, 0), np.add(point, (step, 0, 0)), (-0.03, 0.0, 0.0))
                     for step in (1e-6, -1e-6))  # fmt: skip
    assert before.result == "no_contact" and np.isnan(before.force_base).all() and math.isnan(before.s)
    assert after.result == "ok" and after.s == pytest.approx(height, abs=1e-6)


@pytest.mark.parametrize("name", ["cone", "cylinder", "profile"])
def test_an_edge_slides_off_the_tip(name):
    rod = RODS[name]
    z, solver = 0.97 * rod.length, CoulombSolver(rod, 0.0)
    results = [solver.press((0, 0, 0), (-0.02 * rod.length, 0.0, z), (-0.12 * rod.length, 0, 0), (0, 1, 0))]
    for depth in np.linspace(0.04, 0.5, 24):
        results.append(solver.advance(results[-1], (-depth * rod.length, 0.0, z)))
    ok = [press.result == "ok" for press in results]
    assert ok[0] and not ok[-1] and sorted(ok, reverse=True) == ok
    assert results[-1].result in ("on_end", "unstable") and np.isnan(results[-1].force_base).all()
    slid = [press.s for press in results if press.result == "ok"]
    assert (np.diff(slid) > 0.0).all() and slid[-1] <= rod.length


@pytest.mark.parametrize("fraction", [0.36, 0.5])
def test_over_the_knots_of_a_profile_the_press_goes_on(fraction):
    """The radius of the profile increases in places, so an edge that slides outwards meets a groove and a ridge."""
    rod = Rod(np.array([0.0, 0.05, 0.07, 0.12]), np.array([4e-3, 2e-3, 2.5e-3, 1.5e-3]), 1e6, 0.3e6, 1100.0)
    solver, z, slid = CoulombSolver(rod, 0.0), fraction * rod.length, []
    press = solver.press((0, 0, 0), (1.7e-3, 0.0, z), (-0.0101, 0.0, 0.0), (0, 1, 0))
    for depth in np.linspace(2e-3, 0.05, 25):
        if press.result != "ok":
            break
        slid.append(press.s)
        press = solver.advance(press, (1.8e-3 - depth, 0.0, z))
    assert np.abs(np.diff(slid)).max() < 0.08 * rod.length
    assert slid[-1] > (fraction + 0.05) * rod.length and (np.diff(np.searchsorted(rod.s, slid)) > 0).any()


@pytest.mark.parametrize("bad", [(math.nan, 0, 0), (0, math.inf, 0), (1, 2), "here", None])
def test_what_is_no_place_is_refused(bad):
    with pytest.raises(InputError, match="three finite numbers"):
        press_against_point(CONE, GRAVITY, bad, (-0.1, 0, 0))
    with pytest.raises(InputError, match="three finite numbers"):
        press_against_line(CONE, GRAVITY, (0, 0, 0.1), (0, 1, 0), bad)
    with pytest.raises(InputError, match=r"direction = .* (three finite numbers|not be zero)"):
        press_against_line(CONE, GRAVITY, (0, 0, 0.1), bad if bad is not None else (0, 0, 0), (-0.1, 0, 0))


def test_a_path_must_start_clear_and_stay_near():
    with pytest.raises(InputError, match="clear of the rod"):
        press_against_point(CONE, GRAVITY, (0, 0, 0.05), (0, 0, 0))
    with pytest.raises(InputError, match="a million lengths"):
        press_against_point(CONE, GRAVITY, (0, 0, 0.05), (1e200, 0, 0))


@pytest.mark.parametrize("travel", [(0, 0, 0), (1e-30, 0, 0), (1e5, 1e5, 0), (-1e5, 0, 0), (0, 0, 1e5)])
def test_absurd_ways_end(travel):
    codes = ("ok", "no_contact", "on_end", "unstable", "not_converged")
    assert press_against_point(CONE, (9.81, 0, 0), (0.05, 0.0, 0.05), travel).result in codes
    assert press_against_line(CONE, (9.81, 0, 0), (0.05, 0.0, 0.05), (0, 1, 0), travel).result in codes


def test_an_unstable_free_rod_has_nothing_to_press():
    soft = replace(CONE, youngs_modulus=100.0, shear_modulus=33.0)
    press = press_against_point(soft, (0, 0, -9.81), (0.0, 0.0, 0.1), (-1.0, 0, 0))
    assert press.result in ("unstable", "not_converged") and math.isnan(press.s)


def test_the_poses_of_a_press_put_the_base_where_the_point_pushes_so_hard():
    rest, forces, compliance = np.array([0.3, -0.2, 0.1]), np.array([0.002, 0.006]), 0.04
    s = 0.6 * CONE.length
    wrenches, poses = press_poses(CONE, GRAVITY, s, -math.pi / 2, forces, rest, compliance)
    weight = CONE.solve(GRAVITY).wrench_base[:3]
    for force, wrench, T in zip(forces, wrenches, poses, strict=True):
        pushed = wrench[:3] - weight  # by the object
        assert np.linalg.norm(pushed) == pytest.approx(force, rel=1e-6)
        point = rest - compliance * pushed - T[:3, 3]  # in base axes: those of the world
        press = press_against_point(CONE, GRAVITY, point, 0.02 * pushed / force, "reference")
        assert press.s == pytest.approx(s, rel=1e-5)
        # The fast mode is within a micrometre, which is 1e-4 of the deflection and so of the force.
        np.testing.assert_allclose(press.equilibrium.wrench_base, wrench, atol=1e-4 * force)
