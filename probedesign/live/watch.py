"""Watches the probe while readings come: touching or not, the phase, the fusion, the contacts so far."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from probedesign.estimation.detector import Detector, Touching
from probedesign.estimation.estimator import Estimator
from probedesign.estimation.fused import FusedEstimate
from probedesign.estimation.tracker import Tracker
from probedesign.frames import Array
from probedesign.live.batch import Batch
from probedesign.live.contacts import Contacts
from probedesign.live.phases import Phase, Phases
from probedesign.live.pose.latency import TOLD, Timing
from probedesign.live.pose.poses import Poses
from probedesign.live.tare import Tare

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
