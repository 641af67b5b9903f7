"""What page and picture show: points, how large their ellipsoids, and what was truly touched if a simulation tells."""

import math
from dataclasses import dataclass

import numpy as np

from probedesign.frames import Array
from probedesign.mapping.contact_map import WITHIN_95, Cloud
from probedesign.units import MM

FEWEST_MM = 10.0
"""What is shown at least, so that one point is not blown up without bounds."""
TIMES = (1, 5, 10)
"""How many times its size an ellipsoid may be drawn."""
SEEN = 0.02
"""Half-axis over the scene's radius from which an ellipsoid is seen: five pixels or so."""


@dataclass(frozen=True)
class Scene:
    """What is shown.

    Attributes:
        cloud: its located points.
        truth: outlines of what was touched, where a simulation tells them [m], (k, 3) each, closed; the first side is
            the edge that was touched.
    """

    cloud: Cloud
    truth: tuple[Array, ...] = ()

    @property
    def middle_mm(self) -> Array:
        """Of all of it [mm], (3,)."""
        everything = self._everything_mm
        return np.asarray(0.5 * (everything.min(axis=0) + everything.max(axis=0)))

    @property
    def radius_mm(self) -> float:
        """About the middle [mm]."""
        far = np.linalg.norm(self._everything_mm - self.middle_mm, axis=1)
        return max(float(far.max()), 0.5 * FEWEST_MM)

    @property
    def times(self) -> int:
        """How many times their size ellipsoids are drawn at first: the least by which half of them are seen."""
        longest = [np.linalg.eigvalsh(point.cov_world)[-1] for point in self.cloud.points]
        half = math.sqrt(WITHIN_95 * float(np.median(longest))) / MM if longest else self.radius_mm
        return next((times for times in TIMES if times * half >= SEEN * self.radius_mm), TIMES[-1])

    @property
    def _everything_mm(self) -> Array:
        points = np.array([point.p_world for point in self.cloud.points]).reshape(-1, 3)
        everything = np.concatenate([points, *self.truth]) / MM
        return everything if len(everything) else np.zeros((1, 3))
