"""First-order propagation of a reading's noise to the contact that the paper's method finds."""

from dataclasses import dataclass

import numpy as np

from probedesign.frames import Array
from probedesign.rod.equilibrium import Sensitivity


@dataclass(frozen=True)
class ContactCovariance:
    """How noise of the base wrench shows in the answer.

    Attributes:
        s_by_wrench: ds_contact/dwrench, (6,).
        p_by_wrench: dp_contact/dwrench, (3, 6).
        moment_misfit: covariance of the moment misfit M(s; F) - M for the true s [N²·m²], (3, 3).
        cov_wrench: of the reading, (6, 6).
    """

    s_by_wrench: Array
    p_by_wrench: Array
    moment_misfit: Array
    cov_wrench: Array

    @property
    def std_s(self) -> float:
        """Standard deviation of s_contact [m]."""
        return float(np.sqrt(self.s_by_wrench @ self.cov_wrench @ self.s_by_wrench))

    @property
    def cov_p(self) -> Array:
        """Covariance of the contact point [m²], (3, 3)."""
        return self.p_by_wrench @ self.cov_wrench @ self.p_by_wrench.T


def propagate(sensitivity: Sensitivity, cov_wrench: Array) -> ContactCovariance:
    """Covariance of the paper's estimate: force by equation 5, then s by least squares on the moment.

    With a = ∂M/∂s and B = ∂M/∂F along the equilibria, a reading off by (ε_F, ε_M) moves
    s by aᵀ(ε_M - B ε_F)/(aᵀa) and the contact point by p_s δs + p_F ε_F.

    Args:
        sensitivity: of the equilibrium at the estimate, its load columns.
        cov_wrench: of the base wrench, (6, 6).

    Returns:
        The covariance; std_s is infinite where the moment does not depend on s.
    """
    d_wrench, d_p = sensitivity.d_wrench, sensitivity.d_position
    B, a = d_wrench[3:6, 0:3], d_wrench[3:6, 3]
    misfit_by_wrench = np.hstack([B, -np.eye(3)])
    square = float(a @ a)
    with np.errstate(divide="ignore", invalid="ignore"):
        s_by_wrench = -(a @ misfit_by_wrench) / square
    p_by_wrench = np.outer(d_p[:, 3], s_by_wrench)
    p_by_wrench[:, 0:3] += d_p[:, 0:3]
    moment_misfit = misfit_by_wrench @ cov_wrench @ misfit_by_wrench.T
    return ContactCovariance(s_by_wrench, p_by_wrench, moment_misfit, cov_wrench)
