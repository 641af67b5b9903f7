"""Outputs of the commands: results on stdout, notes and progress on stderr, files; and termination signals.

Progress appears only where stderr is a terminal, so that logs and pipes hold results and notes alone.
"""

import json
import math
import signal
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import fields, is_dataclass
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any

from probedesign.core.files import write_atomically

if TYPE_CHECKING:
    from probedesign.core.parallel import OnProgress


def print_json(document: Any) -> None:
    """Print one JSON document: arrays as lists, dataclasses as objects, numbers that are not finite as null."""
    print(json.dumps(_to_json(document), indent=2, ensure_ascii=False, allow_nan=False))


def _to_json(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _to_json(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_to_json(item) for item in value]
    if is_dataclass(value):
        return {field.name: _to_json(getattr(value, field.name)) for field in fields(value)}
    if hasattr(value, "tolist"):  # a numpy array or scalar, recognised without importing numpy
        return _to_json(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return str(value) if isinstance(value, Path) else value


def json_bytes(document: dict[str, Any], ascii_only: bool = True) -> bytes:
    """Return a document as the content of a JSON file, with the types of `print_json`."""
    return (json.dumps(_to_json(document), indent=1, ensure_ascii=ascii_only) + "\n").encode()


def write_files(folder: Path, contents: Iterable[tuple[str, bytes]]) -> list[Path]:
    """Write files of these names and contents to a folder, each as soon as its content is there, and return them."""
    written = []
    for name, content in contents:
        write_atomically(folder / name, content)
        written.append(folder / name)
    return written


def print_table(rows: dict[str, str]) -> None:
    """Print names and their values in two columns."""
    width = max(map(len, rows), default=0)
    for name, text in rows.items():
        print(f"  {name:<{width}}  {text}")


def print_columns(head: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Print a table as wide as its cells, numbers to the right and words to the left.

    Args:
        head: a name of each column; a second line of it, such as a unit, stands below the first.
        rows: cells.
    """
    lines, cells = max(name.count("\n") for name in head) + 1, list(rows)
    heads = zip(*((name.split("\n") + [""] * lines)[:lines] for name in head), strict=True)
    columns = []
    for name, *column in zip([*head], *cells, strict=True):
        numbers = any(cell[:1].isdigit() for cell in column) or not any(cell[:1].isalpha() for cell in column)
        width = max(map(len, (*name.split("\n"), *column)))
        columns.append(f"{'>' if numbers else '<'}{width}")
    for row in (*heads, *cells):
        print("  " + "  ".join(map(format, row, columns)).rstrip())


def plural(number: int, noun: str) -> str:
    """Return a count with its noun: "no errors", "1 error", "2 errors"."""
    return f"{number or 'no'} {noun}{'' if number == 1 else 's'}"


def print_note(note: str) -> None:
    """Print a note on stderr."""
    print(f"note: {note}", file=sys.stderr)


def print_step(step: str) -> None:
    """Print the name of a step on stderr if that is a terminal."""
    if sys.stderr.isatty():
        print(f"{step} ...", file=sys.stderr, flush=True)


@contextmanager
def show_progress(first_step: str = "") -> "Iterator[OnProgress]":
    """Show the current step on a terminal, with the completed fraction where it is known.

    Args:
        first_step: shown until the callback is called.

    Returns:
        Context manager that yields the callback; without a terminal the callback does nothing.
    """
    if not sys.stderr.isatty():
        yield lambda step, fraction: None
        return
    from rich.console import Console
    from rich.markup import escape

    def text_of(step: str, fraction: float | None) -> str:
        return escape(f"{step} ..." if fraction is None else f"{step} {fraction:.0%}")

    with Console(stderr=True).status(text_of(first_step, None) if first_step else "") as status:
        yield lambda step, fraction: status.update(text_of(step, fraction))


@contextmanager
def interrupt_on_termination() -> Iterator[None]:
    """Raise KeyboardInterrupt on SIGTERM and SIGHUP, so that `kill` and a closed terminal end a run as Ctrl-C does.

    Files are closed then. A signal that is ignored, as under nohup, stays ignored. For the main thread only.
    """

    def interrupt(number: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    replaced = {}
    for name in ("SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)  # Windows has no SIGHUP
        if number is not None and signal.getsignal(number) == signal.SIG_DFL:
            replaced[number] = signal.signal(number, interrupt)
    try:
        yield
    finally:
        for number, handler in replaced.items():
            signal.signal(number, handler)
