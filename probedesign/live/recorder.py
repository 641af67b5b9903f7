"""Writing recordings, at once or line by line as the sensor reads."""

from pathlib import Path
from types import TracebackType
from typing import Literal, TextIO

import numpy as np
from numpy.typing import ArrayLike

from probedesign.core.csv_tables import Frame
from probedesign.errors import InputError
from probedesign.live.recording_columns import GRAVITY_HEADER, HEADER


class Recorder:
    """A recording that grows by whole lines, so that whatever ends the program leaves a readable file.

    Use it as a context manager.
    """

    def __init__(
        self, path: str | Path, *, frame: Frame = "sensor", gravity: bool = True, force: bool = False
    ) -> None:
        """Open the file and write its header.

        Args:
            path: where; its folder is made if missing.
            frame: of the wrenches, "sensor" or "base".
            gravity: whether every line ends in the vector of gravity.
            force: replace a file that stands there.

        Raises:
            InputError: the file exists and `force` is not said, or it cannot be written.
        """
        header = f"{HEADER},{GRAVITY_HEADER}" if gravity else HEADER
        self._file = _open(Path(path), "w" if force else "x")
        self._file.write(f"# frame: {frame}\n{header}\n")

    def write(self, time: float, wrench: ArrayLike, gravity_base: ArrayLike = ()) -> None:
        """Add a line.

        Args:
            time: [s].
            wrench: [N, N·m], (6,).
            gravity_base: vector of gravity in base axes [m/s²], (3,), if the recording holds it.
        """
        values = np.concatenate([[time], wrench, gravity_base]).tolist()
        self._file.write(",".join(map(repr, values)) + "\n")

    def __enter__(self) -> "Recorder":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.close()


def write_recording(
    path: str | Path,
    time: ArrayLike,
    wrench: ArrayLike,
    frame: Frame = "sensor",
    gravity_base: ArrayLike | None = None,
) -> None:
    """Write a recording that reads back exactly; a file that stands there is replaced.

    Args:
        path: where.
        time: of each sample [s], (n,).
        wrench: [N, N·m], (n, 6), in the axes of `frame`.
        frame: "sensor" or "base".
        gravity_base: vector of gravity in base axes [m/s²], (n, 3).

    Raises:
        InputError: the file cannot be written.
        ValueError: the arrays do not fit together.
    """
    times = np.asarray(time, dtype=float).reshape(-1)
    wrenches = np.asarray(wrench, dtype=float).reshape(-1, 6)
    shape = (-1, 3) if gravity_base is not None else (len(times), 0)
    gravities = np.asarray(() if gravity_base is None else gravity_base, dtype=float).reshape(shape)
    lines = list(zip(times, wrenches, gravities, strict=True))
    with Recorder(path, frame=frame, gravity=gravity_base is not None, force=True) as recorder:
        for line in lines:
            recorder.write(*line)


def _open(path: Path, mode: Literal["w", "x"]) -> TextIO:
    """The file, buffered by lines."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        return path.open(mode, encoding="utf-8", newline="\n", buffering=1)
    except FileExistsError:
        raise InputError(f"{path}: exists; say --force to replace it, or name another file") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from None
