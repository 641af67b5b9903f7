"""Wrenches in anybody's bag."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice

import numpy as np

from probedesign.core.csv_tables import plain, shown
from probedesign.errors import InputError
from probedesign.frames import Array
from probedesign.live.bag import Bag, Channel, Message, choose
from probedesign.live.mcap.messages import WRENCH, read_stamped

AT_ONCE = 256
"""Readings to a block: few enough to be soon there, enough to be cheap."""
Wrenches = tuple[Array, Array]
"""Times [s], (n,), and wrenches as published, (n, 6)."""


@dataclass(frozen=True)
class Published:
    """A topic of wrenches.

    Attributes:
        bag: that holds it.
        channel: of it.
        frame_id: that its first message names.
        unstamped: whether its headers say no time, so that the time of recording counts.
    """

    bag: Bag
    channel: Channel
    frame_id: str
    unstamped: bool

    def wrenches(self) -> Iterator[Wrenches]:
        """Times and wrenches, some at once.

        Raises:
            InputError: a message is none.
        """
        messages = self.bag.messages({self.channel.topic})
        while batch := list(islice(messages, AT_ONCE)):
            read = [_read(self.bag, message) for message in batch]
            pairs = zip(batch, read, strict=True)
            stamps = [message.logged if self.unstamped else stamp for message, (stamp, _, _) in pairs]
            yield np.array(stamps, dtype=float) / 1e9, np.array([values for _, _, values in read])


def find_wrenches(bag: Bag, topic: str = "") -> Published:
    """The topic of wrenches in a bag.

    Args:
        bag: to read.
        topic: its name; may be empty if there is only one.

    Raises:
        InputError: there is none, it holds nothing, or there are several and no name.
    """
    channel = choose(bag, {WRENCH}, topic)
    first = next(iter(bag.messages({channel.topic})), None)
    if first is None:
        raise InputError(
            f"{bag.path}: topic {plain(channel.topic)} holds no messages" + (bag.damage and f"; {bag.damage}")
        )
    stamp, frame_id, _ = _read(bag, first)
    return Published(bag, channel, frame_id, stamp == 0)


def _read(bag: Bag, message: Message) -> tuple[int, str, tuple[float, ...]]:
    try:
        return read_stamped(message.data, 6)
    except ValueError as error:
        at = f"{message.logged / 1e9:.9g} s"
        raise InputError(f"{bag.path}: a message of {shown(message.topic)} logged at {at}: {error}") from None
