"""Checks of a fit: what the tests do not determine (observability), and whether they contradict model or priors.

Observability is judged by the singular values of the whitened Jacobian after all other parameters are projected out.

A fit that gives gross errors almost no weight may leave out a whole kind of reading and fit the rest well; E then rests
on what is left, with an interval that does not show it. So the number of outliers is tested.

Priors and single readings (the pose of the base, the dimensions as designed, a weighing, a sag) have full weight, so a
gross error in one would bias the numbers unseen. Each is tested against the rest: with r its residuals over their
standard deviations and V = I - J C Jᵀ the share of their unit variance that the fit leaves, d² = rᵀ V⁻¹ r is χ².
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import binom, chi2

from probedesign.core.frames import Array
from probedesign.identification.parameters import DIAMETERS, OWNER, PARAMETERS, PRINT, columns_of
from probedesign.identification.residuals import ResidualBlock
from probedesign.identification.solver import (
    REJECTION_CHANCE,
    ROBUST_KINDS,
    Fit,
    Linearization,
    NoiseScale,
    column_scales,
)

MIN_SHARE = 0.2
"""Component of a unit direction from which on a parameter takes part in what cannot be separated."""
GROSS_ERROR_RATE = 0.05
"""Usual fraction of gross errors. Source: F. Hampel et al., Robust Statistics, 1986: 1 to 10 % in routine data. Far
below one half, the breakdown point of the median, which the search starts with."""
MAX_NOISE_SCALE = 3.0
"""Readings that scatter by more times their stated noise contradict the model."""
MIN_REDUNDANCY = 0.02
"""Fraction of its variance that a residual must keep to be tested: below it the other readings do not check it."""
LABELS = {"markers": "markers", "wrenches": "wrenches", "touches": "touched places"}
CHECKS = {
    "markers": "the unit of their columns, s_mm, side_deg and the base's rotation in campaign.toml, and the numbering "
    "of the markers",
    "wrenches": "the units of the force and of the moment columns, their frame, and the base's rotation in "
    "campaign.toml",
    "touches": "the unit of the contact columns, the base's rotation in campaign.toml and, where there are markers, "
    "their s_mm and side_deg",
}
"""What to check in the data folder, by kind of reading."""
SINGLE_READINGS = {
    "sags": ("the sag of {}", "tip_sag_mm: its sign, its unit and std_sag_mm"),
    "scales": ("the weighing", "mass_g, std_g and of in campaign.toml"),
    "places": ("the arclength of the load in {}", "s_contact_mm and std_s_mm"),
}
"""Kinds of readings that have full weight: what they are, and what to check."""


# observability


@dataclass(frozen=True)
class UnobservableDirection:
    """A combination of requested parameters that the tests do not determine.

    Attributes:
        name: of the parameter that is left at the design value for it.
        description: what is not observable, and what is instead.
    """

    name: str
    description: str


def unobservable_direction(
    point: Linearization, weight: Array, requested: Sequence[str], tolerance: float = 1.0
) -> UnobservableDirection | None:
    """Return the least observable direction of the requested parameters if it exceeds their limits.

    The limits are `Parameter.max_std`, over `tolerance`.
    """
    columns = columns_of(requested)
    limits = np.array(
        [PARAMETERS[name].max_std for name in requested for _ in PARAMETERS[name].labels], dtype=float
    )
    _, sizes, directions = np.linalg.svd(_marginal_information_root(point, weight, columns) * limits)
    if sizes[-1] * tolerance >= 1.0:
        return None
    direction = directions[-1] * limits  # in units of the parameters
    by_name = {
        name: [i for i, column in enumerate(columns) if OWNER[column].name == name] for name in requested
    }
    part = [name for name in requested if np.abs(directions[-1][by_name[name]]).max() > MIN_SHARE]
    std = float(np.linalg.norm(direction)) / max(float(sizes[-1]), 1e-12)
    components = {name: float(direction[by_name[name][0]]) for name in part}
    return UnobservableDirection(part[-1], _description(components, std))


def _marginal_information_root(point: Linearization, weight: Array, columns: Sequence[int]) -> Array:
    """Return the square root of the information on these columns, all other unknowns marginalised."""
    rows, _ = point.system(weight)
    active = np.flatnonzero(point.problem.active)
    at = [int(np.searchsorted(active, column)) for column in columns]
    others = rows[:, [i for i in range(rows.shape[1]) if i not in at]]
    R = np.asarray(np.linalg.qr(np.hstack([others * column_scales(others), rows[:, at]]), mode="r"))
    return R[others.shape[1] :, others.shape[1] :]


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
        return (
            f"{kept} and {fixed}: these tests determine only {kept}{'/' if power < 0.0 else '·'}{fixed}{text}"
        )
    return f"{', '.join(names[:-1])} and {names[-1]}: these tests cannot separate them"


def conditional_estimate(fit: Fit, column: int) -> tuple[float, float, float | None]:
    """Return an entry of the parameter vector given the design's dimensions: value, standard deviation, by diameter.

    The last is the derivative by the logarithm of the base diameter, where the tolerances let all diameters differ
    together, or one factor on them was requested; None where neither is estimated. The diameters are not conditioned.
    """
    active = np.flatnonzero(fit.point.problem.active)
    x, cov, i = fit.point.values.x[active], fit.cov, int(np.searchsorted(active, column))
    given = np.flatnonzero((active == DIAMETERS) | (active >= PRINT))
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


def cov_conditional(fit: Fit, columns: Sequence[int]) -> Array:
    """Return the covariance of some entries of the parameter vector given the print's dimensions, (n, n)."""
    active = np.flatnonzero(fit.point.problem.active)
    at, given = np.searchsorted(active, columns), np.flatnonzero(active >= PRINT)
    across = fit.cov[np.ix_(at, given)]
    return np.asarray(
        fit.cov[np.ix_(at, at)] - across @ np.linalg.solve(fit.cov[np.ix_(given, given)], across.T)
    )


# consistency


@dataclass(frozen=True)
class OutlierCount:
    """Outliers among some readings.

    Attributes:
        count: of all readings.
        outliers: readings that noise does not explain.
        farthest: largest distance of an outlier, in standard deviations.
    """

    count: int
    outliers: int
    farthest: float

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
) -> str:
    """Return why the tests contradict the design, or each other, with what to check; empty if they do not."""
    kinds = {kind: n for kind in ROBUST_KINDS if (n := _count(blocks, outliers, kind=kind)).too_many}
    bad = _bad_tests(blocks, outliers)
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
    wild = max((one for one in noise if one.scale > MAX_NOISE_SCALE), key=lambda one: one.scale, default=None)
    if wild is None:
        return ""
    return (f"{LABELS[wild.kind]} scatter {wild.scale:.2g} times as much as stated, so the probe as designed does not "
            f"explain them; check {CHECKS[wild.kind]}")  # fmt: skip


def outlier_notes(
    blocks: Sequence[ResidualBlock], outliers: Sequence[tuple[ResidualBlock, float]]
) -> list[str]:
    """Return a line for each kind of reading with more outliers than usual."""
    counts = {kind: _count(blocks, outliers, kind=kind) for kind in ROBUST_KINDS}
    return [f"{LABELS[kind]}: {n}" for kind, n in counts.items() if n.outliers > GROSS_ERROR_RATE * n.count]


def _bad_tests(blocks: Sequence[ResidualBlock], outliers: Sequence[tuple[ResidualBlock, float]]) -> list[str]:
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
        return block.kind in ROBUST_KINDS and kind in (None, block.kind) and test in (None, block.test)

    far = [distance for block, distance in outliers if chosen(block)]
    return OutlierCount(sum(map(chosen, blocks)), len(far), max(far, default=0.0))


def _listed(tests: Sequence[str]) -> str:
    return ", ".join(tests[:3]) + (f" and {len(tests) - 3} more" if len(tests) > 3 else "")


@dataclass(frozen=True)
class PriorTest:
    """χ² test of a prior or a single reading against the rest of the data.

    Attributes:
        label: what is tested.
        source: where it is stated.
        chance: of so large a deviation.
        deviation: Mahalanobis distance.
    """

    label: str
    source: str
    chance: float
    deviation: float


def rejected_prior(fit: Fit) -> str:
    """Return the prior or single reading that the rest of the data reject, with what to check; empty if none."""
    tests = [*_test_priors(fit), *_test_single_readings(fit)]
    worst = min(tests, key=lambda one: one.chance, default=None)
    if worst is None or worst.chance >= REJECTION_CHANCE / len(tests):
        return ""
    return (f"{worst.label}: the stated value deviates by {worst.deviation:.3g} standard deviations from the rest of "
            f"the data; check {worst.source}")  # fmt: skip


def _test_priors(fit: Fit) -> Iterator[PriorTest]:
    problem = fit.point.problem
    active = np.flatnonzero(problem.active)
    std = problem.prior[active]
    groups: dict[tuple[str, str], list[int]] = {}
    for one in PARAMETERS.values():
        if one.prior_name:
            groups.setdefault((one.prior_name, one.prior_source), []).extend(columns_of([one.name]))
    groups["dimensions as designed", "what was printed: measure it, or increase the tolerances"] = list(
        range(PRINT, problem.common.size)
    )
    for (label, source), columns in groups.items():
        at = np.flatnonzero(np.isin(active, columns) & np.isfinite(std))
        if len(at):
            variance = np.eye(len(at)) - fit.cov[np.ix_(at, at)] / np.outer(std[at], std[at])
            yield from _tested(label, source, fit.point.prior_residual[at], variance)


def _test_single_readings(fit: Fit) -> Iterator[PriorTest]:
    for block in fit.point.blocks:
        if block.kind in SINGLE_READINGS:
            label, source = SINGLE_READINGS[block.kind]
            J = fit.point.block_jacobian(block)
            yield from _tested(label.format(block.test), source, block.r, np.eye(len(J)) - J @ fit.cov @ J.T)


def _tested(label: str, source: str, r: Array, variance: Array) -> Iterator[PriorTest]:
    """Yield the χ² test along those directions that the rest of the data check, if there are any."""
    sizes, directions = np.linalg.eigh(0.5 * (variance + variance.T))
    checked = sizes > MIN_REDUNDANCY
    if checked.any():
        d2 = float(np.sum((directions.T @ r)[checked] ** 2 / sizes[checked]))
        yield PriorTest(label, source, float(chi2.sf(d2, int(checked.sum()))), d2**0.5)
