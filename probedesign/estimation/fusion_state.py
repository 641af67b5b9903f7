"""Linearised touches of one fixed point in the memory of the kernels: of a batch, and of a fusion that goes on.

A row of the memory is one reading or the mean of several. A batch fills as many rows as it has readings, `fusion.py`;
the recursive fusion keeps spare rows for readings to come, `tracker.py`.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import solve_triangular
from scipy.special import chdtrc

from probedesign.core import statistics
from probedesign.core.frames import Array, wrench_map
from probedesign.core.statistics import MISFIT_CHANCE, UNIFORM_STD, is_normal, max_chi2
from probedesign.core.units import MM
from probedesign.estimation import fusion_kernel, multistart
from probedesign.estimation.error_sources import ErrorSources
from probedesign.estimation.estimate import FusedEstimate, MomentsAbout, Result
from probedesign.estimation.model import ProbeModel, Tolerances
from probedesign.rod.kernels.surface_contact import (
    ALONG,
    AROUND,
    CENTRE,
    DEAD,
    NORMAL,
    OWN,
    POINT,
    ROWS,
    TOUCH,
    UNKNOWNS,
    S,
    work_size,
)  # fmt: skip

#: Of the common unknowns: the touched point at rest, and the compliance of the object, in units of its prior.
POINT_COLUMNS, COMPLIANCE = slice(-9, -6), -10

#: Mean and standard deviation of a half-normal prior, over its scale.
HALF_NORMAL = math.sqrt(2.0 / math.pi), math.sqrt(1.0 - 2.0 / math.pi)
#: Standard deviations, over that of the prior, of the part of the friction ratio that the touches of one object have in
#: common, and of the part of each alone. Assumed: they are of the same two materials and slip to the same side as the
#: base presses on, so that all of it may be common; they differ in how far each has slipped, half of the variance.
PRESSED_FRICTION = (1.0, math.sqrt(0.5))
SINGLE_FRICTION = (0.0, 1.0)  #: The same where all of it is drawn anew.
CREEP_SECONDS = 10.0  #: Time constant of the creep since the first contact [s]. Assumed: nothing is published.
#: Standard deviation of an object's step on each axis [m], if it moves between two touches. Assumed: a light object
#: that is pushed over its support.
OBJECT_STEP = 1e-3
MAX_STEP = 0.1  #: Of arclength over length, in one step.


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


def dof_of(model: ProbeModel, channels: Array, touched: NDArray[np.bool_]) -> int:
    """Return the degrees of freedom of a fusion: readings and friction priors, less the unknowns.

    Args:
        model: the probe.
        channels: that count, (m, 6).
        touched: which readings are of a contact, (k,).
    """
    free = 0 if math.isfinite(model.friction) else 2
    return max(len(touched) * len(channels) - free * int(touched.sum()) - 3, 1)


def creep_since(seconds: ArrayLike) -> Array:
    """Return the share of the creep that has happened some time after the first contact [s], 1 - exp(-t/τ)."""
    return np.asarray(-np.expm1(-np.maximum(seconds, 0.0) / CREEP_SECONDS))


class PointConstraint(NamedTuple):
    """A condition on the touched point X: axis · X = at, up to a standard deviation."""

    axis: Array  #: unit vector, (3,).
    at: float  #: at, std: [m].
    std: float


class _Scratch(NamedTuple):
    """Memory that the kernels work in."""

    sweep: Array
    block: Array
    solve: Array  #: the factor of the information and its scale stay at its front.
    mean: Array
    step: Array


class FusionState:
    """Readings of one point, their touches as linearised, and the solution of the unknowns that they have in common.

    Args:
        model, priors: the probe, and standard deviations of the error sources.
        channels: what of a wrench at the base counts, (m, 6): see `channels_of`.
        sources: the error sources at any pose.
        rows: the most readings.
        friction_parts: see `PRESSED_FRICTION`.
    """

    def __init__(self, model: ProbeModel, priors: Tolerances, channels: Array, sources: ErrorSources, rows: int,
                 friction_parts: tuple[float, float] = PRESSED_FRICTION) -> None:  # fmt: skip
        self.model, self.priors, self.channels, self.friction_parts = model, priors, channels, friction_parts
        self.causes, m, parameters = len(sources.names), len(channels), OWN + len(model.rod.s)
        width = fusion_kernel.columns(self.causes)
        # What was read, a row for each reading.
        self.sources = [sources] * rows
        self.wrench, self.pose, self.whiten = np.empty((rows, 6)), np.empty((rows, 4, 4)), np.empty((rows, m, m))
        self.touched, self.ramp = np.ones(rows, dtype=bool), np.ones(rows)
        #: Wrench (6,) and error columns (6, J) of the free probe at each row without contact.
        self.free: dict[int, tuple[Array, Array]] = {}
        # The touches, linearised and reduced by the unknowns of their own pose.
        self.touches = np.zeros((rows, TOUCH))
        self.lin, self.D = np.empty((rows, ROWS, 1 + UNKNOWNS + parameters)), np.empty((rows, 12, self.causes))
        self.local = np.empty((rows, fusion_kernel.LOCAL, fusion_kernel.LOCAL + width))
        self.reduced = np.zeros((rows, m, width))
        #: Compliance of the object [m/N]: where it is linearised, mean and standard deviation of its prior, (3,).
        self.compliance = np.array([*HALF_NORMAL[:1], *HALF_NORMAL]) * priors.object_compliance
        # The solution: rows in the order of time, variance of the step of bias and point before each, standard
        # deviation of the bias at the first, unknowns at the last row and at each, covariance of point, compliance and,
        # if it has a prior, the stiffness.
        self.order, self.walk, self.start = np.arange(rows), np.zeros((rows, 2)), 0.0
        #: Number of pins, which come last in the order; time before each row in the order, over `WALK_SECONDS`.
        self.pins, self.elapsed = 0, np.zeros(rows)
        self.x, self.common = np.empty(width - 1), np.empty((rows, width - 1))
        E = [sources.column("E")] if "E" in sources.names else []
        self._stated = np.r_[np.arange(width - 1)[POINT_COLUMNS], width - 1 + COMPLIANCE, E].astype(np.int64)
        self.cov = np.empty(2 * self._stated.shape)
        self._chain = np.empty((rows, fusion_kernel.WALKING, width))
        self._scatter, self._creep = sources.column("stiffness scatter"), sources.column("creep")
        #: Derivative of the channels by the bias in steps of the resolution, (m, 6).
        step = model.noise_base() * model.averaging_samples
        self.bias = np.ascontiguousarray(channels @ np.linalg.cholesky(step))
        self._work = _Scratch(
            np.empty(work_size(parameters)), np.empty((fusion_kernel.rows_of(m), fusion_kernel.LOCAL + width)),
            np.empty(max(fusion_kernel.solve_work(self.causes), 100)), np.empty(6 * width + 100), np.empty(60),
        )  # fmt: skip

    @property
    def readings(self) -> int:
        """Return the number of rows in the order that are readings."""
        return len(self.order) - self.pins

    def pin(self, constraint: PointConstraint) -> None:
        """Put a condition on the touched point into the last row, which counts as a reading after the last."""
        self.pins = 1
        self.touched[-1] = False
        self.reduced[-1, 0, :-1][POINT_COLUMNS] = constraint.axis / constraint.std
        self.reduced[-1, 0, -1] = constraint.at / constraint.std

    # One row ---------------------------------------------------------------------------------------------------------

    def linearise_row(self, row: int) -> bool:
        """Linearise the touch of a row; return whether it has a stable equilibrium."""
        return self.sources[row].linearise(self.touches[row], False, self._work.sweep, self.lin[row], self.D[row])

    def reduce_row(
        self,
        row: int,
        priors: Tolerances | None = None,
        D: Array | None = None,
        friction: float | None = None,
        friction_parts: tuple[float, float] | None = None,
    ) -> None:
        """Eliminate the own unknowns of a row, as it is linearised.

        Args:
            row: which.
            priors: standard deviations that the columns do not hold; those of the state if None.
            D: error columns, (12, J); those of the touch if None.
            friction: prior standard deviation of the friction ratio; that of the model if None.
            friction_parts: see `PRESSED_FRICTION`; those of the fusion if None.
        """
        if not self.touched[row]:
            free, columns = self.free[row]
            fusion_kernel.reduce_free(columns, free, self.wrench[row], self.channels, self.whiten[row], self.bias,
                                        self.reduced[row])  # fmt: skip
            return
        compliance = self.compliance
        if priors is not None and priors.object_compliance != self.priors.object_compliance:
            compliance = np.append(compliance[:2], HALF_NORMAL[1] * priors.object_compliance)
        fusion_kernel.reduce_keyframe(
            self.touches[row], self.lin[row], self.D[row] if D is None else D, self.wrench[row], self.pose[row],
            self.channels, self.whiten[row], self.bias, self.model.friction if friction is None else friction,
            *(self.friction_parts if friction_parts is None else friction_parts),
            self.model.mass * self.sources[row].gravity, compliance, (priors or self.priors).robot_mm * MM,
            self._scatter, self._creep, float(self.ramp[row]), self._work.block, self.local[row], self.reduced[row],
        )  # fmt: skip

    def move_row(self, row: int, share: float = 1.0, beyond: float = 0.0) -> float:
        """Move the touch of a row towards the solution.

        Args:
            row: which.
            share: of the step to go at most.
            beyond: how far beyond the end of the rod the errors may place a touch that stays there [m].

        Returns:
            The size of the whole step in standard deviations.
        """
        rod = self.model.rod
        return float(fusion_kernel.step_keyframe(
            self.touches[row], self.lin[row], self.local[row], self.common[row], share, MAX_STEP * rod.length,
            rod.flank_end, beyond, self._work.step,
        ))  # fmt: skip

    # All rows --------------------------------------------------------------------------------------------------------

    def linearise(self) -> bool:
        """Linearise all touches of a batch; return whether all have a stable equilibrium."""
        return all(self.linearise_row(row) for row in range(self.readings) if self.touched[row])

    def step(self, share: float, beyond: float = 0.0) -> float:
        """Call `move_row` for all touches of a batch, after `solved`; return the largest step."""
        return max(self.move_row(row, share, beyond) for row in range(self.readings) if self.touched[row])

    def solve(self, walk: Array, start: float) -> float:
        """Solve for the common unknowns at all rows in `order`, as reduced, and return the least misfit squared.

        Args:
            walk: variance of the bias's step before each row in `order` [steps²].
            start: standard deviation of the bias at the first one [steps].
        """
        self.walk, self.start = np.zeros((len(walk), 2)), start
        self.walk[:, 0] = walk
        if self.priors.object_walk_mm > 0.0:
            touched = self.touched[self.order]
            moves = touched & (np.cumsum(touched) > 1)  # the object may move from one touch to the next
            self.walk[moves, 1] = (self.priors.object_walk_mm * MM) ** 2
        chi2 = fusion_kernel.solve_reduced(self.reduced, self.order, self.walk, start, self._stated, self._chain,
                                           self._work.solve, self.x, self.cov)  # fmt: skip
        fusion_kernel.smooth(self._chain, self.order, self.walk, self.x, self.common, self._work.mean)
        return float(chi2)

    @property
    def object_compliance(self) -> float:
        """Return the compliance of the object, as solved [m/N], not below 0."""
        _linearised, mean, std = self.compliance
        return max(float(mean + std * self.x[COMPLIANCE]), 0.0)

    @property
    def point(self) -> Array:
        """Return the touched point at rest, as solved [m], (3,)."""
        return self.x[POINT_COLUMNS]

    def solved(
        self,
        priors: Tolerances | None = None,
        D: Array | None = None,
        friction: float | None = None,
        friction_parts: tuple[float, float] | None = None,
    ) -> tuple[float, Array, Array]:
        """Return the least misfit, the common unknowns and the covariance of the point at rest of a batch, for the
        touches as linearised.

        Args:
            priors: standard deviations that the columns do not hold, of bias, base at each pose and the object's
                compliance; those of the state if None.
            D: error columns, (k, 12, J); those of the touches if None.
            friction, friction_parts: as in `reduce_row`.
        """
        priors = priors or self.priors
        for row in range(self.readings):
            self.reduce_row(row, priors, None if D is None else D[row], friction, friction_parts)
        chi2 = self.solve(priors.walk_steps**2 * self.elapsed, priors.drift_steps)
        return chi2, self.x.copy(), self.cov[:3, :3].copy()

    def information(self, compliance: bool = False) -> tuple[Array, Array]:
        """Return the information matrix (n, n) and vector (n,) of touched point [m] and error sources, as solved.

        All other unknowns are marginalised; the unit priors of the error sources are part of the matrix.

        Args:
            compliance: whether that of the object is kept too, in the last column, with a unit prior.
        """
        n, (L, scale) = len(self.x), _factor(self._work.solve, len(self.x))
        kept = np.arange(n)[np.r_[POINT_COLUMNS, : self.causes, [COMPLIANCE] * compliance].astype(int)]
        rest = np.delete(np.arange(n), kept)
        root = scale[:, None] * L
        A = root @ root.T
        reduced = A[np.ix_(kept, kept)] - A[np.ix_(kept, rest)] @ np.linalg.solve(A[np.ix_(rest, rest)],
                                                                                  A[np.ix_(rest, kept)])  # fmt: skip
        return reduced, reduced @ self.x[kept]

    def cov_with_sources(self) -> Array:
        """Return the covariance of the point at rest [m] with the error sources and, in the last column, with the
        compliance of the object (unit priors), as solved, (3, J + 1)."""
        L, scale = _factor(self._work.solve, len(self.x))
        half = solve_triangular(L, np.diag(1.0 / scale), lower=True)
        return np.asarray(half[:, POINT_COLUMNS].T @ half[:, np.r_[: self.causes, COMPLIANCE]])

    def has_moved(self) -> bool:
        """Return whether the object has moved between the readings of a batch.

        The alternative, for each touch after the first, is a step d ~ N(0, `OBJECT_STEP`²) of the touched point before
        it. The step is one more common unknown, with which the misfit falls by Δ = Σ wᵢ ξᵢ². The wᵢ are the
        eigenvalues of I - V, where V is the posterior covariance of d/`OBJECT_STEP`; the ξᵢ are standard normal if
        nothing moved. Δ is compared with the multiple of χ² that has its mean and variance (Satterthwaite), at
        `MISFIT_CHANCE` over the number of alternatives (Bonferroni). Friction counts as drawn at each touch for itself:
        a step must not be what friction that changes from touch to touch explains as well.
        """
        fixed = self.solved(friction_parts=SINGLE_FRICTION)[0]
        later = np.flatnonzero(self.touched)[1:]
        for first in later:
            chi2, weights = self.with_step(int(first))
            mean, square = weights.sum(), (weights**2).sum()
            fall = max(fixed - chi2, 0.0)
            if chdtrc(mean**2 / square, fall * mean / square) < MISFIT_CHANCE / len(later):
                return True
        return False

    def with_step(self, first: int) -> tuple[float, Array]:
        """Return the least misfit if the object moves just before a reading, and the weights wᵢ of `has_moved`, (3,).

        Args:
            first: the first reading after the step. The readings are reduced as `solved` left them.
        """
        rows, m, width = self.reduced.shape
        wide = np.zeros((rows, m, width + 3))
        wide[:, :, 3:] = self.reduced
        wide[first : self.readings, :, :3] = (
            OBJECT_STEP * self.reduced[first : self.readings, :, :-1][..., POINT_COLUMNS]
        )
        chain = np.empty((rows, fusion_kernel.WALKING, width + 3))
        work, n = np.empty(fusion_kernel.solve_work(self.causes + 3)), width + 2
        chi2 = fusion_kernel.solve_reduced(wide, self.order, self.walk, self.start, self._stated + 3, chain, work,
                                           np.empty(n), np.empty_like(self.cov))  # fmt: skip
        L, scale = _factor(work, n)
        half = solve_triangular(L, np.diag(1.0 / scale)[:, :3], lower=True)
        # All are zero where the step is unobservable.
        return float(chi2), np.maximum(1.0 - np.linalg.eigvalsh(half.T @ half), 1e-12)

    # The result ------------------------------------------------------------------------------------------------------

    def result(self, chi2: float, rms: float, force_std: Array) -> Result:
        """Return the result code of the touched point without rivals.

        Args:
            chi2: misfit squared; rms: of the point [m].
            force_std: standard deviation of a force axis by the noise of each touch in the order of time [N], (k,).
        """
        rows = self.order[self.touched[self.order]]
        pulls = (self.touches[rows, NORMAL] < -3.0 * force_std).any()  # by more than noise explains
        if chi2 > max_chi2(self.dof, MISFIT_CHANCE) or pulls:
            return "inconsistent"
        if len(rows) == 1 and not self.moments_only:  # as of one reading
            drift = self.priors.drift_steps * self.model.noise.force * math.sqrt(self.model.averaging_samples)
            touch = self.touches[rows[0]]
            share = math.hypot(force_std[0], drift) / max(float(np.linalg.norm(touch[DEAD : DEAD + 3])), 1e-300)
            if not is_normal(share, float(touch[S]), rms):
                return self.uncertain
        return "ok" if rms < self.model.rod.length * UNIFORM_STD else self.uncertain

    @property
    def moments_only(self) -> bool:
        """Return whether only the moments count."""
        return len(self.channels) == 3

    @property
    def uncertain(self) -> Result:
        """Return the result code of a point that is no better known than without a reading."""
        return "unobservable" if self.moments_only else "too_light"

    @property
    def dof(self) -> int:
        """Return the degrees of freedom of the misfit."""
        return dof_of(self.model, self.channels, self.touched[self.order[: self.readings]])

    def estimate(self, result: Result, chi2: float, rms: float, iterations: int, candidates: Array) -> FusedEstimate:
        """Return the estimate as solved; with any result but "ok" without the point.

        Args:
            result: its code; chi2: misfit squared; rms: of the point [m].
            iterations: of Gauss-Newton; candidates: points that explain the readings about as well [m], (j, 3).
        """
        stiffness, std, column = 1.0, 0.0, self.sources[0].column("E")
        if column >= 0:
            scale = self.priors.youngs_modulus
            stiffness, std = math.exp(scale * float(self.x[column])), scale * math.sqrt(self.cov[4, 4])
        stated: dict[str, Any] = {
            "stiffness": stiffness, "std_stiffness": stiffness * std, "chi2": chi2, "dof": self.dof, "rms": rms,
            "iterations": iterations, "candidates_world": candidates,
        }  # fmt: skip
        if result != "ok":
            return FusedEstimate(result, **stated)
        points, covs = self.points()
        rows = self.order[: self.readings]
        touches, free, s = self.touches[rows], ~self.touched[rows], np.empty(len(rows))
        multistart.contact_arclengths(self.model.rod.body, touches, s)
        force, normal = touches[:, DEAD : DEAD + 3], touches[:, NORMAL]
        tangential = normal * np.hypot(touches[:, AROUND], touches[:, ALONG])
        force[free] = 0.0
        for column_of_free in (s, normal, tangential):
            column_of_free[free] = np.nan
        compliance = self.object_compliance
        half = statistics.sigmas_95(1) * float(self.compliance[2]) * math.sqrt(self.cov[3, 3])
        interval = np.maximum([compliance - half, compliance + half], 0.0)
        return FusedEstimate(
            "ok", points[0], covs[0], points[1], covs[1], points[2], covs[2], compliance, interval, s, force,
            normal, tangential, **stated,
        )  # fmt: skip

    def points(self) -> tuple[Array, Array]:
        """Return the touched point at rest and now, and the centreline point now, in the world [m], (3, 3), and the
        covariance of each [m²], (3, 3, 3), as solved."""
        points, covs = np.empty((3, 3)), np.empty((3, 3, 3))
        points[0], covs[0] = self.point, self.cov[:3, :3]
        for k, first in enumerate((POINT, CENTRE), start=1):
            fusion_kernel.last_point(
                self.lin, self.D, self.local, self.pose, self.order, self.touched, self.walk, self._chain, self.common,
                self._scatter, self._creep, self.ramp, first, self._work.mean, self._work.solve, points[k], covs[k],
            )  # fmt: skip
        return points, covs

    @property
    def log_volume(self) -> float:
        """Return the logarithm of the volume of the likely unknowns, up to a constant: -½ log det of the information
        on all of them, as solved."""
        L, scale = _factor(self._work.solve, len(self.x))
        rows = self.order[self.touched[self.order]]
        pivots = np.diagonal(self.local[rows][:, :, : fusion_kernel.LOCAL], axis1=1, axis2=2)
        return -float(np.log(np.abs(pivots)).sum() + np.log(scale * L.diagonal()).sum())


def _factor(memory: Array, n: int) -> tuple[Array, Array]:
    return np.tril(memory[: n * n].reshape(n, n)), memory[n * n : n * n + n]
