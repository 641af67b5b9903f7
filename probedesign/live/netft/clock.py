"""The sensor's own clock: time from a counter of 32 bits that wraps, stands still or starts again."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from probedesign.frames import Array
from probedesign.live.netft.wire import SAMPLES_PER_SECOND

WRAP = 1 << 32
AHEAD = 10.0
"""A counter that runs this far ahead of the host's clock is another counter [s]: buffers hold less, suspended
programs find no old records."""


class Times(NamedTuple):
    """What the clock says of n records.

    Attributes:
        new: which of them are not the sample before once more, (n,).
        time: of the k that are new [s], (k,).
        restarted: before which of the new the counter started again, (k,).
    """

    new: NDArray[np.bool_]
    time: Array
    restarted: NDArray[np.bool_]


def steps(values: NDArray[Any], before: float) -> NDArray[Any]:
    """From each value to the next, the first from the one before, (n,): as `np.diff`, which takes four times as long
    for the few values that come at once."""
    found = np.empty_like(values)
    found[:1] = values[:1] - before
    np.subtract(values[1:], values[:-1], out=found[1:])
    return found


class SensorClock:
    """Seconds since the first record by `ft_sequence`, never backward.

    Attributes:
        restarts: how often the counter started again; the host's clock bridges the time between.
    """

    def __init__(self) -> None:
        """A clock that has seen nothing."""
        self.restarts = 0
        self._last: tuple[int, float] | None = None
        self._ticks = 0

    def times(self, ft_sequence: NDArray[np.int64], received: Array) -> Times:
        """Time of records that came one after the other.

        Args:
            ft_sequence: of each, (n,).
            received: when, by the host's clock [s], (n,).
        """
        new = np.ones(len(ft_sequence), dtype=bool)
        new[1:] = np.diff(ft_sequence) != 0
        if self._last is not None and len(new):
            new[0] = ft_sequence[0] != self._last[0]
        ft, received = ft_sequence[new], received[new]
        if not len(ft):
            return Times(new, np.empty(0), np.empty(0, dtype=bool))
        before = self._last or (int(ft[0]), float(received[0]))
        ticks = steps(ft, before[0]) % WRAP
        elapsed = np.maximum(steps(received, before[1]), 0.0)
        restarted = ticks / SAMPLES_PER_SECOND > elapsed + AHEAD
        bridged = np.maximum(np.rint(elapsed * SAMPLES_PER_SECOND), 1.0).astype(np.int64)
        counted = self._ticks + np.cumsum(np.where(restarted, bridged, ticks))
        self.restarts += int(restarted.sum())
        self._last, self._ticks = (int(ft[-1]), float(received[-1])), int(counted[-1])
        return Times(new, counted / SAMPLES_PER_SECOND, restarted)
