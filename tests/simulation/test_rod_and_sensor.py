"""Tests of simulated contacts at a given section of the rod."""

from dataclasses import replace

import numpy as np
import pytest

from probedesign.core.units import MM
from probedesign.simulation.rod_and_sensor import DEFAULT_FORCE, safe_force, solve_contact
from tests.live.conftest import bundle as bundle
from tests.live.conftest import estimator as estimator

FORCE, ANGLE = 4e-3, 0.7


def test_no_friction_force_is_the_contact_without_friction(estimator):
    """The touched section lies r tan α beyond the point of the axis; both are solved for the same axis point."""
    rod, gravity = estimator.model.rod, estimator.model.gravity_base
    touched = solve_contact(rod, gravity, 0.8 * rod.length, ANGLE, FORCE, (0.0, 0.0), "reference")
    on_axis = solve_contact(rod, gravity, touched.s_contact, ANGLE, FORCE, None, "reference")
    assert touched.result == on_axis.result == "ok"
    assert 0.0 < 0.8 * rod.length - touched.s_contact < 0.1 * MM
    assert touched.p_surface_base == pytest.approx(on_axis.p_surface_base, abs=0.01 * MM)
    assert touched.force_base == pytest.approx(on_axis.force_base, abs=1e-3 * FORCE)
    assert touched.equilibrium.wrench_base == pytest.approx(
        on_axis.equilibrium.wrench_base, rel=1e-3, abs=1e-7
    )


def test_friction_adds_a_tangential_force_of_its_ratio(estimator):
    rod, gravity = estimator.model.rod, estimator.model.gravity_base
    contact = solve_contact(rod, gravity, 0.8 * rod.length, ANGLE, FORCE, (0.3, 0.4))
    assert contact.result == "ok"
    assert np.linalg.norm(contact.force_base) == pytest.approx(FORCE * np.hypot(1.0, 0.5), rel=1e-6)


def test_a_force_that_buckles_the_rod_has_no_position(estimator):
    rod = estimator.model.rod
    contact = solve_contact(rod, estimator.model.gravity_base, 0.9 * rod.length, ANGLE, 100.0)
    assert contact.result != "ok" and np.isnan(contact.p_surface_base).all()


def test_the_safe_force_is_proportional_to_a_low_stiffness(estimator):
    rod = estimator.model.rod
    soft, softer = (replace(rod, youngs_modulus=factor * rod.youngs_modulus) for factor in (1e-2, 5e-3))
    assert safe_force(rod) <= DEFAULT_FORCE
    assert safe_force(soft) == pytest.approx(2.0 * safe_force(softer), rel=1e-12)
    assert safe_force(replace(rod, youngs_modulus=1e3 * rod.youngs_modulus)) == DEFAULT_FORCE
