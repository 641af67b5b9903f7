"""What commands print: one JSON document or a few lines; progress goes to stderr, and only to a terminal."""

import json
import math
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any


def print_json(document: Any) -> None:
    """Print one JSON document: arrays as lists, dataclasses as tables, what is not finite as null."""
    print(json.dumps(_plain(document), indent=2, ensure_ascii=False, allow_nan=False))


def _plain(value: Any) -> Any:
    """The value in JSON's own types."""
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if is_dataclass(value):
        return {field.name: _plain(getattr(value, field.name)) for field in fields(value)}
    if hasattr(value, "tolist"):  # a numpy array or scalar, told without importing numpy
        return _plain(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return str(value) if isinstance(value, Path) else value


def print_table(rows: dict[str, str]) -> None:
    """Print names and what they are, in two columns."""
    width = max(map(len, rows), default=0)
    for name, text in rows.items():
        print(f"  {name:<{width}}  {text}")


Tell = Callable[[str, float | None], None]


def counted(number: int, what: str) -> str:
    """So many of something, as one says it."""
    return f"{number or 'no'} {what}{'' if number == 1 else 's'}"


@contextmanager
def telling() -> Iterator[Tell]:
    """Say on a terminal which step is at work, with its share done where that is known."""
    if not sys.stderr.isatty():
        yield lambda step, share: None
        return
    from rich.console import Console
    from rich.markup import escape

    with Console(stderr=True).status("") as status:

        def tell(step: str, share: float | None) -> None:
            status.update(escape(f"{step} ..." if share is None else f"{step} {share:.0%}"))

        yield tell


@contextmanager
def working(what: str) -> Iterator[None]:
    """Say on a terminal what takes its time."""
    if not sys.stderr.isatty():
        yield
        return
    from rich.console import Console

    with Console(stderr=True).status(f"{what} ..."):
        yield
