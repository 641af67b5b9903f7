"""Likely causes of a contradiction: what would have to be different for the tests to agree.

Each cause is a model of its own that is fitted to the same tests: a mistake in the data folder is undone, a prior is
thirty times as wide, or a kind of reading scatters more. They are ranked by Laplace's approximation of their evidence,

    -ln p(data | model) ≈ loss + Σ ln s + Σ ln σ + ½ ln det N,

with the robust loss, the noise scales s of all readings, the standard deviations σ of the priors, and the information N
of all unknowns. The last three terms make a model pay for its freedom: a wide prior or a large scatter fits anything.
A noise scale that is estimated pays for its own freedom too, and a mistake for the number of those it was selected
from. That all readings scatter more, which fits anything, comes last where a particular cause explains the tests.
Source: D. J. C. MacKay, Information Theory, Inference, and Learning Algorithms, 2003, chapter 28.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np
from scipy.special import logsumexp
from scipy.stats import chi2

from probedesign.core.frames import Array
from probedesign.identification.fit_checks import DIMENSIONS, LABELS, PriorTest
from probedesign.identification.mistakes import exchanged, mistakes
from probedesign.identification.parameters import COMPONENTS, OWNER, PARAMETERS, PRINT
from probedesign.identification.residuals import MeasuredTest, ResidualBlock
from probedesign.identification.robust_loss import (
    READING_KINDS,
    REJECTION_CHANCE,
    ROBUST_KINDS,
    median_scales,
    outliers,
    weights,
)
from probedesign.identification.solver import Fit, LeastSquaresProblem, Linearization, linearize, minimise, reread
from probedesign.identification.starting_values import START_FACTORS, points_at, spread, start_nuisance

MAX_REFINED = 5
"""Mistakes, and priors, that are fitted; of other mistakes only the start of the search is compared."""
MAX_FIT_ITERATIONS = 8
MAX_LOADED, MAX_FREE, MAX_FACTORS = 6, 2, 3
"""Tests under load, free tests, and factors on E that models are compared with."""
SOFT_CHANCE = 0.01
"""Chance up to which a cause is listed."""
WRONG_PRIOR = 30.0
"""Factor on the standard deviation of a prior whose value is wrong: 6 mm or 6 degrees of a base known to 0.2
(assumed)."""
MAX_LOSS = 2.0
"""Loss over its median for normal noise up to which a mistake explains tests that have no equilibrium otherwise: noise
three times as large as stated (assumed)."""

MAX_SEEDS, MAX_PAIRS, MAX_OWN_STEPS = 4, 2, 4
"""Outlying tests whose readings may be exchanged with those of another test, pairs that are fitted, and steps of their
own unknowns."""
MIN_GAIN = 1.0
"""Logarithm of the odds from which on a cause is listed (assumed)."""
MAX_SCALE = 1000.0
"""Largest noise scale: its prior is uniform in the logarithm up to it (assumed; the factor between units)."""


@dataclass(frozen=True)
class LikelyCause:
    """A likely cause of a contradiction."""

    name: str  #: sign, unit, mount, camera, marker, probe, friction, stiffness, or the prior's name.
    words: str  #: what is likely wrong, and what to check.
    evidence: str  #: the number that speaks for it.
    gain: float  #: logarithm of its odds against the tests and priors as stated.
    explains: bool = False  #: whether the tests agree with it.
    #: what it changes of each number: relative for a modulus, a density and diameters, in m or rad for a pose.
    moves: dict[str, float] = field(default_factory=dict)

    def __str__(self) -> str:
        return f"{self.words} ({self.evidence})"


@dataclass(frozen=True)
class WidenedFit(Fit):
    """A fit of contradictory tests that the user accepted, with a larger covariance.

    The covariance is multiplied by the square of the Birge ratio, the RMS of all residuals with their robust weights,
    and the spread of the answers is added: the mean square by which the likely causes move the numbers, weighted by
    their probabilities. No standard deviation exceeds that of the prior.
    Sources: R. T. Birge, Phys. Rev. 40, 1932, 207; J. A. Hoeting and others, Statistical Science 14, 1999, 382.
    """

    stated: Fit  #: the fit.
    widened: Array  #: its covariance, larger, (n_active, n_active).

    @property
    def cov(self) -> Array:
        """Covariance of the estimated entries of the parameter vector, (n_active, n_active)."""
        return self.widened


def widened(fit: Fit, causes: Sequence["LikelyCause"]) -> WidenedFit:
    """Return a contradictory fit with the covariance that its residuals and its likely causes ask for."""
    problem = fit.point.problem
    active = np.flatnonzero(problem.active)
    cov = max(birge_ratio(fit), 1.0) ** 2 * fit.cov
    gains = np.array([0.0, *(one.gain for one in causes)])
    shares = np.exp(gains - logsumexp(gains))[1:]
    for share, cause in zip(shares, causes, strict=True):
        move = np.array([cause.moves.get(COMPONENTS[c], 0.0) if c < PRINT else 0.0 for c in active])
        cov = cov + share * np.outer(move, move)
    size = np.maximum(np.sqrt(np.diag(cov)) / problem.prior[active], 1.0)
    return WidenedFit(fit.result, fit.point, fit.scales, fit.noise, fit.iterations, fit, cov / np.outer(size, size))


def birge_ratio(fit: Fit) -> float:
    """Return the RMS of all residuals and priors with their robust weights and noise scales; 1 for those as stated."""
    point = fit.point
    squares = float(point.prior_residual @ point.prior_residual)
    freedom = float(np.isfinite(point.problem.prior[point.problem.active]).sum()) - point.problem.size
    for block, weight in zip(point.blocks, fit.weight, strict=True):
        scale = fit.scales.get(block.kind, 1.0) if block.kind in ROBUST_KINDS else 1.0
        squares += weight * block.squared_distance
        freedom += weight * scale**2 * len(block.r)
    return float(np.sqrt(squares / max(freedom, 1.0)))


def likely_causes(fit: Fit, priors: Sequence[PriorTest]) -> tuple[LikelyCause, ...]:
    """Return what may explain a contradiction, the likeliest first.

    Args:
        fit: of the contradictory tests.
        priors: tests of the priors against the rest of the data.
    """
    off = _outlying(fit)
    seeds = off[:MAX_SEEDS]
    # two exchanged tests do not make most others outlying; a fit to a wrong unit has slow equilibria besides
    few = 2 * len(off) <= len(fit.point.problem.tests)
    pairs = [pair for pair, _, _ in _exchangeable(fit.point, seeds)] if few else []
    wanted = {name for pair in pairs for name in pair} | set(seeds)
    wanted |= {test.name for test in _some(fit.point.problem.tests)}
    solved = [test for test in fit.point.tests if test.measured.name in wanted]
    problem = replace(fit.point.problem, tests=tuple(test.measured for test in solved))
    point = linearize(problem, fit.point.values, [test.nuisance for test in solved])
    if not point.ok:
        return ()
    stated = _refined(problem, point)
    particular = [*_mistakes(problem, stated, pairs), *_wrong_priors(stated, priors), *_scatter(stated, fit)]
    particular = sorted((one for one in particular if one.gain > MIN_GAIN), key=lambda one: -one.gain)
    other = _other_probe(stated)
    if other.gain <= MIN_GAIN:
        return tuple(particular)
    if any(one.explains for one in particular):
        return (*particular, other)
    return tuple(sorted([*particular, other], key=lambda one: -one.gain))


def explaining_mistakes(problem: LeastSquaresProblem) -> tuple[LikelyCause, ...]:
    """Return mistakes without which the rod has an equilibrium in tests that have none as they are, the likeliest
    first."""
    some = replace(problem, tests=_some(problem.tests))
    return tuple(sorted(_mistakes(some, None), key=lambda one: -one.gain))


def _outlying(fit: Fit) -> list[str]:
    """Return the tests with outlying readings, the farthest first."""
    return list(dict.fromkeys(block.test for block, _ in outliers(fit.point.blocks, fit.scales)))


def exchange_hints(point: Linearization, seeds: Sequence[str]) -> list[str]:
    """Return a note if an exchange of the readings of two tests, one of `seeds` among them, explains what is off."""
    common, tests = point.problem.common, {test.name: test for test in point.problem.tests}
    for (a, b), _, _ in _exchangeable(point, seeds[:MAX_SEEDS])[:1]:
        pair = dict(zip((a, b), exchanged(common, tests[a], tests[b]), strict=True))
        problem = replace(point.problem, tests=tuple(pair.get(name, test) for name, test in tests.items()))
        nuisance = [
            start_nuisance((pair[one.measured.name],), point.values.rod)[0]
            if one.measured.name in pair
            else one.nuisance
            for one in point.tests
        ]
        start = linearize(problem, point.values, nuisance)
        if not start.ok:
            continue
        stated, other = (minimise(one.problem, one, {}, MAX_FIT_ITERATIONS)[0] for one in (point, start))
        gain = _cost(stated) - _cost(other) - np.log(len(tests) * (len(tests) - 1) / 2)
        if gain > -np.log(REJECTION_CHANCE):
            return [f"{a} and {b}: their readings may be exchanged: χ² of {len(tests)} tests falls from "
                    f"{2.0 * stated.loss({}):.4g} to {2.0 * other.loss({}):.4g} that way; check wrenches.csv, or their "
                    "places in tests.csv"]  # fmt: skip
    return []


def _exchangeable(point: Linearization, seeds: Sequence[str]) -> list[tuple[tuple[str, str], float, float]]:
    """Return the pairs of tests, one of them outlying, that agree best with the fit after an exchange of readings, and
    the χ² of both before and after it.

    Only the unknowns of the two tests are fitted to them: by one linear step to select the pairs, then by more.
    """
    common, tests = point.problem.common, {test.name: test for test in point.problem.tests}
    before = dict.fromkeys(tests, 0.0)
    for block in point.blocks:
        if block.test:
            before[block.test] += block.squared_distance
    found = list[tuple[tuple[str, str], float, float]]()
    for a, b in combinations((name for name, test in tests.items() if test.wrench_base is not None), 2):
        if a not in seeds and b not in seeds:
            continue
        pair = exchanged(common, tests[a], tests[b])
        found.append(((a, b), before[a] + before[b], sum(_own_loss(point, one, 1) for one in pair)))
    found.sort(key=lambda one: one[2] - one[1])
    refined = []
    for (a, b), now, _ in found[:MAX_PAIRS]:
        after = sum(_own_loss(point, one, MAX_OWN_STEPS) for one in exchanged(common, tests[a], tests[b]))
        if after < now:
            refined.append(((a, b), now, after))
    return sorted(refined, key=lambda one: one[2] - one[1])


def _own_loss(point: Linearization, test: MeasuredTest, steps: int) -> float:
    """Return the χ² of one test at the common parameters of a fit, after linear steps of its own unknowns; infinite
    without an equilibrium."""
    problem = replace(point.problem, tests=(test,), mass=None)
    nuisance, bounds = start_nuisance((test,), point.values.rod)[0], problem.nuisance_bounds[0]
    loss, last = np.inf, None
    for _ in range(steps):
        last = linearize(problem, point.values, [nuisance], last)
        if not last.ok:
            break
        blocks = [block for block in last.blocks if block.test == test.name]
        r, B = np.concatenate([one.r for one in blocks]), np.concatenate([one.J_nuisance for one in blocks])
        size = np.maximum(np.linalg.norm(B, axis=0), 1e-300)
        step = -np.linalg.lstsq(B / size, r, rcond=None)[0] / size if B.shape[1] else nuisance
        loss, nuisance = float(np.sum((r + B @ step) ** 2)), np.clip(nuisance + step, *bounds)
    return loss


def _some(tests: Sequence[MeasuredTest]) -> tuple[MeasuredTest, ...]:
    """Return tests that are spread over the campaign, most of them loaded: a mistake of the whole folder is in all."""
    loaded, free = [one for one in tests if not one.free], [one for one in tests if one.free]
    chosen = {one.name for one in (*spread(loaded, MAX_LOADED), *spread(free, MAX_FREE))}
    return tuple(one for one in tests if one.name in chosen)


def _cost(point: Linearization, scales: dict[str, float] | None = None) -> float:
    """Return minus the logarithm of the evidence, up to a constant of all models."""
    scales = scales or {}
    std = point.problem.prior[point.problem.active]
    noise = sum(len(one.r) * np.log(scales.get(one.kind, 1.0)) for one in point.blocks if one.kind in ROBUST_KINDS)
    volume = point.normal_equations(weights(point.blocks, scales)).log_volume
    freedom = sum(_price(point.blocks, kind) for kind, scale in scales.items() if scale > 1.0)
    return float(point.loss(scales) + noise + np.log(std[np.isfinite(std)]).sum() + volume + freedom)


def _price(blocks: Sequence[ResidualBlock], kind: str) -> float:
    """Return what an estimated noise scale costs: the logarithm of its prior's width over that of its posterior, which
    is 1/√(2n) in the logarithm of the scale for n residuals."""
    n = sum(len(one.r) for one in blocks if one.kind == kind)
    return float(np.log(np.log(MAX_SCALE)) + 0.5 * np.log(max(2 * n, 1)))


def _agrees(point: Linearization, scales: dict[str, float] | None = None) -> bool:
    """Return whether the residuals are within `MAX_LOSS` of normal noise."""
    expected = 0.5 * sum(chi2.median(len(block.r)) for block in point.blocks)
    return bool(point.loss(scales or {}) < MAX_LOSS * expected)


def _moves(point: Linearization, stated: Linearization) -> dict[str, float]:
    """Return what a cause changes of the requested numbers and of those that E implies."""
    change = point.values.x - stated.values.x
    return {COMPONENTS[c]: float(change[c]) for c in range(PRINT)
            if OWNER[c].max_std is not None and stated.problem.active[c]}  # fmt: skip


def _refined(problem: LeastSquaresProblem, point: Linearization) -> Linearization:
    """Return the fit with the stated noise, after a search that gross errors disturb less."""
    point = minimise(problem, point, None, MAX_FIT_ITERATIONS)[0]
    return minimise(problem, point, {}, MAX_FIT_ITERATIONS)[0]


def _wrong_priors(stated: Linearization, priors: Sequence[PriorTest]) -> Iterator[LikelyCause]:
    """Yield priors and single readings whose value is wrong."""
    for one in [one for one in priors if one.chance < SOFT_CHANCE][:MAX_REFINED]:
        gain, agrees, moves = one.gain, False, dict[str, float]()
        if one.columns:
            prior = stated.problem.prior.copy()
            prior[list(one.columns)] *= WRONG_PRIOR
            problem = replace(stated.problem, prior=prior)
            start = Linearization(problem, stated.values, stated.tests, stated.blocks)
            point = minimise(problem, start, {}, MAX_FIT_ITERATIONS)[0]
            gain, agrees, moves = _cost(stated) - _cost(point), _agrees(point), _moves(point, stated)
        name = "probe" if one.label == DIMENSIONS else one.label
        words = f"{one.label}: check {one.source}"
        if gain > 0.0:
            evidence = f"{one.deviation:.3g} standard deviations from the rest"
            yield LikelyCause(name, words, evidence, gain, agrees, moves)


def _scatter(stated: Linearization, fit: Fit) -> Iterator[LikelyCause]:
    """Yield stiffness and friction that scatter more than stated."""
    for scale in fit.noise:
        words = {
            "stiffness": "creep or rests between tests: the stiffness differs from test to test",
            "friction": "friction: larger than friction in [contact]",
        }.get(scale.kind)
        if scale.measured and words:
            scales = {scale.kind: scale.scale}
            point = minimise(stated.problem, stated, scales, MAX_FIT_ITERATIONS)[0]
            gain = _cost(stated) - _cost(point, scales)
            evidence = f"{scale.scale:.2g} times as large as stated"
            agrees = _agrees(point, scales)
            yield LikelyCause(scale.kind, words, evidence, gain, agrees, _moves(point, stated))


def _other_probe(stated: Linearization) -> LikelyCause:
    """Return that all kinds of reading scatter more than stated, as with another probe."""
    point = minimise(stated.problem, stated, None, MAX_FIT_ITERATIONS)[0]
    scales = median_scales(point.blocks)
    worst = max(READING_KINDS, key=lambda kind: scales.get(kind, 0.0))
    return LikelyCause(
        "probe", "another probe than the design's, or a mistake that is not listed here: check probe and fingerprint "
        "in campaign.toml, and the diameters of the print",
        f"{LABELS[worst]} scatter {scales.get(worst, 1.0):.2g} times as much as stated",
        _cost(stated) - _cost(point, scales), _agrees(point, scales), _moves(point, stated),
    )  # fmt: skip


def _mistakes(
    problem: LeastSquaresProblem, stated: Linearization | None, pairs: Sequence[tuple[str, str]] = ()
) -> Iterator[LikelyCause]:
    """Yield mistakes in the data that the tests speak for; without a fit of the tests as stated, those that explain
    all readings."""
    prior = problem.prior.copy()
    prior[PARAMETERS["root"].columns] = 0.0  # its derivatives are half of the time
    rough = replace(problem, prior=prior)
    starts = _starts(rough)
    tried = []
    for mistake in mistakes(problem.common, problem.tests, pairs):
        tests = tuple(mistake.change(test) for test in problem.tests)
        if all(_same_load(a, b) for a, b in zip(tests, problem.tests, strict=True)):
            others = [reread(one, tests) for one in starts]
        else:
            others = _starts(replace(rough, tests=tests))
        if others:
            start = min(others, key=lambda one: one.loss({}))
            tried.append((start.loss({}), mistake, start))
    tried.sort(key=lambda one: one[0])
    margin = 0.5 * chi2.isf(SOFT_CHANCE / max(len(tried), 1), 1)
    for _, (name, words, _, choices), start in tried[:MAX_REFINED]:
        whole = replace(problem, tests=start.problem.tests)
        point = linearize(whole, start.values, [test.nuisance for test in start.tests], start)
        if not point.ok:
            continue
        point = _refined(whole, point)
        loss, n, agrees = point.loss({}), len(whole.tests), _agrees(point)
        if stated is None:
            if agrees:
                evidence = f"χ² of {n} tests is {2.0 * loss:.4g}, and else they have no equilibrium"
                yield LikelyCause(name, words, evidence, -_cost(point), agrees)
        elif (gain := _cost(stated) - _cost(point) - np.log(choices)) > margin:
            evidence = f"χ² of {n} tests falls from {2.0 * stated.loss({}):.4g} to {2.0 * loss:.4g}"
            yield LikelyCause(name, words, evidence, float(gain), agrees, _moves(point, stated))


def _starts(problem: LeastSquaresProblem) -> list[Linearization]:
    """Return the starts of a search with each factor on E for which the rod has an equilibrium."""
    return [point for _, point in points_at(problem, START_FACTORS[:MAX_FACTORS])]


def _same_load(a: MeasuredTest, b: MeasuredTest) -> bool:
    """Return whether two tests differ in what the reference measured alone, so that the rod is in the same state."""
    return a.wrench_base is b.wrench_base and a.force_world is b.force_world and a.T_world_base is b.T_world_base
