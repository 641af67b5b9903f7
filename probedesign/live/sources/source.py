"""Sources of readings: peers behind one small interface."""

from collections.abc import Callable, Generator
from pathlib import Path
from typing import Protocol

from probedesign.errors import InputError
from probedesign.estimation.model import ProbeModel
from probedesign.live.processing.blocks import Block
from probedesign.live.sources.daq import DAQ
from probedesign.live.sources.netft.source import NetFT
from probedesign.live.sources.replay import Replay
from probedesign.live.sources.sim import Simulation


class Source(Protocol):
    """Where readings come from, raw. Iterating opens it; closing the iterator closes it."""

    title: str
    """One line that says what it is."""
    notes: tuple[str, ...]
    """What a user should know of it, each one line."""

    def __iter__(self) -> Generator[Block, None, None]:
        """Readings in order of time, a few at once, each block as soon as it is there; while a sensor is silent,
        blocks without readings."""
        ...


SOURCES = "netft://HOST, daq://DEVICE/ai0:5?cal=FILE, replay:FILE and sim:"


def open_source(spec: str, model: ProbeModel, say: Callable[[str], None] = lambda line: None) -> Source:
    """The source that a specification names.

    Args:
        spec: `netft://HOST[:PORT]`, `daq://Dev1/ai0:5?cal=FILE`, `replay:FILE?speed=max` or `sim:?name=value&...`.
        model: the probe on the sensor.
        say: takes each line that a user should know while it runs: what is late, lost or broken.

    Raises:
        InputError: there is no such source, what follows its name is wrong, or it does not answer.
        MissingDependencyError: what it is read with is not installed.
    """
    scheme, colon, rest = spec.partition(":")
    place, _, query = rest.rpartition("?") if "?" in rest else (rest, "", "")
    match scheme if colon else "":
        case "sim" if not place:
            return Simulation(model, query)
        case "sim":
            raise InputError(f"sim: takes parameters only, as sim:?force_mN=20; found {place!r}")
        case "replay":
            return Replay(model, Path(place), query, say)
        case "netft":
            return NetFT(model, place, query, say)
        case "daq":
            return DAQ(model, place, query, say)
        case _:
            raise InputError(f"source {spec!r} is not known; there are {SOURCES}")
