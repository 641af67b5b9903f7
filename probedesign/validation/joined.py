"""Validations of several probes in one table, laid out as the paper's Table I."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from probedesign.errors import InputError
from probedesign.validation.validate import Validation, csv_of

COLUMNS = ("probe", "length_mm", "force_N", "contact_fraction", "shape_rms_mm", "shape_rms_percent", "contact_error_mm",
           "direction", "kind", "test", "method", "result", "stated_error_mm", "predicted_error_mm",
           "within_95")  # fmt: skip
"""Of table1.csv; the first seven are the paper's."""


@dataclass(frozen=True)
class Joined:
    """Several probes.

    Attributes:
        validations: one a probe, in the order of the table.
    """

    validations: tuple[Validation, ...]

    def rows(self) -> list[dict[str, Any]]:
        """What was pushed or loaded: by probe, along it, from strong to weak, as Table I."""
        return [row for one in self.validations for row in one.rows() if row["kind"] != "free"]

    def csv(self) -> bytes:
        """The table."""
        return csv_of(self.rows(), COLUMNS)

    def as_dict(self) -> dict[str, Any]:
        """Plain data for JSON."""
        table = [{name: row[name] for name in COLUMNS} for row in self.rows()]
        return {"schema": 1, "table": table, "probes": [one.as_dict() for one in self.validations]}


def check_names(names: Sequence[str]) -> None:
    """Refuse a probe that is there twice: its files and its rows could not be told apart.

    Raises:
        InputError: one is.
    """
    for i, name in enumerate(names):
        if name in names[:i]:
            raise InputError(
                f"probe {name} is named twice; validate its second campaign by itself, with --out"
            )
