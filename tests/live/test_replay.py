"""A recorded run gives the same estimates again, in whichever frame it is recorded."""

from contextlib import closing

import numpy as np
import pytest

from probedesign.core.frames import inverse, wrench_map
from probedesign.live.blocks import WrenchReading, group_readings
from probedesign.live.processing.chain import ProcessingOptions
from probedesign.live.recordings.csv import CsvRecorder, read_recording, write_recording
from probedesign.live.run import estimate_recording, estimate_stream
from probedesign.live.sources.replay import ReplaySource
from probedesign.live.sources.sim import SimulatedSource

QUERY = "speed=max&rate_hz=3"


def run(estimator, source, plan=None, sink=None):
    answers = estimate_stream(estimator, source, plan or ProcessingOptions(), lambda note: None, sink)
    return [(answer.reading, answer.estimate) for answer in answers]


@pytest.fixture(scope="module")
def recorded(estimator, tmp_path_factory):
    path = tmp_path_factory.mktemp("replay") / "sim.csv"
    with closing(CsvRecorder(path)) as file:
        answers = run(estimator, SimulatedSource(estimator.model, QUERY), sink=file)
    return path, answers


def test_a_replay_gives_the_same_estimates_to_the_bit(estimator, recorded):
    path, before = recorded
    after = run(estimator, ReplaySource(estimator.model, path, "speed=max"))
    assert len(after) == len(before) == 60
    for (reading, estimate), (reading_before, estimate_before) in zip(after, before, strict=True):
        assert reading.time == reading_before.time
        assert estimate.result == estimate_before.result
        assert np.array_equal(estimate.p_contact_base, estimate_before.p_contact_base, equal_nan=True)
        assert np.array_equal(estimate.cov_contact_base, estimate_before.cov_contact_base, equal_nan=True)


def test_estimate_and_live_agree_to_the_bit(estimator, recorded):
    path, before = recorded
    rows = estimate_recording(estimator, path).rows
    assert [row["s_contact_mm"] for row in rows if row["result"] == "ok"] == [
        estimate.s_contact / 1e-3 for _, estimate in before if estimate.ok
    ]


def test_a_recording_in_the_base_frame(estimator, recorded, tmp_path):
    """The same wrench, the hanging parts' weight taken off by hand. Two maps there and back round at 1e-16
    of 0.12 N in a reading whose noise is 0.5 mN."""
    path, before = recorded
    model, recording = estimator.model, read_recording(path)
    weight = model.payload.wrench(model.T_sensor_base[:3, :3] @ model.gravity_base)
    wrench_base = (recording.wrench - weight) @ wrench_map(inverse(model.T_sensor_base)).T
    write_recording(tmp_path / "base.csv", recording.time, wrench_base, "base")
    after = run(estimator, ReplaySource(model, tmp_path / "base.csv", "speed=max"))
    for (_, estimate), (_, estimate_before) in zip(after, before, strict=True):
        assert estimate.result == estimate_before.result
        assert estimate.s_contact == pytest.approx(estimate_before.s_contact, abs=1e-9, nan_ok=True)


def test_gravity_of_the_recording_counts(estimator, tmp_path):
    """The free probe, turned over between two readings: free in both with recorded gravity, a contact in the
    second without."""
    model = estimator.model
    gravities = np.array([[9.81, 0.0, 0.0], [-9.81, 0.0, 0.0]])
    wrenches = [model.to_sensor(model.rod.solve(gravity).wrench_base, gravity) for gravity in gravities]
    write_recording(tmp_path / "gravity.csv", [0.0, 1.0], wrenches, gravity_base=gravities)
    write_recording(tmp_path / "untold.csv", [0.0, 1.0], wrenches)
    results = [row["result"] for row in estimate_recording(estimator, tmp_path / "gravity.csv").rows]
    untold = [row["result"] for row in estimate_recording(estimator, tmp_path / "untold.csv").rows]
    assert results == ["no_contact", "no_contact"]
    assert untold[0] == "no_contact" and untold[1] != "no_contact"


def test_averaged_recordings_are_noted(estimator, recorded):
    estimates = estimate_recording(estimator, recorded[0], samples=7)
    assert len(estimates.rows) == 8
    assert "each estimate uses the mean of 7 readings; 4 readings at the end are not used" in estimates.notes


class Closing:
    """A source that records whether it was closed."""

    title, notes, closed = "", (), False

    def __init__(self, readings: list[WrenchReading]) -> None:
        self.readings = readings

    def __iter__(self):
        try:
            yield from group_readings(self.readings)
        finally:
            self.closed = True


def test_the_source_is_closed_when_enough_is_seen(estimator, recorded):
    source = Closing([reading for reading, _ in recorded[1]])
    answers = estimate_stream(estimator, source, ProcessingOptions(), lambda note: None)
    next(answers)
    assert not source.closed
    answers.close()
    assert source.closed


def test_readings_that_fill_no_mean_are_reported(estimator):
    lines = []
    source = SimulatedSource(estimator.model, "speed=max&rate_hz=50&seconds=1")
    assert not list(estimate_stream(estimator, source, ProcessingOptions(samples=1000), lines.append))
    assert lines == ["50 readings are fewer than the 1000 of a mean: no estimate"]
