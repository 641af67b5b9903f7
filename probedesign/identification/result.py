"""Result of an identification: numbers with intervals, systematic effects, outliers and residuals, for JSON and CSV.

Attributes of the classes are the keys of identification.json, except those of `JSON_NAMES`, whose keys are older.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

import numpy as np
from scipy.stats import norm, t

from probedesign.core.frames import Array
from probedesign.core.units import MM, MPA
from probedesign.identification.fit_checks import UnobservableDirection, conditional_estimate, cov_conditional
from probedesign.identification.parameters import COMPONENTS, DIAMETERS, OWNER, PARAMETERS, PRINT, columns_of
from probedesign.identification.residuals import MeasuredTest, ResidualBlock
from probedesign.identification.solver import ROBUST_KINDS, Fit, NoiseScale, column_scales, linearize
from probedesign.rod.rod import Rod

CONFIDENCE = 0.95
UNITS = {"markers": "mm", "touches": "mm", "places": "mm", "sags": "mm", "wrenches": "N and N·m", "scales": "g",
         "friction": "share of the force"}  # fmt: skip
"""Units of residuals by kind of reading."""
ROOT_UNCERTAINTY = 0.05
"""Of root_rigid_radii, between the ways to hold a flange. Source: docs/decisions/0006."""
GAIN_UNCERTAINTY = 0.01
"""Of a sensor's gain. Assumed: certificates of the Nano17 state 1 to 1.75 % of full scale."""
SCALE_UNCERTAINTY = 0.005
"""Of a reference's length scale. Assumed: 0.5 mm on a box of 100 mm."""
WEAK = 0.5
"""Fraction of `Parameter.max_std` from which on the total standard deviation makes a parameter weakly identifiable
(assumed)."""
JSON_NAMES = {
    "std_total": "std_in_all",
    "low_total": "low_in_all",
    "high_total": "high_in_all",
    "caveat": "doubt",
}


@dataclass(frozen=True)
class Identified:
    """One requested number.

    Attributes:
        name: of the parameter or its component: E, tilt_x.
        words: what it is.
        unit: of all values below; empty for plain factors.
        result: "identified"; or "not_told" if it is not observable: then `value` is the design's and there is no
            interval.
        value: conditional on the design's diameters, which the frozen probe uses, even where those are requested too.
        std: standard deviation of the fit.
        low, high: 95 % interval of the fit.
        design: design value; 0 for a pose.
        value_of_print, std_of_print, low_of_print, high_of_print: the same with the diameters as uncertain as the
            design's tolerances: of the material rather than of the probe.
        std_total, low_total, high_total: of `value` with systematic effects, each taken as one standard deviation,
            independent of the others. A design gets these.
        by_diameter: power of the base diameter with which `value` changes if all diameters differ together; None if
            the diameters are not estimated.
        caveat: to be shown with the number; empty if there is none.
        why: what the tests determine instead, where it is not observable.
    """

    name: str
    words: str
    unit: str
    result: Literal["identified", "not_told"]
    value: float
    design: float
    std: float | None = None
    low: float | None = None
    high: float | None = None
    value_of_print: float | None = None
    std_of_print: float | None = None
    low_of_print: float | None = None
    high_of_print: float | None = None
    std_total: float | None = None
    low_total: float | None = None
    high_total: float | None = None
    by_diameter: float | None = None
    caveat: str = ""
    why: str = ""

    @property
    def relative_std_total(self) -> float:
        """`std_total` relative to the value."""
        assert self.std_total is not None
        return self.std_total / self.value

    @property
    def identified(self) -> bool:
        """Whether the tests determine it."""
        return self.result == "identified"


@dataclass(frozen=True)
class Outlier:
    """A reading that noise does not explain; it has little weight.

    Attributes:
        test: its test.
        kind: markers, wrenches or touches.
        item: the marker's number; 0 for the others.
        deviations: Mahalanobis distance.
    """

    test: str
    kind: str
    item: int
    deviations: float

    @property
    def words(self) -> str:
        """Name of the reading."""
        what = {"markers": f"marker {self.item}", "wrenches": "the wrench", "touches": "the touched place"}
        return f"{what[self.kind]} of {self.test}"


@dataclass(frozen=True)
class SystematicEffect:
    """Change of one number by a systematic error that the fit's interval does not include.

    Attributes:
        cause: description of the error.
        of: the number.
        percent: change of the number.
    """

    cause: str
    of: str
    percent: float


@dataclass(frozen=True)
class Residual:
    """One reading against the fit.

    Attributes:
        test, kind, item: which.
        s_mm: arclength of a marker or a touch; None for the others.
        off: measured minus modelled: mm, or N and N·m, or g.
        deviations: Mahalanobis distance with the estimated noise, over the root of the number of its values.
        weight: 1 for a reading with full weight.
    """

    test: str
    kind: str
    item: int
    s_mm: float | None
    off: tuple[float, ...]
    deviations: float
    weight: float


@dataclass(frozen=True)
class Identification:
    """Identified numbers of one campaign.

    Attributes:
        result: "ok"; "not_converged"; or "inconsistent": the tests contradict the probe as designed, or each other.
        name: of the design.
        fingerprint: of its geometry.
        data: folder of the campaign.
        tests: number of tests used.
        numbers: number of measured values.
        unknowns: number of unknowns.
        found: the requested numbers.
        correlation: of the identified numbers, in the order of `correlated`, given the design's diameters.
        correlated: their names.
        noise: of each kind of reading.
        quantile: of the 95 % intervals, in standard deviations: Student's where noise was estimated.
        outliers: readings that noise does not explain.
        shifts: systematic effects.
        notes: lines for the user.
        residuals: of every reading.
        seconds: computing time.
        why: what is inconsistent and what to check, where the result is "inconsistent".
        served: `campaigns.Test.digest` of the tests used, which a design keeps for `validate`.
    """

    result: str
    name: str
    fingerprint: str
    data: str
    tests: int
    numbers: int
    unknowns: int
    found: tuple[Identified, ...]
    correlation: Array
    correlated: tuple[str, ...]
    noise: tuple[NoiseScale, ...]
    quantile: float
    outliers: tuple[Outlier, ...]
    shifts: tuple[SystematicEffect, ...]
    notes: tuple[str, ...]
    residuals: tuple[Residual, ...]
    seconds: float
    why: str = ""
    served: tuple[str, ...] = ()

    def as_inconsistent(self, why: str) -> "Identification":
        """Return the result without numbers, intervals or systematic effects, for the reason given."""
        found = tuple(
            Identified(one.name, one.words, one.unit, "not_told", one.design, one.design,
                       why=one.why or "the tests contradict the design, or each other")
            for one in self.found
        )  # fmt: skip
        return replace(self, result="inconsistent", found=found, correlation=self.correlation[:0, :0],
                       correlated=(), shifts=(), why=why)  # fmt: skip

    @property
    def dimensions(self) -> str:
        """Name of the diameters that the interval `of_print` of each number is with."""
        return "tolerances of dimensions" if self.of("diameters") is None else "the diameters found"

    @property
    def caveats(self) -> tuple[str, ...]:
        """Caveats of the numbers, one line each."""
        return tuple(f"{one.name}: {one.caveat}" for one in self.found if one.caveat)

    @property
    def causes(self) -> dict[str, tuple[SystematicEffect, ...]]:
        """Systematic effects by their cause."""
        causes = dict.fromkeys(effect.cause for effect in self.shifts)
        return {cause: tuple(effect for effect in self.shifts if effect.cause == cause) for cause in causes}

    def of(self, name: str) -> Identified | None:
        """Return the number of that name, if it was requested and identified."""
        return next((one for one in self.found if one.name == name and one.identified), None)

    def csv(self) -> bytes:
        """Return every residual as a row of CSV."""
        rows = ["test,kind,item,s_mm,off_1,off_2,off_3,off_4,off_5,off_6,unit,deviations,weight"]
        for one in self.residuals:
            off = [f"{value:.6g}" for value in one.off] + [""] * (6 - len(one.off))
            s = "" if one.s_mm is None else f"{one.s_mm:.6g}"
            rows.append(",".join([one.test, one.kind, str(one.item or ""), s, *off, UNITS[one.kind],
                                  f"{one.deviations:.4g}", f"{one.weight:.4g}"]))  # fmt: skip
        return ("\n".join(rows) + "\n").encode()

    def as_dict(self) -> dict[str, Any]:
        """Return plain data for JSON."""
        document = asdict(self)
        document["found"] = [
            {JSON_NAMES.get(key, key): value for key, value in one.items()} for one in document["found"]
        ]
        document["correlation"] = self.correlation.tolist()
        document["residuals"] = [{**row, "unit": UNITS[row["kind"]]} for row in document["residuals"]]
        return document


def student_quantile(fit: Fit) -> float:
    """Return the quantile of 95 % intervals, in standard deviations: Student's with the fewest degrees of freedom that
    a noise scale was estimated with, else normal."""
    freedom = [one.freedom for one in fit.noise if one.measured]
    share = 0.5 * (1.0 + CONFIDENCE)
    return float(t.ppf(share, min(freedom)) if freedom else norm.ppf(share))


def identified_numbers(
    fit: Fit,
    identified: Sequence[str],
    unobservable: Sequence[UnobservableDirection],
    requested: Sequence[str],
    quantile: float,
) -> tuple[tuple[Identified, ...], Array, tuple[str, ...]]:
    """Return every requested number, the correlation of the identified ones, and their names.

    `quantile` is that of the intervals, in standard deviations.
    """
    rod, columns = fit.point.problem.common.model.rod, columns_of(identified)
    why = {one.name: one.description for one in unobservable}
    found = []
    for column in columns_of(requested):
        owner, name = OWNER[column], COMPONENTS[column]
        if owner.name in why:
            design = owner.design_value(rod)
            found.append(Identified(name, owner.labels[name], owner.unit, "not_told", design, design,
                                    why=why[owner.name]))  # fmt: skip
        else:
            found.append(_identified(fit, column, quantile))
    cov = cov_conditional(fit, columns)
    std = np.sqrt(np.diag(cov))
    return tuple(found), cov / np.outer(std, std), tuple(COMPONENTS[column] for column in columns)


def _identified(fit: Fit, column: int, quantile: float) -> Identified:
    """Return one number given the design's dimensions, and with uncertain dimensions."""
    parameter, name = OWNER[column], COMPONENTS[column]
    rod = fit.point.problem.common.model.rod

    def interval(x: float, std: float) -> tuple[float, float, float, float]:
        """Return value, standard deviation and ends of the interval in the reported unit."""
        value, low, high = (parameter.reported(rod, x + sign * quantile * std) for sign in (0.0, -1.0, 1.0))
        return value, value * std if parameter.logarithm else parameter.scale * std, low, high

    x, std_x, by_diameter = conditional_estimate(fit, column)
    value, std, low, high = interval(x, std_x)
    i = int(fit.point.problem.active[:column].sum())
    of_print = interval(float(fit.point.values.x[column]), float(np.sqrt(fit.cov[i, i])))
    return Identified(name, parameter.labels[name], parameter.unit, "identified", value, parameter.design_value(rod),
                      std, low, high, *of_print,
                      by_diameter=by_diameter if parameter.logarithm else None)  # fmt: skip


def residuals_of(fit: Fit) -> tuple[Residual, ...]:
    """Return every reading against the fit."""
    tests = {test.measured.name: test for test in fit.point.tests}
    found = []
    for block, weight in zip(fit.point.blocks, fit.weight, strict=True):
        scale = fit.scales.get(block.kind, 1.0) if block.kind in ROBUST_KINDS else 1.0
        s = None
        if block.kind == "markers":
            measured = tests[block.test].measured
            s = float(measured.marker_s[measured.marker_numbers.index(block.item)]) / MM
        elif block.kind in ("touches", "wrenches") and not tests[block.test].measured.free:
            s = tests[block.test].eq.s_contact / MM
        unit = {"wrenches": 1.0, "friction": 1.0, "scales": 1e3}.get(block.kind, 1.0 / MM)
        off = tuple(float(v) * unit for v in block.residual)
        distance = float(np.sqrt(block.squared_distance / len(block.r))) / scale
        found.append(Residual(block.test, block.kind, block.item, s, off, distance, float(weight) * scale**2))
    return tuple(found)


# systematic effects


def systematic_effects(fit: Fit, identified: Sequence[str]) -> tuple[SystematicEffect, ...]:
    """Return the changes of moduli, density and diameters, to first order, by errors of the root, the sensor's gain
    and the reference's length scale."""
    names = [name for name in identified if PARAMETERS[name].logarithm]
    if not names:
        return ()
    point = fit.point
    errors = {
        f"sensor gain {GAIN_UNCERTAINTY:.0%} too large": GAIN_UNCERTAINTY * _by_readings(fit, _gain_reading),
        f"length scale of the reference {SCALE_UNCERTAINTY:.1%} too small": SCALE_UNCERTAINTY
        * _by_readings(fit, _length_reading),
    }
    if "root" not in identified:
        own = [test.nuisance for test in point.tests]
        other = linearize(point.problem, point.values, own, point, root=True)
        if other.ok:
            by_root = ROOT_UNCERTAINTY * other.fixed_jacobian(columns_of(["root"]), fit.weight)[:, 0]
            errors = {f"root_rigid_radii {ROOT_UNCERTAINTY:g} larger": by_root, **errors}
    return tuple(
        SystematicEffect(cause, name, 100.0 * float(np.expm1(_change(fit, name, d_residuals))))
        for cause, d_residuals in errors.items()
        if d_residuals.any()
        for name in names
    )


def _change(fit: Fit, name: str, d_residuals: Array) -> float:
    """Return the change of one logarithm, to first order, by a change of the residuals at fixed dimensions."""
    active, column = np.flatnonzero(fit.point.problem.active), columns_of([name])[0]
    fixed = (active >= PRINT) | ((active == DIAMETERS) & (column != DIAMETERS))
    keep = np.concatenate([~fixed, np.ones(fit.point.problem.size - len(active), dtype=bool)])
    rows = fit.point.system(fit.weight)[0][:, keep]
    units = column_scales(rows)
    i = int(np.count_nonzero(~fixed & (active < column)))
    return float(-(np.linalg.lstsq(rows * units, d_residuals)[0] * units)[i])


def _gain_reading(block: ResidualBlock, test: MeasuredTest) -> tuple[Array, Array] | None:
    """Return what the sensor's gain scales in a block and its covariance; None if nothing."""
    wrench, cov = test.wrench_base, test.cov_wrench
    return (wrench, cov) if block.kind == "wrenches" and wrench is not None and cov is not None else None


def _length_reading(block: ResidualBlock, test: MeasuredTest) -> tuple[Array, Array] | None:
    """Return what the length scale of the reference scales in a block and its covariance; None if nothing."""
    base = test.T_world_base[:3, 3]
    if block.kind == "markers":
        i = test.marker_numbers.index(block.item)
        return test.p_markers_world[i] - base, test.cov_markers[i]
    if block.kind == "touches" and test.p_touch_world is not None:
        return test.p_touch_world - base, test.std_touch**2 * np.eye(3)
    if block.kind == "sags":
        return np.array([test.sag]), np.array([[test.std_sag**2]])
    return None


def _by_readings(
    fit: Fit, reading: Callable[[ResidualBlock, MeasuredTest], tuple[Array, Array] | None]
) -> Array:
    """Return the derivative of the weighted residuals by the logarithm of a scale of the readings; `reading` gives what
    it scales in a block, and the covariance."""
    rows = [np.zeros(fit.point.problem.n_active)]
    tests = {test.measured.name: test.measured for test in fit.point.tests}
    for block, w in zip(fit.point.blocks, fit.weight, strict=True):
        change = reading(block, tests[block.test]) if block.test in tests else None
        if change is None:
            rows.append(np.zeros(len(block.r)))
        else:
            rows.append(np.sqrt(w) * np.linalg.solve(np.linalg.cholesky(change[1]), change[0]))
    return np.concatenate(rows)


def with_systematics(
    numbers: Sequence[Identified], effects: Sequence[SystematicEffect], quantile: float
) -> tuple[Identified, ...]:
    """Return the numbers with total standard deviations and intervals: the fit's and each systematic effect, as if
    independent. `quantile` is that of the intervals."""
    result = []
    for one in numbers:
        if one.identified:
            assert one.std is not None
            own = (one.value * 1e-2 * effect.percent for effect in effects if effect.of == one.name)
            std = math.hypot(one.std, *own)
            low, high = one.value - quantile * std, one.value + quantile * std
            if one.name in PARAMETERS and PARAMETERS[one.name].logarithm:
                low, high = (one.value * math.exp(sign * quantile * std / one.value) for sign in (-1.0, 1.0))
            one = replace(one, std_total=std, low_total=low, high_total=high)
        result.append(one)
    return tuple(result)


def with_caveats(numbers: Sequence[Identified], rod: Rod) -> tuple[Identified, ...]:
    """Return the numbers, with caveats where one is weakly identifiable or G is consistent with a fixed ratio to E."""
    E = next((one.value for one in numbers if one.name == "E"), rod.youngs_modulus / MPA)
    ratio = rod.youngs_modulus / rod.shear_modulus
    return tuple(
        replace(one, caveat="; ".join(_caveats(one, E, ratio))) if one.identified else one for one in numbers
    )


def _caveats(one: Identified, E: float, design_ratio: float) -> list[str]:
    """Return caveats of a number: near the limit of observability, or a G that is consistent with a fixed ratio to E.

    The ratios to E are that of an incompressible solid and the design's.
    """
    parameter, caveats = PARAMETERS.get(one.name), []
    limit = parameter.max_std if parameter is not None and parameter.logarithm else None
    if limit is not None and one.relative_std_total >= WEAK * limit:
        caveats.append(f"weakly identifiable: total standard deviation {one.relative_std_total:.0%} (limit {limit:.0%})"
                       "; consider fixing it at the design value")  # fmt: skip
    if one.name == "G" and one.low_total is not None and one.high_total is not None:
        ratios = {"E/3": 3.0, f"the design's E/{design_ratio:.3g}": design_ratio}
        inside = [name for name, ratio in ratios.items() if one.low_total <= E / ratio <= one.high_total]
        if inside:
            caveats.append(f"consistent with {' and '.join(inside)}")
    return caveats
