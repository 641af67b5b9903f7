"""Charts of a prediction: error budget, error map, bent shapes, workspace, forces, sensitivity."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from probedesign.core.frames import Array
from probedesign.core.units import MM
from probedesign.estimation.estimator import Estimator
from probedesign.prediction.fused import FusedCondition
from probedesign.prediction.predict import Condition, Prediction
from probedesign.prediction.touches import DIRECTIONS
from probedesign.prediction.workspace import STEPS, PressPath, Workspace
from probedesign.reports.chart import (
    COLOURS,
    DASHES,
    MARKS,
    NO_LINE,
    ORDERED,
    Chart,
    ChartAxis,
    LegendEntry,
    span_of,
)
from probedesign.rod.contact import solve_frictionless

GROUPS = {
    "noise": ("noise",),
    "drift": ("drift",),
    "robot": ("robot",),
    "friction": ("friction",),
    "stiffness": ("E", "G", "creep", "stiffness scatter"),
    "diameters": ("diameter", "diameter scatter", "length"),
    "mount": ("base place", "base tilt", "clocking", "root", "gain"),
    "weight": ("density", "gravity"),
}
"""Error sources with a common remedy."""
CAPTION = (
    "Shares of the variance, worst direction; above each bar the total RMS error [mm]. Friction: due to its prior. "
    "Stiffness: E, G, creep and scatter between touches. Diameters: including their scatter and the length. Mount: "
    "position, tilt, clocking and root of the base, gain of the sensor. Weight: density and direction of gravity."
)
_FILL = (*COLOURS, "#F0E442")
"""Including Okabe and Ito's eighth colour."""
_INK = ("#fff", "#fff", "#fff", "#fff", "#fff", "#111", "#111", "#111")
_MIN_LABELLED = 0.09  # smallest share with space for its number


def budget_chart(conditions: Sequence[Condition | FusedCondition]) -> Chart:
    """Return the error budget: the share of each group of sources in the variance, as stacked bars.

    Args:
        conditions: one per contact position, with budgets.
    """
    places = [f"{c.contact_fraction:g}" for c in conditions]
    y = ChartAxis("share of the variance [%]", 0.0, 106.0, ticks=(0.0, 20.0, 40.0, 60.0, 80.0, 100.0))
    chart = Chart(ChartAxis.named("contact, fraction of the length", places), y)
    for i, condition in enumerate(conditions, 1):
        chart.text(i, 103.0, f"{condition.predicted_error_mm:.2g}", size=12.5)
        bottom = 0.0
        for (_, share), colour, ink in zip(shares_of(condition).items(), _FILL, _INK, strict=True):
            chart.box((i - 0.42, i + 0.42), (bottom, bottom + 100.0 * share), colour)
            if share >= _MIN_LABELLED:
                chart.text(i, bottom + 50.0 * share, f"{100.0 * share:.0f}", ink)
            bottom += 100.0 * share
    used = [any(shares_of(c)[name] > 0.0 for c in conditions) for name in GROUPS]
    chart.legend = [
        LegendEntry(name, colour) for name, colour, here in zip(GROUPS, _FILL, used, strict=True) if here
    ]
    return chart


def shares_of(condition: Condition | FusedCondition) -> dict[str, float]:
    """Return the shares of the variance by group."""
    budget = condition.budget_mm or {}
    squares = {name: sum(budget.get(cause, 0.0) ** 2 for cause in causes) for name, causes in GROUPS.items()}
    whole = sum(squares.values()) or 1.0
    return {name: square / whole for name, square in squares.items()}


def worst(conditions: Sequence[Condition], force_N: float) -> list[Condition]:
    """Return the worst direction per contact position, at the grid's force nearest to `force_N`."""
    nearest = min((c.force_N for c in conditions), key=lambda force: abs(force - force_N), default=0.0)
    found: dict[float, Condition] = {}
    for c in conditions:
        if c.force_N == nearest and c.budget_mm is not None:
            before = found.get(c.contact_fraction, replace(c, predicted_error_mm=-1.0))
            if (c.predicted_error_mm or 0.0) > (before.predicted_error_mm or 0.0):
                found[c.contact_fraction] = c
    return [found[place] for place in sorted(found)]


Cell = Condition | FusedCondition
LEVELS_MM = (0.2, 0.5, 1.0, 2.0, 5.0, 10.0)
"""Errors at which the colour changes."""
RESULT_LABELS = {"too_light": "faint", "unobservable": "faint", "no_contact": "—", "out_of_range": "range"}
_LIGHT, _FROM_LIGHT = "#111", 4  # dark text on light cells


def error_map(cells: Sequence[Cell], error: Callable[[Cell], float | None]) -> Chart:
    """Return the error over contact position and force as a map: worst direction, or why there is no estimate.

    Args:
        cells: conditions of a whole grid.
        error: returns the mapped error of a condition [mm].
    """
    places = sorted({c.contact_fraction for c in cells})
    forces = sorted({c.force_N for c in cells})
    chart = Chart(
        ChartAxis.named("contact, fraction of the length", [f"{p:g}" for p in places]),
        ChartAxis.named("contact force [mN]", [f"{1e3 * f:g}" for f in forces]),
    )
    for i, place in enumerate(places, 1):
        for j, force in enumerate(forces, 1):
            here = [c for c in cells if (c.contact_fraction, c.force_N) == (place, force)]
            fill, ink, words = _cell(here, error)
            chart.box((i - 0.5, i + 0.5), (j - 0.5, j + 0.5), fill)
            chart.text(i, j, words, ink, 12.5 if len(words) < 5 else 10.5)
    return chart


def _cell(here: Sequence[Cell], error: Callable[[Cell], float | None]) -> tuple[str, str, str]:
    """Return colour, ink and text of a cell."""
    bad = next((c.result for c in here if c.result != "ok"), None)
    errors = [e for e in map(error, here) if e is not None]
    if bad or not errors:
        return "#e4e4e4", "#555", RESULT_LABELS.get(bad or "", "buckles")
    worst = max(errors)
    level = len(ORDERED) - 1 - sum(worst > limit for limit in LEVELS_MM)
    return (
        ORDERED[level],
        _LIGHT if level >= _FROM_LIGHT else "#fff",
        f"{worst:.2g}" if worst < 100 else f"{worst:.0f}",
    )


TOUCHES = ((0.4, 0.05), (0.6, 0.03), (0.8, 0.02))
"""Contact fraction and force [N] of the touches whose shapes are drawn."""
_Z = "z, along the undeformed axis [mm]"


def bending_chart(estimator: Estimator) -> Chart:
    """Return the free probe and its shapes under touches along ±x, seen along y; x points downwards as gravity does."""
    model = estimator.model
    s = np.linspace(0.0, model.rod.length, 60)
    lines: list[tuple[Array, str, str, str]] = []
    dots: list[tuple[Array, str]] = []
    for (fraction, force), colour, dashes in zip(TOUCHES, COLOURS[1:], DASHES, strict=False):
        for side in ("-x", "+x"):
            contact = solve_frictionless(
                model.rod, model.gravity_base, fraction * model.rod.length, DIRECTIONS[side], force
            )
            if contact.result == "ok":
                name = f"{1e3 * force:g} mN at {fraction:g}" if side == "-x" else ""
                lines.append((contact.equilibrium.p_at(s) / MM, colour, dashes, name))
                dots.append((contact.equilibrium.p_contact_base / MM, colour))
    free = estimator.free()
    if free.ok:
        lines.insert(0, (free.p_at(s) / MM, "#000000", "", "free"))
    chart = _chart(
        np.concatenate([points for points, *_ in lines]) if lines else np.zeros((1, 3)), 0, "x [mm]"
    )
    for points, colour, dashes, name in lines:
        chart.line(points[:, 2].tolist(), points[:, 0].tolist(), colour, dashes, name=name, width=2.4)
    for dot, colour in dots:
        chart.line([float(dot[2])], [float(dot[0])], colour, mark="o")
    return chart


def workspace_chart(workspace: Workspace, across: int) -> Chart:
    """Return the positions that the centreline's contact point reaches when pushed from two sides, seen from the third.

    Args:
        workspace: of a prediction.
        across: axis of the pushes: 0 for ±x, seen along y; 1 for ±y, seen along x.
    """
    name = "xy"[across]
    sides = {f"+{name}": COLOURS[1], f"-{name}": COLOURS[2]}
    sheets = {side: _sheet(workspace.paths, side) for side in sides}
    if not len(sheets.get("-y", "-")) and "-y" in (workspace.area_mm2 or {}):
        sheets["-y"] = sheets["+y"] * np.array([1.0, -1.0, 1.0])
    points = np.concatenate([sheet.reshape(-1, 3) for sheet in sheets.values()] + [np.zeros((1, 3))])
    chart = _chart(points, across, f"{name} [mm]")
    for side, colour in sides.items():
        sheet = sheets[side]
        if len(sheet):
            _draw_sheet(chart, sheet, across, colour, f"pushed along {side}")
    free = next((sheet[:, 0] for sheet in sheets.values() if len(sheet)), np.zeros((0, 3)))
    chart.line(
        [0.0, *free[:, 2].tolist()], [0.0, *free[:, across].tolist()], "#000000", name="free", width=2.6
    )
    return chart


def _draw_sheet(chart: Chart, sheet: Array, across: int, colour: str, name: str) -> None:
    """Draw the swept area with the path of each contact position."""
    flat = np.concatenate([np.zeros((1, STEPS, 3)), sheet])[:, :, [2, across]]
    for low, high in pairwise(flat):
        corners = [*map(tuple, low.tolist()), *map(tuple, high[::-1].tolist())]
        chart.area(corners, colour, 0.16)
    for path in flat[1:]:
        chart.line(path[:, 0].tolist(), path[:, 1].tolist(), colour, width=1.0)
    chart.line(flat[:, -1, 0].tolist(), flat[:, -1, 1].tolist(), colour, mark="o", width=2.0, name=name)


def _sheet(paths: Sequence[PressPath], side: str) -> Array:
    along = sorted((path for path in paths if path.direction == side), key=lambda path: path.contact_fraction)
    return np.array([path.points for path in along]).reshape(-1, STEPS, 3)


def _chart(points: Array, across: int, label: str) -> Chart:
    x, y = (
        ChartAxis(words, *span_of(points[:, i].tolist(), False)) for words, i in ((_Z, 2), (label, across))
    )
    return Chart(x, y, square=True, down=across == 0)


LIMITS = {"gives_way": ("buckling", "o"), "sensor": ("sensor's range", "s"), "slips_off": ("slips off", "v"),
          "none": ("no limit found", "d")}  # fmt: skip
PLACE = "contact, fraction of the length"
_TICKS = (0.0, 0.2, 0.4, 0.6, 0.8, 1.0)


def force_chart(prediction: Prediction) -> Chart:
    """Return the forces for detection, for given accuracies by one reading or by fused touches, and the limit."""
    k = prediction.pressing.touches
    lines: list[tuple[str, Sequence[Any], str, bool]] = [
        ("detected", prediction.detection, "detectable_force_mN", True),
        (f"2 mm, {k} fused", prediction.fused_reach, "force_mN_for_2_mm", True),
        ("5 mm, one", prediction.reach, "force_mN_for_5_mm", True),
        ("2 mm, one", prediction.reach, "force_mN_for_2_mm", True),
        ("1 mm, one", prediction.reach, "force_mN_for_1_mm", True),
        ("limit", prediction.reach, "greatest_force_N", False),
    ]
    found = {
        name: _worst(rows, key, largest, 1e3 if key.endswith("_N") else 1.0)
        for name, rows, key, largest in lines
    }
    values = [v for _, line in found.values() for v in line]
    chart = Chart(
        ChartAxis(PLACE, 0.0, 1.05, ticks=_TICKS),
        ChartAxis("contact force [mN]", *span_of(values, True), log=True),
    )
    for (name, (x, y)), colour, dashes, mark in zip(found.items(), COLOURS, DASHES, MARKS, strict=False):
        chart.line(x, y, colour, dashes, mark, name)
    return chart


def limit_chart(prediction: Prediction) -> Chart:
    """Return the maximum force by direction; its marker shows what limits it."""
    values = [1e3 * row.greatest_force_N for row in prediction.reach if row.greatest_force_N is not None]
    chart = Chart(
        ChartAxis(PLACE, 0.0, 1.05, ticks=_TICKS),
        ChartAxis("maximum force [mN]", *span_of(values, True), log=True),
    )
    sides = list(dict.fromkeys(row.direction for row in prediction.reach))
    for side, colour, dashes in zip(sides, COLOURS, DASHES, strict=False):
        rows = [row for row in prediction.reach if row.direction == side and row.greatest_force_N is not None]
        chart.line(
            [row.contact_fraction for row in rows], [1e3 * (row.greatest_force_N or math.nan) for row in rows],
            colour, dashes, name=f"along {side}",
        )  # fmt: skip
        for limit, (_, mark) in LIMITS.items():
            ends = [row for row in rows if row.limit == limit]
            for row in ends:
                chart.line(
                    [row.contact_fraction], [1e3 * (row.greatest_force_N or math.nan)], colour, mark=mark
                )
    seen = {row.limit for row in prediction.reach if row.greatest_force_N is not None}
    for limit, (name, mark) in LIMITS.items():
        if limit in seen:
            chart.legend.append(LegendEntry(name, "#666", NO_LINE, mark))
    return chart


def sensitivity_chart(prediction: Prediction) -> Chart:
    """Return base moment and force per millimetre of press, at the lightest force along the last direction."""
    lightest = min(c.force_N for c in prediction.conditions)
    side = prediction.conditions[-1].direction
    rows = [c for c in prediction.conditions if (c.force_N, c.direction) == (lightest, side)]
    moments = [c.moment_per_mm_Nmm or math.nan for c in rows]
    forces = [1e3 * c.force_per_mm_N if c.force_per_mm_N else math.nan for c in rows]
    chart = Chart(
        ChartAxis(PLACE, 0.0, 1.05, ticks=_TICKS),
        ChartAxis("per millimetre of press", *span_of([*moments, *forces], True), log=True),
    )
    places = [c.contact_fraction for c in rows]
    chart.line(places, moments, COLOURS[1], "", "o", "base moment [N·mm/mm]")
    chart.line(places, forces, COLOURS[2], "7 4", "s", "force [mN/mm]")
    return chart


def error_chart(prediction: Prediction) -> Chart:
    """Return the error of one reading along the probe by force: a line for the worst direction, a band for all."""
    located = [c for c in prediction.conditions if c.result == "ok" and c.predicted_error_mm is not None]
    forces = sorted({c.force_N for c in located})
    values = [c.predicted_error_mm or math.nan for c in located]
    chart = Chart(
        ChartAxis(PLACE, 0.0, 1.02, ticks=_TICKS),
        ChartAxis("predicted contact error, RMS [mm]", *span_of(values, True), log=True),
    )
    for i, force in enumerate(forces):
        errors: dict[float, list[float]] = {}
        for c in located:
            if c.force_N == force:
                errors.setdefault(c.contact_fraction, []).append(c.predicted_error_mm or math.nan)
        low, high = ([f(e) for e in errors.values()] for f in (min, max))
        colour = ORDERED[round((len(ORDERED) - 2) * i / max(len(forces) - 1, 1))]
        chart.area(
            [*zip(errors, low, strict=True), *reversed(list(zip(errors, high, strict=True)))], colour, 0.25
        )
        chart.line(list(errors), high, colour, mark="o", name=f"{1e3 * force:g} mN")
    return chart


def detection_chart(prediction: Prediction) -> Chart:
    """Return the smallest detectable force along the probe, one line per direction."""
    felt = [d for d in prediction.detection if d.detectable_force_mN is not None]
    values = [d.detectable_force_mN or math.nan for d in felt]
    chart = Chart(
        ChartAxis(PLACE, 0.0, 1.02, ticks=_TICKS),
        ChartAxis("smallest detectable force [mN]", *span_of(values, True), log=True),
    )
    directions = list(dict.fromkeys(d.direction for d in prediction.detection))
    for side, colour, dashes in zip(directions, COLOURS, DASHES, strict=False):
        rows = [d for d in felt if d.direction == side]
        chart.line(
            [d.contact_fraction for d in rows], [d.detectable_force_mN or math.nan for d in rows],
            colour, dashes, "o", f"pushed along {side}",
        )  # fmt: skip
    return chart


def _worst(rows: Sequence[Any], key: str, largest: bool, unit: float) -> tuple[list[float], list[float]]:
    """Return the maximum or minimum over the directions at each position; NaN where one direction has no value."""
    places = sorted({row.contact_fraction for row in rows})
    found = []
    for place in places:
        values = [getattr(row, key) for row in rows if row.contact_fraction == place]
        bad = None in values
        found.append(math.nan if bad else unit * (max if largest else min)(values))
    return places, found
