"""Force of a probe on an object that pushes it by a given distance, which `optimize` limits as `force_mN@10mm`."""

import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from probedesign.estimation.model import ProbeModel
from probedesign.optimization.objective import Task
from probedesign.rod.equilibrium import Equilibrium
from probedesign.rod.rod import Rod

#: Names of the metrics, before the distance. A lower limit on `FORCE` bounds `MIN_FORCE`, the smallest force.
FORCE, MIN_FORCE = "force_mN", "min_force_mN"
MAX_DISTANCE_MM = 1000.0
_TOLERANCE = 1e-6  #: Relative accuracy of the distance: that of the rod's fast integration.
_MAX_STEP = 0.1  #: Predicted displacement of the point in one step, in any direction, relative to the length.
_MIN_STEP = 1e-4  #: Relative step of the force below which the rod has no stable equilibrium ahead.
_MAX_SOLVES = 100
AZIMUTHS_DEG = (0.0, 90.0, 180.0, 270.0)  #: Azimuths of the pushes from that of gravity.


@dataclass(frozen=True)
class Push:
    """A push of a point of the rod by a distance."""

    #: "ok": the distance was reached; "snaps": the rod has no stable equilibrium beyond `last`; "not_converged" or
    #: "unstable": no equilibrium was found beyond `last`, or none without the force.
    result: str
    last: Equilibrium  #: the equilibrium at the distance, or the last one before it.

    @property
    def ok(self) -> bool:
        """Return whether the distance was reached."""
        return self.result == "ok"

    @property
    def force(self) -> float:
        """Return the magnitude of the force at `last` [N]."""
        return float(np.linalg.norm(self.last.load[:3]))


def push(rod: Rod, gravity: ArrayLike, direction: ArrayLike, distance: float, s: float | None = None) -> Push:
    """Push a point of the centreline by a distance with a dead force.

    The force F e is increased from zero until e · (p(F) - p(0)) is the distance. This is the frictionless contact with
    a wall of the normal e: the point is free to slide along the wall.

    Args:
        rod: clamped at its base.
        gravity: in base axes [m/s²], (3,).
        direction: e in base axes, (3,).
        distance: along e [m].
        s: arclength of the point [m]; the tip if None.
    """
    e = np.asarray(direction, dtype=float) / np.linalg.norm(direction)
    free = rod.solve(gravity, np.zeros(3), s, columns="load")
    if not free.ok:
        return Push(free.result, free)
    here, force, too_large, refusal = free, 0.0, math.inf, "not_converged"
    for _ in range(_MAX_SOLVES):
        missing = distance - float(e @ (here.p_contact_base - free.p_contact_base))
        if abs(missing) <= _TOLERANCE * distance:
            return Push("ok", here)
        if here.sensitivity is None:
            break
        moves = here.sensitivity.d_position[:, :3] @ e
        longest = _MAX_STEP * rod.length / float(np.linalg.norm(moves))
        step = min(max(missing / float(e @ moves), -longest), longest)  # e · moves > 0 on a stable branch
        if force + step >= too_large:
            step = (too_large - force) / 2.0
            if step <= _MIN_STEP * force:
                break
        ahead = rod.solve(gravity, (force + step) * e, s, columns="load", guess=here.tip)
        jump = np.inf if not ahead.ok else float(np.linalg.norm(ahead.p_contact_base - here.p_contact_base))
        if jump > 5.0 * _MAX_STEP * rod.length:  # no equilibrium, or one of another branch
            too_large, refusal = force + step, "not_converged" if ahead.result == "not_converged" else "snaps"
            continue
        here, force = ahead, force + step
    return Push(refusal, here)


def forces_at_deflection_mN(model: ProbeModel, task: Task, deflection_mm: float) -> tuple[float, float] | None:
    """Return the smallest and the largest force when the probe is deflected by a distance [mN].

    The probe is pushed at each of the task's positions under each of its gravities, across its axis, in the directions
    `AZIMUTHS_DEG`.

    Args:
        model: of the probe.
        task: positions and gravities.
        deflection_mm: displacement of the centreline along the force [mm].

    Returns:
        The forces; None where a push does not reach the distance, because the probe snaps before or is not that long.
    """
    forces = list[float]()
    for under in task.models(model):
        down = math.atan2(under.gravity_base[1], under.gravity_base[0])
        for fraction, azimuth in itertools.product(task.fractions, np.radians(AZIMUTHS_DEG)):
            e = (math.cos(down + azimuth), math.sin(down + azimuth), 0.0)
            pushed = push(under.rod, under.gravity_base, e, 1e-3 * deflection_mm, fraction * under.rod.length)
            if not pushed.ok:
                return None
            forces.append(1e3 * pushed.force)
    return min(forces), max(forces)


def split_metric(name: str) -> tuple[str, float]:
    """Return the metric's name and the distance [mm] of a name such as `force_mN@10mm`; NaN without a distance."""
    metric, _, distance = name.partition("@")
    try:
        return metric, float(distance.removesuffix("mm")) if distance.endswith("mm") else math.nan
    except ValueError:
        return metric, math.nan
