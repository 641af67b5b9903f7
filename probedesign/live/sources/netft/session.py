"""pynetft, driven: its queue emptied in one go, asked anew where it refuses all that comes."""

import sys
from collections import Counter
from collections.abc import Generator
from dataclasses import dataclass
from time import monotonic, sleep
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from probedesign.errors import InputError, MissingDependencyError
from probedesign.frames import Array
from probedesign.live.sources.netft.wire import SAMPLES_PER_SECOND

if TYPE_CHECKING:
    from pynetft import Client


QUEUE_SIZE = 1 << 16
"""Records that wait for us at most: nine seconds."""
MAX_RECORDS_AT_ONCE = 700
"""Records that are taken at once at most: a tenth of a second."""
PAUSE = 0.001
"""Records gather for so long if there is time [s]: waking for one costs more than reading it."""
STALE = 0.040
"""Without a record for so long, what was last estimated is old [s]; told within 50 ms of the last record."""
RENEWED = 0.5
"""Records that come and are all refused, as after a restart, get a new client after so long [s]."""
ASKED = 0.010
"""After a session that ended, as pynetft's do with every sample of a faulty status, it asks again so soon [s]."""
SWITCH = 1e-4
"""Another thread of Python that computes keeps us from each record for so long at most [s]: each read lets go of the
interpreter, and Python's usual 5 ms would be more than the record's turn."""


@dataclass(frozen=True)
class Records:
    """n records of the box, in the order in which they came.

    Attributes:
        ft_sequence: which of the sensor's samples they are, (n,).
        status: their words, (n,).
        received: by `time.monotonic` [s], (n,).
        counts: of the six channels, (n, 6).
    """

    ft_sequence: NDArray[np.int64]
    status: NDArray[np.int64]
    received: Array
    counts: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.ft_sequence)

    def __getitem__(self, part: slice | NDArray[np.bool_]) -> "Records":
        """Some of them."""
        return Records(self.ft_sequence[part], self.status[part], self.received[part], self.counts[part])


class Session:
    """What pynetft reads from one box.

    Attributes:
        counts: records so far: received, lost, late, doubled, malformed, dropped by the queue.
    """

    def __init__(self, name: str, host: str, port: int) -> None:
        """Nothing streams yet.

        Args:
            name: of the box, for messages.
            host: of the box.
            port: of RDT.

        Raises:
            MissingDependencyError: pynetft is not installed.
        """
        self.counts: Counter[str] = Counter()
        self._name, self._host, self._port = name, host, port
        self._client, self._closed = self._made(), Counter[str]()

    def records(self) -> Generator[Records, None, None]:
        """Records as they come; none after each `STALE` without one.

        Raises:
            InputError: pynetft has given up.
        """
        received, renewed, usual = 0, monotonic(), sys.getswitchinterval()
        sys.setswitchinterval(min(usual, SWITCH))
        self._client.start()
        try:
            while True:
                began = monotonic()
                found = drained(self._client)
                yield found
                if len(found):
                    sleep(max(0.0, began + PAUSE - monotonic()))
                    continue
                heard = self._heard()
                if heard > received and monotonic() - renewed > RENEWED:
                    self._renew()
                    renewed, heard = monotonic(), 0
                received = heard
        finally:
            sys.setswitchinterval(usual)
            self._client.stop()
            self.count()

    def count(self) -> None:
        """Bring the counts up to date."""
        health = self._client.health()
        self.counts = self._closed + Counter(
            received=health.received_count,
            lost=health.lost_count - health.out_of_order_count,
            late=health.out_of_order_count,
            doubled=health.duplicate_count,
            malformed=health.malformed_count,
            dropped=health.python_queue_dropped_count,
        )

    def _heard(self) -> int:
        """How many records pynetft has received, whether it gave them to us or not."""
        health = self._client.health()
        if health.state.value == "faulted":
            raise InputError(f"{self._name}: pynetft has ended: {health.last_error}")
        return health.received_count

    def _renew(self) -> None:
        self._client.stop()
        self.count()
        self._closed = self.counts
        self._client = self._made()
        self._client.start()

    def _made(self) -> "Client":
        """A client that knows no units: the counts are ours to convert, since it knows no tool transform."""
        try:
            from pynetft import Calibration, Client, Config, ForceUnit, TorqueUnit
        except ImportError:
            raise MissingDependencyError("netft:// needs pynetft; install probedesign[live]") from None
        config = Config(
            sensor_host=self._host,
            rdt_port=self._port,
            receive_timeout=2.0 * STALE,
            reconnect_initial_delay=ASKED,
            reconnect_max_delay=0.5,
            deliver_samples_with_error_status=True,
            calibration_override=Calibration(1.0, 1.0, ForceUnit.NEWTON, TorqueUnit.NEWTON_METER),
        )
        return Client(config, queue_size=QUEUE_SIZE)


def drained(client: "Client") -> Records:
    """What waits in the client's queue; if nothing does, what comes within `STALE`.

    By its native reader: `Client.samples` makes an object of enumerations and floats of each record, which takes
    three times as long as reading it. That reader is not promised by pynetft: the project pins its version.
    """
    read = client._native.read
    rows: list[tuple[int, ...]] = []
    sample = read(STALE).sample
    while sample is not None:
        rows.append((sample.ft_sequence, sample.status, sample.received_at_ns, *sample.raw_wrench))
        sample = read(0.0).sample if len(rows) < MAX_RECORDS_AT_ONCE else None
    table = np.array(rows, dtype=np.int64).reshape(-1, 9)
    return Records(table[:, 0], table[:, 1], np.asarray(1e-9 * table[:, 2]), table[:, 3:])


WRAP = 1 << 32
AHEAD = 10.0
"""A counter that runs this far ahead of the host's clock is another counter [s]: buffers hold less, suspended
programs find no old records."""


class Times(NamedTuple):
    """What the clock says of n records.

    Attributes:
        new: which of them are not the sample before once more, (n,).
        time: of the k that are new [s], (k,).
        restarted: before which of the new the counter started again, (k,).
    """

    new: NDArray[np.bool_]
    time: Array
    restarted: NDArray[np.bool_]


def steps(values: NDArray[Any], before: float) -> NDArray[Any]:
    """From each value to the next, the first from the one before, (n,): as `np.diff`, which takes four times as long
    for the few values that come at once."""
    found = np.empty_like(values)
    found[:1] = values[:1] - before
    np.subtract(values[1:], values[:-1], out=found[1:])
    return found


class SensorClock:
    """Seconds since the first record by `ft_sequence`, never backward.

    Attributes:
        restarts: how often the counter started again; the host's clock bridges the time between.
    """

    def __init__(self) -> None:
        """A clock that has seen nothing."""
        self.restarts = 0
        self._last: tuple[int, float] | None = None
        self._ticks = 0

    def times(self, ft_sequence: NDArray[np.int64], received: Array) -> Times:
        """Time of records that came one after the other.

        Args:
            ft_sequence: of each, (n,).
            received: when, by the host's clock [s], (n,).
        """
        new = np.ones(len(ft_sequence), dtype=bool)
        new[1:] = np.diff(ft_sequence) != 0
        if self._last is not None and len(new):
            new[0] = ft_sequence[0] != self._last[0]
        ft, received = ft_sequence[new], received[new]
        if not len(ft):
            return Times(new, np.empty(0), np.empty(0, dtype=bool))
        before = self._last or (int(ft[0]), float(received[0]))
        ticks = steps(ft, before[0]) % WRAP
        elapsed = np.maximum(steps(received, before[1]), 0.0)
        restarted = ticks / SAMPLES_PER_SECOND > elapsed + AHEAD
        bridged = np.maximum(np.rint(elapsed * SAMPLES_PER_SECOND), 1.0).astype(np.int64)
        counted = self._ticks + np.cumsum(np.where(restarted, bridged, ticks))
        self.restarts += int(restarted.sum())
        self._last, self._ticks = (int(ft[-1]), float(received[-1])), int(counted[-1])
        return Times(new, counted / SAMPLES_PER_SECOND, restarted)
