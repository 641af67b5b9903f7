"""How a long run may be ended from outside: a closed terminal and `kill` end it as Ctrl-C does."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType


@contextmanager
def ending_well() -> Iterator[None]:
    """SIGTERM and SIGHUP raise KeyboardInterrupt, so that files are closed; one that is ignored, as nohup has it,
    stays so. Only for the main thread."""
    found = {}
    for name in ("SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)  # Windows knows no SIGHUP
        if number is not None and signal.getsignal(number) == signal.SIG_DFL:
            found[number] = signal.signal(number, _interrupt)
    try:
        yield
    finally:
        for number, before in found.items():
            signal.signal(number, before)


def _interrupt(number: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt
