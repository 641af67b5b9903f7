"""The columns of a recording: which there are, in which units, and which of a header's they are."""

import re
from dataclasses import dataclass

from probedesign.live.recording_table import Table, shown

UNITS = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "force": {"N": 1.0, "mN": 1e-3},
    "moment": {"Nm": 1.0, "Nmm": 1e-3, "mNm": 1e-3},
    "gravity": {"m_s2": 1.0},
}
"""Factor to SI by kind of column and unit; capitals do not matter."""

WRENCH = ("fx", "fy", "fz", "mx", "my", "mz")
GRAVITY = ("gx", "gy", "gz")
KIND = {
    "time": "time",
    **dict.fromkeys(WRENCH[:3], "force"),
    **dict.fromkeys(WRENCH[3:], "moment"),
    **dict.fromkeys(GRAVITY, "gravity"),
}
ALIASES = {"t": "time", "timestamp": "time", "tx": "mx", "ty": "my", "tz": "mz"}

HEADER = "time_s,Fx_N,Fy_N,Fz_N,Mx_Nm,My_Nm,Mz_Nm"
GRAVITY_HEADER = "gx_m_s2,gy_m_s2,gz_m_s2"

CEILING = {"time": 1e11, "force": 1000.0, "moment": 50.0, "gravity": 30.0}
"""No true value is larger [s, N, N·m, m/s²]: it is raw counts or a wrong unit. The largest calibration of
the Nano17 reads 50 N and 0.5 N·m; a clock that counts milliseconds since 1970 as seconds reads 1.7e12."""

NUMBER = re.compile(r"\s*[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?\s*", re.ASCII)


@dataclass(frozen=True)
class Column:
    """One column that is read.

    Attributes:
        quantity: "time", one of `WRENCH` or one of `GRAVITY`.
        index: its place in a row.
        factor: to SI.
        name: as the header spells it.
    """

    quantity: str
    index: int
    factor: float
    name: str

    @property
    def ceiling(self) -> float:
        """Largest true value, in SI."""
        return CEILING[KIND[self.quantity]]


def columns_of(table: Table) -> list[Column]:
    """The columns to read: time, wrench and, if they are there, gravity.

    Raises:
        InputError: a column is missing, doubled or without a known unit.
    """
    if all(NUMBER.fullmatch(name) for name in table.header):
        table.fail(table.header_number, f"numbers without a header; the first line must be like {HEADER}")
    found: dict[str, Column] = {}
    for index, name in enumerate(table.header):
        column = _column(table, index, name)
        if column is None:
            continue
        if column.quantity in found:
            pair = f"{shown(found[column.quantity].name)} and {shown(name)}"
            table.fail(table.header_number, f"columns {pair} are the same; keep one")
        found[column.quantity] = column
    wanted = ("time", *WRENCH, *(GRAVITY if found.keys() & set(GRAVITY) else ()))
    names = f"{HEADER},{GRAVITY_HEADER}".split(",")
    missing = [name for quantity, name in zip(wanted, names, strict=False) if quantity not in found]
    if missing:
        told = ", ".join(missing)
        table.fail(table.header_number, f"columns are missing: {told}; the header must be like {HEADER}")
    return [found[quantity] for quantity in wanted]


def _column(table: Table, index: int, name: str) -> Column | None:
    """What a column of that name holds; None if it is nothing of ours.

    The name's stem may end at anything but a letter, and the unit may be spelt as one likes: `Fx_N`, `Fx (N)`,
    `Mx [N·mm]`. `Fx` alone is recognised too, and refused for saying no unit.
    """
    stem = re.match(r"[a-z]*", name.lower()).group()  # type: ignore[union-attr]  # matches everything
    quantity = ALIASES.get(stem, stem)
    if quantity not in KIND:
        return None
    units = UNITS[KIND[quantity]]
    unit = name[len(stem) :].strip(" _()[]")
    factor = {_letters(known): factor for known, factor in units.items()}.get(_letters(unit))
    if factor is None:
        says = f"unit {shown(unit)} is not known" if unit else "names no unit"
        endings = ", ".join(f"_{known}" for known in units)
        table.fail(table.header_number, f"column {shown(name)}: {says}; end its name in one of {endings}")
    return Column(quantity, index, factor, name)


def _letters(unit: str) -> str:
    """What a unit's spellings have in common: N·mm, N-mm, N mm and Nmm."""
    return re.sub(r"[\W_]", "", unit.lower().replace("µ", "u"))
