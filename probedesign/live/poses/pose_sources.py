"""Poses from a file of CSV or JSON lines, by UDP with one object per datagram, and the registry of pose streams."""

import csv
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from pathlib import Path
from typing import Any, Protocol

from probedesign.core.errors import InputError
from probedesign.core.files import check_regular
from probedesign.live.datagrams import StreamListener, decode_object, find_quantity, parse_listen_address
from probedesign.live.poses.track import TimedPose, timed_pose

POSE_COLUMNS = ("time_s", "x_mm", "y_mm", "z_mm", "qx", "qy", "qz", "qw")
"""Names of the fields of a pose, in CSV, JSON lines and UDP packets."""


def parse_pose(values: Mapping[str, Any]) -> TimedPose:
    """Return the pose with the fields `POSE_COLUMNS`; other fields are ignored.

    Time and position may be in other units, named by the end of the field: `time_ms`, `x_m`.

    Raises:
        InputError: a field is missing, duplicated, is not a number, or the numbers are not a pose.
    """
    kinds = {"s": "time", "mm": "length", "": ""}
    parts = [name.partition("_") for name in POSE_COLUMNS]
    found = [find_quantity(values, quantity, kinds[unit]) for quantity, _, unit in parts]
    if missing := [name for name, value in zip(POSE_COLUMNS, found, strict=True) if value is None]:
        raise InputError(f"has no {', '.join(missing)}; a pose needs {', '.join(POSE_COLUMNS)}")
    time, *numbers = (value for value in found if value is not None)
    return timed_pose(time, numbers[:3], numbers[3:])


def parse_pose_json(text: str | bytes) -> tuple[TimedPose, str]:
    """Return the pose of a JSON object, and the value of its field `frame`, if any.

    Raises:
        InputError: the text is not such an object.
    """
    values = decode_object(text)
    return parse_pose(values), str(values.get("frame", ""))


def read_pose_file(path: Path) -> list[TimedPose]:
    """Read all poses of a file.

    Args:
        path: `NAME.csv` with the columns `POSE_COLUMNS`, or any other file with one JSON object of these fields per
            line. Lines that begin with # are ignored.

    Raises:
        InputError: the file cannot be read, has no poses, or a line is wrong; the message names the line.
    """
    lines = _lines(path)
    parsers: Iterable[tuple[int, Callable[[], tuple[TimedPose, str]]]]
    if path.suffix.lower() == ".csv":
        rows = csv.reader(line for _, line in lines)
        header = [name.strip() for name in next(rows, [])]
        numbered = zip(lines[1:], rows, strict=False)
        parsers = ((number, partial(_parse_csv_row, header, row)) for (number, _), row in numbered)
    else:
        parsers = ((number, partial(parse_pose_json, line)) for number, line in lines)
    poses: list[TimedPose] = []
    frames = set()
    for number, parse in parsers:
        try:
            pose, frame = parse()
            if poses and not pose.time > poses[-1].time:
                before = f"{poses[-1].time:.9g}"
                raise InputError(f"time_s = {pose.time:.9g} is not after {before}; sort the lines")
        except InputError as error:
            raise InputError(f"{path}:{number}: {error}") from None
        frames.add(frame)
        poses.append(pose)
    if not poses:
        raise InputError(f"{path}: no poses in the file; a line needs {', '.join(POSE_COLUMNS)}")
    if len(frames) > 1:
        named = ", ".join(sorted(frames))[:80]
        raise InputError(f"{path}: poses are in several frames, {named}; one frame is required")
    return poses


def _parse_csv_row(header: list[str], row: list[str]) -> tuple[TimedPose, str]:
    if len(row) != len(header):
        raise InputError(f"has {len(row)} fields, but the header has {len(header)}")
    return parse_pose(dict(zip(header, row, strict=True))), ""


def _lines(path: Path) -> list[tuple[int, str]]:
    check_regular(path)
    try:
        text = path.read_bytes().decode("utf-8-sig")
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except (OSError, ValueError) as error:  # UnicodeDecodeError and a NUL in the path are ValueErrors
        why = getattr(error, "strerror", None) or "not UTF-8 text"
        raise InputError(f"{path}: cannot be read as poses: {why}") from None
    numbered = enumerate(text.splitlines(), 1)
    return [(number, line) for number, line in numbered if line.strip() and not line.lstrip().startswith("#")]


class PoseStream(Protocol):
    """Poses of the base that arrive during the run, by the robot's clock."""

    title: str  #: one line that describes the poses.
    notes: tuple[str, ...]  #: notes for the user, one line each.

    def pop(self) -> list[tuple[float, TimedPose, int]]:
        """Return the poses since the last call.

        Returns:
            Arrival by `time.monotonic` [s], pose by its sender's clock, and number of the sender's session, for each.
        """

    def pop_messages(self) -> list[str]:
        """Return the messages to the user since the last call."""

    def close(self) -> None:
        """End the stream."""

    @property
    def summary(self) -> str:
        """The counts in one line."""


class PoseListener(StreamListener[TimedPose]):
    """Poses by UDP, one JSON or MessagePack object per datagram; see `StreamListener` and `PoseStream`."""

    def __init__(self, host: str, port: int) -> None:
        """Bind the port and start to receive.

        Raises:
            InputError: the port is in use, or the address does not belong to this machine.
        """
        super().__init__(f"--pose udp://{host}:{port}", "poses", host, port)
        self.title = "poses by UDP to {}:{}".format(*self.address)
        self.notes: tuple[str, ...] = (self.access_note,)
        self.start()

    def parse(self, datagram: bytes) -> tuple[TimedPose, str]:
        """Return the pose of a datagram and its frame."""
        return parse_pose_json(datagram)


def listen(target: str, parameters: Mapping[str, str]) -> PoseListener:
    """Open `udp://[HOST]:PORT`, which has no parameters of its own."""
    return PoseListener(*parse_listen_address(f"--pose {target}"))


POSE_STREAMS = {
    "udp": ("udp://:PORT", "probedesign.live.poses.pose_sources:listen", ()),
    "tf": ("tf://WORLD/BASE", "probedesign.live.sources.ros2.source:open_tf", ("python",)),
    "ur": ("ur://HOST", "probedesign.live.poses.robots:open_ur", ()),
    "franka": ("franka://HOST", "probedesign.live.poses.robots:open_franka", ()),
}
"""By scheme: an example, module and name of the function that opens the `PoseStream` from target and parameters, and
the names of these parameters."""
