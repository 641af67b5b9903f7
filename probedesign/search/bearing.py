"""How near a body is to giving way: the force that it bears, told from how its stiffness falls before."""

import math

import numpy as np

from probedesign.estimation.model import ProbeModel
from probedesign.rod.contact import solve_frictionless
from probedesign.search.task import Task, side_of

_WEAK_N = 1e-6
_SQUARE = 2.0
"""Power of the force that the stiffness falls by while it has fallen little: it does not depend on the force's sign."""
_NONE_LOST = 1e-3
"""Of the stiffness: what is far from giving way need not be told more finely."""
_SHORT = 0.97
"""Of the way to where it would give way, to look again."""
_BACK = 0.7
"""Of the way there, where that was too far."""
_LOOKS = 4


def borne(model: ProbeModel, task: Task, most: float) -> float:
    """The force that a probe bears over the task's, at the place where that is least.

    Smooth in the body, and exact where it is near `most` or less; beyond, it is only told to be more. The stiffness
    against a dead force falls to nothing where the probe gives way, as 1 - (F / F_borne)^p: two forces tell p.

    Args:
        model: of the probe; it bears the task's force.
        task: where it is touched, and how hard.
        most: times the force, that is asked about.
    """
    return min(
        _borne(under, fraction * under.rod.length, task.force_N, most)
        for under in task.models(model)
        for fraction in task.fractions
    )


def _borne(model: ProbeModel, s: float, force: float, most: float) -> float:
    free = _yields(model, s, _WEAK_N)
    here, lost, power = 1.0, _lost(free, _yields(model, s, force)), _SQUARE
    for _ in range(_LOOKS):
        found = here * float(lost ** (-1.0 / power))
        ahead = min(_SHORT * found, most)
        if ahead <= here:
            break
        there = _yields(model, s, ahead * force)
        if not math.isfinite(there):
            most = here + _BACK * (ahead - here)
            continue
        more = _lost(free, there)
        power = max(math.log(more / lost) / math.log(ahead / here), 1.0) if more > lost else _SQUARE
        here, lost = ahead, more
    return here * float(lost ** (-1.0 / power))


def _lost(free: float, pushed: float) -> float:
    """Share of the stiffness."""
    return min(max(1.0 - free / pushed, _NONE_LOST), 1.0)


def _yields(model: ProbeModel, s: float, force: float) -> float:
    """How far the contact moves by a dead force more [m/N]; infinite where the probe gives way."""
    pushed = solve_frictionless(model.rod, model.gravity_base, s, side_of(model.gravity_base), force)
    if pushed.result != "ok":
        return math.inf
    return float(np.linalg.norm(pushed.sensitivity.d_position[:, :3]))
