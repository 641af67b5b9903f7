"""Tests that served an identification: they are known by their readings, and do not count for the verdict."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from probedesign import build_probe, data_of, identify, load_design
from probedesign.campaigns import read_campaign
from probedesign.cli.main import run
from probedesign.core.errors import InputError
from probedesign.estimation.estimator import Estimator
from probedesign.simulation.campaign_folder import make_campaign
from probedesign.simulation.ground_truth import CampaignPlan
from probedesign.validation.validate import coverage_of, touches_needed, validate

DESIGNS = Path(__file__).parents[2] / "designs"


@pytest.fixture(scope="module")
def small():
    return build_probe(load_design("small")).model


@pytest.fixture(scope="module")
def folder(small, tmp_path_factory):
    plan = CampaignPlan("stage", 2, hold_out=True)
    return make_campaign(small, tmp_path_factory.mktemp("data") / "small", plan).folder


def test_a_test_is_known_by_its_readings(folder, tmp_path):
    """Another name, another unit and another order do not change it; another reading does."""
    tests = read_campaign(folder).tests
    assert len({test.digest for test in tests}) == len(tests)
    first = tests[1]
    assert replace(first, name="other", s_contact=0.01).digest == first.digest
    moved = first.wrenches.copy()
    moved[0, 0] += 1e-4
    assert replace(first, wrenches=moved).digest != first.digest
    none = replace(first, wrenches=np.zeros((0, 6)))
    assert replace(none, s_contact=none.s_contact + 1e-3).digest != none.digest
    rows = (folder / "wrenches.csv").read_text().splitlines()
    for path in folder.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    values = [row.split(",") for row in rows[2:]]
    in_mN = [[*row[:2], *(f"{1e3 * float(v):.8g}" for v in row[2:5]), *row[5:]] for row in values]
    header = rows[1].replace("Fx_N,Fy_N,Fz_N", "Fx_mN,Fy_mN,Fz_mN")
    (tmp_path / "wrenches.csv").write_text("\n".join([rows[0], header, *map(",".join, in_mN)]) + "\n")
    assert [test.digest for test in read_campaign(tmp_path).tests] == [test.digest for test in tests]


def test_identify_leaves_out_what_is_for_validate(folder):
    campaign = read_campaign(folder)
    held_out = {test.name for test in campaign.tests if test.use == "validate"}
    assert held_out == {"touch-02", "touch-04", "touch-06"}
    found = identify(data_of(campaign, build_probe(load_design("small")).model, 0.0), ("E",))
    assert not held_out & {one.test for one in found.residuals}
    assert set(found.served) == {test.digest for test in campaign.tests if test.name not in held_out}


def test_tests_that_served_are_listed_and_not_judged(small, folder):
    campaign = read_campaign(folder)
    served = tuple(test.digest for test in campaign.tests if test.use != "validate")
    probe = Estimator(replace(small, identified_tests=served))
    found, every = validate(probe, campaign), validate(probe, campaign, include_identified=True)
    assert len(found.tests) == len(every.tests) == len(campaign.tests)
    assert found.coverage.touches <= 3 < every.coverage.touches
    assert sum(not row["held_out"] for row in found.rows()) == len(served)
    assert every.coverage == coverage_of(every.tests, False) and found.coverage != every.coverage
    assert found.summary["touch"]["contact_error_mm"].count <= 3
    assert any("served the identification" in note for note in found.notes)
    all_served = Estimator(replace(small, identified_tests=tuple(test.digest for test in campaign.tests)))
    assert validate(all_served, campaign).coverage.verdict == "not_judged"
    assert not any(one.served for one in validate(Estimator(small), campaign).tests)


def test_the_intervals_of_coverage_and_ratio_have_their_width():
    """Of touches with correct covariances the 95 % interval of the ratio misses 1 in one of twenty draws."""
    rng = np.random.default_rng(1)
    missed = 0
    draws, touches = 200, 20
    for _ in range(draws):
        errors = [_Error(float(value)) for value in rng.chisquare(3, size=touches)]
        found = coverage_of([_Touch(error) for error in errors], False)
        missed += not found.ratio_low <= 1.0 <= found.ratio_high
        assert found.ratio_low < found.nees_ratio < found.ratio_high
        assert (found.verdict == "too_small") == (found.ratio_low > 1.0 or found.high < 0.95)
    assert missed / draws < 0.05 + 0.062  # four standard deviations


@pytest.mark.parametrize(("larger", "needed"), [(1.5, 20), (2.0, 8)])
def test_the_number_of_touches_needed_notices_errors_that_are_larger(larger, needed):
    """That many touches give the verdict "too_small" in 95 % of draws, half as many do not, and it is rarely wrong."""
    n = touches_needed(larger, 3)
    assert n == needed
    rng, draws = np.random.default_rng(2), 80

    def too_small(touches, factor):
        squares = factor**2 * rng.chisquare(3, size=(draws, touches))
        found = (coverage_of([_Touch(_Error(float(one))) for one in row], False) for row in squares)
        return sum(one.verdict == "too_small" for one in found) / draws

    assert too_small(n, larger) > 0.95 - 4.0 * np.sqrt(0.95 * 0.05 / draws)  # four standard deviations
    assert too_small(n // 2, larger) < 0.9
    assert too_small(n, 1.0) < 0.05 + 4.0 * np.sqrt(0.95 * 0.05 / draws)  # 2.5 % by each of the two intervals


class _Error:
    dof = 3

    def __init__(self, nees):
        self.nees, self.within_95, self.z = nees, nees <= 7.815, np.full(3, np.sqrt(nees / 3.0))


class _Touch:
    kind, measured = "touch", True

    def __init__(self, error):
        self.contact_error = error


def test_from_identify_to_validate_by_the_commands(folder, tmp_path, monkeypatch, capsys):
    """The list goes through design and frozen probe; a second identification of another number keeps it."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "small.toml").write_bytes((DESIGNS / "small.toml").read_bytes())
    assert run(["identify", "small.toml", str(folder), "--for", "E", "--out", "found.toml"]) == 0
    served = load_design(tmp_path / "found.toml").material.identified_tests
    assert len(served) == 6  # two hangs, four touches
    assert run(["deploy", "found.toml", "--out", "found.probe.json"]) == 0
    assert json.loads((tmp_path / "found.probe.json").read_text())["identified_tests"] == list(served)
    capsys.readouterr()
    assert run(["validate", "found.probe.json", str(folder), "--json", "--out", "v"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["coverage"]["touches"] <= 3 and document["verdict"] == document["coverage"]["verdict"]
    held_out = {row["test"] for row in document["tests"] if row["kind"] == "touch" and row["held_out"]}
    assert held_out == {"touch-02", "touch-04", "touch-06"}


@pytest.mark.parametrize("value", ["both", "Validate", "1"])
def test_an_unknown_use_is_refused(folder, tmp_path, value):
    for path in folder.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    text = (tmp_path / "tests.csv").read_text().replace("validate", value, 1)
    (tmp_path / "tests.csv").write_text(text)
    with pytest.raises(InputError, match="use = "):
        read_campaign(tmp_path)
