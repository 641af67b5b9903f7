"""What was stated beforehand is trusted; where all the rest disproves it, nothing is claimed."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from probedesign.campaign import Campaign
from probedesign.estimation.model import ProbeModel
from probedesign.identification.beforehand import disproved
from probedesign.identification.identify import Data, data_of, identify
from probedesign.identification.robust import DOUBTED
from probedesign.identification.solver import Problem, fit
from probedesign.identification.start import first_point


@pytest.fixture(scope="module")
def data(cameras: Campaign, model: ProbeModel) -> Data:
    return data_of(cameras, model, 0.0)


def _sag_halved(data: Data) -> Data:
    """To 0.1 mm."""
    sag = next(t for t in data.trials if np.isfinite(t.sag))
    wrong = replace(sag, sag=0.5 * sag.sag, std_sag=1e-4)
    return replace(data, trials=tuple(wrong if t is sag else t for t in data.trials))


def _too_light(data: Data) -> Data:
    """By a fifth, which no tolerance of the diameters allows for."""
    assert data.weighed is not None
    return replace(data, weighed=replace(data.weighed, mass=0.8 * data.weighed.mass, std=1e-5))


def _base_moved(data: Data) -> Data:
    """By 5 mm, of 0.2 stated."""

    def moved(T: np.ndarray) -> np.ndarray:
        T = T.copy()
        T[:3, 3] += [0.0, 5e-3, 0.0]
        return T

    return replace(data, trials=tuple(replace(t, T_world_base=moved(t.T_world_base)) for t in data.trials))


@pytest.mark.parametrize(("wrong", "said"), [(_sag_halved, "the sag of hang-1"), (_too_light, "the weighing"),
                                             (_base_moved, "the base's place")])  # fmt: skip
def test_a_gross_error_in_what_is_trusted(data: Data, wrong: Callable[[Data], Data], said: str) -> None:
    found = identify(wrong(data), ("E",))
    assert found.result == "inconsistent" and found.of("E") is None
    assert said in found.why and "standard deviations off what all the rest says; look at" in found.why


def test_a_prior_is_judged_by_the_noise_that_the_fit_leaves(data: Data) -> None:
    """Shifted by a given number of its standard deviations, the base's place is disproved from where chance allows
    less than `DOUBTED` of the campaigns. Markers tell it far better than it is stated, so what is left of its unit
    variance is nearly all: two are borne, nine are told."""
    problem = Problem(data.shared, data.trials, data.weighed, data.shared.prior_of(("E",)))
    start = first_point(problem, True)
    assert start is not None
    found = fit(problem, start)
    assert disproved(found) == "" and DOUBTED < 0.01

    def stated(deviations: float) -> str:
        off = np.array([0.0, deviations * data.shared.std_base, 0.0])
        trials = []
        for trial in data.trials:
            T = trial.T_world_base.copy()
            T[:3, 3] -= off
            trials.append(replace(trial, T_world_base=T))
        moved = replace(problem, trials=tuple(trials))
        begun = first_point(moved, True)
        assert begun is not None
        return disproved(fit(moved, begun))

    assert stated(2.0) == ""
    assert "the base's place" in stated(9.0)
