"""Where readings, answers and events go: recorder, view, publisher, terminal, peers behind one small interface."""

from typing import Protocol

from probedesign.live.answer import Answer
from probedesign.live.block import Block


class Sink(Protocol):
    """Takes what live reads and says. None of the calls waits for a disk, a network or a person."""

    def read(self, block: Block) -> None:
        """Readings as the source gave them, raw, before averaging and tare; a block without readings tells silence,
        and why in its fault."""
        ...

    def answered(self, answer: Answer) -> None:
        """An answer, at the rate of estimates."""
        ...

    def told(self, time: float, line: str) -> None:
        """An event in words, with the source's time [s]: a tare, a mark, silence, loss, a fault."""
        ...

    def close(self) -> None:
        """The run ends; called once, however it ends."""
        ...
