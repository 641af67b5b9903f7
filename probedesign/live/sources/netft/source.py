"""Source `netft://HOST[:PORT]`: a streaming Net F/T box, read with pynetft."""

from collections import Counter
from collections.abc import Generator
from contextlib import closing
from urllib.parse import urlsplit

import numpy as np

from probedesign.core.errors import InputError
from probedesign.estimation.model import ProbeModel
from probedesign.live import Log
from probedesign.live.processing.blocks import Block
from probedesign.live.sources.netft.configuration import (
    ConfigurationMonitor,
    NetFTConfiguration,
    fetch_configuration,
)
from probedesign.live.sources.netft.record_decoder import RecordDecoder, summary
from probedesign.live.sources.netft.session import RdtSession
from probedesign.live.sources.netft.wire import HTTP_PORT, RDT_PORT
from probedesign.live.sources.parameters import SourceParameter, parse_parameters

PARAMETERS = {
    "http": SourceParameter(HTTP_PORT, 1, 65535, integer=True),
    "check_s": SourceParameter(2.0, 0.1, 3600.0),
}


class NetFTSource:
    """A box at an address.

    Attributes:
        title: one line that describes the source.
        notes: notes on the box's configuration.
        counts: number of records received, lost, late, doubled, malformed, with a fault, dropped by the queue;
            interruptions and restarts. Updated every second.
    """

    def __init__(self, model: ProbeModel, target: str, query: str, log: Log) -> None:
        """Fetch the configuration of the box; nothing streams yet.

        Args:
            model: probe on the sensor.
            target: `//HOST` or `//HOST:PORT`.
            query: the parameters of `PARAMETERS`.
            log: callback for messages to the user.

        Raises:
            InputError: the address or a parameter is invalid, or no box responds.
            MissingDependencyError: pynetft is not installed.
        """
        host, port = _address(target)
        parameters = parse_parameters("netft:", query, PARAMETERS)
        self._name = f"netft://{host}:{port}"
        self._session = RdtSession(self._name, host, port)  # checks dependencies before any request
        self._page, self._check = (host, int(parameters["http"])), parameters["check_s"]
        self._gravity, self._log = model.gravity_base, log
        self.configuration: NetFTConfiguration = fetch_configuration(*self._page)
        self.title = f"{self._name}, {self.configuration.product}"
        self.notes = self.configuration.notes + _range_note(self.configuration, model)
        self.counts: Counter[str] = Counter()

    def __iter__(self) -> Generator[Block, None, None]:
        with ConfigurationMonitor(*self._page, self.configuration, self._check) as monitor:
            decoder = RecordDecoder(
                self._name, self._gravity, self.configuration, self._session, monitor, self._log
            )
            self.counts = decoder.counts
            try:
                with closing(decoder.blocks()) as blocks:
                    yield from blocks
            finally:
                decoder.count()
                self._log(f"{self._name}: {summary(self.counts)}")


def _range_note(configuration: NetFTConfiguration, model: ProbeModel) -> tuple[str, ...]:
    """Return a note if the range of the box differs from that of the probe's sensor."""
    if len(configuration.ranges) != 6:
        return ()
    reach = np.array(configuration.ranges) * configuration.scale * configuration.counts_of_unit
    if np.allclose(reach, model.wrench_range, rtol=0.01):
        return ()
    ranges = ", ".join(f"{value:g}" for value in configuration.ranges)
    return (
        f"the box's range {ranges} differs from that of the frozen probe's sensor: is it another calibration?",
    )


def _address(target: str) -> tuple[str, int]:
    """Return host and port of `//HOST[:PORT]`."""
    try:
        parts = urlsplit(target)
        host, port = parts.hostname or "", parts.port if parts.port is not None else RDT_PORT
    except ValueError:
        host, port = "", 0
    bare = target.startswith("//") and not (parts.path.strip("/") or parts.username or parts.fragment)
    if not host or not port or not bare:
        raise InputError(f"netft:{target}: write netft://HOST or netft://HOST:PORT")
    return host, port
