"""One reading of a wrench sensor, and what may be done to a stream of them."""

import time
from collections.abc import Callable, Generator, Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from probedesign.frames import Array
from probedesign.live.recorder import Recorder


@dataclass(frozen=True)
class Truth:
    """What a simulation knows of the contact; NaN while nothing touches.

    Attributes:
        s_contact: arclength of the contact [m].
        p_contact_base: its point of the centreline [m], (3,).
        force_base: what the object does to the probe [N], (3,).
    """

    s_contact: float
    p_contact_base: Array
    force_base: Array


FREE = Truth(float("nan"), np.full(3, np.nan), np.full(3, np.nan))
"""Nothing touches."""


@dataclass(frozen=True)
class Reading:
    """What the sensor reads at one moment.

    Attributes:
        time: by the source's own clock [s].
        wrench_sensor: in the sensor frame, its bias included [N, N·m], (6,).
        gravity_base: vector of gravity in base axes [m/s²], (3,).
        truth: where the contact really is, if the source knows.
        fault: what is wrong with it, in words; such a reading counts as out of range.
        stretch: counts what the source read without an interruption; nothing is averaged from one to the next.
        received: when it reached this program, by `time.monotonic` [s]; NaN if nothing is received.
    """

    time: float
    wrench_sensor: Array
    gravity_base: Array
    truth: Truth | None = None
    fault: str = ""
    stretch: int = 0
    received: float = float("nan")


def mean(readings: list[Reading]) -> Reading:
    """The mean of several readings, at their mean time, received with the last; its truth is free if any of theirs
    is, and a fault of one is its fault."""
    truths = [reading.truth for reading in readings if reading.truth is not None]
    truth = Truth(
        float(np.mean([t.s_contact for t in truths])),
        np.mean([t.p_contact_base for t in truths], axis=0),
        np.mean([t.force_base for t in truths], axis=0),
    ) if truths else None  # fmt: skip
    return Reading(
        float(np.mean([reading.time for reading in readings])),
        np.mean([reading.wrench_sensor for reading in readings], axis=0),
        np.mean([reading.gravity_base for reading in readings], axis=0),
        truth,
        next((reading.fault for reading in readings if reading.fault), ""),
        readings[-1].stretch,
        readings[-1].received,
    )


def averaged(readings: Iterable[Reading], samples: int) -> Iterator[Reading]:
    """Means of `samples` readings one after the other; what is left at the end of a stretch and fills no block is
    dropped."""
    if samples == 1:
        yield from readings
        return
    block: list[Reading] = []
    for reading in readings:
        if block and block[0].stretch != reading.stretch:
            block.clear()
        block.append(reading)
        if len(block) == samples:
            yield mean(block)
            block = []


def paced(
    readings: Iterable[Reading],
    speed: float,
    clock: Callable[[], float] = time.monotonic,
    sleep: Callable[[float], None] = time.sleep,
) -> Generator[Reading, None, None]:
    """Readings at their own time, `speed` times as fast; at once if it is infinite. A late one does not delay
    those that follow."""
    start: tuple[float, float] | None = None
    for reading in readings:
        start = start or (clock(), reading.time)
        wait = start[0] + (reading.time - start[1]) / speed - clock()
        if wait > 0.0:
            sleep(wait)
        yield reading


def thinned(readings: Iterable[Reading], rate: float) -> Iterator[Reading]:
    """At most `rate` readings a second of the source's clock [Hz]; the others are left out.

    One may come a hundredth of a period early, so that a source that keeps the very rate loses none to rounding.
    """
    period = 1.0 / rate
    due = -np.inf
    for reading in readings:
        if reading.time >= due - 0.01 * period:
            due = due + period if due + period > reading.time else reading.time + period
            yield reading


def until(readings: Iterable[Reading], seconds: float) -> Iterator[Reading]:
    """Readings of the first `seconds` of the source's clock [s]."""
    start: float | None = None
    for reading in readings:
        start = reading.time if start is None else start
        if reading.time - start >= seconds:
            return
        yield reading


def recorded(readings: Iterable[Reading], recorder: Recorder) -> Iterator[Reading]:
    """The same readings, each written down before it is passed on; one with a fault is left out and makes a gap."""
    for reading in readings:
        if not reading.fault:
            recorder.write(reading.time, reading.wrench_sensor, reading.gravity_base)
        yield reading
