"""What the curve of the probe adds to the ellipsoid of a fusion from one pose.

Presses from several poses pin the place down so well that its ellipsoid is linear. One pose knows it as vaguely as one
reading does, along a line that is bowed (`spread.py`); a fusion then takes the bow from there.
"""

import math
from dataclasses import dataclass

import numpy as np

from probedesign.estimation.likelihood import locate
from probedesign.estimation.observation import Observation
from probedesign.frames import Array
from probedesign.rod.rod import Rod


@dataclass(frozen=True)
class Bow:
    """Of one touch.

    Attributes:
        added: to the linear covariance of the contact's point, in base axes [m²], (3, 3).
        spread: trace of that linear covariance [m²].
    """

    added: Array
    spread: float

    def at(self, spread: float) -> Array:
        """What it adds where the linear covariance has that trace: it goes as its square, (3, 3)."""
        scaled: Array = self.added * (spread / self.spread) ** 2
        return scaled


def bow_of(rod: Rod, wrench: Array, cov: Array, gravity: Array) -> Bow | None:
    """The bow of the touch that a reading tells; None if it tells none.

    Args:
        rod: of the probe.
        wrench: read at the base, (6,); cov: its covariance, (6, 6).
        gravity: base axes [m/s²], (3,).
    """
    whiten = np.linalg.inv(np.linalg.cholesky(cov))
    places = locate(rod, Observation(wrench, whiten, gravity, rod.mass * gravity, math.inf))
    if not places:
        return None
    best = min(places, key=lambda place: place.chi2)
    linear, added = best.cov_linear_base, best.cov_contact_base - best.cov_linear_base
    if not (np.isfinite(linear).all() and np.isfinite(added).all()):
        return None
    return Bow(added, float(np.trace(linear)))
