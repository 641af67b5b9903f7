"""The fusion as readings come: agrees with the batch, keeps to its bounds, forgets, and refuses what cannot be."""

import numpy as np
import pytest

from probedesign.errors import InputError
from probedesign.estimation.tracker import Tracker
from probedesign.estimation.unknowns import Unknowns
from tests.estimation.presses import presses

RATE = 7000.0
SAMPLES = 36


class Feed:
    """Gives a tracker noisy samples, one after another."""

    def __init__(self, tracker, model, seed=0):
        self.tracker, self.model, self.time = tracker, model, 0.0
        self.rng, self.cov = np.random.default_rng(seed), model.noise_base() * model.averaging_samples

    def __call__(self, wrench, T, samples):
        """Samples of one wrench at one pose; the answers and the samples' mean."""
        read = wrench + self.rng.multivariate_normal(np.zeros(6), self.cov, samples)
        said = []
        for sample in read:
            self.time += 1.0 / RATE
            said.append(self.tracker.update(sample, T, self.time))
        return said, read.mean(axis=0)


@pytest.fixture
def pressed(large, gravity):
    """Wrenches, poses and the contact's mean point of five touches."""
    return presses(large, gravity, 0.7 * large.length, 1.57, np.linspace(2e-3, 1e-2, 5))


@pytest.fixture
def free(large, gravity):
    return large.solve(gravity).wrench_base


@pytest.mark.parametrize("moments_only", [False, True])
@pytest.mark.parametrize("unknowns", [Unknowns.none(), Unknowns()])
def test_it_agrees_with_the_batch(moments_only, unknowns, large, gravity, pressed, free):
    wrenches, Ts, _ = pressed
    estimator = large.estimator()
    feed = Feed(Tracker(estimator, unknowns, gravity, moments_only=moments_only), large.model)
    said, _ = feed(free, Ts[0], 50)
    assert {c.result for c in said} == {"no_contact"}
    means = []
    for wrench, T in zip(wrenches, Ts, strict=True):
        said, mean = feed(wrench, T, SAMPLES)
        means.append(mean)
    # Each sample is counted alike by both, so the batch is of the very means that the tracker keeps.
    batch = estimator.fuse(
        means, Ts, gravity, moments_only=moments_only, moments_about="sensor", unknowns=unknowns
    )
    assert said[-1].result == batch.result == "ok"
    # Nodes are linearised in turn, a few readings ago each: within a twentieth of a standard deviation.
    assert np.linalg.norm(said[-1].p_contact_world - batch.p_contact_world) <= 0.05 * batch.rms
    assert said[-1].rms == pytest.approx(batch.rms, rel=1e-2)


def test_it_forgets_when_the_touch_is_lost(large, gravity, pressed, free):
    wrenches, Ts, _ = pressed
    feed = Feed(Tracker(large.estimator(), Unknowns(), gravity), large.model)
    feed(wrenches[4], Ts[4], 60)
    assert feed.tracker.kept == 1
    said, _ = feed(free, Ts[4], 60)
    assert {c.result for c in said[-20:]} == {"no_contact"}
    assert feed.tracker.kept == 0


def test_nothing_said_before_outlives_a_reading_that_does_not_fit(large, gravity, pressed):
    """The bias jumps by a hundred steps while the probe rests at a pose: once that shows there is no place any more."""
    wrenches, Ts, _ = pressed
    feed = Feed(Tracker(large.estimator(), Unknowns.none(), gravity), large.model)
    for k in range(3):
        said, _ = feed(wrenches[k], Ts[k], SAMPLES)
    assert said[-1].ok
    jump = 100.0 * np.sqrt(np.diag(feed.cov))
    said, _ = feed(wrenches[2] + jump, Ts[2], SAMPLES)
    first = [c.ok for c in said].index(False)
    assert first <= 5  # a twelfth of the mean by then
    assert not any(c.ok for c in said[first:])
    assert all(np.isnan(c.p_contact_world).all() for c in said[first:])


def test_memory_is_bounded_while_the_base_moves_on(large, gravity, pressed):
    wrenches, Ts, _ = pressed
    feed = Feed(Tracker(large.estimator(), Unknowns(), gravity, nodes=4), large.model)
    for share in np.linspace(0.0, 1.0, 40):
        T = Ts[3].copy()
        T[:3, 3] = (1.0 - share) * Ts[3][:3, 3] + share * Ts[4][:3, 3]
        feed((1.0 - share) * wrenches[3] + share * wrenches[4], T, 2)
        assert feed.tracker.kept <= 4


def test_many_poses_of_a_turning_base_stay_consistent(large):
    """More poses than nodes: what lies too far apart is dropped, not mixed."""
    world = np.array([9.81, 0.0, 0.0])
    feed = Feed(Tracker(large.estimator(), Unknowns(), world), large.model)
    codes = []
    for k in range(12):
        a = 0.02 * k
        R = np.array([[np.cos(a), -np.sin(a), 0.0], [np.sin(a), np.cos(a), 0.0], [0.0, 0.0, 1.0]])
        wrench, T, _ = presses(large, R.T @ world, 0.105, 1.57, [2e-3 + 1e-3 * k], turn=R)
        said, _ = feed(wrench[0], T[0], SAMPLES)
        codes.append(said[-1].result)
    assert feed.tracker.kept <= 8
    assert codes[-4:] == ["ok"] * 4


def test_light_touches_do_not_spoil_what_free_readings_say_of_the_bias(large, gravity, pressed, free):
    """A touch is told some readings late; those must not count as free ones."""
    _, Ts, _ = pressed
    wrench = presses(large, gravity, 0.08, 1.57, [2e-3])[0][0]
    feed = Feed(Tracker(large.estimator(), Unknowns(bias_steps=3.0), gravity), large.model)
    feed(free, Ts[0], 1500)
    said, _ = feed(wrench, Ts[4], 400)
    assert "inconsistent" not in {c.result for c in said[-200:]}


def test_what_cannot_be_changes_nothing(large, gravity, pressed):
    wrenches, Ts, _ = pressed
    feed = Feed(Tracker(large.estimator(), Unknowns(), gravity), large.model)
    feed(wrenches[4], Ts[4], 10)
    tracker, now = feed.tracker, feed.time + 1.0
    bad_T = Ts[4].copy()
    bad_T[0, 0] = 3.0
    saturated = wrenches[4].copy()
    saturated[0] = 1e3
    for wrench, T, time in (
        (np.full(6, np.nan), Ts[4], now), (wrenches[4], bad_T, now), (wrenches[4], Ts[4], feed.time),
        (wrenches[4], Ts[4], np.nan), (saturated, Ts[4], now), (np.zeros(5), Ts[4], now),
    ):  # fmt: skip
        c = tracker.update(wrench, T, time)
        assert c.result == "out_of_range" and np.isnan(c.p_contact_world).all()
    assert tracker.kept == 1
    assert tracker.update(wrenches[4], Ts[4], now).result != "out_of_range"


def test_one_pose_with_moments_alone_stays_unobservable(large, gravity, pressed):
    wrenches, Ts, _ = pressed
    feed = Feed(Tracker(large.estimator(), Unknowns(), gravity, moments_only=True), large.model)
    said, _ = feed(wrenches[4], Ts[4], 40)
    assert {c.result for c in said} == {"unobservable"}


@pytest.mark.parametrize("wrong", [{"gravity_world": (0.0, 0.0)}, {"nodes": 1}])
def test_arguments_that_make_no_sense_are_refused(wrong, large):
    with pytest.raises(InputError, match=next(iter(wrong))):
        Tracker(large.estimator(), **wrong)
