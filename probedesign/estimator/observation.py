"""What an estimate is made from: one reading at the base, or the mean of a window of them."""

from dataclasses import dataclass

import numpy as np

from probedesign.estimator.model import ProbeModel
from probedesign.frames import Array

NUMERICAL = 1e-6
"""Error of the fast solve's base moment, relative: no reading is held against it more closely."""


@dataclass(frozen=True)
class Observation:
    """A base wrench with how well it is known.

    Attributes:
        wrench: [N, N·m], (6,).
        cov: its covariance, the solver's own error of the moment included, (6, 6).
        gravity: base axes [m/s²], (3,).
        weight: of the flexible part [N], (3,).
    """

    wrench: Array
    cov: Array
    gravity: Array
    weight: Array

    @classmethod
    def of(cls, model: ProbeModel, wrench: Array, gravity: Array, readings: int = 1) -> "Observation":
        """The mean of so many independent readings, each with the model's noise."""
        cov = model.noise_base() / readings
        numerical = NUMERICAL**2 * float(wrench[3:6] @ wrench[3:6])
        return cls(wrench, cov + np.diag([0.0] * 3 + [numerical] * 3), gravity, model.mass * gravity)

    @property
    def force(self) -> Array:
        """Of the contact, by the paper's equation 5 [N], (3,)."""
        return self.wrench[0:3] - self.weight

    @property
    def whiten(self) -> Array:
        """Lower triangular, with whitenᵀ whiten = cov⁻¹, (6, 6)."""
        inverse: Array = np.linalg.inv(np.linalg.cholesky(self.cov))
        return inverse
