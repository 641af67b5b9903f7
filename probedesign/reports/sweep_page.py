"""Page of a sweep: a heat map of two keys, curves of one, parallel coordinates of more."""

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
    errors, figures = [r[METRIC] for r in records if r["result"] == "ok"], list[ReportFigure]()
    if errors and len(keys) == 1:
        figures = _curves(records, keys[0])
    elif errors:
        draw, caption = (heat_map, _HEAT) if len(keys) == 2 else (parallel_coordinates, _PARALLEL)
        figures = [ReportFigure(METRIC, caption, draw(records, keys, min(errors), max(errors)).svg())]
    best = sorted((r for r in records if r["result"] == "ok"), key=lambda r: float(r[METRIC]))[:MAX_ROWS]
    head = [*keys, *METRICS]
    table = HtmlTable(head, [[format_value(row[name]) for name in head] for row in best])
    after = [(f"The best {len(best)} designs", table)]
    return report_page("Sweep", [about], None, figures, after, verdict=verdict(records, keys))


_HEAT = "RMS error of the task. Grey: not evaluated, with the reason; the frame marks the smallest error."
_PARALLEL = ("Each line is a design: its values from the smallest to the largest of each key, and its error; the thick "
             "line has the smallest error.")  # fmt: skip


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


def heat_map(records: Sequence[Record], keys: Sequence[str], low: float, high: float) -> Chart:
    """Return the error over two keys as a map, with colours in equal steps of its logarithm from `low` to `high`."""
    values = [list(dict.fromkeys(record[key] for record in records)) for key in keys]
    x, y = (ChartAxis.named(key, [format_value(v) for v in steps]) for key, steps in zip(keys, values, strict=True))
    chart = Chart(x, y)
    best = min((r for r in records if r["result"] == "ok"), key=lambda r: float(r[METRIC]), default=None)
    frame = None
    for record in records:
        i, j = (steps.index(record[key]) + 1 for key, steps in zip(keys, values, strict=True))
        box = (i - 0.5, i + 0.5), (j - 0.5, j + 0.5)
        if record["result"] != "ok":
            chart.box(*box, "#e4e4e4")
            chart.text(i, j, SHORT.get(str(record["result"]), "failed"), size=9.0, on="#e4e4e4")
            continue
        level = _level(record[METRIC], low, high)
        chart.box(*box, ORDERED[level])
        if len(values[0]) <= 16:
            chart.text(i, j, f"{record[METRIC]:.3g}", size=10.5, on=ORDERED[level])
        if record is best:
            frame = i, j
    _legend(chart, low, high)
    if frame is not None:
        (i, j), h = frame, 0.5
        chart.line([i - h, i + h, i + h, i - h, i - h], [j - h, j - h, j + h, j + h, j - h], COLOURS[2], width=3.0)
    return chart


def _legend(chart: Chart, low: float, high: float) -> None:
    steps = len(ORDERED)
    chart.legend += [
        LegendEntry(f"≤ {low * (high / low) ** (k / steps):.2g} mm", ORDERED[-k])
        for k in range(1, steps + 1 if high > low else 2)
    ]


def parallel_coordinates(records: Sequence[Record], keys: Sequence[str], low: float, high: float) -> Chart:
    """Return a line for each evaluated design through its values of all keys and its error, coloured by the error."""
    names = [*keys, METRIC]
    chart = Chart(ChartAxis.named("", [name.rpartition(".")[2] for name in names]), ChartAxis("", -0.1, 1.1, ticks=()))
    _legend(chart, low, high)
    good = sorted((r for r in records if r["result"] == "ok"), key=lambda r: -float(r[METRIC]))
    scales = [_scale([r[name] for r in records if r[name] is not None]) for name in names]
    for i, record in enumerate(good):
        last = i == len(good) - 1
        heights = [scale[record[name]] for name, scale in zip(names, scales, strict=True)]
        chart.line(
            range(1, len(names) + 1), heights, ORDERED[_level(record[METRIC], low, high)], width=4.0 if last else 1.0
        )
    for i, scale in enumerate(scales, 1):
        ends = min(scale, key=scale.__getitem__), max(scale, key=scale.__getitem__)
        for value, y in zip(ends, (-0.05, 1.05), strict=True):
            chart.text(i, y, format_value(value), size=10.5)
    return chart


def _scale(values: Sequence[Any]) -> dict[Any, float]:
    distinct = list(dict.fromkeys(values))
    if all(isinstance(v, int | float) for v in distinct):
        low, high = min(distinct), max(distinct)
        return {v: (v - low) / (high - low) if high > low else 0.5 for v in distinct}
    return {v: k / max(len(distinct) - 1, 1) for k, v in enumerate(distinct)}


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
