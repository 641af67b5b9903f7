"""Guarded motion: contact and limits at the rate of the samples, with a stop that lasts until it is reset.

The samples are watched in the thread that reads them, so that no event waits for an estimate. They are compared with
the free probe as the last estimate knew it: its bias, its gravity.
"""

import base64
import math
import threading
from collections.abc import Callable, Generator
from contextlib import closing
from dataclasses import dataclass
from queue import SimpleQueue
from time import monotonic
from typing import Any

import numpy as np

from probedesign.core.errors import InputError
from probedesign.core.frames import Array
from probedesign.estimation.detector import Detector
from probedesign.estimation.estimator import Estimator
from probedesign.estimation.model import ProbeModel
from probedesign.live import Log
from probedesign.live.blocks import Block, joined
from probedesign.live.outputs.sinks import Sink, UdpPublisher, time_stamps
from probedesign.live.processing.averaging import choose_averaging
from probedesign.live.processing.commands import Command
from probedesign.live.processing.estimates import EstimateUpdate, Row, json_line
from probedesign.live.processing.tare import CHANNELS
from probedesign.live.recordings.schemas import TEXT, texts
from probedesign.live.sources.source import Source

HEARTBEAT = 0.010  #: Interval of the heartbeats [s]. Assumed: ten cycles of a Franka, five of a UR.
RELEASE = 0.8  #: Share of a limit below which force and moment must fall before the stop can be reset. Assumed.
GATHER = 7  #: Readings that are watched together: 1 ms of the fastest source.
FIRST_READINGS = 64  #: Number of readings that show rate and averaging of a source.
JOIN_TIMEOUT = 5.0  #: Maximum wait for the end of a source [s].
TOPIC = "/probedesign/guard"  #: Topic of the events in ROS 2.


@dataclass(frozen=True)
class Limits:
    """Largest force [N] and moment about the base [N·m] of the contact."""

    force: float = math.inf
    moment: float = math.inf

    def check(self, model: ProbeModel) -> None:
        """Refuse limits that the sensor cannot read in every direction; raises InputError."""
        rows = (("force-N", self.force, model.wrench_range[:3], "N"),
                ("moment-Nm", self.moment, model.wrench_range[3:], "N·m"))  # fmt: skip
        for name, limit, channels, unit in rows:
            most = float(channels.min())
            if not limit > 0.0 or (math.isfinite(limit) and limit > most):
                raise InputError(f"--limit-{name} {limit:g} must be positive and within the sensor's {most:g} {unit}")


class GuardChannel(UdpPublisher):
    """Sends the events of a guard to `udp://HOST:PORT`, or to the node of ROS 2 at `ros2://HOST:PORT`."""

    def __init__(self, address: str, log: Log) -> None:
        """Resolve the address; raises InputError if that fails."""
        self._to_node = address.startswith("ros2:")
        super().__init__(address.replace("ros2:", "udp:", 1), log, "--guard")

    def send(self, row: Row) -> None:
        """Send one event."""
        if self._to_node:
            text = base64.b64encode(texts([json_line(row)])[0].tobytes()).decode()
            row = {"kind": "message", "topic": TOPIC, "type": TEXT, "data": text}
        self._send(row)


class Guard(Sink):
    """Watches the samples of one probe; nothing is compared before the first estimate with a known zero.

    Attributes:
        stop: why motion must stop; empty if it need not. It lasts until `reset`.
    """

    def __init__(self, estimator: Estimator, limits: Limits, send: Callable[[Row], None], log: Log, name: str = ""):
        """Start without a reference; `send` takes events, whose probe is `name` in a run with several."""
        model, self.stop = estimator.model, ""
        self._estimator, self._limits, self._send, self._log, self._name = estimator, limits, send, log, name
        self._to_base = model.to_base(np.eye(6), np.zeros(3))
        self._offset: Array | None = None  # of the base wrench of a sample to its excess over the free probe
        self._detector: Detector | None = None
        self._first: list[Block] | None = []
        self._touching, self._exceeded, self._sent, self._phase = False, "", -math.inf, ""
        self._values = np.zeros(2)

    def on_estimate(self, update: EstimateUpdate) -> None:
        """Take bias and gravity of an estimate as the reference."""
        self._phase = update.phase
        if update.estimate.result == "no_tare" or not np.isfinite(update.wrench_base).all():
            return
        free = self._estimator.free(update.reading.gravity_base).wrench_base
        self._offset = update.wrench_base - update.reading.wrench_sensor @ self._to_base - free

    def watch(self, block: Block) -> None:
        """Compare raw readings with the limits and send what follows; a block without readings reports silence."""
        time, received = (block.time[0], block.received[0]) if len(block) else (math.nan, math.nan)
        fault = block.fault
        if len(block) and not fault:
            beyond = ~(np.abs(block.wrench_sensor) <= self._estimator.model.saturation_limit)
            if beyond.any():
                fault = f"{CHANNELS[int(np.argwhere(beyond)[0][1])]} is at its limit or not a number"
        if fault:
            self._latch(fault, time, received)
        elif len(block):
            self._compare(block)
        if monotonic() - self._sent >= HEARTBEAT:
            self._emit("heartbeat", time, received)

    def _compare(self, block: Block) -> None:
        if self._first is not None:
            self._first.append(block)
            if sum(map(len, self._first)) >= FIRST_READINGS:
                known, priors, self._first = joined(self._first), self._estimator.priors, None
                times = known.time
                step = float(np.median(np.diff(times))) or float(times[-1] - times[0]) / (len(times) - 1)
                samples = choose_averaging(times, known.wrench_sensor, self._estimator.model).samples
                self._detector = Detector(
                    self._estimator.model, 1.0 / max(step, 1e-5), samples=samples, walk_steps=priors.walk_steps,
                    start_steps=priors.drift_steps,
                )  # fmt: skip
        if self._offset is None:
            return
        excess = block.wrench_sensor @ self._to_base + self._offset
        sizes = np.sqrt(np.stack([np.square(excess[:, :3]).sum(axis=1), np.square(excess[:, 3:]).sum(axis=1)], axis=1))
        shares = sizes / (self._limits.force, self._limits.moment)
        i = int(np.argmax(shares.max(axis=1)))
        self._values = sizes[i]
        if shares[i].max() > 1.0:
            kind = ("force", "N", self._limits.force) if shares[i, 0] > 1.0 else ("moment", "N·m", self._limits.moment)
            value = sizes[i, 0] if kind[0] == "force" else sizes[i, 1]
            self._exceeded = f"the {kind[0]} of {value:.3g} {kind[1]} exceeds its limit of {kind[2]:g} {kind[1]}"
            self._latch(self._exceeded, block.time[i], block.received[i])
        elif shares.max() < RELEASE:
            self._exceeded = ""
        if self._detector is not None:
            states = self._detector.run(excess)
            if (touching := states[-1] == "contact") != self._touching:
                self._touching = touching
                first = states.index("contact") if touching else len(states) - 1
                self._emit("contact", block.time[first], block.received[first])

    def _latch(self, reason: str, time: float, received: float) -> None:
        if not self.stop:
            self.stop = reason
            self._emit("limit", time, received)
            self._log(f"guard: stop: {reason}; the command reset ends it")

    def reset(self, command: Command) -> str:
        """End the stop; raises InputError while its reason lasts."""
        if self._exceeded:
            raise InputError(f"{self._exceeded}, and has not fallen below {RELEASE:.0%} of it")
        self.stop = ""
        return "guard: reset"

    def _emit(self, kind: str, time: float, received: float) -> None:
        self._sent = monotonic()
        probe: Row = {"probe": self._name} if self._name else {}
        row: Row = {"kind": kind, **probe, "time_s": float(time), "contact": self._touching, "stop": self.stop,
                    "armed": self._offset is not None, "phase": self._phase, "force_N": float(self._values[0]),
                    "moment_Nm": float(self._values[1])}  # fmt: skip
        self._send(row | time_stamps(float(received)))


class GuardedSource:
    """A source that is read in a thread of its own, in which a guard watches it; see `Source`."""

    def __init__(self, source: Source, guard: Guard) -> None:
        self.title, self.notes = source.title, source.notes
        self._source, self._guard, self._wanted = source, guard, 1
        self._ended = threading.Event()

    def expect(self, readings: int) -> None:
        """Pass readings on when there are this many; see `Source`."""
        self._wanted = readings

    def __iter__(self) -> Generator[Block, None, None]:
        arrived = SimpleQueue[Any]()
        thread = threading.Thread(target=self._read, args=(arrived,), name="guard", daemon=True)
        thread.start()
        try:
            while (item := arrived.get()) is not None:
                if isinstance(item, Exception):
                    raise item
                yield from item
        finally:
            self._ended.set()
            thread.join(JOIN_TIMEOUT)

    def _read(self, arrived: SimpleQueue[Any]) -> None:
        held, count = list[Block](), 0
        try:
            expect = getattr(self._source, "expect", None)
            with closing(iter(self._source)) as stream:
                for block in stream:
                    if expect is not None:
                        expect(GATHER)
                    self._guard.watch(block)
                    held.append(block)
                    count += len(block)
                    if count >= self._wanted or not len(block):
                        arrived.put(held)
                        held, count = [], 0
                    if self._ended.is_set():
                        return
            arrived.put(held)
            arrived.put(None)
        except Exception as error:  # raised where the readings are taken
            arrived.put(error)
