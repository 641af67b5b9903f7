"""Datagrams of a box, with their arrival: all that wait are read at once.

Linux reads many datagrams in one call of the system (`recvmmsg`, which Python does not offer) and states the arrival of
each. The call does not release the interpreter: reading one by one would release it for each record, and another
computing thread would keep it for a tenth of a millisecond each time. Elsewhere datagrams are read one by one, and
their arrival is the time of reading.
"""

import ctypes
import socket
import sys
from contextlib import suppress
from time import monotonic, time_ns
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from probedesign.core.frames import Array
from probedesign.live.sources.netft.rdt import RECORD

MAX_RECORDS = 700
"""Maximum number of records that are gathered: 0.1 s."""
MAX_DATAGRAM = 2048
"""More bytes than any datagram of a box has."""
SO_TIMESTAMPNS, SO_RXQ_OVFL = 35, 40
"""Options of Linux, without names in Python: each datagram comes with its time of arrival by the wall clock, and with
the number of datagrams that were dropped since the buffer was full, once there is one."""


class Datagrams(NamedTuple):
    """Records that were gathered."""

    words: NDArray[np.int64]  #: the records: numbers of record and sample, status, counts of the six channels, (n, 9).
    received: Array  #: arrival by `time.monotonic` [s], (n,); not yet limited to the arrival of earlier ones.
    dropped: int | None  #: number of datagrams that the socket's buffer has dropped so far; None if it is not stated.


class Receiver(Protocol):
    """Gathers the records that wait at a socket."""

    count: int  #: number of records gathered.
    malformed: int  #: number of datagrams so far that are no record.

    def read(self) -> None:
        """Read the datagrams that wait, up to `MAX_RECORDS` in all."""

    def take(self) -> Datagrams:
        """Return what was gathered, and begin again."""


def open_receiver(link: socket.socket) -> Receiver:
    """Return the receiver of a socket that does not block."""
    batched = _batched_call() if sys.platform == "linux" and sys.maxsize > 1 << 32 else None
    return SingleReceiver(link) if batched is None else BatchReceiver(link, batched)


class SingleReceiver:
    """Reads datagrams one by one; see `Receiver`."""

    def __init__(self, link: socket.socket) -> None:
        self._link, self.count, self.malformed = link, 0, 0
        self._datagrams: list[bytes] = []
        self._received: list[float] = []

    def read(self) -> None:
        """Read the datagrams that wait; see `Receiver`."""
        with suppress(OSError):  # nothing waits, or the system reports that the box is off
            for _ in range(MAX_RECORDS - self.count):
                datagram = self._link.recv(MAX_DATAGRAM)
                if len(datagram) != RECORD.size:
                    self.malformed += 1
                    continue
                self._datagrams.append(datagram)
                self._received.append(monotonic())
                self.count += 1

    def take(self) -> Datagrams:
        """Return what was gathered; see `Receiver`."""
        rows = np.frombuffer(b"".join(self._datagrams), dtype=np.uint8).reshape(-1, RECORD.size)
        received = np.array(self._received)
        self._datagrams, self._received, self.count = [], [], 0
        return Datagrams(_words(rows), received, None)


def _words(rows: NDArray[np.uint8]) -> NDArray[np.int64]:
    """Return the numbers of records in bytes, (n, 36); see `Datagrams`."""
    words = rows.view(">i4").astype(np.int64)
    words[:, :3] &= 0xFFFFFFFF  # without a sign
    return words


_HEADS = np.dtype([("name", "u8"), ("name_length", "u8"), ("parts", "u8"), ("n_parts", "u8"), ("control", "u8"),
                   ("control_length", "u8"), ("flags", "u8"), ("length", "u4"), ("", "u4")])  # fmt: skip
"""A `struct mmsghdr` of 64-bit Linux."""
_PARTS = np.dtype([("base", "u8"), ("length", "u8")])
"""A `struct iovec`."""
_CONTROL = np.dtype([("stamp_length", "u8"), ("stamp_level", "i4"), ("stamp_kind", "i4"), ("s", "i8"), ("ns", "i8"),
                     ("dropped_length", "u8"), ("dropped_level", "i4"), ("dropped_kind", "i4"), ("dropped", "u4"),
                     ("", "u4")])  # fmt: skip
"""What the system states about a datagram, in this order: its arrival, and the number dropped once there is one."""
_STAMP_LENGTH = 32
"""Length of the first part of it [bytes]."""
_ROW = 64
"""Bytes for one datagram: more than those of a record, so that a longer one is recognised."""


class BatchReceiver:
    """Reads all datagrams in one call, each into its row of one table; see `Receiver`."""

    def __init__(self, link: socket.socket, call: Any) -> None:
        """Prepare the memory; `call` is `recvmmsg`."""
        link.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        link.setsockopt(socket.SOL_SOCKET, SO_RXQ_OVFL, 1)
        self._link, self._call = link, call
        self.count = self.malformed = 0
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
        """Read the datagrams that wait; see `Receiver`."""
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

    def take(self) -> Datagrams:
        """Return what was gathered; see `Receiver`."""
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
        return Datagrams(words, received, dropped)


def _batched_call() -> Any:
    """Return `recvmmsg` of the system's library, which keeps the interpreter while it runs; None if it has none."""
    try:
        call = ctypes.PyDLL(None).recvmmsg
    except (OSError, AttributeError):
        return None
    call.argtypes = (ctypes.c_int, ctypes.c_void_p, ctypes.c_uint, ctypes.c_int, ctypes.c_void_p)
    call.restype = ctypes.c_int
    return call
