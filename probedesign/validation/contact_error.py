"""Error of an estimated contact against the reference, the covariance of both, and the predicted error."""

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from probedesign.campaigns.campaign import Campaign, Test
from probedesign.core.frames import Array
from probedesign.core.units import MM
from probedesign.estimation.estimate import Estimate
from probedesign.estimation.estimator import Estimator
from probedesign.estimation.model import ProbeModel
from probedesign.prediction.predict import predict_touch

TAIL = 0.05
"""Probability outside a 95 % ellipsoid."""
MIN_REFERENCE_STD = 1e-3 * MM
"""Smallest standard deviation of a reference [m], which keeps its covariance regular."""


@dataclass(frozen=True, eq=False)
class ContactError:
    """Error of an estimated contact against the reference, in the base frame.

    Attributes:
        error: estimated minus measured [m]: of the point (3,), or of the arclength alone (1,).
        cov: of estimate and reference together, as stated [m²], (d, d).
        cov_reference: the reference's share, with the pose of the base [m²], (d, d).
    """

    error: Array
    cov: Array
    cov_reference: Array

    @property
    def size(self) -> float:
        """Norm of the error [m]."""
        return float(np.linalg.norm(self.error))

    @property
    def expected(self) -> float:
        """RMS of the norm by the stated covariance [m]."""
        return math.sqrt(float(np.trace(self.cov)))

    @property
    def nees(self) -> float:
        """Normalised estimation error squared: χ² with `dof` degrees of freedom if the covariance is correct."""
        return float(self.error @ np.linalg.solve(self.cov, self.error))

    @property
    def dof(self) -> int:
        """Degrees of freedom: number of axes."""
        return len(self.error)

    @property
    def within_95(self) -> bool:
        """Whether the reference lies within the 95 % ellipsoid."""
        return bool(self.nees <= chdtri(self.dof, TAIL))

    @property
    def z(self) -> Array:
        """Error over its standard deviation, axis by axis, (d,)."""
        return np.asarray(self.error / np.sqrt(np.diag(self.cov)))


def contact_error(
    campaign: Campaign, test: Test, estimate: Estimate | None, contact: Array | None
) -> ContactError | None:
    """Return the error of the touched point if the reference measured it, else of the arclength if that is known.

    Args:
        campaign: of the test.
        test: with what is known.
        estimate: of it.
        contact: measured point in the base frame [m], (3,).
    """
    if estimate is None or not estimate.ok:
        return None
    if contact is not None:
        own = cov_by_base_pose(campaign, contact) + max(test.std_contact, MIN_REFERENCE_STD) ** 2 * np.eye(3)
        return ContactError(estimate.p_surface_base - contact, estimate.cov_surface_base + own, own)
    if not math.isnan(test.s_contact):
        reference = np.array([[max(test.std_s, MIN_REFERENCE_STD) ** 2]])
        error = np.array([estimate.s_contact - test.s_contact])
        return ContactError(error, reference + estimate.std_s**2, reference)
    return None


def cov_by_base_pose(campaign: Campaign, p_base: Array) -> Array:
    """Return the covariance of points of the base frame by the uncertainty of its pose [m²], (..., 3) → (..., 3, 3)."""
    squared = np.einsum("...i,...i->...", p_base, p_base)[..., None, None] * np.eye(3)
    lever = squared - p_base[..., :, None] * p_base[..., None, :]
    return np.asarray(campaign.std_base**2 * np.eye(3) + campaign.std_tilt**2 * lever)


def predicted_error(model: ProbeModel, fraction: float, force: float, push_direction: str) -> float:
    """Return the RMS error that `predict` states for such a touch, full error budget: one reading, the design's own
    mount and tolerances, no reference [m]. NaN if it predicts no location, or if an argument is missing.

    Args:
        model: of the probe.
        fraction: contact over length; NaN if not known.
        force: [N]; NaN if not known.
        push_direction: of the object, a key of `DIRECTIONS`; empty if not known.
    """
    if not 0.0 < fraction <= 1.0 or not force > 0.0 or not push_direction:
        return math.nan
    predicted = predict_touch(Estimator(model), fraction, force, push_direction)
    if predicted.result != "ok" or predicted.predicted_error_mm is None:
        return math.nan
    return predicted.predicted_error_mm * MM
