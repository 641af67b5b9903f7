"""Test the bias filter: it is unbiased, its covariance is correct for walk and ramp, and it ignores touches."""

import numpy as np
import pytest

from probedesign.estimation.bias import RAMP_STEPS, WALK_STEPS
from probedesign.estimation.detector import Detector

RATE = 200.0  #: Rate of the means [Hz], low so that a long time has few readings.


@pytest.fixture
def run(large):
    """Return a detector and a function that feeds it means of a free probe with a bias [steps] for some seconds."""
    model, rng = large.model, np.random.default_rng(8)
    step = np.linalg.cholesky(model.noise_base() * model.averaging_samples)
    noise = np.linalg.cholesky(model.noise_base())
    detector = Detector(model, RATE, samples=1)

    def feed(bias):
        return detector.run(bias @ step.T + rng.normal(size=(len(bias), 6)) @ noise.T)

    return detector, feed, step, rng


def test_it_follows_walk_and_ramp_as_certainly_as_it_states(run):
    """Return the error in stated standard deviations at every minute of an hour; these errors are independent."""
    detector, feed, step, rng = run
    n, bias, errors = int(60.0 * RATE), np.zeros(6), []
    for minute in range(60):
        walked = bias + WALK_STEPS / np.sqrt(RATE) * np.cumsum(rng.normal(size=(n, 6)), axis=0)
        bias = walked[-1]
        drift = walked + RAMP_STEPS * (60.0 * minute + np.arange(n)[:, None] / RATE)
        feed(drift)
        known = detector.bias_filter.known()
        errors.append((np.linalg.solve(step, known.excess) - drift[-1]) / known.steps)
    # The mean of 360 values of χ² with one degree of freedom, within four standard deviations.
    assert abs(np.mean(np.square(errors)) - 1.0) < 4.0 * np.sqrt(2.0 / 360.0)
    assert known.steps < 0.2  # better than a tare of a quarter of a minute ago


def test_it_is_less_certain_the_longer_a_touch_lasts(run):
    """The variance increases by those of walk and ramp, and the mean does not change."""
    detector, feed, step, _ = run
    feed(np.zeros((2000, 6)))
    before = detector.bias_filter.known()
    touched = np.tile([0.0, 0.0, 0.0, 0.0, 30.0, 0.0], (int(600.0 * RATE), 1))
    assert feed(touched)[-1] == "contact"
    after = detector.bias_filter.known()
    expected = before.variance_after(600.0, WALK_STEPS**2)
    assert after.steps == pytest.approx(np.sqrt(expected), rel=0.02)  # the rate decorrelates within the hour
    assert after.steps > WALK_STEPS * np.sqrt(600.0)
    moved = np.linalg.solve(step, after.excess - before.after(600.0))
    assert np.abs(moved).max() < 0.05 * after.steps  # rate decays towards zero, by a sixth in ten minutes


def test_without_a_walk_the_bias_is_the_mean_of_all_readings(large):
    """Then the filter is the least-squares estimate of a constant, one block late."""
    detector = Detector(large.model, RATE, samples=1, walk_steps=0.0, start_steps=100.0)
    noise = np.linalg.cholesky(large.model.noise_base())
    samples = np.random.default_rng(2).normal(size=(4800, 6)) @ noise.T
    detector.run(samples)
    block = detector.lengths[-1]
    used = samples[: (len(samples) // block - 1) * block]
    sample_variance = 1.0 / large.model.averaging_samples
    known = detector.bias_filter.known()
    # The prior of 100 steps weighs 1e-9 of them; sways that the test has learnt count a few per cent.
    assert known.steps == pytest.approx(np.sqrt(sample_variance / len(used)), rel=0.05)
    std = np.sqrt(np.diag(large.model.noise_base()) / len(used))
    assert (np.abs(known.excess - used.mean(axis=0)) < 0.2 * std).all()
