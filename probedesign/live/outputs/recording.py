"""Recording sink: one file after another, each started and stopped on request and written by a background thread."""

import threading
import time
from collections.abc import Callable, Iterator, Mapping
from datetime import datetime
from functools import partial
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Protocol

from probedesign.core.errors import InputError, ProbeDesignError
from probedesign.estimation.model import ProbeModel
from probedesign.live import Log
from probedesign.live.outputs.sinks import Sink
from probedesign.live.poses.track import TimedPose
from probedesign.live.processing.blocks import Block
from probedesign.live.processing.estimates import EstimateUpdate

MAX_QUEUED_READINGS = 65_536
"""Maximum number of queued readings: 9 s at the 7000 Hz of a Net F/T box, 5 MB."""
FLUSH_PERIOD = 0.5
"""Period of flushing to the disk [s]; a crash of the program loses at most this and the queue."""
GATHER_TIME = 0.05
"""Interval in which readings are gathered for one write [s]: each wake-up of the thread interrupts the estimator."""
CLOSE_TIMEOUT = 30.0
"""Maximum wait for the disk at the end [s]."""

Job = tuple[int, Callable[[], None]]
"""Number of readings that a job writes, and the job."""


class RecordingFile(Sink, Protocol):
    """A sink that writes a file; called from one thread, may raise OSError."""

    def flush(self) -> None:
        """Pass everything to the operating system; from then on it survives this program."""

    def on_pose(self, pose: TimedPose) -> None:
        """Receive a pose of the base."""

    def on_dropped(self, readings: int, others: int) -> None:
        """Receive the number of readings, and of estimates and events, that were dropped before this point."""


class BackgroundWriter:
    """Writes a recording on a background thread; drops and counts what exceeds the queue.

    Attributes:
        readings: number of readings passed to the file.
        dropped: number of readings dropped.
    """

    def __init__(
        self,
        file: RecordingFile,
        name: str,
        log: Log,
        max_queued: int = MAX_QUEUED_READINGS,
        flush_period: float = FLUSH_PERIOD,
    ) -> None:
        """Start the thread; it alone uses the file from now on, and `log` is called from both threads."""
        self._file, self._name, self._log = file, name, log
        self._max_queued, self._flush_period = max_queued, flush_period
        self._queue: SimpleQueue[Job | None] = SimpleQueue()
        self._queued = self._done = 0
        self._counting = threading.Lock()  # events come from several threads
        self._dropped = [0, 0]
        self.readings = self.dropped = 0
        self._failed = False
        self._thread = threading.Thread(target=self._work, name=f"writing {name}", daemon=True)
        self._thread.start()

    def on_samples(self, block: Block) -> None:
        """Queue readings; see `Sink`."""
        if self._enqueue(len(block) or 1, partial(self._file.on_samples, block)):
            self.readings += 0 if self._failed else len(block)
            return
        if not self.dropped:
            self._log(f"{self._name}: the disk is too slow; readings are dropped")
        self._dropped[0] += len(block)
        self.dropped += len(block)

    def on_estimate(self, update: EstimateUpdate) -> None:
        """Queue an estimate; see `Sink`."""
        self._enqueue_other(partial(self._file.on_estimate, update))

    def on_pose(self, pose: TimedPose) -> None:
        """Queue a pose; see `RecordingFile`."""
        self._enqueue_other(partial(self._file.on_pose, pose))

    def on_event(self, time: float, line: str) -> None:
        """Queue an event; see `Sink`."""
        self._enqueue_other(partial(self._file.on_event, time, line))

    def close(self) -> None:
        """Write the queue and close the file."""
        if any(self._dropped):
            self._queue.put((0, partial(self._file.on_dropped, *self._dropped)))
        self._queue.put(None)
        self._thread.join(CLOSE_TIMEOUT)
        if self._thread.is_alive():
            self._log(f"{self._name}: the disk does not respond; unwritten data are lost")
        elif self.dropped and not self._failed:
            self._log(
                f"{self._name}: the disk was too slow: {self.dropped} readings dropped, marked in the file"
            )

    def _enqueue(self, weight: int, job: Callable[[], None]) -> bool:
        """Queue a job; return False if the queue is full."""
        if self._failed:
            return True  # the failure has been reported
        with self._counting:
            waiting = self._queued - self._done
            if waiting and waiting + weight > self._max_queued:
                return False
            if any(self._dropped):
                self._queue.put((0, partial(self._file.on_dropped, *self._dropped)))
                self._dropped = [0, 0]
            self._queued += weight
            self._queue.put((weight, job))
        return True

    def _enqueue_other(self, job: Callable[[], None]) -> None:
        if not self._enqueue(1, job):
            self._dropped[1] += 1

    def _work(self) -> None:
        """Run jobs until the end and flush periodically; after a failure only count them."""
        try:
            self._write()
        except Exception as error:  # a full disk or a bug: the run continues in both cases
            self._failed = True
            reason = error.strerror if isinstance(error, OSError) else f"{type(error).__name__}: {error}"
            complete = "the file is complete up to this point, the run continues"
            self._log(f"{self._name}: recording ended: {reason}; {complete}")
            while (job := self._queue.get()) is not None:
                self._done += job[0]

    def _write(self) -> None:
        flushed = time.monotonic()
        while True:
            for job in self._gather():
                if job is None:
                    self._queue.put(None)  # the end marker again, for the counting loop if closing fails
                    self._file.close()
                    return
                job[1]()
                self._done += job[0]
                if time.monotonic() - flushed >= self._flush_period:
                    self._file.flush()
                    flushed = time.monotonic()

    def _gather(self) -> Iterator[Job | None]:
        """Yield the jobs that arrive within the gathering interval, or an empty one when a flush is due before."""
        try:
            first = self._queue.get(timeout=self._flush_period)
        except Empty:
            yield 0, lambda: None
            return
        if first is not None:
            time.sleep(GATHER_TIME)
        yield first
        for _ in range(self._queue.qsize()):
            yield self._queue.get_nowait()


SUFFIXES = (".mcap", ".csv")
DEFAULT_FOLDER = Path("recordings")


def check_suffix(path: Path) -> None:
    """Refuse a file name without a suffix of `SUFFIXES`; raises InputError."""
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(
            f"{path}: use the suffix .mcap (all data, for ROS 2 and replay) or .csv (raw readings)"
        )


def open_recording_file(
    path: Path, model: ProbeModel, force: bool, metadata: Mapping[str, str]
) -> RecordingFile:
    """Return the recording file of the type that the suffix names; see `McapRecorder` for the arguments."""
    check_suffix(path)
    try:
        if path.suffix.lower() == ".csv":
            from probedesign.live.recordings.csv import CsvRecorder

            return CsvRecorder(path, force)
        from probedesign.live.recordings.mcap_write import McapRecorder

        return McapRecorder(path, model, force, metadata)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from None


class RecordingSink:
    """Sink that records between `start` and `stop`, to a new file each time; no file is ever overwritten unasked."""

    def __init__(
        self,
        path: Path | None,
        model: ProbeModel,
        log: Log,
        force: bool = False,
        metadata: Mapping[str, str] | None = None,
    ) -> None:
        """Prepare to record; no file is opened.

        Args:
            path: first file; later files are named NAME-2, NAME-3, ... None names it by probe and date in the folder
                `recordings`.
            model: probe on the sensor.
            force: whether the first file may replace an existing one.
            metadata: additional metadata of an MCAP file.
        """
        self._path = path or DEFAULT_FOLDER / f"{model.name}-{datetime.now():%Y%m%d-%H%M%S}.mcap"
        self._model, self._log, self._metadata = model, log, metadata or {}
        self._force = force and path is not None
        self._current: tuple[Path, BackgroundWriter] | None = None
        self._started = False

    @property
    def path(self) -> Path | None:
        """Path of the current file, or None."""
        return self._current and self._current[0]

    def start(self) -> None:
        """Open the next file.

        Raises:
            InputError: it exists or cannot be written.
            MissingDependencyError: the package that writes it is not installed.
        """
        if self._current is not None:
            self._log(f"recording to {self._current[0]} is already active")
            return
        path = _unused_path(self._path) if self._started else self._path
        file = open_recording_file(path, self._model, self._force and not self._started, self._metadata)
        self._started = True
        self._current = path, BackgroundWriter(file, str(path), self._log)
        self._log(f"recording to {path}")

    def stop(self) -> None:
        """Close the file."""
        if self._current is None:
            self._log("no recording is active")
            return
        (path, writer), self._current = self._current, None
        writer.close()
        self._log(f"recorded {writer.readings} readings to {path}")

    def try_start(self) -> None:
        """Open the next file on request; a failure is reported and the run continues."""
        try:
            self.start()
        except ProbeDesignError as error:
            self._log(f"cannot start recording: {error}")

    def on_samples(self, block: Block) -> None:
        """Record readings; see `Sink`."""
        if self._current is not None:
            self._current[1].on_samples(block)

    def on_estimate(self, update: EstimateUpdate) -> None:
        """Record an estimate; see `Sink`."""
        if self._current is not None:
            self._current[1].on_estimate(update)

    def on_pose(self, pose: TimedPose) -> None:
        """Record a pose of the base, by the source's clock."""
        if self._current is not None:
            self._current[1].on_pose(pose)

    def on_event(self, time: float, line: str) -> None:
        """Record an event; see `Sink`."""
        if self._current is not None:
            self._current[1].on_event(time, line)

    def close(self) -> None:
        """Close the current file, if any."""
        if self._current is not None:
            self.stop()


def _unused_path(path: Path) -> Path:
    """Return the first of NAME, NAME-2, NAME-3, ... that does not exist."""
    number, unused = 1, path
    while unused.exists():
        number += 1
        unused = path.with_stem(f"{path.stem}-{number}")
    return unused
