"""The rows of one table of a campaign, cell by cell: strict about what a spreadsheet may get wrong."""

import csv
import difflib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from probedesign.core.columns import NUMBER, UNITS, Column, find_columns
from probedesign.core.csv_tables import TextTable, read_table, shown
from probedesign.errors import InputError
from probedesign.frames import Array

MOST_BYTES = 50_000_000
MOST_ROWS = 500_000
NOTES = ("note", "notes", "comment", "remark")
"""Columns for people."""


@dataclass(frozen=True)
class Kind:
    """What one table may hold.

    Attributes:
        what: it is called.
        kinds: kind of each quantity by its name in the header; "name", "word" and "number" have no unit.
        needed: quantities without which the table says nothing.
        like: a header as it should be.
        aliases: other names of quantities.
    """

    what: str
    kinds: Mapping[str, str]
    needed: tuple[str, ...]
    like: str
    aliases: Mapping[str, str]


@dataclass(frozen=True)
class Rows:
    """The cells of one table.

    Attributes:
        table: they stand in.
        columns: by quantity.
        cells: text of each row's cells.
    """

    table: TextTable
    columns: dict[str, Column]
    cells: list[list[str]]

    def __len__(self) -> int:
        return len(self.cells)

    def fail(self, row: int, problem: str) -> NoReturn:
        """Raise the error of one row."""
        self.table.fail(self.table.numbers[row], problem)

    def texts(self, quantity: str) -> list[str]:
        """Of a column without unit; empty texts where there is no such column."""
        column = self.columns.get(quantity)
        return [""] * len(self) if column is None else [cells[column.index].strip() for cells in self.cells]

    def numbers(self, *quantities: str) -> Array:
        """In SI, (n, len(quantities)); NaN where a cell is empty or there is no such column.

        Raises:
            InputError: a cell is no finite number, or more than can be.
        """
        return np.column_stack([self._column(quantity) for quantity in quantities])

    def _column(self, quantity: str) -> Array:
        column = self.columns.get(quantity)
        if column is None:
            return np.full(len(self), np.nan)
        values = [self._number(i, column, cells[column.index]) for i, cells in enumerate(self.cells)]
        return np.array(values) * column.factor

    def _number(self, row: int, column: Column, text: str) -> float:
        if not text or text.isspace():
            return float("nan")
        if not NUMBER.fullmatch(text) or abs(value := float(text)) == float("inf"):
            remedy = "write a number with a decimal point, or leave the cell empty where it may be"
            self.fail(row, f"{column.name} = {shown(text.strip())} is not a finite number; {remedy}")
        if abs(value * column.factor) > column.ceiling:
            self.fail(row, f"{column.name} = {value:g} is more than can be; raw counts or a wrong unit?")
        return value

    def full(self, *quantities: str) -> Array:
        """Numbers of which none may be missing, (n, len(quantities)).

        Raises:
            InputError: a cell is empty or no finite number.
        """
        values = self.numbers(*quantities)
        for row, place in np.argwhere(np.isnan(values))[:1]:
            self.fail(int(row), f"{self.columns[quantities[place]].name} is empty; write the number")
        return values

    def spread(self, quantity: str, needed: NDArray[np.bool_], missing: str) -> Array:
        """A standard deviation of each row, (n,); NaN where its cell is empty.

        Args:
            quantity: its column.
            needed: rows that must have one, (n,).
            missing: what is wrong with a row that has none, and its remedy.

        Raises:
            InputError: one is not above 0, or a needed one is missing.
        """
        values = self.numbers(quantity)[:, 0]
        for row in np.flatnonzero(values <= 0.0)[:1]:
            column = self.columns[quantity]
            said = f"{column.name} = {self.cells[row][column.index].strip()}"
            self.fail(int(row), f"{said} is no standard deviation; write one above 0")
        for row in np.flatnonzero(needed & np.isnan(values))[:1]:
            self.fail(int(row), missing)
        return values

    def whole(self, *quantities: str) -> tuple[Array, NDArray[np.bool_]]:
        """Numbers that a row has all of or none: (n, len(quantities)), and which rows have them, (n,).

        Raises:
            InputError: a row has some only.
        """
        values = self.numbers(*quantities)
        empty = np.isnan(values)
        for row in np.flatnonzero(empty.any(axis=1) & ~empty.all(axis=1))[:1]:
            lacking = quantities[int(np.argmax(empty[row]))]
            said = self.columns[lacking].name if lacking in self.columns else f"a column {lacking}"
            given = self.columns[quantities[int(np.argmin(empty[row]))]].name
            self.fail(int(row), f"{given} is given without {said}; give all of them or none")
        return values, np.asarray(~empty.any(axis=1))

    def once(self, keys: list[tuple[object, ...]], say: Callable[[int], str]) -> None:
        """Refuse a second row of the same keys.

        Raises:
            InputError: there is one.
        """
        first: dict[tuple[object, ...], int] = {}
        for row, key in enumerate(keys):
            before = first.setdefault(key, row)
            if before != row:
                self.fail(
                    row, f"{say(row)} stands twice, first in line {self.table.numbers[before]}; keep one"
                )


def read_rows(path: Path, kind: Kind) -> Rows:
    """Read one table.

    Raises:
        InputError: it cannot be read, or its columns or the number of cells in a row are wrong.
    """
    table = read_table(path, kind.what, kind.like, MOST_BYTES)
    if len(table.header) == 1 and ";" in table.header[0]:
        table.fail(
            table.header_number, "semicolons between the columns; export it with commas and decimal points"
        )
    table = _without_empty(table)
    columns = find_columns(table, kind.kinds, kind.aliases, kind.like)
    _check_columns(table, columns, kind)
    if not table.rows:
        raise InputError(f"{path}: holds no rows, only a header")
    if len(table.rows) > MOST_ROWS:
        raise InputError(f"{path}: holds {len(table.rows)} rows, far too many for a {kind.what}")
    return Rows(table, columns, _cells(table))


def _without_empty(table: TextTable) -> TextTable:
    """Without the rows that hold nothing but commas, as spreadsheets leave them at the end."""
    kept = [i for i, row in enumerate(table.rows) if row.strip(", \t")]
    return replace(table, rows=[table.rows[i] for i in kept], numbers=[table.numbers[i] for i in kept])


def _check_columns(table: TextTable, columns: dict[str, Column], kind: Kind) -> None:
    """Refuse columns that are missing, that nobody knows, and one kind of quantity in two units."""
    read = {column.index for column in columns.values()}
    for index, name in enumerate(table.header):
        if index not in read and name and name.lower() not in NOTES:
            near = difflib.get_close_matches(name, kind.like.split(","), 1, 0.5)
            hint = f"did you mean {shown(near[0])}?" if near else f"known are {kind.like}"
            table.fail(table.header_number, f"column {shown(name)} is not known; {hint} (for people: note)")
    missing = [name for name in kind.needed if name not in columns]
    if missing:
        told = ", ".join(_spelt(name, kind) for name in missing)
        table.fail(table.header_number, f"columns are missing: {told}; the header must be like {kind.like}")
    for what in ("length", "angle", "force", "moment"):
        alike = [column for column in columns.values() if column.kind == what]
        for other in alike[1:]:
            if other.factor != alike[0].factor:
                pair = f"{shown(alike[0].name)} and {shown(other.name)}"
                table.fail(table.header_number, f"mixed units: {pair}; keep to one unit of {what} in a table")


def _spelt(quantity: str, kind: Kind) -> str:
    """A quantity as the header should have it."""
    alike = [name for name in kind.like.split(",") if name.lower().startswith(quantity)]
    unit = next(iter(UNITS.get(kind.kinds[quantity], {})), "")
    return alike[0] if alike else f"{quantity}_{unit}".rstrip("_")


def _cells(table: TextTable) -> list[list[str]]:
    cells = []
    for row, number in zip(table.rows, table.numbers, strict=True):
        try:
            fields = next(csv.reader([row], strict=True))
        except csv.Error:
            table.fail(number, "a quotation mark is opened and not closed, or the row is too long")
        if len(fields) != len(table.header):
            table.fail(number, f"{len(fields)} fields where the header names {len(table.header)}")
        for name, text in zip(table.header, fields, strict=True):
            if not name and text.strip():
                table.fail(
                    number, f"{shown(text.strip())} stands in a column without a name; name it, or empty it"
                )
        cells.append(fields)
    return cells
