"""What an error is made of, place by place: each cause's share of the variance as a stacked bar."""

from collections.abc import Sequence
from dataclasses import replace

from probedesign.pages.chart import COLOURS, Axis, Chart, Entry
from probedesign.prediction.fused import FusedCondition
from probedesign.prediction.predict import Condition

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
"""Causes that a reader has one remedy for."""
CAPTION = (
    "Shares of the variance, worst of the directions; above each bar the RMS error of all causes [mm]. Friction: what "
    "its prior adds. Stiffness: E, G, creep and scatter from touch to touch. Diameters: with their scatter and the "
    "length. Mount: place, tilt, clocking and root of the base, gain of the sensor. Weight: density and gravity's "
    "direction."
)
_FILL = (*COLOURS, "#F0E442")
"""Okabe and Ito's eighth colour too."""
_INK = ("#fff", "#fff", "#fff", "#fff", "#fff", "#111", "#111", "#111")
_LEAST = 0.09  # share that has room for its number


def draw_budget(conditions: Sequence[Condition | FusedCondition]) -> bytes:
    """The bars, an SVG.

    Args:
        conditions: one a place, with budgets.
    """
    places = [f"{c.contact_fraction:g}" for c in conditions]
    y = Axis("share of the variance [%]", 0.0, 106.0, ticks=(0.0, 20.0, 40.0, 60.0, 80.0, 100.0))
    chart = Chart(Axis.named("contact, fraction of the length", places), y)
    for i, condition in enumerate(conditions, 1):
        chart.text(i, 103.0, f"{condition.predicted_error_mm:.2g}", size=12.5)
        below = 0.0
        for (_, share), colour, ink in zip(shares_of(condition).items(), _FILL, _INK, strict=True):
            chart.box((i - 0.42, i + 0.42), (below, below + 100.0 * share), colour)
            if share >= _LEAST:
                chart.text(i, below + 50.0 * share, f"{100.0 * share:.0f}", ink)
            below += 100.0 * share
    used = [any(shares_of(c)[name] > 0.0 for c in conditions) for name in GROUPS]
    chart.legend = [
        Entry(name, colour) for name, colour, here in zip(GROUPS, _FILL, used, strict=True) if here
    ]
    return chart.svg()


def shares_of(condition: Condition | FusedCondition) -> dict[str, float]:
    """Of the variance, by group."""
    budget = condition.budget_mm or {}
    squares = {name: sum(budget.get(cause, 0.0) ** 2 for cause in causes) for name, causes in GROUPS.items()}
    whole = sum(squares.values()) or 1.0
    return {name: square / whole for name, square in squares.items()}


def worst(conditions: Sequence[Condition], force_N: float) -> list[Condition]:
    """One a place, at the force of the grid nearest to that."""
    nearest = min((c.force_N for c in conditions), key=lambda force: abs(force - force_N), default=0.0)
    found: dict[float, Condition] = {}
    for c in conditions:
        if c.force_N == nearest and c.budget_mm is not None:
            before = found.get(c.contact_fraction, replace(c, predicted_error_mm=-1.0))
            if (c.predicted_error_mm or 0.0) > (before.predicted_error_mm or 0.0):
                found[c.contact_fraction] = c
    return [found[place] for place in sorted(found)]
