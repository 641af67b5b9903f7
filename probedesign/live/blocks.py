"""Wrench readings, and blocks of readings that a source delivers together.

A source delivers raw readings in blocks of any size. Results do not depend on where a source cuts its blocks:
`processing.averaging.Averager` cuts them again into batches of a fixed number of samples.
"""

import time
from collections.abc import Callable, Generator, Iterable, Iterator
from dataclasses import dataclass
from math import inf
from typing import NamedTuple

import numpy as np

from probedesign.core.frames import Array


class TrueContact(NamedTuple):
    """The true contact of a simulation; NaN while nothing touches."""

    s_contact: float  #: arclength of the contact [m].
    p_contact_base: Array  #: contact point on the centreline [m], (3,).
    force_base: Array  #: force of the object on the probe [N], (3,).
    p_surface_base: Array  #: touched point of the surface [m], (3,).


#: The true contact while nothing touches.
NO_CONTACT = TrueContact(float("nan"), np.full(3, np.nan), np.full(3, np.nan), np.full(3, np.nan))


@dataclass(frozen=True)
class WrenchReading:
    """One reading of the wrench sensor, raw or averaged."""

    time: float  #: time by the source's clock [s].
    wrench_sensor: Array  #: wrench in the sensor frame, bias included [N, N·m], (6,).
    gravity_base: Array  #: gravity vector in base axes [m/s²], (3,).
    truth: TrueContact | None = None  #: the true contact, if the source provides it.
    fault: str = ""  #: description of a sensor fault; a reading with a fault is treated as out of range.
    stretch: int = 0  #: number of the uninterrupted stretch of readings; averages never span two stretches.
    #: arrival time by `time.monotonic` [s]; NaN if the reading was not received from hardware.
    received: float = float("nan")


@dataclass(frozen=True)
class Block:
    """n consecutive readings of one stretch, with one gravity vector and one fault or none.

    A block without readings reports that the sensor is silent; `fault` gives the reason.
    """

    time: Array  #: times by the source's clock [s], (n,).
    wrench_sensor: Array  #: wrenches in the sensor frame, bias included [N, N·m], (n, 6).
    gravity_base: Array  #: gravity vector in base axes [m/s²], (3,).
    received: Array  #: arrival times by `time.monotonic` [s], (n,); NaN if not received from hardware.
    fault: str = ""  #: description of a fault that affects all of them; they are treated as out of range.
    stretch: int = 0  #: number of the uninterrupted stretch of readings.
    #: the true contact of each reading, if the source provides it; otherwise empty.
    truths: tuple[TrueContact, ...] = ()
    probe: str = ""  #: name of the probe in a run with several; a source leaves it empty.

    def __len__(self) -> int:
        return len(self.time)

    def __getitem__(self, index: slice) -> "Block":
        return Block(
            self.time[index], self.wrench_sensor[index], self.gravity_base, self.received[index], self.fault,
            self.stretch, self.truths[index],
        )  # fmt: skip

    def readings(self) -> Iterator[WrenchReading]:
        """Iterate over the readings one by one."""
        truths = self.truths or (None,) * len(self)
        rows = zip(self.time.tolist(), self.wrench_sensor, truths, self.received.tolist(), strict=True)
        for stamp, wrench, truth, received in rows:
            yield WrenchReading(stamp, wrench, self.gravity_base, truth, self.fault, self.stretch, received)


def joined(blocks: list[Block]) -> Block:
    """Return the readings of blocks as one, with gravity, fault and stretch of the first."""
    if len(blocks) == 1:
        return blocks[0]
    first = blocks[0]
    time, wrench, received = (
        np.concatenate([getattr(block, name) for block in blocks]) for name in ("time", "wrench_sensor", "received")
    )
    truths = tuple(truth for block in blocks for truth in block.truths)
    return Block(time, wrench, first.gravity_base, received, first.fault, first.stretch, truths, first.probe)


def dropout_block(gravity_base: Array, why: str, stretch: int) -> Block:
    """Return a block without readings, which reports a silent sensor, with the reason and the interrupted stretch."""
    return Block(np.empty(0), np.empty((0, 6)), gravity_base, np.empty(0), why, stretch)


def iter_readings(blocks: Iterable[Block]) -> Iterator[WrenchReading]:
    """Iterate over the readings of blocks one by one."""
    for block in blocks:
        yield from block.readings()


def group_readings(readings: Iterable[WrenchReading], max_count: int = 1, max_span: float = inf) -> Iterator[Block]:
    """Group readings in order of time into blocks that span less than `max_span` [s] and have one state of the source.

    A block is emitted when it is full or the next reading does not fit.
    """
    pending: list[WrenchReading] = []

    def fits(a: WrenchReading, b: WrenchReading) -> bool:
        if (a.fault, a.stretch, a.truth is None) != (b.fault, b.stretch, b.truth is None):
            return False
        same_gravity = a.gravity_base is b.gravity_base or np.array_equal(a.gravity_base, b.gravity_base)
        return same_gravity and b.time - a.time < max_span

    for reading in readings:
        if pending and not fits(pending[0], reading):
            yield _block_of(pending)
            pending = []
        pending.append(reading)
        if len(pending) == max_count:
            yield _block_of(pending)
            pending = []
    if pending:
        yield _block_of(pending)


def _block_of(readings: list[WrenchReading]) -> Block:
    first = readings[0]
    return Block(
        np.array([r.time for r in readings]),
        np.array([r.wrench_sensor for r in readings]),
        first.gravity_base,
        np.array([r.received for r in readings]),
        first.fault,
        first.stretch,
        tuple(r.truth for r in readings if r.truth is not None),
    )


def paced(
    blocks: Iterable[Block],
    speed: float,
    clock: Callable[[], float] = time.monotonic,
    sleep: Callable[[float], None] = time.sleep,
) -> Generator[Block, None, None]:
    """Yield blocks at the time of their last reading, `speed` times as fast; at once if `speed` is infinite.

    A late block does not delay the blocks after it.
    """
    start: tuple[float, float] | None = None
    for block in blocks:
        start = start or (clock(), float(block.time[0]))
        wait = start[0] + (float(block.time[-1]) - start[1]) / speed - clock()
        if wait > 0.0:
            sleep(wait)
        yield block


def limit_duration(
    blocks: Iterable[Block], seconds: float, clock: Callable[[], float] = time.monotonic
) -> Iterator[Block]:
    """Yield the readings of the first `seconds` [s], by the source's clock or the wall clock, whichever ends first.

    The wall clock counts from the first block, also of a silent source.
    """
    start: float | None = None
    opened: float | None = None
    for block in blocks:
        opened = clock() if opened is None else opened
        if len(block):
            start = float(block.time[0]) if start is None else start
            if block.time[-1] - start >= seconds:
                inside = int(np.searchsorted(block.time - start, seconds))
                if inside:
                    yield block[:inside]
                return
        if clock() - opened >= seconds:
            return
        yield block
