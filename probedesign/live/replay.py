"""`replay:FILE`: a recording, as if the sensor read it now."""

from collections.abc import Generator, Iterator
from pathlib import Path

from probedesign.errors import InputError
from probedesign.estimator.model import ProbeModel
from probedesign.live.block import Block, blocks_of
from probedesign.live.flow import paced
from probedesign.live.reading import Reading
from probedesign.live.recording import Recording, read_recording
from probedesign.live.spec import MOST, SPEED, TICK, parse_parameters

PARAMETERS = {"speed": SPEED}


class Replay:
    """A recording at its own speed or another.

    Attributes:
        title: one line that says what it is.
        notes: what a user should know of the file.
    """

    def __init__(self, model: ProbeModel, path: Path, query: str = "") -> None:
        """Read the file.

        Args:
            model: the probe it was recorded with.
            path: the recording.
            query: parameters, as `PARAMETERS` has them.

        Raises:
            InputError: a parameter is wrong or the file is no recording.
        """
        if not path.name:
            raise InputError("replay: names no file; write replay:FILE")
        self._speed = parse_parameters("replay:", query, PARAMETERS)["speed"]
        self._model = model
        self._recording = read_recording(path)
        self.title = f"replay of {path}, {len(self._recording.time)} readings"
        self.notes = self._recording.notes

    def __iter__(self) -> Generator[Block, None, None]:
        readings = readings_of(self._recording, self._model)
        return paced(blocks_of(readings, MOST, TICK * self._speed), self._speed)


def readings_of(recording: Recording, model: ProbeModel) -> Iterator[Reading]:
    """The samples of a recording as readings of the sensor.

    Args:
        recording: in either frame; where it holds no gravity, the model's is taken.
        model: the probe it was recorded with.
    """
    for i, (time, wrench) in enumerate(zip(recording.time.tolist(), recording.wrench, strict=True)):
        gravity = model.gravity_base if recording.gravity_base is None else recording.gravity_base[i]
        sensed = model.to_sensor(wrench, gravity) if recording.frame == "base" else wrench
        yield Reading(time, sensed, gravity)
