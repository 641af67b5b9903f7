"""Datagrams from outside: decoding, a receiver with bounds on rate and size, and streams of one sender.

A datagram is one object of names and values, as JSON or MessagePack; each name of a number ends in its unit. Nothing in
it is trusted: what is not valid is counted by kind, reported once per kind, and dropped.
"""

import json
import math
import socket
import threading
from collections import Counter, deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from queue import Empty, SimpleQueue
from time import monotonic, sleep
from typing import Any, Generic, NamedTuple, TypeVar

from probedesign.core.csv_tables import UNITS
from probedesign.core.errors import InputError, quoted
from probedesign.live import split_address
from probedesign.web import LOOPBACK

MAX_DATAGRAM = 4096  #: Maximum size of a datagram [bytes]; two or three hundred are needed.


def decode_object(content: str | bytes) -> dict[str, Any]:
    """Return the object of a datagram or of a line of a file, in JSON or MessagePack.

    The first byte distinguishes them: a map of MessagePack begins with 0x80 ... 0x8f, 0xde or 0xdf, which no JSON does.

    Raises:
        InputError: it is neither.
    """
    packed = isinstance(content, bytes) and content and (content[0] >> 4 == 8 or content[0] in (0xDE, 0xDF))
    try:
        if packed:
            import msgpack
        values = msgpack.unpackb(content) if packed else json.loads(content)
    except ImportError:
        raise InputError("is MessagePack, which needs: pip install 'probedesign[msgpack]'") from None
    except (ValueError, RecursionError):
        raise InputError("is not JSON or MessagePack") from None
    if not isinstance(values, dict):
        raise InputError("is not a JSON object")
    return values


Spellings = Mapping[str, float]  #: Names that a quantity may have in an object, each with the factor of its unit to SI.


def spellings(field: str, kind: str, *other_stems: str) -> Spellings:
    """Return the names of a quantity: that of `field`, as `x_mm`, and other ones, in every unit of a kind of `UNITS`.

    With an empty `kind` it has no unit.
    """
    stems = (field.partition("_")[0], *other_stems)
    units = {f"_{unit}": factor for unit, factor in UNITS[kind].items()} if kind else {"": 1.0}
    return {stem + unit: factor for stem in stems for unit, factor in units.items()}


def read_quantity(values: Mapping[str, Any], names: Spellings) -> float | None:
    """Return the quantity of an object that has one of these names [SI]; None if it is missing.

    Raises:
        InputError: it is given twice, or is not a finite number.
    """
    given = [name for name in names if name in values]
    if not given:
        return None
    if len(given) > 1:
        raise InputError(f"has {given[0]} and {given[1]}; keep one")
    value, number = values[given[0]], math.nan
    with suppress(TypeError, ValueError, OverflowError):
        number = math.nan if isinstance(value, bool) or value is None else float(value)
    if not math.isfinite(number):
        raise InputError(f"{given[0]} = {quoted(value)} is not a finite number")
    return names[given[0]] * number


def read_quantities(values: Mapping[str, Any], fields: Mapping[str, Spellings], what: str) -> list[float]:
    """Return all quantities of a table of fields [SI]; `what` has them, for messages.

    Raises:
        InputError: one is missing, given twice, or is not a finite number.
    """
    numbers = {field: read_quantity(values, names) for field, names in fields.items()}
    if missing := [field for field, number in numbers.items() if number is None]:
        raise InputError(f"has no {', '.join(missing)}; {what} needs {', '.join(fields)}")
    return [number for number in numbers.values() if number is not None]


def parse_listen_address(option: str) -> tuple[str, int]:
    """Return host and port of `udp://[HOST]:PORT` at the end of an option's text; without a host this machine only.

    Raises:
        InputError: it is not of this form.
    """
    host, port = split_address(option.rpartition(" ")[2], "udp") or ("", None)
    if port is None:
        raise InputError(
            f"{option}: write udp://:PORT with a port of 1 ... 65535, or udp://0.0.0.0:PORT for every network"
        )
    return host or LOOPBACK[0], port


MAX_QUEUED = 8192  #: Maximum number of queued values: a second of the fastest sensor.
TICK = 0.010  #: Interval in which the number of datagrams is limited [s]. The system drops the rest of a flood.
MAX_BURSTS = 50  #: Number of full ticks after which the user is informed: more than a busy machine causes.
LOST = ("lost", "dropped")  #: Counts of what the network lost, and of what nobody took in time.
BUFFER_BYTES = 1 << 22  #: Size of the socket's buffer that is requested of the system; it may grant less.

T = TypeVar("T")


class Handover(deque[T]):
    """Values that one thread appends and another takes; beyond a number the oldest are dropped."""

    def __init__(self, max_queued: int = MAX_QUEUED) -> None:
        super().__init__(maxlen=max_queued)

    def take(self) -> list[T]:
        """Return the values since the last call, in order."""
        return [self.popleft() for _ in range(len(self))]


#: Time without a valid datagram [s] after which any sender may start anew, with another clock and another frame.
SENDER_TIMEOUT = 1.0
MAX_TIME_JUMP = 1.0  #: Maximum advance of a time stamp beyond its arrival [s]; more indicates another clock.


class Parsed(NamedTuple, Generic[T]):
    """Content of one datagram."""

    value: T  #: what it contains.
    frame: str = ""  #: frame of the value, as the sender names it; may be empty.
    time: float = math.nan  #: time by the sender's clock [s]; NaN without one.
    sequence: int | None = None  #: number of the datagram; None without one.


class Listener(Generic[T]):
    """Receives datagrams in its own thread, at a limited rate, and queues the values of one sender.

    The first sender of a valid value keeps the stream until it is silent for `SENDER_TIMEOUT`. Everything else is
    counted, and each kind is reported once: invalid, another frame, another sender, a sequence or a time that decreases
    or jumps. Datagrams that a gap of the sequence shows as lost are counted too.

    Attributes:
        counts: number of datagrams by kind, and of bursts: ticks in which the limit was reached.
        frame: frame of the values, as the sender names it; may be empty.
    """

    def __init__(
        self,
        option: str,
        name: str,
        address: tuple[str, int],
        parse: Callable[[Mapping[str, Any]], Parsed[T]],
        max_rate: float = 2000.0,
        title: str = "",
        max_queued: int = MAX_QUEUED,
    ) -> None:
        """Bind the port of this machine, or one that the system chooses if it is 0; nothing is received before `start`.

        Messages name the `option` of the user and what is received, `name`, in plural. `parse` returns the content of
        an object, or raises InputError; `max_rate` is that of datagrams [Hz]. Of more than `max_queued` values that
        nobody takes, the oldest are dropped, and count as lost.

        Raises:
            InputError: the port is in use, or the address does not belong to this machine.
        """
        self.counts: Counter[str] = Counter()
        self._name, self._max_rate, self._parse = name, max_rate, parse
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER_BYTES)
            self._socket.bind(address)
        except (OSError, OverflowError) as error:
            self._socket.close()
            why = getattr(error, "strerror", None) or str(error)
            raise InputError(f"{option}: {why}; use another port, or an address of this machine") from None
        self.address: tuple[str, int] = self._socket.getsockname()[:2]
        self.title = title or "{} by UDP to {}:{}".format(name, *self.address)
        self.frame = ""
        self._messages = Handover[str]()
        self._arrived = SimpleQueue[None]()  # a signal within the wait of an Event can leave its lock held
        self._queue = Handover[tuple[float, T, int]](max_queued)
        self._session, self._address = 0, ("", 0)
        self._last: Parsed[T] | None = None
        self._last_arrival = -SENDER_TIMEOUT
        self._begun, self._lost_before = 0.0, 0  # of the session
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._listen, name=name, daemon=True)

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes for the user: who can send."""
        host, port = self.address
        public = "" if host.startswith("127.") else ": anyone on that network can send"
        return (f"listening for {self._name} on {host}:{port}{public}",)

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

    def reject(self, kind: str, line: str) -> None:
        """Count a rejected datagram, and report the first of its kind."""
        self.counts[kind] += 1
        if self.counts[kind] == 1:
            self._messages.append(f"{self._name}: {line}; such datagrams are rejected and counted")

    def _listen(self) -> None:
        tick, n_tick = monotonic(), 0
        while not self._ended.is_set():
            try:
                datagram, sender = self._socket.recvfrom(MAX_DATAGRAM + 1)
            except OSError:  # the timeout, or the sender's system reports a closed port
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
            if n_tick >= self._max_rate * TICK:
                self.counts["bursts"] += 1
                if self.counts["bursts"] == MAX_BURSTS:
                    line = f"more than {self._max_rate:.0f} datagrams a second; the system drops some"
                    self._messages.append(f"{self._name}: {line}")
                sleep(max(tick + TICK - monotonic(), 0.0))

    def wait(self, timeout: float) -> None:
        """Return when a value is queued, or after the timeout [s]."""
        # The first get of a queue takes its lock; where a signal or the scheduler then outlasts the timeout,
        # CPython waits without end. A get that does not wait takes that lock.
        with suppress(Empty):
            return self._arrived.get_nowait()
        with suppress(Empty):
            self._arrived.get(timeout=timeout)

    def pop(self) -> list[tuple[float, T, int]]:
        """Return arrival by `time.monotonic` [s], value, and session of the sender of what came since the last call."""
        with suppress(Empty):
            self._arrived.get_nowait()
        return self._queue.take()

    @property
    def summary(self) -> str:
        """The counts in one line."""
        refused = [f"{n} {kind}" for kind, n in self.counts.items() if kind not in ("taken", "bursts", *LOST)]
        lost = f", {n} lost" if (n := sum(self.counts[kind] for kind in LOST)) else ""
        rejected = f", rejected: {', '.join(refused)}" if refused else ""
        return f"{self.counts['taken']} {self._name}{lost}{rejected}"

    def receive(self, datagram: bytes, sender: tuple[str, int], now: float) -> None:
        """Queue one datagram, in the thread; `now` is its arrival by `time.monotonic` [s].

        Raises:
            InputError: it is not valid; it is counted, and the first one is reported.
        """
        if now - self._last_arrival > SENDER_TIMEOUT:
            self._last = None
        elif sender != self._address:
            return self.reject("from another sender", f"{sender[0]}:{sender[1]} sends {self._name} too")
        content = self._parse(decode_object(datagram))
        if self._last is None:
            self._session += 1
            self._begun, self._lost_before = now, self.counts["lost"]
            self._address, self.frame = sender, content.frame
            again = "again " if self._session > 1 else ""
            frame = f", frame {content.frame[:40]!r}" if content.frame else ""
            self._messages.append(f"{self._name}: {again}from {sender[0]}:{sender[1]}{frame}")
        elif content.frame != self.frame:
            return self.reject("in another frame", f"frame {content.frame[:40]!r} after {self.frame[:40]!r}")
        elif contradiction := self._contradiction(content, self._last, now):
            return self.reject(*contradiction)
        self._last, self._last_arrival = content, now
        self.counts["taken"] += 1
        if len(self._queue) == self._queue.maxlen:
            self.counts["dropped"] += 1
            if self.counts["dropped"] == 1:
                self._messages.append(f"{self._name}: they arrive faster than they are processed; the oldest are lost")
        self._queue.append((now, content.value, self._session))
        if self._arrived.empty():
            self._arrived.put(None)

    def _contradiction(self, new: Parsed[T], last: Parsed[T], now: float) -> tuple[str, str] | None:
        """Return kind and description of a contradiction to the last datagram, or None; `now` is the arrival [s]."""
        elapsed = now - self._last_arrival
        if (new.sequence is None) != (last.sequence is None):
            return "not always numbered", "only some datagrams have a sequence"
        lost = 0
        if new.sequence is not None and last.sequence is not None:
            lost = new.sequence - last.sequence - 1
            if lost < 0:
                return "late or duplicated", f"sequence {new.sequence} after {last.sequence}"
            # neither since the last one nor in all can more be lost than can have been sent
            excess, total = lost - self._max_rate * elapsed, self.counts["lost"] - self._lost_before + lost
            if max(excess, total - self._max_rate * (now - self._begun)) >= self._max_rate * MAX_TIME_JUMP:
                return "leaping in sequence", f"sequence leaps by {lost + 1} within {1e3 * elapsed:.3g} ms"
        if math.isnan(new.time) != math.isnan(last.time):
            return "not always timed", "only some datagrams have a time"
        step = new.time - last.time  # NaN without times
        if step <= 0.0:
            return "not increasing in time", f"time_s = {new.time:.9g} is not after {last.time:.9g}"
        if step - elapsed > MAX_TIME_JUMP:
            return "jumping in time", f"time_s jumps by {step:.3g} s"
        if lost:
            self.counts["lost"] += lost
        return None
