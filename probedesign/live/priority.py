"""Priority of a run over other programs and of its estimates over its outputs, while a sensor streams.

With the usual scheduling of Linux a busy computer delays an estimate by many milliseconds. A real-time priority, which
the system grants to administrators and to users with a limit `rtprio`, ends that. All threads of the program get one,
the one that estimates the higher: a thread of usual priority that holds the interpreter while another program runs
would delay the estimates nevertheless.
"""

import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress

#: Thread switch interval of the interpreter while streaming [s]. Another computing thread would keep the interpreter
#: for Python's usual 5 ms, as long as the interval between two estimates.
SWITCH_INTERVAL = 1e-4
#: Real-time priorities. Any of them precedes every program without one; higher ones are for drivers and the system.
OUTPUTS, ESTIMATES = 1, 2


@contextmanager
def prompt_estimates() -> Iterator[bool]:
    """Let the calling thread compute without delay; yield whether the system grants a real-time priority."""
    usual = sys.getswitchinterval()
    sys.setswitchinterval(min(usual, SWITCH_INTERVAL))
    granted = _request()
    try:
        yield granted
    finally:
        sys.setswitchinterval(usual)
        if granted:
            _set_all(os.SCHED_OTHER, 0)


def yield_to_estimates() -> None:
    """Give the calling thread, which computes outputs, the lower priority; it has inherited that of its parent."""
    if sys.platform == "linux" and os.sched_getscheduler(0) == os.SCHED_FIFO:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(OUTPUTS))


def _request() -> bool:
    if sys.platform != "linux" or os.sched_getscheduler(0) != os.SCHED_OTHER:
        return False
    try:
        os.sched_setscheduler(threading.get_native_id(), os.SCHED_FIFO, os.sched_param(ESTIMATES))
    except OSError:  # not allowed
        return False
    _set_all(os.SCHED_FIFO, OUTPUTS, except_for=threading.get_native_id())
    return True


def _set_all(policy: int, priority: int, except_for: int = 0) -> None:
    for name in os.listdir("/proc/self/task"):
        if int(name) != except_for:
            with suppress(OSError):  # the thread has just ended
                os.sched_setscheduler(int(name), policy, os.sched_param(priority))
