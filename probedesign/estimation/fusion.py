"""Readings of one fixed point, touched from several poses of the base, fused by Gauss-Newton.

Pressing on by a known motion of the base measures the compliance at the contact, which locates it without any reading
of the force. What is minimised is written down in `keyframe_kernel.py`; a single touch is the fusion of one pose, and a
tracked touch (`tracker.py`) the fusion of its keyframes as they come.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from probedesign.core import statistics
from probedesign.core.frames import Array, wrench_map
from probedesign.core.statistics import MISFIT_CHANCE, RIVAL_CHI2, UNIFORM_STD, max_chi2
from probedesign.estimation.error_sources import ErrorSources, across
from probedesign.estimation.estimate import FusedEstimate, MomentsAbout, Result
from probedesign.estimation.force_moment import closest_approaches, curve
from probedesign.estimation.fusion_state import GROUPS, FusionState, PointConstraint, result_of, without
from probedesign.estimation.likelihood import Problem, locate
from probedesign.estimation.model import Observation, ProbeModel
from probedesign.estimation.tolerances import WALK_SECONDS, Tolerances
from probedesign.estimation.uncertainty_kernel import NODE, TAIL
from probedesign.rod.kernels.surface_contact import TOUCH

NEAR = 1e-9
"""Poses whose numbers differ by no more, in metres too, are one."""
STARTS = 3
"""Closest approaches of the curves that a fusion starts from."""
ANYWHERE = (4, 10, 16, 22)
"""Stations to start from where no closest approach leads to a solution."""
MAX_ITERATIONS = 40
CLOSE = 1e-3
"""Step of the touched point, in standard deviations, at which the iterations end."""
SETTLED_STEP = 0.03
"""Step of a pose's own unknowns, in standard deviations given the point, at which they end too; it is taken."""
MAX_STEP = 0.1
"""Of arclength over length, in one iteration."""
COMMON_FRICTION = 0.5
"""Share of the friction ratio's variance that the touches of one object have in common. Assumed: they are of the same
two materials and slip to the same side, but differ in how far each has slipped."""
CONSTRAINT_STD = 1e-3
"""Standard deviation, over that of the free point, to which `Fusion.curvature` constrains the point."""
MAX_EXTENSIONS = 3
"""Extensions of the offset at which the point is constrained, until the misfit has risen by about three."""


def channels_of(model: ProbeModel, moments: MomentsAbout | None) -> Array:
    """Return the map from a base wrench to the channels that the fusion uses.

    Args:
        model: the probe.
        moments: None: all six channels. "base": the moments about the base's origin alone. "sensor": the moments that
            the sensor reads, which hold no noise of the forces; but they need all six numbers to be got back.

    Returns:
        (6, 6) or (3, 6).
    """
    if moments is None:
        return np.eye(6)
    return np.ascontiguousarray(np.eye(6)[3:] if moments == "base" else wrench_map(model.T_sensor_base)[3:])


@dataclass(frozen=True)
class Reading:
    """One reading, or the mean of several, at one pose."""

    wrench: Array  #: at the base, after payload compensation, (6,).
    cov: Array  #: of its noise, (6, 6).
    T_world_base: Array  #: (4, 4).
    gravity: Array  #: base axes [m/s²], (3,).
    touched: bool  #: whether there was contact.
    time: float | None = None  #: of the reading [s]; None: `WALK_SECONDS` after the one before.


class Solution(NamedTuple):
    """Result of one Gauss-Newton solve."""

    x: Array  #: the common unknowns: touched point, error sources, bias, (n,).
    cov: Array  #: of the touched point [m²], (3, 3).
    chi2: float  #: misfit, priors included.
    touches: Array  #: at every pose, (k, TOUCH); undefined for free poses.
    iterations: int  #: how many.


@dataclass(frozen=True)
class Fusion:
    """Readings to be fused."""

    model: ProbeModel  #: the probe.
    readings: tuple[Reading, ...]  #: in the order of time.
    priors: Tolerances  #: standard deviations of the error sources.
    channels: Array  #: what of a wrench at the base counts, (m, 6): see `channels_of`.
    gravity_world: Array  #: gravity in the world [m/s²], (3,).
    #: share of the friction ratio's variance that all touches have in common, below 1.
    common_friction: float = COMMON_FRICTION

    @property
    def moments_only(self) -> bool:
        """Return whether only the moments are used."""
        return len(self.channels) == 3

    @cached_property
    def touched(self) -> NDArray[np.bool_]:
        """Return which readings are of a contact, (k,)."""
        return np.array([reading.touched for reading in self.readings])

    @property
    def one_pose(self) -> bool:
        """Return whether all touched readings have the same pose."""
        poses = [reading.T_world_base for reading in self.readings if reading.touched]
        return all(np.allclose(poses[0], T, rtol=0.0, atol=NEAR) for T in poses[1:])

    @property
    def dof(self) -> int:
        """Return the degrees of freedom: readings and friction priors, less the unknowns."""
        free = 0 if math.isfinite(self.model.friction) else 2
        return max(len(self.readings) * len(self.channels) - free * int(self.touched.sum()) - 3, 1)

    # What the kernels need -------------------------------------------------------------------------------------------

    @cached_property
    def sources(self) -> tuple[ErrorSources, ...]:
        """Return the error sources at every pose; the sensor was tared at the first reading."""
        axes = across(self.gravity_world)
        found: list[ErrorSources] = []
        known: dict[bytes, ErrorSources] = {}
        for reading in self.readings:
            R = np.ascontiguousarray(reading.T_world_base[:3, :3])
            key = R.tobytes()
            if key not in known:
                free = self.model.rod.solve(reading.gravity)
                known[key] = ErrorSources.of(
                    self.model, self.priors, reading.gravity, free, found[0] if found else None, axes @ R, posed=True
                )
            found.append(known[key])
        return tuple(found)

    @cached_property
    def own_columns(self) -> tuple[int, int]:
        """Return the columns of the stiffness scatter and of the creep, or -1."""
        return self.sources[0].column("stiffness scatter"), self.sources[0].column("creep")

    @cached_property
    def ramps(self) -> Array:
        """Return how far creep has gone at each touch: from 0 at the first to 1 at the last, 1 if alone, (k,)."""
        before = np.maximum(np.cumsum(self.touched) - 1.0, 0.0)
        return np.ones(len(before)) if before[-1] == 0.0 else before / before[-1]

    @cached_property
    def steps_of_walk(self) -> Array:
        """Return the variance of the bias's step before each reading, over that in `WALK_SECONDS`, (k,)."""
        times = [reading.time for reading in self.readings]
        if any(time is None for time in times):
            return np.append(0.0, np.ones(len(times) - 1))
        seconds = np.diff(np.array(times, dtype=float), prepend=float(times[0] or 0.0))
        return np.asarray(np.maximum(seconds, 0.0) / WALK_SECONDS)

    @cached_property
    def whitening(self) -> Array:
        """Return the whitening matrix of each reading, lower triangular, (k, m, m)."""
        covs = np.array([self.channels @ reading.cov @ self.channels.T for reading in self.readings])
        return np.ascontiguousarray(statistics.whiten(covs))

    @cached_property
    def bias(self) -> Array:
        """Return the derivative of the channels by the bias in steps of the resolution, (m, 6)."""
        step = self.model.noise_base() * self.model.averaging_samples
        return np.ascontiguousarray(self.channels @ np.linalg.cholesky(step))

    @cached_property
    def free(self) -> dict[int, tuple[Array, Array]]:
        """Return wrench (6,) and error columns (6, J) of the free probe for each reading without contact."""
        found = {}
        for k, (reading, sources) in enumerate(zip(self.readings, self.sources, strict=True)):
            if not reading.touched:
                free = self.model.rod.solve(reading.gravity)
                found[k] = free.wrench_base, np.ascontiguousarray(sources.free_columns(free))
        return found

    # Solving ---------------------------------------------------------------------------------------------------------

    def solve(self) -> FusedEstimate:
        """Return the fused estimate; see `Estimator.fuse`."""
        found = self.solutions()
        if isinstance(found, FusedEstimate):
            return found
        return self.answer(found)

    def solutions(self) -> list[Solution] | FusedEstimate:
        """Return every solution, best first, or the result that explains why there is none."""
        if not self.touched.any() or (self.moments_only and self.one_pose):
            return FusedEstimate("unobservable")
        found: list[Solution] = []
        for starts in self._starts():
            found = _distinct([*found, *(self.refine(start) for start in starts)])
            if any(place.chi2 <= max_chi2(self.dof, MISFIT_CHANCE) for place in found):
                break
        return found or FusedEstimate("not_converged")

    def _starts(self) -> Iterable[list[Array]]:
        """Yield lists of initial touches, (k, TOUCH) each, the most likely first: from the single readings, from the
        closest approaches of the curves of equal moment, and from places along the probe.
        """
        k = len(self.readings)
        singles = [] if self.moments_only else self._from_single_readings()
        if k == 1 or self.one_pose:
            yield singles
            return
        curves = [curve(self.model.rod, r.gravity, r.wrench[3:6], r.T_world_base) for r in self.readings if r.touched]

        def at(stations: tuple[int, ...]) -> list[Array]:
            touches = [of.touches[j] for of, j in zip(curves, stations, strict=True)]
            if any(touch is None for touch in touches):
                return []
            start = np.zeros((k, TOUCH))
            start[self.touched] = np.array(touches)
            return [start]

        yield [*(start for place in closest_approaches(curves)[:STARTS] for start in at(place)), *singles]
        if self.moments_only:
            yield self._from_single_readings()
        yield [start for j in ANYWHERE for start in at((j,) * len(curves))]

    def _from_single_readings(self) -> list[Array]:
        """Return the touches estimated from each reading alone; an empty list if one has none."""
        start = np.zeros((len(self.readings), TOUCH))
        for k, (reading, sources) in enumerate(zip(self.readings, self.sources, strict=True)):
            if not reading.touched:
                continue
            whiten = statistics.whiten(reading.cov)
            seen = Observation(reading.wrench, whiten, reading.gravity, self.model.mass * reading.gravity, math.inf)
            places = locate(Problem(sources, seen, self.model.friction, reading.cov + sources.drift))
            if not places or places[0].touch is None:
                return []
            start[k] = places[0].touch
        return [start]

    def refine(self, start: Array, pin: PointConstraint | None = None) -> Solution | None:
        """Run Gauss-Newton from one initial guess of the touches, (k, TOUCH); return None if it does not converge."""
        touches, max_step = start.copy(), MAX_STEP * self.model.rod.length
        state = FusionState(self, touches, pin)
        share, last, way = 1.0, None, np.zeros(3)
        for iteration in range(MAX_ITERATIONS):
            if not state.linearise():
                return None
            chi2, x, cov = state.solved(self.priors)
            if not math.isfinite(chi2):
                return None
            moved = x[:3] - (x[:3] if last is None else last)
            # Where the model fits badly whole steps go to and fro about the least misfit.
            back = float(moved @ way) < -0.25 * float(way @ way)
            share, way, last = (max(0.5 * share, 0.1) if back else min(2.0 * share, 1.0)), moved, x[:3].copy()
            linearised = touches.copy()
            size = state.step(share, max_step)
            near = float(np.abs(moved).max()) <= CLOSE * statistics.rms(cov) + 1e-9
            if near and size <= SETTLED_STEP * math.sqrt(1.0 + chi2):
                touches[:] = linearised
                return Solution(x, cov, chi2, linearised, iteration + 1)
        return None

    # The result ------------------------------------------------------------------------------------------------------

    def answer(self, found: list[Solution], brief: bool = False) -> FusedEstimate:
        """Return the best solution with its result code.

        Args:
            found: every solution, best first.
            brief: leave out `rms_without` and `rms_with`.
        """
        best = found[0]
        linear = statistics.rms(best.cov)
        state = FusionState(self, best.touches.copy())
        if not state.linearise():
            return FusedEstimate("not_converged")
        code: Result = "inconsistent" if state.has_moved() else self._code(found, linear)
        _chi2, x, cov = state.solved(self.priors)
        E, scale = self.sources[0].column("E"), self.priors.youngs_modulus
        stiffness = math.exp(scale * float(x[3 + E])) if E >= 0 else 1.0
        result = FusedEstimate(
            code, stiffness=stiffness, std_stiffness=stiffness * scale * state.std_of(3 + E) if E >= 0 else 0.0,
            chi2=best.chi2, dof=self.dof, rms=linear, iterations=best.iterations,
            candidates_world=np.array([p.x[:3] for p in found if p.chi2 < best.chi2 + RIVAL_CHI2]),
        )  # fmt: skip
        if code == "ok":
            mean, cov_mean = state.mean_centre()
            added, added_contact = self.curvature(best)
            rms = statistics.rms(cov + added)
            if rms < self.model.rod.length * UNIFORM_STD:
                result = replace(result, p_surface_world=x[:3].copy(), cov_surface_world=cov + added, rms=rms,
                                 p_contact_world=mean, cov_contact_world=cov_mean + added_contact,
                                 **state.forces()._asdict())  # fmt: skip
            else:
                result = replace(result, result="unobservable" if self.moments_only else "too_light", rms=rms)
        if brief:
            return result
        # The bounds below are linear: the curvature is taken to scale with them.
        share = result.rms / linear if linear > 0.0 else 1.0
        result = replace(result, rms_without={of: share * state.rms(without(self.priors, of)) for of in GROUPS})
        gains = {of: share * rms for of, rms in state.gains().items()} if result.ok else {}
        return replace(result, rms_with=gains)

    def curvature(self, best: Solution) -> tuple[Array, Array]:
        """Return the curvature correction of the covariances of touched point and centreline [m²], (3, 3) each.

        The points that explain the readings lie on a curve x + a δ + b δ² + c δ³, far narrower than it is bowed. Its
        mean square about x, for a standard normal δ, is a aᵀ + 3 (a cᵀ + c aᵀ) + 3 b bᵀ + 15 c cᵀ. The fusion is solved
        again with the point constrained at δ = ±√3, where the misfit has risen by about three. One pose leaves the
        point as uncertain as a single reading does, and its curve is that of the single estimate.
        """
        if self.one_pose:
            return self._single_curvature()
        variances, axes = np.linalg.eigh(best.cov)
        added = np.zeros((3, 3))
        for variance, axis in zip(variances[:0:-1], axes.T[:0:-1], strict=True):
            std = math.sqrt(max(float(variance), 0.0))
            if not std > 0.0:
                continue
            a = best.cov @ axis / std
            aside = [
                (side, place.x[:3] - best.x[:3] - side * a)
                for side in (-NODE, NODE)
                if (place := self._constrained(best, axis, side * std)) is not None
            ]
            if not aside:
                continue
            # With one side alone the cubic term is taken for zero.
            b = sum((off for _, off in aside), np.zeros(3)) / (3.0 * len(aside))
            c = sum((side * off for side, off in aside), np.zeros(3)) / 18.0 if len(aside) == 2 else np.zeros(3)
            both = np.outer(a, c)
            added += 3.0 * (both + both.T) + 3.0 * TAIL * np.outer(b, b) + 15.0 * np.outer(c, c)
        return added, added

    def _constrained(self, best: Solution, axis: Array, way: float) -> Solution | None:
        """Return the solution with the point constrained at an offset along an axis: `way` [m], or further until the
        misfit has risen by three.
        """
        found, touches, pinned = None, best.touches, CONSTRAINT_STD * abs(way)
        for _ in range(MAX_EXTENSIONS):
            place = self.refine(touches, PointConstraint(axis, float(axis @ best.x[:3]) + way, pinned))
            if place is None:
                break
            found, touches = place, place.touches
            rise = max(place.chi2 - best.chi2, 0.25 * NODE**2)
            further = NODE / math.sqrt(rise)
            if further < 1.02:  # below, the step is too small to make the stated error jump between neighbouring places
                break
            way *= further
        return found

    def _single_curvature(self) -> tuple[Array, Array]:
        """Return the curvature correction of the single estimate from the mean reading of one pose [m²], (3, 3)
        each.
        """
        first = int(self.touched.argmax())
        sources, reading = self.sources[first], self.readings[first]
        wrenches = [r.wrench for r in self.readings if r.touched]
        covs = [r.cov for r in self.readings if r.touched]
        cov = np.mean(covs, axis=0) / len(covs)
        whiten = statistics.whiten(cov)
        hanging = self.model.mass * reading.gravity
        seen = Observation(np.mean(wrenches, axis=0), whiten, reading.gravity, hanging, math.inf)
        places = locate(Problem(sources, seen, self.model.friction, cov + sources.drift))
        R, none = reading.T_world_base[:3, :3], np.zeros((3, 3))
        if not places:
            return none, none
        best = places[0]
        added = (
            R @ (best.cov_surface_base - best.cov_linear_base) @ R.T,
            R @ (best.cov_contact_base - best.cov_linear_contact_base) @ R.T,
        )
        return added if all(np.isfinite(of).all() for of in added) else (none, none)

    def _code(self, found: list[Solution], rms: float) -> Result:
        best = found[0]
        std = np.array([math.sqrt(float(reading.cov[0, 0])) for reading in self.readings])
        code = result_of(best.chi2, self.dof, rms / self.model.rod.length, best.touches[self.touched],
                         std[self.touched], self.moments_only)  # fmt: skip
        if code != "ok":
            return code
        for rival in found[1:]:
            apart = float(np.linalg.norm(rival.x[:3] - best.x[:3]))
            spread = rms + statistics.rms(rival.cov)
            if rival.chi2 < best.chi2 + RIVAL_CHI2 and apart > 3.0 * spread:
                return "ambiguous"
        return "ok"


def _distinct(found: Iterable[Solution | None]) -> list[Solution]:
    """Return the distinct solutions, best first."""
    kept: list[Solution] = []
    for place in sorted((place for place in found if place is not None), key=lambda of: of.chi2):
        near = 0.1 * statistics.rms(place.cov) + 1e-6
        if all(np.linalg.norm(place.x[:3] - of.x[:3]) > near for of in kept):
            kept.append(place)
    return kept
