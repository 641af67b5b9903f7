"""`--view`: a sink that shows what it is given on a page, drawn by another process."""

import importlib.util
import json
import os
import pickle
import socket
import subprocess
import sys
import threading
from contextlib import suppress
from pathlib import Path
from typing import IO, Any, get_args

from probedesign.errors import InputError, MissingDependencyError
from probedesign.estimation.estimator import Estimator
from probedesign.live.outputs.sinks import Say
from probedesign.live.processing.scheduler import Requests, Wish
from probedesign.live.view.scene import Setup, Tube, parts_of
from probedesign.live.view.snapshot import Shape
from probedesign.live.view.state import Counts, Keeper

PERIOD = 1.0 / 30.0
"""Between two frames [s]."""
LONGEST_NOTE = 200
"""Characters of a mark that are taken."""
LOCAL = ("127.0.0.1", "localhost", "::1")


class View(Keeper):
    """The page of a run, from when it listens to `close`.

    Nothing here waits for it: a thread sends what there is to see, at most 30 times a second, and if the page does not
    keep up it sees fewer moments.

    Attributes:
        url: where it is.
    """

    def __init__(
        self,
        estimator: Estimator,
        folder: Path,
        requests: Requests,
        say: Say,
        host: str = "127.0.0.1",
        port: int = 8080,
        counts: Counts = dict,
    ) -> None:
        """Open the page.

        Args:
            estimator: of the probe.
            folder: where its exported parts may lie.
            requests: takes what people ask.
            say: takes what a user should know.
            host: address to listen on.
            port: where, or at the next free one.
            counts: gives what the source counts: lost, dropped.

        Raises:
            InputError: it cannot listen there.
            MissingDependencyError: viser is not installed.
        """
        if importlib.util.find_spec("viser") is None:
            raise MissingDependencyError("--view needs viser; install probedesign[view]")
        _check(host, port)
        self._requests, self._say = requests, say
        super().__init__(counts)
        self._ended = threading.Event()
        self._process = process = _start()
        assert process.stdin is not None and process.stdout is not None
        with suppress(BrokenPipeError):  # then the next line tells why
            self._send(process.stdin, setup_of(estimator, folder, host, port, say))
        self.url = self._opened(process.stdout)
        who = (
            "this machine alone"
            if host in LOCAL
            else "anyone who reaches it, who may tare and end recordings"
        )
        say(f"view: {self.url}, open to {who}")
        self._writer = threading.Thread(target=self._write, args=(process.stdin,), daemon=True)
        self._reader = threading.Thread(target=self._read, args=(process.stdout,), daemon=True)
        self._writer.start()
        self._reader.start()

    def close(self) -> None:
        """The page is gone a moment later."""
        self._ended.set()
        self._writer.join(timeout=1.0)
        self._process.kill()
        self._process.wait()

    def _write(self, page: IO[bytes]) -> None:
        while not self._ended.wait(PERIOD):
            try:
                self._send(page, self.moment())
            except OSError:
                return  # the reader has heard why

    def _send(self, page: IO[bytes], what: Any) -> None:
        pickle.dump(what, page, protocol=pickle.HIGHEST_PROTOCOL)
        page.flush()

    def _opened(self, page: IO[bytes]) -> str:
        """Where it is, once it is there.

        Raises:
            InputError: it is not.
        """
        message = _message(page.readline())
        if "url" not in message:
            self._process.kill()
            raise InputError(
                f"--view: the page could not be opened: {message.get('error', 'its process ended')}"
            )
        return str(message["url"])

    def _read(self, page: IO[bytes]) -> None:
        why = "its process ended"
        for line in page:
            message = _message(line)
            why = message.get("error", why)
            for wish in get_args(Wish):
                if wish == message.get("wish"):
                    self._requests.ask(wish, message.get("text", "")[:LONGEST_NOTE])
        if not self._ended.is_set():
            self._say(f"view: the page is gone: {why}; the run goes on")


def setup_of(estimator: Estimator, folder: Path, host: str, port: int, say: Say) -> Setup:
    """What the page needs to know before anything is read."""
    model = estimator.model
    parts, note = parts_of(model, folder)
    if note:
        say(f"view: {note}")
    eq = estimator.free()
    if not eq.ok:
        raise InputError("--view: the free probe has no equilibrium under its own weight")
    tube = Tube(model.rod.s, model.rod.radius, model.cross_section.flatness)
    free = Shape(eq.s, eq.p_base, eq.R_base)
    return Setup(
        f"{model.name} {model.fingerprint}", host, port, tube, free, tuple(parts), model.gravity_base, note
    )


def _start() -> "subprocess.Popen[bytes]":
    """A process that neither Ctrl-C nor a closing terminal reaches: it ends when its input does."""
    here = str(Path(__file__).parents[3])
    paths = os.pathsep.join(filter(None, [here, os.environ.get("PYTHONPATH", "")]))
    return subprocess.Popen(
        [sys.executable, "-P", "-m", "probedesign.live.view"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env=os.environ | {"PYTHONPATH": paths},
        start_new_session=True,
    )


def _message(line: bytes) -> dict[str, Any]:
    try:
        message = json.loads(line)
    except ValueError:
        message = None
    return message if isinstance(message, dict) else {}


def _check(host: str, port: int) -> None:
    """Whether an address of this machine is meant; what else is wrong viser would not tell.

    Raises:
        InputError: it is not.
    """
    if not 0 < port < 65536:
        raise InputError(f"--view-port {port} must be in 1 ... 65535")
    try:
        found = socket.getaddrinfo(host, 0, type=socket.SOCK_STREAM)[0]
        with socket.socket(*found[:3]) as trial:
            trial.bind(found[4])
    except (OSError, UnicodeError) as error:
        told = getattr(error, "strerror", None) or error
        raise InputError(f"--view-host {host}: {told}; say an address of this machine") from None
