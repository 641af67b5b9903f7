"""Page and charts of a validation: measured and estimated, as the paper's figure 3 and its Table I."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.stats import chi2

from probedesign.core.frames import Array
from probedesign.core.units import MILLINEWTON, MM, format_value
from probedesign.design.catalog import assumed_text
from probedesign.estimation.model import ProbeModel
from probedesign.reports.chart import COLOURS, Chart, ChartAxis
from probedesign.reports.html_page import HtmlTable, ReportFigure, report_page
from probedesign.reports.prediction_charts import flanks
from probedesign.validation.validate import WHY, ErrorStatistics, ValidatedTest, ValidationReport

MEASURED, ESTIMATED, CONTACT = COLOURS[0], COLOURS[1], COLOURS[2]
POINTS = 80  #: Arclengths at which a shape is drawn.
MAX_SHAPES = 24  #: Further shapes are left out, with a note on the page.


def error_size_chart(trials: Sequence[ValidatedTest]) -> Chart:
    """Return measured error against stated error."""
    errors = [
        (trial.kind, trial.contact_error.expected / MM, trial.contact_error.size / MM)
        for trial in trials
        if trial.contact_error is not None
    ]
    y = ChartAxis.spanning("measured error [mm]", [value for _, *pair in errors for value in pair], log=True)
    chart = Chart(replace(y, label="stated error, RMS [mm]"), y)
    chart.line([y.low, y.high], [y.low, y.high], "#888", "5 2", name="equal")
    for kind, colour, mark in (("touch", ESTIMATED, "o"), ("weight", CONTACT, "d")):
        here = np.array([(x, y) for of, x, y in errors if of == kind]).reshape(-1, 2)
        chart.points(here[:, 0], here[:, 1], colour, mark, kind if len(here) else "")
    return chart


def lateral_axis(trial: ValidatedTest) -> int:
    """Return the axis drawn against z: that of the larger load, 0 for x, 1 for y; x for a free probe."""
    if trial.test.direction[1:] in ("x", "y"):
        return "xy".index(trial.test.direction[1:])
    if trial.shape is None or trial.kind == "free":
        return 0
    return int(np.argmax(np.abs(trial.shape.load[0:2])))


def estimated_contact(trial: ValidatedTest) -> Array | None:
    """Return the estimated contact [m], (3,): on the axis if only s is known for comparison, else on the surface."""
    if trial.estimate is None or not trial.estimate.ok:
        return None
    on_axis = trial.contact_base is None and not math.isnan(trial.test.s_contact)
    return trial.estimate.p_contact_base if on_axis else trial.estimate.p_surface_base


def known_contact(trial: ValidatedTest) -> Array | None:
    """Return the point of the axis where the force is known to act [m], (3,); None if unknown."""
    if trial.shape is None or math.isnan(trial.test.s_contact):
        return None
    return np.asarray(trial.shape.p_at(np.array([trial.test.s_contact]))[0])


def shape_chart(trial: ValidatedTest, model: ProbeModel) -> Chart:
    """Return measured markers and contact, estimated outline, centreline and contact, from the side."""
    across = lateral_axis(trial)
    view, rod, estimate = [2, across], model.rod, estimated_contact(trial)
    points = [trial.markers_on_axis, *(p[None] for p in (trial.contact_base, estimate) if p is not None)]
    seen, line, body = np.concatenate([*points, np.zeros((1, 3))])[:, view] / MM, None, np.zeros((0, 2))
    if trial.shape is not None:
        s = np.linspace(0.0, rod.length, POINTS)
        line = trial.shape.p_at(s)
        radius = rod.radius_at(s) * model.cross_section.reach(across * math.pi / 2.0)
        upper, lower = flanks(line, radius, across)
        body = np.concatenate([upper, lower[::-1]])
    chart = Chart.side_view(np.concatenate([body, seen]), across)
    if line is not None:
        chart.area(body.tolist(), ESTIMATED, 0.15)
    if n := len(trial.markers_on_axis):
        chart.line(seen[:n, 0], seen[:n, 1], MEASURED, "7 4", "x", "measured", 1.4)
    if line is not None:
        chart.line(line[:, 2] / MM, line[:, across] / MM, ESTIMATED, name="estimated", width=2.4)
    for p, colour, mark, name in ((estimate, CONTACT, "s", "contact, estimated"),
                                  (trial.contact_base, MEASURED, "o", "contact, measured"),
                                  (known_contact(trial), MEASURED, "d", "s of the contact, known")):  # fmt: skip
        if p is not None:
            chart.points(p[2] / MM, p[across] / MM, colour, mark, name)
    return chart


def validation_page(validation: ValidationReport) -> bytes:
    """Return the page of a validation."""
    model, coverage = validation.estimator.model, validation.coverage
    how = "probe assumed to match its file exactly" if validation.exact else "with the probe's tolerances"
    about = [
        *validation.notes_on_identification,
        f"{len(validation.tests)} tests of {validation.campaign.folder}; geometry {model.fingerprint}; {how}",
        f"assumed of the probe until measured: {assumed_text(model.assumptions)}",
        *coverage.words,
    ]
    drawn = [trial for trial in validation.tests if trial.shape is not None or len(trial.markers_base)]
    shapes = [_shape(trial, model) for trial in drawn[:MAX_SHAPES]]
    folded = [(f"Shapes of {len(shapes)} tests", shapes)]
    after = [("Results by test", _table(validation))]
    if validation.notes or len(drawn) > MAX_SHAPES:
        more = [f"{len(drawn) - MAX_SHAPES} more shapes are not shown"] if len(drawn) > MAX_SHAPES else []
        after.append(("Notes", HtmlTable([""], [[note] for note in (*validation.notes, *more)])))
    title = f"{model.name}: validation against the reference"
    return report_page(
        title, about, _summary(validation), _figures(validation), after, folded, verdict=coverage.sentence
    )


def _summary(validation: ValidationReport) -> HtmlTable:
    rows = []
    for kind, means in validation.summary.items():
        here = [trial for trial in validation.judged if trial.kind == kind]
        located = sum(trial.result == "ok" for trial in here)
        shape, contact = means["shape_rms_mm"], means["contact_error_mm"]
        rows.append([kind, f"{len(here)}", f"{located}", *_mean_cells(shape), *_mean_cells(contact)])
    head = ["tests", "number", "located", "shape RMS, mean", "RMS", "largest", "contact error, mean", "RMS", "largest"]
    return HtmlTable(head, rows, "Shape: equation 6 of the paper. Both include the errors of the reference.")


def _mean_cells(mean: ErrorStatistics) -> list[str]:
    return [_mm(value) for value in (mean.mean, mean.rms, mean.largest)]


def _table(validation: ValidationReport) -> HtmlTable:
    head = ["test", "force", "contact", "direction", "shape RMS", "of length", "contact error", "stated", "predicted",
            "in 95 %", "method", "result"]  # fmt: skip
    rows = []
    for row in validation.rows():
        inside = {None: "—", True: "yes", False: "no"}[row["within_95"]]
        force, fraction = row["force_N"], row["contact_fraction"]
        rows.append([
            row["test"] + ("" if row["held_out"] or row["kind"] == "free" else " (served)"),
            "—" if force is None else "none" if force == 0.0 else f"{force / MILLINEWTON:.3g} mN",
            format_value(fraction, ".3f", "L", "—"), row["direction"] or "—", _mm(row["shape_rms_mm"]),
            format_value(row["shape_rms_percent"], ".2f", "%", "—"),
            _mm(row["contact_error_mm"]), _mm(row["stated_error_mm"]),
            _mm(row["predicted_error_mm"]), inside, row["method"], row["result"],
        ])  # fmt: skip
    note = (
        "Contact: fraction of the length, known or else estimated; its error is that of the touched point, for weights "
        "that of s. Stated: RMS including the reference's own error. Predicted: the predicted error of one "
        "reading of a frictionless touch of that force, position and direction, without a reference. Method: weights "
        "hang by friction and are therefore estimated by the paper's method, which allows a force of any direction."
        " Served: the probe's parameters were identified from the test, which is not judged."
    )
    return HtmlTable(head, rows, note)


def _mm(value: float | None) -> str:
    return format_value(value, ".3g", "mm", "—")


def _figures(validation: ValidationReport) -> list[ReportFigure]:
    located = [trial for trial in validation.judged if trial.contact_error is not None]
    if not located:
        return []
    errors = [trial.contact_error for trial in located if trial.measured and trial.contact_error is not None]
    scaled = sorted(error.nees / error.dof for error in errors)
    dof, n = errors[0].dof if errors else 3, len(scaled)
    expected = (chi2.ppf((np.arange(n) + 0.5) / max(n, 1), dof) / dof).tolist()
    high = max([*scaled, *expected, 1.0]) * 1.1
    nees = Chart(
        ChartAxis("expected quantile of the NEES per degree of freedom", 0.0, high),
        ChartAxis("NEES per degree of freedom", 0.0, high),
    )
    nees.line([0.0, high], [0.0, high], "#888", "5 2", name="consistent")
    nees.line(expected, scaled, ESTIMATED, mark="o", name="touches")
    return [
        ReportFigure("Stated and measured error", "Distance of each contact from the reference against the RMS "
                "distance stated by estimate and reference. About two of three should lie below the line.",
                error_size_chart(located).svg()),
        ReportFigure("Consistency of the stated covariance", "Normalised estimation error squared, sorted, against "
                "the quantiles of its distribution. Above the line the stated covariance is too small.",
                nees.svg()),
    ]  # fmt: skip


def _words(trial: ValidatedTest) -> str:
    if trial.kind == "free":
        return "free"
    force = f"{trial.force / MILLINEWTON:.3g} mN"
    where = "" if math.isnan(trial.fraction) else f" at {trial.fraction:.2g} L"
    return f"{force}{where}{', ' if trial.test.direction else ''}{trial.test.direction}"


def _shape(trial: ValidatedTest, model: ProbeModel) -> ReportFigure:
    parts = []
    if not math.isnan(trial.shape_rms):
        parts.append(f"RMS {trial.shape_rms / MM:.3g} mm, the reference alone {trial.reference_rms / MM:.3g} mm")
    if trial.contact_error is not None:
        parts.append(
            f"contact error {trial.contact_error.size / MM:.3g} mm, stated {trial.contact_error.expected / MM:.3g} mm"
        )
    if not math.isnan(trial.predicted):
        parts.append(f"predicted {trial.predicted / MM:.3g} mm")
    if trial.kind == "free":
        parts.append("no contact reported, as expected" if trial.result != "ok" else "false contact reported")
    elif trial.result != "ok":
        parts.append(f"{trial.result}: {WHY[trial.result]}")
    heading = f"{trial.test.name}: {_words(trial)}"
    return ReportFigure(heading, "; ".join(parts) + ".", shape_chart(trial, model).svg())
