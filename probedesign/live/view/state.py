"""How often something comes, and whether it has stopped."""

import math
import time
from collections import deque
from collections.abc import Callable, Mapping

import numpy as np

from probedesign.frames import Array
from probedesign.live.processing.blocks import Block
from probedesign.live.processing.estimates import Answer
from probedesign.live.view.snapshot import STRIP, Health, Moment, Place, Shape, words_of

LEAST = 0.05
"""Silence that is stale at the soonest [s], as for a Net F/T box."""
MISSED = 5.0
"""Silence of so many of the usual gaps is stale."""


class Pace:
    """Beats, of one thread, looked at from another."""

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._beats: deque[tuple[float, int]] = deque(maxlen=64)

    def beat(self, count: int) -> None:
        """So many have come at once."""
        self._beats.append((self._clock(), count))

    @property
    def silence(self) -> float:
        """Since the last beat [s]; NaN before the first."""
        beats = tuple(self._beats)
        return self._clock() - beats[-1][0] if beats else math.nan

    @property
    def rate(self) -> float:
        """A second, of the last beats; NaN before the second."""
        beats = tuple(self._beats)
        span = beats[-1][0] - beats[0][0] if beats else 0.0
        return sum(count for _, count in beats[1:]) / span if span > 0.0 else math.nan

    @property
    def stale(self) -> bool:
        """Whether it has been silent for longer than it is used to."""
        beats = tuple(self._beats)
        if not beats:
            return False
        usual = (beats[-1][0] - beats[0][0]) / max(len(beats) - 1, 1)
        return self._clock() - beats[-1][0] > max(LEAST, MISSED * usual)


TOUCHES = 64
"""Places of earlier touches that are kept."""
ENDED = ("free", "moving", "released")
"""Phases in which nothing touches."""
EVENTS = 8
ABOUT = {"tare": "tare", "recording": "recording", "recorded": "recording"}
"""Of which events begin so the last is what there is to say of tare and recording."""
STRIPS = 4096
"""Rows that wait for who looks; he who looks 30 times a second finds a handful."""


Counts = Callable[[], Mapping[str, int]]


class Keeper:
    """Takes what the run says, without waiting, and gives a `Moment` when it is asked."""

    def __init__(self, counts: Counts = dict, clock: Callable[[], float] = time.monotonic) -> None:
        """Nothing has been read yet.

        Args:
            counts: gives what the source counts: lost, dropped.
            clock: that `received` is told by [s].
        """
        self._counts, self._clock = counts, clock
        self._answer: Answer | None = None
        self._first = math.nan
        self._fault, self._taken = "", 0
        self._readings, self._answers = Pace(clock), Pace(clock)
        self._strip: deque[tuple[float, ...]] = deque(maxlen=STRIPS)
        self._events: deque[tuple[float, str]] = deque(maxlen=EVENTS)
        self._last_said = {"tare": "", "recording": ""}
        self._touches: deque[Place] = deque(maxlen=TOUCHES)
        self._touching: Place | None = None
        self._settled = False
        self._number = 1

    def read(self, block: Block) -> None:
        """Readings have come, or the source says that it is silent."""
        self._fault = block.fault
        if len(block):
            self._taken += len(block)
            self._readings.beat(len(block))

    def answered(self, answer: Answer) -> None:
        """An answer has come."""
        self._answers.beat(1)
        if self._answer is None:
            self._first = answer.reading.time
        self._answer = answer
        self._follow(answer)
        force, estimate = float(np.linalg.norm(answer.estimate.force_base)), answer.estimate
        known = (estimate.s_contact, estimate.std_s, force if estimate.ok else math.nan)
        self._strip.append((answer.reading.time - self._first, *answer.wrench_base.tolist(), *known))

    def told(self, time: float, line: str) -> None:
        """An event."""
        self._events.append((time, line))
        if about := ABOUT.get(line.partition(" ")[0].rstrip(":")):
            self._last_said[about] = line

    def close(self) -> None:
        """Nothing is open."""

    def moment(self, shaped: bool = True) -> Moment:
        """What there is to see now; the probe's shape, if it is wanted, is solved here, in the thread of who asks."""
        answer = self._answer
        health = Health(
            self._readings.stale, self._answers.stale, self._readings.silence, self._readings.rate,
            self._answers.rate, self._fault, self._taken, dict(self._counts()), **self._last_said,
        )  # fmt: skip
        events, strip = tuple(self._events), self._drained()
        if answer is None:
            return Moment(words=words_of(None, None, health), events=events, strip=strip)
        place = place_of(answer, self._counted(answer))
        return Moment(
            since=answer.reading.time - self._first,
            result=answer.estimate.result,
            old=health.stale or health.no_answer,
            words=words_of(answer, place, health),
            shape=shape_of(answer) if shaped else None,
            place=place,
            touches=tuple(self._touches),
            T_world_base=answer.T_world_base,
            gravity_base=answer.reading.gravity_base,
            strip=strip,
            events=events,
        )

    def _drained(self) -> Array:
        rows = []
        while self._strip:
            rows.append(self._strip.popleft())
        return np.array(rows).reshape(-1, len(STRIP))

    def _counted(self, answer: Answer) -> int:
        """Number of the present touch, as whoever follows them counts, else as counted here."""
        return answer.contacts[-1].number if answer.contacts else self._number

    def _follow(self, answer: Answer) -> None:
        """Keep the surest place of a touch: the last one that it was settled at, else that of least deviation."""
        place = place_of(answer, self._counted(answer))
        if place is not None and answer.phase in ("", "touching", "settled"):
            settled = answer.phase == "settled"
            surer = self._touching is None or place.std_s <= self._touching.std_s
            if settled or (surer and not self._settled):
                self._touching = place
            self._settled |= settled
        free = answer.phase in ENDED if answer.phase else answer.estimate.result == "no_contact"
        if free and self._touching is not None:
            self._touches.append(self._touching)
            self._touching, self._settled, self._number = None, False, self._number + 1


def place_of(answer: Answer, number: int) -> Place | None:
    """The contact, from all readings of the touch where they are fused, else from this one; None if it is not sure."""
    estimate, fused, T = answer.estimate, answer.fused, answer.T_world_base
    if not estimate.ok:
        return None
    contact = (estimate.force_base, estimate.s_contact, estimate.std_s)
    when = (answer.reading.time, number, estimate.friction_ratio)
    if not np.isfinite(T).all():
        return Place(estimate.p_surface_base, estimate.cov_surface_base, *contact, False, *when)
    R, origin = T[:3, :3], T[:3, 3]
    contact = (R @ estimate.force_base, estimate.s_contact, estimate.std_s)
    if fused is not None and fused.ok:
        return Place(fused.p_surface_world, fused.cov_surface_world, *contact, True, *when)
    surface = R @ estimate.p_surface_base + origin
    return Place(surface, R @ estimate.cov_surface_base @ R.T, *contact, True, *when)


def shape_of(answer: Answer) -> Shape | None:
    """The probe as the answer has it; None where it does not tell."""
    eq = answer.estimate.shape
    return Shape(eq.s, eq.p_base, eq.R_base) if eq is not None and eq.ok else None
