"""A swaying cantilever on an accelerated base: modes of an Euler-Bernoulli beam of cubic elements, integrated exactly.

The estimator does not use it: it knows the first natural frequency alone, from another discretisation.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigh
from scipy.signal import lfilter

from probedesign.core.frames import Array
from probedesign.rod.rod import Rod

ELEMENTS = 24


def _matrices(rod: Rod) -> tuple[Array, Array, Array]:
    """Return stiffness and mass of deflections and slopes at the nodes, the first node included, and the nodes."""
    nodes = np.linspace(0.0, rod.length, ELEMENTS + 1)
    K, M, h = np.zeros((2 * len(nodes),) * 2), np.zeros((2 * len(nodes),) * 2), nodes[1]
    x, weights = np.polynomial.legendre.leggauss(4)
    for e in range(ELEMENTS):
        for xi, weight in zip(0.5 * (x + 1.0), 0.5 * weights * h, strict=True):
            r = float(rod.radius_at(np.array([nodes[e] + xi * h]))[0])
            N = np.array(
                [1 - 3 * xi**2 + 2 * xi**3, h * xi * (1 - xi) ** 2, xi**2 * (3 - 2 * xi), h * xi**2 * (xi - 1)]
            )
            B = np.array([12 * xi - 6, h * (6 * xi - 4), 6 - 12 * xi, h * (6 * xi - 2)]) / h**2
            part = slice(2 * e, 2 * e + 4)
            K[part, part] += weight * rod.youngs_modulus * math.pi / 4.0 * r**4 * np.outer(B, B)
            M[part, part] += weight * rod.density * math.pi * r**2 * np.outer(N, N)
    return K, M, nodes


@dataclass(frozen=True)
class SwayingBeam:
    """Modes of a straight rod that is clamped to a base, and held at one node if it touches an object there."""

    omega: Array  #: angular frequencies [rad/s], (k,).
    by_force: Array  #: what each mode adds to force and moment at the base by its acceleration, (k, 2).
    rigid: Array  #: mass [kg] and first moment of it [kg·m], (2,).
    by_base: Array  #: what an acceleration of the base does to each mode, (k,).
    by_impact: Array  #: velocity of each mode over that of the base when the held node stops, (k,).

    @classmethod
    def of(cls, rod: Rod, s_held: float | None = None, modes: int = 6) -> "SwayingBeam":
        """Return the lowest modes."""
        K, M, nodes = _matrices(rod)
        free, bent = list(range(2, len(K))), np.zeros(len(K))  # the first node is clamped
        if s_held is not None:
            held = 2 * int(np.argmin(np.abs(nodes - s_held)))
            free.remove(held)
            bent[held] = 1.0  # the shape of a unit deflection of the held node
            bent[free] = -np.linalg.solve(K[np.ix_(free, free)], K[free, held])
        values, vectors = eigh(K[np.ix_(free, free)], M[np.ix_(free, free)])
        shapes = np.zeros((len(K), modes))
        shapes[free] = vectors[:, :modes]
        shift, turn = np.zeros(len(K)), np.zeros(len(K))
        shift[::2], turn[::2], turn[1::2] = 1.0, nodes, 1.0
        weights, carried = np.stack([M @ shift, M @ turn], axis=1), shift - bent
        return cls(np.sqrt(values[:modes]), shapes.T @ weights, weights.T @ carried, shapes.T @ M @ carried,
                   shapes.T @ M @ bent)  # fmt: skip

    def base_load(self, acceleration: Array, rate: float, damping: float, impact: float = 0.0) -> Array:
        """Return force and moment of the beam on its base beyond those of its quasi-static shape [N, N·m], (n, 2).

        Args:
            acceleration: of the base across the beam [m/s²], (n,), constant within a sample.
            rate: of the samples [Hz].
            damping: ratio of every mode.
            impact: velocity of the base when the held node stops, before the first sample [m/s].
        """
        # With the roots λ of each mode, q = c + c̄ and dc/dt = λ c + f/(λ - λ̄).
        w = self.omega
        root = w * (-damping + 1j * math.sqrt(1.0 - damping**2))
        split, step, force = root - root.conj(), np.exp(root / rate), -np.outer(acceleration, self.by_base)
        gain = (step - 1.0) / (root * split)
        c = np.exp(np.outer(np.arange(len(force)) / rate, root)) * self.by_impact * impact / split
        for i in range(len(w)):
            c[:, i] += lfilter([0.0, gain[i]], [1.0, -step[i]], force[:, i])
        q, v = 2.0 * c.real, 2.0 * (root * c).real
        return -np.outer(acceleration, self.rigid) - (force - 2.0 * damping * w * v - w**2 * q) @ self.by_force
