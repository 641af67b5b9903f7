"""Answers and events as JSON datagrams over UDP, for anyone's controller."""

import math
import socket
import time
from urllib.parse import urlsplit

from probedesign.errors import InputError
from probedesign.live.answer import Answer
from probedesign.live.block import Block
from probedesign.live.row import Row, json_line, row
from probedesign.live.sinks import Say

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
        host, port = _parts(address)
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
        self._send(kind | row(answer.reading, answer.estimate) | stamps(answer.reading.received))

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


def _parts(address: str) -> tuple[str, int]:
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
