"""Where a probe is touched: detection, one of the methods, and the result code."""

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from probedesign.core.errors import InputError
from probedesign.core.frames import Array, is_pose
from probedesign.core.statistics import (
    FALSE_ALARM,
    MISFIT_CHANCE,
    NORMAL_95,
    NORMAL_GROWTH,
    RIVAL_CHI2,
    UNIFORM_95,
    UNIFORM_STD,
    is_normal,
    max_chi2,
    sigmas_95,
)
from probedesign.core.units import MM
from probedesign.design.sensors import Noise
from probedesign.estimation import force_moment, likelihood
from probedesign.estimation.bias import RAMP_STEPS
from probedesign.estimation.error_sources import ErrorSources
from probedesign.estimation.estimate import Candidate, Estimate, FusedEstimate, MomentsAbout, Result
from probedesign.estimation.force_moment import Problem
from probedesign.estimation.model import WALK_SECONDS, Observation, ProbeModel, Tolerances, covariance
from probedesign.estimation.uncertainty_kernel import WIDE
from probedesign.rod.equilibrium import Equilibrium

if TYPE_CHECKING:
    from probedesign.estimation.fusion import Reading

Method = Literal["ml", "force_moment"]  #: Ways to locate a single contact.

ALARM_CHI2 = max_chi2(6, FALSE_ALARM)
#: Difference of poses, in metres and in entries of the rotation, up to which they are one: far below any robot's.
SAME_POSE = 1e-6
#: Number of estimators of other variances of the bias that are cached: those of one touch after the other.
MAX_AGED = 8
#: Change of the base moment with s, over the force, below which the place of a force is not observable.
MIN_LEVER = 0.1


@dataclass(frozen=True)
class Estimator:
    """Locates one contact from one base wrench, or from a window of them.

    Two methods: "ml", maximum a posteriori: the touch of the surface, by a force of any direction with a prior on its
    friction, whose base wrench lies nearest to the reading, weighted by the sensor's noise and all error sources.
    "force_moment", the published one: the force by its equation 5, then the arclength where that force, of any
    direction, makes the measured moment.
    """

    model: ProbeModel  #: the probe.
    tolerances: Tolerances | None = None  #: standard deviations of the model's parameters; None: those of its design.
    _last_free: dict[bytes, Equilibrium] = field(default_factory=dict, compare=False, repr=False)
    _last_sources: dict[bytes, ErrorSources] = field(default_factory=dict, compare=False, repr=False)
    _last_aged: dict[int, "Estimator"] = field(default_factory=dict, compare=False, repr=False)

    @cached_property
    def priors(self) -> Tolerances:
        """Return the tolerances in use."""
        return Tolerances.of(self.model) if self.tolerances is None else self.tolerances

    def with_noise(self, force_N: float, moment_Nm: float) -> "Estimator":
        """Return the estimator for readings with these standard deviations of each channel.

        Args:
            force_N: [N], positive.
            moment_Nm: [N·m], positive.

        Raises:
            InputError: a value is not positive and finite.
        """
        for name, value in (("force_N", force_N), ("moment_Nm", moment_Nm)):
            if not 0.0 < value < np.inf:
                raise InputError(f"{name} = {value} must be positive and finite")
        return Estimator(self.model.with_noise(Noise.isotropic(float(force_N), float(moment_Nm))), self.tolerances)

    def with_tolerances(self, tolerances: Tolerances | None = None) -> "Estimator":
        """Return the estimator with other tolerances.

        Args:
            tolerances: as `Tolerances.of` the model has them if None; `Tolerances.none()` is an exact probe.
        """
        return Estimator(self.model, tolerances)

    def with_friction(self, friction: float) -> "Estimator":
        """Return the estimator with another prior on friction.

        Args:
            friction: standard deviation of tangential over normal force in each direction; 0: the force is normal to
                the surface; inf: its direction is free.

        Raises:
            InputError: friction is NaN or below 0.
        """
        return Estimator(replace(self.model, friction=float(friction)), self.tolerances)

    def estimate(
        self,
        wrench_base: ArrayLike,
        gravity_base: ArrayLike | None = None,
        *,
        method: Method = "ml",
        near: Estimate | None = None,
    ) -> Estimate:
        """Locate the contact that explains a reading.

        Args:
            wrench_base: what the probe does to its mount, about the base origin [N, N·m], (6,), or a window of
                independent readings of one and the same touch, (n, 6).
            gravity_base: gravity in base axes [m/s²], (3,); the design's mount if None.
            method: "ml" or "force_moment".
            near: an estimate of a touch close by, which "ml" then starts from; it looks no further if it finds
                a contact there.

        Returns:
            The estimate; anything that goes wrong is its result code, never an exception.

        Raises:
            InputError: an argument has the wrong shape, gravity is not finite, or there is no such method.
        """
        wrenches = np.asarray(wrench_base, dtype=float)
        gravity = self._gravity(gravity_base)
        if method not in get_args(Method):
            raise InputError(f"method = {method!r} is not known; known: ml, force_moment")
        if wrenches.shape[-1:] != (6,) or wrenches.ndim > 2 or len(wrenches) == 0:
            raise InputError(
                f"wrench_base has shape {wrenches.shape}; it must be (6,), force and moment, or (n, 6) of them"
            )
        window = np.ascontiguousarray(wrenches.reshape(-1, 6))
        free = self.free(gravity)
        seen = Observation.of(self.model, window, gravity, free.wrench_base)
        if seen is None:
            return Estimate("out_of_range")
        if not free.ok:
            return Estimate("not_converged")
        readings = len(window)
        chi2 = seen.chi2 / self._scatter(readings)
        if chi2 < ALARM_CHI2:
            return Estimate("no_contact", detection_chi2=chi2, solve_shape=lambda: free)
        if seen.zero_chi2 / self._scatter(readings) < ALARM_CHI2:
            # Zero is read: the sensor was tared with the probe mounted, and that zero was not taken into account.
            # A contact that balances all six channels is not a coincidence to believe in.
            return Estimate("no_tare", detection_chi2=chi2)
        sources = self.sources(gravity)
        noise = covariance(self.model, seen.wrench, readings) + sources.drift
        problem = Problem(sources, seen, self.model.friction, noise)
        if method != "ml":
            return self._decide(force_moment.locate(problem), chi2, readings, problem)
        start = near.candidates[0] if near is not None and near.candidates else None
        found = likelihood.locate(problem, start)
        if not found:
            # The force–moment method may show why there is none, but its place is not that of the method "ml".
            why = self._decide(force_moment.locate(problem), chi2, readings)
            return Estimate("not_converged", detection_chi2=chi2) if why.ok else why
        return self._decide(found, chi2, readings, problem)

    def sources(self, gravity_base: ArrayLike | None = None) -> ErrorSources:
        """Return the error sources under gravity [m/s²], (3,); the design's mount if None. The last ones are kept."""
        gravity = self._gravity(gravity_base)
        sources = self._last_sources.get(key := gravity.tobytes())
        if sources is None:
            sources = ErrorSources.of(self.model, self.priors, gravity, self.free(gravity))
            self._last_sources.clear()
            self._last_sources[key] = sources
        return sources

    def _gravity(self, gravity_base: ArrayLike | None) -> Array:
        if gravity_base is None:
            return self.model.gravity_base
        gravity = np.asarray(gravity_base, dtype=float)
        if gravity.shape != (3,) or not math.isfinite(gravity @ gravity):
            raise InputError(f"gravity_base = {gravity} must be three finite numbers in m/s²")
        return gravity

    def fuse(
        self,
        wrenches_base: ArrayLike,
        Ts_world_base: ArrayLike,
        gravity_world: ArrayLike = (0.0, 0.0, -9.81),
        *,
        moments_only: bool = False,
        moments_about: MomentsAbout = "base",
        touched: ArrayLike | None = None,
        times: ArrayLike | None = None,
        object_compliance: float | None = None,
        object_walk: float | None = None,
    ) -> FusedEstimate:
        """Locate one fixed point of the world that the probe touches from several poses of its base.

        Args:
            wrenches_base: readings about the base's origin, in the order of time, (k, 6); with moments alone about
                the base the forces may be NaN.
            Ts_world_base: pose of the base at each, (k, 4, 4).
            gravity_world: [m/s²], (3,).
            moments_only: whether the readings of the forces are not used.
            moments_about: with moments alone, which: those about the base's origin, in which the sensor's force noise
                times its lever shows, or those that the sensor reads itself, which need all six numbers to be got
                back and are then free of it.
            touched: where there was contact, (k,), all if None; readings without it tie the bias down.
            times: of the readings [s], (k,), for the walk of the bias; `WALK_SECONDS` apart if None. Consecutive
                readings from one pose count as a window of one touch.
            object_compliance: scale of the half-normal prior of how far the object yields per force [m/N]; 0 is a
                rigid object; that of the estimator's priors if None.
            object_walk: standard deviation, on each axis, of a step of a loose object between two touches [m]; that
                of the estimator's priors if None.

        Returns:
            The estimate with its covariance; anything that goes wrong is its result code, never an exception.

        Raises:
            InputError: an argument has the wrong shape, or compliance or walk is negative or not finite.
        """
        from probedesign.estimation.fusion import Fusion  # compiled for those who fuse alone
        from probedesign.estimation.fusion_state import channels_of

        moments = moments_about if moments_only else None
        if moments not in (None, "base", "sensor"):
            raise InputError(f"moments_about = {moments!r} is not known; known: base, sensor")
        priors = self.priors
        if object_compliance is not None:
            priors = replace(priors, object_compliance=object_compliance)
        if object_walk is not None:
            priors = replace(priors, object_walk_mm=object_walk / MM)
        wrenches, poses, gravity, contact, clock = _fused_arguments(
            wrenches_base, Ts_world_base, gravity_world, touched, times
        )
        known = [wrenches[:, 3:] if moments == "base" else wrenches, gravity, clock]
        if not (all(np.isfinite(of).all() for of in known) and all(is_pose(T) for T in poses)):
            return FusedEstimate("out_of_range")
        wrenches, gravities = np.nan_to_num(wrenches), gravity @ poses[:, :3, :3]
        channels = slice(0, 6) if moments is None else slice(3, 6)
        read = [self.model.to_sensor(w, g)[channels] for w, g in zip(wrenches, gravities, strict=True)]
        if (np.abs(read) > self.model.saturation_limit[channels]).any() or (np.diff(clock) < 0.0).any():
            return FusedEstimate("out_of_range")
        frees = [self.free(g) for g in gravities]
        if not all(free.ok for free in frees):
            return FusedEstimate("not_converged")
        detected = [
            self._detection_chi2(wrench, free) >= ALARM_CHI2
            for wrench, free, touches in zip(wrenches, frees, contact, strict=True)
            if touches
        ]
        if moments is None and detected and not any(detected):
            return FusedEstimate("no_contact")
        readings, window = self._windows(wrenches, poses, gravities, contact, clock, priors)
        found = Fusion(self.model, readings, priors, channels_of(self.model, moments), gravity).solve()
        if not found.ok or len(readings) == len(window):
            return found
        return replace(
            found, s_contact=found.s_contact[window], force_base=found.force_base[window],
            force_normal=found.force_normal[window], force_tangential=found.force_tangential[window],
        )  # fmt: skip

    def _windows(
        self, wrenches: Array, poses: Array, gravities: Array, contact: NDArray[np.bool_], clock: Array,
        priors: Tolerances,
    ) -> "tuple[tuple[Reading, ...], list[int]]":  # fmt: skip
        """Return one reading for each run of readings from one pose, and the run of each reading.

        A run is one touch: priors on friction and on its stiffness count once. In its mean the bias has walked: a walk
        of variance q a second scatters the mean over T seconds about the bias at its middle by q T/12.
        """
        from probedesign.estimation.fusion import Reading

        starts = [
            k for k in range(len(poses))
            if k == 0 or contact[k] != contact[k - 1] or np.abs(poses[k] - poses[k - 1]).max() > SAME_POSE
        ]  # fmt: skip
        step = self.model.noise_base() * self.model.averaging_samples
        readings, window = list[Reading](), list[int]()
        for first, end in zip(starts, [*starts[1:], len(poses)], strict=True):
            wrench, n = wrenches[first:end].mean(axis=0), end - first
            walked = priors.walk_steps**2 * (clock[end - 1] - clock[first]) / WALK_SECONDS / 12.0
            cov = covariance(self.model, wrench, n) + walked * step
            time = float(clock[first:end].mean())
            window += [len(readings)] * n
            readings.append(Reading(wrench, cov, poses[first], gravities[first], bool(contact[first]), time))
        return tuple(readings), window

    def free(self, gravity_base: ArrayLike | None = None) -> Equilibrium:
        """Return the untouched probe under gravity [m/s²], (3,); the design's mount if None. The last one is kept."""
        gravity = self._gravity(gravity_base)
        free = self._last_free.get(key := gravity.tobytes())
        if free is None:
            free = self.model.rod.solve(gravity)
            self._last_free.clear()
            self._last_free[key] = free
        return free

    def detects(self, wrench_base: Array, gravity_base: ArrayLike | None = None) -> bool:
        """Return whether a reading (6,) differs significantly from the free probe's (equation 4 with drift)."""
        free = self.free(gravity_base)
        return free.ok and self._detection_chi2(wrench_base, free) >= ALARM_CHI2

    def force_share(self, force: Array, readings: int = 1) -> float:
        """Return the standard deviation of the force, by noise and drift, over the force [N], (3,)."""
        std_force = self.model.noise.force * math.sqrt(self._scatter(readings) / readings)
        return std_force / max(math.sqrt(force @ force), 1e-300)

    def result_at(self, s: float, std_s: float, force: Array) -> Result:
        """Return the result of one reading whose contact is known to s and its standard deviation [m], (3,) [N].

        "too_light" if s is no better known than without a reading: uniform over the probe.
        """
        length, share = self.model.rod.length, self.force_share(force)
        if is_normal(share, s, std_s):
            return "ok" if std_s < length * UNIFORM_STD else "too_light"
        low, high = likelihood.ratio_interval(s, std_s, share, length)
        return "interval_only" if high - low < UNIFORM_95 * length else "too_light"

    def with_drift(self, steps: float) -> "Estimator":
        """Return the estimator for readings whose bias is known with a standard deviation in steps of the resolution.

        It is rounded up to `drift_steps` of the tolerances times a power of √2, and never below `drift_steps`, which
        is assumed like the numbers that the bias is followed with. Such estimators are cached.
        """
        least = self.priors.drift_steps
        if least == 0.0 or not steps > least:
            return self
        doublings = math.ceil(2.0 * math.log2(steps / least))
        aged = self._last_aged.get(doublings)
        if aged is None:
            tolerances = replace(self.priors, drift_steps=least * math.sqrt(2.0**doublings))
            aged = Estimator(self.model, tolerances, self._last_free)
            if len(self._last_aged) >= MAX_AGED:
                self._last_aged.clear()
            self._last_aged[doublings] = aged
        return aged

    def with_tare_age(self, seconds: float) -> "Estimator":
        """Return the estimator for readings this long after a tare [s] since which the bias was not followed.

        The tolerance `drift_steps` applies `WALK_SECONDS` after the tare; its variance grows with time, and that of
        the rate of drift (`bias.RAMP_STEPS`) with its square.
        """
        if not seconds > WALK_SECONDS:
            return self
        walked = self.priors.drift_steps**2 * seconds / WALK_SECONDS
        return self.with_drift(math.sqrt(walked + (RAMP_STEPS * seconds) ** 2))

    def _scatter(self, readings: int = 1) -> float:
        return 1.0 + readings * self.priors.drift_steps**2 * self.model.averaging_samples

    def detectable(self, wrench_by_force: Array) -> float:
        """Return the smallest force [N] that is detected with probability 0.5.

        Args:
            wrench_by_force: change of the base wrench per newton of contact, (6,).
        """
        least = math.sqrt(ALARM_CHI2 * self._scatter())
        return least / float(np.linalg.norm(self.model.whiten @ wrench_by_force))

    def _detection_chi2(self, wrench: Array, free: Equilibrium) -> float:
        off = self.model.whiten @ (wrench - free.wrench_base)
        return float(off @ off) / self._scatter()

    def _decide(
        self, found: list[Candidate], detection_chi2: float, readings: int, problem: Problem | None = None
    ) -> Estimate:
        if not found:
            return Estimate("not_converged", detection_chi2=detection_chi2)
        listed = tuple(sorted(found, key=lambda candidate: candidate.chi2)) if len(found) > 1 else tuple(found)
        best = listed[0]
        result, interval = self._result(listed, readings, problem)
        if result != "ok":
            return Estimate(result, force_base=best.force_base, detection_chi2=detection_chi2, candidates=listed,
                            solve_interval=None if interval is None else lambda: interval)  # fmt: skip
        return Estimate(
            "ok", best.s_contact, best.std_s, best.p_contact_base, best.p_surface_base, best.force_base,
            best.cov_contact_base, best.cov_surface_base, best.force_normal, best.force_tangential,
            best.friction_ratio, detection_chi2, listed, best.shape,
            None if problem is None else lambda: likelihood.profile_interval(problem, best),
        )  # fmt: skip

    def _result(
        self, listed: tuple[Candidate, ...], readings: int, problem: Problem | None
    ) -> tuple[Result, tuple[float, float] | None]:
        """Return the result code of the best candidate among its rivals, and the interval of an "interval_only"."""
        best, length = listed[0], self.model.rod.length
        if best.chi2 > max_chi2(best.dof, MISFIT_CHANCE) or best.force_normal <= 0.0:
            return "out_of_range" if best.at_end else "inconsistent", None
        # At an end the likely places lie to one side; where they reach far, no ellipsoid about the end holds them.
        normal = not (best.at_end and best.std_s > WIDE * length) and is_normal(
            self.force_share(best.force_base, readings), best.s_contact, best.std_s
        )
        if best.lever < MIN_LEVER and not (normal and best.std_s < length * UNIFORM_STD):
            return "unobservable", None
        if normal and best.std_s >= length * UNIFORM_STD:
            return "too_light", None
        for rival in listed[1:]:
            apart = abs(rival.s_contact - best.s_contact)
            if rival.chi2 < best.chi2 + RIVAL_CHI2 and apart > sigmas_95(1) * math.hypot(rival.std_s, best.std_s):
                return "ambiguous", None
        if normal and (best.growth >= NORMAL_GROWTH or problem is None):
            return "ok", None
        if problem is None:
            return "too_light", None
        low, high = likelihood.profile_interval(problem, best)
        if normal and max(best.s_contact - low, high - best.s_contact) <= NORMAL_95 * best.std_s:
            return "ok", None
        return ("interval_only", (low, high)) if high - low < UNIFORM_95 * length else ("too_light", None)


def _fused_arguments(
    wrenches_base: ArrayLike,
    Ts_world_base: ArrayLike,
    gravity_world: ArrayLike,
    touched: ArrayLike | None,
    times: ArrayLike | None,
) -> tuple[Array, Array, Array, NDArray[np.bool_], Array]:
    """Return the arguments of `Estimator.fuse` as arrays.

    Raises:
        InputError: a shape is wrong.
    """
    wrenches, poses = np.asarray(wrenches_base, dtype=float), np.asarray(Ts_world_base, dtype=float)
    gravity, k = np.asarray(gravity_world, dtype=float), len(wrenches) if wrenches.ndim else 0
    contact = np.ones(k, dtype=bool) if touched is None else np.asarray(touched, dtype=bool)
    clock = WALK_SECONDS * np.arange(k) if times is None else np.asarray(times, dtype=float)
    shapes = {"wrenches_base": (wrenches, (k, 6)), "Ts_world_base": (poses, (k, 4, 4)),
              "gravity_world": (gravity, (3,)), "touched": (contact, (k,)), "times": (clock, (k,))}  # fmt: skip
    for name, (array, shape) in shapes.items():
        if array.shape != shape or k == 0:
            raise InputError(f"{name} has shape {array.shape}; it must be {shape}, one or more readings k")
    return wrenches, poses, gravity, contact, clock.astype(float)
