"""Client of PreForm's local API, which prepares jobs for Formlabs printers: one method per call, over plain HTTP.

Source: Formlabs Local API 0.9, github.com/Formlabs/formlabs-api-python (local-api/formlabs-api-local-openapi.yaml).
Python's own HTTP client suffices: a dozen calls to one address, without proxies, redirects or kept connections. The
responding server is not trusted: the time, size and text of its responses are bounded.
"""

import ipaddress
import json
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from http.client import HTTPConnection, HTTPException, HTTPResponse, IncompleteRead
from threading import Event, Timer
from typing import Any, TypeVar
from urllib.parse import quote, urlsplit

from pydantic import ValidationError

from probedesign.core.errors import InputError
from probedesign.design.diagnostics import one_line, quoted
from probedesign.printing.check import HEIGHT_ABOVE_RAFT, RAFT_THICKNESS
from probedesign.printing.preform_settings import (
    MaterialList,
    OperationAccepted,
    OperationStatus,
    PrintScene,
    PrintTimeEstimate,
    PrintValidation,
    Reply,
    UploadedJob,
    VersionReply,
)

PORT = 44388
CONNECT_S = 5.0
MAX_REPLY = 16 * 2**20
"""Maximum size of a response [bytes]; the longest one, the list of materials, has half a million."""


class PreFormError(InputError):
    """Signals that PreForm refuses a request, or that the response is not PreForm's."""


class RefusedError(PreFormError):
    """Signals that PreForm refuses a request with a reason: it was not carried out."""


class NoResponseError(PreFormError):
    """Signals a missing or incomplete response: the request may or may not have been carried out."""


@dataclass(frozen=True)
class Connection:
    """The address of a PreForm server."""

    host: str  #: host, port: of the machine where PreFormServer runs.
    port: int = PORT
    timeout_s: float = 60.0  #: of one response, from request to last byte.

    @property
    def url(self) -> str:
        """Return the address as a user writes it."""
        return f"http://{f'[{self.host}]' if ':' in self.host else self.host}:{self.port}"

    @property
    def local(self) -> bool:
        """Return whether the server runs on this machine."""
        try:
            return ipaddress.ip_address(self.host).is_loopback
        except ValueError:
            return self.host.lower() == "localhost"

    def request(self, what: str, method: str, path: str, body: dict[str, Any] | None = None) -> dict[str, Any]:
        """Send one request and return its response.

        Args:
            what: name of the request, for errors.
            method: GET, POST or DELETE.
            path: with its query.
            body: sent as JSON.

        Returns:
            The JSON object in the response; empty for an empty response.

        Raises:
            NoResponseError: nothing listens, or the response is not complete in time.
            RefusedError: PreForm refuses.
            PreFormError: the response is not PreForm's.
        """
        status, reason, content = self._exchange(what, method, path, body)
        answer = _parsed(content)
        if 200 <= status < 300:
            if isinstance(answer, dict):
                return answer
            raise PreFormError(f"{self.url} is not PreForm: its answer to {what} is no JSON object")
        message = error_message(answer)
        if message is None:
            raise PreFormError(one_line(f"{self.url} answers {what} with {status} {reason}; is that PreForm?"))
        raise RefusedError(one_line(f"PreForm refuses {what}: {message}"))

    def _exchange(self, what: str, method: str, path: str, body: dict[str, Any] | None) -> tuple[int, str, bytes]:
        http = self._connected()
        late = Event()
        try:
            with _deadline(http.sock, self.timeout_s, late):
                payload = None if body is None else json.dumps(body).encode()
                http.request(method, path, payload, {"Content-Type": "application/json", "Connection": "close"})
                response = http.getresponse()
                return response.status, response.reason, self._read(what, response, late)
        except (OSError, HTTPException) as error:
            kind = getattr(error, "strerror", None) or str(error) or type(error).__name__
            how = f"not within {self.timeout_s:g} s" if late.is_set() else f"not to the end ({kind})"
            raise NoResponseError(one_line(f"{self.url} answers {what} {how}")) from None
        finally:
            http.close()

    def _connected(self) -> HTTPConnection:
        http = HTTPConnection(self.host, self.port, timeout=min(CONNECT_S, self.timeout_s))
        try:
            http.connect()
        except (OSError, UnicodeError) as error:  # UnicodeError: a host that no name server takes
            http.close()
            reason = getattr(error, "strerror", None) or str(error) or "no response"
            raise NoResponseError(
                one_line(f"{self.url}: no server responds ({reason}); start it: PreFormServer --port {self.port}")
            ) from None
        return http

    def _read(self, what: str, response: HTTPResponse, late: Event) -> bytes:
        content = response.read(MAX_REPLY + 1)
        if len(content) > MAX_REPLY:
            raise PreFormError(f"{self.url} is not PreForm: its answer to {what} is longer than {MAX_REPLY} bytes")
        # A connection cut within the headers reads like an empty response, which would mean success.
        silent = not content and response.length is None and not response.chunked
        if response.length or silent or late.is_set():
            raise IncompleteRead(content)
        return content


def connection_to(url: str, timeout_s: float = 60.0) -> Connection:
    """Return the connection to an address.

    Raises:
        InputError: it is not of the form http://HOST:PORT.
    """
    try:
        parts = urlsplit(url)
        plain = parts.scheme == "http" and parts.path in ("", "/") and not (parts.query or parts.fragment)
        if plain and parts.hostname and parts.username is None and parts.port != 0:
            return Connection(parts.hostname, parts.port or PORT, timeout_s)
    except ValueError:
        pass
    raise InputError(f"--preform {quoted(url)} is not the address of a PreFormServer; write http://localhost:{PORT}")


@contextmanager
def _deadline(sock: socket.socket, after_s: float, late: Event) -> Iterator[None]:
    """Close a connection after a time, even while the other side keeps sending."""

    def cut() -> None:
        late.set()
        with suppress(OSError):  # it closed by itself in the meantime
            sock.shutdown(socket.SHUT_RDWR)

    sock.settimeout(after_s + 1.0)  # the timer fires first
    timer = Timer(after_s, cut)
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


def _parsed(content: bytes) -> Any:
    """Return the JSON of a response: an empty object for an empty response, None for what is not JSON."""
    if not content.strip():
        return {}
    try:
        return json.loads(content)
    except (ValueError, RecursionError):
        return None


def error_message(answer: Any) -> str | None:
    """Return PreForm's error message in a response, if there is one."""
    error = answer.get("error") if isinstance(answer, dict) else None
    if not isinstance(error, dict):
        return None
    message, code = error.get("message"), error.get("code")
    words = " ".join(str(w) for w in (message, f"({code})" if code else None) if isinstance(w, str) and w)
    return words or None


R = TypeVar("R", bound=Reply)
OnProgress = Callable[[str, float | None], None]

UPRIGHT = {"z_direction": [0.0, 0.0, 1.0], "x_direction": [1.0, 0.0, 0.0]}
"""Keeps the part's z axis up; PreForm would tilt it."""
UPSIDE_DOWN = {"z_direction": [0.0, 0.0, -1.0], "x_direction": [1.0, 0.0, 0.0]}
SUPPORTS = {
    "raft_type": "FULL_RAFT",
    "raft_thickness_mm": RAFT_THICKNESS,
    "height_above_raft_mm": HEIGHT_ABOVE_RAFT,
    "internal_supports_enabled": False,
}
"""Supports below the part only, as the print check assumes. Density and touchpoints are PreForm's defaults."""


FORGET_S = 5.0
FIRST_POLL_S = 0.05


def quiet(_step: str, _share: float | None) -> None:
    """Ignore progress."""


@dataclass(frozen=True)
class PreForm:
    """The API of a PreFormServer."""

    connection: Connection  #: to the server.
    operation_s: float = 600.0  #: timeout of one long operation; the server itself gives up after ten minutes.
    poll_s: float = 1.0  #: longest interval between progress queries.
    on_progress: OnProgress = quiet  #: called with the name of each step and the share done, None where unknown.

    def version(self) -> str:
        """Return the version of the API."""
        return self._call(VersionReply, "the version", "GET", "/").version

    def materials(self) -> MaterialList:
        """Return the printers, materials and settings that the server knows."""
        return self._call(MaterialList, "the list of materials", "GET", "/list-materials/")

    def new_scene(self, settings: dict[str, Any]) -> PrintScene:
        """Create an empty scene for one printer, material and layer height."""
        return self._call(PrintScene, "a new scene", "POST", "/scene/", settings)

    def scene(self, scene: str) -> PrintScene:
        """Return the current state of a scene."""
        return self._call(PrintScene, "the scene", "GET", _at(scene))

    def delete(self, scene: str) -> None:
        """Delete a scene; with a short timeout, since a user may be waiting for the prompt."""
        replace(self.connection, timeout_s=FORGET_S).request("the end of the scene", "DELETE", _at(scene))

    def import_model(self, scene: str, file: str, name: str, upside_down: bool = False) -> None:
        """Import a part upright or upside down. PreForm would guess its units and refuse meshes with defects."""
        body = {
            "file": file, "name": name, "repair_behavior": "REPAIR", "units": "MILLIMETERS",
            "orientation": UPSIDE_DOWN if upside_down else UPRIGHT,
        }  # fmt: skip
        self._operate(Reply, f"the import of {name}", "POST", f"{_at(scene)}import-model/", body)

    def support(self, scene: str, models: list[str] | None = None) -> None:
        """Generate raft and supports below some parts, or below all if `models` is None."""
        body = {"models": "ALL" if models is None else models, **SUPPORTS}
        self._operate(Reply, "supports", "POST", f"{_at(scene)}auto-support/", body)

    def lay_out(self, scene: str) -> None:
        """Lay out all parts on the platform."""
        self._operate(Reply, "the layout", "POST", f"{_at(scene)}auto-layout/", {"models": "ALL"})

    def validate(self, scene: str) -> PrintValidation:
        """Validate the print: cups, islands, missing supports."""
        return self._operate(PrintValidation, "print validation", "GET", f"{_at(scene)}print-validation/")

    def print_time_s(self, scene: str) -> float:
        """Return the estimated print time [s]."""
        path = f"{_at(scene)}estimate-print-time/"
        return self._operate(PrintTimeEstimate, "the print time", "POST", path, {}).total_print_time_s

    def save_screenshot(self, scene: str, file: str) -> None:
        """Save a picture to a path on the server's machine."""
        self._operate(Reply, "a picture", "POST", f"{_at(scene)}save-screenshot/", {"file": file})

    def save_form(self, scene: str, file: str) -> None:
        """Save the job as PreForm's own file to a path on the server's machine."""
        self._operate(Reply, "the form file", "POST", f"{_at(scene)}save-form/", {"file": file})

    def send(self, scene: str, printer: str, job_name: str) -> str:
        """Upload the job to a printer's queue, where a person starts it; return its id."""
        body = {"printer": printer, "job_name": job_name, "print_now": False}
        return self._operate(UploadedJob, "the upload", "POST", f"{_at(scene)}print/", body).job_id

    def _call(self, kind: type[R], what: str, method: str, path: str, body: dict[str, Any] | None = None) -> R:
        self.on_progress(what, None)
        return self._checked(kind, what, self.connection.request(what, method, path, body))

    def _operate(self, kind: type[R], what: str, method: str, path: str, body: dict[str, Any] | None = None) -> R:
        """Start a long operation and wait until it ends."""
        self.on_progress(what, None)
        answer = self.connection.request(what, method, f"{path}?async=true", body)
        operation = self._checked(OperationAccepted, what, answer).operationId
        if operation is None:  # it ended at once
            return self._checked(kind, what, answer)
        return self._checked(kind, what, self._wait(what, operation))

    def _wait(self, what: str, operation: str) -> dict[str, Any]:
        deadline = time.monotonic() + self.operation_s
        pause_s = FIRST_POLL_S
        while True:
            state = self._checked(OperationStatus, what, self._progress(what, operation))
            if state.status == "SUCCEEDED":
                return state.result or {}
            if state.status == "FAILED":
                raise RefusedError(
                    one_line(f"PreForm fails at {what}: {error_message(state.result) or 'no reason stated'}")
                )
            share = min(max(state.progress, 0.0), 1.0)
            if time.monotonic() > deadline:
                raise NoResponseError(
                    f"PreForm is not done with {what} after {self.operation_s:g} s ({share:.0%} done); "
                    "--timeout-s gives it more"
                )
            self.on_progress(what, share)
            time.sleep(min(pause_s, self.poll_s))
            pause_s *= 1.5  # most end soon; supports may take minutes

    def _progress(self, what: str, operation: str) -> dict[str, Any]:
        try:
            return self.connection.request(what, "GET", f"/operations/{quote(operation, safe='')}/")
        except RefusedError as error:  # a refused query does not show whether the operation ended
            raise NoResponseError(str(error)) from None

    def _checked(self, kind: type[R], what: str, answer: dict[str, Any]) -> R:
        try:
            return kind.model_validate(answer)
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            where = ".".join(map(str, first["loc"]))
            raise PreFormError(
                one_line(f"{self.connection.url} is not PreForm: its answer to {what}: {where}: {first['msg']}")
            ) from None


def _at(scene: str) -> str:
    return f"/scene/{quote(scene, safe='')}/"
