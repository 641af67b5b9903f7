"""A frictionless contact on the bent rod: the force that leans with the surface it acts on."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from probedesign.frames import Array
from probedesign.rod.equilibrium import Equilibrium, Sensitivity
from probedesign.rod.rod import Mode, Rod

_MAX_ITERATIONS = 20
_CLOSE = 1e-12  # relative misfit of force and normal


@dataclass(frozen=True)
class FrictionlessContact:
    """An equilibrium under a force normal to the rod's own bent surface.

    Attributes:
        result: "ok" or the code of the equilibrium that was not found.
        equilibrium: solved with the load columns of its sensitivity.
        force_base: what the object does to the rod [N], (3,).
        d_force: by (s_contact, angle, magnitude), (3, 3).
    """

    result: str
    equilibrium: Equilibrium
    force_base: Array
    d_force: Array

    @property
    def sensitivity(self) -> Sensitivity:
        """Of the equilibrium, by force and s_contact."""
        assert self.equilibrium.sensitivity is not None, "asked of a contact without an answer"
        return self.equilibrium.sensitivity

    @property
    def d_wrench(self) -> Array:
        """Of the base wrench by (s_contact, angle, magnitude), (6, 3)."""
        return self._total(self.sensitivity.d_wrench)

    @property
    def d_position(self) -> Array:
        """Of the contact point by (s_contact, angle, magnitude), (3, 3)."""
        return self._total(self.sensitivity.d_position)

    def _total(self, columns: Array) -> Array:
        direct = np.zeros((columns.shape[0], 3))
        direct[:, 0] = columns[:, 3]
        return columns[:, 0:3] @ self.d_force + direct


def solve_frictionless(
    rod: Rod, gravity: ArrayLike, s_contact: float, angle: float, magnitude: float, mode: Mode = "fast"
) -> FrictionlessContact:
    """Equilibrium under an object that pushes without friction.

    F = f (cos α u - sin α t), where u = x cos φ + y sin φ is the push seen in the bent section's own axes,
    t the bent tangent and α the half-angle of the frustum: the outward normal leans towards the tip, so
    the push leans towards the base. Solved by Newton on F with the rod's exact sensitivities.

    Args:
        rod: the rod.
        gravity: in base axes [m/s²], (3,).
        s_contact: where the force's line meets the axis [m].
        angle: φ of the push about the tangent, from the section's x axis [rad].
        magnitude: f [N].

    Returns:
        The contact; numbers come only with result "ok".
    """
    alpha = math.atan(rod.taper_at(s_contact))
    force = magnitude * _push(np.eye(3), alpha, angle)
    guess: Array | None = None
    for _ in range(_MAX_ITERATIONS):
        eq = rod.solve(gravity, force, s_contact, mode=mode, guess=guess, columns="load")
        if not eq.ok or eq.sensitivity is None:
            return FrictionlessContact(eq.result, eq, np.full(3, np.nan), np.full((3, 3), np.nan))
        frame, d = eq.sensitivity.frame, eq.sensitivity.d_contact
        R = np.stack([frame[3:6], frame[9:12], frame[0:3]], axis=-1)
        wanted = magnitude * _push(R, alpha, angle)
        d_wanted = magnitude * np.stack([_push(_columns(d, j), alpha, angle) for j in range(4)], axis=-1)
        jacobian = np.eye(3) - d_wanted[:, 0:3]
        if np.linalg.norm(force - wanted) <= _CLOSE * max(magnitude, 1e-12):
            across = magnitude * math.cos(alpha) * (R[:, 1] * math.cos(angle) - R[:, 0] * math.sin(angle))
            direct = np.stack([d_wanted[:, 3], across, _push(R, alpha, angle)], axis=-1)
            return FrictionlessContact("ok", eq, force, np.linalg.solve(jacobian, direct))
        force = force - np.linalg.solve(jacobian, force - wanted)
        guess = eq.tip_tangent
    return FrictionlessContact("not_converged", eq, np.full(3, np.nan), np.full((3, 3), np.nan))


def _push(R: Array, alpha: float, angle: float) -> Array:
    """Unit push in the axes R (columns x, y, tangent)."""
    return math.cos(alpha) * (math.cos(angle) * R[:, 0] + math.sin(angle) * R[:, 1]) - math.sin(alpha) * R[:, 2]


def _columns(d_contact: Array, j: int) -> Array:
    """Derivative j of the frame [x, y, tangent], (3, 3)."""
    d = d_contact[:, j]
    return np.stack([d[3:6], d[9:12], d[0:3]], axis=-1)

