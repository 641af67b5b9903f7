"""`sim:`: the estimator finds the contact that the simulation knows, within its stated uncertainty."""

import numpy as np
import pytest

from probedesign.core.errors import InputError
from probedesign.live.blocks import WrenchReading, iter_readings
from probedesign.live.processing.estimates import locate
from probedesign.live.sources.sim import SimulatedSource

FAST = "speed=max&rate_hz=10"


def read(model, query):
    return iter_readings(SimulatedSource(model, query))


def errors(estimator, readings: list[WrenchReading]) -> list[tuple[float, float]]:
    """Error of s_contact and its standard deviation [m], for each reading with an answer."""
    answers = [(reading, locate(estimator, reading)) for reading in readings]
    return [(e.s_contact - r.truth.s_contact, e.std_s) for r, e in answers if e.ok]


def test_the_truth_lies_within_the_estimated_interval(estimator):
    """Of a Gaussian 99.994 % lies within 4 standard deviations; a percent is left for the first order of the
    covariance."""
    found = errors(estimator, list(read(estimator.model, FAST + "&seed=1")))
    assert len(found) > 150  # the contact presses for 0.8 of the 200 readings
    within = [abs(error) < 4.0 * std for error, std in found]
    assert np.mean(within) >= 0.99


def test_without_noise_the_answer_is_the_truth(estimator):
    """The simulation is of reference accuracy, the estimator's fast solve keeps the base torque within 1e-6:
    of 0.1 m of lever that is 0.1 µm, a hundredth of the bound."""
    quiet = estimator.with_noise(force_N=1e-9, moment_Nm=5e-12)
    found = errors(quiet, list(read(quiet.model, "speed=max&rate_hz=3")))
    assert len(found) == 47  # every reading but the free ones: 0.8 of the 60, less the ends of the ramps
    assert max(abs(error) for error, _ in found) < 0.01e-3


def test_the_free_probe_is_called_free_and_its_weight_is_felt(estimator):
    readings = list(read(estimator.model, FAST + "&seconds=2"))
    assert all(np.isnan(reading.truth.s_contact) for reading in readings)
    assert {locate(estimator, reading).result for reading in readings} == {"no_contact"}
    model = estimator.model  # noise at most 6σ; flange and adapter weigh 96 mN, 180 σ
    weight = (model.mass + model.payload.mass) * model.gravity_base
    assert readings[0].wrench_sensor[:3] == pytest.approx(weight, abs=6 * model.noise.force)


def test_a_run_repeats_and_another_seed_does_not(estimator):
    def run(query):
        return np.array([r.wrench_sensor for r in read(estimator.model, FAST + "&seconds=1&" + query)])

    assert np.array_equal(run("seed=1"), run("seed=1"))
    assert not np.array_equal(run("seed=1"), run("seed=2"))


def test_a_force_without_equilibrium_is_refused_before_the_first_reading(estimator):
    with pytest.raises(InputError, match=r"no equilibrium under 1000 mN at s = .* mm .*reduce force_mN"):
        next(iter(SimulatedSource(estimator.model, "force_mN=1000")))
