"""CSV tables whose header names the unit of every number: their lines, their columns and their values in SI.

`read_lines` splits a file into header, rows and comments; `find_columns` interprets the header; `read_rows` reads a
table by its schema, `write` writes one. The module does not depend on what the tables are for.
"""

import csv
import difflib
import io
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, NoReturn

import numpy as np
from numpy.typing import NDArray

from probedesign.core.errors import InputError, one_line, quoted
from probedesign.core.frames import Array

Frame = Literal["sensor", "base"]
FRAMES: dict[str, Frame] = {"sensor": "sensor", "base": "base"}  #: Frames by name, as a file or a user states them.

#: Factor to SI by kind of column and unit; case is ignored. A kind that is not here has no unit.
UNITS = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "force": {"N": 1.0, "mN": 1e-3},
    "moment": {"Nm": 1.0, "Nmm": 1e-3, "mNm": 1e-3},
    "gravity": {"m_s2": 1.0},
    "length": {"mm": 1e-3, "m": 1.0, "cm": 1e-2, "um": 1e-6},
    "angle": {"deg": 3.141592653589793 / 180.0, "rad": 1.0},
    "pixel": {"px": 1.0},
}
WRENCH = ("fx", "fy", "fz", "mx", "my", "mz")
WRENCH_KINDS = {**dict.fromkeys(WRENCH[:3], "force"), **dict.fromkeys(WRENCH[3:], "moment")}
WRENCH_ALIASES = {"tx": "mx", "ty": "my", "tz": "mz"}
#: Largest plausible value [s, N, N·m, m/s², m, rad, px]; a larger one is raw counts or a wrong unit. The largest
#: calibration of the Nano17 reads 50 N and 0.5 N·m; a clock that counts milliseconds since 1970 as seconds reads
#: 1.7e12; no laboratory is wider than 100 m, and no picture than a million pixels.
CEILING = {
    "time": 1e11, "force": 1000.0, "moment": 50.0, "gravity": 30.0, "length": 100.0, "angle": 100.0, "pixel": 1e6,
}  # fmt: skip
NUMBER = re.compile(r"\s*[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?\s*", re.ASCII)
NOTES = ("note", "notes", "comment", "remark")  #: Names of free-text columns, which are not read.
MAX_BYTES = 50_000_000
MAX_ROWS = 500_000
MAX_LINE = 1_000_000  #: Length that no line has [bytes]: a file with one is refused before it is read whole.


# lines


@dataclass(frozen=True)
class CsvLines:
    """Non-empty lines of a CSV file."""

    path: Path  #: of the file.
    header: list[str]  #: names of the columns.
    header_number: int  #: line of the file with the header.
    rows: list[str]  #: the lines after it.
    numbers: list[int]  #: line of the file of each row.
    ends_whole: bool  #: whether the file ends in a newline.
    comments: list[tuple[int, str]]  #: lines that begin with #, each with its line of the file.

    def fail(self, number: int, problem: str) -> NoReturn:
        """Raise the error of one line of the file."""
        raise InputError(f"{self.path}:{number}: {problem}")

    @property
    def frame(self) -> Frame | None:
        """Frame that a comment `# frame: ...` names; None if none does.

        Raises:
            InputError: a comment names another frame, or two.
        """
        frames: set[Frame] = set()
        for number, line in self.comments:
            named = re.match(r"\s*#\s*frame\s*[:=](.*)", line, re.IGNORECASE)
            if not named:
                continue
            name = named.group(1).strip().lower()
            if name not in FRAMES:
                self.fail(number, f"frame {quoted(name)} is not known; use sensor or base")
            frames.add(FRAMES[name])
        if len(frames) > 1:
            raise InputError(f"{self.path}: names two frames; a recording has one")
        return frames.pop() if frames else None


def read_lines(path: Path, what: str, like: str, max_bytes: int | None = None) -> CsvLines:
    """Read header, rows and comments of a file, without blank lines.

    Args:
        path: of a text file in UTF-8.
        what: name of such a file in messages.
        like: example of a header, for messages.
        max_bytes: a larger file is refused; None accepts any.

    Raises:
        InputError: the file cannot be read, is not text, is empty or too large.
    """
    text = read_text(path, what, max_bytes)
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    comments, filled = list[tuple[int, str]](), list[tuple[int, str]]()
    for i, line in enumerate(lines, 1):
        if line and not line.isspace():
            (comments if line.lstrip().startswith("#") else filled).append((i, line))
    if not filled:
        raise InputError(f"{path}: is empty; a {what} starts with the header {like}")
    header_number, header = filled[0]
    names = [name.strip().strip("\"'").strip() for name in header.split(",")]
    rows, numbers = [line for _, line in filled[1:]], [i for i, _ in filled[1:]]
    return CsvLines(path, names, header_number, rows, numbers, text.endswith(("\n", "\r")), comments)


def read_text(path: Path, what: str, max_bytes: int | None = None, kind: str = "CSV", remedy: str = "") -> str:
    """Read a text file.

    Args:
        path: see `read_lines`, as `what` and `max_bytes`.
        what: name of such a file.
        max_bytes: a larger file is refused.
        kind: format of the file, for messages.
        remedy: what to do if there is no such file.

    Raises:
        InputError: it cannot be read, is not text in UTF-8, or it or a line of it is too long.
    """
    chunks = list[bytes]()
    try:
        if max_bytes is not None and path.stat().st_size > max_bytes:
            raise InputError(f"{path}: is larger than {max_bytes / 1e6:g} MB, far too large for a {what}")
        with path.open("rb") as file:
            while chunk := file.read(MAX_LINE):
                if len(chunk) == MAX_LINE and not (b"\n" in chunk or b"\r" in chunk):
                    raise InputError(f"{path}: has a line of more than {MAX_LINE / 1e6:g} MB; a {what} is {kind}")
                chunks.append(chunk)
        text = b"".join(chunks).decode("utf-8-sig")  # Windows editors put a byte order mark first
    except FileNotFoundError:
        raise InputError(f"{one_line(str(path))}: no such {what}{remedy and f'; {remedy}'}") from None
    except UnicodeDecodeError:
        raise InputError(f"{path}: is not a text file in UTF-8; a {what} is {kind}") from None
    except InputError:
        raise
    except (OSError, ValueError) as error:  # ValueError: a NUL in the path
        raise InputError(one_line(f"{path}: cannot be read: {getattr(error, 'strerror', error)}")) from None
    if "\0" in text:
        raise InputError(f"{path}: is a binary file; a {what} is {kind}")
    return text


# columns


@dataclass(frozen=True)
class Column:
    """One column that is read."""

    quantity: str  #: name of the quantity.
    kind: str  #: of the quantity, a key of `UNITS` or a kind without unit.
    index: int  #: its position in a row.
    factor: float  #: to SI.
    name: str  #: as the header spells it.

    @property
    def ceiling(self) -> float:
        """Largest plausible value, in SI."""
        return CEILING[self.kind]


def find_columns(lines: CsvLines, kinds: Mapping[str, str], aliases: Mapping[str, str], like: str) -> dict[str, Column]:
    """Return the known columns of a header by quantity; others are left out.

    Args:
        lines: whose header is read.
        kinds: kind of each known quantity, in lower case.
        aliases: other names of quantities.
        like: example of a header, for messages.

    Raises:
        InputError: there is no header, or a column is doubled or without a known unit.
    """
    if all(NUMBER.fullmatch(name) for name in lines.header):
        lines.fail(lines.header_number, f"numbers without a header; the first line must be like {like}")
    found: dict[str, Column] = {}
    for index, name in enumerate(lines.header):
        column = _column(lines, index, name, kinds, aliases)
        if column is None:
            continue
        if column.quantity in found:
            pair = f"{quoted(found[column.quantity].name)} and {quoted(name)}"
            lines.fail(lines.header_number, f"columns {pair} are the same; keep one")
        found[column.quantity] = column
    return found


def _column(
    lines: CsvLines, index: int, name: str, kinds: Mapping[str, str], aliases: Mapping[str, str]
) -> Column | None:
    """Return the column of that name; None if its quantity is not known.

    The quantity is the longest known name that the column's begins with, followed by anything but a letter, and the
    unit may be spelt freely: `Fx_N`, `Fx (N)`, `Mx [N·mm]`. `Fx` alone is recognised too, and refused without a unit.
    """
    lower = name.lower()
    stems = [k for k in (*kinds, *aliases) if lower.startswith(k) and not lower[len(k) : len(k) + 1].isalpha()]
    if not stems:
        return None
    stem = max(stems, key=len)
    quantity = aliases.get(stem, stem)
    kind = kinds[quantity]
    unit = name[len(stem) :].strip(" _()[]")
    if kind not in UNITS:
        return None if unit else Column(quantity, kind, index, 1.0, name)
    factor = {_letters(known): factor for known, factor in UNITS[kind].items()}.get(_letters(unit))
    if factor is None:
        problem = f"unit {quoted(unit)} is not known" if unit else "names no unit"
        endings = ", ".join(f"_{known}" for known in UNITS[kind])
        lines.fail(lines.header_number, f"column {quoted(name)}: {problem}; end its name in one of {endings}")
    return Column(quantity, kind, index, factor, name)


def _letters(unit: str) -> str:
    return re.sub(r"[\W_]", "", unit.lower().replace("µ", "u"))


# rows


@dataclass(frozen=True)
class TableSchema:
    """Columns that a table may have."""

    what: str  #: name of such a table in messages.
    #: kind of each quantity by its name in the header; "name", "word" and "number" have no unit.
    kinds: Mapping[str, str]
    required: tuple[str, ...]  #: quantities that must have a column.
    like: str  #: example of a header, for messages.
    aliases: Mapping[str, str]  #: other names of quantities.


@dataclass(frozen=True)
class TableRows:
    """Cells of one table, strict about what a spreadsheet may get wrong."""

    lines: CsvLines  #: of the file.
    columns: dict[str, Column]  #: by quantity.
    cells: list[list[str]]  #: text of each row's cells.

    def __len__(self) -> int:
        return len(self.cells)

    def fail(self, row: int, problem: str) -> NoReturn:
        """Raise the error of one row."""
        self.lines.fail(self.lines.numbers[row], problem)

    def texts(self, quantity: str) -> list[str]:
        """Return the cells of a column without unit; empty texts if there is no such column."""
        column = self.columns.get(quantity)
        return [""] * len(self) if column is None else [cells[column.index].strip() for cells in self.cells]

    def numbers(self, *quantities: str) -> Array:
        """Return numbers in SI, (n, len(quantities)); NaN where a cell is empty or there is no such column.

        Raises:
            InputError: a cell is not a finite number, or not plausible.
        """
        return np.column_stack([self._numbers(quantity) for quantity in quantities])

    def _numbers(self, quantity: str) -> Array:
        column = self.columns.get(quantity)
        if column is None:
            return np.full(len(self), np.nan)
        values = [self._number(i, column, cells[column.index]) for i, cells in enumerate(self.cells)]
        return np.array(values) * column.factor

    def _number(self, row: int, column: Column, text: str) -> float:
        if not text or text.isspace():
            return float("nan")
        if not NUMBER.fullmatch(text) or abs(value := float(text)) == float("inf"):
            remedy = "write a number with a decimal point; only an optional cell may be empty"
            self.fail(row, f"{column.name} = {quoted(text.strip())} is not a finite number; {remedy}")
        if abs(value * column.factor) > column.ceiling:
            self.fail(row, f"{column.name} = {value:g} is implausibly large; raw counts or a wrong unit?")
        return value

    def required(self, *quantities: str) -> Array:
        """Return numbers of which none may be missing, (n, len(quantities)).

        Raises:
            InputError: a cell is empty or not a finite number.
        """
        values = self.numbers(*quantities)
        for row, column in np.argwhere(np.isnan(values))[:1]:
            self.fail(int(row), f"{self.columns[quantities[column]].name} is empty; write the number")
        return values

    def std(self, quantity: str, needed: NDArray[np.bool_], missing: str) -> Array:
        """Return a standard deviation of each row, (n,); NaN where its cell is empty.

        Args:
            quantity: its column.
            needed: rows that must have one, (n,).
            missing: message, with its remedy, for a row that lacks one.

        Raises:
            InputError: one is not positive, or a needed one is missing.
        """
        values = self.numbers(quantity)[:, 0]
        for row in np.flatnonzero(values <= 0.0)[:1]:
            column = self.columns[quantity]
            cell = f"{column.name} = {self.cells[row][column.index].strip()}"
            self.fail(int(row), f"{cell} is not a standard deviation; write a positive number")
        for row in np.flatnonzero(needed & np.isnan(values))[:1]:
            self.fail(int(row), missing)
        return values

    def all_or_none(self, *quantities: str) -> tuple[Array, NDArray[np.bool_]]:
        """Return numbers of which a row has all or none, (n, len(quantities)), and which rows have them, (n,).

        Raises:
            InputError: a row has only some.
        """
        values = self.numbers(*quantities)
        empty = np.isnan(values)
        for row in np.flatnonzero(empty.any(axis=1) & ~empty.all(axis=1))[:1]:
            lacking = quantities[int(np.argmax(empty[row]))]
            absent = self.columns[lacking].name if lacking in self.columns else f"a column {lacking}"
            given = self.columns[quantities[int(np.argmin(empty[row]))]].name
            self.fail(int(row), f"{given} is given without {absent}; give all of them or none")
        return values, np.asarray(~empty.any(axis=1))

    def check_unique(self, keys: list[tuple[object, ...]], describe: Callable[[int], str]) -> None:
        """Refuse two rows of the same key.

        Raises:
            InputError: there are two.
        """
        first: dict[tuple[object, ...], int] = {}
        for row, key in enumerate(keys):
            before = first.setdefault(key, row)
            if before != row:
                line = self.lines.numbers[before]
                self.fail(row, f"{describe(row)} occurs twice, first in line {line}; keep one")


def read_rows(path: Path, schema: TableSchema) -> TableRows:
    """Read one table.

    Raises:
        InputError: it cannot be read, or its columns or the number of cells in a row are wrong.
    """
    lines = read_lines(path, schema.what, schema.like, MAX_BYTES)
    if len(lines.header) == 1 and ";" in lines.header[0]:
        lines.fail(lines.header_number, "semicolons between the columns; export it with commas and decimal points")
    # spreadsheets leave rows of nothing but commas at the end
    filled = [i for i, row in enumerate(lines.rows) if row.strip(", \t")]
    lines = replace(lines, rows=[lines.rows[i] for i in filled], numbers=[lines.numbers[i] for i in filled])
    columns = find_columns(lines, schema.kinds, schema.aliases, schema.like)
    _check_columns(lines, columns, schema)
    if not lines.rows:
        raise InputError(f"{path}: has a header and no rows")
    if len(lines.rows) > MAX_ROWS:
        raise InputError(f"{path}: has {len(lines.rows)} rows, far too many for a {schema.what}")
    cells = []
    for text, number in zip(lines.rows, lines.numbers, strict=True):
        try:
            fields = next(csv.reader([text], strict=True))
        except csv.Error:
            lines.fail(number, "a quotation mark is opened and not closed, or the row is too long")
        if len(fields) != len(lines.header):
            lines.fail(number, f"the row has {len(fields)} values where the header names {len(lines.header)}")
        for name, cell in zip(lines.header, map(str.strip, fields), strict=True):
            if cell and not name:
                problem = "is in a column without a name; name the column, or empty the cell"
                lines.fail(number, f"{quoted(cell)} {problem}")
        cells.append(fields)
    return TableRows(lines, columns, cells)


def _check_columns(lines: CsvLines, columns: dict[str, Column], schema: TableSchema) -> None:
    """Refuse missing and unknown columns, and one kind of quantity in two units."""
    read = {column.index for column in columns.values()}
    for index, name in enumerate(lines.header):
        if index not in read and name and name.lower() not in NOTES:
            near = difflib.get_close_matches(name, schema.like.split(","), 1, 0.5)
            hint = f"did you mean {quoted(near[0])}?" if near else f"known are {schema.like}"
            lines.fail(lines.header_number, f"column {quoted(name)} is not known; {hint} (for free text: note)")
    missing = [name for name in schema.required if name not in columns]
    if missing:
        spelt = {name: f"{name}_{next(iter(UNITS.get(schema.kinds[name], {})), '')}".rstrip("_") for name in missing}
        for example in reversed(schema.like.split(",")):
            spelt |= {name: example for name in missing if example.lower().startswith(name)}
        names = ", ".join(spelt.values())
        lines.fail(lines.header_number, f"columns are missing: {names}; the header must be like {schema.like}")
    for kind in ("length", "angle", "force", "moment"):
        alike = [column for column in columns.values() if column.kind == kind]
        for other in alike[1:]:
            if other.factor != alike[0].factor:
                pair = f"{quoted(alike[0].name)} and {quoted(other.name)}"
                lines.fail(lines.header_number, f"mixed units: {pair}; keep to one unit of {kind} in a table")


# writing


def write(columns: Sequence[str], rows: Iterable[Mapping[str, Any]], spec: str = "") -> bytes:
    """Return a table as CSV in UTF-8: a header and a line for each row.

    Args:
        columns: names of the columns.
        rows: their values by column; None and a missing value become empty cells, other keys are ignored.
        spec: format of floating-point numbers; by default all digits that distinguish them.
    """
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, restval="", extrasaction="ignore", lineterminator="\n")
    writer.writeheader()
    for row in rows:
        writer.writerow({name: f"{v:{spec}}" if isinstance(v, float) else v for name, v in row.items()})
    return text.getvalue().encode()
