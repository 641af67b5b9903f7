"""The page of a sweep: every design is drawn, the best one is marked and named."""

import itertools
import re

import pytest

from probedesign.optimization.objective import METRICS
from probedesign.reports.sweep_page import sweep_page, verdict


def grid(points):
    """Return records whose error is the distance from the middle of the grid; the first design buckles."""
    records = []
    for number, values in enumerate(points):
        error = 1.0 + sum((v - 2.0) ** 2 for v in values)
        point = {f"probe.k{i}": v for i, v in enumerate(values)}
        metrics = dict.fromkeys(METRICS, 1.0) | {"error_mm": error}
        records.append({"point": number, **point, "result": "ok", "reason": "", **metrics})
    records[0] |= {"result": "gives_way", **dict.fromkeys(METRICS)}
    return records


@pytest.mark.parametrize("n", [1, 2, 3])
def test_a_grid_of_any_number_of_keys_has_a_page_with_its_best_design(n):
    records = grid(list(itertools.product((1.0, 2.0, 3.0), repeat=n)))
    keys = [f"probe.k{i}" for i in range(n)]
    page = sweep_page(records, keys, "task").decode()
    assert page.count("<svg") == {1: 4, 2: 1, 3: 3}[n]
    assert all(f"k{i} = 2" in verdict(records, keys) for i in range(n)) and "1 of" in verdict(records, keys)
    if n == 3:
        assert "error_mm, k2 = 2" in page
    if n == 2:  # a cell for each design, the buckled one without a number
        assert len(re.findall("<rect", page)) >= 9 and "buckles" in page


def test_a_grid_without_a_good_design_has_a_page():
    records = [r | {"result": "refused", **dict.fromkeys(METRICS)} for r in grid([(1.0,), (2.0,)])]
    assert "None of 2" in sweep_page(records, ["probe.k0"], "task").decode()
