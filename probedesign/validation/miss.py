"""How far an estimated contact is from the reference's, beside what both state."""

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri

from probedesign.campaign.campaign import Campaign, Test
from probedesign.estimation.estimate import Estimate
from probedesign.estimation.estimator import Estimator, Method
from probedesign.estimation.tolerances import Tolerances
from probedesign.frames import Array
from probedesign.units import MM
from probedesign.validation.taring import Reading, cov_of_pose

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
    estimator: Estimator,
    method: Method,
    estimate: Estimate | None,
    contact: Array | None,
    reading: Reading,
) -> Miss | None:
    """Of the touched point where the reference saw it, else of the arclength where that is known.

    Args:
        campaign: the test is of.
        test: with what is known.
        estimator: that estimated it.
        method: by which.
        estimate: of it.
        contact: touched point in the base frame [m], (3,).
        reading: that it was estimated from.
    """
    if estimate is None or not estimate.ok:
        return None
    if contact is not None:
        own = cov_of_pose(campaign, contact) + max(test.std_contact, LEAST_REFERENCE) ** 2 * np.eye(3)
        stated = _cov_of_surface(estimator, method, estimate, reading)
        return Miss(estimate.p_surface_base - contact, stated + own, own)
    if not math.isnan(test.s_contact):
        reference = np.array([[max(test.std_s, LEAST_REFERENCE) ** 2]])
        off = np.array([estimate.s_contact - test.s_contact])
        return Miss(off, reference + estimate.std_s**2, reference)
    return None


def _cov_of_surface(estimator: Estimator, method: Method, estimate: Estimate, reading: Reading) -> Array:
    """Covariance of the touched point [m²], (3, 3): that of the axis, which the estimate states, and what the way from
    there to the surface adds.

    The way turns with the force, whose components across are each as uncertain as the sensor. It is a radius long, and
    a thicker probe is stiffer too: so what a diameter's tolerance moves the axis by is replaced by what it moves the
    touched point by, found by estimating once more with a thicker probe.
    """
    known, model, shape = estimator.tolerances, estimator.model, estimate.shape
    way = estimate.p_surface_base - estimate.p_contact_base
    if shape is None or not way.any():
        return estimate.cov_contact_base
    drift = 0.0 if known is None else known.drift_steps**2 * model.averaging_samples
    std_force = model.noise.force * math.sqrt(1.0 / len(reading.wrenches_base) + drift)
    turn = std_force / float(np.linalg.norm(estimate.force_base))
    aside = turn * np.cross(shape.R_at(estimate.s_contact)[:, 2], way)
    cov = estimate.cov_contact_base + np.outer(aside, aside)
    thicker = None if known is None else _thicker(estimator, known, method, estimate, reading)
    if thicker is None:
        return np.asarray(cov)
    axis, surface = (getattr(thicker, p) - getattr(estimate, p) for p in ("p_contact_base", "p_surface_base"))
    return np.asarray(cov + np.outer(surface, surface) - np.outer(axis, axis))


def _thicker(
    estimator: Estimator, known: Tolerances, method: Method, estimate: Estimate, reading: Reading
) -> Estimate | None:
    """The same reading, estimated with a probe thicker by a standard deviation; None where that tells no place."""
    model, gravity = estimator.model, reading.gravity_base
    radius = model.rod.radius + np.maximum(
        known.diameter_mm * MM / 2.0, known.diameter_share * model.rod.radius
    )
    other = Estimator(replace(model, rod=replace(model.rod, radius=radius)), known)
    retared = other.free(gravity).wrench_base - estimator.free(gravity).wrench_base if reading.tares else 0.0
    found = other.estimate(reading.wrenches_base + retared, gravity, method=method, near=estimate)
    return found if found.ok else None
