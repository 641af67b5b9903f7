"""How often something comes, and whether it has stopped."""

import math
from collections import deque
from collections.abc import Callable

LEAST = 0.05
"""Silence that is stale at the soonest [s], as for a Net F/T box."""
MISSED = 5.0
"""Silence of so many of the usual gaps is stale."""


class Pace:
    """Beats, of one thread, looked at from another."""

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._beats: deque[tuple[float, int]] = deque(maxlen=64)

    def beat(self, count: int) -> None:
        """So many have come at once."""
        self._beats.append((self._clock(), count))

    @property
    def silence(self) -> float:
        """Since the last beat [s]; NaN before the first."""
        beats = tuple(self._beats)
        return self._clock() - beats[-1][0] if beats else math.nan

    @property
    def rate(self) -> float:
        """A second, of the last beats; NaN before the second."""
        beats = tuple(self._beats)
        span = beats[-1][0] - beats[0][0] if beats else 0.0
        return sum(count for _, count in beats[1:]) / span if span > 0.0 else math.nan

    @property
    def stale(self) -> bool:
        """Whether it has been silent for longer than it is used to."""
        beats = tuple(self._beats)
        if not beats:
            return False
        usual = (beats[-1][0] - beats[0][0]) / max(len(beats) - 1, 1)
        return self._clock() - beats[-1][0] > max(LEAST, MISSED * usual)
