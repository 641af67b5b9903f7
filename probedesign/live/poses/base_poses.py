"""Poses of the base by the clock of the wrench, wherever they come from."""

import math
from collections.abc import Callable
from time import monotonic

import numpy as np

from probedesign.frames import Array
from probedesign.live.poses.listener import Listener
from probedesign.live.poses.track import MAX_GAP, MAX_POSES, Offset, TimedPose, Track
from probedesign.live.processing.blocks import Block

PATIENCE = 2.0
"""How long an estimate waits for the pose after it, in limits; then it is made without."""
GRAVITY_WORLD = (0.0, 0.0, -9.81)
"""Of a world whose z axis points up [m/s²]."""


class Poses:
    """Where the base is, at any moment that poses lie around.

    The poses of a file or a bag are told by the wrench's clock already. Those of a listener have the robot's: both
    clocks are compared with this machine's, by what arrives soonest after its stamp.

    Attributes:
        title: one line that says what it is.
        notes: what a user should know of it, each one line.
        gravity_world: [m/s²], (3,).
        latency: by which a pose arrives later, or is stamped later, than a reading of the same moment [s].
        track: all poses that are kept, by the wrench's clock, latency taken off.
        tell: takes each of them once, in order, as the readings come to it: what a recording needs to replay them.
    """

    def __init__(
        self,
        title: str,
        poses: list[TimedPose] | Listener,
        *,
        latency: float = 0.0,
        limit: float = MAX_GAP,
        gravity_world: Array | None = None,
        notes: tuple[str, ...] = (),
        say: Callable[[str], None] = lambda line: None,
    ) -> None:
        """Begin.

        Args:
            title: what they are.
            poses: all of them, by the wrench's clock, or who hears them.
            latency: stated [s].
            limit: of the time between neighbours, as in `Track` [s].
            gravity_world: down by 9.81 m/s² along z if None.
            notes: on them.
            say: takes what comes up later.
        """
        self.title, self.notes, self.latency = title, notes, latency
        self.gravity_world = np.array(GRAVITY_WORLD if gravity_world is None else gravity_world, dtype=float)
        self._say = say
        self._listener = poses if isinstance(poses, Listener) else None
        if isinstance(poses, Listener):
            self.track = Track(limit, MAX_POSES)
        else:
            self.track = Track.of((self._later(pose, -latency) for pose in poses), limit)
        self._wrench, self._robot = Offset(), Offset()
        self._session = 0
        self._last: tuple[float, Array | None] = (math.nan, None)
        self._told, self._since = -math.inf, math.nan
        self.tell: Callable[[TimedPose], None] = lambda pose: None

    def refresh(self, block: Block) -> None:
        """Take in what was heard since the last call, and how the wrench's clock goes; tell the poses that count."""
        if len(block) == 0:
            return
        if math.isnan(self._since):
            self._since = float(block.time[0])
        if self._listener is not None:
            self._hear(self._listener, block)
        self._tell_up_to(float(block.time[-1]) if self._listener is None else math.inf)

    def _tell_up_to(self, time: float) -> None:
        for pose in self.track.around(self._since, time):
            if pose.time > self._told:
                self._told, self._since = pose.time, max(pose.time, self._since)
                self.tell(pose)

    def _hear(self, listener: Listener, block: Block) -> None:
        for line in listener.said():
            self._say(line)
        now = monotonic()
        for time, received in zip(block.time.tolist(), block.received.tolist(), strict=True):
            self._wrench.add(time, received if math.isfinite(received) else now)
        for arrival, pose, session in listener.taken():
            if session != self._session:
                self._session, self._robot = session, Offset()
            ahead = self._robot.add(pose.time, arrival) - self._wrench.value
            self.track.add(self._later(pose, ahead - self.latency))

    def at(self, time: float) -> Array | None:
        """T_world_base (4, 4) at a time [s]; None where there is no pose that may be trusted."""
        if time != self._last[0] or self._last[1] is None:  # one batch asks several times
            self._last = (time, self.track.at(time))
        return self._last[1]

    def awaits(self, time: float, newest: float) -> bool:
        """Whether the pose after a time may come yet, the newest reading being from `newest` [s]."""
        if self._listener is None or self.track.end >= time:
            return False
        return newest - time < PATIENCE * self.track.limit

    def why(self, time: float) -> str:
        """Why there is no pose at a time, in words."""
        return f"no pose of the base at {time:.6g} s: {self.track.why(time)}"

    def gravity(self, T_world_base: Array) -> Array:
        """In base axes [m/s²], (3,)."""
        return np.asarray(T_world_base[:3, :3].T @ self.gravity_world, dtype=float)

    def close(self) -> None:
        """Stop listening; said with what was heard."""
        if self._listener is not None:
            self._listener.close()
            for line in (*self._listener.said(), f"{self.title}: {self._listener.summary}"):
                self._say(line)

    @staticmethod
    def _later(pose: TimedPose, seconds: float) -> TimedPose:
        """The same pose with a later stamp, of whole nanoseconds, so that a recording of it is exact."""
        return TimedPose(round(pose.time + seconds, 9), pose.p, pose.q)
