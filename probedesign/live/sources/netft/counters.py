"""The counters of a stream: order and loss of its records, and time and rate by the samples of its sensor."""

from collections import Counter
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from probedesign.core.frames import Array
from probedesign.live.sources.netft.rdt import SAMPLES_PER_SECOND

WRAP = 1 << 32  #: Both counters have 32 bits.
MAX_TICKS = 1 << 30  #: Largest step of a counter that is surely forward; a larger one is examined.
MAX_MISSING = 4096  #: Maximum number of lost records that are remembered, to recognise them if they arrive late.


class SequenceMonitor:
    """Counts lost, late and doubled records by `rdt_sequence`, and selects those that are new.

    A record is late if it was counted as lost before, and doubled if it was not. A stream that is counted from one
    again, with samples that are newer, is another stream.
    """

    def __init__(self, counts: Counter[str]) -> None:
        """Start before the first record; `counts` is updated."""
        self._counts = counts
        self._last: tuple[int, int] | None = None
        self._missing: dict[int, None] = {}

    def restart(self) -> None:
        """Accept the next record, whatever its number."""
        self._last = None
        self._missing.clear()

    def accept(self, rdt: NDArray[np.int64], ft: NDArray[np.int64]) -> NDArray[np.bool_] | None:
        """Return which of n records are new by their numbers, (n,); None if all are.

        A sample that is repeated is not new.
        """
        if not len(rdt):
            return None
        last = self._last
        if last is not None and ascending(rdt, last[0], 1) and ascending(ft, last[1], MAX_TICKS):
            self._last = int(rdt[-1]), int(ft[-1])
            return None
        return np.array([self._is_new(*pair) for pair in zip(rdt.tolist(), ft.tolist(), strict=True)])

    def _is_new(self, rdt: int, ft: int) -> bool:
        if self._last is None:
            self._last = rdt, ft
            return True
        step, newer = _signed(rdt - self._last[0]), _signed(ft - self._last[1])
        if step <= 0 and newer <= 0:
            late = rdt in self._missing
            self._counts["late" if late else "doubled"] += 1
            if late:
                del self._missing[rdt]
                self._counts["lost"] -= 1
            return False
        if step > 1:
            self._counts["lost"] += step - 1
            for number in range(max(1, step - MAX_MISSING), step):
                self._missing[(self._last[0] + number) % WRAP] = None
            while len(self._missing) > MAX_MISSING:
                del self._missing[next(iter(self._missing))]
        self._last = rdt, ft
        return newer != 0


def _signed(difference: int) -> int:
    """Return the difference of two 32-bit counters, positive if the first is ahead."""
    return (difference + WRAP // 2) % WRAP - WRAP // 2


#: Maximum lead of the counter over the host's clock [s]; more indicates another counter. Buffers are shorter, and a
#: suspended program finds no old records.
MAX_LEAD = 10.0


class RecordTimes(NamedTuple):
    """Times of n records."""

    new: NDArray[np.bool_]  #: whether each record is a new sample, not a repeated one, (n,).
    time: Array  #: times of the k new samples [s], (k,).
    restarted: NDArray[np.bool_]  #: whether the counter restarted before each new sample, (k,).


def steps(values: NDArray[Any], before: float) -> NDArray[Any]:
    """Return the difference of each value to the one before, the first to `before`, (n,).

    As `np.diff`, which takes four times as long for few values.
    """
    differences = np.empty_like(values)
    differences[:1] = values[:1] - before
    np.subtract(values[1:], values[:-1], out=differences[1:])
    return differences


def ascending(values: NDArray[np.int64], before: float, largest: float) -> bool:
    """Return whether each of n numbers exceeds the one before it, the first `before`, by 1 to `largest`."""
    if not 0 < values[0] - before <= largest:
        return False
    differences = values[1:] - values[:-1]
    return not len(differences) or bool(differences.min() > 0 and differences.max() <= largest)


class SensorClock:
    """Time since the first record by `ft_sequence` [s], a 32-bit counter that overflows, stops or restarts.

    The time never decreases.

    Attributes:
        restarts: number of restarts of the counter; the host's clock covers the gaps.
    """

    def __init__(self, rate: float = SAMPLES_PER_SECOND) -> None:
        """Start before the first record; the counter advances by `rate` a second [Hz]."""
        self.restarts, self._rate = 0, rate
        self._last: tuple[int, float] | None = None
        self._ticks = 0

    def times(self, ft_sequence: NDArray[np.int64], received: Array) -> RecordTimes:
        """Return the times of consecutive records by sequence numbers and arrival by the host's clock [s], (n,)."""
        n = len(ft_sequence)
        new = np.ones(n, dtype=bool)
        if n and self._last is not None and ascending(ft_sequence, self._last[0], MAX_LEAD * self._rate):
            counted = ft_sequence + (self._ticks - self._last[0])
            self._last, self._ticks = (int(ft_sequence[-1]), float(received[-1])), int(counted[-1])
            return RecordTimes(new, counted / self._rate, np.zeros(n, dtype=bool))
        new[1:] = np.diff(ft_sequence) != 0
        if self._last is not None and len(new):
            new[0] = ft_sequence[0] != self._last[0]
        ft, received = ft_sequence[new], received[new]
        if not len(ft):
            return RecordTimes(new, np.empty(0), np.empty(0, dtype=bool))
        before = self._last or (int(ft[0]), float(received[0]))
        ticks = steps(ft, before[0]) % WRAP
        elapsed = np.maximum(steps(received, before[1]), 0.0)
        restarted = ticks / self._rate > elapsed + MAX_LEAD
        bridged = np.maximum(np.rint(elapsed * self._rate), 1.0).astype(np.int64)
        counted = self._ticks + np.cumsum(np.where(restarted, bridged, ticks))
        self.restarts += int(restarted.sum())
        self._last, self._ticks = (int(ft[-1]), float(received[-1])), int(counted[-1])
        return RecordTimes(new, counted / self._rate, restarted)


#: Interval over which the rate of the counter is measured [s]; the host's clock is far better than the limit.
RATE_PERIOD = 5.0
#: Fraction of the expected rate by which two successive measurements must deviate to be reported, and within which they
#: must agree.
MAX_RATE_ERROR, RATE_SCATTER = 0.05, 0.02


class RateMonitor:
    """Compares the rate of the sensor's counter with the host's clock; an Axia may sample at another rate."""

    def __init__(self, rate: float) -> None:
        """Start before the first record; `rate` is the one that is assumed [Hz]."""
        self._rate, self._start = rate, (0.0, 0.0)
        self._before = rate
        self._reported = False

    def reset(self) -> None:
        """Forget the interval that has begun, because records are missing in it."""
        self._start = (0.0, 0.0)

    def measured(self, time: float, received: float) -> float | None:
        """Return the measured rate [Hz], once, if it deviates; both times are those of the last record [s]."""
        if self._start == (0.0, 0.0):
            self._start = (time, received)
            return None
        elapsed = received - self._start[1]
        if elapsed < RATE_PERIOD:
            return None
        found = self._rate * (time - self._start[0]) / elapsed
        before, self._before, self._start = self._before, found, (time, received)
        deviates = abs(found / self._rate - 1.0) > MAX_RATE_ERROR and abs(found - before) < RATE_SCATTER * self._rate
        if not deviates or self._reported:
            return None
        self._reported = True
        return found
