"""Tests of segmentation: a touch lost and detected again at its beginning is one touch, and numbers have no gaps."""

from dataclasses import replace

import numpy as np

from probedesign.live.blocks import WrenchReading
from probedesign.live.processing.estimates import EstimateUpdate
from probedesign.live.processing.touches import ContactHistory
from probedesign.mapping.segmentation import REJOIN_TIME, TouchSegmenter

STEP = 0.01  #: Interval between estimates [s], about that of means of 36 samples at 3500 Hz.


def segments(*phases):
    """Return the segments of a stationary base, from consecutive (phase, duration [s])."""
    contacts, segmenter, found, time = ContactHistory(), TouchSegmenter(), [], 0.0
    blank = EstimateUpdate(
        WrenchReading(0.0, np.zeros(6), np.zeros(3)), None, T_world_base=np.eye(4), wrench_base=np.zeros(6)
    )
    for phase, seconds in phases:
        for _ in range(round(seconds / STEP)):
            time += STEP
            contacts.update(time, phase, None)
            update = replace(blank, reading=replace(blank.reading, time=time), phase=phase, contacts=contacts.contacts)
            found += segmenter.update(update)
    return [*found, *segmenter.finish()]


def test_a_touch_lost_at_its_beginning_continues():
    (one,) = segments(
        *[("free", 2.0), ("touching", 2 * STEP), ("released", 2 * STEP), ("touching", 0.2), ("settled", 1.0)],
        *[("released", REJOIN_TIME), ("free", 2.0)],
    )
    assert one.number == 1 and abs(one.start - (2.0 + STEP)) < 0.5 * STEP  # its first detection
    assert len(one.intervals) == 1 and one.free_before is not None and one.free_after is not None


def test_a_base_that_creeps_during_a_touch_for_hours_keeps_no_reading_of_each_pose():
    """Each reading has a pose of its own, so none is at rest."""
    segmenter, contacts = TouchSegmenter(), ContactHistory()
    for k in range(1000):
        contacts.update(k * STEP, "settled", None)
        T = np.eye(4) + 2e-5 * k * np.eye(4, k=3)
        list(segmenter.update(EstimateUpdate(
            WrenchReading(k * STEP, np.zeros(6), np.zeros(3)), None, phase="settled", T_world_base=T,
            wrench_base=np.zeros(6), contacts=contacts.contacts)))  # fmt: skip
    assert len(segmenter._intervals) == 1
    (touch,) = segmenter.finish()
    assert touch.intervals == ()


def test_a_contact_detected_later_is_another_touch():
    """A brief contact stays in the list as a touch that never settled."""
    brush, touch = segments(
        ("free", 2.0),
        ("touching", 0.1),
        ("released", REJOIN_TIME),
        ("free", REJOIN_TIME),
        ("touching", 0.2),
        ("settled", 1.0),
    )
    assert (brush.number, touch.number) == (1, 2)
    assert brush.intervals == () and len(touch.intervals) == 1


def test_a_touch_with_a_stationary_interval_ends_when_it_is_lost():
    """Otherwise two points touched in quick succession would be taken for one."""
    first, second = segments(
        ("touching", 0.2), ("settled", 0.5), ("released", 2 * STEP), ("touching", 0.2), ("settled", 0.5)
    )
    assert (first.number, second.number) == (1, 2)
    assert len(first.intervals) == len(second.intervals) == 1
