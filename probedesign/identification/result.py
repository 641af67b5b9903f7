"""Result of an identification: numbers with intervals and their error budget, outliers and residuals, for JSON and CSV.

Attributes of the classes are the keys of identification.json.
"""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

import numpy as np
from scipy.stats import t

from probedesign.core import csv_tables
from probedesign.core.frames import Array
from probedesign.core.notebook import Tabular
from probedesign.core.units import MM
from probedesign.identification.fit_checks import (
    LikelyCause,
    UnobservableDirection,
    conditional_estimate,
    cov_conditional,
)
from probedesign.identification.parameters import (
    COMPONENTS,
    IMPLIED,
    LOG_E,
    OWNER,
    PARAMETERS,
    POISSON,
    POISSON_STD,
    columns_of,
)
from probedesign.identification.solver import READING_KINDS, Fit, NoiseScale, chi2_words

CONFIDENCE = 0.95
#: Units of residuals by kind of reading.
UNITS = {"markers": "mm", "touches": "mm", "places": "mm", "sags": "mm", "wrenches": "N and N·m", "scales": "g",
         "friction": "share of the force", "weights": "share of the load", "stiffness": "logarithm of the stiffness",
         "poisson": "logarithm of E/G", "poses": "rad and m"}  # fmt: skip
#: Largest posterior over prior variance with which an implied parameter counts as identified by the tests: they then
#: contain at least as much information on it as its prior.
DATA_SHARE = 0.5
#: Of the standard deviation of a number: smaller contributions to it, 1 % of its variance, are not listed.
MIN_CONTRIBUTION = 0.1
ACCEPTED = "accepted contradiction"  #: Name of what the acceptance of a contradiction adds to an error budget.


@dataclass(frozen=True)
class Identified:
    """One requested number."""

    name: str  #: of the parameter or its component: E, tilt_x.
    words: str  #: what it is.
    unit: str  #: of all values below; empty for plain factors.
    #: "identified"; "inferred" if it follows from E and a prior rather than from the tests; "not_observable", or
    #: "withheld" because the tests contradict each other: then `value` is the design's, without an interval.
    result: Literal["identified", "inferred", "not_observable", "withheld"]
    #: conditional on the design's diameters, which the frozen probe uses, even where those are requested too.
    value: float
    design: float  #: design value; 0 for a pose.
    std: float | None = None  #: standard deviation, which includes all errors of the bench.
    low: float | None = None  #: low, high: 95 % interval.
    high: float | None = None
    #: value_of_print, std_of_print, low_of_print, high_of_print: the same with the diameters as uncertain as the
    #: design's tolerances: of the material rather than of the probe.
    value_of_print: float | None = None
    std_of_print: float | None = None
    low_of_print: float | None = None
    high_of_print: float | None = None
    #: power of the base diameter with which `value` changes if all diameters differ together; None if the diameters are
    #: not estimated.
    by_diameter: float | None = None
    why: str = ""  #: what the tests determine instead, where it is not observable, or what the value follows from.

    @property
    def relative_std(self) -> float:
        """`std` relative to the value."""
        assert self.std is not None
        return self.std / self.value

    @property
    def identified(self) -> bool:
        """Whether the tests determine it."""
        return self.result == "identified"

    @property
    def estimated(self) -> bool:
        """Whether it has a value of its own with an interval: by the tests, or by E and a prior."""
        return self.result in ("identified", "inferred")

    @property
    def state(self) -> str:
        """Why there is no value, in words; empty where there is one."""
        return {"not_observable": "not observable in these tests", "withheld": "withheld"}.get(self.result, "")

    @property
    def change(self) -> str:
        """Change from the design with its 95 % interval: of a factor or a property of the material in percent, else in
        the unit. Empty where there is none, and for poses, which the design does not state."""
        owner = OWNER[COMPONENTS.index(self.name)]
        if self.low is None or self.high is None or not (owner.logarithm or owner.design_key):
            return ""
        ends = (self.value, self.low, self.high)
        if owner.logarithm:
            change, low, high = (f"{100.0 * (end / self.design - 1.0):+.1f}" for end in ends)
            return f"{change} % ({low} ... {high} %)"
        change, low, high = (f"{end - self.design:+.2g}" for end in ends)
        return f"{change} ({low} ... {high}) {self.unit}".rstrip()


@dataclass(frozen=True)
class Outlier:
    """A reading that noise does not explain; it has little weight."""

    test: str  #: its test.
    kind: str  #: markers, wrenches, touches, stiffness or friction.
    item: int  #: the marker's number; 0 for the others.
    deviations: float  #: Mahalanobis distance: the root of χ².
    freedom: int  #: number of its values, the degrees of freedom of that χ².

    @property
    def words(self) -> str:
        """Name of the reading, and its χ²."""
        what = {"markers": f"marker {self.item}", "wrenches": "the wrench", "touches": "the touched place",
                "places": "the arclength", "weights": "the known load", "stiffness": "the stiffness",
                "friction": "the friction"}  # fmt: skip
        return f"{what[self.kind]} of {self.test}: {chi2_words(self.deviations**2, self.freedom)}"


@dataclass(frozen=True)
class ErrorContribution:
    """Part of the standard deviation of one number that one error source makes; their squares add up."""

    cause: str  #: the error source.
    of: str  #: the number.
    percent: float  #: standard deviation of the number due to it, relative to its value.


@dataclass(frozen=True)
class Residual:
    """One reading against the fit."""

    test: str  #: test, kind, item: which.
    kind: str
    item: int
    s_mm: float | None  #: arclength of a marker or a touch; None for the others.
    off: tuple[float, ...]  #: measured minus modelled: mm, or N and N·m, or g.
    deviations: float  #: Mahalanobis distance with the estimated noise, over the root of the number of its values.
    weight: float  #: 1 for a reading with full weight, 0 for one that is left out.


@dataclass(frozen=True)
class Identification(Tabular):
    """Identified numbers of one campaign."""

    #: "ok"; "not_converged"; "inconsistent": the tests contradict the probe as designed, or each other; or "accepted":
    #: the same, accepted by the user with widened intervals.
    result: str
    name: str  #: of the design.
    fingerprint: str  #: of its geometry.
    data: str  #: folder of the campaign.
    tests: int  #: number of tests used.
    numbers: int  #: number of measured values.
    unknowns: int  #: number of unknowns.
    found: tuple[Identified, ...]  #: the requested numbers.
    correlation: Array  #: of the identified numbers, in the order of `correlated`, given the design's diameters.
    correlated: tuple[str, ...]  #: their names.
    noise: tuple[NoiseScale, ...]  #: of each kind of reading.
    quantile: float  #: of the 95 % intervals, in standard deviations: Student's where noise was estimated.
    outliers: tuple[Outlier, ...]  #: readings that noise does not explain.
    shifts: tuple[ErrorContribution, ...]  #: error budget of the moduli.
    notes: tuple[str, ...]  #: lines for the user.
    residuals: tuple[Residual, ...]  #: of every reading.
    seconds: float  #: computing time.
    why: str = ""  #: what is inconsistent and what to check, where the tests contradict each other.
    likely_causes: tuple[LikelyCause, ...] = ()  #: of a contradiction, the likeliest first.
    widening: float = 1.0  #: largest factor on a standard deviation, of a contradiction that was accepted; else 1.
    served: tuple[str, ...] = ()  #: `campaigns.Test.digest` of the tests used, which a design keeps for `validate`.

    @property
    def valid(self) -> bool:
        """Whether its numbers may be used: the tests agree, or a contradiction was accepted."""
        return self.result in ("ok", "accepted")

    def as_inconsistent(self, why: str) -> "Identification":
        """Return the result without numbers, intervals or error budget, for the reason given."""
        numbers = tuple(
            Identified(number.name, number.words, number.unit, "withheld", number.design, number.design,
                       why="the tests contradict the design, or each other")
            for number in self.found
        )  # fmt: skip
        return replace(self, result="inconsistent", found=numbers, correlation=self.correlation[:0, :0],
                       correlated=(), shifts=(), why=why)  # fmt: skip

    @property
    def dimensions(self) -> str:
        """Name of the diameters that the interval `of_print` of each number is with."""
        return "tolerances of dimensions" if self.of("diameters") is None else "the diameters found"

    @property
    def causes(self) -> dict[str, tuple[ErrorContribution, ...]]:
        """Error budget by cause."""
        causes = dict.fromkeys(effect.cause for effect in self.shifts)
        return {cause: tuple(effect for effect in self.shifts if effect.cause == cause) for cause in causes}

    def of(self, name: str) -> Identified | None:
        """Return the number of that name, if it was requested and identified."""
        return next((number for number in self.found if number.name == name and number.identified), None)

    def csv(self) -> bytes:
        """Return every residual as a row of CSV."""
        names = [f"off_{i}" for i in range(1, 7)]
        rows = [{"test": residual.test, "kind": residual.kind, "item": residual.item or "", "s_mm": residual.s_mm,
                 **dict(zip(names, residual.off, strict=False)), "unit": UNITS[residual.kind],
                 "deviations": f"{residual.deviations:.4g}", "weight": f"{residual.weight:.4g}"}
                for residual in self.residuals]  # fmt: skip
        return csv_tables.write(["test", "kind", "item", "s_mm", *names, "unit", "deviations", "weight"], rows, ".6g")

    def as_dict(self) -> dict[str, Any]:
        """Return plain data for JSON."""
        document = asdict(self)
        document["correlation"] = self.correlation.tolist()
        document["residuals"] = [{**row, "unit": UNITS[row["kind"]]} for row in document["residuals"]]
        return document


def student_quantile(fit: Fit) -> float:
    """Return the quantile of 95 % intervals, in standard deviations: Student's with the fewest degrees of freedom that
    a noise scale was estimated with, else normal."""
    freedom = min((noise.freedom for noise in fit.noise if noise.measured), default=np.inf)
    return float(t.ppf(0.5 * (1.0 + CONFIDENCE), freedom))


def identified_numbers(
    fit: Fit,
    identified: Sequence[str],
    unobservable: Sequence[UnobservableDirection],
    requested: Sequence[str],
    quantile: float,
) -> tuple[tuple[Identified, ...], Array, tuple[str, ...]]:
    """Return every requested number and those that E implies, the correlation of the identified ones, and their names.

    `quantile` is that of the intervals, in standard deviations.
    """
    model, columns = fit.point.problem.common.model, columns_of(identified)
    why = {number.name: number.description for number in unobservable}
    implied = [name for name in IMPLIED if "E" in identified and name not in requested]
    numbers = []
    for column in columns_of([*requested, *implied]):
        owner, name = OWNER[column], COMPONENTS[column]
        if owner.name in why and not (owner.name in IMPLIED and "E" in identified):  # G and the root go with E
            design = owner.design_value(model)
            numbers.append(Identified(name, owner.labels[name], owner.unit, "not_observable", design, design,
                                    why=why[owner.name]))  # fmt: skip
        elif fit.point.problem.active[column]:
            number = _identified(fit, column, quantile)
            reason = _prior_of(fit, owner.name, owner.name in identified) or why.get(owner.name, "")
            numbers.append(replace(number, result="inferred", why=reason) if reason else number)
    cov = cov_conditional(fit, columns)
    std = np.sqrt(np.diag(cov))
    return tuple(numbers), cov / np.outer(std, std), tuple(COMPONENTS[column] for column in columns)


def _prior_of(fit: Fit, name: str, requested: bool) -> str:
    """Return which prior an implied parameter follows, where the tests contain less information on it; else empty."""
    column = columns_of([name])[0]
    if name == "G" and fit.point.problem.with_poisson:
        prior = POISSON_STD / (1.0 + POISSON)
        variance = float(fit.cov[_at(fit, column), _at(fit, column)])
        if fit.point.problem.active[LOG_E]:
            cov = cov_conditional(fit, [LOG_E, column])
            variance = float(cov[0, 0] - 2.0 * cov[0, 1] + cov[1, 1])
        text = f"not observable in these tests; E/G by Poisson's ratio {POISSON:g} ± {POISSON_STD:g}"
    elif name == "root" and not requested:
        prior = float(fit.point.problem.prior[column])
        variance = float(cov_conditional(fit, [column])[0, 0])
        text = f"not observable in these tests; prior ± {prior:.2g} by [tolerances]"
    else:
        return ""
    return text if variance > DATA_SHARE * prior**2 else ""


def _at(fit: Fit, column: int) -> int:
    return int(np.count_nonzero(fit.point.problem.active[:column]))


def _identified(fit: Fit, column: int, quantile: float) -> Identified:
    """Return one number given the design's dimensions, and with uncertain dimensions."""
    parameter, name = OWNER[column], COMPONENTS[column]
    model = fit.point.problem.common.model

    def interval(x: float, std: float) -> tuple[float, float, float, float]:
        value, low, high = (parameter.reported(model, x + sign * quantile * std) for sign in (0.0, -1.0, 1.0))
        return value, value * std if parameter.logarithm else parameter.scale * std, low, high

    x, std_x, by_diameter = conditional_estimate(fit, column)
    value, std, low, high = interval(x, std_x)
    i = _at(fit, column)
    of_print = interval(float(fit.point.values.x[column]), float(np.sqrt(fit.cov[i, i])))
    return Identified(name, parameter.labels[name], parameter.unit, "identified", value, parameter.design_value(model),
                      std, low, high, *of_print,
                      by_diameter=by_diameter if parameter.logarithm else None)  # fmt: skip


def residuals_of(fit: Fit) -> tuple[Residual, ...]:
    """Return every reading against the fit."""
    tests = {test.measured.name: test for test in fit.point.tests}
    rows, weights = [], {block.key: weight for block, weight in zip(fit.point.blocks, fit.weight, strict=True)}
    for block in fit.point.every_block():
        weight = weights.get(block.key, 0.0)
        scale = fit.scales.get(block.kind, 1.0)
        s = None
        if block.kind == "markers":
            measured = tests[block.test].measured
            s = float(measured.marker_s[measured.marker_numbers.index(block.item)]) / MM
        elif block.kind in ("touches", "wrenches") and not tests[block.test].measured.free:
            s = tests[block.test].eq.s_contact / MM
        unit = {"scales": 1e3, **dict.fromkeys(("markers", "touches", "places", "sags"), 1.0 / MM)}.get(block.kind, 1.0)
        residual = tuple(float(v) * unit for v in block.residual)
        distance = float(np.sqrt(block.squared_distance / len(block.r))) / scale
        rows.append(Residual(block.test, block.kind, block.item, s, residual, distance, float(weight) * scale**2))
    return tuple(rows)


def farthest_tests(residuals: Sequence[Residual]) -> str:
    """Return a line that names the three tests farthest from the fit, by χ² per degree of freedom."""
    by_test: dict[str, list[tuple[float, int]]] = {}
    for row in residuals:
        if row.test and row.kind in READING_KINDS:
            by_test.setdefault(row.test, []).append((row.deviations**2 * len(row.off), len(row.off)))
    sums = {test: (sum(part[0] for part in parts), sum(part[1] for part in parts)) for test, parts in by_test.items()}
    worst = sorted(sums, key=lambda test: -sums[test][0] / sums[test][1])[:3]
    return "farthest from the fit: " + "; ".join(f"{test} ({chi2_words(*sums[test])})" for test in worst)


# error budget


def error_budget(fit: Fit, names: Sequence[str]) -> tuple[ErrorContribution, ...]:
    """Return the contribution of each error source to the standard deviation of the moduli, density and diameters.

    A fit is linear in the values its priors are about: an error of one standard deviation σ of prior j changes the
    number i by C_ij/σ_j, C the covariance with the design's dimensions. What these leave of C_ii is due to the readings
    and the priors of single tests. What the acceptance of a contradiction adds to the variance is a term of its own.
    """
    total, fit = fit, replace(fit, added_cov=None)
    problem = fit.point.problem
    active = np.flatnonzero(problem.active)
    print_modes = range(problem.common.print_columns.start, problem.common.print_columns.stop)
    columns = [int(c) for c in active if c not in print_modes]
    cov, prior = cov_conditional(fit, columns), problem.prior[columns]
    causes = ["drift of the sensor" if c >= len(OWNER) else OWNER[c].prior_name or c for c in columns]
    result = []
    for name in names:
        if not PARAMETERS[name].logarithm:
            continue
        i = columns.index(columns_of([name])[0])
        share = np.where(np.isinf(prior), 0.0, cov[i] / np.where(np.isinf(prior), 1.0, prior)) ** 2
        squares: dict[str, float] = {}
        for cause, value in zip(causes, share, strict=True):
            if isinstance(cause, str):
                squares[cause] = squares.get(cause, 0.0) + float(value)
        squares["readings and single tests"] = max(float(cov[i, i]) - sum(squares.values()), 0.0)
        variance = float(cov_conditional(total, [columns[i]])[0, 0])
        squares[ACCEPTED] = max(variance - float(cov[i, i]), 0.0)
        for cause, value in sorted(squares.items(), key=lambda pair: -pair[1]):
            if value > MIN_CONTRIBUTION**2 * variance:
                result.append(ErrorContribution(cause, name, 100.0 * math.sqrt(value)))
    return tuple(result)


def widening(fit: Fit, names: Sequence[str]) -> float:
    """Return the largest factor on a standard deviation of these parameters by the acceptance of a contradiction."""
    if fit.added_cov is None:
        return 1.0
    at = [_at(fit, column) for column in columns_of(names)]
    return max(1.0, float(np.sqrt(np.diag(fit.cov)[at] / np.diag(fit.stated_cov)[at]).max()))


def beyond_limits(fit: Fit, names: Sequence[str]) -> tuple[UnobservableDirection, ...]:
    """Return the parameters whose standard deviation exceeds its limit of use, as after the acceptance of a
    contradiction."""
    lost = []
    for name in names:
        limit, at = PARAMETERS[name].max_std, [_at(fit, column) for column in columns_of([name])]
        std = float(np.sqrt(np.diag(fit.cov)[at]).max())
        if limit is not None and std > limit:
            text = (f"{name}: the contradiction leaves a standard deviation of {PARAMETERS[name].format_std(std)} "
                    f"(limit {PARAMETERS[name].format_std(limit)})")  # fmt: skip
            lost.append(UnobservableDirection(name, text))
    return tuple(lost)
