"""Mistakes of a laboratory that leave out a whole kind of reading, or a test, are no result."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from probedesign.campaign import Campaign
from probedesign.errors import InputError
from probedesign.estimation.model import ProbeModel
from probedesign.identification.consistency import Share
from probedesign.identification.identify import Data, data_of, identify
from probedesign.identification.result import Identification
from probedesign.identification.trial import Trial


def _with(data: Data, change: Callable[[Trial], Trial]) -> Identification:
    return identify(replace(data, trials=tuple(change(trial) for trial in data.trials)), ("E",))


def _assert_nothing_claimed(found: Identification, *said: str) -> None:
    assert found.result == "inconsistent"
    assert all(words in found.why for words in said) and "\n" not in found.why
    assert found.of("E") is None and found.found[0].std is None and not found.shifts
    assert any("hardly count" in note for note in found.notes)


def _turned(trial: Trial) -> Trial:
    """The base turned by -90 degrees about world y in campaign.toml."""
    T = trial.T_world_base.copy()
    T[:3, :3] = [[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]
    return replace(trial, T_world_base=T)


def _in_nmm(trial: Trial) -> Trial:
    """Moments in N mm in columns of N m."""
    assert trial.wrench_base is not None
    return replace(trial, wrench_base=trial.wrench_base * [1.0, 1.0, 1.0, 1e3, 1e3, 1e3])


def _in_mn(trial: Trial) -> Trial:
    """Forces in mN in columns of N."""
    assert trial.wrench_base is not None
    return replace(trial, wrench_base=trial.wrench_base * [1e3, 1e3, 1e3, 1.0, 1.0, 1.0])


def _in_metres(trial: Trial) -> Trial:
    return trial if trial.p_touch_world is None else replace(trial, p_touch_world=1e-3 * trial.p_touch_world)


@pytest.mark.parametrize(
    ("mistake", "kind", "look"),
    [
        (_turned, "places touched: 9 of 9", "the base's rotation in campaign.toml"),
        (_in_nmm, "wrenches: 11 of 11", "the units of the force and of the moment columns"),
        (_in_metres, "places touched: 9 of 9", "the unit of the contact columns"),
    ],
)
def test_a_kind_that_is_all_wrong(
    mistake: Callable[[Trial], Trial], kind: str, look: str, stage: Campaign, model: ProbeModel
) -> None:
    _assert_nothing_claimed(_with(data_of(stage, model, 0.0), mistake), kind, look)


def test_forces_in_millinewtons(stage: Campaign, model: ProbeModel) -> None:
    """The probe gives way under touches a thousand times as strong."""
    with pytest.raises(InputError, match=r"gives way .* are forces in their column's unit"):
        _with(data_of(stage, model, 0.0), _in_mn)


def test_markers_of_one_test_numbered_one_too_high(cameras: Campaign, model: ProbeModel) -> None:
    data = data_of(cameras, model, 0.0)
    name = next(t.name for t in data.trials if t.touched and len(t.marker_s) > 10)

    def renumbered(t: Trial) -> Trial:
        if t.name != name:
            return t
        return replace(t, marker_s=t.marker_s[1:], marker_numbers=t.marker_numbers[1:],
                       p_markers_world=t.p_markers_world[:-1], cov_markers=t.cov_markers[:-1])  # fmt: skip

    _assert_nothing_claimed(_with(data, renumbered), name, "how its markers are numbered")


def test_one_wrong_place_among_nine_passes(stage: Campaign, model: ProbeModel) -> None:
    data = data_of(stage, model, 0.0)
    wrong = next(t.name for t in data.trials if t.p_touch_world is not None and not t.free)
    found = _with(data, lambda t: _in_metres(t) if t.name == wrong else t)
    assert found.result == "ok" and found.of("E") is not None
    assert found.outliers[0].test == wrong


@pytest.mark.parametrize(
    ("off", "count", "too_many"),
    [
        (0, 9, False),
        (3, 9, False),
        (4, 9, True),
        (1, 1, True),
        (1, 2, False),
        (25, 500, False),
        (42, 500, True),
    ],
)
def test_how_many_are_too_many(off: int, count: int, too_many: bool) -> None:
    """Chances of a binomial with 5 %: P(4 or more of 9) = 6e-4, P(3 or more) = 8e-3; 25 of 500 is the mean, 42 is 3.5
    standard deviations above."""
    assert Share(count, off, 5.0).too_many is too_many


def test_share_of_gross_errors_is_below_the_breakdown_of_the_median() -> None:
    counts = np.arange(3, 400)
    assert all(Share(int(n), int(n) // 2 + 1, 5.0).too_many for n in counts)
