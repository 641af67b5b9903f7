"""Test the 95 % interval of s_contact: normal posterior, bounds of the probe and coverage."""

import math

import numpy as np
import pytest

from probedesign.estimation.estimator import Estimator
from tests.estimation.true_touches import settle

GRAVITY = np.array([9.81, 0.0, 0.0])


def test_the_interval_of_a_firm_touch_is_that_of_a_normal_posterior(large, touched):
    """200 mN at 0.4 L: s is known to half a millimetre, over which the misfit is a parabola to a few per cent."""
    estimator = Estimator(large.model)
    c = estimator.estimate(touched(0.4 * large.length, 0.2, 0.7, 0.2, -0.1), GRAVITY)
    low, high = c.s_interval_95
    assert c.ok
    assert (c.s_contact - low) / c.std_s == pytest.approx(1.96, rel=0.05)
    assert (high - c.s_contact) / c.std_s == pytest.approx(1.96, rel=0.05)


def test_the_interval_ends_where_the_probe_ends(large, touched):
    """10 mN at 0.95 L: the normal interval would reach beyond the tip."""
    estimator = Estimator(large.model)
    c = estimator.estimate(touched(0.95 * large.length, 0.01, 0.7, 0.1, 0.3), GRAVITY)
    low, high = c.s_interval_95
    assert c.ok and c.s_contact + 1.96 * c.std_s > large.model.rod.length
    assert 0.0 < low < c.s_contact < high <= large.model.rod.length


def test_a_place_that_the_end_bounds_is_an_interval(large, touched):
    """15 mN at 0.97 L, of which 1.2 mN less are read: the moment then puts the touch beyond the tip, and all likely
    places lie to one side of the end."""
    estimator = Estimator(large.model)
    wrench = touched(0.97 * large.length, 0.015, 0.7)
    assert estimator.estimate(wrench, GRAVITY).ok
    push = wrench[:3] - estimator.free(GRAVITY).wrench_base[:3]
    c = estimator.estimate(wrench - 1.2e-3 * np.append(push / np.linalg.norm(push), np.zeros(3)), GRAVITY)
    low, high = c.s_interval_95
    assert c.result == "interval_only" and c.candidates[0].at_end
    assert low < 0.97 * large.model.rod.length < high


def test_the_interval_holds_light_touches_near_the_tip(large, exact_sources):
    """Seeded draws of noise and friction, 5 to 20 mN at 0.7 to 0.95 L: of 60 draws with a coverage of 95 %, fewer than
    51 inside have a chance of one in a thousand."""
    rng, inside, located = np.random.default_rng(4), 0, 0
    estimator = Estimator(large.model)
    chol = np.linalg.cholesky(large.model.noise_base() + estimator.sources(GRAVITY).drift)
    while located < 60:
        fraction, angle = rng.uniform(0.7, 0.95), rng.uniform(-math.pi, math.pi)
        force, ratios = 10 ** rng.uniform(-2.3, -1.7), rng.normal(0.0, 0.6, 2)
        touch = settle(exact_sources, np.array([fraction * large.length, angle, force, *ratios]))
        if touch is None:
            continue
        exact = estimator.with_noise(1e-6, 1e-8).estimate(touch.wrench, GRAVITY)
        c = estimator.estimate(touch.wrench + chol @ rng.normal(size=6), GRAVITY)
        if not (c.ok and exact.ok):
            continue
        low, high = c.s_interval_95
        inside += low <= exact.s_contact <= high
        located += 1
    assert inside >= 51


def test_what_is_not_located_has_no_interval(large):
    estimator = Estimator(large.model)
    c = estimator.estimate(estimator.free(GRAVITY).wrench_base, GRAVITY)
    assert c.result == "no_contact"
    assert all(math.isnan(bound) for bound in c.s_interval_95)
