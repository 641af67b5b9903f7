"""The outputs that the user of a run selected, and their sinks."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from probedesign.core.errors import InputError
from probedesign.core.files import check_overwrite
from probedesign.estimation.estimator import Estimator
from probedesign.estimation.model import ProbeModel
from probedesign.live import Log
from probedesign.live.outputs.guard import Limits
from probedesign.live.outputs.recording import RecordingSink, check_suffix
from probedesign.live.outputs.sinks import SinkGroup, UdpPublisher
from probedesign.live.processing.commands import CommandQueue
from probedesign.live.sources.source import Source


def open_publisher(address: str | None, models: Sequence[ProbeModel], log: Log) -> UdpPublisher | None:
    """Return the publisher of --publish; raises InputError if its address is invalid."""
    if address is not None and address.startswith("ros2:"):
        from probedesign.live.outputs.message_streams import RosPublisher

        return RosPublisher(address, models, log)
    return None if address is None else UdpPublisher(address, log)


@dataclass(frozen=True)
class OutputOptions:
    """Outputs that the user selected."""

    record: Path | None  #: file to record to; None records nothing until it is requested during the run.
    force: bool  #: whether that file may be replaced.
    publish: str | None  #: udp://HOST:PORT to which estimates are sent, or ros2://HOST:PORT of a node.
    page: tuple[str, int] | None  #: host and port of the page in the browser.
    terminal: bool  #: whether a live table is shown on the terminal.
    parts_folders: Sequence[Path]  #: folders of the exported parts of each probe, which the page shows.
    metadata: Mapping[str, str]  #: options of the run, stored in the recording.
    foxglove: tuple[str, int] | None = None  #: host and port of the Foxglove server; None serves none.
    guard: str | None = None  #: address of the events of guarded motion; None: nothing is guarded.
    limits: Limits = field(default_factory=Limits)  #: its limits.
    open_browser: bool = False  #: whether the page is shown in the user's browser.

    def check(self, sources: Sequence[str], several: bool) -> None:
        """Refuse to replace an existing file unasked, or to replace a recording that is replayed.

        Raises:
            InputError: this would happen, the suffix of the file is unknown, or several probes share a table.
        """
        record = self.record
        if record is None:
            return
        check_suffix(record)
        if several and record.suffix.lower() == ".csv":
            raise InputError(f"--record {record}: a table has the readings of one sensor; record to NAME.mcap")
        for source in sources:
            replayed = Path(source.partition("?")[0].removeprefix("replay:"))
            if record.exists() and replayed.exists() and record.samefile(replayed):
                raise InputError(f"--record {record} is the recording being replayed; choose another file")
        check_overwrite(record, self.force)

    def connect(
        self,
        sinks: SinkGroup,
        commands: CommandQueue,
        estimators: Mapping[str, Estimator],
        sources: Sequence[Source],
        publisher: UdpPublisher | None,
    ) -> None:
        """Add the selected sinks to a run and register their commands; the name of a single probe is empty.

        Raises:
            InputError: the file cannot be written, or an address cannot be used.
        """
        models = [estimator.model for estimator in estimators.values()]
        if publisher is not None:
            sinks.add(publisher)  # the first of them: a controller waits for it
        recordings = RecordingSink(self.record, models, sinks.log, self.force, self.metadata)
        commands.register("start recording", lambda command: recordings.start())
        commands.register("stop recording", lambda command: recordings.stop())
        sinks.add(recordings)
        if self.foxglove is not None:
            from probedesign.live.outputs.message_streams import FoxgloveSink

            sinks.add(FoxgloveSink(models, self.foxglove, sinks.log))
        if self.page is not None or self.terminal:
            from probedesign.live.view.sinks import BrowserView, TerminalView
            from probedesign.live.view.state import ViewState

            states = {
                name: ViewState(partial(getattr, source, "counts", {}), recording=recordings.state, name=name)
                for name, source in zip(estimators, sources, strict=True)
            }
            if self.page is not None:
                folders = [*zip(estimators.values(), self.parts_folders, strict=True)]
                limits = self.limits.force, self.limits.moment
                sinks.add(BrowserView(states, folders, commands, sinks.log, *self.page, limits=limits,
                                      open_browser=self.open_browser))  # fmt: skip
            if self.terminal:
                sinks.add(TerminalView(states, [f"{model.name} {model.fingerprint}" for model in models]))
        if self.record is not None:  # after the views, which show recording by its events
            sinks.log(recordings.start())
