"""Fit of a campaign: SciPy's least squares in a loop that reweights the readings and estimates their noise scales.

A block of residuals shares one weight, and the scale of its kind is estimated with it; SciPy has losses of single
residuals only. A block of k residuals at distance d has full weight up to c², the 99 % quantile of χ²_k, and weight
c²/d² beyond: with normal noise hardly any information is lost, and the pull of a gross error falls as 1/d. That loss
has more than one minimum, so distances are first measured against their median, whose scale falls to 1 as the fit
converges.
"""

import math
from collections.abc import Iterator, Sequence, Set
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import Bounds, least_squares
from scipy.stats import chi2

from probedesign.core.frames import Array
from probedesign.identification.parameters import (
    LOG_E,
    LOG_G,
    MAX_LOGARITHM,
    PARAMETERS,
    CommonParameters,
    ParameterValues,
)
from probedesign.identification.residuals import (
    BlockKey,
    MassMeasurement,
    MeasuredTest,
    ResidualBlock,
    SolvedTest,
    poisson_block,
    solve_test,
)
from probedesign.rod.rod import Rod

READING_KINDS = ("markers", "wrenches", "touches", "places", "weights")  #: Kinds of readings that most tests have.
#: Kinds whose scatter is estimated where it exceeds the stated one; the others are prior knowledge or single readings.
#: Stiffness and friction of each touch scatter as readings do, and one may be far from the others.
ROBUST_KINDS = (*READING_KINDS, "stiffness", "friction")
MIN_FREEDOM = 1.0  #: Degrees of freedom from which on a scatter is judged.
#: Equivalent degrees of freedom of a stated standard deviation, which has an uncertainty of about a third (assumed).
STATED_FREEDOM = 4.0
FULL_WEIGHT = 0.99  #: Quantile of χ² up to which a block has full weight.
REJECTION_CHANCE = 1e-3  #: Chance, with noise as stated, that a prior is rejected.
#: Chance, with noise as stated, that a scatter is judged larger than stated and reported; it refuses nothing.
SCATTER_CHANCE = 0.05
OUTLIER_CHANCE = 0.01  #: Chance, with normal noise, that a campaign reports any outlier at all.


@dataclass(frozen=True)
class NoiseScale:
    """Scatter of one kind of reading."""

    kind: str  #: of readings.
    groups: int  #: how many there are.
    scale: float  #: standard deviation over the stated one; at least 1.
    freedom: float  #: degrees of freedom of the scale, those of the stated value included.
    measured: bool  #: whether the residuals scatter significantly more than stated.


def _distances(blocks: Sequence[ResidualBlock], scales: dict[str, float]) -> tuple[Array, Array, Array]:
    """Return the squared distance of each block with the scale of its kind, the one up to which it has full weight, and
    the variance of its kind over the stated one, (n,) each."""
    variance = np.array([scales.get(block.kind, 1.0) ** 2 for block in blocks])
    limit = np.asarray(chi2.ppf(FULL_WEIGHT, [len(block.r) for block in blocks]))
    limit[[block.kind not in ROBUST_KINDS for block in blocks]] = np.inf
    return np.array([block.squared_distance for block in blocks]) / variance, limit, variance


def weights(blocks: Sequence[ResidualBlock], scales: dict[str, float]) -> Array:
    """Return the weight of each block, relative to its stated information, (n,)."""
    squares, limit, variance = _distances(blocks, scales)
    return np.asarray(np.minimum(1.0, limit / np.maximum(squares, 1e-12)) / variance)


def median_scales(blocks: Sequence[ResidualBlock]) -> dict[str, float]:
    """Return the scale of each kind by the median of its distances, at least 1."""
    kinds, squares = np.array([block.kind for block in blocks]), [block.squared_distance for block in blocks]
    relative = np.asarray(squares) / np.asarray(chi2.median([len(block.r) for block in blocks]))
    medians = {kind: float(np.median(relative[kinds == kind])) for kind in ROBUST_KINDS if kind in kinds}
    return {kind: max(1.0, math.sqrt(median)) for kind, median in medians.items()}


def noise_scales(
    blocks: Sequence[ResidualBlock], weight: Array, leverage: Array, scales: dict[str, float]
) -> list[NoiseScale]:
    """Estimate the scatter of each kind about the fit; `leverage` is what the fit absorbs of each block, (n,).

    The stated variance is itself uncertain: its prior is the scaled inverse χ² distribution with `STATED_FREEDOM`
    degrees of freedom, and the scale is that of the posterior, never below the stated one.
    """
    result = []
    for kind in dict.fromkeys(block.kind for block in blocks if block.kind in ROBUST_KINDS):
        at = [i for i, block in enumerate(blocks) if block.kind == kind]
        # 1 for blocks with full weight; the square lets far outliers have no part in the scale.
        relative = (weight[at] * scales.get(kind, 1.0) ** 2) ** 2
        squares = float(np.sum(relative * [blocks[i].squared_distance for i in at]))
        freedom = float(np.sum(relative * [len(blocks[i].r) for i in at]) - leverage[at].sum())
        measured = freedom > MIN_FREEDOM and chi2.sf(squares, freedom) < SCATTER_CHANCE
        freedom = max(freedom, 0.0) + STATED_FREEDOM
        scale = max(math.sqrt((squares + STATED_FREEDOM) / freedom), 1.0)
        result.append(NoiseScale(kind, len(at), scale, freedom, bool(measured)))
    return result


def chi2_words(squares: float, freedom: int) -> str:
    """Return a χ², its degrees of freedom and the probability of one as large, as text."""
    chance = max(float(chi2.sf(squares, freedom)), 1e-99)
    return f"χ² {squares:.3g} of {freedom} degree{'s' * (freedom != 1)} of freedom, probability {chance:.1g}"


def outliers(blocks: Sequence[ResidualBlock], scales: dict[str, float]) -> list[tuple[ResidualBlock, float]]:
    """Return the blocks that noise does not explain, farthest first, with their Mahalanobis distance."""
    robust = [block for block in blocks if block.kind in ROBUST_KINDS]
    squares = _distances(robust, scales)[0]
    chances = np.asarray(chi2.sf(squares, [len(block.r) for block in robust]))
    unlikely = chances < OUTLIER_CHANCE / max(len(robust), 1)
    return [(robust[i], math.sqrt(squares[i])) for i in np.argsort(-squares, kind="stable") if unlikely[i]]


# the search

#: Of reweighting in one search, and evaluations of the campaign in each round: most take one.
MAX_ROUNDS, MAX_EVALUATIONS = 25, 6
SMALL_DECREASE = 0.5  #: Relative decrease of the loss in a step that ends a round.
#: Decrease of the loss, half a χ², that ends a search: within a twentieth of a standard deviation of the minimum. The
#: rod's own tolerances, a micrometre and a millionth of the moment, make the loss uncertain by about as much.
MIN_GAIN = 1e-3
MAX_SCALE_ROUNDS = 4  #: Estimates of the noise scales from the residuals.
SETTLED = 0.02  #: Relative change of a noise scale below which it is settled.
#: Information that is added to each unknown, relative to its own: what nothing determines has a large covariance.
ROUNDING = 1e-13
#: Factors on E to start from: published values of one resin differ by two; 6 is for forces in a wrong unit.
START_FACTORS = (1.0, 0.7, 1.5, 0.45, 2.5, 6.0)
#: Largest F s²/(2 E I) of a load, the angle by which it would bend a rod of small deflection [rad] (assumed: far beyond
#: any test).
MAX_LOAD = 15.0
MAX_COMPARED = 6  #: Tests that the factors are compared by.


@dataclass(frozen=True)
class LeastSquaresProblem:
    """Tests, weighing and prior of one fit.

    Unknowns are the estimated entries of the parameter vector, then the nuisance parameters of each test.
    """

    common: CommonParameters  #: parameters that the tests share.
    tests: tuple[MeasuredTest, ...]  #: the tests.
    mass: MassMeasurement | None  #: the weighing; None if there was none.
    prior: Array  #: standard deviations of the parameter vector: infinite for requested parameters, 0 for fixed ones.
    left_out: frozenset[BlockKey] = frozenset()  #: readings that the fit does not use.

    @cached_property
    def active(self) -> Array:
        """Which entries of the parameter vector are estimated, (size,) of bool."""
        return np.asarray(self.prior > 0.0)

    @cached_property
    def n_active(self) -> int:
        """Number of estimated entries of the parameter vector."""
        return int(self.active.sum())

    @cached_property
    def nuisance_columns(self) -> dict[str, slice]:
        """Position of the nuisance parameters of each test among the unknowns, by its name."""
        ends = np.cumsum([self.n_active, *(test.nuisance_size for test in self.tests)]).tolist()
        return {test.name: slice(a, b) for test, a, b in zip(self.tests, ends, ends[1:], strict=False)}

    @property
    def size(self) -> int:
        """Number of all unknowns."""
        return self.n_active + sum(test.nuisance_size for test in self.tests)

    @property
    def with_poisson(self) -> bool:
        """Whether Poisson's ratio ties G to E; else G has its own prior."""
        return bool(np.isinf(self.prior[LOG_G]))

    @cached_property
    def bounds(self) -> Array:
        """Smallest and largest values of the unknowns, (2, size): the flank ends the arclength, and a stiffness is
        bounded as E is."""
        bounds = np.full((2, self.size), np.inf) * [[-1.0], [1.0]]
        bounds[:, : self.n_active] = self.common.bounds[:, self.active]
        for test in self.tests:
            of_test = bounds[:, self.nuisance_columns[test.name]]  # a view
            if "s" in test.nuisance:
                of_test[:, test.nuisance["s"]] = [[0.0], [self.common.model.rod.flank_end]]
            if "stiffness" in test.nuisance:
                of_test[:, test.nuisance["stiffness"]] = [[-MAX_LOGARITHM], [MAX_LOGARITHM]]
        return bounds


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

    def every_block(self) -> Iterator[ResidualBlock]:
        """Yield the residuals of all readings, those left out of the fit as well."""
        for test in self.tests:
            yield from test.blocks()
        if self.problem.mass is not None:
            yield self.problem.mass.block(self.values)
        if self.problem.with_poisson:
            yield poisson_block(self.values)

    def without(self, left_out: Set[BlockKey], columns: Sequence[int]) -> "Linearization":
        """Return it without some readings, and without prior knowledge of some entries of the parameter vector."""
        prior = self.problem.prior.copy()
        prior[list(columns)] = np.inf
        problem = replace(self.problem, prior=prior, left_out=self.problem.left_out | left_out)
        kept = tuple(block for block in self.blocks if block.key not in left_out)
        return replace(self, problem=problem, blocks=kept)

    @property
    def unknowns(self) -> Array:
        """Values of all unknowns, (size,)."""
        return np.concatenate([self.values.x[self.problem.active], *(test.nuisance for test in self.tests)])

    def at(self, unknowns: Array) -> "Linearization":
        """Return the campaign at other values of the unknowns; this one is the initial guess of the equilibria."""
        x = self.values.x.copy()
        x[self.problem.active] = unknowns[: self.problem.n_active]
        nuisance = [unknowns[self.problem.nuisance_columns[test.name]] for test in self.problem.tests]
        return linearize(self.problem, ParameterValues(self.problem.common, x), nuisance, self)

    @cached_property
    def prior_residual(self) -> Array:
        """Whitened deviation of the estimated entries from their prior, (n_active,)."""
        std = self.problem.prior[self.problem.active]
        return np.where(np.isinf(std), 0.0, self.values.x[self.problem.active] / std)

    @cached_property
    def starts(self) -> NDArray[np.intp]:
        """First row of each block, (n,)."""
        return np.cumsum([0, *(len(block.r) for block in self.blocks)], dtype=np.intp)[:-1]

    @cached_property
    def rows(self) -> tuple[Array, Array]:
        """Residuals with full weight, those of the priors last, (k,), and their derivatives by the unknowns, (k, n)."""
        problem, size = self.problem, self.problem.common.size
        r = np.concatenate([*(block.r for block in self.blocks), self.prior_residual])
        J, at = np.zeros((len(r), problem.size)), 0
        for block in self.blocks:
            end = at + len(block.r)
            J[at:end, : problem.n_active] = block.J[:, :size][:, problem.active]
            if block.test and block.J.shape[1] > size:
                J[at:end, problem.nuisance_columns[block.test]] = block.J[:, size:]
            at = end
        std = problem.prior[problem.active]
        J[at:, : problem.n_active] = np.diag(np.where(np.isinf(std), 0.0, 1.0 / std))
        return r, J

    def by_row(self, of_blocks: Array) -> Array:
        """Return a value of each block for each row, 1 for those of the priors, (k,)."""
        lengths = [len(block.r) for block in self.blocks]
        return np.concatenate([np.repeat(of_blocks, lengths), np.ones(self.problem.n_active)])

    def loss(self, scales: dict[str, float]) -> float:
        """Return what a fit minimises: the robust loss, half a χ² at full weight, and that of the priors."""
        squares, limit, _ = _distances(self.blocks, scales)
        robust = np.where(squares <= limit, squares, limit * (1.0 + np.log(np.maximum(squares / limit, 1.0))))
        return 0.5 * float(robust.sum() + self.prior_residual @ self.prior_residual)

    def movable(self, weight: Array) -> NDArray[np.bool_]:
        """Return which unknowns are within their bounds or are drawn away from the bound they are at, (size,)."""
        r, J = self.rows
        gradient, unknowns, (low, high) = J.T @ (self.by_row(weight) * r), self.unknowns, self.problem.bounds
        return np.asarray(~((unknowns <= low) & (gradient > 0.0) | (unknowns >= high) & (gradient < 0.0)))

    def expected_gain(self, weight: Array) -> float:
        """Return the decrease of the loss by a step within the bounds, by the linear model; infinite without a
        solution."""
        if not self.ok:
            return np.inf
        (r, J), movable = self.rows, self.movable(weight)
        N, unit = _scaled(self.information(weight)[np.ix_(movable, movable)])
        g = unit * (J.T @ (self.by_row(weight) * r))[movable]
        return float(0.5 * g @ cho_solve(cho_factor(N), g))

    # the information

    def information(self, weight: Array) -> Array:
        """Return the information on all unknowns with a weight of each block, (size, size)."""
        weighted = np.sqrt(self.by_row(weight))[:, None] * self.rows[1]
        return np.asarray(weighted.T @ weighted)  # of one matrix with itself: half the products

    def marginal(self, weight: Array, columns: Sequence[int]) -> Array:
        """Return the information on some unknowns, all others marginalised, (n, n)."""
        N, unit = _scaled(self.information(weight))
        kept, others = np.asarray(columns), np.setdiff1d(np.arange(len(N)), columns)
        across = N[np.ix_(others, kept)]
        left = N[np.ix_(kept, kept)] - across.T @ cho_solve(cho_factor(N[np.ix_(others, others)]), across)
        return np.asarray(left / np.outer(unit[kept], unit[kept]))


def _scaled(information: Array) -> tuple[Array, Array]:
    diagonal = np.diag(information)
    unit = 1.0 / np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0))
    return information * np.outer(unit, unit) + ROUNDING * np.eye(len(unit)), unit


def linearize(
    problem: LeastSquaresProblem,
    values: ParameterValues,
    nuisance: Sequence[Array],
    last: Linearization | None = None,
    every: bool = False,
) -> Linearization:
    """Solve every test at some parameter values, with its nuisance parameters.

    The equilibria of `last`, a neighbouring linearization, are the initial guesses. `every` asks for derivatives by
    parameters with a step although they are fixed.
    """
    rod, common = values.rod, problem.common
    stepped = [
        name
        for name, parameter in PARAMETERS.items()
        if parameter.step and parameter.apply is not None and (every or problem.active[parameter.columns][0])
        and parameter.apply(common.model, rod, parameter.step) is not rod
    ]  # fmt: skip
    solved: list[SolvedTest] = []
    for i, (test, of_test) in enumerate(zip(problem.tests, nuisance, strict=True)):
        solved.append(
            solve_test(test, values, of_test, last.tests[i] if last is not None and last.tests else None, stepped)
        )
        if not solved[-1].ok:
            return Linearization(problem, values, tuple(solved), ())
    point = Linearization(problem, values, tuple(solved), ())
    return replace(point, blocks=tuple(block for block in point.every_block() if block.key not in problem.left_out))


# the search


@dataclass(frozen=True)
class Fit:
    """Result of a search."""

    result: str  #: "ok" or "not_converged".
    point: Linearization  #: linearization where it ended.
    scales: dict[str, float]  #: noise scale of each kind over the stated noise.
    noise: tuple[NoiseScale, ...] = ()  #: how the scales were estimated.
    #: what the acceptance of a contradiction adds to `cov`; None where there is none.
    added_cov: Array | None = None

    @cached_property
    def weight(self) -> Array:
        """Weight of each block."""
        return weights(self.point.blocks, self.scales)

    @cached_property
    def cov_unknowns(self) -> Array:
        """Covariance of all unknowns, the inverse of their information, (size, size)."""
        N, unit = _scaled(self.point.information(self.weight))
        return np.asarray(cho_solve(cho_factor(N), np.eye(len(N))) * np.outer(unit, unit))

    @property
    def stated_cov(self) -> Array:
        """Covariance of the estimated entries of the parameter vector without `added_cov`, (n_active, n_active)."""
        n = self.point.problem.n_active
        return self.cov_unknowns[:n, :n]

    @property
    def cov(self) -> Array:
        """Covariance of the estimated entries of the parameter vector, (n_active, n_active)."""
        return self.stated_cov if self.added_cov is None else self.stated_cov + self.added_cov

    def absorbed(self, i: int) -> Array:
        """Return what the fit absorbs of the residuals of one block, its hat matrix, (k, k)."""
        start = self.point.starts[i]
        J = self.point.rows[1][start : start + len(self.point.blocks[i].r)]
        return np.asarray(self.weight[i] * J @ self.cov_unknowns @ J.T)

    @cached_property
    def leverage(self) -> Array:
        """Degrees of freedom of each block that the unknowns absorb, (n,)."""
        J = self.point.rows[1][: len(self.point.rows[1]) - self.point.problem.n_active]
        of_rows = np.sum((J @ self.cov_unknowns) * J, axis=1)
        return np.asarray(self.weight * np.add.reduceat(of_rows, self.point.starts))


def fit(start: Linearization) -> Fit:
    """Fit a campaign.

    At first the scale of each kind is that of the median of its distances; once that has converged it is estimated
    from the residuals and their degrees of freedom, and the search continues from there.
    """
    point, converged = minimise(start, None)
    result = Fit("ok" if converged else "not_converged", point, {})
    for _ in range(MAX_SCALE_ROUNDS):
        noise = noise_scales(point.blocks, result.weight, result.leverage, result.scales)
        scales = {estimated.kind: estimated.scale for estimated in noise}
        settled = all(abs(scales[kind] / result.scales.get(kind, np.inf) - 1.0) < SETTLED for kind in scales)
        if converged:  # of contradictory tests more steps change no more than the noise
            point, converged = minimise(point, scales)
        result = Fit("ok" if converged else "not_converged", point, scales, tuple(noise))
        if settled or not converged:
            break
    return result


def minimise(
    point: Linearization, scales: dict[str, float] | None, max_rounds: int = MAX_ROUNDS
) -> tuple[Linearization, bool]:
    """Minimise the robust loss: least squares with the weights of the last round, again and again.

    Args:
        point: to start from.
        scales: standard deviation of each kind of reading over the stated one; by the medians of each round if None.
        max_rounds: number of rounds.

    Returns:
        Where the search ended, and whether it converged.
    """
    for _ in range(max_rounds):
        weight = weights(point.blocks, median_scales(point.blocks) if scales is None else scales)
        gain = point.expected_gain(weight)
        if gain < MIN_GAIN:
            return point, True
        moved = _least_squares(point, weight)
        if moved is point:  # the loss is not exact enough to gain
            return point, gain < 10.0 * MIN_GAIN
        point = moved
    return point, False


def _least_squares(point: Linearization, weight: Array) -> Linearization:
    """Return where SciPy's search ends with given weights, after a step that gains little of what is left."""
    problem, accepted, root = point.problem, point, np.sqrt(point.by_row(weight))
    begin = np.clip(point.unknowns, *problem.bounds)
    tried = {begin.tobytes(): point if np.array_equal(begin, point.unknowns) else point.at(begin)}

    def solved(unknowns: Array) -> Linearization:
        key = unknowns.tobytes()
        if key not in tried:
            tried.clear()
            tried[key] = accepted.at(unknowns)
        return tried[key]

    def residuals(unknowns: Array) -> Array:
        at = solved(unknowns)
        return root * at.rows[0] if at.ok else np.full(len(root), np.nan)

    def jacobian(unknowns: Array) -> Array:
        nonlocal accepted
        accepted = solved(unknowns)
        return np.asarray(root[:, None] * accepted.rows[1])

    least_squares(residuals, begin, jacobian, Bounds(*problem.bounds), "dogbox", SMALL_DECREASE, None, None,
                  x_scale="jac", max_nfev=MAX_EVALUATIONS)  # fmt: skip
    return accepted


# starting values: a factor on E that explains the tests best, and each touch by its own reading


def start_point(problem: LeastSquaresProblem, free_E: bool) -> Linearization | None:
    """Return the linearization with the least loss over factors on E, or at the design's E; None without a solution.

    The factors are compared by tests that are spread over the campaign.
    """
    some, losses = replace(problem, tests=spread(problem.tests, MAX_COMPARED)), dict[float, float]()
    for factor in sorted(START_FACTORS, reverse=True) if free_E else ():
        point = start_at(some, factor)
        if not point.ok:  # a softer probe does not bear this either, and it takes long to find that out
            break
        losses[factor] = point.loss({})
    for factor in sorted(losses, key=lambda factor: losses[factor]) if free_E else (1.0,):
        point = start_at(problem, factor)
        if point.ok:
            return point
    return None


def spread(tests: Sequence[MeasuredTest], count: int) -> tuple[MeasuredTest, ...]:
    """Return at most `count` tests that are spread over the campaign."""
    n = len(tests)
    return tuple(tests[i] for i in np.unique(np.linspace(0, n - 1, min(n, count)).round().astype(int)))


def start_at(problem: LeastSquaresProblem, factor: float) -> Linearization:
    """Return the linearization at a factor on the design's E, each touch by its own reading."""
    x = np.zeros(problem.common.size)
    x[LOG_E] = np.log(factor)
    if problem.with_poisson:
        x[LOG_G] = x[LOG_E]  # as Poisson's ratio has it
    values = ParameterValues(problem.common, x)
    nuisance = start_nuisance(problem.tests, problem.common.model.rod)
    stiffness = values.rod.youngs_modulus * 0.25 * np.pi * float(values.rod.radius.max()) ** 4
    for test, of_test in zip(problem.tests, nuisance, strict=True):
        force = of_test[test.nuisance["force"]] if test.force_world is None else test.force_world
        s = of_test[test.nuisance["s"]][0] if "s" in test.nuisance else test.s_contact
        # no test bends the probe by more, and the solver takes long to find that out
        if not test.free and np.linalg.norm(force) * s**2 > 2.0 * MAX_LOAD * stiffness:
            return Linearization(problem, values, (), ())
    return linearize(problem, values, nuisance)


def solvable_tests(problem: LeastSquaresProblem, free_E: bool) -> tuple[list[MeasuredTest], list[MeasuredTest]]:
    """Split the tests into those with a stable equilibrium for some factor on E, and those without."""
    kept: list[MeasuredTest] = []
    lost: list[MeasuredTest] = []
    for test in problem.tests:
        alone = LeastSquaresProblem(problem.common, (test,), None, problem.prior)
        (lost if start_point(alone, free_E) is None else kept).append(test)
    return kept, lost


def start_nuisance(tests: Sequence[MeasuredTest], rod: Rod) -> list[Array]:
    """Return initial nuisance parameters of each test: a touch's force by its reading, its place by the lever, and the
    touched side opposite to the force."""
    result = []
    for test in tests:
        start, at = np.zeros(test.nuisance_size), test.nuisance
        if test.force_world is None:
            assert test.wrench_base is not None  # tests without are not used
            force = test.wrench_base[:3] - rod.mass * test.gravity_base
            start[at["force"]], start[at["angle"]] = force, np.arctan2(-force[1], -force[0])
        else:
            force = test.T_world_base[:3, :3].T @ test.force_world
        if "s" in at:
            start[at["s"]] = np.clip(_start_arclength(test, rod, force), 0.02 * rod.length, rod.flank_end)
        result.append(start)
    return result


def _start_arclength(test: MeasuredTest, rod: Rod, force: Array) -> float:
    """Return the stated arclength, else the distance of the touched point, else the lever of the force [m]."""
    if np.isfinite(test.s_contact):
        return test.s_contact
    if test.p_touch_world is not None:
        return float(np.linalg.norm(test.p_touch_world - test.T_world_base[:3, 3]))
    free = rod.solve(test.gravity_base)
    assert test.wrench_base is not None
    moment = test.wrench_base[3:] - (free.wrench_base[3:] if free.ok else 0.0)
    across = float(np.hypot(*force[:2]))
    return float(np.hypot(*moment[:2])) / across if across > 0.0 else 0.5 * rod.length
