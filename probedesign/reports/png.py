"""PNG pictures of a prediction and a validation, drawn with matplotlib; legible at half size."""

import io
from typing import TYPE_CHECKING, Any

import numpy as np

from probedesign.core.errors import MissingDependencyError
from probedesign.core.units import MILLINEWTON, MM
from probedesign.design.catalog import assumed_text
from probedesign.estimation.estimator import Estimator
from probedesign.prediction.predict import Prediction
from probedesign.reports.chart import NO_LINE, Chart, ChartArea, ChartLine
from probedesign.reports.prediction_page import prediction_figures

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from probedesign.validation.validate import ValidationReport

#: Shapes in a row, and in the whole picture of a validation; one more panel shows the errors.
COLUMNS, MAX_PICTURED = 3, 11


def draw_prediction(prediction: Prediction, estimator: Estimator) -> bytes:
    """Return a PNG with the figures of the prediction that have a panel title, two in a row.

    Raises:
        MissingDependencyError: matplotlib is not installed.
    """
    panels = [figure for figure in prediction_figures(prediction, estimator) if figure.panel]
    rows = -(-len(panels) // 2)
    figure = _new_figure(12, 1.25 + 3.68 * rows, (0.7, 0.1, 0.5, 0.75))
    axes: Any = figure.subplots(rows, 2, gridspec_kw={"wspace": 0.135, "hspace": 0.22}).ravel()
    for ax, panel in zip(axes, panels, strict=False):
        draw_chart(panel.chart, ax, panel.panel)
        ax.set_title(panel.panel, y=1.0)  # a fixed position, which matplotlib would otherwise search for
    for ax in axes[len(panels) :]:
        ax.set_axis_off()
    noise = f"σ {prediction.noise_force_mN:.2g} mN, {prediction.noise_moment_Nmm:.2g} N·mm per reading"
    text = (f"{prediction.name}  ·  geometry {prediction.fingerprint}  ·  {noise}\n"
            f"assumed until measured: {assumed_text(prediction.assumptions)}")  # fmt: skip
    figure.suptitle(text, fontsize=12, x=0.01, y=1.0 - 0.07 / (1.25 + 3.68 * rows), ha="left", va="top")
    return _png_bytes(figure)


def draw_validation(validation: "ValidationReport") -> bytes:
    """Return a PNG of a validation: shapes as the paper's figures 4 to 6, and errors against their prediction.

    Raises:
        MissingDependencyError: matplotlib is not installed.
    """
    # Imported here, so that `predict` loads neither campaigns nor scipy.stats.
    from probedesign.reports.validation_page import error_size_chart, shape_chart

    model, coverage = validation.estimator.model, validation.coverage
    shown = [t for t in validation.tests if t.shape is not None and t.kind != "free"]
    n = min(len(shown), MAX_PICTURED)
    chosen = [shown[i] for i in np.linspace(0, len(shown) - 1, n).round().astype(int)]
    rows = -(-(len(chosen) + 1) // COLUMNS)
    figure = _new_figure(12, 0.8 + 2.6 * rows)
    axes: Any = np.atleast_1d(figure.subplots(rows, COLUMNS)).ravel()
    for ax, trial in zip(axes, chosen, strict=False):
        stated = "" if trial.contact_error is None else f", error {trial.contact_error.size / MM:.2g} mm"
        title = f"{trial.test.name}: {trial.force / MILLINEWTON:.3g} mN at {trial.fraction:.2g} L{stated}"
        draw_chart(shape_chart(trial, model), ax, title, legend_size=0.0)
    errors = error_size_chart([t for t in validation.tests if t.contact_error is not None])
    draw_chart(errors, axes[len(chosen)], "Contact error: measured against stated")
    for ax in axes[: len(chosen) + 1]:
        ax.title.set_fontsize(9)
        ax.tick_params(labelsize=8)
        ax.xaxis.label.set_fontsize(8)
        ax.yaxis.label.set_fontsize(8)
    for ax in axes[len(chosen) + 1 :]:
        ax.set_axis_off()
    left_out = f", {len(shown) - len(chosen)} more not shown" if len(shown) > len(chosen) else ""
    figure.suptitle(f"{model.name}: measured (crosses, ●; ♦ known s) and estimated (line, ■); {coverage.within} of "
                    f"{coverage.touches} touches within their 95 % ellipsoid{left_out}",
                    fontsize=12, x=0.01, ha="left")  # fmt: skip
    return _png_bytes(figure)


def _new_figure(width: float, height: float, margins: tuple[float, float, float, float] | None = None) -> "Figure":
    """Return an empty figure that needs no display.

    Args:
        width, height: [inch].
        margins: left, right, bottom and top of its axes [inch]; fitted to the content if None, which takes as long as
            drawing it twice more.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ModuleNotFoundError:
        raise MissingDependencyError.of_extra("--plots", "matplotlib", "plots") from None
    figure = Figure(figsize=(width, height), layout="constrained" if margins is None else None)
    FigureCanvasAgg(figure)
    if margins is not None:
        left, right, bottom, top = margins
        figure.subplots_adjust(left / width, bottom / height, 1.0 - right / width, 1.0 - top / height)
    return figure


def _png_bytes(figure: "Figure") -> bytes:
    picture = io.BytesIO()
    figure.savefig(picture, format="png", dpi=110, metadata={"Software": None})
    return picture.getvalue()


def draw_chart(chart: Chart, ax: "Axes", title: str, legend_size: float = 8.0) -> None:
    """Draw a chart into matplotlib axes; boxes and labels are for the SVG alone."""
    for element in chart.elements:
        match element:
            case ChartLine(x, y, colour, dashes, mark, width, _):
                ax.plot(x, y, color=colour, lw=0.75 * width, ls=_linestyle(dashes), marker=mark, ms=4.5)
            case ChartArea(points, colour, opacity):
                ax.fill(*zip(*points, strict=True), color=colour, alpha=opacity, lw=0)
            case _:
                raise TypeError(f"matplotlib draws no {type(element).__name__} of a chart")
    for entry in chart.legend:
        if entry.dashes is None:
            ax.fill([], [], color=entry.colour, alpha=0.4, lw=0, label=entry.name)
        else:
            style = _linestyle(entry.dashes)
            ax.plot([], [], color=entry.colour, ls=style, marker=entry.mark, ms=4.5, label=entry.name)
    ax.set(xlabel=chart.x.label, ylabel=chart.y.label, title=title)
    if chart.square:  # matplotlib chooses limits that suit the shape of its axes
        ax.set_aspect("equal", adjustable="datalim")
    else:
        for axis, name in ((chart.x, "x"), (chart.y, "y")):
            ax.set(**{f"{name}scale": "log" if axis.log else "linear", f"{name}lim": (axis.low, axis.high)})
            ax.set(**{f"{name}ticks": axis.shown_ticks, f"{name}ticklabels": axis.tick_labels})
        ax.minorticks_off()
        if chart.x.upright:
            ax.tick_params(axis="x", rotation=90.0, labelsize=8.0)
    if chart.down:
        ax.invert_yaxis()
    ax.grid(True, alpha=0.25)
    if chart.legend and legend_size:
        ax.legend(fontsize=legend_size)


def _linestyle(dashes: str) -> str | tuple[float, tuple[float, ...]]:
    if dashes == NO_LINE:
        return "none"
    return (0.0, tuple(0.5 * float(n) for n in dashes.split())) if dashes else "-"
