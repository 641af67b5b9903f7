"""Handover of values from one thread to another."""

from collections import deque
from typing import TypeVar

MAX_QUEUED = 8192
"""Maximum number of queued values: a second of the fastest sensor."""

T = TypeVar("T")


class Handover(deque[T]):
    """Values that one thread appends and another takes; beyond `MAX_QUEUED` the oldest are dropped."""

    def __init__(self) -> None:
        """Start empty."""
        super().__init__(maxlen=MAX_QUEUED)

    def take(self) -> list[T]:
        """Return the values since the last call, in order."""
        return [self.popleft() for _ in range(len(self))]
