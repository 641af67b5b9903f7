"""Poses from a file of CSV or JSON lines, by UDP with one object per datagram, and the registry of pose streams."""

import csv
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from probedesign.core.csv_tables import read_text
from probedesign.core.errors import InputError
from probedesign.core.files import check_regular
from probedesign.live.datagrams import Listener, Parsed, decode_object, parse_listen_address, read_quantities, spellings
from probedesign.live.poses.base_poses import TimedPose, timed_pose

#: Names of the fields of a pose, in CSV, JSON lines and UDP packets.
POSE_COLUMNS = ("time_s", "x_mm", "y_mm", "z_mm", "qx", "qy", "qz", "qw")
#: Names that each may have: time and position may be in other units, as `time_ms` and `x_m`.
POSE_FIELDS = {
    field: spellings(field, {"s": "time", "mm": "length", "": ""}[field.partition("_")[2]]) for field in POSE_COLUMNS
}


def parse_pose(values: Mapping[str, Any]) -> Parsed[TimedPose]:
    """Return the pose with `POSE_FIELDS` and its optional `frame`; other fields are ignored.

    Raises:
        InputError: a field is missing, given twice, is not a number, or the numbers are not a pose.
    """
    time, *numbers = read_quantities(values, POSE_FIELDS, "a pose")
    pose = timed_pose(time, numbers[:3], numbers[3:])
    return Parsed(pose, str(values.get("frame", "")), pose.time)


def read_pose_file(path: Path) -> list[TimedPose]:
    """Read all poses of a file.

    Args:
        path: `NAME.csv` with the columns `POSE_COLUMNS`, or any other file with one JSON object of these fields per
            line. Lines that begin with # are ignored.

    Raises:
        InputError: the file cannot be read, has no poses, or a line is wrong; the message names the line.
    """
    check_regular(path)
    numbered = enumerate(read_text(path, "file of poses", kind="CSV or JSON").splitlines(), 1)
    lines = [(number, line) for number, line in numbered if line.strip() and not line.lstrip().startswith("#")]
    objects: Iterable[tuple[int, Callable[[], dict[str, Any]]]]
    if path.suffix.lower() == ".csv":
        rows = csv.reader(line for _, line in lines)
        header = [name.strip() for name in next(rows, [])]
        objects = ((n, partial(_named, header, row)) for (n, _), row in zip(lines[1:], rows, strict=False))
    else:
        objects = ((number, partial(decode_object, line)) for number, line in lines)
    poses: list[TimedPose] = []
    frames = set()
    for number, values_of in objects:
        try:
            pose, frame, *_ = parse_pose(values_of())
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


def _named(header: list[str], row: list[str]) -> dict[str, Any]:
    if len(row) != len(header):
        raise InputError(f"has {len(row)} fields, but the header has {len(header)}")
    return dict(zip(header, row, strict=True))


def listen(target: str) -> Listener[TimedPose]:
    """Listen for poses on `udp://[HOST]:PORT`, one JSON or MessagePack object per datagram.

    Raises:
        InputError: the port is in use, or the address does not belong to this machine.
    """
    option = f"--pose {target}"
    listener = Listener(option, "poses", parse_listen_address(option), parse_pose)
    listener.start()
    return listener


#: By scheme: an example, and module and name of the function that opens the `PoseStream` from its target.
POSE_STREAMS = {
    "udp": ("udp://:PORT", "probedesign.live.poses.pose_sources:listen"),
    "tf": ("tf://WORLD/BASE", "probedesign.live.sources.ros2:open_tf"),
    "ur": ("ur://HOST", "probedesign.live.poses.robots:open_ur"),
    "franka": ("franka://HOST", "probedesign.live.poses.robots:open_franka"),
}
