"""The published force–moment method: the force by the paper's equation 5, then the arclength where that force makes the
measured moment.

The force may have any direction; it acts on the centreline, so the couple of a force at the surface is neglected.
Source: "Spatial Position Estimation of Lightweight and Delicate Objects using a Soft haptic Probe", equations 4 to 6.
"""

import numpy as np

from probedesign.core.frames import Array
from probedesign.estimation import multistart
from probedesign.estimation.covariance import propagate
from probedesign.estimation.estimate import Candidate
from probedesign.estimation.problem import Problem
from probedesign.estimation.surface_contact_kernel import TIP, TOUCH
from probedesign.rod.equilibrium import Equilibrium
from probedesign.rod.rod import Rod

DOF = 2
"""Three moments, one unknown."""


def locate(problem: Problem) -> list[Candidate]:
    """Return the places where the measured force makes the measured moment, or nearly.

    Args:
        problem: the reading and what it is known to.
    """
    return [_candidate(problem, eq) for eq in problem.scan.candidates]


def _candidate(problem: Problem, eq: Equilibrium) -> Candidate:
    assert eq.sensitivity is not None
    rod, seen = problem.sources.model.rod, problem.seen
    force = eq.load[0:3].copy()
    touch, R = np.zeros(TOUCH), eq.R_at(eq.s_contact)
    multistart.placed(rod.body, rod.flank_end, eq.s_contact, force, R[:, 2].copy(), R[:, 0].copy(), touch)
    touch[TIP:] = eq.tip
    D = np.nan_to_num(problem.sources.columns_at(touch)[1])
    cov = propagate(eq.sensitivity, problem.noise, (D[:6], D[9:12]))
    misfit = eq.wrench_base[3:6] - seen.wrench[3:6]
    size = float(np.linalg.norm(force))
    surface = surface_point(rod, eq)
    out = (surface - eq.p_contact_base) / max(float(np.linalg.norm(surface - eq.p_contact_base)), 1e-300)
    # Where around the section the force acts follows from its direction, which friction turns.
    radius = float(rod.radius_at(eq.s_contact))
    lean = radius * min(problem.friction, 1.0)
    cov_surface = cov.cov_p + lean**2 * (np.eye(3) - np.outer(out, out))
    return Candidate(
        s_contact=eq.s_contact,
        std_s=cov.std_s,
        p_contact_base=eq.p_contact_base,
        p_surface_base=surface,
        force_base=force,
        cov_contact_base=cov.cov_p,
        cov_surface_base=cov_surface,
        force_normal=float("nan"),
        force_tangential=float("nan"),
        chi2=float(misfit @ np.linalg.solve(cov.moment_misfit, misfit)),
        dof=DOF,
        lever=float(np.linalg.norm(eq.sensitivity.d_moment[:, 3])) / max(size, 1e-300),
        at_end=eq.s_contact in (0.0, rod.flank_end),
        shape=lambda: eq,
    )


def surface_point(rod: Rod, eq: Equilibrium) -> Array:
    """The touched point of the surface, where the force's line leaves the body.

    The outward normal at the touched section leans towards the tip by α, so with r the radius at
    s_contact the touched section lies r cos α sin α further out and has radius r cos² α.
    """
    s = eq.s_contact
    tan = rod.taper_at(s)
    cos2 = 1.0 / (1.0 + tan * tan)
    radius = float(rod.radius_at(s)) * cos2
    there = min(s + radius * tan, rod.length)
    R = eq.R_at(there)
    inward = eq.load[0:3] - R[:, 2] * float(R[:, 2] @ eq.load[0:3])
    norm = float(np.linalg.norm(inward))
    out = -inward / norm if norm > 0.0 else np.zeros(3)
    return eq.p_at(there) + radius * out
