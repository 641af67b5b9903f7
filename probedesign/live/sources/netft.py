"""Source `netft://HOST[:PORT]`: a session with a Net F/T box, and its records as wrenches, times and faults.

The session requests the stream, reads its records in one pass, and requests it again after a silence.
"""

import ctypes
import math
import select
import socket
import sys
from collections import Counter, deque
from collections.abc import Generator
from contextlib import closing, suppress
from dataclasses import dataclass
from itertools import pairwise
from math import inf, isfinite
from time import monotonic, sleep, time_ns
from typing import Any

import numpy as np
from numpy.typing import NDArray

from probedesign.core.errors import InputError
from probedesign.core.frames import Array
from probedesign.estimation.model import ProbeModel
from probedesign.live import Log, split_address
from probedesign.live.blocks import Block, dropout_block
from probedesign.live.priority import prompt_estimates
from probedesign.live.sources.netft_configuration import (
    ConfigurationMonitor,
    NetFTConfiguration,
    fetch_page,
    parse_configuration,
)
from probedesign.live.sources.netft_rdt import (
    AXIA,
    HTTP_PORT,
    NET_BOX,
    RDT_PORT,
    REALTIME,
    RECORD,
    SAMPLES_PER_SECOND,
    STOP,
    RateMonitor,
    Request,
    SensorClock,
    SequenceMonitor,
    fault_of,
)
from probedesign.live.sources.source import STALE_TIME, DropoutMonitor, SourceParameter, parse_parameters, range_note

MAX_RECORDS = 700  #: Maximum number of records that are gathered: 0.1 s.
MAX_DATAGRAM = 2048  #: More bytes than any datagram of a box has.
#: Options of Linux, without names in Python: each datagram comes with its time of arrival by the wall clock, and with
#: the number of datagrams that were dropped since the buffer was full, once there is one.
SO_TIMESTAMPNS, SO_RXQ_OVFL = 35, 40


#: Records: numbers of record and sample, status, counts of the six channels, (n, 9); their arrival by `time.monotonic`
#: [s], (n,), not yet limited to that of earlier ones; the number of datagrams that the socket's buffer has dropped so
#: far, None if it is not stated.
Gathered = tuple[NDArray[np.int64], Array, int | None]


class SingleReceiver:
    """Gathers the records that wait at a socket, one by one.

    Attributes:
        count: number of records gathered.
        malformed: number of datagrams so far that are no record.
    """

    def __init__(self, link: socket.socket) -> None:
        self._link, self.count, self.malformed = link, 0, 0
        self._datagrams: list[bytes] = []
        self._received: list[float] = []

    def read(self) -> None:
        """Read the datagrams that wait, up to `MAX_RECORDS` in all."""
        with suppress(OSError):  # nothing waits, or the system reports that the box is off
            for _ in range(MAX_RECORDS - self.count):
                datagram = self._link.recv(MAX_DATAGRAM)
                if len(datagram) != RECORD.size:
                    self.malformed += 1
                    continue
                self._datagrams.append(datagram)
                self._received.append(monotonic())
                self.count += 1

    def take(self) -> Gathered:
        """Return what was gathered, and begin again."""
        rows = np.frombuffer(b"".join(self._datagrams), dtype=np.uint8).reshape(-1, RECORD.size)
        received = np.array(self._received)
        self._datagrams, self._received, self.count = [], [], 0
        return _words(rows), received, None


def _words(rows: NDArray[np.uint8]) -> NDArray[np.int64]:
    words = rows.view(">i4").astype(np.int64)
    words[:, :3] &= 0xFFFFFFFF  # without a sign
    return words


#: A `struct mmsghdr` of 64-bit Linux.
_HEADS = np.dtype([("name", "u8"), ("name_length", "u8"), ("parts", "u8"), ("n_parts", "u8"), ("control", "u8"),
                   ("control_length", "u8"), ("flags", "u8"), ("length", "u4"), ("", "u4")])  # fmt: skip
_PARTS = np.dtype([("base", "u8"), ("length", "u8")])  #: A `struct iovec`.
#: What the system states about a datagram, in this order: its arrival, and the number dropped once there is one.
_CONTROL = np.dtype([("stamp_length", "u8"), ("stamp_level", "i4"), ("stamp_kind", "i4"), ("s", "i8"), ("ns", "i8"),
                     ("dropped_length", "u8"), ("dropped_level", "i4"), ("dropped_kind", "i4"), ("dropped", "u4"),
                     ("", "u4")])  # fmt: skip
_STAMP_LENGTH = 32  #: Length of the first part of it [bytes].
_ROW = 64  #: Bytes for one datagram: more than those of a record, so that a longer one is recognised.


class BatchReceiver(SingleReceiver):
    """Reads all datagrams in one call, each into its row of one table.

    Linux reads many datagrams in one call of the system (`recvmmsg`, which Python does not offer) and states the
    arrival of each. The call does not release the interpreter: reading one by one would release it for each record, and
    another computing thread would keep it for a tenth of a millisecond each time.
    """

    def __init__(self, link: socket.socket, call: Any) -> None:
        """Prepare the memory; `call` is `recvmmsg`."""
        link.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        link.setsockopt(socket.SOL_SOCKET, SO_RXQ_OVFL, 1)
        super().__init__(link)
        self._call = call
        self._rows = np.zeros((MAX_RECORDS, _ROW), np.uint8)
        self._control, self._parts = np.zeros(MAX_RECORDS, _CONTROL), np.zeros(MAX_RECORDS, _PARTS)
        self._heads = np.zeros(MAX_RECORDS, _HEADS)
        numbers = np.arange(MAX_RECORDS, dtype=np.uint64)
        self._parts["base"], self._parts["length"] = self._rows.ctypes.data + numbers * np.uint64(_ROW), _ROW
        self._heads["parts"] = self._parts.ctypes.data + numbers * np.uint64(_PARTS.itemsize)
        self._heads["n_parts"] = 1
        self._heads["control"] = self._control.ctypes.data + numbers * np.uint64(_CONTROL.itemsize)
        self._lengths, self._control_lengths = self._heads["length"], self._heads["control_length"]
        self._control_lengths[:] = _CONTROL.itemsize
        self._address = self._heads.ctypes.data

    def read(self) -> None:
        """Read the datagrams that wait; see `SingleReceiver`."""
        start = self.count
        address = self._address + start * _HEADS.itemsize
        n = self._call(self._link.fileno(), address, MAX_RECORDS - start, socket.MSG_DONTWAIT, None)
        if n <= 0:  # nothing waits, or the system reports that the box is off
            return
        end = start + n
        whole = self._lengths[start:end] == RECORD.size
        if whole.all():
            self.count = end
            return
        kept = start + np.flatnonzero(whole)
        self.count = start + len(kept)
        self.malformed += end - self.count
        for table in (self._rows, self._control, self._control_lengths):
            table[start : self.count] = table[kept]
        self._control_lengths[self.count : end] = _CONTROL.itemsize

    def take(self) -> Gathered:
        """Return what was gathered; see `SingleReceiver`."""
        n = self.count
        words = _words(self._rows[:n, : RECORD.size])
        stated, control = self._control_lengths[:n], self._control[:n]
        now, wall = monotonic(), time_ns()
        if stated.min() >= _STAMP_LENGTH and (control["stamp_kind"] == SO_TIMESTAMPNS).all():
            received = now - 1e-9 * (wall - (control["s"] * 1_000_000_000 + control["ns"]))
        else:
            received = np.full(n, now)
        known = stated[-1] > _STAMP_LENGTH and control["dropped_kind"][-1] == SO_RXQ_OVFL
        dropped = int(control["dropped"][-1]) if known else None
        stated[:] = _CONTROL.itemsize
        self.count = 0
        return words, received, dropped


def open_receiver(link: socket.socket) -> SingleReceiver:
    """Return the receiver of a socket that does not block."""
    try:
        call = ctypes.PyDLL(None).recvmmsg if sys.platform == "linux" and sys.maxsize > 1 << 32 else None
    except (OSError, AttributeError):  # the system's library has none
        call = None
    if call is None:
        return SingleReceiver(link)
    call.argtypes = (ctypes.c_int, ctypes.c_void_p, ctypes.c_uint, ctypes.c_int, ctypes.c_void_p)
    call.restype = ctypes.c_int
    return BatchReceiver(link, call)


#: Least and largest time in which records are gathered [s]: waking up for a record costs more than reading it.
GATHER_TIME, MAX_GATHER_TIME = 0.001, 0.010
#: Least time of one sleep while records are gathered [s]: a program or a switch that sends records in bursts needs less
#: for one of them.
MIN_SLEEP = 0.0002
#: Number of readings together from which it is found when a record arrives at the earliest, 0.7 s of means.
WINDOW = 128
REQUEST_INTERVAL = 0.5  #: Minimum interval between requests for the stream [s].
BUFFER_BYTES = 1 << 22  #: Size of the socket's buffer that is requested of the system [bytes].
#: Memory that Linux counts for one record in the buffer [bytes]: measured, 277 records fill 212,992 bytes.
BYTES_PER_RECORD = 768
#: Duration of the stream below which a smaller buffer is reported [s]: the longest pauses of a busy desktop.
MIN_BUFFERED_TIME = 0.25


def buffer_note(granted: int) -> tuple[str, ...]:
    """Return a note if the system granted a buffer [bytes] that is shorter than the pauses of a busy computer."""
    buffered = granted / BYTES_PER_RECORD / SAMPLES_PER_SECOND
    if buffered >= MIN_BUFFERED_TIME:
        return ()
    return (
        f"the system grants a buffer of {1e3 * buffered:.0f} ms of records; longer pauses of this computer lose "
        f"records. On Linux: sysctl -w net.core.rmem_max={BUFFER_BYTES}",
    )


@dataclass(frozen=True)
class RdtRecords:
    """n records of the box, in the order of arrival."""

    ft_sequence: NDArray[np.int64]  #: sequence numbers of the sensor's samples, (n,).
    status: NDArray[np.int64]  #: status words, (n,).
    received: Array  #: arrival by `time.monotonic` [s], (n,).
    counts: NDArray[np.int64]  #: counts of the six channels, (n, 6).

    def __len__(self) -> int:
        return len(self.ft_sequence)

    def __getitem__(self, part: slice | NDArray[np.bool_]) -> "RdtRecords":
        return RdtRecords(self.ft_sequence[part], self.status[part], self.received[part], self.counts[part])


class RdtSession:
    """Streams the records of one box, and requests the stream again when it is silent.

    It sleeps until as many records are due as are wanted, and reads and decodes them together. Arrival is stated by the
    system, where that is Linux, so that it does not depend on how late they are read; elsewhere it is the time of
    reading.

    Attributes:
        wanted: number of records that are used together.
        counts: number of records received, lost, late, malformed, and dropped by the socket's buffer.
        buffer_bytes: size of the socket's buffer that the system granted [bytes].
    """

    def __init__(self, name: str, host: str, port: int, rate: float = SAMPLES_PER_SECOND) -> None:
        """Open a socket to the box at a host and RDT port, which sends `rate` records a second; nothing streams yet.

        Raises:
            InputError: the host is unknown.
        """
        self.wanted = 1
        self.counts: Counter[str] = Counter()
        self._sequence = SequenceMonitor(self.counts)
        self._rate, self._requested, self._received = rate, -math.inf, -math.inf
        try:
            address = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
            link = socket.socket(*address[:3])
            link.connect(address[4])  # from then on the system accepts datagrams of this address only
        except OSError as error:
            raise InputError(f"{name}: {error.strerror or error}") from None
        link.setblocking(False)
        link.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER_BYTES)
        self.buffer_bytes = link.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)
        self._link, self._receiver = link, open_receiver(link)
        self._newest, self._delays = 0, deque[float](maxlen=WINDOW)

    def records(self) -> Generator[RdtRecords | None, None, None]:
        """Yield new records as they arrive; None after each `STALE_TIME` without one."""
        try:
            self._request()
            last = started = monotonic()  # the last new record; the first that was gathered
            while True:
                before = self._receiver.count
                if not before:
                    started = monotonic()
                self._receiver.read()
                self.counts["malformed"] = self._receiver.malformed
                now, n = monotonic(), self._receiver.count
                gathered = max(self.wanted, self._rate * GATHER_TIME)
                if n and (n > gathered - 1.0 or now - started > MAX_GATHER_TIME or n == MAX_RECORDS):
                    words, received, dropped = self._receiver.take()
                    rdt, ft = words[:, 0], words[:, 1]
                    # The system states it by the wall clock, which may be set at any time.
                    received = np.maximum.accumulate(np.maximum(np.minimum(received, monotonic()), self._received))
                    self._received = float(received[-1])
                    records = RdtRecords(ft, words[:, 2], received, words[:, 3:])
                    self.counts["received"] += len(words)
                    if dropped is not None:
                        self.counts["dropped"] = dropped
                    self._newest = int(rdt[-1])
                    self._delays.append(self._received - self._newest / self._rate)
                    new = self._sequence.accept(rdt, ft)
                    if new is None or new.any():
                        last = now
                        yield records if new is None else records[new]
                elif n > before:
                    # The last of them arrives then at the earliest; a network or a busy program delays some.
                    due = min(self._delays, default=-math.inf) + (self._newest + gathered) / self._rate
                    sleep(min(max(due - now, MIN_SLEEP), MAX_GATHER_TIME))
                elif now - last <= STALE_TIME:  # the next record, or the silence
                    select.select([self._link], [], [], last + STALE_TIME - now + MIN_SLEEP)
                if now - last > STALE_TIME and not self._receiver.count:
                    if now - self._requested > REQUEST_INTERVAL:
                        self._request()
                    last = now
                    yield None
        finally:
            self._send(Request(STOP))
            self._link.close()

    def _request(self) -> None:
        self._requested = monotonic()
        self._sequence.restart()
        self._delays.clear()
        self._send(Request(REALTIME))

    def _send(self, request: Request) -> None:
        with suppress(OSError):  # the box is off or the network is down: the silence is reported
            self._link.send(request.packed())


COUNT_INTERVAL = 1.0  #: Interval at which the counts are updated [s].
REPORT_INTERVAL = 10.0  #: Minimum interval between reports of losses [s].

#: Texts of the counters, in the order of the summary.
COUNTERS = {
    "lost": "lost", "late": "late or duplicated", "malformed": "malformed", "faults": "with a fault",
    "dropped": "lost because this computer read too slowly", "interruptions": "interruptions", "restarts": "restarts",
}  # fmt: skip
REPORTED = ("lost", "dropped", "malformed")  #: Counters that are reported while they increase.


NO_RECORD = "the box responds to HTTP but sends no records; check the firewall and the port"
FAULT_REPORT_INTERVAL = 1.0  #: Minimum interval between reports of faults [s]: a load near the limit causes many.


PARAMETERS = {
    "http": SourceParameter(HTTP_PORT, 1, 65535, integer=True),
    "check_s": SourceParameter(2.0, 0.1, 3600.0),
    "clock_hz": SourceParameter(SAMPLES_PER_SECOND, 100.0, 10_000.0),
}
STATUS_TABLES = {"netbox": NET_BOX, "axia": AXIA}
TEXT_PARAMETERS = {"sensor": tuple(STATUS_TABLES)}


class NetFTSource:
    """A box at an address; see `Source`.

    Attributes:
        counts: number of records with each of `COUNTERS`, and received, updated every second.
    """

    def __init__(self, model: ProbeModel, target: str, query: str, log: Log) -> None:
        """Fetch the configuration of the box at `//HOST[:PORT]`; nothing streams yet.

        The parameters are `PARAMETERS` and `TEXT_PARAMETERS`.

        Raises:
            InputError: the address or a parameter is invalid, or no box responds.
        """
        host, port = split_address(f"netft:{target}", "netft") or ("", None)
        if not host or port == 0:
            raise InputError(f"netft:{target}: write netft://HOST or netft://HOST:PORT")
        port = RDT_PORT if port is None else port
        parameters, texts = parse_parameters("netft:", query, PARAMETERS, TEXT_PARAMETERS)
        self._name = f"netft://{host}:{port}"
        page = host, int(parameters["http"])
        self._gravity, self._log = model.gravity_base, log
        self.configuration: NetFTConfiguration = parse_configuration(fetch_page(*page))
        self._session = RdtSession(self._name, host, port, self.configuration.rate)
        self.title = f"{self._name}, {self.configuration.product}"
        self.notes = self.configuration.notes
        if len(self.configuration.ranges) == 6:
            ranges = np.array(self.configuration.ranges) * self.configuration.units
            self.notes += range_note("box", ranges, model)
        axia = "axia" in self.configuration.product.lower()  # assumed: the manual does not list the names
        self._table = STATUS_TABLES[texts["sensor"] or ("axia" if axia else "netbox")]
        self.notes += buffer_note(self._session.buffer_bytes)
        rate = parameters["clock_hz"]
        self._clock, self._rate = SensorClock(rate), RateMonitor(rate)
        self._monitor = ConfigurationMonitor(*page, self.configuration, parameters["check_s"])
        self.notes += (f"its status codes are decoded as those of a sensor of type {self._table.kind}",)
        self.counts: Counter[str] = Counter()
        self._reported, self._report_time = Counter[str](), -inf
        self._last, self._stretch = -inf, 0
        self._awaited = 0  # the first request for the page since the box restarted
        self._counted, self._faulted, self._fault = -inf, -inf, ""

    def expect(self, readings: int) -> None:
        """Gather this number of readings to a block; see `Source`."""
        self._session.wanted = readings

    def __iter__(self) -> Generator[Block, None, None]:
        self._dropout = DropoutMonitor(self._name, self._log, NO_RECORD)
        self._started = monotonic()
        try:
            with self._monitor, prompt_estimates() as granted, closing(self._blocks()) as blocks:
                if granted:
                    self._log(f"{self._name}: estimates have a real-time priority")
                yield from blocks
        finally:
            self._count()
            text = ", ".join(f"{self.counts[name]} {text}" for name, text in COUNTERS.items() if self.counts[name])
            self._log(f"{self._name}: {self.counts['received']} records, {text or 'none lost'}")

    def _blocks(self) -> Generator[Block, None, None]:
        with closing(self._session.records()) as stream:
            for records in stream:
                self._check_configuration()
                if monotonic() - self._counted > COUNT_INTERVAL:
                    self._count()
                    more = {name: self.counts[name] - self._reported[name] for name in REPORTED}
                    if any(more.values()) and monotonic() - self._report_time > REPORT_INTERVAL:
                        text = ", ".join(f"{count} {COUNTERS[name]}" for name, count in more.items() if count)
                        self._log(f"{self._name}: {text}; {self.counts['received']} received so far")
                        self._reported, self._report_time = self.counts.copy(), monotonic()
                yield from self._decode(records) if records is not None else self._report_silence()

    def _count(self) -> None:
        self._counted = monotonic()
        for name, count in self._session.counts.items():
            self.counts[name] = count
        # what did not fit into the buffer is missing in the numbers of the records, too; a forged number leaps further
        sent = round((self._counted - self._started) * self.configuration.rate)
        self.counts["lost"] = max(min(self.counts["lost"], sent) - self.counts["dropped"], 0)

    def _decode(self, records: RdtRecords) -> Generator[Block, None, None]:
        """Yield blocks of records, split where the stream was interrupted and where the fault changes."""
        new, time, broken = self._clock.times(records.ft_sequence, records.received)
        records = records if new.all() else records[new]
        if not len(records):
            return
        status = records.status
        if status.any():
            status = np.where(np.isin(status, self._table.harmless), 0, status)
        before = self._last if isfinite(self._last) else records.received[0]
        if records.received[-1] - before > STALE_TIME:
            broken |= np.diff(records.received, prepend=before) > STALE_TIME
        broken[0] |= self._dropout.ongoing
        uniform = not (broken.any() or status.any())
        cuts = [] if uniform else (np.flatnonzero(broken[1:] | (np.diff(status) != 0)) + 1).tolist()
        for start, end in pairwise([0, *cuts, len(records)]):
            received = records.received[start:end]
            if broken[start]:
                self._rate.reset()
                if not self._resumed(float(received[0])):
                    yield from self._report_silence("its page does not respond")
                    return
            wrench = records.counts[start:end] @ self.configuration.to_sensor.T
            fault = fault_of(int(status[start]), self._table) if status[start] else ""
            if fault:
                self.counts["faults"] += end - start
            if fault != self._fault and (not fault or monotonic() - self._faulted > FAULT_REPORT_INTERVAL):
                self._log(f"{self._name}: {fault or 'healthy again'}")
                self._fault, self._faulted = fault, monotonic()
            yield Block(time[start:end], wrench, self._gravity, received, fault, self._stretch)
            self._last = float(received[-1])
            if (rate := self._rate.measured(float(time[end - 1]), self._last)) is not None:
                self._log(
                    f"{self._name}: its counter advances by {rate:.0f} a second, so all times are wrong; "
                    f"restart with ?clock_hz={rate:.0f}"
                )

    def _report_silence(self, hint: str = "asking again") -> Generator[Block, None, None]:
        self._dropout.on_silence(self._last, hint)
        if self._dropout.ongoing:
            yield dropout_block(self._gravity, self._dropout.reason, self._stretch)

    def _resumed(self, received: float) -> bool:
        """Return whether resumed records come from the same box with the same configuration.

        Its page is read in the background. A counter that continues is that of the same box, so its records are used
        meanwhile. Those of another box, or of one that restarted, are not used before the page has been read.
        """
        restarted = self._clock.restarts > self.counts["restarts"]
        request = self._monitor.request()
        self._awaited = self._awaited or request
        if restarted and self._monitor.read < self._awaited:
            return False
        self._awaited = 0
        self._check_configuration()
        self._stretch += 1
        self.counts["interruptions"] += 1
        if restarted:
            self.counts["restarts"] = self._clock.restarts
            self._log(f"{self._name}: its clock restarted; the previous tare is kept, take a new one")
        self._dropout.on_resumed(received - self._last)
        return True

    def _check_configuration(self) -> None:
        if self._monitor.changed:
            text = ", ".join(self._monitor.changed)
            raise InputError(
                f"{self._name}: its configuration has changed ({text}); readings of the last "
                f"{self._monitor.period:g} s may be wrong; restart with a new tare"
            )
