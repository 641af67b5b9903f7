"""The columns of a recording: time, wrench and, if the file holds it, gravity."""

from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Literal, NoReturn, TextIO

import numpy as np
from numpy.typing import ArrayLike

from probedesign.errors import InputError
from probedesign.frames import Array
from probedesign.live.poses.track import TimedPose
from probedesign.live.processing.blocks import Block
from probedesign.live.processing.estimates import Answer
from probedesign.live.recordings.append_file import Pieces
from probedesign.tables.columns import (
    CEILING,
    NUMBER,
    WRENCH,
    WRENCH_ALIASES,
    WRENCH_KINDS,
    Column,
    find_columns,
)
from probedesign.tables.text_table import Frame, TextTable, read_table, shown

GRAVITY = ("gx", "gy", "gz")
KINDS = {"time": "time", **WRENCH_KINDS, **dict.fromkeys(GRAVITY, "gravity")}
ALIASES = {"t": "time", "timestamp": "time", **WRENCH_ALIASES}

HEADER = "time_s,Fx_N,Fy_N,Fz_N,Mx_Nm,My_Nm,Mz_Nm"
GRAVITY_HEADER = "gx_m_s2,gy_m_s2,gz_m_s2"


def columns_of(table: TextTable) -> list[Column]:
    """The columns to read: time, wrench and, if they are there, gravity.

    Raises:
        InputError: a column is missing, doubled or without a known unit.
    """
    found = find_columns(table, KINDS, ALIASES, HEADER)
    wanted = ("time", *WRENCH, *(GRAVITY if found.keys() & set(GRAVITY) else ()))
    names = f"{HEADER},{GRAVITY_HEADER}".split(",")
    missing = [name for quantity, name in zip(wanted, names, strict=False) if quantity not in found]
    if missing:
        told = ", ".join(missing)
        table.fail(table.header_number, f"columns are missing: {told}; the header must be like {HEADER}")
    return [found[quantity] for quantity in wanted]


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
    table = read_table(Path(path), "recording", HEADER)
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


def _whole_rows(table: TextTable, columns: list[Column]) -> tuple[list[str], tuple[str, ...]]:
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


def _is_cut(row: str, table: TextTable, columns: list[Column]) -> bool:
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


def _numbers(table: TextTable, rows: list[str], columns: list[Column]) -> Array:
    """The columns' numbers in SI, (n, len(columns)); only if one is none is it searched for."""
    index = [column.index for column in columns]
    try:
        values = np.loadtxt(rows, delimiter=",", usecols=index, comments=None, ndmin=2)
    except ValueError:
        values = np.full((1, 1), np.nan)
    if not np.isfinite(values).all():
        _name_bad_number(table, rows, columns)
    return np.asarray(values * [column.factor for column in columns])


def _name_bad_number(table: TextTable, rows: list[str], columns: list[Column]) -> NoReturn:
    """Raise the error of the first field that is no finite number."""
    for row, number in zip(rows, table.numbers, strict=False):
        fields = row.split(",")
        for column in columns:
            text = fields[column.index].strip()
            if not NUMBER.fullmatch(text) or not np.isfinite(float(text)):
                remedy = "write the value or take the line out"
                table.fail(number, f"{column.name} = {shown(text)} is not a finite number; {remedy}")
    raise InputError(f"{table.path}: its rows cannot be read as numbers")


def _check(table: TextTable, columns: list[Column], values: Array) -> None:
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


class Recorder:
    """A recording that grows by whole lines, so that whatever ends the program leaves a readable file.

    Use it as a context manager.
    """

    def __init__(
        self, path: str | Path, *, frame: Frame = "sensor", gravity: bool = True, force: bool = False
    ) -> None:
        """Open the file and write its header.

        Args:
            path: where; its folder is made if missing.
            frame: of the wrenches, "sensor" or "base".
            gravity: whether every line ends in the vector of gravity.
            force: replace a file that stands there.

        Raises:
            InputError: the file exists and `force` is not said, or it cannot be written.
        """
        header = f"{HEADER},{GRAVITY_HEADER}" if gravity else HEADER
        self._file = _open_text(Path(path), "w" if force else "x")
        self._file.write(f"# frame: {frame}\n{header}\n")

    def write(self, time: float, wrench: ArrayLike, gravity_base: ArrayLike = ()) -> None:
        """Add a line.

        Args:
            time: [s].
            wrench: [N, N·m], (6,).
            gravity_base: vector of gravity in base axes [m/s²], (3,), if the recording holds it.
        """
        values = np.concatenate([[time], wrench, gravity_base]).tolist()
        self._file.write(",".join(map(repr, values)) + "\n")

    def __enter__(self) -> "Recorder":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.close()


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
    times = np.asarray(time, dtype=float).reshape(-1)
    wrenches = np.asarray(wrench, dtype=float).reshape(-1, 6)
    shape = (-1, 3) if gravity_base is not None else (len(times), 0)
    gravities = np.asarray(() if gravity_base is None else gravity_base, dtype=float).reshape(shape)
    lines = list(zip(times, wrenches, gravities, strict=True))
    with Recorder(path, frame=frame, gravity=gravity_base is not None, force=True) as recorder:
        for line in lines:
            recorder.write(*line)


def _open_text(path: Path, mode: Literal["w", "x"]) -> TextIO:
    """The file, buffered by lines."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        return path.open(mode, encoding="utf-8", newline="\n", buffering=1)
    except FileExistsError:
        raise InputError(f"{path}: exists; say --force to replace it, or name another file") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from None


class CsvFile:
    """A recording that grows by whole lines. A `File`: called from one thread.

    It holds raw readings and nothing else; those with a fault are left out and make a gap.
    """

    def __init__(self, path: Path, force: bool = False) -> None:
        """Make the file and write its header.

        Args:
            path: where; its folder is made if missing.
            force: replace a file that stands there.

        Raises:
            InputError: the file exists and `force` is not said, or it cannot be written.
        """
        self._pieces = Pieces(path, force)
        self._pieces.write(f"# frame: sensor\n{HEADER},{GRAVITY_HEADER}\n".encode())
        try:
            self._pieces.flush()
        except OSError:
            self._pieces.abandon()
            raise

    def read(self, block: Block) -> None:
        """A line a reading."""
        if block.fault:
            return
        gravity = "".join(f",{value!r}" for value in block.gravity_base.tolist())
        rows = zip(block.time.tolist(), block.wrench_sensor.tolist(), strict=True)
        lines = [",".join(map(repr, (time, *wrench))) + gravity for time, wrench in rows]
        self._pieces.write("".join(f"{line}\n" for line in lines).encode())
        self._pieces.flush()  # so little that it need not wait for more

    def answered(self, answer: Answer) -> None:
        """Only what is raw stands in CSV."""

    def posed(self, pose: TimedPose) -> None:
        """Only what is raw stands in CSV."""

    def told(self, time: float, line: str) -> None:
        """Only what is raw stands in CSV."""

    def left_out(self, readings: int, others: int) -> None:
        """A comment."""
        self._pieces.write(f"# the disk was too slow: {readings} readings left out here\n".encode())

    def flush(self) -> None:
        """Hand what waits to the operating system."""
        self._pieces.flush()

    def close(self) -> None:
        """Write what waits, and close."""
        try:
            self._pieces.flush()
        finally:
            self._pieces.close()
