"""Cache of an interrupted marker search: one line per finished photograph, in a file beside `pixels.csv`."""

import hashlib
import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from probedesign.campaigns.cameras import PIXELS
from probedesign.core.errors import InputError
from probedesign.core.frames import Array
from probedesign.vision.dots import Dot
from probedesign.vision.marker_sequence import DetectedMarkers, ImageSide

NAME = f"{PIXELS}.unfinished"
FINDER = 1
"""Version of the detection; a cache of another version is not used."""


def cache_key(photograph: Path, s: Array, base: Array | ImageSide, dark: bool | None) -> str:
    """Return the hash of everything that a detection depends on: the photograph's content and the arguments.

    Raises:
        InputError: the photograph cannot be read.
    """
    try:
        with photograph.open("rb") as file:
            content = hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise InputError(f"{photograph}: cannot be read: {error.strerror}") from None
    arguments = json.dumps([FINDER, content, s.tolist(), np.asarray(base).tolist(), dark])
    return hashlib.sha256(arguments.encode()).hexdigest()


@dataclass
class DetectionCache:
    """Finished photographs of a campaign.

    Attributes:
        folder: of the campaign.
        used: number of results that were taken from the cache.
    """

    folder: Path
    used: int = 0
    _done: dict[str, DetectedMarkers] = field(init=False)

    def __post_init__(self) -> None:
        """Read the file; incomplete and foreign lines are skipped."""
        try:
            lines = self.path.read_text(encoding="utf-8").splitlines()
        except (OSError, ValueError):
            lines = []
        self._done = dict(pair for line in lines if (pair := _parsed(line)))

    @property
    def path(self) -> Path:
        """Path of the file."""
        return self.folder / NAME

    def get(self, key: str) -> DetectedMarkers | None:
        """Return the markers of a finished photograph; None if it is not finished."""
        found = self._done.get(key)
        self.used += found is not None
        return found

    def add(self, key: str, found: DetectedMarkers) -> None:
        """Append the markers of one photograph to the file.

        Raises:
            InputError: the folder cannot be written to.
        """
        dots = [[*dot.pixel, dot.std_px, *dot.shape.ravel()] for dot in found.dots]
        line = json.dumps({"key": key, "dark": found.dark, "dots": dots})
        try:
            with self.path.open("a", encoding="utf-8") as file:
                file.write(f"\n{line}\n")  # the newline in front ends an incomplete line
        except OSError as error:
            raise InputError(f"{self.path}: cannot be written: {error.strerror}") from None
        self._done[key] = found

    def remove(self) -> None:
        """Delete the file."""
        self.path.unlink(missing_ok=True)

    def __len__(self) -> int:
        """Return the number of finished photographs."""
        return len(self._done)


def _parsed(line: str) -> tuple[str, DetectedMarkers] | None:
    try:
        entry: dict[str, Any] = json.loads(line)
        rows = np.array(entry["dots"], dtype=float)
        if rows.ndim != 2 or rows.shape[1] != 7 or not np.isfinite(rows).all():
            return None
        dots = tuple(Dot(row[:2], float(row[2]), row[3:].reshape(2, 2)) for row in rows)
        return str(entry["key"]), DetectedMarkers(rows[:, :2], rows[:, 2], dots, bool(entry["dark"]))
    except (ValueError, TypeError, KeyError):
        return None
