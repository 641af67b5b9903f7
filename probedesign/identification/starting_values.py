"""Starting values of a fit: a factor on E that explains the tests best, and each touch by its own reading."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from probedesign.core.frames import Array
from probedesign.identification.parameters import LOG_E, LOG_G, ParameterValues
from probedesign.identification.residuals import MeasuredTest
from probedesign.identification.solver import LeastSquaresProblem, Linearization, linearize
from probedesign.rod.rod import Rod

START_FACTORS = (1.0, 0.7, 1.5, 0.45, 2.5, 6.0)
"""Factors on E to start from: published values of one resin differ by two; 6 is for forces in a wrong unit."""
MAX_LOAD = 15.0
"""Largest F s²/(2 E I) of a load, the angle by which it would bend a rod of small deflection [rad] (assumed: far
beyond any test)."""
MAX_COMPARED = 6
"""Tests that the factors are compared by."""


def start_point(problem: LeastSquaresProblem, free_E: bool) -> Linearization | None:
    """Return the linearization with the least loss over factors on E, or at the design's E; None without a solution.

    The factors are compared by tests that are spread over the campaign.
    """
    some = replace(problem, tests=spread(problem.tests, MAX_COMPARED))
    losses = {factor: point.loss({}) for factor, point in start_points(some)} if free_E else {1.0: 0.0}
    for factor in sorted(losses, key=lambda factor: losses[factor]):
        point = _at_factor(problem, factor)
        if point.ok:
            return point
    return None


def spread(tests: Sequence[MeasuredTest], count: int) -> tuple[MeasuredTest, ...]:
    """Return at most `count` tests that are spread over the campaign."""
    n = len(tests)
    return tuple(tests[i] for i in np.unique(np.linspace(0, n - 1, min(n, count)).round().astype(int)))


def start_points(
    problem: LeastSquaresProblem, count: int = len(START_FACTORS)
) -> Iterator[tuple[float, Linearization]]:
    """Yield the first `count` factors on E for which the rod has an equilibrium in every test, with the linearization,
    from the stiffest on. A softer probe does not bear what a stiffer one does not, and it takes long to find that
    out."""
    for factor in sorted(START_FACTORS[:count], reverse=True):
        point = _at_factor(problem, factor)
        if not point.ok:
            return
        yield factor, point


def _at_factor(problem: LeastSquaresProblem, factor: float) -> Linearization:
    x = np.zeros(problem.common.size)
    x[LOG_E] = np.log(factor)
    if problem.with_poisson:
        x[LOG_G] = x[LOG_E]  # as Poisson's ratio has it
    values = ParameterValues(problem.common, x)
    nuisance = start_nuisance(problem.tests, problem.common.model.rod)
    if any(_absurd(test, own, values.rod) for test, own in zip(problem.tests, nuisance, strict=True)):
        return Linearization(problem, values, (), ())
    return linearize(problem, values, nuisance)


def _absurd(test: MeasuredTest, nuisance: Array, rod: Rod) -> bool:
    """Return whether the load would bend the probe by more than `MAX_LOAD`: no test does, and the solver takes long to
    find that out."""
    at = test.nuisance
    force = nuisance[at["force"]] if test.force_world is None else test.force_world
    s = nuisance[at["s"]][0] if "s" in at else test.s_contact
    stiffness = rod.youngs_modulus * 0.25 * np.pi * float(rod.radius.max()) ** 4
    return not test.free and bool(np.linalg.norm(force) * s**2 > 2.0 * MAX_LOAD * stiffness)


def solvable_tests(problem: LeastSquaresProblem, free_E: bool) -> tuple[list[MeasuredTest], list[MeasuredTest]]:
    """Split the tests into those with a stable equilibrium for some factor on E, and those without."""
    kept: list[MeasuredTest] = []
    lost: list[MeasuredTest] = []
    for test in problem.tests:
        alone = LeastSquaresProblem(problem.common, (test,), None, problem.prior)
        (lost if start_point(alone, free_E) is None else kept).append(test)
    return kept, lost


def start_nuisance(tests: Sequence[MeasuredTest], rod: Rod) -> list[Array]:
    """Return initial nuisance parameters of each test: a touch's force by its reading, its place by the lever, and the
    touched side opposite to the force."""
    result = []
    for test in tests:
        start, at = np.zeros(test.nuisance_size), test.nuisance
        if test.force_world is None:
            assert test.wrench_base is not None  # tests without are not used
            force = test.wrench_base[:3] - rod.mass * test.gravity_base
            start[at["force"]], start[at["angle"]] = force, np.arctan2(-force[1], -force[0])
        else:
            force = test.T_world_base[:3, :3].T @ test.force_world
        if "s" in at:
            start[at["s"]] = np.clip(_start_arclength(test, rod, force), 0.02 * rod.length, rod.flank_end)
        result.append(start)
    return result


def _start_arclength(test: MeasuredTest, rod: Rod, force: Array) -> float:
    """Return the stated arclength, else the distance of the touched point, else the lever of the force [m]."""
    if np.isfinite(test.s_contact):
        return test.s_contact
    if test.p_touch_world is not None:
        return float(np.linalg.norm(test.p_touch_world - test.T_world_base[:3, 3]))
    free = rod.solve(test.gravity_base)
    assert test.wrench_base is not None
    moment = test.wrench_base[3:] - (free.wrench_base[3:] if free.ok else 0.0)
    across = float(np.hypot(*force[:2]))
    return float(np.hypot(*moment[:2])) / across if across > 0.0 else 0.5 * rod.length
