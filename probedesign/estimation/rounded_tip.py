"""A touch of a rounded tip: its place follows from the roundness, its force may lean as it likes.

The normals of a sphere all meet at its centre. So a push on the round end acts on the axis there but for its friction,
which turns it by up to atan μ about the touched point: it then passes the centre at μ R. Instead of the arclength its
lean is unknown, from the flank's own to straight along the axis.
"""

import math

import numpy as np

from probedesign.estimation import multistart
from probedesign.estimation.estimate import Candidate
from probedesign.estimation.problem import Problem
from probedesign.estimation.surface_contact_kernel import TIP, TOUCH
from probedesign.rod.rod import Rod

DOF = 3
"""Six channels, three unknowns: the force."""
_ITERATIONS = 12
_CLOSE = 1e-3
"""Step of the whitened misfit, in standard deviations, at which the search ends."""
_LEANING = 3.0
"""Standard deviations of the force by which it may seem to lean less than the flank's normal."""
MAX_FRICTION = 1.0
"""Ratio of friction that is counted where the direction of the force is free: the touched point lies within R."""


def locate(problem: Problem) -> Candidate | None:
    """The touch of the round end that explains a reading best.

    Args:
        problem: of a rod with a rounded tip.

    Returns:
        The place; None if the probe cannot be pushed so, or the force would not point into the round end.
    """
    rod, seen, model = problem.sources.model.rod, problem.seen, problem.sources.model
    s, R = _sphere(rod)
    lean = R * min(problem.friction, MAX_FRICTION)
    force, tip, moved = seen.force, None, math.inf
    whiten, cov = np.linalg.inv(np.linalg.cholesky(problem.noise)), None
    for _ in range(_ITERATIONS):
        eq = rod.solve(seen.gravity, force, s, guess=tip, columns="contact")
        if not eq.ok or eq.sensitivity is None:
            return None
        if cov is None:
            touch, frame = np.zeros(TOUCH), eq.R_at(s)
            multistart.placed(
                rod.body, rod.flank_end, s, force, frame[:, 2].copy(), frame[:, 0].copy(), touch
            )
            touch[TIP:] = eq.tip
            D = np.nan_to_num(problem.sources.columns_at(touch)[1])
            # Friction adds a couple about the centre, of any direction across the force.
            couple = lean * float(np.linalg.norm(force)) * eq.sensitivity.d_wrench[:, 4:7]
            cov = problem.noise + D[:6] @ D[:6].T + couple @ couple.T
            whiten = np.linalg.inv(np.linalg.cholesky(cov))
        r = whiten @ (eq.wrench_base - seen.wrench)
        J = whiten @ eq.sensitivity.d_wrench[:, :3]
        if moved < _CLOSE:
            break
        step = -np.linalg.lstsq(J, r, rcond=None)[0]
        force, tip, moved = force + step, eq.tip, float(np.linalg.norm(J @ step))
    else:
        return None
    cov_force, size = np.linalg.inv(J.T @ J), float(np.linalg.norm(force))
    t = eq.R_at(s)[:, 2]
    tilt = float(force @ t) + size * math.sin(math.atan(rod.taper_at(rod.flank_end)))
    if size == 0.0 or tilt > _LEANING * math.sqrt(float(t @ cov_force @ t)) + lean / R * size:
        return None
    by_force = eq.sensitivity.d_position[:, :3]
    # Facets are no sphere, and no print is: their normals miss its centre by so much.
    std_s = math.hypot(rod.flank_end - s, lean)
    out = -force / size
    cov_contact = by_force @ cov_force @ by_force.T + std_s**2 * np.outer(t, t)
    cov_surface = cov_contact + lean**2 * (np.eye(3) - np.outer(out, out))
    lever = float(np.linalg.norm(eq.sensitivity.d_moment[:, 3])) / size
    return Candidate(
        s_contact=s,
        std_s=std_s,
        p_contact_base=eq.p_contact_base,
        p_surface_base=eq.p_contact_base + R * out,
        force_base=force,
        cov_contact_base=cov_contact,
        cov_surface_base=cov_surface,
        force_normal=size,
        force_tangential=0.0,
        chi2=float(r @ r),
        dof=DOF,
        lever=lever,
        shape=lambda: model.rod.solve(seen.gravity, force, s, guess=eq.tip),
    )


def _sphere(rod: Rod) -> tuple[float, float]:
    """Arclength of its centre and its radius [m], from the flank that it continues and the end that it reaches."""
    tan = rod.taper_at(rod.flank_end)
    sin = tan / math.hypot(1.0, tan)
    blunt = float(np.interp(rod.flank_end, rod.s, rod.radius)) - tan * (rod.length - rod.flank_end)
    R = blunt * math.sqrt(1.0 - sin * sin) / (1.0 - sin)
    return rod.length - R, R
