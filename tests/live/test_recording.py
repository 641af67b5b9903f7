"""Recording during a run: nothing waits for the disk, and no failure of the disk ends the run."""

import errno
import os
import threading
from contextlib import closing

import pytest

from probedesign.core.errors import InputError
from probedesign.live import recordings as pieces
from probedesign.live.outputs.recording import BackgroundWriter, RecordingSink
from probedesign.live.processing.control import ProcessingOptions
from probedesign.live.recordings.csv import read_recording
from probedesign.live.recordings.mcap_write import McapRecorder
from probedesign.live.run import estimate_stream
from probedesign.live.sources.sim import SimulatedSource
from tests.live.mcap_files import block, joined, read, same

SIM = "speed=max&rate_hz=60&seconds=4"


@pytest.fixture(scope="module")
def model(estimator):
    return estimator.model


class BlockedFile:
    """A file whose disk answers only when it is let go."""

    def __init__(self, file):
        self.file, self.go = file, threading.Event()

    def __getattr__(self, name):
        def call(*arguments):
            assert self.go.wait(30)
            return getattr(self.file, name)(*arguments)

        return call


def full_after(monkeypatch, size: int) -> None:
    """A disk with a given number of free bytes, which fails as on Linux: part of a write, then an error."""
    left = [size]

    def write(file: int, data) -> int:
        if not left[0]:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        part = bytes(data)[: left[0]]
        left[0] -= len(part)
        return os_write(file, part)

    os_write = os.write
    monkeypatch.setattr(pieces.os, "write", write)


def test_a_slow_disk_drops_readings_and_reports_it(model, tmp_path):
    """Room for 40 readings: the first block is being written, four of nine wait, the rest is left out."""
    log_lines, path = [], tmp_path / "slow.mcap"
    blocked = BlockedFile(McapRecorder(path, model))
    writer = BackgroundWriter(blocked, "slow.mcap", log_lines.append, max_queued=40)
    written = [block(i * 10, 10) for i in range(10)]
    for each in written:
        writer.on_samples(each)
    assert log_lines == ["slow.mcap: the disk is too slow; readings are dropped"]
    blocked.go.set()
    writer.close()
    assert writer.dropped + writer.readings == 100 and writer.dropped >= 50
    assert (
        log_lines[1]
        == f"slow.mcap: the disk was too slow: {writer.dropped} readings dropped, marked in the file"
    )
    _, blocks = read(path, model)
    assert joined(blocks) == joined(written[: writer.readings // 10])


def test_a_disk_that_is_full_at_the_end_is_reported(model, tmp_path, monkeypatch):
    """And not, after a long wait, as one that does not answer."""
    log_lines, file = [], McapRecorder(tmp_path / "end.mcap", model)
    writer = BackgroundWriter(file, "end.mcap", log_lines.append)

    def full():
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(file, "close", full)
    writer.close()
    assert len(log_lines) == 1 and "recording ended: No space left on device" in log_lines[0]


def test_averages_do_not_span_dropped_readings(model, tmp_path):
    file = McapRecorder(tmp_path / "gap.mcap", model)
    for each in (block(0, 5), block(5, 5)):
        file.on_samples(each)
        file.flush()
    file.on_dropped(7, 0)
    file.on_samples(block(17, 5))
    file.close()
    recorded, blocks = read(tmp_path / "gap.mcap", model)
    assert len({each.stretch for each in blocks}) == 2 and blocks[0].stretch == blocks[1].stretch
    assert recorded.missing() == ("7 readings were dropped by the recorder: the disk was too slow",)


@pytest.mark.parametrize("kind", ["mcap", "csv"])
@pytest.mark.parametrize("room", [0, 15_000])
def test_a_full_disk_ends_the_recording_and_not_the_run(estimator, tmp_path, monkeypatch, kind, room):
    """240 readings take 40 kB of CSV and 25 of MCAP, where the head is written already; 64 come at
    once."""
    path, log_lines = tmp_path / f"full.{kind}", []
    recordings = RecordingSink(path, estimator.model, log_lines.append)
    recordings.start()
    recordings._current[1]._flush_period = 0.0
    full_after(monkeypatch, room)
    answers = list(
        estimate_stream(
            estimator,
            SimulatedSource(estimator.model, SIM),
            ProcessingOptions(),
            log_lines.append,
            recordings,
        )
    )
    recordings.close()
    assert len(answers) == 240
    (line,) = [line for line in log_lines if "recording ended" in line]
    assert "No space left on device" in line and "the run continues" in line
    if kind == "csv":
        assert room == 0 or read_recording(path).dropped_lines == 0
    else:
        blocks = read(path, estimator.model)[1]
        time = [time for each in blocks for time in each.time]
        assert time == [i / 60.0 for i in range(len(time))]
        assert len(time) < 240 and bool(time) == bool(room)


def test_a_full_disk_when_nothing_is_there_yet(model, tmp_path, monkeypatch):
    full_after(monkeypatch, 10)
    recordings = RecordingSink(tmp_path / "full.mcap", model, lambda line: None)
    with pytest.raises(InputError, match="cannot be written: No space left on device"):
        recordings.start()
    assert not list(tmp_path.iterdir())


def test_each_start_is_a_new_file(model, tmp_path):
    log_lines, path = [], tmp_path / "r.mcap"
    with closing(RecordingSink(path, model, log_lines.append)) as recordings:
        recordings.on_samples(block(0, 3))  # before the start: recorded nowhere
        for i in range(1, 4):
            recordings.try_start()
            recordings.on_samples(block(3 * i, 3))
            recordings.stop()
        recordings.stop()
        recordings.try_start()
        recordings.try_start()
    names = ["r.mcap", "r-2.mcap", "r-3.mcap", "r-4.mcap"]
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(names)
    for i, name in enumerate(names[:3], 1):
        (only,) = read(tmp_path / name, model)[1]
        assert same(only, block(3 * i, 3))
    assert log_lines[:2] == [f"recording to {path}", f"recorded 3 readings to {path}"]
    assert log_lines[6:8] == ["no recording is active", f"recording to {tmp_path / 'r-4.mcap'}"]
    assert log_lines[8] == f"recording to {tmp_path / 'r-4.mcap'} is already active"


def test_no_file_is_overwritten_without_force(model, tmp_path):
    log_lines, path = [], tmp_path / "r.mcap"
    path.write_text("mine")
    recordings = RecordingSink(path, model, log_lines.append)
    recordings.try_start()
    assert log_lines == [
        f"cannot start recording: {path}: exists already; --force replaces it, or choose another name"
    ]
    assert path.read_text() == "mine"
    with closing(RecordingSink(path, model, log_lines.append, force=True)) as recordings:
        recordings.start()
        assert recordings.path == path
    assert read(path, model)[1] == []


def test_an_unknown_suffix_is_refused(model, tmp_path):
    with pytest.raises(InputError, match=r"use the suffix \.mcap .* or \.csv"):
        RecordingSink(tmp_path / "r.bag", model, print).start()


def test_without_a_name_it_is_called_by_probe_and_date(model, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with closing(RecordingSink(None, model, lambda line: None)) as recordings:
        recordings.start()
        assert recordings.path.match("recordings/large-????????-??????.mcap")
