"""What the studio shows of a design: the numbers and charts of `predict`, and one bent touch.

`preview` takes some tens of milliseconds and follows the sliders: single touches at every second position. `complete`
adds the other positions, fused touches, the largest force, the workspace, the natural frequency and the print
check, and follows when the hand rests.
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
from probedesign.prediction.fused import SHOWN_N, worst
from probedesign.prediction.predict import (
    FORCES_N,
    FRACTIONS,
    HEADLINE_FORCE_N,
    HEADLINE_FRACTION,
    Condition,
    Prediction,
    predict,
)
from probedesign.probe import Probe, build_probe
from probedesign.reports.chart import COLOURS, DASHES, MARKS, Chart, ChartAxis, line_colours
from probedesign.reports.prediction_charts import LIMITS, budget_chart, direction_chart
from probedesign.rod.contact import RodContact, solve_frictionless
from probedesign.rod.equilibrium import Equilibrium
from probedesign.rod.rod import natural_frequency
from probedesign.studio.session import PinnedDesign, StudioTouch

_PLACE = ChartAxis("contact position, fraction of the length", 0.0, 1.02, ticks=(0.0, 0.2, 0.4, 0.6, 0.8, 1.0))
#: Style of the page; viser's own is narrower, smaller, and covers a phone's probe with its sheet.
HEAD = """<style>.st{font:16px/1.5 system-ui,sans-serif;font-variant-numeric:tabular-nums;padding:8px 16px}
.st table{border-collapse:collapse;width:100%}
.st td,.st th{text-align:left;padding:4px 8px 4px 0;vertical-align:top;overflow-wrap:anywhere}
.st svg{width:100%;height:auto;display:block;font-family:system-ui,sans-serif}
.st svg rect[fill=none]{stroke:#c4ccd4}
.st th{white-space:nowrap}.st tr>:first-child{width:52%}
.st .better{color:#1b7f4b}.st .worse{color:#b3261e}
.st .bad{background:#b3261e;color:#fff;border-radius:8px;padding:8px}
.st .note{color:light-dark(#4d5761,#a9b2bb);font-size:14px;margin:8px 0}
.st .status{height:136px;overflow:auto}.st .status .note{font-size:16px;margin:0}
.st small{display:block;color:light-dark(#4d5761,#a9b2bb);font-size:14px;line-height:1.3}
.st .button{display:block;margin:8px 0;padding:8px;border:1px solid #8a949e;border-radius:8px;text-align:center;
text-decoration:none;color:light-dark(#26547c,#8cc4f0)}
[data-mantine-color-scheme=dark] [role=tab][aria-selected=true]{color:#8cc4f0!important}
[data-mantine-color-scheme=dark] .st svg{filter:invert(1) hue-rotate(180deg)}
[data-mantine-color-scheme=dark] .st svg text[style]{fill:var(--dark)}
[data-mantine-color-scheme=dark] .st .better{color:#6fd39b}[data-mantine-color-scheme=dark] .st .worse{color:#ff9a92}
</style>"""
WAITING = "…"  #: Shown while a slider moves, for a value that is computed once it rests.
PREVIEWED = FRACTIONS[1::2]  #: Contact positions that follow a slider, the one of the summary among them.


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
        if self.note == WAITING:
            return WAITING
        number = "none" if self.value is None else f"{self.value:.3g} {self.unit}".strip()
        return f"{number} ({self.note})" if self.note else number

    @property
    def html(self) -> str:
        """Return the text as HTML, the note on a line of its own."""
        value, _, note = escape(self.text).removesuffix(")").partition(" (")
        return f"{value}<small>{note or '&nbsp;'}</small>" if self.note else value


@dataclass(frozen=True)
class DesignFigures:
    """What is known of a design."""

    probe: Probe  #: the probe.
    #: `predict` of it; without fused touches, force limits and workspace while `complete` is false.
    prediction: Prediction
    complete: bool  #: whether everything was predicted; `frequency` and `findings` are unknown before.
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
        reach = [r for r in p.reach if r.contact_fraction == HEADLINE_FRACTION]
        weakest = min(reach, key=lambda r: r.greatest_force_N or 0.0)
        force = None if weakest.greatest_force_N is None else 1e3 * weakest.greatest_force_N
        fused = p.fused_headline
        rows += [
            Figure(fused.label, fused.predicted_error_mm, "mm", "fused" if self.complete else WAITING),
            Figure(f"largest force at {HEADLINE_FRACTION:g} L", force, "mN",
                   LIMITS[weakest.limit] if self.complete else WAITING, False),
        ]  # fmt: skip
        rows += [
            Figure("tip sag", p.tip_sag_mm, "mm", "" if not self.buckles else "it buckles under its own weight"),
            Figure("mass", p.mass_g, "g", "flexible part", None),
            Figure(
                "first natural frequency",
                None if math.isnan(self.frequency) else self.frequency, "Hz",
                "undamped" if self.complete else WAITING, False,
            ),
        ]  # fmt: skip
        return rows


def _largest(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return max(known) if known and len(known) == len(values) else None


_COMPLETE: dict[Design, DesignFigures] = {}
_MAX_KEPT = 16


def preview(probe: Probe, forces_N: tuple[float, ...]) -> DesignFigures:
    """Return what follows a slider: single touches, sag and mass.

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
    model, frequency, findings = probe.model, math.nan, tuple[str, ...]()
    if not only_single:
        from probedesign.printing.check import check_print

        frequency, check = natural_frequency(probe.rod, model.gravity_base), check_print(probe.design)
        findings = tuple(f"{finding.severity}: {finding.message}" for finding in (*check.errors, *check.warnings))
    prediction = predict(model, fractions, forces_N, only_single=only_single, on_progress=on_progress)
    return DesignFigures(probe, prediction, not only_single, frequency, findings)


def errors_along(figures: DesignFigures, force_N: float) -> dict[float, float | None]:
    """Return the error [mm] of a touch of the nearest force by its fraction of the length; None where not located."""
    fractions = dict.fromkeys(c.contact_fraction for c in figures.prediction.conditions)
    rows = ((fraction, figures.at(fraction, force_N)) for fraction in fractions)
    return {fraction: None if row is None else row.predicted_error_mm for fraction, row in rows}


@dataclass(frozen=True)
class DrawnTouch:
    """One touch as the sensor reads it."""

    contact: RodContact  #: the equilibrium.
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
    return DrawnTouch(touched, s, touched.p_surface_base, normal)


def located(probe: Probe, drawn: DrawnTouch) -> Estimate:
    """Return the touch as it is located from its reading without noise, with its covariance."""
    return probe.estimator().estimate(drawn.contact.equilibrium.wrench_base)


N_CLOUD, N_TOGETHER = 200, 10  #: Estimates of `estimate_cloud`, and those between two reports of its progress.


def estimate_cloud(probe: Probe, drawn: DrawnTouch, touch: StudioTouch, on_progress: OnProgress) -> Array:
    """Return where the estimator locates the touch on `N_CLOUD` prints with other errors, (k, 3) [m].

    Each print, reading and friction is a draw of the priors, as in `predict --monte-carlo`; the difference from the
    point that was touched is drawn from the touched point of the nominal probe. Touches that are not located are left
    out.
    """
    from probedesign.prediction.monte_carlo import PrintSamples

    estimator, rng, points = probe.estimator(), np.random.default_rng(1), list[Array]()
    for k in range(N_CLOUD // N_TOGETHER):
        on_progress("estimates", k * N_TOGETHER / N_CLOUD)
        samples = PrintSamples.draw(probe.model, estimator.priors, N_TOGETHER, k)
        wrenches, touched = samples.simulate_touches(
            drawn.s / probe.length, math.radians(touch.angle_deg) + math.pi, (1e-3 * touch.force_mN,), rng
        )
        readings = (wrenches + samples.draw_noise(N_TOGETHER, 1, rng))[:, 0]
        for reading, p in zip(readings, touched[:, 0], strict=True):
            if np.isfinite(reading).all() and (estimate := estimator.estimate(reading)).ok:
                points.append(drawn.p_surface + estimate.p_surface_base - p)
    return np.array(points).reshape(-1, 3)


def _touched(probe: Probe, touch: StudioTouch) -> tuple[float, RodContact]:
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
        rows = worst(shown_figures.prediction.fused, SHOWN_N) if shown_figures.complete else ()
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


def summary_table(figures: DesignFigures, pinned: Sequence[tuple[PinnedDesign, DesignFigures]]) -> str:
    """Return the figures as an HTML table, with the pinned designs and the difference to each."""
    rows = figures.summary()
    others = [(pin.label, {row.name: row for row in other.summary()}) for pin, other in pinned]
    head = "".join(f"<th>{escape(label)}</th>" for label, _ in others)
    body = ""
    for row in rows:
        cells = "".join(_difference(row, by_name.get(row.name)) for _, by_name in others)
        body += f"<tr><td>{escape(row.name)}</td><td>{row.html}</td>{cells}</tr>"
    return f"<table><tr><th></th><th>this design</th>{head}</tr>{body}</table>"


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
    return f'<div class="st">{content}</div>'
