"""Recording during a run: nothing waits for the disk, and no failure of the disk ends the run."""

import errno
import os
import subprocess
import sys
import threading
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest

from probedesign.core.errors import InputError
from probedesign.live import recordings as pieces
from probedesign.live.outputs.recording import BackgroundWriter, RecordingSink
from probedesign.live.processing.chain import ProcessingOptions
from probedesign.live.recordings.csv import read_recording
from probedesign.live.recordings.mcap_write import McapRecorder
from probedesign.live.run import estimate_stream
from probedesign.live.sources.replay import open_recording
from probedesign.live.sources.sim import SimulatedSource
from tests.live.mcap_files import TIME_ROUNDING, block, joined, read, same

SIM = "speed=max&rate_hz=60&seconds=4"


class BlockedFile:
    """A file whose disk answers only when it is let go."""

    def __init__(self, file):
        self.file, self.go = file, threading.Event()

    def __getattr__(self, name):
        if not callable(found := getattr(self.file, name)):
            return found

        def call(*arguments):
            assert self.go.wait(30)
            return found(*arguments)

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
    assert log_lines[1] == f"slow.mcap: the disk was too slow: {writer.dropped} readings dropped, marked in the file"
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
    recordings = RecordingSink(path, [estimator.model], log_lines.append)
    recordings.start()
    recordings._current._flush_period = 0.0
    full_after(monkeypatch, room)
    answers = list(
        estimate_stream(
            estimator, SimulatedSource(estimator.model, SIM), ProcessingOptions(), log_lines.append, recordings
        )
    )
    recordings.close()
    assert len(answers) == 240
    (line,) = [line for line in log_lines if "recording ended" in line]
    assert "No space left on device" in line and "the run continues" in line
    if kind == "csv":
        n = len(read_recording(path).time) if room else 0  # a file without readings is refused
        assert room == 0 or not read_recording(path).damage
    else:
        time = [time for each in read(path, estimator.model)[1] for time in each.time]
        assert time == pytest.approx([i / 60.0 for i in range(len(time))], abs=TIME_ROUNDING)
        n = len(time)
    assert n < 240 and bool(n) == bool(room)
    assert f"the file contains {n} readings" in line  # the counts are those of the file
    assert log_lines[-1].startswith(f"recorded {n} readings to {path}")
    assert "No space left on device" in log_lines[-1]  # the last line states it, too


def test_a_full_disk_when_nothing_is_there_yet(model, tmp_path, monkeypatch):
    full_after(monkeypatch, 10)
    recordings = RecordingSink(tmp_path / "full.mcap", [model], lambda line: None)
    with pytest.raises(InputError, match="cannot be written: No space left on device"):
        recordings.start()
    assert not list(tmp_path.iterdir())


def test_each_start_is_a_new_file(model, tmp_path):
    log_lines, path = [], tmp_path / "r.mcap"
    with closing(RecordingSink(path, [model], log_lines.append)) as recordings:
        recordings.on_samples(block(0, 3))  # before the start: recorded nowhere
        for i in range(1, 4):
            assert recordings.start() == f"recording to {recordings.path}"
            written = recordings.path
            recordings.on_samples(block(3 * i, 3))
            assert recordings.stop() == f"recorded 3 readings to {written}"
        with pytest.raises(InputError, match="no recording is active"):
            recordings.stop()
        recordings.start()
        with pytest.raises(InputError, match=r"recording to .*r-4\.mcap is already active"):
            recordings.start()
    names = ["r.mcap", "r-2.mcap", "r-3.mcap", "r-4.mcap"]
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(names)
    for i, name in enumerate(names[:3], 1):
        (only,) = read(tmp_path / name, model)[1]
        assert same(only, block(3 * i, 3))
    assert log_lines == [f"recorded 0 readings to {tmp_path / 'r-4.mcap'}"]


def test_no_file_is_overwritten_without_force(model, tmp_path):
    log_lines, path = [], tmp_path / "r.mcap"
    path.write_text("mine")
    recordings = RecordingSink(path, [model], log_lines.append)
    with pytest.raises(InputError, match="exists already; --force replaces it"):
        recordings.start()
    assert path.read_text() == "mine"
    with closing(RecordingSink(path, [model], log_lines.append, force=True)) as recordings:
        recordings.start()
        assert recordings.path == path
    assert read(path, model)[1] == []


@pytest.mark.parametrize("name", ["r.mcap", "r.csv"])
def test_a_second_writer_on_the_same_file_is_refused_and_leaves_it_whole(model, tmp_path, name):
    """With --force too, from this process and from another one."""
    path, log_lines = tmp_path / name, []
    with closing(RecordingSink(path, [model], log_lines.append)) as first:
        first.start()
        first.on_samples(block(0, 5))
        with pytest.raises(InputError, match="another program is writing this file"):
            RecordingSink(path, [model], print, force=True).start()
        code = (
            "import sys; from pathlib import Path; from probedesign.live.recordings import AppendFile\n"
            "AppendFile(Path(sys.argv[1]), True)"
        )
        other = subprocess.run([sys.executable, "-c", code, path], capture_output=True, text=True)
        assert other.returncode == 1 and "another program is writing this file" in other.stderr
    assert log_lines[-1] == f"recorded 5 readings to {path}"
    assert sum(map(len, open_recording(path, model).blocks())) == 5
    RecordingSink(path, [model], print, force=True).start()  # the lock ends with the writer


def test_csv_and_mcap_contain_the_same_readings_with_their_faults(model, tmp_path):
    """A saturated reading with any values, a fault text with delimiters, and a silence."""
    quiet = replace(block(0, 0), fault="stale")
    wild = replace(block(30, 5), fault='saturated, channel "Fx"', wrench_sensor=np.full((5, 6), np.nan))
    found = {}
    for kind in ("mcap", "csv"):
        path, log_lines = tmp_path / f"both.{kind}", []
        with closing(RecordingSink(path, [model], log_lines.append)) as sink:
            sink.start()
            for each in (block(0, 30), wild, quiet, block(40, 20)):
                sink.on_samples(each)
        assert log_lines[-1] == f"recorded 55 readings to {path}"
        found[kind] = [each for each in open_recording(path, model).blocks() if len(each)]
    assert joined(found["mcap"]) == joined(found["csv"])
    assert [len(each) for each in found["csv"]] == [30, 5, 20]
    assert [each.fault for each in found["csv"]] == ["", "saturated; channel 'Fx'", ""]


def test_an_unknown_suffix_is_refused(model, tmp_path):
    with pytest.raises(InputError, match=r"use the suffix \.mcap .* or \.csv"):
        RecordingSink(tmp_path / "r.bag", [model], print).start()


def test_without_a_name_it_is_called_by_probe_and_date(model, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with closing(RecordingSink(None, [model], lambda line: None)) as recordings:
        recordings.start()
        assert recordings.path.match("recordings/large-????????-??????.mcap")
