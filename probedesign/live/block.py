"""Readings that came together: what a source gives, and what is recorded raw."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from math import inf

import numpy as np

from probedesign.frames import Array
from probedesign.live.reading import Reading, Truth


@dataclass(frozen=True)
class Block:
    """n readings one after the other, of one stretch, with one gravity and one fault or none.

    A block without readings tells silence: nothing has come for a while, as its fault says.

    Attributes:
        time: by the source's own clock [s], (n,).
        wrench_sensor: in the sensor frame, bias included [N, N·m], (n, 6).
        gravity_base: vector of gravity in base axes [m/s²], (3,).
        received: when they reached this program, by `time.monotonic` [s], (n,); NaN if nothing is received.
        fault: what is wrong with all of them, in words; they count as out of range.
        stretch: counts what the source read without an interruption.
        truths: where the contact really is, of each, if the source knows; else empty.
    """

    time: Array
    wrench_sensor: Array
    gravity_base: Array
    received: Array
    fault: str = ""
    stretch: int = 0
    truths: tuple[Truth, ...] = ()

    def __len__(self) -> int:
        return len(self.time)

    def __getitem__(self, part: slice) -> "Block":
        """Some of its readings, in order."""
        return replace(
            self,
            time=self.time[part],
            wrench_sensor=self.wrench_sensor[part],
            received=self.received[part],
            truths=self.truths[part],
        )

    def readings(self) -> Iterator[Reading]:
        """One by one."""
        truths = self.truths or (None,) * len(self)
        rows = zip(self.time.tolist(), self.wrench_sensor, truths, self.received.tolist(), strict=True)
        for time, wrench, truth, received in rows:
            yield Reading(time, wrench, self.gravity_base, truth, self.fault, self.stretch, received)


def silence(gravity_base: Array, why: str, stretch: int) -> Block:
    """A block without readings.

    Args:
        gravity_base: as the last one had it [m/s²], (3,).
        why: what is told of the silence.
        stretch: that is interrupted.
    """
    return Block(np.empty(0), np.empty((0, 6)), gravity_base, np.empty(0), why, stretch)


def readings_in(blocks: Iterable[Block]) -> Iterator[Reading]:
    """The readings of blocks, one by one."""
    for block in blocks:
        yield from block.readings()


def blocks_of(readings: Iterable[Reading], most: int = 1, span: float = inf) -> Iterator[Block]:
    """Readings gathered to blocks, each given away when it is full or the next does not fit in.

    Args:
        readings: in order of time.
        most: so many to a block.
        span: the last of a block is less than so long after its first [s].
    """
    held: list[Reading] = []
    for reading in readings:
        if held and not (_alike(held[0], reading) and reading.time - held[0].time < span):
            yield _block(held)
            held = []
        held.append(reading)
        if len(held) == most:
            yield _block(held)
            held = []
    if held:
        yield _block(held)


def _alike(a: Reading, b: Reading) -> bool:
    if (a.fault, a.stretch, a.truth is None) != (b.fault, b.stretch, b.truth is None):
        return False
    return a.gravity_base is b.gravity_base or np.array_equal(a.gravity_base, b.gravity_base)


def _block(readings: list[Reading]) -> Block:
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
