"""A point of the world as touches locate it, given the error sources that all touches of a run share.

A fusion of one touch leaves the information matrix Λ and vector η of the touched point x, of the error sources m, each
in standard deviations of its prior, and of the sensor's bias. With the bias marginalised, the touch gives the point as
a conditional distribution and what it observes of m itself:

    x = a + B m + e,   e ~ N(0, S),   S = Λxx⁻¹,  B = -S Λxm,  a = S ηx
    information on m: Λmm - Λmx S Λxm,   its vector: ηm - Λmx S ηx,   both without the prior

Stiffness, diameters, length, root, pose of the base, gravity and gain are the same in every touch of a run, so that m
is one vector: the joint map adds the information of all touches on it to the unit prior, once. Two touches of one point
become one by the same terms, and their difference is an observation of m. The bias, and the stiffness that scatters
from touch to touch, belong to each touch alone.
"""

from dataclasses import dataclass

import numpy as np

from probedesign.estimation.fusion_state import FusionState
from probedesign.frames import Array

CLEAR = 1e-9
"""Information on a common error source, over its prior, below which it is rounding."""


@dataclass(frozen=True)
class Located:
    """The point of one or more touches, conditional on the common error sources.

    Attributes:
        a: the point if all common error sources were zero [m], (3,).
        B: derivative of the point by the common error sources in standard deviations of their priors [m], (3, J).
        S: covariance of the point if they were known [m²], (3, 3).
        information: on the common error sources, their prior not counted, (J, J).
        vector: that information times the value that these touches give them, (J,).
        names: the error source of each column, as `ErrorSources.names`.
    """

    a: Array
    B: Array
    S: Array
    information: Array
    vector: Array
    names: tuple[str, ...] = ()

    @classmethod
    def of(cls, state: FusionState, added: Array) -> "Located":
        """Return what the fusion of one touch gives.

        Args:
            state: of the fusion, linearised and solved with its own priors.
            added: covariance that the linearised fusion does not hold [m²], (3, 3).
        """
        information, vector = state.information()
        J = state.causes
        x, m = slice(0, 3), slice(3, 3 + J)
        S = np.linalg.inv(information[x, x])
        B = -S @ information[x, m]
        on_m = information[m, m] - np.eye(J) + information[m, x] @ B
        values, vectors = np.linalg.eigh(0.5 * (on_m + on_m.T))
        kept = vectors[:, values > CLEAR]
        on_m = (kept * values[values > CLEAR]) @ kept.T
        pull = kept @ (kept.T @ (vector[m] - information[m, x] @ S @ vector[x]))
        names = state.fusion.sources[0].names
        return cls(S @ vector[x], B, 0.5 * (S + S.T) + added, on_m, pull, names)

    def at(self, common: Array) -> Array:
        """Return the point for given common error sources [m], (3,)."""
        point: Array = self.a + self.B @ common
        return point

    def cov(self, cov_common: Array) -> Array:
        """Return the covariance of the point for a covariance of the common error sources [m²], (3, 3)."""
        cov: Array = self.S + self.B @ cov_common @ self.B.T
        return cov

    def with_(self, other: "Located") -> "Located":
        """Return both as one point."""
        mine, others = np.linalg.inv(self.S), np.linalg.inv(other.S)
        S = np.linalg.inv(mine + others)
        apart, by = self.a - other.a, self.B - other.B
        weight = np.linalg.inv(self.S + other.S)
        return Located(
            S @ (mine @ self.a + others @ other.a),
            S @ (mine @ self.B + others @ other.B),
            0.5 * (S + S.T),
            self.information + other.information + by.T @ weight @ by,
            self.vector + other.vector - by.T @ weight @ apart,
            self.names,
        )
