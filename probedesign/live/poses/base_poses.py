"""Poses of the base by the clock of the wrench: time-stamped poses, their track, the TF tree, and the clock offset."""

import math
from bisect import bisect_left, bisect_right
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from time import monotonic
from typing import Protocol

import numpy as np

from probedesign.core.errors import InputError
from probedesign.core.frames import Array, inverse, pose
from probedesign.live import Log
from probedesign.live.blocks import Block

MAX_NORM_ERROR = 1e-3  #: Maximum deviation of a quaternion's norm from 1: it may have been printed with four digits.
MAX_DISTANCE = 100.0  #: Maximum distance of the base from the world origin [m]; a larger value indicates a wrong unit.
MAX_TIME = 1e11  #: Maximum time stamp [s], as for recordings; a larger value is not in seconds.


@dataclass(frozen=True)
class TimedPose:
    """Pose of the base at one time."""

    time: float  #: time by any clock [s].
    p: tuple[float, ...]  #: origin of the base in the world [m], three numbers.
    q: tuple[float, ...]  #: orientation as a quaternion x, y, z, w, as received.
    probe: str = ""  #: name of the probe in a run with several; otherwise empty.


def timed_pose(time: float, p: Sequence[float], q: Sequence[float]) -> TimedPose:
    """Return the validated pose.

    Raises:
        InputError: the numbers cannot be a pose of the base.
    """
    if not abs(time) <= MAX_TIME:
        raise InputError(f"its time {time:g} s is out of range")
    if not all(abs(value) <= MAX_DISTANCE for value in p):
        values = ", ".join(f"{value:g}" for value in p)
        raise InputError(f"its position ({values}) m is farther than {MAX_DISTANCE:g} m")
    if not abs(math.hypot(*q) - 1.0) <= MAX_NORM_ERROR:
        values = ", ".join(f"{value:g}" for value in q)
        raise InputError(f"its quaternion ({values}) is not a rotation; x, y, z, w must have norm 1")
    return TimedPose(float(time), tuple(map(float, p)), tuple(map(float, q)))


def interpolate_pose(a: TimedPose, b: TimedPose, time: float) -> Array:
    """Return T_world_base (4, 4) between two poses: linear in the origin, spherical linear in the orientation.

    In plain Python, since it runs for every batch of readings: `scipy.spatial.transform` takes seven times as long
    for a single pose.
    """
    fraction = (time - a.time) / (b.time - a.time)
    q, r = _normalized(a.q), _normalized(b.q)
    cosine = sum(x * y for x, y in zip(q, r, strict=True))
    if cosine < 0.0:
        r, cosine = tuple(-x for x in r), -cosine
    angle = math.acos(min(cosine, 1.0))
    if angle < 1e-6:  # linear weights are exact to 1e-12 for so small an angle
        weights = (1.0 - fraction, fraction)
    else:
        weights = (math.sin((1.0 - fraction) * angle), math.sin(fraction * angle))
    turned = tuple(weights[0] * x + weights[1] * y for x, y in zip(q, r, strict=True))
    p = [(1.0 - fraction) * x + fraction * y for x, y in zip(a.p, b.p, strict=True)]
    return pose(_rotation(_normalized(turned)), p)


def pose_matrix(a: TimedPose) -> Array:
    """Return T_world_base of a pose, (4, 4)."""
    return pose(_rotation(_normalized(a.q)), a.p)


def _normalized(q: tuple[float, ...]) -> tuple[float, ...]:
    length = math.hypot(*q)
    return tuple(x / length for x in q)


def _rotation(q: tuple[float, ...]) -> Array:
    x, y, z, w = q
    return np.array(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)],
            [2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)],
            [2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)],
        ]
    )


def pose_from_matrix(time: float, T: Array) -> TimedPose:
    """Return the pose at a time [s] of a rigid transform (4, 4)."""
    from scipy.spatial.transform import Rotation  # a third of a second to import; a live run needs none

    q = Rotation.from_matrix(T[:3, :3]).as_quat()
    return TimedPose(time, tuple(T[:3, 3].tolist()), tuple(q.tolist()))


#: Maximum interval between poses that are interpolated [s]: a base that accelerates at 1 m/s² deviates from the
#: straight line by 0.3 mm in it. Robots publish at 100 Hz and more.
MAX_GAP = 0.050
#: Where poses are slower than that: the largest interval in usual ones and in seconds, and the largest deviation from
#: the straight line [m]. A base that starts or stops within the interval deviates by a quarter of its travel.
MAX_PERIODS, MAX_SLOW_GAP, MAX_DEVIATION = 2.5, 0.25, 0.5e-3
LEVER = 0.1  #: Lever arm that converts a rotation of the base to a distance [m], as in the tracker.
MIN_INTERVALS = 5  #: Number of intervals whose median is the usual one, at least.
MAX_POSES = 20_000  #: Maximum number of poses kept of a stream: 20 s of a fast one.


@dataclass
class PoseTrack:
    """Poses of the base by one clock, with interpolation between them; never extrapolated."""

    #: maximum interval between neighbours that are interpolated [s]; None: `MAX_GAP`, and more for slower poses as far
    #: as their speed allows it.
    max_gap: float | None = None
    max_poses: float = math.inf  #: maximum number of poses that are kept.
    _poses: list[TimedPose] = field(default_factory=list, repr=False)
    _times: list[float] = field(default_factory=list, repr=False)

    @classmethod
    def of(cls, poses: Iterable[TimedPose], max_gap: float | None = None) -> "PoseTrack":
        """Return the track of the poses; a pose that is not later than the one before is dropped."""
        track = cls(max_gap)
        for each in poses:
            track.add(each)
        return track

    def add(self, pose: TimedPose) -> bool:
        """Append a pose unless it is not later than the last; return whether it was appended."""
        if self._times and not pose.time > self._times[-1]:
            return False
        self._poses.append(pose)
        self._times.append(pose.time)
        if len(self._times) > 2 * self.max_poses:
            del self._poses[: -int(self.max_poses)], self._times[: -int(self.max_poses)]
        return True

    def __len__(self) -> int:
        return len(self._times)

    def spanning(self, start: float, end: float) -> list[TimedPose]:
        """Return the poses from the last at or before `start` to the first at or after `end` [s]."""
        first = max(bisect_right(self._times, start) - 1, 0)
        return self._poses[first : bisect_left(self._times, end) + 1]

    @property
    def times(self) -> list[float]:
        """Times of all poses [s]."""
        return self._times

    @property
    def end(self) -> float:
        """Time of the last pose [s]; minus infinity without any."""
        return self._times[-1] if self._times else -math.inf

    def at(self, time: float) -> Array | None:
        """Return T_world_base (4, 4) at a time [s]; None unless two neighbours within the maximum gap enclose it."""
        i = bisect_left(self._times, time)
        if i < len(self._times) and self._times[i] == time:
            return pose_matrix(self._poses[i])
        if i in (0, len(self._times)) or not self._bridged(i):
            return None
        return interpolate_pose(self._poses[i - 1], self._poses[i], time)

    def usual(self, i: int) -> float:
        """Return the usual interval of the poses up to one [s], as later ones are unknown; 0 if there are too few."""
        near = self._times[max(i - 2 * MIN_INTERVALS, 0) : i + 1]
        return float(np.median(np.diff(near))) if len(near) > MIN_INTERVALS else 0.0

    def _bridged(self, i: int) -> bool:
        gap = self._times[i] - self._times[i - 1]
        if self.max_gap is not None or gap <= MAX_GAP:
            return gap <= (self.max_gap or MAX_GAP)
        a, b = self._poses[i - 1], self._poses[i]
        cosine = abs(sum(x * y for x, y in zip(_normalized(a.q), _normalized(b.q), strict=True)))
        travel = math.dist(a.p, b.p) + LEVER * 2.0 * math.acos(min(cosine, 1.0))
        return gap <= min(MAX_PERIODS * self.usual(i), MAX_SLOW_GAP) and 0.25 * travel <= MAX_DEVIATION

    def reason(self, time: float) -> str:
        """Return why there is no pose at a time."""
        i = bisect_left(self._times, time)
        if not self._times:
            return "no pose has been received yet"
        if i == 0:
            return f"the first pose is {self._times[0] - time:.3g} s later"
        if i == len(self._times):
            return f"the last pose is {time - self._times[-1]:.3g} s older"
        gap = self._times[i] - self._times[i - 1]
        limit = f"{MAX_GAP:g} s at this speed" if self.max_gap is None else f"{self.max_gap:g} s"
        return f"the neighbouring poses are {gap:.3g} s apart, more than {limit}"


class TransformTree:
    """Tree of coordinate frames as published by TF; each edge is static or time-stamped."""

    def __init__(self) -> None:
        self._parent: dict[str, str] = {}
        self._static: dict[str, Array] = {}
        self._moving: dict[str, PoseTrack] = {}

    def add(self, parent: str, child: str, pose: TimedPose, static: bool) -> None:
        """Add the pose of a child in its parent.

        Raises:
            InputError: the child has another parent already.
        """
        if self._parent.setdefault(child, parent) != parent:
            raise InputError(f"frame {child[:40]!r} has two parents, {self._parent[child][:40]!r} and {parent[:40]!r}")
        if static:
            self._static[child] = pose_matrix(pose)
        else:
            self._moving.setdefault(child, PoseTrack()).add(pose)

    def poses(self, world: str, base: str) -> list[TimedPose]:
        """Return the poses of `base` in `world`, at every time stamp of a moving edge between them.

        Raises:
            InputError: the frames are not connected, or no edge between them moves.
        """
        to_world_path, to_base_path = self._to_root(world), self._to_root(base)
        shared = next((frame for frame in to_base_path if frame in to_world_path), None)
        if shared is None:
            known = ", ".join(sorted({*self._parent, *self._parent.values()}))[:200] or "none"
            raise InputError(f"TF does not connect {world!r} and {base!r}; frames: {known}")
        to_world_path = to_world_path[: to_world_path.index(shared)]
        to_base_path = to_base_path[: to_base_path.index(shared)]
        moving = [self._moving[child] for child in (*to_world_path, *to_base_path) if child in self._moving]
        times = {time for track in moving for time in track.times}
        poses = []
        for time in sorted(times):
            to_world, to_base = self._compose(to_world_path, time), self._compose(to_base_path, time)
            if to_world is not None and to_base is not None:
                poses.append(pose_from_matrix(time, inverse(to_world) @ to_base))
        if not poses:
            raise InputError(f"TF has no pose of {base!r} in {world!r} at any time; are all transforms static?")
        return poses

    def _to_root(self, frame: str) -> list[str]:
        chain = [frame]
        while (parent := self._parent.get(chain[-1])) is not None and parent not in chain:
            chain.append(parent)
        return chain

    def _compose(self, children: list[str], time: float) -> Array | None:
        """Return T from the first child to the parent of the last, (4, 4); None if an edge is unknown at this time."""
        T: Array | None = pose_matrix(TimedPose(time, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)))
        for child in children:
            edge = self._static.get(child)
            edge = self._moving[child].at(time) if edge is None else edge
            if edge is None or T is None:
                return None
            T = edge @ T
        return T


#: Interval in which the minimum delay is taken [s]: clocks that differ by 50 ppm drift by 0.5 ms in it.
OFFSET_WINDOW = 10


class ClockOffset:
    """Offset between two clocks: the minimum of arrival time minus time stamp over the last seconds.

    The minimum belongs to a message that was not queued anywhere.
    """

    def __init__(self) -> None:
        self._minima: dict[int, float] = {}

    def add(self, stamp: float, arrival: float) -> float:
        """Add one message by both clocks [s]; return the current offset [s]."""
        second = math.floor(arrival)
        if second not in self._minima:
            for old in [s for s in self._minima if not second - OFFSET_WINDOW < s <= second]:
                del self._minima[old]
        self._minima[second] = min(self._minima.get(second, math.inf), arrival - stamp)
        return min(self._minima.values())

    @property
    def value(self) -> float:
        """Current offset [s]."""
        return min(self._minima.values())


class PoseStream(Protocol):
    """Poses of the base that arrive during the run, by the robot's clock."""

    title: str  #: one line that describes the poses.
    notes: tuple[str, ...]  #: notes for the user, one line each.

    def pop(self) -> list[tuple[float, TimedPose, int]]:
        """Return arrival by `time.monotonic` [s], pose by its sender's clock and session of the sender since then."""

    def pop_messages(self) -> list[str]:
        """Return the messages to the user since the last call."""

    def close(self) -> None:
        """End the stream."""

    @property
    def summary(self) -> str:
        """The counts in one line."""


LAG_POSES = 64  #: Number of poses whose median delay is compared with their period.
POSE_WAIT = 2.0  #: Maximum wait of an estimate for the next pose, in units of the maximum gap.
GRAVITY_WORLD = (0.0, 0.0, -9.81)  #: Gravity in a world whose z axis points up [m/s²].


class BasePoses:
    """Pose of the base at any time that is enclosed by poses.

    Poses of a file or a bag are by the wrench's clock already. Poses of a listener are by the robot's clock: both
    clocks are related to this machine's by the minimum delay of their messages.

    Attributes:
        gravity_world: gravity vector in the world [m/s²], (3,).
        latency: delay of a pose's time stamp relative to a reading of the same instant [s].
        track: the poses by the wrench's clock, corrected for latency.
        on_pose: callback for each pose, once and in order, as the readings reach it, for recordings.
    """

    def __init__(
        self,
        title: str,
        poses: list[TimedPose] | PoseStream,
        *,
        latency: float = 0.0,
        max_gap: float | None = None,
        gravity_world: Array | None = None,
        notes: tuple[str, ...] = (),
        log: Log = lambda line: None,
    ) -> None:
        """Start with all poses by the wrench's clock, or with a listener that receives them.

        `max_gap` [s] is that of `PoseTrack`; gravity is 9.81 m/s² along -z if it is None.
        """
        self.title, self.notes, self.latency = title, notes, latency
        self.gravity_world = np.array(GRAVITY_WORLD if gravity_world is None else gravity_world, dtype=float)
        self._log = log
        self._listener = None if isinstance(poses, list) else poses
        self.track = PoseTrack(max_gap, math.inf if self._listener is None else MAX_POSES)
        for each in poses if isinstance(poses, list) else ():
            self.track.add(self._delayed(each, -latency))
        self._wrench, self._robot = ClockOffset(), ClockOffset()
        self._session = 0
        self._delays, self._lag_reported = deque[float](maxlen=LAG_POSES), False
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
        for base_pose in self.track.spanning(self._since, math.inf if self._listener else float(block.time[-1])):
            if base_pose.time > self._reported:
                self._reported, self._since = base_pose.time, max(base_pose.time, self._since)
                self.on_pose(base_pose)

    def _receive(self, listener: PoseStream, block: Block) -> None:
        for line in listener.pop_messages():
            self._log(line)
        now = monotonic()
        for time, received in zip(block.time.tolist(), block.received.tolist(), strict=True):
            self._wrench.add(time, received if math.isfinite(received) else now)
        for arrival, base_pose, session in listener.pop():
            if session != self._session:
                self._session, self._robot = session, ClockOffset()
            ahead = self._robot.add(base_pose.time, arrival) - self._wrench.value
            late = arrival - base_pose.time - self._robot.value + self.latency
            self._delays.append(late)
            usual = self.track.usual(len(self.track))
            if not self._lag_reported and len(self._delays) == LAG_POSES and 0.0 < usual < np.median(self._delays):
                self._lag_reported = True
                self._log(f"poses: they are {1e3 * float(np.median(self._delays)):.0f} ms late, more than their own "
                          f"period of {1e3 * usual:.0f} ms, and each estimate waits as long; stamp them where they are "
                          "measured, and send each at once")  # fmt: skip
            self.track.add(self._delayed(base_pose, ahead - self.latency))

    def at(self, time: float) -> Array | None:
        """Return T_world_base (4, 4) at a time [s]; None if no reliable pose is known."""
        if time != self._cached[0] or self._cached[1] is None:  # a batch needs the same pose several times
            self._cached = (time, self.track.at(time))
        return self._cached[1]

    def may_arrive(self, time: float, newest: float) -> bool:
        """Return whether the pose after a time may still arrive, with the newest reading at `newest` [s]."""
        if self._listener is None or self.track.end >= time:
            return False
        if self.track.max_gap is not None:
            return newest - time < POSE_WAIT * self.track.max_gap
        usual = self.track.usual(len(self.track))
        return newest - time < max(POSE_WAIT * MAX_GAP, MAX_PERIODS * min(usual, MAX_SLOW_GAP))

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
