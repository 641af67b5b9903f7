"""The box's page `netftapi2.xml` over HTTP."""

import re
import select
import socket
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, fields, replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from time import monotonic
from xml.sax.saxutils import escape

import numpy as np
from numpy.typing import NDArray

from probedesign.errors import InputError
from probedesign.live.netft_box.transducer import Transducer
from probedesign.live.sources.netft import wire
from probedesign.live.sources.netft.configuration import TAGS, Configuration
from probedesign.live.sources.netft.wire import PAGE, RECORDS, SAMPLES_PER_SECOND, Request, parse_request


def page_of(configuration: Configuration) -> bytes:
    """The page that tells a configuration."""
    lines = ['<?xml version="1.0" encoding="UTF-8"?>', "<netft>"]
    for name in (f.name for f in fields(configuration)):
        lines.append(f"<{TAGS[name]}>{escape(_page_text(getattr(configuration, name)))}</{TAGS[name]}>")
    return "\n".join([*lines, "</netft>", ""]).encode()


def _page_text(value: object) -> str:
    if isinstance(value, tuple):
        return ";".join(f"{v:.9g}" for v in value)
    return f"{value:.9g}" if isinstance(value, float) else str(value)


class PageServer(ThreadingHTTPServer):
    """Serves the page as long as there is one."""

    daemon_threads = True
    block_on_close = False

    def __init__(self, address: tuple[str, int], page: Callable[[], bytes | None]) -> None:
        """Listen.

        Args:
            address: host and port; port 0 lets the system choose.
            page: what to serve; None answers nothing, as a box does that is off.
        """
        self.page = page
        super().__init__(address, _PageHandler)


class _PageHandler(BaseHTTPRequestHandler):
    server: PageServer
    timeout = 5.0  # of a client that says nothing

    def do_GET(self) -> None:
        page = self.server.page()
        if page is None:
            self.close_connection = True
            return
        found = self.path.partition("?")[0] == PAGE
        body = page if found else b""
        self.send_response(200 if found else 404)
        self.send_header("Content-Type", "text/xml")
        self.send_header("Content-Length", str(len(body)))
        self.send_header("Connection", "close")
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *args: object) -> None:
        """Nothing is told of what clients ask."""


FAULT_EVENTS = ("stall", "restart", "stolen", "units", "saturate")
"""What can happen to the box, for a second or for good; `units`: somebody chooses another configuration."""


@dataclass
class Faults:
    """Parts of all packets that each fault befalls, and events at their times.

    Attributes:
        loss: never sent.
        reorder: sent after the one that follows.
        duplicate: sent twice.
        garbage: preceded by a datagram of random length and content, never as long as a record.
        short: cut.
        events: (time since the stream began [s], one of `EVENTS`).
        seed: of the chance.
    """

    loss: float = 0.0
    reorder: float = 0.0
    duplicate: float = 0.0
    garbage: float = 0.0
    short: float = 0.0
    events: list[tuple[float, str]] = field(default_factory=list)
    seed: int = 1
    _held: list[bytes] = field(default_factory=list, repr=False)

    def __post_init__(self) -> None:
        self._random = np.random.default_rng(self.seed)

    def through(self, packets: list[bytes]) -> list[bytes]:
        """The packets as they reach the wire, in order."""
        if not (self.loss or self.reorder or self.duplicate or self.garbage or self.short):
            return packets
        sent: list[bytes] = []
        for packet in packets:
            sent += self._befallen(packet)
        return sent

    def _befallen(self, packet: bytes) -> list[bytes]:
        loss, reorder, duplicate, garbage, short = self._random.random(5)
        if garbage < self.garbage:
            made_up = self._random.bytes(int(self._random.integers(0, 35)))
            return [made_up, packet]
        if loss < self.loss:
            return []
        if reorder < self.reorder and not self._held:
            self._held.append(packet)
            return []
        late, self._held = self._held, []
        if short < self.short:
            packet = packet[: int(self._random.integers(1, len(packet)))]
        return [packet] * (1 + (duplicate < self.duplicate)) + late


def parse_faults(texts: list[str], seed: int = 1) -> Faults:
    """Faults as the command line names them: `loss=0.01`, `restart@10`.

    Raises:
        InputError: one is unknown or its number is wrong.
    """
    rates = [f.name for f in fields(Faults) if f.type is float or f.type == "float"]
    said: dict[str, float] = {}
    events = []
    for text in texts:
        found = re.fullmatch(r"([a-z]+)([=@])(\d+\.?\d*|\.\d+)", text)
        name, sign, number = found.groups() if found else ("", "", "")
        if sign == "=" and name in rates and float(number) <= 1.0:
            said[name] = float(number)
        elif sign == "@" and name in FAULT_EVENTS:
            events.append((float(number), name))
        else:
            raise InputError(
                f"--fault {text!r} must be one of {', '.join(rates)} as loss=0.01, a part of all packets, "
                f"or one of {', '.join(FAULT_EVENTS)} as restart@10, seconds after the stream began"
            )
    return Faults(**said, events=sorted(events), seed=seed)  # type: ignore[arg-type]


TICK = 0.001
"""Records go out in bursts of so long [s], as good as Python sleeps."""
BEHIND = SAMPLES_PER_SECOND
"""Samples that are sent late at most; what a suspended process did not send is lost."""
POWERED = 1_000_000
"""Samples since power-up when the program starts: a box that has been on for two minutes."""
FAULT_DURATION = 1.0
"""How long a restart takes, and other faults last [s]; a real box takes some ten."""

NATIVE = Configuration(
    "Net F/T (simulated by probedesign)",
    "N",
    "N-mm",
    1e6,
    1e6,
    "Nano17",
    length_unit="mm",
    angle_unit="degrees",
)
"""A Nano17's own configuration: torque in N·mm."""


class Box:
    """A simulated Net F/T box. Use it as a context manager; inside, it listens.

    Attributes:
        configuration: the active one.
        client: where records go; None while nobody asked.
    """

    def __init__(
        self,
        transducer: Transducer,
        configuration: Configuration = NATIVE,
        *,
        host: str = "127.0.0.1",
        port: int = 0,
        http_port: int = 0,
        faults: Faults | None = None,
        powered: int = POWERED,
    ) -> None:
        """Bind both ports; nothing is answered before the box is entered.

        Args:
            transducer: what it reads.
            configuration: what it says of itself.
            host: address to listen on.
            port: of RDT; 0 lets the system choose.
            http_port: of the page; likewise.
            faults: what goes wrong.
            powered: samples counted since power-up.

        Raises:
            InputError: a port is in use, or the address is not this machine's.
        """
        self.configuration = configuration
        self.client: tuple[str, int] | None = None
        self._transducer, self._faults = transducer, faults or Faults()
        self._udp = _bound(host, port)
        self.address: tuple[str, int] = self._udp.getsockname()[:2]
        try:
            self._http = PageServer((host, http_port), self._page)
        except OSError as error:
            self._udp.close()
            raise InputError(_refused(host, http_port, error, "--http-port")) from None
        self.http_port = int(self._http.server_address[1])
        self._lock = threading.RLock()
        self._ended = threading.Event()
        self._zero = monotonic() - powered / SAMPLES_PER_SECOND
        self._off_until = self._stalled_until = 0.0
        self._frozen = 0
        self._moving: float | None = None
        self._request, self._next, self._rdt = Request(wire.STOP), 0, 0

    @property
    def source(self) -> str:
        """What `live --source` takes to read it."""
        host, port = self.address
        return f"netft://{host}:{port}?http={self.http_port}"

    @property
    def gone(self) -> float:
        """How long the base has been on its way [s]: since the first request."""
        return monotonic() - self._moving if self._moving is not None else 0.0

    def __enter__(self) -> "Box":
        self._threads = [
            threading.Thread(target=self._serve, name="box-rdt", daemon=True),
            threading.Thread(target=self._http.serve_forever, args=(0.05,), name="box-http", daemon=True),
        ]
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._http.shutdown()
        for thread in self._threads:
            thread.join()
        self._http.server_close()
        self._udp.close()

    # what can happen to it

    def restart(self, seconds: float = FAULT_DURATION) -> None:
        """Switch it off and on: it counts from one again, and forgets its client and its bias."""
        with self._lock:
            self.client = None
            self._transducer.unbias()
            self.configuration = replace(self.configuration, bias=(0.0,) * 6)
            self._off_until = monotonic() + seconds
            self._zero = self._off_until
            self._next = 0

    def stall(self, seconds: float = FAULT_DURATION) -> None:
        """Send the same sample again and again."""
        with self._lock:
            self._stalled_until, self._frozen = monotonic() + seconds, self._next - 1

    def steal(self) -> None:
        """Let another client take the stream."""
        with self._lock:
            self.client = None

    def configure(self, **changes: object) -> None:
        """Choose another configuration."""
        with self._lock:
            self.configuration = replace(self.configuration, **changes)  # type: ignore[arg-type]

    def saturate(self, on: bool = True) -> None:
        """Hold the transducer at its limit."""
        with self._lock:
            self._transducer.saturated = on

    def send(self, datagram: bytes) -> None:
        """Send the client anything at all."""
        with self._lock:
            if self.client is not None:
                self._udp.sendto(datagram, self.client)

    # how it serves

    def _page(self) -> bytes | None:
        with self._lock:
            return page_of(self.configuration) if monotonic() >= self._off_until else None

    def _serve(self) -> None:
        while not self._ended.is_set():
            ready, _, _ = select.select([self._udp], [], [], TICK if self.client else 0.02)
            with self._lock:
                if ready:
                    self._hear()
                if self.client is not None:
                    self._happen()
                    self._stream()

    def _hear(self) -> None:
        """Take one datagram."""
        try:
            datagram, address = self._udp.recvfrom(65536)
        except OSError:  # a client that went away may be reported here
            return
        request = parse_request(datagram)
        if request is None or monotonic() < self._off_until:
            return
        match request.command:
            case wire.REALTIME | wire.BUFFERED:
                self.client, self._request = address, request
                self._rdt, self._next = 0, self._samples()
                self._moving = self._moving or monotonic()
            case wire.STOP:
                self.client = None
            case wire.RESET_LATCH:
                self._transducer.latched = False
            case wire.BIAS:
                self._transducer.bias()
                self.configuration = replace(self.configuration, bias=self._transducer.gauges())

    def _stream(self) -> None:
        """Send all that is due."""
        spacing = max(1, round(SAMPLES_PER_SECOND / self.configuration.rate))
        now = self._samples()
        self._next = max(self._next, now - BEHIND)
        size = int(self.configuration.records) if self._request.command == wire.BUFFERED else 1
        due = (now - self._next) // spacing // size * size
        if self._request.records:
            due = min(due, self._request.records - self._rdt)
        if due <= 0:
            return
        records = self._records(self._next + spacing * np.arange(due), spacing).tobytes()
        self._next += spacing * due
        width = RECORDS.itemsize * size
        for packet in self._faults.through([records[i : i + width] for i in range(0, len(records), width)]):
            self._send_or_lose(packet)
        if self._request.records and self._rdt >= self._request.records:
            self.client = None

    def _send_or_lose(self, packet: bytes) -> None:
        with suppress(OSError):  # full buffers and vanished clients lose it, as on a wire
            if self.client is not None:
                self._udp.sendto(packet, self.client)

    def _records(self, samples: NDArray[np.int64], spacing: int) -> NDArray[np.void]:
        """The records of samples since power-up."""
        if monotonic() < self._stalled_until:
            samples = np.full(len(samples), self._frozen)
        start = self._moving - self._zero if self._moving else 0.0
        time = np.maximum(samples / SAMPLES_PER_SECOND - start, 0.0)
        counts, status = self._transducer.read(time, spacing / SAMPLES_PER_SECOND, self.configuration)
        records = np.empty(len(samples), dtype=RECORDS)
        records["rdt"] = (self._rdt + 1 + np.arange(len(samples))) % 2**32
        records["ft"] = samples % 2**32
        records["status"] = status
        records["counts"] = counts
        self._rdt += len(samples)
        return records

    def _samples(self) -> int:
        """Since power-up."""
        return int((monotonic() - self._zero) * SAMPLES_PER_SECOND)

    def _happen(self) -> None:
        """Let the events happen whose time has come."""
        while (
            self._faults.events and self._moving and monotonic() - self._moving >= self._faults.events[0][0]
        ):
            _, name = self._faults.events.pop(0)
            happen: dict[str, Callable[[], None]] = {
                "stall": self.stall,
                "restart": self.restart,
                "stolen": self.steal,
                "units": self._other_units,
                "saturate": self._saturate_awhile,
            }
            happen[name]()
            if self.client is None:
                return

    def _other_units(self) -> None:
        metre = self.configuration.torque_unit == "N-m"
        self.configure(torque_unit="N-mm" if metre else "N-m")

    def _saturate_awhile(self) -> None:
        self.saturate()
        timer = threading.Timer(FAULT_DURATION, self.saturate, [False])
        timer.daemon = True
        timer.start()


def _bound(host: str, port: int) -> socket.socket:
    """A UDP socket of that address."""
    udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        udp.bind((host, port))
    except (OSError, OverflowError) as error:
        udp.close()
        raise InputError(_refused(host, port, error, "--port")) from None
    return udp


def _refused(host: str, port: int, error: Exception, option: str) -> str:
    why = getattr(error, "strerror", None) or str(error)
    return f"{host}:{port}: {why}; say another {option}, or an address of this machine"
