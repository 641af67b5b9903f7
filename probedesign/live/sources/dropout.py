"""Monitors the dropouts of a sensor and reports them."""

from math import isfinite
from time import monotonic

from probedesign.core.errors import InputError
from probedesign.live import Log

FIRST_RECORD_TIMEOUT = 3.0
"""Maximum wait for the first record [s]."""
REPORT_TIMES = (0.0, 2.0, 10.0, 60.0, 600.0)
"""Durations of silence after which it is reported (again) [s]."""
MAX_INTERRUPTIONS, INTERRUPTION_WINDOW = 4, 10.0
"""Number of interruptions within a time [s] that indicates another client."""


class DropoutMonitor:
    """Tracks the silence of a sensor and reports it.

    Attributes:
        ongoing: whether records are missing now.
        reason: description of the dropout; empty if there is none.
    """

    def __init__(self, name: str, log: Log, no_record_text: str) -> None:
        """Start before the first record.

        Args:
            name: name of the source.
            log: callback for messages to the user.
            no_record_text: message if no record arrives at all.
        """
        self._no_record_text = no_record_text
        self.ongoing, self.reason = False, ""
        self._name, self._log = name, log
        self._n_reports = 0
        self._interruptions: list[float] = []
        self._opened = monotonic()

    def on_silence(self, last: float, hint: str = "asking again") -> None:
        """Handle the absence of usable records.

        Args:
            last: time of the last record [s]; -inf if there was none.
            hint: probable cause.

        Raises:
            InputError: no record has ever arrived.
        """
        now = monotonic()
        if not isfinite(last):
            if now - self._opened > FIRST_RECORD_TIMEOUT:
                raise InputError(f"{self._name}: {self._no_record_text}")
            return
        if not self.ongoing:
            self.ongoing, self._n_reports = True, 0
            self._interruptions = [t for t in self._interruptions if now - t < INTERRUPTION_WINDOW] + [now]
        self.reason = f"stale, no record for {now - last:.2g} s"
        if self._n_reports < len(REPORT_TIMES) and now - last >= REPORT_TIMES[self._n_reports]:
            self._n_reports += 1
            self._log(f"{self._name}: {self.reason}; {self._another_client() or hint}")

    def on_resumed(self, silence: float) -> None:
        """Handle the end of a dropout of this duration [s]."""
        self._log(f"{self._name}: records resumed after {silence:.2g} s; the tare is kept")
        self.ongoing, self.reason = False, ""

    def _another_client(self) -> str:
        if len(self._interruptions) < MAX_INTERRUPTIONS:
            return ""
        return (
            f"{len(self._interruptions)} times within {INTERRUPTION_WINDOW:g} s: is another client reading?"
        )
