"""Sinks of `live` that show the run: on a page that another process serves, or as a table on the terminal."""

import json
import math
import os
import pickle
import secrets
import socket
import subprocess
import sys
import threading
import webbrowser
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, get_args
from urllib.parse import urlsplit

import numpy as np

from probedesign.core.errors import InputError, require
from probedesign.estimation.estimator import Estimator
from probedesign.geometry.tube import BentShape, TubeMesh
from probedesign.live import Log
from probedesign.live.processing.commands import MAX_NOTE, CommandName, CommandQueue
from probedesign.live.view.state import Level, PageSetup, RunView, SceneSetup, Snapshot, ViewState
from probedesign.web import LOOPBACK
from probedesign.web.scene import rigid_parts

if TYPE_CHECKING:
    from rich.console import Console, Group
    from rich.table import Table


PERIOD = 1.0 / 30.0  #: Minimum interval between two frames [s].
TOKEN_BYTES = 24  #: Random bytes of the token of a page that is open to the network: 192 bits.


class BrowserView(RunView):
    """The page of a run, open until `close`.

    It never blocks the run: a thread sends snapshots at most 30 times per second, and fewer if the page is slow.

    Attributes:
        url: address of the page.
    """

    def __init__(
        self,
        states: Mapping[str, ViewState],
        probes: Sequence[tuple[Estimator, Path]],
        commands: CommandQueue,
        log: Log,
        host: str = "127.0.0.1",
        port: int = 8080,
        *,
        open_browser: bool = False,
        limits: tuple[float, float] = (math.inf, math.inf),
        guided: bool = False,
    ) -> None:
        """Open the page at `port` of `host`, or at the first free port after it.

        `probes` are the estimators with the folders of exported parts, `limits` the force and the moment at which a
        guard stops [N, N·m]; `guided` is as that of `PageSetup`.

        Raises:
            InputError: the address cannot be used.
            MissingDependencyError: viser is not installed.
        """
        require("viser", "--view", "view")
        if not 0 < port < 65536:
            raise InputError(f"--view-port {port} must be in 1 ... 65535")
        try:  # viser reports a port in use only
            address = socket.getaddrinfo(host, 0, type=socket.SOCK_STREAM)[0]
            with socket.socket(*address[:3]) as trial:
                trial.bind(address[4])
        except (OSError, UnicodeError) as error:
            reason = getattr(error, "strerror", None) or error
            raise InputError(f"--view-host {host}: {reason}; use an address of this machine") from None
        self._commands, self._log = commands, log
        super().__init__(states)
        self._ended = threading.Event()
        paths = os.pathsep.join(filter(None, [str(Path(__file__).parents[3]), os.environ.get("PYTHONPATH", "")]))
        # neither Ctrl-C nor a closing terminal ends it, only the end of its input
        self._process = process = subprocess.Popen(
            [sys.executable, "-P", "-m", "probedesign.live.view.page"], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            env=os.environ | {"PYTHONPATH": paths}, start_new_session=True,
        )  # fmt: skip
        assert process.stdin is not None and process.stdout is not None
        token = "" if host in LOOPBACK else secrets.token_urlsafe(TOKEN_BYTES)
        with suppress(BrokenPipeError):  # the next line reports the reason
            scenes = tuple(scene_setup(estimator, folder, log, limits) for estimator, folder in probes)
            self._send(process.stdin, PageSetup(host, port, scenes, token, guided))
        message = _parse_message(process.stdout.readline())
        if "url" not in message:
            process.kill()
            why = message.get("error", "its process ended")
            raise InputError(f"--view: the page could not be opened: {why}")
        self.url = str(message["url"])
        if token:  # not to the log, which recordings and the network receive
            parts = urlsplit(self.url)
            everywhere = parts.hostname in ("0.0.0.0", "::")
            named = f"http://{socket.gethostname()}:{parts.port}" if everywhere else self.url
            print(f"view: open {named}/?token={token}", file=sys.stderr, flush=True)
        log(f"view: {self.url}, open to {'the network, with its token' if token else 'this machine only'}")
        if open_browser and not webbrowser.open(f"{self.url}/?token={token}" if token else self.url):
            log("view: no browser was found; open the address by hand")
        self._writer = threading.Thread(target=self._write, args=(process.stdin,), daemon=True)
        self._writer.start()
        threading.Thread(target=self._read, args=(process.stdout,), daemon=True).start()

    def close(self) -> None:
        """Close the page."""
        self._ended.set()
        self._writer.join(timeout=1.0)
        self._process.kill()
        self._process.wait()

    def _write(self, page: IO[bytes]) -> None:
        while not self._ended.wait(PERIOD):
            try:
                self._send(page, self.snapshots())
            except OSError:
                return  # the reader reports the reason

    def _send(self, page: IO[bytes], what: Any) -> None:
        pickle.dump(what, page, protocol=pickle.HIGHEST_PROTOCOL)
        page.flush()

    def _read(self, page: IO[bytes]) -> None:
        why = "its process ended"
        for line in page:
            message = _parse_message(line)
            why = message.get("error", why)
            for name in get_args(CommandName):
                if name == message.get("command"):
                    self._commands.put(name, "force" if name == "tare" else message.get("text", "")[:MAX_NOTE])
        if not self._ended.is_set():
            self._log(f"view: the page has closed: {why}; the run continues")


def scene_setup(
    estimator: Estimator, folder: Path, log: Log, limits: tuple[float, float] = (math.inf, math.inf)
) -> SceneSetup:
    """Return the static content of the page for a probe, with the exported parts of a folder and the guard's limits."""
    model = estimator.model
    parts, note = rigid_parts(model, folder)
    if note:
        log(f"view: {note}")
    eq = estimator.free()
    if not eq.ok:
        raise InputError("--view: the free probe has no equilibrium under its own weight")
    tube = TubeMesh(model.rod.s, model.rod.radius, model.cross_section.flatness)
    free = BentShape(eq.s, eq.p_base, eq.R_base)
    force, moment = (float(np.min(model.wrench_range[channels])) for channels in (slice(3), slice(3, 6)))
    drawn = (force, min(moment, limits[1]), min(force, limits[0]))
    return SceneSetup(f"{model.name} {model.fingerprint}", tube, free, tuple(parts), model.gravity_base, drawn, note)


def _parse_message(line: bytes) -> dict[str, Any]:
    try:
        message = json.loads(line)
    except ValueError:
        message = None
    return message if isinstance(message, dict) else {}


REFRESH_RATE = 8
STYLES: dict[Level, str] = {"good": "bold green", "fair": "yellow", "bad": "bold red", "plain": ""}


class TerminalView(RunView):
    """Sink that shows a live table at the bottom of a terminal until it is closed."""

    def __init__(
        self, states: Mapping[str, ViewState], titles: Sequence[str], console: "Console | None" = None
    ) -> None:
        from rich.live import Live

        super().__init__(states)
        self._titles = titles
        self._live = Live(console=console, get_renderable=self._tables, refresh_per_second=REFRESH_RATE)
        self._live.start()

    def close(self) -> None:
        """Stop updating; the last table remains and the cursor is restored."""
        self._live.stop()

    def _tables(self) -> "Group":
        from rich.console import Group

        return Group(*map(table_of, self._titles, self.snapshots(shaped=False)))


def table_of(title: str, snapshot: Snapshot) -> "Table":
    """Return the status lines in two columns."""
    from rich.table import Table
    from rich.text import Text

    table = Table(title=f"{title}, {snapshot.time:.1f} s", title_justify="left", show_header=False, box=None)
    for line in snapshot.status:
        table.add_row(Text(line.name, style="dim"), Text(line.text, style=STYLES[line.level]))
    return table
