"""`estimate` and `live` as their user meets them: what they print, what they refuse, how they end."""

import csv
import json
import subprocess
import sys

import numpy as np
import pytest

from probedesign.cli.main import run
from probedesign.live.blocks import iter_readings
from probedesign.live.processing.estimates import COLUMNS, TRUE_COLUMNS, WORLD_COLUMNS
from probedesign.live.recordings.csv import read_recording, write_recording
from probedesign.live.sources.sim import SimulatedSource

POSITION = [name for name in COLUMNS if name.startswith(("s_contact", "std_", "p_", "cov_"))]
INTERVAL = [name for name in COLUMNS if name.startswith("s_interval_95")]
SIM = "sim:?speed=max&rate_hz=3"


def write_readings(path, readings, bias=0.0) -> None:
    rows = [(r.time, r.wrench_sensor + bias, r.gravity_base) for r in readings]
    time, wrench, gravity = zip(*rows, strict=True)
    write_recording(path, time, wrench, "sensor", gravity)


@pytest.fixture(scope="module")
def recording(estimator, tmp_path_factory):
    path = tmp_path_factory.mktemp("commands") / "sim.csv"
    write_readings(path, iter_readings(SimulatedSource(estimator.model, "speed=max&rate_hz=3")))
    return path


@pytest.fixture
def call(capsys):
    """Runs a command line here; (exit status, stdout, stderr)."""

    def call(*arguments) -> tuple[int, str, str]:
        status = run([str(argument) for argument in arguments])
        return (status, *capsys.readouterr())

    return call


def refused(result: tuple[int, str, str]) -> str:
    status, out, err = result
    assert (status, out) == (2, "")
    assert err.count("\n") == 1 and "Traceback" not in err
    return err


# estimate


def assert_positions_only_with_ok(rows: list[dict], nothing) -> None:
    assert {row["result"] for row in rows} >= {"ok", "no_contact"}
    for row in rows:
        given = [row[name] != nothing for name in POSITION]
        assert all(given) if row["result"] == "ok" else not any(given)
        bounded = [row[name] != nothing for name in INTERVAL]
        assert all(bounded) if row["result"] == "interval_only" else not any(bounded)


def test_estimate_prints_csv(call, bundle, recording):
    status, out, err = call("estimate", bundle, recording)
    rows = list(csv.DictReader(out.splitlines()))
    # Nothing is noted but that kernels compile, where they have to.
    assert (status, [line for line in err.splitlines() if "compiling" not in line]) == (0, [])
    assert tuple(rows[0]) == COLUMNS
    assert [float(row["time_s"]) for row in rows] == read_recording(recording).time.tolist()
    assert_positions_only_with_ok(rows, "")


def test_estimate_prints_one_json_document(call, bundle, recording):
    status, out, err = call("estimate", bundle, recording, "--json", "--average", 2)
    document = json.loads(out)
    assert status == 0
    assert (document["probe"], document["readings"], document["average"]) == ("large", 60, 2)
    assert document["tare"] is None
    assert sum(document["counts"].values()) == len(document["estimates"]) == 30
    assert_positions_only_with_ok(document["estimates"], None)
    assert err == "note: each estimate uses the mean of 2 readings\n"


def test_estimate_writes_what_it_would_print_but_never_over_the_recording(call, bundle, recording, tmp_path):
    out, before = tmp_path / "new" / "estimates.csv", recording.read_bytes()
    status, printed, _ = call("estimate", bundle, recording, "--out", out)
    assert status == 0 and printed.startswith(f"wrote {out}: 60 estimates: ")
    assert out.read_text() == call("estimate", bundle, recording)[1]
    assert "is the recording" in refused(call("estimate", bundle, recording, "--out", recording, "--force"))
    assert recording.read_bytes() == before


def test_estimate_reports_its_tare(call, bundle, estimator, tmp_path):
    path = tmp_path / "biased.csv"
    readings = iter_readings(SimulatedSource(estimator.model, "speed=max&rate_hz=10&seconds=4"))
    write_readings(path, readings, np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
    status, out, err = call("estimate", bundle, path, "--tare-s", "0:2", "--json")
    tare = json.loads(out)["tare"]
    assert status == 0 and err.startswith("note: tare from 20 readings in 0:2 s: Fx 1e+03 mN")
    assert tare["bias_force_N"][0] == pytest.approx(1.0, abs=0.001)  # 8 standard deviations of the mean
    assert json.loads(out)["estimates"][0]["result"] == "no_contact"


def test_an_incomplete_recording_is_refused_or_accepted_with_a_note(call, bundle, recording, tmp_path):
    cut = tmp_path / "cut.csv"
    lines = recording.read_text().splitlines(keepends=True)
    cut.write_text("".join(lines[:10] + lines[13:20]) + "6.0,0.1")
    status, out, err = call("estimate", bundle, cut)
    assert (status, out, len(err.splitlines())) == (2, "", 1)
    assert "line 18" in err and "3 samples" in err and "--mend" in err
    _, out, err = call("estimate", bundle, cut, "--mend")
    assert err.splitlines() == [
        "note: line 18 is incomplete at the end: dropped",
        "note: 3 samples are missing in 1 gaps",
    ]
    assert len(out.splitlines()) == 16


# live


def test_live_prints_lines_of_equal_columns(call, bundle):
    status, out, err = call("live", bundle, "--source", SIM)
    lines = out.splitlines()
    assert (status, len(lines)) == (0, 60)
    assert "noise seed 1" in err  # after the message of compiling, if there is any
    assert err.splitlines()[-1].startswith("60 estimates: ")
    ok = [line for line in lines if " ok " in line]
    assert len({(line.index("±"), line.index("true s"), len(line)) for line in ok}) == 1
    assert any("no_contact" in line and "±" not in line for line in lines)


def test_live_prints_lines_of_json(call, bundle):
    status, out, _ = call("live", bundle, "--source", SIM, "--json")
    rows = [json.loads(line) for line in out.splitlines()]
    assert status == 0
    assert tuple(rows[0]) == (*COLUMNS, *TRUE_COLUMNS)
    assert_positions_only_with_ok(rows, None)


def test_live_with_poses_reports_world_coordinates(call, bundle, tmp_path):
    """The base is at one pose, x and z exchanged, given twice, 20 s apart."""
    path = tmp_path / "poses.csv"
    names, pose = "time_s,x_mm,y_mm,z_mm,qx,qy,qz,qw", "100,0,0,0,0.7071,0,0.7071"
    path.write_text(f"{names}\n-1,{pose}\n21,{pose}\n")
    options = ("--pose", f"{path}?limit_ms=30000", "--gravity-world", "0,0,-9.81", "--seconds", 8, "--json")
    status, out, err = call("live", bundle, "--source", "sim:?speed=max&rate_hz=10", *options)
    rows = [json.loads(line) for line in out.splitlines()]
    assert status == 0 and "2 poses of" in err
    assert tuple(rows[0]) == (*COLUMNS, *TRUE_COLUMNS, *WORLD_COLUMNS)
    assert {row["stale"] for row in rows} == {""}
    assert {row["fused_result"] for row in rows if row["phase"] == "free"} == {"no_contact"}
    assert "touching" in {row["phase"] for row in rows}


def test_live_stops_at_count_and_seconds(call, bundle):
    assert len(call("live", bundle, "--source", SIM, "--count", 3)[1].splitlines()) == 3
    assert len(call("live", bundle, "--source", SIM, "--seconds", 2)[1].splitlines()) == 6
    assert len(call("live", bundle, "--source", SIM, "--seconds", 3.5, "--rate-hz", 1)[1].splitlines()) == 4


def test_live_records_what_it_read(call, bundle, recording, tmp_path):
    """Every reading, also those that are averaged; the fixture is the same run."""
    path = tmp_path / "new" / "record.csv"
    status, *_ = call("live", bundle, "--source", SIM, "--average", 5, "--record", path)
    assert status == 0
    ours, theirs = read_recording(path), read_recording(recording)
    assert ours.time.tobytes() == theirs.time.tobytes() and ours.wrench.tobytes() == theirs.wrench.tobytes()


@pytest.mark.parametrize(
    ("command", "expected"),
    [
        (["estimate", "BUNDLE", "RECORDING", "--out", "OUT"], "time_s,"),
        (["live", "BUNDLE", "--source", SIM, "--count", 1, "--record", "OUT"], "# frame: sensor\n"),
    ],
)
def test_files_are_not_overwritten(call, bundle, recording, tmp_path, command, expected):
    out = tmp_path / "out.csv"
    out.write_text("mine")
    paths = {"BUNDLE": bundle, "RECORDING": recording, "OUT": out}
    command = [paths.get(argument, argument) for argument in command]
    assert "--force" in refused(call(*command))
    assert out.read_text() == "mine"
    assert call(*command, "--force")[0] == 0
    assert out.read_text().startswith(expected)


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (["RECORDING", "--tare-s", "3:9"], "is not steady"),
        (["RECORDING", "--tare-s", "5"], "START:END"),
        (["RECORDING", "--average", "0"], "--average 0 must be positive"),
        (["RECORDING", "--average", "1000"], "60 readings are fewer than --average 1000"),
        (["RECORDING", "--manifest", "none.json"], "none.json: no such manifest"),
        (["--source", "netfd://host"], "replay:FILE, sim:"),
        (["--source", "sim:?force=1"], "did you mean force_mN?"),
        (["--source", SIM, "--rate-hz", "nan"], "--rate-hz nan must be positive"),
        (["--source", SIM, "--seconds", "0"], "--seconds 0.0 must be positive"),
        (["--source", SIM, "--count", "0"], "--count 0 must be positive"),
        (["--source", SIM, "--average", "-1"], "--average -1 must be positive"),
        (["--source", SIM, "--tare-s", "1"], "START:END"),
        (["--source", SIM, "--pose", "none.csv"], "none.csv: no such file"),
        (["--source", SIM, "--pose", "udp://:99999"], "write udp://:PORT"),
        ([], "--source"),
    ],
)
def test_estimate_and_live_refuse(call, bundle, recording, options, expected):
    command = "estimate" if options[:1] == ["RECORDING"] else "live"
    options = [recording if option == "RECORDING" else option for option in options]
    assert expected in refused(call(command, bundle, *options))


def test_nothing_of_the_design_side_is_imported(bundle, recording):
    heavy = (
        "pydantic", "cadquery", "matplotlib", "tomlkit", "scipy.stats",
        "probedesign.design.schema", "probedesign.probe",
    )  # fmt: skip
    code = (
        "import sys; from probedesign.cli.main import run;"
        f"run({['estimate', str(bundle), str(recording)]!r});"
        f"status = run({['live', str(bundle), '--source', SIM, '--count', '1']!r});"
        f"print([m for m in {heavy!r} if m in sys.modules], file=sys.stderr); sys.exit(status)"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert result.returncode == 0
    assert result.stderr.splitlines()[-1] == "[]"
