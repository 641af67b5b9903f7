"""Estimates contacts from a recording, one row per reading."""

import math
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from probedesign.core.errors import InputError
from probedesign.estimation.estimator import Estimator, Method
from probedesign.live.processing.blocks import WrenchReading, averaged
from probedesign.live.processing.estimates import COLUMNS, Row, csv_line, estimate_row, locate
from probedesign.live.processing.tare import Tare, TareWindow, describe_tare, split_at_tare, take_tare
from probedesign.live.recordings.csv import gaps_in
from probedesign.live.run import count_results
from probedesign.live.sources.replay import OpenRecording, RecordingOptions, open_recording

Progress = Callable[[list[WrenchReading]], Iterable[WrenchReading]]


@dataclass(frozen=True)
class RecordingEstimates:
    """Estimates of a recording.

    Attributes:
        estimator: estimator used.
        recorded: the recording.
        readings: number of readings in it.
        missing_samples: number of samples missing in its gaps.
        samples: number of readings averaged to one.
        tare: bias subtracted from every reading, if a tare was requested.
        rows: one row per reading or mean.
        notes: notes for the user, one line each.
        method: method by which the readings were located.
    """

    estimator: Estimator
    recording: OpenRecording
    readings: int
    missing_samples: int
    samples: int
    tare: Tare | None
    rows: list[Row]
    notes: tuple[str, ...]
    method: Method = "ml"

    @property
    def counts(self) -> dict[str, int]:
        """Number of rows with each result."""
        return count_results(str(row["result"]) for row in self.rows)

    def csv(self) -> str:
        """Return the rows as CSV with a header."""
        return ",".join(COLUMNS) + "\n" + "".join(map(csv_line, self.rows))

    def document(self) -> dict[str, Any]:
        """Return everything as one JSON document."""
        model, tare = self.estimator.model, self.tare
        return {
            "probe": model.name,
            "fingerprint": model.fingerprint,
            "assumptions": model.assumptions,
            "recording": self.recording.path,
            "frame": self.recording.frame,
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
    window: TareWindow | None = None,
    samples: int = 1,
    progress: Progress = iter,
    allow_incomplete: bool = False,
    options: RecordingOptions | None = None,
    method: Method = "ml",
) -> RecordingEstimates:
    """Locate the contacts of a recording.

    Args:
        estimator: estimator of the recorded probe.
        path: path of the recording.
        window: window of the tare, in which the probe is free; None takes no tare.
        samples: number of readings averaged to one.
        progress: receives the readings and passes them on one by one.
        allow_incomplete: accept an incomplete recording: dropped lines of CSV, a truncated file.
        options: what to read of a bag.
        method: see `Estimator.estimate`.

    Raises:
        InputError: the recording or the tare window cannot be used.
    """
    if samples < 1:
        raise InputError(f"--average {samples} must be positive")
    recording = open_recording(path, estimator.model, options)
    blocks = list(recording.blocks())
    if (missing := recording.missing()) and not allow_incomplete:
        raise InputError(f"{path}: {'; '.join(missing)}; use --mend to continue without the missing data")
    time = np.concatenate([np.empty(0), *(block.time for block in blocks)])
    readings = list(averaged(blocks, samples))
    if not readings:
        raise InputError(f"{path}: {len(time)} readings are fewer than --average {samples}")
    tare = take_tare(split_at_tare(readings, window)[0], window, estimator) if window is not None else None
    rows = [estimate_row(reading, locate(estimator, reading, tare, method)) for reading in progress(readings)]
    gaps, lost = gaps_in(time)
    gap = (f"{lost} samples are missing in {gaps} gaps",) if gaps else ()
    notes = (*dict.fromkeys((*recording.notes, *missing, *gap)), *_notes(len(time), samples, tare))
    return RecordingEstimates(estimator, recording, len(time), lost, samples, tare, rows, notes, method)


def _notes(readings: int, samples: int, tare: Tare | None) -> tuple[str, ...]:
    """Return notes on averaging and tare."""
    notes = []
    if samples > 1:
        left = f"; {readings % samples} readings at the end are not used" if readings % samples else ""
        notes.append(f"each estimate uses the mean of {samples} readings{left}")
    if tare is not None:
        notes.append(describe_tare(tare))
    return tuple(notes)
