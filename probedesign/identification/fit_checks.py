"""Checks of a fit: what the tests do not determine (observability), whether they contradict model or priors, and why.

A robust fit may leave out a whole kind of reading and fit the rest well, so the number of outliers is tested. Priors
and single readings have full weight; each is tested against the rest: with r its residuals over their standard
deviations and V = I - J C Jᵀ the share of their unit variance that the fit leaves, d² = rᵀ V⁻¹ r is χ². The cause of a
contradiction is sought in a table of hypotheses, each of which undoes a mistake in the data or widens a prior. See
docs/identification.md.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binom, chi2

from probedesign.core.frames import Array
from probedesign.identification.parameters import (
    CHANNELS,
    COMPONENTS,
    DIAMETERS,
    OWNER,
    PARAMETERS,
    PRINT,
    CommonParameters,
    columns_of,
)
from probedesign.identification.residuals import CREEP, BlockKey, MeasuredTest, ResidualBlock
from probedesign.identification.solver import (
    READING_KINDS,
    REJECTION_CHANCE,
    Fit,
    Linearization,
    chi2_words,
    fit,
    linearize,
    minimise,
    outliers,
    spread,
    start_at,
    start_nuisance,
    weights,
)

MIN_SHARE = 0.2  #: Component of a unit direction from which on a parameter takes part in what cannot be separated.
#: Usual fraction of gross errors. Source: F. Hampel et al., Robust Statistics, 1986: 1 to 10 % in routine data. Far
#: below one half, the breakdown point of the median, which the search starts with.
GROSS_ERROR_RATE = 0.05
#: Largest move of a requested number, in its standard deviations, and largest growth of that deviation when what
#: contradicts the rest is left out, and how often something is. A normal error that is off by half a standard deviation
#: is in its 95 % interval in 92 %; what more than halves the information is no side issue (assumed).
MAX_MOVE, MAX_GROWTH, MAX_CONTRADICTIONS = 0.5, 1.4, 3
#: Residuals of readings over the scatter of these readings from test to test, both RMS, from which on a fit does not
#: explain them: it then accounts for less than three quarters of their variance (assumed).
MAX_UNEXPLAINED = 0.5
#: Fraction of its variance that a residual must keep to be tested: below it the other readings do not check it.
MIN_REDUNDANCY = 0.02
LABELS = {"markers": "markers", "wrenches": "wrenches", "touches": "touched places", "places": "arclengths of loads",
          "weights": "known loads", "stiffness": "stiffnesses of tests", "friction": "frictions"}  # fmt: skip
#: What to check in the data folder, by kind of reading.
CHECKS = {
    "markers": "their unit and numbers, and s_mm, side_deg and the base's rotation in campaign.toml",
    "wrenches": "the units and the frame of their columns, and the base's rotation in campaign.toml",
    "touches": "the unit of the contact columns, and the base's rotation in campaign.toml",
    "places": "s_contact_mm and std_s_mm",
    "weights": "the known forces and their unit",
}
DIMENSIONS = "dimensions as designed"  #: Label of the prior on the print's dimensions.
#: Kinds of readings that have full weight: what they are, and what to check.
SINGLE_READINGS = {
    "sags": ("the sag of {}", "tip_sag_mm: its sign, its unit and std_sag_mm"),
    "scales": ("the weighing", "mass_g, std_g and of in campaign.toml"),
    "poisson": ("Poisson's ratio", "the diameters of the print, and whether it is solid"),
}


# observability


class UnobservableDirection(NamedTuple):
    """A combination of requested parameters that the tests do not determine."""

    name: str  #: of the parameter that is left at the design value for it.
    description: str  #: what is not observable, and what is instead.


def unobservable_direction(
    point: Linearization, weight: Array, requested: Sequence[str], tolerance: float = 1.0
) -> UnobservableDirection | None:
    """Return the least observable direction of the requested parameters if it exceeds their limits.

    The limits are `Parameter.max_std`, over `tolerance`.
    """
    columns = columns_of(requested)
    limits = np.array([PARAMETERS[name].max_std for name in requested for _ in PARAMETERS[name].labels], dtype=float)
    positions = np.searchsorted(np.flatnonzero(point.problem.active), columns)
    squares, vectors = np.linalg.eigh(point.marginal(weight, positions.tolist()) * np.outer(limits, limits))
    size, weakest = float(np.sqrt(max(squares[0], 0.0))), vectors[:, 0]
    if size * tolerance >= 1.0:
        return None
    direction = weakest * limits  # in units of the parameters
    first = {OWNER[column].name: i for i, column in reversed(list(enumerate(columns)))}
    part = [
        name
        for name in requested
        if max(abs(w) for w, c in zip(weakest, columns, strict=True) if OWNER[c].name == name) > MIN_SHARE
    ]
    if len(part) == 1:
        parameter, std = PARAMETERS[part[0]], float(np.linalg.norm(direction)) / max(size, 1e-12)
        assert parameter.max_std is not None
        text = (f"{part[0]}: weakly observable in these tests; its standard deviation would be "
                f"{parameter.format_std(std)} (limit {parameter.format_std(parameter.max_std)})")  # fmt: skip
    elif len(part) == 2 and all(PARAMETERS[name].logarithm for name in part):
        kept, fixed = part
        power = -float(direction[first[kept]] / direction[first[fixed]])
        exponent = "" if abs(abs(power) - 1.0) < 0.05 else f"^{abs(power):.1f}".removesuffix(".0")
        text = f"{kept} and {fixed}: these tests determine only {kept}{'/' if power < 0.0 else '·'}{fixed}{exponent}"
    else:
        text = f"{', '.join(part[:-1])} and {part[-1]}: these tests cannot separate them"
    return UnobservableDirection(part[-1], text)


def conditional_estimate(fit: Fit, column: int) -> tuple[float, float, float | None]:
    """Return an entry of the parameter vector given the design's dimensions: value, standard deviation, by diameter.

    The last is the derivative by the logarithm of the base diameter, where the tolerances let all diameters differ
    together, or one factor on them was requested; None where neither is estimated. The diameters are not conditioned.
    """
    active = np.flatnonzero(fit.point.problem.active)
    x, cov, i = fit.point.values.x[active], fit.cov, int(np.searchsorted(active, column))
    given = np.flatnonzero((active == DIAMETERS) | _of_print(fit, active))
    if column == DIAMETERS or not len(given):
        return float(x[i]), float(np.sqrt(cov[i, i])), None
    gain = np.linalg.solve(cov[np.ix_(given, given)], cov[given, i])
    variance = cov[i, i] - gain @ cov[given, i]
    common, first = fit.point.problem.common, int(active[given[0]])
    # what a unit of the first dimension changes in the logarithm of the base diameter, if it is of all diameters
    base = 1.0 if first == DIAMETERS else None
    if first == PRINT and max(common.tolerances.diameter_mm, common.tolerances.diameter_share) > 0.0:
        base = float(common.print_modes[0, 0])
    by_diameter = None if base is None else float(gain[0] / base)
    return float(x[i] - gain @ x[given]), float(np.sqrt(variance)), by_diameter


def _of_print(fit: Fit, columns: NDArray[np.intp]) -> NDArray[np.bool_]:
    modes = fit.point.problem.common.print_columns
    return np.asarray((modes.start <= columns) & (columns < modes.stop))


def cov_conditional(fit: Fit, columns: Sequence[int]) -> Array:
    """Return the covariance of some entries of the parameter vector given the print's dimensions, (n, n)."""
    active = np.flatnonzero(fit.point.problem.active)
    at, given = np.searchsorted(active, columns), np.flatnonzero(_of_print(fit, active))
    across = fit.cov[np.ix_(at, given)]
    return np.asarray(fit.cov[np.ix_(at, at)] - across @ np.linalg.solve(fit.cov[np.ix_(given, given)], across.T))


# consistency


class OutlierCount(NamedTuple):
    """Outliers among some readings."""

    readings: int  #: number of all.
    outliers: int  #: readings that noise does not explain.
    farthest: float = 0.0  #: largest distance of an outlier, in standard deviations.
    freedom: int = 0  #: number of values of that outlier.

    @property
    def majority(self) -> bool:
        """Whether more than half are outliers, so that the median is one too."""
        return 2 * self.outliers > self.readings

    @property
    def too_many(self) -> bool:
        """Whether gross errors make this number of outliers with a chance below 0.001, or outliers are a majority."""
        chance = float(binom.sf(self.outliers - 1, self.readings, GROSS_ERROR_RATE))
        return self.majority or chance < REJECTION_CHANCE

    def __str__(self) -> str:
        farthest = chi2_words(self.farthest**2, self.freedom)
        return f"{self.outliers} of {self.readings} are outliers with little weight, the farthest with {farthest}"


class Contradiction(NamedTuple):
    """Readings, or prior knowledge, that contradict the design or the rest of the data."""

    label: str  #: what contradicts.
    words: str  #: by how much, and what to check.
    #: readings, columns: readings, and entries of the parameter vector by their prior, that may be left out; none where
    #: a whole kind of readings contradicts the design.
    readings: frozenset[BlockKey] = frozenset()
    columns: tuple[int, ...] = ()
    chance: float = 0.0  #: of so large a deviation.

    def __str__(self) -> str:
        return f"{self.label}: {self.words}"


def inconsistency(fit: Fit) -> Contradiction | None:
    """Return which readings contradict the design, or each other; None if there are none.

    Noise alone is no contradiction, however large: its scale is estimated.
    """
    blocks, far = fit.point.blocks, outliers(fit.point.blocks, fit.scales)
    bad = bad_tests(blocks, far)
    named = ", ".join(bad[:3]) + (f" and {len(bad) - 3} more" if len(bad) > 3 else "")
    if kinds := {kind: n for kind in READING_KINDS if (n := _count(blocks, far, kind)).too_many}:
        kind, n = max(kinds.items(), key=lambda pair: (pair[1].outliers / pair[1].readings, pair[1].farthest))
        mostly = f", especially in {named}" if bad else ""
        return Contradiction(LABELS[kind], f"{n}; check {CHECKS[kind]}{mostly}")
    if bad:
        text = (f"{_count(blocks, far, test=bad[0])}; check the known force and s_contact_mm, the marker numbers, the "
                 "wrench and the base pose, or leave it out")  # fmt: skip
        readings = frozenset(block.key for block in blocks if block.test in bad and block.kind in READING_KINDS)
        return Contradiction(f"readings of {named}", text, readings)
    if (every := _count(blocks, far)).too_many:
        return Contradiction("readings of all kinds", f"{every}; check units and the base's rotation in campaign.toml")
    for noise in fit.noise:
        if noise.measured and noise.kind in CHECKS and (share := _unexplained(fit.point, noise.kind)) > MAX_UNEXPLAINED:
            text = f"{share:.0%} of their RMS scatter is not explained by the probe as designed"
            return Contradiction(LABELS[noise.kind], f"{text}; check {CHECKS[noise.kind]}")
    return None


def _unexplained(point: Linearization, kind: str) -> float:
    """Return the residuals of a kind over the scatter of its readings from test to test, both RMS; the larger of
    forces and moments; 0 if fewer than three tests have them."""
    of = {test.name: test for test in point.problem.tests}
    pairs: dict[int, list[Array]] = {}  # reading and residual by the number of the marker
    for block in (block for block in point.blocks if block.kind == kind and kind in ("markers", "wrenches", "touches")):
        test = of[block.test]
        reading = test.p_touch_world if kind == "touches" else test.wrench_base
        if kind == "markers":
            reading = test.p_markers_world[test.marker_numbers.index(block.item)]
        assert reading is not None
        pairs.setdefault(block.item, []).append(np.reshape(np.stack([reading, block.residual]), (2, -1, 3)))
    stacks = [np.stack(group) for group in pairs.values() if len(group) >= 3]  # (tests, 2, forces and moments, 3)
    if not stacks:
        return 0.0
    scatter = np.sum([np.sum((stack[:, 0] - stack[:, 0].mean(axis=0)) ** 2, axis=(0, 2)) for stack in stacks], axis=0)
    residual = np.sum([np.sum(stack[:, 1] ** 2, axis=(0, 2)) for stack in stacks], axis=0)
    return float(np.sqrt(np.max(residual / np.maximum(scatter, 1e-300))))


def outlier_notes(blocks: Sequence[ResidualBlock], outliers: Sequence[tuple[ResidualBlock, float]]) -> list[str]:
    """Return a line for each kind of reading with more outliers than usual."""
    counts = {kind: _count(blocks, outliers, kind) for kind in READING_KINDS}
    return [f"{LABELS[kind]}: {n}" for kind, n in counts.items() if n.outliers > GROSS_ERROR_RATE * n.readings]


def bad_tests(blocks: Sequence[ResidualBlock], outliers: Sequence[tuple[ResidualBlock, float]]) -> list[str]:
    """Return tests with more than one outlier that are the majority of its readings."""
    counts = {block.test: _count(blocks, outliers, test=block.test) for block, _ in outliers}
    return [test for test, n in counts.items() if n.outliers > 1 and n.majority]


def _count(
    blocks: Sequence[ResidualBlock], outliers: Sequence[tuple[ResidualBlock, float]], kind: str = "", test: str = ""
) -> OutlierCount:
    def chosen(block: ResidualBlock) -> bool:
        return block.kind in READING_KINDS and kind in ("", block.kind) and test in ("", block.test)

    far = [(distance, len(block.r)) for block, distance in outliers if chosen(block)]
    return OutlierCount(sum(map(chosen, blocks)), len(far), *max(far, default=(0.0, 0)))


def check_priors(fit: Fit) -> list[Contradiction]:
    """Return the priors and single readings that the rest of the data reject, the least probable first."""
    point, common = fit.point, fit.point.problem.common
    active, modes = np.flatnonzero(point.problem.active), range(common.size)
    std = point.problem.prior[active]
    groups: dict[tuple[str, str], list[int]] = {}
    for parameter in PARAMETERS.values():
        if parameter.prior_name:
            groups.setdefault((parameter.prior_name, parameter.prior_source), []).extend(columns_of([parameter.name]))
    groups[DIMENSIONS, "what was printed: measure it, or increase the tolerances"] = [*modes[common.print_columns]]
    groups["drift of the sensor", "whether it was warm and whether it was zeroed between tests; and walk_steps"] = [
        *modes[common.print_columns.stop :]
    ]
    # label and source, residuals, their variance that the fit leaves, and what may be left out
    cases: list[tuple[str, str, Array, Array, frozenset[BlockKey], tuple[int, ...]]] = []
    for (label, source), columns in groups.items():
        at = np.flatnonzero(np.isin(active, columns) & np.isfinite(std))
        left = np.eye(len(at)) - fit.cov[np.ix_(at, at)] / np.outer(std[at], std[at])
        cases.append((label, source, point.prior_residual[at], left, frozenset(), tuple(active[at].tolist())))
    for i, block in enumerate(point.blocks):
        if block.kind in SINGLE_READINGS:
            label, source = SINGLE_READINGS[block.kind]
            left = np.eye(len(block.r)) - fit.absorbed(i)
            cases.append((label.format(block.test), source, block.r, left, frozenset([block.key]), ()))
    tests = []
    for label, source, r, left, readings, concerned in cases:
        sizes, directions = np.linalg.eigh(0.5 * (left + left.T))
        checked = sizes > MIN_REDUNDANCY  # directions that the rest of the data check
        if checked.any():
            squares, freedom = float(np.sum((directions.T @ r)[checked] ** 2 / sizes[checked])), int(checked.sum())
            text = f"what is stated deviates from the rest of the data: {chi2_words(squares, freedom)}; check {source}"
            tests.append(Contradiction(label, text, readings, concerned, float(chi2.sf(squares, freedom))))
    return sorted((test for test in tests if test.chance < REJECTION_CHANCE / len(tests)), key=lambda test: test.chance)


def contradictions(fit: Fit) -> list[Contradiction]:
    """Return which readings, else which priors and single readings, contradict the rest, the clearest first."""
    return [first] if (first := inconsistency(fit)) else check_priors(fit)


def reconciled(fitted: Fit, names: Sequence[str]) -> tuple[Fit, tuple[str, ...]] | None:
    """Return a fit without the readings and priors that contradict the rest, and a warning for each.

    What contradicts most is left out first, at most `MAX_CONTRADICTIONS` times. Of two that contradict each other
    either may be wrong, so each is left out by itself. None where one of the requested numbers, `names`, moves without
    it by more than `MAX_MOVE` of its standard deviation, or that deviation grows by more than `MAX_GROWTH`, or where a
    whole kind of readings or the dimensions that it is conditional on contradict the rest.
    """
    now, warnings = fitted, list[str]()
    before = {column: conditional_estimate(fitted, column)[:2] for column in columns_of(names)}
    while rejected := contradictions(now):
        final = any(each.label == DIMENSIONS or not (each.readings or each.columns) for each in rejected)
        if final or len(warnings) == MAX_CONTRADICTIONS:
            return None
        farthest, without = 0.0, [fit(now.point.without(each.readings, each.columns)) for each in rejected]
        for (column, (value, std)), other in product(before.items(), without):
            after, grown, _ = conditional_estimate(other, column)
            far = abs(after - value) / std
            if not (far <= MAX_MOVE and grown <= MAX_GROWTH * std):
                return None
            farthest = max(farthest, far)
        now = without[0]
        warnings.append(f"warning: {rejected[0]}; left out, which moves {', '.join(names)} by up to {farthest:.2g} "
                        "standard deviations")  # fmt: skip
    return (now, tuple(warnings)) if now.result == "ok" else None


def widened(fit: Fit, moves: Mapping[str, float]) -> Fit:
    """Return a fit of contradictory tests that the user accepted, with a larger covariance.

    The covariance is multiplied by the square of the Birge ratio, the RMS of all residuals with their robust weights,
    and the squares of what the likely cause changes are added: `moves` of the components of the parameter vector. No
    standard deviation exceeds that of the prior. Source: R. T. Birge, Phys. Rev. 40, 1932, 207.
    """
    point, problem = fit.point, fit.point.problem
    active = np.flatnonzero(problem.active)
    squares = float(point.prior_residual @ point.prior_residual)
    freedom = float(np.isfinite(problem.prior[active]).sum()) - problem.size
    for block, weight in zip(point.blocks, fit.weight, strict=True):
        scale = fit.scales.get(block.kind, 1.0)
        squares += weight * block.squared_distance
        freedom += weight * scale**2 * len(block.r)
    birge_ratio = float(np.sqrt(squares / max(freedom, 1.0)))
    move = np.array([moves.get(COMPONENTS[c], 0.0) if c < PRINT else 0.0 for c in active])
    cov = max(birge_ratio, 1.0) ** 2 * fit.stated_cov + np.outer(move, move)
    size = np.maximum(np.sqrt(np.diag(cov)) / problem.prior[active], 1.0)
    return replace(fit, added_cov=cov / np.outer(size, size) - fit.stated_cov)


# the cause of a contradiction

#: Hypotheses that are fitted, the best by the linear model, and rounds of such a fit.
MAX_REFINED, MAX_FIT_ROUNDS = 3, 6
#: Tests under load, free ones, and outlying ones that the hypotheses are fitted to.
MAX_LOADED, MAX_FREE, MAX_SEEDS = 6, 2, 4
#: Loss over its median for normal noise up to which tests agree: noise three times as large as stated (assumed).
MAX_LOSS = 2.0
LOOSE = 30.0  #: Factor on the tolerances of what another probe or a defect of the print changes (assumed).
OF_PRINT = ("planes", "probe")  #: Hypotheses about the probe; the others are mistakes in the files.


class Hypothesis(NamedTuple):
    """A mistake that may explain a contradiction."""

    name: str  #: unit, sign, frame, exchange, marker, planes or probe.
    words: str  #: what is likely wrong, and what to check.
    change: Callable[[MeasuredTest], MeasuredTest] = lambda test: test  #: undoes it in a test.
    loose: Sequence[int] = ()  #: entries of the parameter vector whose priors are widened by `LOOSE`.
    price: float = 0.0  #: logarithm of the number of hypotheses of this kind among which it was selected.


@dataclass(frozen=True)
class LikelyCause:
    """A likely cause of a contradiction."""

    name: str  #: of the hypothesis.
    words: str  #: what is likely wrong, and what to check.
    evidence: str  #: the number that speaks for it.
    explains: bool  #: whether the tests agree with it, and do not without.
    #: what it changes of each number: relative for a modulus, a density and diameters, in m or rad for a pose.
    moves: dict[str, float] = field(default_factory=dict)

    def __str__(self) -> str:
        return f"{self.words} ({self.evidence})"


def likely_causes(fit: Fit, names: Sequence[str] = ()) -> tuple[LikelyCause, ...]:
    """Return what may explain a contradiction, the likeliest first; of the hypotheses of some `names` if there are any.

    Another probe is the first cause where no other hypothesis explains the tests.
    """
    point, tests = fit.point, fit.point.problem.tests
    seeds = list(dict.fromkeys(block.test for block, _ in outliers(point.blocks, fit.scales)))
    few = 2 * len(seeds) <= len(tests)  # two exchanged tests do not make most others outlying
    exchanged = _best_exchange(point, seeds[:MAX_SEEDS]) if few else {}
    loaded, free = [test for test in tests if not test.free], [test for test in tests if test.free]
    kept = {test.name for test in (*spread(loaded, MAX_LOADED), *spread(free, MAX_FREE))}
    kept |= {*seeds[:MAX_SEEDS], *exchanged}
    some = replace(point.problem, tests=tuple(test for test in tests if test.name in kept))
    # as the fit solved them: from no initial guess, tests far off the design may have no solution
    solved = tuple(test for test in point.tests if test.measured.name in kept)
    blocks = tuple(block for block in point.blocks if block.test in kept or not block.test)
    stated = minimise(Linearization(some, point.values, solved, blocks), {})[0]
    causes = _fitted(stated, [each for each in _hypotheses(stated, exchanged) if not names or each.name in names])
    if names or any(cause.explains for cause in causes) or _agrees(stated):
        return tuple(causes)
    text = ("probe: another probe than the design's, or a mistake that is not listed here; check probe and "
             "fingerprint in campaign.toml, and the diameters of the print")  # fmt: skip
    probe = Hypothesis("probe", text, loose=range(some.common.size)[some.common.print_columns], price=-np.inf)
    return *_fitted(stated, [probe]), *causes


def _fitted(stated: Linearization, hypotheses: Sequence[Hypothesis]) -> list[LikelyCause]:
    """Return the hypotheses that the tests speak for, the likeliest first."""
    starts, before = [], stated.loss({})
    for hypothesis in hypotheses:
        prior = stated.problem.prior.copy()
        prior[list(hypothesis.loose)] *= LOOSE
        changed = replace(stated.problem, tests=tuple(map(hypothesis.change, stated.problem.tests)), prior=prior)
        if hypothesis.loose:
            start = linearize(changed, stated.values, [test.nuisance for test in stated.tests], stated)
        else:
            start = start_at(changed, 1.0)
        if start.ok:
            predicted = start.loss({}) - start.expected_gain(weights(start.blocks, {}))
            starts.append((predicted + hypothesis.price, hypothesis, start))
    causes = []
    for _, hypothesis, start in sorted(starts, key=lambda row: row[0])[:MAX_REFINED]:
        point = minimise(minimise(start, None, MAX_FIT_ROUNDS)[0], {}, MAX_FIT_ROUNDS)[0]
        loss, chance = point.loss({}), 0.01 / len(starts)
        if before - loss < 0.5 * chi2.isf(chance, max(len(hypothesis.loose), 1)) + hypothesis.price:
            continue
        text = hypothesis.words.replace("RATIO", f"{np.exp(-2.0 * point.values.x[CREEP]):.3g}")
        evidence = f"χ² of {len(stated.tests)} tests falls from {2.0 * before:.4g} to {2.0 * loss:.4g}"
        change = point.values.x - stated.values.x
        moves = {COMPONENTS[c]: float(change[c]) for c in range(PRINT)
                 if OWNER[c].max_std is not None and stated.problem.active[c]}  # fmt: skip
        explains = _agrees(point) and not _agrees(stated)
        causes.append((loss + hypothesis.price, LikelyCause(hypothesis.name, text, evidence, explains, moves)))
    return [cause for _, cause in sorted(causes, key=lambda pair: pair[0])]


def _agrees(point: Linearization) -> bool:
    return bool(point.loss({}) < MAX_LOSS * 0.5 * sum(chi2.median(len(block.r)) for block in point.blocks))


def _best_exchange(point: Linearization, seeds: Sequence[str]) -> dict[str, MeasuredTest]:
    """Return two tests, one of them of `seeds`, under each other's readings, which lowers their loss most before their
    own unknowns are fitted."""
    problem, model, rod = point.problem, point.problem.common.model, point.values.rod
    fixed = replace(problem, mass=None, prior=np.zeros(problem.common.size))
    of = {test.name: test for test in problem.tests if test.wrench_base is not None}
    loss = {name: 0.5 * sum(block.squared_distance for block in point.blocks if block.test == name) for name in of}
    best, largest = dict[str, MeasuredTest](), 0.0
    for a, b in product((name for name in seeds if name in of), of):
        exchanged, gain = dict[str, MeasuredTest](), loss[a] + loss[b]
        for test, other in ((of[a], of[b]), (of[b], of[a])) if a != b else ():
            assert other.wrench_base is not None
            reading = model.to_sensor(other.wrench_base, other.gravity_base)  # of which the base may have been turned
            wrench = model.to_base(reading, test.gravity_base)
            exchanged[test.name] = changed = replace(test, wrench_base=wrench, cov_wrench=other.cov_wrench)
            start = linearize(replace(fixed, tests=(changed,)), point.values, start_nuisance((changed,), rod))
            gain -= start.loss({}) if start.ok else np.inf
        if exchanged and gain > largest:
            best, largest = exchanged, gain
    return best


def _mistakes_of_columns(common: CommonParameters) -> Iterator[Hypothesis]:
    """Yield mistakes in the columns of wrenches.csv."""
    model = common.model

    def columns(
        change: Callable[[Array], Array], written: str = common.frame
    ) -> Callable[[MeasuredTest], MeasuredTest]:
        """Return the change of a test by that of its columns in wrenches.csv, which are `written` in some frame."""

        def changed(test: MeasuredTest) -> MeasuredTest:
            if test.wrench_base is None:
                return test
            wrench, gravity = test.wrench_base, test.gravity_base
            values = change(model.to_sensor(wrench, gravity) if common.frame == "sensor" else wrench)
            return replace(test, wrench_base=model.to_base(values, gravity) if written == "sensor" else values)

        return changed

    both = np.repeat([-1.0, 1.0], 3)
    signs = {"all wrenches": -np.ones(6), "forces": both, "moments": -both}
    signs |= {name: 1.0 - 2.0 * np.eye(6)[i] for i, name in enumerate(CHANNELS)}
    for which, factors in signs.items():
        text = f"sign: {which} with the opposite sign; check the columns of wrenches.csv"
        yield Hypothesis("sign", text, columns(partial(np.multiply, factors)))
    for which, those in (("forces", both < 0.0), ("moments", both > 0.0)):
        for factor, size in ((1e-3, "large"), (1e3, "small")):
            text = f"unit: {which} a thousand times too {size}; check the columns of wrenches.csv"
            yield Hypothesis("unit", text, columns(partial(np.multiply, np.where(those, factor, 1.0))))
    actual = "base" if common.frame == "sensor" else "sensor"
    text = f"frame: wrenches.csv states '# frame: {common.frame}', but its values are those of '# frame: {actual}'"
    yield Hypothesis("frame", text, columns(np.positive, actual))


def _hypotheses(stated: Linearization, exchanged: dict[str, MeasuredTest]) -> Iterator[Hypothesis]:
    """Yield what may be wrong with the tests."""
    common, tests = stated.problem.common, stated.problem.tests
    if any(test.wrench_base is not None for test in tests):
        yield from _mistakes_of_columns(common)
    if exchanged:
        text = f"exchange: the readings of {' and '.join(exchanged)}; check wrenches.csv, or their places in tests.csv"
        price = float(np.log(len(tests) * (len(tests) - 1) / 2))
        yield Hypothesis("exchange", text, lambda test: exchanged.get(test.name, test), price=price)
    if any(np.any(test.force_world) for test in tests if test.force_world is not None):
        for name, what, factor in (("sign", "with the opposite sign", -1.0), ("unit", "in mN", 1e-3)):
            yield Hypothesis(name, f"{name}: known forces {what}; check tests.csv", partial(_known, factor))
    if any(len(test.marker_s) > 2 for test in tests):
        for shift, size in ((1, "low"), (-1, "high")):
            yield Hypothesis("marker", f"marker: all numbers too {size} by 1; check s_mm",
                             partial(_shifted, shift, common.model.rod.length))  # fmt: skip
    if stated.problem.active[CREEP]:
        # the stiffness by the plane of bending, exp(-c cos 2φ) with φ the direction of the force, replaces the creep
        forces = {test.measured.name: test.eq.load[:2] for test in stated.tests}
        cosines = {name: float((f[0] ** 2 - f[1] ** 2) / max(f @ f, 1e-12)) for name, f in forces.items()}
        text = ("planes: bending along x is RATIO times as stiff as along y, so planes of bending differ; measure "
                 "the diameters across both axes")  # fmt: skip
        yield Hypothesis("planes", text, lambda test: replace(test, creep_ramp=cosines[test.name]), [CREEP])


def _known(factor: float, test: MeasuredTest) -> MeasuredTest:
    return test if test.force_world is None else replace(test, force_world=factor * test.force_world)


def _shifted(shift: int, length: float, test: MeasuredTest) -> MeasuredTest:
    s = test.marker_s
    if len(s) < 2:
        return test
    end = min(2.0 * s[-1] - s[-2], length) if shift > 0 else max(2.0 * s[0] - s[1], 0.0)
    return replace(test, marker_s=np.append(s[1:], end) if shift > 0 else np.append(end, s[:-1]))
