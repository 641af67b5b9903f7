"""One picture of a validation: shapes as the paper's figures 4 to 6, and errors against what was stated."""

from typing import TYPE_CHECKING, Any

import numpy as np

from probedesign.estimation.model import ProbeModel
from probedesign.pages.validation_charts import across_of, centreline, contact_told, outline, place_known
from probedesign.report import blank, png
from probedesign.units import MILLINEWTON, MM
from probedesign.validation.validate import ValidationReport
from probedesign.validation.validated_test import ValidatedTest

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLUMNS, MOST = 3, 11
"""Shapes in a row, and in the picture; one place is the errors'."""


def draw_validation(validation: ValidationReport) -> bytes:
    """The picture, a PNG.

    Raises:
        MissingDependencyError: matplotlib is not installed.
    """
    shown = [t for t in validation.tests if t.shape is not None and t.kind != "free"]
    chosen = (
        shown
        if len(shown) <= MOST
        else [shown[i] for i in np.linspace(0, len(shown) - 1, MOST).round().astype(int)]
    )
    rows = -(-(len(chosen) + 1) // COLUMNS)
    figure = blank(12, 0.8 + 2.6 * rows)
    axes: Any = np.atleast_1d(figure.subplots(rows, COLUMNS)).ravel()
    for ax, trial in zip(axes, chosen, strict=False):
        _draw_shape(ax, trial, validation.estimator.model)
    _draw_errors(axes[len(chosen)], validation)
    for ax in axes[len(chosen) + 1 :]:
        ax.set_axis_off()
    honesty = validation.coverage
    left_out = f", {len(shown) - len(chosen)} more not drawn" if len(shown) > len(chosen) else ""
    figure.suptitle(f"{validation.estimator.model.name}: measured (crosses, ●; ♦ known s) and estimated (line, ■); "
                    f"{honesty.within} of {honesty.touches} touches within their 95 % ellipsoid{left_out}",
                    fontsize=12, x=0.01, ha="left")  # fmt: skip
    return png(figure)


def _draw_shape(ax: "Axes", trial: ValidatedTest, model: ProbeModel) -> None:
    across = across_of(trial)
    body, known = outline(trial, model) / MM, place_known(trial)
    ax.fill(body[:, 2], body[:, across], color="#0072B2", alpha=0.2, lw=0)
    line, seen = centreline(trial) / MM, trial.markers_on_axis / MM
    ax.plot(seen[:, 2], seen[:, across], "x--", color="black", lw=0.8, ms=5)
    ax.plot(line[:, 2], line[:, across], color="#0072B2", lw=1.8)
    told = contact_told(trial)
    if told is not None:
        ax.plot(told[2] / MM, told[across] / MM, "s", color="#D55E00", ms=6)
    if trial.contact_base is not None:
        ax.plot(trial.contact_base[2] / MM, trial.contact_base[across] / MM, "o", color="black", ms=6)
    if known is not None:
        ax.plot(known[2] / MM, known[across] / MM, "d", color="black", ms=6)
    if across == 0:
        ax.invert_yaxis()
    ax.set_aspect("equal", adjustable="datalim")
    ax.grid(True, alpha=0.25)
    off = "" if trial.contact_error is None else f", off {trial.contact_error.size / MM:.2g} mm"
    ax.set_title(
        f"{trial.test.name}: {trial.force / MILLINEWTON:.3g} mN at {trial.fraction:.2g} L{off}", fontsize=9
    )
    ax.set_xlabel("z [mm]", fontsize=8)
    ax.set_ylabel(f"{'xy'[across]} [mm]", fontsize=8)
    ax.tick_params(labelsize=8)


def _draw_errors(ax: "Axes", validation: ValidationReport) -> None:
    """Measured against stated."""
    told = [
        (t.contact_error.expected / MM, t.contact_error.size / MM, t.kind)
        for t in validation.tests
        if t.contact_error is not None
    ]
    for kind, mark in (("touch", "o"), ("weight", "d")):
        here = np.array([(x, y) for x, y, of in told if of == kind]).reshape(-1, 2)
        if len(here):
            ax.plot(here[:, 0], here[:, 1], mark, ms=5, label=kind)
    if told:
        ends = [min(min(x, y) for x, y, _ in told), max(max(x, y) for x, y, _ in told)]
        ax.plot(ends, ends, "--", color="grey", label="equal")
        ax.set(xscale="log", yscale="log")
        ax.legend(fontsize=8)
    ax.set_title("Contact error [mm]: measured against stated, RMS", fontsize=9)
    ax.grid(True, which="both", alpha=0.25)
    ax.tick_params(labelsize=8)
