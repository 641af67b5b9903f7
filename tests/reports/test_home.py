"""The home page of a design: states and commands of its steps, its figures, links between its pages, bad files."""

import base64
import json
from pathlib import Path

import numpy as np
import pytest

from probedesign.cli.console import json_bytes
from probedesign.design import load_design
from probedesign.probe import build_probe
from probedesign.reports.prediction_page import prediction_page
from probedesign.web.home import write_home

DESIGNS = Path(__file__).parents[2] / "designs"


@pytest.fixture(scope="module")
def probe():
    return build_probe(load_design(DESIGNS / "large.toml"))


@pytest.fixture(scope="module")
def prediction(probe):
    return probe.predict((0.5, 0.8), (0.005, 0.01), ("+x",))


def home(folder, probe, **options) -> str:
    page = write_home(folder, probe.model, "designs/large.toml", **options)
    assert page == folder / "index.html"
    return page.read_text("utf-8")


def test_a_page_without_files_has_the_command_of_each_step(tmp_path, probe):
    text = home(tmp_path, probe)
    assert "probedesign predict designs/large.toml" in text and "probedesign live large --source sim: --view" in text
    assert '<p class="number">' not in text and "http-equiv" not in text and probe.model.fingerprint in text


def test_the_mount_is_drawn_before_it_is_exported(tmp_path, probe):
    """From the robot's face, the adapter's plate, to the tip; without a design from the sensor."""
    lengths = []
    for design in (str(DESIGNS / "large.toml"), ""):
        page = write_home(tmp_path, probe.model, design).read_text("utf-8")
        scene = json.loads(page.split('id="scene-data">')[1].split("</script>")[0])
        points = [np.frombuffer(base64.b64decode(part["points"]), "<u2").reshape(-1, 3) for part in scene["parts"]]
        lengths.append(scene["step"] * np.ptp(np.concatenate(points)[:, 0].astype(float)))  # it hangs along x
    assert lengths[0] == pytest.approx(probe.length + probe.model.T_robotflange_base[2, 3], abs=1e-5)
    assert lengths[1] < lengths[0] - 5e-3


def test_a_prediction_gives_the_figures_and_its_card_the_result(tmp_path, probe, prediction):
    (tmp_path / "prediction.json").write_bytes(json_bytes(prediction.as_dict()))
    (tmp_path / "prediction.html").write_bytes(prediction_page(prediction, probe.estimator()))
    text = home(tmp_path, probe)
    assert text.count('<p class="number">') == 3 and prediction.verdict in text
    assert f"{prediction.fused_headline.predicted_error_mm:.2g} mm" in text
    assert "probedesign predict" not in text


def test_a_prediction_of_another_geometry_gives_no_figures_and_says_so(tmp_path, probe, prediction):
    (tmp_path / "prediction.json").write_bytes(json_bytes(prediction.as_dict() | {"fingerprint": "0123456789ab"}))
    text = home(tmp_path, probe)
    assert '<p class="number">' not in text and "made for geometry 0123456789ab" in text
    assert "probedesign predict designs/large.toml" in text


def test_all_pages_link_to_each_other(tmp_path, probe, prediction):
    page = prediction_page(prediction, probe.estimator())
    (tmp_path / "validation").mkdir()
    for name in ("prediction.html", "validation/validation.html"):
        (tmp_path / name).write_bytes(page)
    home(tmp_path, probe)
    home(tmp_path, probe)  # the links are replaced, not repeated
    top, below = ((tmp_path / name).read_text("utf-8") for name in ("prediction.html", "validation/validation.html"))
    assert top.count("<nav>") == 1 and 'href="index.html"' in top and 'href="validation/validation.html"' in top
    assert 'href="../index.html"' in below and 'href="../prediction.html"' in below


def test_a_page_that_the_manifest_lists_keeps_its_bytes(tmp_path, probe, prediction):
    page = prediction_page(prediction, probe.estimator())
    (tmp_path / "assembly.html").write_bytes(page)
    home(tmp_path, probe)
    assert (tmp_path / "assembly.html").read_bytes() == page


@pytest.mark.parametrize("content", ["<!DOCTYPE html>\n<html><body>mine</body></html>\n", "notes"])
def test_a_foreign_file_is_never_replaced(tmp_path, probe, content):
    (tmp_path / "index.html").write_text(content)
    assert write_home(tmp_path, probe.model) is None
    assert (tmp_path / "index.html").read_text() == content


@pytest.mark.parametrize(
    "content", ["", "[]", "{", '{"detection": 3}', '{"verdict": ["<b>"], "fused_headline": "x"}', "[" * 100_000]
)
def test_a_damaged_file_ends_no_command(tmp_path, probe, content):
    if content.startswith('{"'):
        content = json.dumps(json.loads(content) | {"fingerprint": probe.model.fingerprint, "conditions": [1]})
    for name in ("prediction.json", "manifest.json", "large.probe.json"):
        (tmp_path / name).write_text(content)
    text = home(tmp_path, probe)
    assert '<p class="number">' not in text and "<b>" not in text


def test_a_page_reloads_itself_while_something_is_made(tmp_path, probe):
    assert 'http-equiv="refresh"' in home(tmp_path, probe, working="the prediction")
    assert 'http-equiv="refresh"' not in home(tmp_path, probe)
