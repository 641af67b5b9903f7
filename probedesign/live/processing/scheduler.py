"""Options of a run, commands from the user during it, and the schedule of estimates."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from queue import Empty, SimpleQueue
from time import monotonic
from typing import Literal

from probedesign.core.errors import InputError
from probedesign.estimation.estimator import Method
from probedesign.live import Log
from probedesign.live.processing.blocks import WrenchReading
from probedesign.live.processing.tare import TareWindow


@dataclass(frozen=True)
class ProcessingOptions:
    """Options for processing the readings of a source.

    Attributes:
        window: window of the tare, in which the probe is free; None takes no tare.
        samples: number of readings averaged to one.
        rate: maximum number of estimates per second of the source's clock [Hz].
        count: end after this many estimates.
        seconds: end this long after the first reading [s].
        filter_hz: cut-off frequency of the low-pass filter before each estimate; None does not filter.
        method: method by which a single reading is located.
        estimates: whether contacts are located as readings arrive; otherwise only phases and touches are reported.
    """

    window: TareWindow | None = None
    samples: int = 1
    rate: float = math.inf
    count: int | None = None
    seconds: float | None = None
    filter_hz: float | None = None
    estimates: bool = True
    method: Method = "ml"

    def __post_init__(self) -> None:
        """Check the numbers; raises InputError if one is not positive."""
        limits = {"average": self.samples, "rate-hz": self.rate, "count": self.count, "seconds": self.seconds,
                "filter-hz": self.filter_hz}  # fmt: skip
        for name, value in limits.items():
            if value is not None and not value > 0:
                raise InputError(f"--{name} {value} must be positive")


CommandName = Literal["tare", "mark", "start recording", "stop recording", "stop"]


@dataclass(frozen=True)
class Command:
    """One command of the user.

    Attributes:
        name: the command.
        text: text of a mark.
    """

    name: CommandName
    text: str = ""


class CommandQueue:
    """Passes commands from any thread to the processing thread, which polls between two blocks of readings."""

    def __init__(self) -> None:
        self._queue: SimpleQueue[Command] = SimpleQueue()
        self._handlers: dict[CommandName, Callable[[Command], None]] = {}

    def register(self, name: CommandName, handler: Callable[[Command], None]) -> None:
        """Register the handler of a command; it is called in the processing thread and reports the outcome itself."""
        self._handlers[name] = handler

    def put(self, name: CommandName, text: str = "") -> None:
        """Queue a command; the outcome is reported to every sink as an event."""
        self._queue.put(Command(name, text))

    def pop_all(self) -> list[Command]:
        """Return all commands since the last call, in order, except those that a handler has executed."""
        pending: list[Command] = []
        while True:
            try:
                command = self._queue.get_nowait()
            except Empty:
                return pending
            if handler := self._handlers.get(command.name):
                handler(command)
            else:
                pending.append(command)


MAX_AGE = 0.012
"""Maximum age of a reading that is still located [s].

An older reading is skipped because newer ones are queued behind it: readings that no contact explains take longest to
process and would delay all later ones. It is still recorded, monitored and fused. Such a reading takes about 8 ms, so
its estimate is available within 20 ms."""

REPORT_PERIOD, MAX_SKIPPED_SHARE = 5.0, 0.05
"""Reporting period by the source's clock [s], and the fraction of skipped estimates that is reported at once."""


class EstimateScheduler:
    """Limits the rate of estimates by the source's clock and skips readings that are too old.

    Attributes:
        n_due: number of estimates that were due.
        n_skipped: number of due estimates that were skipped because their reading was too old.
    """

    def __init__(self, rate: float, log: Log, max_age: float = MAX_AGE) -> None:
        """Start with nothing due.

        Args:
            rate: maximum rate of estimates [Hz].
            log: callback for messages to the user.
            max_age: maximum age of a reading [s]; infinite if no consumer waits for the estimates.
        """
        self._max_age = max_age
        self._period, self._next, self._log = 1.0 / rate, -math.inf, log
        self.n_due = self.n_skipped = 0
        self._start, self._reported, self._overloaded = -math.inf, (0, 0), False

    def is_due(self, reading: WrenchReading, ready: float = -math.inf) -> bool:
        """Return whether the reading is to be located.

        Args:
            reading: the reading.
            ready: time by `time.monotonic` at which the base pose became available [s], if the reading waited for it.
        """
        if not self._period_elapsed(reading.time):
            return False
        if reading.time - self._start > REPORT_PERIOD:
            self._report(reading.time)
        max_age = (
            monotonic() - max(reading.received, ready) > self._max_age
        )  # NaN, and so never too old, without hardware
        self.n_due, self.n_skipped = self.n_due + 1, self.n_skipped + max_age
        return not max_age

    def finish(self) -> None:
        """Report the number of skipped estimates, if any."""
        if self.n_skipped:
            self._log(
                f"{self.n_skipped} of {self.n_due} estimates were skipped: each was more than "
                f"{1e3 * self._max_age:g} ms late, with newer readings queued"
            )

    def _period_elapsed(self, time: float) -> bool:
        """Return whether the period has elapsed, with a tolerance of 1 %.

        The tolerance keeps a source that runs at exactly this rate from losing estimates to rounding.
        """
        if time < self._next - 0.01 * self._period:
            return False
        self._next = self._next + self._period if self._next + self._period > time else time + self._period
        return True

    def _report(self, time: float) -> None:
        """Report when the fraction of skipped estimates exceeds the limit, and when it recovers."""
        n_due, n_skipped = self.n_due - self._reported[0], self.n_skipped - self._reported[1]
        self._start, self._reported = time, (self.n_due, self.n_skipped)
        overloaded = n_skipped > MAX_SKIPPED_SHARE * n_due
        if overloaded and not self._overloaded:
            self._log(
                f"{n_skipped} of {n_due} estimates skipped in {REPORT_PERIOD:g} s: each was more than "
                f"{1e3 * self._max_age:g} ms late; reduce --rate-hz"
            )
        elif self._overloaded and not overloaded:
            self._log("estimates are on time again")
        self._overloaded = overloaded
