"""Loads of a probe that is pushed by a given distance: the force on the object, and the sensor's load in a crash.

`optimize` limits them as `force_mN@10mm` and `crash_use@30mm`, with the distance of the user.
"""

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
FORCE, MIN_FORCE, CRASH = "force_mN", "min_force_mN", "crash_use"
MAX_DISTANCE_MM = 1000.0
_TOLERANCE = 1e-6  #: Relative accuracy of the distance: that of the rod's fast integration.
_MAX_STEP = 0.1  #: Predicted displacement of the point in one step, in any direction, relative to the length.
_MIN_STEP = 1e-4  #: Relative step of the force below which the rod has no stable equilibrium ahead.
_MAX_SOLVES = 100
#: Angles between the push of a crash and the line from tip to base. A push exactly along the axis of a straight rod has
#: no preferred side to buckle to; 10° off, the rod bends aside as a real one does (assumed).
CRASH_POLAR_DEG = (90.0, 45.0, 10.0)
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


def push(
    rod: Rod,
    gravity: ArrayLike,
    direction: ArrayLike,
    distance: float,
    s: float | None = None,
    near: Equilibrium | None = None,
) -> Push:
    """Push a point of the centreline by a distance with a dead force.

    The force F e is increased from zero until e · (p(F) - p(0)) is the distance. This is the frictionless contact with
    a wall of the normal e: the point is free to slide along the wall.

    Args:
        rod: clamped at its base.
        gravity: in base axes [m/s²], (3,).
        direction: e in base axes, (3,).
        distance: along e [m].
        s: arclength of the point [m]; the tip if None.
        near: an equilibrium of the branch to follow, with the force to begin with; None for the branch of the free rod.
    """
    e = np.asarray(direction, dtype=float) / np.linalg.norm(direction)
    free = rod.solve(gravity, np.zeros(3), s, columns="load")
    if not free.ok:
        return Push(free.result, free)
    here, force, too_large, refusal = free, 0.0, math.inf, "not_converged"
    if near is not None:
        force = float(np.linalg.norm(near.load[:3]))
        here = rod.solve(gravity, force * e, s, columns="load", guess=near.tip)
        if not here.ok:
            return Push(here.result, here)
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
            if step < 0.0:  # the branch of `near` ends before the distance
                return Push("snaps", here)
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


def crash_use(model: ProbeModel, task: Task, distance_mm: float, overload: ArrayLike) -> float | None:
    """Return the largest fraction of the sensor's overload that a crash of the tip takes.

    The base moves on by the distance after the tip has touched a frictionless wall; the wall's normal is the worst of
    `CRASH_POLAR_DEG` and `AZIMUTHS_DEG`. Where the probe snaps before the distance, it comes to rest on the side to
    which it bends by itself: both its load before the snap and that at the distance are counted. The overload of an
    axis counts as if no other were loaded, as data sheets state it. Contact of the body beyond the tip, the impact and
    the strength of the resin are not included.

    Args:
        model: of the probe.
        task: its gravities.
        distance_mm: travel of the base after first contact [mm].
        overload: load on one axis that the sensor survives [N, N·m], (6,).

    Returns:
        The fraction; None where a push does not reach the distance in any way that was found.
    """
    limits, worst = np.asarray(overload, dtype=float), 0.0
    for under in task.models(model):
        g = under.gravity_base
        down = math.atan2(g[1], g[0])
        for polar in np.radians(CRASH_POLAR_DEG):
            across = math.sin(polar)
            directions = [
                (across * math.cos(down + a), across * math.sin(down + a), -math.cos(polar))
                for a in np.radians(AZIMUTHS_DEG)
            ]
            pushes = [push(under.rod, g, e, 1e-3 * distance_mm) for e in directions]
            reached = next((pushed.last for pushed in pushes if pushed.ok), None)
            for e, pushed in zip(directions, tuple(pushes), strict=True):
                if pushed.ok:
                    continue
                if pushed.result != "snaps" or reached is None:
                    return None
                after = push(under.rod, g, e, 1e-3 * distance_mm, near=reached)
                if not after.ok:
                    return None
                pushes.append(after)
            loads = [np.abs(under.to_sensor(pushed.last.wrench_base, g)) for pushed in pushes]
            worst = max(worst, *(float((load / limits).max()) for load in loads))
    return worst


def displacement_metric(name: str, model: ProbeModel, task: Task, overload: ArrayLike | None) -> float | None:
    """Return a metric that a distance belongs to, such as `force_mN@10mm`; None where it does not exist.

    Args:
        name: of the metric with its distance.
        model: of the probe.
        task: positions and gravities.
        overload: of the sensor [N, N·m], (6,); needed for `crash_use`.
    """
    metric, distance = split_metric(name)
    if metric in (MIN_FORCE, FORCE):
        forces = forces_at_deflection_mN(model, task, distance)
        if forces is None:
            return None
        smallest, largest = forces
        return smallest if metric == MIN_FORCE else largest
    assert overload is not None, "the problem rejects sensors without a known overload"
    return crash_use(model, task, distance, overload)


def split_metric(name: str) -> tuple[str, float]:
    """Return the metric's name and the distance [mm] of a name such as `force_mN@10mm`; NaN without a distance."""
    metric, _, distance = name.partition("@")
    try:
        return metric, float(distance.removesuffix("mm")) if distance.endswith("mm") else math.nan
    except ValueError:
        return metric, math.nan
