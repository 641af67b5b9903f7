"""The predicted error is the estimator's own covariance, scales as it must, and refuses nonsense."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from probedesign.cli.prediction_tables import print_all
from probedesign.design import check_design, load_design
from probedesign.errors import InputError
from probedesign.prediction.predict import DIRECTIONS, Condition, predict, predict_touch
from probedesign.prediction.quantile import radius_95
from probedesign.probe import build_probe
from probedesign.rod.contact import solve_frictionless
from probedesign.search.grid import tables_of
from probedesign.sensor import Noise

DESIGNS = Path(__file__).parents[1] / "designs"


@pytest.fixture(scope="module")
def large():
    return build_probe(load_design(DESIGNS / "large.toml"))


@pytest.fixture(scope="module")
def prediction(large):
    return large.predict(fractions=(0.4, 0.8), forces_N=(0.01, 0.1), directions=("+x", "+y"))


# The error


@pytest.mark.parametrize(
    ("fraction", "force", "direction"), [(0.4, 0.1, "+y"), (0.8, 0.01, "-x"), (1.0, 0.005, "+x")]
)
def test_it_is_the_estimators_own_covariance(large, fraction, force, direction):
    noise = large.model.noise
    estimator = large.estimator().with_noise(0.01 * noise.force, 0.01 * noise.moment)
    found = predict_touch(estimator, fraction, force, direction)
    touch = solve_frictionless(
        large.rod, large.model.gravity_base, fraction * large.length, DIRECTIONS[direction], force
    )
    c = estimator.estimate(touch.equilibrium.wrench_base)
    assert found.result == c.result == "ok"
    # A hundredth of the noise, where what the estimator counts to second order is small; but then it also counts the
    # fast rod's error, 0.25 µm beside 3.5 µm. The estimate solves once more: two fast answers, 1e-6 of the moment.
    assert found.predicted_error_mm == pytest.approx(1e3 * np.sqrt(np.trace(c.cov_contact_base)), rel=1e-2)
    assert found.predicted_error_95_mm == pytest.approx(1e3 * radius_95(c.cov_contact_base), rel=1e-2)
    assert found.std_s_mm == pytest.approx(1e3 * c.std_s, rel=1e-3)  # sweeps as fine as the noise needs


def test_noisy_readings_err_as_predicted(large):
    estimator, readings, rare = large.estimator(), 200, 1e-4
    found = predict_touch(estimator, 0.4, 0.1, "+y")
    eq = solve_frictionless(
        large.rod, large.model.gravity_base, 0.4 * large.length, np.pi / 2, 0.1
    ).equilibrium
    rng = np.random.default_rng(4)
    noise = rng.multivariate_normal(np.zeros(6), large.model.noise_base(), readings)
    estimates = [estimator.estimate(eq.wrench_base + e) for e in noise]
    off = 1e3 * np.linalg.norm([c.p_contact_base - eq.p_contact_base for c in estimates], axis=1)
    # Σ|e|² over its mean scatters at most as chi-square of one degree a reading (all error along one line).
    share = (off**2).sum() / found.predicted_error_mm**2
    assert stats.chi2(readings).ppf(rare) <= share <= stats.chi2(readings).ppf(1.0 - rare)
    inside = (off <= found.predicted_error_95_mm).sum()
    assert stats.binom(readings, 0.95).ppf(rare) <= inside <= stats.binom(readings, 0.95).ppf(1.0 - rare)


def test_a_slight_touch_errs_as_one_over_its_force(large):
    errors = [predict_touch(large.estimator(), 0.6, f, "+y").predicted_error_mm for f in (1e-5, 2e-5, 4e-5)]
    # What is left is how far the touch itself moves the point: 40 µN at 90 mm, a hundredth of a millimetre.
    assert errors[0] / errors[1] == pytest.approx(2.0, rel=1e-3)
    assert errors[1] / errors[2] == pytest.approx(2.0, rel=1e-3)


def test_the_error_is_proportional_to_the_noise(large):
    noise = large.model.noise
    twice = predict(
        large.model.with_noise(Noise(2 * noise.force, 2 * noise.moment)), (0.5,), (0.05,), ("+y",)
    )
    once = predict(large.model, (0.5,), (0.05,), ("+y",))
    for name in ("predicted_error_mm", "predicted_error_95_mm", "std_s_mm"):
        assert getattr(twice.conditions[0], name) == pytest.approx(
            2 * getattr(once.conditions[0], name), rel=1e-6
        )
    felt = [p.detection[0].detectable_force_mN for p in (twice, once)]
    assert felt[0] == pytest.approx(2 * felt[1], rel=1e-9)
    assert once.noise_force_mN == pytest.approx(1e3 * noise.force, rel=1e-15)


def test_the_lever_arm_is_as_vague_as_the_force(large):
    """σ_s ≈ s σ_F/F where the moment is read sharply: the bound that no single touch can beat."""
    found = predict_touch(large.estimator(), 0.4, 0.02, "+y")
    noise = large.model.noise
    wanted = 0.4 * large.length * noise.force / 0.02
    assert 1e-3 * found.std_s_mm == pytest.approx(wanted, rel=0.2)  # bending and moment noise are left out


# What else a condition tells


def test_compliances_are_those_of_pressing_on(large):
    h, force = 1e-4, 0.05
    low, high = (
        solve_frictionless(large.rod, large.model.gravity_base, 0.5 * large.length, np.pi / 2, f, "reference")
        for f in (force - h, force + h)
    )
    found = predict_touch(large.estimator(), 0.5, force, "+y")
    change = (high.equilibrium.wrench_base - low.equilibrium.wrench_base) / (2.0 * h)
    press = high.equilibrium.p_contact_base - low.equilibrium.p_contact_base
    mean = (low.force_base + high.force_base) / 2.0
    per_N_mm = 1e3 * press @ mean / np.linalg.norm(mean) / (2.0 * h)
    # Differences over a five-hundredth of the force: h²; fast mode: 1e-6.
    assert found.moment_per_N_Nmm == pytest.approx(1e3 * np.linalg.norm(change[3:]), rel=1e-4)
    assert found.force_per_N_N == pytest.approx(np.linalg.norm(change[:3]), rel=1e-4)
    assert found.moment_per_mm_Nmm == pytest.approx(found.moment_per_N_Nmm / per_N_mm, rel=1e-4)
    assert found.force_per_mm_N == pytest.approx(found.force_per_N_N / per_N_mm, rel=1e-4)


def test_a_touch_at_the_detectable_force_is_on_the_verge(large):
    found = predict(large.model, (0.6,), (0.01,), ("+y",)).detection[0]
    force = 1e-3 * found.detectable_force_mN
    assert predict_touch(large.estimator(), 0.6, 0.99 * force, "+y").result == "no_contact"
    assert predict_touch(large.estimator(), 0.6, 1.01 * force, "+y").result in ("ok", "too_light")


def test_a_touch_beyond_the_sensor_is_flagged(large):
    limit = large.model.wrench_range[0]
    below, above = (predict_touch(large.estimator(), 0.05, f, "+y") for f in (0.3 * limit, 1.1 * limit))
    assert below.result == "ok" and 0.0 < below.sensor_use < 1.0
    assert above.result == "out_of_range" and above.sensor_use > 1.0


def test_a_touch_that_the_probe_cannot_hold_has_no_numbers(large):
    found = predict_touch(large.estimator(), 1.0, 5.0, "+y")
    assert found.result in ("gives_way", "not_converged")
    assert found == Condition(1.0, 5.0, "+y", found.result)


def made_of(youngs_mpa):
    """The large probe of another material."""
    tables = tables_of(load_design(DESIGNS / "large.toml"))
    tables["material"] |= {"youngs_modulus_mpa": youngs_mpa, "shear_modulus_mpa": youngs_mpa / 3.0}
    return build_probe(check_design(tables)).predict(fractions=(0.5, 1.0), directions=("+x", "-x"))


def test_a_force_that_is_not_borne_is_not_felt():
    """So soft a tip hangs and gives way under less than the sensor tells."""
    soft = made_of(0.02)
    borne = {(r.contact_fraction, r.direction): r.greatest_force_N for r in soft.reach}
    felt = {(d.contact_fraction, d.direction): d.detectable_force_mN for d in soft.detection}
    assert felt[1.0, "+x"] is None or felt[1.0, "-x"] is None
    assert all(force is None or force <= 1e3 * borne[line] for line, force in felt.items())
    assert felt[0.5, "+x"] is not None


def test_what_is_not_located_has_no_budget_in_the_tables(capsys):
    """Moments alone of a probe that does not bend tell no place, whatever a linear formula makes of it."""
    print_all(made_of(20000.0))
    fused = capsys.readouterr().out.split("Error budget")[2]
    assert "none, for no place is located" in fused and "e+" not in fused.split("What it takes")[0]


def test_mirror_sides_err_alike(large):
    one, other = (predict_touch(large.estimator(), 0.6, 0.05, d) for d in ("+y", "-y"))
    # The base in the sensor's frame need not be mirror-symmetric, its noise about the base's z is.
    assert one.predicted_error_mm == pytest.approx(other.predicted_error_mm, rel=1e-6)


# The answer as a whole


def test_the_grid_is_whole(prediction):
    grid = {(c.contact_fraction, c.force_N, c.direction) for c in prediction.conditions}
    assert grid == {(s, f, d) for s in (0.4, 0.8) for f in (0.01, 0.1) for d in ("+x", "+y")}
    assert len(prediction.conditions) == 8 and len(prediction.detection) == 4


def test_the_promised_keys_are_in_the_json(prediction):
    document = json.loads(json.dumps(prediction.as_dict(), allow_nan=False))
    promised = {"contact_fraction", "force_N", "direction", "predicted_error_mm", "predicted_error_95_mm"}
    for condition in document["conditions"]:
        assert promised <= condition.keys()
        if condition["result"] == "ok":
            assert 0.0 < condition["predicted_error_mm"] < condition["predicted_error_95_mm"]
    assert document["name"] == "large" and document["assumptions"]


def test_mass_and_sag_are_the_probes(large, prediction):
    assert prediction.mass_g == pytest.approx(1e3 * large.mass, rel=1e-12)
    tip = large.solve(mode="reference").p_base[-1]
    assert prediction.tip_sag_mm == pytest.approx(1e3 * np.linalg.norm(tip - [0, 0, large.length]), abs=1e-3)


@pytest.mark.parametrize(
    "grid",
    [
        {"fractions": (0.0,)},
        {"fractions": (0.5, 1.01)},
        {"fractions": (float("nan"),)},
        {"forces_N": (0.0,)},
        {"forces_N": (-0.1,)},
        {"forces_N": (float("nan"),)},
        {"forces_N": (float("inf"),)},
        {"directions": ("up",)},
    ],
)
def test_a_grid_that_makes_no_sense_is_refused(large, grid):
    with pytest.raises(InputError):
        large.predict(**{"fractions": (0.5,), "forces_N": (0.01,), "directions": ("+x",), **grid})


# The quantile


@pytest.mark.parametrize(
    ("variances", "radius"),
    [((1, 0, 0), 1.959964), ((1, 1, 0), 2.447747), ((1, 1, 1), 2.795483)],
    ids=["normal", "Rayleigh", "Maxwell"],
)
@pytest.mark.parametrize("scale", [1e-12, 1.0, 1e6])
def test_the_quantile_of_the_round_cases(variances, radius, scale):
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    cov = scale * turn @ np.diag(variances).astype(float) @ turn.T
    # Tables to seven digits; the quadrature's own error on the needle and the disc.
    assert radius_95(cov) == pytest.approx(np.sqrt(scale) * radius, rel=2e-4)


@pytest.mark.parametrize("variances", [(1.0, 0.3, 0.1), (1.0, 0.05, 0.04), (1.0, 0.9, 1e-6)])
def test_the_quantile_of_any_ellipsoid_holds_its_share(variances):
    draws = np.random.default_rng(1).normal(size=(200_000, 3)) * np.sqrt(variances)
    inside = (np.linalg.norm(draws, axis=1) <= radius_95(np.diag(variances))).mean()
    # Four standard deviations of a binomial share.
    assert inside == pytest.approx(0.95, abs=4.0 * np.sqrt(0.95 * 0.05 / 200_000))


def test_the_quantile_of_what_is_no_covariance():
    assert np.isnan(radius_95(np.full((3, 3), np.nan)))
    assert radius_95(np.diag([np.inf, 1.0, 1.0])) == np.inf
    assert radius_95(np.zeros((3, 3))) == 0.0


@pytest.mark.parametrize(
    "share",
    [0.5, 0.9, 0.99],
)
def test_the_quantile_of_another_share(share):
    assert radius_95(np.eye(3), share) == pytest.approx(np.sqrt(stats.chi2(3).ppf(share)), rel=1e-5)
