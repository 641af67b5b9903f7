"""The error of fused touches is one figure with one name, on every page and in every command that shows it."""

import json

import pytest

from probedesign.cli.main import run
from probedesign.design.io import load_design
from probedesign.optimization.objective import Task
from probedesign.prediction.predict import fused_headline
from probedesign.probe import build_probe
from probedesign.reports.comparison_page import compare, comparison_table
from probedesign.studio.figures import complete


def test_predict_studio_and_compare_show_the_same_error_of_fused_touches():
    designs = [load_design(name) for name in ("small", "medium")]
    table = comparison_table(compare(designs, Task(touches=1, fractions=(0.8,))))
    for i, design in enumerate(designs):
        # With fewer positions and forces the solver begins elsewhere: equal within its tolerance.
        headline = fused_headline(build_probe(design).model)
        figures = complete(design)
        assert headline.predicted_error_mm == pytest.approx(
            figures.prediction.fused_headline.predicted_error_mm, rel=1e-5
        )
        (shown,) = [row for row in figures.summary() if row.name == headline.label]
        assert shown.value == figures.prediction.fused_headline.predicted_error_mm
        (row,) = [row for row in table.rows if headline.label in row[0]]
        assert float(row[1 + i]) == pytest.approx(headline.predicted_error_mm, rel=5e-3)  # of three digits


def test_the_headline_is_the_worst_direction_of_the_table(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run(["new", "a", "--length", "60", "--base-d", "6"]) == 0
    capsys.readouterr()
    assert run(["predict", "designs/a.toml", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    headline = found["fused_headline"]
    here = [
        c["predicted_error_mm"]
        for c in found["fused"]
        if c["contact_fraction"] == headline["contact_fraction"] and c["force_N"] == headline["force_N"]
    ]
    assert len(here) == 3 and headline["predicted_error_mm"] == max(here)
