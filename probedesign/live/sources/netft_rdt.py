"""RDT: the protocol of the box over UDP (big-endian), its status codes, and the counters of its records.

The counters state order and loss of the records, and time and rate by the samples of the sensor.

Source: ATI, Net F/T Sensor System, installation and operation manual 9620-05-NET FT, the chapter on RDT and the table
of the system status code. ATI, F/T Sensor, Ethernet Axia, manuals 9610-05-Ethernet Axia-09, tables 4.7 and 4.9, and
9620-05-C-Ethernet Axia-02, table 5.7: an Axia has the same protocol, but another table.
"""

import struct
from collections import Counter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from probedesign.core.frames import Array

RDT_PORT = 49152
HTTP_PORT = 80
PAGE = "/netftapi2.xml"

#: Sampling rate of the box, independent of the record rate, counted by `ft_sequence`. The record rate is an integer
#: fraction of it.
SAMPLES_PER_SECOND = 7000

STOP, REALTIME, BUFFERED, BIAS = 0x0000, 0x0002, 0x0003, 0x0042  #: Commands to the box.

HEADER = 0x1234
REQUEST = struct.Struct(">HHI")
RECORD = struct.Struct(">III6i")
#: The record as an array type.
RECORDS = np.dtype([("rdt", ">u4"), ("ft", ">u4"), ("status", ">u4"), ("counts", ">i4", 6)])


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


SUMMARY, LATCHED, SATURATED = 1 << 31, 1 << 16, 1 << 17


class StatusTable(NamedTuple):
    """Meaning of the status word of one kind of sensor."""

    kind: str  #: the kind, for messages.
    texts: dict[int, str]  #: faults by bit; bit 31 is the summary.
    harmless: tuple[int, ...]  #: status words that are not faults of the sample.


NET_BOX = StatusTable(
    "Net Box",
    {
        30: "processor or memory error", 29: "digital board error", 28: "analogue board error", 27: "serial link error",
        26: "program memory error", 25: "halted by a wrong configuration", 24: "settings are not valid",
        23: "configuration does not fit the calibration", 22: "network failure", 21: "CAN failure", 20: "RDT failure",
        19: "EtherNet/IP failure", 18: "DeviceNet failure", 17: "transducer saturated or A/D error", 14: "watchdog",
        13: "stack", 12: "EEPROM failure", 11: "flash failure", 10: "analogue board watchdog",
        9: "gauge excitation current too high", 8: "gauge excitation current too low",
        7: "artificial ground out of range", 6: "supply too high", 5: "supply too low",
        4: "no data from the transducer", 3: "reference voltage or power", 2: "temperature", 1: "HTTP failure",
    },
    (0, LATCHED, SUMMARY | LATCHED),  # a monitor condition has been latched, which is not a fault of the sample
)  # fmt: skip
#: Bit 3 is no error by the manual, but readings are not reliable meanwhile.
AXIA = StatusTable(
    "Axia",
    {
        30: "force or torque out of range", 29: "calibration checksum error", 28: "simulated error",
        27: "gauge out of range", 7: "calibration not accessible", 5: "other error",
        3: "busy with a change of its settings; the reading may be affected", 2: "broken gauge",
        1: "supply voltage out of range", 0: "temperature out of range",
    },
    (0, LATCHED),
)  # fmt: skip


def fault_of(status: int, table: StatusTable = NET_BOX) -> str:
    """Return the fault of a status word; empty without one."""
    if status in table.harmless:
        return ""
    texts = [text for bit, text in table.texts.items() if status >> bit & 1]
    return f"{', '.join(texts) or 'unknown fault'} (status 0x{status:08x})"


WRAP = 1 << 32  #: Both counters have 32 bits.
MAX_TICKS = 1 << 30  #: Largest step of a counter that is surely forward; a larger one is examined.


class SequenceMonitor:
    """Counts lost records, and late or duplicated ones, by `rdt_sequence`, and selects those that are new.

    A record that arrives late counts as lost too, because it is rejected. A stream that is counted from one again, with
    samples that are newer, is another stream.
    """

    def __init__(self, counts: Counter[str]) -> None:
        """Start before the first record; `counts` is updated."""
        self._counts = counts
        self._last: tuple[int, int] | None = None

    def restart(self) -> None:
        """Accept the next record, whatever its number."""
        self._last = None

    def accept(self, rdt: NDArray[np.int64], ft: NDArray[np.int64]) -> NDArray[np.bool_] | None:
        """Return which of n ≥ 1 records are new by their numbers, (n,); None if all are.

        A sample that is repeated is not new.
        """
        last = self._last
        if last is not None and ascending(rdt, last[0], 1) and ascending(ft, last[1], MAX_TICKS):
            self._last = int(rdt[-1]), int(ft[-1])
            return None
        return np.array([self._is_new(*pair) for pair in zip(rdt.tolist(), ft.tolist(), strict=True)])

    def _is_new(self, rdt: int, ft: int) -> bool:
        step, newer = (_signed(a - b) for a, b in zip((rdt, ft), self._last or (rdt - 1, ft - 1), strict=True))
        if step <= 0 and newer <= 0:
            self._counts["late"] += 1
            return False
        self._counts["lost"] += max(step - 1, 0)
        self._last = rdt, ft
        return newer != 0


def _signed(difference: int) -> int:
    return (difference + WRAP // 2) % WRAP - WRAP // 2


#: Maximum lead of the counter over the host's clock [s]; more indicates another counter. Buffers are shorter, and a
#: suspended program finds no old records.
MAX_LEAD = 10.0


class RecordTimes(NamedTuple):
    """Times of n records."""

    new: NDArray[np.bool_]  #: whether each record is a new sample, not a repeated one, (n,).
    time: Array  #: times of the k new samples [s], (k,).
    restarted: NDArray[np.bool_]  #: whether the counter restarted before each new sample, (k,).


def ascending(values: NDArray[np.int64], before: float, largest: float) -> bool:
    """Return whether each of n ≥ 1 numbers exceeds the one before it, the first `before`, by 1 to `largest`."""
    if not 0 < values[0] - before <= largest:
        return False
    differences = values[1:] - values[:-1]  # four times as fast as np.diff with a first value
    return not len(differences) or bool(differences.min() > 0 and differences.max() <= largest)


class SensorClock:
    """Time since the first record by `ft_sequence` [s], a 32-bit counter that overflows, stops or restarts.

    The time never decreases; the host's clock covers the gaps of `restarts` of the counter.
    """

    def __init__(self, rate: float = SAMPLES_PER_SECOND) -> None:
        """Start before the first record; the counter advances by `rate` a second [Hz]."""
        self.restarts, self._rate = 0, rate
        self._last: tuple[int, float] | None = None
        self._ticks = 0

    def times(self, ft_sequence: NDArray[np.int64], received: Array) -> RecordTimes:
        """Return the times of n ≥ 1 records by sequence numbers and arrival by the host's clock [s], (n,)."""
        if self._last is not None and ascending(ft_sequence, self._last[0], MAX_LEAD * self._rate):
            counted = ft_sequence + (self._ticks - self._last[0])
            self._last, self._ticks = (int(ft_sequence[-1]), float(received[-1])), int(counted[-1])
            usual = np.ones(len(counted), dtype=bool)
            return RecordTimes(usual, counted / self._rate, ~usual)
        new = np.diff(ft_sequence, prepend=self._last[0] if self._last else ft_sequence[0] - 1) != 0
        ft, received = ft_sequence[new], received[new]
        if not len(ft):
            return RecordTimes(new, np.empty(0), np.empty(0, dtype=bool))
        before = self._last or (int(ft[0]), float(received[0]))
        ticks = np.diff(ft, prepend=before[0]) % WRAP
        elapsed = np.maximum(np.diff(received, prepend=before[1]), 0.0)
        restarted = ticks / self._rate > elapsed + MAX_LEAD
        bridged = np.maximum(np.rint(elapsed * self._rate), 1.0).astype(np.int64)
        counted = self._ticks + np.cumsum(np.where(restarted, bridged, ticks))
        self.restarts += int(restarted.sum())
        self._last, self._ticks = (int(ft[-1]), float(received[-1])), int(counted[-1])
        return RecordTimes(new, counted / self._rate, restarted)


#: Interval over which the rate of the counter is measured [s]; the host's clock is far better than the limit.
RATE_PERIOD = 5.0
#: Fraction of the expected rate by which two successive measurements must deviate to be reported, and within which they
#: must agree.
MAX_RATE_ERROR, RATE_SCATTER = 0.05, 0.02


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
        measured = self._rate * (time - self._start[0]) / elapsed
        before, self._before, self._start = self._before, measured, (time, received)
        steady = abs(measured - before) < RATE_SCATTER * self._rate
        if self._reported or not steady or abs(measured / self._rate - 1.0) <= MAX_RATE_ERROR:
            return None
        self._reported = True
        return measured
