"""Source `netft://HOST[:PORT]`: decodes the records of a streaming Net F/T box to wrenches, times and faults."""

from collections import Counter
from collections.abc import Generator
from contextlib import closing
from itertools import pairwise
from math import inf, isfinite
from time import monotonic

import numpy as np

from probedesign.core.errors import InputError
from probedesign.estimation.model import ProbeModel
from probedesign.live import Log, split_address
from probedesign.live.blocks import Block, dropout_block
from probedesign.live.priority import prompt_estimates
from probedesign.live.sources.netft.configuration import (
    ConfigurationMonitor,
    NetFTConfiguration,
    fetch_page,
    parse_configuration,
)
from probedesign.live.sources.netft.rdt import (
    AXIA,
    HTTP_PORT,
    NET_BOX,
    RDT_PORT,
    SAMPLES_PER_SECOND,
    RateMonitor,
    SensorClock,
    fault_of,
    steps,
)
from probedesign.live.sources.netft.session import RdtRecords, RdtSession
from probedesign.live.sources.source import STALE_TIME, DropoutMonitor, SourceParameter, parse_parameters, range_note

COUNT_INTERVAL = 1.0  #: Interval at which the counts are updated [s].
REPORT_INTERVAL = 10.0  #: Minimum interval between reports of losses [s].

#: Texts of the counters, in the order of the summary.
COUNTERS = {
    "lost": "lost", "late": "late and rejected", "doubled": "duplicated", "malformed": "malformed",
    "faults": "with a fault", "dropped": "lost because this computer read too slowly", "interruptions": "interruptions",
    "restarts": "restarts",
}  # fmt: skip
REPORTED = ("lost", "dropped", "malformed")  #: Counters that are reported while they increase.


def summary(counts: Counter[str]) -> str:
    """Return all counters as one line."""
    text = [f"{counts[name]} {text}" for name, text in COUNTERS.items() if counts[name]]
    return f"{counts['received']} records, {', '.join(text) or 'none lost'}"


NO_RECORD = "the box responds to HTTP but sends no records; check the firewall and the port"
FAULT_REPORT_INTERVAL = 1.0  #: Minimum interval between reports of faults [s]: a load near the limit causes many.


PARAMETERS = {
    "http": SourceParameter(HTTP_PORT, 1, 65535, integer=True),
    "check_s": SourceParameter(2.0, 0.1, 3600.0),
    "clock_hz": SourceParameter(SAMPLES_PER_SECOND, 100.0, 10_000.0),
}
STATUS_TABLES = {"netbox": NET_BOX, "axia": AXIA}
TEXT_PARAMETERS = {"sensor": tuple(STATUS_TABLES)}


class NetFTSource:
    """A box at an address; see `Source`.

    Attributes:
        counts: number of records received, lost, late, doubled, malformed, with a fault, dropped by the queue;
            interruptions and restarts. Updated every second.
    """

    def __init__(self, model: ProbeModel, target: str, query: str, log: Log) -> None:
        """Fetch the configuration of the box at `//HOST[:PORT]`; nothing streams yet.

        The parameters are `PARAMETERS` and `TEXT_PARAMETERS`.

        Raises:
            InputError: the address or a parameter is invalid, or no box responds.
        """
        host, port = split_address(f"netft:{target}", "netft") or ("", None)
        if not host or port == 0:
            raise InputError(f"netft:{target}: write netft://HOST or netft://HOST:PORT")
        port = RDT_PORT if port is None else port
        parameters, texts = parse_parameters("netft:", query, PARAMETERS, TEXT_PARAMETERS)
        self._name = f"netft://{host}:{port}"
        page = host, int(parameters["http"])
        self._gravity, self._log = model.gravity_base, log
        self.configuration: NetFTConfiguration = parse_configuration(fetch_page(*page))
        self._session = RdtSession(self._name, host, port, self.configuration.rate)
        self.title = f"{self._name}, {self.configuration.product}"
        self.notes = self.configuration.notes
        if len(self.configuration.ranges) == 6:
            ranges = np.array(self.configuration.ranges) * self.configuration.units
            self.notes += range_note("box", ranges, model)
        axia = "axia" in self.configuration.product.lower()  # assumed: the manual does not list the names
        self._table = STATUS_TABLES[texts["sensor"] or ("axia" if axia else "netbox")]
        self.notes += self._session.notes
        rate = parameters["clock_hz"]
        self._clock, self._rate = SensorClock(rate), RateMonitor(rate)
        self._dropout = DropoutMonitor(self._name, log, NO_RECORD)
        self._monitor = ConfigurationMonitor(*page, self.configuration, parameters["check_s"])
        self.notes += (f"its status codes are decoded as those of a sensor of type {self._table.kind}",)
        self.counts: Counter[str] = Counter()
        self._reported, self._report_time = Counter[str](), -inf
        self._last, self._stretch = -inf, 0
        self._awaited = 0  # the first request for the page since the box restarted
        self._counted, self._faulted, self._fault = -inf, -inf, ""

    def expect(self, readings: int) -> None:
        """Gather this number of readings to a block; see `Source`."""
        self._session.wanted = readings

    def __iter__(self) -> Generator[Block, None, None]:
        self._dropout.restart()
        self._started = monotonic()
        try:
            with self._monitor, prompt_estimates() as granted, closing(self._blocks()) as blocks:
                if granted:
                    self._log(f"{self._name}: estimates have a real-time priority")
                yield from blocks
        finally:
            self._count()
            self._log(f"{self._name}: {summary(self.counts)}")

    def _blocks(self) -> Generator[Block, None, None]:
        with closing(self._session.records()) as stream:
            for records in stream:
                self._check_configuration()
                if monotonic() - self._counted > COUNT_INTERVAL:
                    self._count()
                    more = {name: self.counts[name] - self._reported[name] for name in REPORTED}
                    if any(more.values()) and monotonic() - self._report_time > REPORT_INTERVAL:
                        text = ", ".join(f"{count} {COUNTERS[name]}" for name, count in more.items() if count)
                        self._log(f"{self._name}: {text}; {self.counts['received']} received so far")
                        self._reported, self._report_time = self.counts.copy(), monotonic()
                yield from self._decode(records) if records is not None else self._report_silence()

    def _count(self) -> None:
        self._counted = monotonic()
        for name, count in self._session.counts.items():
            self.counts[name] = count
        # what did not fit into the buffer is missing in the numbers of the records, too; a forged number leaps further
        sent = round((self._counted - self._started) * self.configuration.rate)
        self.counts["lost"] = max(min(self.counts["lost"], sent) - self.counts["dropped"], 0)

    def _decode(self, records: RdtRecords) -> Generator[Block, None, None]:
        """Yield blocks of records, split where the stream was interrupted and where the fault changes."""
        new, time, broken = self._clock.times(records.ft_sequence, records.received)
        records = records if new.all() else records[new]
        if not len(records):
            return
        status = records.status
        if status.any():
            status = np.where(np.isin(status, self._table.harmless), 0, status)
        before = self._last if isfinite(self._last) else records.received[0]
        if records.received[-1] - before > STALE_TIME:
            broken |= steps(records.received, before) > STALE_TIME
        broken[0] |= self._dropout.ongoing
        uniform = not (broken.any() or status.any())
        cuts = [] if uniform else (np.flatnonzero(broken[1:] | (np.diff(status) != 0)) + 1).tolist()
        for start, end in pairwise([0, *cuts, len(records)]):
            received = records.received[start:end]
            if broken[start]:
                self._rate.reset()
                if not self._resumed(float(received[0])):
                    yield from self._report_silence("its page does not respond")
                    return
            wrench = records.counts[start:end] @ self.configuration.to_sensor.T
            fault = fault_of(int(status[start]), self._table) if status[start] else ""
            if fault:
                self.counts["faults"] += end - start
            if fault != self._fault and (not fault or monotonic() - self._faulted > FAULT_REPORT_INTERVAL):
                self._log(f"{self._name}: {fault or 'healthy again'}")
                self._fault, self._faulted = fault, monotonic()
            yield Block(time[start:end], wrench, self._gravity, received, fault, self._stretch)
            self._last = float(received[-1])
            if (rate := self._rate.measured(float(time[end - 1]), self._last)) is not None:
                self._log(
                    f"{self._name}: its counter advances by {rate:.0f} a second, so all times are wrong; "
                    f"restart with ?clock_hz={rate:.0f}"
                )

    def _report_silence(self, hint: str = "asking again") -> Generator[Block, None, None]:
        self._dropout.on_silence(self._last, hint)
        if self._dropout.ongoing:
            yield dropout_block(self._gravity, self._dropout.reason, self._stretch)

    def _resumed(self, received: float) -> bool:
        """Return whether resumed records come from the same box with the same configuration.

        Its page is read in the background. A counter that continues is that of the same box, so its records are used
        meanwhile. Those of another box, or of one that restarted, are not used before the page has been read.
        """
        restarted = self._clock.restarts > self.counts["restarts"]
        request = self._monitor.request()
        self._awaited = self._awaited or request
        if restarted and self._monitor.read < self._awaited:
            return False
        self._awaited = 0
        self._check_configuration()
        self._stretch += 1
        self.counts["interruptions"] += 1
        if restarted:
            self.counts["restarts"] = self._clock.restarts
            self._log(f"{self._name}: its clock restarted; the previous tare is kept, take a new one")
        self._dropout.on_resumed(received - self._last)
        return True

    def _check_configuration(self) -> None:
        if self._monitor.changed:
            text = ", ".join(self._monitor.changed)
            raise InputError(
                f"{self._name}: its configuration has changed ({text}); readings of the last "
                f"{self._monitor.period:g} s may be wrong; restart with a new tare"
            )
