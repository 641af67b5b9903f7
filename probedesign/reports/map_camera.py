"""How the world is seen: from far away, so that parallel lines stay parallel."""

import math
from dataclasses import dataclass

import numpy as np

from probedesign.frames import Array


@dataclass(frozen=True)
class View:
    """A direction to look along.

    Attributes:
        azimuth: of the eye about the world's z axis, from where it looks along y [rad].
        elevation: of the eye over the ground [rad].
    """

    azimuth: float = math.radians(28.0)
    elevation: float = math.radians(22.0)

    @property
    def axes(self) -> Array:
        """To the right and up on the picture, in the world, (2, 3)."""
        a, e = self.azimuth, self.elevation
        right = (math.cos(a), math.sin(a), 0.0)
        up = (-math.sin(a) * math.sin(e), math.cos(a) * math.sin(e), math.cos(e))
        return np.array([right, up])

    def seen(self, points: Array) -> Array:
        """Points (n, 3) on the picture, right and up, (n, 2)."""
        flat: Array = np.asarray(points) @ self.axes.T
        return flat

    def ellipse(self, cov: Array) -> tuple[float, float, float]:
        """The outline of an ellipsoid of that covariance, one standard deviation: half-axes and the angle of the first
        one from the right, counted upwards [rad]."""
        flat = self.axes @ cov @ self.axes.T
        values, vectors = np.linalg.eigh(flat)
        long, short = np.sqrt(np.maximum(values[::-1], 0.0))
        return float(long), float(short), math.atan2(float(vectors[1, 1]), float(vectors[0, 1]))
