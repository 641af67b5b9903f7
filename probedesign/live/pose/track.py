"""Poses one after the other, and the pose at any moment between them; never one beyond."""

import math
from bisect import bisect_left, bisect_right
from collections.abc import Iterable
from dataclasses import dataclass, field

from probedesign.frames import Array
from probedesign.live.pose.timed import TimedPose, between, matrix

LIMIT = 0.050
"""Neighbours further apart than this are not interpolated between [s]: a base that speeds up by 1 m/s² leaves the
straight line by 0.3 mm in so long. Robots tell 100 poses a second and more."""
MOST = 20_000
"""Poses of a stream that are kept: twenty seconds of a fast one."""


@dataclass
class Track:
    """Where the base was, by one clock.

    Attributes:
        limit: of the time between neighbours [s].
        most: that are kept.
    """

    limit: float = LIMIT
    most: float = math.inf
    _poses: list[TimedPose] = field(default_factory=list, repr=False)
    _times: list[float] = field(default_factory=list, repr=False)

    @classmethod
    def of(cls, poses: Iterable[TimedPose], limit: float = LIMIT) -> "Track":
        """All of them that are later than those before."""
        track = cls(limit)
        for pose in poses:
            track.add(pose)
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
