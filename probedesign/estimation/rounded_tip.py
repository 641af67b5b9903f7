"""A touch of a rounded tip: its place follows from the roundness, its force may lean as it likes.

The normals of a sphere all meet at its centre. So a push on the round end acts on the axis there but for its friction,
which turns it by up to atan μ about the touched point: it then passes the centre at μ R. Instead of the arclength its
lean is unknown, from the flank's own to straight along the axis.
"""

import math
from typing import NamedTuple

import numpy as np

from probedesign.core.frames import Array
from probedesign.estimation import multistart
from probedesign.estimation.estimate import Candidate
from probedesign.estimation.problem import Problem
from probedesign.estimation.surface_contact_kernel import TIP, TOUCH
from probedesign.rod.equilibrium import Equilibrium, Sensitivity
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


class _ForceFit(NamedTuple):
    """Equilibrium under the fitted force, with the derivatives of the whitened misfit.

    Attributes:
        eq, sensitivity: equilibrium and its derivatives by the load; force: on the centre of the sphere [N], (3,).
        r, J: whitened misfit (6,) and its derivatives by the force (6, 3).
    """

    eq: Equilibrium
    sensitivity: Sensitivity
    force: Array
    r: Array
    J: Array


def locate(problem: Problem) -> Candidate | None:
    """Locate the touch of the round end that explains a reading best.

    Args:
        problem: of a rod with a rounded tip.

    Returns:
        The place; None if the probe cannot be pushed so, or the force would not point into the round end.
    """
    rod, gravity = problem.sources.model.rod, problem.seen.gravity
    s, R = _sphere(rod)
    lean = R * min(problem.friction, MAX_FRICTION)
    fit = _fit_force(problem, s, lean)
    if fit is None:
        return None
    eq, force = fit.eq, fit.force
    cov_force, size = np.linalg.inv(fit.J.T @ fit.J), float(np.linalg.norm(force))
    t = eq.R_at(s)[:, 2]
    tilt = float(force @ t) + size * math.sin(math.atan(rod.taper_at(rod.flank_end)))
    if size == 0.0 or tilt > _LEANING * math.sqrt(float(t @ cov_force @ t)) + lean / R * size:
        return None
    by_force = fit.sensitivity.d_position[:, :3]
    # Facets are no sphere, and no print is: their normals miss its centre by so much.
    std_s = math.hypot(rod.flank_end - s, lean)
    out = -force / size
    cov_contact = by_force @ cov_force @ by_force.T + std_s**2 * np.outer(t, t)
    return Candidate(
        s_contact=s,
        std_s=std_s,
        p_contact_base=eq.p_contact_base,
        p_surface_base=eq.p_contact_base + R * out,
        force_base=force,
        cov_contact_base=cov_contact,
        cov_surface_base=cov_contact + lean**2 * (np.eye(3) - np.outer(out, out)),
        force_normal=size,
        force_tangential=0.0,
        chi2=float(fit.r @ fit.r),
        dof=DOF,
        lever=float(np.linalg.norm(fit.sensitivity.d_moment[:, 3])) / size,
        shape=lambda: rod.solve(gravity, force, s, guess=eq.tip),
    )


def _fit_force(problem: Problem, s: float, lean: float) -> _ForceFit | None:
    """Fit the force at arclength s [m] by Gauss-Newton; None where there is no equilibrium or no convergence.

    Args:
        lean: how far friction moves the line of action from the sphere's centre [m].
    """
    rod, seen = problem.sources.model.rod, problem.seen
    force, tip, moved, whiten = seen.force, None, math.inf, None
    for _ in range(_ITERATIONS):
        eq = rod.solve(seen.gravity, force, s, guess=tip, columns="contact")
        if not eq.ok or eq.sensitivity is None:
            return None
        if whiten is None:  # the error sources are taken at the first guess
            whiten = np.linalg.inv(
                np.linalg.cholesky(_covariance(problem, s, lean, force, eq, eq.sensitivity))
            )
        r = whiten @ (eq.wrench_base - seen.wrench)
        J = whiten @ eq.sensitivity.d_wrench[:, :3]
        if moved < _CLOSE:
            return _ForceFit(eq, eq.sensitivity, force, r, J)
        step = -np.linalg.lstsq(J, r, rcond=None)[0]
        force, tip, moved = force + step, eq.tip, float(np.linalg.norm(J @ step))
    return None


def _covariance(
    problem: Problem, s: float, lean: float, force: Array, eq: Equilibrium, sensitivity: Sensitivity
) -> Array:
    """Return the covariance of the reading with error sources and friction, (6, 6)."""
    rod = problem.sources.model.rod
    touch, frame = np.zeros(TOUCH), eq.R_at(s)
    multistart.placed(rod.body, rod.flank_end, s, force, frame[:, 2].copy(), frame[:, 0].copy(), touch)
    touch[TIP:] = eq.tip
    D = np.nan_to_num(problem.sources.columns_at(touch)[1])
    # Friction adds a couple about the centre, of any direction across the force.
    couple = lean * float(np.linalg.norm(force)) * sensitivity.d_wrench[:, 4:7]
    return np.asarray(problem.noise + D[:6] @ D[:6].T + couple @ couple.T)


def _sphere(rod: Rod) -> tuple[float, float]:
    """Return the arclength of the sphere's centre and its radius [m], from the flank and the end of the rod."""
    tan = rod.taper_at(rod.flank_end)
    sin = tan / math.hypot(1.0, tan)
    blunt = float(rod.radius_at(rod.flank_end)) - tan * (rod.length - rod.flank_end)
    R = blunt * math.sqrt(1.0 - sin * sin) / (1.0 - sin)
    return rod.length - R, R
