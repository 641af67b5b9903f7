"""What a solve returns: the bent rod, what its base feels, and how both answer to the load."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from probedesign.frames import Array
from probedesign.rod import kernels


@dataclass(frozen=True)
class Sensitivity:
    """Exact first derivatives by `kernels.PARAMETERS` (the first columns of them), all in base axes.

    Attributes:
        d_moment: of the base moment, (3, k).
        d_contact: of the contact's [tangent, section x axis, position, section y axis], (12, k).
        frame: those four themselves, (12,).
        load: the load they were taken at.
        body: the rod they were taken for.
    """

    d_moment: Array
    d_contact: Array
    frame: Array
    load: Array
    body: kernels.Body

    @cached_property
    def d_wrench(self) -> Array:
        """Of the base wrench [force; moment], (6, k); force = F + ρ V g in closed form."""
        k = self.d_moment.shape[1]
        mass = self.body.material[3] * self.body.volume_beyond[0]
        weight = mass * self.load[3:6]
        d_force = np.zeros((3, kernels.ALL_COLUMNS))
        d_force[:, 0:3] = np.eye(3)
        d_force[:, 4:7] = mass * np.eye(3)
        d_force[:, kernels.PARAMETERS.index("log_density")] = weight
        d_force[:, kernels.PARAMETERS.index("log_diameter")] = 2.0 * weight
        return np.vstack([d_force[:, :k], self.d_moment])

    @property
    def d_position(self) -> Array:
        """Of the contact point on the centreline [m per unit], (3, k)."""
        return self.d_contact[6:9]


@dataclass(frozen=True)
class Equilibrium:
    """A solved rod in base axes; every array is NaN or empty unless `result` is "ok".

    Attributes:
        result: "ok", "not_converged" or "unstable".
        stable: whether the second variation of the energy is positive.
        residual: misfit of the base's tangent [rad].
        load: [force, gravity, tip moment, s_c] it was solved for, (10,).
        sensitivity: first derivatives, where they were asked for.
    """

    result: str
    stable: bool
    residual: float
    load: Array
    nodes: Array
    y: Array
    contact: Array
    body: kernels.Body
    sensitivity: Sensitivity | None

    @property
    def ok(self) -> bool:
        """Whether there is an answer."""
        return self.result == "ok"

    @cached_property
    def wrench_base(self) -> Array:
        """What the rod does to its mount about the base origin: [N, N, N, N·m, N·m, N·m], (6,)."""
        if not self.ok:
            return np.full(6, np.nan)
        mass = self.body.material[3] * self.body.volume_beyond[0]
        return np.concatenate([self.load[0:3] + mass * self.load[3:6], self.y[3:6]])

    @cached_property
    def p_contact_base(self) -> Array:
        """Point of the centreline where the force acts [m], (3,)."""
        return self.contact[6:9] - self.y[6:9] if self.ok else np.full(3, np.nan)

    @cached_property
    def tip_tangent(self) -> Array:
        """Tangent at the tip, (3,): the guess for a neighbouring load."""
        return self.nodes[0, 1:4].copy() if self.ok else np.full(3, np.nan)

    @cached_property
    def s(self) -> Array:
        """Arclengths of the nodes, base to tip [m], (k,)."""
        return self.nodes[::-1, 0].copy() if self.ok else np.empty(0)

    @cached_property
    def p_base(self) -> Array:
        """Centreline at the nodes [m], (k, 3)."""
        return self.nodes[::-1, 7:10] - self.y[6:9] if self.ok else np.empty((0, 3))

    @cached_property
    def R_base(self) -> Array:
        """Orientation of the sections at the nodes, (k, 3, 3); columns are their x, y and tangent."""
        return self._frames(self.nodes[::-1, 1:]) if self.ok else np.empty((0, 3, 3))

    @cached_property
    def m_base(self) -> Array:
        """Internal moment at the nodes [N·m], (k, 3)."""
        return self.nodes[::-1, 4:7].copy() if self.ok else np.empty((0, 3))

    @cached_property
    def n_base(self) -> Array:
        """Internal force at the nodes [N], (k, 3); at s_contact itself the force is counted."""
        return self.n_at(self.s)

    def n_at(self, s: ArrayLike) -> Array:
        """Internal force [N] at arclengths s [m], (j, 3): F [s ≤ s_c] + ρ V(s) g; NaN off the rod."""
        s = np.atleast_1d(np.asarray(s, dtype=float))
        weight = self.body.material[3] * _volume_beyond(self.body, s)
        n: Array = weight[:, None] * self.load[3:6]
        n[s <= self.load[9]] += self.load[0:3]
        n[~(self.ok & (s >= 0.0) & (s <= self.body.knots[-1]))] = np.nan
        return n

    def p_at(self, s: ArrayLike) -> Array:
        """Centreline at any arclength s [m]: (3,) for a number, (j, 3) for an array; exact as the solve itself."""
        states = self.states_at(s)[:, 6:9] - self.y[6:9]
        return states[0] if np.ndim(s) == 0 else states

    def R_at(self, s: ArrayLike) -> Array:
        """Orientation of the section at any arclength s [m]: (3, 3) for a number, (j, 3, 3) for an array."""
        frames = self._frames(self.states_at(s))
        return frames[0] if np.ndim(s) == 0 else frames

    def states_at(self, s: ArrayLike) -> Array:
        """Kernel states [t, m, p from the tip, d] at arclengths s [m], (j, 12); NaN off the rod."""
        s = np.atleast_1d(np.asarray(s, dtype=float))
        states = np.full((len(s), 12), np.nan)
        if self.ok:
            inside = (s >= 0.0) & (s <= self.body.knots[-1])
            found = np.empty((int(inside.sum()), 12))
            scratch = np.empty(120)
            kernels.states_at(s[inside], self.nodes, len(self.nodes), self.body, self.load, scratch, found)
            states[inside] = found
        return states

    def _frames(self, states: Array) -> Array:
        """Sections' frames, turned about the tangent so that the base's is the identity."""
        t, d = states[:, 0:3], states[:, 9:12]
        across = np.cross(t, d)
        turn = -np.arctan2(self.y[10], self.y[9])
        x = np.cos(turn) * d + np.sin(turn) * across
        return np.stack([x, np.cross(t, x), t], axis=-1)


def _volume_beyond(body: kernels.Body, s: Array) -> Array:
    """Volume from s to the tip [m³]."""
    i = np.clip(np.searchsorted(body.knots, s, side="right") - 1, 0, len(body.knots) - 2)
    h = body.knots[i + 1] - s
    r, r1 = np.interp(s, body.knots, body.radii), body.radii[i + 1]
    return body.volume_beyond[i + 1] + np.pi / 3.0 * h * (r * r + r * r1 + r1 * r1)
