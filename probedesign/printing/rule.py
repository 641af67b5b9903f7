"""A rule of printing and what was found of it: a number, its limit, and what would do."""

from dataclasses import dataclass
from typing import Any, Literal

Severity = Literal["ok", "warning", "error"]
Confidence = Literal["high", "medium", "low"]
ROUNDING = 1e-9
"""Relative: sums such as 1.75 - 1.05 miss what they mean in the sixteenth digit."""


@dataclass(frozen=True)
class Finding:
    """What one rule says of one part.

    Attributes:
        rule: its name.
        part: of the export.
        severity: `error` is not to be expected to print, `warning` may fail or come out badly.
        what: the thing that was measured.
        measured: the number, in `unit`; None where a part could not be laid out at all.
        limit: that it must keep.
        bound: on which side of the limit it must lie.
        unit: mm, deg or 1.
        remedy: the nearest that works; empty if the finding is ok.
        source: of the limit.
        confidence: in the limit.
    """

    rule: str
    part: str
    severity: Severity
    what: str
    measured: float | None
    limit: float | None
    bound: Literal["at least", "at most"]
    unit: str
    remedy: str
    source: str
    confidence: Confidence

    def as_record(self) -> dict[str, Any]:
        """For JSON and the manifest; numbers to a nanometre."""
        record = {key: value for key, value in vars(self).items() if value != ""}
        numbers = {key: _rounded(record[key]) for key in ("measured", "limit")}
        return record | numbers | {"message": self.message}

    @property
    def message(self) -> str:
        """For people, on one line: part, number, limit, remedy."""
        if self.measured is None or self.limit is None:
            return f"{self.part}: {self.what}"
        unit = "" if self.unit == "1" else f" {self.unit}"
        numbers = f"{self.measured:.4g}{unit}, {self.bound} {self.limit:.4g}{unit} wanted"
        return f"{self.part}: {self.what} {numbers}{f'; {self.remedy}' if self.remedy else ''}"


@dataclass(frozen=True)
class Rule:
    """A rule by its name, with where its numbers come from and how far they can be trusted."""

    name: str
    unit: str
    source: str
    confidence: Confidence

    def at_least(
        self, part: str, what: str, measured: float, good: float, bad: float | None = None, remedy: str = ""
    ) -> Finding:
        """Warn below `good`, an error below `bad`; without `bad` already below `good`."""
        severity = _severity(measured, good, good if bad is None else bad)
        limit = bad if severity == "error" and bad is not None else good
        return self._finding(part, what, measured, limit, "at least", severity, remedy)

    def at_most(self, part: str, what: str, measured: float, bad: float, remedy: str = "") -> Finding:
        """An error above `bad`."""
        severity = _severity(-measured, -bad, -bad)
        return self._finding(part, what, measured, bad, "at most", severity, remedy)

    def impossible(self, part: str, what: str) -> Finding:
        """An error without a number of its own: `what` says it all."""
        return Finding(
            self.name, part, "error", what, None, None, "at most", self.unit, "", self.source, self.confidence
        )

    def _finding(
        self,
        part: str,
        what: str,
        measured: float,
        limit: float,
        bound: Literal["at least", "at most"],
        severity: Severity,
        remedy: str,
    ) -> Finding:
        told = "" if severity == "ok" else remedy
        return Finding(
            self.name, part, severity, what, measured, limit, bound, self.unit, told, self.source, self.confidence
        )  # fmt: skip


def _severity(measured: float, good: float, bad: float) -> Severity:
    room = ROUNDING * max(abs(good), abs(bad))
    if measured < bad - room:
        return "error"
    return "warning" if measured < good - room else "ok"


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 6)
