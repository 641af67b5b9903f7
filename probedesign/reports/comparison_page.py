"""Comparison of several designs: one table, and charts with common axes."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from probedesign.core.errors import InputError
from probedesign.core.units import MM, format_value
from probedesign.design import Design
from probedesign.optimization.objective import (
    COMPARED_FRACTIONS,
    DETECTION_FRACTION,
    METRICS,
    DesignMetrics,
    Task,
    TaskErrors,
    design_metrics,
    predict_task,
)
from probedesign.prediction.fused import MAX_TOUCHES, FusedHeadline, PressSchedule
from probedesign.prediction.predict import Prediction, fused_headline
from probedesign.probe import build_probe
from probedesign.reports.chart import COLOURS, DASHES, MARKS, Chart, ChartAxis
from probedesign.reports.html_page import HtmlTable, ReportFigure, report_page

MAX_DESIGNS = 6
SIDE = "+y"  #: Direction across gravity for a horizontal mount, as in the task.
NEUTRAL = ("length_mm", "thinnest_mm")  #: Metrics of which neither a larger nor a smaller value is better.
LARGER_IS_BETTER = ("reach_mm",)
#: Names of the metrics in the table.
LABELS = {
    "error_mm": "error of the task, RMS [mm]",
    "worst_error_mm": "largest error of the task [mm]",
    "detectable_mN": f"detected at {DETECTION_FRACTION:g} L from [mN]",
    "sag_mm": "sag of the tip [mm]",
    "reach_mm": "distance from base to tip [mm]",
    "sensor_use": "used fraction of the sensor's range",
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
    along: TaskErrors  #: its touches at `COMPARED_FRACTIONS`.
    #: error over the task's positions at each of `FORCES_N` [m]; infinite where the probe buckles.
    by_force: tuple[float, ...]
    prediction: Prediction  #: for pushes across gravity with the task's force.
    fused: FusedHeadline  #: its error of fused touches as `predict` reports it, whatever the task.


def compare(designs: Sequence[Design], task: Task) -> list[ComparedDesign]:
    """Evaluate designs for the same task.

    Raises:
        InputError: there are fewer than two designs, or more than a chart can distinguish.
    """
    if not 2 <= len(designs) <= MAX_DESIGNS:
        raise InputError(f"compare takes 2 to {MAX_DESIGNS} designs; {len(designs)} given")
    along = replace(task, fractions=COMPARED_FRACTIONS, forces_N=(task.force_N,), gravities=task.gravities[:1])
    by_force = [replace(task, forces_N=(force,)) for force in FORCES_N]
    pressing = PressSchedule(min(max(task.touches, 2), MAX_TOUCHES), task.moments_about)
    compared = []
    for design in designs:
        probe = build_probe(design)
        model = probe.model
        prediction = probe.predict(
            forces_N=(task.force_N,), directions=(SIDE,), tolerances=task.priors(model), pressing=pressing
        )
        rms = tuple(task.combined(predict_task(model, other, slipping=False).errors) for other in by_force)
        touches = predict_task(model, along, slipping=False)
        metrics = design_metrics(design, task)
        compared.append(ComparedDesign(design, metrics, touches, rms, prediction, fused_headline(model)))
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
               lambda entry: (COMPARED_FRACTIONS, _in_mm(entry.along.errors)), _PLACE, _ERROR),
        _lines("Error by force", "As before, over the task's positions, by the largest force.", compared,
               lambda entry: ([1e3 * f for f in FORCES_N], _in_mm(entry.by_force)), force, _ERROR),
        _lines("Detection limit", "Force detected with probability 0.5 at one false alarm an hour.", compared,
               lambda entry: _rows(entry.prediction.detection, lambda d: d.detectable_force_mN), _PLACE,
               "smallest detectable force [mN]"),
        _lines("Maximum force", "Force at which the probe buckles, an object slips off the tip or the sensor's range "
               "ends; pushed sideways.", compared,
               lambda entry: _rows(entry.prediction.reach, lambda r: r.greatest_force_N, 1e3), _PLACE,
               "maximum force [mN]"),
        _lines("Diameter", "Diameter along the undeformed axis.", compared,
               lambda entry: ([s for s, _ in entry.design.probe.knots_mm], [d for _, d in entry.design.probe.knots_mm]),
               "arclength s [mm]", "diameter [mm]", from_zero=True),
        ReportFigure("Sag", "Without contact, under gravity as mounted, seen along y, x downwards.",
                _sag_chart(compared).svg()),
    ]  # fmt: skip
    assumed = [f"{entry.design.name} assumes {', '.join(entry.design.assumptions) or 'nothing'}" for entry in compared]
    title = f"Comparison: {' · '.join(entry.design.name for entry in compared)}"
    table, verdict = comparison_table(compared), comparison_verdict(compared)
    return report_page(title, [task.text, *assumed], table, sections, verdict=verdict)


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


def _rows(rows: Sequence[Any], value: Callable[[Any], float | None], unit: float = 1.0) -> _Points:
    values = [math.nan if (v := value(row)) is None else unit * v for row in rows]
    return [row.contact_fraction for row in rows], values


def _sag_chart(compared: Sequence[ComparedDesign]) -> Chart:
    """Return the free shapes from the side."""
    shapes = []
    for entry in compared:
        probe = build_probe(entry.design)
        free = probe.rod.solve(probe.model.gravity_base)
        s = np.linspace(0.0, probe.length, 60)
        shapes.append(free.p_at(s) / MM if free.ok else np.full((1, 3), np.nan))
    chart = Chart.side_view(np.concatenate(shapes)[:, [2, 0]], 0)
    for entry, p, colour, dashes in zip(compared, shapes, COLOURS, DASHES, strict=False):
        chart.line(p[:, 2], p[:, 0], colour, dashes, name=entry.design.name)
    return chart


def _in_mm(errors: Sequence[float]) -> list[float]:
    return [error / MM if math.isfinite(error) else math.nan for error in errors]
