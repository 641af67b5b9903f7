"""Readings of one fixed point, touched from several poses of the base, fused by Gauss-Newton.

Pressing on by a known motion of the base measures the compliance at the contact, which locates it without any reading
of the force. What is minimised is written down in `fusion_kernel.py`; a single touch is the fusion of one pose, and a
tracked touch (`tracker.py`) the fusion of its keyframes as they come.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from probedesign.estimation import fusion_kernel as kernel
from probedesign.estimation import multistart
from probedesign.estimation.error_sources import FINE, ErrorSources, across
from probedesign.estimation.estimate import Result
from probedesign.estimation.fused import FusedEstimate, MomentsAbout
from probedesign.estimation.iso_moment_curves import closest_approaches, curve
from probedesign.estimation.likelihood import locate
from probedesign.estimation.model import ProbeModel
from probedesign.estimation.observation import Observation
from probedesign.estimation.problem import Problem
from probedesign.estimation.surface_contact_kernel import (
    ALONG,
    AROUND,
    DEAD,
    NORMAL,
    OWN,
    PHI,
    POINT,
    ROWS,
    TIP,
    TOUCH,
    UNKNOWNS,
    VALUE,
    work_size,
)
from probedesign.estimation.tolerances import Tolerances
from probedesign.frames import Array, wrench_map
from probedesign.statistics import MISFIT_CHANCE, RIVAL_CHI2, max_chi2
from probedesign.units import MM

NEAR = 1e-9
"""Poses whose numbers differ by no more, in metres too, are one."""
STARTS = 3
"""Closest approaches of the curves that a fusion starts from."""
ANYWHERE = (4, 10, 16, 22)
"""Stations to start from where no closest approach leads to a solution."""
MAX_ITERATIONS = 40
CLOSE = 1e-3
"""Step of the touched point, in standard deviations, at which the iterations end."""
SETTLED = 0.03
"""Step of a pose's own unknowns, in standard deviations given the point, at which they end too; it is taken."""
MAX_STEP = 0.1
"""Of arclength over length, in one iteration."""
BETTER_THAN_NOTHING = 1.0 / math.sqrt(12.0)
"""Standard deviation of a place somewhere along the probe, over its length."""


def channels_of(model: ProbeModel, moments: MomentsAbout | None) -> Array:
    """What of a wrench at the base counts.

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
    """One pose.

    Attributes:
        wrench: read at the base, free of what hangs below it, (6,).
        cov: of its noise, (6, 6).
        T_world_base: (4, 4).
        gravity: base axes [m/s²], (3,).
        touched: whether there was contact.
    """

    wrench: Array
    cov: Array
    T_world_base: Array
    gravity: Array
    touched: bool


class Solution(NamedTuple):
    """Where the iterations ended.

    Attributes:
        x: the common unknowns: touched point, error sources, bias, (n,).
        cov: of the touched point [m²], (3, 3).
        chi2: misfit, priors included.
        touches: at every pose, (k, TOUCH); those of free poses mean nothing.
        iterations: how many.
    """

    x: Array
    cov: Array
    chi2: float
    touches: Array
    iterations: int


@dataclass(frozen=True)
class Fusion:
    """Readings to be fused.

    Attributes:
        model: the probe.
        readings: in the order of time.
        priors: standard deviations of the error sources.
        channels: what of a wrench at the base counts, (m, 6): see `channels_of`.
        gravity_world: [m/s²], (3,).
    """

    model: ProbeModel
    readings: tuple[Reading, ...]
    priors: Tolerances
    channels: Array
    gravity_world: Array

    @property
    def moments_only(self) -> bool:
        """Whether forces are left aside."""
        return len(self.channels) == 3

    @cached_property
    def touched(self) -> NDArray[np.bool_]:
        """Which readings are of a contact, (k,)."""
        return np.array([reading.touched for reading in self.readings])

    @property
    def one_pose(self) -> bool:
        """Whether all that touched did so from one and the same pose."""
        poses = [reading.T_world_base for reading in self.readings if reading.touched]
        return all(np.allclose(poses[0], T, rtol=0.0, atol=NEAR) for T in poses[1:])

    @property
    def dof(self) -> int:
        """Degrees of freedom: what was read and the prior on friction, less the unknowns."""
        free = 0 if math.isfinite(self.model.friction) else 2
        return max(len(self.readings) * len(self.channels) - free * int(self.touched.sum()) - 3, 1)

    # What the kernels need -------------------------------------------------------------------------------------------

    @cached_property
    def sources(self) -> tuple[ErrorSources, ...]:
        """The error sources at every pose; the sensor was tared where the readings begin."""
        axes = across(self.gravity_world)
        found: list[ErrorSources] = []
        known: dict[bytes, ErrorSources] = {}
        for reading in self.readings:
            R = np.ascontiguousarray(reading.T_world_base[:3, :3])
            key = R.tobytes()
            if key not in known:
                free = self.model.rod.solve(reading.gravity)
                known[key] = ErrorSources.of(
                    self.model, self.priors, reading.gravity, free, found[0] if found else None, axes @ R
                )
            found.append(known[key])
        return tuple(found)

    @cached_property
    def _columns(self) -> tuple[int, int]:
        """Columns of the error sources that scatter from touch to touch, and that creep; -1: none."""
        names = self.sources[0].names
        return tuple(names.index(n) if n in names else -1 for n in ("stiffness scatter", "creep"))  # type: ignore[return-value]

    @cached_property
    def ramps(self) -> Array:
        """How far creep has gone at each reading, (k,)."""
        k = len(self.readings)
        return np.ones(1) if k == 1 else np.linspace(0.0, 1.0, k)

    @cached_property
    def _whitening(self) -> Array:
        covs = np.array([self.channels @ reading.cov @ self.channels.T for reading in self.readings])
        return np.ascontiguousarray(np.linalg.inv(np.linalg.cholesky(covs)))

    @cached_property
    def bias(self) -> Array:
        """The channels by the bias in steps of the sensor's resolution, (m, 6)."""
        step = self.model.noise_base() * self.model.averaging_samples
        return np.ascontiguousarray(self.channels @ np.linalg.cholesky(step))

    @cached_property
    def _free(self) -> dict[int, tuple[Array, Array]]:
        """Of the readings without contact: the free probe's wrench, (6,), and its error columns, (6, J)."""
        found = {}
        for k, (reading, sources) in enumerate(zip(self.readings, self.sources, strict=True)):
            if not reading.touched:
                free = self.model.rod.solve(reading.gravity)
                found[k] = free.wrench_base, np.ascontiguousarray(sources.free_columns(free))
        return found

    # Solving ---------------------------------------------------------------------------------------------------------

    def solve(self) -> FusedEstimate:
        """The answer; see `Estimator.fuse`."""
        found = self.solutions()
        if isinstance(found, FusedEstimate):
            return found
        return self.answer(found)

    def solutions(self) -> list[Solution] | FusedEstimate:
        """Every solution that the starts lead to, best first; or why there is none."""
        if not self.touched.any() or (self.moments_only and self.one_pose):
            return FusedEstimate("unobservable")
        found: list[Solution] = []
        for starts in self._starts():
            found = _distinct([*found, *(self._run(start) for start in starts)])
            if any(place.chi2 <= max_chi2(self.dof, MISFIT_CHANCE) for place in found):
                break
        return found or FusedEstimate("not_converged")

    def _starts(self) -> Iterable[list[Array]]:
        """Guesses of the touches, (k, TOUCH) each, the likelier first: what each reading gives by itself; where the
        curves of equal moment come nearest; anywhere along them."""
        k = len(self.readings)
        singles = [] if self.moments_only else self._from_single_readings()
        if k == 1 or self.one_pose:
            yield singles
            return
        curves = [
            curve(self.model.rod, r.gravity, r.wrench[3:6], r.T_world_base)
            for r in self.readings
            if r.touched
        ]

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
        """The touch that each reading gives by itself, its force trusted; none where one gives none."""
        start = np.zeros((len(self.readings), TOUCH))
        for k, (reading, sources) in enumerate(zip(self.readings, self.sources, strict=True)):
            if not reading.touched:
                continue
            whiten = np.linalg.inv(np.linalg.cholesky(reading.cov))
            seen = Observation(
                reading.wrench, whiten, reading.gravity, self.model.mass * reading.gravity, math.inf
            )
            places = locate(Problem(sources, seen, self.model.friction, reading.cov + sources.drift))
            if not places or places[0].touch is None:
                return []
            start[k] = places[0].touch
        return [start]

    def _run(self, start: Array) -> Solution | None:
        """Gauss-Newton from one guess."""
        touches, most = start.copy(), MAX_STEP * self.model.rod.length
        state = FusionState(self, touches)
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
            size = state.step(x, share, most)
            near = float(np.abs(moved).max()) <= CLOSE * math.sqrt(float(np.trace(cov))) + 1e-9
            if near and size <= SETTLED * math.sqrt(1.0 + chi2):
                touches[:] = linearised
                return Solution(x, cov, chi2, linearised, iteration + 1)
        return None

    # The result ------------------------------------------------------------------------------------------------------

    def answer(self, found: list[Solution], brief: bool = False) -> FusedEstimate:
        """The best solution with its code.

        Args:
            found: every solution, best first.
            brief: without what it would be if something were otherwise.
        """
        best = found[0]
        rms = math.sqrt(max(float(np.trace(best.cov)), 0.0))
        code = self._code(found, rms)
        state = FusionState(self, best.touches.copy())
        if not state.linearise():
            return FusedEstimate("not_converged")
        _chi2, x, cov = state.solved(self.priors)
        names = self.sources[0].names
        E = names.index("E") if "E" in names else -1
        std_E = state.std_of(3 + E) if E >= 0 else 0.0
        scale = self.priors.youngs_modulus
        stiffness = math.exp(scale * float(x[3 + E])) if E >= 0 else 1.0
        result = FusedEstimate(
            code,
            stiffness=stiffness,
            std_stiffness=stiffness * scale * std_E,
            chi2=best.chi2,
            dof=self.dof,
            rms=rms,
            rms_without={} if brief else {of: state.rms(without(self.priors, of)) for of in GROUPS},
            iterations=best.iterations,
            candidates_world=np.array([p.x[:3] for p in found if p.chi2 < best.chi2 + RIVAL_CHI2]),
        )
        if code != "ok":
            return result
        state.solved(self.priors)
        mean, cov_mean = state.mean_centre(x)
        placed = replace(result, p_surface_world=x[:3].copy(), cov_surface_world=cov, p_contact_world=mean,
                         cov_contact_world=cov_mean, **state.forces())  # type: ignore[arg-type]  # fmt: skip
        if self.one_pose:
            placed = self._bowed(placed)
        return placed if brief else replace(placed, rms_with=state.gains())

    def _bowed(self, result: FusedEstimate) -> FusedEstimate:
        """A result from one pose with what the curve of the probe adds to its covariance."""
        return add_single_pose_curvature(
            result,
            self.model,
            [r for r in self.readings if r.touched],
            self.sources[int(self.touched.argmax())],
        )

    def _code(self, found: list[Solution], rms: float) -> Result:
        best = found[0]
        std = np.array([math.sqrt(float(reading.cov[0, 0])) for reading in self.readings])
        if best.chi2 > max_chi2(self.dof, MISFIT_CHANCE) or pulls(
            best.touches[self.touched], std[self.touched]
        ):
            return "inconsistent"
        if not rms < self.model.rod.length * BETTER_THAN_NOTHING:
            return "unobservable" if self.moments_only else "too_light"
        for rival in found[1:]:
            apart = float(np.linalg.norm(rival.x[:3] - best.x[:3]))
            spread = rms + math.sqrt(max(float(np.trace(rival.cov)), 0.0))
            if rival.chi2 < best.chi2 + RIVAL_CHI2 and apart > 3.0 * spread:
                return "ambiguous"
        return "ok"


def pulls(touches: Array, std: Array) -> bool:
    """Whether a touch pulls by more than the noise of a force may feign, std [N], (k,)."""
    return bool((touches[:, NORMAL] < -3.0 * std).any())


GROUPS = ("stiffness", "bias", "robot")
"""Groups of error sources whose absence `rms_without` reports."""


def without(priors: Tolerances, group: str) -> Tolerances:
    """The same priors with one group of error sources gone."""
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

    def __init__(self, fusion: Fusion, touches: Array) -> None:
        """Args:
        fusion: of the readings.
        touches: at every pose, (k, TOUCH), moved in place.
        """
        self.fusion, self.touches = fusion, touches
        k, m = len(fusion.readings), len(fusion.channels)
        parameters = OWN + len(fusion.model.rod.s)
        self.causes = len(fusion.sources[0].names)
        width = kernel.columns(self.causes)
        self.lin = np.empty((k, ROWS, 1 + UNKNOWNS + parameters))
        self.D = np.empty((k, 12, self.causes))
        self.reduced = np.empty((k, m, width))
        self.local = np.empty((k, kernel.LOCAL, kernel.LOCAL + width))
        self._sweep_work = np.empty(work_size(parameters))
        self._block = np.empty((kernel.rows_of(m), kernel.LOCAL + width))
        self._work = np.empty(max(kernel.solve_work(self.causes), 100))
        self._x, self._cov = np.empty(width - 1), np.empty((3, 3))

    def linearise(self) -> bool:
        """All touches where they are; whether the probe holds them all."""
        fusion = self.fusion
        for k, sources in enumerate(fusion.sources):
            if fusion.touched[k] and not kernel.linearise_keyframe(
                fusion.model.rod.body, sources.gravity, fusion.model.mass, FINE, self.touches[k],
                *sources.arguments(), self._sweep_work, self.lin[k], self.D[k],
            ):  # fmt: skip
                return False
        return True

    def _reduce(self, priors: Tolerances, D: Array, friction: float | None) -> None:
        fusion = self.fusion
        ratio = fusion.model.friction if friction is None else friction
        scatter, creep = fusion._columns
        for k, reading in enumerate(fusion.readings):
            whiten = fusion._whitening[k]
            if not reading.touched:
                free, columns = fusion._free[k]
                kernel.reduce_free(
                    columns, free, reading.wrench, fusion.channels, whiten, fusion.bias, self.reduced[k]
                )
                continue
            kernel.reduce_keyframe(
                self.touches[k], self.lin[k], D[k], reading.wrench, reading.T_world_base, fusion.channels, whiten,
                fusion.bias, ratio, priors.robot_mm * MM, scatter, creep, float(fusion.ramps[k]),
                self._block, self.local[k], self.reduced[k],
            )  # fmt: skip

    def solved(
        self,
        priors: Tolerances,
        D: Array | None = None,
        friction: float | None = None,
    ) -> tuple[float, Array, Array]:
        """Least misfit, common unknowns and covariance of the touched point, of the touches as linearised.

        Args:
            priors: standard deviations that the columns do not hold: bias and base at each pose.
            D: error columns, (k, 12, J); those of the touches if None.
            friction: prior standard deviation of the friction ratio; that of the model if None.
        """
        self._reduce(priors, self.D if D is None else D, friction)
        order = np.arange(len(self.fusion.readings))
        walk = np.full(len(order), priors.walk_steps**2)
        chi2 = kernel.solve_reduced(
            self.reduced, order, walk, priors.drift_steps, self.causes, self._work, self._x, self._cov
        )
        return float(chi2), self._x.copy(), self._cov.copy()

    def step(self, x: Array, share: float, most: float) -> float:
        """Carry every touch towards where the common unknowns put it; the largest step in standard deviations."""
        work, end = np.empty(60), self.fusion.model.rod.flank_end
        sizes = [
            float(
                kernel.step_keyframe(self.touches[k], self.lin[k], self.local[k], x, share, most, end, work)
            )
            for k in np.flatnonzero(self.fusion.touched)
        ]
        return max(sizes)

    def information(self) -> tuple[Array, Array]:
        """Information matrix (n, n) and vector (n,) of touched point [m] and error sources, after `solved`.

        The bias is marginalised; the unit priors of the error sources are part of the matrix.

        Returns:
            Both of n = 3 + J unknowns.
        """
        n, o = len(self._x), 3 + self.causes
        L, scale = np.tril(self._work[: n * n].reshape(n, n)), self._work[n * n : n * n + n]
        root = scale[:, None] * L
        A = root @ root.T
        reduced = A[:o, :o] - A[:o, o:] @ np.linalg.solve(A[o:, o:], A[o:, :o])
        return reduced, reduced @ self._x[:o]

    def std_of(self, j: int) -> float:
        """Standard deviation of a common unknown, after `solved`."""
        n = len(self._x)
        return float(kernel.standard_deviation(self._work, n, j, np.empty(n)))

    def cov_with_sources(self) -> Array:
        """Covariance of the touched point [m] with the error sources (unit priors), after `solved`, (3, J)."""
        n = len(self._x)
        L, scale = self._work[: n * n].reshape(n, n), self._work[n * n : n * n + n]
        half = solve_triangular(L, np.diag(1.0 / scale), lower=True)
        return np.asarray(half[:, :3].T @ half[:, 3 : 3 + self.causes])

    def rms(self, priors: Tolerances) -> float:
        """Of the touched point [m] under other priors, by the bound."""
        D, now = self.D.copy(), self.fusion.priors
        for c, name in enumerate(self.fusion.sources[0].names):
            if name in _SCALED:
                before = getattr(now, _SCALED[name])
                D[:, :, c] *= getattr(priors, _SCALED[name]) / before if before > 0.0 else 0.0
        return math.sqrt(max(float(np.trace(self.solved(priors, D)[2])), 0.0))

    def mean_centre(self, x: Array) -> tuple[Array, Array]:
        """Mean of the centreline points in the world [m], (3,), and its covariance [m²], after `solved`."""
        fusion, n = self.fusion, len(x)
        poses = np.array([reading.T_world_base for reading in fusion.readings])
        mean, cov, order = np.empty(3), np.empty((3, 3)), np.flatnonzero(fusion.touched)
        kernel.mean_centre(
            self.lin, self.D, self.local, poses, order, x, *fusion._columns, fusion.ramps[order],
            np.empty(6 * n + 100), self._work, mean, cov,
        )  # fmt: skip
        return mean, cov

    def forces(self) -> dict[str, Array]:
        """Arclength, force and friction at every pose; NaN where free."""
        touches, free = self.touches, ~self.fusion.touched
        s = np.empty(len(touches))
        multistart.contact_arclengths(self.fusion.model.rod.body, touches, s)
        force = touches[:, DEAD : DEAD + 3].copy()
        normal = touches[:, NORMAL].copy()
        tangential = normal * np.hypot(touches[:, AROUND], touches[:, ALONG])
        force[free] = 0.0
        for of in (s, normal, tangential):
            of[free] = np.nan
        return {"s_contact": s, "force_base": force, "force_normal": normal, "force_tangential": tangential}

    def gains(self) -> dict[str, float]:
        """The error with one more touch like the last, a further press as far again, or a stiffness known to half."""
        fusion = self.fusion
        halved = replace(fusion.priors, youngs_modulus=0.5 * fusion.priors.youngs_modulus)
        gains = {"stiffness": self.rms(halved)}
        at = np.flatnonzero(fusion.touched)
        last = fusion.readings[at[-1]]
        gains["one more touch"] = self._with(last, self.touches[at[-1]])
        if len(at) > 1:
            further = 2.0 * self.touches[at[-1]] - self.touches[at[-2]]
            further[TIP:] = self.touches[at[-1], TIP:]
            further[PHI] = self.touches[at[-1], PHI]
            gain = self._with(last, further)
            if math.isfinite(gain):
                gains["further press"] = gain
        return gains

    def _with(self, reading: Reading, touch: Array) -> float:
        """The error with one reading more, from the pose that puts its touched point where that of `reading` is [m]."""
        fusion = self.fusion
        more = replace(fusion, readings=(*fusion.readings, reading))
        state = FusionState(more, np.vstack([self.touches, touch]))
        if not state.linearise():
            return math.nan
        T = reading.T_world_base.copy()
        i = int(np.flatnonzero(fusion.touched)[-1])
        T[:3, 3] += T[:3, :3] @ (
            self.lin[i][POINT : POINT + 3, VALUE] - state.lin[-1][POINT : POINT + 3, VALUE]
        )
        state.fusion = replace(more, readings=(*fusion.readings, replace(reading, T_world_base=T)))
        return math.sqrt(max(float(np.trace(state.solved(fusion.priors)[2])), 0.0))


def add_single_pose_curvature(
    result: FusedEstimate, model: ProbeModel, readings: list[Reading], sources: ErrorSources
) -> FusedEstimate:
    """A result from one pose with the curvature of the valley of likely touches added, as a single reading has it.

    Presses from several poses pin the place down so well that its covariance is linear; one pose leaves it as uncertain
    as one reading does, along a curve.
    """
    first = readings[0]
    wrench = np.mean([reading.wrench for reading in readings], axis=0)
    cov = np.mean([reading.cov for reading in readings], axis=0) / len(readings)
    seen = Observation(
        wrench, np.linalg.inv(np.linalg.cholesky(cov)), first.gravity, model.mass * first.gravity, math.inf
    )
    places = locate(Problem(sources, seen, model.friction, cov + sources.drift))
    if not places:
        return result
    R = first.T_world_base[:3, :3]
    added = [
        R @ (wide - linear) @ R.T
        for wide, linear in (
            (places[0].cov_surface_base, places[0].cov_linear_base),
            (places[0].cov_contact_base, places[0].cov_linear_contact_base),
        )
    ]
    if not all(np.isfinite(of).all() for of in added):
        return result
    surface = result.cov_surface_world + added[0]
    return replace(
        result,
        cov_surface_world=surface,
        cov_contact_world=result.cov_contact_world + added[1],
        rms=math.sqrt(max(float(np.trace(surface)), 0.0)),
    )


def _distinct(found: Iterable[Solution | None]) -> list[Solution]:
    """Each solution once, best first."""
    kept: list[Solution] = []
    for place in sorted((place for place in found if place is not None), key=lambda of: of.chi2):
        near = 0.1 * math.sqrt(max(float(np.trace(place.cov)), 0.0)) + 1e-6
        if all(np.linalg.norm(place.x[:3] - of.x[:3]) > near for of in kept):
            kept.append(place)
    return kept
