"""`replay:FILE`: a recording, as if the sensor read it now."""

from collections.abc import Callable, Generator, Iterator
from pathlib import Path
from typing import get_args
from urllib.parse import parse_qsl, urlencode

from probedesign.core.csv_tables import Frame
from probedesign.errors import InputError
from probedesign.estimation.model import ProbeModel
from probedesign.live.block import Block, blocks_of
from probedesign.live.flow import paced
from probedesign.live.reading import Reading
from probedesign.live.recorded import Choice, MomentUnit, open_recording
from probedesign.live.spec import MOST, SPEED, TICK, Parameter, parse_parameters

PARAMETERS = {"speed": SPEED, "other_probe": Parameter(0, 0, 1, whole=True)}
WORDS = {"topic": (), "frame": get_args(Frame), "moment_unit": get_args(MomentUnit)}
"""Parameters that are no numbers, with what there is to choose from; nothing if anything goes."""


class Replay:
    """A recording at its own speed or another.

    Attributes:
        title: one line that says what it is.
        notes: what a user should know of the file.
        recorded_from: what the recording was read from, by its own words; empty where it does not say.
    """

    def __init__(
        self,
        model: ProbeModel,
        path: Path,
        query: str = "",
        say: Callable[[str], None] = lambda line: None,
    ) -> None:
        """Open the file.

        Args:
            model: the probe it was recorded with.
            path: the recording.
            query: parameters, as `PARAMETERS` and `WORDS` have them.
            say: takes what is found to be missing at the end.

        Raises:
            InputError: a parameter is wrong, the file is no recording, or it is another probe's.
            MissingDependencyError: what reads it is not installed.
        """
        if not path.name:
            raise InputError("replay: names no file; write replay:FILE")
        words, rest = _words(query)
        numbers = parse_parameters("replay:", rest, PARAMETERS)
        self._speed, self._say = numbers["speed"], say
        choice = Choice(other_probe=numbers["other_probe"] == 1, **words)  # type: ignore[arg-type]  # checked
        self._recorded = open_recording(path, model, choice)
        self.title = f"replay of {path}, {self._recorded.what}"
        self.notes, self.recorded_from = self._recorded.notes, self._recorded.source

    def __iter__(self) -> Generator[Block, None, None]:
        return paced(blocks_of(self._readings(), MOST, TICK * self._speed), self._speed)

    def _readings(self) -> Iterator[Reading]:
        for block in self._recorded.blocks():
            yield from block.readings()
        for line in self._recorded.lacking():
            if line not in self.notes:
                self._say(f"{self._recorded.path}: {line}")


def _words(query: str) -> tuple[dict[str, str], str]:
    """The parameters that are no numbers, and the query without them.

    Raises:
        InputError: one is said twice, or is none of what there is.
    """
    try:
        pairs = parse_qsl(query, keep_blank_values=True, strict_parsing=bool(query))
    except ValueError:
        return {}, query  # told by who parses the rest
    words = [(name, value) for name, value in pairs if name in WORDS]
    for i, (name, value) in enumerate(words):
        if name in dict(words[:i]):
            raise InputError(f"replay: {name} is said twice; keep one")
        if WORDS[name] and value not in WORDS[name]:
            raise InputError(f"replay: {name} = {value!r} must be {' or '.join(WORDS[name])}")
    return dict(words), urlencode([pair for pair in pairs if pair[0] not in WORDS])
