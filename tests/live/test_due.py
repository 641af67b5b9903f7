"""When live estimates, and what it leaves out when it cannot keep up."""

from dataclasses import replace

import numpy as np

from probedesign.live import due
from probedesign.live.due import CALM, LATE, Due
from probedesign.live.reading import Reading

READING = Reading(0.0, np.zeros(6), np.zeros(3))


def wanted(at, times, received, monkeypatch):
    """Whether each reading is wanted, taken in when the clock shows `received` and as much more as `at` says."""
    said: list[str] = []
    kept = Due(100.0, said.append)
    found = []
    for time, late in zip(times, at, strict=True):
        monkeypatch.setattr(due, "monotonic", lambda late=late: 7.0 + late)
        found.append(kept.wants(replace(READING, time=time, received=received)))
    return found, said


def test_estimates_keep_the_rate_that_was_asked_for(monkeypatch):
    found, said = wanted([0.0] * 100, 1e-3 * np.arange(100), 7.0, monkeypatch)
    assert sum(found) == 10 and not said


def test_a_reading_that_waited_too_long_is_left_out_and_that_is_told_once(monkeypatch):
    at = [0.0, LATE + 0.01, 0.0, LATE + 0.5, 0.1, 0.0, 0.0]
    times = [0.0, 0.01, 0.02, 0.03, 0.04, 0.03 + 1.1 * CALM, 1.0 + CALM]
    found, said = wanted(at, times, 7.0, monkeypatch)
    assert found == [True, False, True, False, True, True, True]
    assert len(said) == 2 and "late" in said[0] and "2 were left out" in said[1]


def test_a_replay_is_never_late(monkeypatch):
    found, said = wanted([0.0, 1e6, 0.0], 0.01 * np.arange(3), float("nan"), monkeypatch)
    assert found == [True] * 3 and not said
