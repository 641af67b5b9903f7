"""What a person asks of a run while it lasts: the view's buttons, keys of the terminal."""

from dataclasses import dataclass
from queue import Empty, SimpleQueue
from typing import Literal

Wish = Literal["tare", "mark", "start recording", "stop recording", "stop"]


@dataclass(frozen=True)
class Request:
    """One wish.

    Attributes:
        wish: what is asked.
        text: of a mark.
    """

    wish: Wish
    text: str = ""


class Requests:
    """From any thread to the one that runs, which looks between two blocks of readings."""

    def __init__(self) -> None:
        self._queue: SimpleQueue[Request] = SimpleQueue()

    def ask(self, wish: Wish, text: str = "") -> None:
        """Ask; answered by an event that every sink is told."""
        self._queue.put(Request(wish, text))

    def taken(self) -> list[Request]:
        """All that was asked since the last call, in order."""
        found = []
        while True:
            try:
                found.append(self._queue.get_nowait())
            except Empty:
                return found
