"""Touches that make one measured moment: a curve along the probe, each place with the frictionless force that it takes.

The point that was touched from several poses lies where their curves meet; that is where a fusion starts.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from probedesign.core.frames import Array
from probedesign.estimation.multistart import placed
from probedesign.estimation.surface_contact_kernel import TIP, TOUCH
from probedesign.rod.batch import Batch, solve_batch
from probedesign.rod.rod import Rod

STATIONS = 24
NEAREST = 0.04
"""Of the stations to the base, over the length."""
MAX_BENT = 6.0
"""F s² r(0)/(E I(0) r(s)) beyond which a push has no equilibrium; to search for one would take long."""
_ITERATIONS = 3
X_AXIS, Y_AXIS = slice(3, 6), slice(9, 12)
"""Of the section at the contact, in `Batch.frame`."""


@dataclass(frozen=True)
class Curve:
    """Places that are consistent with one moment.

    Attributes:
        points: of the centreline, in the world [m], (j, 3); NaN where no force makes the moment.
        touches: that make the moment there, (TOUCH,) each, (j,).
    """

    points: Array
    touches: tuple[Array | None, ...]


def curve(rod: Rod, gravity: Array, moment: Array, T_world_base: Array) -> Curve:
    """Return for each station the force across the probe whose base moment comes nearest to the one read, all at once.

    Args:
        rod: of the probe.
        gravity: base axes [m/s²], (3,).
        moment: read at the base [N·m], (3,).
        T_world_base: pose of the base, (4, 4).
    """
    stations = np.linspace(NEAREST, 1.0, STATIONS) * rod.flank_end
    points, touches = np.full((STATIONS, 3), np.nan), list[Array | None]([None] * STATIONS)
    force, going = np.zeros((STATIONS, 3)), np.arange(STATIONS)
    for _ in range(_ITERATIONS):
        bearable = np.linalg.norm(force[going], axis=1) <= _max_force(rod, stations[going])
        for j in going[~bearable]:
            points[j], touches[j] = np.nan, None
        going = going[bearable]
        if len(going) == 0:
            break
        batch = solve_batch(rod, gravity, force[going], stations[going], columns="load")
        going, batch = going[batch.ok], batch.rows(batch.ok)
        for j, case in zip(going, range(len(going)), strict=True):
            touches[j] = _touch(rod, float(stations[j]), force[j].copy(), batch.frame[case], batch.tip[case])
        points[going] = batch.p_contact_base @ T_world_base[:3, :3].T + T_world_base[:3, 3]
        force[going] = _across(batch, force[going], moment)
    return Curve(points, tuple(touches))


def _max_force(rod: Rod, s: Array) -> Array:
    """Return the pushes beyond which there is no equilibrium [N], (j,)."""
    radius = rod.radius_at(s)
    most: Array = MAX_BENT * rod.youngs_modulus * math.pi / 4.0 * float(rod.radius[0]) ** 3 * radius / s**2
    return most


def _across(batch: Batch, force: Array, moment: Array) -> Array:
    """Return the forces across the sections whose base moments come nearest to the one read, to first order, (j, 3)."""
    across = np.stack([batch.frame[:, X_AXIS], batch.frame[:, Y_AXIS]], axis=2)
    by_force = batch.d_moment[:, :, :3]
    misfit = moment - batch.wrench_base[:, 3:6] + np.einsum("jik,jk->ji", by_force, force)
    found: Array = np.einsum("jik,jkl,jl->ji", across, np.linalg.pinv(by_force @ across), misfit)
    return found


def _touch(rod: Rod, s: float, force: Array, frame: Array, tip: Array) -> Array:
    """Return the touch whose force crosses the centreline at s, (TOUCH,)."""
    touch = np.zeros(TOUCH)
    placed(rod.body, rod.flank_end, s, force, frame[:3].copy(), frame[X_AXIS].copy(), touch)
    touch[TIP:] = tip
    return touch


def closest_approaches(curves: list[Curve]) -> list[tuple[int, ...]]:
    """Return where curves come nearest to each other: a station of each, for every local minimum, nearest first."""
    if len(curves) < 2:
        return []
    first = curves[0].points
    stations, total = [np.arange(STATIONS)], np.zeros(STATIONS)
    for other in curves[1:]:
        nearest, apart = _nearest(first, other.points)
        stations.append(nearest)
        total += apart**2
    before, after = np.append(np.inf, total[:-1]), np.append(total[1:], np.inf)
    lowest = np.flatnonzero((total <= before) & (total <= after) & np.isfinite(total))
    return [tuple(int(of[j]) for of in stations) for j in lowest[np.argsort(total[lowest])]]


def _nearest(points: Array, line: Array) -> tuple[NDArray[np.intp], Array]:
    """Return the vertex of a line (j, 3) next to where each point (i, 3) comes nearest to it, and how near [m]."""
    start, way = line[:-1], np.diff(line, axis=0)
    off = points[:, None] - start[None]
    with np.errstate(invalid="ignore"):
        share = np.clip((off * way).sum(axis=2) / (way * way).sum(axis=1), 0.0, 1.0)
        apart = np.linalg.norm(off - share[:, :, None] * way, axis=2)
    apart = np.where(np.isfinite(apart), apart, np.inf)
    segment = apart.argmin(axis=1)
    i = np.arange(len(points))
    vertex = segment + (np.nan_to_num(share[i, segment]) > 0.5)
    return vertex, apart[i, segment]
