"""What is said of a box that falls silent, and of what is lost."""

from collections import Counter
from collections.abc import Callable
from math import inf, isfinite
from time import monotonic

from probedesign.errors import InputError

FIRST = 3.0
"""The first record must be there within [s]."""
TOLD = (0.0, 2.0, 10.0, 60.0, 600.0)
"""After so much silence a line is said again [s]."""
OFTEN, LATELY = 4, 10.0
"""So many interruptions within this time [s] look like another client; losses are told as seldom."""
COUNTED = 1.0
"""Losses are looked at so often [s]."""

WORDS = {
    "lost": "lost on the way", "late": "late and left out", "doubled": "doubled", "malformed": "malformed",
    "faults": "with a fault", "dropped": "dropped because we lagged", "interruptions": "interruptions",
    "restarts": "restarts",
}  # fmt: skip
"""Of what is counted, in the order in which it is told."""
WORSE = ("lost", "dropped", "malformed")
"""What is told while it grows."""


class Outage:
    """Silence of the box, and what is said of it.

    Attributes:
        lasts: whether records are missing now.
        why: what is wrong, in words; empty while nothing is.
    """

    def __init__(self, name: str, say: Callable[[str], None]) -> None:
        """No record has come yet.

        Args:
            name: of the box.
            say: takes each line.
        """
        self.lasts, self.why = False, ""
        self._name, self._say = name, say
        self._told = 0
        self._recent: list[float] = []
        self._opened = monotonic()

    def silent(self, last: float, guess: str = "asking again") -> None:
        """There is no record, or none that may be taken.

        Args:
            last: when the last one came [s]; -inf if none ever did.
            guess: what it may be.

        Raises:
            InputError: the box has never sent one.
        """
        now = monotonic()
        if not isfinite(last):
            if now - self._opened > FIRST:
                raise InputError(
                    f"{self._name}: the box answers HTTP but sends no record; is a firewall between, or the port "
                    "another?"
                )
            return
        if not self.lasts:
            self.lasts, self._told = True, 0
            self._recent = [t for t in self._recent if now - t < LATELY] + [now]
        self.why = f"stale, no record for {now - last:.2g} s"
        if self._told < len(TOLD) and now - last >= TOLD[self._told]:
            self._told += 1
            self._say(f"{self._name}: {self.why}; {self._another_client() or guess}")

    def over(self, silence: float) -> None:
        """Records come again, after so long [s]."""
        self._say(f"{self._name}: records again after {silence:.2g} s; the tare is kept")
        self.lasts, self.why = False, ""

    def _another_client(self) -> str:
        if len(self._recent) < OFTEN:
            return ""
        return f"{len(self._recent)} times within {LATELY:g} s: does another client take the stream?"


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
        more = {name: counts[name] - self._told[name] for name in WORSE}
        if any(more.values()) and now - self._when > LATELY:
            told = ", ".join(f"{count} {WORDS[name]}" for name, count in more.items() if count)
            self._say(f"{self._name}: {told}; {counts['received']} received so far")
            self._told, self._when = counts.copy(), now


def summary(counts: Counter[str]) -> str:
    """All that was counted, in one line."""
    told = [f"{counts[name]} {words}" for name, words in WORDS.items() if counts[name]]
    return f"{counts['received']} records, {', '.join(told) or 'none lost'}"
