"""`udp://HOST:PORT`: poses as a robot tells them, one JSON object a datagram."""

import socket
import threading
from collections import Counter, deque
from time import monotonic, sleep

from probedesign.errors import InputError
from probedesign.live.poses.pose_file import pose_of_json
from probedesign.live.poses.track import TimedPose

LARGEST = 4096
"""Bytes of a datagram that may hold a pose; it takes two hundred."""
TICK, MOST = 0.010, 20
"""At most so many datagrams are read in so long [s]: 2000 a second. The rest of a flood the system drops."""
OFTEN = 50
"""Ticks that are full before a user is told."""
QUIET = 1.0
"""After so long without a good pose [s] any sender may begin anew, with another clock and another frame."""
LEAP = 1.0
"""A stamp that goes further than its arrival by so much [s] is none of this clock's."""
WAITING = 4096
"""Poses that wait for us at most."""


class Listener:
    """Listens in a thread of its own; what comes is checked there and waits to be taken.

    The first sender of a good pose is the robot, until it is quiet. Anything else is counted and told once of each
    kind: no JSON, no rotation, not finite, another frame, another sender, time running backward or leaping.

    Attributes:
        address: host and port that are listened to.
        counts: datagrams so far: taken, and left out by the kind of fault; and bursts of a whole tick's.
    """

    def __init__(self, host: str, port: int) -> None:
        """Bind the port and begin.

        Raises:
            InputError: the port is in use, or the address is not this machine's.
        """
        self.counts: Counter[str] = Counter()
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind((host, port))
        except (OSError, OverflowError) as error:
            self._socket.close()
            why = getattr(error, "strerror", None) or str(error)
            raise InputError(
                f"--pose udp://{host}:{port}: {why}; say another port, or an address of this machine"
            ) from None
        self._socket.settimeout(0.1)
        self.address: tuple[str, int] = self._socket.getsockname()[:2]
        self._waiting: deque[tuple[float, TimedPose, int]] = deque(maxlen=WAITING)
        self._lines: deque[str] = deque(maxlen=WAITING)
        self._session, self._sender, self._frame = 0, ("", 0), ""
        self._last: TimedPose | None = None
        self._heard = -QUIET
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._listen, name="poses", daemon=True)
        self._thread.start()

    def taken(self) -> list[tuple[float, TimedPose, int]]:
        """What came since the last call: when by `time.monotonic` [s], the pose by its sender's clock, and which
        sender's in a row."""
        return [self._waiting.popleft() for _ in range(len(self._waiting))]

    def said(self) -> list[str]:
        """What a user should know that came up since the last call."""
        return [self._lines.popleft() for _ in range(len(self._lines))]

    def close(self) -> None:
        """Stop listening."""
        self._ended.set()
        self._thread.join()
        self._socket.close()

    @property
    def summary(self) -> str:
        """The counts in one line."""
        refused = [f"{n} {kind}" for kind, n in self.counts.items() if kind not in ("taken", "bursts")]
        return f"{self.counts['taken']} poses" + (f", left out: {', '.join(refused)}" if refused else "")

    def _listen(self) -> None:
        tick, heard = monotonic(), 0
        while not self._ended.is_set():
            try:
                datagram, sender = self._socket.recvfrom(LARGEST + 1)
            except TimeoutError:
                continue
            except OSError:  # what a sender's system reports of a port that is gone
                continue
            now = monotonic()
            if now - tick >= TICK:
                tick, heard = now, 0
            heard += 1
            self._hear(datagram, sender, now)
            if heard >= MOST:
                self._burst()
                sleep(max(tick + TICK - monotonic(), 0.0))

    def _burst(self) -> None:
        """Count, and say so when it is no longer what a busy machine makes of a robot's poses."""
        self.counts["bursts"] += 1
        if self.counts["bursts"] == OFTEN:
            self._lines.append(
                f"poses: more than {MOST / TICK:.0f} datagrams a second; the system drops some"
            )

    def _hear(self, datagram: bytes, sender: tuple[str, int], now: float) -> None:
        """Take in one datagram or leave it out."""
        if now - self._heard > QUIET:
            self._last = None
        elif sender != self._sender:
            return self._tell("from another sender", f"{sender[0]}:{sender[1]} sends poses too")
        try:
            if len(datagram) > LARGEST:
                raise InputError(f"has more than {LARGEST} bytes")
            pose, frame = pose_of_json(datagram)
        except InputError as error:
            return self._tell("no pose", f"a datagram {error}")
        if self._last is None:
            self._begin(sender, frame)
        elif fault := self._fault(pose, frame, now):
            return self._tell(*fault)
        self._last, self._heard = pose, now
        self.counts["taken"] += 1
        self._waiting.append((now, pose, self._session))

    def _begin(self, sender: tuple[str, int], frame: str) -> None:
        self._session += 1
        self._sender, self._frame = sender, frame
        again = "again " if self._session > 1 else ""
        told = f", frame {frame[:40]!r}" if frame else ""
        self._lines.append(f"poses: {again}from {sender[0]}:{sender[1]}{told}")

    def _fault(self, pose: TimedPose, frame: str, now: float) -> tuple[str, str] | None:
        """Kind and words of what is wrong beside the last good one."""
        assert self._last is not None
        if frame != self._frame:
            return "in another frame", f"frame {frame[:40]!r} after {self._frame[:40]!r}"
        step = pose.time - self._last.time
        if step <= 0.0:
            return "running backward", f"time_s = {pose.time:.9g} does not follow {self._last.time:.9g}"
        if step - (now - self._heard) > LEAP:
            return "leaping", f"time_s leaps by {step:.3g} s"
        return None

    def _tell(self, kind: str, line: str) -> None:
        """Count, and say so the first time."""
        self.counts[kind] += 1
        if self.counts[kind] == 1:
            self._lines.append(f"poses: {line}; such datagrams are left out and counted")
