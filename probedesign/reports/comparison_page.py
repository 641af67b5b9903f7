"""Comparison of several designs: one table, and charts with common axes."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from probedesign.core.errors import InputError
from probedesign.core.units import MM
from probedesign.design import Design
from probedesign.optimization.objective import (
    METRICS,
    DesignMetrics,
    TaskErrors,
    design_metrics,
    predict_task,
)
from probedesign.optimization.task import Task
from probedesign.prediction.fused import MAX_TOUCHES, PressSchedule
from probedesign.prediction.predict import Prediction
from probedesign.probe import build_probe
from probedesign.reports.chart import COLOURS, DASHES, MARKS, Chart, ChartAxis, span_of
from probedesign.reports.html_page import HtmlTable, Section, report_page

MAX_DESIGNS = 6
PLACES = tuple(round(0.2 + 0.05 * k, 2) for k in range(16))
SIDE = "+y"
"""Direction across gravity for a horizontal mount, as in the task."""
FORCES_N = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05)


@dataclass(frozen=True)
class ComparedDesign:
    """One of the compared designs.

    Attributes:
        design: the design.
        metrics: its metrics for the task.
        along: its touches at `PLACES`.
        by_force: error over the task's positions at each of `FORCES_N` [m]; infinite where the probe buckles.
        prediction: for pushes across gravity with the task's force.
    """

    design: Design
    metrics: DesignMetrics
    along: TaskErrors
    by_force: tuple[float, ...]
    prediction: Prediction


def compare(designs: Sequence[Design], task: Task) -> list[ComparedDesign]:
    """Evaluate designs for the same task.

    Raises:
        InputError: there are fewer than two designs, or more than a chart can distinguish.
    """
    if not 2 <= len(designs) <= MAX_DESIGNS:
        raise InputError(f"compare takes 2 to {MAX_DESIGNS} designs; {len(designs)} given")
    return [_compared(design, task) for design in designs]


def _compared(design: Design, task: Task) -> ComparedDesign:
    probe = build_probe(design)
    model, moments = probe.model, task.moments_about
    prediction = probe.predict(
        forces_N=(task.force_N,), directions=(SIDE,),
        tolerances=task.priors(model),
        pressing=PressSchedule(min(max(task.touches, 2), MAX_TOUCHES), moments),
    )  # fmt: skip
    rms = tuple(
        task.combined(predict_task(model, replace(task, forces_N=(f,)), slipping=False).errors)
        for f in FORCES_N
    )
    along = replace(task, fractions=PLACES, forces_N=(task.force_N,), gravities=task.gravities[:1])
    return ComparedDesign(
        design, design_metrics(design, task), predict_task(model, along, slipping=False), rms, prediction
    )


def comparison_table(compared: Sequence[ComparedDesign]) -> HtmlTable:
    """Return one row per metric, one column per design."""
    rows = [[name, *(_cell(getattr(one.metrics, name)) for one in compared)] for name in METRICS]
    return HtmlTable(["", *(one.design.name for one in compared)], rows)


def comparison_page(compared: Sequence[ComparedDesign], task: Task) -> bytes:
    """Return the page of a comparison."""
    touched = task.text.split(", all causes")[0] + ", all error sources included"
    drawn: list[tuple[str, str, bytes]] = [
        ("Error along the probe", f"{touched}. A line ends where the probe buckles.",
         _lines(compared, _along, _PLACE, _ERROR)),
        ("Error by force", "As before, over the task's positions, by the largest force.",
         _lines(compared, _by_force, ChartAxis("contact force [mN]", 0.9, 55.0, log=True), _ERROR)),
        ("Error of fused touches", f"{compared[0].prediction.pressing.text}, up to {1e3 * task.force_N:g} mN, "
         "all error sources included, pushed sideways.", _lines(compared, _all_causes, _PLACE, _ERROR)),
        ("Detection limit", "Force detected with probability 0.5 at one false alarm an hour.",
         _lines(compared, _detected, _PLACE, "smallest detectable force [mN]")),
        ("Maximum force",
         "Until the probe buckles, an object slips off the tip or the sensor's range ends, "
         "pushed sideways.", _lines(compared, _max_force, _PLACE, "maximum force [mN]")),
        ("Diameter", "Diameter along the undeformed axis.",
         _lines(compared, _outline, "s, base to tip [mm]", "diameter [mm]", from_zero=True)),
        ("Sag", "Without contact, under gravity as mounted, seen along y, x downwards.",
         _draw_sag(compared)),
    ]  # fmt: skip
    names = " · ".join(one.design.name for one in compared)
    assumed = [
        f"{one.design.name} assumes {', '.join(one.design.assumptions) or 'nothing'}" for one in compared
    ]
    sections = [Section(*one) for one in drawn]
    return report_page(f"Comparison: {names}", [task.text, *assumed], comparison_table(compared), sections)


_Line = tuple[Sequence[float], Sequence[float]]
_PLACE = ChartAxis("contact, fraction of the length", 0.0, 1.05, ticks=(0.0, 0.2, 0.4, 0.6, 0.8, 1.0))
_ERROR = "contact error, RMS [mm]"


def _lines(
    compared: Sequence[ComparedDesign],
    line: Callable[[ComparedDesign], _Line],
    x: ChartAxis | str,
    y: str,
    from_zero: bool = False,
) -> bytes:
    """Return a chart with one line per design; logarithmic upwards unless it starts at zero."""
    lines = [line(one) for one in compared]
    low, high = span_of([v for _, values in lines for v in values], not from_zero)
    along = (
        x
        if isinstance(x, ChartAxis)
        else ChartAxis(x, *span_of([v for values, _ in lines for v in values], False))
    )
    chart = Chart(along, ChartAxis(y, 0.0 if from_zero else low, high, log=not from_zero))
    for one, (places, values), colour, dashes, mark in zip(
        compared, lines, COLOURS, DASHES, MARKS, strict=False
    ):
        chart.line(places, values, colour, dashes, mark, one.design.name)
    return chart.svg()


def _along(one: ComparedDesign) -> _Line:
    return PLACES, _shown(one.along.errors)


def _by_force(one: ComparedDesign) -> _Line:
    return [1e3 * force for force in FORCES_N], _shown(one.by_force)


def _all_causes(one: ComparedDesign) -> _Line:
    cells = one.prediction.fused
    return [c.contact_fraction for c in cells], [
        _number(c.predicted_error_mm if c.result == "ok" else None) for c in cells
    ]


def _detected(one: ComparedDesign) -> _Line:
    rows = one.prediction.detection
    return [row.contact_fraction for row in rows], [_number(row.detectable_force_mN) for row in rows]


def _max_force(one: ComparedDesign) -> _Line:
    rows = one.prediction.reach
    return [row.contact_fraction for row in rows], [1e3 * _number(row.greatest_force_N) for row in rows]


def _outline(one: ComparedDesign) -> _Line:
    s, d = np.array(one.design.probe.knots_mm).T
    return s.tolist(), d.tolist()


def _draw_sag(compared: Sequence[ComparedDesign]) -> bytes:
    shapes = []
    for one in compared:
        probe = build_probe(one.design)
        free = probe.rod.solve(probe.model.gravity_base)
        s = np.linspace(0.0, probe.length, 60)
        shapes.append(free.p_at(s) / MM if free.ok else np.full((1, 3), np.nan))
    points = np.concatenate(shapes)
    x = ChartAxis("z, along the undeformed axis [mm]", *span_of(points[:, 2].tolist(), False))
    chart = Chart(x, ChartAxis("x [mm]", *span_of(points[:, 0].tolist(), False)), square=True, down=True)
    for one, p, colour, dashes in zip(compared, shapes, COLOURS, DASHES, strict=False):
        chart.line(p[:, 2].tolist(), p[:, 0].tolist(), colour, dashes, name=one.design.name)
    return chart.svg()


def _shown(errors: Sequence[float]) -> list[float]:
    return [error / MM if np.isfinite(error) else np.nan for error in errors]


def _number(value: float | None) -> float:
    return np.nan if value is None else value


def _cell(value: float | int | None) -> str:
    return "none" if value is None else f"{value:.4g}"
