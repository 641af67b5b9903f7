"""Recordings: CSV with raw readings, and MCAP with standard ROS 2 messages in a file that survives a crash."""

import os
import sys
from pathlib import Path

from probedesign.core.errors import InputError, require
from probedesign.core.files import exists_already


def require_mcap() -> None:
    """Check that the package that reads and writes MCAP is installed.

    Raises:
        MissingDependencyError: it is not installed.
    """
    require("mcap", "an MCAP recording", "live")


class AppendFile:
    """Buffers what is written until `flush`, which appends all of it or leaves the file unchanged."""

    def __init__(self, path: Path, force: bool = False) -> None:
        """Create the file, and its folder if necessary, and lock it; `force` replaces an existing file.

        Raises:
            InputError: the file exists and `force` is not set, it is a link, another program writes it, or it cannot
                be written.
        """
        flags = os.O_WRONLY | os.O_CREAT | getattr(os, "O_BINARY", 0) | (0 if force else os.O_EXCL)
        flags |= getattr(os, "O_NOFOLLOW", 0)  # a link that is made between the check and this call
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            if path.is_symlink():
                raise InputError(f"{path}: cannot be written: it is a link to another file; name that file")
            if force and path.exists() and not path.is_file():  # a pipe would block until someone reads it
                raise InputError(f"{path}: cannot be written: it is not a regular file")
            self._file = os.open(path, flags, 0o666)
            if not _lock(self._file):
                os.close(self._file)
                raise InputError(f"{path}: another program is writing this file; choose another name")
            os.ftruncate(self._file, 0)  # only now: the file of another writer is left as it is
        except FileExistsError:
            raise exists_already(path) from None
        except OSError as error:
            raise InputError(f"{path}: cannot be written: {error.strerror}") from None
        self._path = path
        self._pending: list[bytes] = []
        self._pending_size = self._written = 0

    def write(self, data: bytes) -> int:
        """Buffer bytes for the next `flush`; return their number."""
        self._pending.append(data)
        self._pending_size += len(data)
        return len(data)

    def tell(self) -> int:
        """Return the offset of the next byte."""
        return self._written + self._pending_size

    def flush(self) -> None:
        """Pass the buffer to the operating system.

        Raises:
            OSError: it cannot be written completely; the file is unchanged.
        """
        rest = memoryview(b"".join(self._pending))
        try:
            while rest:
                rest = rest[os.write(self._file, rest) :]
        except OSError:
            os.ftruncate(self._file, self._written)
            raise
        self._written += self._pending_size
        self._pending, self._pending_size = [], 0

    def close(self) -> None:
        """Close the file; the buffer is not written."""
        os.close(self._file)

    def discard(self) -> None:
        """Close and delete the file."""
        self.close()
        self._path.unlink(missing_ok=True)


def _lock(file: int) -> bool:
    """Lock an open file against other writers; return False if it is locked already."""
    if sys.platform == "win32":
        return True  # not implemented there
    import fcntl

    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:  # a file system without locks
        return True
    return True
