"""Findings of the print check, and the rules that make them from a value and its limit."""

from dataclasses import dataclass
from typing import Any, Literal

Severity = Literal["ok", "warning", "error"]
Confidence = Literal["high", "medium", "low"]
Bound = Literal["at least", "at most"]
ROUNDING = 1e-9  #: Relative tolerance: sums such as 1.75 - 1.05 are off in the sixteenth digit.


@dataclass(frozen=True)
class Finding:
    """The result of one rule on one part."""

    rule: str  #: name of the rule.
    part: str  #: of the export.
    severity: Severity  #: `error` is not expected to print; `warning` may fail or print badly.
    what: str  #: the measured feature.
    measured: float | None  #: its value in `unit`; None where the part could not be laid out.
    limit: float | None  #: the value it is compared with.
    bound: Bound  #: the side of the limit on which it must lie.
    unit: str  #: mm, mm², mm³, deg, N or 1.
    remedy: str  #: the nearest change that meets the limit; empty if the finding is ok.
    source: str  #: of the limit.
    confidence: Confidence  #: in the limit.

    def as_record(self) -> dict[str, Any]:
        """Return the finding as a dictionary for JSON and the manifest; numbers to a nanometre."""
        record = {key: value for key, value in vars(self).items() if value != ""}
        numbers = {key: record[key] for key in ("measured", "limit")}
        rounded = {key: None if value is None else round(value, 6) for key, value in numbers.items()}
        return record | rounded | {"message": self.message}

    @property
    def message(self) -> str:
        """Return one line: part, value, limit, remedy."""
        if self.measured is None or self.limit is None:
            return f"{self.part}: {self.what}"
        unit = "" if self.unit == "1" else f" {self.unit}"
        numbers = f"{self.measured:.4g}{unit}, required {self.bound} {self.limit:.4g}{unit}"
        return f"{self.part}: {self.what}: {numbers}{f'; {self.remedy}' if self.remedy else ''}"


@dataclass(frozen=True)
class Rule:
    """A rule with the source of its limits and the confidence in them."""

    name: str
    unit: str
    source: str
    confidence: Confidence

    def at_least(
        self, part: str, what: str, measured: float, good: float, bad: float | None = None, remedy: str = ""
    ) -> Finding:
        """Return a warning below `good` and an error below `bad`; without `bad` an error below `good`."""
        worst = good if bad is None else bad
        room = ROUNDING * max(abs(good), abs(worst))
        severity: Severity = "ok" if measured >= good - room else "warning"
        if measured < worst - room:
            return self._finding(part, what, measured, worst, "at least", "error", remedy)
        return self._finding(part, what, measured, good, "at least", severity, remedy)

    def at_most(self, part: str, what: str, measured: float, bad: float, remedy: str = "") -> Finding:
        """Return an error above `bad`."""
        severity: Severity = "error" if measured > bad + ROUNDING * abs(bad) else "ok"
        return self._finding(part, what, measured, bad, "at most", severity, remedy)

    def warn_above(self, part: str, what: str, measured: float, good: float, remedy: str = "") -> Finding:
        """Return a warning above `good`."""
        severity: Severity = "warning" if measured > good + ROUNDING * abs(good) else "ok"
        return self._finding(part, what, measured, good, "at most", severity, remedy)

    def impossible(self, part: str, what: str) -> Finding:
        """Return an error without a number; `what` is the whole message."""
        return self._finding(part, what, None, None, "at most", "error", "")

    def _finding(
        self, part: str, what: str, measured: float | None, limit: float | None, bound: Bound, severity: Severity,
        remedy: str,
    ) -> Finding:  # fmt: skip
        remedy = "" if severity == "ok" else remedy
        return Finding(
            self.name, part, severity, what, measured, limit, bound, self.unit, remedy, self.source, self.confidence
        )
