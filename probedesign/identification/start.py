"""Where a search begins: the force of each touch by its reading, its place by its lever."""

from collections.abc import Sequence

import numpy as np

from probedesign.frames import Array
from probedesign.identification.guess import Guess
from probedesign.identification.solver import Point, Problem, solve_at
from probedesign.identification.trial import Trial
from probedesign.rod.rod import Rod

STIFFER = (1.0, 0.7, 1.5, 0.45, 2.5)
"""Factors on E that are tried: published values of one resin differ by two."""


def first_point(problem: Problem, free: bool) -> Point | None:
    """The campaign solved with the factor on E that explains it best; None where the rod holds with none.

    Args:
        problem: what is fitted.
        free: whether E may differ from the design's.
    """
    best = None
    for factor in STIFFER if free else STIFFER[:1]:
        x = np.zeros(problem.shared.size)
        x[0] = np.log(factor)
        point = solve_at(problem, Guess(problem.shared, x), owns_of(problem.trials, problem.shared.model.rod))
        if point.ok and (best is None or point.loss({}) < best.loss({})):
            best = point
    return best


def standing(problem: Problem, free: bool) -> tuple[list[Trial], list[Trial]]:
    """Tests that the rod bears with some factor on E, and those that it never does."""
    kept: list[Trial] = []
    lost: list[Trial] = []
    for trial in problem.trials:
        alone = Problem(problem.shared, (trial,), None, problem.prior)
        (lost if first_point(alone, free) is None else kept).append(trial)
    return kept, lost


def owns_of(trials: Sequence[Trial], rod: Rod) -> list[Array]:
    """First values of each test's own unknowns."""
    return [_own(trial, rod) for trial in trials]


def _own(trial: Trial, rod: Rod) -> Array:
    own = np.zeros(trial.own)
    if not trial.own:
        return own
    R = trial.T_world_base[:3, :3]
    known = None if trial.force_world is None else R.T @ trial.force_world
    force = _force(trial, rod) if known is None else known
    place = _place(trial, rod, force)
    if trial.touched:
        own[:3] = force
    if trial.slides:
        own[-1] = np.clip(place, 0.02 * rod.length, rod.flank_end)
    return own


def _force(trial: Trial, rod: Rod) -> Array:
    """What the reading has beyond the probe's weight."""
    assert trial.wrench_base is not None  # tests without are not used
    return np.asarray(trial.wrench_base[:3] - rod.mass * trial.gravity_base)


def _place(trial: Trial, rod: Rod, force: Array) -> float:
    """As told, or below the place that was seen, or where the lever of the force has it."""
    if np.isfinite(trial.s_contact):
        return trial.s_contact
    if trial.p_touch_world is not None:
        return float(np.linalg.norm(trial.p_touch_world - trial.T_world_base[:3, 3]))
    free = rod.solve(trial.gravity_base)
    assert trial.wrench_base is not None
    moment = trial.wrench_base[3:] - (free.wrench_base[3:] if free.ok else 0.0)
    across = float(np.hypot(*force[:2]))
    return float(np.hypot(*moment[:2])) / across if across > 0.0 else 0.5 * rod.length
