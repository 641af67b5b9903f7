"""Poses of a file: CSV with a header, or one JSON object a line."""

import csv
from collections.abc import Iterator
from pathlib import Path

from probedesign.errors import InputError
from probedesign.live.pose.timed import TimedPose
from probedesign.live.pose.words import NAMES, pose_of, pose_of_json


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
