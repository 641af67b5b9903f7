"""One reading of a wrench sensor."""

import time
from collections.abc import Callable, Generator, Iterable, Iterator
from dataclasses import dataclass, replace
from math import inf

import numpy as np

from probedesign.frames import Array


@dataclass(frozen=True)
class Truth:
    """What a simulation knows of the contact; NaN while nothing touches.

    Attributes:
        s_contact: arclength of the contact [m].
        p_contact_base: its point of the centreline [m], (3,).
        force_base: what the object does to the probe [N], (3,).
        p_surface_base: the touched point of the surface [m], (3,).
    """

    s_contact: float
    p_contact_base: Array
    force_base: Array
    p_surface_base: Array


FREE = Truth(float("nan"), np.full(3, np.nan), np.full(3, np.nan), np.full(3, np.nan))
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
        for stamp, wrench, truth, received in rows:
            yield Reading(stamp, wrench, self.gravity_base, truth, self.fault, self.stretch, received)


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
            yield _gathered(held)
            held = []
        held.append(reading)
        if len(held) == most:
            yield _gathered(held)
            held = []
    if held:
        yield _gathered(held)


def _alike(a: Reading, b: Reading) -> bool:
    if (a.fault, a.stretch, a.truth is None) != (b.fault, b.stretch, b.truth is None):
        return False
    return a.gravity_base is b.gravity_base or np.array_equal(a.gravity_base, b.gravity_base)


def _gathered(readings: list[Reading]) -> Block:
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


def mean(blocks: list[Block]) -> Reading:
    """The mean of all readings, at their mean time, received with the last; its truth is free if any of theirs is,
    and a fault of one is its fault."""
    return Reading(
        float(np.concatenate([block.time for block in blocks]).mean()),
        np.concatenate([block.wrench_sensor for block in blocks]).mean(axis=0),
        _mean_gravity(blocks),
        _mean_truth([truth for block in blocks for truth in block.truths]),
        next((block.fault for block in blocks if block.fault), ""),
        blocks[-1].stretch,
        float(blocks[-1].received[-1]),
    )


def _mean_gravity(blocks: list[Block]) -> Array:
    """The mean vector of gravity; the very one if it does not turn."""
    first = blocks[0].gravity_base
    if all(block.gravity_base is first for block in blocks):
        return first
    rows = np.concatenate([np.tile(block.gravity_base, (len(block), 1)) for block in blocks])
    return first if (rows == first).all() else np.asarray(rows.mean(axis=0))


def _mean_truth(truths: list[Truth]) -> Truth | None:
    if not truths:
        return None
    return Truth(
        float(np.mean([t.s_contact for t in truths])),
        np.mean([t.p_contact_base for t in truths], axis=0),
        np.mean([t.force_base for t in truths], axis=0),
        np.mean([t.p_surface_base for t in truths], axis=0),
    )


def paced(
    blocks: Iterable[Block],
    speed: float,
    clock: Callable[[], float] = time.monotonic,
    sleep: Callable[[float], None] = time.sleep,
) -> Generator[Block, None, None]:
    """Blocks at their own time, which is that of their last reading, `speed` times as fast; at once if it is
    infinite. A late one does not delay those that follow."""
    start: tuple[float, float] | None = None
    for block in blocks:
        start = start or (clock(), float(block.time[0]))
        wait = start[0] + (float(block.time[-1]) - start[1]) / speed - clock()
        if wait > 0.0:
            sleep(wait)
        yield block


def until(blocks: Iterable[Block], seconds: float) -> Iterator[Block]:
    """Readings of the first `seconds` of the source's clock [s]."""
    start: float | None = None
    for block in blocks:
        if len(block):
            start = float(block.time[0]) if start is None else start
            inside = int(np.searchsorted(block.time - start, seconds))
            if inside < len(block):
                if inside:
                    yield block[:inside]
                return
        yield block


@dataclass(frozen=True)
class Batch:
    """n samples one after the other, of one stretch.

    Attributes:
        block: their times, wrenches and what came with them; of one gravity and one fault, the first.
        reading: their mean.
    """

    block: Block
    reading: Reading


class Batches:
    """Cuts batches of n samples, so that what follows does not depend on how a source cut its blocks."""

    def __init__(self, samples: int) -> None:
        self._samples = samples
        self._held: list[Block] = []
        self._count = 0

    def cut(self, block: Block) -> Iterator[Batch]:
        """All batches that a block fills; what fills none by the end of a stretch is dropped."""
        if self._held and self._held[0].stretch != block.stretch:
            self._held, self._count = [], 0
        start = 0
        while self._count + len(block) - start >= self._samples:
            end = start + self._samples - self._count
            yield _joined_batch([*self._held, block[start:end]])
            self._held, self._count, start = [], 0, end
        if start < len(block):
            self._held.append(block[start:])
            self._count += len(block) - start


def averaged(blocks: Iterable[Block], samples: int) -> Iterator[Reading]:
    """Means of `samples` readings one after the other."""
    batches = Batches(samples)
    for block in blocks:
        for batch in batches.cut(block):
            yield batch.reading


def _joined_batch(parts: list[Block]) -> Batch:
    if len(parts) == 1 and len(parts[0]) == 1:
        return Batch(parts[0], next(parts[0].readings()))
    reading = mean(parts)
    whole = Block(
        np.concatenate([part.time for part in parts]),
        np.concatenate([part.wrench_sensor for part in parts]),
        reading.gravity_base,
        np.concatenate([part.received for part in parts]),
        reading.fault,
        reading.stretch,
        tuple(truth for part in parts for truth in part.truths),
    )
    return Batch(whole, reading)
