"""A recording in, one estimate a row out."""

import math
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from probedesign.errors import InputError
from probedesign.estimation.estimator import Estimator, Method
from probedesign.live.processing.blocks import Reading, averaged
from probedesign.live.processing.estimates import COLUMNS, Row, csv_line, estimate_row, locate
from probedesign.live.processing.tare import Tare, Window, describe_tare, split, take_tare
from probedesign.live.recordings.csv import gaps_in
from probedesign.live.run import count_results
from probedesign.live.sources.replay import Choice, Recorded, open_recording

Progress = Callable[[list[Reading]], Iterable[Reading]]


@dataclass(frozen=True)
class Estimates:
    """What `estimate` found in a recording.

    Attributes:
        estimator: that found it.
        recorded: that it was found in.
        readings: that it holds.
        missing_samples: how many would have filled its gaps.
        samples: how many readings were averaged to one.
        tare: taken from every reading, if one was asked for.
        rows: one for each reading or mean.
        notes: what a user should know of all that, each one line.
        method: by which the readings were located.
    """

    estimator: Estimator
    recorded: Recorded
    readings: int
    missing_samples: int
    samples: int
    tare: Tare | None
    rows: list[Row]
    notes: tuple[str, ...]
    method: Method = "ml"

    @property
    def counts(self) -> dict[str, int]:
        """How many rows have each result."""
        return count_results(str(estimate_row["result"]) for estimate_row in self.rows)

    def csv(self) -> str:
        """The rows as CSV with a header."""
        return ",".join(COLUMNS) + "\n" + "".join(map(csv_line, self.rows))

    def document(self) -> dict[str, Any]:
        """Everything, for JSON."""
        model, tare = self.estimator.model, self.tare
        return {
            "probe": model.name,
            "fingerprint": model.fingerprint,
            "assumptions": model.assumptions,
            "recording": self.recorded.path,
            "frame": self.recorded.frame,
            "readings": self.readings,
            "missing_samples": self.missing_samples,
            "average": self.samples,
            "noise_force_N": model.noise.force,
            "noise_moment_Nm": model.noise.moment,
            "method": self.method,
            "friction": str(model.friction) if math.isinf(model.friction) else model.friction,
            "tolerances": asdict(self.estimator.priors),
            "tare": tare and {
                "start_s": tare.window.start,
                "end_s": tare.window.end,
                "readings": tare.readings,
                "bias_force_N": tare.bias_sensor[:3],
                "bias_moment_Nm": tare.bias_sensor[3:],
            },
            "notes": self.notes,
            "counts": self.counts,
            "estimates": self.rows,
        }  # fmt: skip


def estimate_recording(
    estimator: Estimator,
    path: Path,
    window: Window | None = None,
    samples: int = 1,
    progress: Progress = iter,
    mend: bool = False,
    choice: Choice | None = None,
    method: Method = "ml",
) -> Estimates:
    """Locate the contacts of a recording.

    Args:
        estimator: of the probe it was recorded with.
        path: of the recording.
        window: when the probe is free, for the tare; None takes none.
        samples: how many readings are averaged to one.
        progress: is handed the readings and hands them on one by one.
        mend: go on with a recording that lacks something: lines of a CSV, the end of a file.
        choice: what of a bag is read.
        method: as in `Estimator.estimate`.

    Raises:
        InputError: the recording or the tare's window is no good.
    """
    if samples < 1:
        raise InputError(f"--average {samples} must be positive")
    recorded = open_recording(path, estimator.model, choice)
    blocks = list(recorded.blocks())
    if (lacking := recorded.lacking()) and not mend:
        raise InputError(f"{path}: {'; '.join(lacking)}; --mend goes on without what is missing")
    time = np.concatenate([np.empty(0), *(block.time for block in blocks)])
    readings = list(averaged(blocks, samples))
    if not readings:
        raise InputError(f"{path}: holds {len(time)} readings, fewer than --average {samples}")
    tare = take_tare(split(readings, window)[0], window, estimator) if window is not None else None
    rows = [estimate_row(reading, locate(estimator, reading, tare, method)) for reading in progress(readings)]
    gaps, missing = gaps_in(time)
    gap = (f"{missing} samples are missing in {gaps} gaps",) if gaps else ()
    notes = (*dict.fromkeys((*recorded.notes, *lacking, *gap)), *_notes(len(time), samples, tare))
    return Estimates(estimator, recorded, len(time), missing, samples, tare, rows, notes, method)


def _notes(readings: int, samples: int, tare: Tare | None) -> tuple[str, ...]:
    """What averaging and tare did."""
    notes = []
    if samples > 1:
        left = f"; {readings % samples} readings at the end fill none" if readings % samples else ""
        notes.append(f"each estimate is of the mean of {samples} readings{left}")
    if tare is not None:
        notes.append(describe_tare(tare))
    return tuple(notes)
