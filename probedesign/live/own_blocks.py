"""The blocks of our own recordings, to the last bit as the source gave them."""

import json
from collections.abc import Iterator
from typing import Any

import numpy as np

from probedesign.core.csv_tables import plain
from probedesign.errors import InputError
from probedesign.frames import Array
from probedesign.live.bag import Bag
from probedesign.live.block import Block
from probedesign.live.mcap.messages import read_text, read_wrenches
from probedesign.live.mcap.topics import BLOCK, RAW

LONGEST = 1_000_000
"""No source gives more readings at once: it is two minutes of the fastest."""


class OwnBlocks:
    """What a recorder wrote, again as blocks.

    Attributes:
        left_out: readings that the recorder left out, as far as it was read.
    """

    def __init__(self, bag: Bag) -> None:
        """Blocks of a bag that holds `RAW` and `BLOCK`."""
        self._bag = bag
        self.left_out = 0

    def __iter__(self) -> Iterator[Block]:
        """The blocks in order.

        Raises:
            InputError: the file is none of ours, whatever it says.
        """
        raw: list[bytes | memoryview] = []
        self.left_out = 0
        seen, skips = 0, 0
        for message in self._bag.messages({RAW.name, BLOCK.name}):
            if message.topic == RAW.name:
                raw.append(message.data)
                if len(raw) > LONGEST:
                    raise InputError(f"{self._bag.path}: {len(raw)} readings without a {BLOCK.name}")
                continue
            try:
                first, block = _block(raw, read_text(message.data))
            except (ValueError, KeyError, TypeError, RecursionError, OverflowError) as error:
                raise InputError(f"{self._bag.path}: a {BLOCK.name} after {seen} readings: {error}") from None
            if first != seen + self.left_out:  # nothing is averaged over what was left out
                self.left_out, skips = first - seen, skips + 1
            seen, raw = seen + len(block), []
            yield block if not skips else _moved(block, skips)


def _block(raw: list[bytes | memoryview], text: str) -> tuple[int, Block]:
    """How many readings came before it, and the block.

    Raises:
        ValueError, KeyError, TypeError: it is not as it should be.
    """
    known = json.loads(text)
    time = _numbers(known["time_s"])
    gravity = _numbers(known["gravity_base_m_s2"])
    first, stretch, fault = known["first"], known["stretch"], known["fault"]
    if type(first) is not int or type(stretch) is not int or type(fault) is not str or gravity.shape != (3,):
        raise ValueError("it is not as its schema says")
    if len(time) != len(raw):
        raise ValueError(f"it tells of {len(time)} readings, {len(raw)} wrenches stand before it")
    wrench = read_wrenches(raw)
    return first, Block(time, wrench, gravity, np.full(len(time), np.nan), plain(fault, 200), stretch)


def _numbers(values: Any) -> Array:
    array = np.array(values, dtype=float)
    if array.ndim != 1 or not np.isfinite(array).all():
        raise ValueError("its numbers are not finite numbers")
    return array


def _moved(block: Block, skips: int) -> Block:
    """The block, in a stretch of its own after what was left out; 2³² keeps clear of the source's stretches."""
    return Block(block.time, block.wrench_sensor, block.gravity_base, block.received, block.fault,
                 block.stretch + (skips << 32))  # fmt: skip
