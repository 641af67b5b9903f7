"""Readings of one fixed point, touched from several poses of the base, fused by Gauss-Newton.

Pressing on by a known motion of the base measures the compliance at the contact, which locates it without any reading
of the force. What is minimised is written down in `fusion_kernel.py`; a single touch is the fusion of one pose, and a
tracked touch (`tracker.py`) the fusion of its keyframes as they come.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline

from probedesign.core import statistics
from probedesign.core.frames import Array
from probedesign.core.statistics import MISFIT_CHANCE, RIVAL_CHI2, UNIFORM_STD, max_chi2
from probedesign.estimation.error_sources import ErrorSources, across
from probedesign.estimation.estimate import Candidate, FusedEstimate, Result
from probedesign.estimation.force_moment import Problem, closest_approaches, equal_moments
from probedesign.estimation.fusion_state import (
    PRESSED_FRICTION,
    SINGLE_FRICTION,
    FusionState,
    PointConstraint,
    creep_since,
    dof_of,
)
from probedesign.estimation.likelihood import locate
from probedesign.estimation.model import WALK_SECONDS, Observation, ProbeModel, Tolerances
from probedesign.estimation.uncertainty_kernel import NODE, TAIL
from probedesign.rod.kernels.surface_contact import TOUCH

NEAR = 1e-9  #: Poses whose numbers differ by no more, in metres too, are one.
STARTS = 3  #: Closest approaches of the curves that a fusion starts from.
ANYWHERE = (4, 10, 16, 22)  #: Stations to start from where no closest approach leads to a solution.
MAX_ITERATIONS = 40
CLOSE = 1e-3  #: Step of the touched point, in standard deviations, at which the iterations end.
#: Step of a pose's own unknowns, in standard deviations given the point, at which they end too; it is taken.
SETTLED_STEP = 0.03
#: How far beyond the end of the rod a touch of the tip may lie, in standard deviations of its point.
PAST_END = 3.0
#: Standard deviation, over that of the free point, to which `Fusion.curvature` constrains the point.
CONSTRAINT_STD = 1e-3
#: Extensions of the offset at which the point is constrained, until the misfit has risen by about three.
MAX_EXTENSIONS = 3
#: Steps of a standard deviation of the object's compliance to either side of the best one, at most, and the fall of the
#: logarithm of its weight beyond which it is negligible; number of values at which it is interpolated.
MAX_COMPLIANCE_STEPS, NEGLIGIBLE, DENSE = 8, 5.0, 161
WIDE = 0.03  #: RMS error over the length from which a second branch of the likely points is searched.
NEAR_BRANCH = 2e-3  #: Distance of two points [m] below which two branches that meet are one.


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

    #: the touched point at rest and at the last touch, and the centreline point there [m], (3, 3), with the covariance
    #: of each [m²], (3, 3, 3).
    points: Array
    covs: Array
    chi2: float  #: misfit, priors included.
    touches: Array  #: at every pose, (k, TOUCH); undefined for free poses.
    iterations: int  #: how many.
    compliance: float  #: compliance, std_compliance: of the object [m/N]; a standard deviation of 0 if it is given.
    std_compliance: float
    log_volume: float  #: see `FusionState.log_volume`.

    @property
    def x(self) -> Array:
        """Return the touched point at rest [m], (3,)."""
        return np.asarray(self.points[0])

    @property
    def cov(self) -> Array:
        """Return its covariance [m²], (3, 3)."""
        return np.asarray(self.covs[0])


class Posterior(NamedTuple):
    """Moments of the points of a `Solution` over the compliance of the object."""

    points: Array  #: points, covs: as in `Solution`.
    covs: Array
    chi2: float  #: least misfit, with the half-normal prior of the compliance.
    compliance: float  #: mean [m/N], and an interval of 95 %, (2,).
    interval: Array

    @property
    def fields(self) -> dict[str, Any]:
        """Return the moments by the names of `FusedEstimate`."""
        names = ("surface_world", "surface_now_world", "contact_world")
        values = {f"p_{name}": p for name, p in zip(names, self.points, strict=True)}
        values |= {f"cov_{name}": cov for name, cov in zip(names, self.covs, strict=True)}
        return values | {"object_compliance": self.compliance, "object_compliance_interval_95": self.interval}


@dataclass(frozen=True)
class Fusion:
    """Readings to be fused."""

    model: ProbeModel  #: the probe.
    readings: tuple[Reading, ...]  #: in the order of time.
    priors: Tolerances  #: standard deviations of the error sources.
    channels: Array  #: what of a wrench at the base counts, (m, 6): see `channels_of`.
    gravity_world: Array  #: gravity in the world [m/s²], (3,).
    friction_parts: tuple[float, float] = PRESSED_FRICTION  #: see there; a single pose has `SINGLE_FRICTION`.

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

    # What the kernels need -------------------------------------------------------------------------------------------

    @cached_property
    def sources(self) -> tuple[ErrorSources, ...]:
        """Return the error sources at every pose; the sensor was tared at the first reading."""
        axes = across(self.gravity_world)
        tared: ErrorSources | None = None
        by_rotation: dict[bytes, ErrorSources] = {}
        rotations = [np.ascontiguousarray(reading.T_world_base[:3, :3]) for reading in self.readings]
        for reading, R in zip(self.readings, rotations, strict=True):
            if R.tobytes() not in by_rotation:
                free = self.model.rod.solve(reading.gravity)
                sources = ErrorSources.of(self.model, self.priors, reading.gravity, free, tared, axes @ R, posed=True)
                by_rotation[R.tobytes()], tared = sources, tared or sources
        return tuple(by_rotation[R.tobytes()] for R in rotations)

    @cached_property
    def whitening(self) -> Array:
        """Return the whitening matrix of each reading, lower triangular, (k, m, m)."""
        return statistics.whiten(np.array([self.channels @ reading.cov @ self.channels.T for reading in self.readings]))

    @cached_property
    def free(self) -> dict[int, tuple[Array, Array]]:
        """Return wrench (6,) and error columns (6, J) of the free probe for each reading without contact."""
        equilibria = {k: self.model.rod.solve(reading.gravity)
                      for k, reading in enumerate(self.readings) if not reading.touched}  # fmt: skip
        return {k: (eq.wrench_base, np.ascontiguousarray(self.sources[k].free_columns(eq)))
                for k, eq in equilibria.items()}  # fmt: skip

    @cached_property
    def elapsed(self) -> Array:
        """Return the time before each reading, over `WALK_SECONDS`, (k,)."""
        times = [reading.time for reading in self.readings]
        if any(time is None for time in times):
            return np.append(0.0, np.ones(len(times) - 1))
        seconds = np.diff(np.array(times, dtype=float), prepend=float(times[0] or 0.0))
        return np.asarray(np.maximum(seconds, 0.0) / WALK_SECONDS)

    def state(self, touches: Array, constraint: PointConstraint | None = None, compliance: float | None = None
              ) -> FusionState:  # fmt: skip
        """Return the readings in the memory of the kernels, with touches to be linearised, (k, TOUCH).

        Creep begins at the first touch; a single one has all of it.

        Args:
            touches: (k, TOUCH).
            constraint: on the touched point.
            compliance: of the object, if it is given [m/N]; None: it has the prior.
        """
        k, pinned = len(self.readings), constraint is not None
        parts = SINGLE_FRICTION if self.one_pose else self.friction_parts
        state = FusionState(self.model, self.priors, self.channels, self.sources[0], k + pinned, parts)
        state.sources[:k], state.free = self.sources, self.free
        state.wrench[:k] = [reading.wrench for reading in self.readings]
        state.pose[:k] = [reading.T_world_base for reading in self.readings]
        state.whiten[:k], state.touched[:k], state.touches[:k] = self.whitening, self.touched, touches
        time = WALK_SECONDS * np.cumsum(self.elapsed)
        state.ramp[:k] = 1.0 if self.one_pose else creep_since(time - time[int(self.touched.argmax())])
        state.elapsed[:k] = self.elapsed
        if compliance is not None:
            state.compliance[:] = compliance, compliance, 0.0
        if constraint is not None:
            state.pin(constraint)
        return state

    # Solving ---------------------------------------------------------------------------------------------------------

    def solve(self) -> FusedEstimate:
        """Return the fused estimate; see `Estimator.fuse`."""
        solutions = self.solutions()
        return solutions if isinstance(solutions, FusedEstimate) else self.answer(solutions)

    def solutions(self) -> list[Solution] | FusedEstimate:
        """Return every solution, best first, or the result that explains why there is none."""
        if not self.touched.any() or (self.moments_only and self.one_pose):
            return FusedEstimate("unobservable")
        solutions: list[Solution] = []
        limit = max_chi2(dof_of(self.model, self.channels, self.touched), MISFIT_CHANCE)
        for starts in self._starts():
            solutions = _distinct([*solutions, *(self.refine(start) for start in starts)])
            if any(solution.chi2 <= limit for solution in solutions):
                break
        return solutions or FusedEstimate("not_converged")

    def _starts(self) -> Iterable[list[Array]]:
        """Yield lists of initial touches, (k, TOUCH) each, the most likely first: from the single readings, from the
        closest approaches of the curves of equal moment, and from places along the probe.
        """
        k = len(self.readings)
        singles = [] if self.moments_only else self._from_single_readings()
        if k == 1 or self.one_pose:
            yield singles
            return
        curves = [
            equal_moments(self.model.rod, r.gravity, r.wrench[3:6], r.T_world_base) for r in self.readings if r.touched
        ]

        def at(stations: tuple[int, ...]) -> list[Array]:
            touches = [curve.touches[j] for curve, j in zip(curves, stations, strict=True)]
            if any(touch is None for touch in touches):
                return []
            start = np.zeros((k, TOUCH))
            start[self.touched] = np.array(touches)
            return [start]

        yield [*(start for stations in closest_approaches(curves)[:STARTS] for start in at(stations)), *singles]
        if self.moments_only:
            yield self._from_single_readings()
        yield [start for j in ANYWHERE for start in at((j,) * len(curves))]

    def _from_single_readings(self) -> list[Array]:
        """Return the touches estimated from each reading alone; an empty list if one has none."""
        start = np.zeros((len(self.readings), TOUCH))
        for k, reading in enumerate(self.readings):
            if not reading.touched:
                continue
            candidates = self._from_one(k, reading.wrench, reading.cov)
            if not candidates or candidates[0].touch is None:
                return []
            start[k] = candidates[0].touch
        return [start]

    def _from_one(self, k: int, wrench: Array, cov: Array) -> list[Candidate]:
        sources, gravity = self.sources[k], self.readings[k].gravity
        seen = Observation(wrench, statistics.whiten(cov), gravity, self.model.mass * gravity, math.inf)
        return locate(Problem(sources, seen, self.model.friction, cov + sources.drift))

    def refine(self, start: Array, pin: PointConstraint | None = None, compliance: float | None = None
               ) -> Solution | None:  # fmt: skip
        """Run Gauss-Newton from one initial guess of the touches, (k, TOUCH); return None if it does not converge.

        Args:
            start, pin, compliance: as in `state`.
        """
        state = self.state(start, pin, compliance)
        damping, point, last_step = 1.0, None, np.zeros(3)
        for iteration in range(MAX_ITERATIONS):
            if not state.linearise():
                return None
            chi2, _x, cov = state.solved()
            if not math.isfinite(chi2):
                return None
            step = state.point - (state.point if point is None else point)
            # Where the model fits badly whole steps go to and fro about the least misfit.
            back = float(step @ last_step) < -0.25 * float(last_step @ last_step)
            damping = max(0.5 * damping, 0.1) if back else min(2.0 * damping, 1.0)
            last_step, point, linearised = step, state.point.copy(), state.touches[: len(start)].copy()
            size = state.step(damping, beyond=PAST_END * statistics.rms(cov))
            state.compliance[0] = state.object_compliance
            near = float(np.abs(step).max()) <= CLOSE * statistics.rms(cov) + 1e-9
            if near and size <= SETTLED_STEP * math.sqrt(1.0 + chi2):
                return Solution(*state.points(), chi2, linearised, iteration + 1, state.object_compliance,
                                float(state.compliance[2]) * math.sqrt(state.cov[3, 3]), state.log_volume)  # fmt: skip
        return None

    # The result ------------------------------------------------------------------------------------------------------

    def answer(self, solutions: list[Solution]) -> FusedEstimate:
        """Return the best of all solutions, which come best first, with its result code."""
        best = solutions[0]
        state, linear = self.state(best.touches), statistics.rms(best.cov)
        if not state.linearise():
            return FusedEstimate("not_converged")
        result: Result = "inconsistent" if state.has_moved() else self._result(solutions, state)
        state.solved()
        posterior = self.over_compliance(best) if result == "ok" else None
        rms = linear if posterior is None else statistics.rms(posterior.covs[0])
        if result == "ok" and not rms < self.model.rod.length * UNIFORM_STD:
            result = state.uncertain
        candidates = np.array([rival.x for rival in solutions if rival.chi2 < best.chi2 + RIVAL_CHI2])
        estimate = state.estimate(result, best.chi2, rms, best.iterations, candidates)
        if posterior is not None and estimate.ok:
            return replace(estimate, **posterior.fields, chi2=posterior.chi2)
        return estimate

    def over_compliance(self, best: Solution) -> Posterior:
        """Return the moments of the points over the compliance c of the object, with their curvature.

        For every c the other unknowns have a normal posterior, solved for anew; with the half-normal prior of scale σ
        the weight of c is exp(-χ²(c)/2 - c²/(2 σ²)) times the volume of that posterior. It is evaluated in steps of the
        standard deviation of c until the weight is negligible, and interpolated.

        Args:
            best: the solution with a normal prior of the same mean and variance.
        """
        scale = self.priors.object_compliance
        branches = [self._branch(best, best.compliance, best.std_compliance)] if scale > 0.0 else [[]]
        if len(branches[0]) < 2:  # the object is rigid, or no other compliance has an equilibrium
            return Posterior(best.points, best.covs + self.curvature(best, best.compliance), best.chi2, best.compliance,
                             np.full(2, best.compliance))  # fmt: skip
        weight, c, points, covs = _interpolated(branches)
        cov, mean, compliance = _moments(weight, c, points, covs)
        first = branches[0][0]
        if first.compliance > 0.0 and statistics.rms(cov[0]) > WIDE * self.model.rod.length:
            # Where the probe is about as compliant as the object, the likely points may have a second branch.
            starts = (self.refine(start, compliance=0.0) for group in self._starts() for start in group)
            stiff = next((solution for solution in starts if solution is not None), None)
            other = [] if stiff is None else self._branch(stiff, 0.0, 0.25 * scale, first)
            if len(other) > 1:
                branches.append(other)
                weight, c, points, covs = _interpolated(branches)
                cov, mean, compliance = _moments(weight, c, points, covs)
        nodes = max(branches, key=lambda branch: max(node.log_weight for node in branch))
        nearest = min(nodes, key=lambda node: abs(node.compliance - compliance))
        added = self.curvature(nearest.solution, nearest.compliance)
        # The interval is one-sided, from 0, unless the readings alone reject a rigid object. The shortest would leave
        # 0 out too often: the place follows M/F, and a force that is read as too large makes the object look soft.
        misfits = {node.compliance: node.solution.chi2 for branch in branches for node in branch}
        rigid = misfits.get(0.0, math.inf) - min(misfits.values()) < max_chi2(1, 0.1)
        order = np.argsort(c)
        interval = np.interp([0.0, 0.95] if rigid else [0.025, 0.975], np.cumsum(weight[order]), c[order])
        chi2 = min(node.chi2 for node in nodes)
        return Posterior(mean, cov + added, chi2, compliance, interval)

    def _branch(self, start: Solution, centre: float, step: float, met: "_Node | None" = None) -> list["_Node"]:
        """Return solutions with given compliances of the object, in ascending order, until their weight is negligible.

        Args:
            start: a solution near the first one.
            centre: compliance of the first one [m/N].
            step: from one compliance to the next [m/N].
            met: a solution at which another branch begins: if this one leads to it, it is the same; None: none.

        Returns:
            The solutions; an empty list if there is none, or if the branch is another one's.
        """

        def solved(compliance: float, touches: Array) -> _Node | None:
            solution, prior = self.refine(touches, compliance=compliance), compliance / self.priors.object_compliance
            return solution and _Node(solution, compliance, solution.chi2 + prior**2)

        middle = solved(centre, start.touches)
        if middle is None:
            return []
        nodes, likely = [middle], middle.log_weight
        for side in (-1.0, 1.0):
            last, change, slope = middle, step, np.zeros_like(start.touches)
            for _ in range(MAX_COMPLIANCE_STEPS):
                compliance = max(last.compliance + side * change, 0.0)
                if met is not None and compliance > met.compliance >= last.compliance:
                    there = solved(met.compliance, last.solution.touches)
                    if there is not None and float(np.linalg.norm(there.solution.x - met.solution.x)) < NEAR_BRANCH:
                        return []
                further = compliance - last.compliance
                following = solved(compliance, last.solution.touches + further * slope) if further != 0.0 else None
                if following is None:  # no such contact of the probe; the last one may be nearer
                    change *= 0.5
                    if compliance == 0.0 or change < 0.2 * step:
                        break
                    continue
                slope = (following.solution.touches - last.solution.touches) / further
                last = following
                nodes.append(following)
                likely = max(likely, following.log_weight)
                if following.log_weight < likely - NEGLIGIBLE:
                    break
        return sorted(nodes, key=lambda node: node.compliance)

    def curvature(self, best: Solution, compliance: float) -> Array:
        """Return the curvature correction of the covariances of a solution with a given compliance [m/N] of the object:
        of the touched point at rest and now and of the centreline point [m²], (3, 3, 3).

        The points that explain the readings lie on a curve x + a δ + b δ² + c δ³, far narrower than it is bowed. Its
        mean square about x, for a standard normal δ, is a aᵀ + 3 (a cᵀ + c aᵀ) + 3 b bᵀ + 15 c cᵀ; the bows of two
        directions, b₁ δ₁² + b₂ δ₂², have b₁ b₂ᵀ + b₂ b₁ᵀ more. The fusion is solved again with the point constrained at
        δ = ±√3, where the misfit has risen by about three. One pose leaves the point as uncertain as a single reading
        does, and its curve is that of the single estimate.
        """
        if self.one_pose:
            surface, centre = self._single_curvature()
            return np.array([surface, surface, centre])
        variances, axes = np.linalg.eigh(best.cov)
        added, bowed = np.zeros((3, 3)), np.zeros(3)
        for variance, axis in zip(variances[:0:-1], axes.T[:0:-1], strict=True):
            std = math.sqrt(max(float(variance), 0.0))
            if not std > 0.0:
                continue
            a = best.cov @ axis / std
            bows = [
                (side, solution.x - best.x - side * a)
                for side in (-NODE, NODE)
                if (solution := self._constrained(best, axis, side * std, compliance)) is not None
            ]
            if not bows:
                continue
            # With one side alone the cubic term is taken for zero.
            b = np.sum([bow for _, bow in bows], axis=0) / (3.0 * len(bows))
            ac = np.outer(a, c := np.sum([side * bow for side, bow in bows], axis=0) / 18.0 * (len(bows) == 2))
            added += 3.0 * (ac + ac.T) + 2.0 * TAIL * np.outer(b, b) + 15.0 * np.outer(c, c)
            bowed += b
        return np.array(3 * [added + TAIL * np.outer(bowed, bowed)])

    def _constrained(self, best: Solution, axis: Array, offset: float, compliance: float) -> Solution | None:
        """Return the solution with the point constrained at an offset along an axis [m], or further until the misfit
        has risen by three.
        """
        furthest, touches, std = None, best.touches, CONSTRAINT_STD * abs(offset)
        for _ in range(MAX_EXTENSIONS):
            solution = self.refine(touches, PointConstraint(axis, float(axis @ best.x) + offset, std), compliance)
            if solution is None:
                break
            furthest, touches = solution, solution.touches
            factor = NODE / math.sqrt(max(solution.chi2 - best.chi2, 0.25 * NODE**2))
            if factor < 1.02:  # below, the step is too small to make the stated error jump between neighbouring places
                break
            offset *= factor
        return furthest

    def _single_curvature(self) -> tuple[Array, Array]:
        """Return the curvature correction of the single estimate from the mean reading of one pose [m²], (3, 3)
        each.
        """
        touched = [reading for reading in self.readings if reading.touched]
        wrench = np.mean([reading.wrench for reading in touched], axis=0)
        cov = np.mean([reading.cov for reading in touched], axis=0) / len(touched)
        candidates = self._from_one(int(self.touched.argmax()), wrench, cov)
        R, none = touched[0].T_world_base[:3, :3], np.zeros((3, 3))
        if not candidates:
            return none, none
        best = candidates[0]
        added = (
            R @ (best.cov_surface_base - best.cov_linear_base) @ R.T,
            R @ (best.cov_contact_base - best.cov_linear_contact_base) @ R.T,
        )
        return added if all(np.isfinite(cov).all() for cov in added) else (none, none)

    def _result(self, solutions: list[Solution], state: FusionState) -> Result:
        best, rms = solutions[0], statistics.rms(solutions[0].cov)
        std = np.array([math.sqrt(float(reading.cov[0, 0])) for reading in self.readings])
        result = state.result(best.chi2, rms, std[self.touched])
        for rival in solutions[1:] if result == "ok" else []:
            apart = float(np.linalg.norm(rival.x - best.x))
            if rival.chi2 < best.chi2 + RIVAL_CHI2 and apart > 3.0 * (rms + statistics.rms(rival.cov)):
                return "ambiguous"
        return result


class _Node(NamedTuple):
    """A solution with a given compliance of the object [m/N], and its misfit with the prior on the compliance."""

    solution: Solution
    compliance: float
    chi2: float

    @property
    def log_weight(self) -> float:
        """Return the logarithm of its weight in the posterior, up to a constant."""
        return self.solution.log_volume - 0.5 * self.chi2


def _interpolated(branches: Sequence[Sequence[_Node]]) -> tuple[Array, Array, Array, Array]:
    """Return weight (n,), compliance (n,) [m/N], points (n, 3, 3) and covariances (n, 3, 3, 3) along all branches."""
    logs, c, steps, values = [], [], [], []
    for nodes in branches:
        known = np.array([node.compliance for node in nodes])
        rows = np.array([np.concatenate([[node.log_weight], node.solution.points.ravel(), node.solution.covs.ravel()])
                         for node in nodes])  # fmt: skip
        dense = np.linspace(known[0], known[-1], DENSE)
        row = make_interp_spline(known, rows, k=min(3, len(known) - 1))(dense)
        step = np.full(DENSE, dense[1] - dense[0])
        step[[0, -1]] *= 0.5
        logs.append(row[:, 0])
        c.append(dense)
        steps.append(step)
        values.append(row[:, 1:])
    log, value = np.concatenate(logs), np.concatenate(values)
    weight = np.concatenate(steps) * np.exp(log - log.max())
    return (weight / weight.sum(), np.concatenate(c), value[:, :9].reshape(-1, 3, 3),
            value[:, 9:].reshape(-1, 3, 3, 3))  # fmt: skip


def _moments(weight: Array, c: Array, points: Array, covs: Array) -> tuple[Array, Array, float]:
    """Return covariance (3, 3, 3) and mean (3, 3) of the points, and the mean compliance [m/N], of `_interpolated`.

    A likely point is off the mean by e(c) and by a normal share of the widest direction that it has for this c. What of
    both is not linear in the place along the principal axis bows, and counts by `TAIL` as in `Fusion.curvature`.
    """
    mean = np.tensordot(weight, points, 1)
    error = points - mean
    cov = np.tensordot(weight, covs, 1) + np.einsum("w,wpi,wpj->pij", weight, error, error)
    variances, axes = np.linalg.eigh(covs)
    off = np.stack([error, np.sqrt(np.maximum(variances[..., -1:], 0.0)) * axes[..., -1]])
    place = np.einsum("ewpi,pi->ewp", off, np.linalg.eigh(cov)[1][..., -1])
    line = np.einsum("w,ewp,ewpi->pi", weight, place, off) / np.einsum("w,ewp->p", weight, place**2)[:, None]
    bow = off - place[..., None] * line
    cov += (TAIL - 1.0) * np.einsum("w,ewpi,ewpj->pij", weight, bow, bow)
    return cov, mean, float(weight @ c)


def _distinct(solutions: Iterable[Solution | None]) -> list[Solution]:
    kept: list[Solution] = []
    for solution in sorted((solution for solution in solutions if solution is not None), key=lambda other: other.chi2):
        near = 0.1 * statistics.rms(solution.cov) + 1e-6
        if all(np.linalg.norm(solution.x - other.x) > near for other in kept):
            kept.append(solution)
    return kept
