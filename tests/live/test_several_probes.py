"""Several probes in one run: one recording, one stream of JSON and of datagrams, and each probe as if it were alone."""

import io
import json
import socket
from contextlib import redirect_stdout, suppress

import numpy as np
import pytest

from probedesign.cli.main import run
from probedesign.design import load_design
from probedesign.frozen_probe import load_estimator, write_frozen
from probedesign.live.processing.commands import CommandQueue, CommandResult, SharedCommands
from probedesign.live.recordings.mcap_read import McapBag
from probedesign.live.sources.replay import open_recording
from probedesign.live.sources.rosbag import read_bag_poses
from probedesign.live.sources.sim import SimulatedSource
from probedesign.probe import build_probe
from tests.live.conftest import LARGE

QUERY = {"left": "speed=max&rate_hz=50&seconds=3&period_s=3",
         "right": "speed=max&rate_hz=40&seconds=4&period_s=4&force_mN=30"}  # fmt: skip
SOURCES = [option for query in QUERY.values() for option in ("--source", f"sim:?{query}")]


@pytest.fixture(scope="module")
def bundles(tmp_path_factory):
    """Two prints of one design."""
    folder, design = tmp_path_factory.mktemp("fleet"), load_design(LARGE)
    for name in QUERY:
        write_frozen(build_probe(design.model_copy(update={"name": name})).model, folder / f"{name}.probe.json")
    return [str(folder / f"{name}.probe.json") for name in QUERY]


@pytest.fixture(scope="module")
def sent(bundles, tmp_path_factory):
    """One recording of both, with the poses of the left one, and the datagrams of the run."""
    folder = tmp_path_factory.mktemp("recorded")
    rows = [f"{0.05 * i},{i},0,0,0,0,0,1" for i in range(100)]
    (folder / "poses.csv").write_text("time_s,x_mm,y_mm,z_mm,qx,qy,qz,qw\n" + "\n".join(rows) + "\n")
    path, datagrams = folder / "two.mcap", []
    poses = ["--pose", str(folder / "poses.csv"), "--pose", "fixed"]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
        outputs = ["--record", str(path), "--publish", f"udp://127.0.0.1:{receiver.getsockname()[1]}", "--lines"]
        assert run(["live", *bundles, *SOURCES, *poses, "--tare", "none", *outputs]) == 0
        receiver.setblocking(False)
        with suppress(BlockingIOError):
            while True:
                datagrams.append(json.loads(receiver.recv(4096)))
    return path, datagrams


@pytest.fixture
def recorded(sent):
    return sent[0]


def rows_of(*arguments: str) -> list[dict]:
    printed = io.StringIO()
    with redirect_stdout(printed):
        assert run(["live", *arguments, "--tare", "none", "--json"]) == 0
    return [json.loads(line) for line in printed.getvalue().splitlines()]


@pytest.fixture(scope="module")
def alone(bundles):
    """Rows of each probe in a run of its own."""
    sources = [f"sim:?{query}" for query in QUERY.values()]
    return [rows_of(bundle, "--source", source) for bundle, source in zip(bundles, sources, strict=True)]


def test_each_probe_is_estimated_as_if_it_were_alone(bundles, alone):
    rows = rows_of(*bundles, *SOURCES)
    assert {row["probe"] for row in rows} == {"left", "right"}
    for name, expected in zip(QUERY, alone, strict=True):
        assert "probe" not in expected[0]
        together = [{key: row[key] for key in row if key != "probe"} for row in rows if row["probe"] == name]
        assert together == expected  # exactly: the same samples, and no state in common


def test_one_recording_has_every_probe_with_its_readings_topics_and_frames(bundles, recorded):
    bag = McapBag(recorded)
    assert [probe["name"] for probe in bag.probes] == ["left", "right"]
    topics = {channel.topic for channel in bag.channels()}
    assert {f"/{name}/probedesign/{topic}" for name in QUERY for topic in ("wrench_raw", "estimate", "event")} < topics
    assert not any(topic.startswith("/probedesign") for topic in topics) and {"/tf", "/tf_static"} < topics
    frames = {bytes(m.data)[16:].partition(b"\0")[0] for m in bag.messages({"/right/probedesign/wrench_raw"})}
    assert frames == {b"right/sensor"}
    for bundle, query in zip(bundles, QUERY.values(), strict=True):
        model = load_estimator(bundle).model
        blocks = list(open_recording(recorded, model).blocks())
        truth = list(SimulatedSource(model, query))
        assert np.array_equal(np.concatenate([b.wrench_sensor for b in blocks]),
                              np.concatenate([b.wrench_sensor for b in truth]))  # fmt: skip
        # nanoseconds of a recording
        assert np.concatenate([b.time for b in blocks]) == pytest.approx(
            np.concatenate([b.time for b in truth]), abs=1e-9
        )


def test_a_replay_of_one_probe_reproduces_the_run(bundles, recorded, alone):
    rows = rows_of(bundles[1], "--source", f"replay:{recorded}?speed=max")
    assert rows == [{key: row[key] for key in row if not key.startswith("true_")} for row in alone[1]]
    assert "one of 2 probes" in " ".join(open_recording(recorded, load_estimator(bundles[0]).model).notes)


def test_poses_of_one_probe_are_read_by_its_clock(recorded):
    for more in ({"topic": "/left/probedesign/base"}, {"world": "world", "base": "left/base"}):
        poses = read_bag_poses(recorded, **more)
        assert len(poses) > 50
        for pose in poses:  # 20 mm a second; the time of a file of TF is that of its header, a nanosecond
            assert pose.p[0] == pytest.approx(0.02 * pose.time, abs=1e-9)


def test_datagrams_name_the_probe(sent):
    received = sent[1]
    numbers = [message["number"] for message in received]
    assert len(set(numbers)) == len(numbers)  # one sequence for both
    assert {message.get("probe") for message in received if message["kind"] == "estimate"} == set(QUERY)
    assert any(message.get("event", "").startswith("right: ") for message in received)


def test_a_command_reaches_every_probe_and_is_answered_once():
    queues, replies, log = [CommandQueue(), CommandQueue()], [], []
    shared = SharedCommands(queues)
    for queue, answer in zip(queues, ("left tared", "right tared"), strict=True):
        queue.register("tare", lambda command, answer=answer: answer)
    shared.register("start recording", lambda command: "recording")
    shared.put("tare", "", replies.append)
    shared.put("start recording", "", replies.append)
    for queue in queues:
        queue.execute(log.append)
    assert replies == [CommandResult(True, "recording"), CommandResult(True, "left tared; right tared")]


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["--source", "sim:"], "1 --source for 2 probes"),
        (["--source", "sim:", "--source", "sim:", "--pose", "fixed"], "1 --pose for 2 probes"),
        (["--source", "udp://:9000", "--source", "udp://:9000"], "--source udp://:9000 is given twice"),
        (
            ["--source", "netft://localhost", "--source", "netft://127.0.0.1"],
            "--source netft://127.0.0.1 is given twice",
        ),
        ([*SOURCES, "--record", "r.csv"], "record to NAME.mcap"),
        ([*SOURCES, "--manifest", "manifest.json"], "--manifest belongs to one probe"),
    ],
)
def test_what_does_not_belong_together_is_refused_in_one_line(bundles, capfd, arguments, expected):
    assert run(["live", *bundles, *arguments]) == 2
    line = capfd.readouterr().err
    assert expected in line and line.count("\n") == 1
    assert run(["live", bundles[0], bundles[0], *SOURCES]) == 2
    assert "two probes are named left" in capfd.readouterr().err


def test_a_probe_whose_source_fails_ends_the_run(bundles, tmp_path, capfd):
    """Its line says why, and the other does not run on."""
    table = tmp_path / "r.csv"
    table.write_text("time_s,fx_N,fy_N,fz_N,mx_Nm,my_Nm,mz_Nm\n0,0,0,0,0,0,0\n")
    sources = ["--source", "sim:?seconds=1000000", "--source", f"replay:{table}?speed=max"]
    assert run(["live", *bundles, *sources, "--tare-s", "0:9", "--lines"]) == 2
    assert "tare" in capfd.readouterr().err
