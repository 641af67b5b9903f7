"""Test the tracker: agreement with the batch, limits of memory, forgetting, and refusal of inconsistent readings."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from probedesign.core.errors import InputError
from probedesign.core.frames import pose, rotation_z
from probedesign.estimation.estimator import Estimator
from probedesign.estimation.model import WALK_SECONDS, Tolerances
from probedesign.estimation.tracker import Tracker
from tests.estimation.true_touches import EXACT, presses, settle, sources_of, wrenches_of

RATE = 7000.0
SAMPLES = 36


class Feed:
    """Feed noisy samples to a tracker one by one."""

    def __init__(self, tracker, model, seed=0):
        self.tracker, self.model, self.time = tracker, model, 0.0
        self.rng, self.cov = np.random.default_rng(seed), model.noise_base() * model.averaging_samples

    def __call__(self, wrench, T, samples):
        """Feed samples of one wrench at one pose and return the results and the mean of the samples."""
        read = wrench + self.rng.multivariate_normal(np.zeros(6), self.cov, samples)
        results = []
        for sample in read:
            self.time += 1.0 / RATE
            results.append(self.tracker.update(sample, T, self.time))
        return results, read.mean(axis=0)


@pytest.fixture(scope="module")
def pressed(exact_sources, large):
    """Wrenches and poses of five touches with friction."""
    touches, Ts = presses(exact_sources, 0.7 * large.length, 1.57, np.linspace(2e-3, 1e-2, 5), (0.1, 0.2))
    return wrenches_of(touches), Ts


@pytest.fixture(scope="module")
def free(large, gravity):
    return large.rod.solve(gravity).wrench_base


@pytest.mark.parametrize("priors", [EXACT, Tolerances()], ids=["exact", "all"])
def test_it_agrees_with_the_batch(priors, large, gravity, pressed, free):
    wrenches, Ts = pressed
    feed = Feed(Tracker(Estimator(large.model, priors), gravity), large.model)
    results, _ = feed(free, Ts[0], 50)
    assert {c.result for c in results} == {"no_contact"}
    for wrench, T in zip(wrenches, Ts, strict=True):
        feed(wrench, T, SAMPLES)
    # At rest, until the last keyframe's mean has settled and the older ones have followed it.
    results, _ = feed(wrenches[-1], Ts[-1], 1000)
    c, tracker = results[-1], feed.tracker
    assert tracker.kept == 5
    batch = tracker._batch(tracker._touch).solve()
    assert c.result == batch.result == "ok"
    # Both end within a few hundredths of a standard deviation.
    assert np.linalg.norm(c.p_surface_world - batch.p_surface_world) <= 0.05 * batch.rms
    assert np.linalg.norm(c.p_contact_world - batch.p_contact_world) <= 0.05 * batch.rms
    # The tracker evaluates what curvature adds as its readings double and scales it between.
    assert c.rms == pytest.approx(batch.rms, rel=2e-2)
    assert c.chi2 == pytest.approx(batch.chi2, abs=0.1)
    np.testing.assert_allclose(c.force_normal, batch.force_normal, atol=0.1 * large.model.noise.force)


@pytest.mark.parametrize("seconds", [1.0, 60.0])
def test_a_touch_held_while_the_bias_walks_scatters_as_stated(seconds, large, gravity, exact_sources, free):
    """The mean of a keyframe averages the noise, but not the walk of the bias under it."""
    priors, rng = replace(EXACT, drift_steps=0.2, walk_steps=0.2), np.random.default_rng(5)
    model = replace(large.model, friction=0.0)
    (touch,), (T,) = presses(exact_sources, 0.7 * large.length, 1.57, [0.02])
    samples, squares, draws = 50, [], 25
    step = np.linalg.cholesky(model.noise_base() * model.averaging_samples)
    for _ in range(draws):
        tracker = Tracker(Estimator(model, priors), gravity)
        walk = rng.normal(size=(samples, 6)) * priors.walk_steps * math.sqrt(seconds / samples / WALK_SECONDS)
        bias = priors.drift_steps * rng.normal(size=6) + np.cumsum(walk, axis=0)
        for k in range(samples):
            reading = touch.wrench + step @ (bias[k] + rng.normal(size=6))
            c = tracker.update(reading, T, k * seconds / samples, touching="contact")
        if c.ok:
            values, axes = np.linalg.eigh(c.cov_surface_world)
            squares.append((c.p_surface_world @ axes) ** 2 / values)
    assert len(squares) >= draws - 1
    # The mean of that many values of χ² with one degree of freedom, within three standard deviations. Along the longest
    # axis from both sides. Across it the covariance includes the curvature along it, which is a bound: the errors are
    # smaller, by no more than the factor of three in the standard deviation that it may add here.
    means, scatter = np.mean(squares, axis=0), 3.0 * math.sqrt(2.0 / len(squares))
    assert abs(means[-1] - 1.0) < scatter
    assert (means[:-1] < 1.0 + scatter).all() and (means[:-1] > 1.0 / 9.0).all()
    # The whole error squared over the covariance, of three degrees of freedom, is within its 95 % limit as often as
    # stated, or more often: one draw of 25 in twenty would lie beyond three of these.
    assert np.sum(np.sum(squares, axis=1) > stats.chi2.isf(0.05, 3)) <= 3


def test_one_pose_is_one_estimate(large, gravity, exact, exact_sources):
    touches, Ts = presses(exact_sources, 0.6 * large.length, 1.57, [0.03], (0.2, 0.1))
    feed = Feed(Tracker(exact, gravity), large.model)
    results, mean = feed(touches[0].wrench, Ts[0], SAMPLES)
    one = exact.estimate(mean, gravity)
    assert results[-1].ok and one.ok
    std = np.sqrt(np.trace(one.cov_surface_base))
    assert np.linalg.norm(one.p_surface_base + Ts[0, :3, 3] - results[-1].p_surface_world) <= 0.05 * std
    assert results[-1].rms == pytest.approx(std, rel=0.05)


def test_a_second_touch_elsewhere_is_located_anew(large, gravity, exact, exact_sources, free):
    feed = Feed(Tracker(exact, gravity), large.model)
    for fraction, shift in ((0.7, [0.0, 0.0, 0.0]), (0.4, [0.05, 0.0, 0.02])):
        touches, Ts = presses(exact_sources, fraction * large.length, -1.57, np.linspace(0.01, 0.03, 3))
        Ts = pose(np.eye(3), np.array(shift)) @ Ts
        for touch, T in zip(touches, Ts, strict=True):
            results, _ = feed(touch.wrench, T, SAMPLES)
        assert results[-1].ok
        assert np.linalg.norm(results[-1].p_surface_world - shift) <= 4.0 * results[-1].rms
        feed(free, Ts[-1], 80)
        assert feed.tracker.kept == 0


def test_no_result_outlives_a_reading_that_does_not_fit(large, gravity, pressed):
    """The bias jumps by a hundred steps while the probe is at rest: once the jump is observed, no place is returned."""
    wrenches, Ts = pressed
    feed = Feed(Tracker(Estimator(large.model, EXACT), gravity), large.model)
    for k in range(3):
        results, _ = feed(wrenches[k], Ts[k], SAMPLES)
    assert results[-1].ok
    jump = 100.0 * np.sqrt(np.diag(feed.cov))
    results, _ = feed(wrenches[2] + jump, Ts[2], SAMPLES)
    first = [c.ok for c in results].index(False)
    assert first <= 5  # a twelfth of the mean by then
    assert not any(c.ok for c in results[first:])
    assert all(np.isnan(c.p_surface_world).all() for c in results[first:])


def test_memory_is_bounded_while_the_base_moves_on(large, gravity, pressed):
    """Every reading counts: poses less than a hundredth of the length apart are averaged."""
    wrenches, Ts = pressed
    feed = Feed(Tracker(large.estimator(), gravity), large.model)
    for share in np.linspace(0.0, 1.0, 40):
        T = Ts[3].copy()
        T[:3, 3] = (1.0 - share) * Ts[3][:3, 3] + share * Ts[4][:3, 3]
        feed((1.0 - share) * wrenches[3] + share * wrenches[4], T, 2)
        assert feed.tracker.kept <= 8
    assert sum(frame.count for frame in feed.tracker._touch.keyframes) == 80


def test_many_poses_of_a_turning_base_stay_consistent(large):
    """With more poses than keyframes, distant keyframes are dropped and not merged."""
    world = np.array([9.81, 0.0, 0.0])
    feed = Feed(Tracker(large.estimator(), world), large.model)
    codes = []
    for k in range(12):
        R = rotation_z(0.02 * k)[:3, :3]
        touch = settle(sources_of(large.model, R.T @ world), np.array([0.105, 1.57, 2e-3 + 1e-3 * k, 0.1, 0.1]))
        results, _ = feed(touch.wrench, pose(R, -R @ touch.p_surface), SAMPLES)
        codes.append(results[-1].result)
    assert feed.tracker.kept <= 8
    assert codes[-4:] == ["ok"] * 4


def test_free_readings_anchor_the_bias(large, gravity, pressed, free):
    """A second of free readings determines a bias of two steps and reduces the covariance of the point."""
    wrenches, Ts = pressed
    priors = replace(EXACT, drift_steps=2.0)
    rng = np.random.default_rng(3)
    bias = np.linalg.cholesky(large.model.noise_base() * large.model.averaging_samples) @ (2.0 * rng.normal(size=6))
    last = []
    for seconds in (0.0, 1.0):
        feed = Feed(Tracker(Estimator(large.model, priors), gravity, rate=RATE), large.model)
        if seconds:
            for reading in free + bias + feed.rng.multivariate_normal(np.zeros(6), feed.cov, int(seconds * RATE)):
                feed.time += 1.0 / RATE
                feed.tracker.update(reading, Ts[0], feed.time, touching="free")
        for wrench, T in zip(wrenches, Ts, strict=True):
            read = wrench + bias + feed.rng.multivariate_normal(np.zeros(6), feed.cov, SAMPLES)
            for sample in read:
                feed.time += 1.0 / RATE
                c = feed.tracker.update(sample, T, feed.time, touching="contact")
        assert c.result == "ok"
        assert c.p_surface_world @ np.linalg.solve(c.cov_surface_world, c.p_surface_world) < stats.chi2(3).ppf(0.999)
        last.append(c)
    assert last[1].rms < last[0].rms


def test_light_touches_do_not_spoil_what_free_readings_know_of_the_bias(large, gravity, exact_sources, pressed, free):
    """A touch is detected some readings late; these readings must not be used as free ones."""
    _, Ts = pressed
    touches, _ = presses(exact_sources, 0.08, 1.57, [2e-3])
    feed = Feed(Tracker(Estimator(large.model, replace(EXACT, drift_steps=3.0)), gravity), large.model)
    feed(free, Ts[0], 1500)
    results, _ = feed(touches[0].wrench, Ts[4], 400)
    assert "inconsistent" not in {c.result for c in results[-200:]}


def test_an_object_that_moves_is_inconsistent(large, gravity, exact_sources):
    touches, Ts = presses(exact_sources, 0.7 * large.length, -1.57, np.linspace(0.01, 0.04, 5), (0.2, 0.0))
    feed = Feed(Tracker(large.estimator(), gravity), large.model)
    for k, (touch, T) in enumerate(zip(touches, Ts, strict=True)):
        moved = T.copy()
        moved[1, 3] += 4e-3 * (k >= 3)
        results, _ = feed(touch.wrench, moved, SAMPLES)
    assert results[-1].result != "ok" and np.isnan(results[-1].p_surface_world).all()


def test_what_cannot_be_changes_nothing(large, gravity, pressed):
    wrenches, Ts = pressed
    feed = Feed(Tracker(large.estimator(), gravity), large.model)
    feed(wrenches[4], Ts[4], 10)
    tracker, now = feed.tracker, feed.time + 1.0
    bad_T, mirrored = Ts[4].copy(), Ts[4].copy()
    bad_T[0, 0], mirrored[0, 0] = 3.0, -1.0
    saturated = wrenches[4].copy()
    saturated[0] = 1e3
    for wrench, T, time in (
        (np.full(6, np.nan), Ts[4], now), (wrenches[4], bad_T, now), (wrenches[4], Ts[4], feed.time),
        (wrenches[4], Ts[4], np.nan), (saturated, Ts[4], now), (np.zeros(5), Ts[4], now), (wrenches[4], mirrored, now),
    ):  # fmt: skip
        c = tracker.update(wrench, T, time)
        assert c.result == "out_of_range" and np.isnan(c.p_surface_world).all()
    assert tracker.kept == 1
    assert tracker.update(wrenches[4], Ts[4], now).result != "out_of_range"


@pytest.mark.parametrize("wrong", [(0.0, 0.0), (0.0, 0.0, np.nan)])
def test_a_gravity_that_is_none_is_refused(wrong, large):
    with pytest.raises(InputError, match="gravity_world"):
        Tracker(large.estimator(), wrong)
