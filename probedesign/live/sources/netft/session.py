"""A session with the box: requests the stream, reads its records in one pass, and requests it again after a silence."""

import math
import select
import socket
from collections import Counter, deque
from collections.abc import Generator
from contextlib import suppress
from dataclasses import dataclass
from time import monotonic, sleep

import numpy as np
from numpy.typing import NDArray

from probedesign.core.errors import InputError
from probedesign.core.frames import Array
from probedesign.live.sources.netft.counters import SequenceMonitor
from probedesign.live.sources.netft.rdt import REALTIME, SAMPLES_PER_SECOND, STOP, Request
from probedesign.live.sources.netft.receiver import MAX_RECORDS, open_receiver
from probedesign.live.sources.source import STALE_TIME

GATHER_TIME, MAX_GATHER_TIME = 0.001, 0.010
"""Least and largest time in which records are gathered [s]: waking up for a record costs more than reading it."""
MIN_SLEEP = 0.0002
"""Least time of one sleep while records are gathered [s]: a program or a switch that sends records in bursts needs less
for one of them."""
WINDOW = 128
"""Number of readings together from which it is found when a record arrives at the earliest, 0.7 s of means."""
REQUEST_INTERVAL = 0.5
"""Minimum interval between requests for the stream [s]."""
BUFFER_BYTES = 1 << 22
"""Size of the socket's buffer that is requested of the system [bytes]."""
BYTES_PER_RECORD = 768
"""Memory that Linux counts for one record in the buffer [bytes]: measured, 277 records fill 212,992 bytes."""
MIN_BUFFERED_TIME = 0.25
"""Duration of the stream below which a smaller buffer is reported [s]: the longest pauses of a busy desktop."""


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
        """Return some of the records."""
        return RdtRecords(self.ft_sequence[part], self.status[part], self.received[part], self.counts[part])


NO_RECORDS = RdtRecords(np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0), np.empty((0, 6), np.int64))


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
        try:
            found = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
            link = socket.socket(*found[:3])
            link.connect(found[4])  # from then on the system accepts datagrams of this address only
        except OSError as error:
            raise InputError(f"{name}: {error.strerror or error}") from None
        link.setblocking(False)
        link.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER_BYTES)
        self.buffer_bytes = link.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)
        self._link, self._receiver = link, open_receiver(link)
        self._newest, self._delays = 0, deque[float](maxlen=WINDOW)

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
                    if len(records := self._decoded()):
                        last = now
                        yield records
                elif n > before:
                    sleep(min(max(self._due(gathered) - now, MIN_SLEEP), MAX_GATHER_TIME))
                elif now - last <= STALE_TIME:  # the next record, or the silence
                    select.select([self._link], [], [], last + STALE_TIME - now + MIN_SLEEP)
                if now - last > STALE_TIME and not self._receiver.count:
                    if now - self._requested > REQUEST_INTERVAL:
                        self._request()
                    last = now
                    yield NO_RECORDS
        finally:
            self._send(Request(STOP))
            self._link.close()

    def _due(self, gathered: float) -> float:
        """Return when the last of so many records arrives at the earliest, by `time.monotonic` [s].

        A box sends records as they are sampled, and a network or a busy program delays some of them.
        """
        return min(self._delays, default=-math.inf) + (self._newest + gathered) / self._rate

    def _request(self) -> None:
        """Request the stream, whose records are counted from one again."""
        self._requested = monotonic()
        self._sequence.restart()
        self._delays.clear()
        self._send(Request(REALTIME))

    def _send(self, request: Request) -> None:
        with suppress(OSError):  # the box is off or the network is down: the silence is reported
            self._link.send(request.packed())

    def _decoded(self) -> RdtRecords:
        """Return the new records among those that were gathered."""
        words, received, dropped = self._receiver.take()
        rdt, ft = words[:, 0], words[:, 1]
        records = RdtRecords(ft, words[:, 2], self._arrival(received), words[:, 3:])
        self.counts["received"] += len(words)
        if dropped is not None:
            self.counts["dropped"] = dropped
        self._newest = int(rdt[-1])
        self._delays.append(self._received - self._newest / self._rate)
        new = self._sequence.accept(rdt, ft)
        return records if new is None else records[new]

    def _arrival(self, received: Array) -> Array:
        """Return the arrival of datagrams, (n,), neither before that of the last ones nor after now.

        The system states it by the wall clock, which may be set at any time.
        """
        received = np.maximum.accumulate(np.maximum(np.minimum(received, monotonic()), self._received))
        self._received = float(received[-1])
        return received
