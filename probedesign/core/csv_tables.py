"""The lines of a table in a text file: header, rows and comments. Nothing of numbers yet."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NoReturn

from probedesign.errors import InputError

Frame = Literal["sensor", "base"]


@dataclass(frozen=True)
class TextTable:
    """The lines of a text file that hold something.

    Attributes:
        path: of the file.
        header: names of the columns.
        header_number: line of the file that holds them.
        rows: the lines after it.
        numbers: line of the file of each row.
        ends_whole: whether the file ends in a newline.
        comments: lines that begin with #, each with its line of the file.
    """

    path: Path
    header: list[str]
    header_number: int
    rows: list[str]
    numbers: list[int]
    ends_whole: bool
    comments: list[tuple[int, str]]

    def fail(self, number: int, problem: str) -> NoReturn:
        """Raise the error of one line of the file."""
        raise InputError(f"{self.path}:{number}: {problem}")

    @property
    def frame(self) -> Frame:
        """The frame that a comment `# frame: ...` names; the sensor's own if none does.

        Raises:
            InputError: a comment names another, or two.
        """
        return _frame(self.path, self.comments) or "sensor"

    @property
    def names_frame(self) -> bool:
        """Whether a comment does."""
        return _frame(self.path, self.comments) is not None


def read_table(path: Path, what: str, like: str, most_bytes: int | None = None) -> TextTable:
    """Header, rows and comments of a file, without blank lines.

    Args:
        path: of a text file in UTF-8.
        what: it is called in messages.
        like: the header that an empty file is told to start with.
        most_bytes: a larger file is refused; None takes any.

    Raises:
        InputError: the file cannot be read, is no text, is empty or too large.
    """
    text = read_text(path, what, most_bytes)
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    held = [(i, line) for i, line in enumerate(lines, 1) if line and not line.isspace()]
    comments = [(i, line) for i, line in held if line.lstrip().startswith("#")]
    if comments:
        held = [(i, line) for i, line in held if not line.lstrip().startswith("#")]
    if not held:
        raise InputError(f"{path}: is empty; a {what} starts with the header {like}")
    header_number, header = held[0]
    names = [name.strip().strip("\"'").strip() for name in header.split(",")]
    rows, numbers = [line for _, line in held[1:]], [i for i, _ in held[1:]]
    return TextTable(path, names, header_number, rows, numbers, text.endswith(("\n", "\r")), comments)


def shown(text: str) -> str:
    """A piece of the file as it may stand in a message: quoted, escaped, never long."""
    quoted = repr(text)
    return quoted if len(quoted) <= 40 else quoted[:37] + "..."


def plain(text: str, most: int = 100) -> str:
    """A piece of a file as it may stand in a sentence: nothing that a terminal obeys, never long."""
    return "".join(c for c in text[:most] if c.isprintable())


def read_text(path: Path, what: str, most_bytes: int | None = None, kind: str = "CSV") -> str:
    """The text of a file; for the arguments see `read_table`, `kind` is what it should be.

    Raises:
        InputError: it cannot be read, is no text in UTF-8, or too large.
    """
    try:
        if most_bytes is not None and path.stat().st_size > most_bytes:
            raise InputError(f"{path}: is larger than {most_bytes / 1e6:g} MB, far too large for a {what}")
        text = path.read_bytes().decode("utf-8-sig")
    except FileNotFoundError:
        raise InputError(f"{path}: no such {what}") from None
    except UnicodeDecodeError:
        raise InputError(f"{path}: is not a text file in UTF-8; a {what} is {kind}") from None
    except InputError:
        raise
    except (OSError, ValueError) as error:  # ValueError: a NUL in the path
        raise InputError(f"{path}: cannot be read: {getattr(error, 'strerror', error)}") from None
    if "\0" in text:
        raise InputError(f"{path}: is a binary file; a {what} is {kind}")
    return text


def _frame(path: Path, comments: list[tuple[int, str]]) -> Frame | None:
    frames: set[Frame] = set()
    for number, line in comments:
        said = re.match(r"\s*#\s*frame\s*[:=](.*)", line, re.IGNORECASE)
        if not said:
            continue
        match said.group(1).strip().lower():
            case "sensor":
                frames.add("sensor")
            case "base":
                frames.add("base")
            case other:
                raise InputError(f"{path}:{number}: frame {shown(other)} is not known; say sensor or base")
    if len(frames) > 1:
        raise InputError(f"{path}: names two frames; a recording has one")
    return frames.pop() if frames else None
