"""A row has the estimate in the units that its names state."""

import json
from dataclasses import replace

import numpy as np
import pytest

from probedesign.estimation.estimate import Estimate, FusedEstimate
from probedesign.live.blocks import NO_CONTACT, TrueContact, WrenchReading
from probedesign.live.processing.estimates import (
    COLUMNS,
    WORLD_COLUMNS,
    EstimateUpdate,
    csv_line,
    estimate_row,
    json_line,
    readable_line,
    world_row,
)
from probedesign.live.processing.touches import Contact

P, SURFACE, FORCE = (np.array([0.001, 0.002, 0.003]), np.array([0.004, 0.005, 0.006]), np.array([0.3, 0.0, -0.4]))
COV = np.array([[1.0, 2.0, 3.0], [2.0, 4.0, 5.0], [3.0, 5.0, 6.0]]) * 1e-6
COV_SURFACE = 2.0 * COV
FOUND = Estimate("ok", 0.08, 0.0025, P, SURFACE, FORCE, COV, COV_SURFACE, 0.4, 0.3, 0.75, detection_chi2=123.0)
TRUE = WrenchReading(1700000000.000001, np.zeros(6), np.zeros(3), TrueContact(0.0801, 2.0 * P, FORCE, 3.0 * P))


def test_every_number_in_its_unit():
    """One multiplication and one division round: 1e-15. CSV holds the time to the last bit."""
    values = list(estimate_row(TRUE, FOUND).values())
    assert values[:2] == [1700000000.000001, "ok"]
    lengths = [80.0, 2.5, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
    surface = [2.0, 4.0, 6.0, 8.0, 10.0, 12.0, 0.4, 0.3, 0.75]
    truth = [80.1, 2.0, 4.0, 6.0, 3.0, 6.0, 9.0]
    expected = [*lengths, 0.3, 0.0, -0.4, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 123.0, *surface, np.nan, np.nan, *truth]
    assert values[2:] == pytest.approx(expected, rel=1e-15, nan_ok=True)
    fields = csv_line(estimate_row(TRUE, FOUND)).rstrip("\n").split(",")
    assert len(fields) == len(COLUMNS)
    assert float(fields[0]) == TRUE.time
    assert fields[1:5] == ["ok", "80", "2.5", "1"]


def test_unknown_values_are_empty_or_null():
    reading = WrenchReading(1.0, np.zeros(6), np.zeros(3), NO_CONTACT)
    answer = estimate_row(reading, Estimate("no_contact", detection_chi2=4.0))
    assert csv_line(answer) == "1.0,no_contact" + 17 * "," + ",4" + 11 * "," + "\n"
    document = json.loads(json_line(answer))
    assert [name for name, value in document.items() if value is not None] == ["time_s", "result", "detection_chi2"]
    line = readable_line(EstimateUpdate(reading, Estimate("no_contact")))
    assert line.split() == ["1.00", "s", "no_contact", "true:", "free"]
    assert readable_line(EstimateUpdate(replace(TRUE, time=12.34), FOUND)) == (
        "    12.34 s  ok             s   80.0 ±   2.5 mm  p (   4.0,    5.0,    6.0) mm  F   500.0 mN  true s   80.1 mm"
    )


def test_the_world_in_its_units():
    fused = FusedEstimate("ok", SURFACE, COV_SURFACE, P, COV, 2.0 * P, COV, 0.02, np.array([0.0, 0.05]), rms=1e-3)
    contacts = (Contact(7, 1.0),)
    row = world_row(EstimateUpdate(TRUE, FOUND, "settled", fused, contacts=contacts, time_to_rest=0.25))
    assert tuple(row) == WORLD_COLUMNS
    values = list(row.values())
    assert values[:2] == ["settled", "ok"] and values[14:16] == [7, ""]
    expected = [2.0, 4.0, 6.0, 4.0, 5.0, 6.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
    assert values[2:14] == pytest.approx(expected, rel=1e-15)
    now = [1.0, 2.0, 3.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 0.02, 0.0, 0.05]
    assert values[16:-1] == pytest.approx([2.0, 4.0, 6.0, 8.0, 10.0, 12.0, *now], rel=1e-15)
    assert values[-1] == 0.25


def test_without_a_pose_the_world_is_empty():
    answer = EstimateUpdate(
        TRUE, FOUND, "", FusedEstimate("out_of_range"), stale="pose", contacts=(Contact(1, 0.0, end=0.5),)
    )
    row = json.loads(json_line(world_row(answer)))
    assert {name: value for name, value in row.items() if value is not None} == {
        "phase": "",
        "fused_result": "out_of_range",
        "stale": "pose",
    }
    assert "world: no pose" in readable_line(answer)
