"""The touches of a run as they come: of each, where the base stood, and what the free probe read before and after."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from probedesign.live.processing.estimates import EstimateUpdate
from probedesign.live.processing.touches import SPAN, Contact
from probedesign.mapping.dwell import Dwell

FREE_SPAN = 2.0
"""How much of a free probe's readings next to a touch counts [s]: the bias walks on."""
MOST = 20
"""Dwells of one touch that count; of more, so many evenly chosen."""

AGAIN = SPAN
"""A touch that is lost before the base stood in it, and told again within less than this [s], is one: where it begins,
its force lies in the noise still, and one mean may tell it and the next not. For so long `live` says released, not
free."""


@dataclass(frozen=True)
class Series:
    """One touch.

    Attributes:
        number: of it, from 1.
        start: when it was told [s].
        before: the free probe just before it; None if it did not stand.
        dwells: where the base stood while it touched, in the order of time.
        after: the free probe just after it; None if it did not stand.
    """

    number: int
    start: float
    before: Dwell | None
    dwells: tuple[Dwell, ...]
    after: Dwell | None


class Gathering:
    """Gathers series while the answers of a chain come, which must hold every reading."""

    def __init__(self) -> None:
        self._count, self._start = 0, np.nan
        self._told, self._last = 0, np.nan  # by the number that `live` gives; 0 where none is gathered
        self._before: Dwell | None = None
        self._older: Dwell | None = None
        self._dwells: list[Dwell] = []
        self._after: Dwell | None = None

    def take(self, answer: EstimateUpdate) -> Iterator[Series]:
        """Take in an answer; the series that it completes, if one."""
        if answer.phase == "" or not np.isfinite(answer.wrench_base).all():
            return
        present = answer.contacts[-1] if answer.contacts and answer.contacts[-1].ongoing else None
        if present is not None and present.number != self._told:
            if not self._goes_on(present):
                yield from self.ended()
                self._begin(present)
            self._told = present.number
        if present is not None:
            self._last = answer.reading.time
            if answer.phase == "settled":
                self._settled(answer)
        elif answer.phase == "free":
            yield from self._freely(answer)

    def ended(self) -> Iterator[Series]:
        """The series that is not complete yet, if one."""
        if self._told:
            after = self._after if self._after is not None and self._after.counts else None
            dwells = tuple(_some([dwell for dwell in self._dwells if dwell.counts]))
            yield Series(self._count, self._start, self._before, dwells, after)
            if after is not None:
                self._before, self._older = after, None
        self._told, self._dwells, self._after = 0, [], None

    def _goes_on(self, present: Contact) -> bool:
        """Whether what is told now is the touch that was just lost, as it begins."""
        stood = any(dwell.counts for dwell in self._dwells)
        return self._told != 0 and not stood and present.start - self._last < AGAIN

    def _begin(self, present: Contact) -> None:
        self._count, self._start = self._count + 1, present.start
        self._before = _longer(self._before, self._older)

    def _settled(self, answer: EstimateUpdate) -> None:
        if self._dwells and self._dwells[-1].holds(answer.T_world_base):
            self._dwells[-1].add(answer)
        else:
            self._dwells.append(Dwell.at(answer))

    def _freely(self, answer: EstimateUpdate) -> Iterator[Series]:
        """A reading of the free probe, whose base stands: after a touch or before one."""
        if not self._told:
            self._waiting(answer)
            return
        after = self._after
        if after is None:
            self._after = Dwell.at(answer)
        elif after.holds(answer.T_world_base) and answer.reading.time - after.start < FREE_SPAN:
            after.add(answer)
        else:
            yield from self.ended()
            self._waiting(answer)

    def _waiting(self, answer: EstimateUpdate) -> None:
        """Keep the last one or two spans."""
        before = self._before
        if before is None or not before.holds(answer.T_world_base):
            # What begins to move looks free for a moment still.
            self._older = before if before is not None and before.counts else self._older
            self._before = Dwell.at(answer)
        elif answer.reading.time - before.start >= FREE_SPAN:
            self._older, self._before = before, Dwell.at(answer)
        else:
            before.add(answer)


def _longer(now: Dwell | None, older: Dwell | None) -> Dwell | None:
    """The free probe's last span, or the one before it where that has hardly begun."""
    if older is not None and (now is None or 2 * now.readings < older.readings):
        return older
    return now if now is not None and now.counts else None


def _some(dwells: list[Dwell]) -> list[Dwell]:
    """All of them, or `MOST` from the first to the last."""
    if len(dwells) <= MOST:
        return dwells
    return [dwells[round(i)] for i in np.linspace(0, len(dwells) - 1, MOST)]
