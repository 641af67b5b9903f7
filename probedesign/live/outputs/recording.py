"""Recording sink: one file after another, each started and stopped on request and written by a background thread."""

import math
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Protocol

from probedesign.core.errors import InputError, ProbeDesignError
from probedesign.estimation.model import ProbeModel
from probedesign.live import Log
from probedesign.live.blocks import Block
from probedesign.live.outputs.sinks import Sink
from probedesign.live.poses.base_poses import TimedPose
from probedesign.live.priority import yield_to_estimates
from probedesign.live.processing.estimates import EstimateUpdate
from probedesign.live.recordings import FileLock, part_path

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

    @property
    def size(self) -> int:
        """Length of the file [bytes]."""

    def flush(self) -> None:
        """Pass everything to the operating system; from then on it survives this program."""

    def on_pose(self, pose: TimedPose) -> None:
        """Receive a pose of the base."""

    def on_dropped(self, readings: int, others: int) -> None:
        """Receive the number of readings, and of estimates and events, that were dropped before this point."""


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
        """Start the thread; it alone uses the file from now on, and `log` is called from both threads.

        `cause` names what may be too slow.
        """
        self._file, self._name, self._log = file, name, log
        self._max_queued, self._flush_period, self._cause = max_queued, flush_period, cause
        self._queue: SimpleQueue[Job | None] = SimpleQueue()
        self._queued = self._done = 0
        self._counting = threading.Lock()  # events come from several threads
        self._dropped = [0, 0]
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
        if self._enqueue(len(block) or 1, partial(self._file.on_samples, block)):
            return
        if not self.dropped:
            self._log(f"{self._name}: {self._cause} is too slow; readings are dropped")
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
        yield_to_estimates()
        try:
            self._write()
        except Exception as error:  # a full disk or a bug: the run continues in both cases
            with suppress(Exception):  # it releases the file; what fits is written
                self._file.close()
            known = str(error) if isinstance(error, ProbeDesignError) else f"{type(error).__name__}: {error}"
            reason = error.strerror if isinstance(error, OSError) else known
            self.failure = reason or known
            contents = f"the file contains {self._file.readings} readings, " if self._cause == "the disk" else ""
            self._log(f"{self._name}: recording ended: {reason}; {contents}the run continues")
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
        raise InputError(f"{path}: use the suffix .mcap (all data, for ROS 2 and replay) or .csv (raw readings)")


def open_recording_file(path: Path, model: ProbeModel, force: bool, metadata: Mapping[str, str]) -> RecordingFile:
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


@dataclass(frozen=True)
class SplitLimits:
    """When a recording continues in a new file."""

    size: float = math.inf  #: length of a file [bytes].
    duration: float = math.inf  #: duration of a file [s], by the computer's clock.

    @classmethod
    def of_options(cls, megabytes: float | None, minutes: float | None) -> "SplitLimits":
        """Return the limits that the user stated, in units of 10⁶ bytes and 60 s; None sets no limit.

        Raises:
            InputError: a number is not positive.
        """
        for name, value in (("--split-mb", megabytes), ("--split-minutes", minutes)):
            if value is not None and not 0.0 < value < math.inf:
                raise InputError(f"{name} {value:g} must be a positive number")
        return cls(1e6 * (megabytes or math.inf), 60.0 * (minutes or math.inf))


class SplitRecording(Sink):
    """A recording in several files; each is complete and can be read by itself.

    Attributes:
        path: path of the current file.
        first_path: path of the first one.
    """

    def __init__(self, open_next: Callable[[], tuple[Path, RecordingFile]], limits: SplitLimits, log: Log) -> None:
        """Open the first file; `open_next` opens a file, and `log` receives a line for each further one."""
        self._open_next, self._limits, self._log = open_next, limits, log
        self._n_before = 0
        self._first_lock: FileLock | None = None
        self.path, self._file = open_next()
        self.first_path = self.path
        self._opened = time.monotonic()

    @property
    def readings(self) -> int:
        """Number of readings in all files; see `RecordingFile`."""
        return self._n_before + self._file.readings

    @property
    def size(self) -> int:
        """Length of the current file [bytes]."""
        return self._file.size

    def on_samples(self, block: Block) -> None:
        """Write readings, beyond a limit to the next file; see `Sink`."""
        age = time.monotonic() - self._opened
        if self._file.size >= self._limits.size or age >= self._limits.duration:
            self._continue()
        self._file.on_samples(block)

    def _continue(self) -> None:
        """Close the file and open the next; the first one stays locked, and with it the series."""
        self._file.close()
        with suppress(OSError):  # the user has moved it
            self._first_lock = self._first_lock or FileLock(self.first_path)
        path, file = self._open_next()
        self._n_before += self._file.readings
        self.path, self._file, self._opened = path, file, time.monotonic()
        self._log(f"recording continues in {path}")

    def on_estimate(self, update: EstimateUpdate) -> None:
        """Write an estimate; see `Sink`."""
        self._file.on_estimate(update)

    def on_pose(self, pose: TimedPose) -> None:
        """Write a pose; see `RecordingFile`."""
        self._file.on_pose(pose)

    def on_event(self, time: float, line: str) -> None:
        """Write an event; see `Sink`."""
        self._file.on_event(time, line)

    def on_dropped(self, readings: int, others: int) -> None:
        """Write the number of what was dropped; see `RecordingFile`."""
        self._file.on_dropped(readings, others)

    def flush(self) -> None:
        """Flush the current file; see `RecordingFile`."""
        self._file.flush()

    def close(self) -> None:
        """Close the file."""
        try:
            self._file.close()
        finally:
            if self._first_lock is not None:
                self._first_lock.close()


class RecordingSink(Sink):
    """Sink that records between `start` and `stop`, to a new file each time; no file is ever overwritten unasked."""

    def __init__(
        self,
        path: Path | None,
        model: ProbeModel,
        log: Log,
        force: bool = False,
        metadata: Mapping[str, str] | None = None,
        limits: SplitLimits = SplitLimits(),  # it is immutable
    ) -> None:
        """Prepare to record; no file is opened.

        Args:
            path: first file; later files are named NAME-2, NAME-3, ... None names it by probe and date in the folder
                `recordings`.
            model: probe on the sensor.
            force: whether the first file may replace an existing one.
            metadata: additional metadata of an MCAP file.
            limits: when a recording continues in a new file.
        """
        self._path = path or DEFAULT_FOLDER / f"{model.name}-{datetime.now():%Y%m%d-%H%M%S}.mcap"
        self._model, self._log, self._metadata = model, log, metadata or {}
        self._force, self._limits = force and path is not None, limits
        self._current: tuple[SplitRecording, BackgroundWriter] | None = None
        self._number = 0  # of the newest file

    @property
    def path(self) -> Path | None:
        """Path of the current file, or None."""
        return self._current and self._current[0].path

    def state(self) -> tuple[str, str]:
        """Return what is recorded, and why the recording ended by itself; each may be empty."""
        if self._current is None:
            return "", ""
        recording, writer = self._current
        if writer.failure:
            return "", f"ended: {writer.failure}"
        return f"to {recording.path}, {writer.readings} readings", ""

    def start(self) -> str:
        """Open the next file, and return a line that names it.

        Raises:
            InputError: a recording is active already, or the file exists or cannot be written.
            MissingDependencyError: the package that writes it is not installed.
        """
        if self._current is not None and not self._current[1].failure:
            raise InputError(f"recording to {self.path} is already active")
        self.close()
        recording = SplitRecording(self._open_next, self._limits, self._log)
        self._current = recording, BackgroundWriter(recording, str(recording.path), self._log)
        return f"recording to {recording.path}"

    def _open_next(self) -> tuple[Path, RecordingFile]:
        number, path = self._number + 1, self._path
        while number > 1 and (path := part_path(self._path, number)).exists():
            number += 1
        file = open_recording_file(path, self._model, self._force and number == 1, self._metadata)
        self._number = number
        return path, file

    def stop(self) -> str:
        """Close the file, and return a line that names it.

        Raises:
            InputError: no recording is active.
        """
        if self._current is None:
            raise InputError("no recording is active")
        (recording, writer), self._current = self._current, None
        writer.close()
        first = recording.first_path
        files = f"{recording.path}" if first == recording.path else f"{first} ... {recording.path.name}"
        early = f"; it ended early: {writer.failure}" if writer.failure else ""
        return f"recorded {writer.readings} readings to {files}{early}"

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
        """Close the current file, if any, and report it."""
        if self._current is not None:
            self._log(self.stop())
