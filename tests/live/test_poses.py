"""Poses of the base: interpolated, never extrapolated, whatever is sent."""

import json
import socket
import time

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from probedesign.core.errors import InputError
from probedesign.core.frames import inverse, is_pose, pose
from probedesign.live.blocks import Block
from probedesign.live.poses.base_poses import (
    GRAVITY_WORLD,
    MAX_GAP,
    OFFSET_WINDOW,
    BasePoses,
    ClockOffset,
    PoseTrack,
    TimedPose,
)
from probedesign.live.poses.open import open_poses
from probedesign.live.poses.pose_sources import listen, read_pose_file
from probedesign.live.recordings.schemas import POSE, TRANSFORMS
from tests.live.mcap_files import ROS, header, write_bag
from tests.live.peers import until

GOOD = {"time_s": 1.0, "x_mm": 1.0, "y_mm": 2.0, "z_mm": 3.0, "qx": 0.0, "qy": 0.0, "qz": 0.0, "qw": 1.0}


def random_poses(n, step=0.01, seed=0):
    rng = np.random.default_rng(seed)
    turns = Rotation.random(n, rng=rng)
    p = rng.uniform(-1.0, 1.0, (n, 3))
    return ([TimedPose(step * i, tuple(p[i].tolist()), tuple(turns[i].as_quat().tolist())) for i in range(n)], turns, p)


# between poses


def test_between_poses_as_scipy_has_it():
    """Another implementation of the same great circle; both round at 1e-15."""
    poses, turns, p = random_poses(20)
    track = PoseTrack.of(poses)
    at = np.random.default_rng(1).uniform(0.0, poses[-1].time, 200)
    expected = Slerp([q.time for q in poses], turns)(at).as_matrix()
    for t, R in zip(at.tolist(), expected, strict=True):
        T = track.at(t)
        assert is_pose(T, 1e-12)
        assert T[:3, :3] == pytest.approx(R, abs=1e-12)
        assert T[:3, 3] == pytest.approx([np.interp(t, track.times, p[:, k]) for k in range(3)], abs=1e-14)
    track = PoseTrack.of([TimedPose(0.0, (0, 0, 0), (0.6, 0, 0, 0.8)), TimedPose(0.01, (0, 0, 0), (-0.6, 0, 0, -0.8))])
    assert track.at(0.005) == pytest.approx(track.at(0.0), abs=1e-15)  # the negative quaternion is the same rotation


def test_a_pose_is_exact_at_its_time_and_never_extrapolated():
    poses, *_ = random_poses(3)
    track = PoseTrack.of(poses)
    assert track.at(0.02) is not None and np.array_equal(track.at(0.02)[:3, 3], poses[2].p)
    assert track.at(np.nextafter(0.02, 1.0)) is None and track.at(-1e-9) is None
    assert "the last pose is 1 s older" in track.reason(1.02) and "the first pose is 1 s later" in track.reason(-1.0)
    assert "no pose has been received yet" in PoseTrack().reason(0.0)
    poses = [TimedPose(t, (0, 0, 0), (0, 0, 0, 1)) for t in (0.0, MAX_GAP, 3.0 * MAX_GAP)]
    track = PoseTrack.of(poses)  # a gap is not bridged
    assert track.at(0.5 * MAX_GAP) is not None and track.at(2.0 * MAX_GAP) is None
    assert "0.1 s apart, more than 0.05 s" in track.reason(2.0 * MAX_GAP)


def test_slow_poses_are_bridged_as_far_as_their_speed_allows():
    """At 20 Hz with scatter of the interval: to 0.5 mm for a base that starts or stops, a quarter of its travel."""
    times = np.cumsum(np.random.default_rng(1).uniform(0.045, 0.058, 60))
    for speed, bridged in ((0.02, True), (0.2, False)):
        track = PoseTrack.of([TimedPose(t, (speed * t, 0, 0), (0, 0, 0, 1)) for t in times])
        inside = [track.at(t) is not None for t in 0.5 * (times[12:] + times[11:-1])]
        assert all(inside) == bridged and any(inside)  # intervals of up to 50 ms are always bridged
    turning = [TimedPose(t, (0, 0, 0), (np.sin(t), 0, 0, np.cos(t))) for t in times]  # 2 rad/s: 0.2 m/s at the lever
    track = PoseTrack.of(turning)
    assert not all(track.at(t) is not None for t in 0.5 * (times[12:] + times[11:-1]))
    fast = [TimedPose(t, (0, 0, 0), (0, 0, 0, 1)) for t in (*np.arange(0.0, 1.0, 0.008), 1.1)]
    assert PoseTrack.of(fast).at(1.05) is None  # poses are missing there


def test_poses_that_lag_by_more_than_their_period_are_named_once():
    class Late:
        summary = title = ""

        def pop_messages(self):
            return []

        def pop(self):
            return [(t + 0.03 + 0.02 * (i % 2), TimedPose(t, (0, 0, 0), (0, 0, 0, 1)), 1) for i, t in enumerate(times)]

    times, lines = np.arange(0.0, 2.0, 0.01), []
    poses = BasePoses("", Late(), latency=0.015, log=lines.append)
    for _ in range(2):
        poses.refresh(Block(times, np.zeros((len(times), 6)), np.array(GRAVITY_WORLD), times))
    (line,) = lines
    assert line.startswith("poses: they are 25 ms late, more than their own period of 10 ms")


# fields of a pose


BAD = {
    "nan": {"x_mm": float("nan")},
    "inf": {"time_s": float("inf")},
    "no rotation": {"qw": 0.5},
    "nothing": {"qw": 0.0},
    "text": {"y_mm": "a lot"},
    "none": {"qx": None},
    "true": {"qx": True},
    "list": {"z_mm": [1.0]},
    "metres": {"z_mm": 1e9},
    "two units": {"time_ms": 1.0},
    "milliseconds": {"time_s": 1.8e12},
}


@pytest.mark.parametrize("wrong", BAD.values(), ids=BAD.keys())
def test_an_invalid_pose_is_refused_with_its_line(wrong, tmp_path):
    path = tmp_path / "poses.jsonl"
    path.write_text(json.dumps(GOOD) + "\n# a comment\n\n" + json.dumps(GOOD | {"time_s": 2.0} | wrong) + "\n")
    with pytest.raises(InputError, match=r"poses.jsonl:4: ") as error:
        read_pose_file(path)
    assert len(str(error.value)) < 200


@pytest.mark.parametrize(
    ("text", "stated"),
    [
        ("", "no poses"),
        ("[1, 2]\n", ":1: is not a JSON object"),
        ("[" * 100_000, ":1: is not JSON"),
        ('{"time_s": 1}\n', ":1: has no x_mm"),
        ("\x00\n", "is a binary file"),
        (json.dumps(GOOD) + "\n" + json.dumps(GOOD), ":2: time_s = 1 is not after 1"),
        (
            json.dumps(GOOD | {"frame": "a"}) + "\n" + json.dumps(GOOD | {"frame": "b", "time_s": 2}),
            "several frames, a, b",
        ),
    ],
)
def test_a_file_of_no_poses(text, stated, tmp_path):
    path = tmp_path / "poses.jsonl"
    path.write_text(text)
    with pytest.raises(InputError) as error:
        read_pose_file(path)
    assert stated in str(error.value)


@pytest.mark.parametrize(
    ("names", "factors"),
    [(tuple(GOOD), (1.0, 1e3, 1e3, 1e3)),
     (("time_ms", "x_m", "y_um", "z_mm", "qx", "qy", "qz", "qw"), (1e3, 1.0, 1e6, 1e3))],
)  # fmt: skip
def test_csv_and_json_lines_give_the_same_poses_in_any_units(tmp_path, names, factors):
    poses, *_ = random_poses(5)
    rows = [(*(f * x for f, x in zip(factors, (p.time, *p.p), strict=True)), *p.q) for p in poses]
    table, lines = tmp_path / "poses.csv", tmp_path / "poses.jsonl"
    table.write_text(",".join(names) + "\n" + "".join(",".join(map(repr, row)) + "\n" for row in rows))
    lines.write_text("".join(json.dumps(dict(zip(names, row, strict=True))) + "\n" for row in rows))
    assert read_pose_file(table) == read_pose_file(lines)
    third = read_pose_file(table)[3]
    assert (third.time, *third.p) == pytest.approx((poses[3].time, *poses[3].p), rel=1e-15)


@pytest.mark.parametrize(
    ("spec", "options", "stated"),
    [
        ("none.csv", {}, "none.csv: no such file of poses"),
        ("fixed", {"latency_ms": 5.0}, "--pose fixed has no latency"),
        ("udp://", {}, "write udp://:PORT"),
        ("udp://:port", {}, "write udp://:PORT"),
        ("udp://:0?topic=/a", {}, "has no parameter 'topic'"),
        ("udp://:0?limit_ms=0", {}, "limit_ms = '0' must be"),
        ("udp://:0?limit_ms=1&limit_ms=2", {}, "is given twice"),
        ("udp://192.0.2.1:3000", {}, "use another port, or an address of this machine"),
        ("udp://:0", {"latency_ms": float("nan")}, "--pose-latency-ms nan"),
        ("udp://:0", {"gravity_world": "0,0"}, "--gravity-world 0,0 must be"),
        ("udp://:0", {"gravity_world": "0,0,-981"}, "--gravity-world 0,0,-981 must be"),
    ],
)
def test_what_names_no_poses(spec, options, stated):
    with pytest.raises(InputError) as error:
        open_poses(spec, **options)
    assert stated in str(error.value)


# by UDP


@pytest.fixture
def listener():
    listener = listen("udp://127.0.0.1:0")
    yield listener
    listener.close()


@pytest.fixture
def robot(listener):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
        udp.connect(listener.address)
        yield udp


def test_a_flood_costs_no_more_than_its_share(listener, robot):
    """Enough datagrams for a message, faster than they are read: the ticks limit how many are taken."""
    start, lines, i = time.monotonic(), [], 0
    while not any("more than 2000 datagrams a second" in line for line in lines):
        assert time.monotonic() - start < 30.0
        for _ in range(100):
            i += 1
            robot.send(json.dumps(GOOD | {"time_s": 1.0 + 1e-5 * i}).encode())
        lines += listener.pop_messages()
        time.sleep(0.001)
    ticks = (time.monotonic() - start) / 0.010 + 2.0
    assert listener.counts["taken"] <= 20.0 * ticks < i


def test_udp_poses_go_by_the_clock_of_the_wrench(robot, listener):
    """Robot, sensor and this machine count from different zeros; what arrives together belongs together."""
    poses = BasePoses("udp", listener, latency=0.010)
    wrench_zero, robot_zero = time.monotonic() - 100.0, time.monotonic() - 5000.0
    for i in range(10):
        robot.send(json.dumps(GOOD | {"time_s": time.monotonic() - robot_zero, "x_mm": float(i)}).encode())
        time.sleep(0.005)
    until(lambda: listener.counts["taken"] == 10)
    now = np.array([time.monotonic()])
    poses.refresh(Block(now - wrench_zero, np.zeros((1, 6)), np.zeros(3), now))
    sent = time.monotonic() - wrench_zero
    # The last was sent 5 ms and a little ago, and its stamp is taken back by 10 ms: within what a busy machine sleeps.
    assert sent - 1.0 < poses.track.end + 0.010 <= sent
    steps = np.diff(poses.track.times)
    # The zero of the robot's clock is that of the record that came quickest: where a busy machine delayed the first
    # ones, a step is shorter by as much as that.
    assert len(poses.track) == 10 and (steps > 0.0).all() and np.median(steps) >= 0.004
    assert poses.at(poses.track.end) is not None and poses.at(poses.track.end + 1e-6) is None
    assert poses.may_arrive(poses.track.end + 0.001, poses.track.end + 0.002)
    assert not poses.may_arrive(poses.track.end + 0.001, poses.track.end + 1.0)


def test_the_offset_of_two_clocks_is_that_of_what_did_not_wait():
    """Half of what arrives waits up to 20 ms; clocks part by 50 ppm."""
    rng, offset = np.random.default_rng(0), ClockOffset()
    for i in range(6000):
        stamp = i / 100.0
        true = 1000.0 + 50e-6 * stamp
        found = offset.add(stamp, stamp + true + rng.choice([0.0, 0.02 * rng.random()]))
        if i > 100:
            assert true - 50e-6 * OFFSET_WINDOW - 1e-9 <= found <= true + 1e-9  # the least of the last ten seconds


# bags


def link(t, parent, child, p, q):
    move = ROS["Transform"](ROS["Vector3"](*map(float, p)), ROS["Quaternion"](*q))
    return ROS["TransformStamped"](header(t, parent), child, move)


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    """A bag of PoseStamped on two topics, and TF of two joints and a still link; the poses and where the base is."""
    first, turns, p = random_poses(5, seed=3)
    second, turns2, p2 = random_poses(5, seed=4)
    rows = [("/tf_static", 0.0, ROS["TFMessage"]([link(0.0, "flange", "probe", (0, 0, 0.1), (0.0, 0.0, 0.0, 1.0))]))]
    for a, b in zip(first, second, strict=True):
        there = ROS["Pose"](ROS["Point"](*a.p), ROS["Quaternion"](*a.q))
        links = [link(a.time, "world", "arm", a.p, a.q), link(a.time, "arm", "flange", b.p, b.q)]
        rows += [("/tool", a.time, ROS["PoseStamped"](header(a.time, "world"), there)),
                 ("/tf", a.time, ROS["TFMessage"](links))]  # fmt: skip
    kinds = {"/tool": POSE, "/other": POSE, "/tf": TRANSFORMS, "/tf_static": TRANSFORMS}
    path = write_bag(tmp_path_factory.mktemp("bags") / "poses", kinds, rows, storage="mcap")
    chained = [
        pose(R.as_matrix(), x) @ pose(R2.as_matrix(), y) @ pose(p=(0.0, 0.0, 0.1))
        for R, x, R2, y in zip(turns, p, turns2, p2, strict=True)
    ]
    return path, first, chained


def test_a_topic_of_a_bag(bag):
    """Stamps are of whole nanoseconds, numbers of double precision."""
    path, stated, _ = bag
    poses = open_poses(f"{path}?topic=/tool")
    for one in stated:
        T = poses.at(one.time)
        assert T is not None and T[:3, 3] == pytest.approx(one.p, abs=1e-15)
    assert "5 poses of" in poses.title


def test_two_frames_of_tf(bag):
    """Chained over two joints and a still link, and the other way round."""
    path, stated, chained = bag
    there, back = open_poses(f"{path}?world=world&base=probe"), open_poses(f"{path}?world=probe&base=world")
    for one, T in zip(stated, chained, strict=True):
        assert there.at(one.time) == pytest.approx(T, abs=1e-12)
        assert back.at(one.time) == pytest.approx(inverse(T), abs=1e-12)


@pytest.mark.parametrize(
    ("query", "stated"),
    [
        ("", "has several topics of PoseStamped: '/tool', '/other'; select one with ?topic="),
        ("?topic=/wrench", "has no topic '/wrench' of PoseStamped; available are: '/tool', '/other'"),
        ("?topic=/other", "no poses"),
        ("?world=world", "use topic=/NAME, or world=FRAME&base=FRAME"),
        ("?world=world&base=gripper", "TF does not connect 'world' and 'gripper'; frames: arm, flange, probe, world"),
        ("?world=flange&base=probe", "are all transforms static?"),
    ],
)
def test_what_a_bag_does_not_hold(bag, query, stated):
    with pytest.raises(InputError) as error:
        open_poses(f"{bag[0]}{query}")
    assert stated in str(error.value)


def test_what_is_no_bag(tmp_path):
    for name in ("", "junk.mcap", "junk.db3"):
        if name:
            (tmp_path / name).write_bytes(b"not a bag")
        with pytest.raises(InputError, match=r"cannot be read as a ROS 2 bag|not an MCAP file"):
            open_poses(str(tmp_path / name))
