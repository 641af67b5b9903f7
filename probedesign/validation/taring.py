"""Readings of a campaign as the estimator wants them: at the base, less what the free probe reads too much."""

import math
from dataclasses import dataclass, replace

import numpy as np

from probedesign.campaigns.campaign import Campaign, Test
from probedesign.estimation.estimator import Estimator
from probedesign.estimation.model import ProbeModel
from probedesign.estimation.tolerances import Tolerances
from probedesign.frames import Array

SAME_WAY = math.cos(math.radians(1.0))
"""Free tests tare those in which gravity pulls the same way, to a degree."""


@dataclass(frozen=True, eq=False)
class Reading:
    """What the sensor told of one test.

    Attributes:
        wrenches_base: one row a reading [N, N·m], (n, 6).
        gravity_base: as the base is said to stand [m/s²], (3,).
        tares: free tests that it was tared by; 0 where there was none.
    """

    wrenches_base: Array
    gravity_base: Array
    tares: int


def gravity_of(campaign: Campaign, test: Test) -> Array:
    """Gravity in the base axes of a test [m/s²], (3,)."""
    return np.asarray(test.T_world_base[:3, :3].T @ campaign.gravity_world)


def reading_of(campaign: Campaign, test: Test, estimator: Estimator) -> Reading:
    """The readings of one test, tared by the free tests that have any; a free test by the others of them.

    Args:
        campaign: the test is of.
        test: with wrenches.
        estimator: of the probe.
    """
    gravity = gravity_of(campaign, test)
    own = _at_base(estimator.model, test, gravity)
    free = [
        t
        for t in campaign.tests
        if t.free and len(t.wrenches) and t is not test and _alike(campaign, t, gravity)
    ]
    if not free:
        return Reading(own, gravity, 0)
    offs = []
    for other in free:
        pulled = gravity_of(campaign, other)
        offs.append(
            _at_base(estimator.model, other, pulled).mean(axis=0) - estimator.free(pulled).wrench_base
        )
    return Reading(own - np.mean(offs, axis=0), gravity, len(free))


def tolerances_of(campaign: Campaign, model: ProbeModel, reading: Reading) -> Tolerances:
    """How well the probe is known in this campaign: gravity's direction no better than the base stands, the bias no
    better than the tare was.

    A tare of k tests drifts as they did: by 1/√k, and its noise is that of as many readings as they had, taken for as
    many as the test's own.
    """
    known = Tolerances.of(model)
    gravity_deg = math.hypot(known.gravity_deg, math.degrees(campaign.std_tilt))
    if not reading.tares:
        return replace(known, gravity_deg=gravity_deg, tared=False)
    noise = 1.0 / (model.averaging_samples * len(reading.wrenches_base) * reading.tares)
    drift = math.sqrt(known.drift_steps**2 * (1.0 + 1.0 / reading.tares) + noise)
    return replace(known, gravity_deg=gravity_deg, drift_steps=drift, tared=True)


def cov_of_pose(campaign: Campaign, p_base: Array) -> Array:
    """Covariance of a point of the base frame by what is not known of its pose [m²], (..., 3) to (..., 3, 3)."""
    squared = np.einsum("...i,...i->...", p_base, p_base)[..., None, None] * np.eye(3)
    lever = squared - p_base[..., :, None] * p_base[..., None, :]
    return np.asarray(campaign.std_base**2 * np.eye(3) + campaign.std_tilt**2 * lever)


def _at_base(model: ProbeModel, test: Test, gravity: Array) -> Array:
    return test.wrenches if test.frame == "base" else model.to_base(test.wrenches, gravity)


def _alike(campaign: Campaign, other: Test, gravity: Array) -> bool:
    pulled = gravity_of(campaign, other)
    return bool(pulled @ gravity >= SAME_WAY * np.linalg.norm(pulled) * np.linalg.norm(gravity))
