"""Loads of a probe that is pushed by a given distance: the force on the object, and the sensor's load in a crash.

`optimize` limits them as `force_mN@10mm` and `crash_use@30mm`, with the distance of the user.
"""

import itertools
import math

import numpy as np
from numpy.typing import ArrayLike

from probedesign.estimation.model import ProbeModel
from probedesign.optimization.objective import Task, side_of
from probedesign.rod.equilibrium import Equilibrium
from probedesign.rod.rod import Rod

FORCE, CRASH = "force_mN", "crash_use"
"""Names of the metrics, before the distance."""
MAX_DISTANCE_MM = 1000.0
_TOLERANCE = 1e-6
"""Relative accuracy of the distance: that of the rod's fast integration."""
_MAX_STEP = 0.1
"""Predicted displacement of the point in one step, in any direction, relative to the length."""
_MIN_STEP = 1e-4
"""Relative step of the force below which the rod has no stable equilibrium ahead."""
_MAX_SOLVES = 100
CRASH_POLAR_DEG = (90.0, 45.0, 10.0)
"""Angles between the push of a crash and the line from tip to base. A push exactly along the axis of a straight rod has
no preferred side to buckle to; 10° off, the rod bends aside as a real one does (assumed)."""
CRASH_AZIMUTHS_DEG = (0.0, 90.0, 180.0, 270.0)
"""Azimuths of the push from that of gravity."""


def push(
    rod: Rod, gravity: ArrayLike, direction: ArrayLike, distance: float, s: float | None = None
) -> Equilibrium:
    """Return the equilibrium in which a dead force has moved its point of the centreline by a distance.

    The force F e is increased from zero until e · (p(F) - p(0)) is the distance. This is the frictionless contact with
    a wall of the normal e: the point is free to slide along the wall.

    Args:
        rod: clamped at its base.
        gravity: in base axes [m/s²], (3,).
        direction: e in base axes, (3,).
        distance: along e [m].
        s: arclength of the point [m]; the tip if None.

    Returns:
        The equilibrium; where the rod snaps before that distance, the last stable one. Its result is not "ok" where the
        rod has no stable equilibrium without the force.
    """
    e = np.asarray(direction, dtype=float) / np.linalg.norm(direction)
    here = rod.solve(gravity, np.zeros(3), s, columns="load")
    if not here.ok:
        return here
    start, force, too_large = here.p_contact_base, 0.0, math.inf
    for _ in range(_MAX_SOLVES):
        missing = distance - float(e @ (here.p_contact_base - start))
        if abs(missing) <= _TOLERANCE * distance or here.sensitivity is None:
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
            too_large = force + step
            continue
        here, force = ahead, force + step
    return here


def force_at_deflection_mN(model: ProbeModel, task: Task, deflection_mm: float) -> float | None:
    """Return the largest force at the task's positions when the probe is deflected there by a distance [mN].

    The probe is pushed across gravity, as in the task. Where it snaps before, the force is that at which it does.

    Args:
        model: of the probe.
        task: positions and gravities.
        deflection_mm: displacement of the centreline along the force [mm].

    Returns:
        The force; None where the free probe has no stable equilibrium.
    """
    found = list[float]()
    for under in task.models(model):
        phi = side_of(under.gravity_base)
        aside = (math.cos(phi), math.sin(phi), 0.0)
        for fraction in task.fractions:
            pushed = push(
                under.rod, under.gravity_base, aside, 1e-3 * deflection_mm, fraction * under.rod.length
            )
            if not pushed.ok:
                return None
            found.append(1e3 * float(np.linalg.norm(pushed.load[:3])))
    return max(found)


def crash_use(model: ProbeModel, task: Task, distance_mm: float, overload: ArrayLike) -> float | None:
    """Return the largest fraction of the sensor's overload that a crash of the tip takes.

    The base moves on by the distance after the tip has touched a frictionless wall; the wall's normal is the worst of
    `CRASH_POLAR_DEG` and `CRASH_AZIMUTHS_DEG`. The overload of an axis counts as if no other were loaded, as data
    sheets state it. Contact of the body beyond the tip, the impact and the strength of the resin are not included.

    Args:
        model: of the probe.
        task: its gravities.
        distance_mm: travel of the base after first contact [mm].
        overload: load on one axis that the sensor survives [N, N·m], (6,).

    Returns:
        The fraction; None where the free probe has no stable equilibrium.
    """
    limits, worst = np.asarray(overload, dtype=float), 0.0
    for under in task.models(model):
        g = under.gravity_base
        down = math.atan2(g[1], g[0])
        for polar, azimuth in itertools.product(np.radians(CRASH_POLAR_DEG), np.radians(CRASH_AZIMUTHS_DEG)):
            across, phi = math.sin(polar), down + azimuth
            e = (across * math.cos(phi), across * math.sin(phi), -math.cos(polar))
            pushed = push(under.rod, g, e, 1e-3 * distance_mm)
            if not pushed.ok:
                return None
            load = np.abs(under.to_sensor(pushed.wrench_base, g))
            worst = max(worst, float((load / limits).max()))
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
    if metric == FORCE:
        return force_at_deflection_mN(model, task, distance)
    assert overload is not None, "the problem rejects sensors without a known overload"
    return crash_use(model, task, distance, overload)


def split_metric(name: str) -> tuple[str, float]:
    """Return the metric's name and the distance [mm] of a name such as `force_mN@10mm`; NaN without a distance."""
    metric, _, distance = name.partition("@")
    try:
        return metric, float(distance.removesuffix("mm")) if distance.endswith("mm") else math.nan
    except ValueError:
        return metric, math.nan
