"""The commands one after the other, as a laboratory types them: what they leave, and what they never touch."""

import json

import pytest

from probedesign.cli.main import run
from probedesign.design_file import draft_design, render_design

SOFT = ("new", "soft", "--length", "400", "--base-d", "0.3")
"""So slender that it cannot stand, not even horizontally within its own length."""


@pytest.fixture
def workplace(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_design_predict_deploy_and_live(workplace, capsys):
    assert run(["new", "a", "--length", "150", "--base-d", "12"]) == 0
    assert run(["predict", "designs/a.toml", "--no-plots"]) == 0
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


def test_deploy_never_replaces_what_is_no_frozen_probe(workplace, capsys):
    assert run(["new", "a", "--length", "150", "--base-d", "12"]) == 0
    before = (workplace / "designs/a.toml").read_bytes()
    assert run(["deploy", "designs/a.toml", "--out", "designs/a.toml"]) == 2
    assert (workplace / "designs/a.toml").read_bytes() == before
    assert run(["deploy", "designs/a.toml", "--out", "a.probe.json"]) == 0
    assert run(["deploy", "designs/a.toml", "--out", "a.probe.json"]) == 0  # its own it may


def test_the_demo_leaves_an_edited_design_alone(workplace, capsys):
    folder = workplace / "d"
    folder.mkdir()
    edited = render_design(*draft_design("demo", shape="cone", length_mm=120.0, base_d_mm=12.0))
    (folder / "demo.toml").write_text(edited)
    assert run(["demo", "--out", "d"]) == 2
    assert "--force" in capsys.readouterr().err
    assert [p.name for p in folder.iterdir()] == ["demo.toml"]
    assert (folder / "demo.toml").read_text() == edited


def test_a_probe_that_cannot_stand_is_told_so(workplace, capsys):
    assert run(list(SOFT)) == 0
    design = workplace / "designs/soft.toml"
    design.write_text(design.read_text().replace("[9.81, 0.0, 0.0]", "[0.0, 0.0, -9.81]"))
    assert run(["predict", "designs/soft.toml"]) == 0
    told = capsys.readouterr()
    assert "cannot stand" in told.out and told.err == ""
    document = json.loads((workplace / "exports/soft/prediction.json").read_text())
    assert document["tip_sag_mm"] is None
    assert {c["result"] for c in document["conditions"]} == {"gives_way"}


def test_a_root_as_long_as_the_probe_is_refused_where_it_is_written(workplace, capsys):
    assert run(["new", "a", "--length", "5", "--base-d", "8"]) == 0
    design = workplace / "designs/a.toml"
    design.write_text(design.read_text().replace("root_rigid_radii = 0.12", "root_rigid_radii = 2.0"))
    assert run(["predict", "designs/a.toml", "--no-plots"]) == 2
    told = capsys.readouterr().err
    assert "mount.root_rigid_radii" in told and "designs/a.toml:" in told
