"""Columns of a table whose header names every number's unit: which there are, and what they count in."""

import re
from collections.abc import Mapping
from dataclasses import dataclass

from probedesign.core.csv_tables import TextTable, shown

UNITS = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "force": {"N": 1.0, "mN": 1e-3},
    "moment": {"Nm": 1.0, "Nmm": 1e-3, "mNm": 1e-3},
    "gravity": {"m_s2": 1.0},
    "length": {"mm": 1e-3, "m": 1.0, "cm": 1e-2, "um": 1e-6},
    "angle": {"deg": 3.141592653589793 / 180.0, "rad": 1.0},
    "pixel": {"px": 1.0},
}
"""Factor to SI by kind of column and unit; capitals do not matter. A kind that is not here has no unit."""

WRENCH = ("fx", "fy", "fz", "mx", "my", "mz")
WRENCH_KINDS = {**dict.fromkeys(WRENCH[:3], "force"), **dict.fromkeys(WRENCH[3:], "moment")}
WRENCH_ALIASES = {"tx": "mx", "ty": "my", "tz": "mz"}
CEILING = {
    "time": 1e11,
    "force": 1000.0,
    "moment": 50.0,
    "gravity": 30.0,
    "length": 100.0,
    "angle": 100.0,
    "pixel": 1e6,
}
"""No true value is larger [s, N, N·m, m/s², m, rad, px]: it is raw counts or a wrong unit. The largest calibration of
the Nano17 reads 50 N and 0.5 N·m; a clock that counts milliseconds since 1970 as seconds reads 1.7e12; no
laboratory is wider than 100 m, and no picture than a million pixels."""

NUMBER = re.compile(r"\s*[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?\s*", re.ASCII)


@dataclass(frozen=True)
class Column:
    """One column that is read.

    Attributes:
        quantity: what it holds, as the reader calls it.
        kind: of that quantity, a key of `UNITS` or a kind without unit.
        index: its place in a row.
        factor: to SI.
        name: as the header spells it.
    """

    quantity: str
    kind: str
    index: int
    factor: float
    name: str

    @property
    def ceiling(self) -> float:
        """Largest true value, in SI."""
        return CEILING[self.kind]


def find_columns(
    table: TextTable, kinds: Mapping[str, str], aliases: Mapping[str, str], like: str
) -> dict[str, Column]:
    """The columns of a header that are known, by quantity; others are left out.

    Args:
        table: whose header is read.
        kinds: kind of each known quantity, in lower case.
        aliases: other names of quantities.
        like: a header as it should be, for messages.

    Raises:
        InputError: there is no header, or a column is doubled or without a known unit.
    """
    if all(NUMBER.fullmatch(name) for name in table.header):
        table.fail(table.header_number, f"numbers without a header; the first line must be like {like}")
    found: dict[str, Column] = {}
    for index, name in enumerate(table.header):
        column = _column(table, index, name, kinds, aliases)
        if column is None:
            continue
        if column.quantity in found:
            pair = f"{shown(found[column.quantity].name)} and {shown(name)}"
            table.fail(table.header_number, f"columns {pair} are the same; keep one")
        found[column.quantity] = column
    return found


def _column(
    table: TextTable, index: int, name: str, kinds: Mapping[str, str], aliases: Mapping[str, str]
) -> Column | None:
    """What a column of that name holds; None if it is nothing of ours.

    The name's stem may end at anything but a letter, and the unit may be spelt as one likes: `Fx_N`, `Fx (N)`,
    `Mx [N·mm]`. `Fx` alone is recognised too, and refused for saying no unit.
    """
    stem = _stem(name.lower(), (*kinds, *aliases))
    if stem is None:
        return None
    quantity = aliases.get(stem, stem)
    kind = kinds[quantity]
    unit = name[len(stem) :].strip(" _()[]")
    if kind not in UNITS:
        return None if unit else Column(quantity, kind, index, 1.0, name)
    factor = {_letters(known): factor for known, factor in UNITS[kind].items()}.get(_letters(unit))
    if factor is None:
        says = f"unit {shown(unit)} is not known" if unit else "names no unit"
        endings = ", ".join(f"_{known}" for known in UNITS[kind])
        table.fail(table.header_number, f"column {shown(name)}: {says}; end its name in one of {endings}")
    return Column(quantity, kind, index, factor, name)


def _stem(name: str, known: tuple[str, ...]) -> str | None:
    """The longest known name that a column's begins with, whole words only."""
    begun = [k for k in known if name.startswith(k) and not name[len(k) : len(k) + 1].isalpha()]
    return max(begun, key=len, default=None)


def _letters(unit: str) -> str:
    """What a unit's spellings have in common: N·mm, N-mm, N mm and Nmm."""
    return re.sub(r"[\W_]", "", unit.lower().replace("µ", "u"))
