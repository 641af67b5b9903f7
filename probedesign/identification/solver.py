"""Least squares over a whole campaign: Levenberg–Marquardt steps within bounds, with robust weights and noise scales.

SciPy's `least_squares` has robust losses of single residuals only; here a block of residuals shares one weight and the
scale of its kind is estimated with it, which is why the steps are taken here.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from probedesign.core.frames import Array
from probedesign.identification.elimination import NormalEquations, TestRows
from probedesign.identification.parameters import LOG_G, MAX_LOGARITHM, CommonParameters, ParameterValues, columns_of
from probedesign.identification.residuals import MeasuredTest, ResidualBlock, SolvedTest, solve_test
from probedesign.identification.robust_loss import NoiseScale, median_scales, noise_scales, robust_loss, weights
from probedesign.identification.whole_probe import MassMeasurement, PoissonPrior

MAX_ITERATIONS = 25
"""Steps of one search: those of campaigns without contradictions take fewer than ten."""
MIN_DAMPING, MAX_DAMPING = 1e-9, 1e8
MIN_GAIN = 1e-3
"""Decrease of the loss, half a χ², that ends a search: within a twentieth of a standard deviation of the minimum. The
rod's own tolerances, a micrometre and a millionth of the moment, make the loss uncertain by about as much."""
MAX_SCALE_ROUNDS = 4
"""Estimates of the noise scales from the residuals."""


# the problem, linearised


@dataclass(frozen=True)
class LeastSquaresProblem:
    """Tests, weighing and prior of one fit."""

    common: CommonParameters  #: parameters that the tests share.
    tests: tuple[MeasuredTest, ...]  #: the tests.
    mass: MassMeasurement | None  #: the weighing; None if there was none.
    prior: Array  #: standard deviations of the parameter vector: infinite for requested parameters, 0 for fixed ones.

    @cached_property
    def active(self) -> Array:
        """Which entries of the parameter vector are estimated, (size,) of bool."""
        return np.asarray(self.prior > 0.0)

    @cached_property
    def poisson(self) -> PoissonPrior | None:
        """Prior on Poisson's ratio; None if G has its own prior."""
        return PoissonPrior() if np.isinf(self.prior[LOG_G]) else None

    @cached_property
    def bounds(self) -> Array:
        """Smallest and largest values of the estimated entries of the parameter vector, (2, n_active)."""
        return self.common.bounds[:, self.active]

    @cached_property
    def nuisance_bounds(self) -> tuple[Array, ...]:
        """Smallest and largest values of each test's nuisance parameters, (2, nuisance_size): the flank ends the
        arclength, and a stiffness is bounded as E is."""
        found = []
        for test in self.tests:
            bounds = np.full((2, test.nuisance_size), np.inf) * [[-1.0], [1.0]]
            if "s" in test.nuisance:
                bounds[:, test.nuisance["s"]] = [[0.0], [self.common.model.rod.flank_end]]
            if "stiffness" in test.nuisance:
                bounds[:, test.nuisance["stiffness"]] = [[-MAX_LOGARITHM], [MAX_LOGARITHM]]
            found.append(bounds)
        return tuple(found)

    @cached_property
    def n_active(self) -> int:
        """Number of estimated entries of the parameter vector."""
        return int(self.active.sum())

    @cached_property
    def size(self) -> int:
        """Number of all unknowns, nuisance parameters of the tests included."""
        return self.n_active + sum(test.nuisance_size for test in self.tests)


@dataclass(frozen=True)
class Linearization:
    """The campaign solved at some parameter values, with derivatives."""

    problem: LeastSquaresProblem  #: the fit.
    values: ParameterValues  #: of the parameters.
    tests: tuple[SolvedTest, ...]  #: solved; none where the loads are absurd.
    blocks: tuple[ResidualBlock, ...]  #: all residuals; empty where a test has no solution.

    @property
    def ok(self) -> bool:
        """Whether the rod has a stable equilibrium in every test."""
        return len(self.tests) == len(self.problem.tests) and all(test.ok for test in self.tests)

    @cached_property
    def prior_residual(self) -> Array:
        """Whitened deviation of the estimated entries from their prior, (n_active,)."""
        std = self.problem.prior[self.problem.active]
        return np.where(np.isinf(std), 0.0, self.values.x[self.problem.active] / std)

    def loss(self, scales: dict[str, float]) -> float:
        """Return the loss with the prior's share."""
        return robust_loss(self.blocks, scales) + 0.5 * float(self.prior_residual @ self.prior_residual)

    @cached_property
    def _blocks_of_tests(self) -> list[list[int]]:
        """Positions of the blocks of each test, and of those that belong to none."""
        groups: dict[str, list[int]] = {test.measured.name: [] for test in self.tests}
        groups[""] = []
        for i, block in enumerate(self.blocks):
            groups[block.test].append(i)
        return list(groups.values())

    @cached_property
    def _stacked(self) -> list[tuple[TestRows, NDArray[np.intp]]]:
        """Rows of each test with full weight, and the number of rows of each block."""
        active, result = self.problem.active, []
        for group in self._blocks_of_tests:
            blocks = [self.blocks[i] for i in group]
            if not blocks:
                empty = np.zeros((0, self.problem.n_active))
                result.append((TestRows(empty, np.zeros((0, 0)), np.zeros(0)), np.zeros(0, dtype=np.intp)))
                continue
            rows = TestRows(
                np.concatenate([block.J for block in blocks])[:, active],
                np.concatenate([block.J_nuisance for block in blocks]),
                np.concatenate([block.r for block in blocks]),
            )
            result.append((rows, np.array([len(block.r) for block in blocks])))
        return result

    def normal_equations(self, weight: Array, damping: float = 0.0, bounded: bool = False) -> NormalEquations:
        """Return the weighted normal equations of the common unknowns.

        `bounded` fixes the unknowns at a bound whose loss decreases beyond it: the steps then are those of the others,
        and the expected decrease is one that a step within the bounds can reach.
        """
        rows = []
        for group, (stated, sizes) in zip(self._blocks_of_tests, self._stacked, strict=True):
            root = np.sqrt(np.repeat(weight[group], sizes))
            rows.append(TestRows(root[:, None] * stated.A, root[:, None] * stated.B, root * stated.r))
        std = self.problem.prior[self.problem.active]
        inverse = np.where(np.isinf(std), 0.0, 1.0 / std)
        if bounded:
            gradient = inverse * self.prior_residual + sum(one.A.T @ one.r for one in rows)
            movable = _movable(self.values.x[self.problem.active], gradient, self.problem.bounds)
            inverse = inverse * movable
            rows = [replace(one, A=one.A * movable) for one in rows]
            for i, (test, bounds) in enumerate(zip(self.tests, self.problem.nuisance_bounds, strict=True)):
                own = rows[i]
                rows[i] = replace(own, B=own.B * _movable(test.nuisance, own.B.T @ own.r, bounds))
        tests = [one.eliminated(damping) for one in rows]
        return NormalEquations(tests, inverse**2, inverse * self.prior_residual, damping)

    def absorbed(self, equations: NormalEquations) -> list[Array]:
        """Return the hat matrix of each block, by the normal equations with its weights."""
        result: list[Array] = [np.zeros((0, 0))] * len(self.blocks)
        for i, (group, (_, sizes)) in enumerate(zip(self._blocks_of_tests, self._stacked, strict=True)):
            hat, ends = equations.hat(i), np.cumsum(sizes)
            for k, size, end in zip(group, sizes, ends, strict=True):
                result[k] = hat[end - size : end, end - size : end]
        return result


def _movable(values: Array, gradient: Array, bounds: Array) -> NDArray[np.bool_]:
    """Return which values are within their bounds or are drawn away from the bound they are at."""
    low, high = bounds
    return np.asarray(~((values <= low) & (gradient > 0.0) | (values >= high) & (gradient < 0.0)))


def linearize(
    problem: LeastSquaresProblem,
    values: ParameterValues,
    nuisance: Sequence[Array],
    last: Linearization | None = None,
    root: bool = False,
) -> Linearization:
    """Solve every test at some parameter values, with its nuisance parameters.

    The equilibria of `last`, a neighbouring linearization, are the initial guesses. `root` asks for derivatives by the
    root although it is fixed.
    """
    root = root or bool(problem.active[columns_of(["root"])[0]])
    solved: list[SolvedTest] = []
    for i, (test, own) in enumerate(zip(problem.tests, nuisance, strict=True)):
        solved.append(solve_test(test, values, own, None if last is None else last.tests[i], root))
        if not solved[-1].ok:
            return Linearization(problem, values, tuple(solved), ())
    return _collected(problem, values, solved)


def reread(point: Linearization, tests: Sequence[MeasuredTest]) -> Linearization:
    """Return the same states of the probe with other readings of the reference."""
    solved = [replace(one, measured=test) for one, test in zip(point.tests, tests, strict=True)]
    return _collected(replace(point.problem, tests=tuple(tests)), point.values, solved)


def _collected(problem: LeastSquaresProblem, values: ParameterValues, solved: Sequence[SolvedTest]) -> Linearization:
    blocks = [block for test in solved for block in test.blocks()]
    if problem.mass is not None:
        blocks.append(problem.mass.block(values))
    if problem.poisson is not None:
        blocks.append(problem.poisson.block(values))
    return Linearization(problem, values, tuple(solved), tuple(blocks))


# the search


@dataclass(frozen=True)
class Fit:
    """Result of a search."""

    result: str  #: "ok" or "not_converged".
    point: Linearization  #: linearization where it ended.
    scales: dict[str, float]  #: noise scale of each kind over the stated noise.
    noise: tuple[NoiseScale, ...]  #: how the scales were estimated.
    iterations: int  #: number of steps.

    @cached_property
    def weight(self) -> Array:
        """Weight of each block."""
        return weights(self.point.blocks, self.scales)

    @cached_property
    def equations(self) -> NormalEquations:
        """Normal equations at the solution."""
        return self.point.normal_equations(self.weight)

    @property
    def cov(self) -> Array:
        """Covariance of the estimated entries of the parameter vector, (n_active, n_active)."""
        return self.equations.covariance

    @cached_property
    def absorbed(self) -> list[Array]:
        """Hat matrix of each block."""
        return self.point.absorbed(self.equations)


def fit(problem: LeastSquaresProblem, start: Linearization) -> Fit:
    """Fit a campaign.

    At first the scale of each kind is that of the median of its distances; once that has converged it is estimated
    from the residuals and their degrees of freedom, and the search continues from there.
    """
    point, iterations, converged = minimise(problem, start, None)
    scales: dict[str, float] = {}
    noise: list[NoiseScale] = []
    for _ in range(MAX_SCALE_ROUNDS):
        weight = weights(point.blocks, scales)
        noise = noise_scales(point.blocks, weight, _leverage(point, weight), scales)
        estimated = {one.kind: one.scale for one in noise}
        settled = bool(scales) and all(abs(estimated[k] / scales[k] - 1.0) < 0.02 for k in estimated)
        scales = estimated
        if not converged:  # contradictory tests: more steps change no more than the noise
            break
        point, more, converged = minimise(problem, point, scales)
        iterations += more
        if settled:
            break
    return Fit("ok" if converged else "not_converged", point, scales, tuple(noise), iterations)


def _leverage(point: Linearization, weight: Array) -> Array:
    """Return the degrees of freedom of each block that the unknowns absorb, (n,)."""
    return np.array([np.trace(hat) for hat in point.absorbed(point.normal_equations(weight))])


def minimise(
    problem: LeastSquaresProblem,
    point: Linearization,
    scales: dict[str, float] | None,
    max_iterations: int = MAX_ITERATIONS,
) -> tuple[Linearization, int, bool]:
    """Take Levenberg–Marquardt steps until the gain is negligible; scales by the medians if none are given."""
    damping = MIN_DAMPING
    for iteration in range(max_iterations):
        used = median_scales(point.blocks) if scales is None else scales
        weight = weights(point.blocks, used)
        equations = point.normal_equations(weight, MIN_DAMPING, bounded=True)
        if equations.steps[2] < MIN_GAIN:
            return point, iteration, True
        moved, loss = None, point.loss(used)
        while moved is None and damping < MAX_DAMPING:
            if damping > MIN_DAMPING:
                equations = point.normal_equations(weight, damping, bounded=True)
            moved = _moved(problem, point, equations)
            if moved is not None and moved.loss(used) > loss:
                moved = None
            damping = 10.0 * max(damping, 1e-5) if moved is None else max(damping / 10.0, MIN_DAMPING)
        if moved is None:
            return point, iteration, False
        point = moved
    return point, max_iterations, False


def _moved(problem: LeastSquaresProblem, point: Linearization, equations: NormalEquations) -> Linearization | None:
    """Return the campaign after a step of all unknowns within their bounds; None if the rod has no solution."""
    step, own_steps, _ = equations.steps
    x = point.values.x.copy()
    x[problem.active] = np.clip(x[problem.active] + step, *problem.bounds)
    nuisance = [
        np.clip(test.nuisance + own_step, *bounds)
        for test, own_step, bounds in zip(point.tests, own_steps, problem.nuisance_bounds, strict=False)
    ]
    moved = linearize(problem, ParameterValues(problem.common, x), nuisance, point)
    return moved if moved.ok else None
