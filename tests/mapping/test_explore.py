"""Tests of the command `explore` on a simulated run: results, files and refusals."""

import csv
import io
import json
import socket
import subprocess
import sys
from contextlib import closing, redirect_stdout
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from probedesign.cli.main import run
from probedesign.cli.options import RehearsalOptions
from probedesign.core.errors import InputError
from probedesign.core.statistics import max_chi2
from probedesign.core.units import MM
from probedesign.frozen_probe import load_estimator, write_frozen
from probedesign.live.blocks import WrenchReading
from probedesign.live.outputs.sinks import SCHEMA
from probedesign.live.poses.pose_sources import POSE_COLUMNS, read_pose_file
from probedesign.live.processing.estimates import EstimateUpdate
from probedesign.live.processing.touches import Contact
from probedesign.live.recordings.csv import write_recording
from probedesign.live.recordings.mcap_write import McapRecorder
from probedesign.live.sources.replay import open_recording
from probedesign.mapping.contact_map import COLUMNS
from probedesign.mapping.explore import Exploration, followed_update


def arguments(probe, folder, *more, poses="poses.csv"):
    return ["explore", str(probe), str(folder / "house.mcap"), "--pose", str(folder / poses), "--average", "36",
            "--tare-s", "0.5:3.5", *map(str, more)]  # fmt: skip


def test_a_rehearsal_prints_one_document(probe, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(RehearsalOptions, "write", lambda self, *_: [self.rehearse / "house.mcap"])
    assert run(["explore", str(probe), "--rehearse", str(tmp_path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"files": [str(tmp_path / "house.mcap")]}


@pytest.fixture(scope="module")
def explored(probe, house, tmp_path_factory):
    out, printed = tmp_path_factory.mktemp("found"), io.StringIO()
    with redirect_stdout(printed):
        assert run(arguments(probe, house[1], "--out", out, "--json")) == 0
    return out, json.loads(printed.getvalue())


@pytest.fixture(scope="module")
def found(explored):
    out, _ = explored
    with (out / "points.csv").open() as file:
        return out, list(csv.DictReader(file))


def place(row):
    return np.array([float(row[f"{axis}_world_mm"]) for axis in "xyz"])


def covariance(row):
    xx, xy, xz, yy, yz, zz = (float(row[f"cov_world_{name}_mm2"]) for name in ("xx", "xy", "xz", "yy", "yz", "zz"))
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def test_the_points_lie_in_their_ellipsoids(house, found):
    """In twice the 95 % ellipsoid, which a Gaussian leaves once in a million cases."""
    rehearsal, (_, rows) = house[0], found
    assert list(rows[0]) == list(COLUMNS) and [row["result"] for row in rows] == ["ok", "ok"]
    for row, true in zip(rows, rehearsal.touches, strict=False):
        off = place(row) - true.p_world / MM
        assert off @ np.linalg.solve(covariance(row), off) < 4.0 * max_chi2(3, 0.05)
        assert np.linalg.norm(off) < 2.0
        assert float(row["force_N"]) == pytest.approx(true.force, rel=0.1)  # as well as the bias is known


def test_two_touches_of_one_point_are_fused(found):
    _, rows = found
    assert [row["touch_numbers"] for row in rows] == ["1 3", "2"]
    assert [row["touches"] for row in rows] == ["2", "1"]
    assert all(float(row["common_rms_mm"]) < float(row["rms_mm"]) for row in rows)


def test_the_simulated_touches_are_light_and_clear_of_the_cards(house):
    """Forces below 5 mN; the probe does not touch the card beyond the edge."""
    for touch in house[0].touches:
        assert touch.force < 5e-3
        assert touch.clearance > -0.1 * MM  # at the edge itself it is none; the chord's sag is that


def test_ply_json_page_and_picture_have_the_points_of_the_table(explored, found):
    (out, rows), (_, document) = found, explored
    cloud = trimesh.load(out / "points.ply")
    assert cloud.vertices == pytest.approx(np.array([place(row) for row in rows]), abs=1e-3)
    assert cloud.colors.shape == (len(rows), 4) and "rms_mm" in (out / "points.ply").read_text()
    assert [point["x_world_mm"] for point in document["points"]] == pytest.approx([place(row)[0] for row in rows])
    assert document["not_located"] == [] and abs(document["stiffness_factor"] - 1.0) < 0.04
    page, picture = (out / "points.html").read_text(), (out / "points.svg").read_text()
    assert picture.count("rotate(") == len(rows) and page.count("<canvas") == 1
    for text in (page, picture):  # the recording of a simulated run states its source; nothing needs a network
        assert "the simulated truth" in text
        assert "http" not in text.replace("http://www.w3.org/2000/svg", "") and "src=" not in text


def test_a_smaller_base_uncertainty_makes_smaller_ellipsoids(probe, house, found, capsys):
    """A tilt of 0.2° shifts a point at 110 mm by 0.39 mm on two axes, part of which the touches themselves observe; the
    remaining common error is due to the print."""
    still = ["--tilt-deg", "0", "--clocking-deg", "0", "--base-offset-mm", "0.02"]
    assert run(arguments(probe, house[1], "--json", *still)) == 0
    output = capsys.readouterr()
    assert "0.02 mm common, 0.01 mm per pose, tilt 0°, clocking 0°" in output.err
    for point, row in zip(json.loads(output.out)["points"], found[1], strict=True):
        less = float(row["common_rms_mm"]) ** 2 - point["common_rms_mm"] ** 2
        assert 0.2**2 < less < 0.39**2 * 2.0


def test_a_source_gives_the_same_as_the_recording(probe, house, found, tmp_path, capsys):
    """Identical files: a replay is a source like a sensor, and its recording states its source, too."""
    folder, out = house[1], tmp_path / "found"
    command = ["explore", str(probe), "--source", f"replay:{folder / 'house.mcap'}?speed=max", "--average", "36",
               "--pose", str(folder / "poses.csv"), "--tare-s", "0.5:3.5", "--json", "--out", str(out)]  # fmt: skip
    assert run(command) == 0
    output = capsys.readouterr()
    assert "touch 1 ended: ok" in output.err
    assert [point["touch_numbers"] for point in json.loads(output.out)["points"]] == ["1 3", "2"]
    for name in ("points.csv", "points.ply", "points.svg"):
        assert (out / name).read_bytes() == (found[0] / name).read_bytes()


def test_a_recording_of_means_gives_the_same_points(probe, house, found, tmp_path, capsys):
    """Ten means a second without `--average`: the same touches, each point within its stated error of the one from
    samples."""
    folder = house[1]
    blocks = list(open_recording(folder / "house.mcap", load_estimator(probe).model).blocks())
    time, wrench = (np.concatenate([getattr(b, name) for b in blocks]) for name in ("time", "wrench_sensor"))
    n = round(0.1 / np.median(np.diff(time)))
    k = len(time) // n
    means = wrench[: k * n].reshape(k, n, 6).mean(axis=1)
    write_recording(tmp_path / "means.csv", time[: k * n].reshape(k, n).mean(axis=1), means)
    command = ["explore", str(probe), str(tmp_path / "means.csv"), "--pose", str(folder / "poses.csv"),
               "--tare-s", "0.5:3.5", "--json"]  # fmt: skip
    assert run(command) == 0
    points = json.loads(capsys.readouterr().out)["points"]
    assert [point["touch_numbers"] for point in points] == ["1 3", "2"]
    for point, row in zip(points, found[1], strict=True):
        off = np.array([point[f"{axis}_world_mm"] for axis in "xyz"]) - place(row)
        assert np.linalg.norm(off) < point["rms_mm"]  # the same samples, but for those where the base moves


# refusals


RUN = ("HOUSE", "--pose", "POSES", "--average", "36", "--tare-s", "0.5:3.5")


def refused(capsys, command):
    status = run(command)
    lines = [line for line in capsys.readouterr().err.splitlines() if not line.startswith("note:")]
    assert status == 2 and len(lines) == 1, lines
    return lines[0]


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (["HOUSE", "--tare-s", "0:3"], "--pose FILE.csv"),
        (["HOUSE", "--pose", "POSES"], "--tare-s START:END"),
        (["--rehearse", "FOLDER", "--seed", "-1"], "--seed -1"),
        ([*RUN, "--out", "FOUND"], "--force"),
        ([*RUN, "--apart-mm", "-1"], "--apart-mm -1"),
        ([*RUN, "--source", "sim:"], "--source"),
        ([*RUN, "--tilt-deg", "nan"], "--tilt-deg nan"),
        ([*RUN, "--base-offset-mm", "50"], "--base-offset-mm 50"),
        ([*RUN, "--object", "POSES", "--object-at", "0,0,0"], "is not a readable mesh"),
        ([*RUN, "--publish", "ros2://HOST"], "--publish ros2://HOST: write ros2://HOST:PORT"),
        (["--follow", "udp://:9000", "--pose", "POSES"], "no --pose"),
        (["--follow", "udp://:9000", "--average", "36"], "no --average"),
        (["--follow", "udp://:9000", "--seconds", "-1"], "--seconds -1"),
    ],
)
def test_what_is_missing_or_out_of_range_is_refused_with_its_option(
    probe, house, found, tmp_path, capsys, change, named
):
    paths = {
        "HOUSE": house[1] / "house.mcap", "POSES": house[1] / "poses.csv", "FOLDER": tmp_path, "FOUND": found[0]
    }  # fmt: skip
    assert named in refused(capsys, ["explore", str(probe), *(str(paths.get(word, word)) for word in change)])


def test_a_recording_of_another_probe_or_of_another_clock_is_refused(estimator, probe, house, tmp_path, capsys):
    rod = estimator.model.rod
    other = replace(estimator.model, fingerprint="0" * 12, rod=replace(rod, youngs_modulus=2.0 * rod.youngs_modulus))
    write_frozen(other, tmp_path / "other.probe.json")
    line = refused(capsys, arguments(tmp_path / "other.probe.json", house[1]))
    assert "recorded with probe" in line or "fingerprint" in line
    rows = [f"{1e6 + t},0,0,0,0,0,0,1" for t in (0.0, 0.01)]
    (tmp_path / "late.csv").write_text("\n".join([",".join(POSE_COLUMNS), *rows]) + "\n")
    line = refused(capsys, [*arguments(probe, house[1])[:4], str(tmp_path / "late.csv"), "--tare-s", "0:3"])
    assert "the clocks do not overlap" in line


def test_a_live_source_with_positions_in_metres_gives_no_points(probe, house, tmp_path, capsys):
    """As `live` does: 0.4 in x_mm. A recording with such poses is refused before it is read."""
    lines = (house[1] / "poses.csv").read_text().splitlines()
    header, *rows = (line for line in lines if not line.startswith("#"))
    metres = [
        ",".join([row.split(",")[0], *(repr(float(x) / 1000.0) for x in row.split(",")[1:4]), *row.split(",")[4:]])
        for row in rows
    ]
    (tmp_path / "metres.csv").write_text("\n".join([header, *metres]) + "\n")
    replayed = ["explore", str(probe), "--source", f"replay:{house[1] / 'house.mcap'}?speed=max", "--json",
                "--average", "36", "--tare-s", "0.5:3.5", "--pose", str(tmp_path / "metres.csv")]  # fmt: skip
    assert run(replayed) == 0
    printed = capsys.readouterr()
    assert json.loads(printed.out)["points"] == []
    assert "in metres" in printed.err and printed.err.count("ended: inconsistent") == len(house[0].touches)


def test_recordings_of_two_probes_make_one_map_that_names_them(probe, house, found, tmp_path, capsys):
    """Both have the readings of the same run, in one recording that has the poses, too, or in one each: either touches
    each point, and the touches of both halve the variance that they do not have in common."""
    model, poses = load_estimator(probe).model, read_pose_file(house[1] / "poses.csv")
    models = {name: replace(model, name=name) for name in ("left", "right")}
    files = {"both": [*models.values()], **{name: [each] for name, each in models.items()}}
    blocks = list(open_recording(house[1] / "house.mcap", model).blocks())
    for file, recorded in files.items():
        with closing(McapRecorder(tmp_path / f"{file}.mcap", *recorded)) as recorder:
            for each in recorded:
                write_frozen(each, tmp_path / f"{each.name}.probe.json")
                of = each.name if len(recorded) > 1 else ""
                for block in blocks:
                    recorder.on_samples(replace(block, probe=of))
                for pose in poses if of else ():
                    recorder.on_pose(replace(pose, probe=of))
    bundles = [str(tmp_path / f"{name}.probe.json") for name in models]
    both, left, right = (str(tmp_path / f"{name}.mcap") for name in files)
    options, stated = ["--average", "36", "--tare-s", "0.5:3.5"], ["--pose", str(house[1] / "poses.csv")]
    assert run(["explore", *bundles, both, "--pose", both, *options]) == 0
    lines = capsys.readouterr().out.splitlines()
    numbers = ["left 1, right 1, left 3, right 3", "left 2, right 2"]
    assert [line.partition("touch ")[2] for line in lines[:2]] == numbers
    assert lines[-1] == "2 points from 6 touches"
    assert run(["explore", *bundles, left, right, *stated, *stated, *options, "--json"]) == 0
    for point, alone, of in zip(json.loads(capsys.readouterr().out)["points"], found[1], numbers, strict=True):
        assert np.linalg.norm(place(point) - place(alone)) < 1.0
        assert point["rms_mm"] < float(alone["rms_mm"]) and point["touch_numbers"] == of


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (lambda a, b, r, p: [a, a, r, *p, *p], "two probes are named left"),
        (lambda a, b, r, p: [a, b, r, r, *p], "1 --pose for 2 probes"),
        (lambda a, b, r, p: [a, b, r, "--pose", r], "left: "),
        (lambda a, b, r, p: [a, b, r, r, r, *p], "3 recordings of 2 probes"),
        (lambda a, b, r, p: [a, b, "--source", "sim:", *p, *p], "--source is read by one probe"),
        (lambda a, b, r, p: [a, b, "--follow", "udp://:9000", "--source", "sim:", *p], "--follow takes the touches"),
        (lambda a, b, r, p: [a, b, r, *p, *p, "--publish", "http://here"], "udp://HOST:PORT"),
    ],
)
def test_several_probes_without_names_recordings_or_poses_of_their_own_are_refused(
    change, named, probe, house, tmp_path, capsys
):
    for name in ("left", "right"):
        write_frozen(replace(load_estimator(probe).model, name=name), tmp_path / f"{name}.probe.json")
    files = [str(path) for path in (tmp_path / "left.probe.json", tmp_path / "right.probe.json",
                                    house[1] / "house.mcap")]  # fmt: skip
    words = change(*files, ["--pose", str(house[1] / "poses.csv")])
    line = refused(capsys, ["explore", *words, *(["--tare-s", "0.5:3.5"] if "--follow" not in words else [])])
    assert named in line


@pytest.mark.parametrize("change", [
    {"number": "7"}, {"number": 10**400}, {"schema": 0}, {"T_world_base": np.diag([1.0, 1.0, -1.0, 1.0]).tolist()},
    {"T_world_base": [[1.0]]}, {"T_world_base": (np.eye(4) + 1e9 * np.eye(4, k=3)).tolist()},
    {"mount_force_base_N": [0.0, float("nan"), 0.0]}, {"mount_moment_base_Nm": [1e300] * 3}, {"time_s": None},
    {"time_s": 1e300}, {"touch": float("inf")}, {"touch": "first"}, {"phase": ["touching"]}, {"phase": None},
])  # fmt: skip
def test_a_damaged_estimate_of_a_followed_run_is_refused(change):
    """The thread that receives ends with any other exception."""
    estimate = {
        "schema": SCHEMA, "number": 7, "kind": "estimate", "phase": "touching", "touch": 3, "time_s": 1.0,
        "T_world_base": np.eye(4).tolist(), "mount_force_base_N": [0.0] * 3, "mount_moment_base_Nm": [0.0] * 3,
    }  # fmt: skip
    update = followed_update(np.array([0.0, 0.0, -9.81]), estimate).value
    assert update is not None and update.contacts[0].number == 3
    with pytest.raises(InputError):
        followed_update(np.array([0.0, 0.0, -9.81]), estimate | change)


def test_a_run_begins_without_the_free_probe_of_the_run_before(estimator):
    """Its tare, and so the zero of its wrenches, is another."""
    exploration = Exploration(estimator)
    free = EstimateUpdate(WrenchReading(0.0, np.zeros(6), np.array([0.0, 0.0, -9.81])), None, phase="free",
                          T_world_base=np.eye(4), wrench_base=np.zeros(6))  # fmt: skip
    for run_of in range(2):
        for k in range(100):
            touch = replace(free, phase="settled", contacts=(Contact(1, 0.0),)) if run_of and k > 1 else free
            assert not list(exploration.take(replace(touch, reading=replace(free.reading, time=0.01 * k)), print))
        touches = list(exploration.finish(print))
    (touch,) = touches
    assert touch.segment.number == 1 and touch.segment.free_before is None and len(touch.segment.intervals) == 1


def test_a_run_of_live_is_followed_and_answered_with_the_next_touch(probe, house, found, tmp_path):
    """Over real sockets: the points are those of the recording, and each touch is answered with shapes."""
    answers, free = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
    with answers, free:
        for each in (answers, free):
            each.bind(("127.0.0.1", 0))
        port, sender = free.getsockname()[1], [sys.executable, "-m", "probedesign.cli.main"]
        free.close()
        trimesh.creation.box((63.5, 63.5, 89.0)).export(tmp_path / "object.stl")
        following = subprocess.Popen(
            [*sender, "explore", str(probe), "--follow", f"udp://:{port}", "--suggest", "--goal", "pose", "--object",
             str(tmp_path / "object.stl"), "--object-at=-30,32,45", "--publish",
             f"udp://127.0.0.1:{answers.getsockname()[1]}", "--out", str(tmp_path / "out")],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)  # fmt: skip
        assert "listening" in following.stderr.readline()
        run_of_it = [*sender, "live", str(probe), "--source", f"replay:{house[1]}/house.mcap?speed=10", "--pose",
                     str(house[1] / "poses.csv"), "--tare-s", "0.5:3.5", "--average", "36", "--rate-hz", "200",
                     "--deadline-ms", "60000", "--publish", f"udp://127.0.0.1:{port}"]  # fmt: skip
        assert subprocess.run(run_of_it, capture_output=True, check=False).returncode == 0
        answers.settimeout(120.0)
        first = json.loads(answers.recv(65536))
        following.terminate()  # SIGINT is ignored in a shell's background
        printed, _ = following.communicate(timeout=120)
        second = json.loads(answers.recv(65536))
    assert following.returncode == 0 and "next touch" in printed
    assert np.shape(first["suggestion"]["T_world_base"]["contact"]) == (4, 4)
    assert second["number"] == first["number"] + 1 and first["kind"] == second["kind"] == "map"
    with (tmp_path / "out/points.csv").open() as file:
        for here, there in zip(csv.DictReader(file), found[1], strict=True):
            # The same readings, but for those before a pause of a second, which a busy machine makes.
            assert np.linalg.norm(place(here) - place(there)) < 0.3 * float(there["rms_mm"])
