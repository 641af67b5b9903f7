"""Page of a sweep: curves of one key, heat maps of each two."""

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Any

from probedesign.core.units import format_value
from probedesign.optimization.objective import METRICS
from probedesign.reports.chart import COLOURS, DASHES, MARKS, ORDERED, Chart, ChartAxis, LegendEntry
from probedesign.reports.html_page import HtmlTable, ReportFigure, report_page

Record = Mapping[str, Any]
METRIC = "error_mm"
CURVES = ("error_mm", "worst_error_mm", "sag_mm", "detectable_mN")  #: Metrics drawn over a single key.
MAX_ROWS = 20
#: Text of a cell without an error, by result.
SHORT = {"refused": "invalid", "gives_way": "buckles", "unobservable": "unobs.", "out_of_range": "range",
         "failed": "failed"}  # fmt: skip


def sweep_page(records: Sequence[Record], keys: Sequence[str], about: str) -> bytes:
    """Return the page of a sweep of `keys`."""
    best = sorted((r for r in records if r["result"] == "ok"), key=lambda r: float(r[METRIC]))[:MAX_ROWS]
    figures = _curves(records, keys[0]) if len(keys) == 1 else []
    for pair in itertools.combinations(keys, 2) if best else ():
        fixed = {key: best[0][key] for key in keys if key not in pair}
        drawn = [r for r in records if all(r[key] == value for key, value in fixed.items())]
        at = "".join(f", {key.rpartition('.')[2]} = {format_value(value)}" for key, value in fixed.items())
        figures.append(ReportFigure(METRIC + at, _HEAT, heat_map(drawn, pair).svg()))
    head = [*keys, *METRICS]
    table = HtmlTable(head, [[format_value(row[name]) for name in head] for row in best])
    after = [(f"The best {len(best)} designs", table)]
    return report_page("Sweep", [about], None, figures, after, verdict=verdict(records, keys))


_HEAT = "RMS error of the task. Grey: not evaluated, with the reason; the frame marks the smallest error."


def verdict(records: Sequence[Record], keys: Sequence[str]) -> str:
    """Return the best design in one sentence."""
    good = [r for r in records if r["result"] == "ok"]
    if not good:
        return f"None of {len(records)} designs could be evaluated."
    best = min(good, key=lambda r: float(r[METRIC]))
    values = ", ".join(f"{key.rpartition('.')[2]} = {format_value(best[key])}" for key in keys)
    lost = len(records) - len(good)
    rest = f"; {lost} of {len(records)} designs could not be evaluated" if lost else ""
    return f"The smallest error of {len(records)} designs is {best[METRIC]:.3g} mm, with {values}{rest}."


def heat_map(records: Sequence[Record], keys: Sequence[str]) -> Chart:
    """Return the error over two keys as a map, with colours in equal steps of its logarithm; at least one is known."""
    values = [list(dict.fromkeys(record[key] for record in records)) for key in keys]
    x, y = (ChartAxis.named(key, [format_value(v) for v in steps]) for key, steps in zip(keys, values, strict=True))
    chart = Chart(x, y)
    good = sorted((r for r in records if r["result"] == "ok"), key=lambda r: float(r[METRIC]))
    low, high = (float(r[METRIC]) for r in (good[0], good[-1]))
    for record in records:
        i, j = (steps.index(record[key]) + 1 for key, steps in zip(keys, values, strict=True))
        if record["result"] != "ok":
            chart.cell(i, j, SHORT.get(str(record["result"]), "failed"), "#e4e4e4", 9.0)
        else:
            text = f"{record[METRIC]:.3g}" if len(values[0]) <= 16 else ""
            chart.cell(i, j, text, ORDERED[_level(record[METRIC], low, high)], 10.5)
    steps, h = len(ORDERED), 0.5
    chart.legend += [
        LegendEntry(f"≤ {low * (high / low) ** (k / steps):.2g} mm", ORDERED[-k])
        for k in range(1, steps + 1 if high > low else 2)
    ]
    i, j = (steps.index(good[0][key]) + 1 for key, steps in zip(keys, values, strict=True))
    chart.line([i - h, i + h, i + h, i - h, i - h], [j - h, j - h, j + h, j + h, j - h], COLOURS[2], width=3.0)
    return chart


def _level(error: float, low: float, high: float) -> int:
    share = math.log(error / low) / math.log(high / low) if high > low else 0.0
    return len(ORDERED) - 1 - min(int(share * len(ORDERED)), len(ORDERED) - 1)


def _curves(records: Sequence[Record], key: str) -> list[ReportFigure]:
    figures = []
    x = [record[key] for record in records]
    numeric = all(isinstance(value, int | float) for value in x)
    places = x if numeric else list(range(1, len(x) + 1))
    across = ChartAxis.spanning(key, places) if numeric else ChartAxis.named(key, [format_value(v) for v in x])
    for i, metric in enumerate(CURVES):
        y = [math.nan if r[metric] is None or r["result"] != "ok" else float(r[metric]) for r in records]
        if not any(map(math.isfinite, y)):
            continue
        chart = Chart(across, ChartAxis.spanning(metric, y))
        chart.line(places, y, COLOURS[i % len(COLOURS)], DASHES[0], MARKS[0])
        figures.append(ReportFigure(metric, "Broken where not evaluated.", chart.svg()))
    return figures
