"""Plain HTTP to PreForm: one request, one JSON object, or one line of error.

Python's own client does it: a dozen calls to one address, and nothing here wants proxies of the environment,
redirects or kept connections. What answers is not trusted: its time, its size and its text are bounded.
"""

import ipaddress
import json
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from http.client import HTTPConnection, HTTPException, HTTPResponse, IncompleteRead
from threading import Event, Timer
from typing import Any
from urllib.parse import urlsplit

from probedesign.design_problems import one_line, quoted
from probedesign.errors import InputError

PORT = 44388
CONNECT_S = 5.0
MAX_REPLY = 16 * 2**20
"""Bytes; the longest there is, the list of materials, has half a million."""


class PreFormError(InputError):
    """PreForm refuses, or what answers is not PreForm."""


class RefusedError(PreFormError):
    """PreForm refuses in its own words: what was asked for is not done."""


class NoAnswerError(PreFormError):
    """Nothing answers, or not to the end: what was asked for may have been done or not."""


@dataclass(frozen=True)
class Connection:
    """Where PreForm listens.

    Attributes:
        host, port: of the machine where PreFormServer runs.
        timeout_s: for one answer, from request to last byte.
    """

    host: str
    port: int = PORT
    timeout_s: float = 60.0

    @property
    def url(self) -> str:
        """As a user writes it."""
        return f"http://{f'[{self.host}]' if ':' in self.host else self.host}:{self.port}"

    @property
    def local(self) -> bool:
        """Whether that is this machine."""
        try:
            return ipaddress.ip_address(self.host).is_loopback
        except ValueError:
            return self.host.lower() == "localhost"

    def ask(self, what: str, method: str, path: str, body: dict[str, Any] | None = None) -> dict[str, Any]:
        """Send one request and read its answer.

        Args:
            what: that is wanted, for errors.
            method: GET, POST or DELETE.
            path: with its query.
            body: sent as JSON.

        Returns:
            The object that was answered; empty for an empty answer.

        Raises:
            NoAnswerError: nothing listens, or the answer does not come to its end in time.
            RefusedError: PreForm refuses.
            PreFormError: the answer is none of PreForm's.
        """
        status, reason, content = self._exchange(what, method, path, body)
        answer = _parsed(content)
        if 200 <= status < 300:
            if isinstance(answer, dict):
                return answer
            raise PreFormError(f"{self.url} is not PreForm: its answer to {what} is no JSON object")
        told = told_error(answer)
        if told is None:
            raise PreFormError(
                one_line(f"{self.url} answers {what} with {status} {reason}; is that PreForm?")
            )
        raise RefusedError(one_line(f"PreForm refuses {what}: {told}"))

    def _exchange(
        self, what: str, method: str, path: str, body: dict[str, Any] | None
    ) -> tuple[int, str, bytes]:
        http = self._connected()
        late = Event()
        try:
            with _cut_off(http.sock, self.timeout_s, late):
                payload = None if body is None else json.dumps(body).encode()
                http.request(
                    method, path, payload, {"Content-Type": "application/json", "Connection": "close"}
                )
                response = http.getresponse()
                return response.status, response.reason, self._read(what, response, late)
        except (OSError, HTTPException) as error:
            how = f"not within {self.timeout_s:g} s" if late.is_set() else f"not to the end ({_kind(error)})"
            raise NoAnswerError(one_line(f"{self.url} answers {what} {how}")) from None
        finally:
            http.close()

    def _connected(self) -> HTTPConnection:
        http = HTTPConnection(self.host, self.port, timeout=min(CONNECT_S, self.timeout_s))
        try:
            http.connect()
        except (OSError, UnicodeError) as error:  # UnicodeError: a host that no name server takes
            http.close()
            reason = getattr(error, "strerror", None) or str(error) or "no answer"
            raise NoAnswerError(
                one_line(
                    f"{self.url}: nothing answers there ({reason}); start it: PreFormServer --port {self.port}"
                )
            ) from None
        return http

    def _read(self, what: str, response: HTTPResponse, late: Event) -> bytes:
        content = response.read(MAX_REPLY + 1)
        if len(content) > MAX_REPLY:
            raise PreFormError(
                f"{self.url} is not PreForm: its answer to {what} is longer than {MAX_REPLY} bytes"
            )
        # A connection cut within the headers reads like an empty answer, which would mean success.
        silent = not content and response.length is None and not response.chunked
        if response.length or silent or late.is_set():
            raise IncompleteRead(content)
        return content


def connection_to(url: str, timeout_s: float = 60.0) -> Connection:
    """The connection that an address means.

    Raises:
        InputError: it is no http://HOST:PORT.
    """
    try:
        parts = urlsplit(url)
        plain = parts.scheme == "http" and parts.path in ("", "/") and not (parts.query or parts.fragment)
        if plain and parts.hostname and parts.username is None and parts.port != 0:
            return Connection(parts.hostname, parts.port or PORT, timeout_s)
    except ValueError:
        pass
    raise InputError(
        f"--preform {quoted(url)} is no address of a PreFormServer; write http://localhost:{PORT}"
    )


@contextmanager
def _cut_off(sock: socket.socket, after_s: float, late: Event) -> Iterator[None]:
    """End a connection after a time, however busily the other side keeps it alive."""

    def cut() -> None:
        late.set()
        with suppress(OSError):  # it ended by itself just now
            sock.shutdown(socket.SHUT_RDWR)

    sock.settimeout(after_s + 1.0)  # the timer comes first
    timer = Timer(after_s, cut)
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


def _parsed(content: bytes) -> Any:
    """The JSON in an answer; an empty object for none, None for what is not JSON."""
    if not content.strip():
        return {}
    try:
        return json.loads(content)
    except (ValueError, RecursionError):
        return None


def told_error(answer: Any) -> str | None:
    """PreForm's own words in an answer that says what went wrong."""
    error = answer.get("error") if isinstance(answer, dict) else None
    if not isinstance(error, dict):
        return None
    message, code = error.get("message"), error.get("code")
    words = " ".join(str(w) for w in (message, f"({code})" if code else None) if isinstance(w, str) and w)
    return words or None


def _kind(error: Exception) -> str:
    return getattr(error, "strerror", None) or str(error) or type(error).__name__
