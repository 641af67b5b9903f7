"""What may be done to a stream of blocks on its way from a source. How readings are cut into blocks changes nothing."""

import time
from collections.abc import Callable, Generator, Iterable, Iterator

import numpy as np

from probedesign.frames import Array
from probedesign.live.block import Block
from probedesign.live.reading import Reading, Truth


def mean(blocks: list[Block]) -> Reading:
    """The mean of all readings, at their mean time, received with the last; its truth is free if any of theirs is,
    and a fault of one is its fault."""
    return Reading(
        float(np.concatenate([block.time for block in blocks]).mean()),
        np.concatenate([block.wrench_sensor for block in blocks]).mean(axis=0),
        _gravity(blocks),
        _truth([truth for block in blocks for truth in block.truths]),
        next((block.fault for block in blocks if block.fault), ""),
        blocks[-1].stretch,
        float(blocks[-1].received[-1]),
    )


def _gravity(blocks: list[Block]) -> Array:
    """The mean vector of gravity; the very one if it does not turn."""
    first = blocks[0].gravity_base
    if all(block.gravity_base is first for block in blocks):
        return first
    rows = np.concatenate([np.tile(block.gravity_base, (len(block), 1)) for block in blocks])
    return first if (rows == first).all() else np.asarray(rows.mean(axis=0))


def _truth(truths: list[Truth]) -> Truth | None:
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
