"""What the studio shows of a design: the numbers and charts of `predict`, and one bent touch.

`preview` takes some tens of milliseconds and follows the sliders: single touches at every second position. `complete`
adds the other positions, fused touches, the largest force and the workspace, and follows when the hand rests.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

import numpy as np

from probedesign.core.frames import Array
from probedesign.core.parallel import OnProgress, quiet
from probedesign.design import Design
from probedesign.estimation.estimate import Estimate
from probedesign.prediction.fused import SHOWN_N, shown
from probedesign.prediction.predict import (
    FORCES_N,
    FRACTIONS,
    HEADLINE_FORCE_N,
    HEADLINE_FRACTION,
    Condition,
    Prediction,
    predict,
    worst,
)
from probedesign.printing.check import check_print
from probedesign.probe import Probe, build_probe
from probedesign.reports.chart import COLOURS, DASHES, MARKS, ORDERED, Chart, ChartAxis, line_colours
from probedesign.reports.prediction_charts import LEVELS_MM, LIMITS, budget_chart, direction_chart, error_level
from probedesign.rod.contact import FrictionlessContact, solve_frictionless, surface_point
from probedesign.rod.equilibrium import Equilibrium
from probedesign.rod.vibration import natural_frequency
from probedesign.studio.session import PinnedDesign, StudioTouch

_PLACE = ChartAxis("contact position, fraction of the length", 0.0, 1.02, ticks=(0.0, 0.2, 0.4, 0.6, 0.8, 1.0))
#: Style of the texts, tables and charts of the page.
STYLE = """<style>.st table{border-collapse:collapse;font-size:12.5px;width:100%}
.st .chips{display:flex;flex-wrap:wrap;gap:2px 10px;margin:4px 0;font-size:12px}
.st .chips i{display:inline-block;width:12px;height:12px;margin-right:4px;vertical-align:-1px}
[data-mantine-color-scheme=dark] [role=tab][aria-selected=true]{color:#8cc4f0!important}
[data-mantine-color-scheme=dark] .st svg{filter:invert(1) hue-rotate(180deg)}
[data-mantine-color-scheme=dark] .st svg text[style]{fill:var(--dark)}
[data-mantine-color-scheme=dark] .st .better{color:#6fd39b}[data-mantine-color-scheme=dark] .st .worse{color:#ff9a92}
.st td,.st th{text-align:left;padding:2px 8px 2px 0;vertical-align:top;font-variant-numeric:tabular-nums}
.st .better{color:#1b7f4b}.st .worse{color:#b3261e}.st svg{width:100%;height:auto;display:block;background:#fff}
.st .bad{background:#b3261e;color:#fff;border-radius:6px;padding:6px 10px}
.st .note{color:light-dark(#5b6570,#a9b2bb);font-size:12px}</style>"""
PREVIEWED = FRACTIONS[1::2]  #: Contact positions that follow a slider, the one of the summary among them.
NOT_LOCATED = (150, 150, 150)  #: Colour of a part of the probe that is not located.


@dataclass(frozen=True)
class Figure:
    """One line of the summary."""

    name: str  #: of the quantity.
    value: float | None  #: its number; None where there is none.
    unit: str  #: of the number.
    note: str = ""  #: beside the value, such as what limits it.
    smaller_is_better: bool | None = True  #: None where no value is better.

    @property
    def text(self) -> str:
        """Return the value with its unit."""
        number = "none" if self.value is None else f"{self.value:.3g} {self.unit}".strip()
        return f"{number} ({self.note})" if self.note else number


@dataclass(frozen=True)
class DesignFigures:
    """What is known of a design."""

    probe: Probe  #: the probe.
    #: `predict` of it; without fused touches, force limits and workspace while `complete` is false.
    prediction: Prediction
    complete: bool  #: whether everything was predicted.
    frequency: float  #: first natural frequency [Hz]; NaN where the weight buckles the probe.
    findings: tuple[str, ...]  #: messages of the print check, errors first.

    @property
    def buckles(self) -> bool:
        """Whether the probe buckles under its own weight."""
        return self.prediction.tip_sag_mm is None

    def at(self, fraction: float, force_N: float) -> Condition | None:
        """Return the worst direction at a position and the nearest force; None where a touch of any is not located."""
        here = [c for c in self.prediction.conditions if c.contact_fraction == fraction]
        conditions = worst(here, force_N)
        lost = any(c.result != "ok" for c in here if conditions and c.force_N == conditions[0].force_N)
        return None if lost or not conditions else conditions[0]

    def summary(self) -> list[Figure]:
        """Return the figures of the summary, each the number that `predict` reports."""
        p = self.prediction
        touch = self.at(HEADLINE_FRACTION, HEADLINE_FORCE_N)
        where = f"{1e3 * HEADLINE_FORCE_N:g} mN at {HEADLINE_FRACTION:g} L"
        felt = [d.detectable_force_mN for d in p.detection if d.contact_fraction == HEADLINE_FRACTION]
        rows = [
            Figure(f"error, {where}", touch.predicted_error_mm if touch else None, "mm", "all error sources"),
            Figure("of it noise and friction", touch.noise_error_mm if touch else None, "mm", "of an exact probe"),
            Figure(f"detected at {HEADLINE_FRACTION:g} L", _largest(felt), "mN", "with probability 0.5"),
        ]
        if self.complete:
            reach = [r for r in p.reach if r.contact_fraction == HEADLINE_FRACTION]
            weakest = min(reach, key=lambda r: r.greatest_force_N or 0.0)
            force = None if weakest.greatest_force_N is None else 1e3 * weakest.greatest_force_N
            fused = p.fused_headline
            rows += [
                Figure(fused.label, fused.predicted_error_mm, "mm", "fused"),
                Figure(f"largest force at {HEADLINE_FRACTION:g} L", force, "mN", LIMITS[weakest.limit][0], False),
            ]
        rows += [
            Figure("tip sag", p.tip_sag_mm, "mm", "" if not self.buckles else "it buckles under its own weight"),
            Figure("mass", p.mass_g, "g", "flexible part", None),
            Figure(
                "first natural frequency",
                None if math.isnan(self.frequency) else self.frequency, "Hz", "undamped", False,
            ),
        ]  # fmt: skip
        return rows


def _largest(values: Sequence[float | None]) -> float | None:
    """Return the largest value, None if one is missing."""
    known = [value for value in values if value is not None]
    return max(known) if known and len(known) == len(values) else None


_COMPLETE: dict[Design, DesignFigures] = {}
_MAX_KEPT = 16


def preview(probe: Probe, forces_N: tuple[float, ...]) -> DesignFigures:
    """Return what follows a slider: single touches, sag, mass, frequency, print check.

    Args:
        probe: of a valid design.
        forces_N: forces whose errors are drawn; those of the summary are added.
    """
    forces = tuple(sorted({*forces_N, HEADLINE_FORCE_N}))
    return _figures(probe, PREVIEWED, forces, True)


def complete(design: Design, on_progress: OnProgress = quiet) -> DesignFigures:
    """Return all figures of `probedesign predict`; those of the last designs are kept.

    Args:
        design: a valid design.
        on_progress: as in `predict`; an exception that it raises ends the prediction.
    """
    if design not in _COMPLETE:
        figures = _figures(build_probe(design), FRACTIONS, FORCES_N, False, on_progress)
        while len(_COMPLETE) >= _MAX_KEPT:
            _COMPLETE.pop(next(iter(_COMPLETE)))
        _COMPLETE[design] = figures
    return _COMPLETE[design]


def _figures(
    probe: Probe,
    fractions: tuple[float, ...],
    forces_N: tuple[float, ...],
    only_single: bool,
    on_progress: OnProgress = quiet,
) -> DesignFigures:
    model = probe.model
    check = check_print(probe.design)
    return DesignFigures(
        probe,
        predict(model, fractions, forces_N, only_single=only_single, on_progress=on_progress),
        not only_single,
        natural_frequency(probe.rod, model.gravity_base),
        tuple(f"{finding.severity}: {finding.message}" for finding in (*check.errors, *check.warnings)),
    )


def segment_colours(figures: DesignFigures, edges: Array, force_N: float) -> list[tuple[int, int, int]]:
    """Return the colour of each segment of the probe: the error of a touch there, by the levels of the page.

    Args:
        figures: of the design.
        edges: fractions of the length between which the segments are, (n + 1,).
        force_N: of the touch.
    """
    located = {c.contact_fraction: c.predicted_error_mm for c in worst(figures.prediction.conditions, force_N)}
    places = np.array(sorted({c.contact_fraction for c in figures.prediction.conditions}))
    colours = []
    for middle in (edges[1:] + edges[:-1]) / 2.0:
        error = located.get(float(places[np.argmin(np.abs(places - middle))]))
        colour = NOT_LOCATED
        if error is not None:
            red, green, blue = bytes.fromhex(ORDERED[error_level(error)][1:])
            colour = red, green, blue
        colours.append(colour)
    return colours


def colour_legend(force_mN: float) -> str:
    """Return the legend of `segment_colours` as HTML: the error of a touch of a force [mN] at that place."""
    bounds = [f"≤ {level:g}" for level in LEVELS_MM] + [f"> {LEVELS_MM[-1]:g} mm"]
    chips = [(ORDERED[error_level(level)], text) for level, text in zip((*LEVELS_MM, 1e9), bounds, strict=True)]
    chips.append((f"rgb{NOT_LOCATED}", "not located"))
    items = "".join(f'<span><i style="background:{colour}"></i>{text}</span>' for colour, text in chips)
    return f"<div class=note>Colour of the probe: error of {force_mN:g} mN there</div><div class=chips>{items}</div>"


@dataclass(frozen=True)
class DrawnTouch:
    """One touch as the sensor reads it."""

    contact: FrictionlessContact  #: the equilibrium.
    s: float  #: arclength of the touched section [m].
    p_surface: Array  #: touched point [m], (3,).
    normal: Array  #: direction of the push at it, (3,).


def drawn_touch(probe: Probe, touch: StudioTouch) -> DrawnTouch | None:
    """Return the touch; None where the probe buckles under it or under its own weight."""
    model = probe.model
    if not model.rod.solve(model.gravity_base).ok:
        return None
    s, touched = _touched(probe, touch)
    if touched.result != "ok":
        return None
    normal = touched.force_base / np.linalg.norm(touched.force_base)
    return DrawnTouch(touched, s, surface_point(model.rod, touched.equilibrium), normal)


def located(probe: Probe, drawn: DrawnTouch) -> Estimate:
    """Return the touch as it is located from its reading without noise, with its covariance."""
    return probe.estimator().estimate(drawn.contact.equilibrium.wrench_base)


def _touched(probe: Probe, touch: StudioTouch) -> tuple[float, FrictionlessContact]:
    """Return the arclength of the touched section [m], and the equilibrium."""
    model, force = probe.model, 1e-3 * touch.force_mN
    s = min(touch.fraction * probe.length, model.rod.flank_end)
    return s, solve_frictionless(model.rod, model.gravity_base, s, math.radians(touch.angle_deg), force)


def touched_shape(probe: Probe, touch: StudioTouch) -> Equilibrium:
    """Return the shape of a probe under the touch; without it where it buckles under the touch."""
    contact = _touched(probe, touch)[1]
    return contact.equilibrium if contact.result == "ok" else probe.rod.solve(probe.model.gravity_base)


# Charts and tables


def error_chart(
    figures: DesignFigures, pinned: Sequence[tuple[PinnedDesign, DesignFigures]], forces_N: Sequence[float]
) -> Chart:
    """Return the error along the probe at some forces: all error sources, the sensor alone dotted, pinned designs
    dashed."""
    by_force = _curves(figures.prediction.conditions, forces_N)
    lines = [curve for curves in by_force.values() for curve in curves]
    others = [(pin, _curves(other.prediction.conditions, forces_N)) for pin, other in pinned]
    lines += [curves[0] for _, curves_of in others for curves in curves_of.values()]
    values = [value for _, errors in lines for value in errors]
    chart = Chart(_PLACE, ChartAxis.spanning("contact error, RMS [mm]", values, log=True))
    drawn = zip(by_force.items(), line_colours(len(by_force)), itertools.cycle(MARKS), strict=False)
    for (force, ((x, total), (_, noise))), colour, mark in drawn:
        chart.line(x, noise, colour, "1 4", width=1.4)
        chart.line(x, total, colour, "", mark, f"{1e3 * force:g} mN")
        for (_, curves_of), dashes in zip(others, DASHES[1:], strict=False):
            if force in curves_of:
                chart.line(*curves_of[force][0], colour, dashes, width=1.6)
    return chart


_Curve = tuple[list[float], list[float]]


def _curves(conditions: Sequence[Condition], forces_N: Sequence[float]) -> dict[float, tuple[_Curve, _Curve]]:
    """Return position and error of all sources, and of the sensor alone, by force; the worst direction.

    A curve ends where a touch of any direction is not located.
    """
    curves = {}
    for force in forces_N:
        here = [c for c in conditions if math.isclose(c.force_N, force)]
        lost = {c.contact_fraction for c in here if c.result != "ok"}
        rows = [c for c in worst(here, force) if c.contact_fraction not in lost]
        x = [c.contact_fraction for c in rows]
        total = [math.nan if c.predicted_error_mm is None else c.predicted_error_mm for c in rows]
        noise = [math.nan if c.noise_error_mm is None else c.noise_error_mm for c in rows]
        if x:
            curves[force] = (x, total), (x, noise)
    return curves


def fused_chart(figures: DesignFigures, pinned: Sequence[tuple[PinnedDesign, DesignFigures]]) -> Chart | None:
    """Return the error of fused touches along the probe; None until it was predicted."""
    lines = []
    designs = [("this design", figures), *((pin.label, other) for pin, other in pinned)]
    for (label, shown_figures), colour, dashes in zip(designs, COLOURS, DASHES, strict=False):
        rows = shown(shown_figures.prediction.fused, SHOWN_N) if shown_figures.complete else ()
        if rows:
            errors = [math.nan if c.predicted_error_mm is None else c.predicted_error_mm for c in rows]
            lines.append((label, [c.contact_fraction for c in rows], errors, colour, dashes))
    if not lines:
        return None
    values = [v for _, _, errors, _, _ in lines for v in errors]
    chart = Chart(_PLACE, ChartAxis.spanning("error of fused touches, RMS [mm]", values, log=True))
    for label, x, errors, colour, dashes in lines:
        chart.line(x, errors, colour, dashes, "o", label)
    return chart


def direction_figure(
    figures: DesignFigures, pinned: Sequence[tuple[PinnedDesign, DesignFigures]], forces_N: Sequence[float]
) -> Chart | None:
    """Return the error over the direction of some light forces, pinned designs at the summary's force; None for a
    straight probe."""
    by_force = {row.force_N: row.errors_mm for row in figures.prediction.over_directions
                if row.contact_fraction == HEADLINE_FRACTION and row.force_N in forces_N
                and SHOWN_N <= row.force_N <= 2.0 * HEADLINE_FORCE_N}  # fmt: skip
    curves = {f"{1e3 * force:g} mN": errors for force, errors in by_force.items()}
    for pin, other in pinned if curves else ():
        for row in other.prediction.over_directions:
            if (row.contact_fraction, row.force_N) == (HEADLINE_FRACTION, HEADLINE_FORCE_N):
                curves[f"{pin.label}, {1e3 * row.force_N:g} mN"] = row.errors_mm
    return direction_chart(curves) if curves else None


def budget_figure(figures: DesignFigures) -> Chart | None:
    """Return the error budget along the probe; None where nothing is located."""
    rows = worst(figures.prediction.conditions, HEADLINE_FORCE_N)
    return budget_chart(rows) if rows else None


def summary_table(
    figures: DesignFigures, pinned: Sequence[tuple[PinnedDesign, DesignFigures]], label: str = "this design"
) -> str:
    """Return the figures as an HTML table, with the pinned designs and the difference to each."""
    rows = figures.summary()
    others = [(pin.label, {row.name: row for row in other.summary()}) for pin, other in pinned]
    head = "".join(f"<th>{escape(label)}</th>" for label, _ in others)
    body = ""
    for row in rows:
        cells = "".join(_difference(row, by_name.get(row.name)) for _, by_name in others)
        body += f"<tr><td>{escape(row.name)}</td><td>{escape(row.text)}</td>{cells}</tr>"
    return f"<table><tr><th></th><th>{escape(label)}</th>{head}</tr>{body}</table>"


def _difference(now: Figure, then: Figure | None) -> str:
    if then is None or then.value is None or now.value is None:
        return f"<td>{escape(then.text) if then else '-'}</td>"
    change = now.value - then.value
    relative = f"{change / then.value:+.0%}" if then.value else f"{change:+.3g}"
    better = now.smaller_is_better is not None and change != 0.0 and (change < 0.0) is now.smaller_is_better
    worse = now.smaller_is_better is not None and change != 0.0 and not better
    level = "better" if better else "worse" if worse else "same"
    return f'<td>{then.value:.3g} <span class="{level}">{relative}</span></td>'


def styled(content: str) -> str:
    """Return HTML in the style of the page."""
    return f'<div class="st" style="padding:4px 12px">{STYLE}{content}</div>'
