"""Coulomb friction between the rod and a fixed object: stick, slip, and the statics of both.

Directions and places are compared in the axes of the bent section at the touched point.
"""

import math
from itertools import pairwise

import numpy as np
import pytest
from rods import CONE, CYLINDER, ELLIPTIC, PROFILE, ROOTED_CONE, approach, surface_point

from probedesign.core.errors import InputError
from probedesign.rod.contact import line_of_action, solve_surface_force
from probedesign.rod.friction import CoulombSolver, draw_friction

GRAVITY = np.array([6.0, 5.0, -6.0])
RODS = {"cone": CONE, "rooted": ROOTED_CONE, "cylinder": CYLINDER, "profile": PROFILE, "elliptic": ELLIPTIC}


def followed(solver, first, point, steps=12):
    """Return the contacts at equal steps of a straight path without the first."""
    contacts, start = [first], first.object_point
    for i in range(1, steps + 1):
        contacts.append(solver.advance(contacts[-1], start + i / steps * (np.asarray(point) - start)))
    return contacts[1:]


@pytest.mark.parametrize("line", [False, True])
@pytest.mark.parametrize(("name", "friction"), [("cone", 0.1), ("profile", 1.0), *((name, 0.5) for name in RODS)])
def test_coulombs_law_at_the_touched_point(name, friction, line):
    """In every step: the touched point is the object's, a line is tangent, the force stays in the cone, and where it
    slips it lies on the cone and drags the rod with the object."""
    rod = RODS[name]
    point, travel, d = approach(rod, GRAVITY, line=line)
    solver = CoulombSolver(rod, friction, "reference")
    first = solver.touch(GRAVITY, point, travel, d)
    assert first.ok and first.magnitude == 0.0
    states = set()
    for contact in followed(solver, first, point):
        x, normal = surface_point(rod, contact.equilibrium, contact.s, contact.angle)
        states.add(contact.state)
        assert contact.ok and contact.normal_force > 0.0
        assert np.linalg.norm(x - contact.p_surface_base) < 1e-9
        assert np.allclose(normal, contact.normal, atol=1e-9) or name == "profile"
        assert contact.tangential_force <= friction * contact.normal_force * (1.0 + 1e-9)
        arm = contact.p_surface_base - contact.equilibrium.p_contact_base
        assert np.allclose(contact.couple_base, np.cross(arm, contact.force_base), rtol=0.0, atol=1e-13)
        if line:
            assert abs(contact.normal @ contact.direction) < 1e-9
        if contact.state == "slip":
            assert contact.tangential_force == pytest.approx(friction * contact.normal_force, rel=1e-9)
            slide, drag = contact.slide, contact.tangential_force_base
            parallel = slide @ drag / (np.linalg.norm(slide) * np.linalg.norm(drag))
            assert parallel == pytest.approx(1.0, abs=1e-6)
    assert "slip" in states or friction == 1.0


@pytest.mark.parametrize("name", ["cone", "profile", "elliptic"])
def test_the_base_bears_the_contact_and_the_weight(name):
    """Force F + m g and moment x × F + ∫ p × ρ A g ds, integrated by Gauss's rule between the knots."""
    rod = RODS[name]
    point, travel, _ = approach(rod, GRAVITY)
    contact = CoulombSolver(rod, 0.5, "reference").press(GRAVITY, point, travel)
    nodes, weights = np.polynomial.legendre.leggauss(12)
    breaks = np.unique(np.concatenate([rod.s, [contact.s]]))
    low, high = breaks[:-1, None], breaks[1:, None]
    s = (0.5 * (high - low) * nodes + 0.5 * (high + low)).ravel()
    ds = (0.5 * (high - low) * weights).ravel()
    weight = rod.density * rod.factors[0] * np.pi * rod.radius_at(s) ** 2 * ds
    force = contact.force_base + weight.sum() * GRAVITY
    moment = np.cross(contact.p_surface_base, contact.force_base) + np.cross(
        weight @ contact.equilibrium.p_at(s), GRAVITY
    )
    felt = contact.equilibrium.wrench_base
    assert np.allclose(felt[:3], force, rtol=1e-9, atol=1e-12)
    assert np.linalg.norm(felt[3:] - moment) <= 1e-7 * np.linalg.norm(moment)


def led_along(solver, steps=40, step=5e-8):
    """Pressed squarely onto the flank, then led towards the tip in so many steps of the path, and back.

    A rod is stiff along its axis: while it is pressed, its material point is drawn along under the object and slips
    towards the base, and μ F_n bends it back and forth by a micrometre.
    """
    gravity = np.zeros(3)
    point, travel, _ = approach(solver.rod, gravity, 0.5, 0.3, 0.0)
    pressed = CoulombSolver(solver.rod, 0.4, "reference").press(gravity, point, travel)
    out = [pressed]
    for i in range(1, steps + 1):
        out.append(solver.advance(out[-1], point + i * step * np.array([0.0, 0.0, 1.0])))
    back = [out[-1]]
    for i in range(steps - 1, -1, -1):
        back.append(solver.advance(back[-1], point + i * step * np.array([0.0, 0.0, 1.0])))
    return out, back[1:]


def drag(contact):
    """Return the force along the rod over the normal force, positive towards the tip."""
    t = contact.equilibrium.R_at(contact.s)[:, 2]
    return float(contact.tangential_force_base @ t) / contact.normal_force


def test_a_ramp_sticks_then_slips_and_sticks_again_when_reversed():
    """Led towards the tip, the drag grows from one side of the cone to the other while the material point stays, then
    the object slides towards the tip. Turned back it sticks at once, and slides towards the base at last."""
    friction = 0.4
    out, back = led_along(CoulombSolver(CYLINDER, friction, "reference"))
    assert out[0].state == "slip" and drag(out[0]) == pytest.approx(-friction, rel=1e-2)
    for way, sign in ((out[1:], 1.0), (back, -1.0)):
        states = [contact.state for contact in way]
        turn = states.index("slip")
        assert turn >= 5 and set(states[:turn]) == {"stick"} and set(states[turn:]) == {"slip"}
        stuck, slid = way[:turn], way[turn:]
        assert all(abs(contact.s - stuck[0].s) < 1e-13 for contact in stuck)
        rise = sign * np.diff([drag(contact) for contact in stuck])
        assert (rise > 0.0).all() and np.ptp(rise) < 0.15 * rise[0]  # the normal force changes a little too
        # The next step would leave the cone, and does not.
        assert sign * drag(stuck[-1]) <= friction < sign * drag(stuck[-1]) + 1.1 * rise[-1]
        assert all(sign * drag(c) == pytest.approx(friction, rel=1e-2) for c in slid)
        assert all(c.tangential_force == pytest.approx(friction * c.normal_force, rel=1e-9) for c in slid)
        assert (sign * np.diff([contact.s for contact in slid]) > 0.0).all()


def test_contact_equals_sticking_up_to_the_transition():
    friction = 0.4
    free, bound = (led_along(CoulombSolver(CYLINDER, mu, "reference"))[0] for mu in (friction, math.inf))
    assert {contact.state for contact in bound[1:]} == {"stick"}
    over = [contact.tangential_force > friction * contact.normal_force for contact in bound[1:]]
    assert [contact.state == "slip" for contact in free[1:]] == over and any(over)
    for one, other in zip(free[1:], bound[1:], strict=True):
        if one.state == "stick":
            assert np.allclose(one.force_base, other.force_base, rtol=1e-7, atol=1e-12)


def test_sticking_is_path_independent():
    """Without slip the force depends on the place alone: a loop leads back to it."""
    point, travel, _ = approach(CONE, GRAVITY)
    begun = CoulombSolver(CONE, 0.5, "reference").press(GRAVITY, point, travel)
    solver = CoulombSolver(CONE, math.inf, "reference")
    moved = solver.advance(begun, point + np.array([0.0, 1e-5, 1e-6]))
    again = solver.advance(solver.advance(moved, point + np.array([1e-5, 0.0, 0.0])), point)
    assert again.state == "stick"
    assert np.linalg.norm(moved.force_base - begun.force_base) > 1e-3 * begun.magnitude
    assert np.allclose(again.force_base, begun.force_base, rtol=0.0, atol=1e-6 * begun.magnitude)


def test_steps_of_the_path_hardly_matter():
    """The direction of sliding rotates during the motion; halving the steps has a small, first-order effect."""
    point, travel, _ = approach(CONE, GRAVITY)
    solver = CoulombSolver(CONE, 0.5, "reference")
    first = solver.touch(GRAVITY, point, travel)
    forces = [followed(solver, first, point, steps)[-1].force_base for steps in (16, 32, 64)]
    rough, fine = (np.linalg.norm(a - b) for a, b in pairwise(forces))
    assert fine < 0.7 * rough < 0.02 * np.linalg.norm(forces[-1])


def test_moving_away_ends_the_contact():
    """No force at the end, at any step a push: there is no adhesion."""
    point, travel, _ = approach(CONE, GRAVITY)
    solver = CoulombSolver(CONE, 0.5, "reference")
    contact = solver.press(GRAVITY, point, travel)
    left = followed(solver, contact, point - travel, 40)
    ok = [c.ok for c in left]
    assert ok[0] and not ok[-1] and sorted(ok, reverse=True) == ok
    assert all(c.normal_force > 0.0 for c in left if c.ok)
    assert left[-1].result == "no_contact" and left[-1].equilibrium.ok
    assert np.isnan(left[-1].force_base).all()
    assert solver.advance(left[-1], point) is left[-1]


@pytest.mark.parametrize("line", [False, True])
def test_an_object_that_yields_is_the_rigid_one_at_the_yielded_point(line):
    """Without friction the contact does not depend on the path, so it is that of a rigid object which ends there."""
    point, travel, d = approach(CONE, GRAVITY, line=line)
    soft = CoulombSolver(CONE, 0.0, "reference", compliance=0.2).press(GRAVITY, point, travel, d)
    assert soft.ok
    moved = -0.2 * soft.force_base
    assert np.linalg.norm(moved) > 1e-4
    hard = CoulombSolver(CONE, 0.0, "reference").press(GRAVITY, point + moved, travel + moved, d)
    # The tolerance of the solver is 1e-11 of the length, which the depth is about a hundredth of.
    assert np.allclose(soft.force_base, hard.force_base, rtol=0.0, atol=1e-8 * soft.magnitude)
    assert np.allclose(soft.p_surface_base, hard.p_surface_base, rtol=0.0, atol=1e-9 * CONE.length)
    assert np.allclose(soft.p_surface_base - soft.p_rest_base, moved, rtol=0.0, atol=1e-15)


def test_an_edge_may_roll_without_sliding():
    """A line across a sticking rod that is led along itself takes the rod along; the touched place moves on both."""
    point, travel, d = approach(CYLINDER, np.zeros(3), line=True)
    begun = CoulombSolver(CYLINDER, 0.5, "reference").press(np.zeros(3), point, travel, d)
    solver = CoulombSolver(CYLINDER, math.inf, "reference")
    moved = solver.advance(begun, point + 1e-5 * d / np.linalg.norm(d))
    assert moved.state == "stick"
    rolled = CYLINDER.radius[0] * (moved.angle - begun.angle)
    along = math.hypot(moved.s - begun.s, rolled)
    assert along > 1e-7
    assert abs(moved.way - begun.way) == pytest.approx(along, rel=0.01)


def test_results_without_a_contact_are_codes():
    solver = CoulombSolver(CONE, 0.5)
    missed = solver.press(GRAVITY, (0.05, 0.05, 0.1), (0.0, 0.0, -0.02))
    assert (missed.result, missed.state) == ("no_contact", "")
    end = solver.press((0, 0, 0), (0.0, 0.0, 0.149), (0.0, 0.0, -0.02))
    assert end.result == "on_end"
    r = float(CONE.radius_at(0.14))
    begun = solver.press((0, 0, 0), (0.5 * r, 0.0, 0.14), (-0.02, 0.0, 0.0))
    gone = solver.advance(begun, (-0.5 * r, 0.0, 0.20))
    assert begun.ok and gone.result in ("on_end", "no_contact", "unstable") and np.isnan(gone.force_base).all()


@pytest.mark.parametrize(
    "wrong", [{"friction": -0.1}, {"friction": math.nan}, *({"compliance": c} for c in (-0.1, math.nan, math.inf))]
)
def test_a_friction_or_compliance_out_of_range_is_refused(wrong):
    with pytest.raises(InputError, match=f"{next(iter(wrong))} = .* not"):
        CoulombSolver(CONE, **{"friction": 0.5} | wrong)


@pytest.mark.parametrize("name", RODS)
def test_a_given_force_on_the_surface_is_that_of_the_contact(name):
    """With the components of a solved contact, the same equilibrium follows."""
    rod = RODS[name]
    point, travel, _ = approach(rod, GRAVITY, 0.6, 0.4)
    contact = CoulombSolver(rod, 0.5, "reference").press(GRAVITY, point, travel)
    reach = math.hypot(math.cos(contact.angle), rod.flatness * math.sin(contact.angle))
    R, alpha = contact.equilibrium.R_at(contact.s), math.atan(reach * rod.taper_at(contact.s))
    e, h = (R @ [math.cos(phi), math.sin(phi), 0.0] for phi in (contact.angle, contact.angle + math.pi / 2.0))
    normal = math.cos(alpha) * e + math.sin(alpha) * R[:, 2]  # of the straight rod, by which the force is given
    normal_force = -float(contact.force_base @ normal)
    ratios = tuple(float(contact.force_base @ v) / normal_force for v in (np.cross(normal, h), h))
    given = solve_surface_force(rod, GRAVITY, contact.s, contact.angle, normal_force, ratios, "reference")
    assert given.result == "ok"
    assert np.allclose(given.force_base, contact.force_base, rtol=0.0, atol=1e-7 * contact.magnitude)
    assert np.allclose(given.p_surface_base, contact.p_surface_base, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("ratios", [(0.0, 0.0), (0.5, 0.0), (-0.3, 0.4)])
def test_where_the_line_of_action_passes_the_axis(ratios):
    """There the force has no couple about the axis across it and the rod; r tan α nearer the base without friction.

    The rod is bent by 2e-3 or less over that way."""
    found = solve_surface_force(CONE, (0, 0, 0), 0.1, 0.3, 1e-3, ratios, "reference")
    eq = found.equilibrium
    s = line_of_action(CONE, eq, found.p_surface_base)
    r, tan = float(CONE.radius_at(0.1)), CONE.taper_at(0.1)
    cos = 1.0 / math.hypot(1.0, tan)
    along, out = -cos * tan + ratios[0] * cos, -cos - ratios[0] * cos * tan
    assert s == pytest.approx(0.1 - r * along / out, abs=1e-9)
    couple = np.cross(found.p_surface_base - eq.p_at(s), found.force_base)
    R = eq.R_at(0.1)
    h = math.cos(0.3) * R[:, 1] - math.sin(0.3) * R[:, 0]
    assert abs(couple @ h) <= 2e-3 * r * np.linalg.norm(found.force_base)


def test_friction_differs_from_touch_to_touch_about_its_median():
    """Of 2000 lognormal draws the median is known to 1.25 σ/√2000 = 0.6 %, the spread to σ/√4000; thrice that."""
    rng = np.random.default_rng(1)
    drawn = np.array([draw_friction(0.5, 0.2, rng) for _ in range(2000)])
    assert np.median(drawn) == pytest.approx(0.5, rel=0.02)
    assert np.std(np.log(drawn)) == pytest.approx(0.2, rel=0.05)
    assert draw_friction(0.0, 0.2, rng) == 0.0 and draw_friction(0.5, 0.0, rng) == 0.5
