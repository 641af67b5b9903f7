"""A probe pressed against something at one pose of its base: what it reads and where it is touched, to first order."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from probedesign.estimation import press_kernel as kernel
from probedesign.estimation.fused import Fixed
from probedesign.frames import Array
from probedesign.rod import kernels
from probedesign.rod.equilibrium import Equilibrium
from probedesign.rod.rod import Rod
from probedesign.rod.workspace import workspace

_COMPLIANCES = [kernels.BEND_X, kernels.BEND_Y, kernels.TWIST, kernels.SHEAR, kernels.STRETCH]
STIFFNESS = 3
"""Column of the derivatives by the common factor on E and G, after those by place, angle and magnitude."""
_WORST = 1e12
"""Condition of the fixed point by the push beyond which it does not tell it: at the clamp itself nothing moves."""
_LEAST = 0.02
"""Nearest to the base that a contact is looked for, over the length: nearer, nothing bends."""


@dataclass(frozen=True)
class Push:
    """A guess of one touch.

    Attributes:
        s: arclength of the contact [m].
        angle: of the push about the tangent, from the section's x axis [rad].
        magnitude: of the force [N]; negative where the object would have to pull.
        force: base axes [N], (3,); normal to the surface once the guess has settled.
        tip: the tip's section, for the rod to start from, (6,).
    """

    s: float
    angle: float
    magnitude: float
    force: Array
    tip: Array

    @classmethod
    def under(cls, rod: Rod, eq: Equilibrium) -> "Push":
        """As the force of an equilibrium pushes."""
        force, R = eq.load[0:3].copy(), eq.R_at(eq.s_contact)
        x, y, _ = force @ R
        return cls(eq.s_contact, math.atan2(y, x), float(np.linalg.norm(force)), force, eq.tip)


@dataclass(frozen=True)
class Pressed:
    """One touch solved and linearised about a guess, the force made normal to first order.

    With θ = (s, angle, magnitude, log stiffness); where the point of the centreline is fixed, the second is not the
    angle but the tangential force magnitude·δangle, which is well-behaved where there is no force.

    Attributes:
        push: the guess.
        length: up to which touches act [m].
        fixed: which point stands still.
        wrench: at the base [N, N·m], (6,); d_wrench: by θ, (6, 4).
        p_contact, p_surface: [m], (3,).
        d_contact, d_surface: of these by θ, (3, 4).
        d_force: of the force by θ, (3, 4).
        towards_normal: what makes the force normal [N], (3,).
        tip: the tip's section, (6,).
        log_stiffness: by which E and G were greater than the rod's.
    """

    push: Push
    length: float
    fixed: Fixed
    wrench: Array
    d_wrench: Array
    p_contact: Array
    p_surface: Array
    d_contact: Array
    d_surface: Array
    d_force: Array
    towards_normal: Array
    tip: Array
    log_stiffness: float

    @property
    def p_fixed(self) -> Array:
        """The point that stands still [m], (3,)."""
        return self.p_surface if self.fixed == "surface" else self.p_contact

    @property
    def d_fixed(self) -> Array:
        """Of the point that stands still, by θ, (3, 4)."""
        return self.d_surface if self.fixed == "surface" else self.d_contact

    @cached_property
    def by_point(self) -> Array:
        """Of θ's first three by the fixed point, (3, 3)."""
        scale = np.sqrt((self.d_fixed[:, :3] ** 2).sum(axis=0)) + 1e-300
        inverse: Array = np.linalg.inv(self.d_fixed[:, :3] / scale) / scale[:, None]
        return inverse

    @cached_property
    def stiffness(self) -> Array:
        """Of the wrench by the fixed point, (6, 3)."""
        return self.d_wrench[:, :3] @ self.by_point

    @cached_property
    def by_stiffness(self) -> Array:
        """Of the wrench by log stiffness with the point held, (6,)."""
        held: Array = self.d_wrench[:, STIFFNESS] - self.stiffness @ self.d_fixed[:, STIFFNESS]
        return held

    @cached_property
    def contact_by_fixed(self) -> tuple[Array, Array]:
        """Of the centreline's point by the fixed one, (3, 3), and by log stiffness with that held, (3,)."""
        by_point = self.d_contact[:, :3] @ self.by_point
        return by_point, self.d_contact[:, STIFFNESS] - by_point @ self.d_fixed[:, STIFFNESS]

    def moved(self, point: Array, log_stiffness: float, most: float) -> Push:
        """The next guess: the fixed point there, with such a stiffness, no further than `most` [m] along s."""
        more = log_stiffness - self.log_stiffness
        step = np.append(self.by_point @ (point - self.p_fixed - self.d_fixed[:, STIFFNESS] * more), more)
        share = min(1.0, most / max(abs(step[0]), 1e-300))
        if self.fixed == "surface":
            share = min(share, 0.5 / max(abs(step[1]), 1e-300))
        step = share * step
        s = min(max(self.push.s + step[0], _LEAST * self.length), self.length)
        force = self.push.force + self.towards_normal + self.d_force @ step
        angle, magnitude = self.push.angle + step[1], self.push.magnitude + step[2]
        if self.fixed == "contact":
            along, aside = self.push.magnitude + step[2], step[1]
            angle, magnitude = self.push.angle + math.atan2(aside, along), math.hypot(along, aside)
        return Push(s, angle, magnitude, force, self.tip)


def press(rod: Rod, gravity: Array, push: Push, fixed: Fixed, log_stiffness: float = 0.0) -> Pressed | None:
    """Solve and linearise a guess; None where there is no equilibrium.

    Args:
        rod: the rod.
        gravity: base axes [m/s²], (3,).
        push: the guess.
        fixed: which point stands still.
        log_stiffness: by which E and G are greater than the rod's.
    """
    body = rod.body
    if log_stiffness:
        constants = body.constants.copy()
        constants[_COMPLIANCES] *= math.exp(-log_stiffness)
        body = body._replace(constants=constants)
    room = workspace(kernel.COLUMNS, 0)
    tip, answer, load = push.tip.copy(), np.empty(kernel.ANSWER), np.zeros(kernels.LOAD)
    found = kernel.press_at(
        body, gravity, push.s, push.angle, push.magnitude, push.force, fixed == "contact", load, room.scratch,
        room.nodes, room.blocks, room.y, room.contact, room.turns, np.empty((15, kernel.COLUMNS + 1)), np.empty(27),
        tip, answer,
    )  # fmt: skip
    by_push = answer[kernel.D_SURFACE if fixed == "surface" else kernel.D_POINT :][:12].reshape(3, 4)[:, :3]
    if not found or not np.linalg.cond(by_push / (np.linalg.norm(by_push, axis=0) + 1e-300)) < _WORST:
        return None
    d_force, towards = answer[kernel.D_FORCE : kernel.TOWARDS].reshape(3, 4), answer[kernel.TOWARDS :]
    wrench, d_wrench = np.empty(6), np.empty((6, 4))
    wrench[:3] = push.force + towards + rod.mass * gravity
    wrench[3:] = answer[: kernel.D_MOMENT]
    d_wrench[:3] = d_force
    d_wrench[3:] = answer[kernel.D_MOMENT : kernel.POINT].reshape(3, 4)
    return Pressed(
        push, rod.flank_end, fixed, wrench, d_wrench, answer[kernel.POINT : kernel.D_POINT],
        answer[kernel.SURFACE : kernel.D_SURFACE], answer[kernel.D_POINT : kernel.SURFACE].reshape(3, 4),
        answer[kernel.D_SURFACE : kernel.D_FORCE].reshape(3, 4), d_force, towards, tip, log_stiffness,
    )  # fmt: skip


def settle(
    rod: Rod, gravity: Array, push: Push, fixed: Fixed, point: Array, close: float, log_stiffness: float = 0.0
) -> Pressed | None:
    """The touch whose fixed point is there, within `close` [m]; None if it is not found."""
    for _ in range(25):
        pressed = press(rod, gravity, push, fixed, log_stiffness)
        if pressed is None:
            return None
        normal = float(np.linalg.norm(pressed.towards_normal)) <= 1e-6 * abs(push.magnitude) + 1e-12
        if np.linalg.norm(pressed.p_fixed - point) <= close and normal:
            return pressed
        push = pressed.moved(point, log_stiffness, 0.1 * rod.length)
    return None
