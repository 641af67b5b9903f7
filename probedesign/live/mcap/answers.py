"""Answers as messages, those of a while laid out together: one by one they take five times as long."""

import json
import math
from collections.abc import Iterator, Sequence

import numpy as np

from probedesign.frames import Array
from probedesign.live.answer import Answer
from probedesign.live.mcap import topics
from probedesign.live.mcap.messages import Bytes, Nanoseconds, nanoseconds, stamped, texts
from probedesign.live.row import json_line, row, world_row

UNTOLD = math.pi**2
"""Variance of each angle of a contact's orientation [rad²], which is not estimated: half a turn either way."""

Values = Sequence[tuple[float, list[float]]]
"""Each with its time [s]."""


def messages_of(answers: Sequence[Answer]) -> Iterator[tuple[topics.Topic, Nanoseconds, Bytes]]:
    """What was said, and what was said it from: by topic the times [ns], (n,), and the messages, (n,)."""
    for topic, frame, values in (
        (topics.WITHOUT_BIAS, "base", _wrenches(answers)),
        (topics.CONTACT, "base", _contacts(answers)),
        (topics.CONTACT_WORLD, "world", _contacts_world(answers)),
    ):
        if values:
            stamps = nanoseconds([time for time, _ in values])
            yield topic, stamps, stamped(frame, stamps, [numbers for _, numbers in values])
    if answers:
        stamps = nanoseconds([answer.reading.time for answer in answers])
        yield topics.ESTIMATE, stamps, texts([_line(answer) for answer in answers])


def _wrenches(answers: Sequence[Answer]) -> Values:
    return [(a.reading.time, a.wrench_base.tolist()) for a in answers if np.isfinite(a.wrench_base).all()]


def _contacts(answers: Sequence[Answer]) -> Values:
    found = [(a.reading.time, a.estimate) for a in answers if a.estimate.ok]
    return [(time, _place(e.p_surface_base, e.cov_surface_base)) for time, e in found]


def _contacts_world(answers: Sequence[Answer]) -> Values:
    found = [(a.reading.time, a.fused) for a in answers if a.fused is not None and a.fused.ok]
    return [(time, _place(f.p_surface_world, f.cov_surface_world)) for time, f in found]


def _place(p: Array, cov: Array) -> list[float]:
    """A point as a pose with covariance, (43,); nothing is said of its orientation."""
    whole = UNTOLD * np.eye(6)
    whole[:3, :3] = cov
    return [*p.tolist(), 0.0, 0.0, 0.0, 1.0, *whole.ravel().tolist()]


def _line(answer: Answer) -> str:
    """What was said as JSON, with the pose to the last bit, which a quaternion does not tell."""
    world = world_row(answer) if answer.fused is not None else {}
    line, T = json_line(row(answer.reading, answer.estimate) | world), answer.T_world_base
    return f'{line[:-1]}, "T_world_base": {json.dumps(T.tolist())}}}' if np.isfinite(T).all() else line
