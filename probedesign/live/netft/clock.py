"""The sensor's own clock: time from a counter of 32 bits that wraps, stands still or starts again."""

from probedesign.live.netft.wire import SAMPLES_PER_SECOND

WRAP = 1 << 32
AHEAD = 10.0
"""A counter that runs this far ahead of the host's clock is another counter [s]: buffers hold less, suspended
programs find no old records."""


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

    def time(self, ft_sequence: int, received: float) -> float | None:
        """Time of a record [s]; None if the counter stands still, so that the record is no new one.

        Args:
            ft_sequence: of the record.
            received: when, by the host's clock [s].
        """
        if self._last is not None:
            ticks = (ft_sequence - self._last[0]) % WRAP
            elapsed = max(received - self._last[1], 0.0)
            if ticks == 0:
                return None
            if ticks / SAMPLES_PER_SECOND > elapsed + AHEAD:
                self.restarts += 1
                ticks = max(1, round(elapsed * SAMPLES_PER_SECOND))
            self._ticks += ticks
        self._last = (ft_sequence, received)
        return self._ticks / SAMPLES_PER_SECOND
