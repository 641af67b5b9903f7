"""What `live` does with the readings of a source."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from queue import Empty, SimpleQueue
from time import monotonic
from typing import Literal

from probedesign.errors import InputError
from probedesign.estimation.estimator import Method
from probedesign.live.processing.blocks import Reading
from probedesign.live.processing.tare import Window


@dataclass(frozen=True)
class Plan:
    """What `live` does with the readings of a source.

    Attributes:
        window: when the probe is free, for the tare; None takes none.
        samples: how many readings are averaged to one.
        rate: at most so many estimates a second of the source's clock [Hz].
        count: end after so many estimates.
        seconds: end so long after the first reading [s].
        filter_hz: cut-off of the low-pass before each estimate; None filters nothing.
        method: by which a single reading is located.
        estimates: whether contacts are located as readings come; else phases and touches alone are told.
    """

    window: Window | None = None
    samples: int = 1
    rate: float = math.inf
    count: int | None = None
    seconds: float | None = None
    filter_hz: float | None = None
    estimates: bool = True
    method: Method = "ml"

    def __post_init__(self) -> None:
        """Raises InputError where a number cannot be meant."""
        said = {"average": self.samples, "rate-hz": self.rate, "count": self.count, "seconds": self.seconds,
                "filter-hz": self.filter_hz}  # fmt: skip
        for name, value in said.items():
            if value is not None and not value > 0:
                raise InputError(f"--{name} {value} must be positive")


Wish = Literal["tare", "mark", "start recording", "stop recording", "stop"]


@dataclass(frozen=True)
class Request:
    """One wish.

    Attributes:
        wish: what is asked.
        text: of a mark.
    """

    wish: Wish
    text: str = ""


class Requests:
    """From any thread to the one that runs, which looks between two blocks of readings."""

    def __init__(self) -> None:
        self._queue: SimpleQueue[Request] = SimpleQueue()
        self._done_by: dict[Wish, Callable[[Request], None]] = {}

    def does(self, wish: Wish, act: Callable[[Request], None]) -> None:
        """Who does what is asked, in the thread that runs, between two blocks; it tells what became of it."""
        self._done_by[wish] = act

    def ask(self, wish: Wish, text: str = "") -> None:
        """Ask; answered by an event that every sink is told."""
        self._queue.put(Request(wish, text))

    def taken(self) -> list[Request]:
        """All that was asked since the last call, in order, without what somebody did by now."""
        left: list[Request] = []
        while True:
            try:
                request = self._queue.get_nowait()
            except Empty:
                return left
            if act := self._done_by.get(request.wish):
                act(request)
            else:
                left.append(request)


MAX_AGE = 0.012
"""A reading that waited so long [s] is not located, since newer ones wait behind it: readings that nothing explains
cost the most, and would let those after them wait as well. Recorded, watched and fused it is all the same. With the
eight milliseconds that such a reading takes, its estimate comes within twenty."""

REPORT_PERIOD, MAX_SKIPPED_SHARE = 5.0, 0.05
"""In each span [s] of the source's clock, the share left out from which that is told at once."""


class Due:
    """At most so many estimates a second of the source's clock, and none of a reading that has waited too long.

    Attributes:
        wanted: estimates that were due.
        left_out: those of them whose reading had waited too long.
    """

    def __init__(self, rate: float, say: Callable[[str], None], late: float = MAX_AGE) -> None:
        """Begin.

        Args:
            rate: of estimates [Hz].
            say: takes each line that a user should know.
            late: from when on a reading has waited too long [s]; infinite where nobody waits for what is made of it.
        """
        self._late = late
        self._period, self._due, self._say = 1.0 / rate, -math.inf, say
        self.wanted = self.left_out = 0
        self._start, self._before, self._behind = -math.inf, (0, 0), False

    def wants(self, reading: Reading, ready: float = -math.inf) -> bool:
        """Whether the reading is to be located.

        Args:
            reading: that there is.
            ready: when the base's pose was known at last, if it had to wait for that [s], by `time.monotonic`.
        """
        if not self._is_due(reading.time):
            return False
        if reading.time - self._start > REPORT_PERIOD:
            self._tell(reading.time)
        late = monotonic() - max(reading.received, ready) > self._late  # never so of one that came by no wire
        self.wanted, self.left_out = self.wanted + 1, self.left_out + late
        return not late

    def ended(self) -> None:
        """Tell how many were left out, if any were."""
        if self.left_out:
            self._say(
                f"{self.left_out} of {self.wanted} estimates were left out: each came more than "
                f"{1e3 * self._late:g} ms late, with newer readings behind it"
            )

    def _is_due(self, time: float) -> bool:
        """A hundredth of a period early will do, so that a source that keeps the very rate loses none to rounding."""
        if time < self._due - 0.01 * self._period:
            return False
        self._due = self._due + self._period if self._due + self._period > time else time + self._period
        return True

    def _tell(self, time: float) -> None:
        """Tell when more than a few are left out, and when that is over."""
        wanted, left_out = self.wanted - self._before[0], self.left_out - self._before[1]
        self._start, self._before = time, (self.wanted, self.left_out)
        behind = left_out > MAX_SKIPPED_SHARE * wanted
        if behind and not self._behind:
            self._say(
                f"{left_out} of {wanted} estimates left out in {REPORT_PERIOD:g} s: each came more than "
                f"{1e3 * self._late:g} ms late; a lower --rate-hz needs less"
            )
        elif self._behind and not behind:
            self._say("estimates are in time again")
        self._behind = behind
