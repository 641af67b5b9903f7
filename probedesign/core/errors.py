"""Exceptions of the package.

A solve or an estimate returns a result code and raises nothing. Files, options and arguments that cannot be used raise
an `InputError` with a message of one line: the value, its place and the remedy.
"""

import datetime
import difflib
import traceback
from collections.abc import Iterable
from importlib.util import find_spec
from typing import Any


class ProbeDesignError(Exception):
    """Base of all errors that the package raises on purpose."""


class InputError(ProbeDesignError, ValueError):
    """A file, option or argument cannot be used; the message is one line for the user."""


class MissingDependencyError(ProbeDesignError, ImportError):
    """An optional dependency is not installed; the message names the extra to install."""

    @classmethod
    def of_extra(cls, feature: str, package: str, extra: str) -> "MissingDependencyError":
        """Return the error for a missing package of one of this project's extras."""
        return cls(f"{feature} needs {package}: pip install 'probedesign[{extra}]'")


def require(module: str, feature: str, extra: str, package: str = "") -> None:
    """Check that a module of one of this project's extras is installed, without importing it.

    `package` is the name of its package, if it differs.

    Raises:
        MissingDependencyError: it is not installed.
    """
    if find_spec(module) is None:
        raise MissingDependencyError.of_extra(feature, package or module, extra)


def report_defect(error: Exception) -> str:
    """Print the traceback of an error that nobody expected to standard error, and return one line about it."""
    traceback.print_exception(error)
    text = " ".join(f"{type(error).__name__}: {error}".split())
    return f"{text[:300]} (a defect of probedesign; the terminal shows the details: please report them)"


class CheckFailedError(ProbeDesignError):
    """A check of something that the package made itself, such as a mesh or a file, failed."""


def quoted(value: Any) -> str:
    """Return a value of the user for a message: text in quotes, special characters escaped, at most 60 characters."""
    try:
        text = value.isoformat() if isinstance(value, datetime.date | datetime.time) else repr(value)
    except (RecursionError, ValueError):  # nested thousands deep; an integer of thousands of digits
        return "..."
    return text if len(text) <= 60 else text[:57] + "..."


def one_line(text: str, max_length: int = 500) -> str:
    """Return a text of a user, a file or a peer on one line for a message: control characters escaped, shortened."""
    text = "".join(c if c.isprintable() else repr(c)[1:-1] for c in " ".join(text.split()))
    return text if len(text) <= max_length else text[: max_length - 3] + "..."


def unknown_name(key: str, name: str, known: Iterable[str], of: str = "") -> InputError:
    """Return the error for an unknown name: one line with the nearest known name, if one is near, and all names.

    Args:
        key: of the design file, as `table.key`.
        name: the unknown name.
        known: the known names.
        of: what the names belong to, such as a sensor.
    """
    names = sorted(known)
    plain = "-".join(name.lower().replace("_", " ").split())
    near = difflib.get_close_matches(plain, names, 1, 0.3)
    hint = f"did you mean '{near[0]}'? known: " if near else "known: "
    return InputError(f"{key}: unknown {quoted(name)}{f' for {of}' if of else ''}; {hint}{', '.join(names)}")
