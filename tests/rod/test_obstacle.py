"""Test the rod pressed against a fixed point or line: statics, geometry, energy and derivatives."""

import math
from dataclasses import replace

import numpy as np
import pytest
from rods import CONE, CYLINDER, PROFILE, ROOTED_CONE, turned

from probedesign.core.errors import InputError
from probedesign.rod.contact import solve_frictionless
from probedesign.rod.obstacle import press_against_line, press_against_point
from probedesign.rod.rod import Rod

GRAVITY = np.array([6.0, 5.0, -6.0])
RODS = {"cone": CONE, "rooted": ROOTED_CONE, "cylinder": CYLINDER, "profile": PROFILE}
SIDE = np.array([math.cos(0.4), math.sin(0.4), 0.0])
"""Directions from which the flank is pressed."""
LEAN = 0.7
"""Angle of an edge to the plane of the rim [rad]."""
FLANK = [(name, fraction) for name in RODS for fraction in (0.2, 0.5, 0.85)]


def flank_press(rod, fraction, depth, line=False, offset=0.2, gravity=GRAVITY, mode="reference", moved=(0, 0, 0)):
    """Press at a fraction of the free rod by `depth` radii, at a distance from its axis in radii."""
    free = rod.solve(gravity, mode="reference")
    s = fraction * rod.length
    R, r = free.R_at(s), float(rod.radius_at(s))
    out, across = R @ SIDE, R @ np.cross([0.0, 0.0, 1.0], SIDE)
    point = free.p_at(s) + r * ((math.sqrt(1.0 - offset**2) - depth) * out + offset * across)
    travel = -(depth + 3.0) * r * (out + 0.1 * R[:, 2])
    if line:
        return press_against_line(rod, gravity, point + moved, across + 0.3 * R[:, 2] + 0.2 * out, travel, mode)
    return press_against_point(rod, gravity, point + moved, travel, mode)


def tip_press(rod, offset, depth, line=False, gravity=GRAVITY, mode="reference", moved=(0, 0, 0)):
    """Press on the flat end by `depth` radii, at a distance from its centre in radii, or by an edge on its rim."""
    free = rod.solve(gravity, mode="reference")
    R, r = free.R_at(rod.length), rod.radius[-1]
    normal = R @ ([math.cos(LEAN), 0.0, math.sin(LEAN)] if line else [0.0, 0.0, 1.0])
    touched = free.p_at(rod.length) + r * (R @ ([1.0, 0.0, 0.0] if line else [offset, 0.1, 0.0]))
    point, travel = touched - r * depth * normal + moved, -r * (depth + 2.0) * normal
    if line:
        return press_against_line(rod, gravity, point, R @ [-math.sin(LEAN), 0.4, math.cos(LEAN)], travel, mode)
    return press_against_point(rod, gravity, point, travel, mode)


PRESSES = {
    **{f"flank of {name} at {x}": (flank_press, RODS[name], x, 0.5) for name, x in FLANK},
    **{f"line on flank of {name} at {x}": (flank_press, RODS[name], x, 0.8, True) for name, x in FLANK},
    "face of cone": (tip_press, CONE, 0.5, 0.02),
    "face of cylinder": (tip_press, CYLINDER, -0.5, 0.005),
    "line on rim of cone": (tip_press, CONE, 1.0, 0.2, True),
    "line on rim of cylinder": (tip_press, CYLINDER, 1.0, 0.2, True),
}


def pressed(name, **more):
    press, *args = PRESSES[name]
    return press(*args, **more)


def surface_normal(rod, press):
    """Return the outward normal of the bent body at the touched section and the point of its circle."""
    eq, s = press.equilibrium, press.s_contact
    R = eq.R_at(s)
    out = -(math.cos(press.angle) * R[:, 0] + math.sin(press.angle) * R[:, 1])
    alpha = math.atan(rod.taper_at(press.s_surface))
    return math.cos(alpha) * out + math.sin(alpha) * R[:, 2]


@pytest.mark.parametrize("name", PRESSES)
def test_the_base_bears_the_contact_and_the_weight(name):
    """wrench = [F + m g; p × F + p_com × m g], at the touched point, whatever is put on the centreline."""
    press = pressed(name)
    assert press.result == "ok"
    rod, eq, F = PRESSES[name][1], press.equilibrium, press.force_base
    weight = weight_moment(rod, press)
    moment = np.cross(press.p_surface_base, F) + weight[3:]
    np.testing.assert_allclose(eq.wrench_base[0:3], F + weight[0:3], atol=1e-12)
    # The reference's own digits, 1e-10; the moment of the weight by quadrature.
    np.testing.assert_allclose(eq.wrench_base[3:6], moment, atol=1e-9 * np.linalg.norm(F) * rod.length)


def nodes_of(rod, breaks=()):
    """Return Gauss points and weights over the rod, with breaks at knots, the end of the root and given places."""
    x, w = np.polynomial.legendre.leggauss(10)
    even = np.linspace(0.0, rod.length, 31)
    ends = np.unique(np.concatenate([rod.s, [max(rod.root[1], 0.0)], even, breaks]))
    h = np.diff(ends)
    return (ends[:-1, None] + h[:, None] * (x + 1) / 2).ravel(), (h[:, None] * w / 2).ravel()


def weight_moment(rod, press):
    """Return the wrench of gravity alone on the base, [force; moment]."""
    s, w = nodes_of(rod, [press.s_contact])
    mass = w * rod.density * math.pi * rod.radius_at(s) ** 2
    return np.concatenate([mass.sum() * GRAVITY, np.cross(mass @ press.equilibrium.p_at(s), GRAVITY)])


@pytest.mark.parametrize("name", PRESSES)
def test_the_object_touches_the_surface_and_pushes_along_its_normal(name):
    press = pressed(name)
    rod, eq, L = PRESSES[name][1], press.equilibrium, PRESSES[name][1].length
    w = press.p_surface_base - eq.p_at(press.s_contact)
    along = -press.force_base / press.magnitude
    assert press.where in name
    if press.where == "flank":
        normal = surface_normal(rod, press)
        radius = float(rod.radius_at(press.s_contact)) / math.hypot(1.0, rod.taper_at(press.s_surface))
        np.testing.assert_allclose(w, radius * normal, atol=1e-9 * L)
        np.testing.assert_allclose(along, normal, atol=1e-9)
        np.testing.assert_array_equal(press.couple_base, 0.0)
    else:
        t = eq.R_at(L)[:, 2]
        assert press.s_contact == press.s_surface == L
        assert abs(w @ t) < 1e-9 * L
        np.testing.assert_allclose(press.couple_base, np.cross(w, press.force_base), atol=1e-12 * L)
    if press.where == "face":
        assert np.linalg.norm(w) < rod.radius[-1]
        np.testing.assert_allclose(along, t, atol=1e-9)
    if press.where == "rim":
        assert np.linalg.norm(w) == pytest.approx(rod.radius[-1], abs=1e-9 * L)
        assert abs(along @ np.cross(t, w)) < 1e-9 * rod.radius[-1]
        assert rod.taper_at(L) < (along @ t) / (along @ w / rod.radius[-1])  # leans out further than the flank


@pytest.mark.parametrize("name", [n for n in PRESSES if "line" in n])
def test_an_edge_pushes_across_itself(name):
    press = pressed(name)
    direction = press.touch.obstacle.direction
    assert abs(press.force_base @ direction) < 1e-9 * press.magnitude
    off = press.p_surface_base - press.touch.obstacle.point
    np.testing.assert_allclose(np.cross(off, direction), 0.0, atol=1e-15)


@pytest.mark.parametrize("name", [n for n in PRESSES if "flank" in n and "profile" not in n])
def test_the_push_found_is_the_push_that_was_given(name):
    press, rod = pressed(name), PRESSES[name][1]
    given = solve_frictionless(rod, GRAVITY, press.s_contact, press.angle, press.magnitude, "reference")
    # Both stop at 1e-10; the thin tip magnifies that.
    np.testing.assert_allclose(press.force_base, given.force_base, atol=1e-8 * press.magnitude)
    np.testing.assert_allclose(press.equilibrium.p_base[-1], given.equilibrium.p_base[-1], atol=1e-8 * rod.length)


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
    assert press.s_surface == pytest.approx(z, rel=1e-5)
    assert abs(press.angle) == pytest.approx(math.pi)
    # The flank yields along its normal by δ cos α: the axis by δ. What f sin α does to it is of the order α².
    assert press.magnitude == pytest.approx(stiffness * depth * math.hypot(1.0, tan), rel=1e-3)


@pytest.mark.parametrize("name", ["cone", "profile"])
@pytest.mark.parametrize("line", [False, True])
def test_turning_everything_about_the_axis_turns_the_answer(name, line):
    rod, angle = RODS[name], 0.9
    press = flank_press(rod, 0.6, 0.5, line)
    obstacle = press.touch.obstacle
    args = [turned(angle, v) for v in (GRAVITY, obstacle.point)]
    if line:
        args.append(turned(angle, obstacle.direction))
    against = press_against_line if line else press_against_point
    again = against(rod, *args, turned(angle, obstacle.travel), "reference")
    assert again.s_contact == pytest.approx(press.s_contact, abs=1e-10 * rod.length)
    np.testing.assert_allclose(again.force_base, turned(angle, press.force_base), atol=1e-9 * press.magnitude)


@pytest.mark.parametrize("name", ["cone", "profile"])
def test_in_its_plane_an_edge_across_it_is_a_point(name):
    rod, gravity = RODS[name], (9.81, 0.0, 0.0)
    p = rod.solve(gravity).p_at(0.7 * rod.length)
    travel = (-0.02, 0.0, 0.0)
    point = press_against_point(rod, gravity, p, travel, "reference", judged=False)
    line = press_against_line(rod, gravity, p, (0.0, -3.0, 0.0), travel, "reference")
    assert point.result == line.result == "ok"
    np.testing.assert_allclose(line.equilibrium.wrench_base, point.equilibrium.wrench_base, rtol=1e-9, atol=1e-12)
    assert line.s_surface == pytest.approx(point.s_surface, abs=1e-10)


def energy(rod, press):
    """Return the energy [J]: ∫ (m - t (m·t))²/(2 E I) + (m·t)²/(2 G J) - ρ A g·p ds, inextensible."""
    s, w = nodes_of(rod, [press.s_contact])
    y, p = press.equilibrium.states_at(s), press.equilibrium.p_at(s)
    t, m = y[:, 0:3], y[:, 3:6]
    twist = np.einsum("ij,ij->i", t, m)
    bend2 = np.einsum("ij,ij->i", m, m) - twist**2
    area = math.pi * rod.radius_at(s) ** 2
    EI = rod.youngs_modulus * area**2 / (4.0 * math.pi)
    GJ = rod.shear_modulus * area**2 / (2.0 * math.pi)
    elastic = (bend2 / EI + twist**2 / GJ) / 2.0
    return float(w @ (elastic - rod.density * area * (p @ GRAVITY)))


ENERGETIC = [n for n in PRESSES if "rooted" not in n and "face" not in n]  # a face yields by compression alone


@pytest.mark.parametrize("name", ENERGETIC)
def test_force_equals_energy_gradient(name):
    """dE = F · dq as the object moves by dq, whatever slides on whatever: without friction nothing is lost.

    With shear and stretch the contract's normal, which leans against the tangent and not against p', costs a
    little more; so the rod is inextensible here.
    """
    press, rod, *args = PRESSES[name]
    rod = replace(rod, inextensible=True, rigid_length=0.0)
    found = press(rod, *args)
    h = 1e-4 * rod.length
    for dq in np.eye(3):
        at = [energy(rod, press(rod, *args, moved=k * h * dq)) for k in (-2, -1, 1, 2)]
        slope = (8.0 * (at[2] - at[1]) - (at[3] - at[0])) / (12.0 * h)
        assert slope == pytest.approx(found.force_base @ dq, abs=1e-6 * found.magnitude)


@pytest.mark.parametrize("name", PRESSES)
def test_derivatives_are_those_of_differences(name):
    rod, found = PRESSES[name][1], pressed(name)
    h = (1e-5 if found.where == "flank" else 1e-7) * rod.length  # the tip yields along the axis like a column

    def at(dq):
        press = pressed(name, moved=dq)
        assert press.result == "ok" and press.where == found.where
        eq = press.equilibrium
        return np.concatenate(
            [
                eq.wrench_base,
                press.force_base,
                [press.s_contact],
                eq.p_contact_base,
                press.p_surface_base,
                press.couple_base,
            ]
        )

    rows = [
        found.d_wrench,
        found.d_force,
        found.touch.d_load[3:4],
        found.d_position,
        found.touch.d_point,
        found.touch.d_load[4:7],
    ]
    exact = np.vstack(rows)
    for j, dq in enumerate(h * np.eye(3)):
        wanted = (8.0 * (at(dq) - at(-dq)) - (at(2 * dq) - at(-2 * dq))) / (12.0 * h)
        for low, high in ((0, 3), (3, 6), (6, 9), (9, 10), (10, 13), (13, 16), (16, 19)):
            # Newton stops at 1e-12 of the length, over h; relative to the largest of its kind.
            scale = max(np.abs(exact[low:high]).max(), 1e-9)
            np.testing.assert_allclose(exact[low:high, j], wanted[low:high], atol=1e-6 * scale)


def test_an_edge_that_moves_along_itself_changes_nothing():
    press = flank_press(PROFILE, 0.5, 0.8, line=True)
    along = press.touch.obstacle.direction
    for d in (press.d_wrench, press.d_force, press.d_position, press.touch.d_load[3:4]):
        np.testing.assert_allclose(d @ along, 0.0, atol=1e-9 * np.abs(d).max())


def test_fast_is_close_to_reference():
    for name in PRESSES:
        fast, reference = pressed(name, mode="fast"), pressed(name)
        s = np.linspace(0.0, PRESSES[name][1].length, 7)
        off = np.linalg.norm(fast.equilibrium.p_at(s) - reference.equilibrium.p_at(s), axis=1).max()
        assert off <= 1e-6, name  # the documented accuracy of mode "fast"


@pytest.mark.parametrize("against", ["point", "line"])
def test_what_stays_outside_touches_nothing(against):
    travel, end = (-0.05, 0.0, 0.0), (0.02, 0.0, 0.1)
    extra = [(0.0, 1.0, 0.0)] if against == "line" else []
    press = (press_against_line if extra else press_against_point)(CONE, (0, 0, 0), end, *extra, travel)
    assert press.result == "no_contact" and not press.lost and press.where == ""
    assert math.isnan(press.s_contact) and np.isnan(press.force_base).all()
    np.testing.assert_allclose(press.equilibrium.p_base[-1], [0.0, 0.0, 0.15])


@pytest.mark.parametrize("height", [0.03, 0.149])
def test_the_first_touch_is_where_the_surface_is(height):
    r = float(CONE.radius_at(height))
    for offset in (0.0, 0.7):
        point = (r * math.sqrt(1.0 - offset**2) - 1e-5, offset * r, height)
        press = press_against_point(CONE, (0, 0, 0), point, (-0.03, 0.0, 0.0))
        assert press.result == "ok"
        assert press.way_touched == pytest.approx(0.03 - 1e-5, abs=1e-6 * CONE.length), offset


@pytest.mark.parametrize("offset", [0.01, 0.3, 0.8])
def test_a_point_slips_round_a_round_rod(offset):
    """Free to yield alike to all sides, the axis keeps r from the point by the shortest way: the force ends
    where the point has passed the free rod, 2 √(r² - y²) further on."""
    r = 3e-3
    press = press_against_point(CONE, (0, 0, 0), (-0.02, offset * r, 0.09), (-0.04, 0.0, 0.0))
    assert press.result == "no_contact" and press.lost
    through = press.way_followed - press.way_touched
    assert through == pytest.approx(2.0 * r * math.sqrt(1.0 - offset**2), rel=1e-3)  # bent little: 1 : 30


def test_an_axial_press_buckles_in_place():
    r = 3e-3
    press = press_against_point(CONE, (0, 0, 0), (-0.004, 0.0, 0.09), (-0.024, 0.0, 0.0))
    assert press.result == "unstable" and np.isnan(press.force_base).all()
    assert press.way_followed - press.way_touched == pytest.approx(r, rel=1e-3)
    kept = press_against_point(CONE, (0, 0, 0), (-0.004, 0.0, 0.09), (-0.024, 0.0, 0.0), judged=False)
    assert kept.result == "ok" and abs(kept.force_base[1]) < 1e-12


@pytest.mark.parametrize("name", ["cone", "cylinder", "profile"])
def test_an_edge_slides_off_the_tip(name):
    rod = RODS[name]
    z = 0.97 * rod.length
    press = press_against_line(rod, (0, 0, 0), (-0.5 * rod.length, 0, z), (0, 1, 0), (-0.6 * rod.length, 0, 0))
    assert press.result == "no_contact" and press.lost
    x = 0.1 * rod.length - press.way_followed + 1e-6
    before = press_against_line(rod, (0, 0, 0), (x, 0, z), (0, 1, 0), (x - 0.1 * rod.length, 0, 0))
    assert before.result == "ok" and before.where == "flank"
    assert before.s_surface == pytest.approx(rod.length, abs=1e-4)


def test_a_column_pressed_on_its_end():
    """f = E A δ/L of what is left of L, until it buckles under a dead load: π² E I/(4 L²)."""
    rod = replace(CYLINDER, density=0.0)
    L, r = rod.length, 2e-3
    E_A = rod.youngs_modulus * math.pi * r**2
    for depth, result in ((1e-4, "ok"), (2.3e-4, "ok"), (2.6e-4, "unstable")):
        press = press_against_point(rod, (0, 0, 0), (0, 0, L * (1 - depth)), (0, 0, -0.2 * L), "reference")
        assert press.result == result, depth
        if result == "ok":
            assert press.where == "face"
            np.testing.assert_allclose(press.force_base, [0.0, 0.0, -E_A * depth], rtol=1e-9, atol=1e-12)
            assert press.d_force[2, 2] == pytest.approx(E_A / L, rel=1e-9)


def test_a_cone_pressed_on_its_end_bows_out_from_under_the_point():
    """As the flat end turns, so does the force, and its point of attack stays: ½ ∫ E I w''² - f/2 ∫ w'² + f w(L) w'(L)
    loses its minimum at 0.01704 N by Hermite elements, before a dead load's 0.0205 N."""
    press = press_against_point(CONE, (0, 0, 0), (0, 0, 0.149), (0, 0, -0.02))
    assert press.result == "unstable"
    short = press.way_followed - press.way_touched
    r0, r1 = CONE.radius
    stiffness = CONE.youngs_modulus * math.pi * r0 * r1 / CONE.length
    assert stiffness * short == pytest.approx(0.01704, rel=0.01)  # the column also shortens and shears


@pytest.mark.parametrize("fraction", [0.36, 0.5])
def test_over_the_knots_of_a_profile_the_press_goes_on(fraction):
    """The radius of the profile increases in places, so an edge that slides outwards meets a groove and a ridge."""
    rod = Rod(np.array([0.0, 0.05, 0.07, 0.12]), np.array([4e-3, 2e-3, 2.5e-3, 1.5e-3]), 1e6, 0.3e6, 1100.0)
    seen, last = set(), None
    for depth in np.linspace(1e-4, 0.05, 25):
        p = np.array([1.8e-3 - depth, 0.0, fraction * rod.length])
        press = press_against_line(rod, (0, 0, 0), p, (0, 1, 0), (-0.01 - depth, 0.0, 0.0))
        if press.result != "ok":
            break
        seen.add(press.touch.index)
        if last is not None:
            assert abs(press.s_surface - last.s_surface) < 0.08 * rod.length
        last = press
    assert len(seen) >= 2 and last.s_surface > (fraction + 0.05) * rod.length


@pytest.mark.parametrize("bad", [(math.nan, 0, 0), (0, math.inf, 0), (1, 2), "here", None])
def test_what_is_no_place_is_refused(bad):
    with pytest.raises(InputError, match="three finite numbers"):
        press_against_point(CONE, GRAVITY, bad, (-0.1, 0, 0))
    with pytest.raises(InputError, match="three finite numbers"):
        press_against_line(CONE, GRAVITY, (0, 0, 0.1), (0, 1, 0), bad)


def test_a_path_must_start_clear_and_a_line_must_have_a_direction():
    with pytest.raises(InputError, match="clear of the rod"):
        press_against_point(CONE, GRAVITY, (0, 0, 0.05), (0, 0, 0))
    with pytest.raises(InputError, match="a million lengths"):
        press_against_point(CONE, GRAVITY, (0, 0, 0.05), (1e200, 0, 0))
    with pytest.raises(InputError, match="must not be zero"):
        press_against_line(CONE, GRAVITY, (0, 0, 0.05), (0, 0, 0), (1, 0, 0))


@pytest.mark.parametrize("travel", [(0, 0, 0), (1e-30, 0, 0), (1e5, 1e5, 0), (-1e5, 0, 0), (0, 0, 1e5)])
def test_absurd_ways_end(travel):
    press = press_against_point(CONE, (9.81, 0, 0), (0.05, 0.0, 0.05), travel)
    assert press.result in ("ok", "no_contact", "unstable", "not_converged")
    line = press_against_line(CONE, (9.81, 0, 0), (0.05, 0.0, 0.05), (0, 1, 0), travel)
    assert line.result in ("ok", "no_contact", "unstable", "not_converged")


def test_the_clamp_itself_does_not_yield():
    press = press_against_point(ROOTED_CONE, (0, 0, 0), (5e-3, 0, 1e-5), (-0.05, 0, 0))
    assert press.result == "not_converged" and not press.lost


def test_an_unstable_free_rod_has_nothing_to_press():
    soft = replace(CONE, youngs_modulus=100.0, shear_modulus=33.0)
    press = press_against_point(soft, (0, 0, -9.81), (0.0, 0.0, 0.1), (-1.0, 0, 0))
    assert press.result in ("unstable", "not_converged") and press.where == ""


def test_only_a_round_section_has_this_surface():
    oval = replace(CONE, factors=(1.0, 1.0, 0.25, 0.4))
    with pytest.raises(InputError, match="round"):
        press_against_point(oval, (0, 0, 0), (0, 0, 0.1), (-0.1, 0, 0))
