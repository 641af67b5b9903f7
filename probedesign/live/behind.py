"""A sink whose work is done by a thread of its own, so that nobody waits for its disk."""

import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from queue import Empty, SimpleQueue
from typing import Protocol

from probedesign.live.answer import Answer
from probedesign.live.block import Block
from probedesign.live.pose.timed import TimedPose
from probedesign.live.sink import Sink

MOST = 65_536
"""Readings that may wait: nine seconds at the 7000 a second of a Net F/T box, five megabytes."""
EVERY = 0.5
"""How often everything is handed to the disk [s]: what ends the program takes no more than this along, and what
waits."""
GATHERED = 0.05
"""What comes within so long is written in one go [s]: each waking of the thread would interrupt whoever estimates."""
PATIENCE = 30.0
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
        self, file: File, name: str, say: Callable[[str], None], most: int = MOST, every: float = EVERY
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
        self._thread.join(PATIENCE)
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
            time.sleep(GATHERED)
        yield first
        for _ in range(self._queue.qsize()):
            yield self._queue.get_nowait()
