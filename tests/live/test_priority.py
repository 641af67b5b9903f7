"""The priority of estimates while a sensor streams, and what remains of it afterwards."""

import os
import sys
import threading

import pytest

from probedesign.live import priority
from probedesign.live.priority import ESTIMATES, OUTPUTS, prompt_estimates, yield_to_estimates
from tests.live.peers import until

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="only Linux has these priorities")


def state(thread=0):
    return os.sched_getscheduler(thread), os.sched_getparam(thread).sched_priority


def test_threads_of_outputs_come_after_the_estimates_and_all_is_as_usual_afterwards():
    """One that started before the sensor streams, and one that starts meanwhile."""
    ended, tasks, before, interval = threading.Event(), [], state(), sys.getswitchinterval()

    def wait():
        yield_to_estimates()
        tasks.append(threading.get_native_id())
        ended.wait(10.0)

    threads = [threading.Thread(target=wait) for _ in range(2)]
    threads[0].start()
    try:
        with prompt_estimates() as granted:
            threads[1].start()
            until(lambda: len(tasks) == 2)
            own, seen = state(), [state(task) for task in tasks]
            assert sys.getswitchinterval() <= interval
        after = [state(task) for task in tasks]
    finally:
        ended.set()
        for thread in threads:
            thread.join()
    assert own == ((os.SCHED_FIFO, ESTIMATES) if granted else before)
    assert seen == [(os.SCHED_FIFO, OUTPUTS) if granted else before] * 2
    assert after == [before] * 2 and state() == before and sys.getswitchinterval() == interval


def test_a_run_without_the_permission_is_not_changed(monkeypatch):
    def refuse(*arguments):
        raise PermissionError(1, "Operation not permitted")

    before = state()
    monkeypatch.setattr(priority.os, "sched_setscheduler", refuse)
    with prompt_estimates() as granted:
        assert not granted and state() == before


def test_a_priority_of_the_user_is_kept():
    if not priority._request():
        pytest.skip("the system grants no priority")
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(7))
    try:
        with prompt_estimates() as granted:
            assert not granted and state() == (os.SCHED_FIFO, 7)
        assert state() == (os.SCHED_FIFO, 7)
    finally:
        priority._set_all(os.SCHED_OTHER, 0)
