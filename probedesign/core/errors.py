"""What can go wrong at the public door, as types.

Inside, a solve or an estimate returns a result code and never raises. At the door (files, options,
arguments) a wrong value raises an `InputError` whose text is one line: what, where, the remedy.
"""

import difflib
from collections.abc import Iterable


class ProbeDesignError(Exception):
    """Any error this package raises on purpose."""


class InputError(ProbeDesignError, ValueError):
    """A file, option or argument that cannot be used; the text is one line fit for a user."""


class MissingDependencyError(ProbeDesignError, ImportError):
    """An optional package that this step needs is not installed; the text names the extra."""

    @classmethod
    def of_extra(cls, feature: str, package: str, extra: str) -> "MissingDependencyError":
        """Return the error for a missing package of one of this project's extras.

        Args:
            feature: what needs the package.
            package: its name.
            extra: the extra that installs it.
        """
        return cls(f"{feature} needs {package}: pip install 'probedesign[{extra}]'")


class CheckFailedError(ProbeDesignError):
    """A self-check of something this package made itself (a mesh, a solid) did not hold."""


def unknown_name(key: str, name: str, known: Iterable[str], of: str = "") -> InputError:
    """The error for a name that no table knows: one line with the nearest, if one is near, and all of them.

    Args:
        key: of the design file, as `table.key`.
        name: as it was given.
        known: names that would do.
        of: what they belong to, such as a sensor.
    """
    names = sorted(known)
    plain = "-".join(name.lower().replace("_", " ").split())
    near = difflib.get_close_matches(plain, names, 1, 0.3)
    hint = f"did you mean '{near[0]}'? known: " if near else "known: "
    shown = repr(name) if len(name) <= 60 else repr(name[:57]) + "..."
    return InputError(f"{key}: unknown {shown}{f' for {of}' if of else ''}; {hint}{', '.join(names)}")
