"""The paper's method: the force by its equation 5, then the arclength where that force makes the measured moment.

The force may have any direction: friction is not assumed away.
"""

import numpy as np

from probedesign.estimation.covariance import propagate
from probedesign.estimation.doubts import Doubts
from probedesign.estimation.estimate import Candidate
from probedesign.estimation.locate import Scan
from probedesign.estimation.observation import Observation
from probedesign.frames import Array
from probedesign.rod.equilibrium import Equilibrium
from probedesign.rod.rod import Rod

DOF = 2
"""Three moments, one unknown."""


def locate(
    rod: Rod, seen: Observation, scan: Scan | None = None, doubts: Doubts | None = None
) -> list[Candidate]:
    """The places where the measured force makes the measured moment, or nearly.

    Args:
        rod: of the probe.
        seen: the reading.
        scan: of it, if there is one already.
        doubts: how well the probe is known, under the reading's gravity; None takes it as exact.
    """
    return [_candidate(rod, seen, eq, doubts) for eq in (scan or Scan.of(rod, seen)).candidates]


def _candidate(rod: Rod, seen: Observation, eq: Equilibrium, doubts: Doubts | None) -> Candidate:
    assert eq.sensitivity is not None
    cov = (
        propagate(eq.sensitivity, seen.cov)
        if doubts is None
        else propagate(eq.sensitivity, seen.cov + doubts.drift, doubts.held(eq))
    )
    misfit = eq.wrench_base[3:6] - seen.wrench[3:6]
    force = eq.load[0:3].copy()
    size = float(np.linalg.norm(force))
    return Candidate(
        s_contact=eq.s_contact,
        std_s=cov.std_s,
        p_contact_base=eq.p_contact_base,
        p_surface_base=surface_point(rod, eq),
        force_base=force,
        cov_contact_base=cov.cov_p,
        chi2=float(misfit @ np.linalg.solve(cov.moment_misfit, misfit)),
        dof=DOF,
        lever=float(np.linalg.norm(eq.sensitivity.d_moment[:, 3])) / max(size, 1e-300),
        tip=eq.tip,
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
    radius = float(np.interp(s, rod.s, rod.radius)) * cos2
    there = min(s + radius * tan, rod.length)
    R = eq.R_at(there)
    inward = eq.load[0:3] - R[:, 2] * float(R[:, 2] @ eq.load[0:3])
    norm = float(np.linalg.norm(inward))
    out = -inward / norm if norm > 0.0 else np.zeros(3)
    return eq.p_at(there) + radius * out
