"""A rehearsal as files: what `explore` reads, and the truth beside it."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from probedesign.errors import InputError
from probedesign.estimation.model import ProbeModel
from probedesign.files import write_atomically
from probedesign.live.poses.pose_file import POSE_COLUMNS
from probedesign.live.recordings.csv import CsvRecorder
from probedesign.live.recordings.mcap_write import McapRecorder
from probedesign.simulation.card_house import SOURCE
from probedesign.simulation.simulated_run import Rehearsal
from probedesign.units import MM

FILES = ("house.mcap", "poses.csv", "truth.csv")
TRUTH = ("time_s", "x_world_mm", "y_world_mm", "z_world_mm", "fraction", "force_N", "again", "friction")


def write_rehearsal(
    rehearsal: Rehearsal,
    model: ProbeModel,
    folder: Path,
    rng: np.random.Generator,
    force: bool = False,
    recording: str = FILES[0],
) -> tuple[Path, ...]:
    """Write the recording, the poses and the truth.

    Args:
        rehearsal: it.
        model: the probe on the sensor.
        folder: to write to.
        rng: of the sensor's noise.
        force: replace files that stand there.
        recording: name of the recording, .mcap or .csv.

    Raises:
        InputError: files stand there, or cannot be written.
    """
    paths = tuple(folder / name for name in (recording, *FILES[1:]))
    for path in paths:
        if path.exists() and not force:
            raise InputError(f"{path}: exists; say --force to replace it, or name another folder")
    kind = CsvRecorder if recording.endswith(".csv") else None
    file = (
        kind(paths[0], force)
        if kind is not None
        else McapRecorder(paths[0], model, force, {"source": SOURCE})
    )
    try:
        for block in rehearsal.way.blocks(model, rng):
            file.on_samples(block)
    finally:
        file.close()
    write_atomically(paths[1], _poses(rehearsal).encode())
    write_atomically(paths[2], _truth(rehearsal).encode())
    return paths


def _poses(rehearsal: Rehearsal) -> str:
    lines = [",".join(POSE_COLUMNS)]
    for pose in rehearsal.way.poses():
        numbers = (pose.time, *(value / MM for value in pose.p), *pose.q)
        lines.append(_cells(numbers))
    return "\n".join(lines) + "\n"


def _truth(rehearsal: Rehearsal) -> str:
    lines = [",".join(TRUTH)]
    for touch in rehearsal.touches:
        numbers = (touch.start, *(touch.p_world / MM), touch.spot.fraction, touch.force)
        lines.append(_cells(numbers) + f",{int(touch.spot.again)},{_cells([touch.friction])}")
    return "\n".join(lines) + "\n"


def _cells(numbers: Iterable[float]) -> str:
    """To the ninth decimal, behind which rounding stands: millimetres, seconds and newtons to a billionth."""
    return ",".join(f"{round(number, 9):z.9g}" for number in numbers)
