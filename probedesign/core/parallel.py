"""Parallel work that can be interrupted and resumed: worker processes, SIGINT handling and a journal of results."""

import hashlib
import json
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass
from io import BufferedRandom
from multiprocessing import forkserver
from pathlib import Path
from typing import Any, TypeVar

from probedesign.core.errors import InputError

Record = dict[str, Any]
#: Receives the name of the current step and the completed fraction, None where that is unknown.
OnProgress = Callable[[str, float | None], None]


def quiet(_step: str, _share: float | None) -> None:
    """Show no progress."""


T = TypeVar("T")
R = TypeVar("R")
#: Environment of workers: every core runs a worker, so further threads of the linear algebra compete with them.
_ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}


# Worker processes


def start_method() -> str:
    """Return the start method of worker processes on this platform: forkserver where it exists, else spawn."""
    return "forkserver" if "forkserver" in multiprocessing.get_all_start_methods() else "spawn"


def start_forkserver(preload: Sequence[str]) -> None:
    """Start the fork server early, so that it imports in parallel with the command itself.

    On platforms without a fork server the call has no effect.
    """
    if start_method() != "forkserver":
        return
    multiprocessing.set_forkserver_preload(list(preload))
    before = {name: os.environ.get(name) for name in _ONE_THREAD}
    os.environ.update(_ONE_THREAD)
    # Processes that ignore SIGINT: the parent ends them, and only the parent reports the interruption. Only the main
    # thread may set handlers.
    main = threading.current_thread() is threading.main_thread()
    handler = signal.signal(signal.SIGINT, signal.SIG_IGN) if main else None
    try:
        forkserver.ensure_running()
    finally:
        if main:
            signal.signal(signal.SIGINT, handler)
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


@contextmanager
def defer_sigint() -> Iterator[None]:
    """Defer Ctrl-C until the block has ended."""
    if threading.current_thread() is not threading.main_thread():  # only the main thread receives it
        yield
        return
    asked: list[int] = []
    previous = signal.signal(signal.SIGINT, lambda number, frame: asked.append(number))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, previous)
    if asked:
        raise KeyboardInterrupt


def process_map(
    function: Callable[[T], R],
    items: Iterable[T],
    workers: int | None = None,
    initializer: Callable[..., None] | None = None,
    initargs: tuple[Any, ...] = (),
    preload: Sequence[str] = (),
) -> Iterator[tuple[int, R]]:
    """Apply a function to items in worker processes.

    Args:
        function: picklable.
        items: its arguments.
        workers: number of processes; all available cores if None. With 1 this process does the work, in order.
        initializer: called once in each worker, with `initargs`, before its first item.
        preload: modules that the fork server imports once for all workers.

    Returns:
        Index and result of each item, in the order of completion. An exception, KeyboardInterrupt among them, cancels
        the items that have not begun.
    """
    tasks, count = list(items), workers or len(os.sched_getaffinity(0))
    if not tasks:
        return
    if count == 1:
        if initializer is not None:
            initializer(*initargs)
        yield from enumerate(map(function, tasks))
        return
    context = multiprocessing.get_context(start_method())
    if preload:
        start_forkserver(preload)
    with ProcessPoolExecutor(count, context, _initialize_worker, (initializer, initargs)) as pool:
        try:
            with defer_sigint():  # a worker that starts while this process ends prints a traceback
                futures = {pool.submit(function, task): i for i, task in enumerate(tasks)}
            for future in as_completed(futures):
                yield futures[future], future.result()
        except BaseException:
            pool.shutdown(wait=True, cancel_futures=True)
            raise


def _initialize_worker(initializer: Callable[..., None] | None, initargs: tuple[Any, ...]) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent handles the interruption
    if initializer is not None:
        initializer(*initargs)


# Results on disk


def fingerprint(document: Any) -> str:
    """Return the first twelve hex digits of the SHA-256 hash of plain data."""
    return hashlib.sha256(json.dumps(document, sort_keys=True).encode()).hexdigest()[:12]


@dataclass
class Journal:
    """A file of JSON lines: a header with the request, then one line per result.

    A result is on disk before it counts, so an interrupted run resumes without computing anything twice.
    """

    path: Path  #: of the file.
    request: Record  #: what the results belong to; a file of another request is refused and left unchanged.
    results: dict[int, Record]  #: by the number of their point.
    notes: list[str]  #: repairs made while reading, one sentence each.
    valid_bytes: int  #: length of the part with complete records.

    @classmethod
    def open(cls, path: Path, request: Record) -> "Journal":
        """Read the file, which need not exist.

        Raises:
            InputError: the file cannot be read, or belongs to another request.
        """
        try:
            content = path.read_bytes()
        except FileNotFoundError:
            content = b""
        except OSError as error:
            raise InputError(f"{path}: cannot be read: {error.strerror}") from None
        (records, valid), notes = _complete_records(content, path), list[str]()
        if records and records[0] != request:
            different = [key for key in request if records[0].get(key) != request[key]]
            what = f"other {', '.join(different)}" if different else "of another version"
            raise InputError(f"{path}: contains results of another run ({what}); name another folder with --out")
        if valid < len(content):
            notes.append(f"{path}: an incomplete record at the end was dropped; it is computed again")
        results = {int(record["point"]): record for record in records[1:]}
        return cls(path, request, results, notes, valid)

    @contextmanager
    def appending(self) -> Iterator["JournalWriter"]:
        """Open the file for writing after its last complete record.

        Raises:
            InputError: the file cannot be written.
        """
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            file = self.path.open("r+b" if self.path.exists() else "w+b")
        except OSError as error:
            raise InputError(f"{self.path}: cannot be written: {error.strerror}") from None
        with file:
            file.truncate(self.valid_bytes)
            file.seek(self.valid_bytes)
            writer = JournalWriter(self, file)
            if self.valid_bytes == 0:
                writer.write_line(self.request)
            yield writer


@dataclass
class JournalWriter:
    """A journal that is open for writing."""

    journal: Journal
    file: BufferedRandom

    def add(self, record: Record) -> None:
        """Append one result and flush it to disk."""
        self.write_line(record)
        self.journal.results[int(record["point"])] = record

    def write_line(self, record: Record) -> None:
        """Append one line; its newline comes last, so a reader recognises an incomplete one."""
        self.file.write(json.dumps(record).encode() + b"\n")
        self.file.flush()
        os.fsync(self.file.fileno())
        self.journal.valid_bytes = self.file.tell()


def _complete_records(content: bytes, path: Path) -> tuple[list[Record], int]:
    """Return the records before the first incomplete one, and their length in bytes."""
    records, valid = list[Record](), 0
    for line in content.splitlines(keepends=True):
        try:
            record = json.loads(line)
        except ValueError:
            break
        if not line.endswith(b"\n") or not isinstance(record, dict):
            break
        if records and not isinstance(record.get("point"), int):
            break
        records.append(record)
        valid += len(line)
    left = content[valid:].count(b"\n")
    if left > 1 or (content and not records and left):
        wrong = f"line {len(records) + 1} is not a record of results"
        raise InputError(f"{path}: {wrong}; move the file away, or repair it")
    return records, valid
