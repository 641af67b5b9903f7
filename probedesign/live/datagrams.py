"""Datagrams from outside: decoding, a receiver with bounds on rate and size, and streams of one sender.

A datagram is one object of names and values, as JSON or MessagePack; each name of a number ends in its unit. Nothing in
it is trusted: what is not valid is counted by kind, reported once per kind, and dropped.
"""

import json
import math
import socket
import threading
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Mapping
from contextlib import suppress
from queue import Empty, SimpleQueue
from time import monotonic, sleep
from typing import Any, Generic, Protocol, TypeVar

from probedesign.core.csv_tables import UNITS
from probedesign.core.errors import InputError
from probedesign.live import LOOPBACK, split_address
from probedesign.live.handover import MAX_QUEUED, Handover

MAX_DATAGRAM = 4096
"""Maximum size of a datagram [bytes]; two or three hundred are needed."""


def decode_object(content: str | bytes) -> dict[str, Any]:
    """Return the object of a datagram or of a line of a file, in JSON or MessagePack.

    The first byte distinguishes them: a map of MessagePack begins with 0x80 ... 0x8f, 0xde or 0xdf, which no JSON does.

    Raises:
        InputError: it is neither.
    """
    try:
        if isinstance(content, bytes) and content and (content[0] >> 4 == 8 or content[0] in (0xDE, 0xDF)):
            values = _unpack(content)
        else:
            values = json.loads(content)
    except (ValueError, RecursionError):
        raise InputError("is not JSON or MessagePack") from None
    if not isinstance(values, dict):
        raise InputError("is not a JSON object")
    return values


def _unpack(content: bytes) -> Any:
    try:
        import msgpack
    except ImportError:
        raise InputError("is MessagePack, which needs: pip install 'probedesign[msgpack]'") from None
    return msgpack.unpackb(content)


def find_quantity(values: Mapping[str, Any], quantity: str, kind: str) -> float | None:
    """Return a quantity [SI] whose name ends in any unit of its kind, as `x_mm` or `x_m`; None if it is missing.

    Args:
        values: names and values.
        quantity: name without unit.
        kind: key of `UNITS`; empty for a quantity without unit.

    Raises:
        InputError: it is given in two units, or is not a finite number.
    """
    units = {f"{quantity}_{unit}": factor for unit, factor in UNITS[kind].items()} if kind else {quantity: 1.0}
    found = [name for name in units if name in values]
    if not found:
        return None
    if len(found) > 1:
        raise InputError(f"has {found[0]} and {found[1]}; keep one")
    return units[found[0]] * _finite(found[0], values[found[0]])


def _finite(name: str, value: Any) -> float:
    try:
        number = math.nan if isinstance(value, bool) or value is None else float(value)
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if not math.isfinite(number):
        raise InputError(f"{name} = {str(value)[:40]!r} is not a finite number")
    return number


def parse_listen_address(option: str) -> tuple[str, int]:
    """Return host and port of `udp://[HOST]:PORT` at the end of an option's text; without a host this machine only.

    Raises:
        InputError: it is not of this form.
    """
    try:
        host, port = split_address(option.rpartition(" ")[2], "udp")
    except ValueError:
        host, port = "", None
    if port is None:
        raise InputError(
            f"{option}: write udp://:PORT with a port of 1 ... 65535, or udp://0.0.0.0:PORT for every network"
        )
    return host or LOOPBACK[0], port


TICK = 0.010
"""Interval in which the number of datagrams is limited [s]. The system drops the rest of a flood."""
MAX_BURSTS = 50
"""Number of full ticks after which the user is informed."""
BUFFER_BYTES = 1 << 22
"""Size of the socket's buffer that is requested of the system; it may grant less."""


class DatagramReceiver(ABC):
    """Receives datagrams in its own thread, at a limited rate; a subclass handles each in `receive`.

    Attributes:
        address: host and port.
        counts: number of datagrams by kind, and of bursts: ticks in which the limit was reached.
    """

    def __init__(self, option: str, name: str, host: str, port: int, max_per_tick: int = 20) -> None:
        """Bind the port; nothing is received before `start`.

        Args:
            option: option of the user, for errors.
            name: what is received, in plural, for messages.
            host: address of this machine to listen on.
            port: port; 0 lets the system choose.
            max_per_tick: maximum number of datagrams per `TICK`.

        Raises:
            InputError: the port is in use, or the address does not belong to this machine.
        """
        self.counts: Counter[str] = Counter()
        self._name, self._max_per_tick = name, max_per_tick
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER_BYTES)
            self._socket.bind((host, port))
        except (OSError, OverflowError) as error:
            self._socket.close()
            why = getattr(error, "strerror", None) or str(error)
            raise InputError(f"{option}: {why}; use another port, or an address of this machine") from None
        self.address: tuple[str, int] = self._socket.getsockname()[:2]
        self._messages = Handover[str]()
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._listen, name=name, daemon=True)

    @property
    def access_note(self) -> str:
        """One line on who can send."""
        host, port = self.address
        public = "" if host.startswith("127.") else ": anyone on that network can send"
        return f"listening for {self._name} on {host}:{port}{public}"

    def start(self) -> None:
        """Start to receive; what arrived since the port was bound is discarded, because it is old."""
        self._socket.setblocking(False)
        with suppress(OSError):
            for _ in range(100 * MAX_QUEUED):
                self._socket.recv(1)
        self._socket.settimeout(0.1)
        self._thread.start()

    def pop_messages(self) -> list[str]:
        """Return the messages to the user since the last call."""
        return self._messages.take()

    def close(self) -> None:
        """Stop the thread and close the socket."""
        self._ended.set()
        if self._thread.is_alive():
            self._thread.join()
        self._socket.close()

    @abstractmethod
    def receive(self, datagram: bytes, sender: tuple[str, int], now: float) -> None:
        """Handle one datagram, in the thread; `now` is its arrival by `time.monotonic` [s].

        Raises:
            InputError: it is not valid; it is counted, and the first one is reported.
        """

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
            try:
                if len(datagram) > MAX_DATAGRAM:
                    raise InputError(f"has more than {MAX_DATAGRAM} bytes")
                self.receive(datagram, sender[:2], now)
            except InputError as error:
                self.reject("invalid", f"a datagram {error}")
            if n_tick >= self._max_per_tick:
                self._count_burst()
                sleep(max(tick + TICK - monotonic(), 0.0))

    def _count_burst(self) -> None:
        """Count a full tick; report when there are more than a busy machine causes."""
        self.counts["bursts"] += 1
        if self.counts["bursts"] == MAX_BURSTS:
            rate = self._max_per_tick / TICK
            self._messages.append(f"{self._name}: more than {rate:.0f} datagrams a second; the system drops some")

    def reject(self, kind: str, line: str) -> None:
        """Count a rejected datagram, and report the first of its kind."""
        self.counts[kind] += 1
        if self.counts[kind] == 1:
            self._messages.append(f"{self._name}: {line}; such datagrams are rejected and counted")


SENDER_TIMEOUT = 1.0
"""Time without a valid datagram [s] after which any sender may start anew, with another clock and another frame."""
MAX_TIME_JUMP = 1.0
"""Maximum advance of a time stamp beyond its arrival [s]; more indicates another clock."""


class Timed(Protocol):
    """A value with a time by its sender's clock [s]; NaN without one."""

    @property
    def time(self) -> float:
        """Time by the sender's clock [s]."""


T = TypeVar("T", bound=Timed)


class StreamListener(DatagramReceiver, Generic[T]):
    """Receives the values of one sender and queues them; a subclass parses them.

    The first sender of a valid value keeps the stream until it is silent for `SENDER_TIMEOUT`. Everything else is
    counted, and each kind is reported once: invalid, another frame, another sender, time that decreases or jumps.

    Attributes:
        frame: frame of the values, as the sender names it; may be empty.
    """

    def __init__(self, option: str, name: str, host: str, port: int, max_per_tick: int = 20) -> None:
        """Bind the port; see `DatagramReceiver`."""
        super().__init__(option, name, host, port, max_per_tick)
        self._arrived = SimpleQueue[None]()  # a signal within the wait of an Event can leave its lock held
        self._queue = Handover[tuple[float, T, int]]()
        self._session, self._sender, self.frame = 0, ("", 0), ""
        self._last: T | None = None
        self._last_arrival = -SENDER_TIMEOUT

    @abstractmethod
    def parse(self, datagram: bytes) -> tuple[T, str]:
        """Return the value of a datagram and its frame, empty without one; raises InputError if it is not valid."""

    def fault(self, value: T, last: T, elapsed: float) -> tuple[str, str] | None:
        """Return kind and description of an inconsistency with the last value, `elapsed` seconds before, or None."""
        if math.isnan(value.time) and math.isnan(last.time):
            return None
        step = value.time - last.time
        if math.isnan(step):
            return "not always timed", "only some datagrams have a time"
        if step <= 0.0:
            return "not increasing in time", f"time_s = {value.time:.9g} is not after {last.time:.9g}"
        if step - elapsed > MAX_TIME_JUMP:
            return "jumping in time", f"time_s jumps by {step:.3g} s"
        return None

    def wait(self, timeout: float) -> None:
        """Return when a value is queued, or after the timeout [s]."""
        with suppress(Empty):
            self._arrived.get(timeout=timeout)

    def pop(self) -> list[tuple[float, T, int]]:
        """Return the values since the last call.

        Returns:
            Arrival by `time.monotonic` [s], value, and number of the sender's session, for each.
        """
        with suppress(Empty):
            self._arrived.get_nowait()
        return self._queue.take()

    @property
    def summary(self) -> str:
        """The counts in one line."""
        refused = [f"{n} {kind}" for kind, n in self.counts.items() if kind not in ("taken", "bursts", "lost")]
        lost = f", {self.counts['lost']} lost" if self.counts["lost"] else ""
        rejected = f", rejected: {', '.join(refused)}" if refused else ""
        return f"{self.counts['taken']} {self._name}{lost}{rejected}"

    def receive(self, datagram: bytes, sender: tuple[str, int], now: float) -> None:
        """Queue or reject one datagram; see `DatagramReceiver`."""
        if now - self._last_arrival > SENDER_TIMEOUT:
            self._last = None
        elif sender != self._sender:
            return self.reject("from another sender", f"{sender[0]}:{sender[1]} sends {self._name} too")
        value, frame = self.parse(datagram)
        if self._last is None:
            self._start_session(sender, frame)
        elif frame != self.frame:
            return self.reject("in another frame", f"frame {frame[:40]!r} after {self.frame[:40]!r}")
        elif fault := self.fault(value, self._last, now - self._last_arrival):
            return self.reject(*fault)
        self._last, self._last_arrival = value, now
        self.counts["taken"] += 1
        self._queue.append((now, value, self._session))
        if self._arrived.empty():
            self._arrived.put(None)

    def _start_session(self, sender: tuple[str, int], frame: str) -> None:
        self._session += 1
        self._sender, self.frame = sender, frame
        again = "again " if self._session > 1 else ""
        frame_text = f", frame {frame[:40]!r}" if frame else ""
        self._messages.append(f"{self._name}: {again}from {sender[0]}:{sender[1]}{frame_text}")
