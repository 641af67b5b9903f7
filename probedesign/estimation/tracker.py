"""Recursive fusion: bounded time and memory; its state is cleared when contact is lost.

Readings from nearly one pose are kept as their mean, a keyframe; at most `KEYFRAMES` are kept, and the two that lie
closest are merged if there is one more. Each update puts its reading into the last keyframe and solves all of
them as they were linearised last; now and then, and where a keyframe is new, all are linearised anew. So the result is
that of the batch over the keyframes' means.
"""

import math
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from probedesign.core import statistics
from probedesign.core.errors import InputError
from probedesign.core.frames import Array
from probedesign.core.statistics import UNIFORM_STD
from probedesign.core.units import MM
from probedesign.estimation import fusion_kernel
from probedesign.estimation.bias import BiasFilter, KnownBias
from probedesign.estimation.detector import Detector, Touching
from probedesign.estimation.error_sources import ErrorSources, across
from probedesign.estimation.estimate import FusedEstimate, Result
from probedesign.estimation.estimator import Estimator
from probedesign.estimation.fusion import Fusion, Posterior, Reading
from probedesign.estimation.fusion_state import PRESSED_FRICTION, SINGLE_FRICTION, FusionState, channels_of, creep_since
from probedesign.estimation.model import WALK_SECONDS

KEYFRAMES = 8  #: Kept at most.
#: Readings of the last keyframe at which all keyframes are linearised anew: its first ones move the point most.
LINEARISED_AT = (2.0, 4.0, 8.0, 16.0, 32.0)
LINEARISED_EVERY = 4  #: Readings, times the number of keyframes, after which they are linearised anew in any case.
#: Least time from one evaluation of the curvature to the next, and the longest where the base moves on all the time.
CURVATURE_SECONDS = (0.1, 1.0)
FIRST_CURVATURE = 16.0  #: Readings of a keyframe after which the curvature is evaluated; then after four times as many.
#: Readings from one start to the next, which come after 1, 2, 4 ... of them: a start may take a tenth of a second, and
#: a touch that fits no single point must not hold up the readings.
MAX_WAIT = 256
SETTLING = 8  #: Gauss-Newton steps at the first readings, from the place that one reading by itself gives.
MAX_COUNT = 1e9  #: Readings after which a mean follows like a low-pass filter.
#: Distance [m] below which two poses are one, or three standard deviations of the robot's place if that is more; a
#: rotation of 1 rad counts as a tenth of a metre.
_APART = 5e-6
#: Distance over the length, and rotation [rad], above which two poses are not merged into one keyframe. Below, the mean
#: of their readings is that at the mean pose up to about 1e-4, a hundredth of `Tolerances.stiffness_scatter`; rotations
#: are not averaged.
_MIXED, _TURNED = 0.01, 1e-3


@dataclass(eq=False)
class Keyframe:
    """Mean of the readings of one pose, in a row of the fusion's memory."""

    row: int  #: of the memory.
    wrench: Array  #: wrench, T, time: means; the arrays are those of the row.
    T: Array
    time: float
    began: float  #: began, span: time of the first reading, and from it to the last one [s].
    span: float = 0.0
    count: float = 1.0  #: number of readings.
    due: float = FIRST_CURVATURE  #: count at which the curvature is evaluated again.
    linearised: bool = False  #: whether its touch has been linearised.

    def take_in(self, wrench: Array, T: Array, time: float) -> None:
        """Take in one more reading of this pose; wrench, place and time are means."""
        self.count = min(self.count + 1.0, MAX_COUNT)
        self.wrench += (wrench - self.wrench) / self.count
        self.T[:3, 3] += (T[:3, 3] - self.T[:3, 3]) / self.count
        self.time += (time - self.time) / self.count
        self.span = time - self.began

    def merge(self, earlier: "Keyframe", later: "Keyframe") -> None:
        """Become the mean of two neighbours, of which this is one."""
        a, b = earlier.count, later.count
        self.wrench[:] = (a * earlier.wrench + b * later.wrench) / (a + b)
        self.T[:3, 3] = (a * earlier.T[:3, 3] + b * later.T[:3, 3]) / (a + b)
        self.time = (a * earlier.time + b * later.time) / (a + b)
        self.began, self.span = earlier.began, later.began + later.span - earlier.began
        self.count = a + b

    def weight(self, rate: float) -> float:
        """Return the effective number of samples of the mean for a bias with a random walk.

        The mean over T seconds has the variance `rate` T/12 about the bias at its middle.

        Args:
            rate: variance of the walk, in steps² a second; a sample has a variance of one step².
        """
        return 1.0 / (1.0 / self.count + rate * self.span / 12.0)


@dataclass
class _Curvature:
    """What the posterior over the object's compliance and the curvature add, when they were evaluated last."""

    size: float = 0.0  #: trace of the point's linear covariance then [m²]; 0 before the first evaluation.
    #: what is added to the points of `Solution` [m], (3, 3), and to their covariances [m²], (3, 3, 3), beside the share
    #: of the linear ones that the posterior lacks, (3, 1, 1).
    shift: Array = field(default_factory=lambda: np.zeros((3, 3)))
    added: Array = field(default_factory=lambda: np.zeros((3, 3, 3)))
    lack: Array = field(default_factory=lambda: np.zeros((3, 1, 1)))
    posterior: Posterior | None = None  #: of the keyframes then; None if it was not found.
    moved: bool = False  #: whether the object had moved.
    time: float = -math.inf  #: of the evaluation [s].


@dataclass
class _Touch:
    """The present touch."""

    bias: KnownBias  #: bias of the free readings before it: as a tare, where it begins.
    began: float  #: time of its first reading [s].
    keyframes: list[Keyframe] = field(default_factory=list)  #: in the order of time.
    tared: ErrorSources | None = None  #: error sources where it began.
    located: bool = False  #: whether the keyframes' touches are near the solution.
    unchanged: int = 0  #: readings since all keyframes were linearised.
    missed: int = 0  #: readings since the last start.
    wait: int = 1  #: readings from one start to the next.
    curvature: _Curvature = field(default_factory=_Curvature)
    result: FusedEstimate = field(default_factory=lambda: FusedEstimate("unobservable"))  #: the last one.

    def variance_at(self, time: float, walk: float) -> float:
        return self.bias.variance_after(max(time - self.began, 0.0), walk)

    def start_std(self, walk: float) -> float:
        """Return the standard deviation of the bias at the first keyframe [steps]: the mean of a walk over T has the
        variance q T/3, and `Keyframe.weight` has q T/12 of it.
        """
        first = self.keyframes[0]
        return math.sqrt(self.variance_at(first.began + 0.25 * first.span, walk))


@dataclass
class Tracker:
    """Locates one fixed point of the world while the probe touches it, reading by reading."""

    estimator: Estimator  #: of the probe.
    gravity_world: ArrayLike = (0.0, 0.0, -9.81)  #: [m/s²], (3,).
    rate: float = 7000.0  #: of readings [Hz].
    #: number of readings whose mean has the noise of the model: None for single samples of the sensor, 1 for readings
    #: that are such means.
    samples: int | None = None
    #: the filter that follows the bias, if the contact test is outside; None: the tracker's own.
    bias: BiasFilter | None = None

    def __post_init__(self) -> None:
        self._gravity_world = np.asarray(self.gravity_world, dtype=float)
        if self._gravity_world.shape != (3,) or not np.isfinite(self._gravity_world).all():
            raise InputError(f"gravity_world = {self.gravity_world} must be three finite numbers in m/s²")
        model, priors = self.estimator.model, self.estimator.priors
        samples = model.averaging_samples if self.samples is None else self.samples
        self._detector = Detector(
            model, self.rate, samples=samples, walk_steps=priors.walk_steps, start_steps=priors.drift_steps
        )
        self._followed = self.bias or self._detector.bias_filter
        self._axes, self._apart = across(self._gravity_world), max(_APART, 3.0 * priors.robot_mm * MM)
        self._walk = priors.walk_steps**2 / WALK_SECONDS
        self._walk_rate = self._walk * model.averaging_samples / samples
        self._noise = model.noise_base() * samples
        self._whiten = np.ascontiguousarray(statistics.whiten(self._noise))
        free = self.estimator.free(model.gravity_base)
        sources = ErrorSources.of(model, priors, model.gravity_base, free, posed=True)
        self._state = FusionState(model, priors, channels_of(model, None), sources, KEYFRAMES + 1)  # one too many
        self._time, self._gravity = -math.inf, np.empty(3)
        self._touch: _Touch | None = None

    def restart(self) -> None:
        """Discard the present touch: the base has leapt, and its readings no longer belong together."""
        self._touch = None

    @property
    def kept(self) -> int:
        """Return the number of keyframes of the present touch."""
        return 0 if self._touch is None else len(self._touch.keyframes)

    def update(
        self, wrench_base: ArrayLike, T_world_base: ArrayLike, time: float, touching: Touching | None = None
    ) -> FusedEstimate:
        """Take in one reading.

        Args:
            wrench_base: one sample at the base [N, N·m], (6,).
            T_world_base: pose of the base as it was read, (4, 4).
            time: of the sensor's clock [s].
            touching: state of the contact by another test, as `Detector` gives it; the tracker's own test if None.

        Returns:
            The touched point: "ok" with its covariance, "no_contact", or why there is no number. A reading that cannot
            be ("out_of_range": not finite, beyond the sensor, no pose, time running backward) changes nothing.
        """
        wrench = np.ascontiguousarray(wrench_base, dtype=float)
        T = np.ascontiguousarray(T_world_base, dtype=float)
        if wrench.shape != (6,) or T.shape != (4, 4) or not self._time < time < math.inf:
            return FusedEstimate("out_of_range")
        to_sensor, payload, limit, _ = self.estimator.model.observation_map
        if not fusion_kernel.admit(wrench, T, self._gravity_world, to_sensor, payload, limit, self._gravity):
            return FusedEstimate("out_of_range")
        free = self.estimator.free(self._gravity)
        if not free.ok:
            return FusedEstimate("not_converged")
        self._time = float(time)
        beyond = wrench - free.wrench_base
        if (touching or self._detector.update(beyond)) != "contact":
            self._touch = None
            if touching is not None and self.bias is None:  # the tracker's own test has used the reading
                self._followed.add(beyond)
            return FusedEstimate("no_contact")
        if self._touch is None:
            self._followed.drop_waiting()
            self._touch = _Touch(self._followed.known(), self._time)
        touch = self._touch
        self._place(touch, wrench - touch.bias.after(self._time - touch.began), T)
        return self._solve(touch) if touch.located else self._begin(touch)

    # Readings into keyframes -----------------------------------------------------------------------------------------

    def _place(self, touch: _Touch, wrench: Array, T: Array) -> None:
        """Add a reading to the last keyframe, or to a new one if the base has moved."""
        frames, state = touch.keyframes, self._state
        last = frames[-1] if frames else None
        if last is not None:
            far, gap = self._gap(last.T, T)
            # In the second case it would become a keyframe that is merged with the last one at once.
            if gap <= self._apart or (len(frames) == KEYFRAMES and not far and (far, gap) <= min(self._gaps(frames))):
                last.take_in(wrench, T, self._time)
                return
        row = next(i for i in range(KEYFRAMES + 1) if all(frame.row != i for frame in frames))
        state.wrench[row], state.pose[row] = wrench, T
        state.touches[row] = 0.0 if last is None else state.touches[last.row]
        if last is not None and np.array_equal(state.sources[last.row].gravity, self._gravity):
            state.sources[row] = state.sources[last.row]
        else:
            gravity = self._gravity.copy()
            state.sources[row] = ErrorSources.of(
                state.model, state.priors, gravity, self.estimator.free(gravity), touch.tared, self._axes @ T[:3, :3],
                posed=True,
            )  # fmt: skip
        touch.tared = touch.tared or state.sources[row]
        frames.append(Keyframe(row, state.wrench[row], state.pose[row], self._time, self._time))
        if len(frames) > KEYFRAMES:
            self._join(touch)

    def _gaps(self, frames: list[Keyframe]) -> list[tuple[bool, float]]:
        return [self._gap(a.T, b.T) for a, b in pairwise(frames)]

    def _gap(self, a: Array, b: Array) -> tuple[bool, float]:
        """Return whether two poses lie too far apart to be averaged, and their distance, rotations included [m]."""
        moved, turned = math.dist(a[:3, 3], b[:3, 3]), math.dist(a[:3, :3].ravel(), b[:3, :3].ravel()) / math.sqrt(2.0)
        return moved > _MIXED * self._state.model.rod.length or turned > _TURNED, moved + 0.1 * turned

    def _join(self, touch: _Touch) -> None:
        """Make one of the two neighbours that lie closest, or drop the lighter where they lie too far apart."""
        frames = touch.keyframes
        gaps = self._gaps(frames)
        i = gaps.index(min(gaps))
        a, b = frames[i], frames[i + 1]
        kept, dropped = (a, b) if a.count >= b.count and i + 2 < len(frames) else (b, a)
        if not gaps[i][0]:
            kept.merge(a, b)
            if kept.linearised:
                self._reduce(touch, frames.index(kept))
        frames.remove(dropped)

    # One step over all keyframes -------------------------------------------------------------------------------------

    def _solve(self, touch: _Touch) -> FusedEstimate:
        """Return the result after a reading was added to the last keyframe.

        All keyframes are linearised anew together: one at a time, their mixed linearisations would claim more than is
        known where the point is hardly known. Between, only the mean of the last one changes.
        """
        frames, last = touch.keyframes, touch.keyframes[-1]
        new = not last.linearised
        touch.unchanged += 1
        if not new and last.count not in LINEARISED_AT and touch.unchanged < LINEARISED_EVERY * len(frames):
            self._reduce(touch, len(frames) - 1)
            return self._remember(touch, self._step(touch))
        touch.unchanged = 0
        return self._remember(touch, self._iterate(touch, 2 if new else 1))

    def _iterate(self, touch: _Touch, steps: int) -> FusedEstimate:
        result = FusedEstimate("not_converged")
        for _ in range(steps):
            if not all(self._linearise(touch, k) for k in range(len(touch.keyframes))):
                return FusedEstimate("not_converged")
            result = self._step(touch)
        return result

    def _linearise(self, touch: _Touch, k: int) -> bool:
        """Move a touch to the present solution and linearise it; return whether it has a stable equilibrium."""
        frame = touch.keyframes[k]
        if frame.linearised and touch.located:
            self._state.move_row(frame.row)
        if not self._state.linearise_row(frame.row):
            return False
        frame.linearised = True
        self._reduce(touch, k)
        return True

    def _reduce(self, touch: _Touch, k: int) -> None:
        frame, state, several = touch.keyframes[k], self._state, len(touch.keyframes) > 1
        state.ramp[frame.row] = creep_since(frame.time - touch.began) if several else 1.0
        state.friction_parts = PRESSED_FRICTION if several else SINGLE_FRICTION
        state.whiten[frame.row] = math.sqrt(frame.weight(self._walk_rate)) * self._whiten
        state.reduce_row(frame.row)

    def _step(self, touch: _Touch) -> FusedEstimate:
        frames, state = touch.keyframes, self._state
        variances = np.array([touch.variance_at(frame.time, self._walk) for frame in frames])
        state.order = np.array([frame.row for frame in frames], dtype=np.int64)
        chi2 = state.solve(np.maximum(np.diff(variances, prepend=variances[:1]), 0.0), touch.start_std(self._walk))
        if not math.isfinite(chi2):
            return FusedEstimate("not_converged")
        touch.located = True
        state.compliance[0] = state.object_compliance
        rms = statistics.rms(state.cov[:3, :3])
        force_std = math.sqrt(float(self._noise[0, 0])) / np.sqrt([frame.count for frame in frames])
        return state.estimate(state.result(chi2, rms, force_std), chi2, rms, 1, state.point[None].copy())

    def _remember(self, touch: _Touch, result: FusedEstimate) -> FusedEstimate:
        """Return the result with its curvature; a fit that is inconsistent or did not converge is restarted."""
        if result.ok:
            result = self._curved(touch, result)
        if result.result in ("inconsistent", "not_converged"):
            touch.located = False
        touch.result = result
        return result

    def _curved(self, touch: _Touch, result: FusedEstimate) -> FusedEstimate:
        """Return the result with the curvature correction.

        From one evaluation to the next it goes with the square of the covariance, which stays positive.
        """
        size = float(result.cov_surface_world.trace())
        if self._is_due(touch, size):
            self._evaluate_curvature(touch, size)
        curvature = touch.curvature
        scale = min(size / curvature.size, 1.0) ** 2 if curvature.size > 0.0 else 0.0
        linear = np.array([result.cov_surface_world, result.cov_surface_now_world, result.cov_contact_world])
        covs = (1.0 - scale * curvature.lack) * linear + scale * curvature.added
        points = np.array([result.p_surface_world, result.p_surface_now_world, result.p_contact_world])
        posterior = Posterior(points + math.sqrt(scale) * curvature.shift, covs, result.chi2, result.object_compliance,
                              result.object_compliance_interval_95)  # fmt: skip
        if curvature.posterior is not None:
            last = curvature.posterior
            posterior = posterior._replace(compliance=last.compliance, interval=last.interval)
        rms = statistics.rms(posterior.covs[0])
        if not curvature.moved and rms < self._state.model.rod.length * UNIFORM_STD:
            return replace(result, **posterior.fields, rms=rms)
        code: Result = "inconsistent" if curvature.moved else self._state.uncertain
        return FusedEstimate(code, stiffness=result.stiffness, std_stiffness=result.std_stiffness, chi2=result.chi2,
                             dof=result.dof, rms=rms, iterations=1)  # fmt: skip

    def _is_due(self, touch: _Touch, size: float) -> bool:
        before, since, last = touch.curvature.size, self._time - touch.curvature.time, touch.keyframes[-1]
        if before == 0.0 or since < CURVATURE_SECONDS[0]:
            return before == 0.0
        return last.count >= last.due or since > CURVATURE_SECONDS[1] or not 0.5 * before < size < 2.0 * before

    def _evaluate_curvature(self, touch: _Touch, size: float) -> None:
        """Evaluate the posterior over the compliance with its curvature, and whether the object moved, by a batch."""
        fusion, last = self._batch(touch), touch.keyframes[-1]
        last.due = 4.0 * max(last.count, FIRST_CURVATURE)
        touch.curvature = _Curvature(size, time=self._time)
        best = fusion.refine(self._state.touches[self._state.order])
        if best is None:
            return
        posterior, state = fusion.over_compliance(best), fusion.state(best.touches)
        moved = state.linearise() and state.has_moved()
        ratios = np.linalg.eigvals(np.linalg.solve(best.covs, posterior.covs)).real
        lack = np.clip(1.0 - ratios.min(axis=1), 0.0, 1.0)[:, None, None]
        added = posterior.covs - (1.0 - lack) * best.covs
        touch.curvature = _Curvature(size, posterior.points - best.points, added, lack, posterior, moved, self._time)

    # Starting --------------------------------------------------------------------------------------------------------

    def _begin(self, touch: _Touch) -> FusedEstimate:
        """Start at the first reading and then ever more rarely; between, return the last result, never "ok"."""
        touch.missed += 1
        if touch.missed < touch.wait:
            return touch.result
        touch.missed, touch.wait = 0, min(2 * touch.wait, MAX_WAIT)
        result = self._from_one(touch)
        if result.result not in ("ok", "too_light") and len(touch.keyframes) > 1:  # of one pose, a batch knows no more
            result = self._from_batch(touch)
        return self._remember(touch, result)

    def _from_one(self, touch: _Touch) -> FusedEstimate:
        last = touch.keyframes[-1]
        single = self.estimator.estimate(last.wrench, self._state.sources[last.row].gravity)
        if single.result == "ambiguous":
            return FusedEstimate("ambiguous")
        if not single.candidates or single.candidates[0].touch is None:
            return FusedEstimate("not_converged")
        return self._settle(touch, [single.candidates[0].touch] * len(touch.keyframes))

    def _from_batch(self, touch: _Touch) -> FusedEstimate:
        fusion = self._batch(touch)
        solutions = fusion.solutions()
        if isinstance(solutions, FusedEstimate):
            return solutions
        result = fusion.answer(solutions)
        return self._settle(touch, list(solutions[0].touches)) if result.ok else result

    def _settle(self, touch: _Touch, guesses: list[Array]) -> FusedEstimate:
        touch.located = False
        for frame, guess in zip(touch.keyframes, guesses, strict=True):
            self._state.touches[frame.row], frame.linearised = guess, False
        return self._iterate(touch, SETTLING if len(touch.keyframes) > 1 else 2)

    def _batch(self, touch: _Touch) -> Fusion:
        frames, state = touch.keyframes, self._state
        readings = tuple(
            Reading(frame.wrench.copy(), self._noise / frame.weight(self._walk_rate), frame.T,
                    state.sources[frame.row].gravity, True, frame.time)
            for frame in frames
        )  # fmt: skip
        first, last = frames[0].time, frames[-1].time
        walked = touch.variance_at(last, self._walk) - touch.variance_at(first, self._walk)
        walk = max(walked, 0.0) / (last - first) if last > first else self._walk
        priors = replace(state.priors, drift_steps=touch.start_std(self._walk),
                         walk_steps=math.sqrt(walk * WALK_SECONDS))  # fmt: skip
        return Fusion(state.model, readings, priors, state.channels, self._gravity_world)
