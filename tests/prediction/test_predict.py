"""Test that the predicted error is the covariance of the estimator, its scaling, and invalid input."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from probedesign.core.errors import InputError
from probedesign.design import check_design, load_design
from probedesign.design.edit import tables_of
from probedesign.design.sensors import Noise
from probedesign.estimation.estimator import Estimator
from probedesign.estimation.fusion_state import SINGLE_FRICTION
from probedesign.estimation.model import Tolerances
from probedesign.optimization.objective import Task, design_metrics
from probedesign.prediction.budget import radius_95
from probedesign.prediction.fused import LinearizedPresses, PressSchedule
from probedesign.prediction.predict import Condition, predict, predict_touch
from probedesign.prediction.touches import touches_of
from probedesign.probe import build_probe
from probedesign.rod.contact import solve_surface_force
from probedesign.rod.kernels.surface_contact import POINT, VALUE

DESIGNS = Path(__file__).parents[2] / "designs"


@pytest.fixture(scope="module")
def large():
    return build_probe(load_design(DESIGNS / "large.toml"))


@pytest.fixture(scope="module")
def prediction(large):
    return large.predict(fractions=(0.4, 0.8), forces_N=(0.01, 0.1), directions=("+x", "+y"))


# The error


def at_sensor_noise_alone(large, friction):
    return Estimator(large.model, Tolerances.none()).with_friction(friction)


#: Cramér and Rao's bounds of the touched point [mm] by friction prior, contact fraction and force [N]: large probe,
#: gravity across, noise white at the sensor's origin (0.52 mN, 2.6 µN·m), 8.2 mm below the base. Computed independently
#: of this package, by a full-frame rod with the force at the surface, in the review that introduced the friction model.
BOUNDS = {
    0.0: {(0.4, 0.005): 7.12, (0.4, 0.02): 1.78, (0.4, 0.05): 0.72, (0.6, 0.005): 10.28, (0.6, 0.02): 2.55,
          (0.6, 0.05): 0.94, (0.8, 0.005): 13.05, (0.8, 0.02): 2.21, (0.8, 0.05): 0.41, (0.95, 0.005): 8.14,
          (0.95, 0.02): 0.57},
    0.3: {(0.4, 0.005): 7.15, (0.4, 0.02): 1.79, (0.4, 0.05): 0.72, (0.6, 0.005): 10.29, (0.6, 0.02): 2.58,
          (0.6, 0.05): 1.04, (0.8, 0.005): 13.41, (0.8, 0.02): 3.40, (0.8, 0.05): 1.44, (0.95, 0.005): 14.09,
          (0.95, 0.02): 4.01},
    0.6: {(0.4, 0.005): 7.16, (0.4, 0.02): 1.79, (0.4, 0.05): 0.72, (0.6, 0.005): 10.29, (0.6, 0.02): 2.58,
          (0.6, 0.05): 1.04, (0.8, 0.005): 13.45, (0.8, 0.02): 3.41, (0.8, 0.05): 1.44, (0.95, 0.005): 15.41,
          (0.95, 0.02): 4.35},
    float("inf"): {(0.4, 0.005): 7.16, (0.4, 0.02): 1.79, (0.4, 0.05): 0.72, (0.6, 0.005): 10.29, (0.6, 0.02): 2.58,
                   (0.6, 0.05): 1.04, (0.8, 0.005): 13.46, (0.8, 0.02): 3.41, (0.8, 0.05): 1.44,
                   (0.95, 0.005): 16.01, (0.95, 0.02): 4.48},
}  # fmt: skip


@pytest.mark.parametrize("friction", BOUNDS)
def test_noise_alone_gives_the_bounds_computed_independently(large, friction):
    estimator = at_sensor_noise_alone(large, friction)
    for (fraction, force), bound in BOUNDS[friction].items():
        # Two decimals are given; the probes differ by how the bonded root is modelled, a part in a hundred.
        error = predict_touch(estimator, fraction, force, "+y").noise_error_mm
        assert error == pytest.approx(bound, rel=0.02, abs=0.01)


#: The same of five touches pressed on, by place, greatest force [N] and standard deviation of E: moments about the base
#: alone and all six channels [mm], for friction 0, 0.3 and 0.6; poses repeat to 0.01 mm, the bias of each channel about
#: the base walks 0.2 steps a touch, independently of the others.
FUSED = {
    (0.5, 0.002, 0.03): ((3.12, 2.98), (3.17, 3.03), (3.33, 3.16)),
    (0.5, 0.005, 0.03): ((1.46, 1.41), (1.57, 1.50), (1.79, 1.65)),
    (0.8, 0.002, 0.03): ((1.71, 1.61), (1.74, 1.65), (1.83, 1.72)),
    (0.8, 0.005, 0.03): ((1.08, 1.06), (1.12, 1.09), (1.21, 1.18)),
    (0.8, 0.005, 0.005): ((0.60, 0.55), (0.66, 0.62), (0.80, 0.76)),
}


@pytest.mark.parametrize(("fraction", "force", "spread"), FUSED)
def test_five_touches_give_the_bounds_computed_independently(large, fraction, force, spread):
    known = replace(Tolerances.none(), youngs_modulus=spread, robot_mm=0.01, walk_steps=0.2)
    for friction, bounds in zip((0.0, 0.3, 0.6), FUSED[fraction, force, spread], strict=True):
        estimator = Estimator(large.model, known).with_friction(friction)
        for moments, bound in zip(("base", None), bounds, strict=True):
            schedule = PressSchedule(5, moments)
            steps = touches_of(estimator, [(fraction, "+y")], schedule.forces(force))
            press = LinearizedPresses(estimator.model, known, large.model.gravity_base,
                               np.array([step.touch[0] for step in steps.values()]), schedule)  # fmt: skip
            # The bounds let the bias walk about the base; the estimator lets it walk at the sensor, where it arises.
            # They take the friction of each touch for independent.
            press.state.friction_parts = SINGLE_FRICTION
            noise = large.model.noise
            step = np.sqrt(large.model.averaging_samples) * np.repeat([noise.force, noise.moment], 3)
            press.state.bias = np.ascontiguousarray(press.state.channels @ np.diag(step))
            rms = 1e3 * np.sqrt(np.trace(press.cov()))
            assert rms == pytest.approx(bound, rel=0.06)


@pytest.mark.parametrize(("fraction", "force", "direction"), [(0.4, 0.1, "+y"), (0.6, 0.02, "+x"), (0.8, 0.05, "-x")])
def test_the_prediction_is_the_covariance_of_the_estimator(large, fraction, force, direction):
    """With noise, all error sources and friction the prediction equals the covariance of `estimate` for that touch."""
    estimator = large.estimator()
    found = predict_touch(estimator, fraction, force, direction)
    touch = touches_of(estimator, [(fraction, direction)], [force])[force]
    c = estimator.estimate(touch.wrench[0])
    assert found.result == c.result == "ok"
    # The estimate ends within a hundredth of a standard deviation of the touch.
    best = c.candidates[0]
    assert found.predicted_error_mm == pytest.approx(1e3 * np.sqrt(np.trace(best.cov_linear_base)), rel=0.01)
    assert found.predicted_error_95_mm == pytest.approx(1e3 * radius_95(best.cov_linear_base), rel=0.01)
    assert found.std_s_mm == pytest.approx(1e3 * c.std_s, rel=0.01)
    total = touch.budget.cov_centre[0]
    np.testing.assert_allclose(total, best.cov_linear_contact_base, atol=0.01 * np.abs(total).max())


def test_the_error_by_friction_is_largest_near_the_tip(large):
    """At 0.95 L most of the error is due to the free direction of the force, which the frictionless model ignores."""
    with_, without = (predict_touch(large.estimator().with_friction(mu), 0.95, 0.02, "+y") for mu in (0.6, 0.0))
    assert with_.budget_mm["friction"] > 0.5 * with_.predicted_error_mm
    # A prior of zero is limited to a hundredth of the angle that a sensor resolves.
    assert without.budget_mm["friction"] < 5e-3 * without.predicted_error_mm
    added = with_.predicted_error_mm**2 - without.predicted_error_mm**2
    assert with_.budget_mm["friction"] ** 2 == pytest.approx(added, rel=1e-5)  # what the prior adds over none


def test_noisy_readings_have_the_predicted_error(large):
    estimator, readings, rare = Estimator(large.model, Tolerances.none()), 200, 1e-4
    found = predict_touch(estimator, 0.4, 0.1, "+y")
    touch = touches_of(estimator, [(0.4, "+y")], [0.1])[0.1]
    rng = np.random.default_rng(4)
    noise = rng.multivariate_normal(np.zeros(6), large.model.noise_base(), readings)
    estimates = [estimator.estimate(touch.wrench[0] + e) for e in noise]
    point = touch.lin[0, POINT : POINT + 3, VALUE]
    off = 1e3 * np.linalg.norm([c.p_surface_base - point for c in estimates], axis=1)
    # Σ|e|² over its mean scatters at most as chi-square of one degree a reading (all error along one line). Friction is
    # none in truth but 0.6 in the prior, so that a part of the predicted error is not drawn.
    share = (off**2).sum() / found.predicted_error_mm**2
    assert 0.8 * stats.chi2(readings).ppf(rare) <= share <= stats.chi2(readings).ppf(1.0 - rare)
    inside = (off <= found.predicted_error_95_mm).sum()
    assert inside >= stats.binom(readings, 0.95).ppf(rare)


def test_the_error_of_a_light_touch_is_inversely_proportional_to_force(large):
    estimator = Estimator(large.model, Tolerances.none())
    errors = [predict_touch(estimator, 0.6, f, "+y").predicted_error_mm for f in (1e-5, 2e-5, 4e-5)]
    # What is left is how far the touch itself moves the point: 40 µN at 90 mm, a hundredth of a millimetre.
    assert errors[0] / errors[1] == pytest.approx(2.0, rel=1e-3)
    assert errors[1] / errors[2] == pytest.approx(2.0, rel=1e-3)


def test_the_noise_alone_is_proportional_to_the_noise(large):
    noise = large.model.noise
    doubled = large.model.with_noise(Noise.isotropic(2 * noise.force, 2 * noise.moment))
    twice, once = (predict(replace(model, friction=0.0), (0.5,), (0.05,), ("+y",)) for model in (doubled, large.model))
    for name in ("noise_error_mm", "noise_error_95_mm"):
        # The prior on friction is not scaled; where it binds altogether, only the solver's own error is left.
        assert getattr(twice.conditions[0], name) == pytest.approx(2 * getattr(once.conditions[0], name), rel=1e-3)
    felt = [p.detection[0].detectable_force_mN for p in (twice, once)]
    assert felt[0] == pytest.approx(2 * felt[1], rel=1e-9)
    assert once.noise_force_mN == pytest.approx(1e3 * noise.force, rel=1e-15)


# Other values of a condition


def test_compliances_are_those_of_pressing_on(large):
    """The result agrees with the independent solver of a force at the deformed surface."""
    h, force, s = 1e-4, 0.05, 0.5 * large.length
    low, high = (
        solve_surface_force(large.rod, large.model.gravity_base, s, -np.pi / 2, f, mode="reference")
        for f in (force - h, force + h)
    )
    found = predict_touch(large.estimator(), 0.5, force, "+y")
    change = (high.equilibrium.wrench_base - low.equilibrium.wrench_base) / (2.0 * h)
    press = high.p_surface_base - low.p_surface_base
    mean = (low.force_base + high.force_base) / 2.0
    per_N_mm = 1e3 * press @ mean / np.linalg.norm(mean) / (2.0 * h)
    # Differences over a five-hundredth of the force: h²; fast mode: 1e-6.
    assert found.moment_per_N_Nmm == pytest.approx(1e3 * np.linalg.norm(change[3:]), rel=1e-4)
    assert found.force_per_N_N == pytest.approx(np.linalg.norm(change[:3]), rel=1e-4)
    assert found.moment_per_mm_Nmm == pytest.approx(found.moment_per_N_Nmm / per_N_mm, rel=1e-4)
    assert found.force_per_mm_N == pytest.approx(found.force_per_N_N / per_N_mm, rel=1e-4)


def test_the_detectable_force_is_the_limit_of_detection(large):
    """Prediction, optimisation and estimator have the same force of detection probability one half."""
    found = predict(large.model, (0.6,), (0.01,), ("+y",)).detection[0]
    force = 1e-3 * found.detectable_force_mN
    assert predict_touch(large.estimator(), 0.6, 0.99 * force, "+y").result == "no_contact"
    assert predict_touch(large.estimator(), 0.6, 1.01 * force, "+y").result in ("ok", "too_light")


def test_a_touch_beyond_the_sensor_is_flagged(large):
    limit = large.model.wrench_range[0]
    below, above = (predict_touch(large.estimator(), 0.05, f, "+y") for f in (0.3 * limit, 1.1 * limit))
    assert below.result == "ok" and 0.0 < below.sensor_use < 1.0
    assert above.result == "out_of_range" and above.sensor_use > 1.0


def test_a_touch_that_buckles_the_probe_has_no_numbers(large):
    found = predict_touch(large.estimator(), 1.0, 5.0, "+y")
    assert found.result in ("gives_way", "not_converged")
    assert found == Condition(1.0, 5.0, "+y", found.result)


def made_of(youngs_mpa, pressing=None):
    """Return the large probe with another material."""
    tables = tables_of(load_design(DESIGNS / "large.toml"))
    tables["material"] |= {"youngs_modulus_mpa": youngs_mpa, "shear_modulus_mpa": youngs_mpa / 3.0}
    probe = build_probe(check_design(tables))
    return probe.predict(fractions=(0.5, 1.0), directions=("+x", "-x"), pressing=pressing)


def test_a_force_beyond_buckling_is_not_detectable():
    """A tip this soft buckles under less force than the sensor detects."""
    soft = made_of(0.02)
    limits = {(r.contact_fraction, r.direction): r.greatest_force_N for r in soft.reach}
    felt = {(d.contact_fraction, d.direction): d.detectable_force_mN for d in soft.detection}
    assert felt[1.0, "+x"] is None or felt[1.0, "-x"] is None
    assert all(force is None or force <= 1e3 * limits[line] for line, force in felt.items())
    assert felt[0.5, "+x"] is not None


def test_what_is_not_located_has_no_budget():
    """Moments alone do not locate a touch of a probe that does not bend, although a linear formula gives a number."""
    assert all(c.budget_mm is None for c in made_of(20000.0, PressSchedule(5, "sensor")).fused)


def test_mirrored_directions_have_equal_errors(large):
    one, other = (predict_touch(large.estimator(), 0.6, 0.05, d) for d in ("+y", "-y"))
    # The base in the sensor's frame need not be mirror-symmetric, its noise about the base's z is.
    assert one.predicted_error_mm == pytest.approx(other.predicted_error_mm, rel=1e-6)


# The answer as a whole


def test_the_documented_keys_are_in_the_json(prediction):
    document = json.loads(json.dumps(prediction.as_dict(), allow_nan=False))
    required = {"contact_fraction", "force_N", "direction", "predicted_error_mm", "predicted_error_95_mm"}
    for condition in document["conditions"]:
        assert required <= condition.keys()
        if condition["result"] == "ok":
            assert 0.0 < condition["predicted_error_mm"] < condition["predicted_error_95_mm"]
    assert document["name"] == "large" and document["assumptions"]


def test_mass_and_sag_are_the_probes(large, prediction):
    assert prediction.mass_g == pytest.approx(1e3 * large.mass, rel=1e-12)
    tip = large.solve(mode="reference").p_base[-1]
    assert prediction.tip_sag_mm == pytest.approx(1e3 * tip[0], abs=1e-3)  # gravity is along x


def test_sag_is_measured_along_gravity_as_in_campaigns(large):
    """Under oblique gravity the tip does not move along it: prediction and optimisation use the same component."""
    gravity = np.array([6.0, 0.0, 7.0])
    model = replace(large.model, gravity_base=gravity)
    moved = large.rod.solve(gravity, mode="reference").p_at(large.length) - [0.0, 0.0, large.length]
    wanted = 1e3 * moved @ gravity / np.linalg.norm(gravity)
    assert 0.0 < wanted < 0.9e3 * np.linalg.norm(moved)
    assert predict(model, (0.5,), (0.01,), ("+y",)).tip_sag_mm == pytest.approx(wanted, abs=1e-3)
    tables = tables_of(large.design)
    tables["mount"]["gravity_base_m_s2"] = gravity.tolist()
    found = design_metrics(check_design(tables), Task(fractions=(0.5,)))
    assert found.sag_mm == pytest.approx(wanted, abs=1e-3)


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
def test_an_invalid_grid_is_refused(large, grid):
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
def test_the_quantile_of_any_ellipsoid_contains_its_share(variances):
    draws = np.random.default_rng(1).normal(size=(200_000, 3)) * np.sqrt(variances)
    inside = (np.linalg.norm(draws, axis=1) <= radius_95(np.diag(variances))).mean()
    # Four standard deviations of a binomial share.
    assert inside == pytest.approx(0.95, abs=4.0 * np.sqrt(0.95 * 0.05 / 200_000))


def test_the_quantile_of_what_is_no_covariance():
    assert np.isnan(radius_95(np.full((3, 3), np.nan)))
    assert radius_95(np.diag([np.inf, 1.0, 1.0])) == np.inf
    assert radius_95(np.zeros((3, 3))) == 0.0


def test_an_hour_on_the_bench_gains_what_a_better_known_stiffness_does(large):
    """The gain is the prediction with E and G to 3 %; there is none for a probe that is known better."""
    unidentified = replace(large.model, tolerances=Tolerances())
    shown, benched = (
        predict(unidentified, (0.8,), (0.005, 0.01), tolerances=tolerances)
        for tolerances in (None, replace(Tolerances(), youngs_modulus=0.03, shear_modulus=0.03))
    )
    gain, single = shown.bench_gain, [c for c in benched.conditions if c.force_N == 0.01]
    assert gain.predicted_error_mm == pytest.approx(max(c.predicted_error_mm for c in single), rel=1e-6)
    assert gain.fused_error_mm == pytest.approx(benched.fused_headline.predicted_error_mm, rel=1e-6)
    assert gain.fused_error_mm < 0.8 * shown.fused_headline.predicted_error_mm  # 2.7 of 4.0 mm: E is the largest cause
    assert benched.bench_gain is None and predict(large.model, (0.8,), (0.01,)).bench_gain is None
