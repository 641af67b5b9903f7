"""Source `udp://[HOST]:PORT`: wrenches of any sender, one JSON or MessagePack object per datagram."""

from collections import deque
from collections.abc import Generator, Mapping
from contextlib import closing
from math import inf, isfinite, isnan, nan
from statistics import median
from time import monotonic, sleep
from typing import Any, NamedTuple, get_args

import numpy as np

from probedesign.core.csv_tables import CEILING, WRENCH_ALIASES, WRENCH_KINDS, Frame
from probedesign.core.errors import InputError, one_line, quoted
from probedesign.core.frames import Array
from probedesign.estimation.model import ProbeModel
from probedesign.live import Log
from probedesign.live.blocks import Block, WrenchReading, dropout_block, group_readings
from probedesign.live.datagrams import (
    SENDER_TIMEOUT,
    Listener,
    Parsed,
    parse_listen_address,
    read_quantities,
    read_quantity,
    spellings,
)
from probedesign.live.sources.source import STALE_TIME, DropoutMonitor, SourceParameter, parse_parameters

MAX_SEQUENCE = 1 << 63  #: Sequence numbers are below this.
MAX_RATE = 20_000  #: Maximum number of datagrams per second.
#: Components of a wrench and the names that each may have; torques may also be named `tx` ... `tz`.
WRENCH_FIELDS = {
    f"{name}_{'N' if kind == 'force' else 'Nm'}": spellings(
        name, kind, *(other for other, usual in WRENCH_ALIASES.items() if usual == name)
    )
    for name, kind in WRENCH_KINDS.items()
}
TIME = spellings("time_s", "time")
#: Largest plausible components [N, N·m], (6,).
MAX_WRENCH = np.array([CEILING[kind] for kind in WRENCH_KINDS.values()])


class ReceivedWrench(NamedTuple):
    """Wrench of one datagram, [N, N·m], (6,), its time by the sender's clock [s], NaN without one, and its fault."""

    wrench: Array
    time: float
    fault: str


def parse_wrench(values: Mapping[str, Any]) -> Parsed[ReceivedWrench]:
    """Return the wrench with `WRENCH_FIELDS`, in any units of `UNITS`.

    `time_s`, `sequence`, `frame` and `fault` are optional; other fields are ignored.

    Raises:
        InputError: a field is missing, given twice, not a number, or beyond the range of any sensor.
    """
    wrench = np.array(read_quantities(values, WRENCH_FIELDS, "a wrench"))
    if (beyond := ~(np.abs(wrench) <= MAX_WRENCH)).any():
        i = int(np.argmax(beyond))
        raise InputError(f"{list(WRENCH_FIELDS)[i]} = {wrench[i]:g} is beyond {MAX_WRENCH[i]:g}")
    time = read_quantity(values, TIME)
    if time is not None and not abs(time) <= CEILING["time"]:
        raise InputError(f"its time {time:g} s is out of range")
    sequence = values.get("sequence")
    if sequence is not None and (type(sequence) is not int or not 0 <= sequence < MAX_SEQUENCE):
        raise InputError(f"sequence = {quoted(sequence)} is not a whole number")
    received = ReceivedWrench(wrench, nan if time is None else time, one_line(str(values.get("fault") or "")))
    return Parsed(received, one_line(str(values.get("frame") or "")), received.time, sequence)


GATHER_TIME = 0.001  #: Time in which datagrams are gathered [s]: a block of several costs less than several blocks.
#: Number of intervals whose median is the usual one; silence is longer than so many of these, and than `STALE_TIME`.
USUAL_INTERVALS, STALE_INTERVALS = 32, 5
MAX_BURST = 0.25  #: Longest interval between bursts whose times show that nothing is missing [s].
REPORT_INTERVAL = 10.0  #: Minimum interval between reports of lost datagrams [s].
PARAMETERS = {"wait_s": SourceParameter(10.0, 0.1, 86_400.0)}
TEXT_PARAMETERS = {"frame": get_args(Frame)}


class UdpSource:
    """Wrenches that a listener receives; see `Source`.

    Attributes:
        address: host and port that receive.
        counts: number of datagrams by kind, see `Listener`.
        interruptions: number of interruptions so far.
    """

    def __init__(
        self,
        model: ProbeModel,
        listener: Listener[ReceivedWrench],
        log: Log,
        frame: str = "",
        wait: float = PARAMETERS["wait_s"].default,
        base: str = "base",
    ) -> None:
        """Prepare to read from a listener, and to wait so long for the first wrench [s]; nothing is received yet.

        Without a `frame`, wrenches are in the base frame if the datagrams name that, `base`, else in the sensor's.
        """
        self.title, self.notes, self.address = listener.title, listener.notes, listener.address
        self._model, self._listener, self._log, self._frame, self._base = model, listener, log, frame, base
        self._wait = wait
        self.counts = listener.counts
        self._session, self._stretch, self.interruptions = 0, 0, 0
        self._offset, self._time, self._arrival, self._step = 0.0, -inf, -inf, 0.0
        self._intervals: deque[float] = deque(maxlen=USUAL_INTERVALS)
        self._burst = 0.0  # longest interval between two bursts so far [s]
        self._reported = (0, -inf)

    def __iter__(self) -> Generator[Block, None, None]:
        text = f"no wrench within {self._wait:g} s; check the sender, its address and port"
        self._dropout = DropoutMonitor(self.title, self._log, text, self._wait)
        with closing(self._listener) as listener:
            listener.start()
            try:
                yield from self._blocks(listener)
            finally:
                self._report(listener)
                self._log(f"{self.title}: {listener.summary}")

    def _blocks(self, listener: Listener[ReceivedWrench]) -> Generator[Block, None, None]:
        while True:
            listener.wait(STALE_TIME)
            started = monotonic()
            values = listener.pop()
            self._log_messages(listener)
            if values:
                yield from group_readings(map(self._reading, *zip(*values, strict=True)), len(values))
                sleep(max(0.0, started + GATHER_TIME - monotonic()))
            elif started - self._arrival > self._stale_time:
                self._report(listener)
                self._dropout.on_silence(self._arrival, "is the sender running?")
                yield dropout_block(self._model.gravity_base, self._dropout.reason, self._stretch)

    @property
    def _stale_time(self) -> float:
        """Duration of silence that is an interruption [s]."""
        if len(self._intervals) < STALE_INTERVALS:
            return SENDER_TIMEOUT
        return max(STALE_TIME, STALE_INTERVALS * median(self._intervals), 1.5 * self._burst)

    def _reading(self, arrival: float, value: ReceivedWrench, session: int) -> WrenchReading:
        """Return the reading by the source's clock, which continues where a new session has another one."""
        elapsed = arrival - self._arrival
        stamp = arrival if isnan(value.time) else value.time
        first = not isfinite(self._time)
        if session != self._session:
            self._session = session
            self._offset = self._time + elapsed - stamp if not first else (-stamp if isnan(value.time) else 0.0)
            if (named := self._listener.frame) and not self._frame:
                used = "base" if named == self._base else "sensor"
                self._log(f"{self.title}: frame {named[:40]!r} is interpreted as the {used} frame")
        if not first:
            step = inf if isnan(value.time) else stamp + self._offset - self._time
            complete = STALE_TIME < elapsed <= MAX_BURST and step <= max(
                STALE_TIME / STALE_INTERVALS, STALE_INTERVALS * self._step
            )
            self._step = min(step, MAX_BURST)
            if complete:
                self._burst = max(self._burst, elapsed)
                if self._dropout.ongoing:
                    self._dropout.on_resumed(elapsed)
            elif self._dropout.ongoing or (elapsed > STALE_TIME and elapsed > self._stale_time):
                self._stretch += 1
                self.interruptions += 1
                if self._dropout.ongoing:
                    self._dropout.on_resumed(elapsed)
            self._intervals.append(elapsed)
        self._time, self._arrival = stamp + self._offset, arrival
        gravity, wrench = self._model.gravity_base, value.wrench
        if self._frame == "base" or (not self._frame and self._listener.frame == self._base):
            wrench = self._model.to_sensor(wrench, gravity)
        return WrenchReading(self._time, wrench, gravity, None, value.fault, self._stretch, arrival)

    def _log_messages(self, listener: Listener[ReceivedWrench]) -> None:
        for line in listener.pop_messages():
            self._log(line)
        if monotonic() - self._reported[1] > REPORT_INTERVAL:
            self._report(listener)

    def _report(self, listener: Listener[ReceivedWrench]) -> None:
        lost = listener.counts["lost"]
        if lost > self._reported[0]:
            self._log(f"{self.title}: {lost - self._reported[0]} wrenches lost; {self.counts['taken']} received")
            self._reported = lost, monotonic()


def open_udp(model: ProbeModel, target: str, query: str, log: Log) -> UdpSource:
    """Open the source `udp://[HOST]:PORT` with `PARAMETERS` and `TEXT_PARAMETERS`.

    Raises:
        InputError: the address or a parameter is invalid, or the port is in use.
    """
    numbers, texts = parse_parameters("udp:", query, PARAMETERS, TEXT_PARAMETERS)
    option = f"--source udp:{target}"
    listener = Listener(option, "wrenches", parse_listen_address(option), parse_wrench, MAX_RATE)
    return UdpSource(model, listener, log, texts["frame"], numbers["wait_s"])
