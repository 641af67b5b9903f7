"""The pages: whole, asking nothing of a network, and saying what the numbers say."""

import json
import math
import re
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree

import pytest

from probedesign.cli.main import run
from probedesign.design import check_design, load_design
from probedesign.pages.budget_bars import GROUPS, shares_of
from probedesign.pages.chart import Axis, Chart
from probedesign.pages.prediction_page import prediction_page
from probedesign.prediction.fused_budget import FUSED_CAUSES
from probedesign.probe import build_probe
from probedesign.reports.html_page import Section

DESIGNS = Path(__file__).parents[1] / "designs"


class Elements(HTMLParser):
    """Counts elements, and collects what they would fetch."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.seen: dict[str, int] = {}
        self.fetched: list[str] = []
        self.feed(page)

    def handle_starttag(self, tag, attrs):
        self.seen[tag] = self.seen.get(tag, 0) + 1
        self.fetched += [
            v for k, v in attrs if k in ("src", "href", "xlink:href") and not v.startswith(("#", "data:"))
        ]


def assert_whole(page: str) -> Elements:
    elements = Elements(page)
    assert elements.fetched == [] and "script" not in elements.seen and "@import" not in page
    assert page.rstrip().endswith("</html>")
    return elements


def test_the_page_of_a_prediction_holds_the_figures_and_what_is_added():
    probe = build_probe(load_design(DESIGNS / "small.toml"))
    prediction = probe.predict(fractions=(0.5, 0.8), forces_N=(0.02,), directions=("+y",))
    more = Section("Budget & causes", "what each costs", b'<svg id="budget"></svg>')
    page = prediction_page(prediction, probe.estimator(), [more]).decode()
    assert assert_whole(page).seen["svg"] == 12
    assert "Budget &amp; causes" in page and prediction.fingerprint in page
    told = re.findall(r"<text[^>]*>([^<]*)</text>", page)
    for condition in (*prediction.conditions, *prediction.fused):
        assert f"{condition.total_error_mm:.2g}" in told
    for row in prediction.reach:
        assert f"<td>{row.force_mN_for_5_mm:.3g} mN</td>" in page


def test_a_probe_that_cannot_stand_has_a_page_that_says_so():
    design = load_design(DESIGNS / "large.toml")
    soft = {**design.model_dump(by_alias=True, exclude_none=True), "name": "soft"}
    soft["material"]["youngs_modulus_mpa"], soft["material"]["shear_modulus_mpa"] = 0.11, 0.04
    soft["mount"]["gravity_base_m_s2"] = [0.0, 0.0, -9.81]
    soft["probe"] |= {"base_d_mm": 4.0, "tip_d_mm": 4.0}
    probe = build_probe(check_design(soft))
    prediction = probe.predict(fractions=(0.5,), forces_N=(0.02,), directions=("+y",))
    assert prediction.tip_sag_mm is None and prediction.fused[0].result == "gives_way"
    assert "it cannot stand" in prediction_page(prediction, probe.estimator()).decode()


def test_the_shares_of_a_budget_are_whole():
    probe = build_probe(load_design(DESIGNS / "small.toml"))
    prediction = probe.predict(fractions=(0.6,), forces_N=(0.02,), directions=("+y",))
    assert {cause for group in GROUPS.values() for cause in group} == set(FUSED_CAUSES)
    for condition in (prediction.conditions[0], prediction.fused[0]):
        shares = shares_of(condition)
        assert sum(shares.values()) == pytest.approx(1.0, rel=1e-12)  # rounding
        mount = sum(condition.budget_mm[cause] ** 2 for cause in GROUPS["mount"])
        assert shares["mount"] == pytest.approx(mount / condition.total_error_mm**2, rel=1e-9)


@pytest.mark.parametrize(
    ("axis", "ticks"),
    [
        (Axis("", 0.09, 21.0, log=True), (0.1, 0.2, 0.5, 1, 2, 5, 10, 20)),
        (Axis("", 0.09, 5000.0, log=True), (0.1, 1, 10, 100, 1000)),
        (Axis("", -13.0, 61.0), (0, 20, 40, 60)),
        (Axis("", 0.0, 1.0), (0, 0.2, 0.4, 0.6, 0.8, 1)),
        (Axis.named("", ["a", "b"]), (1, 2)),
    ],
)
def test_ticks_are_round_and_inside(axis, ticks):
    assert axis.told == ticks


def test_a_line_is_broken_where_there_is_no_number_and_names_are_escaped():
    chart = Chart(Axis("x & y", 0.0, 4.0), Axis("[mm]", 0.0, 1.0))
    chart.line([0, 1, 2, 3, 4], [0.1, 0.2, math.nan, 0.3, 0.4], "#000", name="<a>")
    drawn = chart.svg().decode()
    assert drawn.count("stroke-linejoin") == 2 and "nan" not in drawn
    assert "x &amp; y" in drawn and "&lt;a&gt;" in drawn
    assert ElementTree.fromstring(drawn).tag.endswith("svg")


def test_what_is_square_is_drawn_to_scale():
    chart = Chart(Axis("", 0.0, 100.0), Axis("", 0.0, 10.0), square=True)
    (a, b), (c, d) = chart.at(0.0, 0.0), chart.at(50.0, 5.0)
    assert c - a == pytest.approx(10.0 * (b - d), rel=1e-12)  # rounding


def test_compare_puts_designs_side_by_side(tmp_path, capsys):
    out, places = tmp_path / "page.html", ("--places", "0.6:0.8:0.2")
    files = [str(DESIGNS / f"{name}.toml") for name in ("large", "small")]
    assert run(["compare", *files, "--out", str(out), *places, "--json"]) == 0
    designs = json.loads(capsys.readouterr().out)["designs"]
    page = out.read_text(encoding="utf-8")
    assert assert_whole(page).seen["svg"] == 7
    row = re.search(r"<td>error_mm</td><td>(.*?)</td><td>(.*?)</td>", page)
    assert [float(cell) for cell in row.groups()] == pytest.approx([d["error_mm"] for d in designs], rel=1e-3)


@pytest.mark.parametrize("count", [1, 7])
def test_compare_takes_two_to_six(count, capsys):
    assert run(["compare", *[str(DESIGNS / "large.toml")] * count]) == 2
    assert "2 to 6 designs" in capsys.readouterr().err
