"""RDT: the protocol of the box over UDP (big-endian), a session with it, and the sensor's clock.

Source: ATI, Net F/T Sensor System, installation and operation manual 9620-05-NET FT, the chapter on RDT and the table
of the system status code. ATI, F/T Sensor, Ethernet Axia, manuals 9610-05-Ethernet Axia-09, tables 4.7 and 4.9, and
9620-05-C-Ethernet Axia-02, table 5.7: an Axia has the same protocol, but another table.
"""

import math
import select
import socket
import struct
import sys
from collections import Counter
from collections.abc import Generator
from contextlib import suppress
from dataclasses import dataclass
from time import monotonic, sleep, time_ns
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from probedesign.core.errors import InputError
from probedesign.core.frames import Array
from probedesign.live.sources.source import STALE_TIME

RDT_PORT = 49152
HTTP_PORT = 80
PAGE = "/netftapi2.xml"

SAMPLES_PER_SECOND = 7000
"""Sampling rate of the box, independent of the record rate, counted by `ft_sequence`. The record rate is an integer
fraction of it."""
MAX_RECORDS = 40
"""Maximum number of records in a packet of buffered streaming."""

STOP, REALTIME, BUFFERED, RESET_LATCH, BIAS = 0x0000, 0x0002, 0x0003, 0x0041, 0x0042
"""Commands to the box."""

HEADER = 0x1234
REQUEST = struct.Struct(">HHI")
RECORD = struct.Struct(">III6i")
RECORDS = np.dtype([("rdt", ">u4"), ("ft", ">u4"), ("status", ">u4"), ("counts", ">i4", 6)])
"""The record as an array type."""


class Request(NamedTuple):
    """Request of a client: a command, and a number of records; 0 is unlimited."""

    command: int
    records: int = 0

    def packed(self) -> bytes:
        """Return the request as eight bytes."""
        return REQUEST.pack(HEADER, self.command, self.records)


def parse_request(datagram: bytes) -> Request | None:
    """Return the request in a datagram; None if it is not a request."""
    if len(datagram) != REQUEST.size:
        return None
    header, command, count = REQUEST.unpack(datagram)
    return Request(command, count) if header == HEADER else None


HEALTHY = (0x00000000, 0x80010000)
"""The second value: a monitor condition has been latched, which is not a fault of the sample."""

SUMMARY, LATCHED, SATURATED = 1 << 31, 1 << 16, 1 << 17
HARMLESS = (*HEALTHY, LATCHED)


class StatusTable(NamedTuple):
    """Meaning of the status word of one kind of sensor.

    Attributes:
        kind: the kind, for messages.
        texts: faults by bit; bit 31 is the summary.
        harmless: status words that are not faults of the sample.
    """

    kind: str
    texts: dict[int, str]
    harmless: tuple[int, ...]


NET_BOX = StatusTable(
    "Net Box",
    {
        30: "processor or memory error",
        29: "digital board error",
        28: "analogue board error",
        27: "serial link error",
        26: "program memory error",
        25: "halted by a wrong configuration",
        24: "settings are not valid",
        23: "configuration does not fit the calibration",
        22: "network failure",
        21: "CAN failure",
        20: "RDT failure",
        19: "EtherNet/IP failure",
        18: "DeviceNet failure",
        17: "transducer saturated or A/D error",
        14: "watchdog",
        13: "stack",
        12: "EEPROM failure",
        11: "flash failure",
        10: "analogue board watchdog",
        9: "gauge excitation current too high",
        8: "gauge excitation current too low",
        7: "artificial ground out of range",
        6: "supply too high",
        5: "supply too low",
        4: "no data from the transducer",
        3: "reference voltage or power",
        2: "temperature",
        1: "HTTP failure",
    },
    HARMLESS,
)
AXIA = StatusTable(
    "Axia",
    {
        30: "force or torque out of range",
        29: "calibration checksum error",
        28: "simulated error",
        27: "gauge out of range",
        7: "calibration not accessible",
        5: "other error",
        3: "busy with a change of its settings; the reading may be affected",
        2: "broken gauge",
        1: "supply voltage out of range",
        0: "temperature out of range",
    },
    (0, LATCHED),
)
"""Bit 3 is no error by the manual, but readings are not reliable meanwhile."""


def fault_of(status: int, table: StatusTable = NET_BOX) -> str:
    """Return the fault of a status word; empty without one."""
    if status in table.harmless:
        return ""
    texts = [text for bit, text in table.texts.items() if status >> bit & 1]
    return f"{', '.join(texts) or 'unknown fault'} (status 0x{status:08x})"


MAX_RECORDS_AT_ONCE = 700
"""Maximum number of records read at once: 0.1 s."""
GATHER_TIME, MAX_GATHER_TIME = 0.001, 0.010
"""Least and largest time in which records are gathered [s]: waking up for a record costs more than reading it."""
MIN_SLEEP = 0.0003
"""Least time of one sleep while records are gathered [s], two records."""
REQUEST_INTERVAL = 0.5
"""Minimum interval between requests for the stream [s]."""
SWITCH_INTERVAL = 1e-4
"""Thread switch interval of the interpreter while streaming [s]. Each read releases the interpreter; another computing
thread would keep it for Python's usual 5 ms, longer than the interval between records."""
BUFFER_BYTES = 1 << 22
"""Size of the socket's buffer that is requested of the system [bytes]."""
BYTES_PER_RECORD = 768
"""Memory that Linux counts for one record in the buffer [bytes]: measured, 277 records fill 212,992 bytes."""
MIN_BUFFERED_TIME = 0.25
"""Duration of the stream below which a smaller buffer is reported [s]: the longest pauses of a busy desktop."""
MAX_MISSING = 4096
"""Maximum number of lost records that are remembered, to recognise them if they arrive late."""
SO_TIMESTAMPNS, SO_RXQ_OVFL = 35, 40
"""Options of Linux, without names in Python: each datagram comes with its time of arrival by the wall clock, and with
the number of datagrams that did not fit into the buffer."""
MAX_DATAGRAM, ANCILLARY_BYTES = 2048, 128


@dataclass(frozen=True)
class RdtRecords:
    """n records of the box, in the order of arrival.

    Attributes:
        ft_sequence: sequence numbers of the sensor's samples, (n,).
        status: status words, (n,).
        received: arrival by `time.monotonic` [s], (n,).
        counts: counts of the six channels, (n, 6).
    """

    ft_sequence: NDArray[np.int64]
    status: NDArray[np.int64]
    received: Array
    counts: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.ft_sequence)

    def __getitem__(self, part: slice | NDArray[np.bool_]) -> "RdtRecords":
        """Return some of the records."""
        return RdtRecords(self.ft_sequence[part], self.status[part], self.received[part], self.counts[part])


NO_RECORDS = RdtRecords(np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0), np.empty((0, 6), np.int64))
Ancillary = list[tuple[int, int, bytes]]
"""What the system states about a datagram: level, kind and content."""


class RdtSession:
    """Streams the records of one box, and requests the stream again when it is silent.

    It sleeps until as many records are due as are wanted, and reads and decodes them together. Arrival is stated by the
    system, where that is Linux, so that it does not depend on how late they are read; elsewhere it is the time of
    reading.

    Attributes:
        wanted: number of records that are used together.
        counts: number of records received, lost, late, doubled, malformed, and dropped by the socket's buffer.
        buffer_bytes: size of the socket's buffer that the system granted [bytes].
    """

    def __init__(self, name: str, host: str, port: int, rate: float = SAMPLES_PER_SECOND) -> None:
        """Open a socket to the box at a host and RDT port; nothing streams yet.

        Args:
            name: name of the source, for messages.
            host: host of the box.
            port: its RDT port.
            rate: records a second.

        Raises:
            InputError: the host is unknown.
        """
        self.wanted = 1
        self.counts: Counter[str] = Counter()
        self._sequence = SequenceMonitor(self.counts)
        self._rate, self._requested, self._received = rate, -math.inf, -math.inf
        self._datagrams: list[bytes] = []
        self._ancillary: list[Ancillary] = []
        try:
            found = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
            link = socket.socket(*found[:3])
            link.connect(found[4])  # from then on the system accepts datagrams of this address only
        except OSError as error:
            raise InputError(f"{name}: {error.strerror or error}") from None
        link.setblocking(False)
        link.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER_BYTES)
        self.buffer_bytes = link.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)
        if sys.platform == "linux":
            link.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
            link.setsockopt(socket.SOL_SOCKET, SO_RXQ_OVFL, 1)
        self._link = link

    @property
    def notes(self) -> tuple[str, ...]:
        """A note if the system granted a buffer that is shorter than the pauses of a busy computer."""
        buffered = self.buffer_bytes / BYTES_PER_RECORD / SAMPLES_PER_SECOND
        if buffered >= MIN_BUFFERED_TIME:
            return ()
        return (
            f"the system grants a buffer of {1e3 * buffered:.0f} ms of records; longer pauses of this computer lose "
            f"records. On Linux: sysctl -w net.core.rmem_max={BUFFER_BYTES}",
        )

    def records(self) -> Generator[RdtRecords, None, None]:
        """Yield new records as they arrive; none after each `STALE_TIME` without one."""
        usual = sys.getswitchinterval()
        sys.setswitchinterval(min(usual, SWITCH_INTERVAL))
        try:
            self._request()
            last = started = monotonic()  # the last new record; the first that was gathered
            while True:
                if not self._datagrams:
                    started = monotonic()
                self._receive_waiting()
                now, n = monotonic(), len(self._datagrams)
                missing = max(self.wanted, self._rate * GATHER_TIME) - n
                if n and (missing < 1.0 or now - started > MAX_GATHER_TIME):
                    if len(records := self._decoded()):
                        last = now
                        yield records
                elif n:
                    sleep(min(max(missing / self._rate, MIN_SLEEP), MAX_GATHER_TIME))
                elif now - last <= STALE_TIME:
                    select.select([self._link], [], [], last + STALE_TIME - now + MIN_SLEEP)
                if now - last > STALE_TIME and not self._datagrams:
                    if now - self._requested > REQUEST_INTERVAL:
                        self._request()
                    last = now
                    yield NO_RECORDS
        finally:
            sys.setswitchinterval(usual)
            self._send(Request(STOP))
            self._link.close()

    def _request(self) -> None:
        """Request the stream, whose records are counted from one again."""
        self._requested = monotonic()
        self._sequence.restart()
        self._send(Request(REALTIME))

    def _send(self, request: Request) -> None:
        with suppress(OSError):  # the box is off or the network is down: the silence is reported
            self._link.send(request.packed())

    def _receive_waiting(self) -> None:
        """Read the datagrams that wait."""
        with suppress(OSError):  # nothing waits, or the system reports that the box is off
            for _ in range(MAX_RECORDS_AT_ONCE):
                datagram, ancillary = self._receive()
                if len(datagram) == RECORD.size:
                    self._datagrams.append(datagram)
                    self._ancillary.append(ancillary)
                else:
                    self.counts["malformed"] += 1

    def _receive(self) -> tuple[bytes, Ancillary]:
        """Return a datagram that waits, and what the system states about it."""
        if sys.platform == "win32":
            return self._link.recv(MAX_DATAGRAM), []
        return self._link.recvmsg(MAX_DATAGRAM, ANCILLARY_BYTES)[:2]

    def _decoded(self) -> RdtRecords:
        """Return the new records among the datagrams that were gathered."""
        table = np.frombuffer(b"".join(self._datagrams), dtype=RECORDS)
        rdt, ft, status = (table[name].astype(np.int64) for name in ("rdt", "ft", "status"))
        records = RdtRecords(ft, status, self._arrival(self._ancillary), table["counts"].astype(np.int64))
        self._datagrams, self._ancillary = [], []
        self.counts["received"] += len(table)
        new = self._sequence.accept(rdt, ft)
        return records if new is None else records[new]

    def _arrival(self, ancillary: list[Ancillary]) -> Array:
        """Return the arrival of datagrams by `time.monotonic` [s], (n,), and count those that were dropped.

        The system states it by the wall clock, which may be set at any time: the arrival is neither before that of the
        last datagram nor after now.
        """
        for _, kind, data in ancillary[-1]:
            if kind == SO_RXQ_OVFL:
                self.counts["dropped"] = int.from_bytes(data[:4], sys.byteorder)
        times = b"".join(data for extra in ancillary for _, kind, data in extra if kind == SO_TIMESTAMPNS)
        now = monotonic()
        if len(times) == TIMESPEC.itemsize * len(ancillary):
            stamps = np.frombuffer(times, dtype=TIMESPEC)
            ages = 1e-9 * (time_ns() - (stamps["s"] * 1_000_000_000 + stamps["ns"]))
            received = np.maximum.accumulate(np.clip(now - ages, self._received, now))
        else:
            received = np.full(len(ancillary), now)
        self._received = float(received[-1])
        return received


TIMESPEC = np.dtype([("s", np.int64), ("ns", np.int64)])
"""A time of the system on 64-bit computers."""


class SequenceMonitor:
    """Counts lost, late and doubled records by `rdt_sequence`, and selects those that are new.

    A record is late if it was counted as lost before, and doubled if it was not. A stream that is counted from one
    again, with samples that are newer, is another stream.
    """

    def __init__(self, counts: Counter[str]) -> None:
        """Start before the first record; `counts` is updated."""
        self._counts = counts
        self._last: tuple[int, int] | None = None
        self._missing: dict[int, None] = {}

    def restart(self) -> None:
        """Accept the next record, whatever its number."""
        self._last = None
        self._missing.clear()

    def accept(self, rdt: NDArray[np.int64], ft: NDArray[np.int64]) -> NDArray[np.bool_] | None:
        """Return which of n records are new by their numbers, (n,); None if all are.

        A sample that is repeated is not new.
        """
        if not len(rdt):
            return None
        before = self._last
        if before is not None and (steps(rdt, before[0]) == 1).all() and (steps(ft, before[1]) != 0).all():
            self._last = int(rdt[-1]), int(ft[-1])
            return None
        return np.array([self._is_new(*pair) for pair in zip(rdt.tolist(), ft.tolist(), strict=True)])

    def _is_new(self, rdt: int, ft: int) -> bool:
        if self._last is None:
            self._last = rdt, ft
            return True
        step, newer = _signed(rdt - self._last[0]), _signed(ft - self._last[1])
        if step <= 0 and newer <= 0:
            late = rdt in self._missing
            self._counts["late" if late else "doubled"] += 1
            if late:
                del self._missing[rdt]
                self._counts["lost"] -= 1
            return False
        if step > 1:
            self._counts["lost"] += step - 1
            for number in range(max(1, step - MAX_MISSING), step):
                self._missing[(self._last[0] + number) % WRAP] = None
            while len(self._missing) > MAX_MISSING:
                del self._missing[next(iter(self._missing))]
        self._last = rdt, ft
        return newer != 0


def _signed(difference: int) -> int:
    """Return the difference of two 32-bit counters, positive if the first is ahead."""
    return (difference + WRAP // 2) % WRAP - WRAP // 2


WRAP = 1 << 32
MAX_LEAD = 10.0
"""Maximum lead of the counter over the host's clock [s]; more indicates another counter. Buffers are shorter, and a
suspended program finds no old records."""


class RecordTimes(NamedTuple):
    """Times of n records.

    Attributes:
        new: whether each record is a new sample, not a repeated one, (n,).
        time: times of the k new samples [s], (k,).
        restarted: whether the counter restarted before each new sample, (k,).
    """

    new: NDArray[np.bool_]
    time: Array
    restarted: NDArray[np.bool_]


def steps(values: NDArray[Any], before: float) -> NDArray[Any]:
    """Return the difference of each value to the one before, the first to `before`, (n,).

    As `np.diff`, which takes four times as long for few values.
    """
    differences = np.empty_like(values)
    differences[:1] = values[:1] - before
    np.subtract(values[1:], values[:-1], out=differences[1:])
    return differences


class SensorClock:
    """Time since the first record by `ft_sequence` [s], a 32-bit counter that overflows, stops or restarts.

    The time never decreases.

    Attributes:
        restarts: number of restarts of the counter; the host's clock covers the gaps.
    """

    def __init__(self, rate: float = SAMPLES_PER_SECOND) -> None:
        """Start before the first record; the counter advances by `rate` a second [Hz]."""
        self.restarts, self._rate = 0, rate
        self._last: tuple[int, float] | None = None
        self._ticks = 0

    def times(self, ft_sequence: NDArray[np.int64], received: Array) -> RecordTimes:
        """Return the times of consecutive records by sequence numbers and arrival by the host's clock [s], (n,)."""
        new = np.ones(len(ft_sequence), dtype=bool)
        new[1:] = np.diff(ft_sequence) != 0
        if self._last is not None and len(new):
            new[0] = ft_sequence[0] != self._last[0]
        ft, received = ft_sequence[new], received[new]
        if not len(ft):
            return RecordTimes(new, np.empty(0), np.empty(0, dtype=bool))
        before = self._last or (int(ft[0]), float(received[0]))
        ticks = steps(ft, before[0]) % WRAP
        elapsed = np.maximum(steps(received, before[1]), 0.0)
        restarted = ticks / self._rate > elapsed + MAX_LEAD
        bridged = np.maximum(np.rint(elapsed * self._rate), 1.0).astype(np.int64)
        counted = self._ticks + np.cumsum(np.where(restarted, bridged, ticks))
        self.restarts += int(restarted.sum())
        self._last, self._ticks = (int(ft[-1]), float(received[-1])), int(counted[-1])
        return RecordTimes(new, counted / self._rate, restarted)


RATE_PERIOD = 5.0
"""Interval over which the rate of the counter is measured [s]; the host's clock is far better than the limit."""
MAX_RATE_ERROR, RATE_SCATTER = 0.05, 0.02
"""Fraction of the expected rate by which two successive measurements must deviate to be reported, and within which they
must agree."""


class RateMonitor:
    """Compares the rate of the sensor's counter with the host's clock; an Axia may sample at another rate."""

    def __init__(self, rate: float) -> None:
        """Start before the first record; `rate` is the one that is assumed [Hz]."""
        self._rate, self._start = rate, (0.0, 0.0)
        self._before = rate
        self._reported = False

    def reset(self) -> None:
        """Forget the interval that has begun, because records are missing in it."""
        self._start = (0.0, 0.0)

    def measured(self, time: float, received: float) -> float | None:
        """Return the measured rate [Hz], once, if it deviates; both times are those of the last record [s]."""
        if self._start == (0.0, 0.0):
            self._start = (time, received)
            return None
        elapsed = received - self._start[1]
        if elapsed < RATE_PERIOD:
            return None
        found = self._rate * (time - self._start[0]) / elapsed
        before, self._before, self._start = self._before, found, (time, received)
        deviates = (
            abs(found / self._rate - 1.0) > MAX_RATE_ERROR and abs(found - before) < RATE_SCATTER * self._rate
        )
        if not deviates or self._reported:
            return None
        self._reported = True
        return found
