"""Recordings of a wrench sensor as CSV, with a unit in every column name.

Reading is strict: a column without unit, an invalid number or decreasing time is an error that names the line. Only
unambiguous damage is repaired: an incomplete last line is dropped, and gaps are counted.

Source: docs/recording-format.md.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from probedesign.core import csv_tables
from probedesign.core.csv_tables import WRENCH, Column, CsvLines, Frame, TableRows
from probedesign.core.errors import InputError, one_line, quoted
from probedesign.core.files import write_atomically
from probedesign.core.frames import Array
from probedesign.live.blocks import Block
from probedesign.live.outputs.sinks import Sink
from probedesign.live.recordings import AppendFile

GRAVITY = ("gx", "gy", "gz")
KINDS = {"time": "time", **csv_tables.WRENCH_KINDS, **dict.fromkeys(GRAVITY, "gravity")}
ALIASES = {"t": "time", "timestamp": "time", **csv_tables.WRENCH_ALIASES}

CSV_HEADER = "time_s,Fx_N,Fy_N,Fz_N,Mx_Nm,My_Nm,Mz_Nm"
GRAVITY_HEADER = "gx_m_s2,gy_m_s2,gz_m_s2"
FAULT = "fault"  #: Optional column with the fault of a reading as text; empty if there is none.
_NO_DELIMITERS = str.maketrans(',"', ";'")


GAP = 1.5  #: Factor of the median interval above which an interval counts as a gap.


@dataclass(frozen=True)
class Recording:
    """Readings of a recording, in SI units."""

    time: Array  #: time of each sample [s], (n,), not decreasing.
    wrench: Array  #: wrenches [N, N·m], (n, 6), about the origin and in the axes of `frame`.
    frame: Frame = "sensor"  #: "sensor" or "base".
    gravity_base: Array | None = None  #: gravity vector in base axes [m/s²], (n, 3), if the file contains it.
    notes: tuple[str, ...] = ()  #: notes for the user, one line each.
    damage: tuple[str, ...] = ()  #: what is missing in it, one line each: samples in gaps, an incomplete last line.
    faults: tuple[str, ...] = ()  #: fault of each reading, (n,), empty if none; empty if the file has no such column.


def read_recording(path: str | Path) -> Recording:
    """Read a recording, in SI units, from CSV with units in its column names, see docs/recording-format.md.

    Raises:
        InputError: the file cannot be read or is invalid; the message names the line.
    """
    table = csv_tables.read_lines(Path(path), "recording", CSV_HEADER)
    known = csv_tables.find_columns(table, KINDS, ALIASES, CSV_HEADER)
    wanted = ("time", *WRENCH, *(GRAVITY if known.keys() & set(GRAVITY) else ()))
    names = f"{CSV_HEADER},{GRAVITY_HEADER}".split(",")
    if absent := [name for quantity, name in zip(wanted, names, strict=False) if quantity not in known]:
        problem = f"columns are missing: {', '.join(absent)}; the header must be like {CSV_HEADER}"
        table.fail(table.header_number, problem)
    columns = {quantity: known[quantity] for quantity in wanted}
    rows, notes, damage = table.rows, list[str](), list[str]()
    read = {column.index for column in columns.values()}
    index = next((i for i, name in enumerate(table.header) if name.strip().casefold() == FAULT), None)
    if ignored := [quoted(name) for i, name in enumerate(table.header) if i not in {*read, index}]:
        notes.append(f"columns not read: {', '.join(ignored)[:200]}")
    if rows and not table.ends_whole:
        last = f"line {table.numbers[-1]}"
        if _is_cut(rows[-1], table, read):
            rows = rows[:-1]
            damage.append(f"{last} is incomplete at the end: dropped")
        else:
            notes.append(f"{last} does not end in a newline: kept, but its last number may be truncated")
    commas = len(table.header) - 1
    for row, number in zip(rows, table.numbers, strict=False):
        if row.count(",") != commas:
            table.fail(number, f"the row has {row.count(',') + 1} values where the header names {commas + 1}")
    if not rows:
        raise InputError(f"{path}: no samples, only a header")
    faults = () if index is None else tuple(one_line(row.split(",")[index], 200) for row in rows)
    values = _numeric_columns(table, rows, columns, faults)
    gaps, missing = gaps_in(values[:, 0])
    if gaps:
        damage.append(f"{missing} samples are missing in {gaps} gaps")
    gravity = values[:, 7:] if values.shape[1] > 7 else None
    return Recording(
        values[:, 0], values[:, 1:7], table.frame or "sensor", gravity, tuple(notes), tuple(damage), faults
    )


def _is_cut(row: str, table: CsvLines, read: set[int]) -> bool:
    """Return whether a last line without newline has too few fields or ends in part of a number that is read."""
    fields = row.split(",")
    if len(fields) >= len(table.header) and len(table.header) - 1 not in read:
        return False
    try:
        float(fields[-1])
    except ValueError:
        return True
    return len(fields) < len(table.header)


def _numeric_columns(table: CsvLines, rows: list[str], columns: dict[str, Column], faults: tuple[str, ...]) -> Array:
    """Return the columns in SI units, (n, len(columns)); what is invalid is located only if there is anything.

    A reading with a fault may have any wrench, but must have a time.
    """
    read = list(columns.values())
    try:
        index = [column.index for column in read]
        values = np.loadtxt(rows, delimiter=",", usecols=index, comments=None, ndmin=2)
    except ValueError:
        values = np.full((len(rows), len(read)), np.nan)
    values = np.asarray(values * [column.factor for column in read])
    plausible = np.abs(values) <= [column.ceiling for column in read]
    healthy = [i for i in range(len(rows)) if not faults or not faults[i]]
    if not plausible[:, 0].all() or not plausible[healthy].all():
        for chosen, quantities in ((range(len(rows)), ["time"]), (healthy, list(columns))):
            lines = replace(table, numbers=[table.numbers[i] for i in chosen])
            TableRows(lines, columns, [rows[i].split(",") for i in chosen]).required(*quantities)
        raise InputError(f"{table.path}: its rows cannot be read as numbers")
    backward = np.diff(values[:, 0]) < 0
    if backward.any():
        i = int(np.argmax(backward)) + 1
        times = f"from {values[i - 1, 0]:.9g} s to {values[i, 0]:.9g} s"
        table.fail(table.numbers[i], f"time decreases, {times}; sort the rows or split the recording")
    return values


def gaps_in(time: Array) -> tuple[int, int]:
    """Return the number of gaps in times [s], (n,), and the number of samples missing in them."""
    steps = np.diff(time)
    median = float(np.median(steps)) if len(steps) else 0.0
    if median == 0.0:
        return 0, 0  # several samples per tick of a coarse clock: the rate is undefined
    long = steps[steps > GAP * median]
    with np.errstate(over="ignore"):
        missing = np.clip(np.rint(long / median) - 1.0, 1.0, 1e9)
    return len(long), int(missing.sum())


def write_recording(
    path: str | Path, time: ArrayLike, wrench: ArrayLike, frame: Frame = "sensor", gravity_base: ArrayLike | None = None
) -> None:
    """Write a recording that is read back exactly; an existing file is replaced, its folder created if necessary.

    Args:
        path: path of the file.
        time: time of each sample [s], (n,).
        wrench: wrenches [N, N·m], (n, 6), in the axes of `frame`.
        frame: "sensor" or "base".
        gravity_base: gravity vector in base axes [m/s²], (n, 3).

    Raises:
        InputError: the file cannot be written.
        ValueError: the shapes of the arrays do not match.
    """
    rows = np.hstack([np.reshape(values, (-1, width)) for values, width in ((time, 1), (wrench, 6), (gravity_base, 3))
                      if values is not None]).astype(float)  # fmt: skip
    header = CSV_HEADER if gravity_base is None else f"{CSV_HEADER},{GRAVITY_HEADER}"
    lines = [f"# frame: {frame}", header, *(",".join(map(repr, row)) for row in rows.tolist()), ""]
    write_atomically(Path(path), "\n".join(lines).encode(), durable=False)


class CsvRecorder(Sink):
    """Records raw readings as CSV, in whole lines; called from one thread (see `RecordingFile`).

    Attributes:
        readings: number of readings in the file.
    """

    def __init__(self, path: Path, force: bool = False) -> None:
        """Create the file and write its header; see `AppendFile`."""
        self._file, self.readings, self._n_pending = AppendFile(path, force), 0, 0
        self._file.write(f"# frame: sensor\n{CSV_HEADER},{GRAVITY_HEADER},{FAULT}\n".encode())
        try:
            self._file.flush()
        except OSError:
            self._file.discard()
            raise

    def on_samples(self, block: Block) -> None:
        """Write one line per reading."""
        fault = one_line(block.fault).translate(_NO_DELIMITERS)
        last = "".join(f",{value!r}" for value in block.gravity_base.tolist()) + f",{fault}\n"
        rows = zip(block.time.tolist(), block.wrench_sensor.tolist(), strict=True)
        lines = [",".join(map(repr, (time, *wrench))) + last for time, wrench in rows]
        self._file.write("".join(lines).encode())
        self._n_pending += len(block)
        self.flush()  # little data, so it is written at once

    def on_dropped(self, readings: int, others: int, probe: str = "") -> None:
        """Write a comment."""
        self._file.write(f"# the disk was too slow: {readings} readings dropped here\n".encode())

    def flush(self) -> None:
        """Pass the buffer to the operating system."""
        self._file.flush()
        self.readings, self._n_pending = self.readings + self._n_pending, 0

    def close(self) -> None:
        """Write the buffer and close the file."""
        try:
            self.flush()
        finally:
            self._file.close()
