"""What a run records: one file after the other, each begun and ended on request, none ever replaced."""

from collections.abc import Callable, Mapping
from datetime import datetime
from pathlib import Path

from probedesign.errors import InputError, ProbeDesignError
from probedesign.estimation.model import ProbeModel
from probedesign.live.answer import Answer
from probedesign.live.behind import Behind, File
from probedesign.live.block import Block
from probedesign.live.pose.timed import TimedPose

KINDS = (".mcap", ".csv")
FOLDER = Path("recordings")


def check_name(path: Path) -> None:
    """Refuse a name that says no kind of recording.

    Raises:
        InputError: it ends in none of `KINDS`.
    """
    if path.suffix.lower() not in KINDS:
        raise InputError(
            f"{path}: end its name in .mcap (everything, for ROS 2 and replay) or .csv (raw readings)"
        )


def open_file(path: Path, model: ProbeModel, force: bool, about: Mapping[str, str]) -> File:
    """The file to record to, of the kind that its name says; for the arguments see `McapFile`."""
    check_name(path)
    try:
        if path.suffix.lower() == ".csv":
            from probedesign.live.csv_file import CsvFile

            return CsvFile(path, force)
        from probedesign.live.mcap.file import McapFile

        return McapFile(path, model, force, about)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from None


class Recordings:
    """A sink that records from `start` to `stop`, and takes no note of anything between."""

    def __init__(
        self,
        path: Path | None,
        model: ProbeModel,
        say: Callable[[str], None],
        force: bool = False,
        about: Mapping[str, str] | None = None,
    ) -> None:
        """Nothing is opened yet.

        Args:
            path: of the first file; those after it are called NAME-2, NAME-3, ... None calls it by probe and
                date, in the folder `recordings`.
            model: the probe on the sensor.
            say: takes each line that a user should know.
            force: let the first file replace one that stands there.
            about: what else an MCAP file should tell.
        """
        self._path = path or FOLDER / f"{model.name}-{datetime.now():%Y%m%d-%H%M%S}.mcap"
        self._model, self._say, self._about = model, say, about or {}
        self._force = force and path is not None
        self._now: tuple[Path, Behind] | None = None
        self._begun = False

    @property
    def path(self) -> Path | None:
        """Of the file that is being recorded to."""
        return self._now and self._now[0]

    def start(self) -> None:
        """Begin the next file.

        Raises:
            InputError: it exists or cannot be written.
            MissingDependencyError: what writes it is not installed.
        """
        if self._now is not None:
            self._say(f"recording to {self._now[0]} already")
            return
        path = _free(self._path) if self._begun else self._path
        file = open_file(path, self._model, self._force and not self._begun, self._about)
        self._begun = True
        self._now = path, Behind(file, str(path), self._say)
        self._say(f"recording to {path}")

    def stop(self) -> None:
        """End the file."""
        if self._now is None:
            self._say("nothing is being recorded")
            return
        (path, behind), self._now = self._now, None
        behind.close()
        self._say(f"recorded {behind.readings} readings to {path}")

    def asked_to_start(self) -> None:
        """Begin the next file, as a button asks; if that cannot be, it is said and the run goes on."""
        try:
            self.start()
        except ProbeDesignError as error:
            self._say(f"nothing is recorded: {error}")

    def read(self, block: Block) -> None:
        """See `Sink`."""
        if self._now is not None:
            self._now[1].read(block)

    def answered(self, answer: Answer) -> None:
        """See `Sink`."""
        if self._now is not None:
            self._now[1].answered(answer)

    def posed(self, pose: TimedPose) -> None:
        """Where the base was, by the source's clock."""
        if self._now is not None:
            self._now[1].posed(pose)

    def told(self, time: float, line: str) -> None:
        """See `Sink`."""
        if self._now is not None:
            self._now[1].told(time, line)

    def close(self) -> None:
        """See `Sink`."""
        if self._now is not None:
            self.stop()


def _free(path: Path) -> Path:
    """The first of NAME, NAME-2, NAME-3, ... that nothing stands under."""
    number, free = 1, path
    while free.exists():
        number += 1
        free = path.with_stem(f"{path.stem}-{number}")
    return free
