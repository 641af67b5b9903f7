"""Tests of simulated contacts at a given section of the rod, and of the noise that all simulated sensors share."""

from dataclasses import replace

import numpy as np
import pytest

from probedesign.core.units import MM
from probedesign.rod.contact import DEFAULT_FORCE, safe_force, solve_contact
from probedesign.simulation.simulated_run import SimulatedTrajectory
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
    assert touched.equilibrium.wrench_base == pytest.approx(on_axis.equilibrium.wrench_base, rel=1e-3, abs=1e-7)


def test_friction_adds_a_tangential_force_of_its_ratio(estimator):
    rod, gravity = estimator.model.rod, estimator.model.gravity_base
    contact = solve_contact(rod, gravity, 0.8 * rod.length, ANGLE, FORCE, (0.3, 0.4))
    assert contact.result == "ok"
    assert np.linalg.norm(contact.force_base) == pytest.approx(FORCE * np.hypot(1.0, 0.5), rel=1e-6)


@pytest.mark.parametrize("force", [1.0, 5.0])
def test_a_force_that_buckles_the_rod_has_no_position(estimator, force):
    """Some hundred and a thousand times the force that the other tests press with."""
    rod = estimator.model.rod
    contact = solve_contact(rod, estimator.model.gravity_base, 0.9 * rod.length, ANGLE, force)
    assert contact.result != "ok" and np.isnan(contact.p_surface_base).all()


def test_the_safe_force_is_proportional_to_a_low_stiffness(estimator):
    rod = estimator.model.rod
    soft, softer = (replace(rod, youngs_modulus=factor * rod.youngs_modulus) for factor in (1e-2, 5e-3))
    assert safe_force(rod) <= DEFAULT_FORCE
    assert safe_force(soft) == pytest.approx(2.0 * safe_force(softer), rel=1e-12)
    assert safe_force(replace(rod, youngs_modulus=1e3 * rod.youngs_modulus)) == DEFAULT_FORCE


def test_the_bias_walks_with_the_square_root_of_time():
    """With 30 000 moves the standard deviation is known to 0.4 %, a correlation to 0.006; five times that."""
    trajectory = SimulatedTrajectory(np.eye(3), np.zeros(6), np.random.default_rng(5), bias_rate=0.3)
    for _ in range(30_000):
        trajectory.go(0.4, np.zeros(3), np.zeros(6), 1.0)
    steps = np.diff(trajectory.biases[2::2], axis=0) / np.sqrt(np.diff(trajectory.times[2::2]))[:, None]
    assert steps.std(axis=0) == pytest.approx(np.full(6, 0.3), rel=0.02)
    assert np.abs(np.corrcoef(steps.T) - np.eye(6)).max() < 0.03


def test_samples_of_a_trajectory_have_the_noise_and_the_resolution_of_the_sensor(estimator):
    """Rounding to steps as large as the noise adds a twelfth of its variance."""
    model, rng = estimator.model, np.random.default_rng(4)
    trajectory = SimulatedTrajectory(np.eye(3), np.zeros(6), rng, bias_rate=0.0)
    wrench = np.concatenate([block.wrench_sensor for block in trajectory.blocks(model, rng)])
    assert len(wrench) == 14_000  # 4 s at 3500 samples/s
    steps = wrench / (np.sqrt(model.averaging_samples) * model.noise.std)
    assert steps == pytest.approx(np.round(steps), abs=1e-6)
    assert steps.std(axis=0) == pytest.approx(np.full(6, np.sqrt(1.0 + 1.0 / 12.0)), rel=0.03)
