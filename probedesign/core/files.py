"""Writing files so that nobody ever finds half of one."""

import os
import tempfile
from itertools import count
from pathlib import Path

from probedesign.core.errors import InputError


def check_writable(path: Path) -> None:
    """Refuse early what could not be written in the end; folders that are missing are made only then.

    Raises:
        InputError: no folder, or none that may be written to.
    """
    folder = next(parent for parent in path.absolute().parents if parent.exists())
    try:
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from None


def write_atomically(path: Path, content: bytes) -> None:
    """Write aside, then rename: the file is the old one or the whole new one at every moment.

    Args:
        path: its folder is made if missing.
        content: of the file.

    Raises:
        InputError: the folder cannot be written to.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, aside = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from None
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content)
        os.chmod(aside, 0o644)
        os.replace(aside, path)
    except OSError as error:
        os.unlink(aside)
        raise InputError(f"{path}: cannot be written: {error.strerror}") from None
    except BaseException:
        os.unlink(aside)
        raise


def backup(path: Path) -> Path | None:
    """Keep a file that is about to be replaced: as NAME.old, or NAME.old2 and so on where that is taken.

    Args:
        path: of the file.

    Returns:
        Where its content stands now, beside it; None if there is no such file.

    Raises:
        InputError: it cannot be read, or the folder cannot be written to.
    """
    if not path.is_file():
        return None
    try:
        content = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    names = (f"{path.name}.old{'' if i == 1 else i}" for i in count(1))
    kept = next(aside for name in names if not os.path.lexists(aside := path.with_name(name)))
    write_atomically(kept, content)
    return kept


def check_overwrite(path: Path, force: bool) -> None:
    """Check that a file or folder may be written: it does not exist, or its replacement was requested.

    Raises:
        InputError: it exists and `force` is not set.
    """
    if path.exists() and not force:
        raise exists_already(path)


def exists_already(path: Path) -> InputError:
    """Return the error for a file or folder that is not replaced without --force."""
    return InputError(f"{path}: exists already; --force replaces it, or choose another name")
