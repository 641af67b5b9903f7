"""A frictionless contact on the bent rod: the force that leans with the surface it acts on."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from probedesign.frames import Array
from probedesign.rod.equilibrium import Equilibrium, Sensitivity
from probedesign.rod.rod import Mode, Rod

_MAX_ITERATIONS = 20
_CLOSE = 1e-10  # relative misfit of force and normal
_LEAST_STEP = 1e-3  # of the magnitude


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
    the push leans towards the base. Solved by Newton on F with the rod's exact sensitivities, the push
    growing from nothing in steps that Newton can take.

    Args:
        rod: the rod.
        gravity: in base axes [m/s²], (3,).
        s_contact: where the force's line meets the axis [m]; beyond the flank, before a rounded tip, no touch acts,
            and it is taken at the flank's end.
        angle: φ of the push about the tangent, from the section's x axis [rad].
        magnitude: f [N].
        mode: "fast" or "reference".

    Returns:
        The contact; numbers come only with result "ok". "not_converged" also stands for a push that the
        rod cannot hold: it bends away.
    """
    s_contact = min(s_contact, rod.flank_end)
    found = _Push(rod, np.asarray(gravity, dtype=float), s_contact, angle, mode).at(magnitude, None)
    if found.result == "ok":
        return found
    push = _Push(rod, np.asarray(gravity, dtype=float), s_contact, angle, mode)
    reached, step, last = 0.0, magnitude / 4.0, None
    while reached < magnitude:
        goal = min(reached + step, magnitude)
        found = push.at(goal, last)
        if found.result == "ok":
            reached, last, step = goal, found, 2.0 * step
        elif step < _LEAST_STEP * magnitude:
            return found
        else:
            step /= 4.0
    return found


@dataclass(frozen=True)
class _Push:
    """A frictionless push at one place from one side."""

    rod: Rod
    gravity: Array
    s: float
    angle: float
    mode: Mode

    def at(self, magnitude: float, last: FrictionlessContact | None) -> FrictionlessContact:
        """Newton on F for one magnitude, from the contact at a lesser one or from the unbent rod."""
        if last is None:
            force, guess = magnitude * self._normal(np.eye(3)), None
        else:
            ahead = magnitude - float(np.linalg.norm(last.force_base))
            force, guess = last.force_base + ahead * last.d_force[:, 2], last.equilibrium.tip
        for _ in range(_MAX_ITERATIONS):
            eq = self.rod.solve(
                self.gravity, force, self.s, mode=self.mode, guess=guess, guess_only=True, columns="load"
            )
            if not eq.ok or eq.sensitivity is None:
                return FrictionlessContact(eq.result, eq, np.full(3, np.nan), np.full((3, 3), np.nan))
            frame, d = eq.sensitivity.frame, eq.sensitivity.d_contact
            R = _axes(frame)
            d_normal = magnitude * np.stack([self._normal(_axes(d[:, j])) for j in range(4)], axis=-1)
            jacobian = np.eye(3) - d_normal[:, 0:3]
            misfit = force - magnitude * self._normal(R)
            if np.linalg.norm(misfit) <= _CLOSE * max(magnitude, 1e-12):
                direct = np.stack([d_normal[:, 3], magnitude * self._turned(R), self._normal(R)], axis=-1)
                d_force = np.linalg.solve(jacobian, direct).astype(float, copy=False)
                return FrictionlessContact("ok", eq, force, d_force)
            force = force - np.linalg.solve(jacobian, misfit)
            if np.linalg.norm(force) > 3.0 * magnitude:  # Newton left the sphere on which F must lie
                break
            guess = eq.tip
        return FrictionlessContact("not_converged", eq, np.full(3, np.nan), np.full((3, 3), np.nan))

    @cached_property
    def _weights(self) -> tuple[float, float, float]:
        """The push in the section's axes."""
        alpha = math.atan(self.rod.taper_at(self.s))
        return (
            math.cos(alpha) * math.cos(self.angle),
            math.cos(alpha) * math.sin(self.angle),
            -math.sin(alpha),
        )

    def _normal(self, R: Array) -> Array:
        """Unit push in the axes R (columns x, y, tangent); linear in R, so it serves derivatives too."""
        x, y, z = self._weights
        return x * R[:, 0] + y * R[:, 1] + z * R[:, 2]

    def _turned(self, R: Array) -> Array:
        """Its derivative by the angle."""
        x, y, _ = self._weights
        return x * R[:, 1] - y * R[:, 0]


def _axes(column: Array) -> Array:
    """[x, y, tangent] as columns from the kernels' [tangent, x, position, y], (12,) to (3, 3)."""
    return np.stack([column[3:6], column[9:12], column[0:3]], axis=-1)
