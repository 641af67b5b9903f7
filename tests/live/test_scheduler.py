"""When live estimates, and what it leaves out when it cannot keep up."""

from dataclasses import replace

import numpy as np

from probedesign.live.processing import control as due
from probedesign.live.processing.blocks import WrenchReading
from probedesign.live.processing.control import MAX_AGE, MAX_SKIPPED_SHARE, REPORT_PERIOD, EstimateScheduler

READING = WrenchReading(0.0, np.zeros(6), np.zeros(3))


def wanted(at, times, received, monkeypatch):
    """Whether each reading is wanted, taken in when the clock shows `received` and as much more as `at` says."""
    said: list[str] = []
    kept = EstimateScheduler(100.0, said.append)
    found = []
    for time, late in zip(times, at, strict=True):
        monkeypatch.setattr(due, "monotonic", lambda late=late: 7.0 + late)
        found.append(kept.is_due(replace(READING, time=time, received=received)))
    kept.finish()
    return found, said


def test_estimates_have_the_requested_rate(monkeypatch):
    found, said = wanted([0.0] * 100, 1e-3 * np.arange(100), 7.0, monkeypatch)
    assert sum(found) == 10 and not said


def test_a_reading_that_is_too_old_is_skipped_and_counted(monkeypatch):
    at = [0.0, MAX_AGE + 0.01, 0.0, MAX_AGE + 0.5, 0.5 * MAX_AGE]
    found, said = wanted(at, 0.01 * np.arange(5), 7.0, monkeypatch)
    assert found == [True, False, True, False, True]
    assert said == [
        "2 of 5 estimates were skipped: each was more than 12 ms late, with newer readings queued"
    ]


def test_many_skipped_estimates_are_reported_at_once_and_at_their_end(monkeypatch):
    """A span with none left out, one with twice as many as are borne in silence, one with none."""
    n = round(REPORT_PERIOD * 100.0)
    at = np.zeros(3 * n + 10)
    at[n : 2 * n : round(0.5 / MAX_SKIPPED_SHARE)] = 2.0 * MAX_AGE
    _, said = wanted(at, 0.01 * np.arange(len(at)), 7.0, monkeypatch)
    assert len(said) == 3 and "reduce --rate-hz" in said[0] and "on time again" in said[1]


def test_a_reading_that_waited_for_its_pose_is_as_old_as_that(monkeypatch):
    kept = EstimateScheduler(100.0, print)
    monkeypatch.setattr(due, "monotonic", lambda: 8.0)
    assert kept.is_due(replace(READING, received=7.0), ready=8.0 - 0.5 * MAX_AGE)
    assert not kept.is_due(replace(READING, time=1.0, received=7.0), ready=8.0 - 2.0 * MAX_AGE)


def test_a_replay_is_never_late(monkeypatch):
    found, said = wanted([0.0, 1e6, 0.0], 0.01 * np.arange(3), float("nan"), monkeypatch)
    assert found == [True] * 3 and not said


def test_without_a_maximum_age_no_reading_is_late(monkeypatch):
    """`explore` makes points of whole touches, and wants every reading."""
    kept = EstimateScheduler(100.0, print, np.inf)
    monkeypatch.setattr(due, "monotonic", lambda: 1e6)
    assert kept.is_due(replace(READING, received=0.0)) and kept.n_skipped == 0
