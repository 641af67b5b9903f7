"""Sinks of a run: the interface, a group, standard error, a log file, and JSON datagrams by UDP."""

import math
import re
import socket
import sys
import threading
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from queue import SimpleQueue
from time import monotonic
from typing import Any, Protocol

import numpy as np

from probedesign.core.errors import InputError
from probedesign.core.files import check_regular
from probedesign.live import Log, split_address
from probedesign.live.blocks import Block
from probedesign.live.poses.base_poses import TimedPose
from probedesign.live.processing.estimates import EstimateUpdate, Row, json_line, update_row


class Sink(Protocol):
    """Receives readings, estimates and events of a run. No call may wait for a disk, a network or a person.

    What a subclass does not override goes to `pass_on`, which ignores it.
    """

    def on_samples(self, block: Block) -> None:
        """Receive raw readings, before averaging and tare; a block without readings reports silence in its fault."""
        self.pass_on("on_samples", block)

    def on_estimate(self, update: EstimateUpdate) -> None:
        """Receive an estimate, at the rate of estimates."""
        self.pass_on("on_estimate", update)

    def on_pose(self, pose: TimedPose) -> None:
        """Receive a pose of the base by the source's clock, once and in order, as the readings reach it."""
        self.pass_on("on_pose", pose)

    def on_event(self, time: float, line: str) -> None:
        """Receive an event at the source's time [s]: a tare, a mark, silence, loss, a fault."""
        self.pass_on("on_event", time, line)

    def on_end(self) -> None:
        """Handle the end of the source: no further reading will come, but the run may stay open."""
        self.pass_on("on_end")

    def pass_on(self, call: str, *data: Any) -> None:
        """Receive the call of another method by its name; a sink that forwards everything overrides this."""
        return None

    def close(self) -> None:
        """Handle the end of the run; called once, whatever ended it."""
        return None


class SinkGroup(Sink):
    """Forwards every call to several sinks; a sink that fails is removed and reported, and the run continues."""

    def __init__(self, *sinks: Sink) -> None:
        self._sinks = list(sinks)
        self._time = math.nan
        self.lock = threading.RLock()  #: Held while data of one of several probes are forwarded.

    def add(self, sink: Sink) -> None:
        """Add a sink."""
        self._sinks.append(sink)

    def on_samples(self, block: Block) -> None:
        """Forward raw readings."""
        if len(block):
            self._time = float(block.time[-1])
        super().on_samples(block)

    def log(self, line: str) -> None:
        """Forward an event at the time of the last reading; may be called from any thread."""
        self.on_event(self._time, line)

    def close(self) -> None:
        """Close every sink, the last first, even if one fails, so that a sink can still report to the others."""
        while self._sinks:
            last = self._sinks.pop()
            try:
                last.close()
            except Exception as error:
                self.log(f"{type(last).__name__} cannot be closed: {error} ({type(error).__name__})")

    def pass_on(self, call: str, *data: Any) -> None:
        """Call the method of every sink that has it."""
        for sink in tuple(self._sinks):
            try:
                getattr(sink, call)(*data)
            except Exception as error:
                if sink in self._sinks:  # it may have failed in a call within this one
                    self._sinks.remove(sink)
                    name, kind = type(sink).__name__, type(error).__name__
                    self.log(f"{name} failed and is no longer used: {error} ({kind})")


class ProbeSink(Sink):
    """Passes on what belongs to one of several probes: data carry its name, and events begin with it.

    It is called from the thread of its probe; the sinks behind it receive data of one probe at a time.
    """

    def __init__(self, name: str, run: SinkGroup) -> None:
        self._name, self._run = name, run

    def pass_on(self, call: str, *data: Any) -> None:
        """Pass on data with the name of the probe."""
        with self._run.lock:
            getattr(self._run, call)(*(replace(each, probe=self._name) for each in data))

    def on_event(self, time: float, line: str) -> None:
        """Pass on an event; it is not locked, since a thread that ends may wait for it."""
        self._run.on_event(time, f"{self._name}: {line}")


CLOSE_TIMEOUT = 5.0  #: Maximum wait for the disk of the log at the end [s].
REPEAT_INTERVAL = 10.0  #: Minimum interval between lines on the terminal that differ in their numbers only [s].
#: Lines that are always printed: touches, and results of commands, after the name of one of several probes.
ALWAYS_PRINTED = re.compile(r"(?:[\w.-]+: )?(?:touch|mark|tare|record)")


class StderrSink(Sink):
    """Prints events to standard error, one line each; of lines that differ in numbers only, one in ten seconds."""

    def __init__(self) -> None:
        self._printed: dict[str, tuple[float, int, str]] = {}  # time, number of lines since then, and the last of them

    def on_event(self, time: float, line: str) -> None:
        """Print the event."""
        now, kind = monotonic(), re.sub(r"[\d.]+", "", line)
        since, held, _ = self._printed.get(kind, (-math.inf, 0, ""))
        if now - since < REPEAT_INTERVAL and not ALWAYS_PRINTED.match(line):
            self._printed[kind] = since, held + 1, line
            return
        more = f" ({held} more such lines before)" if held else ""
        print(line + more, file=sys.stderr, flush=True)
        self._printed = {k: v for k, v in list(self._printed.items()) if v[1] or now - v[0] < REPEAT_INTERVAL}
        self._printed[kind] = now, 0, ""

    def close(self) -> None:
        """Print the last line of each kind that was held back."""
        for _, held, line in self._printed.values():
            if held:
                print(f"{line} ({held} such lines)", file=sys.stderr, flush=True)


class LogFile(Sink):
    """Appends every event to a file, with the wall-clock time and that of the source; written in a thread."""

    def __init__(self, path: Path) -> None:
        """Open the file; its folder is created if necessary.

        Raises:
            InputError: it cannot be written.
        """
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            check_regular(path)
            self._file = path.open("a", encoding="utf-8", errors="replace")
        except OSError as error:
            raise InputError(f"--log {path}: cannot be written: {error.strerror}") from None
        self._queue = SimpleQueue[str | None]()
        self._thread = threading.Thread(target=self._write, name="log", daemon=True)
        self._thread.start()

    def on_event(self, time: float, line: str) -> None:
        """Queue the event."""
        now = datetime.now().astimezone().isoformat(timespec="milliseconds")
        self._queue.put(f"{now} {'-' if math.isnan(time) else f'{time:.3f} s'} {line}\n")

    def close(self) -> None:
        """Write what is queued and close the file."""
        self._queue.put(None)
        self._thread.join(CLOSE_TIMEOUT)

    def _write(self) -> None:
        with suppress(OSError), self._file:  # a full disk ends the log and not the run
            while (line := self._queue.get()) is not None:
                self._file.write(line)
                self._file.flush()


SCHEMA = 1


class UdpPublisher(Sink):
    """Sends estimates and events as JSON datagrams; never waits for a receiver or the network.

    No receiver is required. A datagram that the system does not accept at once is dropped and counted.

    Attributes:
        sent: number of datagrams sent.
        dropped: number of datagrams that the system did not accept.
    """

    def __init__(self, address: str, log: Log, option: str = "--publish", scheme: str = "udp") -> None:
        """Resolve the address of the receiver, as `udp://HOST:PORT`, that an option of the user states.

        Raises:
            InputError: the address is invalid, or the host is unknown.
        """
        host, port = split_address(address, scheme) or ("", None)
        if not host or not port:
            raise InputError(f"{option} {address}: write {scheme}://HOST:PORT, as {scheme}://127.0.0.1:9000")
        try:
            receiver = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
            self._socket, self._receiver = socket.socket(*receiver[:3]), receiver[4]
        except OSError as error:
            raise InputError(f"{option} {address}: {error.strerror or error}") from None
        self._socket.setblocking(False)
        self._address, self._log, self._option = address, log, option
        self.sent, self.dropped, self._lock = 0, 0, threading.RLock()

    def on_estimate(self, update: EstimateUpdate) -> None:
        """Send the row of `live --json`, its time stamps and, with poses, what `explore --follow` takes."""
        kind: Row = {"kind": "estimate", **({"probe": update.probe} if update.probe else {})}
        followed: dict[str, Any] = {}
        wrench, T = update.wrench_base + update.drift_base, update.T_world_base
        if update.fused is not None and np.isfinite(wrench).all() and np.isfinite(T).all():
            force, moment = np.split(wrench, 2)
            followed = {"T_world_base": T.tolist(), "mount_force_base_N": force.tolist(),
                        "mount_moment_base_Nm": moment.tolist()}  # fmt: skip
        self._send(kind | update_row(update) | followed | time_stamps(update.reading.received))

    def send_map(self, document: Mapping[str, Any]) -> None:
        """Send shapes and next touch of `explore`."""
        self._send({"kind": "map", **document})

    def on_event(self, time: float, line: str) -> None:
        """Send an event."""
        event: Row = {"kind": "event", "time_s": time, "event": line}
        self._send(event | time_stamps(math.nan))

    def close(self) -> None:
        """Close the socket and report the counts."""
        lost = f", {self.dropped} were not accepted by the network" if self.dropped else ""
        self._socket.close()
        self._log(f"published {self.sent} datagrams to {self._address}{lost}")

    def _send(self, message: Mapping[str, Any]) -> None:
        with self._lock:  # events come from the threads of all probes
            counted = {"schema": SCHEMA, "number": self.sent + self.dropped + 1, **message}
            try:
                self._socket.sendto(json_line(counted).encode(), self._receiver)
                self.sent += 1
            except OSError as error:
                self.dropped += 1
                if self.dropped == 1:
                    why = error.strerror or error
                    self._log(f"{self._option} {self._address}: a datagram was not sent: {why}; the run continues")


def time_stamps(received: float) -> Row:
    """Return the arrival time of a reading and the current time by both clocks [s], and the latency [ms].

    `received` is the arrival by `time.monotonic` [s]; NaN without hardware.
    """
    monotonic, wall = time.monotonic(), time.time()
    return {
        "received_monotonic_s": received,
        "sent_monotonic_s": monotonic,
        "received_unix_s": wall - (monotonic - received),
        "sent_unix_s": wall,
        "latency_ms": 1e3 * (monotonic - received),
    }
