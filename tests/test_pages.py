"""The pages: whole, asking nothing of a network, and saying what the numbers say."""

import json
import re
from html.parser import HTMLParser
from pathlib import Path

import pytest

from probedesign.cli.main import run
from probedesign.design import load_design
from probedesign.pages.page import Section
from probedesign.pages.prediction_page import prediction_page
from probedesign.probe import build_probe

DESIGNS = Path(__file__).parents[1] / "designs"
pytest.importorskip("matplotlib")


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
    assert assert_whole(page).seen["svg"] == 6
    assert "Budget &amp; causes" in page and prediction.fingerprint in page
    for condition in prediction.conditions:
        assert f"<td>{condition.predicted_error_mm:.3g} mm</td>" in page


def test_compare_puts_designs_side_by_side(tmp_path, capsys):
    out, places = tmp_path / "page.html", ("--places", "0.6:0.8:0.2")
    files = [str(DESIGNS / f"{name}.toml") for name in ("large", "small")]
    assert run(["compare", *files, "--out", str(out), *places, "--json"]) == 0
    designs = json.loads(capsys.readouterr().out)["designs"]
    page = out.read_text(encoding="utf-8")
    assert assert_whole(page).seen["svg"] == 4
    row = re.search(r"<td>error_mm</td><td>(.*?)</td><td>(.*?)</td>", page)
    assert [float(cell) for cell in row.groups()] == pytest.approx([d["error_mm"] for d in designs], rel=1e-3)


@pytest.mark.parametrize("count", [1, 7])
def test_compare_takes_two_to_six(count, capsys):
    assert run(["compare", *[str(DESIGNS / "large.toml")] * count]) == 2
    assert "2 to 6 designs" in capsys.readouterr().err
