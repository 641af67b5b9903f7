"""Compare stated covariances with the errors for random error sources, friction and noise."""

import math

import numpy as np
import pytest
from scipy import stats

from probedesign.estimation.estimator import Estimator
from probedesign.rod.kernels.surface_contact import POINT
from tests.estimation.true_touches import EXACT, settle, sources_of

DRAWS, RARE = 150, 1e-4
FRICTIONS = (0.0, 0.2, 0.5, 0.8)
#: Share inside a 95 % ellipsoid that 150 draws may have: binomial, 0.95 ± 0.018, four standard deviations below; above,
#: the bow that the covariance adds is none of a normal distribution's, so 99 % is the tolerance.
LOW, HIGH = 0.88, 0.99
MAX_BOUND = 6e-3  #: Bound of the touched point [m] below which a touch must be located.
CHI2_95 = stats.chi2(3).ppf(0.95)


def between(distribution):
    return distribution.ppf(RARE), distribution.ppf(1.0 - RARE)


def drawn(estimator, gravity, friction, fractions, forces, seed, draws=DRAWS):
    """(estimate, true touched point, stated bound) of touches with all drawn: place, force, direction, friction at its
    limit in a random direction, and every error source of the estimator, to first order."""
    model, rng, found = estimator.model, np.random.default_rng(seed), []
    sources = sources_of(model, gravity, estimator.priors)
    while len(found) < draws:
        s = rng.uniform(*fractions) * model.rod.length
        normal = math.exp(rng.uniform(*np.log(forces)))
        way, share = rng.uniform(0.0, 2.0 * math.pi), rng.uniform(0.0, 1.0)
        ratios = share * friction * math.cos(way), share * friction * math.sin(way)
        touch = settle(sources, np.array([s, rng.uniform(-math.pi, math.pi), normal, *ratios]))
        if touch is None or math.acos(min(max(touch.touch[13], -1.0), 1.0)) > 1.0:  # the tip beyond 60 degrees
            continue
        off = rng.normal(size=touch.D.shape[1])
        noise = rng.multivariate_normal(np.zeros(6), model.noise_base() + sources.drift)
        c = estimator.estimate(touch.wrench + touch.D[:6] @ off + noise, gravity)
        linear = c.candidates[0].cov_linear_base if c.candidates else np.full((3, 3), np.inf)
        found.append((c, touch.p_surface + touch.D[POINT : POINT + 3] @ off, math.sqrt(abs(np.trace(linear)))))
    return found


@pytest.fixture(scope="module", params=FRICTIONS)
def with_every_source(request, large, gravity):
    return drawn(large.estimator(), gravity, request.param, (0.25, 0.95), (0.01, 0.3), seed=11)


def test_touches_worth_locating_are_located(with_every_source):
    known = [c for c, _point, bound in with_every_source if bound < MAX_BOUND]
    assert len(known) > 0.5 * DRAWS
    assert sum(c.ok for c in known) >= 0.97 * len(known)


def test_the_ellipsoid_holds_the_touched_point_as_often_as_stated(with_every_source):
    squares = [(c.p_surface_base - p) @ np.linalg.solve(c.cov_surface_base, c.p_surface_base - p)
               for c, p, _bound in with_every_source if c.ok]  # fmt: skip
    assert LOW <= np.mean(np.array(squares) < CHI2_95) <= HIGH


def test_errors_are_as_large_as_stated(with_every_source):
    """Return the RMS error over the stated one, by place."""
    ratios = [np.linalg.norm(c.p_surface_base - p) ** 2 / np.trace(c.cov_surface_base)
              for c, p, _bound in with_every_source if c.ok]  # fmt: skip
    # The largest of three axes carries most of it: χ² of one to two, whose mean of 130 scatters by an eighth.
    assert 0.7 <= math.sqrt(np.mean(ratios)) <= 1.25


def test_the_misfit_is_chi_square(with_every_source, large):
    """The statistics include all fits; friction below its prior makes its part of χ² smaller than the mean."""
    misfits = np.array([c.candidates[0].chi2 for c, _p, _bound in with_every_source if c.candidates])
    # Three degrees of freedom by the prior of 0.6, of which at least one is left by what is read.
    assert stats.chi2(1).ppf(0.5) * 0.5 < np.median(misfits) < stats.chi2(3).ppf(0.5) * 1.5
    assert np.mean(misfits > stats.chi2(3).ppf(0.99)) < 0.05


@pytest.mark.parametrize("name", ["medium", "small"])
def test_smaller_probes_with_friction_of_a_half(name, probes, gravity):
    found = drawn(probes[name].estimator(), gravity, 0.5, (0.3, 0.9), (0.02, 0.2), seed=12, draws=100)
    located = [(c, p) for c, p, bound in found if c.ok]
    known = [c for c, _p, bound in found if bound < MAX_BOUND]
    assert sum(c.ok for c in known) >= 0.97 * len(known)
    inside = [(c.p_surface_base - p) @ np.linalg.solve(c.cov_surface_base, c.p_surface_base - p) < CHI2_95
              for c, p in located]  # fmt: skip
    assert np.mean(inside) >= LOW - 0.02  # a hundred draws scatter by 0.022


# One touch, noise alone: the distribution itself


@pytest.fixture(scope="module", params=[(0.4, 0.1, 1.57), (0.6, 0.08, 0.6)], ids=["mid", "far"])
def repeated(request, large, gravity, touched):
    """Return the estimate without noise and with free direction of the force, and the estimates of noisy readings."""
    fraction, force, phi = request.param
    wrench = touched(fraction * large.length, force, phi, 0.2, -0.2)
    estimator = Estimator(large.model, EXACT).with_friction(math.inf)
    rng, cov = np.random.default_rng(11), large.model.noise_base()
    reads = wrench + rng.multivariate_normal(np.zeros(6), cov, 2 * DRAWS)
    return estimator.estimate(wrench, gravity), [estimator.estimate(read, gravity) for read in reads]


def test_a_well_posed_touch_is_always_located(repeated):
    # A true contact is called inconsistent once in a thousand readings.
    others = [c.result for c in repeated[1] if not c.ok]
    assert set(others) <= {"inconsistent"} and len(others) <= stats.binom(2 * DRAWS, 1e-3).ppf(1.0 - RARE)


def test_errors_scatter_as_the_linear_covariance_along_every_axis(repeated):
    exact, estimates = repeated
    errors = np.array([c.candidates[0].p_surface_base for c in estimates]) - exact.p_surface_base
    variances, axes = np.linalg.eigh(exact.cov_surface_base)
    white = (errors @ axes / np.sqrt(variances)).T
    low, high = between(stats.chi2(len(estimates)))
    for row in white[1:]:  # the narrowest direction holds the bow, which is not normal
        assert low <= (row**2).sum() <= high
        assert len(estimates) * row.mean() ** 2 <= stats.chi2(1).ppf(1.0 - RARE)


def test_the_arclength_scatters_as_its_deviation(repeated):
    exact, estimates = repeated
    errors = (np.array([c.candidates[0].s_contact for c in estimates]) - exact.s_contact) / exact.std_s
    low, high = between(stats.chi2(len(estimates)))
    assert low <= (errors**2).sum() <= high


def test_the_misfit_of_one_touch_is_chi_square_of_one(repeated):
    exact, estimates = repeated
    assert exact.candidates[0].dof == 1
    misfits = np.array([c.candidates[0].chi2 for c in estimates])
    low, high = between(stats.chi2(len(estimates)))
    assert low <= misfits.sum() <= high
    assert stats.kstest(misfits, stats.chi2(1).cdf).pvalue > RARE


# Detection


@pytest.mark.parametrize("mount", [(9.81, 0, 0), (0, 0, -9.81)])
def test_a_free_probe_alarms_as_seldom_as_chi_square_of_six(mount, large):
    free, estimator = large.solve(mount).wrench_base, Estimator(large.model, EXACT)
    reads = free + np.random.default_rng(5).multivariate_normal(np.zeros(6), large.model.noise_base(), 300)
    estimates = [estimator.estimate(w, mount) for w in reads]
    # 300 readings at 1.4e-6 each: one alarm in 2400 such runs.
    assert {c.result for c in estimates} == {"no_contact"}
    assert stats.kstest([c.detection_chi2 for c in estimates], stats.chi2(6).cdf).pvalue > RARE


def test_the_detectable_force_is_detected_every_other_time(large, gravity):
    estimator, s = Estimator(large.model, EXACT), 0.5 * large.length
    free = large.solve(gravity, s, (0.0, 0.0, 0.0), columns="load")
    by_force = free.sensitivity.d_wrench[:, 1]
    wrench = free.wrench_base + estimator.detectable(by_force) * by_force
    reads = wrench + np.random.default_rng(2).multivariate_normal(np.zeros(6), large.model.noise_base(), 300)
    alarms = sum(estimator.detects(w, gravity) for w in reads)
    # Noncentral chi-square of six whose centre is the threshold t itself: its median is a little above.
    t = stats.chi2(6).ppf(1.0 - 1.4e-6)
    low, high = between(stats.binom(300, stats.ncx2(6, t).sf(t)))
    assert low <= alarms <= high
