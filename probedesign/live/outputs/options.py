"""What a run is kept, shown and sent by, as a user asks for it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from probedesign.errors import InputError
from probedesign.estimation.estimator import Estimator
from probedesign.live.outputs.recording import Recordings, check_name
from probedesign.live.outputs.sinks import Publisher, Sinks
from probedesign.live.poses.base_poses import Poses
from probedesign.live.processing.scheduler import Requests
from probedesign.live.sources.source import Source
from probedesign.live.view.browser_view import View
from probedesign.live.view.status_text import Terminal


@dataclass(frozen=True)
class Outlets:
    """What is asked for.

    Attributes:
        record: file that everything is written to; None records nothing until that is asked for.
        force: whether it may be replaced.
        publish: udp://HOST:PORT that answers are sent to.
        page: host and port of the page in the browser.
        drawn: whether a table is drawn anew on the terminal.
        parts: folder of the exported parts, which the page shows.
        about: options of the run, written into the recording.
    """

    record: Path | None
    force: bool
    publish: str | None
    page: tuple[str, int] | None
    drawn: bool
    parts: Path
    about: Mapping[str, str]

    def check(self, source: str) -> None:
        """Refuse to replace a file unasked, and the recording that is replayed at all.

        Raises:
            InputError: it would be so, or the file's name says no kind.
        """
        record = self.record
        if record is None:
            return
        check_name(record)
        replayed = Path(source.partition("?")[0].removeprefix("replay:"))
        if record.exists() and replayed.exists() and record.samefile(replayed):
            raise InputError(f"--record {record} is the recording that is replayed; name another file")
        if record.exists() and not self.force:
            raise InputError(f"{record}: exists already; --force replaces it, or name another file")

    def publisher(self, say: Callable[[str], None]) -> Publisher | None:
        """Who sends the answers; apart from the others, since a wrong address is to be told before anything else.

        Raises:
            InputError: there is no such address.
        """
        return None if self.publish is None else Publisher(self.publish, say)

    def connect(
        self,
        sinks: Sinks,
        requests: Requests,
        estimator: Estimator,
        source: Source,
        poses: Poses | None,
        publisher: Publisher | None,
    ) -> None:
        """Add them to the sinks of a run, and let them do what is asked for meanwhile.

        Raises:
            InputError: the file cannot be written, or the page has no port.
        """
        counts = partial(getattr, source, "counts", {})
        recordings = Recordings(self.record, estimator.model, sinks.say, self.force, dict(self.about))
        requests.does("start recording", lambda _: recordings.asked_to_start())
        requests.does("stop recording", lambda _: recordings.stop())
        sinks.add(recordings)
        if poses is not None:
            poses.tell = recordings.posed
        if publisher is not None:
            sinks.add(publisher)
        if self.page is not None:
            sinks.add(View(estimator, self.parts, requests, sinks.say, *self.page, counts))
        if self.drawn:
            sinks.add(Terminal(f"{estimator.model.name} {estimator.model.fingerprint}", counts))
        if self.record is not None:  # after the views, which tell from the events whether it is recorded
            recordings.start()
