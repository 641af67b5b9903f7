"""A simulated Net F/T box: transducer, page over HTTP, records over UDP; and the motion of its base."""

import json
import math
import select
import socket
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from functools import cached_property
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from time import monotonic
from urllib.parse import urlsplit
from xml.sax.saxutils import escape

import numpy as np
from numpy.typing import NDArray

from probedesign.core.errors import InputError
from probedesign.core.frames import Array, pose, rotation_under_gravity
from probedesign.core.units import MM
from probedesign.estimation.model import ProbeModel
from probedesign.live.poses.base_poses import pose_from_matrix
from probedesign.live.sources import netft_rdt as rdt
from probedesign.live.sources.netft_configuration import TAGS, NetFTConfiguration
from probedesign.live.sources.netft_rdt import (
    PAGE,
    RECORDS,
    SAMPLES_PER_SECOND,
    SATURATED,
    SUMMARY,
    Request,
    parse_request,
)
from probedesign.simulation.scenes import PressedObject


def configuration_page(configuration: NetFTConfiguration) -> bytes:
    """Return the page `netftapi2.xml` of a configuration."""

    def text(value: object) -> str:
        if isinstance(value, tuple):
            return ";".join(map(text, value))
        return f"{value:.9g}" if isinstance(value, float) else str(value)

    lines = ['<?xml version="1.0" encoding="UTF-8"?>', "<netft>"]
    for name in (f.name for f in fields(configuration)):
        lines.append(f"<{TAGS[name]}>{escape(text(getattr(configuration, name)))}</{TAGS[name]}>")
    return "\n".join([*lines, "</netft>", ""]).encode()


def _page_server(address: tuple[str, int], page: Callable[[], bytes]) -> ThreadingHTTPServer:
    """Return a server of what `page` returns."""

    class Handler(BaseHTTPRequestHandler):
        timeout = 5.0  # of a client that sends nothing

        def do_GET(self) -> None:
            known = self.path.partition("?")[0] == PAGE
            body = page() if known else b""
            self.send_response(200 if known else 404)
            self.send_header("Content-Type", "text/xml")
            self.send_header("Content-Length", str(len(body)))
            self.send_header("Connection", "close")
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, format: str, *args: object) -> None: ...

    server = ThreadingHTTPServer(address, Handler)
    server.daemon_threads, server.block_on_close = True, False
    return server


# the transducer

Load = Callable[[Array], Array]  #: Returns the wrench in the sensor frame [N, N·m], (n, 6), at times [s], (n,).

#: Reading of the unloaded transducer [N, N·m]: assumed; in reality caused by mounting stress.
OFFSET = (0.3, -0.2, 0.5, 0.002, -0.003, 0.001)
#: Random walk of each channel, in units of the noise of one sample per √s: 0.2 after 10 s, assumed.
DRIFT = 0.2 / math.sqrt(10.0)
MAX_COUNTS = 2**31 - 1


class SimulatedTransducer:
    """Simulates the samples of the box: noise and range of the model's sensor, and a walk of its zero."""

    def __init__(self, model: ProbeModel, load: Load, seed: int, drift: float = DRIFT) -> None:
        self._load = load
        self._random = np.random.default_rng(seed)
        self._noise, self._drift = model.noise.std * math.sqrt(model.averaging_samples), drift
        self._range = model.wrench_range
        self._last = self._zero = np.array(OFFSET)
        self._bias = np.zeros(6)

    def read(self, time: Array, configuration: NetFTConfiguration) -> tuple[Array, NDArray[np.int64]]:
        """Return counts (n, 6) and status words (n,) of successive samples at times [s], (n,)."""
        walk = self._random.normal(0.0, self._drift * math.sqrt(len(time) / SAMPLES_PER_SECOND), 6)
        self._zero = self._zero + self._noise * walk
        wrench = self._load(time) + self._zero + self._noise * self._random.standard_normal((len(time), 6))
        over = (np.abs(wrench) > self._range).any(axis=1)
        wrench = np.clip(wrench, -self._range, self._range)
        self._last = wrench.mean(axis=0)
        counts = np.rint((wrench - self._bias) @ np.linalg.inv(configuration.to_sensor).T)
        return np.clip(counts, -MAX_COUNTS, MAX_COUNTS), np.where(over, SUMMARY | SATURATED, 0)

    def bias(self) -> tuple[float, ...]:
        """Store the current wrench as the software bias.

        Returns:
            The bias as shown on the page: six integers, here in ten-thousandths of the range.
        """
        self._bias = self._last
        return tuple(float(v) for v in np.rint(1e4 * self._bias / self._range))


# the box

TICK = 0.001  #: Interval between bursts of records [s], the resolution of Python's sleep.
MAX_BACKLOG = SAMPLES_PER_SECOND  #: Maximum number of samples sent late; what a suspended process did not send is lost.
#: Samples since power-up at the start of the program: a box that has been on for two minutes.
INITIAL_SAMPLES = 1_000_000

#: Configuration of a Nano17: torque in N·mm.
NATIVE = NetFTConfiguration("Net F/T (simulated by probedesign)", "N", "N-mm", 1e6, 1e6)


class SimulatedNetFT:
    """A simulated Net F/T box. Use it as a context manager; inside, it listens."""

    def __init__(
        self,
        transducer: SimulatedTransducer,
        configuration: NetFTConfiguration = NATIVE,
        *,
        host: str = "127.0.0.1",
        port: int = 0,
        http_port: int = 0,
        initial_samples: int = INITIAL_SAMPLES,
    ) -> None:
        """Bind both ports; requests are served when the context is entered.

        Args:
            transducer: source of the samples.
            configuration: configuration of the box.
            host: address to listen on.
            port: RDT port; 0 lets the system choose.
            http_port: port of the page; 0 lets the system choose.
            initial_samples: samples counted since power-up.

        Raises:
            InputError: a port is in use, or the address does not belong to this machine.
        """
        self.configuration = configuration  #: Active configuration.
        self.client: tuple[str, int] | None = None  #: Receiver of the records; None before a request.
        self._transducer = transducer
        self._udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        option, number = "--port", port
        try:
            self._udp.bind((host, port))
            option, number = "--http-port", http_port
            self._http = _page_server((host, http_port), self._page)
        except (OSError, OverflowError) as error:
            self._udp.close()
            why = getattr(error, "strerror", None) or str(error)
            raise InputError(f"{host}:{number}: {why}; use another {option}, or an address of this machine") from None
        self.address: tuple[str, int] = self._udp.getsockname()[:2]
        self.http_port = int(self._http.server_address[1])
        self._lock = threading.RLock()
        self._ended = threading.Event()
        self._zero = monotonic() - initial_samples / SAMPLES_PER_SECOND
        self._motion_start: float | None = None
        self._request, self._next, self._rdt = Request(rdt.STOP), 0, 0

    @property
    def source(self) -> str:
        """Specification for `live --source`."""
        host, port = self.address
        return f"netft://{host}:{port}?http={self.http_port}"

    @property
    def motion_time(self) -> float:
        """Time since the base started to move [s]: since the first request."""
        return monotonic() - self._motion_start if self._motion_start is not None else 0.0

    def __enter__(self) -> "SimulatedNetFT":
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

    def _page(self) -> bytes:
        return configuration_page(self.configuration)

    def _serve(self) -> None:
        while not self._ended.is_set():
            ready, _, _ = select.select([self._udp], [], [], TICK if self.client else 0.02)
            with self._lock:
                if ready:
                    self._receive()
                if self.client is not None:
                    self._stream()

    def _receive(self) -> None:
        try:
            datagram, address = self._udp.recvfrom(65536)
        except OSError:  # the system may report a closed client here
            return
        request = parse_request(datagram)
        if request is None:
            return
        match request.command:
            case rdt.REALTIME | rdt.BUFFERED:
                self.client, self._request = address, request
                self._rdt, self._next = 0, self._samples()
                self._motion_start = self._motion_start or monotonic()
            case rdt.STOP:
                self.client = None
            case rdt.BIAS:
                self.configuration = replace(self.configuration, bias=self._transducer.bias())

    def _stream(self) -> None:
        now = self._samples()
        self._next = max(self._next, now - MAX_BACKLOG)
        due = now - self._next
        if self._request.records:
            due = min(due, self._request.records - self._rdt)
        if due <= 0:
            return
        records = self._records(self._next + np.arange(due)).tobytes()
        self._next += due
        self._send([records[i : i + RECORDS.itemsize] for i in range(0, len(records), RECORDS.itemsize)])
        if self._request.records and self._rdt >= self._request.records:
            self.client = None

    def _send(self, packets: list[bytes]) -> None:
        for packet in packets:
            with suppress(OSError):  # lost with full buffers or closed clients, as on a wire
                self._udp.sendto(packet, self.client)  # type: ignore[arg-type]  # `_serve` streams to a client only

    def _records(self, samples: NDArray[np.int64]) -> NDArray[np.void]:
        start = self._motion_start - self._zero if self._motion_start else 0.0
        time = np.maximum(samples / SAMPLES_PER_SECOND - start, 0.0)
        records = np.empty(len(samples), dtype=RECORDS)
        records["rdt"] = (self._rdt + 1 + np.arange(len(samples))) % 2**32
        records["ft"] = samples % 2**32
        records["counts"], records["status"] = self._transducer.read(time, self.configuration)
        self._rdt += len(samples)
        return records

    def _samples(self) -> int:
        return int((monotonic() - self._zero) * SAMPLES_PER_SECOND)


# cyclic motion of its base

REST_TIME = 5.0  #: Free time at the start of a cycle [s], for a tare.
#: Durations of the move to the next object, of the press and of the retraction, and of the dwell [s].
MOVE_TIME, PRESS_TIME, CYCLE_DWELL_TIME = 1.0, 1.5, 3.0


@dataclass(frozen=True)
class BaseMotion:
    """Cyclic motion of the base: rest, then press, hold and retract for each object."""

    model: ProbeModel  #: the probe.
    objects: tuple[PressedObject, ...]  #: objects in the order in which they are pressed.

    @property
    def cycle_time(self) -> float:
        """Duration of a cycle [s]."""
        return REST_TIME + len(self.objects) * self._object_time

    @property
    def _object_time(self) -> float:
        return MOVE_TIME + 2.0 * PRESS_TIME + CYCLE_DWELL_TIME

    def wrench_sensor(self, time: Array) -> Array:
        """Return the wrench at the sensor without bias and noise [N, N·m], (n, 6), at times [s], (n,)."""
        index, travel, retracting = self._at(time)
        wrench = np.tile(self._free, (len(time), 1))
        for i in np.unique(index[index >= 0]):
            obj = self.objects[i]
            on, off = (index == i) & ~retracting, (index == i) & retracting
            wrench[on] = _interpolated(travel[on], obj.travel, obj.wrench_base)
            wrench[off] = _interpolated(travel[off], obj.travel_back, obj.wrench_back)
        return self.model.to_sensor(wrench, self.model.gravity_base)

    def p_world_base(self, time: Array) -> Array:
        """Return the position of the base [m], (n, 3), in a world that coincides with the base at rest.

        The objects are fixed in that world.
        """
        index, travel, _ = self._at(time)
        p = np.zeros((len(time), 3))
        for i in np.unique(index[index >= 0]):
            here = index == i
            p[here] = travel[here, None] * self.objects[i].direction
        return p

    def _at(self, time: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Return the index of the object, -1 for none, the travel towards it [m], and whether the base retracts."""
        since = np.mod(time, self.cycle_time) - REST_TIME
        index = np.floor(since / self._object_time).astype(int)
        index = np.where(since < 0.0, -1, np.minimum(index, len(self.objects) - 1))
        phase = since - index * self._object_time
        knots = np.cumsum([0.0, MOVE_TIME, PRESS_TIME, CYCLE_DWELL_TIME, PRESS_TIME])
        fraction = np.interp(phase, knots, [0.0, 0.0, 1.0, 1.0, 0.0])
        ends = np.array([obj.travel[-1] for obj in self.objects] + [0.0])  # index -1 selects the last entry
        return index, fraction * ends[index], phase > MOVE_TIME + PRESS_TIME + CYCLE_DWELL_TIME

    @cached_property
    def _free(self) -> Array:
        return self.model.rod.solve(self.model.gravity_base, mode="reference").wrench_base


def _interpolated(at: Array, knots: Array, values: Array) -> Array:
    return np.stack([np.interp(at, knots, column) for column in values.T], axis=-1)


# poses sent by UDP

POSE_PERIOD = 0.008  #: Interval between poses [s], as of a robot controller.


class SimulatedRobot:
    """Sends the pose of the base in a world whose z axis points up. Use it as a context manager."""

    def __init__(self, motion: BaseMotion, motion_time: Callable[[], float], target: str) -> None:
        """Resolve the receiver, HOST:PORT; `motion_time` returns the time since the motion started [s].

        Raises:
            InputError: this is not an address.
        """
        self._motion, self._motion_time = motion, motion_time
        try:
            parts = urlsplit(f"//{target}")
            self._target = (socket.gethostbyname(parts.hostname) if parts.hostname else "", parts.port or 0)
        except (ValueError, OSError):
            self._target = ("", 0)
        if not all(self._target):
            raise InputError(f"--pose-to {target} must be HOST:PORT, as 127.0.0.1:30010")
        self._R = rotation_under_gravity(motion.model.gravity_base)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._send, name="robot", daemon=True)

    def __enter__(self) -> "SimulatedRobot":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()

    def datagram(self, time: float, motion_time: float) -> bytes:
        """Return the datagram at a time by the robot's clock [s], `motion_time` after the motion started [s]."""
        p = self._R @ self._motion.p_world_base(np.array([motion_time]))[0]
        q = pose_from_matrix(time, pose(self._R)).q
        fields = zip(("time_s", "x_mm", "y_mm", "z_mm", "qx", "qy", "qz", "qw"), (time, *p / MM, *q), strict=True)
        return json.dumps({"frame": "world", **{name: float(value) for name, value in fields}}).encode()

    def _send(self) -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
            while not self._ended.wait(POSE_PERIOD):
                with suppress(OSError):  # there is no listener
                    udp.sendto(self.datagram(monotonic(), self._motion_time()), self._target)
