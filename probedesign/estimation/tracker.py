"""Recursive fusion: bounded time and memory; its state is cleared when contact is lost.

Readings from nearly one pose are kept as their mean, a keyframe; at most `keyframes` are kept, and the two that lie
closest are merged if there is one more. Each update puts its reading into the last keyframe and solves all of
them as they were linearised last; now and then, and where a keyframe is new, all are linearised anew. So the result is
that of the batch over the keyframes' means.
"""

import math
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from probedesign.core import statistics
from probedesign.core.errors import InputError
from probedesign.core.frames import Array
from probedesign.core.statistics import UNIFORM_STD
from probedesign.core.units import MM
from probedesign.estimation import fusion_kernel, keyframe_kernel, multistart
from probedesign.estimation.bias import BiasFilter, KnownBias
from probedesign.estimation.detector import Detector, Touching
from probedesign.estimation.error_sources import FINE, ErrorSources, across
from probedesign.estimation.estimate import FusedEstimate, MomentsAbout, Result
from probedesign.estimation.estimator import Estimator
from probedesign.estimation.fusion import COMMON_FRICTION, Fusion, Reading, channels_of
from probedesign.estimation.fusion_state import FIRST_CURVATURE, FusionState, Keyframe, result_of
from probedesign.estimation.tolerances import WALK_SECONDS, Tolerances
from probedesign.rod.kernels.surface_contact import ALONG, AROUND, DEAD, NORMAL, OWN, ROWS, TOUCH, UNKNOWNS, work_size

MAX_KEYFRAMES = 8
IN_TURN = 4
"""Readings, times the number of keyframes, after which all of them are linearised anew."""
SWEEPS = (2.0, 4.0, 8.0, 16.0, 32.0)
"""Readings of the last keyframe at which that is done sooner: they move the point most."""
CURVATURE_SECONDS = (0.1, 1.0)
"""Least time from one evaluation to the next, and the longest where the base moves on all the time."""
MAX_WAIT = 256
"""Readings from one start to the next, which come after 1, 2, 4 ... of them: a start may take a tenth of a second, and
a touch that fits no single point must not hold up the readings."""
SETTLING = 8
"""Gauss-Newton steps at the first readings, from the place that one reading by itself gives."""
_APART = 5e-6
"""Distance [m] below which two poses are one, or three standard deviations of the robot's place if that is more; a
rotation of 1 rad counts as a tenth of a metre."""
_MIXED = 1e-4
"""Distance [m], rotations included, above which two poses are not merged into one keyframe: their readings differ."""
MAX_STEP = 0.1
"""Of arclength over length, in one step."""


@dataclass
class Tracker:
    """Locates one fixed point of the world while the probe touches it, reading by reading."""

    estimator: Estimator  #: of the probe.
    priors: Tolerances | None = None  #: standard deviations of the error sources; those of the estimator if None.
    gravity_world: ArrayLike = (0.0, 0.0, -9.81)  #: [m/s²], (3,).
    moments_only: bool = False  #: moments_only, moments_about: as in `Estimator.fuse`.
    moments_about: MomentsAbout = "sensor"
    rate: float = 7000.0  #: of readings [Hz].
    keyframes: int = MAX_KEYFRAMES  #: kept at most.
    #: number of readings whose mean has the noise of the model: None for single samples of the sensor, 1 for readings
    #: that are such means.
    samples: int | None = None
    #: the filter that follows the bias, if the contact test is outside; None: the tracker's own.
    bias: BiasFilter | None = None
    _kept: list[Keyframe] = field(default_factory=list, init=False, repr=False)

    def __post_init__(self) -> None:
        """Raise InputError if an argument is out of range."""
        self._gravity_world = np.asarray(self.gravity_world, dtype=float)
        if self._gravity_world.shape != (3,) or not np.isfinite(self._gravity_world).all():
            raise InputError(f"gravity_world = {self.gravity_world} must be three finite numbers in m/s²")
        if self.keyframes < 2:
            raise InputError(f"keyframes = {self.keyframes} must be 2 or more")
        model = self.estimator.model
        self._priors = self.priors or self.estimator.priors
        samples = model.averaging_samples if self.samples is None else self.samples
        priors = self._priors
        self._detector = Detector(
            model, self.rate, samples=samples, walk_steps=priors.walk_steps, start_steps=priors.drift_steps
        )
        self._followed = self.bias or self._detector.bias_filter
        self._channels = channels_of(model, self.moments_about if self.moments_only else None)
        self._moments = self.moments_about if self.moments_only else None
        sample, step = model.noise_base() * samples, model.noise_base() * model.averaging_samples
        of = np.linalg.cholesky(self._channels @ sample @ self._channels.T)
        self._whiten, self._sample = np.ascontiguousarray(np.linalg.inv(of)), sample
        self._step_of_bias = np.ascontiguousarray(self._channels @ np.linalg.cholesky(step))
        self._time = -math.inf
        self._gravity = np.empty(3)
        self._axes = across(self._gravity_world)
        self._walk = self._priors.walk_steps**2 / WALK_SECONDS
        self._walk_rate = self._walk * model.averaging_samples / samples
        self._apart = max(_APART, 3.0 * self._priors.robot_mm * MM)
        self._tared: ErrorSources | None
        self._memory()
        self._forget()

    def _memory(self) -> None:
        """Allocate the arrays of the kernels."""
        free = self.estimator.free(self.estimator.model.gravity_base)
        sources = ErrorSources.of(
            self.estimator.model, self._priors, self.estimator.model.gravity_base, free, posed=True
        )
        self._causes, self._width = len(sources.names), keyframe_kernel.columns(len(sources.names))
        self._scatter, self._creep = sources.column("stiffness scatter"), sources.column("creep")
        self._E = sources.column("E")
        m, parameters = len(self._channels), OWN + len(self.estimator.model.rod.s)
        self._columns = 1 + UNKNOWNS + parameters
        self._sweep_work = np.empty(work_size(parameters))
        self._block = np.empty((keyframe_kernel.rows_of(m), keyframe_kernel.LOCAL + self._width))
        self._work = np.empty(fusion_kernel.solve_work(self._causes))
        room = self.keyframes + 1  # for one keyframe too many
        self._all = np.empty((room, m, self._width))
        self._chain = np.empty((room, keyframe_kernel.BIAS, self._width))
        self._xs = np.empty((room, self._width - 1))
        self._touched, self._ramp = np.ones(room, dtype=bool), np.ones(room)
        self._lins, self._Ds = np.empty((room, ROWS, self._columns)), np.empty((room, 12, self._causes))
        self._locals = np.empty((room, keyframe_kernel.LOCAL, keyframe_kernel.LOCAL + self._width))
        self._poses, self._touches = np.empty((room, 4, 4)), np.empty((room, TOUCH))
        self._mean_work = np.empty(6 * self._width + 100)
        self._mean, self._cov_mean = np.empty(3), np.empty((3, 3))
        self._step_work = np.empty(60)
        self._cov = np.empty((3, 3))

    def _forget(self) -> None:
        self._kept.clear()
        self._x: Array | None = None
        self._turn, self._idle, self._wait = 0, 0, 1
        self._evaluated, self._moved = -math.inf, False
        self._curvature = 0.0, np.zeros((3, 3)), np.zeros((3, 3))
        self._last = FusedEstimate("unobservable")
        # The bias is that of the free readings before the touch: as a tare, where it begins.
        self._tared = None
        self._known: KnownBias | None = None
        self._last_sources: dict[bytes, ErrorSources] = {}

    def restart(self) -> None:
        """Discard the present touch: the base has leapt, and its readings no longer belong together."""
        self._forget()

    @property
    def kept(self) -> int:
        """Return the number of keyframes of the present touch."""
        return len(self._kept)

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
        if not keyframe_kernel.admit(wrench, T, self._gravity_world, to_sensor, payload, limit, self._gravity):
            return FusedEstimate("out_of_range")
        free = self.estimator.free(self._gravity)
        if not free.ok:
            return FusedEstimate("not_converged")
        self._time = float(time)
        state = touching or self._detector.update(wrench - free.wrench_base)
        if state != "contact":
            self._release(wrench - free.wrench_base, lost=state == "lost", followed=touching is None)
            return FusedEstimate("no_contact")
        if self._known is None:
            self._followed.drop_waiting()
            self._known, self._began = self._followed.known(), self._time
        self._place(wrench - self._known.after(self._time - self._began), T)
        return self._solve() if self._x is not None else self._begin()

    # Readings into keyframes -----------------------------------------------------------------------------------------

    def _release(self, beyond: Array, lost: bool, followed: bool) -> None:
        """Take in a free reading, less the wrench of the free probe; `followed`: the contact test has used it."""
        if lost or self._kept:
            self._forget()
        if not followed and self.bias is None:
            self._followed.add(beyond)

    def _sources_at(self, T: Array) -> ErrorSources:
        """Return the error sources under the present gravity; the sensor counts as tared where the touch began."""
        key = self._gravity.tobytes()
        found = self._last_sources.get(key)
        if found is None:
            gravity = self._gravity.copy()
            found = ErrorSources.of(
                self.estimator.model, self._priors, gravity, self.estimator.free(gravity), self._tared,
                self._axes @ T[:3, :3], posed=True,
            )  # fmt: skip
            self._tared = self._tared or found
            self._last_sources = {key: found}
        return found

    def _place(self, wrench: Array, T: Array) -> None:
        """Add a reading to the last keyframe, or to a new one if the base has moved."""
        if self._kept and keyframe_kernel.apart(self._kept[-1].T, T) <= self._apart:
            self._kept[-1].take_in(wrench, T, self._time)
            return
        touch = self._kept[-1].touch.copy() if self._kept else np.zeros(TOUCH)
        slot = next(i for i in range(self.keyframes + 1) if all(frame.slot != i for frame in self._kept))
        self._poses[slot], self._touches[slot] = T, touch
        self._kept.append(Keyframe(
            slot, wrench.copy(), self._poses[slot], self._time, self._sources_at(T), self._touches[slot],
            self._lins[slot], self._Ds[slot], self._locals[slot], self._all[slot], self._xs[slot], self._time,
        ))  # fmt: skip
        if len(self._kept) > self.keyframes:
            self._join()

    def _join(self) -> None:
        """Make one of the two neighbours that lie closest, or drop the lighter where they lie too far apart."""
        gaps = [keyframe_kernel.apart(a.T, b.T) for a, b in pairwise(self._kept)]
        i = int(np.argmin(gaps))
        a, b = self._kept[i], self._kept[i + 1]
        kept, other = (a, b) if a.count >= b.count and i + 2 < len(self._kept) else (b, a)
        if gaps[i] <= _MIXED:
            total = a.count + b.count
            kept.wrench = (a.count * a.wrench + b.count * b.wrench) / total
            kept.T[:3, 3] = (a.count * a.T[:3, 3] + b.count * b.T[:3, 3]) / total
            kept.time = (a.count * a.time + b.count * b.time) / total
            kept.began, kept.span = a.began, b.began + b.span - a.began
            kept.count = total
            if kept.known:
                self._reduce(kept, self._kept.index(kept))
        del self._kept[self._kept.index(other)]

    # One step over all keyframes -------------------------------------------------------------------------------------

    def _solve(self) -> FusedEstimate:
        """Return the result after a reading was added to the last keyframe.

        All keyframes are linearised anew together: one at a time, their mixed linearisations would claim more than is
        known where the point is hardly known. Between, only the mean of the last one changes.
        """
        last, before = self._kept[-1], self._kept[-1].known
        self._turn += 1
        if before and last.count not in SWEEPS and self._turn < IN_TURN * len(self._kept):
            self._reduce(last, len(self._kept) - 1)
            return self._remember(self._step())
        self._turn, result = 0, FusedEstimate("not_converged")
        for _ in range(1 if before else 2):
            if not all(self._linearise(k) for k in range(len(self._kept))):
                return self._remember(FusedEstimate("not_converged"))
            result = self._step()
        return self._remember(result)

    def _remember(self, result: FusedEstimate) -> FusedEstimate:
        """Return the result with its curvature; a fit that is inconsistent or did not converge is restarted."""
        if result.ok:
            result = self._curved(result)
        if result.result in ("inconsistent", "not_converged"):
            self._x = None
        self._last = result
        return result

    def _linearise(self, k: int) -> bool:
        """Move the touch of a keyframe to the present solution and linearise it; return whether it has a stable
        equilibrium.
        """
        frame, model = self._kept[k], self.estimator.model
        if frame.known and self._x is not None:
            keyframe_kernel.step_keyframe(frame.touch, frame.lin, frame.local, frame.x, 1.0,
                                 MAX_STEP * model.rod.length, model.rod.flank_end, self._step_work)  # fmt: skip
        if not keyframe_kernel.linearise_keyframe(
            model.rod.body, frame.sources.gravity, model.mass, FINE, frame.touch, *frame.sources.arguments(),
            self._sweep_work, frame.lin, frame.D,
        ):  # fmt: skip
            return False
        frame.known = True
        self._reduce(frame, k)
        return True

    def _reduce(self, frame: Keyframe, k: int) -> None:
        self._ramp[frame.slot] = k / (len(self._kept) - 1) if len(self._kept) > 1 else 1.0
        keyframe_kernel.reduce_keyframe(
            frame.touch, frame.lin, frame.D, frame.wrench, frame.T, self._channels,
            math.sqrt(frame.weight(self._walk_rate)) * self._whiten, self._step_of_bias, self.estimator.model.friction,
            COMMON_FRICTION, self._priors.robot_mm * MM, self._scatter, self._creep, self._ramp[frame.slot],
            self._block, frame.local, frame.reduced,
        )  # fmt: skip

    def _gather(self) -> tuple[NDArray[np.int64], Array, float]:
        """Return the order of the rows, the variance of the bias's step before each, and its standard deviation at the
        first [steps].
        """
        frames = [frame for frame in self._kept if frame.known]
        variances = np.array([self._variance_at(frame.time) for frame in frames])
        walk, order = np.diff(variances, prepend=variances[:1]), [frame.slot for frame in frames]
        return np.array(order, dtype=np.int64), np.maximum(walk, 0.0), self._start_of(frames[0])

    def _start_of(self, first: Keyframe) -> float:
        """Return the standard deviation of the bias at the first keyframe [steps]: the mean of a walk over T has the
        variance q T/3, and `Keyframe.weight` has q T/12 of it.
        """
        return math.sqrt(self._variance_at(first.began + 0.25 * first.span))

    def _variance_at(self, time: float) -> float:
        """Return the variance of the bias during the touch [steps²]."""
        assert self._known is not None
        return self._known.variance_after(max(time - self._began, 0.0), self._walk)

    def _step(self) -> FusedEstimate:
        """Solve all keyframes as they are linearised."""
        order, walk, start = self._gather()
        x = np.empty(self._width - 1)
        chi2 = fusion_kernel.solve_reduced(
            self._all, order, walk, start, self._causes, self._chain, self._work, x, self._cov
        )
        if not math.isfinite(chi2):
            return FusedEstimate("not_converged")
        fusion_kernel.smooth_bias(self._chain, order, walk, x, self._xs)
        self._x = x
        return self._result(x, float(chi2), order, walk)

    def _result(self, x: Array, chi2: float, order: NDArray[np.int64], walk: Array) -> FusedEstimate:
        model, frames = self.estimator.model, [frame for frame in self._kept if frame.known]
        free = 0 if math.isfinite(model.friction) else 2
        dof = max(len(frames) * (len(self._channels) - free) - 3, 1)
        rms = statistics.rms(self._cov)
        stiffness, std = 1.0, 0.0
        if self._E >= 0:
            scale = self._priors.youngs_modulus
            stiffness = math.exp(scale * float(x[3 + self._E]))
            std = scale * fusion_kernel.standard_deviation(self._work, len(x), 3 + self._E, self._mean_work)
        touches = self._touches[[frame.slot for frame in frames]]
        force_std = math.sqrt(float(self._sample[0, 0])) / np.sqrt([frame.count for frame in frames])
        code = result_of(chi2, dof, rms / model.rod.length, touches, force_std, self.moments_only)
        if code != "ok":
            return FusedEstimate(code, stiffness=stiffness, std_stiffness=stiffness * std, chi2=chi2, dof=dof, rms=rms,
                                 iterations=1)  # fmt: skip
        fusion_kernel.mean_centre(
            self._lins, self._Ds, self._locals, self._poses, order, self._touched, walk, self._chain, self._xs,
            self._scatter, self._creep, self._ramp, self._mean_work, self._work, self._mean, self._cov_mean,
        )  # fmt: skip
        s = np.empty(len(frames))
        multistart.contact_arclengths(model.rod.body, touches, s)
        return FusedEstimate(
            "ok", x[:3].copy(), self._cov.copy(), self._mean.copy(), self._cov_mean.copy(), s,
            touches[:, DEAD : DEAD + 3], touches[:, NORMAL],
            touches[:, NORMAL] * np.hypot(touches[:, AROUND], touches[:, ALONG]), stiffness, stiffness * std, chi2, dof,
            rms, iterations=1, candidates_world=x[None, :3].copy(),
        )  # fmt: skip

    def _is_due(self, size: float) -> bool:
        """Return whether to evaluate the curvature again, which takes some milliseconds."""
        before, since, last = self._curvature[0], self._time - self._evaluated, self._kept[-1]
        if before == 0.0 or since < CURVATURE_SECONDS[0]:
            return before == 0.0
        return last.count >= last.due or since > CURVATURE_SECONDS[1] or not 0.5 * before < size < 2.0 * before

    def _evaluate_curvature(self, size: float) -> None:
        """Evaluate the curvature correction, and whether the object has moved, by the batch of the keyframes."""
        fusion, start = self._batch()
        best, last = fusion.refine(start), self._kept[-1]
        self._evaluated, last.due = self._time, 4.0 * max(last.count, FIRST_CURVATURE)
        surface = contact = np.zeros((3, 3))
        self._moved = False
        if best is not None:
            surface, contact = (_positive_part(of) for of in fusion.curvature(best))
            state = FusionState(fusion, best.touches)
            self._moved = state.linearise() and state.has_moved()
        self._curvature = size, surface, contact

    def _curved(self, result: FusedEstimate) -> FusedEstimate:
        """Return the result with the curvature correction.

        From one evaluation to the next it goes with the square of the covariance, and only where it adds: the
        covariance has turned since.
        """
        size = float(np.trace(result.cov_surface_world))
        if self._is_due(size):
            self._evaluate_curvature(size)
        before, added, added_contact = self._curvature
        share = min(size / before, 1.0) ** 2 if before > 0.0 else 0.0
        cov = result.cov_surface_world + share * added
        rms = statistics.rms(cov)
        if self._moved or not rms < self.estimator.model.rod.length * UNIFORM_STD:
            uncertain: Result = "unobservable" if self.moments_only else "too_light"
            return FusedEstimate(
                "inconsistent" if self._moved else uncertain, stiffness=result.stiffness,
                std_stiffness=result.std_stiffness, chi2=result.chi2, dof=result.dof, rms=rms, iterations=1,
            )  # fmt: skip
        return replace(
            result, cov_surface_world=cov, cov_contact_world=result.cov_contact_world + share * added_contact, rms=rms
        )

    # Starting --------------------------------------------------------------------------------------------------------

    def _begin(self) -> FusedEstimate:
        """Start at the first reading and then ever more rarely; between, return the last result, which is never
        "ok".
        """
        if self.moments_only and len(self._kept) < 2:
            self._last = FusedEstimate("unobservable")
            return self._last
        self._idle += 1
        if self._idle < self._wait:
            return self._last
        self._idle, self._wait = 0, min(2 * self._wait, MAX_WAIT)
        # Moments alone may have rivals that one reading does not show; of one pose, a batch knows no more.
        result = FusedEstimate("not_converged") if self.moments_only else self._from_one()
        if result.result not in ("ok", "too_light") and len(self._kept) > 1:
            result = self._from_batch()
        return self._remember(result)

    def _from_one(self) -> FusedEstimate:
        """Start from the touch that the last keyframe's reading gives by itself."""
        last = self._kept[-1]
        found = self.estimator.estimate(last.wrench, last.sources.gravity)
        if found.result == "ambiguous":
            return FusedEstimate("ambiguous")
        if not found.candidates or found.candidates[0].touch is None:
            return FusedEstimate("not_converged")
        return self._settled([found.candidates[0].touch] * len(self._kept))

    def _settled(self, touches: list[Array]) -> FusedEstimate:
        """Take a few steps over all keyframes from a guess of their touches."""
        self._x = None
        for frame, touch in zip(self._kept, touches, strict=True):
            frame.touch[:], frame.known = touch, False
        result = FusedEstimate("not_converged")
        for _ in range(SETTLING if len(self._kept) > 1 else 2):
            if not all(self._linearise(k) for k in range(len(self._kept))):
                return FusedEstimate("not_converged")
            result = self._step()
        return result

    def _batch(self) -> tuple[Fusion, Array]:
        """Return the keyframes as one batch, and their touches, (k, TOUCH)."""
        readings = [
            Reading(frame.wrench.copy(), self._sample / frame.weight(self._walk_rate), frame.T, frame.sources.gravity,
                    True, frame.time)
            for frame in self._kept
        ]  # fmt: skip
        touches, first, last = [frame.touch for frame in self._kept], self._kept[0].time, self._kept[-1].time
        walked = self._variance_at(last) - self._variance_at(first)
        walk = max(walked, 0.0) / (last - first) if last > first else self._walk
        priors = replace(
            self._priors, drift_steps=self._start_of(self._kept[0]), walk_steps=math.sqrt(walk * WALK_SECONDS)
        )
        fusion = Fusion(self.estimator.model, tuple(readings), priors, self._channels, self._gravity_world)
        return fusion, np.array(touches)

    def _from_batch(self) -> FusedEstimate:
        """Start from the whole batch."""
        fusion, _touches = self._batch()
        found = fusion.solutions()
        if isinstance(found, FusedEstimate):
            return found
        result = fusion.answer(found, brief=True)
        if not result.ok:
            return result
        return self._settled(list(found[0].touches[fusion.touched]))


def _positive_part(A: Array) -> Array:
    """Return the nearest positive semidefinite matrix to a symmetric one."""
    values, vectors = np.linalg.eigh(A)
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T)
