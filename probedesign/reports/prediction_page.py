"""The page of a prediction. A chart is added by one entry in `_figures`."""

from collections.abc import Iterator

import numpy as np

from probedesign.core.units import MM, format_value
from probedesign.design.catalog import assumed_text
from probedesign.estimation.estimator import Estimator
from probedesign.prediction.fused import SHOWN_N, worst
from probedesign.prediction.predict import HEADLINE_FORCE_N, HEADLINE_FRACTION, Prediction
from probedesign.reports.chart import Chart
from probedesign.reports.html_page import HtmlTable, ReportFigure, report_page
from probedesign.reports.prediction_charts import (
    STATIONS,
    bending_chart,
    budget_chart,
    direction_chart,
    error_chart,
    error_map,
    force_chart,
    lateral_axis,
    probe_chart,
    surface_map,
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


def _figures(prediction: Prediction, estimator: Estimator) -> Iterator[tuple[str, Chart, str, str]]:
    """Yield group, chart, heading and caption of each figure; one of a group is folded away under its name."""
    k = prediction.pressing.touches
    force = f"{1e3 * HEADLINE_FORCE_N:g} mN"
    free = estimator.free()
    lateral = lateral_axis(free.p_at(np.linspace(0.0, estimator.model.rod.length, STATIONS))) if free.ok else 0
    seen = f"seen along {'yx'[lateral]}"
    yield (
        "", probe_chart(prediction, estimator), f"Contact error of {force} along the probe",
        f"The free probe to scale under gravity as mounted, {seen}. Colour: RMS error of one reading, all "
        "sources included, worst direction; grey: not located.",
    )  # fmt: skip
    yield (
        "", error_chart(prediction), "Contact error of one reading by force",
        "RMS error, all sources included. Marked line: worst direction; the shaded area below it reaches to the "
        "best direction. A pointer on a mark shows its values. A line ends where the probe buckles.",
    )  # fmt: skip
    if over := prediction.over_directions:
        fraction = min((row.contact_fraction for row in over), key=lambda at: abs(at - HEADLINE_FRACTION))
        yield (
            "", direction_chart({f"{1e3 * row.force_N:g} mN": row.errors_mm for row in over
                             if row.contact_fraction == fraction and row.force_N in (0.005, 0.01, 0.02)}),
            f"Contact error over the direction of the force, at {fraction:g} of the length",
            "The distance from the centre is the RMS error of one reading, all sources included; X and Y are the axes "
            "of the touched section, carried along the probe's axis without twist. The error is large where the force "
            "lies in the plane in which the axis is bent: there the moments do not tell the place.",
        )  # fmt: skip
        light = min((row.force_N for row in over), key=lambda force: abs(force - SHOWN_N))
        yield (
            "", surface_map([row for row in over if row.force_N == light]),
            f"Contact error on the surface, {1e3 * light:g} mN",
            "RMS error of one reading [mm], all sources included, over place and direction of the force, from X "
            "towards Y.",
        )  # fmt: skip
    if single := worst(prediction.conditions, HEADLINE_FORCE_N):
        budgeted = f"{1e3 * single[0].force_N:g} mN"
        yield "", budget_chart(single), f"Error budget of one reading of {budgeted}", _BUDGET
    yield (
        "", error_map(prediction.conditions, lambda c: c.predicted_error_mm),
        "Contact error of one reading", f"RMS error, all sources included. {_CELLS}",
    )  # fmt: skip
    yield (
        "", error_map(prediction.fused, lambda c: c.predicted_error_mm), f"Contact error of {k} fused touches",
        "Force of the last touch. RMS error, all sources included, worst direction [mm].",
    )  # fmt: skip
    yield (
        _ERRORS, error_map(prediction.conditions, lambda c: c.noise_error_mm),
        "Contact error due to sensor noise alone",
        "One reading of a probe that matches its model, with the prior on friction: the lower bound. "
        "Worst direction [mm].",
    )  # fmt: skip
    yield (
        _FORCES, force_chart(prediction), "Force thresholds",
        "Detected: with probability 0.5 at one false alarm an hour. Located: within the given RMS error, all sources "
        "included. Limit: the probe buckles, an object at constant distance from the base slips off its tip, or the "
        "range of the sensor ends. Worst direction; a line is broken where no force suffices.",
    )  # fmt: skip
    if fused := worst(prediction.fused, SHOWN_N):
        yield (
            _ERRORS, budget_chart(fused), f"Error budget of {k} touches up to {1e3 * fused[0].force_N:g} mN",
            "As before. Robot: position error of the base, independent between touches.",
        )  # fmt: skip
    yield (
        "Deflection", bending_chart(estimator), "Deflection",
        f"{seen.capitalize()}; dots are the touches, along ±{'xy'[lateral]}.",
    )  # fmt: skip


def prediction_page(prediction: Prediction, estimator: Estimator) -> bytes:
    """Return the page of a prediction by an estimator of the same probe."""
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
    for group, chart, heading, caption in _figures(prediction, estimator):
        sections.setdefault(group, []).append(ReportFigure(heading, caption, chart.svg()))
    shown_first = sections.pop("", [])
    sources = prediction.tolerances.sources(prediction.resin, prediction.length_mm * MM)
    rows = [[name, f"{getattr(prediction.tolerances, name):g}", source] for name, source in sources.items()]
    tables = list[tuple[str, HtmlTable]]()
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


def _mm(value: float | None) -> str:
    return format_value(value, ".3g", "mm")
