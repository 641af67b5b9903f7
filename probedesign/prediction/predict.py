"""Prediction of a probe's performance before it is printed: sensitivity, detection, saturation and localisation
error."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from probedesign.core import csv_tables
from probedesign.core.frames import Array
from probedesign.core.notebook import Tabular
from probedesign.core.parallel import OnProgress, quiet
from probedesign.core.units import MM
from probedesign.estimation.estimator import Estimator
from probedesign.estimation.model import AFTER_AN_HOUR, ProbeModel, Tolerances
from probedesign.prediction.budget import CAUSES
from probedesign.prediction.fused import (
    FUSED_CAUSES,
    SHOWN_N,
    FusedCondition,
    FusedHeadline,
    PredictedTouch,
    PressSchedule,
    forces_of,
    fused_conditions,
    fused_headline_of,
    worst,
)
from probedesign.prediction.thresholds import LADDER_N, ForceThresholds, force_thresholds
from probedesign.prediction.touches import Touches, check_grid, directions_of, touches_of
from probedesign.rod.equilibrium import Equilibrium
from probedesign.rod.rod import Rod

FRACTIONS = tuple(round(0.1 * k, 1) for k in range(1, 11))
FORCES_N = (0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2)
#: Touch that the verdict and the shown error budget describe: the smallest force of the paper's Table I, where its
#: touches near the tip are.
HEADLINE_FORCE_N, HEADLINE_FRACTION = 0.01, 0.8
#: Error sources with a common remedy.
CAUSE_GROUPS = {
    "noise": ("noise",),
    "drift": ("drift",),
    "robot": ("robot",),
    "friction": ("friction",),
    "object": ("object",),
    "stiffness": ("E", "G", "creep", "stiffness scatter"),
    "shape": ("diameter", "diameter scatter", "bore", "length", "bow"),
    "mount": ("base place", "base tilt", "clocking", "pose", "root", "gain"),
    "weight": ("density", "gravity"),
}
PRESSING = PressSchedule()
_WEAK_N = 1e-6  # small enough for the response to be linear


@dataclass(frozen=True)
class Condition(PredictedTouch):
    """Prediction for one touch."""

    std_s_mm: float | None = None  #: standard deviation of s_contact by all error sources.
    deflection_mm: float | None = None  #: distance of the contact point from its place on the free probe.
    #: moment_per_N_Nmm, force_per_N_N: derivative of the base's moment and force by the normal force.
    moment_per_N_Nmm: float | None = None
    force_per_N_N: float | None = None
    #: moment_per_mm_Nmm, force_per_mm_N: the same by the indentation at constant s.
    moment_per_mm_Nmm: float | None = None
    force_per_mm_N: float | None = None
    sensor_use: float | None = None  #: largest fraction of a channel's range that the reading takes.


@dataclass(frozen=True)
class ErrorOverDirections:
    """RMS errors of single readings over the directions of the force; None where the probe buckles in one of them."""

    contact_fraction: float  #: arclength of the touched section over length.
    force_N: float  #: normal force.
    #: by all error sources, of pushes at 0°, 15° ... 345° about the tangent from the section's X axis.
    errors_mm: tuple[float | None, ...]
    rms_error_mm: float | None  #: rms_error_mm, median_error_mm, worst_error_mm: over these directions.
    median_error_mm: float | None
    worst_error_mm: float | None


@dataclass(frozen=True)
class Detection:
    """Force that one reading detects with probability 0.5 at one position, noise and drift included.

    See `Estimator.detectable`; None where the probe buckles before.
    """

    contact_fraction: float
    direction: str
    detectable_force_mN: float | None


@dataclass(frozen=True)
class MonteCarloResult:
    """Monte Carlo result of one condition; None where nothing was located."""

    contact_fraction: float  #: contact_fraction, force_N, direction: of the condition.
    force_N: float
    direction: str
    draws: int  #: number of print samples.
    located: int  #: number of draws with the result "ok".
    #: error_mm, error_95_mm: RMS distance and 95 % quantile of the best candidates, those with the result
    #: "inconsistent" included.
    error_mm: float | None
    error_95_mm: float | None
    standard_error_mm: float | None  #: of that RMS.
    first_order_mm: float | None  #: predicted by the error budget.
    differs: bool  #: whether the two differ by more than a tenth and two standard errors.
    touches: int = 1  #: number of fused touches; 1 is a single reading.
    inside: int = 0  #: number of "ok" draws whose 95 % ellipsoid contains the true point.


@dataclass(frozen=True)
class BenchGain:
    """Errors of one probe with its stiffness known as after an hour on the bench, the rest as before; None where
    nothing is located."""

    stiffness: float  #: standard deviation of E and of G then, relative.
    contact_fraction: float  #: arclength of the touched section over the length.
    #: RMS distance of one reading of `HEADLINE_FORCE_N`, worst direction, by all error sources.
    predicted_error_mm: float | None
    fused_error_mm: float | None  #: the same of fused touches up to `SHOWN_N`.

    @property
    def text(self) -> str:
        """Return the gain in words."""
        single, fused = ("not located" if error is None else f"{error:.2g} mm RMS"
                         for error in (self.predicted_error_mm, self.fused_error_mm))  # fmt: skip
        return (f"an hour of it, E known to {self.stiffness:.0%}: at {self.contact_fraction:g} L one reading of "
                f"{1e3 * HEADLINE_FORCE_N:g} mN {single}, fused up to {1e3 * SHOWN_N:g} mN {fused}")  # fmt: skip


@dataclass(frozen=True)
class Prediction(Tabular):
    """Predicted performance of a probe."""

    name: str  #: of the probe.
    fingerprint: str  #: of its geometry.
    assumptions: tuple[str, ...]  #: assumed values of the design that the numbers depend on.
    mass_g: float  #: mass_g, length_mm: of the flexible part.
    length_mm: float
    tip_sag_mm: float | None  #: displacement of the tip along gravity.
    noise_force_mN: float  #: noise_force_mN, noise_moment_Nmm: standard deviation of a reading's channels.
    noise_moment_Nmm: float
    #: prior standard deviation of tangential over normal force; None where the direction is free.
    friction: float | None
    conditions: tuple[Condition, ...]  #: the grid.
    detection: tuple[Detection, ...]  #: detection limits along the probe.
    reach: tuple[ForceThresholds, ...]  #: force thresholds along the probe.
    tolerances: Tolerances  #: standard deviations of the error sources, with the source of each number.
    fused: tuple[FusedCondition, ...] = ()  #: the same grid, each point touched several times and fused.
    pressing: PressSchedule = PRESSING  #: how they are made.
    monte_carlo: tuple[MonteCarloResult, ...] = ()  #: of the conditions that are located; empty if none was run.
    resin: str = ""  #: name of the resin; empty if unknown.
    #: what an hour on the bench gains; None if the stiffness is known as well already, and in a preview.
    bench_gain: BenchGain | None = None
    over_directions: tuple[ErrorOverDirections, ...] = ()  #: of a curved probe, over the same places and forces.

    @property
    def verdict(self) -> str:
        """The result in one sentence: error, detection limit and largest error source of one light touch."""
        if self.tip_sag_mm is None:
            return "The probe buckles under its own weight as mounted."
        touch = min(
            worst(self.conditions, HEADLINE_FORCE_N),
            key=lambda c: abs(c.contact_fraction - HEADLINE_FRACTION),
            default=None,
        )
        if touch is None or touch.predicted_error_mm is None:
            return f"One reading of {1e3 * HEADLINE_FORCE_N:g} mN is located nowhere along the probe."
        fraction = touch.contact_fraction
        felt = [d.detectable_force_mN for d in self.detection if d.contact_fraction == fraction]
        detected = max((f for f in felt if f is not None), default=math.nan)
        shares = shares_of(touch)
        largest = max(shares, key=lambda group: shares[group])
        across = ""
        for over in self.over_directions:
            if (over.contact_fraction, over.force_N) == (fraction, touch.force_N) and over.median_error_mm is not None:
                across = f" in the worst direction, {over.median_error_mm:.2g} mm in the median one"
        return (
            f"At {fraction:g} of the length a touch is felt from {detected:.2g} mN, and one reading of "
            f"{1e3 * touch.force_N:g} mN locates it within {touch.predicted_error_mm:.2g} mm RMS{across}. The largest "
            f"error source is then {largest}, with {shares[largest]:.0%} of the variance."
        )

    @property
    def fused_headline(self) -> FusedHeadline:
        """The error of fused touches up to `SHOWN_N` at the position of the verdict."""
        return fused_headline_of(self.fused, self.pressing.touches, HEADLINE_FRACTION)

    def as_dict(self) -> dict[str, Any]:
        """Return plain data for JSON; every key ends in its unit."""
        return {
            "schema": 1,
            "verdict": self.verdict,
            "fused_headline": asdict(self.fused_headline),
            **asdict(self),
            "tolerance_sources": self.tolerances.sources(self.resin, self.length_mm * MM),
        }


def fused_headline(model: ProbeModel) -> FusedHeadline:
    """Return `Prediction.fused_headline` of a probe without the rest of its prediction."""
    return predict(model, (HEADLINE_FRACTION,), (SHOWN_N,)).fused_headline


def predict(
    model: ProbeModel,
    fractions: tuple[float, ...] = FRACTIONS,
    forces_N: tuple[float, ...] = FORCES_N,
    directions: tuple[str, ...] | None = None,
    tolerances: Tolerances | None = None,
    pressing: PressSchedule = PRESSING,
    only_single: bool = False,
    on_progress: OnProgress = quiet,
) -> Prediction:
    """Predict sensitivity and contact error over a grid of touches.

    The error is the first-order covariance of the estimator's own residuals at touches of the model without friction,
    including all error sources and the prior on friction (`budget.py`): what `estimate` and `fuse` return at such a
    touch.

    Args:
        model: of the probe.
        fractions: contact positions over the length, in (0, 1].
        forces_N: normal forces [N].
        directions: in which the object pushes, see `angle_of`; those of `directions_of` the probe if None.
        tolerances: standard deviations of the error sources; `Tolerances.of` the model if None.
        pressing: how the fused touches of one point are made.
        only_single: leave out radii of 95 %, fused touches, and force thresholds, for a preview within tens of
            milliseconds.
        on_progress: receives the step and its share some tens of times a second; an exception that it raises ends the
            prediction.

    Raises:
        InputError: a fraction, force or direction is out of range.
    """
    directions = directions_of(model.rod) if directions is None else directions
    check_grid(fractions, forces_N, directions)
    estimator = Estimator(model, tolerances)
    known = estimator.priors
    end = model.rod.flank_end / model.rod.length
    lines = [(fraction, direction) for fraction in fractions for direction in directions]
    ends = [(end, direction) for direction in directions if (end, direction) not in lines]
    # What holds for a probe without a stable free equilibrium, and what a preview leaves out.
    gain, over = None, tuple[ErrorOverDirections, ...]()
    reach = tuple(ForceThresholds(*line, None, None, None, None, "gives_way", None) for line in lines)
    detection = tuple(Detection(*line, None) for line in lines)
    conditions = {(*line, force): Condition(line[0], force, line[1], "gives_way")
                  for line in lines for force in forces_N}  # fmt: skip
    fused = tuple(FusedCondition(fraction, force, side, "gives_way", touches=pressing.touches)
                  for fraction in fractions for force in forces_N for side in directions)  # fmt: skip
    if estimator.free().ok:
        pressed = () if only_single else forces_of(pressing, forces_N)
        ladder, ends = ((), []) if only_single else (LADDER_N, ends)
        touches = touches_of(estimator, lines + ends, (_WEAK_N, *ladder, *forces_N, *pressed), on_progress)
        for force in forces_N:
            for line, condition in zip(lines, conditions_of(touches[force], lines, not only_single), strict=True):
                conditions[(*line, force)] = condition
        if model.rod.is_curved:  # a preview has the place of the verdict alone
            nearest = min(fractions, key=lambda at: abs(at - HEADLINE_FRACTION))
            over = errors_over_directions(estimator, (nearest,) if only_single else fractions, forces_N)
        if only_single:
            limits = [max((f for f in forces_N if touches[f].ok[i]), default=None) for i in range(len(lines))]
        else:
            reach = force_thresholds(lines + ends, {f: touches[f] for f in LADDER_N}, end)[: len(lines)]
            limits = [row.greatest_force_N for row in reach]
            fused = fused_conditions(lines, touches, forces_N, pressing, on_progress)
            gain = _bench_gain(estimator, fractions, directions, pressing)
        detection = tuple(
            _detection(touches[_WEAK_N], i, line, limit)
            for i, (line, limit) in enumerate(zip(lines, limits, strict=True))
        )
    return Prediction(
        name=model.name,
        fingerprint=model.fingerprint,
        assumptions=model.assumptions,
        mass_g=1e3 * model.mass,
        length_mm=model.rod.length / MM,
        tip_sag_mm=tip_sag_mm(estimator),
        noise_force_mN=1e3 * model.noise.force,
        noise_moment_Nmm=1e3 * model.noise.moment,
        friction=finite_or_none(model.friction),
        conditions=tuple(
            conditions[fraction, direction, force]
            for fraction in fractions for force in forces_N for direction in directions
        ),
        detection=detection,
        reach=reach,
        tolerances=known,
        fused=fused,
        pressing=pressing,
        resin=model.resin,
        bench_gain=gain,
        over_directions=over,
    )  # fmt: skip


def _bench_gain(
    estimator: Estimator, fractions: Sequence[float], directions: Sequence[str], pressing: PressSchedule
) -> BenchGain | None:
    known = estimator.priors
    better = replace(known, youngs_modulus=min(known.youngs_modulus, AFTER_AN_HOUR),
                     shear_modulus=min(known.shear_modulus, AFTER_AN_HOUR))  # fmt: skip
    if better == known:
        return None
    fraction = min(fractions, key=lambda fraction: abs(fraction - HEADLINE_FRACTION))
    lines = [(fraction, direction) for direction in directions]
    touches = touches_of(estimator.with_tolerances(better), lines, (HEADLINE_FORCE_N, *pressing.forces(SHOWN_N)))
    single = worst(conditions_of(touches[HEADLINE_FORCE_N], lines), HEADLINE_FORCE_N)
    fused = fused_headline_of(fused_conditions(lines, touches, (SHOWN_N,), pressing), pressing.touches, fraction)
    return BenchGain(
        better.youngs_modulus, fraction, single[0].predicted_error_mm if single else None, fused.predicted_error_mm
    )


DIRECTION_STEP_DEG = 15  #: Between the directions of `errors_over_directions`.


def errors_over_directions(
    estimator: Estimator, fractions: Sequence[float], forces_N: Sequence[float]
) -> tuple[ErrorOverDirections, ...]:
    """Return the errors of single readings over the direction of the force, at each place and force."""
    degrees = range(0, 360, DIRECTION_STEP_DEG)
    touches = touches_of(estimator, [(at, f"{k}deg") for at in fractions for k in degrees], forces_N)
    rows = []
    for i, at in enumerate(fractions):
        for force in forces_N:
            errors = touches[force].rms[0][i * len(degrees) : (i + 1) * len(degrees)] / MM
            figures = (float(np.sqrt((errors**2).mean())), float(np.median(errors)), float(errors.max()))
            shown = tuple(map(finite_or_none, errors.tolist()))
            rows.append(ErrorOverDirections(at, force, shown, *map(finite_or_none, figures)))
    return tuple(rows)


def shares_of(condition: PredictedTouch) -> dict[str, float]:
    """Return the shares of the variance by group of error sources."""
    budget = condition.budget_mm or {}
    squares = {name: sum(budget.get(cause, 0.0) ** 2 for cause in causes) for name, causes in CAUSE_GROUPS.items()}
    whole = sum(squares.values()) or 1.0
    return {name: square / whole for name, square in squares.items()}


def predict_touch(
    estimator: Estimator, fraction: float, force_N: float, direction: str, tolerances: Tolerances | None = None
) -> Condition:
    """Predict one condition; see `predict`."""
    if not estimator.free().ok:
        return Condition(fraction, force_N, direction, "gives_way")
    if tolerances is not None:
        estimator = estimator.with_tolerances(tolerances)
    line = (fraction, direction)
    return conditions_of(touches_of(estimator, [line], [force_N])[force_N], [line])[0]


def conditions_of(touches: Touches, lines: Sequence[tuple[float, str]], radii: bool = True) -> list[Condition]:
    """Return the conditions of some lines at one force; without the radii of 95 % if not `radii`."""
    per_N = touches.wrench_by_force
    by_moment, by_force = np.linalg.norm(per_N[:, 3:6], axis=1), np.linalg.norm(per_N[:, 0:3], axis=1)
    per_mm = MM / np.where(touches.press_per_N > 0.0, touches.press_per_N, np.nan)
    error = touches.rms[0] / MM
    within = touches.within_95 if radii else np.full((2, len(error)), np.nan)
    numbers = {
        "predicted_error_mm": error,
        "predicted_error_95_mm": within[0] / MM,
        "noise_error_mm": touches.rms[1] / MM,
        "noise_error_95_mm": within[1] / MM,
        "std_s_mm": touches.budget.std_s / MM,
        "deflection_mm": touches.deflection / MM,
        "moment_per_N_Nmm": 1e3 * by_moment,
        "force_per_N_N": by_force,
        "moment_per_mm_Nmm": 1e3 * by_moment * per_mm,
        "force_per_mm_N": by_force * per_mm,
        "sensor_use": touches.sensor_use,
    }
    # Numbers that are infinite or NaN do not exist.
    columns = {name: column.tolist() for name, column in numbers.items()}
    values = [[x if math.isfinite(x) else None for x in row] for row in zip(*columns.values(), strict=True)]
    budgets = [dict(zip(CAUSES, row, strict=True)) if math.isfinite(sum(row)) else None
               for row in (touches.budget.rms / MM).tolist()]  # fmt: skip
    rows = zip(lines, touches.results(), values, budgets, strict=False)
    return [
        Condition(fraction, touches.force_N, side, result, **dict(zip(columns, row, strict=True)), budget_mm=budget)
        for (fraction, side), result, row, budget in rows
    ]


def tip_sag_mm(estimator: Estimator) -> float | None:
    """Return the sag of the tip [mm], see `tip_sag`; None if the probe has no stable free equilibrium."""
    free = estimator.free()
    return tip_sag(free, estimator.model.rod, estimator.model.gravity_base) / MM if free.ok else None


def tip_sag(free: Equilibrium, rod: Rod, gravity: Array) -> float:
    """Return the displacement of the free tip along gravity from the unloaded probe [m]; 0 without gravity.

    It is measured from `Rod.sag_origin`, as the sags of a campaign (`tip_sag_mm`).

    Args:
        free: equilibrium without contact.
        rod: the flexible part.
        gravity: base axes [m/s²], (3,).
    """
    if not gravity.any():
        return 0.0
    return float((free.p_at(rod.length) - rod.sag_origin) @ gravity / np.linalg.norm(gravity))


def _detection(touches: Touches, i: int, line: tuple[float, str], max_force: float | None) -> Detection:
    """Return the detection limit, which is proportional to a weak push; None where the probe buckles before."""
    if not touches.ok[i] or max_force is None:
        return Detection(*line, None)
    felt = touches.estimator.detectable(touches.wrench_by_force[i])
    return Detection(*line, 1e3 * felt if felt <= max_force else None)


def finite_or_none(value: float) -> float | None:
    """Return the number, None where it is infinite or NaN."""
    return float(value) if math.isfinite(value) else None


def condition_rows(prediction: Prediction) -> tuple[list[str], list[dict[str, Any]]]:
    """Return the columns and rows of a table of all conditions, single (touches = 1) and fused, error sources last."""
    first = ["contact_fraction", "force_N", "direction", "touches", "result"]
    sources = {cause: f"budget_{cause.replace(' ', '_')}_mm" for cause in FUSED_CAUSES}
    rows = []
    for row in [{"touches": 1, **asdict(c)} for c in prediction.conditions] + [*map(asdict, prediction.fused)]:
        budget = row.pop("budget_mm") or {}
        rows.append(row | {sources[cause]: value for cause, value in budget.items()})
    known = {*first, *sources.values()}
    between = [name for name in dict.fromkeys(k for row in rows for k in row) if name not in known]
    return [*first, *between, *sources.values()], rows


def conditions_csv(prediction: Prediction) -> bytes:
    """Return `condition_rows` as CSV."""
    return csv_tables.write(*condition_rows(prediction), spec=".6g")


def along_csv(prediction: Prediction) -> bytes:
    """Return a CSV table with detection, thresholds and limits by position and direction."""
    rows: dict[tuple[float, str], dict[str, Any]] = {}
    shown: tuple[Detection | ForceThresholds, ...] = (*prediction.detection, *prediction.reach)
    for line in shown:
        rows.setdefault((line.contact_fraction, line.direction), {}).update(asdict(line))
    return csv_tables.write(list(dict.fromkeys(k for row in rows.values() for k in row)), rows.values(), ".6g")
