"""What a reading can tell at best: Cramér and Rao's bound for a contact without friction."""

from dataclasses import dataclass

import numpy as np

from probedesign.frames import Array
from probedesign.rod.contact import FrictionlessContact


@dataclass(frozen=True)
class Bound:
    """No unbiased estimator scatters less.

    Attributes:
        cov: of (s_contact, angle, magnitude), (3, 3).
        cov_p: of the contact point on the centreline [m²], (3, 3).
    """

    cov: Array
    cov_p: Array

    @property
    def std_s(self) -> float:
        """Of s_contact [m]."""
        return float(np.sqrt(self.cov[0, 0]))


def contact_bound(contact: FrictionlessContact, cov_wrench: Array) -> Bound:
    """Of one touch: with J = ∂wrench/∂θ, P = ∂p/∂θ and θ = (s, angle, magnitude),

        cov θ = (Jᵀ Σ⁻¹ J)⁻¹,  cov p = P cov θ Pᵀ.

    Args:
        contact: solved.
        cov_wrench: Σ, (6, 6).

    Returns:
        The bound; infinite where the reading leaves something open.
    """
    J, P = contact.d_wrench, contact.d_position
    white = np.linalg.solve(np.linalg.cholesky(cov_wrench), J)
    scale = np.linalg.norm(white, axis=0)
    if not (np.isfinite(scale).all() and (scale > 0.0).all()):
        return Bound(np.full((3, 3), np.inf), np.full((3, 3), np.inf))
    R = np.linalg.qr(white / scale)[1]
    if np.abs(np.diag(R)).min() < 1e-12:
        return Bound(np.full((3, 3), np.inf), np.full((3, 3), np.inf))
    root = np.linalg.inv(R) / scale[:, None]
    return Bound(root @ root.T, P @ root @ root.T @ P.T)
