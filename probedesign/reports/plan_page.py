"""Page of a plan: the tests with the expected intervals, a drawing of each set-up, and the checklist for the bench."""

import math
from collections.abc import Sequence
from html import escape

import numpy as np

from probedesign.campaigns.campaign import PUSH_DIRECTIONS
from probedesign.core.units import MM
from probedesign.estimation.model import ProbeModel
from probedesign.planning.candidates import CandidateTest
from probedesign.planning.plan import ENOUGH, ExpectedInterval, Plan, checklist
from probedesign.reports.chart import COLOURS, DASHES, MARKS, Chart, ChartAxis
from probedesign.reports.html_page import REPORT_STYLE, HtmlTable, html_document, labelled
from probedesign.reports.prediction_charts import STATIONS, flanks

STYLE = """
.sheet { display: grid; grid-template-columns: repeat(auto-fill, minmax(min(78mm, 100%), 1fr)); gap: 4mm }
.sheet section { border: 0.4pt solid #bbb; padding: 2mm }
.sheet h3, .steps h3 { font-size: 10.5pt; margin: 0 }
.steps ul { list-style: none; padding: 0; margin: 1mm 0 3mm } .steps li { margin: 1mm 0 1mm 6mm; text-indent: -6mm }
.steps li::before { content: "\\2610\\00a0\\00a0" } 
.steps li.command { font-family: monospace; overflow-wrap: anywhere }
.plan td:nth-child(2), .plan th:nth-child(2) { text-align: left; white-space: normal; min-width: 45mm; width: 60% }
.plan { break-inside: auto } .plan th, .plan td { padding: 0.6mm 1.5mm }
.stop { max-width: 120mm }
@media print { .sheet { grid-template-columns: 1fr 1fr } .plan table { break-inside: auto } }
"""


def interval_text(interval: ExpectedInterval) -> str:
    """Return half the width of the 95 % interval as text: relative for a factor, else in its unit."""
    if interval.low is None or interval.high is None:
        return "—"
    half = 0.5 * (interval.high - interval.low)
    if interval.relative:
        return f"± {half / (0.5 * (interval.high + interval.low)):.1%}"
    return f"± {half:.2g} {interval.unit}".rstrip()


def plan_page(plan: Plan, folder: str) -> bytes:
    """Return the page of a plan; `folder` is that of the data, as the commands of the checklist name it."""
    model, enough = plan.bench.model, plan.enough
    about = [
        f"{len(plan.tests)} measurements in {plan.tests[-1].minutes:.0f} of {plan.minutes:g} minutes, preparation "
        f"included; geometry {model.fingerprint}. Durations are assumed.",
        f"After {enough.candidate.name} ({enough.minutes:.0f} min) every interval is within {ENOUGH - 1.0:.0%} of the "
        "final one.",
        *plan.notes,
    ]
    drawings = "".join(
        f"<section><h3>☐ {escape(candidate.name)}</h3>{labelled(set_up_chart(model, candidate).svg(), candidate.words)}"
        f"<p>{escape(_words(candidate))}</p></section>"
        for candidate in plan.candidates
        if candidate.shape is not None
    )
    *steps, (last, commands) = checklist(plan, folder)
    lists = "".join(f"<h3>{escape(heading)}</h3>{_items(lines)}" for heading, lines in steps)
    lists += f"<h3>{escape(last)}</h3>{_items(commands, ' class=command')}"
    body = (
        f'<section class="plan"><h2>Expected 95 % intervals after each test</h2>{_table(plan).html()}</section>'
        f"{_chart_section(plan)}"
        f'<section class="steps" style="break-inside: auto"><h2>Checklist</h2>{lists}</section>'
        f'<h2>Set-ups</h2><div class="sheet">{drawings}</div>'
    )
    return html_document(
        f"{model.name}: plan of a campaign", [escape(line) for line in about], body, REPORT_STYLE + STYLE
    )


def set_up_chart(model: ProbeModel, candidate: CandidateTest) -> Chart:
    """Return the set-up of a test with a shape, in base axes: the probe as it will bend, the load and gravity."""
    test, shape, rod, length = candidate.test, candidate.shape, model.rod, model.rod.length / MM
    assert test is not None and shape is not None
    across = 1 if test.direction[1:] == "y" else int(np.argmax(np.abs(test.gravity_base[:2])))
    s, down = np.linspace(0.0, rod.length, STATIONS), test.gravity_base / np.linalg.norm(test.gravity_base)
    upper, lower = flanks(shape.p_at(s), rod.radius_at(s), across)
    arrows = {"gravity": (np.zeros(3), 0.2 * length * down)}
    if math.isfinite(candidate.mark):
        marked, push = shape.p_at(candidate.mark) / MM, np.array(PUSH_DIRECTIONS.get(test.direction, down))
        arrows[f"{1e3 * candidate.mass:g} g" if candidate.mass else f"{candidate.displacement / MM:g} mm"] = (
            (marked, marked + 0.25 * length * push) if candidate.mass else (marked - 0.25 * length * push, marked)
        )
    ends = np.concatenate([*arrows.values(), np.eye(3)[2:] * length])[:, [2, across]]
    sides = np.concatenate([upper, lower[::-1]])
    chart = Chart.side_view(np.concatenate([ends, sides]), across)
    chart.line([0.0, length], [0.0, 0.0], "#666", DASHES[1], name="straight")
    chart.area(sides.tolist(), COLOURS[1], 0.7, "probe")
    for (name, (tail, tip)), colour in zip(arrows.items(), ("#666", COLOURS[2]), strict=False):
        chart.line([tail[2], tip[2]], [tail[across], tip[across]], colour, name=name)
        chart.points(tip[2], tip[across], colour, "o")
    return chart


def _table(plan: Plan) -> HtmlTable:
    head = ["test", "what", "min", "since start", *(interval.name for interval in plan.expected)]
    rows = []
    for test in plan.tests:
        candidate = test.candidate
        intervals = ("" if candidate.held_out else interval_text(interval) for interval in test.expected)
        rows.append([candidate.name, _words(candidate), f"{candidate.minutes:g}", f"{test.minutes:.0f}", *intervals])
    return HtmlTable(head, rows, "Intervals of identify with the design's dimensions; — : not determined yet.")


def _chart_section(plan: Plan) -> str:
    times = [test.minutes for test in plan.tests]
    lines = {}
    for k, final in enumerate(plan.expected):
        if final.std is not None:
            now = [test.expected[k].std for test in plan.tests]
            lines[final.name] = [math.nan if std is None else std / final.std for std in now]
    if not lines:
        return ""
    values = [v for line in lines.values() for v in line if math.isfinite(v)]
    chart = Chart(
        ChartAxis("time [min]", 0.0, 1.03 * times[-1]),
        ChartAxis.spanning("interval over the final one", [*values, 1.0, 2.0], log=True),
    )
    for i, (name, line) in enumerate(lines.items()):
        style = (COLOURS[1 + i % 6], DASHES[i % len(DASHES)], MARKS[i % len(MARKS)])
        chart.line(times, line, *style, name=name)
    heading = "When to stop"
    caption = "Where a line begins the tests first determine the parameter. It may rise where another one begins."
    return f"<section class=stop><h2>{heading}</h2>{labelled(chart.svg(), heading)}<p>{caption}</p></section>"


def _words(candidate: CandidateTest) -> str:
    return candidate.words + (" For validate." if candidate.held_out else "")


def _items(lines: Sequence[str], attribute: str = "") -> str:
    return f"<ul>{''.join(f'<li{attribute}>{escape(line)}</li>' for line in lines)}</ul>"
