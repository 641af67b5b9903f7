"""Sinks of a run: the interface, a group of sinks, standard error, and JSON datagrams by UDP."""

import math
import socket
import sys
import time
from collections.abc import Callable
from typing import Protocol
from urllib.parse import urlsplit

from probedesign.core.errors import InputError
from probedesign.live import Log
from probedesign.live.processing.blocks import Block
from probedesign.live.processing.estimates import EstimateUpdate, Row, estimate_row, json_line, world_row


class Sink(Protocol):
    """Receives readings, estimates and events of a run. No call may wait for a disk, a network or a person."""

    def on_samples(self, block: Block) -> None:
        """Receive raw readings, before averaging and tare; a block without readings reports silence in its fault."""
        ...

    def on_estimate(self, update: EstimateUpdate) -> None:
        """Receive an estimate, at the rate of estimates."""
        ...

    def on_event(self, time: float, line: str) -> None:
        """Receive an event at the source's time [s]: a tare, a mark, silence, loss, a fault."""
        ...

    def close(self) -> None:
        """Handle the end of the run; called once, whatever ended it."""
        ...


class SinkGroup:
    """Forwards every call to several sinks; a sink that fails is removed and reported, and the run continues."""

    def __init__(self, *sinks: Sink) -> None:
        self._sinks = list(sinks)
        self._time = math.nan

    def add(self, sink: Sink) -> None:
        """Add a sink."""
        self._sinks.append(sink)

    def on_samples(self, block: Block) -> None:
        """Forward raw readings."""
        if len(block):
            self._time = float(block.time[-1])
        self._call_all(lambda sink: sink.on_samples(block))

    def on_estimate(self, update: EstimateUpdate) -> None:
        """Forward an estimate."""
        self._call_all(lambda sink: sink.on_estimate(update))

    def on_event(self, time: float, line: str) -> None:
        """Forward an event."""
        self._call_all(lambda sink: sink.on_event(time, line))

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

    def _call_all(self, call: Callable[[Sink], None]) -> None:
        for sink in tuple(self._sinks):
            try:
                call(sink)
            except Exception as error:
                self._remove(sink, error)

    def _remove(self, sink: Sink, error: Exception) -> None:
        if sink in self._sinks:
            self._sinks.remove(sink)
            self.log(f"{type(sink).__name__} failed and is no longer used: {error} ({type(error).__name__})")


class StderrSink:
    """Prints events to standard error, one line each."""

    def on_samples(self, block: Block) -> None:
        """Ignore readings."""

    def on_estimate(self, update: EstimateUpdate) -> None:
        """Ignore estimates."""

    def on_event(self, time: float, line: str) -> None:
        """Print the event."""
        print(line, file=sys.stderr, flush=True)

    def close(self) -> None:
        """Do nothing: standard error stays open."""


SCHEMA = 1


class UdpPublisher:
    """Sends estimates and events as JSON datagrams; never waits for a receiver or the network.

    No receiver is required. A datagram that the system does not accept at once is dropped and counted.

    Attributes:
        sent: number of datagrams sent.
        dropped: number of datagrams that the system did not accept.
    """

    def __init__(self, address: str, log: Log) -> None:
        """Resolve the address of the receiver.

        Args:
            address: `udp://HOST:PORT`.
            log: callback for messages to the user.

        Raises:
            InputError: the address is invalid, or the host is unknown.
        """
        host, port = _host_and_port(address)
        try:
            found = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
            self._socket, self._receiver = socket.socket(*found[:3]), found[4]
        except OSError as error:
            raise InputError(f"--publish {address}: {error.strerror or error}") from None
        self._socket.setblocking(False)
        self._address, self._log = address, log
        self.sent, self.dropped = 0, 0

    def on_samples(self, block: Block) -> None:
        """Ignore raw readings."""

    def on_estimate(self, update: EstimateUpdate) -> None:
        """Send the row of `live --json` and its time stamps."""
        kind: Row = {"kind": "estimate"}
        world = world_row(update) if update.fused is not None else {}
        self._send(
            kind
            | estimate_row(update.reading, update.estimate)
            | world
            | time_stamps(update.reading.received)
        )

    def on_event(self, time: float, line: str) -> None:
        """Send an event."""
        event: Row = {"kind": "event", "time_s": time, "event": line}
        self._send(event | time_stamps(math.nan))

    def close(self) -> None:
        """Close the socket and report the counts."""
        lost = f", {self.dropped} were not accepted by the network" if self.dropped else ""
        self._socket.close()
        self._log(f"published {self.sent} datagrams to {self._address}{lost}")

    def _send(self, message: Row) -> None:
        counted: Row = {"schema": SCHEMA, "number": self.sent + self.dropped + 1} | message
        try:
            self._socket.sendto(json_line(counted).encode(), self._receiver)
            self.sent += 1
        except OSError as error:
            self.dropped += 1
            if self.dropped == 1:
                self._log(
                    f"--publish {self._address}: a datagram was not sent: {error.strerror or error}; the run continues"
                )


def time_stamps(received: float) -> Row:
    """Return the arrival time of a reading and the current time by both clocks [s], and the latency [ms].

    Args:
        received: arrival by `time.monotonic` [s]; NaN without hardware.
    """
    monotonic, wall = time.monotonic(), time.time()
    return {
        "received_monotonic_s": received,
        "sent_monotonic_s": monotonic,
        "received_unix_s": wall - (monotonic - received),
        "sent_unix_s": wall,
        "latency_ms": 1e3 * (monotonic - received),
    }


def _host_and_port(address: str) -> tuple[str, int]:
    """Return host and port of `udp://HOST:PORT`."""
    try:
        parts = urlsplit(address)
        host, port = parts.hostname or "", parts.port or 0
    except ValueError:
        host, port = "", 0
    if (
        address != f"udp://{address[6:]}"
        or not host
        or not port
        or parts.path
        or parts.query
        or parts.username
    ):
        raise InputError(f"--publish {address}: write udp://HOST:PORT, as udp://127.0.0.1:9000")
    return host, port
