"""Results as they come, a line each: what was done is never done again, half a line at the end is dropped."""

import hashlib
import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from io import BufferedRandom
from pathlib import Path
from typing import Any

from probedesign.errors import InputError

Record = dict[str, Any]


def fingerprint(document: Any) -> str:
    """Twelve hex digits that stand for plain data."""
    return hashlib.sha256(json.dumps(document, sort_keys=True).encode()).hexdigest()[:12]


@dataclass
class Journal:
    """A file of JSON lines: first what was asked, then a result a line.

    Attributes:
        path: of the file.
        asked: what the results answer; a file that answers something else is not touched.
        results: by the number of their point.
        notes: what was mended on reading.
        whole: bytes that hold whole records.
    """

    path: Path
    asked: Record
    results: dict[int, Record]
    notes: list[str]
    whole: int

    @classmethod
    def open(cls, path: Path, asked: Record) -> "Journal":
        """Read what is there.

        Raises:
            InputError: the file cannot be read, or answers something else.
        """
        try:
            content = path.read_bytes()
        except FileNotFoundError:
            content = b""
        except OSError as error:
            raise InputError(f"{path}: cannot be read: {error.strerror}") from None
        (lines, whole), notes = _records(content, path), list[str]()
        if lines and lines[0] != asked:
            what = _difference(lines[0], asked)
            raise InputError(
                f"{path}: holds results of another sweep ({what}); name another folder with --out"
            )
        if whole < len(content):
            notes.append(
                f"{path}: a half-written record at the end was dropped, and its design is computed again"
            )
        results = {int(line["point"]): line for line in lines[1:]}
        return cls(path, asked, results, notes, whole)

    @contextmanager
    def appending(self) -> Iterator["Appender"]:
        """Write on, after the last whole record.

        Raises:
            InputError: the file cannot be written.
        """
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            file = self.path.open("r+b" if self.path.exists() else "w+b")
        except OSError as error:
            raise InputError(f"{self.path}: cannot be written: {error.strerror}") from None
        with file:
            file.truncate(self.whole)
            file.seek(self.whole)
            appender = Appender(self, file)
            if self.whole == 0:
                appender.line(self.asked)
            yield appender


@dataclass
class Appender:
    """An open journal."""

    journal: Journal
    file: BufferedRandom

    def add(self, record: Record) -> None:
        """One result, on the disk before it counts."""
        self.line(record)
        self.journal.results[int(record["point"])] = record

    def line(self, record: Record) -> None:
        """One line, whole or not at all as far as a reader can tell: the newline comes last."""
        self.file.write(json.dumps(record).encode() + b"\n")
        self.file.flush()
        os.fsync(self.file.fileno())
        self.journal.whole = self.file.tell()


def _records(content: bytes, path: Path) -> tuple[list[Record], int]:
    """The records up to the first that is not whole, and how far they reach."""
    found, whole = list[Record](), 0
    for line in content.splitlines(keepends=True):
        try:
            record = json.loads(line)
        except ValueError:
            break
        if not line.endswith(b"\n") or not isinstance(record, dict):
            break
        if found and not isinstance(record.get("point"), int):
            break
        found.append(record)
        whole += len(line)
    left = content[whole:].count(b"\n")
    if left > 1 or (content and not found and left):
        raise InputError(
            f"{path}: line {len(found) + 1} is no record of a sweep; move the file away, or mend it"
        )
    return found, whole


def _difference(there: Record, asked: Record) -> str:
    keys = [key for key in asked if there.get(key) != asked[key]]
    return f"other {', '.join(keys)}" if keys else "of another version"
