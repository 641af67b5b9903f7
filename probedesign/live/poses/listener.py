"""Receives poses by UDP (`udp://HOST:PORT`), one JSON object per datagram."""

import socket
import threading
from collections import Counter, deque
from time import monotonic, sleep

from probedesign.core.errors import InputError
from probedesign.live.poses.pose_file import parse_pose_json
from probedesign.live.poses.track import TimedPose

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
