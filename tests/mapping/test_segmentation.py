"""Answers to touches: what is lost and told again while it begins is one touch, and numbers have no gaps."""

from dataclasses import replace

import numpy as np

from probedesign.live.processing.blocks import WrenchReading
from probedesign.live.processing.estimates import EstimateUpdate
from probedesign.live.processing.touches import ContactHistory
from probedesign.mapping.segmentation import AGAIN, Gathering

STEP = 0.01
"""From one answer to the next [s], about as 36 samples of 3500 a second are."""


def told(*stretches):
    """Series of a base that stands at the origin, from (phase, seconds) one after the other."""
    contacts, gathering, series, time = ContactHistory(), Gathering(), [], 0.0
    blank = EstimateUpdate(
        WrenchReading(0.0, np.zeros(6), np.zeros(3)), None, T_world_base=np.eye(4), wrench_base=np.zeros(6)
    )
    for phase, seconds in stretches:
        for _ in range(round(seconds / STEP)):
            time += STEP
            contacts.update(time, phase, None)
            answer = replace(
                blank, reading=replace(blank.reading, time=time), phase=phase, contacts=contacts.contacts
            )
            series += gathering.take(answer)
    return [*series, *gathering.ended()]


def test_a_touch_that_is_lost_as_it_begins_goes_on():
    (one,) = told(("free", 2.0), ("touching", 2 * STEP), ("released", 2 * STEP), ("touching", 0.2), ("settled", 1.0),
                  ("released", AGAIN), ("free", 2.0))  # fmt: skip
    assert one.number == 1 and abs(one.start - (2.0 + STEP)) < 0.5 * STEP  # when it was told first
    assert len(one.dwells) == 1 and one.before is not None and one.after is not None


def test_what_is_told_again_later_is_another_touch():
    """A brush and a touch after it: the brush stays in the list as one that never settled."""
    brush, touch = told(
        ("free", 2.0), ("touching", 0.1), ("released", AGAIN), ("touching", 0.2), ("settled", 1.0)
    )
    assert (brush.number, touch.number) == (1, 2)
    assert brush.dwells == () and len(touch.dwells) == 1


def test_a_touch_that_was_stood_in_is_over_when_it_is_lost():
    """Else two points, one touched right after the other, would be taken for one."""
    first, second = told(
        ("touching", 0.2), ("settled", 0.5), ("released", 2 * STEP), ("touching", 0.2), ("settled", 0.5)
    )
    assert (first.number, second.number) == (1, 2)
    assert len(first.dwells) == len(second.dwells) == 1
