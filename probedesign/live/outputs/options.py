"""The outputs that the user of a run selected, and their sinks."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from probedesign.core.errors import InputError
from probedesign.core.files import check_overwrite
from probedesign.estimation.estimator import Estimator
from probedesign.estimation.model import ProbeModel
from probedesign.live import Log
from probedesign.live.outputs.recording import RecordingSink, SplitLimits, check_suffix
from probedesign.live.outputs.ros2 import SCHEME, RosPublisher
from probedesign.live.outputs.sinks import SinkGroup, UdpPublisher
from probedesign.live.poses.base_poses import BasePoses
from probedesign.live.processing.commands import CommandQueue
from probedesign.live.sources.source import Source
from probedesign.live.view.sinks import BrowserView, TerminalView


@dataclass(frozen=True)
class OutputOptions:
    """Outputs that the user selected."""

    record: Path | None  #: file to record to; None records nothing until it is requested during the run.
    force: bool  #: whether that file may be replaced.
    publish: str | None  #: udp://HOST:PORT to which estimates are sent, or ros2://HOST:PORT of a node.
    page: tuple[str, int] | None  #: host and port of the page in the browser.
    terminal: bool  #: whether a live table is shown on the terminal.
    parts_folder: Path  #: folder of the exported parts, which the page shows.
    metadata: Mapping[str, str]  #: options of the run, stored in the recording.
    split: SplitLimits = field(default_factory=SplitLimits)  #: when a recording continues in a new file.
    foxglove: tuple[str, int] | None = None  #: host and port of the Foxglove server; None serves none.
    open_browser: bool = False  #: whether the page is shown in the user's browser.

    def check(self, source: str) -> None:
        """Refuse to replace an existing file unasked, or to replace the recording that is replayed.

        Raises:
            InputError: this would happen, or the suffix of the file is unknown.
        """
        record = self.record
        if record is None:
            return
        check_suffix(record)
        replayed = Path(source.partition("?")[0].removeprefix("replay:"))
        if record.exists() and replayed.exists() and record.samefile(replayed):
            raise InputError(f"--record {record} is the recording being replayed; choose another file")
        check_overwrite(record, self.force)

    def publisher(self, model: ProbeModel, log: Log) -> UdpPublisher | None:
        """Return the publisher; separate from the other sinks because an invalid address is reported first."""
        if self.publish is not None and self.publish.startswith(SCHEME):
            return RosPublisher(self.publish, model, log)
        return None if self.publish is None else UdpPublisher(self.publish, log)

    def connect(
        self,
        sinks: SinkGroup,
        commands: CommandQueue,
        estimator: Estimator,
        source: Source,
        poses: BasePoses | None,
        publisher: UdpPublisher | None,
    ) -> None:
        """Add the selected sinks to a run and register their commands.

        Raises:
            InputError: the file cannot be written, or an address cannot be used.
        """
        counts = partial(getattr, source, "counts", {})
        if publisher is not None:
            sinks.add(publisher)  # the first of them: a controller waits for it
        recordings = RecordingSink(self.record, estimator.model, sinks.log, self.force, self.metadata, self.split)
        commands.register("start recording", lambda command: recordings.start())
        commands.register("stop recording", lambda command: recordings.stop())
        sinks.add(recordings)
        if self.foxglove is not None:
            from probedesign.live.outputs.foxglove import FoxgloveSink

            sinks.add(FoxgloveSink(estimator.model, self.foxglove, sinks.log))
        if poses is not None:
            poses.on_pose = sinks.on_pose
        if self.page is not None:
            host, port = self.page
            sinks.add(
                BrowserView(
                    estimator, self.parts_folder, commands, sinks.log, host=host, port=port, counts=counts,
                    recording=recordings.state, open_browser=self.open_browser,
                )
            )  # fmt: skip
        if self.terminal:
            sinks.add(TerminalView(f"{estimator.model.name} {estimator.model.fingerprint}", counts, recordings.state))
        if self.record is not None:  # after the views, which show recording by its events
            sinks.log(recordings.start())
