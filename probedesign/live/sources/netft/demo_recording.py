"""Recordings of ATI's demonstration program: seven lines, a header, and rows of quoted fields.

Source: ATI's Java demo, version 1.1.1.
"""

import csv
import re
from pathlib import Path

import numpy as np

from probedesign.core.csv_tables import read_text
from probedesign.core.errors import InputError, quoted
from probedesign.core.frames import Array
from probedesign.core.units import FORCE_UNITS, TORQUE_UNITS, unit_of
from probedesign.live.recordings.csv import Recording, check_wrenches, gaps_in
from probedesign.live.sources.netft.rdt import SAMPLES_PER_SECOND, fault_of

FIRST_WORDS = "Start Time"
ATI_HEADER = ("status(hex)", "rdtsequence", "f/tsequence", "fx", "fy", "fz", "tx", "ty", "tz", "time")
WRAP = 1 << 32


def is_ati_demo(path: Path) -> bool:
    """Return whether a file begins like a recording of ATI's demonstration program."""
    try:
        with path.open("rb") as file:
            return file.read(len(FIRST_WORDS) + 4).lstrip(b'\xef\xbb\xbf"').startswith(FIRST_WORDS.encode())
    except (OSError, ValueError):
        return False


def read_ati_demo(path: Path) -> Recording:
    """Read a recording of ATI's demonstration program: seven lines, a header, and rows of quoted fields.

    A row contains counts or units. The time is the sensor's, from the first sample.

    Raises:
        InputError: the file cannot be read or is invalid; the message names the line.
    """
    lines = read_text(path, "recording").splitlines()
    factors, start = _head(path, lines)
    rows = [(number, fields) for number, fields in enumerate(csv.reader(lines[start:]), start + 1) if fields]
    notes = []
    if rows and len(rows[-1][1]) < len(ATI_HEADER):
        notes.append(f"line {rows[-1][0]} is incomplete at the end: dropped")
        rows.pop()
    dropped = len(notes)
    values = np.array([_numbers(path, number, fields) for number, fields in rows]).reshape(-1, 8)
    if not len(values):
        raise InputError(f"{path}: no samples, only a header")
    time = _time(path, values[:, 1], [number for number, _ in rows])
    counts = bool((values[:, 2:] == np.rint(values[:, 2:])).all())  # counts are integers, newtons are not
    wrench = values[:, 2:] * factors[0] / (factors[1] if counts else 1.0)
    good = np.array([not fault_of(int(status)) for status in values[:, 0]])
    if not good.all():
        notes.append(f"{int((~good).sum())} samples with a fault are omitted")
    gaps, missing = gaps_in(time[good])
    if gaps:
        notes.append(f"{missing} samples are missing in {gaps} gaps")
    check_wrenches(path, time[good], wrench[good])
    return Recording(time[good], wrench[good], "sensor", None, gaps, missing, dropped, tuple(notes))


def _head(path: Path, lines: list[str]) -> tuple[tuple[Array, Array], int]:
    """Return units in SI and counts per unit, (6,) each, and the number of lines before the first row."""
    head: dict[str, str] = {}
    for number, line in enumerate(lines[:20], 1):
        if re.sub(r"[\s\"]", "", line).lower().split(",") == list(ATI_HEADER):
            force, torque = (
                unit_of(f"{path}: {what} Units", head.get(f"{what} Units", ""), units)
                for what, units in (("Force", FORCE_UNITS), ("Torque", TORQUE_UNITS))
            )
            counts = [_counts(path, head, f"Counts per Unit {what}") for what in ("Force", "Torque")]
            return (np.repeat([force, torque], 3), np.repeat(counts, 3)), number
        name, _, value = line.strip().strip('"').partition(":")
        head[name.strip()] = value.strip()
    raise InputError(f"{path}: like a recording of ATI's demo, but without its header: Status (hex), ..., Time")


def _counts(path: Path, head: dict[str, str], name: str) -> float:
    try:
        counts = float(head[name])
    except (KeyError, ValueError):
        counts = 0.0
    if not 0.0 < counts < np.inf:
        raise InputError(f"{path}: {name} {quoted(head.get(name, ''))} must be a positive number")
    return counts


def _numbers(path: Path, number: int, fields: list[str]) -> list[float]:
    """Return status, sequence number of the sensor and six channels."""
    try:
        if len(fields) != len(ATI_HEADER):
            raise ValueError
        numbers = [int(fields[0].strip(), 16), int(fields[2]), *map(float, fields[3:9])]
    except ValueError:
        text = quoted(",".join(fields))
        raise InputError(f"{path}:{number}: {text} is not a row of {len(ATI_HEADER)} fields of ATI's demo") from None
    if not np.isfinite(numbers).all() or not 0 <= min(numbers[:2]) <= max(numbers[:2]) < WRAP:
        raise InputError(f"{path}:{number}: {quoted(','.join(fields))} contains a number that no box sends")
    return numbers


def _time(path: Path, sequence: Array, numbers: list[int]) -> Array:
    """Return the time by the sensor's own counter, across its 32-bit overflow [s], (n,)."""
    ticks = np.diff(sequence) % WRAP
    back = np.flatnonzero(ticks > WRAP / 2)
    if len(back):
        number = numbers[int(back[0]) + 1]
        raise InputError(f"{path}:{number}: F/T Sequence decreases; sort the rows or split the recording")
    return np.concatenate([[0.0], np.cumsum(ticks)]) / SAMPLES_PER_SECOND
