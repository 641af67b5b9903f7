"""One pose of the base at one moment, and what lies between two of them."""

import math
from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from probedesign.errors import InputError
from probedesign.frames import Array, inverse, pose

UNIT = 1e-3
"""How far from one the length of a rotation's quaternion may be: it may have been printed with four digits."""
FURTHEST = 100.0
"""No base is further from its world's origin [m]: it is a wrong unit."""
LATEST = 1e11
"""No clock tells more [s], as for recordings: it counts something else than seconds."""


@dataclass(frozen=True)
class TimedPose:
    """Where the base was.

    Attributes:
        time: [s], of whatever clock.
        p: the base's origin in the world [m], three numbers.
        q: its rotation, a quaternion x, y, z, w as it was told.
    """

    time: float
    p: tuple[float, ...]
    q: tuple[float, ...]


def timed_pose(time: float, p: Sequence[float], q: Sequence[float]) -> TimedPose:
    """The pose of these numbers.

    Raises:
        InputError: they are none that a base can have.
    """
    if not abs(time) <= LATEST:
        raise InputError(f"its time {time:g} s is none")
    if not all(abs(value) <= FURTHEST for value in p):
        told = ", ".join(f"{value:g}" for value in p)
        raise InputError(f"its place ({told}) m is none within {FURTHEST:g} m")
    if not abs(math.hypot(*q) - 1.0) <= UNIT:
        told = ", ".join(f"{value:g}" for value in q)
        raise InputError(f"its quaternion ({told}) is no rotation; x, y, z, w have length 1")
    return TimedPose(float(time), tuple(map(float, p)), tuple(map(float, q)))


def between(a: TimedPose, b: TimedPose, time: float) -> Array:
    """T_world_base (4, 4) at a time between two poses: the origin along the line, the rotation along the great
    circle, the shorter way round."""
    share = (time - a.time) / (b.time - a.time)
    q, r = _normalized(a.q), _normalized(b.q)
    cosine = sum(x * y for x, y in zip(q, r, strict=True))
    if cosine < 0.0:
        r, cosine = tuple(-x for x in r), -cosine
    angle = math.acos(min(cosine, 1.0))
    if angle < 1e-6:  # the circle is its chord, to 1e-12
        weights = (1.0 - share, share)
    else:
        weights = (math.sin((1.0 - share) * angle), math.sin(share * angle))
    turned = tuple(weights[0] * x + weights[1] * y for x, y in zip(q, r, strict=True))
    p = [(1.0 - share) * x + share * y for x, y in zip(a.p, b.p, strict=True)]
    return pose(_rotation(_normalized(turned)), p)


def matrix(a: TimedPose) -> Array:
    """T_world_base of it, (4, 4)."""
    return pose(_rotation(_normalized(a.q)), a.p)


def _normalized(q: tuple[float, ...]) -> tuple[float, ...]:
    length = math.hypot(*q)
    return tuple(x / length for x in q)


def _rotation(q: tuple[float, ...]) -> Array:
    x, y, z, w = q
    return np.array([
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)],
        [2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)],
        [2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)],
    ])  # fmt: skip


def of_matrix(time: float, T: Array) -> TimedPose:
    """The pose at a time [s] of a rigid transform (4, 4); its quaternion by the largest of the four numbers."""
    R = T[:3, :3]
    x, y, z = np.diag(R)
    squares = np.array([1.0 + x - y - z, 1.0 - x + y - z, 1.0 - x - y + z, 1.0 + x + y + z])
    i = int(np.argmax(squares))
    four = np.array([
        [squares[0], R[0, 1] + R[1, 0], R[0, 2] + R[2, 0], R[2, 1] - R[1, 2]],
        [R[0, 1] + R[1, 0], squares[1], R[1, 2] + R[2, 1], R[0, 2] - R[2, 0]],
        [R[0, 2] + R[2, 0], R[1, 2] + R[2, 1], squares[2], R[1, 0] - R[0, 1]],
        [R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1], squares[3]],
    ])  # fmt: skip
    q = four[i] / (2.0 * math.sqrt(squares[i]))
    return TimedPose(time, tuple(T[:3, 3].tolist()), tuple(q.tolist()))


MAX_GAP = 0.050
"""Neighbours further apart than this are not interpolated between [s]: a base that speeds up by 1 m/s² leaves the
straight line by 0.3 mm in so long. Robots tell 100 poses a second and more."""
MAX_POSES = 20_000
"""Poses of a stream that are kept: twenty seconds of a fast one."""


@dataclass
class Track:
    """Where the base was, by one clock.

    Attributes:
        limit: of the time between neighbours [s].
        most: that are kept.
    """

    limit: float = MAX_GAP
    most: float = math.inf
    _poses: list[TimedPose] = field(default_factory=list, repr=False)
    _times: list[float] = field(default_factory=list, repr=False)

    @classmethod
    def of(cls, poses: Iterable[TimedPose], limit: float = MAX_GAP) -> "Track":
        """All of them that are later than those before."""
        track = cls(limit)
        for each in poses:
            track.add(each)
        return track

    def add(self, pose: TimedPose) -> bool:
        """Take in the next; one that is not later than the last is left out. Whether it was taken."""
        if self._times and not pose.time > self._times[-1]:
            return False
        self._poses.append(pose)
        self._times.append(pose.time)
        if len(self._times) > 2 * self.most:
            del self._poses[: -int(self.most)], self._times[: -int(self.most)]
        return True

    def __len__(self) -> int:
        return len(self._times)

    def around(self, start: float, end: float) -> list[TimedPose]:
        """Poses from the last that is not after `start` to the first that is not before `end` [s]."""
        first = max(bisect_right(self._times, start) - 1, 0)
        return self._poses[first : bisect_left(self._times, end) + 1]

    @property
    def times(self) -> list[float]:
        """Of all poses [s]."""
        return self._times

    @property
    def end(self) -> float:
        """Time of the last [s]; minus infinity without any."""
        return self._times[-1] if self._times else -math.inf

    def at(self, time: float) -> Array | None:
        """T_world_base (4, 4) at a time [s]; None where no two neighbours within the limit lie around it."""
        i = bisect_left(self._times, time)
        if i < len(self._times) and self._times[i] == time:
            return matrix(self._poses[i])
        if i in (0, len(self._times)) or self._times[i] - self._times[i - 1] > self.limit:
            return None
        return between(self._poses[i - 1], self._poses[i], time)

    def why(self, time: float) -> str:
        """Why there is no pose at a time, in words."""
        i = bisect_left(self._times, time)
        if not self._times:
            return "there is none yet"
        if i == 0:
            return f"the first is {self._times[0] - time:.3g} s later"
        if i == len(self._times):
            return f"the last is {time - self._times[-1]:.3g} s older"
        gap = self._times[i] - self._times[i - 1]
        return f"its neighbours are {gap:.3g} s apart, more than {self.limit:g} s"


class Tree:
    """Edges from parent to child, each still or with its own stamps."""

    def __init__(self) -> None:
        self._parent: dict[str, str] = {}
        self._still: dict[str, Array] = {}
        self._moving: dict[str, Track] = {}

    def add(self, parent: str, child: str, pose: TimedPose, still: bool) -> None:
        """Take in where a child is in its parent.

        Raises:
            InputError: the child hangs on another parent already.
        """
        if self._parent.setdefault(child, parent) != parent:
            raise InputError(
                f"frame {child[:40]!r} hangs on {self._parent[child][:40]!r} and on {parent[:40]!r}"
            )
        if still:
            self._still[child] = matrix(pose)
        else:
            self._moving.setdefault(child, Track()).add(pose)

    def poses(self, world: str, base: str) -> list[TimedPose]:
        """Where `base` is in `world`, at every stamp of an edge that moves between them.

        Raises:
            InputError: they do not hang together, or nothing between them moves.
        """
        up, down = self._to_root(world), self._to_root(base)
        shared = next((frame for frame in down if frame in up), None)
        if shared is None:
            known = ", ".join(sorted({*self._parent, *self._parent.values()}))[:200] or "none"
            raise InputError(f"TF does not join {world!r} and {base!r}; frames: {known}")
        up, down = up[: up.index(shared)], down[: down.index(shared)]
        times = {
            time for child in (*up, *down) if child in self._moving for time in self._moving[child].times
        }
        found = []
        for time in sorted(times):
            to_world, to_base = self._chained(up, time), self._chained(down, time)
            if to_world is not None and to_base is not None:
                found.append(of_matrix(time, inverse(to_world) @ to_base))
        if not found:
            raise InputError(f"TF never tells where {base!r} is in {world!r} at one time; is it all static?")
        return found

    def _to_root(self, frame: str) -> list[str]:
        """The frame, its parent, the parent's parent and so on."""
        chain = [frame]
        while (parent := self._parent.get(chain[-1])) is not None and parent not in chain:
            chain.append(parent)
        return chain

    def _chained(self, children: list[str], time: float) -> Array | None:
        """T from the first child to the parent of the last, (4, 4)."""
        T: Array | None = matrix(TimedPose(time, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)))
        for child in children:
            edge = self._still.get(child)
            edge = self._moving[child].at(time) if edge is None else edge
            if edge is None or T is None:
                return None
            T = edge @ T
        return T


KEPT = 10
"""Seconds over which the least delay is looked for: crystals that differ by 50 ppm part by half a millisecond."""


class Offset:
    """Least of arrival less stamp over the last seconds: of what came without waiting anywhere."""

    def __init__(self) -> None:
        self._least: dict[int, float] = {}

    def add(self, stamp: float, arrival: float) -> float:
        """Take in one, told by both clocks [s]; the offset as it is known now [s]."""
        second = math.floor(arrival)
        if second not in self._least:
            for old in [s for s in self._least if not second - KEPT < s <= second]:
                del self._least[old]
        self._least[second] = min(self._least.get(second, math.inf), arrival - stamp)
        return min(self._least.values())

    @property
    def known(self) -> bool:
        """Whether anything was taken in."""
        return bool(self._least)

    @property
    def value(self) -> float:
        """As it is known now [s]."""
        return min(self._least.values())
