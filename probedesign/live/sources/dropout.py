"""What is said of a sensor that falls silent."""

from collections.abc import Callable
from math import isfinite
from time import monotonic

from probedesign.errors import InputError

FIRST = 3.0
"""The first record must be there within [s]."""
TOLD = (0.0, 2.0, 10.0, 60.0, 600.0)
"""After so much silence a line is said again [s]."""
OFTEN, LATELY = 4, 10.0
"""So many interruptions within this time [s] look like another client."""


class Outage:
    """Silence of a sensor, and what is said of it.

    Attributes:
        lasts: whether records are missing now.
        why: what is wrong, in words; empty while nothing is.
    """

    def __init__(self, name: str, say: Callable[[str], None], never: str) -> None:
        """No record has come yet.

        Args:
            name: of the source.
            say: takes each line.
            never: what is told where none comes at all.
        """
        self._never = never
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
            InputError: none has ever come.
        """
        now = monotonic()
        if not isfinite(last):
            if now - self._opened > FIRST:
                raise InputError(f"{self._name}: {self._never}")
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
