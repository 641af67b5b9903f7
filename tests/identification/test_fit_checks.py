"""Gross errors in a kind of reading, a test, a prior or a single reading make the result inconsistent."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from probedesign.campaigns import Campaign
from probedesign.core.errors import InputError
from probedesign.estimation.model import ProbeModel
from probedesign.identification.fit_checks import Contradiction, OutlierCount, check_priors
from probedesign.identification.identify import IdentificationData, data_of, identify
from probedesign.identification.residuals import MeasuredTest
from probedesign.identification.result import Identification
from probedesign.identification.solver import LeastSquaresProblem, chi2_words, fit, start_point


def _with(data: IdentificationData, change: Callable[[MeasuredTest], MeasuredTest]) -> Identification:
    common = replace(data.common, frame="base")  # wrenches are changed about the base, as if written so
    return identify(replace(data, common=common, tests=tuple(map(change, data.tests))), ("E",))


def _turned(trial: MeasuredTest) -> MeasuredTest:
    """The base turned by -90 degrees about world y in campaign.toml."""
    T = trial.T_world_base.copy()
    T[:3, :3] = [[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]
    return replace(trial, T_world_base=T)


def _in_mn(trial: MeasuredTest) -> MeasuredTest:
    """Forces in mN in columns of N."""
    assert trial.wrench_base is not None
    return replace(trial, wrench_base=trial.wrench_base * [1e3, 1e3, 1e3, 1.0, 1.0, 1.0])


def _in_metres(trial: MeasuredTest) -> MeasuredTest:
    return trial if trial.p_touch_world is None else replace(trial, p_touch_world=1e-3 * trial.p_touch_world)


@pytest.mark.parametrize("mistake", [_turned, _in_metres])
def test_a_kind_with_only_gross_errors_is_inconsistent(
    mistake: Callable[[MeasuredTest], MeasuredTest], stage: Campaign, model: ProbeModel
) -> None:
    data = data_of(stage, model, 0.0)
    result = _with(replace(data, tests=data.tests[::2]), mistake)
    assert result.result == "inconsistent" and result.why and "\n" not in result.why and result.likely_causes
    assert result.of("E") is None and result.found[0].std is None and not result.shifts


def test_forces_in_millinewtons_are_refused(stage: Campaign, model: ProbeModel) -> None:
    """The probe buckles under touches a thousand times as strong, so there is no fit to explain."""
    with pytest.raises(InputError, match=r"buckles in 9 of 11 tests for any E; .*are forces in their"):
        _with(data_of(stage, model, 0.0), _in_mn)


def test_a_test_with_markers_numbered_one_too_high_is_left_out(cameras: Campaign, model: ProbeModel) -> None:
    data = data_of(cameras, model, 0.0)
    name = next(t.name for t in data.tests if t.touched and len(t.marker_s) > 10)

    def renumbered(t: MeasuredTest) -> MeasuredTest:
        if t.name != name:
            return t
        return replace(t, marker_s=t.marker_s[1:], marker_numbers=t.marker_numbers[1:],
                       p_markers_world=t.p_markers_world[:-1], cov_markers=t.cov_markers[:-1])  # fmt: skip

    result = _with(data, renumbered)
    E = result.of("E")
    assert result.result == "ok" and E is not None
    assert any(note.startswith(f"{name}: left out") for note in result.notes)
    assert result.tests == len(data.tests) - 1


def test_one_wrong_place_among_nine_is_an_outlier(stage: Campaign, model: ProbeModel) -> None:
    data = data_of(stage, model, 0.0)
    wrong = next(t.name for t in data.tests if t.p_touch_world is not None and not t.free)
    result = _with(data, lambda t: _in_metres(t) if t.name == wrong else t)
    assert result.result == "ok" and result.of("E") is not None
    assert result.outliers[0].test == wrong


@pytest.mark.parametrize(
    ("off", "count", "too_many"),
    [(0, 9, False), (3, 9, False), (4, 9, True), (1, 1, True), (1, 2, False), (2, 3, True), (25, 500, False),
     (42, 500, True)],
)  # fmt: skip
def test_number_of_outliers_that_is_too_many(off: int, count: int, too_many: bool) -> None:
    """Chances of a binomial with 5 %: P(4 or more of 9) = 6e-4, P(3 or more) = 8e-3; 25 of 500 is the mean, 42 is 3.5
    standard deviations above. A majority always is."""
    assert OutlierCount(count, off).too_many is too_many


# priors and single readings


@pytest.fixture(scope="module")
def data(cameras: Campaign, model: ProbeModel) -> IdentificationData:
    """The hangs, the weights and three touches, whose markers are enough."""
    data = data_of(cameras, model, 0.0)
    touches = [t.name for t in data.tests if t.touched][::4]
    return replace(data, tests=tuple(t for t in data.tests if t.free or t.name in touches))


def _sag_halved(data: IdentificationData) -> IdentificationData:
    """Return the data with half the sag, known to 0.1 mm."""
    sag = next(t for t in data.tests if np.isfinite(t.sag))
    wrong = replace(sag, sag=0.5 * sag.sag, std_sag=1e-4)
    return replace(data, tests=tuple(wrong if t is sag else t for t in data.tests))


def _too_light(data: IdentificationData) -> IdentificationData:
    """Return the data with a fifth less mass, which no tolerance of the diameters explains."""
    assert data.mass is not None
    return replace(data, mass=replace(data.mass, mass=0.8 * data.mass.mass, std=1e-5))


def _base_moved(data: IdentificationData) -> IdentificationData:
    """Return the data with the base moved by 5 mm; 0.2 mm is its standard deviation."""

    def moved(T: np.ndarray) -> np.ndarray:
        T = T.copy()
        T[:3, 3] += [0.0, 5e-3, 0.0]
        return T

    return replace(data, tests=tuple(replace(t, T_world_base=moved(t.T_world_base)) for t in data.tests))


@pytest.mark.parametrize(("wrong", "label"), [(_sag_halved, "the sag of hang-1"), (_too_light, "design density")])
def test_a_gross_error_with_full_weight_is_rejected(
    data: IdentificationData, wrong: Callable[[IdentificationData], IdentificationData], label: str
) -> None:
    result = identify(wrong(data), ("E",))
    assert result.result == "inconsistent" and result.of("E") is None
    assert label in result.why or any(label in cause.words for cause in result.likely_causes)


def test_a_contradiction_that_moves_no_requested_number_is_a_warning(cameras: Campaign, model: ProbeModel) -> None:
    """The markers of all touches show where the base is, so E is as without the error."""
    data = data_of(cameras, model, 0.0)
    clean, wrong = identify(data, ("E",)).of("E"), _base_moved(data)
    result = identify(wrong, ("E",))
    E = result.of("E")
    assert result.result == "ok" and not result.why and E is not None and clean is not None and E.std is not None
    assert abs(E.value - clean.value) < 0.5 * E.std  # the limit of the move
    assert E.std > 0.95 * clean.std  # nothing is gained by leaving out
    warning, *_, farthest = result.notes
    assert warning.startswith("warning: position of the base: ") and "3 degrees of freedom, probability" in warning
    assert farthest.startswith("farthest from the fit: ") and "degrees of freedom, probability" in farthest


def test_chi2_is_stated_with_its_degrees_of_freedom_and_probability() -> None:
    """The norm of 134 directions that are off by one standard deviation each is 11.6, and no contradiction."""
    assert chi2_words(11.6**2, 134) == "χ² 135 of 134 degrees of freedom, probability 0.5"
    assert chi2_words(11.6**2, 1) == "χ² 135 of 1 degree of freedom, probability 4e-31"


def test_priors_are_rejected_by_their_residual_variance(data: IdentificationData) -> None:
    """The position of the base is shifted by a given number of its standard deviations. Markers measure it far better
    than it is stated, so nearly all of its unit variance is left: two are accepted, nine are rejected."""
    problem = LeastSquaresProblem(data.common, data.tests, data.mass, data.common.prior_without(("E",)))

    def shifted(deviations: float) -> list[Contradiction]:
        off = np.array([0.0, deviations * data.common.std_base, 0.0])
        trials = []
        for trial in data.tests:
            T = trial.T_world_base.copy()
            T[:3, 3] -= off
            trials.append(replace(trial, T_world_base=T))
        moved = replace(problem, tests=tuple(trials))
        begun = start_point(moved, True)
        assert begun is not None
        return check_priors(fit(begun))

    assert not shifted(2.0)
    assert shifted(9.0)[0].label == "position of the base"
