"""Samples that make one averaged reading, cut from blocks of any size."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from probedesign.live.block import Block
from probedesign.live.flow import mean
from probedesign.live.reading import Reading


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
            yield _batch([*self._held, block[start:end]])
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


def _batch(parts: list[Block]) -> Batch:
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
