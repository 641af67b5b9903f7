"""Compare the compiled linearisation of a touch with repeated solves of the reference rod."""

from dataclasses import replace

import numpy as np
import pytest

from probedesign.core.frames import rotation_z
from probedesign.estimation.error_sources import FINE
from probedesign.estimation.multistart import contact_arclengths
from probedesign.geometry.cross_section import CrossSection
from probedesign.rod.kernels.surface_contact import (
    BY_GRAVITY,
    BY_PARAMETER,
    BY_TOUCH,
    CENTRE,
    DEAD,
    OWN,
    POINT,
    ROWS,
    TIP,
    TOUCH,
    UNKNOWNS,
    VALUE,
    linearise_touch,
    work_size,
)
from probedesign.rod.rod import Rod
from tests.reference.surface_contact import SurfaceTouch, derivatives, solve_touch

GRAVITY = np.array([9.81, 1.0, -2.0])
MATERIAL = {"youngs_modulus": 2.32e6, "shear_modulus": 0.761e6, "density": 1010.0}
CONE = Rod(np.array([0.0, 0.15]), np.array([6e-3, 1e-3]), **MATERIAL, rigid_length=0.12 * 6e-3, finite_strain=True)
RODS = {
    "cone": CONE,
    "cylinder": Rod(np.array([0.0, 0.1]), np.array([3e-3, 3e-3]), **MATERIAL),
    "swelling profile": Rod(
        1e-3 * np.array([0.0, 40.0, 80.0, 120.0]), 1e-3 * np.array([5.0, 2.5, 3.0, 1.0]), **MATERIAL, finite_strain=True
    ),
    "hollow": replace(CONE, finite_strain=False, factors=(0.75, 0.9375, 0.9375, 0.9375)),
    "arc": replace(CONE, rest_curvature=np.tile([10.0, 0.0, 0.0], (2, 1))),
    "bent and twisted profile": Rod(
        1e-3 * np.array([0.0, 40.0, 80.0, 120.0]),
        1e-3 * np.array([5.0, 3.5, 3.0, 1.0]),
        **MATERIAL,
        rest_curvature=np.array([[6.0, -4.0, 5.0], [-4.0, 8.0, 20.0], [0.0, 6.0, -8.0], [10.0, 0.0, 2.0]]),
    ),
    "elliptic": replace(CONE, finite_strain=False, factors=CrossSection(flatness=0.7).factors),
}
#: Fraction of the length, angle, normal force [N], ratios of friction.
TOUCHES = {
    "near the base, oblique": (0.25, 0.5, 0.2, 0.2, -0.3),
    "mid, without friction": (0.6, -1.6, 0.02, 0.0, 0.0),
    "far, sliding towards the base": (0.8, 2.2, 0.01, -0.5, 0.5),
    "tip": (0.95, 1.0, 0.004, 0.3, 0.3),
}


def _arclength(rod, touch):
    """Arclength of the centreline point nearest to the line of action [m]."""
    found = np.empty(1)
    contact_arclengths(rod.body, touch[None].copy(), found)
    return float(found[0])


def at(rod, name):
    """Return the touch of a rod with this name."""
    fraction, *rest = TOUCHES[name]
    return SurfaceTouch(fraction * rod.length, *rest)


def compiled(rod, gravity, touch, tip=None):
    """Return the linearisation, (ROWS, 1 + 5 + OWN + K), of a converged touch, and the touch, (TOUCH,)."""
    settled = np.zeros(TOUCH)
    settled[:UNKNOWNS] = touch.s, touch.phi, touch.normal, touch.around, touch.along
    settled[TIP:] = rod.solve(gravity).tip if tip is None else tip
    parameters = OWN + len(rod.s)
    lin, work = np.empty((ROWS, 1 + UNKNOWNS + parameters)), np.empty(work_size(parameters))
    assert linearise_touch(
        rod.body, np.asarray(gravity, dtype=float), rod.mass, FINE, settled, True, parameters, work, lin
    )
    return lin, settled


@pytest.fixture(scope="module", params=[(rod, touch) for rod in RODS for touch in TOUCHES], ids=" ".join)
def case(request):
    rod = RODS[request.param[0]]
    touch = at(rod, request.param[1])
    oracle = solve_touch(rod, GRAVITY, touch)
    return rod, touch, oracle, *compiled(rod, GRAVITY, touch, oracle.equilibrium.tip)


def test_wrench_and_points_are_those_of_the_reference(case):
    rod, touch, oracle, lin, settled = case
    # A sweep errs by FINE = 5e-7 rad a step; dead loads agree with the turned section to 1e-4 squared of the force.
    np.testing.assert_allclose(lin[:3, VALUE], oracle.wrench[:3], atol=1e-8 + 1e-7 * touch.normal, rtol=0)
    np.testing.assert_allclose(lin[3:6, VALUE], oracle.wrench[3:], atol=1e-6 * np.abs(oracle.wrench[3:]).max(), rtol=0)
    np.testing.assert_allclose(lin[POINT:CENTRE, VALUE], oracle.p_surface, atol=2e-8, rtol=0)
    np.testing.assert_allclose(settled[DEAD : DEAD + 3], oracle.force, atol=1e-4 * touch.normal, rtol=0)
    # From the touched section to the nearest point of the centreline the kernel goes along a parabola: of third order
    # in the way, which is up to half a radius.
    assert np.linalg.norm(lin[CENTRE : CENTRE + 3, VALUE] - oracle.p_contact) < 2e-5
    assert _arclength(rod, settled) == pytest.approx(oracle.s_contact, abs=1e-12)


def test_derivatives_by_the_unknowns_are_differences(case):
    rod, touch, _oracle, lin, _settled = case
    by_hand = derivatives(rod, GRAVITY, touch)
    own = lin[:12, BY_TOUCH:BY_PARAMETER]
    for rows, allowed in ((slice(0, 3), 5e-4), (slice(3, 6), 5e-4), (slice(6, 9), 5e-4), (slice(9, 12), 3e-2)):
        # Central differences over 1e-6 m of a reference solve with 1e-11: 1e-4. The centreline point neglects how
        # the curve changes on the way from the touched section.
        scale = np.abs(by_hand[rows]).max(axis=0)
        assert (np.abs(own[rows] - by_hand[rows]) <= allowed * scale + 1e-12).all(), rows


def moved(rod, j, by):
    """Return rod, gravity and factor of the arclength with one parameter changed: gravity (3), then logarithms,
    the curvature at rest (2) [1/m] among them."""
    gravity, factor = GRAVITY.copy(), np.exp(by)
    if j < 3:
        gravity[j] += by
        return rod, gravity, 1.0
    if j < 6:
        name = ("youngs_modulus", "shear_modulus", "density")[j - 3]
        return replace(rod, **{name: factor * getattr(rod, name)}), gravity, 1.0
    rest = np.zeros((len(rod.s), 3)) if rod.rest_curvature is None else rod.rest_curvature
    if j == 6:  # the axis keeps its shape
        return replace(rod, s=factor * rod.s, rest_curvature=rest / factor), gravity, factor
    if j < OWN:
        return replace(rod, rest_curvature=rest + by * np.eye(3)[j - 7]), gravity, 1.0
    radius = rod.radius.copy()
    radius[j - OWN] *= factor
    return replace(rod, radius=radius), gravity, 1.0


@pytest.mark.parametrize("touch_name", list(TOUCHES)[:3])
@pytest.mark.parametrize(
    "rod_name", ["cone", "swelling profile", "hollow", "elliptic", "arc", "bent and twisted profile"]
)
def test_derivatives_by_the_probe_are_those_of_other_probes(rod_name, touch_name):
    """The touch keeps its place over the length. The rods have no bonded root: its reach depends on the base radius."""
    rod = replace(RODS[rod_name], rigid_length=0.0)
    touch = at(rod, touch_name)
    lin, _settled = compiled(rod, GRAVITY, touch, solve_touch(rod, GRAVITY, touch).equilibrium.tip)
    for j in range(OWN + len(rod.s)):
        h = 1e-3 if j < 3 or j in (7, 8) else 1e-4
        rows = []
        for way in (h, -h):
            other, gravity, factor = moved(rod, j, way)
            solved = solve_touch(other, gravity, replace(touch, s=factor * touch.s))
            rows.append(np.concatenate([solved.wrench, solved.p_surface, solved.p_contact]))
        by_hand, column = (rows[0] - rows[1]) / (2.0 * h), lin[:12, BY_GRAVITY + j]
        for block, allowed in ((slice(0, 3), 1e-3), (slice(3, 6), 1e-3), (slice(6, 9), 1e-3), (slice(9, 12), 0.1)):
            # Of the column, and what a millionth of force, moment and length leaves; how the axis curves between the
            # touched section and the nearest point is neglected in the last rows, half a millimetre times radians.
            size = np.abs(rows[0][block]).max()
            assert np.abs(column[block] - by_hand[block]).max() <= (
                allowed * np.abs(by_hand[block]).max() + 1e-6 * size
            ), (j, block)


@pytest.mark.parametrize("touch_name", TOUCHES)
def test_the_root_does_not_disturb_other_derivatives(touch_name):
    """With a bonded root: E, G, density and the tip's diameter."""
    touch = at(CONE, touch_name)
    lin, _ = compiled(CONE, GRAVITY, touch, solve_touch(CONE, GRAVITY, touch).equilibrium.tip)
    for j in (3, 4, 5, OWN + 1):
        rows = []
        for way in (1e-4, -1e-4):
            other, gravity, _factor = moved(CONE, j, way)
            solved = solve_touch(other, gravity, touch)
            rows.append(np.concatenate([solved.wrench[3:], solved.p_surface]))
        by_hand, column = (rows[0] - rows[1]) / 2e-4, lin[3:9, BY_GRAVITY + j]
        for block in (slice(0, 3), slice(3, 6)):
            size = np.abs(rows[0][block]).max()
            assert np.abs(column[block] - by_hand[block]).max() <= (
                1e-3 * np.abs(by_hand[block]).max() + 1e-6 * size
            ), j


@pytest.mark.parametrize("fraction", [0.3, 0.6, 0.9])
def test_without_friction_the_line_of_action_meets_the_axis_nearer_the_base(fraction):
    """The cone's normal leans towards the tip by α: s_contact = s - r tan α, and no couple is left about that point."""
    touch = SurfaceTouch(fraction * CONE.length, 0.7, 0.01)
    lin, settled = compiled(CONE, GRAVITY, touch)
    tan, r = CONE.taper_at(touch.s), float(CONE.radius_at(touch.s))
    assert _arclength(CONE, settled) == pytest.approx(touch.s - r * tan, abs=1e-12)
    F = lin[:3, VALUE] - CONE.mass * GRAVITY
    arm = lin[POINT:CENTRE, VALUE] - lin[CENTRE : CENTRE + 3, VALUE]
    # The axis curves by κ (r tan α)²/2 on the way, less than a micrometre.
    assert np.linalg.norm(np.cross(arm, F)) <= 1e-6 * np.linalg.norm(F)


@pytest.mark.parametrize("touch_name", TOUCHES)
def test_an_elliptic_probe_turned_by_a_right_angle_has_its_axes_exchanged(touch_name):
    """Its half-width along x is then f r, and 1/f times that along y; a bonded root reaches as far as x is wide."""
    flat = replace(RODS["elliptic"], rigid_length=0.0)
    f = flat.flatness
    exchanged = replace(flat, radius=f * flat.radius, factors=(1 / f, 1 / f**3, 1 / f, 2.0 / f / (f * f + 1.0)))
    touch, turn = at(flat, touch_name), rotation_z(np.pi / 2.0)[:3, :3]
    a, _ = compiled(flat, GRAVITY, touch)
    b, _ = compiled(exchanged, turn @ GRAVITY, replace(touch, phi=touch.phi + np.pi / 2.0))
    for rows in (slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12)):
        # Some ten steps of the sweep err by 5e-7 rad each and fall otherwise; the derivatives as above.
        np.testing.assert_allclose(turn @ a[rows, VALUE], b[rows, VALUE], atol=1e-5 * np.abs(a[rows, VALUE]).max())
        own = a[rows, BY_TOUCH:BY_PARAMETER]
        assert (np.abs(turn @ own - b[rows, BY_TOUCH:BY_PARAMETER]) <= 1e-4 * np.abs(own).max(axis=0)).all()


def test_a_touch_that_the_probe_does_not_hold_has_no_linearisation():
    """The probe has no equilibrium under half a newton at its thin tip."""
    touch, lin = np.zeros(TOUCH), np.empty((ROWS, 1 + UNKNOWNS))
    touch[:3] = 0.95 * CONE.length, 0.3, 0.5
    touch[TIP:] = CONE.solve(GRAVITY).tip
    assert not linearise_touch(CONE.body, GRAVITY, CONE.mass, FINE, touch, True, 0, np.empty(work_size(0)), lin)
