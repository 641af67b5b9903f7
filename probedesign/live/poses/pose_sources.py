"""Poses from a file of CSV or JSON lines, and by UDP (`udp://HOST:PORT`) with one JSON object per datagram."""

import csv
import json
import math
import socket
import threading
from collections import Counter, deque
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from pathlib import Path
from time import monotonic, sleep
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
    """Return the field that contains a quantity and its factor to SI units; None if it is missing."""
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
    try:
        text = path.read_bytes().decode("utf-8-sig")
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except (OSError, ValueError) as error:  # UnicodeDecodeError and a NUL in the path are ValueErrors
        why = getattr(error, "strerror", None) or "not UTF-8 text"
        raise InputError(f"{path}: cannot be read as poses: {why}") from None
    numbered = enumerate(text.splitlines(), 1)
    return [(number, line) for number, line in numbered if line.strip() and not line.lstrip().startswith("#")]


MAX_DATAGRAM = 4096
"""Maximum size of a datagram with a pose [bytes]; about two hundred are needed."""
TICK, MAX_PER_TICK = 0.010, 20
"""Maximum number of datagrams per tick [s]: 2000 per second. The system drops the rest of a flood."""
MAX_BURSTS = 50
"""Number of full ticks after which the user is informed."""
SENDER_TIMEOUT = 1.0
"""Time without a valid pose [s] after which any sender may start anew, with another clock and another frame."""
MAX_TIME_JUMP = 1.0
"""Maximum advance of a time stamp beyond its arrival [s]; more indicates another clock."""
MAX_QUEUED = 4096
"""Maximum number of queued poses."""


class PoseListener:
    """Receives poses in its own thread, validates them and queues them.

    The first sender of a valid pose is the robot, until it times out. Everything else is counted, and each kind is
    reported once: not JSON, not a rotation, not finite, another frame, another sender, time that decreases or jumps.

    Attributes:
        address: host and port.
        counts: number of datagrams: taken, and rejected by the kind of fault; and of bursts of a whole tick.
    """

    def __init__(self, host: str, port: int) -> None:
        """Bind the port and start the thread.

        Raises:
            InputError: the port is in use, or the address does not belong to this machine.
        """
        self.counts: Counter[str] = Counter()
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind((host, port))
        except (OSError, OverflowError) as error:
            self._socket.close()
            why = getattr(error, "strerror", None) or str(error)
            raise InputError(
                f"--pose udp://{host}:{port}: {why}; use another port, or an address of this machine"
            ) from None
        self._socket.settimeout(0.1)
        self.address: tuple[str, int] = self._socket.getsockname()[:2]
        self._queue: deque[tuple[float, TimedPose, int]] = deque(maxlen=MAX_QUEUED)
        self._messages: deque[str] = deque(maxlen=MAX_QUEUED)
        self._session, self._sender, self._frame = 0, ("", 0), ""
        self._last: TimedPose | None = None
        self._last_arrival = -SENDER_TIMEOUT
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._listen, name="poses", daemon=True)
        self._thread.start()

    def pop_poses(self) -> list[tuple[float, TimedPose, int]]:
        """Return the poses since the last call.

        Returns:
            Arrival by `time.monotonic` [s], pose by its sender's clock, and number of the sender's session, for each.
        """
        return [self._queue.popleft() for _ in range(len(self._queue))]

    def pop_messages(self) -> list[str]:
        """Return the messages to the user since the last call."""
        return [self._messages.popleft() for _ in range(len(self._messages))]

    def close(self) -> None:
        """Stop the thread and close the socket."""
        self._ended.set()
        self._thread.join()
        self._socket.close()

    @property
    def summary(self) -> str:
        """The counts in one line."""
        refused = [f"{n} {kind}" for kind, n in self.counts.items() if kind not in ("taken", "bursts")]
        return f"{self.counts['taken']} poses" + (f", rejected: {', '.join(refused)}" if refused else "")

    def _listen(self) -> None:
        tick, n_tick = monotonic(), 0
        while not self._ended.is_set():
            try:
                datagram, sender = self._socket.recvfrom(MAX_DATAGRAM + 1)
            except TimeoutError:
                continue
            except OSError:  # the sender's system reports a closed port
                continue
            now = monotonic()
            if now - tick >= TICK:
                tick, n_tick = now, 0
            n_tick += 1
            self._receive(datagram, sender, now)
            if n_tick >= MAX_PER_TICK:
                self._count_burst()
                sleep(max(tick + TICK - monotonic(), 0.0))

    def _count_burst(self) -> None:
        """Count a full tick; report when there are more than a busy machine causes."""
        self.counts["bursts"] += 1
        if self.counts["bursts"] == MAX_BURSTS:
            self._messages.append(
                f"poses: more than {MAX_PER_TICK / TICK:.0f} datagrams a second; the system drops some"
            )

    def _receive(self, datagram: bytes, sender: tuple[str, int], now: float) -> None:
        """Accept or reject one datagram."""
        if now - self._last_arrival > SENDER_TIMEOUT:
            self._last = None
        elif sender != self._sender:
            return self._reject("from another sender", f"{sender[0]}:{sender[1]} sends poses too")
        try:
            if len(datagram) > MAX_DATAGRAM:
                raise InputError(f"has more than {MAX_DATAGRAM} bytes")
            pose, frame = parse_pose_json(datagram)
        except InputError as error:
            return self._reject("invalid", f"a datagram {error}")
        if self._last is None:
            self._start_session(sender, frame)
        elif fault := self._fault(pose, frame, now):
            return self._reject(*fault)
        self._last, self._last_arrival = pose, now
        self.counts["taken"] += 1
        self._queue.append((now, pose, self._session))

    def _start_session(self, sender: tuple[str, int], frame: str) -> None:
        self._session += 1
        self._sender, self._frame = sender, frame
        again = "again " if self._session > 1 else ""
        frame_text = f", frame {frame[:40]!r}" if frame else ""
        self._messages.append(f"poses: {again}from {sender[0]}:{sender[1]}{frame_text}")

    def _fault(self, pose: TimedPose, frame: str, now: float) -> tuple[str, str] | None:
        """Return kind and description of an inconsistency with the last valid pose, or None."""
        assert self._last is not None
        if frame != self._frame:
            return "in another frame", f"frame {frame[:40]!r} after {self._frame[:40]!r}"
        step = pose.time - self._last.time
        if step <= 0.0:
            return "not increasing in time", f"time_s = {pose.time:.9g} is not after {self._last.time:.9g}"
        if step - (now - self._last_arrival) > MAX_TIME_JUMP:
            return "jumping in time", f"time_s jumps by {step:.3g} s"
        return None

    def _reject(self, kind: str, line: str) -> None:
        """Count a rejected datagram, and report the first of its kind."""
        self.counts[kind] += 1
        if self.counts[kind] == 1:
            self._messages.append(f"poses: {line}; such datagrams are rejected and counted")
