"""Readings that came together: what a source gives, and what is recorded raw."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from probedesign.frames import Array
from probedesign.live.reading import Reading, Truth


@dataclass(frozen=True)
class Block:
    """n readings one after the other, of one stretch, with one gravity and one fault or none.

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

    def readings(self) -> Iterator[Reading]:
        """One by one."""
        truths = self.truths or (None,) * len(self)
        rows = zip(self.time.tolist(), self.wrench_sensor, truths, self.received.tolist(), strict=True)
        for time, wrench, truth, received in rows:
            yield Reading(time, wrench, self.gravity_base, truth, self.fault, self.stretch, received)


def blocks_of(readings: Iterable[Reading], most: int = 1) -> Iterator[Block]:
    """Readings gathered to blocks of at most `most`, each given away when it is full or the next does not fit in."""
    held: list[Reading] = []
    for reading in readings:
        if held and not _alike(held[0], reading):
            yield _block(held)
            held = []
        held.append(reading)
        if len(held) == most:
            yield _block(held)
            held = []
    if held:
        yield _block(held)


def _alike(a: Reading, b: Reading) -> bool:
    same = (a.fault, a.stretch, a.truth is None) == (b.fault, b.stretch, b.truth is None)
    return same and np.array_equal(a.gravity_base, b.gravity_base)


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
