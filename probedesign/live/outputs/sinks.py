"""Where readings, answers and events go: recorder, view, publisher, terminal, peers behind one small interface."""

import math
import socket
import sys
import time
from collections.abc import Callable
from typing import Protocol
from urllib.parse import urlsplit

from probedesign.errors import InputError
from probedesign.live.processing.blocks import Block
from probedesign.live.processing.estimates import Answer, Row, estimate_row, json_line, world_row


class Sink(Protocol):
    """Takes what live reads and says. None of the calls waits for a disk, a network or a person."""

    def read(self, block: Block) -> None:
        """Readings as the source gave them, raw, before averaging and tare; a block without readings tells silence,
        and why in its fault."""
        ...

    def answered(self, answer: Answer) -> None:
        """An answer, at the rate of estimates."""
        ...

    def told(self, time: float, line: str) -> None:
        """An event in words, with the source's time [s]: a tare, a mark, silence, loss, a fault."""
        ...

    def close(self) -> None:
        """The run ends; called once, however it ends."""
        ...


Say = Callable[[str], None]


class Sinks:
    """A sink of sinks. One that fails is dropped, with one line to the others, and the run goes on."""

    def __init__(self, *sinks: Sink) -> None:
        self._sinks = list(sinks)
        self._time = math.nan

    def add(self, sink: Sink) -> None:
        """One more, from now on."""
        self._sinks.append(sink)

    def read(self, block: Block) -> None:
        """Readings as the source gave them."""
        if len(block):
            self._time = float(block.time[-1])
        self._each(lambda sink: sink.read(block))

    def answered(self, answer: Answer) -> None:
        """An answer."""
        self._each(lambda sink: sink.answered(answer))

    def told(self, time: float, line: str) -> None:
        """An event."""
        self._each(lambda sink: sink.told(time, line))

    def say(self, line: str) -> None:
        """An event at the time of the last reading; safe from other threads."""
        self.told(self._time, line)

    def close(self) -> None:
        """The run ends: every sink is closed, whatever becomes of the others, the last first, so that they can
        still say something."""
        while self._sinks:
            last = self._sinks.pop()
            try:
                last.close()
            except Exception as error:
                self.say(f"{type(last).__name__} cannot be closed: {error} ({type(error).__name__})")

    def _each(self, call: Callable[[Sink], None]) -> None:
        for sink in tuple(self._sinks):
            try:
                call(sink)
            except Exception as error:
                self._drop(sink, error)

    def _drop(self, sink: Sink, error: Exception) -> None:
        if sink in self._sinks:
            self._sinks.remove(sink)
            self.say(
                f"{type(sink).__name__} fails and is left out from here on: {error} ({type(error).__name__})"
            )


class Spoken:
    """What is told goes to standard error, a line each."""

    def read(self, block: Block) -> None:
        """Nothing is said of readings."""

    def answered(self, answer: Answer) -> None:
        """Nothing is said of answers."""

    def told(self, time: float, line: str) -> None:
        """The line."""
        print(line, file=sys.stderr, flush=True)

    def close(self) -> None:
        """There is nothing to close."""


SCHEMA = 1


class Publisher:
    """A sink that sends each answer on its way and never waits: not for a receiver, not for the network.

    Nobody needs to listen. What the system does not take at once is dropped and counted.

    Attributes:
        sent: datagrams so far.
        dropped: those that the system did not take.
    """

    def __init__(self, address: str, say: Say) -> None:
        """Look up the receiver.

        Args:
            address: `udp://HOST:PORT`.
            say: takes what a user should know.

        Raises:
            InputError: the address is none, or the host is not known.
        """
        host, port = _host_and_port(address)
        try:
            found = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
            self._socket, self._receiver = socket.socket(*found[:3]), found[4]
        except OSError as error:
            raise InputError(f"--publish {address}: {error.strerror or error}") from None
        self._socket.setblocking(False)
        self._address, self._say = address, say
        self.sent, self.dropped = 0, 0

    def read(self, block: Block) -> None:
        """Raw readings are not published."""

    def answered(self, answer: Answer) -> None:
        """One datagram: the row of `live --json` and when it came and went."""
        kind: Row = {"kind": "estimate"}
        world = world_row(answer) if answer.fused is not None else {}
        self._send(
            kind | estimate_row(answer.reading, answer.estimate) | world | stamps(answer.reading.received)
        )

    def told(self, time: float, line: str) -> None:
        """One datagram: an event in words."""
        event: Row = {"kind": "event", "time_s": time, "event": line}
        self._send(event | stamps(math.nan))

    def close(self) -> None:
        """Say how many there were."""
        lost = f", {self.dropped} were not taken by the network" if self.dropped else ""
        self._socket.close()
        self._say(f"published {self.sent} datagrams to {self._address}{lost}")

    def _send(self, message: Row) -> None:
        counted: Row = {"schema": SCHEMA, "number": self.sent + self.dropped + 1} | message
        try:
            self._socket.sendto(json_line(counted).encode(), self._receiver)
            self.sent += 1
        except OSError as error:
            self.dropped += 1
            if self.dropped == 1:
                self._say(
                    f"--publish {self._address}: a datagram was not sent: {error.strerror or error}; going on"
                )


def stamps(received: float) -> Row:
    """When a reading reached this program and when its answer leaves, by both clocks [s], and between [ms].

    Args:
        received: by `time.monotonic` [s]; NaN if it came from no wire.
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
    """Host and port of `udp://HOST:PORT`."""
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
