"""Comparison of several designs: one table, and charts with common axes."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from probedesign.core.errors import InputError
from probedesign.core.units import MM, format_value
from probedesign.design import Design
from probedesign.design.catalog import assumed_text
from probedesign.estimation.estimator import Estimator
from probedesign.optimization.objective import (
    COMPARED_FRACTIONS,
    DETECTION_FRACTION,
    METRICS,
    DesignMetrics,
    Task,
    design_metrics,
    predict_task,
)
from probedesign.prediction.fused import MAX_TOUCHES, FusedHeadline, PressSchedule
from probedesign.prediction.predict import (
    DIRECTION_STEP_DEG,
    HEADLINE_FRACTION,
    ErrorOverDirections,
    Prediction,
    errors_over_directions,
    fused_headline,
)
from probedesign.probe import build_probe
from probedesign.reports.chart import COLOURS, DASHES, MARKS, Chart, ChartAxis
from probedesign.reports.html_page import HtmlTable, ReportFigure, report_page
from probedesign.reports.prediction_charts import direction_chart, lateral_axis

MAX_DESIGNS = 6
SIDE = "+y"  #: Direction across gravity for a horizontal mount, as in the task.
NEUTRAL = ("length_mm", "thinnest_mm")  #: Metrics of which neither a larger nor a smaller value is better.
LARGER_IS_BETTER = ("reach_mm", "distinction")
OF_CURVED = ("tip_offset_mm", "distinction")  #: Metrics that only curved probes have.
#: Names of the metrics in the table.
LABELS = {
    "error_mm": "error of the task, RMS [mm]",
    "worst_error_mm": "largest error of the task [mm]",
    "detectable_mN": f"detected at {DETECTION_FRACTION:g} L from [mN]",
    "sag_mm": "sag of the tip [mm]",
    "reach_mm": "distance from base to tip [mm]",
    "tip_offset_mm": "offset of the unloaded tip from the base's axis [mm]",
    "sensor_use": "used fraction of the sensor's range",
    "distinction": "standard deviations between touches of different places",
    "slide_mm": "slide of the object along the probe [mm]",
    "mass_g": "mass of the flexible part [g]",
    "length_mm": "length [mm]",
    "thinnest_mm": "smallest diameter or wall [mm]",
    "print_errors": "errors of the print check",
    "print_warnings": "warnings of the print check",
}
FORCES_N = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05)


@dataclass(frozen=True)
class ComparedDesign:
    """One of the compared designs."""

    design: Design  #: the design.
    metrics: DesignMetrics  #: its metrics for the task.
    #: error at each of `COMPARED_FRACTIONS`, over the directions of the task [m]; infinite where the probe buckles.
    along: tuple[float, ...]
    #: error over the task's positions at each of `FORCES_N` [m]; infinite where the probe buckles.
    by_force: tuple[float, ...]
    prediction: Prediction  #: for pushes with the task's force: across gravity, or in all directions if it is curved.
    fused: FusedHeadline  #: its error of fused touches as `predict` reports it, whatever the task.
    #: errors of single readings of the task's force over the directions; empty where all probes are straight.
    over: tuple[ErrorOverDirections, ...] = ()


def compare(designs: Sequence[Design], task: Task) -> list[ComparedDesign]:
    """Evaluate designs for the same task.

    Raises:
        InputError: there are fewer than two designs, or more than a chart can distinguish.
    """
    if not 2 <= len(designs) <= MAX_DESIGNS:
        raise InputError(f"compare takes 2 to {MAX_DESIGNS} designs; {len(designs)} given")
    along = [replace(task, fractions=(at,), forces_N=(task.force_N,), gravities=task.gravities[:1])
             for at in COMPARED_FRACTIONS]  # fmt: skip
    curved = any(build_probe(design).rod.is_curved for design in designs)
    by_force = [replace(task, forces_N=(force,)) for force in FORCES_N]
    pressing = PressSchedule(min(max(task.touches, 2), MAX_TOUCHES))
    compared = []
    for design in designs:
        probe = build_probe(design)
        model = probe.model
        prediction = probe.predict(
            forces_N=(task.force_N,), directions=None if probe.rod.is_curved else (SIDE,), pressing=pressing
        )
        rms = tuple(task.combined(predict_task(model, other, slipping=False).errors) for other in by_force)
        touches = tuple(task.combined(predict_task(model, other, slipping=False).errors) for other in along)
        metrics, estimator = design_metrics(design, task), Estimator(model)
        at = (HEADLINE_FRACTION,)
        over = errors_over_directions(estimator, at, (task.force_N,)) if curved and estimator.free().ok else ()
        compared.append(ComparedDesign(design, metrics, touches, rms, prediction, fused_headline(model), over))
    return compared


def best_design(compared: Sequence[ComparedDesign], metric: str) -> str | None:
    """Return the name of the design with the best value of a metric; None where no value is better.

    No metric prefers a length or a thickness, and values that are printed alike are equal.
    """
    if metric in NEUTRAL:
        return None
    values = {entry.design.name: getattr(entry.metrics, metric) for entry in compared}
    return _best(values, max if metric in LARGER_IS_BETTER else min)


def _best(values: Mapping[str, float | None], choose: Callable[..., str]) -> str | None:
    """Return the name of the smallest or largest value; None if there is none or another one is printed alike."""
    known = {name: value for name, value in values.items() if value is not None}
    if not known:
        return None
    best = choose(known, key=lambda name: known[name])
    alike = [name for name, value in known.items() if format_value(value) == format_value(known[best])]
    return best if len(alike) == 1 else None


def comparison_table(compared: Sequence[ComparedDesign]) -> HtmlTable:
    """Return one row per metric, one column per design, and the best of them."""
    rows = [
        [LABELS[name], *(format_value(getattr(entry.metrics, name)) for entry in compared),
         best_design(compared, name) or "-"]
        for name in METRICS
        if name not in OF_CURVED or any(getattr(entry.metrics, name) for entry in compared)
    ]  # fmt: skip
    fused = {entry.design.name: entry.fused.predicted_error_mm for entry in compared}
    label = f"error of {compared[0].fused.label} [mm]"
    rows.insert(1, [label, *map(format_value, fused.values()), _best(fused, min) or "-"])
    return HtmlTable(["", *(entry.design.name for entry in compared), "best"], rows)


def comparison_verdict(compared: Sequence[ComparedDesign]) -> str:
    """Return which design locates the task's touches best, in one sentence."""
    located = sorted(
        (entry.metrics.error_mm, entry.design.name) for entry in compared if entry.metrics.error_mm is not None
    )
    if not located:
        return "No design locates every touch of the task."
    (error, name), others = located[0], located[1:]
    if not others:
        return f"Only {name} locates every touch of the task: {error:.3g} mm RMS."
    if best_design(compared, "error_mm") is None:
        return f"{name} and {others[0][1]} locate the task's touches equally well: {error:.3g} mm RMS."
    return (
        f"{name} locates the task's touches best: {error:.3g} mm RMS, "
        f"{1.0 - error / others[0][0]:.0%} less than {others[0][1]} with {others[0][0]:.3g} mm."
    )


def comparison_page(compared: Sequence[ComparedDesign], task: Task) -> bytes:
    """Return the page of a comparison."""
    force = ChartAxis("contact force [mN]", 0.9, 55.0, log=True)
    sections = [
        _lines("Error along the probe",
               f"{task.touches_text}, all error sources. A line ends where the probe buckles.", compared,
               lambda entry: (COMPARED_FRACTIONS, _in_mm(entry.along)), _PLACE, _ERROR),
        _lines("Error by force", "As before, over the task's positions, by the largest force.", compared,
               lambda entry: ([1e3 * f for f in FORCES_N], _in_mm(entry.by_force)), force, _ERROR),
        _lines("Detection limit", "Force detected with probability 0.5 at one false alarm an hour.", compared,
               lambda entry: _rows(entry.prediction.detection, lambda d: d.detectable_force_mN, max), _PLACE,
               "smallest detectable force [mN]"),
        _lines("Maximum force", "Force at which the probe buckles, an object slips off the tip or the sensor's range "
               "ends; pushed sideways.", compared,
               lambda entry: _rows(entry.prediction.reach, lambda r: r.greatest_force_N, min, 1e3), _PLACE,
               "maximum force [mN]"),
        _lines("Diameter", "Diameter along the undeformed axis.", compared,
               lambda entry: ([s for s, _ in entry.design.probe.knots_mm], [d for _, d in entry.design.probe.knots_mm]),
               "arclength s [mm]", "diameter [mm]", from_zero=True),
        ReportFigure("Sag", "Without contact, under gravity as mounted, from the side.", _sag_chart(compared).svg()),
    ]  # fmt: skip
    if any(entry.over for entry in compared):
        force_text = f"single readings of {1e3 * task.force_N:g} mN"
        at_0_8 = {entry.design.name: row.errors_mm for entry in compared for row in entry.over}
        sections.append(ReportFigure(
            "Error over the direction of the force",
            f"RMS error of {force_text} at {HEADLINE_FRACTION:g} of the length, all sources included, is the "
            "distance from the centre; X and Y are the axes of the touched section.", direction_chart(at_0_8).svg(),
        ))  # fmt: skip
    assumed = [f"{entry.design.name} assumes {assumed_text(entry.design.assumptions)}" for entry in compared]
    title = f"Comparison: {' · '.join(entry.design.name for entry in compared)}"
    table, verdict = comparison_table(compared), comparison_verdict(compared)
    about = [task.text, *filter(None, [directions_verdict(compared)]), *assumed]
    return report_page(title, about, table, sections, verdict=verdict)


_ALIKE = 0.95  #: Ratio of two errors above which the designs count as equally good.


def directions_verdict(compared: Sequence[ComparedDesign]) -> str:
    """Return for which directions of a light touch near the tip which design is best; empty if all are straight."""
    if not any(entry.over for entry in compared):
        return ""
    force = next(entry.over[0].force_N for entry in compared if entry.over)
    unknown = [None] * (360 // DIRECTION_STEP_DEG)
    errors = np.array([entry.over[0].errors_mm if entry.over else unknown for entry in compared], dtype=float)
    errors = np.where(np.isnan(errors), np.inf, errors)
    best, order = errors.argmin(axis=0), np.sort(errors, axis=0)
    clear, parts = order[0] < _ALIKE * order[1], []
    for k, entry in enumerate(compared):
        if (here := clear & (best == k)).any():
            low, high = errors[k][here].min(), errors[k][here].max()
            parts.append(f"{entry.design.name} best at {_sectors(here)} with {low:.2g} to {high:.2g} mm")
    if not clear.all():
        parts.append(f"no difference at {_sectors(~clear)}")
    return f"Single readings of {1e3 * force:g} mN at {HEADLINE_FRACTION:g} L by direction: {'; '.join(parts)}."


def _sectors(here: NDArray[np.bool_]) -> str:
    """Return the directions of a mask over the circle in words, such as 285° to 75°."""
    n = len(here)
    if here.all():
        return "all directions"
    begins = [i for i in range(n) if here[i] and not here[i - 1]]
    ends = [next(j for j in range(i, i + n) if not here[(j + 1) % n]) % n for i in begins]
    words = [f"{DIRECTION_STEP_DEG * i}°" + (f" to {DIRECTION_STEP_DEG * j}°" if j != i else "")
             for i, j in zip(begins, ends, strict=True)]  # fmt: skip
    return ", ".join(words)


_Points = tuple[Sequence[float], Sequence[float]]
_PLACE = ChartAxis("contact position, fraction of the length", 0.0, 1.05, ticks=(0.0, 0.2, 0.4, 0.6, 0.8, 1.0))
_ERROR = "contact error, RMS [mm]"


def _lines(
    heading: str, caption: str, compared: Sequence[ComparedDesign], line: Callable[[ComparedDesign], _Points],
    x: ChartAxis | str, y: str, from_zero: bool = False,
) -> ReportFigure:  # fmt: skip
    """Return a figure with one line per design; its y axis is logarithmic unless it starts at zero."""
    lines = [line(entry) for entry in compared]
    along = x if isinstance(x, ChartAxis) else ChartAxis.spanning(x, [v for values, _ in lines for v in values])
    upwards = ChartAxis.spanning(y, [v for _, values in lines for v in values], log=not from_zero)
    chart = Chart(along, replace(upwards, low=0.0) if from_zero else upwards)
    for entry, points, colour, dashes, mark in zip(compared, lines, COLOURS, DASHES, MARKS, strict=False):
        chart.line(*points, colour, dashes, mark, entry.design.name)
    return ReportFigure(heading, caption, chart.svg())


def _rows(
    rows: Sequence[Any], value: Callable[[Any], float | None], worst: Callable[..., float], unit: float = 1.0
) -> _Points:
    by_place: dict[float, list[float]] = {}
    for row in rows:
        v = value(row)
        by_place.setdefault(row.contact_fraction, []).append(math.nan if v is None else unit * v)
    return [*by_place], [
        worst(values) if not any(map(math.isnan, values)) else math.nan for values in by_place.values()
    ]


def _sag_chart(compared: Sequence[ComparedDesign]) -> Chart:
    shapes = []
    for entry in compared:
        probe = build_probe(entry.design)
        free = probe.rod.solve(probe.model.gravity_base)
        s = np.linspace(0.0, probe.length, 60)
        shapes.append(free.p_at(s) / MM if free.ok else np.full((1, 3), np.nan))
    across = max(map(lateral_axis, shapes))
    chart = Chart.side_view(np.concatenate(shapes)[:, [2, across]], across)
    for entry, p, colour, dashes in zip(compared, shapes, COLOURS, DASHES, strict=False):
        chart.line(p[:, 2], p[:, across], colour, dashes, name=entry.design.name)
    return chart


def _in_mm(errors: Sequence[float]) -> list[float]:
    return [error / MM if math.isfinite(error) else math.nan for error in errors]
