"""Charts of a prediction, for its page, the studio and notebooks."""

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from probedesign.core.frames import Array
from probedesign.core.units import MM
from probedesign.estimation.estimator import Estimator
from probedesign.prediction.fused import PredictedTouch, worst
from probedesign.prediction.predict import (
    CAUSE_GROUPS,
    DIRECTION_STEP_DEG,
    HEADLINE_FORCE_N,
    ErrorOverDirections,
    Prediction,
    shares_of,
)
from probedesign.prediction.touches import DIRECTIONS
from probedesign.reports.chart import COLOURS, DASHES, MARKS, ORDERED, Chart, ChartAxis, LegendEntry, line_colours
from probedesign.rod.contact import solve_frictionless

#: Including Okabe and Ito's eighth colour and a grey.
_FILL = (*COLOURS, "#F0E442", "#999999")
_MIN_LABELLED = 0.09  # smallest share with space for its number
LEVELS_MM = (0.2, 0.5, 1.0, 2.0, 5.0, 10.0)  #: Errors at which the colour of the map changes.
RESULT_LABELS = {
    "too_light": "faint", "unobservable": "faint", "interval_only": "interval", "no_contact": "—",
    "out_of_range": "range",
}  # fmt: skip
#: Contact fraction and force [N] of the touches whose shapes are drawn.
TOUCHES = ((0.4, 0.05), (0.6, 0.03), (0.8, 0.02))
#: Text of each limit of the force.
LIMITS = {"gives_way": "buckling", "sensor": "sensor's range", "slips_off": "slips off", "none": "no limit found"}
STATIONS = 81  #: Points of a centreline that is drawn.
_PLACE = "contact position, fraction of the length"


def _along(label: str, values: Sequence[float], high: float = 1.05) -> Chart:
    x = ChartAxis(_PLACE, 0.0, high, ticks=(0.0, 0.2, 0.4, 0.6, 0.8, 1.0))
    return Chart(x, ChartAxis.spanning(label, values, log=True))


def _number(value: float | None, unit: float = 1.0) -> float:
    return math.nan if value is None else unit * value


def error_chart(prediction: Prediction) -> Chart:
    """Return the error of one reading along the probe by force: a line for the worst direction, a band for all."""
    located = [c for c in prediction.conditions if c.result == "ok" and c.predicted_error_mm is not None]
    forces = sorted({c.force_N for c in located})
    chart = _along("predicted contact error, RMS [mm]", [_number(c.predicted_error_mm) for c in located], 1.02)
    for force, colour, mark in zip(forces, line_colours(len(forces)), itertools.cycle(MARKS), strict=False):
        errors: dict[float, list[float]] = {}
        for c in located:
            if c.force_N == force:
                errors.setdefault(c.contact_fraction, []).append(_number(c.predicted_error_mm))
        low, high = ([f(e) for e in errors.values()] for f in (min, max))
        there, back = zip(errors, low, strict=True), reversed([*zip(errors, high, strict=True)])
        chart.area([*there, *back], colour, 0.25)
        chart.line(list(errors), high, colour, mark=mark, name=f"{1e3 * force:g} mN")
    return chart


def force_chart(prediction: Prediction) -> Chart:
    """Return the forces for detection, for given accuracies by one reading, and the limit."""
    curves = dict[str, tuple[list[float], list[float]]]()
    lines: list[tuple[str, Sequence[Any], str]] = [
        ("detected", prediction.detection, "detectable_force_mN"),
        ("5 mm", prediction.reach, "force_mN_for_5_mm"),
        ("2 mm", prediction.reach, "force_mN_for_2_mm"),
        ("1 mm", prediction.reach, "force_mN_for_1_mm"),
        ("limit", prediction.reach, "greatest_force_N"),
    ]
    for name, rows, key in lines:
        # The worst direction: the largest force that is needed, the smallest that is possible.
        choose, unit = (max, 1.0) if "mN" in key else (min, 1e3)
        fractions = sorted({row.contact_fraction for row in rows})
        values = [[getattr(row, key) for row in rows if row.contact_fraction == fraction] for fraction in fractions]
        curves[name] = fractions, [math.nan if None in here else unit * choose(here) for here in values]
    chart = _along("contact force [mN]", [v for _, forces in curves.values() for v in forces])
    for (name, (x, y)), colour, dashes, mark in zip(curves.items(), COLOURS, DASHES, MARKS, strict=False):
        chart.line(x, y, colour, dashes, mark, name)
    return chart


def budget_chart(conditions: Sequence[PredictedTouch]) -> Chart:
    """Return the error budget: the share of each group of sources in the variance, as one bar per condition."""
    y = ChartAxis("share of the variance [%]", 0.0, 106.0, ticks=(0.0, 20.0, 40.0, 60.0, 80.0, 100.0))
    chart = Chart(ChartAxis.named(_PLACE, [f"{c.contact_fraction:g}" for c in conditions]), y)
    for i, condition in enumerate(conditions, 1):
        chart.text(i, 103.0, f"{condition.predicted_error_mm:.2g}", size=12.5)
        bottom = 0.0
        for share, colour in zip(shares_of(condition).values(), _FILL, strict=True):
            chart.box((i - 0.42, i + 0.42), (bottom, bottom + 100.0 * share), colour)
            if share >= _MIN_LABELLED:
                chart.text(i, bottom + 50.0 * share, f"{100.0 * share:.0f}", on=colour)
            bottom += 100.0 * share
    chart.legend = [
        LegendEntry(name, colour)
        for name, colour in zip(CAUSE_GROUPS, _FILL, strict=True)
        if any(shares_of(c)[name] > 0.0 for c in conditions)
    ]
    return chart


def error_map(cells: Sequence[PredictedTouch], error: Callable[[PredictedTouch], float | None]) -> Chart:
    """Return the error over contact position and force as a map: worst direction, or why there is no estimate.

    Args:
        cells: conditions of a whole grid.
        error: returns the mapped error of a condition [mm].
    """
    fractions = sorted({c.contact_fraction for c in cells})
    forces = sorted({c.force_N for c in cells})
    chart = Chart(
        ChartAxis.named(_PLACE, [f"{p:g}" for p in fractions]),
        ChartAxis.named("contact force [mN]", [f"{1e3 * f:g}" for f in forces]),
    )
    for i, fraction in enumerate(fractions, 1):
        for j, force in enumerate(forces, 1):
            here = [c for c in cells if (c.contact_fraction, c.force_N) == (fraction, force)]
            fill, words = _cell(here, error)
            chart.cell(i, j, words, fill, 12.5 if len(words) < 5 else 9.0)
    return chart


def _cell(here: Sequence[PredictedTouch], error: Callable[[PredictedTouch], float | None]) -> tuple[str, str]:
    bad = next((c.result for c in here if c.result != "ok"), None)
    errors = [e for e in map(error, here) if e is not None]
    if bad or not errors:
        return "#e4e4e4", RESULT_LABELS.get(bad or "", "buckles")
    largest = max(errors)
    fill = ORDERED[error_level(largest)]
    return fill, f"{largest:.2g}" if largest < 100 else f"{largest:.0f}"


def direction_chart(curves: Mapping[str, Sequence[float | None]]) -> Chart:
    """Return the error over the direction of the force as a polar chart: the distance from the centre is the error.

    Args:
        curves: errors [mm] by name, of directions at even steps from the section's X axis towards Y; a line is broken
            where there is no error.
    """
    errors = {name: np.array([*curve, curve[0]], dtype=float) for name, curve in curves.items()}
    size = max((float(np.nanmax(curve)) for curve in errors.values() if np.isfinite(curve).any()), default=1.0)
    ends = -1.08 * size, 1.08 * size
    x, y = (ChartAxis(f"error of forces along {side} [mm]", *ends) for side in "XY")
    chart = Chart(x, y, square=True)
    turn = np.linspace(0.0, 2.0 * np.pi, 73)
    for radius in chart.y.shown_ticks:
        if 0.0 < radius <= ends[1]:
            chart.line(radius * np.cos(turn), radius * np.sin(turn), "#bbb", width=1.0)
    for (name, error), colour, dashes in zip(errors.items(), COLOURS[1:], DASHES, strict=False):
        angle = np.linspace(0.0, 2.0 * np.pi, len(error))
        chart.line(error * np.cos(angle), error * np.sin(angle), colour, dashes, name=name)
    return chart


def error_band_chart(probes: Mapping[str, Sequence[ErrorOverDirections]]) -> Chart:
    """Return the median error over the directions along each probe, by name, and a band from the best to the worst."""
    bands = {name: ([row.contact_fraction for row in over], np.array([row.errors_mm for row in over], dtype=float))
             for name, over in probes.items()}  # fmt: skip
    chart = _along("contact error, RMS [mm]", [error for _, of in bands.values() for error in of.ravel()], 1.02)
    for (name, (x, errors)), colour, dashes, mark in zip(bands.items(), COLOURS[1:], DASHES, MARKS, strict=False):
        low, high = errors.min(axis=1).tolist(), errors.max(axis=1).tolist()
        chart.area([*zip(x, high, strict=True), *zip(x[::-1], low[::-1], strict=True)], colour, 0.2)
        chart.line(x, np.median(errors, axis=1), colour, dashes, mark, name)
    return chart


def surface_map(over: Sequence[ErrorOverDirections]) -> Chart:
    """Return the error of one reading on the probe's surface: over place and direction, of rows of one force."""
    degrees = range(0, 360, 2 * DIRECTION_STEP_DEG)
    chart = Chart(ChartAxis.named(_PLACE, [f"{row.contact_fraction:g}" for row in over]),
                  ChartAxis.named("direction of the force", [f"{k}°" for k in degrees]))  # fmt: skip
    for i, row in enumerate(over, 1):
        for j, error in enumerate(row.errors_mm[::2], 1):
            if error is None:
                chart.cell(i, j, "buckles", "#e4e4e4", 9.0)
            else:
                chart.cell(i, j, f"{error:.2g}", ORDERED[error_level(error)], 11.0)
    return chart


def probe_chart(prediction: Prediction, estimator: Estimator) -> Chart:
    """Return the free probe to scale, from its side; its colour is the error of one reading of the headline's force."""
    model, free = estimator.model, estimator.free()
    s = np.linspace(0.0, model.rod.length, STATIONS)
    shape = (free if free.ok else model.rod.solve()).p_at(s)  # buckled under its weight: undeformed
    chart, upper, lower = body_chart(shape, model.rod.radius_at(s))
    located = {c.contact_fraction: c.predicted_error_mm for c in worst(prediction.conditions, HEADLINE_FORCE_N)}
    places = np.array(sorted({c.contact_fraction for c in prediction.conditions}))
    fractions = s / model.rod.length
    nearest = places[np.argmin(np.abs(places[:, None] - (fractions[1:] + fractions[:-1]) / 2.0), axis=0)]
    errors = [located.get(float(fraction)) for fraction in nearest]
    levels = [None if error is None else error_level(error) for error in errors]
    ends = [0, *(i for i in range(1, len(levels)) if levels[i] != levels[i - 1]), len(levels)]
    for i, j in pairwise(ends):
        corners = np.concatenate([upper[i : j + 1], lower[i : j + 1][::-1]]).tolist()
        level = levels[i]
        chart.area(corners, "#999" if level is None else ORDERED[level], 1.0)
    shown = {level for level in levels if level is not None}
    outline = np.concatenate([upper, lower[::-1], upper[:1]])
    chart.line(outline[:, 0], outline[:, 1], COLOURS[0], width=1.0)
    labels = [*(f"up to {limit:g} mm" for limit in LEVELS_MM), f"over {LEVELS_MM[-1]:g} mm"][::-1]
    chart.legend += [LegendEntry(labels[level], ORDERED[level]) for level in sorted(shown, reverse=True)]
    return chart


def lateral_axis(shape: Array) -> int:
    """Return the axis, 0 for x or 1 for y, along which a centreline (n, 3) is bent more: it is drawn beside z."""
    return int(np.ptp(shape[:, 1]) > np.ptp(shape[:, 0]))


def body_chart(shape: Array, radius: Array) -> tuple[Chart, Array, Array]:
    """Return an empty chart of a probe seen from its side, and `flanks` there."""
    across = lateral_axis(shape)
    upper, lower = flanks(shape, radius, across)
    return Chart.side_view(np.concatenate([upper, lower]), across), upper, lower


def flanks(shape: Array, radius: Array, across: int) -> tuple[Array, Array]:
    """Return both sides of a probe as points of z and of the axis `across` [mm], (n, 2) each.

    Args:
        shape: centreline [m], (n, 3).
        radius: half-width at its points [m], (n,).
        across: 0 for x, 1 for y.
    """
    centre = shape[:, [2, across]] / MM
    along = np.gradient(centre, axis=0)
    normal = np.column_stack([-along[:, 1], along[:, 0]]) / np.linalg.norm(along, axis=1, keepdims=True)
    reach = radius[:, None] / MM * normal
    return centre + reach, centre - reach


def error_level(error_mm: float) -> int:
    """Return the index of an error's colour, the largest for the smallest error."""
    return len(ORDERED) - 1 - sum(error_mm > limit for limit in LEVELS_MM)


def bending_chart(estimator: Estimator) -> Chart:
    """Return the free probe and its shapes under touches along the lateral axis of the drawing."""
    model, free = estimator.model, estimator.free()
    s = np.linspace(0.0, model.rod.length, 60)
    across = lateral_axis(free.p_at(s)) if free.ok else 0
    lines: list[tuple[Array, str, str, str]] = [(free.p_at(s), "#000000", "", "free")] if free.ok else []
    dots: list[tuple[Array, str]] = []
    for (fraction, force), colour, dashes in zip(TOUCHES, COLOURS[1:], DASHES, strict=False):
        for side in ("-x", "+x") if across == 0 else ("-y", "+y"):
            contact = solve_frictionless(
                model.rod, model.gravity_base, fraction * model.rod.length, DIRECTIONS[side], force
            )
            if contact.result == "ok":
                name = f"{1e3 * force:g} mN at {fraction:g}" if side[0] == "-" else ""
                lines.append((contact.equilibrium.p_at(s), colour, dashes, name))
                dots.append((contact.equilibrium.p_contact_base, colour))
    shapes = np.concatenate([points for points, *_ in lines]) if lines else np.zeros((1, 3))
    chart = Chart.side_view(shapes[:, [2, across]] / MM, across)
    for points, colour, dashes, name in lines:
        chart.line(points[:, 2] / MM, points[:, across] / MM, colour, dashes, name=name, width=2.4)
    for dot, colour in dots:
        chart.points(dot[2] / MM, dot[across] / MM, colour, "o")
    return chart
