"""Recordings of a wrench sensor: CSV whose header names every column's unit. See docs/recording-format.md.

Nothing is guessed: a column without a unit, a number that is none and a time that runs backward are
errors that name the line. Only what says itself is mended: half a last line is dropped, gaps are counted.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import numpy as np

from probedesign.core.csv_tables import CEILING, NUMBER, WRENCH, Column, CsvLines, Frame, read_lines, shown
from probedesign.errors import InputError
from probedesign.frames import Array
from probedesign.live.recording_columns import HEADER, columns_of

GAP = 1.5
"""A step longer than this many median steps has a sample missing."""


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


def read_recording(path: str | Path) -> Recording:
    """Read a recording.

    Args:
        path: CSV with named units, as docs/recording-format.md says.

    Returns:
        The recording in SI.

    Raises:
        InputError: the file cannot be read or says something wrong; one line with the line of the file.
    """
    table = read_lines(Path(path), "recording", HEADER)
    columns = columns_of(table)
    rows, notes = _whole_rows(table, columns)
    if not rows:
        raise InputError(f"{path}: holds no samples, only a header")
    values = _numbers(table, rows, columns)
    _check(table, columns, values)
    gravity = values[:, 7:] if values.shape[1] > 7 else None
    gaps, missing = gaps_in(values[:, 0])
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


def _whole_rows(table: CsvLines, columns: list[Column]) -> tuple[list[str], tuple[str, ...]]:
    """The rows with the right number of fields, without half a line at the end, and notes for the user."""
    rows, notes = table.rows, []
    ignored = [shown(name) for i, name in enumerate(table.header) if i not in {c.index for c in columns}]
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


def _is_cut(row: str, table: CsvLines, columns: list[Column]) -> bool:
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


def _numbers(table: CsvLines, rows: list[str], columns: list[Column]) -> Array:
    """The columns' numbers in SI, (n, len(columns)); only if one is none is it searched for."""
    index = [column.index for column in columns]
    try:
        values = np.loadtxt(rows, delimiter=",", usecols=index, comments=None, ndmin=2)
    except ValueError:
        values = np.full((1, 1), np.nan)
    if not np.isfinite(values).all():
        _name_bad_number(table, rows, columns)
    return np.asarray(values * [column.factor for column in columns])


def _name_bad_number(table: CsvLines, rows: list[str], columns: list[Column]) -> NoReturn:
    """Raise the error of the first field that is no finite number."""
    for row, number in zip(rows, table.numbers, strict=False):
        fields = row.split(",")
        for column in columns:
            text = fields[column.index].strip()
            if not NUMBER.fullmatch(text) or not np.isfinite(float(text)):
                remedy = "write the value or take the line out"
                table.fail(number, f"{column.name} = {shown(text)} is not a finite number; {remedy}")
    raise InputError(f"{table.path}: its rows cannot be read as numbers")


def _check(table: CsvLines, columns: list[Column], values: Array) -> None:
    """Refuse values that no sensor reads, and time that runs backward."""
    absurd = np.abs(values) > [column.ceiling for column in columns]
    if absurd.any():
        i, j = np.argwhere(absurd)[0]
        value = f"{columns[j].name} = {values[i, j] / columns[j].factor:g}"
        table.fail(table.numbers[i], f"{value} is more than any sensor reads; raw counts or a wrong unit?")
    backward = np.diff(values[:, 0]) < 0
    if backward.any():
        i = int(np.argmax(backward)) + 1
        times = f"from {values[i - 1, 0]:.9g} s to {values[i, 0]:.9g} s"
        table.fail(table.numbers[i], f"time runs backward, {times}; sort the rows or split the recording")


def check_values(path: Path, recording: Recording) -> None:
    """Refuse a recording with values that no sensor reads.

    Raises:
        InputError: a force or a moment is absurd; the line tells its time.
    """
    ceiling = np.repeat([CEILING["force"], CEILING["moment"]], 3)
    absurd = np.argwhere(~(np.abs(recording.wrench) <= ceiling))
    if len(absurd):
        i, j = absurd[0]
        value = f"{WRENCH[j].capitalize()} = {recording.wrench[i, j]:g} {'N' if j < 3 else 'N·m'}"
        raise InputError(
            f"{path}: {value} at {recording.time[i]:.9g} s is no reading; raw counts or a wrong unit?"
        )


def gaps_in(time: Array) -> tuple[int, int]:
    """How many gaps there are in times [s], (n,), and how many samples they would have held."""
    steps = np.diff(time)
    median = float(np.median(steps)) if len(steps) else 0.0
    if median == 0.0:
        return 0, 0  # several samples to a tick of a coarse clock: no rate to speak of
    long = steps[steps > GAP * median]
    with np.errstate(over="ignore"):
        missing = np.clip(np.rint(long / median) - 1.0, 1.0, 1e9)
    return len(long), int(missing.sum())
