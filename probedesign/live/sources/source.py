"""The interface of a source of readings, and the function that opens one."""

from collections.abc import Generator
from pathlib import Path
from typing import Protocol

from probedesign.core.errors import InputError
from probedesign.estimation.model import ProbeModel
from probedesign.live import Log
from probedesign.live.processing.blocks import Block


class Source(Protocol):
    """A source of raw readings. Iterating opens it; closing the iterator closes it."""

    title: str
    """One line that describes the source."""
    notes: tuple[str, ...]
    """Notes for the user, one line each."""

    def __iter__(self) -> Generator[Block, None, None]:
        """Yield readings in order of time, in small blocks as soon as they are available.

        While a sensor is silent, it yields blocks without readings.
        """
        ...


SOURCES = "netft://HOST, daq://DEVICE/ai0:5?cal=FILE, replay:FILE and sim:"


def open_source(spec: str, model: ProbeModel, log: Log = lambda line: None) -> Source:
    """Open the source that a specification names.

    Args:
        spec: `netft://HOST[:PORT]`, `daq://Dev1/ai0:5?cal=FILE`, `replay:FILE?speed=max` or `sim:?name=value&...`.
        model: probe on the sensor.
        log: callback for messages to the user during the run: late, lost or invalid data.

    Raises:
        InputError: the source is unknown, its parameters are invalid, or it does not respond.
        MissingDependencyError: the package that reads it is not installed.
    """
    scheme, colon, rest = spec.partition(":")
    target, _, query = rest.rpartition("?") if "?" in rest else (rest, "", "")
    match scheme if colon else "":
        case "sim" if not target:
            from probedesign.live.sources.sim import SimulatedSource

            return SimulatedSource(model, query)
        case "sim":
            raise InputError(f"sim: takes parameters only, as sim:?force_mN=20; found {target!r}")
        case "replay":
            from probedesign.live.sources.replay import ReplaySource

            return ReplaySource(model, Path(target), query, log)
        case "netft":
            from probedesign.live.sources.netft.source import NetFTSource

            return NetFTSource(model, target, query, log)
        case "daq":
            from probedesign.live.sources.daq import DaqSource

            return DaqSource(model, target, query, log)
        case _:
            raise InputError(f"source {spec!r} is unknown; available are {SOURCES}")
