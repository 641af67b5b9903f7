"""Wrenches and poses of ROS 2 through the bridge process, with a stand-in for rclpy (tests/ros2_stub)."""

import os
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from probedesign.core.errors import InputError
from probedesign.live.blocks import Block
from probedesign.live.poses.open import open_poses
from probedesign.live.sources.ros2 import BRIDGE
from probedesign.live.sources.source import open_source
from probedesign.live.sources.udp import parse_wrench
from tests.live.peers import until

STUB = Path(__file__).parents[1] / "ros2_stub"


@pytest.fixture
def ros2(monkeypatch):
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(STUB), os.environ.get("PYTHONPATH", "")]))


def some_readings(source, count):
    stream, readings = iter(source), []
    for block in stream:
        readings += block.readings()
        if len(readings) >= count:
            break
    stream.close()
    return readings


@pytest.mark.parametrize(("topic", "unit"), [("netft/wrench", 1.0), ("ft_sensor/wrench?moment_unit=Nmm", 1e-3)])
def test_wrenches_of_a_topic(ros2, estimator, topic, unit):
    """Values, times and frame of the published messages; the stand-in stamps from 100 s on."""
    lines = []
    source = open_source(f"ros2://{topic}", estimator.model, lines.append)
    readings = some_readings(source, 5)
    assert readings[0].wrench_sensor == pytest.approx([0.25, 0, 0, 0, 0, 0.004 * unit], abs=1e-15)
    assert readings[0].time >= 100.0 and (np.diff([r.time for r in readings]) > 0.0).all()
    assert any("'tool0' is interpreted as the sensor frame" in line for line in lines)
    bridge = source._listener._process
    assert bridge.poll() is not None  # it ends with the source


def test_the_profile_of_a_subscription_fits_ros_netft(monkeypatch):
    """netft_driver publishes WrenchStamped in N and N·m with best effort, by default /netft/wrench in netft_link.

    Source: github.com/netft/ros-netft, src/ros2_node.cpp and config/netft_ros2.yaml. A subscriber that asks for a
    reliable topic would receive nothing, and one with a short queue loses readings of 7 kHz.
    """
    monkeypatch.syspath_prepend(str(STUB))
    before = set(sys.modules)
    try:
        from rclpy.node import Node

        from probedesign.live.sources.ros2_bridge import forward_wrench

        node = Node("bridge")
        forward_wrench(node, "/netft/wrench", "127.0.0.1", "9", "Nm")
        profile = node.subscription_profiles["/netft/wrench"]
        assert profile.reliability.name == "BEST_EFFORT" and profile.depth >= 700  # 0.1 s of the fastest box
    finally:
        for name in set(sys.modules) - before:
            del sys.modules[name]


@pytest.mark.parametrize(("frame", "used"), [("large/base", "base"), ("base", "sensor"), ("netft_link", "sensor")])
def test_the_base_of_a_topic_is_the_robots_unless_it_has_the_name_of_the_probe(ros2, estimator, frame, used):
    lines = []
    source = open_source("ros2://ft_sensor/wrench", estimator.model, lines.append)
    source._listener.frame = frame
    values = parse_wrench({"fx_N": 0.25, "fy_N": 0, "fz_N": 0, "mx_Nm": 0, "my_Nm": 0, "mz_Nm": 0}).value
    reading = source._reading(0.0, values, 1)
    at_base = estimator.model.to_sensor(values.wrench, estimator.model.gravity_base)
    assert reading.wrench_sensor == pytest.approx(at_base if used == "base" else values.wrench, abs=1e-15)
    source._listener._socket.close()  # nothing was started


def test_an_ended_bridge_ends_the_run_with_its_reason(ros2, estimator, monkeypatch, tmp_path):
    (tmp_path / "rclpy").mkdir()
    (tmp_path / "rclpy" / "__init__.py").write_text("def init(args=None): raise RuntimeError('no\\x1b[2J middleware')")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    source, poses = open_source("ros2://wrench", estimator.model), open_poses("tf://world/base")
    now = np.array([time.monotonic()])

    def refresh():
        until(lambda: poses.refresh(Block(now, np.zeros((1, 6)), np.zeros(3), now)))

    for attempt in (lambda: some_readings(source, 1), refresh):
        with pytest.raises(InputError, match=r"has ended: RuntimeError: no\\x1b\[2J middleware"):
            attempt()
    poses.close()


@pytest.mark.parametrize("spec", ["ros2:wrench", "ros2://", "ros2://a b", "ros2://-x", "ros2://w?moment_unit=N"])
def test_what_is_no_topic(estimator, spec):
    with pytest.raises(InputError):
        open_source(spec, estimator.model)


def test_without_rclpy_the_remedy_is_named(estimator, monkeypatch):
    monkeypatch.setattr("probedesign.live.sources.ros2.SYSTEM_PYTHONS", ("none",))
    with pytest.raises(InputError, match="none cannot import rclpy; source the set-up file of ROS 2"):
        open_source("ros2://wrench", estimator.model)


def test_poses_of_tf(ros2):
    """The stand-in moves by 0.1 m a second and is rotated about z; a slash in a frame is written %2F."""
    poses = open_poses("tf://world/robot%2Fbase")
    try:
        until(lambda: poses._listener.counts["taken"] >= 20)
        now = np.array([time.monotonic()])
        poses.refresh(Block(now, np.zeros((1, 6)), np.zeros(3), now))
        T = poses.at(poses.track.end)
        # a stamp's nanoseconds are whole and its seconds are sent as a double: 0.1 m/s times a microsecond
        assert T[0, 3] == pytest.approx(0.1 * (poses._listener._last.time - 200.0), abs=1e-7)
        assert T[:3, 0] == pytest.approx([0.28, 0.96, 0.0], abs=1e-12)
    finally:
        poses.close()
    assert poses._listener._process.poll() is not None


@pytest.mark.parametrize("spec", ["tf://world", "tf:world/base", "tf://a/b/c", "tf:///base", "tf://world/base?pyton=x"])
def test_what_are_no_frames(spec):
    with pytest.raises(InputError):
        open_poses(spec)


def test_the_bridge_runs_in_the_python_of_ros_2():
    """Humble has Python 3.10: nothing newer, and nothing of probedesign."""
    import ast

    tree = ast.parse(BRIDGE.read_text(encoding="utf-8"), feature_version=(3, 10))
    imported = {n.module.split(".")[0] for n in ast.walk(tree) if isinstance(n, ast.ImportFrom)}
    imported |= {a.name.split(".")[0] for n in ast.walk(tree) if isinstance(n, ast.Import) for a in n.names}
    assert imported - set(sys.stdlib_module_names) == {"rclpy", "geometry_msgs", "tf2_ros"}
