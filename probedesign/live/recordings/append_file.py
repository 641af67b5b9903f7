"""A file that grows by whole pieces, so that whatever ends the program or fills the disk cuts no piece in two."""

import os
from pathlib import Path

from probedesign.errors import InputError


class Pieces:
    """What is written waits for `flush`, which puts it into the file at once or leaves the file as it was."""

    def __init__(self, path: Path, force: bool = False) -> None:
        """Make the file; its folder is made if missing.

        Args:
            path: where.
            force: replace a file that stands there.

        Raises:
            InputError: the file exists and `force` is not said, or it cannot be written.
        """
        flags = os.O_WRONLY | os.O_CREAT | getattr(os, "O_BINARY", 0) | (os.O_TRUNC if force else os.O_EXCL)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = os.open(path, flags, 0o644)
        except FileExistsError:
            raise InputError(f"{path}: exists; say --force to replace it, or name another file") from None
        except OSError as error:
            raise InputError(f"{path}: cannot be written: {error.strerror}") from None
        self._path = path
        self._waiting: list[bytes] = []
        self._held = self._written = 0

    def write(self, data: bytes) -> int:
        """Take bytes for the next `flush`."""
        self._waiting.append(data)
        self._held += len(data)
        return len(data)

    def tell(self) -> int:
        """Where the next byte will stand."""
        return self._written + self._held

    def flush(self) -> None:
        """Hand what waits to the operating system.

        Raises:
            OSError: it takes it not, or not all; the file ends where it ended before.
        """
        rest = memoryview(b"".join(self._waiting))
        try:
            while rest:
                rest = rest[os.write(self._file, rest) :]
        except OSError:
            os.ftruncate(self._file, self._written)
            raise
        self._written += self._held
        self._waiting, self._held = [], 0

    def close(self) -> None:
        """Close the file; what was not flushed is not in it."""
        os.close(self._file)

    def abandon(self) -> None:
        """Close the file and take it away: nothing of it is any good."""
        self.close()
        self._path.unlink(missing_ok=True)
