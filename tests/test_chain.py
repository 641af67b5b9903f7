"""Sequences of commands: the files they write, and the files they must not replace."""

import json
import re
from html import escape
from pathlib import Path

import pytest

from probedesign.cli import demo
from probedesign.cli.main import run
from probedesign.cli.options import EstimatorOptions
from probedesign.design import load_design
from probedesign.design.io import new, notes_of, render_design
from probedesign.frozen_probe import deploy_model
from probedesign.probe import build_probe

LARGE = Path(__file__).parents[1] / "designs/large.toml"

#: So slender that it has no stable equilibrium under gravity.
SOFT = ("new", "soft", "--length", "400", "--base-d", "0.3")


@pytest.fixture
def workplace(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_project_has_one_folder_of_exports_and_others_have_their_own(workplace, monkeypatch):
    assert run(["new", "a", "--length", "150", "--base-d", "12"]) == 0
    written = workplace / "exports/a/a.probe.json"
    for within, design in (("designs", "a.toml"), (".", "designs/a.toml"), ("below/more", "../../designs/a.toml")):
        (workplace / within).mkdir(parents=True, exist_ok=True)
        monkeypatch.chdir(workplace / within)
        assert run(["deploy", design]) == 0
        written.unlink()
        assert within == "." or not (workplace / within / "exports").exists()
    (workplace / "elsewhere/designs").mkdir(parents=True)
    (workplace / "designs/a.toml").rename(workplace / "elsewhere/designs/a.toml")
    monkeypatch.chdir(workplace / "below")
    assert run(["deploy", "../elsewhere/designs/a.toml"]) == 0
    assert (workplace / "below/exports/a/a.probe.json").exists()


def test_design_predict_deploy_and_live(workplace, capsys):
    assert run(["new", "a", "--length", "150", "--base-d", "12"]) == 0
    capsys.readouterr()
    assert run(["predict", "designs/a.toml"]) == 0
    assert len(capsys.readouterr().out.splitlines()) <= 40  # a terminal shows 24 to 50 lines
    assert run(["deploy", "designs/a.toml"]) == 0
    capsys.readouterr()
    frozen = "exports/a/a.probe.json"
    assert run(["live", frozen, "--source", "sim:?speed=max&rate_hz=2", "--json"]) == 0
    rows = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    located = [row for row in rows if row["result"] == "ok"]
    assert len(located) > 10
    # Six standard deviations of some thirty estimates: one in ten million fails by chance.
    assert all(abs(r["s_contact_mm"] - r["true_s_contact_mm"]) < 6.0 * r["std_s_mm"] for r in located)
    prediction = json.loads((workplace / "exports/a/prediction.json").read_text())
    assert prediction["fingerprint"] == json.loads((workplace / frozen).read_text())["fingerprint"]


def test_options_of_the_estimator_change_its_priors(workplace):
    """An exact model still drifts: a reading that the drift alone explains must not be located."""
    model = build_probe(load_design(LARGE)).model
    estimator = EstimatorOptions(exact_model=True, friction=0.0).load(deploy_model(model, workplace))
    assert estimator.model.friction == 0.0
    assert estimator.priors.youngs_modulus == 0.0 and estimator.priors.drift_steps > 0.0


def test_deploy_replaces_frozen_probes_only(workplace, capsys):
    assert run(["new", "a", "--length", "150", "--base-d", "12"]) == 0
    before = (workplace / "designs/a.toml").read_bytes()
    assert run(["deploy", "designs/a.toml", "--out", "designs/a.toml"]) == 2
    assert (workplace / "designs/a.toml").read_bytes() == before
    assert run(["deploy", "designs/a.toml", "--out", "a.probe.json"]) == 0
    assert run(["deploy", "designs/a.toml", "--out", "a.probe.json"]) == 0  # a frozen probe
    for _ in range(2):  # a new folder, and one that exists
        assert run(["deploy", "designs/a.toml", "--out", "dep"]) == 0
        assert [file.name for file in Path("dep").iterdir()] == ["a.probe.json"]


def test_demo_does_not_replace_an_edited_design(workplace, capsys):
    folder = workplace / "d"
    folder.mkdir()
    drafted = new("demo", length_mm=120.0, base_d_mm=12.0)
    edited = render_design(drafted, notes_of(drafted))
    (folder / "demo.toml").write_text(edited)
    assert run(["demo", "--out", "d"]) == 2
    assert "--force" in capsys.readouterr().err
    assert [p.name for p in folder.iterdir()] == ["demo.toml"]
    assert (folder / "demo.toml").read_text() == edited


def test_predict_reports_a_probe_that_buckles_under_gravity(workplace, capsys):
    assert run(list(SOFT)) == 0
    design = workplace / "designs/soft.toml"
    design.write_text(design.read_text().replace("[9.81, 0.0, 0.0]", "[0.0, 0.0, -9.81]"))
    assert run(["predict", "designs/soft.toml"]) == 0
    captured = capsys.readouterr()
    assert "no stable equilibrium" in captured.out and captured.err == ""
    document = json.loads((workplace / "exports/soft/prediction.json").read_text())
    assert document["tip_sag_mm"] is None
    assert {c["result"] for c in document["conditions"]} == {"gives_way"}


def test_rigid_root_as_long_as_the_probe_is_refused_with_key_and_line(workplace, capsys):
    assert run(["new", "a", "--length", "5", "--base-d", "8"]) == 0
    design = workplace / "designs/a.toml"
    design.write_text(design.read_text().replace("hold =", "root_rigid_radii = 2.0\nhold ="))
    assert run(["predict", "designs/a.toml"]) == 2
    error = capsys.readouterr().err
    assert "mount.root_rigid_radii" in error and "designs/a.toml:" in error


def test_the_demo_page_is_there_at_once_and_ends_complete(workplace, monkeypatch, capsys):
    """CAD and the card house are replaced: their own tests run them."""
    monkeypatch.setattr(demo, "_begin_parts", lambda design, folder, skipped: skipped.append("parts: left out"))
    monkeypatch.setattr(
        demo, "_explore", lambda bundle, folder, skipped: skipped.append("explore: left out") or ([], "")
    )
    pages = []
    result = demo.run_demo(workplace / "d", False, lambda _: pages.append((workplace / "d/index.html").read_text()))
    assert 'http-equiv="refresh"' in pages[0] and "being made" in pages[0]
    page = (workplace / "d/index.html").read_text()
    assert 'http-equiv="refresh"' not in page and "being made" not in page and 'id="replay"' in page
    assert len(result["skipped"]) == 2 and all(escape(reason) in page for reason in result["skipped"])
    for file in re.findall(r'(?:href|src)="([^"]+)"', page):
        assert (workplace / "d" / file).exists()
