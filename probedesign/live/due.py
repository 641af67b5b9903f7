"""When an estimate is due, and when it would come too late to be of use."""

import math
from collections.abc import Callable
from time import monotonic

from probedesign.live.reading import Reading

LATE = 0.2
"""A reading that waited so long [s] is not located: readings that nothing explains cost the most, and would let those
after them wait as well. Recorded, watched and fused it is all the same."""

CALM = 5.0
"""How long none is left out [s] before that is told."""


class Due:
    """At most so many estimates a second of the source's clock, and none of a reading that has waited too long."""

    def __init__(self, rate: float, say: Callable[[str], None]) -> None:
        """Begin.

        Args:
            rate: of estimates [Hz].
            say: takes each line that a user should know.
        """
        self._period, self._due, self._say = 1.0 / rate, -math.inf, say
        self._left_out, self._last = 0, -math.inf

    def wants(self, reading: Reading) -> bool:
        """Whether the reading is to be located."""
        return self._is_due(reading.time) and not self._late(reading)

    def _is_due(self, time: float) -> bool:
        """A hundredth of a period early will do, so that a source that keeps the very rate loses none to rounding."""
        if time < self._due - 0.01 * self._period:
            return False
        self._due = self._due + self._period if self._due + self._period > time else time + self._period
        return True

    def _late(self, reading: Reading) -> bool:
        """Whether it waited too long; one that came by no wire never does. Told when that begins, and how many were
        left out when it has not been so for a while."""
        if monotonic() - reading.received > LATE:
            if not self._left_out:
                self._say(
                    f"estimates come more than {LATE:g} s late: some are left out; a lower --rate-hz needs less"
                )
            self._left_out, self._last = self._left_out + 1, reading.time
            return True
        if self._left_out and reading.time - self._last > CALM:
            self._say(f"estimates are in time again, {self._left_out} were left out")
            self._left_out = 0
        return False
