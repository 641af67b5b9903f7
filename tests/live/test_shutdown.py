"""The recording survives every end of a run: killed, interrupted, a closed terminal or a closed pipe."""

import json
import os
import signal
import stat
import subprocess
import sys
from itertools import islice

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from probedesign.cli.main import run
from probedesign.estimation.estimator import Estimator
from probedesign.live.recordings.csv import CsvRecorder
from probedesign.live.recordings.mcap_read import recover
from probedesign.live.sources.replay import open_recording
from tests.live.mcap_files import block, write

PROGRAM = [sys.executable, "-m", "probedesign.cli.main"]
LAST_SECOND = 1.0  #: What a kill may cost [s]; the file is flushed every half second.


@pytest.fixture(scope="module")
def stream(estimator: Estimator, tmp_path_factory):
    """Two seconds of the free probe, 7000 readings a second, noisy; what a Net F/T box would send."""
    model = estimator.model
    free = model.to_sensor(estimator.free(model.gravity_base).wrench_base, model.gravity_base)
    blocks = [block(i, 35) for i in range(0, 14_000, 35)]
    for each in blocks:
        each.wrench_sensor[:] = 0.1 * each.wrench_sensor + free
    return write(tmp_path_factory.mktemp("ends") / "stream.mcap", model, blocks, chunk=100)


def started(bundle, stream, record) -> "subprocess.Popen[str]":
    """`live` as a process of its own at the sensor's pace, with the signals that a shell gives a foreground job."""
    command = [*PROGRAM, "live", str(bundle), "--source", f"replay:{stream}", "--json", "--average", "350"]

    def heard() -> None:
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, signal.SIG_DFL)

    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    return subprocess.Popen([*command, "--record", str(record)], text=True, preexec_fn=heard, **pipes)


def readings(path, model):
    recorded = open_recording(path, model)
    blocks = list(recorded.blocks())
    return (recorded, np.concatenate([each.time for each in blocks]), np.concatenate([b.wrench_sensor for b in blocks]))


def test_kill_9_costs_the_last_second_at_most(bundle, estimator, stream, tmp_path, capsys):
    """What is kept is a beginning of the stream to the last bit, reaches within a second of the last line, gives
    the same estimates, and is opened by others once it is recovered. Lines of CSV are in the file at once."""
    path = tmp_path / "killed.mcap"
    with started(bundle, stream, path) as process:
        lines = list(islice(process.stdout, 25))
        process.kill()
    recorded, time, wrench = readings(path, estimator.model)
    assert time[-1] >= json.loads(lines[-1])["time_s"] - LAST_SECOND
    _, sent_time, sent = readings(stream, estimator.model)
    assert time.tobytes() == sent_time[: len(time)].tobytes() and wrench.tobytes() == sent[: len(wrench)].tobytes()
    assert recorded.missing() == ("incomplete: it was cut off",)
    saved = tmp_path / "saved.mcap"
    assert run(["recover", str(path), "--out", str(saved)]) == 0
    assert capsys.readouterr().out.startswith(f"wrote {saved}: ")
    with AnyReader([saved]) as reader:
        counts = {c.topic: c.msgcount for c in reader.connections}
    assert counts["/probedesign/wrench_raw"] == len(time)
    assert run(["live", str(bundle), "--source", f"replay:{saved}?speed=max", "--json", "--average", "350"]) == 0
    again = capsys.readouterr().out.splitlines(keepends=True)
    assert len(again) >= 5 and again[: len(lines)] == lines[: len(again)]
    file = CsvRecorder(tmp_path / "open.csv")
    file.on_samples(block(0, 3))
    assert readings(tmp_path / "open.csv", estimator.model)[1].tobytes() == block(0, 3).time.tobytes()
    file.close()


@pytest.mark.parametrize(("how", "kind"), [("SIGINT", "csv"), ("SIGTERM", "mcap"), ("SIGHUP", "mcap")])
def test_the_recording_is_complete_however_the_run_ends(bundle, estimator, stream, tmp_path, how, kind):
    path = tmp_path / f"ended.{kind}"
    with started(bundle, stream, path) as process:
        seen = list(islice(process.stdout, 5))
        process.send_signal(getattr(signal, how))
        rest, err = process.communicate(timeout=60)
    assert process.returncode == 0 and "Traceback" not in err
    recorded, time, _ = readings(path, estimator.model)
    assert recorded.missing() == recorded.notes == ()
    lines = seen + rest.splitlines()  # several may have been read at once
    assert {f"recorded {len(time)} readings to {path}", f"{len(lines)} estimates: {len(lines)} no_contact"} <= {
        *err.splitlines()
    }
    assert time[-1] >= json.loads(lines[-1])["time_s"]
    if kind == "mcap":
        assert recover(path, tmp_path / "unneeded.mcap").path is None


def test_client_disconnect_keeps_recording_complete(bundle, estimator, stream, tmp_path):
    path = tmp_path / "ended.mcap"
    with started(bundle, stream, path) as process:
        process.stdout.readline()
        process.stdout.close()
        err = process.stderr.read()
    assert process.returncode == 1 and "Traceback" not in err and "error" not in err
    assert readings(path, estimator.model)[0].missing() == ()


# recover, as its user meets it


def test_recover_reports_what_it_saved(estimator, tmp_path, capsys):
    path = write(tmp_path / "cut.mcap", estimator.model, [block(0, 3), block(3, 3)], closed=False)
    assert run(["recover", str(path), "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert (printed["path"], printed["messages"], printed["damage"]) == (
        str(tmp_path / "cut-recovered.mcap"),
        9,  # with the static transform
        "it was cut off",
    )
    assert printed["seconds"] == pytest.approx(5 / 7000, abs=2e-9)  # two stamps of whole nanoseconds
    assert run(["recover", str(path)]) == 2
    assert "--force" in capsys.readouterr().err
    before = os.umask(0o027)
    assert run(["recover", str(path), "--force"]) == 0
    os.umask(before)
    assert stat.S_IMODE((tmp_path / "cut-recovered.mcap").stat().st_mode) == 0o640


def test_recover_leaves_a_whole_file_alone(estimator, tmp_path, capsys):
    path = write(tmp_path / "whole.mcap", estimator.model, [block(0, 3)])
    before = path.read_bytes()
    assert run(["recover", str(path)]) == 0
    assert "is complete: 5 messages over" in capsys.readouterr().out
    assert [p.name for p in tmp_path.iterdir()] == ["whole.mcap"] and path.read_bytes() == before


@pytest.mark.parametrize("options", [[], ["--out", "cut.mcap", "--force"]])
def test_recover_refuses(tmp_path, capsys, monkeypatch, options):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "cut.mcap").write_bytes(b"junk")
    assert run(["recover", "cut.mcap", *options]) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1 and ("not an MCAP file" in err or "is the input file" in err)
    assert (tmp_path / "cut.mcap").read_bytes() == b"junk"
