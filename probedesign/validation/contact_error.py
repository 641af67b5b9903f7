"""How far an estimated contact is from the reference's, beside what both state."""

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from probedesign.campaigns.campaign import Campaign, Test
from probedesign.estimation.estimate import Estimate
from probedesign.frames import Array
from probedesign.units import MM
from probedesign.validation.taring import cov_of_pose

CONFIDENCE = 0.05
"""Share that a 95 % ellipsoid leaves out."""
LEAST_REFERENCE = 1e-3 * MM
"""A reference is never taken for better than a micrometre [m], which keeps its covariance regular."""


@dataclass(frozen=True, eq=False)
class Miss:
    """How far an estimated contact is from the reference's, in the base frame.

    Attributes:
        error: estimated minus measured [m]: of the point (3,), or of the arclength alone (1,).
        cov: that the estimate and the reference state together [m²], (d, d).
        cov_reference: the reference's share, with the pose of the base.
    """

    error: Array
    cov: Array
    cov_reference: Array

    @property
    def size(self) -> float:
        """[m]."""
        return float(np.linalg.norm(self.error))

    @property
    def expected(self) -> float:
        """RMS of the size, as stated [m]."""
        return math.sqrt(float(np.trace(self.cov)))

    @property
    def nees(self) -> float:
        """Normalised estimation error squared: χ² of as many degrees of freedom as there are axes, if all is true."""
        return float(self.error @ np.linalg.solve(self.cov, self.error))

    @property
    def dof(self) -> int:
        """Axes."""
        return len(self.error)

    @property
    def within_95(self) -> bool:
        """Whether the reference lies within the 95 % ellipsoid."""
        return bool(self.nees <= chdtri(self.dof, CONFIDENCE))

    @property
    def z(self) -> Array:
        """Error over its standard deviation, axis by axis, (d,)."""
        return np.asarray(self.error / np.sqrt(np.diag(self.cov)))


def miss_of(
    campaign: Campaign,
    test: Test,
    estimate: Estimate | None,
    contact: Array | None,
) -> Miss | None:
    """Of the touched point where the reference saw it, else of the arclength where that is known.

    Args:
        campaign: the test is of.
        test: with what is known.
        estimate: of it.
        contact: touched point in the base frame [m], (3,).
    """
    if estimate is None or not estimate.ok:
        return None
    if contact is not None:
        own = cov_of_pose(campaign, contact) + max(test.std_contact, LEAST_REFERENCE) ** 2 * np.eye(3)
        return Miss(estimate.p_surface_base - contact, estimate.cov_surface_base + own, own)
    if not math.isnan(test.s_contact):
        reference = np.array([[max(test.std_s, LEAST_REFERENCE) ** 2]])
        off = np.array([estimate.s_contact - test.s_contact])
        return Miss(off, reference + estimate.std_s**2, reference)
    return None
