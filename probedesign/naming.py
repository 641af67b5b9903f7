"""Names that are looked up in a table: what to say when there is none of that name."""

import difflib
from collections.abc import Iterable

from probedesign.errors import InputError


def unknown(key: str, name: str, known: Iterable[str], of: str = "") -> InputError:
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
