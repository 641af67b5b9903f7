"""Recording sink: one file after another, each started and stopped on request and written by a background thread."""

import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from datetime import datetime
from functools import partial
from itertools import chain
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any, Protocol

from probedesign.core.errors import InputError, ProbeDesignError
from probedesign.estimation.model import ProbeModel
from probedesign.live import Log
from probedesign.live.blocks import Block
from probedesign.live.outputs.sinks import Sink, SinkGroup
from probedesign.live.priority import yield_to_estimates

MAX_QUEUED_READINGS = 65_536  #: Maximum number of queued readings: 9 s at the 7000 Hz of a Net F/T box, 5 MB.
FLUSH_PERIOD = 0.5  #: Period of flushing to the disk [s]; a crash of the program loses at most this and the queue.
#: Interval in which readings are gathered for one write [s]: each wake-up of the thread interrupts the estimator.
GATHER_TIME = 0.05
CLOSE_TIMEOUT = 30.0  #: Maximum wait for the disk at the end [s].

Job = tuple[int, Callable[[], None]]  #: Number of readings that a job writes, and the job.


class RecordingFile(Sink, Protocol):
    """A sink that writes a file; called from one thread, may raise OSError."""

    @property
    def readings(self) -> int:
        """Number of readings in the file, without those that wait for the next flush."""

    def flush(self) -> None:
        """Pass everything to the operating system; from then on it survives this program."""

    def on_dropped(self, readings: int, others: int, probe: str = "") -> None:
        """Receive the number of a probe's readings, and of other messages, that were dropped before this point."""


class BackgroundWriter(Sink):
    """Writes a recording, or serves it, on a background thread; drops and counts what exceeds the queue.

    Attributes:
        dropped: number of readings dropped.
        failure: why it ended by itself; empty if it did not.
    """

    def __init__(
        self,
        file: RecordingFile,
        name: str,
        log: Log,
        max_queued: int = MAX_QUEUED_READINGS,
        flush_period: float = FLUSH_PERIOD,
        cause: str = "the disk",
    ) -> None:
        """Start the thread, which alone uses the file from now on; `cause` names what may be too slow."""
        self._file, self._name, self._log = file, name, log
        self._max_queued, self._flush_period, self._cause = max_queued, flush_period, cause
        self._queue: SimpleQueue[Job | None] = SimpleQueue()
        self._queued = self._done = 0
        self._counting = threading.Lock()  # events come from several threads
        self._dropped: dict[str, int] = {}  # readings by probe
        self._others_dropped, self._probe = 0, ""
        self.dropped = 0
        self.failure = ""
        self._thread = threading.Thread(target=self._work, name=f"writing {name}", daemon=True)
        self._thread.start()

    @property
    def readings(self) -> int:
        """Number of readings in the file."""
        return self._file.readings

    def on_samples(self, block: Block) -> None:
        """Queue readings; see `Sink`."""
        self._probe = block.probe
        if self._enqueue(len(block) or 1, lambda: self._file.on_samples(block)):
            return
        if not self.dropped:
            self._log(f"{self._name}: {self._cause} is too slow; readings are dropped")
        self._dropped[block.probe] = self._dropped.get(block.probe, 0) + len(block)
        self.dropped += len(block)

    def pass_on(self, call: str, *data: Any) -> None:
        """Queue an estimate, a pose or an event."""
        if not self._enqueue(1, lambda: getattr(self._file, call)(*data)):
            self._others_dropped += 1

    def close(self) -> None:
        """Write the queue and close the file."""
        self._queue_dropped()
        self._queue.put(None)
        self._thread.join(CLOSE_TIMEOUT)
        if self._thread.is_alive():
            self._log(f"{self._name}: {self._cause} does not respond; unwritten data are lost")
        elif self.dropped and not self.failure:
            self._log(f"{self._name}: {self._cause} was too slow: {self.dropped} readings dropped, marked in the file")

    def _enqueue(self, weight: int, job: Callable[[], None]) -> bool:
        """Queue a job; return False if the queue is full."""
        if self.failure:
            return True  # the failure has been reported
        with self._counting:
            waiting = self._queued - self._done
            if waiting and waiting + weight > self._max_queued:
                return False
            self._queue_dropped()
            self._queued += weight
            self._queue.put((weight, job))
        return True

    def _queue_dropped(self) -> None:
        others, self._others_dropped = self._others_dropped, 0
        dropped, self._dropped = self._dropped or ({self._probe: 0} if others else {}), {}
        for probe, readings in dropped.items():
            self._queue.put((0, partial(lambda *counts: self._file.on_dropped(*counts), readings, others, probe)))
            others = 0

    def _work(self) -> None:
        """Run jobs until the end and flush periodically; after a failure only count them."""
        yield_to_estimates()
        try:
            self._write()
        except Exception as error:  # a full disk or a bug: the run continues in both cases
            with suppress(Exception):  # it releases the file; what fits is written
                self._file.close()
            known = str(error) if isinstance(error, ProbeDesignError) else f"{type(error).__name__}: {error}"
            reason = error.strerror if isinstance(error, OSError) else known
            self.failure = reason or known
            contents = f"the file contains {self.readings} readings, " if self._cause == "the disk" else ""
            self._log(f"{self._name}: recording ended: {reason}; {contents}the run continues")
            while (job := self._queue.get()) is not None:
                self._done += job[0]

    def _write(self) -> None:
        flushed = time.monotonic()
        while True:
            first: Job | None = (0, lambda: None)  # if a flush is due before one arrives
            with suppress(Empty):
                first = self._queue.get(timeout=self._flush_period)
                if first is not None:
                    time.sleep(GATHER_TIME)
            for job in chain([first], (self._queue.get_nowait() for _ in range(self._queue.qsize()))):
                if job is None:
                    self._queue.put(None)  # the end marker again, for the counting loop if closing fails
                    self._file.close()
                    return
                job[1]()
                self._done += job[0]
                if time.monotonic() - flushed >= self._flush_period:
                    self._file.flush()
                    flushed = time.monotonic()


SUFFIXES = (".mcap", ".csv")
DEFAULT_FOLDER = Path("recordings")


def check_suffix(path: Path) -> None:
    """Refuse a file name without a suffix of `SUFFIXES`; raises InputError."""
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(f"{path}: use the suffix .mcap (all data, for ROS 2 and replay) or .csv (raw readings)")


def open_recording_file(
    path: Path, models: Sequence[ProbeModel], force: bool, metadata: Mapping[str, str]
) -> RecordingFile:
    """Return the recording file of the type that the suffix names; see `McapRecorder` for the arguments."""
    check_suffix(path)
    try:
        if path.suffix.lower() == ".csv":
            from probedesign.live.recordings.csv import CsvRecorder

            return CsvRecorder(path, force)
        from probedesign.live.recordings.mcap_write import McapRecorder

        return McapRecorder(path, *models, force=force, about=metadata)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from None


class RecordingSink(SinkGroup):
    """Sink that records between `start` and `stop`, to a new file each time; no file is ever overwritten unasked."""

    def __init__(
        self,
        path: Path | None,
        models: Sequence[ProbeModel],
        log: Log,
        force: bool = False,
        metadata: Mapping[str, str] | None = None,
    ) -> None:
        """Prepare to record; no file is opened.

        Args:
            path: first file; later files are named NAME-2, NAME-3, ... None names it by probes and date in the folder
                `recordings`.
            models: probes of the run.
            force: whether the first file may replace an existing one.
            metadata: additional metadata of an MCAP file.
        """
        super().__init__()  # with the writer as its only sink while it records
        name = "-".join(model.name for model in models)
        self._named = path or DEFAULT_FOLDER / f"{name}-{datetime.now():%Y%m%d-%H%M%S}.mcap"
        self._models, self._log, self._metadata = models, log, metadata or {}
        self._force = force and path is not None
        self._current: BackgroundWriter | None = None
        self._number, self._path = 0, self._named  # of the newest file

    @property
    def path(self) -> Path | None:
        """Path of the current file, or None."""
        return self._path if self._current is not None else None

    def state(self) -> tuple[str, str]:
        """Return what is recorded, and why the recording ended by itself; each may be empty."""
        if self._current is None:
            return "", ""
        if self._current.failure:
            return "", f"ended: {self._current.failure}"
        return f"to {self.path}, {self._current.readings} readings", ""

    def start(self) -> str:
        """Open the next file, and return a line that names it.

        Raises:
            InputError: a recording is active already, or the file exists or cannot be written.
            MissingDependencyError: the package that writes it is not installed.
        """
        if self._current is not None and not self._current.failure:
            raise InputError(f"recording to {self.path} is already active")
        self.close()
        number, path = self._number + 1, self._named
        while number > 1 and (path := self._named.with_stem(f"{self._named.stem}-{number}")).exists():
            number += 1
        file = open_recording_file(path, self._models, self._force and number == 1, self._metadata)
        self._number, self._path = number, path
        self._current = BackgroundWriter(file, str(path), self._log)
        self.add(self._current)
        return f"recording to {path}"

    def stop(self) -> str:
        """Close the file, and return a line that names it.

        Raises:
            InputError: no recording is active.
        """
        if self._current is None:
            raise InputError("no recording is active")
        writer, self._current, self._sinks = self._current, None, []
        writer.close()
        early = f"; it ended early: {writer.failure}" if writer.failure else ""
        return f"recorded {writer.readings} readings to {self._path}{early}"

    def close(self) -> None:
        """Close the current file, if any, and report it."""
        if self._current is not None:
            self._log(self.stop())
