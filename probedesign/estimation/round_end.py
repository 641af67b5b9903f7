"""A touch of a rounded tip: its place is known by the roundness, its force may lean as it likes.

The normals of a sphere all meet at its centre. So wherever the round end is touched without friction, the force acts
on the axis there, and instead of the arclength its lean is unknown, from the flank's own to straight along the axis.
"""

import math

import numpy as np

from probedesign.estimation.estimate import Candidate
from probedesign.estimation.observation import Observation
from probedesign.frames import Array
from probedesign.rod.rod import Rod

DOF = 3
"""Six channels, three unknowns: the force."""
_ITERATIONS = 12
_CLOSE = 1e-3
"""Step of the whitened misfit, in standard deviations, at which the search ends."""
_LEANING = 3.0
"""Standard deviations of the force by which it may seem to lean less than the flank's normal."""


def touch(rod: Rod, seen: Observation) -> Candidate | None:
    """The touch of the round end that explains a reading best.

    Args:
        rod: with a rounded tip.
        seen: the reading.

    Returns:
        The place; None if the probe cannot be pushed so, or the force would not point into the round end.
    """
    s, R = _sphere(rod)
    force, tip, moved = seen.force, None, math.inf
    for _ in range(_ITERATIONS):
        eq = rod.solve(seen.gravity, force, s, guess=tip, columns="load")
        if not eq.ok or eq.sensitivity is None:
            return None
        r = seen.whiten @ (eq.wrench_base - seen.wrench)
        J = seen.whiten @ eq.sensitivity.d_wrench[:, :3]
        if moved < _CLOSE:
            break
        step = -np.linalg.lstsq(J, r, rcond=None)[0]
        force, tip, moved = force + step, eq.tip, float(np.linalg.norm(J @ step))
    else:
        return None
    cov_force, size = np.linalg.inv(J.T @ J), float(np.linalg.norm(force))
    t = eq.R_at(s)[:, 2]
    lean = float(force @ t) + size * math.sin(math.atan(rod.taper_at(rod.flank_end)))
    if size == 0.0 or lean > _LEANING * math.sqrt(float(t @ cov_force @ t)):
        return None
    by_force = eq.sensitivity.d_position[:, :3]
    std_s = abs(
        rod.flank_end - s
    )  # facets are no sphere, and no print is: their normals miss its centre by so much
    return Candidate(
        s_contact=s,
        std_s=std_s,
        p_contact_base=eq.p_contact_base,
        p_surface_base=eq.p_contact_base - R / size * force,
        force_base=force,
        cov_contact_base=by_force @ cov_force @ by_force.T + std_s**2 * np.outer(t, t),
        chi2=float(r @ r),
        dof=DOF,
        lever=_lever(eq.sensitivity.d_moment[:, 3], size),
        tip=eq.tip,
        shape=lambda: eq,
    )


def _sphere(rod: Rod) -> tuple[float, float]:
    """Arclength of its centre and its radius [m], from the flank that it continues and the end that it reaches."""
    tan = rod.taper_at(rod.flank_end)
    sin = tan / math.hypot(1.0, tan)
    blunt = float(np.interp(rod.flank_end, rod.s, rod.radius)) - tan * (rod.length - rod.flank_end)
    R = blunt * math.sqrt(1.0 - sin * sin) / (1.0 - sin)
    return rod.length - R, R


def _lever(d_moment: Array, force: float) -> float:
    return float(np.linalg.norm(d_moment)) / force
