"""Every misfit's derivatives against differences, at a guess where nothing vanishes."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from probedesign.campaign import Campaign
from probedesign.estimation.model import ProbeModel
from probedesign.identification.guess import Guess
from probedesign.identification.identify import Data, data_of
from probedesign.identification.parameters import BIAS, PRINT
from probedesign.identification.solver import Point, Problem, solve_at
from probedesign.identification.start import owns_of


def _data(campaign: Campaign, model: ProbeModel) -> Data:
    """A free probe with its sag, a weight and a touch, with dots on the surface, and the scales."""
    data = data_of(campaign, model, 1e-6)
    free, weight = data.trials[0], next(t for t in data.trials if not t.free and not t.touched)
    touch = next(t for t in data.trials if t.touched)
    return replace(data, trials=tuple(replace(t, marker_side=0.4) for t in (free, weight, touch)))


def test_derivatives_agree_with_differences(cameras: Campaign, model: ProbeModel) -> None:
    data = _data(cameras, model)
    problem = Problem(data.shared, data.trials, data.weighed, np.ones(data.shared.size))
    rng = np.random.default_rng(2)
    sizes = np.concatenate([[0.1, 0.1, 0.1, 0.02, 0.1], np.full(8, 1e-3), np.full(6, 1e-3), np.full(6, 1e-4)])
    x = rng.normal(size=data.shared.size) * np.concatenate([sizes, np.ones(data.shared.size - PRINT)])
    owns = owns_of(data.trials, model.rod)
    point = solve_at(problem, Guess(data.shared, x), owns)
    assert point.ok
    assert {group.kind for group in point.groups} == {
        "wrenches", "markers", "touches", "friction", "places", "sags", "scales"}  # fmt: skip
    rows = _rows(point)
    for j in range(rows.shape[1]):
        step = 1e-2 if j >= PRINT else 1e-4 if BIAS.start <= j else 1e-3
        if j >= data.shared.size:
            step = 1e-5
        told = (_values(problem, x, owns, j, step) - _values(problem, x, owns, j, -step)) / (2.0 * step)
        # differences of second order and the rod's digits: 1e-6 of a moment is 1e-3 of its noise, over the step
        near = 1e-3 * np.abs(rows[:, j]).max() + 4e-3 / step
        assert np.abs(told - rows[:, j]).max() <= near, j


def _values(problem: Problem, x: np.ndarray, owns: list[np.ndarray], j: int, step: float) -> np.ndarray:
    ends = np.cumsum([len(x)] + [len(own) for own in owns])
    every = np.concatenate([x, *owns])
    every[j] += step
    parts = [every[a:b] for a, b in itertools.pairwise(ends)]
    point = solve_at(problem, Guess(problem.shared, every[: len(x)]), parts)
    return point.system(np.ones(len(point.groups)))[1]


def _rows(point: Point) -> np.ndarray:
    return point.system(np.ones(len(point.groups)))[0]


@pytest.mark.parametrize("place", [0.09, 0.09 - 5e-6])
def test_a_marker_where_the_weight_hangs_has_the_right_derivative(
    place: float, cameras: Campaign, model: ProbeModel
) -> None:
    """The shear jumps there: a difference across it would tell of a turn that is none."""
    data = _data(cameras, model)
    trial = replace(data.trials[1], s_contact=place, marker_s=np.array([0.09]), marker_numbers=(1,),
                    p_markers_world=np.zeros((1, 3)), cov_markers=np.eye(3)[None])  # fmt: skip
    problem = Problem(data.shared, (trial,), None, np.ones(data.shared.size))
    x, size = np.zeros(data.shared.size), data.shared.size
    rows = _rows(solve_at(problem, Guess(data.shared, x), [np.array([place])]))
    told = _values(problem, x, [np.array([place])], size, 1e-3) - _values(
        problem, x, [np.array([place])], size, -1e-3
    )
    marker = slice(size + 6, size + 9)  # behind the priors and the wrench
    # a millimetre's difference, of a curve that bends over centimetres
    assert rows[marker, size] == pytest.approx(told[marker] / 2e-3, rel=0.05, abs=2e-4)
