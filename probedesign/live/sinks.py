"""Many sinks as one, so that a run feeds them all and outlives each of them."""

import math
import sys
from collections.abc import Callable

from probedesign.live.answer import Answer
from probedesign.live.block import Block
from probedesign.live.sink import Sink

Say = Callable[[str], None]


class Sinks:
    """A sink of sinks. One that fails is dropped, with one line to the others, and the run goes on."""

    def __init__(self, *sinks: Sink) -> None:
        self._sinks = list(sinks)
        self._time = math.nan

    def add(self, sink: Sink) -> None:
        """One more, from now on."""
        self._sinks.append(sink)

    def read(self, block: Block) -> None:
        """Readings as the source gave them."""
        if len(block):
            self._time = float(block.time[-1])
        self._each(lambda sink: sink.read(block))

    def answered(self, answer: Answer) -> None:
        """An answer."""
        self._each(lambda sink: sink.answered(answer))

    def told(self, time: float, line: str) -> None:
        """An event."""
        self._each(lambda sink: sink.told(time, line))

    def say(self, line: str) -> None:
        """An event at the time of the last reading; safe from other threads."""
        self.told(self._time, line)

    def close(self) -> None:
        """The run ends: every sink is closed, whatever becomes of the others, the last first, so that they can
        still say something."""
        while self._sinks:
            last = self._sinks.pop()
            try:
                last.close()
            except Exception as error:
                self.say(f"{type(last).__name__} cannot be closed: {error} ({type(error).__name__})")

    def _each(self, call: Callable[[Sink], None]) -> None:
        for sink in tuple(self._sinks):
            try:
                call(sink)
            except Exception as error:
                self._drop(sink, error)

    def _drop(self, sink: Sink, error: Exception) -> None:
        if sink in self._sinks:
            self._sinks.remove(sink)
            self.say(
                f"{type(sink).__name__} fails and is left out from here on: {error} ({type(error).__name__})"
            )


class Spoken:
    """What is told goes to standard error, a line each."""

    def read(self, block: Block) -> None:
        """Nothing is said of readings."""

    def answered(self, answer: Answer) -> None:
        """Nothing is said of answers."""

    def told(self, time: float, line: str) -> None:
        """The line."""
        print(line, file=sys.stderr, flush=True)

    def close(self) -> None:
        """There is nothing to close."""
