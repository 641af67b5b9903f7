"""The page of a prediction."""

from collections.abc import Sequence

from probedesign.estimation.estimator import Estimator
from probedesign.prediction.fused import SHOWN_N, shown
from probedesign.prediction.predict import Prediction
from probedesign.reports.html_page import HtmlTable, Section, report_page
from probedesign.reports.prediction_charts import (
    CAPTION,
    LIMITS,
    bending_chart,
    budget_chart,
    error_map,
    force_chart,
    limit_chart,
    sensitivity_chart,
    workspace_chart,
    worst,
)

BUDGET_FORCE_N = 0.02
"""Force of the shown budget of one reading; the grid's nearest force is taken."""
_WORDS = (
    "Worst direction [mm]. Grey cells: — not detected; faint: detected, but too weak to be located; buckles: the probe "
    "is unstable; range: beyond the sensor's range."
)


def prediction_page(prediction: Prediction, estimator: Estimator, more: Sequence[Section] = ()) -> bytes:
    """Return the page of a prediction.

    Args:
        prediction: of a probe.
        estimator: of the same probe.
        more: further sections at the end.
    """
    sag = (
        "it buckles under its own weight"
        if prediction.tip_sag_mm is None
        else f"the tip sags by {prediction.tip_sag_mm:.3g} mm"
    )
    about = [
        f"{prediction.mass_g:.3g} g, flexible part; {sag}, as mounted",
        f"geometry {prediction.fingerprint}; noise {prediction.noise_force_mN:.3g} mN and "
        f"{prediction.noise_moment_Nmm:.3g} N·mm per reading and channel",
        f"assumed: {', '.join(prediction.assumptions) or 'nothing'}; standard deviations at the end",
        f"fused: {prediction.pressing.text}",
    ]
    sections = [*_errors(prediction), *_budgets(prediction), *_space(prediction, estimator), *more]
    after = [("Tolerances: standard deviations", _tolerances(prediction))]
    if prediction.monte_carlo:
        after.insert(0, ("Monte Carlo simulation with the estimator", _sampled(prediction)))
    return report_page(
        f"{prediction.name}: predicted contact errors", about, _table(prediction), sections, after
    )


def _errors(prediction: Prediction) -> list[Section]:
    """Return the maps of the error over position and force, and the force thresholds."""
    k = prediction.pressing.touches
    return [
        Section("Contact error of one reading", f"RMS error, all sources included. {_WORDS}",
                error_map(prediction.conditions, lambda c: c.predicted_error_mm).svg()),
        Section(f"Contact error of {k} fused touches", "Force of the last touch. RMS error, all sources included, "
                "worst direction [mm].", error_map(prediction.fused, lambda c: c.predicted_error_mm).svg()),
        Section("Contact error due to sensor noise alone", "One reading of a probe that matches its model, with "
                "the prior on friction: the lower bound. Worst direction [mm].",
                error_map(prediction.conditions, lambda c: c.noise_error_mm).svg()),
        Section("Force thresholds", "Detected: with probability 0.5 at one false alarm an hour. Then located "
                "within the given RMS error, all sources included. Limit: of the probe or of the sensor. Worst "
                "direction; a line is broken where no force suffices.", force_chart(prediction).svg()),
    ]  # fmt: skip


def _budgets(prediction: Prediction) -> list[Section]:
    """Return the error budgets of one reading and of fused touches."""
    found, k = [], prediction.pressing.touches
    single, fused = worst(prediction.conditions, BUDGET_FORCE_N), shown(prediction.fused, SHOWN_N)
    if single:
        found.append(
            Section(
                f"Error budget of one reading of {1e3 * single[0].force_N:g} mN",
                CAPTION,
                budget_chart(single).svg(),
            )
        )
    if fused:
        heading = f"Error budget of {k} touches up to {1e3 * fused[0].force_N:g} mN"
        found.append(
            Section(
                heading,
                "As before. Robot: position error of the base, independent between touches.",
                budget_chart(fused).svg(),
            )
        )
    return found


def _space(prediction: Prediction, estimator: Estimator) -> list[Section]:
    """Return workspace, force limits, shapes and sensitivity."""
    workspace, area = prediction.workspace, prediction.workspace.area_mm2 or {}
    swept = ", ".join(f"{side} {1e-2 * value:.0f} cm²" for side, value in area.items())
    volume = (
        ""
        if workspace.volume_mm3 is None
        else f" Swept volume over all directions: {1e-3 * workspace.volume_mm3:.0f} cm³."
    )
    return [
        Section("Workspace from the side",
                "Fixed base. Shaded: positions to which the centreline's contact point can be pushed; thin "
                f"lines: path of each position from zero to maximum force. Swept area: {swept}.{volume}",
                workspace_chart(workspace, 0).svg()),
        Section("Workspace from above", "As before, pushed sideways; one side is mirrored where it was not computed.",
                workspace_chart(workspace, 1).svg()),
        Section("Maximum force", "Buckling: the probe becomes unstable. Slips off: an object "
                "at constant distance from the base reaches the tip.", limit_chart(prediction).svg()),
        Section("Deflection", "Seen along y, x downwards; dots are the touches, along ±x.",
                bending_chart(estimator).svg()),
        Section("Sensitivity to a press", "At the lightest force, along the last direction: base moment and "
                "force per additional millimetre of press.", sensitivity_chart(prediction).svg()),
    ]  # fmt: skip


def _table(prediction: Prediction) -> HtmlTable:
    """Return force thresholds and limits along the probe, worst direction."""
    k = prediction.pressing.touches
    head = [
        "along the probe",
        "detected from",
        "5 mm",
        "2 mm",
        "1 mm",
        f"2 mm, {k} fused",
        "maximum force",
        "limited by",
        "deflection",
    ]
    rows = []
    for place in sorted({r.contact_fraction for r in prediction.reach}):
        here = [r for r in prediction.reach if r.contact_fraction == place]
        weakest = min(here, key=lambda r: r.greatest_force_N or 0.0)
        felt = [d.detectable_force_mN for d in prediction.detection if d.contact_fraction == place]
        fused = [f.force_mN_for_2_mm for f in prediction.fused_reach if f.contact_fraction == place]
        max_force = None if weakest.greatest_force_N is None else 1e3 * weakest.greatest_force_N
        needed = ([r.force_mN_for_5_mm for r in here], [r.force_mN_for_2_mm for r in here],
                  [r.force_mN_for_1_mm for r in here], fused)  # fmt: skip
        rows.append([f"{place:g} L", _force(felt), *map(_force, needed), _force([max_force]), LIMITS[weakest.limit][0],
                     "none" if weakest.deflection_mm is None else f"{weakest.deflection_mm:.3g} mm"])  # fmt: skip
    return HtmlTable(head, rows)


def _force(values: Sequence[float | None]) -> str:
    """Return the largest value; none if one is missing."""
    known = [value for value in values if value is not None]
    if len(known) < len(values) or not known:
        return "none"
    largest = max(known)
    return f"{largest:.3g} mN" if largest < 1000.0 else f"{1e-3 * largest:.3g} N"


def _tolerances(prediction: Prediction) -> HtmlTable:
    sources = prediction.tolerances.sources(prediction.resin)
    rows = [[name, f"{getattr(prediction.tolerances, name):g}", source] for name, source in sources.items()]
    return HtmlTable(["[tolerances]", "value", "source"], rows)


def _sampled(prediction: Prediction) -> HtmlTable:
    head = ["contact", "touches", "force", "direction", "budget", "Monte Carlo", "95 % within", "located"]
    rows = [
        [f"{r.contact_fraction:g} L", f"{r.touches}", f"{1e3 * r.force_N:g} mN", r.direction, _mm(r.first_order_mm),
         _mm(r.error_mm) + (" *" if r.differs else ""), _mm(r.error_95_mm), f"{r.located / r.draws:.0%}"]
        for r in prediction.monte_carlo
    ]  # fmt: skip
    return HtmlTable(
        head, rows, "* differs from the budget by more than a tenth; the Monte Carlo value is more reliable"
    )


def _mm(value: float | None) -> str:
    return "none" if value is None else f"{value:.3g} mm"
