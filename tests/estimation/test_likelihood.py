"""The default method against a plain search for the same maximum, and what it makes of windows and neighbours."""

import numpy as np
import pytest
from scipy.optimize import minimize

from probedesign.errors import InputError
from probedesign.estimation import doubtful
from probedesign.estimation.likelihood import Fitter
from probedesign.estimation.observation import Observation
from probedesign.estimation.weighing import Causes
from probedesign.rod.contact import solve_frictionless


def plain(model, wrench, gravity, start):
    """(s, angle, magnitude) of least whitened misfit, by a simplex on whole frictionless equilibria."""
    unit = np.array([start[0], 1.0, start[2]])

    def misfit(x):
        touch = solve_frictionless(model.rod, gravity, *(x * unit))
        if touch.result != "ok":
            return 1e9
        return float(((model.whiten @ (touch.equilibrium.wrench_base - wrench)) ** 2).sum())

    options = {"xatol": 1e-9, "fatol": 1e-9, "maxiter": 4000}
    found = minimize(misfit, np.asarray(start) / unit, method="Nelder-Mead", options=options)
    assert found.success
    return found.x * unit, float(found.fun)


@pytest.mark.parametrize(
    ("name", "fraction", "force", "angle"),
    [
        ("large", 0.4, 0.1, 1.57),
        ("large", 0.8, 0.02, 0.4),
        ("medium", 0.7, 0.05, 3.0),
        ("small", 0.6, 0.08, -1.2),
    ],
)
def test_it_finds_what_a_plain_search_finds(name, fraction, force, angle, probes, gravity):
    model = probes[name].model
    s = fraction * model.rod.length
    exact = solve_frictionless(model.rod, gravity, s, angle, force, "reference").equilibrium.wrench_base
    wrench = exact + np.random.default_rng(1).multivariate_normal(np.zeros(6), model.noise_base())
    c = probes[name].estimator().estimate(wrench, gravity)
    by_hand, chi2 = plain(model, wrench, gravity, (s, angle, force))
    assert c.result == "ok"
    # Both stop a thousandth of a standard deviation from the top; sweeps add a few thousandths of the noise.
    assert abs(c.s_contact - by_hand[0]) <= 1e-2 * c.std_s
    assert np.linalg.norm(c.force_base) == pytest.approx(by_hand[2], abs=1e-2 * model.noise.force)
    assert c.candidates[0].chi2 == pytest.approx(chi2, abs=2e-2)


def test_a_window_is_as_good_as_its_mean_and_better_than_one(large, gravity, touched):
    rng, model = np.random.default_rng(2), large.model
    window = touched(0.09, 0.03) + rng.multivariate_normal(np.zeros(6), model.noise_base(), 25)
    estimator = large.estimator()
    c, one = estimator.estimate(window, gravity), estimator.estimate(window[0], gravity)
    sharp = estimator.with_noise(model.noise.force / 5.0, model.noise.moment / 5.0)
    mean = sharp.estimate(window.mean(axis=0), gravity)
    assert c.result == "ok"
    assert c.s_contact == pytest.approx(mean.s_contact, abs=1e-3 * c.std_s)
    assert c.std_s == pytest.approx(mean.std_s, rel=1e-3)
    assert c.std_s == pytest.approx(
        one.std_s / 5.0, rel=0.1
    )  # the force they are told at differs by its noise


def test_a_window_with_one_bad_reading_is_out_of_range(large, gravity, touched):
    window = np.tile(touched(0.09, 0.03), (5, 1))
    window[3, 2] = np.nan
    assert large.estimator().estimate(window, gravity).result == "out_of_range"


def test_from_a_neighbour_it_finds_the_same(large, gravity, touched):
    estimator = large.estimator()
    near = estimator.estimate(touched(0.09, 0.03), gravity)
    wrench = touched(0.092, 0.031)
    a, b = estimator.estimate(wrench, gravity), estimator.estimate(wrench, gravity, near=near)
    assert a.result == b.result == "ok"
    assert a.s_contact == pytest.approx(b.s_contact, abs=1e-3 * a.std_s)


def test_a_neighbour_that_is_none_does_no_harm(large, gravity, touched):
    estimator = large.estimator()
    far = estimator.estimate(touched(0.03, 0.3, -1.0), gravity)
    wrench = touched(0.135, 0.01)
    a, b = estimator.estimate(wrench, gravity), estimator.estimate(wrench, gravity, near=far)
    assert b.result == "ok"
    assert a.s_contact == pytest.approx(b.s_contact, abs=1e-2 * a.std_s)


@pytest.mark.parametrize("friction", [0.3, 0.5])
@pytest.mark.parametrize("way", ["along", "around"])
def test_friction_is_told(friction, way, large, gravity):
    """A tangential force at the touched point of 0.1 N: far above what the sensor misses."""
    s, force = 0.06, 0.1
    touch = solve_frictionless(large.rod, gravity, s, 1.57, force)
    normal = touch.force_base / force
    tangent = touch.equilibrium.R_at(s)[:, 2]
    aside = tangent if way == "along" else np.cross(tangent, normal)
    pushed = touch.force_base + friction * force * aside
    arm = -normal * np.interp(s, large.rod.s, large.rod.radius)
    eq = large.rod.solve(gravity, pushed, s, couple=np.cross(arm, pushed))
    assert large.estimator().estimate(eq.wrench_base, gravity).result == "inconsistent"


def test_a_method_that_is_none_is_refused(large):
    with pytest.raises(InputError, match="method"):
        large.estimator().estimate(np.zeros(6), method="guess")


def test_what_stood_in_its_memory_before_does_not_count(probes, gravity, monkeypatch):
    """A faint reading: the fit begins where the sweep fails, and has no equations yet."""
    estimator = probes["large"].estimator().with_tolerances()
    wrench = np.array([6.55227547e-02, 7.96323486e-04, -1.56354361e-03,
                       -6.34392281e-06, 2.98214533e-03, 3.07885268e-06])  # fmt: skip
    free = estimator.free(gravity).wrench_base
    seen = Observation.of(estimator.model, wrench[None], np.asarray(gravity), free)
    causes = Causes.of(estimator.model, estimator.tolerances, np.asarray(gravity), estimator.free(gravity))
    made, rng = Fitter.__post_init__, np.random.default_rng(1)

    def forces(scale):
        def begun(self):
            made(self)
            self._work[:] = scale * rng.standard_normal(len(self._work))

        monkeypatch.setattr(Fitter, "__post_init__", begun)
        return [place.force_base.tolist() for place in doubtful.locate(causes, seen)]

    clean = forces(0.0)
    assert clean and all(forces(scale) == clean for scale in (1e-5, 1e-4, 1e-3, 1e-2, 1.0) for _ in range(3))
