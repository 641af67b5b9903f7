"""`netft://HOST[:PORT]`: a Net F/T box, read as it streams, through pynetft."""

from collections import Counter
from collections.abc import Callable, Generator
from contextlib import closing
from time import monotonic
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

import numpy as np

from probedesign.errors import InputError, MissingDependencyError
from probedesign.estimator.model import ProbeModel
from probedesign.live.netft.clock import SensorClock
from probedesign.live.netft.configuration import Configuration
from probedesign.live.netft.page import Watch, fetch_configuration
from probedesign.live.netft.status import fault_of
from probedesign.live.netft.wire import HTTP_PORT, RDT_PORT
from probedesign.live.reading import Reading
from probedesign.live.spec import Parameter, parse_parameters

if TYPE_CHECKING:
    from pynetft import Client, Sample

PARAMETERS = {
    "http": Parameter(HTTP_PORT, 1, 65535, whole=True),
    "check_s": Parameter(2.0, 0.1, 3600.0),
}

QUEUE = 1 << 16
"""Records that wait for us at most: nine seconds."""
STALE = 0.050
"""Without a record for so long, what was last estimated is old [s]."""
RENEWED = 0.5
"""Records that come and are all refused, as after a restart, get a new client after so long [s]."""
FIRST = 3.0
"""The first record must be there within [s]."""
TOLD = (0.0, 2.0, 10.0, 60.0, 600.0)
"""After so much silence a line is said again [s]."""
OFTEN, LATELY = 4, 10.0
"""So many interruptions within this time [s] look like another client."""


class NetFT:
    """A box at an address.

    Attributes:
        title: one line that says what it is.
        notes: what the box says of itself.
        counts: records so far: received, lost, late, doubled, malformed, with a fault, dropped by the queue;
            interruptions and restarts.
    """

    def __init__(self, model: ProbeModel, place: str, query: str, say: Callable[[str], None]) -> None:
        """Ask the box for its configuration; nothing streams yet.

        Args:
            model: the probe on the sensor.
            place: `//HOST` or `//HOST:PORT`.
            query: parameters, as `PARAMETERS` has them.
            say: takes what happens.

        Raises:
            InputError: the address or a parameter is wrong, or no box answers there.
            MissingDependencyError: pynetft is not installed.
        """
        self._host, self._port = _address(place)
        said = parse_parameters("netft:", query, PARAMETERS)
        self._http, self._check = int(said["http"]), said["check_s"]
        _client(self._host, self._port)  # what is missing is told before anything is asked
        self._model, self._say = model, say
        self.configuration: Configuration = fetch_configuration(self._host, self._http)
        self._name = f"netft://{self._host}:{self._port}"
        self.title = f"{self._name}, {self.configuration.product}"
        self.notes = self.configuration.notes + _other_sensor(self.configuration, model)
        self.counts: Counter[str] = Counter()

    def __iter__(self) -> Generator[Reading, None, None]:
        return self._readings()

    def _readings(self) -> Generator[Reading, None, None]:
        clock, outage = SensorClock(), _Outage(self._name, self._say)
        stretch, last = 0, -np.inf
        with (
            Watch(self._host, self._http, self.configuration, self._check) as watch,
            closing(self._samples()) as samples,
        ):
            for sample in samples:
                self._refuse(watch)
                if sample is None:
                    outage.silent(not np.isfinite(last))
                    continue
                received = sample.received_at_ns * 1e-9
                if outage.since or received - last > STALE:
                    if (
                        not watch.look()
                    ):  # another box, or the same set up anew, must not be taken for the first
                        outage.silent(False)
                        continue
                    self._refuse(watch)
                    stretch += np.isfinite(last)
                    self.counts["interruptions"] = stretch
                restarts = clock.restarts
                time = clock.time(sample.ft_sequence, received)
                if time is None:
                    continue
                outage.over(received - last)
                if clock.restarts > restarts:
                    self.counts["restarts"] += 1
                    self._say(
                        f"{self._name}: its clock started again; the tare from before is kept, take it anew"
                    )
                last = received
                yield self._reading(sample, time, stretch, received)

    def _reading(self, sample: "Sample", time: float, stretch: int, received: float) -> Reading:
        wrench = self.configuration.to_sensor @ np.array(sample.raw_wrench, dtype=float)
        fault = fault_of(sample.status) if sample.status else ""
        if fault:
            self.counts["faults"] += 1
            if self.counts["faults"] == 1:
                self._say(f"{self._name}: {fault}")
        return Reading(time, wrench, self._model.gravity_base, None, fault, stretch, received)

    def _refuse(self, watch: Watch) -> None:
        """End where the box is not what it was.

        Raises:
            InputError: its configuration has changed.
        """
        if watch.changed:
            told = ", ".join(watch.changed)
            raise InputError(
                f"{self._name}: its configuration has changed ({told}); what was read in the last "
                f"{self._check:g} s may be wrong; start again, with a new tare"
            )

    def _samples(self) -> Generator["Sample | None", None, None]:
        """Records as they come; None after each `STALE` without one."""
        client, renewed = self._open(), monotonic()
        received = 0
        try:
            while True:
                quiet = False
                try:
                    yield from client.samples(timeout=STALE)
                except TimeoutError:
                    quiet = True
                if not quiet:
                    raise InputError(f"{self._name}: pynetft has ended: {client.health().last_error}")
                yield None
                heard = client.health().received_count
                if heard > received and monotonic() - renewed > RENEWED:
                    self._close(client)
                    client, renewed, heard = self._open(), monotonic(), 0
                received = heard
        finally:
            self._close(client)
            self._say(f"{self._name}: {self._summary()}")

    def _open(self) -> "Client":
        client = _client(self._host, self._port)
        client.start()
        return client

    def _close(self, client: "Client") -> None:
        """Stop it, and count what it counted."""
        client.stop()
        health = client.health()
        self.counts.update(
            received=health.received_count,
            lost=health.lost_count - health.out_of_order_count,
            late=health.out_of_order_count,
            doubled=health.duplicate_count,
            malformed=health.malformed_count,
            dropped=health.python_queue_dropped_count,
        )

    def _summary(self) -> str:
        """The counts that are not zero, in one line."""
        told = {
            "lost": "lost on the way", "late": "late and left out", "doubled": "doubled", "malformed": "malformed",
            "faults": "with a fault", "dropped": "dropped because we lagged",
        }  # fmt: skip
        parts = [f"{self.counts[name]} {words}" for name, words in told.items() if self.counts[name]]
        parts += [
            f"{self.counts[name]} {name}" for name in ("interruptions", "restarts") if self.counts[name]
        ]
        return f"{self.counts['received']} records" + (", " + ", ".join(parts) if parts else ", none lost")


class _Outage:
    """Silence of the box, and what is said of it."""

    def __init__(self, name: str, say: Callable[[str], None]) -> None:
        self.since = 0.0
        self._name, self._say = name, say
        self._told = 0
        self._recent: list[float] = []
        self._opened = monotonic()

    def silent(self, never: bool) -> None:
        """There was no record for `STALE`, or none that may be taken; `never` if there was none at all.

        Raises:
            InputError: the box has never sent one.
        """
        now = monotonic()
        if never and now - self._opened > FIRST:
            raise InputError(
                f"{self._name}: the box answers HTTP but sends no record; is a firewall between, or the port another?"
            )
        if never:
            return
        if not self.since:
            self.since, self._told = now, 0
            self._recent = [t for t in self._recent if now - t < LATELY] + [now]
        if self._told < len(TOLD) and now - self.since >= TOLD[self._told]:
            self._told += 1
            self._say(f"{self._name}: stale, no record for {now - self.since + STALE:.2g} s; {self._guess()}")

    def over(self, silence: float) -> None:
        """Records come again, after so long [s]."""
        if self.since:
            self._say(f"{self._name}: records again after {silence:.2g} s; the tare is kept")
            self.since = 0.0

    def _guess(self) -> str:
        if len(self._recent) >= OFTEN:
            return f"{len(self._recent)} times within {LATELY:g} s: does another client take the stream?"
        return "asking again"


def _client(host: str, port: int) -> "Client":
    """A client that knows no units: the counts are ours to convert, since it knows no tool transform."""
    try:
        from pynetft import Calibration, Client, Config, ForceUnit, TorqueUnit
    except ImportError:
        raise MissingDependencyError("netft:// needs pynetft; install probedesign[live]") from None
    counts = Calibration(1.0, 1.0, ForceUnit.NEWTON, TorqueUnit.NEWTON_METER)
    config = Config(
        sensor_host=host,
        rdt_port=port,
        receive_timeout=2.0 * STALE,
        reconnect_initial_delay=0.1,
        reconnect_max_delay=0.5,
        deliver_samples_with_error_status=True,
        calibration_override=counts,
    )
    return Client(config, queue_size=QUEUE)


def _other_sensor(configuration: Configuration, model: ProbeModel) -> tuple[str, ...]:
    """A note if the box reaches further or less far than the probe's sensor."""
    if len(configuration.ranges) != 6:
        return ()
    reach = np.array(configuration.ranges) * configuration.scale * configuration.counts_of_unit
    if np.allclose(reach, model.wrench_range, rtol=0.01):
        return ()
    told = ", ".join(f"{value:g}" for value in configuration.ranges)
    return (f"the box's sensor reaches {told}, not what the frozen probe's does: is it another calibration?",)


def _address(place: str) -> tuple[str, int]:
    """Host and port of `//HOST[:PORT]`."""
    try:
        parts = urlsplit(place)
        host, port = parts.hostname or "", parts.port if parts.port is not None else RDT_PORT
    except ValueError:
        host, port = "", 0
    bare = place.startswith("//") and not (parts.path.strip("/") or parts.username or parts.fragment)
    if not host or not port or not bare:
        raise InputError(f"netft:{place}: write netft://HOST or netft://HOST:PORT")
    return host, port
