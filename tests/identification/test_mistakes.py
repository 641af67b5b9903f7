"""Mistakes made in the files of a campaign are named first, and accepted contradictions have bounded intervals."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from probedesign.campaigns import Campaign, read_campaign
from probedesign.design import load_design
from probedesign.estimation.model import ProbeModel
from probedesign.identification.design_update import design_changes
from probedesign.identification.fit_checks import LikelyCause
from probedesign.identification.identify import IdentificationData, data_of, identify
from probedesign.identification.residuals import MeasuredTest
from probedesign.simulation.campaign_folder import make_campaign
from probedesign.simulation.ground_truth import CampaignPlan
from tests.identification.conftest import LARGE, TRUE_E


@pytest.fixture(scope="module")
def half(stage: Campaign, cameras: Campaign, model: ProbeModel) -> dict[str, IdentificationData]:
    """Every second test of each bench, with wrenches about the base, as if written so."""
    benches = {"stage": data_of(stage, model, 0.0), "cameras": data_of(cameras, model, 0.0)}
    return {name: replace(data, tests=data.tests[::2], common=replace(data.common, frame="base"))
            for name, data in benches.items()}  # fmt: skip


def scaled(factors: np.ndarray) -> Callable[[IdentificationData], IdentificationData]:
    def change(test: MeasuredTest) -> MeasuredTest:
        return test if test.wrench_base is None else replace(test, wrench_base=factors * test.wrench_base)

    return lambda data: replace(data, tests=tuple(map(change, data.tests)))


def as_the_sensor_shows(data: IdentificationData) -> IdentificationData:
    def change(test: MeasuredTest) -> MeasuredTest:
        if test.wrench_base is None:
            return test
        return replace(test, wrench_base=data.common.model.to_sensor(test.wrench_base, test.gravity_base))

    return replace(data, tests=tuple(map(change, data.tests)))


def numbered_too_low(data: IdentificationData) -> IdentificationData:
    """Marker 1 was not seen, and the numbers of the others begin with it."""
    tests = tuple(
        replace(test, marker_s=test.marker_s[:-1], marker_numbers=test.marker_numbers[:-1],
                p_markers_world=test.p_markers_world[1:], cov_markers=test.cov_markers[1:])
        if len(test.marker_s) > 1 else test
        for test in data.tests
    )  # fmt: skip
    return replace(data, tests=tests)


def of_opposite_loads(data: IdentificationData) -> IdentificationData:
    def change(test: MeasuredTest) -> MeasuredTest:
        return test if test.force_world is None else replace(test, force_world=-test.force_world)

    return replace(data, tests=tuple(map(change, data.tests)))


def of_another_probe(data: IdentificationData) -> IdentificationData:
    """The cone tapers half as much as drawn, which no factor on E and no column explains."""
    rod = data.common.model.rod
    other = replace(rod, radius=rod.radius * np.interp(rod.s, [0.0, rod.length], [1.25, 0.8]))
    return replace(data, common=replace(data.common, model=replace(data.common.model, rod=other)))


FY = scaled(np.array([1.0, -1.0, 1.0, 1.0, 1.0, 1.0]))


@pytest.mark.parametrize(
    ("bench", "mistake", "name", "words"),
    [
        ("stage", FY, "sign", "Fy with the opposite sign"),
        ("stage", as_the_sensor_shows, "frame", "its values are those of '# frame: sensor'"),
        ("stage", scaled(np.repeat([1.0, 1e3], 3)), "unit", "moments a thousand times too large"),
        ("cameras", numbered_too_low, "marker", "too low by 1"),
        ("cameras", of_opposite_loads, "sign", "known forces with the opposite sign"),
        ("cameras", of_another_probe, "probe", "fingerprint in campaign.toml"),
    ],
)
def test_a_mistake_is_named_first_and_an_accepted_number_is_bounded(
    bench: str, mistake: Callable[[IdentificationData], IdentificationData], name: str, words: str,
    half: dict[str, IdentificationData],
) -> None:  # fmt: skip
    """An accepted E has an interval that contains the truth, at most as wide as the limit of use; its budget adds up,
    and it can be written."""
    result = identify(mistake(half[bench]), ("E",), accept=True)
    first, E = result.likely_causes[0], result.of("E")
    assert first.name == name and words in first.words and first.words in result.why
    assert first.explains or name == "probe"
    assert "farthest from the fit: " in " ".join(result.notes)
    if E is None:
        assert result.result == "inconsistent" and "limit 30%" in result.why and name in ("frame", "unit")
        return
    assert result.result == "accepted" and E.low is not None and E.high is not None and E.relative_std < 0.3
    assert 1e6 * E.low < TRUE_E < 1e6 * E.high or name == "probe"  # E of the other probe is none of this one
    shares = [part.percent for part in result.shifts if part.of == "E"]
    # what is below 1 % of the variance is not listed: of a dozen sources
    assert np.hypot.reduce(shares) == pytest.approx(100.0 * E.relative_std, rel=0.06)
    changes = {change.key: change.text for change in design_changes(result, load_design(LARGE), "2026-01-31")}
    assert 0.0 < float(changes["stiffness_spread"]) <= 1.0 and 0.0 < float(changes["root_radii"]) <= 1.0


@pytest.mark.parametrize("bench", ["stage", "cameras"])
def test_exchanged_touches_are_named(bench: str, model: ProbeModel, request: pytest.FixtureRequest) -> None:
    """Two of a few touches may contradict the others, then it is the first cause; or they are outliers with a note."""
    data = data_of(request.getfixturevalue(bench), model, 0.0)
    a, b = [test for test in data.tests if test.touched][1:5:3]
    other = {a.name: b, b.name: a}
    result = identify(replace(data, tests=tuple(
        replace(test, wrench_base=source.wrench_base, cov_wrench=source.cov_wrench)
        for test in data.tests for source in [other.get(test.name, test)])), ("E",))  # fmt: skip
    assert result.result in ("ok", "inconsistent")
    named = [result.likely_causes[0].words] if result.likely_causes else result.notes
    assert any("exchange" in words and a.name in words and b.name in words for words in named)
    E = result.of("E")
    assert E is not None or bench == "cameras"
    assert E is None or (E.low is not None and E.high is not None and 1e6 * E.low < TRUE_E < 1e6 * E.high)


def test_planes_of_bending_that_differ_are_named(stage: Campaign, model: ProbeModel, tmp_path: Path) -> None:
    """Touches along y are of a print that is 1.3 times as stiff; the stiffness of a test has 2 %."""
    plan = CampaignPlan("stage", 5, 1.3 * TRUE_E, None, None, 5, True)
    make_campaign(model, tmp_path / "stiffer", plan)
    stiffer = {test.name: test for test in data_of(read_campaign(tmp_path / "stiffer"), model, 0.0).tests}
    along_y = {test.name for test in stage.tests if test.direction in ("+y", "-y")}
    assert along_y
    data = data_of(stage, model, 0.0)
    tests = tuple(stiffer[test.name] if test.name in along_y else test for test in data.tests)
    result = identify(replace(data, tests=tests), ("E",))
    words = next(cause.words for cause in result.likely_causes if cause.name == "planes")
    ratio = float(words.split(" is ")[1].split()[0])
    assert abs(np.log(1.3 * ratio)) < 4.0 * 0.02  # four standard deviations of a mean of a few tests
    assert "planes of bending differ" in " ".join([result.why, *map(str, result.likely_causes), *result.notes])


def test_a_contradiction_that_leaves_too_much_uncertainty_gives_no_number(
    half: dict[str, IdentificationData], monkeypatch: pytest.MonkeyPatch
) -> None:
    """With a widened deviation beyond the limit of E nothing is accepted, and the reason states both."""
    from probedesign.identification import identify as module

    monkeypatch.setattr(module, "likely_causes", lambda *_: (LikelyCause("sign", "Fy", "", True),))
    monkeypatch.setattr(module, "widened", lambda fit, moves: replace(fit, added_cov=1e4 * fit.cov))
    result = identify(FY(half["stage"]), ("E",), accept=True)
    assert result.result == "inconsistent" and result.of("E") is None and "limit 30%" in result.why
    assert {number.result for number in result.found} == {"withheld"}


def test_a_touch_without_its_place_is_noted(stage: Campaign, model: ProbeModel) -> None:
    """`plan` writes s_contact_mm and std_contact_mm beforehand; the place itself was not filled in."""
    tests = tuple(replace(test, p_contact_world=None) if test.name == "touch-04" else test for test in stage.tests)
    notes = data_of(replace(stage, tests=tests), model, 0.0).notes
    assert any(note.startswith("touch-04: ") and "s_contact_mm" in note for note in notes)
    assert not any(note.startswith("touch-03") for note in notes)
