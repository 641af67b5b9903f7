"""Time-stamped poses: validation, interpolation, the TF tree, and the offset between two clocks."""

import math
from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from probedesign.core.errors import InputError
from probedesign.core.frames import Array, inverse, pose

MAX_NORM_ERROR = 1e-3  #: Maximum deviation of a quaternion's norm from 1: it may have been printed with four digits.
MAX_DISTANCE = 100.0  #: Maximum distance of the base from the world origin [m]; a larger value indicates a wrong unit.
MAX_TIME = 1e11  #: Maximum time stamp [s], as for recordings; a larger value is not in seconds.


@dataclass(frozen=True)
class TimedPose:
    """Pose of the base at one time."""

    time: float  #: time by any clock [s].
    p: tuple[float, ...]  #: origin of the base in the world [m], three numbers.
    q: tuple[float, ...]  #: orientation as a quaternion x, y, z, w, as received.


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
MAX_POSES = 20_000  #: Maximum number of poses kept of a stream: 20 s of a fast one.


@dataclass
class PoseTrack:
    """Poses of the base by one clock, with interpolation between them; never extrapolated."""

    max_gap: float = MAX_GAP  #: maximum interval between neighbours that are interpolated [s].
    max_poses: float = math.inf  #: maximum number of poses that are kept.
    _poses: list[TimedPose] = field(default_factory=list, repr=False)
    _times: list[float] = field(default_factory=list, repr=False)

    @classmethod
    def of(cls, poses: Iterable[TimedPose], max_gap: float = MAX_GAP) -> "PoseTrack":
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
        if i in (0, len(self._times)) or self._times[i] - self._times[i - 1] > self.max_gap:
            return None
        return interpolate_pose(self._poses[i - 1], self._poses[i], time)

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
        return f"the neighbouring poses are {gap:.3g} s apart, more than {self.max_gap:g} s"


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
        found = []
        for time in sorted(times):
            to_world, to_base = self._compose(to_world_path, time), self._compose(to_base_path, time)
            if to_world is not None and to_base is not None:
                found.append(pose_from_matrix(time, inverse(to_world) @ to_base))
        if not found:
            raise InputError(f"TF has no pose of {base!r} in {world!r} at any time; are all transforms static?")
        return found

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
