"""Sources of readings: the interface, the registry of their schemes, their parameters, and the monitor of dropouts.

A new source is a module with a class like `Source`, an entry in `SOURCES`, and its section in docs/live.md.
"""

import difflib
import math
from collections.abc import Generator, Iterable, Mapping
from dataclasses import dataclass, field
from pkgutil import resolve_name
from time import monotonic
from typing import Protocol
from urllib.parse import parse_qsl

import numpy as np

from probedesign.core.errors import InputError
from probedesign.core.frames import Array
from probedesign.estimation.model import ProbeModel
from probedesign.live import Log
from probedesign.live.blocks import Block, WrenchReading, group_readings, paced


class Source(Protocol):
    """A source of raw readings. Iterating opens it; closing the iterator closes it."""

    title: str  #: One line that describes the source.
    notes: tuple[str, ...]  #: Notes for the user, one line each.

    def __iter__(self) -> Generator[Block, None, None]:
        """Yield readings in order of time, in small blocks as soon as they are available.

        While a sensor is silent, it yields blocks without readings. The chain passes to the method `expect` of a
        source, if it has one, how many readings complete the next mean; the source waits for them instead of waking
        up for each few.
        """


#: By scheme: an example, and module and name of the function or class that opens the source from model, target, query
#: and log. It is imported when the source is used, because each needs packages of its own.
SOURCES = {
    "netft": ("netft://HOST", "probedesign.live.sources.netft:NetFTSource"),
    "daq": ("daq://DEVICE/ai0:5?cal=FILE", "probedesign.live.sources.daq:DaqSource"),
    "replay": ("replay:FILE", "probedesign.live.sources.replay:ReplaySource"),
    "sim": ("sim:", "probedesign.live.sources.sim:open_simulation"),
    "udp": ("udp://:PORT", "probedesign.live.sources.udp:open_udp"),
    "ros2": ("ros2://TOPIC", "probedesign.live.sources.ros2:open_ros2"),
}


def open_source(spec: str, model: ProbeModel, log: Log = lambda line: None) -> Source:
    """Open the source that a specification names.

    Args:
        spec: scheme, target and parameters as in `SOURCES`, such as `replay:FILE?speed=max`.
        model: probe on the sensor.
        log: callback for messages during the run: late, lost or invalid data.

    Raises:
        InputError: the source is unknown, its parameters are invalid, or it does not respond.
        MissingDependencyError: the package that reads it is not installed.
    """
    scheme, colon, rest = spec.partition(":")
    if not colon or scheme not in SOURCES:
        *examples, last = (example for example, _ in SOURCES.values())
        raise InputError(f"source {spec!r} is unknown; available are {', '.join(examples)} and {last}")
    target, _, query = rest.rpartition("?") if "?" in rest else (rest, "", "")
    opened: Source = resolve_name(SOURCES[scheme][1])(model, target, query, log)
    return opened


@dataclass(frozen=True)
class SourceParameter:
    """A number among the parameters of a source, in the unit that ends its name; `words` are accepted as values."""

    default: float
    minimum: float
    maximum: float
    integer: bool = False
    words: Mapping[str, float] = field(default_factory=dict)


#: Playback speed relative to the source's own clock, for all sources without hardware.
SPEED = SourceParameter(1.0, 1e-3, 1e6, words={"max": math.inf})
BLOCK_DURATION, MAX_BLOCK_READINGS = 0.002, 64  #: Maximum duration [s] and size of a block of such sources.


def played(readings: Iterable[WrenchReading], speed: float) -> Generator[Block, None, None]:
    """Yield readings that need no hardware in small blocks, `speed` times as fast as their own clock."""
    return paced(group_readings(readings, MAX_BLOCK_READINGS, BLOCK_DURATION * speed), speed)


def parse_parameters(
    source: str, query: str, known: Mapping[str, SourceParameter], texts: Mapping[str, tuple[str, ...]] | None = None
) -> tuple[dict[str, float], dict[str, str]]:
    """Return the value of every known number, and of every known text, empty where it is not given.

    Args:
        source: name of the source, for messages.
        query: `name=value&name=value`, or empty.
        known: the numbers.
        texts: the texts with their allowed values, or with none if any is allowed.

    Raises:
        InputError: a parameter is unknown, duplicated, not a number or out of range.
    """
    numbers = {name: parameter.default for name, parameter in known.items()}
    given = dict.fromkeys(texts or {}, "")
    try:
        pairs = parse_qsl(query, keep_blank_values=True, strict_parsing=bool(query))
    except ValueError:
        raise InputError(f"{source}?{query}: write parameters as name=value&name=value") from None
    for i, (name, text) in enumerate(pairs):
        if name not in numbers and name not in given:
            near = difflib.get_close_matches(name, (*numbers, *given), 1)
            hint = f"did you mean {near[0]}? " if near else ""
            raise InputError(f"{source} has no parameter {name!r}; {hint}known: {', '.join((*numbers, *given))}")
        if name in dict(pairs[:i]):
            raise InputError(f"{source} {name} is given twice; keep one")
        if name in numbers:
            numbers[name] = _value(f"{source} {name}", text, known[name])
        elif texts and texts[name] and text not in texts[name]:
            raise InputError(f"{source} {name} = {text!r} must be {' or '.join(texts[name])}")
        else:
            given[name] = text
    return numbers, given


def _value(what: str, text: str, parameter: SourceParameter) -> float:
    if text in parameter.words:
        return parameter.words[text]
    kind = "a whole number" if parameter.integer else "a number"
    allowed = " or ".join([f"{kind} in {parameter.minimum:g} ... {parameter.maximum:g}", *parameter.words])
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not parameter.minimum <= value <= parameter.maximum or (parameter.integer and value != int(value)):
        raise InputError(f"{what} = {text!r} must be {allowed}")
    return value


def range_note(what: str, ranges: Array, model: ProbeModel) -> tuple[str, ...]:
    """Return a note if the ranges of a sensor [N, N·m], (6,), differ from those of the probe's; `what` states them."""
    if np.allclose(ranges, model.wrench_range, rtol=0.01):
        return ()
    listed = ", ".join(f"{value:g}" for value in ranges)
    return (f"the range of the {what}, {listed} N, Nm, differs from that of the probe's sensor: is it the right one?",)


#: Time without a record of a sensor after which the last estimate is stale [s]; reported within 50 ms of the record.
STALE_TIME = 0.040
FIRST_RECORD_TIMEOUT = 3.0  #: Maximum wait for the first record of a box or card, which sends on request [s].
REPORT_TIMES = (0.0, 2.0, 10.0, 60.0, 600.0)  #: Durations of silence after which it is reported (again) [s].
#: Number of interruptions within a time [s] that indicates another client.
MAX_INTERRUPTIONS, INTERRUPTION_WINDOW = 4, 10.0


class DropoutMonitor:
    """Tracks the silence of a sensor and reports it.

    Attributes:
        ongoing: whether records are missing now.
        reason: description of the dropout; empty without one.
    """

    def __init__(self, name: str, log: Log, no_record_text: str, timeout: float = FIRST_RECORD_TIMEOUT) -> None:
        """Start to wait for the first record; `no_record_text` is the error if none arrives within `timeout` [s]."""
        self._name, self._log, self._no_record_text = name, log, no_record_text
        self.ongoing, self.reason = False, ""
        self._n_reports = 0
        self._interruptions: list[float] = []
        self._opened, self._timeout = monotonic(), timeout

    def on_silence(self, last: float, hint: str = "asking again") -> None:
        """Handle the absence of usable records.

        Args:
            last: time of the last record [s]; -inf if there was none.
            hint: probable cause.

        Raises:
            InputError: no record has ever arrived.
        """
        now = monotonic()
        if not math.isfinite(last):
            if now - self._opened > self._timeout:
                raise InputError(f"{self._name}: {self._no_record_text}")
            return
        if not self.ongoing:
            self.ongoing, self._n_reports = True, 0
            self._interruptions = [t for t in self._interruptions if now - t < INTERRUPTION_WINDOW] + [now]
        self.reason = f"stale, no record for {now - last:.2g} s"
        if self._n_reports < len(REPORT_TIMES) and now - last >= REPORT_TIMES[self._n_reports]:
            self._n_reports += 1
            if len(self._interruptions) >= MAX_INTERRUPTIONS:
                count = len(self._interruptions)
                hint = f"{count} times within {INTERRUPTION_WINDOW:g} s: is another client reading?"
            self._log(f"{self._name}: {self.reason}; {hint}")

    def on_resumed(self, silence: float) -> None:
        """Handle the end of a dropout of this duration [s]."""
        self._log(f"{self._name}: records resumed after {silence:.2g} s; the tare is kept")
        self.ongoing, self.reason = False, ""
