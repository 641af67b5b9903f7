"""Where the error of several fused touches comes from: its covariance, cause by cause, to first order.

The estimator's unknowns x answer to its readings by the gain Γ = cov Dᵀ V⁻¹ of its least squares, priors in cov.
Whether it knows of a cause or not, what that adds to the readings moves the answer by Γ times it: what it takes as
unknown with a prior is thereby caught as far as the prior lets it. The error is the distance in the world between the
mean point of the centreline where the force acts, as told, and the true one, the robot's poses being told as `robot_mm`
allows.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from probedesign.estimation.causes import CAUSES
from probedesign.estimation.equations import (
    OFFSET,
    POINT,
    STIFFNESS,
    UNKNOWNS,
    Equations,
    Linear,
    channels_of,
)
from probedesign.estimation.model import ProbeModel
from probedesign.estimation.tolerances import Tolerances
from probedesign.frames import Array
from probedesign.prediction.budget import ByCause
from probedesign.prediction.pressing import Pressing, unknowns_of
from probedesign.prediction.standing import Standing
from probedesign.rod.contacts import Indices
from probedesign.units import MM

FUSED_CAUSES = (*CAUSES, "robot")


@dataclass(frozen=True)
class FusedBudget(ByCause):
    """Errors of n points, each touched several times.

    Attributes:
        cov: of the contact's point in the world [m²] by cause, (n, causes, 3, 3), as `FUSED_CAUSES` names them.
        cov_told: as the estimator itself states it [m²], (n, 3, 3).
        cov_fixed: likewise of the point of the surface that stands still [m²], (n, 3, 3).
    """

    cov_told: Array
    cov_fixed: Array


@dataclass(frozen=True)
class Pressed:
    """One touch of each of n points, with all that the budget asks of it.

    Attributes:
        by_place, by_stiffness: of the reading's channels by the fixed point and by log stiffness, (n, m, 3), (n, m).
        centre_by_place, centre_by_stiffness: likewise of the centreline's point, (n, 3, 3), (n, 3).
        misled: see `Standing.misled`; of the channels.
    """

    by_place: Array
    by_stiffness: Array
    centre_by_place: Array
    centre_by_stiffness: Array
    misled: dict[str, tuple[Array, Array]]

    @classmethod
    def of(cls, standing: Standing, channels: Array, tolerances: Tolerances) -> "Pressed":
        """From touches that there are."""
        wrench, centre = standing.by_stiffness
        misled = {name: (channels @ read, told) for name, (read, told) in standing.misled(tolerances).items()}
        return cls(
            channels @ standing.by_place, wrench @ channels.T, standing.centre_by_place, centre, misled
        )

    def rows(self, of: Indices) -> "Pressed":
        """Some of them."""
        misled = {name: (read[of], told[of]) for name, (read, told) in self.misled.items()}
        return Pressed(self.by_place[of], self.by_stiffness[of], self.centre_by_place[of],
                       self.centre_by_stiffness[of], misled)  # fmt: skip


def fused_budget_of(
    touches: Sequence[Pressed], model: ProbeModel, tolerances: Tolerances, pressing: Pressing
) -> FusedBudget:
    """Split the errors of points that are touched k times.

    Args:
        touches: the k touches of all points, in the order of time.
        model: the probe.
        tolerances: how well things are known.
        pressing: how they are made.
    """
    series = [_Series(i, touches, model, tolerances, pressing) for i in range(len(touches[0].by_place))]
    split = [one.split() for one in series]
    return FusedBudget(*(np.array(part) for part in zip(*split, strict=True)))


@dataclass(frozen=True)
class _Series:
    """One point's touches."""

    i: int
    touches: Sequence[Pressed]
    model: ProbeModel
    tolerances: Tolerances
    pressing: Pressing

    def split(self) -> tuple[Array, Array, Array]:
        """Covariance of the centreline's point by cause, as told, and of the fixed point as told."""
        channels = channels_of(self.model, self.pressing.moments_about)
        unknowns = unknowns_of(self.model, self.tolerances)
        noise = channels @ self.model.noise_base() @ channels.T
        linear = self._linear(noise)
        answer = Equations(self.model, (), unknowns, channels).gain(linear)
        by_unknowns, by_shift = self._centre_by_unknowns(), self._centre_by_shift()
        gain = by_unknowns @ answer.unknowns + np.einsum("kij,kjn->in", by_shift, answer.shifts)
        walk = self.tolerances.drift_steps**2 * self.model.averaging_samples * noise
        k = np.arange(1, len(self.touches) + 1)
        found = {
            "noise": gain @ np.kron(np.eye(len(k)), noise) @ gain.T,
            "drift": gain @ np.kron(np.minimum.outer(k, k), walk) @ gain.T,
            "robot": self._robot(gain, linear.by_place),
        } | {name: self._misled(name, gain) for name in self.touches[0].misled}
        told = by_unknowns @ answer.cov @ by_unknowns.T
        return np.array([found[name] for name in FUSED_CAUSES]), told, answer.cov[POINT, POINT]

    def _linear(self, noise: Array) -> Linear:
        """The readings as the estimator has them at the truth; the bases turned as in the mount."""
        by_place = np.array([touch.by_place[self.i] for touch in self.touches])
        k, m, _ = by_place.shape
        design = np.empty((k, m, UNKNOWNS))
        design[:, :, POINT], design[:, :, OFFSET] = by_place, -by_place
        design[:, :, STIFFNESS] = [touch.by_stiffness[self.i] for touch in self.touches]
        return Linear(
            np.zeros(k * m), design.reshape(k * m, UNKNOWNS), by_place, np.broadcast_to(noise, (k, m, m))
        )

    def _centre_by_unknowns(self) -> Array:
        """Of the centreline's mean point in the world by the unknowns, (3, 7)."""
        by_place = np.mean([touch.centre_by_place[self.i] for touch in self.touches], axis=0)
        found = np.empty((3, UNKNOWNS))
        found[:, POINT], found[:, OFFSET] = by_place, np.eye(3) - by_place
        found[:, STIFFNESS] = np.mean([touch.centre_by_stiffness[self.i] for touch in self.touches], axis=0)
        return found

    def _centre_by_shift(self) -> Array:
        """Of it by where each base is told to be, in base axes, the fixed point staying, (k, 3, 3)."""
        return (np.array([touch.centre_by_place[self.i] for touch in self.touches]) - np.eye(3)) / len(
            self.touches
        )

    def _misled(self, name: str, gain: Array) -> Array:
        ramp = self.pressing.ramp if name == "creep" else (1.0,) * len(self.touches)
        read, told = (
            np.array(
                [
                    share * touch.misled[name][part][self.i]
                    for share, touch in zip(ramp, self.touches, strict=True)
                ]
            )
            for part in (0, 1)
        )
        off = gain @ read.reshape(-1, read.shape[-1]) + told.mean(axis=0)
        return np.asarray(off @ off.T)

    def _robot(self, gain: Array, by_place: Array) -> Array:
        """A base that is off tells the point amiss by as much, and the reading stays."""
        k, m, _ = by_place.shape
        off = self._centre_by_shift() - gain.reshape(3, k, m).transpose(1, 0, 2) @ by_place
        return np.asarray((self.tolerances.robot_mm * MM) ** 2 * np.einsum("kij,klj->il", off, off))
