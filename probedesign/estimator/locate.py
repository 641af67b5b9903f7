"""Where along the probe a known force acts: the arclengths whose base moment matches the reading.

The paper shoots from the base for zero moment at the tip. Here every trial starts at the tip, where the
moment is zero by itself, and is matched to the measured moment at the base: the same equation, met from
the side on which errors die out instead of growing through the thin tip (docs/decisions/0002).
"""

import numpy as np

from probedesign.frames import Array
from probedesign.rod import kernels
from probedesign.rod.equilibrium import Equilibrium
from probedesign.rod.rod import Rod

STATIONS = 33
"""Arclengths scanned for candidates: L/32 apart, denser than the misfit's own waves (tests/estimator)."""
SCAN_TOLERANCE = 1e-5
"""Error a step [rad] while scanning."""
REACH = 4
"""Stations that a minimum may lie away from where the scan saw it: a probe bent by less than a thousandth of a
radian feels the scan's own errors."""
_MAX_ITERATIONS = 60
_CLOSE = 1e-10  # of the length: a hundredth of a nanometre on a long probe


def scan(rod: Rod, gravity: Array, force: Array, moment: Array) -> tuple[Array, Array, Array]:
    """Misfit of the base moment as the force acts at each of many arclengths.

    Args:
        rod: the rod.
        gravity: base axes [m/s²], (3,).
        force: base axes [N], (3,).
        moment: measured, about the base [N·m], (3,).

    Returns:
        Arclengths [m] (j,), squared misfit [N²·m²] (j,) and tip tangents (j, 3), as far as equilibria exist.
    """
    stations = np.linspace(0.0, rod.length, STATIONS)
    load = np.concatenate([force, gravity, np.zeros(4)])
    moments, tips = np.empty((STATIONS, 3)), np.empty((STATIONS, 3))
    reached = kernels.moments_along(
        stations, load, rod.body, SCAN_TOLERANCE, np.empty(kernels.SCRATCH), moments, tips
    )
    misfit = ((moments[:reached] - moment) ** 2).sum(axis=1)
    return stations[:reached], misfit, tips[:reached]


def refine(
    rod: Rod, gravity: Array, force: Array, moment: Array, s: float, low: float, high: float, guess: Array
) -> Equilibrium | None:
    """The equilibrium at the nearest least misfit in [low, high], by Gauss-Newton with exact sensitivities.

    A step that overshoots, or that leads where there is no equilibrium (the probe gives way there), is halved.

    Returns:
        The equilibrium with its load columns; None if none was found, or if the search ended at a bound short
        of the probe's own ends or at the edge of the equilibria: that is no minimum.
    """
    best: Equilibrium | None = None
    least, at, step, blocked = np.inf, s, 0.0, False
    for _ in range(_MAX_ITERATIONS):
        eq = rod.solve(gravity, force, s, guess=guess, guess_only=True, columns="load")
        misfit = eq.wrench_base[3:6] - moment
        square = float(misfit @ misfit)
        if eq.sensitivity is not None and square < least:
            best, least, at, blocked, guess = eq, square, s, False, eq.tip_tangent
            a = eq.sensitivity.d_moment[:, 3]
            slope = float(a @ a)
            step = -float(a @ misfit) / slope if slope > 0.0 else 0.0
        else:
            blocked = blocked or not eq.ok
            step *= 0.5
        s = min(max(at + step, low), high)
        if best is None or abs(s - at) <= _CLOSE * rod.length:
            break
    inside = at not in (low, high) or at in (0.0, rod.length) or abs(step) <= _CLOSE * rod.length
    return best if inside and not blocked else None


def candidates(rod: Rod, gravity: Array, force: Array, moment: Array) -> list[Equilibrium]:
    """Equilibria at the local minima of the misfit along the probe, best first."""
    stations, misfit, tips = scan(rod, gravity, force, moment)
    found: list[Equilibrium] = []
    for i in range(len(stations)):
        before = misfit[i - 1] if i else np.inf
        after = misfit[i + 1] if i + 1 < len(stations) else np.inf
        if misfit[i] <= before and misfit[i] <= after:
            reach = REACH * rod.length / (STATIONS - 1)
            low, high = max(stations[i] - reach, 0.0), min(stations[i] + reach, rod.length)
            eq = refine(rod, gravity, force, moment, stations[i], low, high, tips[i])
            if eq is not None and not any(_same_place(eq, other) for other in found):
                found.append(eq)
    return sorted(found, key=lambda eq: float(((eq.wrench_base[3:6] - moment) ** 2).sum()))


def _same_place(a: Equilibrium, b: Equilibrium) -> bool:
    return bool(abs(a.load[9] - b.load[9]) < 1e-6 * a.body.knots[-1])
