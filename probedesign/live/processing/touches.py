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
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.special import chdtri

from probedesign.estimation.detector import Detector, Touching
from probedesign.estimation.estimate import Estimate
from probedesign.estimation.estimator import Estimator
from probedesign.estimation.fused import FusedEstimate
from probedesign.estimation.model import ProbeModel
from probedesign.estimation.tracker import Tracker
from probedesign.frames import Array
from probedesign.live.poses.base_poses import Poses
from probedesign.live.poses.latency import TOLD, Timing
from probedesign.live.processing.blocks import Batch
from probedesign.live.processing.tare import Tare

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
MAX_MEANS = 64
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
        self._each = max(1, math.ceil(SPAN * rate / MAX_MEANS))  # readings to a mean
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


MAX_CONTACTS = 1000
"""Contacts that are kept; of a longer run the last."""


@dataclass(frozen=True)
class Contact:
    """One touch.

    Attributes:
        number: from 1.
        start: when it was told [s].
        end: when it was lost [s]; NaN while it lasts.
        settled: whether readings and base stood still in it.
        fused: the point that its readings tell, as answered last while it was settled, or last at all if it never was.
        estimate: the last located one of a single reading, of settled ones if there are any.
    """

    number: int
    start: float
    end: float = math.nan
    settled: bool = False
    fused: FusedEstimate | None = None
    estimate: Estimate | None = None

    @property
    def lasts(self) -> bool:
        """Whether it still touches."""
        return math.isnan(self.end)

    @property
    def line(self) -> str:
        """It in one line."""
        told = f"touch {self.number}, {self.start:.2f} ... {self.end:.2f} s"
        if not self.settled:
            told += ", never settled"
        if self.fused is not None and self.fused.ok:
            x, y, z = (1e3 * float(value) for value in self.fused.p_surface_world)
            return f"{told}: ({x:z.2f}, {y:z.2f}, {z:z.2f}) mm in the world, ± {1e3 * self.fused.rms:.2f} mm"
        if self.fused is not None:
            told += f": as one point of the world {self.fused.result}"
        if self.estimate is not None:
            s, std = 1e3 * self.estimate.s_contact, 1e3 * self.estimate.std_s
            return f"{told}{'; ' if self.fused is not None else ': '}one reading alone says s {s:.1f} ± {std:.1f} mm"
        return f"{told}: not located"


class Contacts:
    """Keeps the list while phases and answers come.

    Attributes:
        so_far: every touch, the present one included.
    """

    def __init__(self) -> None:
        self.so_far: tuple[Contact, ...] = ()
        self._count = 0

    @property
    def present(self) -> Contact | None:
        """The touch that lasts."""
        return self.so_far[-1] if self.so_far and self.so_far[-1].lasts else None

    def follow(self, time: float, phase: Phase, fused: FusedEstimate | None) -> Contact | None:
        """Take in the phase at a time [s] and what is fused by then; the touch that has just ended, if one has."""
        present = self.present
        if phase not in ("touching", "settled"):
            return None if present is None else self._keep(replace(present, end=time))
        if present is None:
            self._count += 1
            present = Contact(self._count, time)
            self.so_far = (*self.so_far[1 - MAX_CONTACTS :], present)
        if phase == "settled" or not present.settled:
            present = replace(present, fused=fused or present.fused)
        self._keep(replace(present, settled=present.settled or phase == "settled"))
        return None

    def locate(self, estimate: Estimate, phase: Phase) -> None:
        """Take in the estimate of one reading of the present touch."""
        present = self.present
        if present is None or not estimate.ok:
            return
        if phase == "settled" or not present.settled:
            self._keep(replace(present, estimate=estimate))

    def _keep(self, contact: Contact) -> Contact:
        self.so_far = (*self.so_far[:-1], contact)
        return contact


BIAS_STEPS = 0.5
"""Of the bias since the tare, in steps of the sensor's resolution: what a walk of `detector.DRIFT_STEPS` makes of it in
a hundred seconds. Free readings before the touch tie it down."""
Say = Callable[[str], None]
"""Takes a line that a user should know."""


@dataclass(frozen=True)
class Seen:
    """What is known after a batch.

    Attributes:
        phase: of the touch; empty where it cannot be told.
        fused: from all readings of this touch; None where no poses are known.
    """

    phase: Phase
    fused: FusedEstimate | None


class Watch:
    """Sees every batch. The test is on its single samples, the phase on its mean, and so is the fusion: the tracker
    takes a mean for one sample of a sensor with the mean's noise."""

    def __init__(
        self,
        estimator: Estimator,
        contacts: Contacts,
        rate: float,
        samples: int,
        poses: Poses | None,
        say: Say,
        estimates: bool = True,
    ) -> None:
        """With nothing seen yet.

        Args:
            estimator: of the probe, for the noise of a batch's mean.
            contacts: the list to go on with.
            rate: of single samples [Hz].
            samples: of a batch.
            poses: of the base, if they are known.
            say: takes each line that a user should know.
            estimates: whether the readings of a touch become a point of the world, and are told, as they come.
        """
        model = estimator.model
        self._estimator, self._contacts, self._poses, self._say = estimator, contacts, poses, say
        self._tells = estimates
        self._detector = Detector(replace(model, averaging_samples=samples), rate)
        self._phases = Phases(model, rate / samples)
        self._timing = Timing(model.whiten)
        self._tracker: Tracker | None = None
        if poses is not None and estimates:
            of_means = Estimator(replace(model, averaging_samples=1), estimator.tolerances)
            # Of a mean that is taken for a sample, the noise is the step; the sensor's own is so much greater.
            step = math.sqrt(model.averaging_samples)
            known = estimator.priors
            priors = replace(known, drift_steps=BIAS_STEPS * step, walk_steps=known.walk_steps * step)
            self._tracker = Tracker(
                of_means, priors=priors, gravity_world=poses.gravity_world, rate=rate / samples
            )
        self._seen = self._unknown
        self._each, self._last = samples / rate, math.nan

    @property
    def _unknown(self) -> Seen:
        return Seen("", None if self._poses is None else FusedEstimate("out_of_range"))

    def see(self, batch: Batch, tare: Tare | None, T_world_base: Array | None) -> Seen:
        """Take in a batch that is right, its gravity known.

        Args:
            batch: bias included.
            tare: of the bias.
            T_world_base: of the base, (4, 4), if poses are known.
        """
        gravity = batch.reading.gravity_base
        free = self._estimator.free(gravity)
        if not free.ok:
            return self._unknown
        self._missed(batch.reading.time)
        beyond = self._beyond(batch, tare)
        mean, said = beyond.mean(axis=0), self._detector.run(beyond)
        phase = self._phases.next("lost" if "lost" in said else said[-1], mean, T_world_base)
        fused = self._fused(said, mean + free.wrench_base, T_world_base, batch.reading.time)
        self._follow(batch.reading.time, phase, fused)
        self._check(batch.reading.time, phase, mean, T_world_base)
        self._seen = Seen(phase, fused)
        return self._seen

    def learn(self, batches: list[Batch], tare: Tare) -> None:
        """See batches of a probe that is known to be free, as those of the tare are: how it sways, and how the bias
        has walked since their mean."""
        if batches:
            self._detector.calibrate(np.concatenate([self._beyond(batch, tare) for batch in batches]))

    def _beyond(self, batch: Batch, tare: Tare | None) -> Array:
        """Its samples at the base, less the free probe's, (n, 6)."""
        gravity, bias = batch.reading.gravity_base, 0.0 if tare is None else tare.bias_sensor
        samples = self._estimator.model.to_base(batch.block.wrench_sensor - bias, gravity)
        return samples - self._estimator.free(gravity).wrench_base

    def _missed(self, time: float) -> None:
        """Let the test know of samples that never came."""
        gap = time - self._last - self._each
        if gap > self._each:
            self._detector.rest(gap)
        self._last = time

    def interrupted(self) -> None:
        """Readings are missing between the last and the next."""
        self._phases.steadiness.forget()

    def _fused(
        self, said: list[Touching], wrench: Array, T: Array | None, time: float
    ) -> FusedEstimate | None:
        """The tracker's answer. A batch that is partly free and partly not tells nothing of either."""
        if self._tracker is None or T is None:
            return None
        if "lost" in said:
            return self._tracker.update(wrench, T, time, "lost")
        if len(set(said)) == 1:
            return self._tracker.update(wrench, T, time, said[0])
        return FusedEstimate("no_contact")

    def _follow(self, time: float, phase: Phase, fused: FusedEstimate | None) -> None:
        ended = self._contacts.follow(time, phase, fused)
        if ended is not None and self._tells:
            self._say(ended.line)

    def _check(self, time: float, phase: Phase, beyond: Array, T: Array | None) -> None:
        """Of every touch, when it settles, whether poses and wrench moved at one time."""
        if T is None or self._poses is None:
            return
        if phase not in ("touching", "settled"):
            return self._timing.forget()
        if phase == "settled" and self._seen.phase == "touching":
            late = 1e3 * self._timing.late()
            if abs(late) > 1e3 * TOLD:
                stated = 1e3 * self._poses.latency
                self._say(
                    f"poses: in this touch they came {abs(late):.0f} ms {'later' if late > 0 else 'earlier'} than "
                    f"stated, by the wrench; is it --pose-latency-ms {stated + late:.0f} rather than {stated:g}?"
                )
        self._timing.see(time, T[:3, 3], beyond)
