"""Files: written whole or not at all, never over a file that nobody asked to replace, and read within bounds."""

import os
import re
import secrets
import shutil
import stat
import tempfile
import tomllib
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from itertools import count
from pathlib import Path
from typing import Any

from probedesign.core.errors import InputError


def check_writable(path: Path) -> None:
    """Refuse a file that could not be written; call it before a long computation. No folder is made.

    Raises:
        InputError: its folder, or the nearest one that exists, is not writable.
    """
    _write_into(path.parent, path)


def _write_into(folder: Path, target: Path) -> None:
    start = folder.absolute()
    existing = next(place for place in (start, *start.parents) if place.exists())
    try:
        tempfile.TemporaryFile(dir=existing).close()
    except OSError as error:
        raise InputError(f"{target}: cannot be written: {error.strerror}") from None


def write_atomically(
    path: Path,
    content: bytes,
    *,
    replace: bool = True,
    check: Callable[[Path], None] | None = None,
    durable: bool = True,
) -> None:
    """Write a temporary file beside the target, flush it to the disk and rename it over the target.

    The target is the former file or the whole new one at all times, also after a power failure. Its permissions are
    those of any new file of the user (0666 without the umask).

    Args:
        path: of the file; missing folders are made.
        content: of the file.
        replace: replace a file that exists.
        check: is called with the temporary file before the rename; what it raises leaves the target as it was.
        durable: wait until the disk has it. Without, a power failure may damage it: for what is checked when it is
            read, and can be made again.

    Raises:
        InputError: the file exists and must not be replaced, or it cannot be written.
    """
    temporary = path.parent / f".{path.name}.{secrets.token_hex(4)}"
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            with temporary.open("xb") as file:
                file.write(content)
                if durable:
                    file.flush()
                    os.fsync(file.fileno())
            if check is not None:
                check(temporary)
            if not replace:  # created in one step, so that no other process can create it in between
                try:
                    path.open("x").close()
                except FileExistsError:
                    raise exists_already(path) from None
            os.replace(temporary, path)
        finally:
            temporary.unlink(missing_ok=True)
        if durable:
            with suppress(OSError):  # the entry of the renamed file; Windows does not allow it
                handle = os.open(path.parent, os.O_RDONLY)
                try:
                    os.fsync(handle)
                finally:
                    os.close(handle)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from None


@contextmanager
def replaced_folder(folder: Path) -> Iterator[Path]:
    """Yield an empty folder that takes the place of `folder` at the end of the block; nothing changes where it fails.

    Raises:
        InputError: it cannot be written.
    """
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        draft = Path(tempfile.mkdtemp(dir=folder.parent, prefix=f".{folder.name}."))
        try:
            yield draft
            os.chmod(draft, 0o755)
            old = draft.with_name(f"{draft.name}.old") if folder.exists() else None
            if old is not None:
                os.replace(folder, old)
            os.replace(draft, folder)
            if old is not None:
                shutil.rmtree(old, ignore_errors=True)
        finally:
            shutil.rmtree(draft, ignore_errors=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be written: {error.strerror}") from None


def backup(path: Path) -> Path | None:
    """Copy a file that is about to be replaced to NAME.old, or to NAME.old2 and so on where that exists.

    Returns:
        The copy, beside the file; None if there is no such file.

    Raises:
        InputError: the file cannot be read, or the folder is not writable.
    """
    if not path.is_file():
        return None
    try:
        content = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    names = (f"{path.name}.old{'' if i == 1 else i}" for i in count(1))
    copy = next(beside for name in names if not os.path.lexists(beside := path.with_name(name)))
    write_atomically(copy, content)
    return copy


def check_folder(folder: Path) -> None:
    """Refuse a folder that could not be made or written to; call it before a long computation.

    Raises:
        InputError: it is a file, or it is not writable.
    """
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: is a file; name a folder")
    _write_into(folder, folder)


#: Folder of the written files, with a folder for each design, in a project; see `exports_of`.
EXPORTS = Path("exports")
EXPORTS_VARIABLE = "PROBEDESIGN_EXPORTS"  #: Environment variable that names another folder for all designs.


def chosen_exports() -> Path | None:
    """Return the folder for the files of all designs that the environment names, None without one."""
    chosen = os.environ.get(EXPORTS_VARIABLE)
    return Path(chosen).expanduser() if chosen else None


def exports_of(design: Path | None = None) -> Path:
    """Return the default folder of the files of a design: `exports` of its project, unless the environment names one.

    A project is the folder that contains `designs`. Within it, all commands have one folder, wherever they are called;
    elsewhere it is that of the working directory.

    Args:
        design: the design file; None for files that belong to none, which go to the project of the working directory.
    """
    chosen = chosen_exports()
    if chosen is not None:
        return chosen
    here = Path.cwd()
    if design is None:
        projects = (folder for folder in (here, *here.parents) if any(folder.glob("designs/*.toml")))
        project = next(projects, here)
    else:
        folder = Path(os.path.abspath(design)).parent
        project = folder.parent if folder.name == "designs" and here.is_relative_to(folder.parent) else here
    return EXPORTS if project == here else Path(os.path.relpath(project / EXPORTS))


#: Names of designs and probes, which become names of files.
PLAIN_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")


def is_plain_name(name: str) -> bool:
    """Return whether a name is that of a file in the same folder, without an extension of its own."""
    return bool(PLAIN_NAME.fullmatch(name)) and not name.endswith((".", ".toml"))


def check_regular(path: Path) -> None:
    """Refuse a path that is a device, a pipe or a socket: reading it may not end. A missing path is accepted.

    Raises:
        InputError: it is one of these.
    """
    try:
        mode = path.stat().st_mode
    except (OSError, ValueError):
        return  # the reader reports the reason
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        raise InputError(f"{path}: is a device, pipe or socket; name a file")


MAX_TOML = 1_000_000  #: Maximum length of a file of TOML [characters].
#: A key of more than 32 parts with dots. `tomllib` takes memory with the square of their number.
_DEEP_KEY = re.compile(r"""(?<![\w-])(?:(?:[\w-]++|"[^"\n]*"|'[^'\n]*')[ \t]*\.[ \t]*){32}""")


def parse_bounded_toml(text: str) -> dict[str, Any]:
    """Return the tables of a text in TOML, within a second and 100 MB whatever it contains.

    Raises:
        ValueError: it is not TOML, or is too large.
    """
    if len(text) > MAX_TOML:
        raise ValueError(f"more than {MAX_TOML / 1e6:g} MB")
    if _DEEP_KEY.search(text):
        raise ValueError("a key has more than 32 parts")
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise ValueError("it is nested too deeply") from None


def file_in(path: Path, pattern: str, what: str) -> Path:
    """Return the file that a path means: itself, or the one file of a folder that matches a pattern.

    Raises:
        InputError: the folder has no such file, or several.
    """
    if not path.is_dir():
        return path
    found = sorted(path.glob(pattern))
    if len(found) != 1:
        names = ", ".join(file.name for file in found[:5])
        raise InputError(f"{path}: is a folder with {f'several: {names}' if found else f'no {what}'}; give the file")
    return found[0]


def check_overwrite(path: Path, force: bool) -> None:
    """Check that a file or folder may be written: it does not exist, or its replacement was requested.

    Raises:
        InputError: it exists and `force` is not set.
    """
    if path.exists() and not force:
        raise exists_already(path)


def check_replaceable(folder: Path, key: str, what: str, force: bool) -> None:
    """Check that a folder may be written: there is none, or it is empty, or one of its kind that `force` replaces.

    Args:
        folder: to write.
        key: name of a file that shows the kind of folder.
        what: name of the kind in messages.
        force: replacing it was requested.

    Raises:
        InputError: it is another folder or a file, or `force` is not set.
    """
    if folder.is_dir() and not any(folder.iterdir()):
        return
    if folder.exists() and not (folder / key).is_file():
        raise InputError(f"{folder}: has no {key}, so it is not a {what} and is not replaced; name another folder")
    check_overwrite(folder, force)


def exists_already(path: Path) -> InputError:
    """Return the error for a file or folder that is not replaced without --force."""
    return InputError(f"{path}: exists already; --force replaces it, or choose another name")
