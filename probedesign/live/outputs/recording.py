"""A sink whose work is done by a thread of its own, so that nobody waits for its disk."""

import threading
import time
from collections.abc import Callable, Iterator, Mapping
from datetime import datetime
from functools import partial
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Protocol

from probedesign.errors import InputError, ProbeDesignError
from probedesign.estimation.model import ProbeModel
from probedesign.live.outputs.sinks import Sink
from probedesign.live.poses.track import TimedPose
from probedesign.live.processing.blocks import Block
from probedesign.live.processing.estimates import Answer

MAX_QUEUED_READINGS = 65_536
"""Readings that may wait: nine seconds at the 7000 a second of a Net F/T box, five megabytes."""
FLUSH_PERIOD = 0.5
"""How often everything is handed to the disk [s]: what ends the program takes no more than this along, and what
waits."""
GATHER_TIME = 0.05
"""What comes within so long is written in one go [s]: each waking of the thread would interrupt whoever estimates."""
CLOSE_TIMEOUT = 30.0
"""How long a disk is waited for at the end [s]."""

Job = tuple[int, Callable[[], None]]
"""How many readings it writes, and how."""


class File(Sink, Protocol):
    """A sink that writes a file; it is called from one thread, and may raise OSError."""

    def flush(self) -> None:
        """Hand everything to the operating system: from now on it survives this program."""
        ...

    def posed(self, pose: TimedPose) -> None:
        """Where the base was."""
        ...

    def left_out(self, readings: int, others: int) -> None:
        """So many readings and answers or events did not come here."""
        ...


class Behind:
    """A file's calls, carried out in order and later. What finds no room is left out, counted and told.

    Attributes:
        readings: that came to be written.
        lost: that were left out.
    """

    def __init__(
        self,
        file: File,
        name: str,
        say: Callable[[str], None],
        most: int = MAX_QUEUED_READINGS,
        every: float = FLUSH_PERIOD,
    ) -> None:
        """Start the thread.

        Args:
            file: that is written; its own from now on.
            name: of the file, for messages.
            say: takes each line that a user should know; called from either thread.
            most: readings that may wait.
            every: how often the file is flushed [s].
        """
        self._file, self._name, self._say, self._most, self._every = file, name, say, most, every
        self._queue: SimpleQueue[Job | None] = SimpleQueue()
        self._put = self._done = 0
        self._counting = threading.Lock()  # lines are told by several threads
        self._missing = [0, 0]
        self.readings = self.lost = 0
        self._failed = False
        self._thread = threading.Thread(target=self._work, name=f"writing {name}", daemon=True)
        self._thread.start()

    def read(self, block: Block) -> None:
        """See `Sink`."""
        if self._asked(len(block) or 1, partial(self._file.read, block)):
            self.readings += 0 if self._failed else len(block)
        else:
            self._leave_out(0, len(block))

    def answered(self, answer: Answer) -> None:
        """See `Sink`."""
        if not self._asked(1, partial(self._file.answered, answer)):
            self._leave_out(1, 1)

    def posed(self, pose: TimedPose) -> None:
        """See `File`."""
        if not self._asked(1, partial(self._file.posed, pose)):
            self._leave_out(1, 1)

    def told(self, time: float, line: str) -> None:
        """See `Sink`."""
        if not self._asked(1, partial(self._file.told, time, line)):
            self._leave_out(1, 1)

    def close(self) -> None:
        """Write what waits, and end the file."""
        if any(self._missing):
            self._queue.put((0, partial(self._file.left_out, *self._missing)))
        self._queue.put(None)
        self._thread.join(CLOSE_TIMEOUT)
        if self._thread.is_alive():
            self._say(f"{self._name}: its disk does not answer; what was not written yet is lost")
        elif self.lost and not self._failed:
            self._say(f"{self._name}: the disk was too slow: {self.lost} readings left out, and marked there")

    def _asked(self, weight: int, job: Callable[[], None]) -> bool:
        """Have the job done, unless too much waits already."""
        if self._failed:
            return True  # it was told that nothing is recorded any more
        with self._counting:
            waiting = self._put - self._done
            if waiting and waiting + weight > self._most:
                return False
            if any(self._missing):
                self._queue.put((0, partial(self._file.left_out, *self._missing)))
                self._missing = [0, 0]
            self._put += weight
            self._queue.put((weight, job))
        return True

    def _leave_out(self, kind: int, count: int) -> None:
        if not self.lost and kind == 0:
            self._say(f"{self._name}: the disk does not keep up; readings are left out")
        self._missing[kind] += count
        self.lost += count if kind == 0 else 0

    def _work(self) -> None:
        """The thread: jobs until the end, a flush now and then; after a failure only the counting goes on."""
        try:
            self._write()
        except Exception as error:  # a full disk, or a fault of ours: either way the run goes on
            self._failed = True
            reason = error.strerror if isinstance(error, OSError) else f"{type(error).__name__}: {error}"
            self._say(
                f"{self._name}: recording ended: {reason}; the file is whole up to there, the run goes on"
            )
            while (job := self._queue.get()) is not None:
                self._done += job[0]

    def _write(self) -> None:
        flushed = time.monotonic()
        while True:
            for job in self._gathered():
                if job is None:
                    self._queue.put(None)  # the end, also for what goes on where closing fails
                    self._file.close()
                    return
                job[1]()
                self._done += job[0]
                flushed = self._flushed(flushed)
            flushed = self._flushed(flushed)

    def _flushed(self, last: float) -> float:
        """When the file was last flushed [s]: now, if that is due."""
        if time.monotonic() - last < self._every:
            return last
        self._file.flush()
        return time.monotonic()

    def _gathered(self) -> Iterator[Job | None]:
        """What comes from now on, for a while; nothing if nothing comes until a flush is due."""
        try:
            first = self._queue.get(timeout=self._every)
        except Empty:
            return
        if first is not None:
            time.sleep(GATHER_TIME)
        yield first
        for _ in range(self._queue.qsize()):
            yield self._queue.get_nowait()


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
            from probedesign.live.recordings.csv import CsvFile

            return CsvFile(path, force)
        from probedesign.live.recordings.mcap_write import McapFile

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
