"""Touch monitoring: contact detection, the phase of a touch, fusion of its readings, and the list of contacts.

The phases are those of the paper's figure 8. The contact test of `estimation/detector.py` reads single samples. Over
the last `SPAN`, readings are stationary if their scatter and the step from its first half to its second are within the
sensor's noise, each at a false-alarm probability of `FALSE_ALARM`, and the base if it moved by no more than
`MAX_TRAVEL`. Without poses, a free probe whose readings are not stationary counts as moving.
"""

import math
from collections import deque
from dataclasses import dataclass, replace
from itertools import groupby
from typing import Literal, NamedTuple

import numpy as np
from scipy.special import chdtri

from probedesign.core.frames import Array
from probedesign.core.statistics import FALSE_ALARM, max_chi2
from probedesign.estimation.bias import KnownBias
from probedesign.estimation.detector import Detector, Touching
from probedesign.estimation.estimate import Estimate, FusedEstimate
from probedesign.estimation.estimator import Estimator
from probedesign.estimation.model import ProbeModel
from probedesign.estimation.tracker import Tracker
from probedesign.live import Log
from probedesign.live.blocks import joined
from probedesign.live.poses.base_poses import BasePoses
from probedesign.live.processing.averaging import AveragedBatch
from probedesign.live.processing.drift import DriftFollower
from probedesign.live.processing.motion import LEVER, MAX_TRAVEL, MotionMonitor, fit_sway, parabola
from probedesign.live.processing.motion import SPAN as FIT_SPAN
from probedesign.live.processing.tare import CHANNELS, Tare

Phase = Literal["", "free", "moving", "touching", "settled", "released"]

#: Length of the interval that is tested [s]; a soft probe of the paper's size oscillates 1.5 times in it. Assumed.
SPAN = 0.25
#: Probability that readings without a sway are not smooth: that only delays a position. A sway of 1.3 standard
#: deviations of 48 readings is as improbable.
SMOOTH_CHANCE = 0.05
KEPT_CHANCE = 1e-4  #: The same of readings with a sway after those before were explained: a position does not flicker.
MIN_SPAN = 8  #: Least number of values in the span that show a sway.
MAX_MEANS = 64  #: Maximum number of values in the span; more readings are averaged.


#: Squares of the elements of a step between two poses (3, 4) to those of its distance, and of its angle times `LEVER`:
#: the Frobenius norm |R - R'| is 2√2 sin(angle/2), which is √2 angle for small angles.
_TRAVELS = np.zeros((12, 2))
_TRAVELS[3::4, 0] = 1.0
_TRAVELS[np.arange(12) % 4 < 3, 1] = 0.5 * LEVER**2


class StationarityTest:
    """Tests whether the readings of the last span vary by no more than their noise, and whether the base moves."""

    def __init__(self, model: ProbeModel, rate: float) -> None:
        """Start with an empty span; the model gives the noise of one reading, `rate` is that of readings [Hz]."""
        self._whiten = model.whiten
        self._period = max(1, math.ceil(SPAN * rate / MAX_MEANS))  # readings to a mean
        n = max(4, math.ceil(SPAN * rate / self._period))
        self._samples, self._filled = np.zeros((n, 6)), 0  # the last rows are filled
        self._poses, self._posed = (np.zeros((n, 12)), 0)  # rows of each pose, and how many of the last rows are known
        self._sum, self._count = np.zeros(6), 0
        self._limits = chdtri(6 * (n - 1), 0.5 * FALSE_ALARM), chdtri(6, 0.5 * FALSE_ALARM)  # scatter, step

    def update(self, wrench: Array, T_world_base: Array | None) -> None:
        """Add a reading at the base minus the free probe's [N, N·m], (6,), and the pose of the base."""
        self._sum = self._sum + wrench
        self._count += 1
        if self._count == self._period:
            self._samples[:-1] = self._samples[1:]
            self._samples[-1] = self._whiten @ self._sum / math.sqrt(self._period)
            self._filled = min(self._filled + 1, len(self._samples))
            self._posed = 0 if T_world_base is None else min(self._posed + 1, len(self._samples))
            self._poses[:-1] = self._poses[1:]
            self._poses[-1] = 0.0 if T_world_base is None else T_world_base[:3].ravel()
            self._sum, self._count = np.zeros(6), 0

    def reset(self) -> None:
        """Discard the span: its readings belong to another phase."""
        self._filled = self._posed = 0
        self._sum, self._count = np.zeros(6), 0

    @property
    def readings(self) -> int:
        """Number of readings in the span."""
        return self._period * len(self._samples)

    @property
    def mean(self) -> Array:
        """Mean of the span, whitened by the noise of one reading, (6,)."""
        return np.asarray(self._samples.mean(axis=0) / math.sqrt(self._period))

    @property
    def full(self) -> bool:
        """Whether the span is full."""
        return self._filled == len(self._samples)

    @property
    def stationary(self) -> bool:
        """Whether the span is full and its readings pass both tests."""
        if not self.full:
            return False
        n, half = len(self._samples), len(self._samples) // 2
        deviations = self._samples - self._samples.sum(axis=0) / n
        step = (deviations[-half:].sum(axis=0) - deviations[:half].sum(axis=0)) / half
        scatter, shifted = np.vdot(deviations, deviations), 0.5 * half * np.vdot(step, step)
        return bool(scatter <= self._limits[0] and shifted <= self._limits[1])

    def sway(self, count: int, chance: float) -> Array | None:
        """Return the sway in the last readings [N, N·m], (count, 6), by the values of the span.

        It is zero where they scatter about a parabola like noise. Otherwise it is one damped oscillation, where that
        and a parabola leave noise while the base moves along a parabola. None where there is more, or the span is not
        full.

        Args:
            count: number of readings.
            chance: probability that readings without any other sway than one are refused.
        """
        n, values = len(self._samples), self._samples
        if not self.full or n <= 3:
            return None
        left = values - parabola(n) @ (parabola(n).T @ values)
        if np.vdot(left, left) <= chdtri(6 * (n - 3), SMOOTH_CHANCE):
            return np.zeros((count, 6))
        strayed = self._poses - parabola(n) @ (parabola(n).T @ self._poses)
        if min(self._posed, n) < max(n, MIN_SPAN) or (strayed * strayed @ _TRAVELS).max() > MAX_TRAVEL**2:
            return None
        ages = np.arange(count)[::-1] - self._count - 0.5 * (self._period - 1)  # since the middle of the last value
        sway, chi2 = fit_sway(values, n - 1 - ages / self._period)
        if chi2 > chdtri(6 * (n - 5) - 2, chance):
            return None
        return np.asarray(np.linalg.solve(self._whiten, sway.T).T / math.sqrt(self._period))

    @property
    def moving(self) -> bool | None:
        """Whether the base moves; None if a pose is missing."""
        if self._posed < max(self._filled, 1):
            return None
        steps = self._poses[-self._filled :] - self._poses[-1]
        return bool((steps * steps @ _TRAVELS).max() > MAX_TRAVEL**2)


class PhaseTracker(StationarityTest):
    """Tracks the phase of the touch, reading by reading."""

    _phase: Phase = ""

    def next(self, touching: Touching, wrench: Array, T_world_base: Array | None) -> Phase:
        """Return the phase after one more reading; see `StationarityTest.update`.

        `touching` is the last decision of the detector for it; "lost" if that was the decision for any of its samples.
        """
        if touching == "lost" or (touching == "contact") != (self._phase in ("touching", "settled")):
            self.reset()
        self.update(wrench, T_world_base)
        moving = self.moving
        if touching == "lost":
            self._phase = "released"
        elif touching == "contact":
            self._phase = "settled" if self.stationary and not moving else "touching"
        elif self._phase != "released" or self.full:
            if moving is None:
                moving = self.full and not self.stationary
            self._phase = "moving" if moving else "free"
        return self._phase


MAX_CONTACTS = 1000  #: Maximum number of contacts in the list; older ones are dropped.


@dataclass(frozen=True)
class Contact:
    """One touch."""

    number: int  #: number of the touch, from 1.
    start: float  #: time of detection [s].
    end: float = math.nan  #: time at which contact was lost [s]; NaN while it lasts.
    settled: bool = False  #: whether readings and base were stationary at any time during the touch.
    #: fused estimate, the last one while settled, or the last one of all if the touch never settled.
    fused: FusedEstimate | None = None
    estimate: Estimate | None = None  #: last located single-reading estimate, of settled readings if there are any.

    @property
    def ongoing(self) -> bool:
        """Whether the probe still touches."""
        return math.isnan(self.end)

    @property
    def summary(self) -> str:
        """The touch in one line."""
        text = f"touch {self.number}, {self.start:.2f} ... {self.end:.2f} s"
        if not self.settled:
            text += ", never settled"
        if self.fused is not None and self.fused.ok:
            x, y, z = (1e3 * float(value) for value in self.fused.p_surface_world)
            low, high = self.fused.object_compliance_interval_95
            yields = f", yields {1e3 * low:.0f} to {1e3 * high:.0f} mm/N" if high > 0.0 else ""
            return f"{text}: ({x:z.2f}, {y:z.2f}, {z:z.2f}) mm in world, ± {1e3 * self.fused.rms:.2f} mm{yields}"
        if self.fused is not None:
            text += f": fused to one point: {self.fused.result}"
        if self.estimate is not None:
            s, std = 1e3 * self.estimate.s_contact, 1e3 * self.estimate.std_s
            return f"{text}{'; ' if self.fused is not None else ': '}single reading: s {s:.1f} ± {std:.1f} mm"
        return f"{text}: not located"


class ContactHistory:
    """Updates the list of contacts from phases and estimates.

    Attributes:
        contacts: every touch, including the current one.
    """

    def __init__(self) -> None:
        self.contacts: tuple[Contact, ...] = ()
        self._count, self._lost = 0, math.nan

    @property
    def current(self) -> Contact | None:
        """The ongoing touch, or None."""
        return self.contacts[-1] if self.contacts and self.contacts[-1].ongoing else None

    def update(self, time: float, phase: Phase, fused: FusedEstimate | None) -> Contact | None:
        """Add the phase at a time [s] and the fused estimate; return the touch that has just ended, if any."""
        current = self.current
        if fused is not None and fused.result == "in_motion":  # the last position of the touch stays
            fused = None
        if phase not in ("touching", "settled"):
            self._lost = time if math.isnan(self._lost) else self._lost
            # A contact that comes back within `SPAN` and never settled is a sway, which crosses the threshold twice a
            # period, or an object that slips.
            if current is None or (phase == "released" and not current.settled):
                return None
            return self._replace_last(replace(current, end=self._lost))
        self._lost = math.nan
        if current is None:
            self._count += 1
            current = Contact(self._count, time)
            self.contacts = (*self.contacts[1 - MAX_CONTACTS :], current)
        settled, point = current.settled or phase == "settled", current.fused
        if phase == "settled" or not settled:
            point = fused or point
        if settled != current.settled or point is not current.fused:
            self._replace_last(replace(current, fused=point, settled=settled))
        return None

    def locate(self, estimate: Estimate, phase: Phase) -> None:
        """Add the estimate of one reading of the current touch."""
        current = self.current
        if current is None or not estimate.ok:
            return
        if phase == "settled" or not current.settled:
            self._replace_last(replace(current, estimate=estimate))

    def withdraw(self) -> None:
        """Remove the current touch from the list: nothing touched."""
        if self.current is not None:
            self.contacts, self._count = self.contacts[:-1], self._count - 1

    def _replace_last(self, contact: Contact) -> Contact:
        self.contacts = (*self.contacts[:-1], contact)
        return contact


class TouchState(NamedTuple):
    """State after a batch: the phase, empty if unknown, and the fused estimate of the touch, None without poses."""

    phase: Phase
    fused: FusedEstimate | None


CONFIRM = 1.5 * FIT_SPAN  #: Time for which poses may explain a contact by an acceleration [s].
#: Norm of six whitened channels that noise alone exceeds once in 10⁵ readings.
NOISE = 6.0
#: Touches to which a change of one channel is compared: places along the probe, sides of it, angles from the side of
#: the tip to its end, and tangential over normal forces along and around. The ratio of 0.9 is assumed: above any stated
#: friction of soft resins, and forces around then lie between the sides, at distances of 3° from each other.
PLACES, SIDES, TIP_ANGLES = 12, 2.0 * math.pi * np.arange(48) / 48, np.radians([0.0, 30.0, 60.0, 90.0])
RATIOS = np.array([(0.0, 0.0), *(0.9 * np.array([math.cos(a), math.sin(a)]) for a in SIDES[::6])])
#: Travel of the base at rest before and after it from which a touch with the same readings is doubted [m]: a probe of
#: the paper's size bends by as much at its tip under 5 mN. Assumed.
RETRACTION = 5e-3


@dataclass
class _Held:
    """Reading and pose at the first rest of a touch."""

    pose: Array | None = None  #: T_world_base, (4, 4).
    wrench: Array | None = None  #: whitened by the noise of one reading, (6,).
    offered: bool = False  #: whether a tare was proposed.

    def offer(self, time: float, T: Array | None, wrench: Array, log: Log) -> None:
        """Propose a tare if the base has moved away since the first rest and the reading has not changed."""
        if self.pose is None or self.wrench is None:
            self.pose, self.wrench = T, wrench
        elif T is not None and not self.offered:
            travel = float(np.linalg.norm(T[:3, 3] - self.pose[:3, 3]))
            if travel > RETRACTION and float(np.square(wrench - self.wrench).sum()) < max_chi2(6, FALSE_ALARM):
                self.offered = True
                log(f"{time:.2f} s: the base moved by {1e3 * travel:.0f} mm and the readings did not change: a leap of "
                    "the zero rather than a touch? the command tare takes the probe for free")  # fmt: skip


def touch_changes(model: ProbeModel, gravity: Array) -> Array:
    """Return how light touches change the reading under a gravity [m/s²], (3,), in steps of the resolution, (k, 6).

    A force F = -n + μ t on the surface, with the outward normal n, changes the wrench by ∂w/∂F F + ∂w/∂C (r × F), with
    the arm r from the centreline. Each row has norm one.
    """
    rows = []
    for s in np.linspace(0.0, model.rod.length, PLACES).tolist():
        eq = model.rod.solve(gravity, s_contact=s, columns="contact")
        if eq.sensitivity is None:
            continue
        (t, x, _, y), by_load = eq.sensitivity.frame.reshape(4, 3), eq.sensitivity.d_wrench
        side = np.outer(np.cos(SIDES), x) + np.outer(np.sin(SIDES), y)
        for angle in TIP_ANGLES if s == model.rod.length else TIP_ANGLES[:1]:
            c, d = math.cos(angle), math.sin(angle)
            along, around = RATIOS.T[:, :, None, None]
            F = -(c * side + d * t) + along * (c * t - d * side) + around * np.cross(t, side)
            couple = np.cross(c * float(model.rod.radius_at(s)) * side, F)
            rows.append((F @ by_load[:, 0:3].T + couple @ by_load[:, 4:7].T).reshape(-1, 6))
    changes = model.to_sensor(np.concatenate(rows), np.zeros(3)) / model.noise.std
    return np.asarray(changes / np.linalg.norm(changes, axis=1, keepdims=True), dtype=float)


#: Mean at the base minus the free probe's wrench [N, N·m], gravity in base axes, pose of the base, and time [s].
_Reading = tuple[Array, Array, Array | None, float]


class TouchMonitor:
    """Monitors every batch: the contact test uses its samples, the phase and the fusion its mean."""

    def __init__(
        self,
        estimator: Estimator,
        contacts: ContactHistory,
        rate: float,
        samples: int,
        poses: BasePoses | None,
        log: Log,
        estimates: bool = True,
    ) -> None:
        """Start with no batch of so many `samples` at a `rate` [Hz]; `contacts` is the list to continue.

        With `estimates`, the readings of a touch are fused to a point in the world, and touches are reported.
        """
        model = estimator.model
        self._estimator, self._contacts, self._poses, self._log = estimator, contacts, poses, log
        self._estimates, self._samples = estimates, samples
        self._detector = Detector(
            model, rate, samples=samples, walk_steps=estimator.priors.walk_steps,
            start_steps=estimator.priors.drift_steps,
        )  # fmt: skip
        self._phases = PhaseTracker(model, rate / samples)
        self._follower = DriftFollower(model, self._detector.bias_filter, estimator.priors.drift_steps)
        self._sure = False
        #: Readings of the touch that are not fused yet, and whether the last ones were explained.
        self._unfused, self._explained = deque[_Reading](maxlen=self._phases.readings), False
        self.in_motion, self._alarm, self._largest = False, math.nan, 0.0
        self.warming_up, self._next_check, self._held = False, -math.inf, _Held()
        self._changes = b"", np.empty((0, 6))  # those of touches, and the gravity of that
        self._tracker: Tracker | None = None
        if poses is not None and estimates:
            self._tracker = Tracker(
                estimator, gravity_world=poses.gravity_world, rate=rate / samples, samples=1,
                bias=self._detector.bias_filter,
            )  # fmt: skip
        self._unknown = self._state = TouchState("", None if poses is None else FusedEstimate("out_of_range"))
        self._period, self._last = samples / rate, math.nan

    def update(
        self, batch: AveragedBatch, tare: Tare | None, T_world_base: Array | None, motion: MotionMonitor | None = None
    ) -> TouchState:
        """Process a batch without fault and with known gravity, bias included, and the pose of the base, if known.

        `motion` is that of the base at the batch; None without poses.
        """
        gravity = batch.reading.gravity_base
        free = self._estimator.free(gravity)
        if not free.ok:
            return self._unknown
        gap = batch.reading.time - self._last - self._period
        if gap > self._period:
            self._detector.rest(gap)
        self._last = batch.reading.time
        excess = self._excess(batch.block.wrench_sensor, gravity, tare)
        mean, decisions = excess.mean(axis=0), self._detector.run(excess, motion is None or motion.explained)
        if motion is not None and not self.warming_up:
            decisions = self._without_motion(decisions, mean, batch.reading.time, motion)
        turning = motion is not None and motion.turning  # an error of gravity then looks like a drift
        if self._follow_drift(decisions, mean, batch.reading.time, turning):
            self._contacts.update(batch.reading.time, "", None)
            return TouchState("", None if self._poses is None else FusedEstimate("warming_up"))
        phase = self._phases.next("lost" if "lost" in decisions else decisions[-1], mean, T_world_base)
        if phase == "settled" and batch.reading.time >= self._next_check:
            self._next_check = batch.reading.time + SPAN
            if self._is_leap(gravity, batch.reading.time, T_world_base):
                phase, decisions = "free", ["free"]
        elif phase not in ("touching", "settled"):
            self._held = _Held()
        reading = (mean, gravity, T_world_base, batch.reading.time)
        if motion is not None and self.in_motion and phase in ("touching", "settled"):
            fused = self._fused_in_motion(reading, motion)
        else:
            self._unfused.clear()
            self._explained = phase in ("touching", "settled")
            fused = self._fused(decisions, *reading)
        ended = self._contacts.update(batch.reading.time, phase, fused)
        if ended is not None and self._estimates:
            self._log(ended.summary)
        self._state = TouchState(phase, fused)
        return self._state

    def _without_motion(
        self, decisions: list[Touching], mean: Array, time: float, motion: MotionMonitor
    ) -> list[Touching]:
        """Return the decisions without contacts that the motion of the base explains.

        Poses show an acceleration late: a contact counts where they have not explained its readings for `CONFIRM`.
        Sets `in_motion`: whether a position may not be given.
        """
        self.in_motion = not motion.explained
        if decisions[-1] != "contact":
            self._alarm, self._largest = math.nan, 0.0
            # What was not confirmed is not lost.
            return decisions if self._state.phase in ("touching", "settled") else ["free"]
        change = mean - self._detector.bias
        size = float(np.linalg.norm(self._estimator.model.whiten @ change))
        self._largest = max(self._largest, motion.sway)
        if self._state.phase in ("touching", "settled"):
            # Half, so that a contact near the bound does not flicker while the acceleration becomes known.
            # A touch that was there at rest does not become a sway.
            self._sure = self._sure or motion.explained or self._state.phase == "settled"
            if self._sure or size > 0.5 * (motion.free_sway + NOISE):
                return decisions
            return self._released(["lost"])
        if math.isnan(self._alarm):
            self._alarm = time
        if self._largest > 0.0 and size <= self._largest + NOISE:
            return self._released(["free"])
        if time - self._alarm < CONFIRM:
            self.in_motion = True
            return ["free"]
        self._alarm, self._largest = math.nan, 0.0
        self._sure = False
        motion.on_contact()
        self.in_motion = self.in_motion or motion.speed > 0.0
        return decisions

    def _released(self, decisions: list[Touching]) -> list[Touching]:
        self._detector.release()
        self._alarm, self._largest = math.nan, 0.0
        return decisions

    def _follow_drift(self, decisions: list[Touching], mean: Array, time: float, turning: bool) -> bool:
        """Follow the bias by one reading; return whether its drift is too fast to distinguish contacts."""
        if self._follower.warming_up and set(decisions) != {"free"}:
            self._detector.release()
        elif self.in_motion or turning or set(decisions) != {"free"}:
            self._follower.drop()
            return False
        self._follower.add(mean, time)
        rate = 60.0 * self._follower.rate
        if self._follower.warming_up and not self.warming_up:
            self._log(f"the sensor is warming up: its zero drifts by {rate:.3g} steps of the resolution a minute; no "
                      f"positions for about {self._follower.wait:.0f} s, if the drift levels off")  # fmt: skip
        elif self.warming_up and not self._follower.warming_up:
            self._log(f"the drift of the sensor's zero is followed again: {rate:.3g} steps of the resolution a minute")
            self._phases.reset()
        self.warming_up = self._follower.warming_up
        return self.warming_up

    def _is_leap(self, gravity: Array, time: float, T_world_base: Array | None) -> bool:
        """Return whether a contact at rest is a leap of one channel's zero, which is then taken out of the readings.

        It is one where a single channel has changed, by more than the noise that any touch would leave unexplained.
        What a touch may have caused stays a touch.
        """
        model, known = self._estimator.model, self._detector.bias_filter.known()
        mean = np.linalg.solve(model.whiten, self._phases.mean)
        change, step = mean - known.excess, model.noise.std * math.sqrt(model.averaging_samples)
        in_steps = model.to_sensor(change, np.zeros(3)) / step
        in_noise = in_steps / math.sqrt(
            known.steps**2 + 1.0 / (model.averaging_samples * max(SPAN / self._period, 1.0))
        )
        i, chi2, limit = int(np.argmax(np.abs(in_noise))), float(in_noise @ in_noise), max_chi2(5, FALSE_ALARM)
        if chi2 - in_noise[i] ** 2 < limit < chi2:
            if gravity.tobytes() != self._changes[0]:
                self._changes = gravity.tobytes(), touch_changes(model, gravity)
            if chi2 - max(float((self._changes[1] @ in_noise).max()), 0.0) ** 2 > limit:
                size = abs(float(in_steps[i] * step[i])) * 1e3
                self._log(f"{time:.2f} s: {CHANNELS[i]} leapt by {size:.3g} {'mN' if i < 3 else 'Nmm'}: no touch "
                          "changes it alone; the zero follows")  # fmt: skip
                self._detector.release()
                self._follower.leap(change)
                self._phases = PhaseTracker(model, 1.0 / self._period)
                self._contacts.withdraw()
                return True
        self._held.offer(time, T_world_base, model.whiten @ mean, self._log)
        return False

    @property
    def drift(self) -> KnownBias:
        """What is known of the drift of the bias since the tare."""
        return self._detector.bias_filter.known()

    def rest(self, seconds: float) -> None:
        """Account for time since the tare without readings [s]: the bias has drifted."""
        self._detector.bias_filter.rest(seconds)
        self._follower.rest(seconds)

    def calibrate(self, batches: list[AveragedBatch], tare: Tare) -> None:
        """Calibrate the detector on batches of a free probe, as those of the tare.

        They provide the oscillation of the probe and the drift of the bias since their mean.
        """
        if batches:
            groups = [list(g) for _, g in groupby(batches, key=lambda b: b.reading.gravity_base.tobytes())]
            excess = [
                self._excess(joined([b.block for b in g]).wrench_sensor, g[0].reading.gravity_base, tare)
                for g in groups
            ]
            self._detector.calibrate(np.concatenate(excess))
            means = (part.mean(axis=0) for group in excess for part in np.split(group, len(group) // self._samples))
            for batch, mean in zip(batches, means, strict=True):
                self._follower.add(mean, batch.reading.time)

    def _excess(self, wrench_sensor: Array, gravity_base: Array, tare: Tare | None) -> Array:
        """Return samples (n, 6) under one gravity at the base minus the free probe's wrench [N, N·m], (n, 6)."""
        bias = 0.0 if tare is None else tare.bias_sensor
        samples = self._estimator.model.to_base(wrench_sensor - bias, gravity_base)
        return samples - self._estimator.free(gravity_base).wrench_base

    def on_interruption(self) -> None:
        """Handle missing readings between the last batch and the next."""
        self._phases.reset()

    def on_leap(self, time: float) -> None:
        """Handle a leap of the base: what was touched before it and what is touched after it are two touches."""
        self._phases.reset()
        self._contacts.update(time, "", None)
        if self._tracker is not None:
            self._tracker.restart()

    def _fused_in_motion(self, reading: _Reading, motion: MotionMonitor) -> FusedEstimate | None:
        """Fuse the readings of a touch since it began, or of the last span, less the sway that they show.

        Ends `in_motion` where they show none. What shows more than a sway waits.
        """
        self._unfused.append(reading)
        chance = KEPT_CHANCE if self._explained else SMOOTH_CHANCE
        sway = self._phases.sway(len(self._unfused), chance)
        self._explained = sway is not None
        if sway is None:
            return self._fused(["contact"], *reading)
        fused, self.in_motion = None, False
        for (mean, gravity, T, time), share in zip(self._unfused, sway, strict=True):
            fused = self._fused(["contact"], mean - share, gravity, T, time)
        self._unfused.clear()
        self.in_motion = bool(sway.any())
        if not self.in_motion:
            motion.on_smooth()
        return fused

    def _fused(
        self, decisions: list[Touching], excess: Array, gravity: Array, T: Array | None, time: float
    ) -> FusedEstimate | None:
        """Return the tracker's estimate. A batch that is partly free and partly in contact is not used, nor one in
        motion: its keyframe would stay for the whole touch.
        """
        if self._tracker is None or self._poses is None or T is None:
            return None
        if self.in_motion and decisions[-1] == "contact":
            return FusedEstimate("in_motion")
        if self._poses.gravity(T).tobytes() != gravity.tobytes():  # the acceleration is not in `excess` any more
            gravity = self._poses.gravity(T)
        wrench = excess + self._estimator.free(gravity).wrench_base
        if "lost" in decisions:
            return self._tracker.update(wrench, T, time, "lost")
        if len(set(decisions)) == 1:
            return self._tracker.update(wrench, T, time, decisions[0])
        return FusedEstimate("no_contact")
