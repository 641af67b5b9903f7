"""State of a fusion: its linearised touches, information matrix and derived quantities."""

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.linalg import solve_triangular
from scipy.special import chdtrc

from probedesign.core import statistics
from probedesign.core.frames import Array
from probedesign.core.statistics import MISFIT_CHANCE, UNIFORM_STD, max_chi2
from probedesign.core.units import MM
from probedesign.estimation import fusion_kernel, keyframe_kernel, multistart
from probedesign.estimation.error_sources import FINE, ErrorSources
from probedesign.estimation.estimate import Result
from probedesign.estimation.tolerances import Tolerances
from probedesign.rod.kernels.surface_contact import (
    ALONG,
    AROUND,
    DEAD,
    NORMAL,
    OWN,
    PHI,
    POINT,
    ROWS,
    TIP,
    UNKNOWNS,
    VALUE,
    work_size,
)

if TYPE_CHECKING:
    from probedesign.estimation.fusion import Fusion, Reading


class PointConstraint(NamedTuple):
    """A condition on the touched point X: axis · X = at, up to a standard deviation."""

    axis: Array  #: unit vector, (3,).
    at: float  #: at, std: [m].
    std: float


FIRST_CURVATURE = 16.0
"""Readings of a keyframe after which the curvature is evaluated; then after four times as many."""
MAX_COUNT = 1e9
"""Readings after which a mean follows like a low-pass filter."""


@dataclass
class Keyframe:
    """Mean of the readings of one pose, in a slot of the memory of a recursive fusion, with its linearised touch."""

    slot: int  #: row of the memory, in which T, touch, lin, D, local, reduced and x lie.
    wrench: Array  #: wrench, T, time: means.
    T: Array
    time: float
    sources: ErrorSources  #: error sources under its gravity.
    touch: Array
    lin: Array
    D: Array
    local: Array
    reduced: Array
    x: Array
    began: float  #: began, span: time of the first reading, and from it to the last one [s].
    count: float = 1.0  #: number of readings.
    span: float = 0.0
    due: float = FIRST_CURVATURE  #: count at which the curvature is evaluated again.
    known: bool = False  #: whether it has been linearised.

    def take_in(self, wrench: Array, T: Array, time: float) -> None:
        """Take in one more reading of this pose; wrench, place and time are means."""
        self.count = min(self.count + 1.0, MAX_COUNT)
        self.wrench += (wrench - self.wrench) / self.count
        self.T[:3, 3] += (T[:3, 3] - self.T[:3, 3]) / self.count
        self.time += (time - self.time) / self.count
        self.span = time - self.began

    def weight(self, rate: float) -> float:
        """Return the effective number of samples of the mean for a bias with a random walk.

        The mean over T seconds has the variance `rate` T/12 about the bias at its middle.

        Args:
            rate: variance of the walk, in steps² a second; a sample has a variance of one step².
        """
        return 1.0 / (1.0 / self.count + rate * self.span / 12.0)


class Forces(NamedTuple):
    """Touches pose by pose; NaN where free, but for the force, which is zero there."""

    s_contact: Array  #: arclength of the contact [m], (k,).
    force_base: Array  #: on the probe [N], (k, 3).
    force_normal: Array  #: force_normal, force_tangential: of it [N], (k,).
    force_tangential: Array


OBJECT_STEP = 1e-3
"""Standard deviation of an object's step on each axis [m], if it moves between two touches. Assumed: a light object
that is pushed over its support."""
GROUPS = ("stiffness", "bias", "robot")
"""Groups of error sources whose absence `rms_without` reports."""


def result_of(
    chi2: float, dof: int, relative_rms: float, touches: Array, force_std: Array, moments_only: bool
) -> Result:
    """Return the result code of a fused touch without rivals.

    Args:
        chi2, dof: misfit and its degrees of freedom.
        relative_rms: root of the trace of the point's covariance, over the length of the probe.
        touches: as located, (k, TOUCH); force_std: of a force axis by the noise of each reading [N], (k,).
        moments_only: whether forces do not count.
    """
    pulls = (touches[:, NORMAL] < -3.0 * force_std).any()  # by more than noise explains
    if chi2 > max_chi2(dof, MISFIT_CHANCE) or pulls:
        return "inconsistent"
    if not relative_rms < UNIFORM_STD:
        return "unobservable" if moments_only else "too_light"
    return "ok"


def without(priors: Tolerances, group: str) -> Tolerances:
    """Return the priors with one group of error sources removed."""
    if group == "stiffness":
        return replace(priors, youngs_modulus=0.0, shear_modulus=0.0, creep=0.0, stiffness_scatter=0.0)
    if group == "bias":
        return replace(priors, drift_steps=0.0, walk_steps=0.0)
    return replace(priors, base_mm=0.0, robot_mm=0.0)


_SCALED = {"E": "youngs_modulus", "G": "shear_modulus", "creep": "creep", "stiffness scatter": "stiffness_scatter",
           "base place": "base_mm"}  # fmt: skip
"""Priors that `FusionState.rms` may change, by the error source whose columns go with them."""


class FusionState:
    """The touches of a fusion as they are linearised, and the memory that the kernels work in."""

    def __init__(self, fusion: "Fusion", touches: Array, pin: PointConstraint | None = None) -> None:
        """Allocate the memory of the kernels.

        Args:
            fusion: of the readings.
            touches: at every pose, (k, TOUCH), moved in place.
            pin: a condition on the touched point; None: none.
        """
        self.fusion, self.touches = fusion, touches
        k, m = len(fusion.readings), len(fusion.channels)
        parameters = OWN + len(fusion.model.rod.s)
        self.causes = len(fusion.sources[0].names)
        width = keyframe_kernel.columns(self.causes)
        self.lin = np.empty((k, ROWS, 1 + UNKNOWNS + parameters))
        self.D = np.empty((k, 12, self.causes))
        # A pin counts as one more reading before the first.
        self.reduced = np.zeros((k + 1, m, width))
        self._order = np.arange(k) if pin is None else np.concatenate([[k], np.arange(k)])
        if pin is not None:
            self.reduced[k, 0, :3], self.reduced[k, 0, -1] = pin.axis / pin.std, pin.at / pin.std
        self._touched = np.append(fusion.touched, False)
        self._walk = np.empty(len(self._order))
        self._chain = np.empty((len(self._order), keyframe_kernel.BIAS, width))
        self._xs = np.empty((k + 1, width - 1))
        self.local = np.empty((k, keyframe_kernel.LOCAL, keyframe_kernel.LOCAL + width))
        self._sweep_work = np.empty(work_size(parameters))
        self._block = np.empty((keyframe_kernel.rows_of(m), keyframe_kernel.LOCAL + width))
        self._work = np.empty(max(fusion_kernel.solve_work(self.causes), 100))
        self._x, self._cov = np.empty(width - 1), np.empty((3, 3))

    def linearise(self) -> bool:
        """Linearise all touches; return whether all have a stable equilibrium."""
        fusion = self.fusion
        for k, sources in enumerate(fusion.sources):
            if fusion.touched[k] and not keyframe_kernel.linearise_keyframe(
                fusion.model.rod.body, sources.gravity, fusion.model.mass, FINE, self.touches[k],
                *sources.arguments(), self._sweep_work, self.lin[k], self.D[k],
            ):  # fmt: skip
                return False
        return True

    def _reduce(self, priors: Tolerances, D: Array, friction: float | None, common: float | None) -> None:
        fusion = self.fusion
        ratio = fusion.model.friction if friction is None else friction
        common = fusion.common_friction if common is None else common
        scatter, creep = fusion.own_columns
        for k, reading in enumerate(fusion.readings):
            whiten = fusion.whitening[k]
            if not reading.touched:
                free, columns = fusion.free[k]
                keyframe_kernel.reduce_free(
                    columns, free, reading.wrench, fusion.channels, whiten, fusion.bias, self.reduced[k]
                )
                continue
            keyframe_kernel.reduce_keyframe(
                self.touches[k], self.lin[k], D[k], reading.wrench, reading.T_world_base, fusion.channels, whiten,
                fusion.bias, ratio, common, priors.robot_mm * MM, scatter, creep,
                float(fusion.ramps[k]), self._block, self.local[k], self.reduced[k],
            )  # fmt: skip

    def solved(
        self,
        priors: Tolerances,
        D: Array | None = None,
        friction: float | None = None,
        common_friction: float | None = None,
    ) -> tuple[float, Array, Array]:
        """Return the least misfit, the common unknowns and the covariance of the touched point, for the touches as
        linearised.

        Args:
            priors: standard deviations that the columns do not hold: bias and base at each pose.
            D: error columns, (k, 12, J); those of the touches if None.
            friction: prior standard deviation of the friction ratio; that of the model if None.
            common_friction: share of its variance that all touches have in common; that of the fusion if None.
        """
        self._reduce(priors, self.D if D is None else D, friction, common_friction)
        self._walk[:] = 0.0  # nothing before the first reading, whether or not a pin counts as one more
        self._walk[-len(self.fusion.readings) :] = priors.walk_steps**2 * self.fusion.steps_of_walk
        chi2 = fusion_kernel.solve_reduced(
            self.reduced, self._order, self._walk, priors.drift_steps, self.causes, self._chain, self._work, self._x,
            self._cov,
        )  # fmt: skip
        fusion_kernel.smooth_bias(self._chain, self._order, self._walk, self._x, self._xs)
        return float(chi2), self._x.copy(), self._cov.copy()

    def step(self, share: float, max_step: float) -> float:
        """Move every touch towards the solution of the common unknowns, after `solved`.

        Args:
            share: of the step to go; max_step: of arclength [m].

        Returns:
            The largest step in standard deviations.
        """
        work, end = np.empty(60), self.fusion.model.rod.flank_end
        sizes = [
            keyframe_kernel.step_keyframe(self.touches[k], self.lin[k], self.local[k], x, share, max_step, end, work)
            for k, x in enumerate(self._xs)
            if self._touched[k]
        ]
        return float(max(sizes))

    def information(self) -> tuple[Array, Array]:
        """Return the information matrix (n, n) and vector (n,) of touched point [m] and error sources, after `solved`.

        Bias and common friction are marginalised; the unit priors of the error sources are part of the matrix.

        Returns:
            Both of n = 3 + J unknowns.
        """
        n, o = len(self._x), 3 + self.causes
        L, scale = np.tril(self._work[: n * n].reshape(n, n)), self._work[n * n : n * n + n]
        root = scale[:, None] * L
        A = root @ root.T
        reduced = A[:o, :o] - A[:o, o:] @ np.linalg.solve(A[o:, o:], A[o:, :o])
        return reduced, reduced @ self._x[:o]

    def has_moved(self) -> bool:
        """Return whether the object has moved between the readings.

        The alternative, for each touch after the first, is a step d ~ N(0, `OBJECT_STEP`²) of the touched point before
        it. The step is one more common unknown, with which the misfit falls by Δ = Σ wᵢ ξᵢ². The wᵢ are the
        eigenvalues of I - V, where V is the posterior covariance of d/`OBJECT_STEP`; the ξᵢ are standard normal if
        nothing moved. Δ is compared with the multiple of χ² that has its mean and variance (Satterthwaite), at
        `MISFIT_CHANCE` over the number of alternatives (Bonferroni). Friction counts as drawn at each touch for itself:
        a step must not be what friction that changes from touch to touch explains as well.
        """
        fixed = self.solved(self.fusion.priors, common_friction=0.0)[0]
        later = np.flatnonzero(self.fusion.touched)[1:]
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
        k, m, width = self.reduced.shape
        wide, later = np.zeros((k, m, width + 3)), slice(first, len(self.fusion.readings))
        wide[:, :, :3], wide[:, :, 6:] = self.reduced[:, :, :3], self.reduced[:, :, 3:]
        wide[later, :, 3:6] = OBJECT_STEP * self.reduced[later, :, :3]
        chain = np.empty((len(self._order), keyframe_kernel.BIAS, width + 3))
        work, n = np.empty(fusion_kernel.solve_work(self.causes + 3)), width + 2
        chi2 = fusion_kernel.solve_reduced(
            wide, self._order, self._walk, self.fusion.priors.drift_steps, self.causes + 3, chain, work, np.empty(n),
            np.empty((3, 3)),
        )  # fmt: skip
        L, scale = np.tril(work[: n * n].reshape(n, n)), work[n * n : n * n + n]
        half = solve_triangular(L, np.diag(1.0 / scale)[:, 3:6], lower=True)
        # All are zero where the step is unobservable.
        return float(chi2), np.maximum(1.0 - np.linalg.eigvalsh(half.T @ half), 1e-12)

    def std_of(self, j: int) -> float:
        """Return the standard deviation of a common unknown, after `solved`."""
        n = len(self._x)
        return float(fusion_kernel.standard_deviation(self._work, n, j, np.empty(n)))

    def cov_with_sources(self) -> Array:
        """Return the covariance of the touched point [m] with the error sources (unit priors), after `solved`, (3,
        J).
        """
        n = len(self._x)
        L, scale = self._work[: n * n].reshape(n, n), self._work[n * n : n * n + n]
        half = solve_triangular(L, np.diag(1.0 / scale), lower=True)
        return np.asarray(half[:, :3].T @ half[:, 3 : 3 + self.causes])

    def rms(self, priors: Tolerances) -> float:
        """Return the RMS error of the touched point [m] under other priors (Cramér-Rao bound)."""
        D, now = self.D.copy(), self.fusion.priors
        for c, name in enumerate(self.fusion.sources[0].names):
            if name in _SCALED:
                before = getattr(now, _SCALED[name])
                D[:, :, c] *= getattr(priors, _SCALED[name]) / before if before > 0.0 else 0.0
        return statistics.rms(self.solved(priors, D)[2])

    def mean_centre(self) -> tuple[Array, Array]:
        """Return the mean of the centreline points in the world [m], (3,), and its covariance [m²], after `solved`."""
        fusion, n = self.fusion, len(self._x)
        poses = np.array([reading.T_world_base for reading in fusion.readings])
        mean, cov = np.empty(3), np.empty((3, 3))
        fusion_kernel.mean_centre(
            self.lin, self.D, self.local, poses, self._order, self._touched, self._walk, self._chain, self._xs,
            *fusion.own_columns, np.append(fusion.ramps, 1.0), np.empty(6 * n + 100), self._work, mean, cov,
        )  # fmt: skip
        return mean, cov

    def forces(self) -> Forces:
        """Return arclength, force and friction at every pose."""
        touches, free = self.touches, ~self.fusion.touched
        s = np.empty(len(touches))
        multistart.contact_arclengths(self.fusion.model.rod.body, touches, s)
        force = touches[:, DEAD : DEAD + 3].copy()
        normal = touches[:, NORMAL].copy()
        tangential = normal * np.hypot(touches[:, AROUND], touches[:, ALONG])
        force[free] = 0.0
        for of in (s, normal, tangential):
            of[free] = np.nan
        return Forces(s, force, normal, tangential)

    def gains(self) -> dict[str, float]:
        """Return the RMS error with one more touch like the last, with a further press, or with half the standard
        deviation of the stiffness [m].
        """
        fusion = self.fusion
        halved = replace(fusion.priors, youngs_modulus=0.5 * fusion.priors.youngs_modulus)
        gains = {"stiffness": self.rms(halved)}
        at = np.flatnonzero(fusion.touched)
        last = fusion.readings[at[-1]]
        gains["one more touch"] = self._rms_with_extra_reading(last, self.touches[at[-1]])
        if len(at) > 1:
            further = 2.0 * self.touches[at[-1]] - self.touches[at[-2]]
            further[TIP:] = self.touches[at[-1], TIP:]
            further[PHI] = self.touches[at[-1], PHI]
            gain = self._rms_with_extra_reading(last, further)
            if math.isfinite(gain):
                gains["further press"] = gain
        return gains

    def _rms_with_extra_reading(self, reading: "Reading", touch: Array) -> float:
        """Return the RMS error with one more reading, taken from the pose that keeps its touched point [m]."""
        fusion = self.fusion
        more = replace(fusion, readings=(*fusion.readings, reading))
        state = FusionState(more, np.vstack([self.touches, touch]))
        if not state.linearise():
            return math.nan
        T = reading.T_world_base.copy()
        i = int(np.flatnonzero(fusion.touched)[-1])
        T[:3, 3] += T[:3, :3] @ (self.lin[i][POINT : POINT + 3, VALUE] - state.lin[-1][POINT : POINT + 3, VALUE])
        state.fusion = replace(more, readings=(*fusion.readings, replace(reading, T_world_base=T)))
        return statistics.rms(state.solved(fusion.priors)[2])
