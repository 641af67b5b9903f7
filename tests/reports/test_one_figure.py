"""The error of fused touches is one figure with one name, on every page and in every command that shows it."""

import pytest

from probedesign.design.io import load_design
from probedesign.optimization.objective import Task
from probedesign.prediction.predict import fused_headline
from probedesign.probe import build_probe
from probedesign.reports.comparison_page import compare, comparison_table
from probedesign.studio.figures import complete


def test_predict_studio_and_compare_show_the_same_error_of_fused_touches():
    """It is that of the worst direction."""
    design = load_design("small")
    table = comparison_table(compare([design, load_design("medium")], Task(touches=1, fractions=(0.8,))))
    figures = complete(design)
    shown = figures.prediction.fused_headline
    # With fewer positions and forces the solver begins elsewhere: equal within its tolerance.
    assert fused_headline(build_probe(design).model).predicted_error_mm == pytest.approx(
        shown.predicted_error_mm, rel=1e-5
    )
    here = [c.predicted_error_mm for c in figures.prediction.fused
            if (c.contact_fraction, c.force_N) == (shown.contact_fraction, shown.force_N)]  # fmt: skip
    assert len(here) == 3 and shown.predicted_error_mm == max(here)
    (row,) = [row for row in figures.summary() if row.name == shown.label]
    assert row.value == shown.predicted_error_mm
    (cells,) = [row for row in table.rows if shown.label in row[0]]
    assert float(cells[1]) == pytest.approx(shown.predicted_error_mm, rel=5e-3)  # of three digits
