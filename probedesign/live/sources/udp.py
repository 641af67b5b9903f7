"""Source `udp://[HOST]:PORT`: wrenches of any sender, one JSON or MessagePack object per datagram."""

from collections import Counter, deque
from collections.abc import Generator, Mapping
from contextlib import closing
from dataclasses import dataclass
from math import inf, isfinite, isnan, nan
from statistics import median
from time import monotonic, sleep
from typing import Any, Protocol, get_args

import numpy as np

from probedesign.core.csv_tables import CEILING, WRENCH, WRENCH_ALIASES, WRENCH_KINDS, Frame
from probedesign.core.errors import InputError, one_line
from probedesign.core.frames import Array
from probedesign.estimation.model import ProbeModel
from probedesign.live import Log
from probedesign.live.blocks import Block, WrenchReading, dropout_block, group_readings
from probedesign.live.datagrams import (
    MAX_TIME_JUMP,
    SENDER_TIMEOUT,
    StreamListener,
    decode_object,
    find_quantity,
    parse_listen_address,
)
from probedesign.live.sources.source import STALE_TIME, DropoutMonitor, SourceParameter, parse_parameters

MAX_SEQUENCE = 1 << 63
"""Sequence numbers are below this."""


@dataclass(frozen=True)
class WrenchDatagram:
    """Content of one datagram."""

    wrench: Array  #: force and moment [N, N·m], (6,).
    time: float = nan  #: time by the sender's clock [s]; NaN without one.
    sequence: int | None = None  #: number of the datagram; None without one.
    fault: str = ""  #: description of a sensor fault; empty without one.


def parse_wrench(values: Mapping[str, Any]) -> WrenchDatagram:
    """Return the wrench with the fields `fx_N`, `fy_N`, `fz_N`, `mx_Nm`, `my_Nm`, `mz_Nm`, in any units of `UNITS`.

    Torques may also be named `tx` ... `tz`. `time_s`, `sequence` and `fault` are optional; other fields are ignored.

    Raises:
        InputError: a field is missing, given twice, not a number, or beyond the range of any sensor.
    """
    other_name = {name: alias for alias, name in WRENCH_ALIASES.items()}
    wrench = np.empty(6)
    for i, name in enumerate(WRENCH):
        kind = WRENCH_KINDS[name]
        found = [find_quantity(values, each, kind) for each in (name, other_name.get(name)) if each]
        numbers = [value for value in found if value is not None]
        unit = "N" if kind == "force" else "Nm"
        if len(numbers) != 1:
            problem = "no" if not numbers else "two of"
            raise InputError(f"has {problem} {name}_{unit}; a wrench needs fx_N, fy_N, fz_N, mx_Nm, my_Nm, mz_Nm")
        if not abs(numbers[0]) <= CEILING[kind]:
            raise InputError(f"{name} = {numbers[0]:g} {unit} is beyond {CEILING[kind]:g} {unit}")
        wrench[i] = numbers[0]
    time = find_quantity(values, "time", "time")
    if time is not None and not abs(time) <= CEILING["time"]:
        raise InputError(f"its time {time:g} s is out of range")
    sequence = values.get("sequence")
    if sequence is not None and (type(sequence) is not int or not 0 <= sequence < MAX_SEQUENCE):
        raise InputError(f"sequence = {str(sequence)[:40]!r} is not a whole number")
    fault = one_line(str(values.get("fault") or ""))
    return WrenchDatagram(wrench, nan if time is None else time, sequence, fault)


MAX_RATE = 20_000
"""Maximum number of datagrams per second."""


class WrenchListener(StreamListener[WrenchDatagram]):
    """Wrenches by UDP; counts those that a gap of the sequence shows as lost."""

    def __init__(self, option: str, host: str, port: int) -> None:
        """Bind the port; see `DatagramReceiver`."""
        super().__init__(option, "wrenches", host, port, max_per_tick=MAX_RATE // 100)

    def parse(self, datagram: bytes) -> tuple[WrenchDatagram, str]:
        """Return the wrench of a datagram and its frame."""
        values = decode_object(datagram)
        return parse_wrench(values), one_line(str(values.get("frame") or ""))

    def fault(self, value: WrenchDatagram, last: WrenchDatagram, elapsed: float) -> tuple[str, str] | None:
        """Return an inconsistency in sequence or time; count the lost datagrams."""
        if (value.sequence is None) != (last.sequence is None):
            return "not always numbered", "only some datagrams have a sequence"
        if value.sequence is not None and last.sequence is not None:
            if value.sequence <= last.sequence:
                return "late or duplicated", f"sequence {value.sequence} after {last.sequence}"
            step = value.sequence - last.sequence
            if step > MAX_RATE * (elapsed + MAX_TIME_JUMP):
                return "leaping in sequence", f"sequence leaps by {step} within {1e3 * elapsed:.3g} ms"
            found = super().fault(value, last, elapsed)
            if found is None:
                self.counts["lost"] += step - 1
            return found
        return super().fault(value, last, elapsed)


class SenderProcess(Protocol):
    """A sender of the datagrams that runs as long as the source is read."""

    def start(self, address: tuple[str, int]) -> None:
        """Start to send to an address."""

    def check(self) -> None:
        """Raise InputError if nothing more will be sent."""

    def close(self) -> None:
        """End it."""


GATHER_TIME = 0.001
"""Time in which datagrams are gathered [s]: a block of several costs less than several blocks."""
USUAL_INTERVALS, STALE_INTERVALS = 32, 5
"""Number of intervals whose median is the usual one; silence is longer than so many of these, and than `STALE_TIME`."""
REPORT_INTERVAL = 10.0
"""Minimum interval between reports of lost datagrams [s]."""
PARAMETERS = {"wait_s": SourceParameter(10.0, 0.1, 86_400.0)}
TEXT_PARAMETERS = {"frame": get_args(Frame)}


class UdpSource:
    """Wrenches that a listener receives.

    Attributes:
        title: one line that describes the source.
        notes: notes for the user.
        counts: number of datagrams received, lost and malformed; interruptions.
    """

    def __init__(
        self,
        model: ProbeModel,
        title: str,
        listener: WrenchListener,
        log: Log,
        frame: str = "",
        wait: float = PARAMETERS["wait_s"].default,
        sender: SenderProcess | None = None,
    ) -> None:
        """Prepare; nothing is received yet.

        Args:
            model: probe on the sensor.
            title: one line that describes the source.
            listener: listener with a bound port.
            log: callback for messages.
            frame: frame of the wrenches; empty: the base frame if the datagrams name it `base`, else the sensor's.
            wait: maximum wait for the first wrench [s].
            sender: process that is started with the source, if any.
        """
        self.title, self.notes = title, (listener.access_note,) if sender is None else ()
        self._model, self._listener, self._log, self._frame, self._sender = (model, listener, log, frame, sender)
        text = f"no wrench within {wait:g} s; check the sender, its address and port"
        self._dropout = DropoutMonitor(title, log, text, wait)
        self.counts: Counter[str] = Counter()
        self._session, self._stretch = 0, 0
        self._offset, self._time, self._arrival = 0.0, -inf, -inf
        self._intervals: deque[float] = deque(maxlen=USUAL_INTERVALS)
        self._reported = (0, -inf)

    @property
    def address(self) -> tuple[str, int]:
        """Host and port that receive."""
        return self._listener.address

    def __iter__(self) -> Generator[Block, None, None]:
        self._dropout.restart()
        with closing(self._listener) as listener:
            listener.start()
            try:
                if self._sender is not None:
                    self._sender.start(listener.address)
                yield from self._blocks(listener)
            finally:
                if self._sender is not None:
                    self._sender.close()
                self._report(listener)
                self._log(f"{self.title}: {listener.summary}")

    def _blocks(self, listener: WrenchListener) -> Generator[Block, None, None]:
        while True:
            listener.wait(STALE_TIME)
            started = monotonic()
            values = listener.pop()
            self._count(listener)
            if values:
                yield from group_readings(map(self._reading, *zip(*values, strict=True)), len(values))
                sleep(max(0.0, started + GATHER_TIME - monotonic()))
            elif started - self._arrival > self._stale_time:
                self._report(listener)
                if self._sender is not None:
                    self._sender.check()
                self._dropout.on_silence(self._arrival, "is the sender running?")
                yield dropout_block(self._model.gravity_base, self._dropout.reason, self._stretch)

    @property
    def _stale_time(self) -> float:
        """Duration of silence that is an interruption [s]."""
        if len(self._intervals) < STALE_INTERVALS:
            return SENDER_TIMEOUT
        return max(STALE_TIME, STALE_INTERVALS * median(self._intervals))

    def _reading(self, arrival: float, value: WrenchDatagram, session: int) -> WrenchReading:
        """Return the reading by the source's clock, which continues where a new session has another one."""
        elapsed = arrival - self._arrival
        stamp = arrival if isnan(value.time) else value.time
        first = not isfinite(self._time)
        if session != self._session:
            self._session = session
            self._offset = self._time + elapsed - stamp if not first else (-stamp if isnan(value.time) else 0.0)
            self._report_frame()
        if not first:
            if self._dropout.ongoing or (elapsed > STALE_TIME and elapsed > self._stale_time):
                self._stretch += 1
                self.counts["interruptions"] += 1
                if self._dropout.ongoing:
                    self._dropout.on_resumed(elapsed)
            self._intervals.append(elapsed)
        self._time, self._arrival = stamp + self._offset, arrival
        gravity, wrench = self._model.gravity_base, value.wrench
        if self._in_base:
            wrench = self._model.to_sensor(wrench, gravity)
        return WrenchReading(self._time, wrench, gravity, None, value.fault, self._stretch, arrival)

    @property
    def _in_base(self) -> bool:
        return (self._frame or self._listener.frame) == "base"

    def _report_frame(self) -> None:
        named = self._listener.frame
        if named and not self._frame:
            used = "base" if self._in_base else "sensor"
            self._log(f"{self.title}: frame {named[:40]!r} is interpreted as the {used} frame")

    def _count(self, listener: WrenchListener) -> None:
        """Update the counts, pass messages on, and report an increase of the losses at limited frequency."""
        for line in listener.pop_messages():
            self._log(line)
        counts = listener.counts
        self.counts["received"], self.counts["lost"] = counts["taken"], counts["lost"]
        self.counts["malformed"] = counts["invalid"]
        if monotonic() - self._reported[1] > REPORT_INTERVAL:
            self._report(listener)

    def _report(self, listener: WrenchListener) -> None:
        lost = listener.counts["lost"]
        if lost > self._reported[0]:
            self._log(f"{self.title}: {lost - self._reported[0]} wrenches lost; {self.counts['received']} received")
            self._reported = lost, monotonic()


def open_udp(model: ProbeModel, target: str, query: str, log: Log) -> UdpSource:
    """Open the source `udp://[HOST]:PORT` with `PARAMETERS` and `TEXT_PARAMETERS`.

    Raises:
        InputError: the address or a parameter is invalid, or the port is in use.
    """
    numbers, texts = parse_parameters("udp:", query, PARAMETERS, TEXT_PARAMETERS)
    option = f"--source udp:{target}"
    listener = WrenchListener(option, *parse_listen_address(option))
    title = "wrenches by UDP to {}:{}".format(*listener.address)
    return UdpSource(model, title, listener, log, texts["frame"], numbers["wait_s"])
