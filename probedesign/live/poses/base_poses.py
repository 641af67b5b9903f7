"""Poses of the base by the clock of the wrench."""

import math
from collections.abc import Callable
from time import monotonic

import numpy as np

from probedesign.core.frames import Array
from probedesign.live import Log
from probedesign.live.blocks import Block
from probedesign.live.poses.pose_sources import PoseStream
from probedesign.live.poses.track import MAX_GAP, MAX_POSES, ClockOffset, PoseTrack, TimedPose

POSE_WAIT = 2.0  #: Maximum wait of an estimate for the next pose, in units of the maximum gap.
GRAVITY_WORLD = (0.0, 0.0, -9.81)  #: Gravity in a world whose z axis points up [m/s²].


class BasePoses:
    """Pose of the base at any time that is enclosed by poses.

    Poses of a file or a bag are by the wrench's clock already. Poses of a listener are by the robot's clock: both
    clocks are related to this machine's by the minimum delay of their messages.

    Attributes:
        title: one line that describes the poses.
        notes: notes for the user, one line each.
        gravity_world: gravity vector in the world [m/s²], (3,).
        latency: delay of a pose's time stamp relative to a reading of the same instant [s].
        track: the poses by the wrench's clock, corrected for latency.
        on_pose: callback for each pose, once and in order, as the readings reach it; a recording needs them for
            replay.
    """

    def __init__(
        self,
        title: str,
        poses: list[TimedPose] | PoseStream,
        *,
        latency: float = 0.0,
        max_gap: float = MAX_GAP,
        gravity_world: Array | None = None,
        notes: tuple[str, ...] = (),
        log: Log = lambda line: None,
    ) -> None:
        """Start with all poses by the wrench's clock, or with a listener that receives them.

        `max_gap` is that of `PoseTrack` [s]; gravity is 9.81 m/s² along -z if it is None.
        """
        self.title, self.notes, self.latency = title, notes, latency
        self.gravity_world = np.array(GRAVITY_WORLD if gravity_world is None else gravity_world, dtype=float)
        self._log = log
        self._listener = None if isinstance(poses, list) else poses
        if not isinstance(poses, list):
            self.track = PoseTrack(max_gap, MAX_POSES)
        else:
            self.track = PoseTrack.of((self._delayed(pose, -latency) for pose in poses), max_gap)
        self._wrench, self._robot = ClockOffset(), ClockOffset()
        self._session = 0
        self._cached: tuple[float, Array | None] = (math.nan, None)
        self._reported, self._since = -math.inf, math.nan
        self.on_pose: Callable[[TimedPose], None] = lambda pose: None

    def refresh(self, block: Block) -> None:
        """Process the poses received since the last call and the readings' clock; report each pose to `on_pose`."""
        if len(block) == 0:
            return
        if math.isnan(self._since):
            self._since = float(block.time[0])
        if self._listener is not None:
            self._receive(self._listener, block)
        for pose in self.track.spanning(self._since, math.inf if self._listener else float(block.time[-1])):
            if pose.time > self._reported:
                self._reported, self._since = pose.time, max(pose.time, self._since)
                self.on_pose(pose)

    def _receive(self, listener: PoseStream, block: Block) -> None:
        for line in listener.pop_messages():
            self._log(line)
        now = monotonic()
        for time, received in zip(block.time.tolist(), block.received.tolist(), strict=True):
            self._wrench.add(time, received if math.isfinite(received) else now)
        for arrival, pose, session in listener.pop():
            if session != self._session:
                self._session, self._robot = session, ClockOffset()
            ahead = self._robot.add(pose.time, arrival) - self._wrench.value
            self.track.add(self._delayed(pose, ahead - self.latency))

    def at(self, time: float) -> Array | None:
        """Return T_world_base (4, 4) at a time [s]; None if no reliable pose is known."""
        if time != self._cached[0] or self._cached[1] is None:  # a batch needs the same pose several times
            self._cached = (time, self.track.at(time))
        return self._cached[1]

    def may_arrive(self, time: float, newest: float) -> bool:
        """Return whether the pose after a time may still arrive, with the newest reading at `newest` [s]."""
        if self._listener is None or self.track.end >= time:
            return False
        return newest - time < POSE_WAIT * self.track.max_gap

    def reason(self, time: float) -> str:
        """Return why there is no pose at a time."""
        return f"no pose of the base at {time:.6g} s: {self.track.reason(time)}"

    def gravity(self, T_world_base: Array) -> Array:
        """Return the gravity vector in base axes [m/s²], (3,)."""
        return np.asarray(T_world_base[:3, :3].T @ self.gravity_world, dtype=float)

    def close(self) -> None:
        """Stop the listener and report its counts."""
        if self._listener is not None:
            self._listener.close()
            for line in (*self._listener.pop_messages(), f"{self.title}: {self._listener.summary}"):
                self._log(line)

    @staticmethod
    def _delayed(pose: TimedPose, seconds: float) -> TimedPose:
        return TimedPose(round(pose.time + seconds, 9), pose.p, pose.q)
