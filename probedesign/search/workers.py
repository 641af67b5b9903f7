"""Worker processes of this machine, made while the command itself still loads.

They are forked from a process that has imported what they need: it does so beside this one, not after it.
"""

import multiprocessing
import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import forkserver
from typing import Any

PRELOADED = ("distributed", "probedesign.search.sweep")
_ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
"""A worker is one thread: more of linear algebra's would only stand in the others' way."""


def method() -> str:
    """How workers are made on this platform."""
    return "forkserver" if "forkserver" in multiprocessing.get_all_start_methods() else "spawn"


def settings() -> dict[str, Any]:
    """For dask."""
    return {"distributed.worker.daemon": True, "distributed.worker.multiprocessing-method": method()}


def prepare() -> None:
    """Start what workers are forked from, where there is such a thing; it is ready while others still load."""
    if method() != "forkserver":
        return
    multiprocessing.set_forkserver_preload(list(PRELOADED))
    before = {name: os.environ.get(name) for name in _ONE_THREAD}
    os.environ.update(_ONE_THREAD)
    try:
        with deaf_to_interruption():
            forkserver.ensure_running()
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


@contextmanager
def deaf_to_interruption() -> Iterator[None]:
    """Processes started here leave Ctrl-C to their parent, who ends them; else each would complain for itself."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
