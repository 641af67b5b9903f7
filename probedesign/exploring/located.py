"""A point of the world as touches tell it, by what is common to all touches.

The stiffness of the probe and the place and turn of its base are the same unknowns in every touch of a run. So a touch
tells its point p only by them,

    p = a + B c,   up to an error of its own with covariance S,

c being the logarithm of the stiffness, the base's offset and its turn; and it tells something of c itself. Two touches
of one point become one by the same three: that they agree says more of c, and nothing that is common is counted twice.
A base that is turned by θ more than the poses say carries the point along, θ × p about its origin; what the turn does
to the readings of one touch is of second order, since gravity's part is read anew beside it. Left out: a probe hangs
down however its base is turned, so that its sag is not carried along, a tenth of the turn's part for the large probe
(tests/exploring/test_turned_base.py).
"""

from dataclasses import dataclass

import numpy as np

from probedesign.estimation.answer import Solution
from probedesign.estimation.equations import POINT, UNKNOWNS
from probedesign.frames import Array

COMMON = slice(3, UNKNOWNS)
"""Of a fusion's unknowns: the logarithm of the stiffness, the base's offset in its own axes [m]. After them comes the
base's turn about its own axes [rad], which a fusion does not know."""
CLEAR = 1e-6
"""Information on a common unknown, over what is known beforehand, below which it is rounding."""


@dataclass(frozen=True)
class Located:
    """What one or more touches tell of one point.

    Attributes:
        a: the point if all common unknowns were as expected beforehand [m], (3,).
        B: of the point by the common unknowns, (3, 7).
        S: covariance of the point if they were known [m²], (3, 3).
        information: on the common unknowns, without what is known beforehand, (7, 7).
        lack: that information times where these touches put them, (7,).
    """

    a: Array
    B: Array
    S: Array
    information: Array
    lack: Array

    @classmethod
    def of(cls, found: Solution, prior: Array, shift: Array, more: Array, T_world_base: Array) -> "Located":
        """What one fusion tells.

        Args:
            found: its solution.
            prior: standard deviations of its common unknowns beforehand, (4,).
            shift: from the point that it sought to the one that is meant [m], (3,).
            more: covariance that the solution does not hold [m²], (3, 3).
            T_world_base: of the base while it touched, (4, 4).
        """
        cov, x = found.cov, found.x
        inverse = np.linalg.inv(cov[COMMON, COMMON])
        B = cov[POINT, COMMON] @ inverse
        S = cov[POINT, POINT] - B @ cov[COMMON, POINT]
        values, vectors = np.linalg.eigh(prior[:, None] * inverse * prior - np.eye(4))
        values = np.where(values > CLEAR, values, 0.0)
        information = (vectors * values) @ vectors.T / np.outer(prior, prior)
        a = x[POINT] + shift - B @ x[COMMON]
        by_all = np.hstack([B, _by_turn(x[POINT] + shift, T_world_base)])
        room = np.zeros((by_all.shape[1], by_all.shape[1]))
        room[: len(prior), : len(prior)] = information
        lack = np.append(_pull(information, x[COMMON], prior), np.zeros(3))
        return cls(a, by_all, 0.5 * (S + S.T) + more, room, lack)

    def at(self, common: Array) -> Array:
        """The point for such common unknowns [m], (3,)."""
        point: Array = self.a + self.B @ common
        return point

    def cov(self, cov_common: Array) -> Array:
        """Of the point, with the common unknowns so well known [m²], (3, 3)."""
        cov: Array = self.S + self.B @ cov_common @ self.B.T
        return cov

    def with_(self, other: "Located") -> "Located":
        """Both as one point."""
        mine, others = np.linalg.inv(self.S), np.linalg.inv(other.S)
        S = np.linalg.inv(mine + others)
        apart, by = self.a - other.a, self.B - other.B
        weight = np.linalg.inv(self.S + other.S)
        return Located(
            S @ (mine @ self.a + others @ other.a),
            S @ (mine @ self.B + others @ other.B),
            0.5 * (S + S.T),
            self.information + other.information + by.T @ weight @ by,
            self.lack + other.lack - by.T @ weight @ apart,
        )


def _by_turn(p_world: Array, T_world_base: Array) -> Array:
    """Of a point by the turn of the base about its own axes [m/rad], (3, 3)."""
    R = T_world_base[:3, :3]
    return np.asarray(np.cross(R.T, p_world - T_world_base[:3, 3]).T, dtype=float)


def _pull(information: Array, told: Array, prior: Array) -> Array:
    """Where a touch by itself puts the common unknowns, times its information: its solution is drawn to what was
    expected, (I + P⁻¹)⁻¹ I m, so that I m = (I + P⁻¹) x."""
    total = information + np.diag(1.0 / prior**2)
    seen: Array = total @ told
    values, vectors = np.linalg.eigh(prior[:, None] * information * prior)
    clear = vectors[:, values > CLEAR]
    kept: Array = (clear @ (clear.T @ (seen * prior))) / prior
    return kept
