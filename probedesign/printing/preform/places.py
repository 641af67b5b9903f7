"""Paths that two machines mean: PreForm reads and writes files on its own disk."""

import os
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePath, PurePosixPath, PureWindowsPath

from probedesign.design_problems import quoted
from probedesign.errors import InputError
from probedesign.printing.preform.connection import PreFormError


@dataclass(frozen=True)
class Places:
    """The export folder, here and as PreForm's machine names it.

    Attributes:
        folder: here, absolute.
        there: the same folder there; None on this machine.
    """

    folder: Path
    there: PurePath | None = None

    def model(self, path: Path) -> str:
        """A file of the export, as PreForm must be told it."""
        return str(path if self.there is None else self.there / path.name)

    @contextmanager
    def written(self, target: str) -> Iterator[str]:
        """Where PreForm is to write a file: on this machine aside, to be put in place when it is whole.

        Raises:
            PreFormError: PreForm says that it wrote the file, and it is not there.
        """
        if self.there is not None:
            yield str(self.there / target)
            return
        path = Path(os.path.abspath(self.folder / target))
        aside = path.with_name(f".{path.stem}.{uuid.uuid4().hex[:8]}{path.suffix}")
        try:
            yield str(aside)
            if not aside.is_file() or aside.stat().st_size == 0:
                raise PreFormError(
                    f"{path}: PreForm says that it wrote it, and it is not here; if PreForm runs elsewhere, "
                    "--server-folder names the export folder there"
                )
            os.replace(aside, path)
        except OSError as error:
            raise InputError(f"{path}: cannot be written: {error.strerror}") from None
        finally:
            aside.unlink(missing_ok=True)

    def shown(self, target: str) -> str:
        """The same, for people."""
        return str(self.folder / target) if self.there is None else str(self.there / target)


def places_of(folder: Path, server_folder: str | None, local: bool, url: str) -> Places:
    """Where the files are for both.

    Args:
        folder: of the export, here.
        server_folder: the same folder as PreForm's machine names it, if given.
        local: whether PreForm runs here.
        url: of PreForm, for the error.

    Raises:
        InputError: PreForm runs elsewhere and no folder there is named, or one that is not absolute.
    """
    folder = Path(os.path.abspath(folder))
    if server_folder is None:
        if local:
            return Places(folder)
        raise InputError(
            f"--preform {url}: PreForm there reads files on its own disk; --server-folder names the folder there "
            f"that holds the files of {folder} (shared or copied)"
        )
    for kind in (PureWindowsPath, PurePosixPath):
        if kind(server_folder).is_absolute():
            return Places(folder, kind(server_folder))
    raise InputError(f"--server-folder {quoted(server_folder)} is not a full path, such as C:\\probes\\large")


def check_form_file(file: str, places: Places, force: bool) -> str:
    """The file that `--save-form` names, fit to be written.

    Returns:
        The path that `Places.written` takes.

    Raises:
        InputError: it does not end in .form, its folder is missing, or it is there and `force` is not given.
    """
    if not file.endswith(".form") or not file.isprintable():
        raise InputError(f"--save-form {quoted(file)}: PreForm's files end in .form")
    if places.there is not None:
        return file
    path = Path(os.path.abspath(file))
    if not path.parent.is_dir():
        raise InputError(f"--save-form {path}: there is no folder {path.parent}")
    if path.exists() and not (force and path.is_file()):
        raise InputError(f"--save-form {path}: exists already; --force replaces it, or name another file")
    return str(path)
