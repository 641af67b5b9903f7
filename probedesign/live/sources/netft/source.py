"""`netft://HOST[:PORT]`: a Net F/T box, read as it streams, through pynetft."""

from collections import Counter
from collections.abc import Callable, Generator
from contextlib import closing
from urllib.parse import urlsplit

import numpy as np

from probedesign.errors import InputError
from probedesign.estimation.model import ProbeModel
from probedesign.live.processing.blocks import Block
from probedesign.live.sources.netft.configuration import Configuration, Watch, fetch_configuration
from probedesign.live.sources.netft.record_decoder import Reception, summary
from probedesign.live.sources.netft.session import Session
from probedesign.live.sources.netft.wire import HTTP_PORT, RDT_PORT
from probedesign.live.sources.parameters import Parameter, parse_parameters

PARAMETERS = {
    "http": Parameter(HTTP_PORT, 1, 65535, whole=True),
    "check_s": Parameter(2.0, 0.1, 3600.0),
}


class NetFT:
    """A box at an address.

    Attributes:
        title: one line that says what it is.
        notes: what the box says of itself.
        counts: records so far: received, lost, late, doubled, malformed, with a fault, dropped by the queue;
            interruptions and restarts. Counted every second.
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
        host, port = _address(place)
        said = parse_parameters("netft:", query, PARAMETERS)
        self._name = f"netft://{host}:{port}"
        self._session = Session(self._name, host, port)  # what is missing is told before anything is asked
        self._page, self._check = (host, int(said["http"])), said["check_s"]
        self._gravity, self._say = model.gravity_base, say
        self.configuration: Configuration = fetch_configuration(*self._page)
        self.title = f"{self._name}, {self.configuration.product}"
        self.notes = self.configuration.notes + _other_sensor(self.configuration, model)
        self.counts: Counter[str] = Counter()

    def __iter__(self) -> Generator[Block, None, None]:
        with Watch(*self._page, self.configuration, self._check) as watch:
            reception = Reception(
                self._name, self._gravity, self.configuration, self._session, watch, self._say
            )
            self.counts = reception.counts
            try:
                with closing(reception.blocks()) as blocks:
                    yield from blocks
            finally:
                reception.count()
                self._say(f"{self._name}: {summary(self.counts)}")


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
