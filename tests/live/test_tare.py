"""The tare: takes a constant bias off whole, and is refused where the probe is not free."""

from dataclasses import replace

import numpy as np
import pytest

from probedesign.core.errors import InputError
from probedesign.live.processing.blocks import group_readings, iter_readings
from probedesign.live.processing.scheduler import ProcessingOptions
from probedesign.live.processing.tare import TareWindow, parse_window, split_at_tare, take_tare, without_bias
from probedesign.live.run import estimate_stream
from probedesign.live.sources.sim import SimulatedSource

BIAS = np.array([0.7, -0.3, 1.1, 0.004, -0.002, 0.001])
"""[N, N·m]: of the size that a sensor shows after it was screwed down."""


@pytest.fixture(scope="module")
def readings(estimator):
    """Free for 2 s, pressed from there on."""
    return list(iter_readings(SimulatedSource(estimator.model, "speed=max&rate_hz=10&seconds=6")))


@pytest.fixture(scope="module")
def biased(readings):
    return [replace(reading, wrench_sensor=reading.wrench_sensor + BIAS) for reading in readings]


def test_a_constant_bias_goes_whole(estimator, readings, biased):
    """Up to the noise's own mean, which both windows share: 1e-12 allows for the rounding of sums of 20."""
    window = TareWindow(0.0, 2.0)
    with_bias = take_tare(split_at_tare(biased, window)[0], window, estimator)
    without = take_tare(split_at_tare(readings, window)[0], window, estimator)
    assert with_bias.readings == 20
    assert with_bias.bias_sensor - without.bias_sensor == pytest.approx(BIAS, rel=1e-12)
    for reading, raw in zip(readings, biased, strict=True):
        expected = without_bias(reading, without).wrench_sensor
        assert without_bias(raw, with_bias).wrench_sensor == pytest.approx(expected, abs=1e-14)  # of 1 N


def test_the_noise_of_the_window_is_all_that_is_left(estimator, biased):
    """The mean of 20 readings is off by σ/√20, by 5 of these at most."""
    window = TareWindow(0.0, 2.0)
    tare = take_tare(split_at_tare(biased, window)[0], window, estimator)
    std = estimator.model.noise.std
    assert (np.abs(tare.bias_sensor - BIAS) < 5.0 * std / np.sqrt(20.0)).all()


def test_no_tare_is_taken_unasked(estimator, biased):
    source = Fixed(biased[::10])  # a force of 1 N bends the probe far: few of these, they are slow
    results = {
        a.estimate.result for a in estimate_stream(estimator, source, ProcessingOptions(), lambda note: None)
    }
    assert "no_contact" not in results and "ok" not in results


def test_live_estimates_begin_after_the_window(estimator, biased):
    told: list[str] = []
    plan = ProcessingOptions(window=TareWindow(0.5, 2.0))
    answers = list(estimate_stream(estimator, Fixed(biased), plan, told.append))
    assert answers[0].reading.time == 2.0
    assert len(answers) == 40
    assert "tare from 15 readings in 0.5:2 s: Fx 700 mN, Fy -300 mN" in told[0]
    last, estimate = answers[-1].reading, answers[-1].estimate
    assert estimate.ok
    assert abs(estimate.s_contact - last.truth.s_contact) < 5.0 * estimate.std_s  # bias and reading are noisy


@pytest.mark.parametrize(
    ("window", "told"),
    [
        (TareWindow(2.0, 4.0), "tare window 2:4 s is not steady: My scatters by"),
        (TareWindow(1.0, 2.7), "is not steady"),
        (TareWindow(3.5, 6.0), "is not steady"),  # the force is constant there, and the contact moves
        (TareWindow(0.0, 0.5), "has 5 readings; a tare needs 10"),
        (TareWindow(60.0, 70.0), "has 0 readings"),
    ],
)
def test_a_window_that_is_not_free_is_refused(estimator, readings, window, told):
    with pytest.raises(InputError) as error:
        take_tare(split_at_tare(readings, window)[0], window, estimator)
    assert told in str(error.value)


@pytest.mark.parametrize(
    "text", ["", "2", "2:", ":2", "2:1", "1:1", "-1:2", "0:nan", "0:inf", "a:b", "0:1:2"]
)
def test_what_is_no_window(text):
    with pytest.raises(InputError, match="must be START:END"):
        parse_window(text)


def test_a_window():
    assert parse_window("0.5:2") == TareWindow(0.5, 2.0)


class Fixed:
    """A source of known readings."""

    title, notes = "", ()

    def __init__(self, readings) -> None:
        self.readings = readings

    def __iter__(self):
        yield from group_readings(self.readings, 3)
