"""Report pages and charts: complete, without network access, and consistent with the data."""

import json
import math
import re
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace
from xml.etree import ElementTree

import numpy as np
import pytest

from probedesign.cli.main import run
from probedesign.design import check_design, load_design
from probedesign.prediction.fused import FUSED_CAUSES
from probedesign.prediction.predict import CAUSE_GROUPS, shares_of
from probedesign.probe import build_probe
from probedesign.reports.chart import Chart, ChartAxis
from probedesign.reports.comparison_page import best_design
from probedesign.reports.html_page import html_document
from probedesign.reports.prediction_page import prediction_page

DESIGNS = Path(__file__).parents[2] / "designs"


class Elements(HTMLParser):
    """Counts elements, and collects what they would fetch."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.seen: dict[str, int] = {}
        self.fetched: list[str] = []
        self.feed(page)

    def handle_starttag(self, tag, attrs):
        self.seen[tag] = self.seen.get(tag, 0) + 1
        if tag != "a":  # a link to another page of the design fetches nothing
            names = ("src", "href", "xlink:href")
            self.fetched += [v for k, v in attrs if k in names and not v.startswith(("#", "data:"))]


def assert_whole(page: str) -> Elements:
    elements = Elements(page)
    assert elements.fetched == [] and "script" not in elements.seen and "@import" not in page
    assert page.rstrip().endswith("</html>")
    return elements


def test_the_prediction_page_has_all_figures():
    probe = build_probe(load_design(DESIGNS / "small.toml"))
    prediction = probe.predict(fractions=(0.5, 0.8), forces_N=(0.02,), directions=("+y",))
    page = prediction_page(prediction, probe.estimator()).decode()
    assert assert_whole(page).seen["svg"] == page.count('<svg role="img" aria-label="') > 1
    assert prediction.fingerprint in page
    labels = re.findall(r"<text[^>]*>([^<]*)</text>", page)
    for condition in (*prediction.conditions, *prediction.fused):
        assert f"{condition.predicted_error_mm:.2g}" in labels


def test_a_buckled_probe_has_a_page():
    design = load_design(DESIGNS / "large.toml")
    soft = {**design.model_dump(by_alias=True, exclude_none=True), "name": "soft"}
    soft["material"]["youngs_modulus_mpa"], soft["material"]["shear_modulus_mpa"] = 0.11, 0.04
    soft["mount"]["gravity_base_m_s2"] = [0.0, 0.0, -9.81]
    soft["probe"] |= {"base_d_mm": 4.0, "tip_d_mm": 4.0}
    probe = build_probe(check_design(soft))
    prediction = probe.predict(fractions=(0.5,), forces_N=(0.02,), directions=("+y",))
    assert prediction.tip_sag_mm is None and prediction.fused[0].result == "gives_way"
    assert "it buckles under its own weight" in prediction_page(prediction, probe.estimator()).decode()


def test_the_shares_of_a_budget_sum_to_one():
    probe = build_probe(load_design(DESIGNS / "small.toml"))
    prediction = probe.predict(fractions=(0.6,), forces_N=(0.02,), directions=("+y",))
    assert {cause for group in CAUSE_GROUPS.values() for cause in group} == set(FUSED_CAUSES)
    for condition in (prediction.conditions[0], prediction.fused[0]):
        shares = shares_of(condition)
        assert sum(shares.values()) == pytest.approx(1.0, rel=1e-12)  # rounding
        mount = sum(condition.budget_mm[cause] ** 2 for cause in CAUSE_GROUPS["mount"])
        assert shares["mount"] == pytest.approx(mount / condition.predicted_error_mm**2, rel=1e-9)


def test_the_verdict_states_the_condition_that_the_page_leads_with():
    probe = build_probe(load_design(DESIGNS / "small.toml"))
    prediction = probe.predict(fractions=(0.3, 0.8), forces_N=(0.01, 0.05), directions=("+x", "+y"))
    touch = max(
        (c for c in prediction.conditions if (c.contact_fraction, c.force_N) == (0.8, 0.01)),
        key=lambda c: c.predicted_error_mm,
    )
    felt = max(d.detectable_force_mN for d in prediction.detection if d.contact_fraction == 0.8)
    numbers = re.findall(r"[\d.]+\d", prediction.verdict)
    assert {f"{touch.predicted_error_mm:.2g}", f"{felt:.2g}", "10", "0.8"} <= set(numbers)
    shares = shares_of(touch)
    assert max(shares, key=lambda group: shares[group]) in prediction.verdict


def test_the_best_design_of_a_metric_is_named_unless_values_are_printed_alike():
    def named(name, **values):
        metrics = SimpleNamespace(**values)
        return SimpleNamespace(design=SimpleNamespace(name=name), metrics=metrics)

    pair = [
        named("a", error_mm=1.0, reach_mm=90.0, length_mm=100.0, slide_mm=None),
        named("b", error_mm=2.0, reach_mm=140.0, length_mm=150.0, slide_mm=0.1),
    ]
    assert [best_design(pair, m) for m in ("error_mm", "reach_mm", "length_mm", "slide_mm")] == ["a", "b", None, "b"]
    alike = [named("a", error_mm=1.00001), named("b", error_mm=1.00002)]
    assert best_design(alike, "error_mm") is None


@pytest.mark.parametrize(
    ("axis", "ticks"),
    [
        (ChartAxis("", 0.09, 21.0, log=True), (0.1, 0.2, 0.5, 1, 2, 5, 10, 20)),
        (ChartAxis("", 0.09, 5000.0, log=True), (0.1, 1, 10, 100, 1000)),
        (ChartAxis("", 2.1, 4.9, log=True), (3, 4)),
        (ChartAxis("", 1.3, 4.4, log=True), (2, 3, 4)),
        (ChartAxis("", 0.31, 0.38, log=True), (0.32, 0.34, 0.36, 0.38)),
        (ChartAxis("", -13.0, 61.0), (0, 20, 40, 60)),
        (ChartAxis("", 0.0, 1.0), (0, 0.2, 0.4, 0.6, 0.8, 1)),
        (ChartAxis.named("", ["a", "b"]), (1, 2)),
    ],
)
def test_ticks_are_round_and_inside(axis, ticks):
    assert axis.shown_ticks == ticks


def test_lines_break_at_nan_and_names_are_escaped():
    chart = Chart(ChartAxis("x & y", 0.0, 4.0), ChartAxis("[mm]", 0.0, 1.0))
    chart.line([0, 1, 2, 3, 4], [0.1, 0.2, math.nan, 0.3, 0.4], "#000", name="<a>")
    drawn = chart.svg().decode()
    assert drawn.count("stroke-linejoin") == 2 and "nan" not in drawn
    assert "x &amp; y" in drawn and "&lt;a&gt;" in drawn
    assert ElementTree.fromstring(drawn).tag.endswith("svg")


def test_square_axes_have_one_scale():
    chart = Chart(ChartAxis("", 0.0, 100.0), ChartAxis("", 0.0, 10.0), square=True)
    (a, b), (c, d) = chart.at(0.0, 0.0), chart.at(50.0, 5.0)
    assert c - a == pytest.approx(10.0 * (b - d), rel=1e-12)  # rounding


def test_compare_puts_designs_side_by_side(tmp_path, capsys):
    out, places = tmp_path / "page.html", ("--at", "0.6", "0.8")
    files = [str(DESIGNS / f"{name}.toml") for name in ("large", "small")]
    assert run(["compare", *files, "--out", str(out), *places, "--json"]) == 0
    designs = json.loads(capsys.readouterr().out)["designs"]
    page = out.read_text(encoding="utf-8")
    assert assert_whole(page).seen["svg"] == page.count('<svg role="img" aria-label="') > 1
    row = re.search(r"<td>error of the task, RMS \[mm\]</td><td>(.*?)</td><td>(.*?)</td>", page)
    assert [float(cell) for cell in row.groups()] == pytest.approx([d["error_mm"] for d in designs], rel=1e-3)


def test_compare_replaces_its_page_and_nothing_else(tmp_path, capsys):
    files, places = ([str(DESIGNS / f"{name}.toml") for name in ("large", "small")], ("--at", "0.6", "0.8"))
    design, page = tmp_path / "design.toml", tmp_path / "page.html"
    design.write_bytes((DESIGNS / "large.toml").read_bytes())
    page.write_bytes(html_document("earlier", [], ""))
    for target in (design, tmp_path):
        assert run(["compare", *files, "--out", str(target), *places]) == 2
        captured = capsys.readouterr()
        assert captured.out == "" and captured.err.count("\n") == 1 and "is not an HTML page" in captured.err
    assert design.read_bytes() == (DESIGNS / "large.toml").read_bytes()
    assert run(["compare", *files, "--out", str(page), *places]) == 0
    assert "error of the task" in page.read_text(encoding="utf-8")


@pytest.mark.parametrize("count", [1, 7])
def test_compare_takes_two_to_six(count, capsys):
    assert run(["compare", *[str(DESIGNS / "large.toml")] * count]) == 2
    assert "2 to 6 designs" in capsys.readouterr().err


def test_every_logarithmic_axis_has_tick_labels():
    for low in np.geomspace(1e-3, 1e3, 61):
        for ratio in (1.02, 1.3, 1.69, 3.0, 10.0, 1e3, 1e5):
            axis = ChartAxis("", low, low * ratio, log=True)
            ticks = axis.shown_ticks
            assert 2 <= len(ticks) <= 13 and ticks == tuple(sorted(set(ticks)))
            assert low * 0.999 <= ticks[0] and ticks[-1] <= low * ratio * 1.001
            assert len(set(axis.tick_labels)) == len(ticks)
