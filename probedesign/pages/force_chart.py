"""From which force on, and up to which: one line an answer, along the probe."""

import math
from collections.abc import Sequence
from typing import Any

from probedesign.pages.chart import COLOURS, DASHES, MARKS, Axis, Chart, Entry, span_of
from probedesign.prediction.predict import Prediction

LIMITS = {"gives_way": ("gives way", "o"), "sensor": ("sensor's range", "s"), "slips_off": ("slips off", "v"),
          "none": ("no limit found", "d")}  # fmt: skip
PLACE = "contact, fraction of the length"
_TICKS = (0.0, 0.2, 0.4, 0.6, 0.8, 1.0)


def draw_forces(prediction: Prediction) -> bytes:
    """Felt, located to so many millimetres by one reading or by fused touches, and the end; an SVG."""
    k = prediction.pressing.touches
    lines: list[tuple[str, Sequence[Any], str, bool]] = [
        ("felt", prediction.detection, "detectable_force_mN", True),
        (f"2 mm, {k} fused", prediction.fused_reach, "force_mN_for_2_mm", True),
        ("5 mm, one", prediction.reach, "force_mN_for_5_mm", True),
        ("2 mm, one", prediction.reach, "force_mN_for_2_mm", True),
        ("1 mm, one", prediction.reach, "force_mN_for_1_mm", True),
        ("the end", prediction.reach, "greatest_force_N", False),
    ]
    found = {
        name: _worst(rows, key, most, 1e3 if key.endswith("_N") else 1.0) for name, rows, key, most in lines
    }
    values = [v for _, line in found.values() for v in line]
    chart = Chart(
        Axis(PLACE, 0.0, 1.05, ticks=_TICKS), Axis("contact force [mN]", *span_of(values, True), log=True)
    )
    for (name, (x, y)), colour, dashes, mark in zip(found.items(), COLOURS, DASHES, MARKS, strict=False):
        chart.line(x, y, colour, dashes, mark, name)
    return chart.svg()


def draw_limits(prediction: Prediction) -> bytes:
    """The greatest force by side; its mark says what ends it; an SVG."""
    values = [1e3 * row.greatest_force_N for row in prediction.reach if row.greatest_force_N is not None]
    chart = Chart(
        Axis(PLACE, 0.0, 1.05, ticks=_TICKS), Axis("greatest force [mN]", *span_of(values, True), log=True)
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
            chart.legend.append(Entry(name, "#666", "0 99", mark))
    return chart.svg()


def draw_sensitivity(prediction: Prediction) -> bytes:
    """What a millimetre more of press makes, at the lightest force along the last of the sides; an SVG."""
    lightest = min(c.force_N for c in prediction.conditions)
    side = prediction.conditions[-1].direction
    rows = [c for c in prediction.conditions if (c.force_N, c.direction) == (lightest, side)]
    moments = [c.moment_per_mm_Nmm or math.nan for c in rows]
    forces = [1e3 * c.force_per_mm_N if c.force_per_mm_N else math.nan for c in rows]
    chart = Chart(
        Axis(PLACE, 0.0, 1.05, ticks=_TICKS),
        Axis("per millimetre of press", *span_of([*moments, *forces], True), log=True),
    )
    places = [c.contact_fraction for c in rows]
    chart.line(places, moments, COLOURS[1], "", "o", "base moment [N·mm/mm]")
    chart.line(places, forces, COLOURS[2], "7 4", "s", "force [mN/mm]")
    return chart.svg()


def _worst(rows: Sequence[Any], key: str, most: bool, unit: float) -> tuple[list[float], list[float]]:
    """Of the directions at each place, the greatest or the least; NaN where one has none."""
    places = sorted({row.contact_fraction for row in rows})
    found = []
    for place in places:
        values = [getattr(row, key) for row in rows if row.contact_fraction == place]
        bad = None in values
        found.append(math.nan if bad else unit * (max if most else min)(values))
    return places, found
