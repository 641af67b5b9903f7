"""Derivatives of every residual against differences, at values where none vanishes."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from probedesign.campaigns import Campaign
from probedesign.estimation.model import ProbeModel
from probedesign.identification.identify import IdentificationData, data_of
from probedesign.identification.parameters import LOG_G, OWNER, PRINT, ParameterValues
from probedesign.identification.solver import LeastSquaresProblem, Linearization, linearize, start_nuisance


def _data(campaign: Campaign, model: ProbeModel) -> IdentificationData:
    """A free probe with its sag, a weight and a touch, with dots on the surface, and the scales."""
    data = data_of(campaign, model, 1e-6)
    free, weight = data.tests[0], next(t for t in data.tests if not t.free and not t.touched)
    touch = next(t for t in data.tests if t.touched)
    return replace(data, tests=tuple(replace(t, marker_side=0.4) for t in (free, weight, touch)))


def test_derivatives_agree_with_differences(cameras: Campaign, model: ProbeModel) -> None:
    data = _data(cameras, model)
    prior = np.ones(data.common.size)
    prior[LOG_G] = np.inf
    problem = LeastSquaresProblem(data.common, data.tests, data.mass, prior)
    rng = np.random.default_rng(2)
    size = {"diameters": 0.02, "E": 0.1, "density": 0.1, "G": 0.1, "root": 0.1, "bias": 1e-4}
    sizes = np.array([size.get(one.name, 1e-3) for one in OWNER])
    x = rng.normal(size=data.common.size) * np.concatenate([sizes, np.ones(data.common.size - PRINT)])
    nuisance = start_nuisance(data.tests, model.rod)
    for test, own in zip(data.tests, nuisance, strict=True):
        # friction around the section, a stiffness and a pose of its own
        for name, value in {"angle": 0.4, "stiffness": 0.02, "weight": 0.01, "pose": 1e-4}.items():
            own[test.nuisance.get(name, slice(0, 0))] += value
    point = linearize(problem, ParameterValues(data.common, x), nuisance)
    assert point.ok
    assert {group.kind for group in point.blocks} == {
        "wrenches", "markers", "touches", "friction", "places", "sags", "scales", "weights", "stiffness",
        "poses", "poisson",
    }  # fmt: skip
    rows = _rows(point)
    for j in range(rows.shape[1]):
        step = 1e-2 if j >= PRINT else 1e-4 if OWNER[j].name == "bias" else 1e-3
        if j >= data.common.size:
            step = 1e-5
        numeric = (_values(problem, x, nuisance, j, step) - _values(problem, x, nuisance, j, -step)) / (2.0 * step)
        # differences of second order and the rod's digits: 1e-6 of a moment is 1e-3 of its noise, over the step
        near = 1e-3 * np.abs(rows[:, j]).max() + 4e-3 / step
        assert np.abs(numeric - rows[:, j]).max() <= near, j


def _values(problem: LeastSquaresProblem, x: np.ndarray, nuisance: list[np.ndarray], j: int, step: float) -> np.ndarray:
    ends = np.cumsum([len(x)] + [len(own) for own in nuisance])
    every = np.concatenate([x, *nuisance])
    every[j] += step
    parts = [every[a:b] for a, b in itertools.pairwise(ends)]
    point = linearize(problem, ParameterValues(problem.common, every[: len(x)]), parts)
    return np.concatenate([block.r for block in point.blocks])


def _rows(point: Linearization) -> np.ndarray:
    """Return the derivatives of all residuals by the parameter vector and every test's nuisance parameters."""
    tests = point.problem.tests
    ends = np.cumsum([point.problem.common.size] + [test.nuisance_size for test in tests])
    at = {test.name: slice(a, b) for test, (a, b) in zip(tests, itertools.pairwise(ends), strict=True)}
    rows = []
    for block in point.blocks:
        J = np.zeros((len(block.r), ends[-1]))
        J[:, : ends[0]] = block.J[:, : ends[0]]
        if block.test:
            J[:, at[block.test]] = block.J[:, ends[0] :]
        rows.append(J)
    return np.concatenate(rows)


@pytest.mark.parametrize("place", [0.09, 0.09 - 5e-6])
def test_a_marker_where_the_weight_hangs_has_the_right_derivative(
    place: float, cameras: Campaign, model: ProbeModel
) -> None:
    """The shear jumps there: a difference across it would show a rotation that is not there."""
    data = _data(cameras, model)
    trial = replace(data.tests[1], s_contact=place, marker_s=np.array([0.09]), marker_numbers=(1,),
                    p_markers_world=np.zeros((1, 3)), cov_markers=np.eye(3)[None])  # fmt: skip
    problem = LeastSquaresProblem(data.common, (trial,), None, np.ones(data.common.size))
    x, size = np.zeros(data.common.size), data.common.size
    own = np.zeros(trial.nuisance_size)
    own[trial.nuisance["s"]] = place
    rows = _rows(linearize(problem, ParameterValues(data.common, x), [own]))
    at = size + trial.nuisance["s"].start
    numeric = _values(problem, x, [own], at, 1e-3) - _values(problem, x, [own], at, -1e-3)
    marker = slice(6, 9)  # after the wrench
    # a millimetre's difference, of a curve that bends over centimetres
    assert rows[marker, at] == pytest.approx(numeric[marker] / 2e-3, rel=0.05, abs=2e-4)
