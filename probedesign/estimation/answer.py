"""What a fusion tells: the point with its code, what limits it, and what would help."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from scipy.special import chdtri

from probedesign.estimation.bow import Bow, bow_of
from probedesign.estimation.equations import (
    OFFSET,
    POINT,
    STIFFNESS,
    UNKNOWNS,
    Equations,
    Linear,
    Reading,
    target,
)
from probedesign.estimation.estimate import Result
from probedesign.estimation.fused import Fixed, Fused
from probedesign.estimation.pressed import Pressed, settle
from probedesign.estimation.unknowns import Source
from probedesign.frames import Array, pose

UNLIKELY = 1e-3
"""Chance that true touches of one fixed point are called inconsistent."""
RIVAL = 9.0
"""Least misfits this close to the best explain the readings about as well."""
_SOURCES: tuple[Source, ...] = ("stiffness", "bias", "robot")


@cache
def most_chi2(dof: int) -> float:
    """Misfit beyond which readings are inconsistent."""
    return float(chdtri(dof, UNLIKELY))


@dataclass(frozen=True)
class Solution:
    """Where the iterations ended.

    Attributes:
        x: the unknowns, (7,).
        cov: of them, (7, 7).
        chi2: misfit, priors included.
        pressed: the touches, None where free.
        linear: the readings there.
        iterations: how many.
    """

    x: Array
    cov: Array
    chi2: float
    pressed: tuple[Pressed | None, ...]
    linear: Linear
    iterations: int


def told(
    equations: Equations,
    found: list[Solution],
    fixed: Fixed,
    others: list[Solution],
    brief: bool = False,
) -> Fused:
    """The best solution with its code.

    Args:
        equations: of the readings.
        found: every place that explains them, best first.
        fixed: which point stands still.
        others: every place if the other point did.
        brief: without what it would be if something were otherwise.
    """
    best, code = found[0], _code(equations, found, others)
    stiffness = math.exp(best.x[STIFFNESS])
    answer = Fused(
        code,
        fixed=fixed,
        stiffness=stiffness,
        std_stiffness=stiffness * math.sqrt(best.cov[STIFFNESS, STIFFNESS]),
        chi2=best.chi2,
        dof=equations.dof,
        rms=_rms(best),
        rms_without={} if brief else _without(equations, best),
        iterations=best.iterations,
        candidates_world=np.array(
            [_centre(equations, place) for place in [*found, *others] if place.chi2 < best.chi2 + RIVAL]
        ),
    )
    if code != "ok":
        return answer
    placed = _placed(answer, equations, best)
    if equations.one_pose:
        placed = _bowed(placed, equations)
    return replace(placed, rms_with={} if brief else _gains(equations, best))


def _bowed(answer: Fused, equations: Equations) -> Fused:
    """An answer from one pose, as vague as the curve of the probe makes it."""
    touched = [reading for reading in equations.readings if reading.touched]
    first, cov = touched[0], np.mean([reading.cov for reading in touched], axis=0) / len(touched)
    wrench = np.mean([reading.wrench for reading in touched], axis=0)
    bow = bow_of(equations.model.rod, wrench, cov, first.gravity)
    return answer if bow is None else widened(answer, bow, first.T_world_base[:3, :3])


def widened(answer: Fused, bow: Bow, R_world_base: Array) -> Fused:
    """An answer with the bow of its one pose added."""
    added = R_world_base @ bow.at(float(np.trace(answer.cov_contact_world))) @ R_world_base.T
    return replace(
        answer,
        cov_contact_world=answer.cov_contact_world + added,
        cov_fixed_world=answer.cov_fixed_world + added,
        rms=math.sqrt(answer.rms**2 + float(np.trace(added))),
    )


def _rms(best: Solution) -> float:
    return math.sqrt(float(np.trace(best.cov[POINT, POINT])))


def _touched(equations: Equations, best: Solution) -> list[tuple[Reading, Pressed]]:
    return [(r, p) for r, p in zip(equations.readings, best.pressed, strict=True) if p is not None]


def _placed(answer: Fused, equations: Equations, best: Solution) -> Fused:
    """An answer with where it all is, and how well that is known."""
    touched = _touched(equations, best)
    by_unknowns = _contact_by_unknowns(
        np.array([r.T_world_base[:3, :3] for r, _ in touched]), [p for _, p in touched]
    )
    return replace(
        answer,
        p_contact_world=_centre(equations, best),
        p_surface_world=best.x[POINT] + _mean(r.turned(p.p_surface - p.p_fixed) for r, p in touched),
        cov_contact_world=by_unknowns @ best.cov @ by_unknowns.T,
        cov_fixed_world=best.cov[POINT, POINT],
        s_contact=np.array([np.nan if p is None else p.push.s for p in best.pressed]),
        force_base=np.array([np.zeros(3) if p is None else p.push.force for p in best.pressed]),
    )


def _code(equations: Equations, found: list[Solution], others: list[Solution]) -> Result:
    best, rms = found[0], _rms(found[0])
    pulled = any(p is not None and p.push.magnitude < 0.0 for p in best.pressed)
    if best.chi2 > most_chi2(equations.dof) or pulled:
        return "inconsistent"
    if not rms < equations.model.rod.length / math.sqrt(12.0):
        return "unobservable" if equations.moments_only else "too_light"
    near = 3.0 * rms
    if any(_apart(equations, best, rival) > near for rival in found[1:] if rival.chi2 < best.chi2 + RIVAL):
        return "ambiguous"
    # Which point stands still moves it by less than the probe is thick; further off it is another touch.
    near += 2.0 * float(equations.model.rod.radius.max())
    rivals = [rival for rival in others if rival.chi2 < best.chi2 + RIVAL]
    far = any(_apart(equations, best, rival) > near + 3.0 * _rms(rival) for rival in rivals)
    return "ambiguous" if far else "ok"


def _apart(equations: Equations, one: Solution, other: Solution) -> float:
    """How far the centreline's points of two solutions lie apart [m]."""
    return float(np.linalg.norm(_centre(equations, one) - _centre(equations, other)))


def _centre(equations: Equations, found: Solution) -> Array:
    """The centreline's mean point in the world [m], (3,)."""
    touched = _touched(equations, found)
    centre: Array = found.x[POINT] + _mean(r.turned(p.p_contact - p.p_fixed) for r, p in touched)
    return centre


def _without(equations: Equations, best: Solution) -> dict[str, float]:
    """What is left if one source of error were gone."""
    unknowns = equations.unknowns
    return {source: equations.rms(best.linear, unknowns.without(source)) for source in _SOURCES}


def _gains(equations: Equations, best: Solution) -> dict[str, float]:
    """What more readings or a better stiffness would bring."""
    unknowns, touched = equations.unknowns, _touched(equations, best)
    halved = replace(unknowns, stiffness=0.5 * unknowns.stiffness)
    last, p = touched[-1]
    gains = {
        "stiffness": equations.rms(best.linear, halved),
        "one more touch": _with(equations, best, last, p),
    }
    if len(touched) > 1:
        way = last.T_world_base[:3, 3] - touched[-2][0].T_world_base[:3, 3]
        on = replace(last, T_world_base=pose(last.T_world_base[:3, :3], last.T_world_base[:3, 3] + way))
        point, log_stiffness = target(on, best.x, np.zeros(3)), float(best.x[STIFFNESS])
        further = settle(equations.model.rod, on.gravity, p.push, p.fixed, point, 1e-6, log_stiffness)
        if further is not None:
            gains["further press"] = _with(equations, best, on, further)
    return gains


def _with(equations: Equations, best: Solution, reading: Reading, pressed: Pressed) -> float:
    """The error with one reading more [m]."""
    more = replace(equations, readings=(reading,)).linear((pressed,), best.x)
    return equations.rms(best.linear.repeated(more), equations.unknowns)


def _contact_by_unknowns(R: Array, pressed: list[Pressed]) -> Array:
    """Of the centreline's mean point in the world by the unknowns, (3, 7); R: the bases' turns, (k, 3, 3)."""
    by_point = R @ np.array([p.contact_by_fixed[0] for p in pressed])
    by_stiffness = np.array([p.contact_by_fixed[1] for p in pressed])
    found = np.empty((3, UNKNOWNS))
    found[:, POINT] = (by_point @ R.transpose(0, 2, 1)).mean(axis=0)
    found[:, STIFFNESS] = (R @ by_stiffness[:, :, None])[:, :, 0].mean(axis=0)
    found[:, OFFSET] = (R - by_point).mean(axis=0)
    return found


def _mean(points: Iterable[Array]) -> Array:
    mean: Array = np.mean(list(points), axis=0)
    return mean
