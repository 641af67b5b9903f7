"""Tests of the press that all simulators of objects in space share."""

import math

import numpy as np
import pytest

from probedesign.core.errors import InputError
from probedesign.core.units import MILLINEWTON, MM
from probedesign.rod.contact import safe_force
from probedesign.rod.friction import CoulombSolver, press_against_line
from probedesign.simulation.scenes import CLEARANCE, MAX_DEPTH, StraightPress, press_scene
from tests.live.conftest import bundle as bundle
from tests.live.conftest import estimator as estimator

ALONG = np.array([0.0, 1.0, 0.0])


def press_at(model, friction, fraction=0.6, compliance=0.0):
    """Return a press against an edge that starts 3 mm before the free probe."""
    free = model.rod.solve(model.gravity_base)
    s = fraction * model.rod.length
    direction = np.cross(ALONG, free.R_at(s)[:, 2])
    start = free.p_at(s) + (float(model.rod.radius_at(s)) + 3.0 * MM) * direction
    solver = CoulombSolver(model.rod, friction, compliance=compliance)
    return StraightPress(solver, model.gravity_base, start, direction, ALONG)


@pytest.mark.parametrize("friction", [0.0, 0.5])
def test_the_travel_gives_the_force(estimator, friction):
    """The travel is found to a micrometre; the probe is softer than 2 N/m there."""
    press = press_at(estimator.model, friction)
    first = press.first_contact(10.0 * MM)
    assert first.ok and first.magnitude == 0.0
    assert press.travel_of(first) == pytest.approx(3.0 * MM, abs=0.01 * MM)
    travel = press.travel_for(5.0 * MILLINEWTON, first)
    assert press.at(travel, first).magnitude == pytest.approx(5.0 * MILLINEWTON, abs=2.0 * 1e-6 * 2.0)


def test_a_limit_of_the_travel_is_kept(estimator):
    press = press_at(estimator.model, 0.5)
    first = press.first_contact(10.0 * MM)
    assert press.travel_for(1.0, first, 3.5 * MM) == 3.5 * MM


def test_friction_0_is_the_frictionless_contact(estimator):
    """The contact is followed in steps there, and solved at its end here: they agree within 1e-4 of the force."""
    model = estimator.model
    for pressed in press_scene(model, "edges", friction=0.0):
        travel = -pressed.travel[-1] * pressed.direction
        contact = press_against_line(
            model.rod, model.gravity_base, pressed.point + travel, ALONG, travel, mode="reference"
        )
        assert contact.result == "ok"
        assert pressed.force == pytest.approx(contact.magnitude, rel=1e-4)
        assert pressed.s_contact == pytest.approx(contact.s, abs=0.01 * MM)


def test_an_object_that_yields_takes_less_force_at_the_same_travel(estimator):
    """For a light press probe and object are two springs in a row, which is accurate to the bending of the probe."""
    force, yielding = (
        press.at(press.travel_of(first) + 0.2 * MM, first).magnitude
        for press in (press_at(estimator.model, 0.0, compliance=c) for c in (0.0, 0.2))
        if (first := press.first_contact(10.0 * MM)).ok
    )
    assert yielding == pytest.approx(1.0 / (1.0 / force + 0.2 / (0.2 * MM)), rel=0.02)


@pytest.mark.parametrize("compliance", [-0.1, math.nan, math.inf])
def test_a_compliance_out_of_range_is_refused(estimator, compliance):
    with pytest.raises(InputError, match="--object-compliance-m-N"):
        press_scene(estimator.model, "edges", compliance=compliance)


def test_objects_are_pressed_with_the_safe_force_or_to_the_largest_depth(estimator):
    model = estimator.model
    for pressed in press_scene(model, "edges"):
        deepest = pressed.travel[-1] >= (CLEARANCE + MAX_DEPTH) * model.rod.length * (1.0 - 1e-9)
        assert deepest or pressed.force == pytest.approx(safe_force(model.rod), rel=1e-3)
