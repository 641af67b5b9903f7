"""The compiled weighing against `doubts.py` and `causes.py`, which say the same with names."""

from dataclasses import replace

import numpy as np
import pytest

from probedesign.design import check_design
from probedesign.estimation import likelihood
from probedesign.estimation.doubts import Doubts
from probedesign.estimation.estimate import Candidate
from probedesign.estimation.observation import Observation
from probedesign.estimation.tolerances import Tolerances
from probedesign.estimation.weighing import Causes, Weighing
from probedesign.prediction.worlds import Worlds
from probedesign.probe import build_probe
from probedesign.rod.contact import solve_frictionless

SHAPES = {
    "large": {"shape": "cone", "length_mm": 150.0, "base_d_mm": 12.0, "tip_d_mm": 2.0},
    "small": {"shape": "cone", "length_mm": 50.0, "base_d_mm": 4.0, "tip_d_mm": 2.0},
    "cylinder": {"shape": "cylinder", "length_mm": 100.0, "base_d_mm": 6.0},
    "round tip": {"shape": "cone", "length_mm": 100.0, "base_d_mm": 8.0, "tip_d_mm": 3.0, "tip": "rounded"},
    "knots": {
        "shape": "profile",
        "length_mm": 120.0,
        "base_d_mm": 10.0,
        "profile_mm": [[s, 10.0 - s / 15.0 + np.sin(s)] for s in np.linspace(0.0, 120.0, 30).tolist()],
    },
    "hollow": {
        "shape": "cone",
        "length_mm": 120.0,
        "base_d_mm": 10.0,
        "tip_d_mm": 4.0,
        "section": "hollow",
        "bore_ratio": 0.5,
    },
    "elliptic": {
        "shape": "cone",
        "length_mm": 120.0,
        "base_d_mm": 10.0,
        "tip_d_mm": 3.0,
        "section": "elliptic",
        "flatness": 0.7,
    },
}
GRAVITY = np.array([7.0, 4.0, -5.0])
TOUCHES = [(0.3, 0.05, 0.4), (0.7, 0.02, 2.0), (0.95, 0.01, -2.5)]


def model_of(shape):
    return build_probe(check_design({"schema": 1, "name": "it", "probe": {**SHAPES[shape]}})).model


def touch_of(rod, fraction, force, angle):
    """A touch, and its base wrench."""
    touch = solve_frictionless(rod, GRAVITY, fraction * rod.flank_end, angle, force)
    assert touch.result == "ok"
    eq = touch.equilibrium
    return np.concatenate([eq.tip, touch.force_base, [eq.s_contact]]), eq.wrench_base


def seen_of(model, wrench):
    return Observation.of(model, wrench[None], GRAVITY, model.rod.solve(GRAVITY).wrench_base)


def candidate_of(state):
    nothing = np.full((3, 3), np.nan)
    return Candidate(
        state[9], np.nan, state[6:9], state[6:9], state[6:9], nothing, 0.0, 3, 1.0, state[:6], None
    )


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("tared", [True, False])
def test_the_compiled_weighing_is_the_clear_one(shape, tared):
    model = model_of(shape)
    tolerances = replace(Tolerances.of(model), tared=tared)
    doubts = Doubts.of(model, GRAVITY, tolerances)
    causes = causes_of(model, tolerances)
    for touch in TOUCHES:
        state, wrench = touch_of(model.rod, *touch)
        seen = seen_of(model, wrench)
        weighing = Weighing(causes, seen)
        assert weighing.at(state)
        clear = doubts.at([candidate_of(state)])[0]
        noise = seen.cov + doubts.drift
        # The compiled sweep takes steps of 1e-5, twenty times the fast rod's, and columns err a few tens of times more
        # than the state: hundredths of a percent, where a tolerance itself is known to a factor.
        for part, wanted in ((weighing.wrench, clear.wrench), (weighing.point, clear.point)):
            assert np.allclose(part, wanted, rtol=0.0, atol=1e-3 * np.abs(wanted).max(axis=1, keepdims=True))
        whiten = np.linalg.inv(np.linalg.cholesky(clear.cov_wrench(noise)))
        assert np.allclose(weighing.whiten @ np.linalg.inv(whiten), np.eye(6), atol=5e-3)
        cov = clear.cov_point(noise)
        assert np.allclose(weighing.cov_point, cov, rtol=0.0, atol=5e-3 * np.abs(cov).max())


def causes_of(model, tolerances, gravity=GRAVITY):
    return Causes.of(model, tolerances, gravity, model.rod.solve(gravity))


def test_a_touch_that_the_probe_cannot_hold_weighs_nothing():
    model = model_of("large")
    state, wrench = touch_of(model.rod, 0.95, 0.01, 0.4)
    weighing = Weighing(causes_of(model, Tolerances.of(model)), seen_of(model, wrench))
    state[6:9] *= 1e4
    assert not weighing.at(state)


@pytest.mark.parametrize("gravity", [GRAVITY, np.array([0.0, 0.0, -9.81])])
def test_what_a_tare_takes_away_is_the_free_probe_s(gravity):
    model = model_of("large")
    tolerances = Tolerances.of(model)
    wanted = Doubts.of(model, gravity, tolerances).still
    there = causes_of(model, tolerances).under(gravity, model.rod.solve(gravity))
    for causes in (causes_of(model, tolerances, gravity), there):
        # Hundredths of a percent, as above.
        assert np.allclose(
            causes.still, wanted, rtol=0.0, atol=1e-3 * np.abs(wanted).max(axis=1, keepdims=True)
        )


def test_the_estimate_is_the_likeliest_under_the_clear_doubts(probes):
    """Drawn worlds: what is answered is the fixed point of weighing as at the answer and fitting again."""
    probe, rng = probes["large"], np.random.default_rng(2)
    model, gravity = probe.model, probe.model.gravity_base
    estimator = probe.estimator().with_tolerances(probe.tolerances)
    doubts = Doubts.of(model, gravity, probe.tolerances)
    worlds = Worlds.draw(model, probe.tolerances, 12, 3)
    compared = 0
    for touch in ((0.6, 0.02, "+y"), (0.3, 0.2, "+y")):
        wrenches, _ = worlds.touched(*touch)
        for wrench in wrenches + worlds.noise(len(wrenches), rng):
            told = estimator.estimate(wrench)
            best = told.candidates[0]
            seen = Observation.of(model, wrench[None], gravity, estimator.free().wrench_base)
            noise = seen.cov + doubts.drift
            doubt = doubts.at([best])[0]
            again = min(
                likelihood.locate(model.rod, seen.known_to(doubt.cov_wrench(noise))), key=lambda c: c.chi2
            )
            # It was weighed as at the noise's likeliest place, up to a twentieth of the length off: a few hundredths.
            assert abs(again.s_contact - best.s_contact) < 0.1 * best.std_s
            assert abs(again.chi2 - best.chi2) < 0.05 * max(best.chi2, 1.0)
            assert np.allclose(
                best.cov_linear_base,
                doubt.cov_point(noise),
                rtol=0.0,
                atol=5e-3 * np.abs(best.cov_linear_base).max(),
            )
            compared += 1
    assert compared == 24
