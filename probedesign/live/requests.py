"""What a person asks of a run while it lasts: the view's buttons, keys of the terminal."""

from collections.abc import Callable
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
        self._done_by: dict[Wish, Callable[[Request], None]] = {}

    def does(self, wish: Wish, act: Callable[[Request], None]) -> None:
        """Who does what is asked, in the thread that runs, between two blocks; it tells what became of it."""
        self._done_by[wish] = act

    def ask(self, wish: Wish, text: str = "") -> None:
        """Ask; answered by an event that every sink is told."""
        self._queue.put(Request(wish, text))

    def taken(self) -> list[Request]:
        """All that was asked since the last call, in order, without what somebody did by now."""
        left: list[Request] = []
        while True:
            try:
                request = self._queue.get_nowait()
            except Empty:
                return left
            if act := self._done_by.get(request.wish):
                act(request)
            else:
                left.append(request)
