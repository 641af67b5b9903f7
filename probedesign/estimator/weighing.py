"""How one reading is known at a touch that may have made it, with its probe's tolerances: compiled."""

import numpy as np

from probedesign.estimator import doubt_kernel as kernel
from probedesign.estimator.doubts import Doubts
from probedesign.estimator.observation import Observation
from probedesign.frames import Array


class Weighing:
    """Of one reading; what it tells is of the touch it was last asked `at`.

    Attributes:
        wrench: of the reading by each cause, one standard deviation a column, (6, j).
        point: of the touched point [m], (3, j).
    """

    def __init__(self, doubts: Doubts, seen: Observation) -> None:
        """Args:
        doubts: of the probe under the reading's gravity.
        seen: the reading, with its noise alone.
        """
        arrays = doubts.arrays
        body, causes = doubts.model.rod.body, arrays.still.shape[1]
        self.wrench, self.point = np.empty((6, causes)), np.empty((3, causes))
        self._told = np.empty(kernel.TOLD)
        self._reading = body, seen.gravity, seen.weight, seen.wrench, seen.whiten, *arrays
        self._work = np.empty(kernel.room_for(len(body.knots), causes))

    def at(self, touch: Array) -> bool:
        """Weigh the reading as at a touch, (fit.STATE,); whether the probe holds it."""
        return bool(kernel.weigh(*self._reading, touch, self._work, self.wrench, self.point, self._told))

    @property
    def whiten(self) -> Array:
        """Lower triangular, with whitenᵀ whiten the inverse of the reading's covariance, a copy, (6, 6)."""
        return self._told[kernel.WHITEN : kernel.COV].reshape(6, 6).copy()

    @property
    def cov_point(self) -> Array:
        """Of the contact point [m²] to first order, infinite where the reading does not tell it, (3, 3)."""
        if not self._told[kernel.KNOWN]:
            return np.full((3, 3), np.inf)
        return self._told[kernel.COV : kernel.KNOWN].reshape(3, 3).copy()
