"""Recordings of a wrench sensor: CSV whose header names every column's unit. See docs/recording-format.md.

Nothing is guessed: a column without a unit, a number that is none and a time that runs backward are
errors that name the line. Only what says itself is mended: half a last line is dropped, gaps are counted.
"""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray

from probedesign.errors import InputError

Array = NDArray[np.float64]
Frame = Literal["sensor", "base"]

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

GAP = 1.5
"""A step longer than this many median steps has a sample missing."""

NUMBER = re.compile(r"\s*[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?\s*", re.ASCII)


@dataclass(frozen=True)
class Recording:
    """What a sensor read, in SI.

    Attributes:
        time: of each sample [s], (n,), never decreasing.
        wrench: [N, N·m], (n, 6), about the origin and in the axes of `frame`.
        frame: "sensor" or "base".
        gravity_base: vector of gravity in base axes [m/s²], (n, 3), if the file holds it.
        gaps: steps longer than 1.5 median steps.
        missing_samples: how many samples those gaps would have held.
        dropped_lines: lines left out: half a line at the end.
        notes: what a user should know of the above, each one line.
    """

    time: Array
    wrench: Array
    frame: Frame = "sensor"
    gravity_base: Array | None = None
    gaps: int = 0
    missing_samples: int = 0
    dropped_lines: int = 0
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Table:
    """The lines of a recording that hold something."""

    path: Path
    header: list[str]
    header_number: int
    rows: list[str]
    numbers: list[int]  # line of the file of each row
    ends_whole: bool  # with a newline
    frame: Frame

    def fail(self, number: int, problem: str) -> NoReturn:
        raise InputError(f"{self.path}:{number}: {problem}")


@dataclass(frozen=True)
class _Column:
    """One column that we read."""

    quantity: str
    index: int
    factor: float
    name: str


def read_recording(path: str | Path) -> Recording:
    """Read a recording.

    Args:
        path: CSV with named units, as docs/recording-format.md says.

    Returns:
        The recording in SI.

    Raises:
        InputError: the file cannot be read or says something wrong; one line with the line of the file.
    """
    table = _lines(Path(path))
    columns = _columns(table)
    rows, notes = _whole_rows(table, columns)
    if not rows:
        raise InputError(f"{path}: holds no samples, only a header")
    values = _numbers(table, rows, columns)
    _check(table, columns, values)
    gravity = values[:, 7:] if values.shape[1] > 7 else None
    gaps, missing = _gaps(values[:, 0])
    if gaps:
        notes += (f"{missing} samples are missing in {gaps} gaps",)
    return Recording(
        time=values[:, 0],
        wrench=values[:, 1:7],
        frame=table.frame,
        gravity_base=gravity,
        gaps=gaps,
        missing_samples=missing,
        dropped_lines=len(table.rows) - len(rows),
        notes=notes,
    )


def _lines(path: Path) -> _Table:
    """Header, rows and frame of the file, without blank lines and comments."""
    text = _text(path)
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    held = [(i, line) for i, line in enumerate(lines, 1) if line and not line.isspace()]
    comments = [(i, line) for i, line in held if line.lstrip().startswith("#")]
    frame = _frame(path, comments)
    if comments:
        held = [(i, line) for i, line in held if not line.lstrip().startswith("#")]
    if not held:
        raise InputError(f"{path}: is empty; a recording starts with the header {HEADER}")
    header_number, header = held[0]
    names = [name.strip().strip("\"'").strip() for name in header.split(",")]
    rows, numbers = [line for _, line in held[1:]], [i for i, _ in held[1:]]
    return _Table(path, names, header_number, rows, numbers, text.endswith(("\n", "\r")), frame)


def _text(path: Path) -> str:
    try:
        text = path.read_bytes().decode("utf-8-sig")
    except FileNotFoundError:
        raise InputError(f"{path}: no such recording") from None
    except UnicodeDecodeError:
        raise InputError(f"{path}: is not a text file in UTF-8; a recording is CSV") from None
    except (OSError, ValueError) as error:  # ValueError: a NUL in the path
        raise InputError(f"{path}: cannot be read: {getattr(error, 'strerror', error)}") from None
    if "\0" in text:
        raise InputError(f"{path}: is a binary file; a recording is CSV")
    return text


def _frame(path: Path, comments: list[tuple[int, str]]) -> Frame:
    """The frame that a comment `# frame: ...` names; the sensor's own if none does."""
    frames: set[Frame] = set()
    for number, line in comments:
        said = re.match(r"\s*#\s*frame\s*[:=](.*)", line, re.IGNORECASE)
        if not said:
            continue
        match said.group(1).strip().lower():
            case "sensor":
                frames.add("sensor")
            case "base":
                frames.add("base")
            case other:
                raise InputError(f"{path}:{number}: frame {_shown(other)} is not known; say sensor or base")
    if len(frames) > 1:
        raise InputError(f"{path}: names two frames; a recording has one")
    return frames.pop() if frames else "sensor"


def _columns(table: _Table) -> list[_Column]:
    """The columns to read: time, wrench and, if they are there, gravity."""
    if all(NUMBER.fullmatch(name) for name in table.header):
        table.fail(table.header_number, f"numbers without a header; the first line must be like {HEADER}")
    found: dict[str, _Column] = {}
    for index, name in enumerate(table.header):
        column = _column(table, index, name)
        if column is None:
            continue
        if column.quantity in found:
            other = found[column.quantity].name
            table.fail(
                table.header_number, f"columns {_shown(other)} and {_shown(name)} are the same; keep one"
            )
        found[column.quantity] = column
    wanted = ("time", *WRENCH, *(GRAVITY if found.keys() & set(GRAVITY) else ()))
    names = f"{HEADER},{GRAVITY_HEADER}".split(",")
    missing = [name for quantity, name in zip(wanted, names, strict=False) if quantity not in found]
    if missing:
        told = ", ".join(missing)
        table.fail(table.header_number, f"columns are missing: {told}; the header must be like {HEADER}")
    return [found[quantity] for quantity in wanted]


def _column(table: _Table, index: int, name: str) -> _Column | None:
    """What a column of that name holds; None if it is nothing of ours.

    The name's stem may end at anything but a letter, so that `Fx`, `Fx (N)` and `Fx[N]` are recognised and
    refused for saying their unit in no way or in another.
    """
    stem = re.match(r"[a-z]*", name.lower()).group()  # type: ignore[union-attr]  # matches everything
    quantity = ALIASES.get(stem, stem)
    if quantity not in KIND:
        return None
    units = UNITS[KIND[quantity]]
    unit = name[len(stem) :]
    factor = {f"_{known}".lower(): factor for known, factor in units.items()}.get(unit.lower())
    if factor is None:
        says = f"unit {_shown(unit[1:])} is not known" if unit.startswith("_") else "names no unit"
        endings = ", ".join(f"_{known}" for known in units)
        table.fail(table.header_number, f"column {_shown(name)}: {says}; end its name in one of {endings}")
    return _Column(quantity, index, factor, name)


def _whole_rows(table: _Table, columns: list[_Column]) -> tuple[list[str], tuple[str, ...]]:
    """The rows with the right number of fields, without half a line at the end, and notes for the user."""
    rows, notes = table.rows, []
    ignored = [_shown(name) for i, name in enumerate(table.header) if i not in {c.index for c in columns}]
    if ignored:
        notes.append(f"columns not read: {', '.join(ignored)[:200]}")
    if rows and not table.ends_whole:
        last = f"line {table.numbers[-1]}"
        if _is_cut(rows[-1], table, columns):
            rows = rows[:-1]
            notes.append(f"{last} is half a line at the end: dropped")
        else:
            notes.append(f"{last} does not end in a newline: kept, but its last number may be cut short")
    commas = len(table.header) - 1
    for row, number in zip(rows, table.numbers, strict=False):
        if row.count(",") != commas:
            table.fail(number, f"{row.count(',') + 1} fields where the header names {commas + 1}")
    return rows, tuple(notes)


def _is_cut(row: str, table: _Table, columns: list[_Column]) -> bool:
    """Whether a last line without a newline lacks fields or ends in part of a number."""
    fields = row.split(",")
    if len(fields) < len(table.header):
        return True
    last_is_read = len(table.header) - 1 in {column.index for column in columns}
    return last_is_read and not _is_float(fields[-1])


def _is_float(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _numbers(table: _Table, rows: list[str], columns: list[_Column]) -> Array:
    """The columns' numbers in SI, (n, len(columns)); only if one is none is it searched for."""
    index = [column.index for column in columns]
    try:
        values = np.loadtxt(rows, delimiter=",", usecols=index, comments=None, ndmin=2)
    except ValueError:
        values = np.full((1, 1), np.nan)
    if not np.isfinite(values).all():
        _name_bad_number(table, rows, columns)
    return np.asarray(values * [column.factor for column in columns])


def _name_bad_number(table: _Table, rows: list[str], columns: list[_Column]) -> NoReturn:
    """Raise the error of the first field that is no finite number."""
    for row, number in zip(rows, table.numbers, strict=False):
        fields = row.split(",")
        for column in columns:
            text = fields[column.index].strip()
            if not NUMBER.fullmatch(text) or not np.isfinite(float(text)):
                remedy = "write the value or take the line out"
                table.fail(number, f"{column.name} = {_shown(text)} is not a finite number; {remedy}")
    raise InputError(f"{table.path}: its rows cannot be read as numbers")


def _check(table: _Table, columns: list[_Column], values: Array) -> None:
    """Refuse values that no sensor reads, and time that runs backward."""
    ceilings = np.array([CEILING[KIND[column.quantity]] for column in columns])
    absurd = np.abs(values) > ceilings
    if absurd.any():
        i, j = np.argwhere(absurd)[0]
        column = columns[j]
        value = f"{column.name} = {values[i, j] / column.factor:g}"
        table.fail(table.numbers[i], f"{value} is more than any sensor reads; raw counts or a wrong unit?")
    backward = np.diff(values[:, 0]) < 0
    if backward.any():
        i = int(np.argmax(backward)) + 1
        times = f"{values[i - 1, 0]:.9g} s to {values[i, 0]:.9g} s"
        table.fail(
            table.numbers[i], f"time runs backward, from {times}; sort the rows or split the recording"
        )


def _gaps(time: Array) -> tuple[int, int]:
    """How many gaps, and how many samples they would have held."""
    steps = np.diff(time)
    median = float(np.median(steps)) if len(steps) else 0.0
    if median == 0.0:
        return 0, 0  # several samples to a tick of a coarse clock: no rate to speak of
    long = steps[steps > GAP * median]
    with np.errstate(over="ignore"):
        missing = np.clip(np.rint(long / median) - 1.0, 1.0, 1e9)
    return len(long), int(missing.sum())


def _shown(text: str) -> str:
    """A piece of the file as it may stand in a message: quoted, escaped, never long."""
    shown = repr(text)
    return shown if len(shown) <= 40 else shown[:37] + "..."


def write_recording(
    path: str | Path,
    time: ArrayLike,
    wrench: ArrayLike,
    frame: Frame = "sensor",
    gravity_base: ArrayLike | None = None,
) -> None:
    """Write a recording that reads back exactly; a file that stands there is replaced.

    Args:
        path: where.
        time: of each sample [s], (n,).
        wrench: [N, N·m], (n, 6), in the axes of `frame`.
        frame: "sensor" or "base".
        gravity_base: vector of gravity in base axes [m/s²], (n, 3).

    Raises:
        InputError: the file cannot be written.
        ValueError: the arrays do not fit together.
    """
    blocks = [np.asarray(time, dtype=float).reshape(-1, 1), np.asarray(wrench, dtype=float).reshape(-1, 6)]
    header = HEADER
    if gravity_base is not None:
        blocks.append(np.asarray(gravity_base, dtype=float).reshape(-1, 3))
        header += f",{GRAVITY_HEADER}"
    rows = np.hstack(blocks).tolist()
    try:
        with Path(path).open("w", encoding="utf-8", newline="\n") as file:
            file.write(f"# frame: {frame}\n{header}\n")
            file.writelines(",".join(map(repr, row)) + "\n" for row in rows)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from None
