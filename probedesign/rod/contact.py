"""Contact forces that turn with the deformed surface on which they act: without friction, and of given direction.

`solve_frictionless` takes the arclength where the force's line of action meets the centreline, `solve_surface_force`
the touched point itself. `probedesign.rod.obstacle` and `probedesign.rod.friction` find the force from the position of
an object instead.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from probedesign.core.frames import Array
from probedesign.rod.coulomb_equations import SurfaceProfile
from probedesign.rod.equilibrium import Equilibrium, Sensitivity
from probedesign.rod.rod import Mode, Rod

_MAX_ITERATIONS = 20
_CLOSE = 1e-10  # relative residual of the force
_MIN_STEP = 1e-3  # of the magnitude


@dataclass(frozen=True)
class FrictionlessContact:
    """An equilibrium under a force normal to the rod's own bent surface.

    Attributes:
        result: "ok" or the code of the failed equilibrium.
        equilibrium: with its sensitivity to force and s_contact.
        force_base: of the object on the rod [N], (3,).
        d_force: derivative of the force by (s_contact, angle, magnitude), (3, 3).
    """

    result: str
    equilibrium: Equilibrium
    force_base: Array
    d_force: Array

    @property
    def sensitivity(self) -> Sensitivity:
        """Return the sensitivity of the equilibrium to force and s_contact."""
        assert self.equilibrium.sensitivity is not None, "a contact whose result is not ok has no sensitivity"
        return self.equilibrium.sensitivity

    @property
    def d_wrench(self) -> Array:
        """Return the derivative of the base wrench by (s_contact, angle, magnitude), (6, 3)."""
        return self._total(self.sensitivity.d_wrench)

    @property
    def d_position(self) -> Array:
        """Return the derivative of the contact point by (s_contact, angle, magnitude), (3, 3)."""
        return self._total(self.sensitivity.d_position)

    def _total(self, columns: Array) -> Array:
        direct = np.zeros((columns.shape[0], 3))
        direct[:, 0] = columns[:, 3]
        return columns[:, 0:3] @ self.d_force + direct


def solve_frictionless(
    rod: Rod, gravity: ArrayLike, s_contact: float, angle: float, magnitude: float, mode: Mode = "fast"
) -> FrictionlessContact:
    """Solve for the equilibrium under an object that pushes without friction.

    F = f (cos α u - sin α t), where u = x cos φ + y sin φ is the push seen in the bent section's own axes,
    t the bent tangent and α the half-angle of the frustum: the outward normal leans towards the tip, so
    the push leans towards the base. Solved for F by Newton's method with the rod's exact sensitivities; where that
    fails, the push is increased from zero in steps.

    Args:
        rod: the rod.
        gravity: in base axes [m/s²], (3,).
        s_contact: where the force's line of action meets the axis [m], at most `rod.flank_end`, beyond which no
            frictionless contact acts.
        angle: φ of the push about the tangent, from the section's x axis [rad].
        magnitude: f [N].
        mode: "fast" or "reference".

    Returns:
        The contact; its numbers are finite only with result "ok". If the rod buckles, the result is "not_converged".
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
        elif step < _MIN_STEP * magnitude:
            return found
        else:
            step /= 4.0
    return found


@dataclass(frozen=True)
class _Push:
    """Solves for a frictionless push of given place and direction."""

    rod: Rod
    gravity: Array
    s: float
    angle: float
    mode: Mode

    def at(self, magnitude: float, last: FrictionlessContact | None) -> FrictionlessContact:
        """Solve for one magnitude by Newton's method, from the contact at a smaller one or from the unbent rod."""
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
            if np.linalg.norm(force) > 3.0 * magnitude:  # the iteration left the sphere on which F must be
                break
            guess = eq.tip
        return FrictionlessContact("not_converged", eq, np.full(3, np.nan), np.full((3, 3), np.nan))

    @cached_property
    def _weights(self) -> tuple[float, float, float]:
        """Return the unit push in the section's axes."""
        alpha = math.atan(self.rod.taper_at(self.s))
        return (
            math.cos(alpha) * math.cos(self.angle),
            math.cos(alpha) * math.sin(self.angle),
            -math.sin(alpha),
        )

    def _normal(self, R: Array) -> Array:
        """Return the unit push for the axes R (columns x, y, tangent); linear in R, so it maps derivatives too."""
        x, y, z = self._weights
        return x * R[:, 0] + y * R[:, 1] + z * R[:, 2]

    def _turned(self, R: Array) -> Array:
        """Return the derivative of the unit push by the angle."""
        x, y, _ = self._weights
        return x * R[:, 1] - y * R[:, 0]


_MAX_SURFACE_ITERATIONS = 15


class SurfaceForce(NamedTuple):
    """Equilibrium under a force that is given in the axes of the surface it acts on.

    Attributes:
        result: "ok", or the code of the failed equilibrium.
        equilibrium: of the rod.
        force_base: [N], (3,).
        p_surface_base: point of the surface where it acts [m], (3,).
    """

    result: str
    equilibrium: Equilibrium
    force_base: Array
    p_surface_base: Array


def solve_surface_force(
    rod: Rod,
    gravity: ArrayLike,
    s: float,
    angle: float,
    normal_force: float,
    tangential: tuple[float, float] = (0.0, 0.0),
    mode: Mode = "fast",
) -> SurfaceForce:
    """Solve for the equilibrium under a force at a point of the deformed surface, given in the surface's own axes.

    F = F_n (-N + c_a a + c_h h) with N the outward normal, a towards the tip along the flank and h around it; it turns
    with the surface. (c_a, c_h) inside a circle of radius μ is a contact within Coulomb's cone.

    Args:
        rod: the rod; its section must be round.
        gravity: in base axes [m/s²], (3,).
        s: arclength of the touched point [m].
        angle: φ of the touched point about the tangent, from the section's x axis [rad].
        normal_force: F_n [N].
        tangential: (c_a, c_h), tangential over normal force.
        mode: "fast" or "reference".

    Returns:
        The equilibrium; its numbers are finite only with result "ok".
    """
    profile = SurfaceProfile.of(rod)
    radius, tan = (float(v) for v in profile.at(np.array(min(s, rod.length) / rod.length)))
    radius, cos = radius * rod.length, 1.0 / math.hypot(1.0, tan)
    e, h = (
        np.array([math.cos(angle), math.sin(angle), 0.0]),
        np.array([-math.sin(angle), math.cos(angle), 0.0]),
    )
    t = np.array([0.0, 0.0, 1.0])
    local = -cos * (e + tan * t) + tangential[0] * cos * (t - tan * e) + tangential[1] * h
    both = np.concatenate([local, np.cross(radius * e, local)])  # force and couple of 1 N, section axes
    load, guess, reached, step = np.concatenate([both[0:3], both[3:6]]), None, 0.0, 1.0
    last_load, last_tip = np.zeros(6), None
    none = np.full(3, np.nan)
    while reached < 1.0:
        goal = min(1.0, reached + step)
        size = goal * normal_force
        load = last_load * (goal / reached) if reached else size * both
        guess, found = last_tip, "not_converged"
        for _ in range(_MAX_SURFACE_ITERATIONS):
            eq = rod.solve(gravity, load[0:3], s, couple=load[3:6], mode=mode, guess=guess,
                           guess_only=guess is not None, columns="contact")  # fmt: skip
            if not eq.ok or eq.sensitivity is None:
                found = eq.result
                break
            frame, d = _axes(eq.sensitivity.frame), eq.sensitivity.d_contact
            want = size * np.concatenate([frame @ both[0:3], frame @ both[3:6]])
            off = load - want
            if np.linalg.norm(off[0:3]) <= 1e-9 * normal_force and np.linalg.norm(off[3:6]) <= 1e-9 * (
                normal_force * rod.length
            ):
                found = "ok"
                break
            columns = [*range(3), *range(4, 7)]
            turned = np.stack(
                [np.concatenate([_axes(d[:, j]) @ both[0:3], _axes(d[:, j]) @ both[3:6]]) for j in columns],
                axis=1,
            )
            load = load - np.linalg.solve(np.eye(6) - size * turned, off)
            guess = eq.tip
        if found == "ok":
            reached, last_load, last_tip, step = goal, load, eq.tip, 2.0 * step
            continue
        step *= 0.25
        if step < 1e-3:
            return SurfaceForce(found, eq, none, none)
    point = eq.p_contact_base + radius * (_axes(eq.sensitivity.frame) @ e)  # type: ignore[union-attr]
    return SurfaceForce("ok", eq, load[0:3], np.asarray(point))


def line_of_action(rod: Rod, eq: Equilibrium, p_surface: ArrayLike) -> float:
    """Return the arclength where the force's line of action passes the centreline, seen across both.

    With the force F at x = p + r e of the section at s, that is s - r (F · t)/(F · e), from where F has no couple about
    h = t × e: r tan α nearer the base than the touched section without friction, up to about μ r to either side with
    friction.

    Args:
        rod: the rod.
        eq: its equilibrium under the force at the touched section.
        p_surface: x, in base axes [m], (3,).

    Returns:
        The arclength [m], clipped to the rod.
    """
    t, arm, force = eq.R_at(eq.s_contact)[:, 2], np.asarray(p_surface) - eq.p_contact_base, eq.load[0:3]
    radius = float(np.linalg.norm(arm))
    s = eq.s_contact - radius * float(force @ t) / (float(force @ arm) / radius)
    return min(max(s, 0.0), rod.length)


def _axes(column: Array) -> Array:
    """Return [x, y, tangent] as columns from the kernels' [tangent, x, position, y], (12,) to (3, 3)."""
    return np.stack([column[3:6], column[9:12], column[0:3]], axis=-1)
