"""The sequential test: as many false alarms as stated, light touches and ends of touches detected in time, drift and
sway tolerated."""

import numpy as np
import pytest
from scipy import stats

from probedesign.core.errors import InputError
from probedesign.estimation.detector import Detector

RATE = 7000.0
RARE = 1e-4


@pytest.fixture
def sampled(large):
    """Return noise samples of a free probe."""

    def sampled(n, seed=1):
        cov = large.model.noise_base() * large.model.averaging_samples
        return np.random.default_rng(seed).multivariate_normal(np.zeros(6), cov, int(n), method="cholesky")

    return sampled


@pytest.fixture(scope="module")
def by_force(large, gravity):
    """Change of the base wrench per newton at mid-length."""
    eq = large.rod.solve(gravity, (0.0, 0.0, 0.0), 0.5 * large.length, columns="load")
    return eq.sensitivity.d_wrench[:, 1]


def changes(states):
    """Return the changes of state with their samples."""
    return [(i, now) for i, (before, now) in enumerate(zip(["free", *states], states, strict=False)) if before != now]


def alarms(states):
    return [i for i, now in changes(states) if now == "contact"]


def test_false_alarms_come_as_often_as_stated(large, sampled):
    """Two minutes of a free probe, tested for one alarm in four seconds: 30, a Poisson number."""
    n = 120 * RATE
    states = Detector(large.model, RATE, 4.0 / 3600.0).run(sampled(n))
    low, high = stats.poisson(30).ppf((RARE, 1.0 - RARE))
    # The five lengths are not independent, and their chances are simply added: rather fewer than stated.
    assert 0.3 * low <= len(alarms(states)) <= high


@pytest.mark.parametrize("force", [0.0005, 0.002, 0.02, 1.0])
def test_a_touch_and_its_end_are_detected(force, large, sampled, by_force):
    on, off = 7000, 21000
    samples = sampled(28000)
    samples[on:off] += force * by_force
    states = Detector(large.model, RATE).run(samples)
    assert not alarms(states[:on])
    assert states[on + 1023 : off].count("contact") >= 0.97 * (off - on - 1023)
    end = [i for i, now in changes(states) if now == "lost"][-1]
    assert off <= end < off + 1024
    assert set(states[end + 1 :]) == {"free"}


def test_drift_is_followed_and_no_touch(large, sampled):
    """The bias drifts for half a minute by two steps, twenty times the assumed rate."""
    model = large.model
    n = int(30 * RATE)
    step = np.sqrt(np.diag(model.noise_base()) * model.averaging_samples)
    drift = 2.0 * step * np.linspace(0.0, 1.0, n)[:, None]
    detector = Detector(model, RATE)
    assert not alarms(detector.run(sampled(n) + drift))
    np.testing.assert_allclose(detector.bias, drift[-1], atol=0.3 * step.max())


def test_a_sway_that_was_seen_is_borne_and_a_touch_in_it_is_told(large, sampled, by_force):
    """5 Hz and 3 mN at mid-length: the robot moves the probe."""
    n = int(30 * RATE)
    t = np.arange(2 * n) / RATE
    sway = 0.003 * np.sin(2 * np.pi * 5.0 * t)[:, None] * by_force
    samples = sampled(2 * n) + sway
    fresh, swaying = Detector(large.model, RATE), Detector(large.model, RATE)
    assert alarms(fresh.run(samples[:n]))
    swaying.calibrate(samples[:n])
    samples[n + n // 2 :] += 0.03 * by_force
    states = swaying.run(samples[n:])
    assert not alarms(states[: n // 2])
    assert "contact" in states[n // 2 : n // 2 + 1024]


def test_sample_by_sample_is_the_same_as_all_at_once(large, sampled, by_force):
    samples = sampled(3000)
    samples[1000:2000] += 0.004 * by_force
    one = Detector(large.model, RATE)
    assert [one.update(sample) for sample in samples] == Detector(large.model, RATE).run(samples)


def test_a_sample_that_is_no_number_is_passed_over(large, sampled):
    samples = sampled(100)
    samples[40, 3], samples[60, 0] = np.nan, np.inf
    states = Detector(large.model, RATE).run(samples)
    assert [i for i, now in enumerate(states) if now == "out_of_range"] == [40, 60]
    assert states.count("free") == 98


@pytest.mark.parametrize("wrong", [{"rate": 0.0}, {"rate": np.nan}, {"hours_between_alarms": -1.0}])
def test_numbers_that_make_no_sense_are_refused(wrong, large):
    with pytest.raises(InputError, match=next(iter(wrong))):
        Detector(large.model, **wrong)


@pytest.mark.parametrize("shape", [(5,), (2, 6)])
def test_a_sample_of_the_wrong_shape_is_refused(shape, large):
    with pytest.raises(InputError, match="shape"):
        Detector(large.model).update(np.zeros(shape))
