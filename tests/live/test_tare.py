"""The tare removes a constant bias and is refused where the probe is not free; the schedule skips late estimates."""

from dataclasses import replace

import numpy as np
import pytest

from probedesign.core.errors import InputError
from probedesign.live.blocks import WrenchReading, group_readings, iter_readings
from probedesign.live.processing import chain as due
from probedesign.live.processing.chain import MAX_AGE, EstimateScheduler, ProcessingOptions
from probedesign.live.processing.estimates import wrench_without_bias
from probedesign.live.processing.tare import TareWindow, parse_window, tare_of
from probedesign.live.run import estimate_stream
from probedesign.live.sources.sim import SimulatedSource

#: [N, N·m]: of the size that a sensor shows after it was screwed down.
BIAS = np.array([0.7, -0.3, 1.1, 0.004, -0.002, 0.001])


@pytest.fixture(scope="module")
def readings(estimator):
    """Free for 2 s, pressed from there on."""
    return list(iter_readings(SimulatedSource(estimator.model, "speed=max&rate_hz=10&seconds=6")))


@pytest.fixture(scope="module")
def biased(readings):
    return [replace(reading, wrench_sensor=reading.wrench_sensor + BIAS) for reading in readings]


def test_a_constant_bias_is_removed_completely(estimator, readings, biased):
    """Up to the noise's own mean, which both windows share: 1e-12 allows for the rounding of sums of 20. The mean of 20
    readings is off by σ/√20, by 5 of these at most."""
    window = TareWindow(0.0, 2.0)
    with_bias = tare_of(biased, window, estimator)
    without = tare_of(readings, window, estimator)
    assert with_bias.readings == 20
    assert with_bias.bias_sensor - without.bias_sensor == pytest.approx(BIAS, rel=1e-12)
    for reading, raw in zip(readings, biased, strict=True):
        expected = wrench_without_bias(estimator.model, reading, without)
        found = wrench_without_bias(estimator.model, raw, with_bias)
        assert found == pytest.approx(expected, abs=1e-14)  # of 1 N
    assert (np.abs(with_bias.bias_sensor - BIAS) < 5.0 * estimator.model.noise.std / np.sqrt(20.0)).all()


def test_no_tare_is_taken_without_a_request(estimator, biased):
    source = Fixed(biased[::10])  # a force of 1 N bends the probe far: few of these, they are slow
    results = {a.estimate.result for a in estimate_stream(estimator, source, ProcessingOptions(), lambda note: None)}
    assert "no_contact" not in results and "ok" not in results


def test_live_estimates_begin_after_the_window(estimator, biased):
    log_lines: list[str] = []
    plan = ProcessingOptions(window=TareWindow(0.5, 2.0))
    answers = list(estimate_stream(estimator, Fixed(biased), plan, log_lines.append))
    assert answers[0].reading.time == 2.0
    assert len(answers) == 40
    assert "tare from 15 readings in 0.5:2 s: Fx 700 mN, Fy -300 mN" in log_lines[0]
    last, estimate = answers[-1].reading, answers[-1].estimate
    assert estimate.ok
    assert abs(estimate.s_contact - last.truth.s_contact) < 5.0 * estimate.std_s  # bias and reading are noisy


@pytest.mark.parametrize(
    ("window", "log_lines"),
    [
        (TareWindow(2.0, 4.0), "tare window 2:4 s is not steady: My scatters by"),
        (TareWindow(1.0, 2.7), "is not steady"),
        (TareWindow(3.5, 6.0), "is not steady"),  # the force is constant there, and the contact moves
        (TareWindow(0.0, 0.5), "has 5 readings; a tare needs 10"),
        (TareWindow(60.0, 70.0), "has 0 readings"),
    ],
)
def test_a_window_that_is_not_free_is_refused(estimator, readings, window, log_lines):
    with pytest.raises(InputError) as error:
        tare_of(readings, window, estimator)
    assert log_lines in str(error.value)


@pytest.mark.parametrize("text", ["", "2", "2:", ":2", "2:1", "1:1", "-1:2", "0:nan", "0:inf", "a:b", "0:1:2"])
def test_what_is_no_window(text):
    assert parse_window("0.5:2") == TareWindow(0.5, 2.0)
    with pytest.raises(InputError, match="must be START:END"):
        parse_window(text)


class Fixed:
    title, notes = "", ()

    def __init__(self, readings) -> None:
        self.readings = readings

    def __iter__(self):
        yield from group_readings(self.readings, 3)


READING = WrenchReading(0.0, np.zeros(6), np.zeros(3))


def test_a_reading_that_is_too_old_is_skipped_and_counted(monkeypatch):
    lines: list[str] = []
    scheduler, due_now = EstimateScheduler(100.0, lines.append), []
    for i, late in enumerate((0.0, MAX_AGE + 0.01, 0.0, MAX_AGE + 0.5, 0.5 * MAX_AGE)):
        monkeypatch.setattr(due, "monotonic", lambda late=late: 7.0 + late)
        due_now.append(scheduler.is_due(replace(READING, time=0.01 * i, received=7.0)))
    scheduler.finish()
    assert due_now == [True, False, True, False, True]
    assert lines[0].startswith("2 of 5 estimates were skipped: each was more than 12 ms late")


@pytest.mark.parametrize(
    ("late", "max_age", "ready", "wanted"),
    [(0.03, 0.05, np.inf, True), (0.06, 0.05, np.inf, False),  # the newest of readings every 50 ms is not too old
     (1.0, MAX_AGE, 0.5 * MAX_AGE, True), (1.0, MAX_AGE, 2.0 * MAX_AGE, False),  # it waited for its pose
     (1e6, np.inf, np.inf, True),  # `explore` makes points of whole touches, and wants every reading
     (np.nan, MAX_AGE, np.inf, True)],  # a replay is never late
)  # fmt: skip
def test_the_age_of_a_reading_counts_from_its_arrival_or_that_of_its_pose(monkeypatch, late, max_age, ready, wanted):
    scheduler = EstimateScheduler(100.0, print, max_age)
    monkeypatch.setattr(due, "monotonic", lambda: 8.0)
    assert scheduler.is_due(replace(READING, received=8.0 - late), ready=8.0 - ready) == wanted
