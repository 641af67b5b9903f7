"""Mistakes made in the files of a campaign are named first, and accepted contradictions have bounded intervals."""

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from probedesign.campaigns import read_campaign
from probedesign.design import load_design
from probedesign.estimation.model import ProbeModel
from probedesign.identification.contradiction import MIN_GAIN
from probedesign.identification.design_update import design_changes
from probedesign.identification.identify import data_of, identify
from probedesign.identification.result import Identification
from probedesign.simulation.campaign_folder import make_campaign
from probedesign.simulation.ground_truth import CampaignPlan
from tests.identification.conftest import LARGE, TRUE_E

Row = list[str]


def _edited(folder: Path, target: Path, change: Callable[[Row], Row], frame: str = "sensor") -> Path:
    """Return a copy of a campaign with changed rows of wrenches.csv."""
    shutil.copytree(folder, target)
    head, columns, *rows = (target / "wrenches.csv").read_text().splitlines()
    assert head == "# frame: sensor"
    changed = [",".join(change(row.split(","))) for row in rows]
    (target / "wrenches.csv").write_text("\n".join([f"# frame: {frame}", columns, *changed, ""]))
    return target


def _exchanged(a: str, b: str) -> Callable[[Row], Row]:
    return lambda row: [{a: b, b: a}.get(row[0], row[0]), *row[1:]]


def _opposite_fy(row: Row) -> Row:
    return [*row[:3], str(-float(row[3])), *row[4:]]


MISTAKES: dict[str, tuple[Callable[[Row], Row], str, str, tuple[str, ...]]] = {
    "Fy": (_opposite_fy, "sensor", "sign", ("Fy",)),
    "frame": (lambda row: row, "base", "frame", ("# frame: sensor",)),
}


@pytest.fixture(scope="module")
def small_folder(model: ProbeModel, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Five touches and two hangs, and four touches that are held out."""
    folder = tmp_path_factory.mktemp("small") / "data"
    make_campaign(model, folder, CampaignPlan("stage", 1, hold_out=True))
    return folder


@pytest.fixture(scope="module", params=MISTAKES)
def mistaken(
    request: pytest.FixtureRequest, stage_folder: Path, model: ProbeModel, tmp_path_factory: pytest.TempPathFactory
) -> tuple[str, Identification]:
    """Name of a mistake, and the accepted result of a campaign with it."""
    change, frame, *_ = MISTAKES[request.param]
    folder = _edited(stage_folder, tmp_path_factory.mktemp("mistaken") / "data", change, frame)
    return request.param, identify(data_of(read_campaign(folder), model, 0.0), ("E",), accept=True)


def test_a_mistake_in_the_columns_is_named_first(mistaken: tuple[str, Identification]) -> None:
    name, found = mistaken
    *_, cause, words = MISTAKES[name]
    first = found.likely_causes[0]
    assert found.result == "accepted" and first.name == cause and first.explains
    assert all(word in first.words for word in words) and first.words in found.why
    assert all(one.gain > MIN_GAIN for one in found.likely_causes)
    # the cause that fits anything is the last one where a particular one explains the tests
    assert "probe" not in [one.name for one in found.likely_causes[:-1]]


def test_an_accepted_contradiction_has_a_bounded_interval(mistaken: tuple[str, Identification]) -> None:
    """It contains the truth, is at most as wide as the limit of use, adds up, and can be written."""
    _, found = mistaken
    E = found.of("E")
    assert E is not None and E.low is not None and E.high is not None and E.std is not None
    assert 1e6 * E.low < TRUE_E < 1e6 * E.high and E.relative_std < 0.3
    shares = [one.percent for one in found.shifts if one.of == "E"]
    # what is below 1 % of the variance is not listed: of a dozen sources
    assert np.hypot.reduce(shares) == pytest.approx(100.0 * E.relative_std, rel=0.06)
    changes = {change.key: change.text for change in design_changes(found, load_design(LARGE), "2026-01-31")}
    assert 0.0 < float(changes["stiffness_spread"]) <= 1.0 and 0.0 < float(changes["root_radii"]) <= 1.0


@pytest.mark.parametrize(
    ("campaign", "pair"),
    [
        ("small_folder", ("touch-05", "touch-07")),
        ("small_folder", ("touch-03", "touch-05")),
        ("stage_folder", ("touch-05", "touch-06")),
        ("stage_folder", ("touch-03", "touch-08")),
    ],
)
def test_exchanged_touches_are_named(
    campaign: str, pair: tuple[str, str], model: ProbeModel, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    """Two of five touches may contradict the others, then it is the first cause; or they are outliers with a note."""
    folder = _edited(request.getfixturevalue(campaign), tmp_path / "data", _exchanged(*pair))
    found = identify(data_of(read_campaign(folder), model, 0.0), ("E",))
    assert found.result in ("ok", "inconsistent")
    named = [found.likely_causes[0].words] if found.likely_causes else found.notes
    assert any("exchange" in words and pair[0] in words and pair[1] in words for words in named)
    E = found.of("E")
    if campaign == "stage_folder":
        assert E is not None and E.low is not None and E.high is not None
        assert 1e6 * E.low < TRUE_E < 1e6 * E.high


def test_a_hang_in_another_pose_than_stated_is_named(stage_folder: Path, model: ProbeModel) -> None:
    """The base was turned by 180 degrees about its axis for the last hang; its six pose cells are empty."""
    data = data_of(read_campaign(stage_folder), model, 0.0)
    hang = [one for one in data.tests if one.free][-1]
    turned = model.rod.solve(hang.gravity_base * [-1.0, -1.0, 1.0])
    free = model.rod.solve(hang.gravity_base)
    assert hang.wrench_base is not None
    # as the sensor's frame has it: the weight between base and sensor turns as well, and its bias does not
    in_sensor = model.to_sensor(turned.wrench_base, hang.gravity_base * [-1.0, -1.0, 1.0])
    reading = model.to_base(in_sensor, hang.gravity_base) + hang.wrench_base - free.wrench_base
    tests = tuple(replace(one, wrench_base=reading) if one is hang else one for one in data.tests)
    found = identify(replace(data, tests=tests), ("E",))
    named = [one.words for one in found.likely_causes if one.name == "pose"] or found.notes
    assert any(hang.name in words and "base_rz_world_deg" in words for words in named)


def test_a_contradiction_that_leaves_too_much_uncertainty_gives_no_number(
    mistaken: tuple[str, Identification], stage_folder: Path, model: ProbeModel, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    """With a widened deviation beyond the limit of E nothing is accepted, and the reason states both."""
    from probedesign.identification import identify as module

    name, accepted = mistaken
    change, frame, *_ = MISTAKES[name]
    monkeypatch.setattr(module, "likely_causes", lambda *_: list(accepted.likely_causes))  # of the same files
    widened = module.widened
    monkeypatch.setattr(module, "widened", lambda fit, causes: replace(
        widened(fit, causes), widened=100.0 * widened(fit, causes).widened))  # fmt: skip
    folder = _edited(stage_folder, tmp_path / "data", change, frame)
    found = identify(data_of(read_campaign(folder), model, 0.0), ("E",), accept=True)
    assert found.result == "inconsistent" and found.of("E") is None and "limit 30%" in found.why
    assert {one.result for one in found.found} == {"withheld"}


def test_a_touch_without_its_place_is_noted(stage_folder: Path, model: ProbeModel, tmp_path: Path) -> None:
    """`plan` writes s_contact_mm and std_contact_mm beforehand; the place itself was not filled in."""
    folder = shutil.copytree(stage_folder, tmp_path / "data")
    head, *rows = (folder / "tests.csv").read_text().splitlines()
    at = [head.split(",").index(f"contact_{axis}_world_mm") for axis in "xyz"]
    cells = [row.split(",") for row in rows]
    for row in cells:
        if row[0] == "touch-04":
            for i in at:
                row[i] = ""
    (folder / "tests.csv").write_text("\n".join([head, *map(",".join, cells), ""]))
    notes = data_of(read_campaign(folder), model, 0.0).notes
    assert any(note.startswith("touch-04: ") and "s_contact_mm" in note for note in notes)
    assert not any(note.startswith("touch-03") for note in notes)
