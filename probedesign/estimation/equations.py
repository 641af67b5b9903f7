"""The readings of a fusion to first order, and their normal equations.

Unknown are the fixed point p, a common factor on the stiffness, and the base's own offset; the sensor's bias, its walk
and the base's scatter from pose to pose go into the covariance V of all readings together:

    w_k = h_k(p) + b_k + ε_k,   b a random walk,   minimise rᵀ V⁻¹ r + priors.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from probedesign.estimation.fused import MomentsAbout
from probedesign.estimation.model import ProbeModel
from probedesign.estimation.pressed import Pressed
from probedesign.estimation.unknowns import Unknowns
from probedesign.frames import Array, wrench_map

POINT, STIFFNESS, OFFSET = slice(0, 3), 3, slice(4, 7)
"""Of the unknowns: where the fixed point is, the logarithm of the stiffness, the base's offset in its own axes."""
UNKNOWNS = 7
NEAR = 1e-9
"""Poses whose numbers differ by no more, in metres too, are one."""


@dataclass(frozen=True)
class Reading:
    """One pose.

    Attributes:
        wrench: read at the base, free of what hangs below it, (6,).
        cov: of its noise, (6, 6).
        T_world_base: (4, 4).
        gravity: base axes [m/s²], (3,).
        touched: whether there was contact.
    """

    wrench: Array
    cov: Array
    T_world_base: Array
    gravity: Array
    touched: bool

    def to_base(self, p_world: Array) -> Array:
        """A point of the world seen from the base [m], (3,)."""
        seen: Array = self.T_world_base[:3, :3].T @ (p_world - self.T_world_base[:3, 3])
        return seen

    def turned(self, v_base: Array) -> Array:
        """A vector of the base's in the world's axes, (3,)."""
        v_world: Array = self.T_world_base[:3, :3] @ v_base
        return v_world

    def to_world(self, p_base: Array) -> Array:
        """A point of the base's in the world [m], (3,)."""
        there: Array = self.T_world_base[:3, :3] @ p_base + self.T_world_base[:3, 3]
        return there


@dataclass(frozen=True)
class Linear:
    """All readings to first order about one guess.

    Attributes:
        misfit: read less modelled, (n,).
        design: of the model by the unknowns, (n, 7).
        by_place: of the model by where each base is, one block a reading, (k, m, 3).
        noise: (k, m, m).
    """

    misfit: Array
    design: Array
    by_place: Array
    noise: Array

    def repeated(self, other: "Linear") -> "Linear":
        """These readings and others after them."""
        return Linear(*(np.concatenate([getattr(self, name), getattr(other, name)]) for name in
                        ("misfit", "design", "by_place", "noise")))  # fmt: skip


class Normal(NamedTuple):
    """What the normal equations tell of one guess.

    Attributes:
        cov: of the unknowns, (7, 7).
        step: to where the misfit is least, (7,).
        chi2: the misfit at the guess, priors included.
        shifts: how far each base was likely off for itself, in base axes [m], (k, 3).
    """

    cov: Array
    step: Array
    chi2: float
    shifts: Array


class Gain(NamedTuple):
    """How the answer moves with the n numbers read.

    Attributes:
        cov: of the unknowns, (7, 7).
        unknowns: by the readings, (7, n).
        shifts: of how far each base was likely off for itself, (k, 3, n).
    """

    cov: Array
    unknowns: Array
    shifts: Array


def channels_of(model: ProbeModel, moments: MomentsAbout | None) -> Array:
    """What of a wrench at the base counts.

    Args:
        model: the probe.
        moments: None: all six channels. "base": the moments about the base's origin alone. "sensor": the moments that
            the sensor reads, which hold no noise of the forces; but they are got back from all six numbers.

    Returns:
        (6, 6) or (3, 6).
    """
    if moments is None:
        return np.eye(6)
    return np.eye(6)[3:] if moments == "base" else wrench_map(model.T_sensor_base)[3:]


@dataclass(frozen=True)
class Equations:
    """Readings to be fused, and what is not known.

    Attributes:
        model: the probe.
        readings: in the order of time.
        unknowns: what is not known.
        channels: what of a wrench at the base counts, (m, 6): see `channels_of`.
    """

    model: ProbeModel
    readings: tuple[Reading, ...]
    unknowns: Unknowns
    channels: Array

    @property
    def moments_only(self) -> bool:
        """Whether forces are left aside."""
        return len(self.channels) == 3

    @property
    def one_pose(self) -> bool:
        """Whether all that touched did so from one and the same pose."""
        touched = [reading.T_world_base for reading in self.readings if reading.touched]
        return all(np.allclose(touched[0], T, rtol=0.0, atol=NEAR) for T in touched[1:])

    @property
    def dof(self) -> int:
        """Numbers read more than a point has."""
        return max(len(self.readings) * len(self.channels) - 3, 1)

    @cached_property
    def _free_wrenches(self) -> dict[int, tuple[Array, Array]]:
        """Of the readings without contact: the wrench and its derivative by log stiffness."""
        found = {}
        for k, reading in enumerate(self.readings):
            if not reading.touched:
                eq = self.model.rod.solve(reading.gravity, columns="all")
                assert eq.sensitivity is not None, "the free probe stands"
                d = eq.sensitivity.d_wrench
                names = eq.sensitivity.names
                found[k] = (eq.wrench_base, d[:, names.index("log_E")] + d[:, names.index("log_G")])
        return found

    def linear(self, pressed: tuple[Pressed | None, ...], x: Array) -> Linear:
        """All readings to first order, each touch's fixed point put where the unknowns say."""
        k = len(self.readings)
        modelled, by_place, design = np.empty((k, 6)), np.zeros((k, 6, 3)), np.empty((k, 6, UNKNOWNS))
        made_at, stiffness_at = np.zeros((k, 3)), np.zeros(k)
        for i, p in enumerate(pressed):
            if p is None:
                modelled[i], design[i, :, STIFFNESS] = self._free_wrenches[i]
            else:
                modelled[i], design[i, :, STIFFNESS] = p.wrench, p.by_stiffness
                by_place[i], made_at[i], stiffness_at[i] = p.stiffness, p.p_fixed, p.log_stiffness
        R, origins = self._poses[:, :3, :3], self._poses[:, :3, 3]
        points = ((x[POINT] - origins)[:, None] @ R)[:, 0] - x[OFFSET]
        modelled += (by_place @ (points - made_at)[:, :, None])[:, :, 0]
        modelled += design[:, :, STIFFNESS] * (x[STIFFNESS] - stiffness_at)[:, None]
        design[:, :, POINT] = by_place @ R.transpose(0, 2, 1)
        design[:, :, OFFSET] = -by_place
        of = self.channels
        misfit = (np.array([reading.wrench for reading in self.readings]) - modelled) @ of.T
        return Linear(misfit.ravel(), (of @ design).reshape(-1, UNKNOWNS), of @ by_place, self._noise)

    @cached_property
    def _poses(self) -> Array:
        return np.array([reading.T_world_base for reading in self.readings])

    @cached_property
    def _noise(self) -> Array:
        """Of the channels that count, (k, m, m)."""
        noise: Array = self.channels @ np.array([reading.cov for reading in self.readings]) @ self.channels.T
        return noise

    def covariance(self, linear: Linear, unknowns: Unknowns) -> Array:
        """V: noise, bias and its walk, and the base's scatter, of all readings together, (n, n)."""
        k, m, _ = linear.noise.shape
        step = self.channels @ self.model.noise_base() @ self.channels.T * self.model.averaging_samples
        walked = np.minimum.outer(np.arange(1, k + 1), np.arange(1, k + 1)).astype(float)
        bias = unknowns.bias_steps**2 + unknowns.bias_walk_steps**2 * walked
        V = np.asarray(np.kron(bias, step), dtype=float)
        creep = unknowns.creep
        i = np.arange(k)
        scatter = unknowns.base_repeat**2 * linear.by_place @ linear.by_place.transpose(0, 2, 1)
        V.reshape(k, m, k, m)[i, :, i] += linear.noise + scatter
        if creep:
            grown = linear.design[:, STIFFNESS] * np.repeat(np.arange(k) / max(k - 1, 1), m)
            V += creep**2 * np.outer(grown, grown)
        return V

    def normal(self, linear: Linear, x: Array) -> Normal:
        """The normal equations of the readings as they are linearised, at the unknowns x."""
        prior = self.unknowns.prior
        V = self.covariance(linear, self.unknowns)
        weighted = np.linalg.solve(V, np.column_stack([linear.design, linear.misfit]))
        cov = _inverted(linear.design.T @ weighted[:, :-1], prior)
        lack = linear.design.T @ weighted[:, -1]
        lack[STIFFNESS:] -= x[STIFFNESS:] / prior**2
        chi2 = float(linear.misfit @ weighted[:, -1] + ((x[STIFFNESS:] / prior) ** 2).sum())
        step = cov @ lack
        left = (weighted[:, -1] - weighted[:, :-1] @ step).reshape(len(linear.by_place), -1)
        shifts = self.unknowns.base_repeat**2 * np.einsum("kmi,km->ki", linear.by_place, left)
        return Normal(cov, step, chi2, shifts)

    def gain(self, linear: Linear) -> Gain:
        """How the answer moves with the readings."""
        V, D, n = self.covariance(linear, self.unknowns), linear.design, len(linear.misfit)
        weighted = np.linalg.solve(V, np.column_stack([D, np.eye(n)]))
        cov = _inverted(D.T @ weighted[:, :UNKNOWNS], self.unknowns.prior)
        unknowns = cov @ weighted[:, :UNKNOWNS].T
        left = (weighted[:, UNKNOWNS:] @ (np.eye(n) - D @ unknowns)).reshape(len(linear.by_place), -1, n)
        shifts = self.unknowns.base_repeat**2 * linear.by_place.transpose(0, 2, 1) @ left
        return Gain(cov, unknowns, shifts)

    def rms(self, linear: Linear, unknowns: Unknowns) -> float:
        """Of the fixed point [m], by the bound."""
        information = linear.design.T @ np.linalg.solve(self.covariance(linear, unknowns), linear.design)
        return math.sqrt(max(float(np.trace(_inverted(information, unknowns.prior)[POINT, POINT])), 0.0))


def target(reading: Reading, x: Array, shift: Array) -> Array:
    """Where the fixed point is seen from the base, that being off by `shift` for itself [m], (3,)."""
    return reading.to_base(x[POINT]) - x[OFFSET] + shift


def _inverted(information: Array, prior: Array) -> Array:
    """Covariance of the unknowns from the readings' information and the priors; huge where neither tells."""
    total = information.copy()
    total[range(STIFFNESS, UNKNOWNS), range(STIFFNESS, UNKNOWNS)] += 1.0 / prior**2
    scale = np.sqrt(np.diag(total))
    scale = np.where(scale > 0.0, scale, 1.0)
    values, vectors = np.linalg.eigh(total / np.outer(scale, scale))
    values = np.maximum(values, 1e-13)
    scaled: Array = (vectors / values) @ vectors.T / np.outer(scale, scale)
    return scaled
