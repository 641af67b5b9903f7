"""Tolerances in one reading: probes drawn as they allow are located, and the ellipsoid holds the truth as it says.

Limits on counts and means are quantiles with 1e-4 on either side of the statistic's own distribution, so a correct
program fails once in thousands of seeds; the seeds are kept.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from probedesign.estimation.detector import DRIFT_STEPS
from probedesign.estimation.doubts import Doubts
from probedesign.estimation.tolerances import Tolerances
from probedesign.prediction.worlds import Worlds

DRAWS = 150
RARE = 1e-4
TOUCHES = {
    "large": [(0.3, 0.02, "+y"), (0.6, 0.02, "+y"), (0.3, 0.2, "+y"), (0.8, 0.03, "-x")],
    "small": [(0.5, 0.1, "+x"), (0.9, 0.01, "+y")],
}


@pytest.fixture(
    scope="module", params=[(name, *touch) for name, several in TOUCHES.items() for touch in several]
)
def drawn(request, probes):
    """Readings of one touch in many worlds, and its true point in each."""
    name, *touch = request.param
    probe = probes[name]
    worlds = Worlds.draw(probe.model, probe.tolerances, DRAWS, 3)
    wrenches, points = worlds.touched(*touch)
    read = wrenches + worlds.noise(DRAWS, np.random.default_rng(5))
    estimator = probe.estimator().with_tolerances(probe.tolerances)
    return [estimator.estimate(wrench) for wrench in read], points


def test_a_probe_within_its_tolerances_is_consistent(drawn):
    estimates, _ = drawn
    # The test's own rate is 1e-3; causes as large as these are not linear, so five times that is allowed.
    assert sum(not e.ok for e in estimates) <= stats.binom(DRAWS, 5e-3).ppf(1.0 - RARE)


def test_the_ellipsoid_holds_the_truth_as_it_says(drawn):
    estimates, points = drawn
    off = [(e.p_contact_base - p, e.cov_contact_base) for e, p in zip(estimates, points, strict=True) if e.ok]
    squares = np.array([d @ np.linalg.solve(cov, d) for d, cov in off])
    # Where s is known to several millimetres a bow makes squares' tails heavier than χ²'s: the share is judged.
    inside = int((squares < stats.chi2(3).ppf(0.95)).sum())
    assert stats.binom(len(off), 0.95).ppf(RARE) - 0.03 * len(off) <= inside


def test_tolerances_of_next_to_nothing_are_the_exact_probe(large, touched):
    estimator = large.estimator()
    wrench = touched(0.09, 0.03)
    least = replace(Tolerances.none(), density=1e-9)
    exact, none = estimator.estimate(wrench), estimator.with_tolerances(least).estimate(wrench)
    assert none.result == exact.result == "ok"
    # The fit ends within a hundredth of a standard deviation, from another start.
    assert abs(none.s_contact - exact.s_contact) < 0.02 * exact.std_s
    assert np.allclose(none.cov_contact_base, exact.cov_contact_base, rtol=0.02, atol=1e-3 * exact.std_s**2)


def test_no_tolerances_are_no_doubt(large):
    assert large.estimator().with_tolerances(Tolerances.none()).tolerances is None


def test_doubt_only_widens_what_noise_leaves(large, touched):
    estimator = large.estimator()
    wrench = touched(0.09, 0.03)
    exact, wide = estimator.estimate(wrench), estimator.with_tolerances().estimate(wrench)
    assert wide.std_s > exact.std_s
    assert np.trace(wide.cov_contact_base) > np.trace(exact.cov_contact_base)


def test_columns_of_doubt_are_differences_of_probes(large, gravity):
    """A world drawn with one cause alone differs by that cause's column, to first order."""
    model = large.model
    tolerances = Tolerances.none()
    # A thousandth of an E: second order is a millionth, and the solves' own error a ten-millionth.
    only = Tolerances(**{**vars(tolerances), "youngs_modulus": 1e-3})
    worlds = Worlds.draw(model, only, 1, 2)
    draw = worlds.parameters[0, 0] / 1e-3
    still, moved = (w.touched(0.6, 0.02, "+y") for w in (Worlds.draw(model, tolerances, 1, 2), worlds))
    place = large.estimator().estimate(still[0][0]).candidates[0]
    doubt = Doubts.of(model, gravity, only).at([place])[0]
    assert doubt is not None
    size = np.abs(doubt.wrench).max()
    assert np.allclose(moved[0][0] - still[0][0], draw * doubt.wrench[:, 0], atol=5e-3 * size)
    assert np.allclose(
        moved[1][0] - still[1][0], draw * doubt.point[:, 0], atol=5e-3 * np.abs(doubt.point).max()
    )


def test_noise_keeps_the_tolerances(large):
    estimator = large.estimator().with_tolerances()
    assert estimator.with_noise(1e-3, 1e-5).tolerances == estimator.tolerances


def test_a_force_that_drift_may_be_tells_no_place(large, touched):
    """A bias that has walked since the tare reads as a force: a place is told from five deviations of both on."""
    noise, tolerances = large.model.noise.force, large.tolerances
    both = noise * np.sqrt(1.0 + tolerances.drift_steps**2 * large.model.averaging_samples)
    wrench = touched(0.12, 0.5 * (5.0 * noise + 5.0 * both))
    assert large.estimator().estimate(wrench).ok
    assert large.estimator().with_tolerances(tolerances).estimate(wrench).result == "too_light"


@pytest.mark.parametrize("age", [10.0, 100.0, 1000.0, 10_000.0])
def test_an_old_tare_is_trusted_less(large, touched, age):
    """The bias has walked by the detector's 0.05 steps a root of a second: a free probe is free still, and a touch that
    is much heavier than the walk is where the ellipsoid says."""
    estimator = large.estimator().with_tolerances().since_tare(age)
    noise = np.linalg.cholesky(estimator.cov_wrench)
    step = noise * np.sqrt(estimator.model.averaging_samples)
    rng = np.random.default_rng(int(age))

    def read(wrench):
        walked = DRIFT_STEPS * np.sqrt(age) * step @ rng.standard_normal(6)
        return estimator.estimate(wrench + noise @ rng.standard_normal(6) + walked)

    free = estimator.free().wrench_base
    assert all(read(free).result == "no_contact" for _ in range(DRAWS))  # one in a million is a false alarm

    force = 12.0 * estimator.model.noise.force * np.sqrt(1.0 + (DRIFT_STEPS**2 * age) * 36)
    told = [read(touched(0.075, force)) for _ in range(DRAWS)]
    assert sum(not c.ok for c in told) <= stats.binom(DRAWS, 5e-3).ppf(1.0 - RARE)
    point = large.estimator().estimate(touched(0.075, force)).p_contact_base
    off = [(c.p_contact_base - point, c.cov_contact_base) for c in told if c.ok]
    squares = np.array([d @ np.linalg.solve(cov, d) for d, cov in off])
    inside = int((squares < stats.chi2(3).ppf(0.95)).sum())
    assert inside >= stats.binom(len(off), 0.95).ppf(RARE) - 0.03 * len(off)  # the bow, as above


def test_without_tolerances_a_tare_does_not_age(large):
    estimator = large.estimator()
    assert estimator.since_tare(1e6) is estimator
    weighed = estimator.with_tolerances()
    assert weighed.since_tare(-1.0) is weighed and weighed.since_tare(float("nan")) is weighed
    assert weighed.since_tare(100.0) is weighed.since_tare(120.0)
