"""What an estimate is made from: one reading at the base, or the mean of a window of them."""

import math
from dataclasses import dataclass

import numpy as np

from probedesign.estimator.model import ProbeModel
from probedesign.frames import Array

NUMERICAL = 1e-6
"""Error of the fast solve's base moment, relative: no reading is held against it more closely."""
NEGLIGIBLE = 1e-2
"""Standard deviations of the moment that this error may make without being counted."""


@dataclass(frozen=True)
class Observation:
    """A base wrench with how well it is known.

    Attributes:
        wrench: [N, N·m], (6,).
        cov: its covariance, (6, 6).
        whiten: lower triangular, with whitenᵀ whiten = cov⁻¹, (6, 6).
        gravity: base axes [m/s²], (3,).
        weight: of the flexible part [N], (3,).
    """

    wrench: Array
    cov: Array
    whiten: Array
    gravity: Array
    weight: Array

    @classmethod
    def of(cls, model: ProbeModel, wrench: Array, gravity: Array, readings: int = 1) -> "Observation":
        """The mean of so many independent readings, each with the model's noise."""
        numerical = NUMERICAL * math.sqrt(wrench[3:] @ wrench[3:])
        cov, weight = model.noise_base() / readings, model.mass * gravity
        if numerical <= NEGLIGIBLE * model.noise.moment / math.sqrt(readings):
            return cls(wrench, cov, model.whiten * math.sqrt(readings), gravity, weight)
        cov[[3, 4, 5], [3, 4, 5]] += numerical**2
        return cls(wrench, cov, np.linalg.inv(np.linalg.cholesky(cov)), gravity, weight)

    @property
    def force(self) -> Array:
        """Of the contact, by the paper's equation 5 [N], (3,)."""
        return self.wrench[0:3] - self.weight
