"""Phases of a touch, as the paper's figure 8 shows them: free, moving, touching, settled, released.

The paper marks three stretches of its first touch of the card house: the base moves and the forces vary hardly; the
probe touches and they change; nothing moves and readings are collected. Here they are told apart by three questions:

- Does it touch? The sequential test of `estimator/detector.py` says so of single samples.
- Are the readings steady? Over the last `SPAN` their scatter, and the step from its first half to its second, are no
  more than the sensor's noise, each but for a chance of `CHANCE`.
- Does the base stand? Over the last `SPAN` it went no further than `STANDS`; where no poses are known, what is free
  and not steady counts as moving.
"""

import math
from collections import deque
from typing import Literal

import numpy as np
from scipy.special import chdtri

from probedesign.estimation.detector import Touching
from probedesign.estimation.model import ProbeModel
from probedesign.frames import Array

Phase = Literal["", "free", "moving", "touching", "settled", "released"]

SPAN = 0.25
"""What is looked back on [s]; a soft probe of the paper's size sways once and a half in it. Assumed."""
CHANCE = 1.4e-6
"""That steady readings look unsteady: once an hour at 7000/36 of them a second, as a false alarm does."""
STANDS = 50e-6
"""A base that goes less far within `SPAN` stands [m]: five times the scatter of a robot's poses
(`Tolerances.robot_mm`, assumed). Its rotation counts over `LEVER`."""
LEVER = 0.1
"""Of a rotation [m], as in the tracker."""
MOST = 64
"""Readings of the span that are looked at, at most; of more, means."""


class Steadiness:
    """Whether the readings of the last span vary by no more than their noise, and whether the base stands."""

    def __init__(self, model: ProbeModel, rate: float) -> None:
        """With nothing seen yet.

        Args:
            model: the probe, for the noise of one reading.
            rate: of readings [Hz].
        """
        self._whiten = model.whiten
        self._each = max(1, math.ceil(SPAN * rate / MOST))  # readings to a mean
        n = max(4, math.ceil(SPAN * rate / self._each))
        self._seen, self._filled = np.zeros((n, 6)), 0  # the last rows are filled
        self._poses: deque[Array | None] = deque(maxlen=n)
        self._sum, self._count = np.zeros(6), 0
        self._most = chdtri(6 * (n - 1), 0.5 * CHANCE), chdtri(6, 0.5 * CHANCE)  # scatter, step

    def see(self, wrench: Array, T_world_base: Array | None) -> None:
        """Take in a reading at the base, less the free probe's [N, N·m], (6,), and where the base was."""
        self._sum = self._sum + wrench
        self._count += 1
        if self._count == self._each:
            self._seen[:-1] = self._seen[1:]
            self._seen[-1] = self._whiten @ self._sum / math.sqrt(self._each)
            self._filled = min(self._filled + 1, len(self._seen))
            self._poses.append(T_world_base)
            self._sum, self._count = np.zeros(6), 0

    def forget(self) -> None:
        """Begin anew: what was seen belongs to another phase."""
        self._filled = 0
        self._poses.clear()
        self._sum, self._count = np.zeros(6), 0

    @property
    def full(self) -> bool:
        """Whether a whole span has been seen."""
        return self._filled == len(self._seen)

    @property
    def steady(self) -> bool:
        """Whether a whole span has been seen and nothing in it changed."""
        if not self.full:
            return False
        n, half = len(self._seen), len(self._seen) // 2
        apart = self._seen - self._seen.sum(axis=0) / n
        step = (apart[-half:].sum(axis=0) - apart[:half].sum(axis=0)) / half
        scatter, shifted = np.vdot(apart, apart), 0.5 * half * np.vdot(step, step)
        return bool(scatter <= self._most[0] and shifted <= self._most[1])

    @property
    def moves(self) -> bool | None:
        """Whether the base moves; None where its poses are not all known."""
        poses = [T for T in self._poses if T is not None]
        if not poses or len(poses) < len(self._poses):
            return None
        seen, last = np.array(poses), poses[-1]
        gone = np.linalg.norm(seen[:, :3, 3] - last[:3, 3], axis=1)
        # |R - R'| by Frobenius is 2√2 sin(angle/2): √2 of the angle where that is small.
        turned = np.linalg.norm(seen[:, :3, :3] - last[:3, :3], axis=(1, 2)) / math.sqrt(2.0)
        return bool((np.maximum(gone, LEVER * turned) > STANDS).any())


class Phases:
    """Follows the phases, reading by reading."""

    def __init__(self, model: ProbeModel, rate: float) -> None:
        """With nothing seen yet; arguments as of `Steadiness`."""
        self.steadiness = Steadiness(model, rate)
        self._phase: Phase = ""

    def next(self, touching: Touching, wrench: Array, T_world_base: Array | None) -> Phase:
        """The phase after one more reading.

        Args:
            touching: what the test said last of it; "lost" if it said so of any sample.
            wrench: at the base, less the free probe's [N, N·m], (6,).
            T_world_base: where the base was, (4, 4), if it is known.
        """
        steadiness = self.steadiness
        if touching == "lost" or (touching == "contact") != (self._phase in ("touching", "settled")):
            steadiness.forget()
        steadiness.see(wrench, T_world_base)
        self._phase = self._now(touching)
        return self._phase

    def _now(self, touching: Touching) -> Phase:
        steadiness, before = self.steadiness, self._phase
        if touching == "lost":
            return "released"
        if touching == "contact":
            return "settled" if steadiness.steady and not steadiness.moves else "touching"
        if before == "released" and not steadiness.full:
            return "released"
        moves = steadiness.moves
        if moves is None:
            moves = steadiness.full and not steadiness.steady
        return "moving" if moves else "free"
