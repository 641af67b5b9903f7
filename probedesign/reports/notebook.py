"""What results show in a notebook: a short table, a picture and a data frame of each class of `core.notebook`.

`summary_of` has one entry per class, and so has `rows_of` for the classes that are tables. A picture is a `Chart`: SVG
in the notebook's output, matplotlib where it is plotted.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from functools import singledispatch
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

from probedesign.core import statistics
from probedesign.core.errors import require
from probedesign.core.frames import Array
from probedesign.core.units import GRAM, MILLINEWTON, MM, MPA, N_MM, format_value
from probedesign.design import Design
from probedesign.design.catalog import assumed_text
from probedesign.estimation.estimate import RESULTS, Estimate, FusedEstimate
from probedesign.estimation.estimator import Estimator
from probedesign.estimation.model import ProbeModel
from probedesign.identification.result import Identification, Identified
from probedesign.mount import build_geometry
from probedesign.prediction.fused import worst
from probedesign.prediction.predict import Prediction, condition_rows
from probedesign.probe import Probe
from probedesign.reports.chart import COLOURS, NO_LINE, Chart, ChartArea, ChartLine
from probedesign.reports.html_page import labelled
from probedesign.reports.identification_page import residual_chart
from probedesign.reports.prediction_charts import STATIONS, body_chart, error_chart

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from pandas import DataFrame

_ARROW = 0.25  #: Length of a force's arrow over that of the probe.
FORCE_COLUMNS = tuple(f"force_base_{axis}_N" for axis in "xyz")
_STYLE = "margin: 0.3em 0 0.3em 0.8em"


@dataclass(frozen=True)
class Summary:
    """What a notebook shows of an object."""

    title: str  #: its kind and name.
    rows: Sequence[tuple[str, str]]  #: quantities and their values with units.
    chart: Chart | None = None  #: the picture, if there is one.


def views_of(thing: object) -> dict[str, str]:
    """Return the table and the picture of an object as HTML, and the table as text, by their media types."""
    summary = summary_of(thing)
    width = max(len(name) for name, _ in summary.rows)
    text = "\n".join([summary.title, *(f"  {name:<{width}}  {value}" for name, value in summary.rows)])
    rows = "".join(
        f'<tr><th style="text-align: left">{escape(name)}</th><td style="text-align: left">{escape(value)}</td></tr>'
        for name, value in summary.rows
    )
    head = f'<thead><tr><th colspan="2">{escape(summary.title)}</th></tr></thead>'
    html = f"<table>{head}<tbody>{rows}</tbody></table>"
    if summary.chart is not None:
        picture = labelled(summary.chart.svg(), summary.title)
        # its inks are dark, and a notebook may be
        shown = f'<div style="background: #fff; width: 440px; max-width: 100%; {_STYLE}">{picture}</div>'
        html = f'<div style="display: flex; flex-wrap: wrap; align-items: flex-start">{html}{shown}</div>'
    return {"text/html": html, "text/plain": text}


def plot_of(thing: object, ax: "Axes | None") -> "Axes":
    """Draw the picture of an object into matplotlib axes, new ones if None, and return them.

    Raises:
        MissingDependencyError: matplotlib is not installed.
    """
    require("matplotlib", "a plot", "notebook")
    if ax is None:
        from matplotlib import pyplot

        ax = pyplot.subplots(layout="constrained")[1]
    summary = summary_of(thing)
    ax.set(title=summary.title)
    if (chart := summary.chart) is None:
        return ax
    for shape in chart.elements:
        match shape:
            case ChartLine(x, y, colour, dashes, mark, width, _):
                ax.plot(x, y, color=colour, lw=0.75 * width, ls=_linestyle(dashes), marker=mark, ms=4.5)
            case ChartArea(points, colour, opacity):
                ax.fill(*zip(*points, strict=True), color=colour, alpha=opacity, lw=0)
            case _:
                raise TypeError(f"matplotlib draws no {type(shape).__name__} of a chart")
    for entry in chart.legend:
        dashes, alpha = (NO_LINE, 0.4) if entry.dashes is None else (entry.dashes, 1.0)
        mark = "s" if entry.dashes is None else entry.mark
        ax.plot([], [], color=entry.colour, alpha=alpha, ls=_linestyle(dashes), marker=mark, ms=4.5, label=entry.name)
    if chart.legend:
        ax.legend(fontsize=8.0)
    ax.set(xlabel=chart.x.label, ylabel=chart.y.label)
    if chart.square:
        ax.set_aspect("equal", adjustable="datalim")
    else:
        ax.set(xscale="log" if chart.x.log else "linear", xlim=(chart.x.low, chart.x.high),
               yscale="log" if chart.y.log else "linear", ylim=(chart.y.low, chart.y.high))  # fmt: skip
        ax.set_xticks(chart.x.shown_ticks, chart.x.tick_labels, rotation=90.0 if chart.x.upright else 0.0)
        ax.set_yticks(chart.y.shown_ticks, chart.y.tick_labels)
        ax.minorticks_off()
    if chart.down:
        ax.invert_yaxis()
    ax.grid(True, alpha=0.25)
    return ax


def _linestyle(dashes: str) -> str | tuple[float, tuple[float, ...]]:
    if dashes == NO_LINE:
        return "none"
    return (0.0, tuple(0.5 * float(n) for n in dashes.split())) if dashes else "-"


def dataframe_of(thing: object) -> "DataFrame":
    """Return an object as a data frame.

    Raises:
        MissingDependencyError: pandas is not installed.
    """
    require("pandas", "a data frame", "notebook")
    from pandas import DataFrame

    columns, rows = rows_of(thing)
    return DataFrame(rows, columns=list(columns))


@singledispatch
def summary_of(thing: object) -> Summary:
    """Return what is shown of an object."""
    raise TypeError(f"a notebook shows no {type(thing).__name__}")


Rows = tuple[Iterable[str], list[dict[str, Any]]]


@singledispatch
def rows_of(thing: object) -> Rows:
    """Return an object as the columns and rows of a table."""
    raise TypeError(f"a {type(thing).__name__} is not a table")


# Design and probe


@summary_of.register
def _(design: Design) -> Summary:
    probe, sensor = design.probe, design.sensor_model
    ends = f"{probe.base_d_mm:g} mm at the base" + (f", {probe.tip_d_mm:g} mm at the tip" if probe.tip_d_mm else "")
    gravity = ", ".join(f"{g:g}" for g in design.mount.gravity_base_m_s2)
    rows = [
        ("shape", f"{probe.shape}, {probe.section} section, {probe.length_mm:g} mm long"),
        ("diameter", ends),
        ("resin", design.resin.product),
        *_material({"E": design.youngs_modulus, "G": design.shear_modulus, "density": design.density}),
        ("sensor", f"{sensor.name}, {design.calibration.name}, mean of {design.sensor.averaging_samples} samples"),
        ("gravity in base axes", f"{gravity} m/s²"),
        ("friction", f"{design.friction.value:g} ({design.friction.provenance})"),
    ]

    geometry = build_geometry(design)
    return Summary(f"design {design.name}", rows, _body(np.outer(geometry.s, (0.0, 0.0, 1.0)), geometry.radius))


@summary_of.register
def _(probe: Probe) -> Summary:
    return summary_of(probe.model)


@summary_of.register
def _(model: ProbeModel) -> Summary:
    rod, free = model.rod, Estimator(model).free()
    s = np.linspace(0.0, rod.length, STATIONS)
    radius = rod.radius_at(s)
    force, moment = model.wrench_range[0], model.wrench_range[3]
    noise = f"{model.noise.force / MILLINEWTON:.3g} mN, {model.noise.moment / N_MM:.3g} N·mm"
    names = {"youngs_modulus": "E", "shear_modulus": "G", "density": "density"}
    rows = [
        ("geometry", model.fingerprint),
        ("length", f"{rod.length / MM:g} mm"),
        ("diameter", f"{2.0 * radius[0] / MM:.3g} mm at the base, {2.0 * radius[-1] / MM:.3g} mm at the tip"),
        ("mass of the flexible part", f"{model.mass / GRAM:.3g} g"),
        *_material({names[key]: quantity for key, quantity in model.material.items() if key in names}),
        ("sensor", f"{model.sensor}, ±{force:g} N, ±{moment / N_MM:g} N·mm (x)"),
        ("noise of one reading", noise),
        ("free shape", "bent by gravity as mounted" if free.ok else "buckles under its own weight"),
    ]
    shape = free.p_at(s) if free.ok else np.outer(s, (0.0, 0.0, 1.0))
    return Summary(f"probe {model.name}", rows, _body(shape, radius))


def _material(quantities: dict[str, Any]) -> list[tuple[str, str]]:
    units = {"E": (MPA, "MPa"), "G": (MPA, "MPa"), "density": (1.0, "kg/m³")}
    return [
        (name, f"{quantity.value / units[name][0]:.4g} {units[name][1]} ({quantity.provenance})")
        for name, quantity in quantities.items()
    ]


def _body(shape: Array, radius: Array) -> Chart:
    chart, upper, lower = body_chart(shape, radius)
    corners = np.concatenate([upper, lower[::-1]])
    chart.area([(z, x) for z, x in corners.tolist()], COLOURS[1], 0.35)
    outline = np.concatenate([corners, corners[:1]])
    chart.line(outline[:, 0], outline[:, 1], COLOURS[1], width=1.0)
    return chart


# Prediction


@summary_of.register
def _(prediction: Prediction) -> Summary:
    forces = sorted({c.force_N for c in prediction.conditions})
    errors = [
        (f"RMS error of {force / MILLINEWTON:g} mN at {touch.contact_fraction:g} of the length",
         format_value(touch.predicted_error_mm, ".3g", "mm", touch.result))
        for force in forces
        for touch in sorted(worst(prediction.conditions, force), key=lambda c: abs(c.contact_fraction - 0.8))[:1]
    ]  # fmt: skip
    rows = [
        ("result", prediction.verdict),
        *errors,
        ("sag of the tip", format_value(prediction.tip_sag_mm, ".3g", "mm", "it buckles")),
        ("mass of the flexible part", f"{prediction.mass_g:.3g} g"),
        ("assumed until measured", assumed_text(prediction.assumptions)),
    ]
    located = any(c.predicted_error_mm is not None for c in prediction.conditions)
    return Summary(f"prediction of {prediction.name}", rows, error_chart(prediction) if located else None)


@rows_of.register
def _(prediction: Prediction) -> Rows:
    return condition_rows(prediction)


# Estimates


@summary_of.register
def _(estimate: Estimate) -> Summary:
    rows = [("result", f"{estimate.result}: {RESULTS[estimate.result]}")]
    if estimate.ok:
        rms = statistics.rms(estimate.cov_surface_base)
        rows += [
            ("touched point, base frame", _point(estimate.p_surface_base)),
            ("RMS error of it", f"{rms / MM:.3g} mm"),
            ("arclength s", f"{estimate.s_contact / MM:.2f} ± {estimate.std_s / MM:.2g} mm"),
            ("normal force", f"{estimate.force_normal / MILLINEWTON:.3g} mN"),
            ("friction, tangential over normal", f"{estimate.friction_ratio:.2g}"),
        ]
    elif estimate.candidates:
        rows.append(("candidates", f"{len(estimate.candidates)}"))
    if not estimate.ok or estimate.shape is None:
        return Summary(f"estimate: {estimate.result}", rows)
    return Summary("estimate of one reading", rows, _contact(estimate))


def _contact(estimate: Estimate) -> Chart:
    shape, p, force = estimate.shape, estimate.p_surface_base, estimate.force_base
    assert shape is not None
    length = float(shape.s[-1])
    across = int(np.argmax(np.abs(force[:2])))
    view = [2, across]
    line = shape.p_at(np.linspace(0.0, length, STATIONS))[:, view] / MM
    ends = np.stack([p - _ARROW * length * force / np.linalg.norm(force), p])[:, view] / MM
    half_axes, axes = statistics.ellipsoid_95(estimate.cov_surface_base[np.ix_(view, view)])
    turn = np.linspace(0.0, 2.0 * math.pi, 49)
    ellipse = ends[1] + half_axes * np.stack([np.cos(turn), np.sin(turn)], axis=1) @ axes.T / MM
    chart = Chart.side_view(np.concatenate([line, ellipse, ends]), across)
    chart.line(line[:, 0], line[:, 1], COLOURS[1], name="probe")
    chart.line(ends[:, 0], ends[:, 1], COLOURS[3], width=2.4, name="force")
    chart.area(ellipse.tolist(), COLOURS[2], 0.3, "95 %")
    chart.points(p[2] / MM, p[across] / MM, COLOURS[2], "o", "touched point")
    return chart


@rows_of.register
def _(estimate: Estimate) -> Rows:
    columns = ["s_contact_mm", "std_s_mm", *(f"p_surface_base_{axis}_mm" for axis in "xyz"), *FORCE_COLUMNS, "rms_mm",
               "force_normal_N", "force_tangential_N", "chi2"]  # fmt: skip
    rows = [
        [c.s_contact / MM, c.std_s / MM, *(c.p_surface_base / MM).tolist(), *c.force_base.tolist(), c.rms / MM,
         c.force_normal, c.force_tangential, c.chi2] for c in estimate.candidates
    ]  # fmt: skip
    return columns, [dict(zip(columns, row, strict=True)) for row in rows]


@summary_of.register
def _(fused: FusedEstimate) -> Summary:
    rows = [("result", f"{fused.result}: {RESULTS[fused.result]}"), ("poses", f"{len(fused.s_contact)}")]
    if not fused.ok:
        return Summary(f"fused touches: {fused.result}", rows)
    rows += [
        ("touched point, world frame", _point(fused.p_surface_world)),
        ("RMS error of it", f"{fused.rms / MM:.3g} mm"),
        ("factor on E", f"{fused.stiffness:.3f} ± {fused.std_stiffness:.2g}"),
        ("χ²", f"{fused.chi2:.3g}, {fused.dof} degrees of freedom"),
    ]
    return Summary("fused touches of one point", rows)


@rows_of.register
def _(fused: FusedEstimate) -> Rows:
    columns = ["s_contact_mm", *FORCE_COLUMNS, "force_normal_N", "force_tangential_N", "friction_ratio"]
    values = np.column_stack(
        [fused.s_contact / MM, fused.force_base, fused.force_normal, fused.force_tangential, fused.friction_ratio]
    )
    return columns, [dict(zip(columns, row, strict=True)) for row in values.tolist()]


def _point(p: Array) -> str:
    return f"({', '.join(f'{value / MM:z.2f}' for value in p)}) mm"


# Identification


@summary_of.register
def _(fit: Identification) -> Summary:
    rows = [
        ("result", f"{fit.result}{': ' if fit.why else ''}{fit.why}"),
        ("data", f"{fit.tests} tests, {fit.numbers} values for {fit.unknowns} unknowns"),
        *((number.name, _interval(number)) for number in fit.found),
        *(("likely cause", str(cause)) for cause in fit.likely_causes),
    ]
    drawn = any(residual.kind in ("markers", "wrenches", "touches") for residual in fit.residuals)
    return Summary(f"identification of {fit.name}", rows, residual_chart(fit) if drawn else None)


def _interval(number: Identified) -> str:
    if number.low is None or number.high is None:
        return f"{number.design:.4g} {number.unit}".strip() + f" (design): {number.why}"
    unit = f" {number.unit}" if number.unit else ""
    return f"{number.value:.4g}{unit}, 95 % interval {number.low:.4g} ... {number.high:.4g}; design {number.design:.4g}"


@rows_of.register
def _(fit: Identification) -> Rows:
    rows = [asdict(number) for number in fit.found]
    return list(Identified.__dataclass_fields__), rows
