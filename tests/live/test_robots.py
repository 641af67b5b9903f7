"""Poses of robot controllers, with modules that have the documented interface of ur_rtde and franky."""

import sys
from types import ModuleType, SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from probedesign.core.errors import InputError, MissingDependencyError
from probedesign.live.poses import robots
from probedesign.live.poses.base_poses import TimedPose, pose_matrix
from probedesign.live.poses.open import open_poses
from tests.live.peers import until

TURN = [0.3, -0.4, 1.2]  #: Rotation vector [rad].


class FakeRtde:
    """A controller whose state is updated every fourth call, so also between time stamp and pose.

    Position x [m] is a hundredth of the time, so that a pose with another state's time shows.
    """

    instances: ClassVar[list] = []
    reachable, connected = True, True

    def __init__(self, hostname, frequency=-1.0, variables=(), verbose=False):
        if not FakeRtde.reachable:
            raise RuntimeError(f"Error: Could not connect to: {hostname} at 30004, verify the IP")
        self.hostname, self.calls = hostname, 0
        FakeRtde.instances.append(self)

    def _state(self):
        self.calls += 1
        return 0.002 * (self.calls // 4)

    def isConnected(self):
        return FakeRtde.connected

    def getTimestamp(self):
        return self._state()

    def getActualTCPPose(self):
        return [0.01 * self._state(), 0.2, 0.3, *TURN]


@pytest.fixture
def rtde(monkeypatch):
    module = ModuleType("rtde_receive")
    module.RTDEReceiveInterface = FakeRtde
    monkeypatch.setitem(sys.modules, "rtde_receive", module)
    monkeypatch.setattr(robots, "RETRY_PERIOD", 0.02)
    FakeRtde.instances, FakeRtde.reachable, FakeRtde.connected = [], True, True
    return FakeRtde


def test_a_pose_and_its_time_are_of_one_state(rtde):
    poses = open_poses("ur://192.168.1.10")
    until(lambda: poses._listener.counts["taken"] >= 20)
    found = [pose for _, pose, _ in poses._listener.pop()]
    poses.close()
    assert rtde.instances[0].hostname == "192.168.1.10"
    assert all(pose.p[0] == 0.01 * pose.time for pose in found)
    assert (np.diff([pose.time for pose in found]) > 0.0).all()
    expected = Rotation.from_rotvec(TURN).as_matrix()
    assert pose_matrix(found[0])[:3, :3] == pytest.approx(expected, abs=1e-12)


def test_a_lost_connection_is_reported_and_made_again_and_an_absent_one_is_one_line(rtde):
    poses = open_poses("ur://robot")._listener
    until(lambda: poses.counts["taken"] >= 3)
    rtde.connected, rtde.reachable = False, False
    until(lambda: poses.counts["connections lost"] == 1)
    rtde.connected, rtde.reachable = True, True
    until(lambda: any("connected again" in line for line in poses._messages))
    poses.pop()
    taken = poses.counts["taken"]
    until(lambda: poses.counts["taken"] > taken)
    assert {session for _, _, session in poses.pop()} == {2}  # its clock may have restarted
    poses.close()
    assert "1 connections lost" in poses.summary
    rtde.reachable = False
    with pytest.raises(InputError, match="--pose ur://robot: Error: Could not connect"):
        open_poses("ur://robot")


class FakeFranka:
    """The part of `franky.Robot` that is read; the state has its time and the pose of the end effector."""

    def __init__(self, fci_hostname, realtime_config=None):
        assert realtime_config == "ignore"
        self.reads = 0

    @property
    def state(self):
        self.reads += 1
        quaternion = np.array([0.0, 0.6, 0.0, 0.8 if self.reads != 3 else 0.9])  # the third is not a rotation
        pose = SimpleNamespace(translation=np.array([0.4, 0.0, 0.001 * self.reads]), quaternion=quaternion)
        return SimpleNamespace(time=SimpleNamespace(to_sec=lambda n=self.reads: 0.001 * n), O_T_EE=pose)


def test_poses_of_a_franka(monkeypatch):
    module = ModuleType("franky")
    module.Robot, module.RealtimeConfig = FakeFranka, SimpleNamespace(Ignore="ignore")
    monkeypatch.setitem(sys.modules, "franky", module)
    poses = open_poses("franka://172.16.0.2?limit_ms=80")
    until(lambda: poses._listener.counts["taken"] >= 5)
    found = [pose for _, pose, _ in poses._listener.pop()]
    messages = poses._listener.pop_messages()
    poses.close()
    assert found[0] == TimedPose(0.001, (0.4, 0.0, 0.001), (0.0, 0.6, 0.0, 0.8))
    assert 0.003 not in [pose.time for pose in found] and len(messages) == 1 and "not a rotation" in messages[0]
    assert poses.track.max_gap == 0.08


@pytest.mark.parametrize("spec", ["ur:robot", "ur://", "ur://a/b", "ur://a:30004", "franka://", "ur://a?rate=3"])
def test_what_is_no_robot(spec):
    with pytest.raises(InputError):
        open_poses(spec)


@pytest.mark.parametrize(("spec", "extra"), [("ur://robot", "ur"), ("franka://robot", "franka")])
def test_a_missing_package_is_named(monkeypatch, spec, extra):
    monkeypatch.setitem(sys.modules, "rtde_receive", None)
    monkeypatch.setitem(sys.modules, "franky", None)
    with pytest.raises(MissingDependencyError, match=rf"probedesign\[{extra}\]"):
        open_poses(spec)
