"""Steps within bounds: a search ends at a bound beyond which the loss decreases, and touches do not pull."""

from dataclasses import replace

import numpy as np
import pytest

from probedesign.campaigns import Campaign
from probedesign.estimation.model import ProbeModel
from probedesign.identification.identify import data_of
from probedesign.identification.parameters import PARAMETERS, ROOT_RANGE, ParameterValues
from probedesign.identification.residuals import MeasuredTest
from probedesign.identification.solver import MIN_GAIN, LeastSquaresProblem, fit, linearize, start_nuisance, start_point
from probedesign.identification.surface_touch import solve_touch


def _problem(tests: tuple[MeasuredTest, ...], campaign: Campaign, model: ProbeModel) -> LeastSquaresProblem:
    common = data_of(campaign, model, 0.0).common
    return LeastSquaresProblem(common, tests, None, common.prior_without(["E"]))


def test_a_place_beyond_the_flank_ends_the_search_at_its_end(stage: Campaign, model: ProbeModel) -> None:
    """The stated place draws the touch beyond the flank; all other unknowns still reach their minimum."""
    tests = data_of(stage, model, 0.0).tests
    end, last = model.rod.flank_end, max(one.s_contact for one in tests if one.touched)
    beyond = tuple(
        replace(one, s_contact=end + 2e-3, p_touch_world=None) if one.s_contact == last else one for one in tests
    )
    problem = _problem(beyond, stage, model)
    start = start_point(problem, free_E=True)
    assert start is not None
    found = fit(start)
    assert found.result == "ok"
    (test,) = [one for one in found.point.tests if one.measured.s_contact > end]
    assert test.nuisance[test.measured.nuisance["s"]][0] == end
    assert found.point.expected_gain(found.weight) < MIN_GAIN
    without = replace(problem, common=problem.common)
    without.__dict__["bounds"] = np.full((2, problem.size), np.inf) * [[-1.0], [1.0]]
    # 2 mm at a standard deviation of 0.05 mm would gain more than half a χ² of 1
    assert replace(found.point, problem=without).expected_gain(found.weight) > 1.0


@pytest.mark.parametrize(("end", "outward"), [(0, -1.0), (1, 1.0)])
def test_a_root_at_its_bound_moves_inwards_only(end: int, outward: float, stage: Campaign, model: ProbeModel) -> None:
    """Readings of a probe with another root draw it over the bound, or back, by the sign of their residuals."""
    tests, column = data_of(stage, model, 0.0).tests[:6], PARAMETERS["root"].columns.start
    problem = _problem(tests, stage, model)
    prior = np.zeros(problem.common.size)
    prior[column] = np.inf  # the root alone is free
    problem = replace(problem, tests=tests, prior=prior)
    x = np.zeros(problem.common.size)
    x[column] = problem.common.bounds[end, column]
    design = model.rod.rigid_length / model.rod.radius[0]
    assert x[column] == pytest.approx(ROOT_RANGE[end] - design)
    point = linearize(problem, ParameterValues(problem.common, x), start_nuisance(tests, model.rod))
    # readings that are shifted along their derivative draw it outwards, or back
    for sign in (1.0, -1.0):
        drawn = replace(
            point, blocks=tuple(one._replace(r=-1e3 * sign * outward * one.J[:, column]) for one in point.blocks)
        )
        movable = drawn.movable(np.ones(len(point.blocks)))
        assert movable[0] == (sign < 0.0)


def test_a_touch_that_would_pull_is_none(model: ProbeModel) -> None:
    """The force points into the surface on its own side alone; there friction ratios have a meaning."""
    s, force = 0.6 * model.rod.length, np.array([0.05, 0.0, 0.0])
    pushes = [
        solve_touch(model.rod, model.gravity_base, force, s, angle, None, np.zeros(3))[1]
        for angle in (np.pi, np.pi - 1.0, np.pi + 1.0, 0.0, 1.0, -1.0)
    ]
    assert pushes == [True, True, True, False, False, False]


def test_a_touch_seen_on_the_other_side_stays_a_push(stage: Campaign, model: ProbeModel) -> None:
    """The touched place is stated where the force would pull: the search neither goes there nor stops early."""
    tests = list(data_of(stage, model, 0.0).tests)
    k = next(i for i, one in enumerate(tests) if one.touched)
    touch = tests[k]
    assert touch.p_touch_world is not None and touch.wrench_base is not None
    R = touch.T_world_base[:3, :3]
    force = R @ (touch.wrench_base[:3] - model.rod.mass * touch.gravity_base)
    across = force - R[:, 2] * (R[:, 2] @ force)
    radius = float(model.rod.radius_at(touch.s_contact))
    tests[k] = replace(touch, p_touch_world=touch.p_touch_world + 1.9 * radius * across / np.linalg.norm(across))
    problem = _problem(tuple(tests), stage, model)
    start = start_point(problem, free_E=True)
    assert start is not None
    found = fit(start)
    assert found.result == "ok"
    assert all(one.touch.pushes for one in found.point.tests if one.touch is not None)
