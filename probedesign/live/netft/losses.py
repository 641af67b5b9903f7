"""What was counted of a stream, and what is said of it."""

from collections import Counter
from collections.abc import Callable
from math import inf
from time import monotonic

COUNTED = 1.0
"""Losses are looked at so often [s]."""
LATELY = 10.0
"""They are told no more often than so [s]."""

WORDS = {
    "lost": "lost on the way", "late": "late and left out", "doubled": "doubled", "malformed": "malformed",
    "faults": "with a fault", "dropped": "dropped because we lagged", "interruptions": "interruptions",
    "restarts": "restarts",
}  # fmt: skip
"""Of what is counted, in the order in which it is told."""
WORSE = ("lost", "dropped", "malformed")
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
        more = {name: counts[name] - self._told[name] for name in WORSE}
        if any(more.values()) and now - self._when > LATELY:
            told = ", ".join(f"{count} {WORDS[name]}" for name, count in more.items() if count)
            self._say(f"{self._name}: {told}; {counts['received']} received so far")
            self._told, self._when = counts.copy(), now


def summary(counts: Counter[str]) -> str:
    """All that was counted, in one line."""
    told = [f"{counts[name]} {words}" for name, words in WORDS.items() if counts[name]]
    return f"{counts['received']} records, {', '.join(told) or 'none lost'}"
