"""From readings to estimates: of a recording at once, or of a source as long as it runs."""

import math
import time
from collections import Counter
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass
from itertools import islice

import numpy as np

from probedesign.errors import InputError
from probedesign.estimator.estimate import RESULTS, Estimate
from probedesign.estimator.estimator import Estimator
from probedesign.frames import Array
from probedesign.live.answer import Answer
from probedesign.live.block import Block
from probedesign.live.flow import averaged, thinned, until
from probedesign.live.reading import Reading
from probedesign.live.requests import Requests
from probedesign.live.sink import Sink
from probedesign.live.source import Source
from probedesign.live.tare import CHANNELS, Tare, Window, split, take_tare, without_bias

Say = Callable[[str], None]


@dataclass(frozen=True)
class Plan:
    """What `live` does with the readings of a source.

    Attributes:
        window: when the probe is free, for the tare; None takes none.
        samples: how many readings are averaged to one.
        rate: at most so many estimates a second of the source's clock [Hz].
        count: end after so many estimates.
        seconds: end so long after the first reading [s].
    """

    window: Window | None = None
    samples: int = 1
    rate: float = math.inf
    count: int | None = None
    seconds: float | None = None

    def __post_init__(self) -> None:
        """Raises InputError where a number cannot be meant."""
        said = {"average": self.samples, "rate-hz": self.rate, "count": self.count, "seconds": self.seconds}
        for name, value in said.items():
            if value is not None and not value > 0:
                raise InputError(f"--{name} {value} must be positive")


def estimate_stream(
    estimator: Estimator,
    source: Source,
    plan: Plan,
    say: Say,
    sink: Sink | None = None,
    requests: Requests | None = None,
) -> Generator[Answer, None, None]:
    """Estimates as the readings come.

    Args:
        estimator: of the probe.
        source: of the readings; closed at the end, however that comes.
        plan: what to do with them.
        say: takes each line that a user should know.
        sink: takes every reading as it was read, before averaging and tare, and every answer.
        requests: what a person asks meanwhile.

    Raises:
        InputError: the tare's window is no good, or the source fails.
    """
    with closing(iter(source)) as stream:
        blocks: Iterator[Block] = stream if plan.seconds is None else until(stream, plan.seconds)
        readings = averaged(_fed(blocks, say, sink, requests), plan.samples)
        tare: Tare | None = None
        if plan.window is not None:
            inside, readings = split(readings, plan.window)
            tare = take_tare(inside, plan.window, estimator)
            say(describe_tare(tare))
        for reading in islice(thinned(readings, plan.rate), plan.count):
            answer = Answer(
                reading,
                locate(estimator, reading, tare),
                wrench_base=_without_fault(estimator, reading, tare),
                made=time.monotonic(),
            )
            if sink is not None:
                sink.answered(answer)
            yield answer


def _fed(blocks: Iterable[Block], say: Say, sink: Sink | None, requests: Requests | None) -> Iterator[Block]:
    """The same blocks, each given to the sink before it is passed on; ends when that is asked."""
    for block in blocks:
        if sink is not None:
            sink.read(block)
        yield block
        for request in requests.taken() if requests is not None else ():
            if request.wish == "stop":
                return
            say(f"mark: {request.text}" if request.wish == "mark" else f"{request.wish} is not possible here")


def _without_fault(estimator: Estimator, read: Reading, tare: Tare | None) -> Array:
    """What is estimated from, at the base, (6,); NaN where there is a fault."""
    if read.fault:
        return np.full(6, np.nan)
    return estimator.model.to_base(without_bias(read, tare).wrench_sensor, read.gravity_base)


def locate(estimator: Estimator, read: Reading, tare: Tare | None = None) -> Estimate:
    """The estimate of one reading; a channel at its limit counts as read, before the bias is taken off."""
    if read.fault or not estimator.model.reads(read.wrench_sensor):
        return Estimate("out_of_range")
    reading = without_bias(read, tare)
    wrench_base = estimator.model.to_base(reading.wrench_sensor, reading.gravity_base)
    return estimator.estimate(wrench_base, reading.gravity_base)


def describe_tare(tare: Tare) -> str:
    """The tare in one line."""
    bias = ", ".join(
        f"{name} {value * 1e3:.3g} {'mN' if name[0] == 'F' else 'Nmm'}"
        for name, value in zip(CHANNELS, tare.bias_sensor.tolist(), strict=True)
    )
    return f"tare from {tare.readings} readings in {tare.window.start:g}:{tare.window.end:g} s: {bias}"


def count_results(answers: Iterable[str]) -> dict[str, int]:
    """How many estimates had each result, in the order of `RESULTS`, without those that none had."""
    counted = Counter(answers)
    return {result: counted[result] for result in RESULTS if counted[result]}


def describe_counts(counts: dict[str, int]) -> str:
    """The counts in one line."""
    told = ", ".join(f"{count} {result}" for result, count in counts.items())
    return f"{sum(counts.values())} estimates" + (f": {told}" if told else "")
