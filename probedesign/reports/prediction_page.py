"""The page of a prediction; `reports/png.py` draws some of its charts as a picture.

A chart is added by one entry in `prediction_figures`: with a heading it is on the page, with a panel title in the PNG.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from probedesign.core.units import MILLINEWTON, MM, format_value
from probedesign.design.catalog import assumed_text
from probedesign.estimation.estimator import Estimator
from probedesign.prediction.fused import SHOWN_N, worst
from probedesign.prediction.predict import HEADLINE_FORCE_N, HEADLINE_FRACTION, Prediction
from probedesign.prediction.workspace import ForceThresholds
from probedesign.reports.chart import Chart
from probedesign.reports.html_page import HtmlTable, ReportFigure, report_page
from probedesign.reports.prediction_charts import (
    LIMITS,
    STATIONS,
    bending_chart,
    budget_chart,
    detection_chart,
    direction_chart,
    error_chart,
    error_map,
    force_chart,
    lateral_axis,
    limit_chart,
    probe_chart,
    sensitivity_chart,
    surface_map,
    swept_text,
    workspace_chart,
)

_BUDGET = (
    "Shares of the variance, worst direction; above each bar the total RMS error [mm]. Friction: due to its prior. "
    "Stiffness: E, G, creep and scatter between touches. Diameters: including their scatter and the length. Mount: "
    "position, tilt, clocking and root of the base, gain of the sensor. Weight: density and direction of gravity."
)
_CELLS = (
    "Worst direction [mm]. Grey cells: — not detected; faint: detected, but too weak to be located; interval: known to "
    "an interval of the arclength alone; buckles: the probe is unstable; range: beyond the sensor's range."
)
_ERRORS, _FORCES = "Errors by the sensor alone, and of fused touches by source", "Forces along the probe"
_WORKSPACE, _BENDING = "Workspace", "Deflection and sensitivity"


@dataclass(frozen=True)
class PredictionFigure:
    """A chart of a prediction."""

    chart: Chart  #: what is drawn.
    heading: str = ""  #: heading, caption: on the page; a figure without a heading is not on the page.
    caption: str = ""
    panel: str = ""  #: title in the PNG; a figure without one is not in the PNG.
    group: str = ""  #: heading under which it is folded away on the page; open if empty.


def prediction_figures(prediction: Prediction, estimator: Estimator) -> Iterator[PredictionFigure]:
    """Yield the figures of a prediction of the estimator's probe, in the order of page and picture."""
    k, side = prediction.pressing.touches, prediction.conditions[-1].direction
    force = f"{1e3 * HEADLINE_FORCE_N:g} mN"
    free = estimator.free()
    lateral = lateral_axis(free.p_at(np.linspace(0.0, estimator.model.rod.length, STATIONS))) if free.ok else 0
    seen = f"seen along {'yx'[lateral]}"
    yield PredictionFigure(
        probe_chart(prediction, estimator), f"Contact error of {force} along the probe",
        f"The free probe to scale under gravity as mounted, {seen}. Colour: RMS error of one reading, all "
        "sources included, worst direction; grey: not located.",
    )  # fmt: skip
    yield PredictionFigure(
        error_chart(prediction), "Contact error of one reading by force",
        "RMS error, all sources included. Marked line: worst direction; the shaded area below it reaches to the "
        "best direction. A pointer on a mark shows its values. A line ends where the probe buckles.",
        "Contact error of one reading by force",
    )  # fmt: skip
    if over := prediction.over_directions:
        fraction = min((row.contact_fraction for row in over), key=lambda at: abs(at - HEADLINE_FRACTION))
        yield PredictionFigure(
            direction_chart({f"{1e3 * row.force_N:g} mN": row.errors_mm for row in over
                             if row.contact_fraction == fraction and row.force_N in (0.005, 0.01, 0.02)}),
            f"Contact error over the direction of the force, at {fraction:g} of the length",
            "The distance from the centre is the RMS error of one reading, all sources included; X and Y are the axes "
            "of the touched section, carried along the probe's axis without twist. The error is large where the force "
            "lies in the plane in which the axis is bent: there the moments do not tell the place.",
            "Contact error over the direction of the force [mm]",
        )  # fmt: skip
        light = min((row.force_N for row in over), key=lambda force: abs(force - SHOWN_N))
        yield PredictionFigure(
            surface_map([row for row in over if row.force_N == light]),
            f"Contact error on the surface, {1e3 * light:g} mN",
            "RMS error of one reading [mm], all sources included, over place and direction of the force, from X "
            "towards Y.",
        )  # fmt: skip
    if single := worst(prediction.conditions, HEADLINE_FORCE_N):
        budgeted = f"{1e3 * single[0].force_N:g} mN"
        yield PredictionFigure(budget_chart(single), f"Error budget of one reading of {budgeted}", _BUDGET)
    yield PredictionFigure(
        error_map(prediction.conditions, lambda c: c.predicted_error_mm),
        "Contact error of one reading", f"RMS error, all sources included. {_CELLS}",
    )  # fmt: skip
    yield PredictionFigure(
        error_map(prediction.fused, lambda c: c.predicted_error_mm), f"Contact error of {k} fused touches",
        "Force of the last touch. RMS error, all sources included, worst direction [mm].",
    )  # fmt: skip
    yield PredictionFigure(
        error_map(prediction.conditions, lambda c: c.noise_error_mm), "Contact error due to sensor noise alone",
        "One reading of a probe that matches its model, with the prior on friction: the lower bound. "
        "Worst direction [mm].", group=_ERRORS,
    )  # fmt: skip
    yield PredictionFigure(detection_chart(prediction), panel="Detection limit, one false alarm an hour")
    yield PredictionFigure(
        force_chart(prediction), "Force thresholds",
        "Detected: with probability 0.5 at one false alarm an hour. Located: within the given RMS error, all sources "
        "included. Limit: of the probe or of the sensor. Worst direction; a line is broken where no force suffices.",
        group=_FORCES,
    )  # fmt: skip
    if fused := worst(prediction.fused, SHOWN_N):
        yield PredictionFigure(
            budget_chart(fused), f"Error budget of {k} touches up to {1e3 * fused[0].force_N:g} mN",
            "As before. Robot: position error of the base, independent between touches.", group=_ERRORS,
        )  # fmt: skip
    yield PredictionFigure(
        workspace_chart(prediction.workspace, 0), "Workspace from the side",
        "Fixed base. Shaded: positions to which the centreline's contact point can be pushed; thin lines: path of each "
        f"position from zero to maximum force. {swept_text(prediction.workspace)}", group=_WORKSPACE,
    )  # fmt: skip
    yield PredictionFigure(
        workspace_chart(prediction.workspace, 1), "Workspace from above",
        "As before, pushed sideways; one side is mirrored where it was not computed.", group=_WORKSPACE,
    )  # fmt: skip
    yield PredictionFigure(
        limit_chart(prediction), "Maximum force", "Buckling: the probe becomes unstable. Slips off: an object "
        "at constant distance from the base reaches the tip.", group=_FORCES,
    )  # fmt: skip
    yield PredictionFigure(
        bending_chart(estimator), "Deflection",
        f"{seen.capitalize()}; dots are the touches, along ±{'xy'[lateral]}.",
        f"Deflection under touches along ±{'xy'[lateral]}", _BENDING,
    )  # fmt: skip
    yield PredictionFigure(
        sensitivity_chart(prediction), "Sensitivity to indentation",
        "At the smallest force, along the last direction: base moment and force per additional millimetre of "
        "indentation.", f"Base moment and force per millimetre of indentation along {side}", _BENDING,
    )  # fmt: skip


def prediction_page(prediction: Prediction, estimator: Estimator, more: Sequence[ReportFigure] = ()) -> bytes:
    """Return the page of a prediction by an estimator of the same probe, with more sections at its end."""
    sag, fused = prediction.tip_sag_mm, prediction.fused_headline
    fused_mm = fused.predicted_error_mm
    sags = "it buckles under its own weight" if sag is None else f"the tip sags by {sag:.3g} mm"
    about = [
        f"{prediction.mass_g:.3g} g, flexible part; {sags}, as mounted",
        f"geometry {prediction.fingerprint}; noise {prediction.noise_force_mN:.3g} mN and "
        f"{prediction.noise_moment_Nmm:.3g} N·mm per reading and channel",
        f"assumed until measured: {assumed_text(prediction.assumptions)}; standard deviations at the end",
        f"{fused.label}, fused: {'not located' if fused_mm is None else f'{fused_mm:.2g} mm RMS'}",
        f"fused: {prediction.pressing.text}",
        *([] if prediction.bench_gain is None else [f"bench: {prediction.bench_gain.text}"]),
    ]
    sections = dict[str, list[ReportFigure]]()
    for figure in prediction_figures(prediction, estimator):
        if figure.heading:
            section = ReportFigure(figure.heading, figure.caption, figure.chart.svg())
            sections.setdefault(figure.group, []).append(section)
    shown_first = [*sections.pop("", []), *more]
    sources = prediction.tolerances.sources(prediction.resin, prediction.length_mm * MM)
    rows = [[name, f"{getattr(prediction.tolerances, name):g}", source] for name, source in sources.items()]
    tables = [("Force thresholds along the probe", _table(prediction))]
    if prediction.monte_carlo:
        head = ["contact", "touches", "force", "direction", "budget", "Monte Carlo", "95 % within", "located"]
        sampled = [
            [f"{r.contact_fraction:g} L", f"{r.touches}", f"{1e3 * r.force_N:g} mN", r.direction,
             _mm(r.first_order_mm), _mm(r.error_mm) + (" *" if r.differs else ""), _mm(r.error_95_mm),
             f"{r.located / r.draws:.0%}"]
            for r in prediction.monte_carlo
        ]  # fmt: skip
        note = "* differs from the budget by more than a tenth; the Monte Carlo value is more reliable"
        tables.append(("Monte Carlo simulation with the estimator", HtmlTable(head, sampled, note)))
    tables.append(("Tolerances: standard deviations", HtmlTable(["[tolerances]", "value", "source"], rows)))
    title = f"{prediction.name}: predicted contact errors"
    return report_page(title, about, None, shown_first, tables, list(sections.items()), verdict=prediction.verdict)


# Tables


def threshold_rows(prediction: Prediction) -> list[tuple[float, list[float | None], ForceThresholds]]:
    """Return for each place the forces [mN] from which on a contact is detected, located to 5, 2 and 1 mm, and to 2 mm
    by fused touches, then the largest force, in the worst direction, and the row that limits it."""
    rows: list[tuple[float, list[float | None], ForceThresholds]] = []
    for fraction in sorted({row.contact_fraction for row in prediction.reach}):
        felt = [row for row in prediction.detection if row.contact_fraction == fraction]
        reach = [row for row in prediction.reach if row.contact_fraction == fraction]
        fused = [row for row in prediction.fused_reach if row.contact_fraction == fraction]
        values = [[row.detectable_force_mN for row in felt],
                  *([getattr(row, f"force_mN_for_{mm}_mm") for row in reach] for mm in (5, 2, 1)),
                  [row.force_mN_for_2_mm for row in fused]]  # fmt: skip
        weakest = min(reach, key=lambda row: row.greatest_force_N or 0.0)
        greatest = None if weakest.greatest_force_N is None else weakest.greatest_force_N / MILLINEWTON
        rows.append((fraction, [*(max(v) if v and None not in v else None for v in values), greatest], weakest))
    return rows


def _table(prediction: Prediction) -> HtmlTable:
    head = ["along the probe", "detected from", "5 mm", "2 mm", "1 mm", f"2 mm, {prediction.pressing.touches} fused",
            "maximum force", "limited by", "deflection"]  # fmt: skip
    return HtmlTable(head, [
        [f"{fraction:g} L", *map(_force, forces), LIMITS[weakest.limit][0], _mm(weakest.deflection_mm)]
        for fraction, forces, weakest in threshold_rows(prediction)
    ])  # fmt: skip


def _force(value: float | None) -> str:
    if value is None:
        return "none"
    return f"{value:.3g} mN" if value < 1000.0 else f"{1e-3 * value:.3g} N"


def _mm(value: float | None) -> str:
    return format_value(value, ".3g", "mm")
