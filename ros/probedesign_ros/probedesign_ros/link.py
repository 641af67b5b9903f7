"""Datagrams from and to a run of `probedesign live`; needs neither ROS 2 nor probedesign.

A run sends `--publish ros2://HOST:PORT` and receives `--control udp://[HOST]:PORT`.
"""

import base64
import json
import socket
from collections import Counter
from collections.abc import Iterator
from typing import NamedTuple

MAX_DATAGRAM = 65536
MAX_SENDERS = 16  # whose numbers are known: a run, and `explore --follow` beside it
MAX_AT_ONCE = 500  # datagrams per call, so that a flood leaves time for services


class RecordedMessage(NamedTuple):
    """One message, as a recording contains it: topic, type, and the bytes of its CDR encoding.

    `number` is that of its datagram; None without one.
    """

    topic: str
    type: str
    cdr: bytes
    number: int | None


def parse(datagram: bytes) -> RecordedMessage:
    """Return the message of a datagram.

    Raises:
        ValueError: it is not one of a run.
    """
    content = json.loads(datagram)
    if not isinstance(content, dict) or content.get("schema") != 1 or content.get("kind") != "message":
        raise ValueError("not a datagram of probedesign live --publish ros2://")
    topic, kind, data = (content.get(name) for name in ("topic", "type", "data"))
    if not (isinstance(topic, str) and isinstance(kind, str) and isinstance(data, str)):
        raise ValueError("topic, type and data must be texts")
    number = content.get("number")
    cdr = base64.b64decode(data, validate=True)
    return RecordedMessage(topic, kind, cdr, number if isinstance(number, int) else None)


class Receiver:
    """Receives the datagrams of a run without waiting.

    Attributes:
        counts: number of messages received, datagrams lost and malformed datagrams.
    """

    def __init__(self, host: str, port: int) -> None:
        self.counts: Counter = Counter()
        self._last: dict[tuple, int] = {}  # number of the last datagram of each sender
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind((host, port))
        self._socket.setblocking(False)

    @property
    def port(self) -> int:
        """Port that is listened on."""
        return int(self._socket.getsockname()[1])

    def messages(self) -> Iterator[RecordedMessage]:
        """Yield the messages that have arrived, up to `MAX_AT_ONCE`; malformed datagrams are counted."""
        for _ in range(MAX_AT_ONCE):
            try:
                datagram, sender = self._socket.recvfrom(MAX_DATAGRAM)
            except BlockingIOError:
                return
            except OSError:
                continue
            try:
                message = parse(datagram)
            except (ValueError, RecursionError):
                self.counts["malformed"] += 1
                continue
            if message.number is not None:
                last = self._last.pop(sender, message.number)
                self.counts["lost"] += max(message.number - last - 1, 0)
                if len(self._last) >= MAX_SENDERS:
                    self._last.clear()
                self._last[sender] = message.number  # it begins anew with a new run
            self.counts["received"] += 1
            yield message

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


class Result(NamedTuple):
    """Whether a command was accepted, and its outcome or the reason of the refusal."""

    accepted: bool
    text: str


class Commander:
    """Sends commands to a run and waits for the reply."""

    def __init__(self, host: str, port: int, timeout: float) -> None:
        self._run, self._timeout, self._number = (host, port), timeout, 0

    def send(self, command: str, text: str = "") -> Result:
        """Return the result of a command; a run that does not reply within the timeout [s] has not accepted it."""
        self._number += 1
        request = json.dumps({"command": command, "text": text, "id": self._number}).encode()
        try:
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
                link.settimeout(self._timeout)
                link.connect(self._run)
                link.send(request)
                return self._reply(link)
        except TimeoutError:
            return Result(False, f"no reply within {self._timeout:g} s: is it run with --control?")
        except OSError as error:
            return Result(False, f"no run listens at {self._run[0]}:{self._run[1]}: {error.strerror or error}")

    def _reply(self, link: socket.socket) -> Result:
        for _ in range(10):
            try:
                reply = json.loads(link.recv(MAX_DATAGRAM))
            except ValueError:
                continue
            if isinstance(reply, dict) and reply.get("id") == self._number:
                return Result(reply.get("accepted") is True, str(reply.get("text", ""))[:500])
        return Result(False, "the replies are not those of probedesign live")
