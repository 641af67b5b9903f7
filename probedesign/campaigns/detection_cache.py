"""What an interrupted search has found already: a line for each photograph, in a file beside `pixels.csv`."""

import hashlib
import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from probedesign.campaigns.pixels_table import FILE
from probedesign.errors import InputError
from probedesign.frames import Array
from probedesign.vision.dots import Dot
from probedesign.vision.finder import Found
from probedesign.vision.marker_sequence import Side

NAME = f"{FILE}.unfinished"
FINDER = 1
"""Counts up when the finder finds otherwise: then nothing that was kept holds."""


def key_of(photograph: Path, s: Array, base: Array | Side, dark: bool | None) -> str:
    """Of what a search depends on: the photograph's content and all that was asked.

    Raises:
        InputError: the photograph cannot be read.
    """
    try:
        with photograph.open("rb") as file:
            content = hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise InputError(f"{photograph}: cannot be read: {error.strerror}") from None
    asked = json.dumps([FINDER, content, s.tolist(), np.asarray(base).tolist(), dark])
    return hashlib.sha256(asked.encode()).hexdigest()


@dataclass
class Kept:
    """Photographs that are done.

    Attributes:
        folder: of the campaign.
        used: how many were not looked at again.
    """

    folder: Path
    used: int = 0
    _done: dict[str, Found] = field(init=False)

    def __post_init__(self) -> None:
        """Read what stands there; a line that ends early, or is no photograph's, is passed over."""
        try:
            lines = self.path.read_text(encoding="utf-8").splitlines()
        except (OSError, ValueError):
            lines = []
        self._done = dict(pair for line in lines if (pair := _read(line)))

    @property
    def path(self) -> Path:
        """Of the file."""
        return self.folder / NAME

    def get(self, key: str) -> Found | None:
        """What was found, None if it was not looked for."""
        found = self._done.get(key)
        self.used += found is not None
        return found

    def add(self, key: str, found: Found) -> None:
        """Keep what was found, at once.

        Raises:
            InputError: the folder cannot be written to.
        """
        dots = [[*dot.pixel, dot.std_px, *dot.shape.ravel()] for dot in found.dots]
        line = json.dumps({"key": key, "dark": found.dark, "dots": dots})
        try:
            with self.path.open("a", encoding="utf-8") as file:
                file.write(f"\n{line}\n")  # after a line that ended early, too
        except OSError as error:
            raise InputError(f"{self.path}: cannot be written: {error.strerror}") from None
        self._done[key] = found

    def remove(self) -> None:
        """All is done: take the file away."""
        self.path.unlink(missing_ok=True)

    def __len__(self) -> int:
        """How many are done."""
        return len(self._done)


def _read(line: str) -> tuple[str, Found] | None:
    try:
        told: dict[str, Any] = json.loads(line)
        rows = np.array(told["dots"], dtype=float)
        if rows.ndim != 2 or rows.shape[1] != 7 or not np.isfinite(rows).all():
            return None
        dots = tuple(Dot(row[:2], float(row[2]), row[3:].reshape(2, 2)) for row in rows)
        return str(told["key"]), Found(rows[:, :2], rows[:, 2], dots, bool(told["dark"]))
    except (ValueError, TypeError, KeyError):
        return None
