"""Whether the stated latency of the poses is true: a press that begins or stops must show in both at once.

While the probe touches, its wrench follows the base. Over one touch, the base's way along its main direction and the
wrench along its own are laid over each other with one of them shifted in time; the shift at which a parabola of the
way explains the wrench best is the latency that is left. The probe is taken to follow at once; a soft one that creeps
looks like poses that come early.
"""

import math
from collections import deque
from dataclasses import dataclass, field

import numpy as np

from probedesign.frames import Array

REACH = 0.200
"""Shifts that are tried, either way [s]."""
STEP = 0.004
"""Between them [s]."""
TOLD = 0.010
"""Less than this is not told [s]: at 10 mm/s it is a tenth of a millimetre, what a tracker's node may hold."""
SURE = 25.0
"""By so much χ² must the shift explain the readings better than none: five standard deviations."""
LEAST = 0.2
"""Of what is told, which the shift must be known to."""
WAY = 0.5e-3
"""A base that went less far [m] tells nothing."""
GAP = 0.1
"""Between readings of a touch that is looked at [s]."""
FEWEST = 20
"""Readings within the reach of all shifts."""
SPAN = 4.0
"""Of one touch, the last so many seconds are looked at."""
MOST = 800
"""Readings that are looked at, at most: `SPAN` at 7000/36 a second."""


@dataclass
class Timing:
    """Gathers one touch.

    Attributes:
        whiten: of one reading, (6, 6).
    """

    whiten: Array
    _seen: deque[tuple[float, Array, Array]] = field(default_factory=lambda: deque(maxlen=MOST))

    def see(self, time: float, p_world_base: Array, wrench: Array) -> None:
        """Take in a reading of the touch [s, m, N and N·m]; before a gap there may have been another."""
        if self._seen and time - self._seen[-1][0] > GAP:
            self.forget()
        self._seen.append((time, p_world_base, self.whiten @ wrench))
        while time - self._seen[0][0] > SPAN:
            self._seen.popleft()

    def forget(self) -> None:
        """The touch is over."""
        self._seen.clear()

    def late(self) -> float:
        """How much later the poses are than they were said to be [s]; NaN if the touch does not tell."""
        if len(self._seen) < FEWEST:
            return math.nan
        time = np.array([t for t, _, _ in self._seen])
        way = _along(np.array([p for _, p, _ in self._seen]))
        wrench = _along(np.array([w for _, _, w in self._seen]))
        inside = (time >= time[0] + REACH) & (time <= time[-1] - REACH)
        if inside.sum() < FEWEST or np.ptp(way[inside]) < WAY:
            return math.nan
        shifts = np.arange(-REACH, REACH + 0.5 * STEP, STEP)
        left = np.array([_left(np.interp(time[inside] + s, time, way), wrench[inside]) for s in shifts])
        i = int(np.argmin(left))
        noise = max(1.0, left[i] / (inside.sum() - 4))
        now = left[len(shifts) // 2]
        if now - left[i] < SURE * noise:
            return 0.0
        if i in (0, len(shifts) - 1):
            return math.nan
        before, here, after = left[i - 1 : i + 2]
        bend = before - 2.0 * here + after
        late = float(shifts[i] + 0.5 * STEP * (before - after) / bend)
        std = STEP * math.sqrt(2.0 * noise / bend)  # where χ² is up by one
        return late if std < LEAST * TOLD else math.nan


def _along(rows: Array) -> Array:
    """Rows (n, k) along their main direction, (n,)."""
    off = rows - rows.mean(axis=0)
    return np.asarray(off @ np.linalg.svd(off, full_matrices=False)[2][0], dtype=float)


def _left(way: Array, wrench: Array) -> float:
    """Squares that a parabola of the way leaves of the wrench."""
    columns = np.stack([np.ones_like(way), way, way * way], axis=1)
    return float(np.sum((wrench - columns @ np.linalg.lstsq(columns, wrench)[0]) ** 2))
