"""RDT: the protocol of the box over UDP (big-endian), a session with it through pynetft, and the sensor's clock.

Source: ATI, Net F/T Sensor System, installation and operation manual 9620-05-NET FT, the chapter on RDT and the table
of the system status code. ATI, F/T Sensor, Ethernet Axia, manuals 9610-05-Ethernet Axia-09, tables 4.7 and 4.9, and
9620-05-C-Ethernet Axia-02, table 5.7: an Axia has the same protocol, but another table.
"""

import struct
import sys
from collections import Counter
from collections.abc import Generator
from contextlib import suppress
from dataclasses import dataclass
from itertools import chain, islice
from time import monotonic, sleep
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from probedesign.core.errors import InputError, MissingDependencyError
from probedesign.core.frames import Array
from probedesign.live.sources.source import STALE_TIME

if TYPE_CHECKING:
    from pynetft import Client


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


QUEUE_SIZE = 1 << 16
"""Maximum number of queued records: 9 s."""
MAX_RECORDS_AT_ONCE = 700
"""Maximum number of records read at once: 0.1 s."""
GATHER_TIME = 0.001
"""Time in which records are gathered, if there is time [s]: waking up for a record costs more than reading it."""
RENEW_AFTER = 0.5
"""Time after which a client that rejects all records, as after a restart of the box, is replaced [s]."""
RECONNECT_DELAY = 0.010
"""Delay before a new request after the end of a session [s]; pynetft ends it with every sample of a faulty status."""
SWITCH_INTERVAL = 1e-4
"""Thread switch interval of the interpreter while streaming [s]. Each read releases the interpreter; another computing
thread would keep it for Python's usual 5 ms, longer than the interval between records."""


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


class RdtSession:
    """Reads the records of one box with pynetft, and replaces a client that rejects all records.

    Attributes:
        counts: number of records received, lost, late, doubled, malformed, dropped by the queue.
    """

    def __init__(self, name: str, host: str, port: int) -> None:
        """Prepare a session with the box at a host and RDT port; nothing streams yet. `name` is for messages.

        Raises:
            MissingDependencyError: pynetft is not installed.
        """
        self.counts: Counter[str] = Counter()
        self._name, self._host, self._port = name, host, port
        self._client, self._closed = self._new_client(), Counter[str]()

    def records(self) -> Generator[RdtRecords, None, None]:
        """Yield records as they arrive; none after each `STALE_TIME` without one.

        Raises:
            InputError: pynetft has stopped.
        """
        from pynetft import NetFTError

        received, renewed, usual = 0, monotonic(), sys.getswitchinterval()
        sys.setswitchinterval(min(usual, SWITCH_INTERVAL))
        self._client.start()
        try:
            while True:
                started = monotonic()
                records = drain(self._client)
                yield records
                if len(records):
                    sleep(max(0.0, started + GATHER_TIME - monotonic()))
                    continue
                received_now = self._received_count()
                if received_now > received and monotonic() - renewed > RENEW_AFTER:
                    self._renew()
                    renewed, received_now = monotonic(), 0
                received = received_now
        except NetFTError as error:
            raise InputError(f"{self._name}: pynetft has stopped: {error}") from None
        finally:
            sys.setswitchinterval(usual)
            self._client.stop()
            self.count()

    def count(self) -> None:
        """Update the counts."""
        health = self._client.health()
        self.counts = self._closed + Counter(
            received=health.received_count,
            lost=health.lost_count - health.out_of_order_count,
            late=health.out_of_order_count,
            doubled=health.duplicate_count,
            malformed=health.malformed_count,
            dropped=health.python_queue_dropped_count,
        )

    def _received_count(self) -> int:
        """Return the number of records that pynetft has received, delivered or not."""
        health = self._client.health()
        if health.state.value == "faulted":
            raise InputError(f"{self._name}: pynetft has stopped: {health.last_error}")
        return health.received_count

    def _renew(self) -> None:
        self._client.stop()
        self.count()
        self._closed = self.counts
        self._client = self._new_client()
        self._client.start()

    def _new_client(self) -> "Client":
        """Return a client that delivers counts: pynetft does not know tool transforms, so counts are converted here."""
        try:
            from pynetft import Calibration, Client, Config, ForceUnit, TorqueUnit
        except ImportError:
            raise MissingDependencyError.of_extra("netft://", "pynetft", "live") from None
        config = Config(
            sensor_host=self._host,
            rdt_port=self._port,
            receive_timeout=2.0 * STALE_TIME,
            reconnect_initial_delay=RECONNECT_DELAY,
            reconnect_max_delay=0.5,
            deliver_samples_with_error_status=True,
            calibration_override=Calibration(1.0, 1.0, ForceUnit.NEWTON, TorqueUnit.NEWTON_METER),
        )
        return Client(config, queue_size=QUEUE_SIZE)


def drain(client: "Client") -> RdtRecords:
    """Return all records in the client's queue; if it is empty, those that arrive within `STALE_TIME`.

    Raises:
        pynetft.NetFTError: the client has stopped with a fault.
    """
    rows: list[tuple[int, ...]] = []
    queued = chain(
        islice(client.samples(STALE_TIME), 1), islice(client.samples(0.0), MAX_RECORDS_AT_ONCE - 1)
    )
    with suppress(TimeoutError):  # the queue is empty
        for sample in queued:
            rows.append((sample.ft_sequence, sample.status, sample.received_at_ns, *sample.raw_wrench))
    table = np.array(rows, dtype=np.int64).reshape(-1, 9)
    return RdtRecords(table[:, 0], table[:, 1], np.asarray(1e-9 * table[:, 2]), table[:, 3:])


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
