"""Checks of a fit: what the tests do not determine (observability), and whether they contradict model or priors.

Observability is judged by the singular values of the whitened Jacobian after all other parameters are projected out.

A fit that gives gross errors almost no weight may leave out a whole kind of reading and fit the rest well; E then rests
on what is left, with an interval that does not show it. So the number of outliers is tested.

Priors and single readings (the pose of the base, the dimensions as designed, a weighing, a sag) have full weight, so a
gross error in one would bias the numbers unseen. Each is tested against the rest: with r its residuals over their
standard deviations and V = I - J C Jᵀ the share of their unit variance that the fit leaves, d² = rᵀ V⁻¹ r is χ².
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binom, chi2

from probedesign.core.frames import Array
from probedesign.identification.parameters import COMPONENTS, DIAMETERS, OWNER, PARAMETERS, PRINT, columns_of
from probedesign.identification.residuals import MeasuredTest, ResidualBlock
from probedesign.identification.robust_loss import READING_KINDS, REJECTION_CHANCE, ROBUST_KINDS, NoiseScale
from probedesign.identification.solver import Fit, Linearization

MIN_SHARE = 0.2  #: Component of a unit direction from which on a parameter takes part in what cannot be separated.
#: Usual fraction of gross errors. Source: F. Hampel et al., Robust Statistics, 1986: 1 to 10 % in routine data. Far
#: below one half, the breakdown point of the median, which the search starts with.
GROSS_ERROR_RATE = 0.05
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
    farthest: float  #: largest distance of an outlier, in standard deviations.

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
        return (f"{self.outliers} of {self.count} are outliers with little weight, the farthest "
                f"{self.farthest:.3g} standard deviations off")  # fmt: skip


def inconsistency(
    blocks: Sequence[ResidualBlock],
    outliers: Sequence[tuple[ResidualBlock, float]],
    noise: Sequence[NoiseScale],
    tests: Sequence[MeasuredTest],
) -> str:
    """Return why the tests contradict the design, or each other, with what to check; empty if they do not.

    Noise alone is no contradiction, however large: its scale is estimated.
    """
    kinds = {kind: n for kind in READING_KINDS if (n := _count(blocks, outliers, kind=kind)).too_many}
    bad = bad_tests(blocks, outliers)
    if kinds:
        kind, n = max(kinds.items(), key=lambda pair: (pair[1].outliers / pair[1].count, pair[1].farthest))
        mostly = f", especially in {_listed(bad)}" if bad else ""
        return f"{LABELS[kind]}: {n}; check {CHECKS[kind]}{mostly}"
    if bad:
        return (f"readings of {_listed(bad)}: {_count(blocks, outliers, test=bad[0])}; check the known force and "
                "s_contact_mm, the marker numbers, the wrench and the base pose, or leave it out")  # fmt: skip
    every = _count(blocks, outliers)
    if every.too_many:
        return f"readings of all kinds: {every}; check units and the base's rotation in campaign.toml"
    if exchanged := _exchanged_markers(blocks, tests):
        return exchanged
    for one in noise:
        if one.measured and one.kind in CHECKS and (share := _unexplained(blocks, tests, one.kind)) > MAX_UNEXPLAINED:
            return (f"{LABELS[one.kind]}: {share:.0%} of their RMS scatter is not explained by the probe as designed; "
                    f"check {CHECKS[one.kind]}")  # fmt: skip
        if one.kind == "markers" and one.scale > MAX_NOISE_SCALE:
            markers = [block for block in blocks if block.kind == "markers"]
            products = sum(float(a.r @ b.r) for a, b in pairwise(markers) if a.test == b.test)
            correlation = products / sum(block.squared_distance for block in markers)
            if correlation > MAX_NEIGHBOUR_CORRELATION:
                return (f"markers scatter {one.scale:.2g} times as much as stated, and neighbours alike (correlation "
                        f"{correlation:.2f}), so the probe as designed does not explain them; check "
                        f"{CHECKS['markers']}")  # fmt: skip
    return ""


def _exchanged_markers(blocks: Sequence[ResidualBlock], tests: Sequence[MeasuredTest]) -> str:
    """Return which neighbouring markers are exchanged in the whole campaign, by the χ² that their exchange saves; each
    single reading may be within its noise."""
    of = {test.name: test for test in tests}
    found = {(one.test, one.item): one for one in blocks if one.kind == "markers"}
    saved: dict[tuple[int, int], float] = {}
    for (name, i), one in found.items():
        test = of[name]
        at = test.marker_numbers.index(i)
        if at + 1 == len(test.marker_numbers):
            continue
        j = test.marker_numbers[at + 1]
        other = found[name, j]
        step = test.p_markers_world[at + 1] - test.p_markers_world[at]
        now = one.squared_distance + other.squared_distance
        then = sum(float(r @ np.linalg.solve(cov, r)) for r, cov in
                   ((one.residual + step, test.cov_markers[at]), (other.residual - step, test.cov_markers[at + 1]))
                   )  # fmt: skip
        saved[i, j] = saved.get((i, j), 0.0) + now - then
    if not saved:
        return ""
    (i, j), most = max(saved.items(), key=lambda pair: pair[1])
    if most < chi2.isf(REJECTION_CHANCE / len(saved), 1):
        return ""
    return f"markers {i} and {j}: χ² is smaller by {most:.3g} with both exchanged; check the numbering of the markers"


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
    return max((float(np.sqrt(off / scatter)) for scatter, off in squares.values() if scatter > 0.0), default=0.0)


def _value(test: MeasuredTest | None, block: ResidualBlock) -> Array | None:
    """Return the reading that a block is of; None for other kinds."""
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
        """Return whether a block counts."""
        return block.kind in READING_KINDS and kind in (None, block.kind) and test in (None, block.test)

    far = [distance for block, distance in outliers if chosen(block)]
    return OutlierCount(sum(map(chosen, blocks)), len(far), max(far, default=0.0))


def _listed(tests: Sequence[str]) -> str:
    return ", ".join(tests[:3]) + (f" and {len(tests) - 3} more" if len(tests) > 3 else "")


@dataclass(frozen=True)
class PriorTest:
    """χ² test of a prior or a single reading against the rest of the data."""

    label: str  #: what is tested.
    source: str  #: where it is stated.
    chance: float  #: of so large a deviation.
    deviation: float  #: Mahalanobis distance.

    def __str__(self) -> str:
        return (f"{self.label}: the stated value deviates by {self.deviation:.3g} standard deviations from the rest of "
                f"the data; check {self.source}")  # fmt: skip


def check_priors(fit: Fit) -> list[PriorTest]:
    """Return the priors and single readings that the rest of the data reject, the least probable first."""
    tests = []
    for label, source, r, variance in _full_weight_residuals(fit):
        sizes, directions = np.linalg.eigh(0.5 * (variance + variance.T))
        checked = sizes > MIN_REDUNDANCY  # directions that the rest of the data check
        if checked.any():
            d2 = float(np.sum((directions.T @ r)[checked] ** 2 / sizes[checked]))
            tests.append(PriorTest(label, source, float(chi2.sf(d2, int(checked.sum()))), d2**0.5))
    rejected = [test for test in tests if test.chance < REJECTION_CHANCE / len(tests)]
    return sorted(rejected, key=lambda test: test.chance)


def _full_weight_residuals(fit: Fit) -> Iterator[tuple[str, str, Array, Array]]:
    """Yield label, source, residuals and their remaining variance of each prior and of each single reading."""
    problem = fit.point.problem
    active = np.flatnonzero(problem.active)
    std = problem.prior[active]
    groups: dict[tuple[str, str], list[int]] = {}
    for one in PARAMETERS.values():
        if one.prior_name:
            groups.setdefault((one.prior_name, one.prior_source), []).extend(columns_of([one.name]))
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
            yield label, source, fit.point.prior_residual[at], variance
    for i, block in enumerate(fit.point.blocks):
        if block.kind in SINGLE_READINGS:
            label, source = SINGLE_READINGS[block.kind]
            yield label.format(block.test), source, block.r, np.eye(len(block.r)) - fit.absorbed(i)


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
