"""What was counted of a stream, and what is said of it."""

from collections import Counter
from collections.abc import Callable, Generator
from contextlib import closing
from itertools import pairwise
from math import inf, isfinite
from time import monotonic

import numpy as np

from probedesign.errors import InputError
from probedesign.frames import Array
from probedesign.live.processing.blocks import Block, silence
from probedesign.live.sources.dropout import Outage
from probedesign.live.sources.netft.configuration import Configuration, Watch
from probedesign.live.sources.netft.session import STALE, Records, SensorClock, Session, steps
from probedesign.live.sources.netft.wire import HARMLESS, fault_of

COUNT_INTERVAL = 1.0
"""Losses are looked at so often [s]."""
REPORT_INTERVAL = 10.0
"""They are told no more often than so [s]."""

COUNTERS = {
    "lost": "lost on the way", "late": "late and left out", "doubled": "doubled", "malformed": "malformed",
    "faults": "with a fault", "dropped": "dropped because we lagged", "interruptions": "interruptions",
    "restarts": "restarts",
}  # fmt: skip
"""Of what is counted, in the order in which it is told."""
REPORTED = ("lost", "dropped", "malformed")
"""What is told while it grows."""


class Losses:
    """What was counted, and what is said of it."""

    def __init__(self, name: str, say: Callable[[str], None]) -> None:
        """Nothing is lost yet.

        Args:
            name: of the box.
            say: takes each line.
        """
        self._name, self._say = name, say
        self._told: Counter[str] = Counter()
        self._when = -inf

    def tell(self, counts: Counter[str]) -> None:
        """Say what has grown since it was last said, but not often."""
        now = monotonic()
        more = {name: counts[name] - self._told[name] for name in REPORTED}
        if any(more.values()) and now - self._when > REPORT_INTERVAL:
            told = ", ".join(f"{count} {COUNTERS[name]}" for name, count in more.items() if count)
            self._say(f"{self._name}: {told}; {counts['received']} received so far")
            self._told, self._when = counts.copy(), now


def summary(counts: Counter[str]) -> str:
    """All that was counted, in one line."""
    told = [f"{counts[name]} {words}" for name, words in COUNTERS.items() if counts[name]]
    return f"{counts['received']} records, {', '.join(told) or 'none lost'}"


NEVER = "the box answers HTTP but sends no record; is a firewall between, or the port another?"
APART = 1.0
"""Lines on faults are so far apart at least [s]: a load near the limit comes and goes."""


class Reception:
    """Blocks of readings out of a session's records.

    Attributes:
        counts: what the session counted, readings with a fault, interruptions and restarts; brought up to date
            every second.
    """

    def __init__(
        self,
        name: str,
        gravity_base: Array,
        configuration: Configuration,
        session: Session,
        watch: Watch,
        say: Callable[[str], None],
    ) -> None:
        """Nothing has come yet.

        Args:
            name: of the box.
            gravity_base: vector of gravity of every reading [m/s²], (3,).
            configuration: in which the box counts.
            session: gives the records.
            watch: looks whether the configuration still is that.
            say: takes each line that a user should know.
        """
        self._name, self._gravity, self._say = name, gravity_base, say
        self._to_sensor = configuration.to_sensor
        self._session, self._watch = session, watch
        self._clock, self._outage, self._losses = SensorClock(), Outage(name, say, NEVER), Losses(name, say)
        self.counts: Counter[str] = Counter()
        self._last, self._stretch = -inf, 0
        self._counted, self._faulted = monotonic(), -inf
        self._fault = ""

    def blocks(self) -> Generator[Block, None, None]:
        """Readings as they come; silence after each `STALE` without one.

        Raises:
            InputError: the box never sends, or is not what it was.
        """
        with closing(self._session.records()) as stream:
            for records in stream:
                self._refuse()
                if monotonic() - self._counted > COUNT_INTERVAL:
                    self.count()
                    self._losses.tell(self.counts)
                yield from self._parts(records) if len(records) else self._silence()

    def count(self) -> None:
        """Bring the counts up to date."""
        self._counted = monotonic()
        self._session.count()
        for name, count in self._session.counts.items():
            self.counts[name] = count

    def _parts(self, records: Records) -> Generator[Block, None, None]:
        """Blocks of records, cut where the stream broke and where the fault is another."""
        new, time, restarted = self._clock.times(records.ft_sequence, records.received)
        records = records[new]
        if not len(records):
            return
        status = records.status
        if status.any():
            status = np.where(np.isin(status, HARMLESS), 0, status)
        before = self._last if isfinite(self._last) else records.received[0]
        broken = restarted | (steps(records.received, before) > STALE)
        broken[0] |= self._outage.lasts
        cuts = np.flatnonzero(broken[1:] | (np.diff(status) != 0)) + 1
        for start, end in pairwise([0, *cuts.tolist(), len(records)]):
            received = records.received[start:end]
            if broken[start] and not self._resumed(float(received[0])):
                yield from self._silence("its page does not answer")
                return
            wrench = records.counts[start:end] @ self._to_sensor.T
            fault = self._judged(int(status[start]), end - start)
            yield Block(time[start:end], wrench, self._gravity, received, fault, self._stretch)
            self._last = float(received[-1])

    def _silence(self, guess: str = "asking again") -> Generator[Block, None, None]:
        """Tell it, and give a block without readings once there have been some."""
        self._outage.silent(self._last, guess)
        if self._outage.lasts:
            yield silence(self._gravity, self._outage.why, self._stretch)

    def _resumed(self, received: float) -> bool:
        """Whether records that come again are of the box as it was: another box, or the same set up anew, must not
        be taken for the first."""
        if not self._watch.look():
            return False
        self._refuse()
        self._stretch += 1
        self.counts["interruptions"] += 1
        if self._clock.restarts > self.counts["restarts"]:
            self.counts["restarts"] = self._clock.restarts
            self._say(f"{self._name}: its clock started again; the tare from before is kept, take it anew")
        self._outage.over(received - self._last)
        return True

    def _judged(self, status: int, count: int) -> str:
        """What is wrong with readings of a status; said where it begins and ends."""
        fault = fault_of(status) if status else ""
        if fault:
            self.counts["faults"] += count
        if fault != self._fault and (not fault or monotonic() - self._faulted > APART):
            self._say(f"{self._name}: {fault or 'healthy again'}")
            self._fault, self._faulted = fault, monotonic()
        return fault

    def _refuse(self) -> None:
        """End where the box is not what it was.

        Raises:
            InputError: its configuration has changed.
        """
        if self._watch.changed:
            told = ", ".join(self._watch.changed)
            raise InputError(
                f"{self._name}: its configuration has changed ({told}); what was read in the last "
                f"{self._watch.period:g} s may be wrong; start again, with a new tare"
            )
