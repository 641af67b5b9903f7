"""Sources of readings: peers behind one small interface."""

from collections.abc import Generator
from pathlib import Path
from typing import Protocol

from probedesign.errors import InputError
from probedesign.estimator.model import ProbeModel
from probedesign.live.reading import Reading
from probedesign.live.replay import Replay
from probedesign.live.simulate import Simulation


class Source(Protocol):
    """Where readings come from. Iterating opens it; closing the iterator closes it."""

    title: str
    """One line that says what it is."""
    notes: tuple[str, ...]
    """What a user should know of it, each one line."""

    def __iter__(self) -> Generator[Reading, None, None]:
        """Readings in order of time, each as soon as it is there."""
        ...


SOURCES = "sim: and replay:FILE"


def open_source(spec: str, model: ProbeModel) -> Source:
    """The source that a specification names.

    Args:
        spec: `sim:?name=value&...` or `replay:FILE?speed=max`.
        model: the probe on the sensor.

    Raises:
        InputError: there is no such source, or what follows its name is wrong.
    """
    scheme, colon, rest = spec.partition(":")
    place, _, query = rest.rpartition("?") if "?" in rest else (rest, "", "")
    match scheme if colon else "":
        case "sim" if not place:
            return Simulation(model, query)
        case "sim":
            raise InputError(f"sim: takes parameters only, as sim:?force_mN=20; found {place!r}")
        case "replay":
            return Replay(model, Path(place), query)
        case "netft" | "daq":
            raise InputError(f"source {scheme}: is not in this version; there are {SOURCES}")
        case _:
            raise InputError(f"source {spec!r} is not known; there are {SOURCES}")
