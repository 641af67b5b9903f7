"""Bags as others write them: rosbags is the independent writer."""

import numpy as np
import pytest

from probedesign.core.errors import InputError
from probedesign.live.blocks import iter_readings
from probedesign.live.processing.estimates import json_line
from probedesign.live.recordings.csv import write_recording
from probedesign.live.run import estimate_recording
from probedesign.live.sources.replay import RecordingOptions, ReplaySource
from probedesign.live.sources.sim import SimulatedSource
from tests.live.mcap_files import bag, read

WRENCH = [0.1, -0.2, 0.3, 0.001, -0.002, 0.003]
ROWS = [(1.7e9 + 0.01 * i, [value + 1e-4 * i for value in WRENCH]) for i in range(300)]


def mcap_of(folder):
    return folder / f"{folder.name}.mcap"


@pytest.mark.parametrize(
    "how", [{}, {"storage": "mcap", "compression": "STORAGE"}, {"compression": "FILE"}, {"compression": "MESSAGE"}]
)
def test_a_bag_is_read_in_every_storage_format(model, tmp_path, how):
    """The stamp counts nanoseconds and a double near 1.7e9 s steps by 2.4e-7 s; the wrench is exact."""
    folder = bag(tmp_path / "b", {"/ft": ROWS}, **how)
    recorded, blocks = read(folder, model)
    time = np.concatenate([block.time for block in blocks])
    assert time == pytest.approx([time for time, _ in ROWS], abs=2.4e-7, rel=0)
    assert np.concatenate([b.wrench_sensor for b in blocks]).tolist() == [wrench for _, wrench in ROWS]
    assert recorded.notes == ("topic /ft, frame 'ft', interpreted as the sensor frame",)
    assert recorded.missing() == ()


def test_a_single_file_of_a_bag_is_read_too(model, tmp_path):
    folder = bag(tmp_path / "b", {"/ft": ROWS})
    mcap = bag(tmp_path / "m", {"/ft": ROWS}, storage="mcap")
    both = [
        np.concatenate([b.wrench_sensor for b in read(path, model)[1]]) for path in (folder / "b.db3", mcap_of(mcap))
    ]
    assert both[0].tobytes() == both[1].tobytes()


def test_a_bag_gives_the_estimates_of_its_csv(estimator, tmp_path):
    """Contacts of the rod itself, at whole seconds, published by somebody and written down by hand."""
    readings = list(iter_readings(SimulatedSource(estimator.model, "speed=max&rate_hz=1&seconds=6")))
    times, wrenches = [r.time for r in readings], [r.wrench_sensor.tolist() for r in readings]
    folder = bag(tmp_path / "b", {"/ft": list(zip(times, wrenches, strict=True))})
    write_recording(tmp_path / "b.csv", times, wrenches)
    rows = [estimate_recording(estimator, path).rows for path in (folder, tmp_path / "b.csv")]
    assert list(map(json_line, rows[0])) == list(map(json_line, rows[1]))
    assert [row["result"] for row in rows[0]].count("ok") >= 3


def test_a_cut_bag_is_read_up_to_there(model, tmp_path):
    path = mcap_of(bag(tmp_path / "b", {"/ft": ROWS}, storage="mcap"))
    path.write_bytes(path.read_bytes()[:-100])
    assert sum(map(len, read(path, model)[1])) == 300  # its one chunk precedes the cut


def test_the_topic_is_chosen_or_named(model, tmp_path):
    folder = bag(tmp_path / "b", {"/left": ROWS[:2], "/right": ROWS[2:5]})
    with pytest.raises(InputError, match="several topics of WrenchStamped: '/left', '/right'"):
        read(folder, model)
    with pytest.raises(InputError, match="no topic '/rihgt' of WrenchStamped; did you mean /right"):
        read(folder, model, RecordingOptions("/rihgt"))
    assert sum(map(len, read(folder, model, RecordingOptions("/right"))[1])) == 3
    assert "topic=/left" not in ReplaySource(model, folder, "topic=/left").title


def test_a_topic_without_messages_or_of_another_kind(model, tmp_path):
    with pytest.raises(InputError, match="topic /ft has no messages"):
        read(bag(tmp_path / "empty", {"/ft": []}), model)
    with pytest.raises(InputError, match="has no topic of WrenchStamped"):
        read(bag(tmp_path / "poses", {"/pose": []}, kind="geometry_msgs/msg/PoseStamped"), model)
    with pytest.raises(InputError, match="no topic '/pose' of WrenchStamped; available are: none"):
        read(tmp_path / "poses", model, RecordingOptions("/pose"))


def test_headers_without_a_time_take_that_of_the_recording(model, tmp_path):
    recorded, blocks = read(bag(tmp_path / "b", {"/ft": [(5.0, WRENCH), (6.0, WRENCH)]}, stamped=False), model)
    assert blocks[0].time.tolist() == [5.0, 6.0]
    assert "its headers have no time stamp: the time of recording is used" in recorded.notes


def test_a_wrench_in_the_base_frame(model, tmp_path):
    folder = bag(tmp_path / "b", {"/ft": [(0.5, WRENCH)]}, frame="base")
    asked = bag(tmp_path / "c", {"/ft": [(0.5, WRENCH)]}, frame="ft")
    sensed = model.to_sensor(np.array(WRENCH), model.gravity_base)
    for path, choice in ((folder, None), (asked, RecordingOptions(frame="base"))):
        recorded, blocks = read(path, model, choice)
        assert recorded.frame == "base"
        assert blocks[0].wrench_sensor[0] == pytest.approx(sensed, rel=1e-12)  # one product of matrices


def test_newton_millimetres_are_detected_and_can_be_selected(model, tmp_path):
    """A moment of 3 N·mm is published as 3; the sensor's range is 0.12 N·m."""
    rows = [(0.5, [0.1, 0.0, 0.0, 0.0, 3.0, 0.0])]
    folder = bag(tmp_path / "b", {"/ft": rows})
    assert "moments of 3 N·m are beyond the sensor's 0.12 N·m" in read(folder, model)[0].notes[1]
    recorded, blocks = read(folder, model, RecordingOptions(moment_unit="Nmm"))
    assert len(recorded.notes) == 1 and blocks[0].wrench_sensor[0, 4] == pytest.approx(0.003, rel=1e-15)


@pytest.mark.parametrize(
    ("rows", "problem"),
    [
        ([(1.0, WRENCH), (2.0, [np.nan] * 6)], "Fx = nan N at 2 s exceeds the range"),
        ([(1.0, [1e5] * 6)], "Fx = 100000 N at 1 s exceeds the range of any sensor; raw counts"),
        # as bags by file order have it; a database gives its messages in order of their recording
        ([(2.0, WRENCH), (1.0, WRENCH)], "time decreases, from 2 s to 1 s"),
    ],
)
def test_what_is_no_reading_is_refused(model, tmp_path, rows, problem):
    path = mcap_of(bag(tmp_path / "b", {"/ft": rows}, storage="mcap"))
    with pytest.raises(InputError, match=problem):
        read(path, model)


@pytest.mark.parametrize("suffix", [".mcap", ".db3"])
@pytest.mark.parametrize("content", [b"", b"\x00" * 64, b"SQLite format 3\x00" + b"\xff" * 200, b"\x89MCAP0\r\n"])
def test_junk_is_one_line(model, tmp_path, suffix, content):
    path = tmp_path / f"junk{suffix}"
    path.write_bytes(content)
    with pytest.raises(InputError) as error:
        read(path, model)
    assert str(path) in str(error.value) and str(error.value).isprintable()


def test_what_is_not_there_is_one_line(model, tmp_path):
    for name in ("none.mcap", "none.db3", "none.csv", "none"):
        with pytest.raises(InputError, match=r"no such recording|does not exist|cannot be read"):
            read(tmp_path / name, model)
    (tmp_path / "folder").mkdir()
    with pytest.raises(InputError, match="is a folder without"):
        read(tmp_path / "folder", model)


@pytest.mark.parametrize(
    ("query", "problem"),
    [
        ("frame=world", "frame = 'world' must be sensor or base"),
        ("moment_unit=lbf", "must be Nm or Nmm"),
        ("topic=/a&topic=/b", "topic is given twice"),
        ("topci=/a", "has no parameter 'topci'"),
        ("topic=/a", "has no topic '/a': it is not a ROS 2 bag"),
    ],
)
def test_parameters_of_a_replay(model, tmp_path, query, problem):
    write_recording(tmp_path / "r.csv", [0.0, 1.0], [WRENCH, WRENCH])
    with pytest.raises(InputError, match=problem):
        ReplaySource(model, tmp_path / "r.csv", query)
