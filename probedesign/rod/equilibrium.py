"""Result of a solve: the bent rod, its base wrench, and the sensitivities of both."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from probedesign.core.errors import InputError
from probedesign.core.frames import Array
from probedesign.rod.kernels.equations import ALL_COLUMNS, CONE, DENSITY, PARAMETERS, Body
from probedesign.rod.kernels.steps import BLOCK, COLUMN, STATE, WIDE, WORK
from probedesign.rod.kernels.sweep import REST_X, lane_of, states_at


@dataclass(frozen=True)
class Sensitivity:
    """Exact first derivatives by `PARAMETERS` and each knot's log diameter, in base axes.

    With `columns` "load" or "contact" there are the first columns only.
    """

    d_moment: Array  #: derivatives of the base moment, (3, k).
    d_contact: Array  #: derivatives of the contact's [tangent, section x axis, position, section y axis], (12, k).
    frame: Array  #: those four vectors, (12,).
    turns: Array  #: rotations of the tip's section about its own axes x, y and tangent, (3, k).
    load: Array  #: at which they are evaluated.
    body: Body  #: of the rod.

    @property
    def names(self) -> tuple[str, ...]:
        """Return the parameters' names, one per column."""
        knots = tuple(f"log_diameter_{i}" for i in range(len(self.body.knots)))
        return (*PARAMETERS, *knots)[: self.d_moment.shape[1]]

    @cached_property
    def d_wrench(self) -> Array:
        """Return the derivatives of the base wrench [force; moment], (6, k); force = F + ρ V g in closed form."""
        k = self.d_moment.shape[1]
        mass = float(self.body.constants[DENSITY] * self.body.volume_beyond[0])
        gravity = self.load[3:6]
        d_force = np.zeros((3, ALL_COLUMNS + len(self.body.knots)))
        d_force[:, 0:3] = np.eye(3)
        d_force[:, 7:10] = mass * np.eye(3)
        d_force[:, PARAMETERS.index("log_density")] = mass * gravity
        d_force[:, PARAMETERS.index("log_diameter")] = 2.0 * mass * gravity
        by_knot = self.body.constants[DENSITY] * self.body.volume_by_knot[0]
        d_force[:, ALL_COLUMNS:] = np.outer(gravity, by_knot)
        return np.vstack([d_force[:, :k], self.d_moment])

    @property
    def d_position(self) -> Array:
        """Return the derivatives of the contact point on the centreline [m per unit], (3, k)."""
        return self.d_contact[6:9]


@dataclass(frozen=True)
class Equilibrium:
    """A solved rod in base axes; every array is NaN or empty unless `result` is "ok"."""

    result: str  #: "ok", "not_converged" or "unstable".
    #: stability margin, the smallest determinant of the free tip's Jacobi fields along the rod; 1 unloaded, 0 where the
    #: second variation of the energy ceases to be positive (docs/decisions/0001).
    margin: float
    residual: float  #: error of the tangent at the base [rad].
    load: Array  #: [force, gravity, tip moment, couple, s_c], (13,).
    nodes: Array  #: rows [s, t, m, p from the tip, d, columns], tip to base.
    tip: Array  #: the tip's section [tangent, x axis], (6,): the guess for a neighbouring load.
    y: Array
    contact: Array
    body: Body
    sensitivity: Sensitivity | None  #: first derivatives; None without columns.

    @property
    def ok(self) -> bool:
        """Return whether `result` is "ok"."""
        return self.result == "ok"

    @property
    def s_contact(self) -> float:
        """Return the arclength where the force acts [m]."""
        return float(self.load[12])

    @cached_property
    def wrench_base(self) -> Array:
        """Return the wrench of the rod on its mount about the base origin [N, N, N, N·m, N·m, N·m], (6,)."""
        if not self.ok:
            return np.full(6, np.nan)
        mass = self.body.constants[DENSITY] * self.body.volume_beyond[0]
        return np.concatenate([self.load[0:3] + mass * self.load[3:6], self.y[3:6]])

    @cached_property
    def p_contact_base(self) -> Array:
        """Return the point of the centreline where the force acts [m], (3,)."""
        return self.contact[6:9] - self.y[6:9] if self.ok else np.full(3, np.nan)

    @cached_property
    def tip_tangent(self) -> Array:
        """Return the tangent at the tip, (3,)."""
        return self.nodes[0, 1:4].copy() if self.ok else np.full(3, np.nan)

    @cached_property
    def s(self) -> Array:
        """Return the arclengths of the nodes, base to tip [m], (k,)."""
        return self.nodes[::-1, 0].copy() if self.ok else np.empty(0)

    @cached_property
    def p_base(self) -> Array:
        """Return the centreline at the nodes [m], (k, 3)."""
        return self.nodes[::-1, 7:10] - self.y[6:9] if self.ok else np.empty((0, 3))

    @cached_property
    def R_base(self) -> Array:
        """Return the orientation of the sections at the nodes, (k, 3, 3); columns are their x, y and tangent."""
        return self._frames(self.nodes[::-1, 1:13]) if self.ok else np.empty((0, 3, 3))

    @cached_property
    def m_base(self) -> Array:
        """Return the internal moment at the nodes [N·m], (k, 3)."""
        return self.nodes[::-1, 4:7].copy() if self.ok else np.empty((0, 3))

    @cached_property
    def n_base(self) -> Array:
        """Return the internal force at the nodes [N], (k, 3); at s_contact it includes the contact force."""
        return self.n_at(self.s)

    def n_at(self, s: ArrayLike) -> Array:
        """Return the internal force [N] at arclengths s [m], (j, 3): F [s ≤ s_c] + ρ V(s) g; NaN off the rod."""
        s = np.atleast_1d(np.asarray(s, dtype=float))
        weight = self.body.constants[DENSITY] * _volume_beyond(self.body, s)
        n: Array = weight[:, None] * self.load[3:6]
        n[s <= self.s_contact] += self.load[0:3]
        n[~(self.ok & (s >= 0.0) & (s <= self.body.knots[-1]))] = np.nan
        return n

    def p_at(self, s: ArrayLike) -> Array:
        """Return the centreline at any arclength s [m]: (3,) or (j, 3); as accurate as at the nodes."""
        states = self.states_at(s)[:, 6:9] - self.y[6:9]
        return states[0] if np.ndim(s) == 0 else states

    def R_at(self, s: ArrayLike) -> Array:
        """Return the orientation of the section at any arclength s [m]: (3, 3) for a number, (j, 3, 3) for an array."""
        frames = self._frames(self.states_at(s))
        return frames[0] if np.ndim(s) == 0 else frames

    def d_p_at(self, s: ArrayLike) -> Array:
        """Return the derivatives of the centreline at fixed arclengths s [m] by the parameters, (j, 3, k)."""
        if self.sensitivity is None:
            raise InputError('derivatives of the centreline need columns = "load", "contact" or "all"')
        rows, turns = self._at(s), self.sensitivity.turns
        lanes = [lane_of.py_func(j) for j in range(turns.shape[1])]
        columns = (_lanes(rows[:, STATE:]) - _lanes(self.nodes[-1:, 1 + STATE :]))[:, 6:9]
        own = columns[:, :, lanes]
        if len(lanes) > REST_X + 1:  # of the tip's own axes, see `sensitivities`
            x, y = self.y[9:11] / np.hypot(self.y[9], self.y[10])
            own[:, :, REST_X : REST_X + 2] = own[:, :, REST_X : REST_X + 2] @ np.array([[x, y], [-y, x]])
        moved: Array = own + columns[:, :, 0:3] @ turns
        return moved

    def states_at(self, s: ArrayLike) -> Array:
        """Return the kernels' states [t, m, p from the tip, d] at arclengths s [m], (j, 12); NaN off the rod."""
        return self._at(s)[:, :STATE]

    def _at(self, s: ArrayLike) -> Array:
        """Return states and columns at arclengths s [m], as in the nodes; NaN off the rod."""
        s = np.atleast_1d(np.asarray(s, dtype=float))
        width = self.nodes.shape[1]
        rows = np.full((len(s), width - 1), np.nan)
        if self.ok:
            inside = (s >= 0.0) & (s <= self.body.knots[-1])
            on_rod = np.empty((int(inside.sum()), width - 1))
            chunks = (width - 1 - STATE) // (WIDE * COLUMN)
            work, blocks = np.empty(WORK), np.empty(chunks * BLOCK)
            states_at(s[inside], self.nodes.ravel(), len(self.nodes), self.body, self.load, work, blocks, on_rod)
            rows[inside] = on_rod
        return rows

    def _frames(self, states: Array) -> Array:
        t, d = states[:, 0:3], states[:, 9:12]
        across = np.cross(t, d)
        turn = -np.arctan2(self.y[10], self.y[9])
        x = np.cos(turn) * d + np.sin(turn) * across
        return np.stack([x, np.cross(t, x), t], axis=-1)


def _lanes(columns: Array) -> Array:
    blocks = columns.reshape(len(columns), -1, COLUMN, WIDE)
    lanes: Array = np.moveaxis(blocks, 1, 2).reshape(len(columns), COLUMN, -1)
    return lanes


def _volume_beyond(body: Body, s: Array) -> Array:
    i = np.clip(np.searchsorted(body.knots, s, side="right") - 1, 0, len(body.knots) - 2)
    h = body.knots[i + 1] - s
    r, r1 = np.interp(s, body.knots, body.radii), body.radii[i + 1]
    cones: Array = body.constants[CONE] * h * (r * r + r * r1 + r1 * r1)
    return cones + body.volume_beyond[i + 1]
