"""Checks of a fit: what the tests do not determine (observability), whether they contradict model or priors, and why.

Observability is judged by the singular values of the whitened Jacobian after all other parameters are projected out.

A fit that gives gross errors almost no weight may leave out a whole kind of reading and fit the rest well; E then rests
on what is left, with an interval that does not show it. So the number of outliers is tested.

Priors and single readings (the pose of the base, the dimensions as designed, a weighing, a sag) have full weight, so a
gross error in one would bias the numbers unseen. Each is tested against the rest: with r its residuals over their
standard deviations and V = I - J C Jᵀ the share of their unit variance that the fit leaves, d² = rᵀ V⁻¹ r is χ².

The cause of a contradiction is sought among eight mistakes: unit, sign, frame, exchanged readings, marker numbers, a
bent print, planes of bending that differ, another probe. Each check undoes one of them in a few tests of the campaign
and fits them again with the stated noise. It is a likely cause where χ² falls by more than chance explains. It explains
the contradiction where the residuals are within `MAX_LOSS` of normal noise and were not before. Where no mistake
explains it, another probe is the first cause. Mistakes of columns are undone in the frame of wrenches.csv.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import pairwise, product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binom, chi2

from probedesign.core.csv_tables import Frame
from probedesign.core.frames import Array
from probedesign.core.units import MM
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
from probedesign.identification.residuals import BlockKey, MeasuredTest, ResidualBlock
from probedesign.identification.solver import (
    READING_KINDS,
    REJECTION_CHANCE,
    ROBUST_KINDS,
    Fit,
    LeastSquaresProblem,
    Linearization,
    chi2_words,
    fit,
    linearize,
    minimise,
    outliers,
    spread,
    start_nuisance,
    start_points,
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
#: Markers that scatter by more times their stated noise contradict the model if residuals of neighbours agree: noise of
#: markers is independent, and an error of the model bends the whole probe (limit of the correlation assumed).
MAX_NOISE_SCALE, MAX_NEIGHBOUR_CORRELATION = 3.0, 0.5
#: Fraction of its variance that a residual must keep to be tested: below it the other readings do not check it.
MIN_REDUNDANCY = 0.02
LABELS = {"markers": "markers", "wrenches": "wrenches", "touches": "touched places", "places": "arclengths of loads",
          "weights": "known loads", "stiffness": "stiffnesses of tests", "friction": "frictions"}  # fmt: skip
#: What to check in the data folder, by kind of reading.
CHECKS = {
    "markers": "the unit of their columns, s_mm, side_deg and the base's rotation in campaign.toml, and the numbering "
    "of the markers",
    "wrenches": "the units of the force and of the moment columns, their frame, and the base's rotation in "
    "campaign.toml",
    "touches": "the unit of the contact columns, the base's rotation in campaign.toml and, where there are markers, "
    "their s_mm and side_deg",
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


@dataclass(frozen=True)
class UnobservableDirection:
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
    information = point.marginal(weight, positions.tolist())
    squares, vectors = np.linalg.eigh(information * np.outer(limits, limits))
    sizes, directions = np.sqrt(np.maximum(squares[::-1], 0.0)), vectors.T[::-1]
    if sizes[-1] * tolerance >= 1.0:
        return None
    direction = directions[-1] * limits  # in units of the parameters
    by_name = {name: [i for i, column in enumerate(columns) if OWNER[column].name == name] for name in requested}
    part = [name for name in requested if np.abs(directions[-1][by_name[name]]).max() > MIN_SHARE]
    std = float(np.linalg.norm(direction)) / max(float(sizes[-1]), 1e-12)
    components = {name: float(direction[by_name[name][0]]) for name in part}
    return UnobservableDirection(part[-1], _description(components, std))


def _description(components: dict[str, float], std: float) -> str:
    names = list(components)
    if len(names) == 1:
        parameter = PARAMETERS[names[0]]
        assert parameter.max_std is not None
        return (f"{names[0]}: weakly observable in these tests; its standard deviation would be "
                f"{parameter.format_std(std)} (limit {parameter.format_std(parameter.max_std)})")  # fmt: skip
    if len(names) == 2 and all(PARAMETERS[name].logarithm for name in names):
        kept, fixed = names
        power = -components[kept] / components[fixed]
        text = "" if abs(abs(power) - 1.0) < 0.05 else f"^{abs(power):.1f}".removesuffix(".0")
        return f"{kept} and {fixed}: these tests determine only {kept}{'/' if power < 0.0 else '·'}{fixed}{text}"
    return f"{', '.join(names[:-1])} and {names[-1]}: these tests cannot separate them"


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


@dataclass(frozen=True)
class OutlierCount:
    """Outliers among some readings."""

    count: int  #: of all readings.
    outliers: int  #: readings that noise does not explain.
    farthest: float = 0.0  #: largest distance of an outlier, in standard deviations.
    freedom: int = 0  #: number of values of that outlier.

    @property
    def majority(self) -> bool:
        """Whether more than half are outliers, so that the median is one too."""
        return 2 * self.outliers > self.count

    @property
    def too_many(self) -> bool:
        """Whether gross errors make this number of outliers with a chance below 0.001, or outliers are a majority."""
        chance = float(binom.sf(self.outliers - 1, self.count, GROSS_ERROR_RATE))
        return self.majority or chance < REJECTION_CHANCE

    def __str__(self) -> str:
        farthest = chi2_words(self.farthest**2, self.freedom)
        return f"{self.outliers} of {self.count} are outliers with little weight, the farthest with {farthest}"


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
    blocks, tests, far = fit.point.blocks, fit.point.problem.tests, outliers(fit.point.blocks, fit.scales)

    kinds = {kind: n for kind in READING_KINDS if (n := _count(blocks, far, kind=kind)).too_many}
    bad = bad_tests(blocks, far)
    if kinds:
        kind, n = max(kinds.items(), key=lambda pair: (pair[1].outliers / pair[1].count, pair[1].farthest))
        mostly = f", especially in {_listed(bad)}" if bad else ""
        return Contradiction(LABELS[kind], f"{n}; check {CHECKS[kind]}{mostly}")
    if bad:
        words = (f"{_count(blocks, far, test=bad[0])}; check the known force and s_contact_mm, the marker numbers, the "
                 "wrench and the base pose, or leave it out")  # fmt: skip
        readings = frozenset(block.key for block in blocks if block.test in bad and block.kind in READING_KINDS)
        return Contradiction(f"readings of {_listed(bad)}", words, readings)
    every = _count(blocks, far)
    if every.too_many:
        words = f"{every}; check units and the base's rotation in campaign.toml"
        return Contradiction("readings of all kinds", words)
    if exchanged := _exchanged_markers(blocks, tests):
        (i, j), saved = exchanged
        words = f"χ² is smaller by {saved:.3g} with both exchanged; check the numbering of the markers"
        return Contradiction(
            f"markers {i} and {j}", words, frozenset(block.key for block in blocks if block.item in (i, j))
        )
    for kind, noise in ((noise.kind, noise) for noise in fit.noise):
        if noise.measured and kind in CHECKS and (share := _unexplained(blocks, tests, kind)) > MAX_UNEXPLAINED:
            words = (f"{share:.0%} of their RMS scatter is not explained by the probe as designed; check "
                     f"{CHECKS[kind]}")  # fmt: skip
            return Contradiction(LABELS[kind], words)
        if kind == "markers" and noise.scale > MAX_NOISE_SCALE:
            markers = [block for block in blocks if block.kind == "markers"]
            products = sum(float(a.r @ b.r) for a, b in pairwise(markers) if a.test == b.test)
            correlation = products / sum(block.squared_distance for block in markers)
            if correlation > MAX_NEIGHBOUR_CORRELATION:
                words = (f"they scatter {noise.scale:.2g} times as much as stated, and neighbours alike (correlation "
                         f"{correlation:.2f}), so the probe as designed does not explain them; check "
                         f"{CHECKS['markers']}")  # fmt: skip
                return Contradiction("markers", words)
    return None


def _exchanged_markers(
    blocks: Sequence[ResidualBlock], tests: Sequence[MeasuredTest]
) -> tuple[tuple[int, int], float] | None:
    """Return which neighbouring markers are exchanged in the whole campaign, and the χ² that their exchange saves; each
    single reading may be within its noise."""
    of = {test.name: test for test in tests}
    seen = {(block.test, block.item): block for block in blocks if block.kind == "markers"}
    saved: dict[tuple[int, int], float] = {}
    for (name, i), block in seen.items():
        test = of[name]
        at = test.marker_numbers.index(i)
        j = test.marker_numbers[at + 1] if at + 1 < len(test.marker_numbers) else 0
        if (other := seen.get((name, j))) is None:
            continue
        step = test.p_markers_world[at + 1] - test.p_markers_world[at]
        now = block.squared_distance + other.squared_distance
        then = sum(float(r @ np.linalg.solve(cov, r)) for r, cov in
                   ((block.residual + step, test.cov_markers[at]), (other.residual - step, test.cov_markers[at + 1]))
                   )  # fmt: skip
        saved[i, j] = saved.get((i, j), 0.0) + now - then
    best = max(saved.items(), key=lambda pair: pair[1], default=None)
    return best if best and best[1] >= chi2.isf(REJECTION_CHANCE / len(saved), 1) else None


def _unexplained(blocks: Sequence[ResidualBlock], tests: Sequence[MeasuredTest], kind: str) -> float:
    """Return the residuals of a kind over the scatter of its readings from test to test, both RMS; the larger of
    forces and moments; 0 if fewer than three tests have them."""
    of = {test.name: test for test in tests}
    groups: dict[tuple[int, int], list[tuple[Array, Array]]] = {}
    for block in blocks:
        value = _value(of.get(block.test), block)
        if block.kind == kind and value is not None:
            for i in range(0, len(value), 3):  # forces and moments apart
                groups.setdefault((i, block.item), []).append((value[i : i + 3], block.residual[i : i + 3]))
    squares: dict[int, Array] = {}  # of the scatter and of the residuals
    for (i, _), pairs in groups.items():
        if len(pairs) >= 3:
            values, residuals = (np.array(part) for part in zip(*pairs, strict=True))
            sums = np.sum((values - values.mean(axis=0)) ** 2), np.sum(residuals**2)
            squares[i] = squares.get(i, np.zeros(2)) + sums
    return max(
        (float(np.sqrt(residual / scatter)) for scatter, residual in squares.values() if scatter > 0.0), default=0.0
    )


def _value(test: MeasuredTest | None, block: ResidualBlock) -> Array | None:
    if test is None:
        return None
    if block.kind == "markers":
        return np.asarray(test.p_markers_world[test.marker_numbers.index(block.item)])
    return {"wrenches": test.wrench_base, "touches": test.p_touch_world}.get(block.kind)


def outlier_notes(blocks: Sequence[ResidualBlock], outliers: Sequence[tuple[ResidualBlock, float]]) -> list[str]:
    """Return a line for each kind of reading with more outliers than usual."""
    counts = {kind: _count(blocks, outliers, kind=kind) for kind in READING_KINDS}
    return [f"{LABELS[kind]}: {n}" for kind, n in counts.items() if n.outliers > GROSS_ERROR_RATE * n.count]


def bad_tests(blocks: Sequence[ResidualBlock], outliers: Sequence[tuple[ResidualBlock, float]]) -> list[str]:
    """Return tests with more than one outlier that are the majority of its readings."""
    tests = dict.fromkeys(block.test for block, _ in outliers)
    counts = {test: _count(blocks, outliers, test=test) for test in tests}
    return [test for test, n in counts.items() if n.outliers > 1 and n.majority]


def _count(
    blocks: Sequence[ResidualBlock],
    outliers: Sequence[tuple[ResidualBlock, float]],
    kind: str | None = None,
    test: str | None = None,
) -> OutlierCount:
    def chosen(block: ResidualBlock) -> bool:
        return block.kind in READING_KINDS and kind in (None, block.kind) and test in (None, block.test)

    far = [(distance, len(block.r)) for block, distance in outliers if chosen(block)]
    return OutlierCount(sum(map(chosen, blocks)), len(far), *max(far, default=(0.0, 0)))


def _listed(tests: Sequence[str]) -> str:
    return ", ".join(tests[:3]) + (f" and {len(tests) - 3} more" if len(tests) > 3 else "")


def check_priors(fit: Fit) -> list[Contradiction]:
    """Return the priors and single readings that the rest of the data reject, the least probable first."""
    tests = []
    for label, source, r, variance, concerned in _full_weight_residuals(fit):
        sizes, directions = np.linalg.eigh(0.5 * (variance + variance.T))
        checked = sizes > MIN_REDUNDANCY  # directions that the rest of the data check
        if checked.any():
            squares, freedom = float(np.sum((directions.T @ r)[checked] ** 2 / sizes[checked])), int(checked.sum())
            words = f"what is stated deviates from the rest of the data: {chi2_words(squares, freedom)}; check {source}"
            tests.append(Contradiction(label, words, *concerned, float(chi2.sf(squares, freedom))))
    rejected = [test for test in tests if test.chance < REJECTION_CHANCE / len(tests)]
    return sorted(rejected, key=lambda test: test.chance)


def _full_weight_residuals(
    fit: Fit,
) -> Iterator[tuple[str, str, Array, Array, tuple[frozenset[BlockKey], tuple[int, ...]]]]:
    """Yield label, source, residuals, their remaining variance, and the readings and entries of the parameter vector
    concerned, of each prior and of each single reading."""
    problem = fit.point.problem
    active = np.flatnonzero(problem.active)
    std = problem.prior[active]
    groups: dict[tuple[str, str], list[int]] = {}
    for parameter in PARAMETERS.values():
        if parameter.prior_name:
            groups.setdefault((parameter.prior_name, parameter.prior_source), []).extend(columns_of([parameter.name]))
    groups[DIMENSIONS, "what was printed: measure it, or increase the tolerances"] = list(
        range(problem.common.print_columns.start, problem.common.print_columns.stop)
    )
    groups["drift of the sensor", "whether it was warm and whether it was zeroed between tests; and walk_steps"] = list(
        range(problem.common.print_columns.stop, problem.common.size)
    )
    for (label, source), columns in groups.items():
        at = np.flatnonzero(np.isin(active, columns) & np.isfinite(std))
        if len(at):
            variance = np.eye(len(at)) - fit.cov[np.ix_(at, at)] / np.outer(std[at], std[at])
            yield label, source, fit.point.prior_residual[at], variance, (frozenset(), tuple(active[at].tolist()))
    for i, block in enumerate(fit.point.blocks):
        if block.kind in SINGLE_READINGS:
            label, source = SINGLE_READINGS[block.kind]
            variance = np.eye(len(block.r)) - fit.absorbed(i)
            yield label.format(block.test), source, block.r, variance, (frozenset([block.key]), ())


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
    and the squares of what the likely cause changes are added. No standard deviation exceeds that of the prior.
    Source: R. T. Birge, Phys. Rev. 40, 1932, 207.

    Args:
        fit: of the tests.
        moves: what the likely cause changes of the components of the parameter vector.
    """
    point, problem = fit.point, fit.point.problem
    active = np.flatnonzero(problem.active)
    squares = float(point.prior_residual @ point.prior_residual)
    freedom = float(np.isfinite(problem.prior[active]).sum()) - problem.size
    for block, weight in zip(point.blocks, fit.weight, strict=True):
        scale = fit.scales.get(block.kind, 1.0) if block.kind in ROBUST_KINDS else 1.0
        squares += weight * block.squared_distance
        freedom += weight * scale**2 * len(block.r)
    birge_ratio = float(np.sqrt(squares / max(freedom, 1.0)))
    move = np.array([moves.get(COMPONENTS[c], 0.0) if c < PRINT else 0.0 for c in active])
    cov = max(birge_ratio, 1.0) ** 2 * fit.stated_cov + np.outer(move, move)
    size = np.maximum(np.sqrt(np.diag(cov)) / problem.prior[active], 1.0)
    return replace(fit, added_cov=cov / np.outer(size, size) - fit.stated_cov)


# the cause of a contradiction

#: Mistakes that are fitted, the best by their start, factors on E that it is chosen from, and rounds of a fit.
MAX_REFINED, MAX_FACTORS, MAX_FIT_ROUNDS = 4, 3, 8
#: Tests under load, free ones, and outlying ones that the checks are made with.
MAX_LOADED, MAX_FREE, MAX_SEEDS = 6, 2, 4
#: Loss over its median for normal noise up to which tests agree: noise three times as large as stated (assumed).
MAX_LOSS = 2.0
OTHER_PRINT = 30.0  #: Factor on the tolerances of the dimensions for another probe (assumed).

DEFECT = 30.0  #: Factor on the tolerances of creep and bow for a defect of the print (assumed).

Change = Callable[[MeasuredTest], MeasuredTest]


class Mistake(NamedTuple):
    """A mistake in the data folder."""

    name: str  #: unit, sign, frame, exchange or marker.
    words: str  #: what is likely wrong, and what to check.
    change: Change  #: undoes it in a test.
    price: float = 0.0  #: logarithm of the number of mistakes of this kind among which it was selected.


class Exchange(NamedTuple):
    """Two tests that agree better with the fit after an exchange of their readings."""

    pair: tuple[str, str]  #: their names.
    before: float  #: loss of both as stated.
    after: float  #: loss of both after the exchange.


@dataclass(frozen=True)
class LikelyCause:
    """A likely cause of a contradiction."""

    name: str  #: that of the mistake, planes, bow, or probe.
    words: str  #: what is likely wrong, and what to check.
    evidence: str  #: the number that speaks for it.
    explains: bool  #: whether the tests agree with it, and do not without.
    #: what it changes of each number: relative for a modulus, a density and diameters, in m or rad for a pose.
    moves: dict[str, float] = field(default_factory=dict)

    def __str__(self) -> str:
        return f"{self.words} ({self.evidence})"


def likely_causes(fit: Fit) -> tuple[LikelyCause, ...]:
    """Return what may explain a contradiction, the likeliest first."""
    problem = fit.point.problem
    seeds = list(dict.fromkeys(block.test for block, _ in outliers(fit.point.blocks, fit.scales)))
    few = 2 * len(seeds) <= len(problem.tests)  # two exchanged tests do not make most others outlying
    exchange = _best_exchange(fit.point, seeds[:MAX_SEEDS]) if few else None
    pair = None if exchange is None else exchange.pair
    names = {*_some(problem.tests), *seeds[:MAX_SEEDS], *(pair or ())}
    some = replace(problem, tests=tuple(test for test in problem.tests if test.name in names))
    # as the fit solved them: from no initial guess, tests far off the design may have no solution
    solved = tuple(test for test in fit.point.tests if test.measured.name in names)
    blocks = tuple(block for block in fit.point.blocks if block.test in names or not block.test)
    stated = minimise(Linearization(some, fit.point.values, solved, blocks), {})[0]
    causes = [*_fitted(some, stated, pair), *print_defects(stated)]
    if any(cause.explains for cause in causes) or _agrees(stated):
        return tuple(causes)
    return _other_probe(stated), *causes


def explaining_mistakes(problem: LeastSquaresProblem) -> tuple[LikelyCause, ...]:
    """Return mistakes without which the rod has an equilibrium in tests that have none as they are."""
    names = _some(problem.tests)
    return tuple(_fitted(replace(problem, tests=tuple(test for test in problem.tests if test.name in names)), None))


def exchange_hint(fit: Fit, outlying: Sequence[tuple[ResidualBlock, float]]) -> tuple[str, ...]:
    """Return a note if an exchange of the readings of two tests, one of them outlying, explains outliers."""
    of = {test.name: test for test in fit.point.problem.tests}
    names = [name for name in dict.fromkeys(block.test for block, _ in outlying) if name in of]
    exchange = _best_exchange(fit.point, [name for name in names if not of[name].free][:MAX_SEEDS])
    price = np.log(len(of) * (len(of) - 1) / 2) - np.log(REJECTION_CHANCE)
    if exchange is None or exchange.before - exchange.after < price:
        return ()
    return (f"{' and '.join(exchange.pair)}: their readings may be exchanged: χ² of both falls from "
            f"{2.0 * exchange.before:.4g} to {2.0 * exchange.after:.4g} that way; check "
            "wrenches.csv, or their places in tests.csv",)  # fmt: skip


# fits of changed tests


def _some(tests: Sequence[MeasuredTest]) -> set[str]:
    loaded, free = [test for test in tests if not test.free], [test for test in tests if test.free]
    return {test.name for test in (*spread(loaded, MAX_LOADED), *spread(free, MAX_FREE))}


def _fitted(
    problem: LeastSquaresProblem, stated: Linearization | None, pair: tuple[str, str] | None = None
) -> list[LikelyCause]:
    """Return the mistakes that the tests speak for, the likeliest first; without a fit of the tests as stated, those
    that explain all readings."""
    starts = []
    for mistake in _mistakes(problem, pair):
        changed = replace(problem, tests=tuple(map(mistake.change, problem.tests)))
        points = [point for _, point in start_points(changed, MAX_FACTORS)]
        if points:
            starts.append((mistake, min(points, key=lambda point: point.loss({}))))
    starts.sort(key=lambda pair: pair[1].loss({}))
    margin = 0.5 * chi2.isf(0.01 / max(len(starts), 1), 1)
    causes = []
    for mistake, start in starts[:MAX_REFINED]:
        point = minimise(minimise(start, None, MAX_FIT_ROUNDS)[0], {}, MAX_FIT_ROUNDS)[0]
        loss, explains = point.loss({}), _agrees(point) and (stated is None or not _agrees(stated))
        before = "they have no equilibrium otherwise" if stated is None else f"falls from {2.0 * stated.loss({}):.4g}"
        if explains if stated is None else stated.loss({}) - loss > margin + mistake.price:
            evidence = f"χ² of {len(problem.tests)} tests {before} to {2.0 * loss:.4g}"
            if stated is None:
                evidence = f"χ² of {len(problem.tests)} tests is {2.0 * loss:.4g}, and {before}"
            cause = LikelyCause(mistake.name, mistake.words, evidence, explains, _moves(point, stated))
            causes.append((loss + mistake.price, cause))
    return [cause for _, cause in sorted(causes, key=lambda pair: pair[0])]


def print_defects(stated: Linearization) -> list[LikelyCause]:
    """Return defects of the print that the tests speak for, the likeliest first: bent, or stiffer in one plane.

    The stiffness of each test by the plane that it bends in, exp(-c cos 2φ) with φ the direction of the force, takes
    the place of the creep, and each prior is `DEFECT` times as wide.
    """
    problem, loss = stated.problem, stated.loss({})
    forces = [test.eq.load[:2] for test in stated.tests]
    planes = tuple(replace(test.measured, creep_ramp=float((f[0] ** 2 - f[1] ** 2) / max(f @ f, 1e-12)))
                   for test, f in zip(stated.tests, forces, strict=True))  # fmt: skip
    causes = []
    for name, tests in (("creep", planes), ("bow", problem.tests)):
        columns = [c for c, owner in enumerate(OWNER) if owner.name.startswith(name) and problem.active[c]]
        if not columns:
            continue
        prior = problem.prior.copy()
        prior[columns] *= DEFECT
        changed = replace(problem, tests=tests, prior=prior)
        nuisance = [test.nuisance for test in stated.tests]
        start = linearize(changed, stated.values, nuisance, stated)
        point = minimise(start, {}, MAX_FIT_ROUNDS)[0] if start.ok else stated
        if loss - point.loss({}) < 0.5 * chi2.isf(REJECTION_CHANCE, len(columns)):
            continue
        x = point.values.x[columns]
        words = (f"planes: bending along x is {np.exp(-2.0 * x[0]):.3g} times as stiff as along y, so planes of "
                 "bending differ; measure the diameters across both axes")  # fmt: skip
        if name == "bow":
            words = (f"bow: a bent print, whose tip deviates by {np.hypot(*x) / MM:.2g} mm; look along it, and write "
                     "the bow into the design with measured --bow-mm")  # fmt: skip
        evidence = f"χ² of {len(tests)} tests falls from {2.0 * loss:.4g} to {2.0 * point.loss({}):.4g}"
        explains = _agrees(point) and not _agrees(stated)
        cause = LikelyCause(words.split(":")[0], words, evidence, explains, _moves(point, stated))
        causes.append((point.loss({}), cause))
    return [cause for _, cause in sorted(causes, key=lambda pair: pair[0])]


def _other_probe(stated: Linearization) -> LikelyCause:
    problem, common = stated.problem, stated.problem.common
    prior = problem.prior.copy()
    prior[common.print_columns] *= OTHER_PRINT
    point = minimise(replace(stated, problem=replace(problem, prior=prior)), {})[0]
    radius = point.values.rod.radius / common.model.rod.radius
    evidence = (f"χ² of {len(problem.tests)} tests is {2.0 * stated.loss({}):.4g}, and {2.0 * point.loss({}):.4g} with "
                f"free diameters, {radius.min():.2f} to {radius.max():.2f} times the design's")  # fmt: skip
    words = ("probe: another probe than the design's, or a mistake that is not listed here; check probe and "
             "fingerprint in campaign.toml, and the diameters of the print")  # fmt: skip
    return LikelyCause("probe", words, evidence, _agrees(point), _moves(point, stated))


def _agrees(point: Linearization) -> bool:
    return bool(point.loss({}) < MAX_LOSS * 0.5 * sum(chi2.median(len(block.r)) for block in point.blocks))


def _moves(point: Linearization, stated: Linearization | None) -> dict[str, float]:
    if stated is None:
        return {}
    change = point.values.x - stated.values.x
    return {COMPONENTS[c]: float(change[c]) for c in range(PRINT)
            if OWNER[c].max_std is not None and stated.problem.active[c]}  # fmt: skip


def _best_exchange(point: Linearization, seeds: Sequence[str]) -> Exchange | None:
    common, of = point.problem.common, {test.name: test for test in point.problem.tests}
    read = [name for name, test in of.items() if test.wrench_base is not None]
    stated = {name: _loss_of_test(point, of[name]) for name in read} if seeds else {}
    exchanges = []
    for a, b in dict.fromkeys((min(a, b), max(a, b)) for a in seeds if a in read for b in read if a != b):
        change, before = _exchange(common, of, (a, b)).change, stated[a] + stated[b]
        after = _loss_of_test(point, change(of[a]))
        after += _loss_of_test(point, change(of[b])) if after < before else 0.0
        if after < before:
            exchanges.append(Exchange((a, b), before, after))
    return max(exchanges, key=lambda exchange: exchange.before - exchange.after, default=None)


def _loss_of_test(point: Linearization, test: MeasuredTest) -> float:
    """Return the loss of one test by its own unknowns at a fit's common parameters; infinite without equilibrium."""
    fixed = replace(point.problem, tests=(test,), mass=None, prior=np.zeros(point.problem.common.size))
    start = Linearization(fixed, point.values, (), ()).at(start_nuisance((test,), point.values.rod)[0])
    return minimise(start, {})[0].loss({}) if start.ok else np.inf


# the mistakes


def _mistakes(problem: LeastSquaresProblem, pair: tuple[str, str] | None) -> Iterator[Mistake]:
    """Yield mistakes that the tests may contain."""
    common, tests, length = problem.common, problem.tests, problem.common.model.rod.length
    if any(test.wrench_base is not None for test in tests):
        both = np.repeat([-1.0, 1.0], 3)
        signs = {"all wrenches": -np.ones(6), "forces": both, "moments": -both}
        signs |= {name: 1.0 - 2.0 * np.eye(6)[i] for i, name in enumerate(CHANNELS)}
        for which, factors in signs.items():
            words = f"sign: {which} with the opposite sign; check the columns of wrenches.csv"
            yield Mistake("sign", words, partial(_scaled, common, factors))
        for which, columns in (("forces", both < 0.0), ("moments", both > 0.0)):
            for factor, size in ((1e-3, "large"), (1e3, "small")):
                words = f"unit: {which} a thousand times too {size}; check the columns of wrenches.csv"
                yield Mistake("unit", words, partial(_scaled, common, np.where(columns, factor, 1.0)))
        actual: Frame = "base" if common.frame == "sensor" else "sensor"
        words = f"frame: wrenches.csv states '# frame: {common.frame}', but its values are those of '# frame: {actual}'"
        yield Mistake("frame", words, partial(_in_frame, replace(common, frame=actual), common))
        if pair is not None:
            yield _exchange(common, {test.name: test for test in tests}, pair)
    if any(np.any(test.force_world) for test in tests if test.force_world is not None):
        for name, what, factor in (("sign", "with the opposite sign", -1.0), ("unit", "in mN", 1e-3)):
            yield Mistake(name, f"{name}: known forces {what}; check tests.csv", partial(_known, factor))
    if any(len(test.marker_s) > 2 for test in tests):
        for shift, size in ((1, "low"), (-1, "high")):
            yield Mistake("marker", f"marker: all numbers too {size} by 1; check s_mm",
                          partial(_shifted, shift, length))  # fmt: skip


def _exchange(common: CommonParameters, of: dict[str, MeasuredTest], pair: tuple[str, str]) -> Mistake:
    other = {pair[0]: of[pair[1]], pair[1]: of[pair[0]]}

    def change(test: MeasuredTest) -> MeasuredTest:
        if test.name not in other:
            return test
        swapped = _with_columns(common, test, _columns(common, other[test.name]))
        return replace(swapped, cov_wrench=other[test.name].cov_wrench)

    words = f"exchange: the readings of {pair[0]} and {pair[1]}; check wrenches.csv, or their places in tests.csv"
    return Mistake("exchange", words, change, float(np.log(len(of) * (len(of) - 1) / 2)))


def _columns(common: CommonParameters, test: MeasuredTest) -> Array:
    """Return the wrench of a test in the frame of wrenches.csv [N, N·m], (6,)."""
    assert test.wrench_base is not None
    sensor = common.frame == "sensor"
    return common.model.to_sensor(test.wrench_base, test.gravity_base) if sensor else test.wrench_base


def _with_columns(common: CommonParameters, test: MeasuredTest, values: Array) -> MeasuredTest:
    wrench = values if common.frame == "base" else common.model.to_base(values, test.gravity_base)
    return replace(test, wrench_base=wrench)


def _scaled(common: CommonParameters, factors: Array, test: MeasuredTest) -> MeasuredTest:
    return test if test.wrench_base is None else _with_columns(common, test, factors * _columns(common, test))


def _in_frame(actual: CommonParameters, stated: CommonParameters, test: MeasuredTest) -> MeasuredTest:
    return test if test.wrench_base is None else _with_columns(actual, test, _columns(stated, test))


def _known(factor: float, test: MeasuredTest) -> MeasuredTest:
    return test if test.force_world is None else replace(test, force_world=factor * test.force_world)


def _shifted(shift: int, length: float, test: MeasuredTest) -> MeasuredTest:
    s = test.marker_s
    if len(s) < 2:
        return test
    end = min(2.0 * s[-1] - s[-2], length) if shift > 0 else max(2.0 * s[0] - s[1], 0.0)
    return replace(test, marker_s=np.append(s[1:], end) if shift > 0 else np.append(end, s[:-1]))
