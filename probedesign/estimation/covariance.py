"""First-order propagation of a reading's noise, and of a probe's tolerances, to what the paper's method finds."""

from dataclasses import dataclass

import numpy as np

from probedesign.core.frames import Array
from probedesign.rod.equilibrium import Sensitivity

NO_CAUSES = np.zeros((6, 0)), np.zeros((3, 0))
"""Error sources of a probe without model errors: none."""


@dataclass(frozen=True)
class ContactCovariance:
    """Propagation of wrench noise and model errors to the estimate.

    Attributes:
        s_by_wrench: ds_contact/dwrench, (6,).
        p_by_wrench: dp_contact/dwrench, (3, 6).
        moment_misfit: covariance of the moment misfit M(s; F) - M for the true s [N²·m²], (3, 3).
        noise: covariance of the reading's noise, (6, 6).
        wrench: of the reading by each cause, one standard deviation a column, (6, j).
        point: of the true point by the same [m], (3, j).
    """

    s_by_wrench: Array
    p_by_wrench: Array
    moment_misfit: Array
    noise: Array
    wrench: Array
    point: Array

    @property
    def cov_wrench(self) -> Array:
        """Return the covariance of the reading, (6, 6)."""
        return np.asarray(self.noise + self.wrench @ self.wrench.T)

    @property
    def std_s(self) -> float:
        """Return the standard deviation of s_contact [m]."""
        return float(np.sqrt(self.s_by_wrench @ self.cov_wrench @ self.s_by_wrench))

    @property
    def cov_p(self) -> Array:
        """Return the covariance of the contact point [m²], (3, 3)."""
        off = self.p_by_wrench @ self.wrench - self.point
        return np.asarray(self.p_by_wrench @ self.noise @ self.p_by_wrench.T + off @ off.T)


def propagate(
    sensitivity: Sensitivity, noise: Array, causes: tuple[Array, Array] = NO_CAUSES
) -> ContactCovariance:
    """Propagate covariances to the published estimate: force by equation 5, then s by least squares on the moment.

    With a = ∂M/∂s and B = ∂M/∂F along the equilibria, a reading off by (ε_F, ε_M) moves
    s by aᵀ(ε_M - B ε_F)/(aᵀa) and the contact point by p_s δs + p_F ε_F.

    Args:
        sensitivity: of the equilibrium at the estimate, its load columns.
        noise: covariance of the base wrench by noise alone, (6, 6).
        causes: of reading and true point by each cause, one standard deviation a column, (6, j) and (3, j).

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
    known = misfit_by_wrench @ causes[0]
    moment_misfit = misfit_by_wrench @ noise @ misfit_by_wrench.T + known @ known.T
    return ContactCovariance(s_by_wrench, p_by_wrench, moment_misfit, noise, *causes)
