"""Checks the stated latency of the poses: a press that starts or stops must show in pose and wrench at once.

While the probe touches, its wrench follows the base. For one touch, the base's travel along its principal direction
and the wrench along its own are compared with a time shift; the shift at which a parabola of the travel fits the wrench
best is the remaining latency. The probe is assumed to follow without delay; a soft probe that creeps looks like poses
that are early.
"""

import math
from collections import deque
from dataclasses import dataclass, field

import numpy as np

from probedesign.core.frames import Array

MAX_SHIFT = 0.200
"""Maximum shift that is tested, in both directions [s]."""
STEP = 0.004
"""Step between shifts [s]."""
MIN_REPORTED = 0.010
"""Minimum latency that is reported [s]: at 10 mm/s it is 0.1 mm, the tolerance of a tracker's keyframe."""
MIN_CHI2_GAIN = 25.0
"""Minimum decrease of χ² by the shift: five standard deviations."""
MAX_STD_SHARE = 0.2
"""Maximum standard deviation of the shift, as a fraction of `MIN_REPORTED`."""
MIN_TRAVEL = 0.5e-3
"""Minimum travel of the base [m]."""
GAP = 0.1
"""Maximum interval between readings of a touch [s]."""
MIN_READINGS = 20
"""Minimum number of readings within the range of all shifts."""
SPAN = 4.0
"""Length of the last part of a touch that is used [s]."""
MAX_READINGS = 800
"""Maximum number of readings: `SPAN` at 7000/36 readings per second."""


@dataclass
class LatencyCheck:
    """Collects the readings of one touch and estimates the latency of its poses.

    Attributes:
        whiten: whitening matrix of one reading, (6, 6).
    """

    whiten: Array
    _readings: deque[tuple[float, Array, Array]] = field(default_factory=lambda: deque(maxlen=MAX_READINGS))

    def add(self, time: float, p_world_base: Array, wrench: Array) -> None:
        """Add a reading of the touch [s, m, N and N·m]; a gap starts another touch."""
        if self._readings and time - self._readings[-1][0] > GAP:
            self.reset()
        self._readings.append((time, p_world_base, self.whiten @ wrench))
        while time - self._readings[0][0] > SPAN:
            self._readings.popleft()

    def reset(self) -> None:
        """Discard the readings: the touch is over."""
        self._readings.clear()

    def delay(self) -> float:
        """Return by how much the poses are later than stated [s]; NaN if the touch does not determine it."""
        if len(self._readings) < MIN_READINGS:
            return math.nan
        time = np.array([t for t, _, _ in self._readings])
        travel = _principal_component(np.array([p for _, p, _ in self._readings]))
        wrench = _principal_component(np.array([w for _, _, w in self._readings]))
        inside = (time >= time[0] + MAX_SHIFT) & (time <= time[-1] - MAX_SHIFT)
        if inside.sum() < MIN_READINGS or np.ptp(travel[inside]) < MIN_TRAVEL:
            return math.nan
        shifts = np.arange(-MAX_SHIFT, MAX_SHIFT + 0.5 * STEP, STEP)
        residuals = np.array(
            [_residual(np.interp(time[inside] + s, time, travel), wrench[inside]) for s in shifts]
        )
        i = int(np.argmin(residuals))
        noise = max(1.0, residuals[i] / (inside.sum() - 4))
        unshifted = residuals[len(shifts) // 2]
        if unshifted - residuals[i] < MIN_CHI2_GAIN * noise:
            return 0.0
        if i in (0, len(shifts) - 1):
            return math.nan
        before, here, after = residuals[i - 1 : i + 2]
        bend = before - 2.0 * here + after
        delay = float(shifts[i] + 0.5 * STEP * (before - after) / bend)
        std = STEP * math.sqrt(2.0 * noise / bend)  # where χ² increases by one
        return delay if std < MAX_STD_SHARE * MIN_REPORTED else math.nan


def _principal_component(rows: Array) -> Array:
    """Return the rows (n, k) along their principal direction, (n,)."""
    centred = rows - rows.mean(axis=0)
    return np.asarray(centred @ np.linalg.svd(centred, full_matrices=False)[2][0], dtype=float)


def _residual(travel: Array, wrench: Array) -> float:
    """Return the sum of squares of the wrench after fitting a parabola of the travel."""
    columns = np.stack([np.ones_like(travel), travel, travel * travel], axis=1)
    return float(np.sum((wrench - columns @ np.linalg.lstsq(columns, wrench)[0]) ** 2))
