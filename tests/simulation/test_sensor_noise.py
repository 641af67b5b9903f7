"""Tests of the noise that all simulated sensors share."""

import numpy as np
import pytest

from probedesign.simulation.robot import SimulatedTrajectory
from probedesign.simulation.rod_and_sensor import bias_step, reading_std, sample_std
from tests.live.conftest import bundle as bundle
from tests.live.conftest import estimator as estimator


def test_a_sample_is_noisier_than_a_reading_by_the_root_of_its_number(estimator):
    model = estimator.model
    assert reading_std(model) == pytest.approx(np.repeat([model.noise.force, model.noise.moment], 3))
    assert sample_std(model) == pytest.approx(np.sqrt(model.averaging_samples) * reading_std(model))


def test_the_bias_walks_with_the_square_root_of_time():
    """With 30 000 steps the standard deviation is known to 0.2 %."""
    rng = np.random.default_rng(5)
    steps = np.array([bias_step(rng, 0.3, 4.0) for _ in range(30_000)])
    assert steps.std(axis=0) == pytest.approx(np.full(6, 0.6), rel=0.02)
    assert np.abs(np.corrcoef(steps.T) - np.eye(6)).max() < 0.03


def test_samples_of_a_trajectory_have_the_noise_and_the_resolution_of_the_sensor(estimator):
    """Rounding to steps as large as the noise adds a twelfth of its variance."""
    model, rng = estimator.model, np.random.default_rng(4)
    trajectory = SimulatedTrajectory(np.eye(3), np.zeros(6), rng, bias_rate=0.0)
    wrench = np.concatenate([block.wrench_sensor for block in trajectory.blocks(model, rng)])
    assert len(wrench) == 14_000  # 4 s at 3500 samples/s
    steps = wrench / sample_std(model)
    assert steps == pytest.approx(np.round(steps), abs=1e-6)
    assert steps.std(axis=0) == pytest.approx(np.full(6, np.sqrt(1.0 + 1.0 / 12.0)), rel=0.03)
