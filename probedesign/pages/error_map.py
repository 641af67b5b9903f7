"""The error over place and force as a map: a cell a condition, its number in it."""

from collections.abc import Callable, Sequence

from probedesign.pages.chart import ORDERED, Axis, Chart
from probedesign.prediction.fused import FusedCondition
from probedesign.prediction.predict import Condition

Cell = Condition | FusedCondition
LEVELS_MM = (0.2, 0.5, 1.0, 2.0, 5.0, 10.0)
"""Where the colour changes."""
MARKS = {"too_light": "faint", "unobservable": "faint", "no_contact": "—", "out_of_range": "range"}
_LIGHT, _FROM_LIGHT = "#111", 4  # dark letters on light cells


def draw_error_map(cells: Sequence[Cell], error: Callable[[Cell], float | None]) -> bytes:
    """The map, an SVG: worst of the directions; where one is not located, why.

    Args:
        cells: of a whole grid.
        error: which of a condition's errors is meant [mm].
    """
    places = sorted({c.contact_fraction for c in cells})
    forces = sorted({c.force_N for c in cells})
    chart = Chart(
        Axis.named("contact, fraction of the length", [f"{p:g}" for p in places]),
        Axis.named("contact force [mN]", [f"{1e3 * f:g}" for f in forces]),
    )
    for i, place in enumerate(places, 1):
        for j, force in enumerate(forces, 1):
            here = [c for c in cells if (c.contact_fraction, c.force_N) == (place, force)]
            fill, ink, words = _cell(here, error)
            chart.box((i - 0.5, i + 0.5), (j - 0.5, j + 0.5), fill)
            chart.text(i, j, words, ink, 12.5 if len(words) < 5 else 10.5)
    return chart.svg()


def _cell(here: Sequence[Cell], error: Callable[[Cell], float | None]) -> tuple[str, str, str]:
    """Colour, ink and words."""
    bad = next((c.result for c in here if c.result != "ok"), None)
    errors = [e for e in map(error, here) if e is not None]
    if bad or not errors:
        return "#e4e4e4", "#555", MARKS.get(bad or "", "yields")
    worst = max(errors)
    level = len(ORDERED) - 1 - sum(worst > limit for limit in LEVELS_MM)
    return (
        ORDERED[level],
        _LIGHT if level >= _FROM_LIGHT else "#fff",
        f"{worst:.2g}" if worst < 100 else f"{worst:.0f}",
    )
