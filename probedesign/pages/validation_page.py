"""The page of one validation: measured beside estimated, as the paper's figures 3 to 6 and its Table I."""

import math

from probedesign.estimation.model import ProbeModel
from probedesign.pages.validation_charts import draw_inner, draw_shape, draw_sizes, draw_squares
from probedesign.reports.html_page import HtmlTable, Section, report_page
from probedesign.units import MILLINEWTON, MM
from probedesign.validation.trial import Trial
from probedesign.validation.validate import WHY, Mean, Validation

MOST_SHAPES = 24
"""More shapes are not drawn, which the page says."""


def validation_page(validation: Validation) -> bytes:
    """The page."""
    model, honesty = validation.estimator.model, validation.honesty
    how = (
        "the probe taken for exactly what its file says"
        if validation.exact
        else "with the probe's tolerances"
    )
    about = [
        f"{len(validation.trials)} tests of {validation.campaign.folder}; geometry {model.fingerprint}; {how}",
        f"assumed of the probe: {', '.join(model.assumptions) or 'nothing'}",
        *honesty.words,
    ]
    drawn = [trial for trial in validation.trials if trial.shape is not None or len(trial.markers_base)]
    shapes = (_shape(trial, model) for trial in drawn[:MOST_SHAPES])
    sections = [*_figures(validation), *_inner(validation), *shapes]
    after = [("Which tests tell what", _table(validation))]
    if validation.notes or len(drawn) > MOST_SHAPES:
        more = [f"{len(drawn) - MOST_SHAPES} more shapes are not drawn"] if len(drawn) > MOST_SHAPES else []
        after.append(("Notes", HtmlTable(["", ""], [[note, ""] for note in (*validation.notes, *more)])))
    return report_page(
        f"{model.name}: what it measured beside the reference", about, _summary(validation), sections, after
    )


def _summary(validation: Validation) -> HtmlTable:
    """Means by kind of test."""
    rows = []
    for kind, means in validation.summary.items():
        here = [trial for trial in validation.trials if trial.kind == kind]
        located = sum(trial.result == "ok" for trial in here)
        shape, contact = means["shape_rms_mm"], means["contact_error_mm"]
        rows.append([kind, f"{len(here)}", f"{located}", *_told(shape), *_told(contact)])
    head = [
        "tests",
        "number",
        "located",
        "shape RMS, mean",
        "RMS",
        "largest",
        "contact error, mean",
        "RMS",
        "largest",
    ]
    return HtmlTable(head, rows, "Shape: equation 6 of the paper. The reference's own errors are in both.")


def _told(mean: Mean) -> list[str]:
    return ["—" if value is None else f"{value:.3g} mm" for value in (mean.mean, mean.rms, mean.largest)]


def _table(validation: Validation) -> HtmlTable:
    """Table I, with what was stated."""
    head = [
        "test",
        "force",
        "contact",
        "way",
        "shape RMS",
        "of length",
        "contact error",
        "stated",
        "predicted",
        "in 95 %",
        "method",
        "result",
    ]
    rows = []
    for row in validation.rows():
        inside = {None: "—", True: "yes", False: "no"}[row["within_95"]]
        force, fraction = row["force_N"], row["contact_fraction"]
        rows.append([
            row["test"], "—" if force is None else "none" if force == 0.0 else f"{force / MILLINEWTON:.3g} mN",
            "—" if fraction is None else f"{fraction:.3f} L", row["direction"] or "—", _mm(row["shape_rms_mm"]),
            "—" if row["shape_rms_percent"] is None else f"{row['shape_rms_percent']:.2f} %",
            _mm(row["contact_error_mm"]), _mm(row["stated_error_mm"]),
            _mm(row["predicted_error_mm"]), inside, row["method"], row["result"],
        ])  # fmt: skip
    note = (
        "Contact: fraction of the length, as known, else as estimated; its error that of the touched point, of weights "
        "that of s. Stated: RMS, the reference's own share counted. Predicted: what `predict` says beforehand of a "
        "frictionless touch of that force, place and way, read once, without a reference. Method: weights are held by "
        "friction, so that they are estimated by the paper's method, which takes a force of any direction."
    )
    return HtmlTable(head, rows, note)


def _mm(value: float | None) -> str:
    return "—" if value is None else f"{value:.3g} mm"


def _figures(validation: Validation) -> list[Section]:
    """Measured error against stated error, and the squares beside their distribution."""
    held = [trial for trial in validation.trials if trial.miss is not None]
    if not held:
        return []
    return [
        Section("Do stated errors come true? Size", "Each contact: its distance from the reference against the RMS "
                "distance that estimate and reference state. About two of three should lie below the line.",
                draw_sizes(held)),
        Section("Do stated errors come true? Squares", "Errors over their standard deviations, squared, in order, "
                "against what so many would be if all is true. Above the line too much was promised.",
                draw_squares(held)),
    ]  # fmt: skip


def _inner(validation: Validation) -> list[Section]:
    """Internal force and moment of the free probe and of the touch in the middle of those located."""
    free = next((t for t in validation.trials if t.kind == "free" and t.shape is not None), None)
    located = [t for t in validation.trials if t.kind != "free" and t.shape is not None]
    shown = [trial for trial in (free, located[len(located) // 2] if located else None) if trial is not None]
    found = []
    for trial in shown:
        assert trial.shape is not None
        jump = (
            ""
            if trial.kind == "free"
            else " At the touched section the force jumps, and the moment by the couple of that force about the axis."
        )
        name = f"{trial.test.name}, {_words(trial)}"
        found.append(
            Section(f"Internal force: {name}", f"In the base's axes.{jump}", draw_inner(trial.shape, "force"))
        )
        found.append(
            Section(
                f"Internal moment: {name}", f"In the base's axes.{jump}", draw_inner(trial.shape, "moment")
            )
        )
    return found


def _words(trial: Trial) -> str:
    if trial.kind == "free":
        return "free"
    force = f"{trial.force / MILLINEWTON:.3g} mN"
    place = "" if math.isnan(trial.fraction) else f" at {trial.fraction:.2g} L"
    return f"{force}{place}{', ' if trial.test.direction else ''}{trial.test.direction}"


def _shape(trial: Trial, model: ProbeModel) -> Section:
    """One probe as measured and as estimated."""
    parts = []
    if not math.isnan(trial.shape_rms):
        parts.append(
            f"RMS {trial.shape_rms / MM:.3g} mm, the reference alone {trial.reference_rms / MM:.3g} mm"
        )
    if trial.miss is not None:
        parts.append(
            f"contact off by {trial.miss.size / MM:.3g} mm, stated {trial.miss.expected / MM:.3g} mm"
        )
    if not math.isnan(trial.predicted):
        parts.append(f"predicted beforehand {trial.predicted / MM:.3g} mm")
    if trial.kind == "free":
        parts.append(
            "no place told, as it should be" if trial.result != "ok" else "a place told, and nothing touches"
        )
    elif trial.result != "ok":
        parts.append(f"{trial.result}: {WHY[trial.result]}")
    return Section(f"{trial.test.name}: {_words(trial)}", "; ".join(parts) + ".", draw_shape(trial, model))
