"""A pose in words: the names of a packet, a line of JSON and a column of CSV, the same for all three."""

import csv
import json
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from probedesign.errors import InputError
from probedesign.live.poses.track import TimedPose, timed_pose
from probedesign.units import MM

NAMES = ("time_s", "x_mm", "y_mm", "z_mm", "qx", "qy", "qz", "qw")


def pose_of(said: Mapping[str, Any]) -> TimedPose:
    """The pose that `NAMES` tell; other names are left alone.

    Raises:
        InputError: a name is missing, a value is no number, or they make no pose.
    """
    missing = [name for name in NAMES if name not in said]
    if missing:
        raise InputError(f"has no {', '.join(missing)}; a pose has {', '.join(NAMES)}")
    time, x, y, z, *q = (_number(name, said[name]) for name in NAMES)
    return timed_pose(time, [x * MM, y * MM, z * MM], q)


def pose_of_json(text: str | bytes) -> tuple[TimedPose, str]:
    """The pose of a JSON object, and the frame that it is told in, if it says `frame`.

    Raises:
        InputError: it is none.
    """
    try:
        said = json.loads(text)
    except (ValueError, RecursionError):
        raise InputError("is no JSON") from None
    if not isinstance(said, dict):
        raise InputError("is no JSON object")
    return pose_of(said), str(said.get("frame", ""))


def _number(name: str, value: Any) -> float:
    try:
        number = math.nan if isinstance(value, bool) or value is None else float(value)
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if not math.isfinite(number):
        raise InputError(f"{name} = {str(value)[:40]!r} is not a finite number")
    return number


def read_file(path: Path) -> list[TimedPose]:
    """All poses of a file.

    Args:
        path: `NAME.csv` with the columns of `NAMES`, or anything else with one JSON object of these a line. Lines
            that begin with # are left alone.

    Raises:
        InputError: it cannot be read, holds none, or a line is wrong; one line with the line of the file.
    """
    lines = _lines(path)
    poses: list[TimedPose] = []
    frames = set()
    for number, pose, frame in _csv(path, lines) if path.suffix.lower() == ".csv" else _json(path, lines):
        if poses and not pose.time > poses[-1].time:
            raise InputError(
                f"{path}:{number}: time_s = {pose.time:.9g} does not follow {poses[-1].time:.9g}; sort the lines"
            )
        frames.add(frame)
        poses.append(pose)
    if not poses:
        raise InputError(f"{path}: holds no poses; a line has {', '.join(NAMES)}")
    if len(frames) > 1:
        raise InputError(
            f"{path}: tells poses in several frames, {', '.join(sorted(frames))[:80]}; one is needed"
        )
    return poses


def _lines(path: Path) -> list[tuple[int, str]]:
    try:
        text = path.read_bytes().decode("utf-8-sig")
    except FileNotFoundError:
        raise InputError(f"{path}: no such file of poses") from None
    except (OSError, ValueError) as error:  # UnicodeDecodeError and a NUL in the path are ValueErrors
        why = getattr(error, "strerror", None) or "it is no text in UTF-8"
        raise InputError(f"{path}: cannot be read as poses: {why}") from None
    held = enumerate(text.splitlines(), 1)
    return [(number, line) for number, line in held if line.strip() and not line.lstrip().startswith("#")]


def _csv(path: Path, lines: list[tuple[int, str]]) -> Iterator[tuple[int, TimedPose, str]]:
    rows = csv.reader(line for _, line in lines)
    header = [name.strip() for name in next(rows, [])]
    for (number, _), row in zip(lines[1:], rows, strict=False):
        try:
            if len(row) != len(header):
                raise InputError(f"has {len(row)} fields, the header {len(header)}")
            yield number, pose_of(dict(zip(header, row, strict=True))), ""
        except InputError as error:
            raise InputError(f"{path}:{number}: {error}") from None


def _json(path: Path, lines: list[tuple[int, str]]) -> Iterator[tuple[int, TimedPose, str]]:
    for number, line in lines:
        try:
            yield number, *pose_of_json(line)
        except InputError as error:
            raise InputError(f"{path}:{number}: {error}") from None
