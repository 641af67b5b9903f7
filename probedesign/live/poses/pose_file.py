"""Poses from a file of CSV or JSON lines; the field names are those of the UDP packet."""

import csv
import json
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from probedesign.core.csv_tables import UNITS
from probedesign.core.errors import InputError
from probedesign.live.poses.track import TimedPose, timed_pose

POSE_COLUMNS = ("time_s", "x_mm", "y_mm", "z_mm", "qx", "qy", "qz", "qw")
"""Names of the fields of a pose, in CSV, JSON lines and UDP packets."""


def parse_pose(values: Mapping[str, Any]) -> TimedPose:
    """Return the pose with the fields `POSE_COLUMNS`; other fields are ignored.

    Time and position may be in other units, named by the end of the field: `time_ms`, `x_m`.

    Raises:
        InputError: a field is missing, duplicated, is not a number, or the numbers are not a pose.
    """
    fields = [_field(values, name) for name in POSE_COLUMNS]
    if missing := [name for name, field in zip(POSE_COLUMNS, fields, strict=True) if field is None]:
        raise InputError(f"has no {', '.join(missing)}; a pose needs {', '.join(POSE_COLUMNS)}")
    time, *numbers = (factor * _number(name, values[name]) for name, factor in filter(None, fields))
    return timed_pose(time, numbers[:3], numbers[3:])


def _field(values: Mapping[str, Any], name: str) -> tuple[str, float] | None:
    """Return the field that contains a quantity and its factor to SI units; None if there is none.

    Raises:
        InputError: the quantity is given in two units.
    """
    quantity, has_unit, _ = name.partition("_")
    if not has_unit:
        return (name, 1.0) if name in values else None
    units = UNITS["time" if quantity == "time" else "length"]
    found = [
        (f"{quantity}_{unit}", factor) for unit, factor in units.items() if f"{quantity}_{unit}" in values
    ]
    if len(found) > 1:
        raise InputError(f"has {found[0][0]} and {found[1][0]}; keep one")
    return found[0] if found else None


def parse_pose_json(text: str | bytes) -> tuple[TimedPose, str]:
    """Return the pose of a JSON object, and the value of its field `frame`, if any.

    Raises:
        InputError: the text is not such an object.
    """
    try:
        values = json.loads(text)
    except (ValueError, RecursionError):
        raise InputError("is not JSON") from None
    if not isinstance(values, dict):
        raise InputError("is not a JSON object")
    return parse_pose(values), str(values.get("frame", ""))


def _number(name: str, value: Any) -> float:
    try:
        number = math.nan if isinstance(value, bool) or value is None else float(value)
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if not math.isfinite(number):
        raise InputError(f"{name} = {str(value)[:40]!r} is not a finite number")
    return number


def read_pose_file(path: Path) -> list[TimedPose]:
    """Read all poses of a file.

    Args:
        path: `NAME.csv` with the columns `POSE_COLUMNS`, or any other file with one JSON object of these fields per
            line. Lines that begin with # are ignored.

    Raises:
        InputError: the file cannot be read, has no poses, or a line is wrong; the message names the line.
    """
    lines = _lines(path)
    poses: list[TimedPose] = []
    frames = set()
    for number, pose, frame in (
        _csv_poses(path, lines) if path.suffix.lower() == ".csv" else _json_poses(path, lines)
    ):
        if poses and not pose.time > poses[-1].time:
            raise InputError(
                f"{path}:{number}: time_s = {pose.time:.9g} is not after {poses[-1].time:.9g}; sort the lines"
            )
        frames.add(frame)
        poses.append(pose)
    if not poses:
        raise InputError(f"{path}: no poses in the file; a line needs {', '.join(POSE_COLUMNS)}")
    if len(frames) > 1:
        raise InputError(
            f"{path}: poses are in several frames, {', '.join(sorted(frames))[:80]}; one frame is required"
        )
    return poses


def _lines(path: Path) -> list[tuple[int, str]]:
    try:
        text = path.read_bytes().decode("utf-8-sig")
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except (OSError, ValueError) as error:  # UnicodeDecodeError and a NUL in the path are ValueErrors
        why = getattr(error, "strerror", None) or "not UTF-8 text"
        raise InputError(f"{path}: cannot be read as poses: {why}") from None
    numbered = enumerate(text.splitlines(), 1)
    return [(number, line) for number, line in numbered if line.strip() and not line.lstrip().startswith("#")]


def _csv_poses(path: Path, lines: list[tuple[int, str]]) -> Iterator[tuple[int, TimedPose, str]]:
    rows = csv.reader(line for _, line in lines)
    header = [name.strip() for name in next(rows, [])]
    for (number, _), row in zip(lines[1:], rows, strict=False):
        try:
            if len(row) != len(header):
                raise InputError(f"has {len(row)} fields, but the header has {len(header)}")
            yield number, parse_pose(dict(zip(header, row, strict=True))), ""
        except InputError as error:
            raise InputError(f"{path}:{number}: {error}") from None


def _json_poses(path: Path, lines: list[tuple[int, str]]) -> Iterator[tuple[int, TimedPose, str]]:
    for number, line in lines:
        try:
            yield number, *parse_pose_json(line)
        except InputError as error:
            raise InputError(f"{path}:{number}: {error}") from None
