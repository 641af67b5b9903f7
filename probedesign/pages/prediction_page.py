"""The page of one prediction."""

from collections.abc import Sequence

from probedesign.estimation.estimator import Estimator
from probedesign.pages.budget_bars import CAPTION, draw_budget, worst
from probedesign.pages.error_map import draw_error_map
from probedesign.pages.force_chart import LIMITS, draw_forces, draw_limits, draw_sensitivity
from probedesign.pages.side_views import draw_shapes, draw_workspace
from probedesign.prediction.fused import SHOWN_N, shown
from probedesign.prediction.predict import Prediction
from probedesign.reports.html_page import HtmlTable, Section, report_page

BUDGET_FORCE_N = 0.02
"""At which the budget of one reading is shown, or at the force of the grid nearest to it."""
_WORDS = (
    "Worst of the directions [mm]. Grey cells: — not felt; faint: felt, but too light to be located; yields: the probe "
    "gives way; range: beyond the sensor's range."
)


def prediction_page(prediction: Prediction, estimator: Estimator, more: Sequence[Section] = ()) -> bytes:
    """The page.

    Args:
        prediction: of a probe.
        estimator: of the same.
        more: further sections at the end.
    """
    sag = (
        "it cannot stand" if prediction.tip_sag_mm is None else f"its tip sags {prediction.tip_sag_mm:.3g} mm"
    )
    about = [
        f"{prediction.mass_g:.3g} g, flexible part; {sag}, as mounted",
        f"geometry {prediction.fingerprint}; noise {prediction.noise_force_mN:.3g} mN and "
        f"{prediction.noise_moment_Nmm:.3g} N·mm a reading and channel",
        f"assumed: {', '.join(prediction.assumptions) or 'nothing'}; spreads at the end",
        f"fused: {prediction.pressing.text}",
    ]
    sections = [*_errors(prediction), *_budgets(prediction), *_space(prediction, estimator), *more]
    after = [("What it rests on: standard deviations", _tolerances(prediction))]
    if prediction.monte_carlo:
        after.insert(0, ("Monte Carlo with the real estimator", _sampled(prediction)))
    return report_page(f"{prediction.name}: what it will feel", about, _table(prediction), sections, after)


def _errors(prediction: Prediction) -> list[Section]:
    """How well at which place and force."""
    k = prediction.pressing.touches
    return [
        Section("How well does one reading locate?", f"RMS error, all causes counted. {_WORDS}",
                draw_error_map(prediction.conditions, lambda c: c.predicted_error_mm)),
        Section(f"And {k} touches, fused?", f"The last of {k} touches has this force. RMS error, all causes counted, "
                "worst of the directions [mm].", draw_error_map(prediction.fused, lambda c: c.predicted_error_mm)),
        Section("Were the sensor's noise all?", "One reading of a probe that is exactly its model, with the prior on "
                "friction: the bound. "
                "Worst of the directions [mm].",
                draw_error_map(prediction.conditions, lambda c: c.noise_error_mm)),
        Section("From which force on?", "Felt: told from none every other time, one false alarm an hour. Then located "
                "to so many millimetres, RMS, all causes counted. The end: what the probe or the sensor bears. Worst "
                "of the directions; a line is broken where no force will do.", draw_forces(prediction)),
    ]  # fmt: skip


def _budgets(prediction: Prediction) -> list[Section]:
    """What the error is made of."""
    found, k = [], prediction.pressing.touches
    single, fused = worst(prediction.conditions, BUDGET_FORCE_N), shown(prediction.fused, SHOWN_N)
    if single:
        found.append(
            Section(
                f"What limits one reading of {1e3 * single[0].force_N:g} mN?", CAPTION, draw_budget(single)
            )
        )
    if fused:
        heading = f"What limits {k} touches up to {1e3 * fused[0].force_N:g} mN?"
        found.append(
            Section(
                heading, "The same. Robot: the base's place at each touch for itself.", draw_budget(fused)
            )
        )
    return found


def _space(prediction: Prediction, estimator: Estimator) -> list[Section]:
    """What it bears and where it gets to."""
    workspace, area = prediction.workspace, prediction.workspace.area_mm2 or {}
    swept = ", ".join(f"{side} {1e-2 * value:.0f} cm²" for side, value in area.items())
    volume = "" if workspace.volume_mm3 is None else f" From all round {1e-3 * workspace.volume_mm3:.0f} cm³."
    return [
        Section("Where can it be touched? From the side",
                "The base stands still. Shaded: where the contact point on the centreline can be pushed to; thin "
                f"lines: each place's way, from no force to the greatest. Swept: {swept}.{volume}",
                draw_workspace(workspace, 0)),
        Section("From above", "The same, pushed across; the other side mirrored where it was not computed.",
                draw_workspace(workspace, 1)),
        Section("How hard can one press?", "Gives way: the probe buckles or bends away. Slips off: an object "
                "that keeps its distance from the base has come to the tip.", draw_limits(prediction)),
        Section("How does it bend?", "Seen along y, x downwards; dots are the touches, along ±x.",
                draw_shapes(estimator)),
        Section("How hard does a millimetre press?", "At the lightest force, along the last of the directions: what a "
                "millimetre more of press changes.", draw_sensitivity(prediction)),
    ]  # fmt: skip


def _table(prediction: Prediction) -> HtmlTable:
    """Along the probe, worst of the directions: what it takes and what it stands."""
    k = prediction.pressing.touches
    head = [
        "along the probe",
        "felt from",
        "5 mm",
        "2 mm",
        "1 mm",
        f"2 mm, {k} fused",
        "most",
        "ended by",
        "moved by",
    ]
    rows = []
    for place in sorted({r.contact_fraction for r in prediction.reach}):
        here = [r for r in prediction.reach if r.contact_fraction == place]
        least = min(here, key=lambda r: r.greatest_force_N or 0.0)
        felt = [d.detectable_force_mN for d in prediction.detection if d.contact_fraction == place]
        fused = [f.force_mN_for_2_mm for f in prediction.fused_reach if f.contact_fraction == place]
        most = None if least.greatest_force_N is None else 1e3 * least.greatest_force_N
        needed = ([r.force_mN_for_5_mm for r in here], [r.force_mN_for_2_mm for r in here],
                  [r.force_mN_for_1_mm for r in here], fused)  # fmt: skip
        rows.append([f"{place:g} L", _force(felt), *map(_force, needed), _force([most]), LIMITS[least.limit][0],
                     "none" if least.deflection_mm is None else f"{least.deflection_mm:.3g} mm"])  # fmt: skip
    return HtmlTable(head, rows)


def _force(values: Sequence[float | None]) -> str:
    """The greatest; none where one is none."""
    known = [value for value in values if value is not None]
    if len(known) < len(values) or not known:
        return "none"
    most = max(known)
    return f"{most:.3g} mN" if most < 1000.0 else f"{1e-3 * most:.3g} N"


def _tolerances(prediction: Prediction) -> HtmlTable:
    sources = prediction.tolerances.sources()
    rows = [[name, f"{getattr(prediction.tolerances, name):g}", source] for name, source in sources.items()]
    return HtmlTable(["[tolerances]", "is", "from"], rows)


def _sampled(prediction: Prediction) -> HtmlTable:
    head = ["contact", "touches", "force", "direction", "budget", "Monte Carlo", "95 % within", "located"]
    rows = [
        [f"{r.contact_fraction:g} L", f"{r.touches}", f"{1e3 * r.force_N:g} mN", r.direction, _mm(r.first_order_mm),
         _mm(r.error_mm) + (" *" if r.differs else ""), _mm(r.error_95_mm), f"{r.located / r.draws:.0%}"]
        for r in prediction.monte_carlo
    ]  # fmt: skip
    return HtmlTable(head, rows, "* differs from the budget by more than a tenth: believe Monte Carlo")


def _mm(value: float | None) -> str:
    return "none" if value is None else f"{value:.3g} mm"
