"""Contact forces that turn with the deformed surface on which they act: without friction, and of given direction.

`solve_frictionless` takes the arclength where the force's line of action meets the centreline, `solve_surface_force`
the touched point itself. `probedesign.rod.obstacle` and `probedesign.rod.friction` find the force from the position of
an object instead; `coulomb_residuals` are the equations of the latter, for complex steps.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from probedesign.core.frames import Array
from probedesign.core.units import MILLINEWTON
from probedesign.rod.equilibrium import Equilibrium, Sensitivity
from probedesign.rod.rod import Mode, Rod

_MAX_ITERATIONS = 20  # of Newton's method; where they do not suffice, the push is increased in smaller steps
_CLOSE = 1e-10  # relative residual of the force: below the error of the rod's fast mode
_MIN_STEP = 1e-3  # of the magnitude: a smaller one means that the rod buckles


@dataclass(frozen=True)
class FrictionlessContact:
    """An equilibrium under a force normal to the rod's own bent surface."""

    result: str  #: "ok" or the code of the failed equilibrium.
    equilibrium: Equilibrium  #: with its sensitivity to force and s_contact.
    force_base: Array  #: of the object on the rod [N], (3,).
    d_force: Array  #: derivative of the force by (s_contact, angle, magnitude), (3, 3).

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
    push = _Push(rod, np.asarray(gravity, dtype=float), s_contact, angle, mode)
    found = push.at(magnitude, None)
    if found.result == "ok":
        return found
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
        return (math.cos(alpha) * math.cos(self.angle), math.cos(alpha) * math.sin(self.angle), -math.sin(alpha))

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
    """Equilibrium under a force that is given in the axes of the surface it acts on."""

    result: str  #: "ok", or the code of the failed equilibrium.
    equilibrium: Equilibrium  #: of the rod.
    force_base: Array  #: [N], (3,).
    p_surface_base: Array  #: point of the surface where it acts [m], (3,).


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
    e, h = (np.array([math.cos(angle), math.sin(angle), 0.0]), np.array([-math.sin(angle), math.cos(angle), 0.0]))
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
                [np.concatenate([_axes(d[:, j]) @ both[0:3], _axes(d[:, j]) @ both[3:6]]) for j in columns], axis=1
            )
            load = load - np.linalg.solve(np.eye(6) - size * turned, off)
            guess = eq.tip
        if found == "ok":
            reached, last_load, last_tip, step = goal, load, eq.tip, 2.0 * step
            continue
        step *= 0.25
        if step < 1e-3:
            return SurfaceForce(found, eq, none, none)
    assert eq is not None and eq.sensitivity is not None  # the last step was solved
    point = eq.p_contact_base + radius * (_axes(eq.sensitivity.frame) @ e)
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


Numbers = NDArray[Any]
"""Real or complex: derivatives are taken by complex steps."""
_BLEND = 0.005
"""Half-width over which the normal rotates at a knot [rod lengths], at most a quarter of the adjacent frusta."""


class SurfaceProfile(NamedTuple):
    """Radius and taper of the surface along a rod, in rod lengths."""

    s: Array  #: s, radius: at the knots, (K,).
    radius: Array
    at_s: Array  #: at_s, tan: knots of tan α, linear between them, (j,).
    tan: Array

    @classmethod
    def of(cls, rod: Rod) -> "SurfaceProfile":
        """Return the profile of a rod."""
        s, r = np.asarray(rod.s) / rod.length, np.asarray(rod.radius) / rod.length
        tan, span = -np.diff(r) / np.diff(s), np.diff(s)
        half = np.minimum(_BLEND, 0.25 * np.minimum(span[:-1], span[1:]))
        ends = np.stack([s[1:-1] - half, s[1:-1] + half], axis=1).ravel()
        return cls(s, r, np.concatenate([[0.0], ends, [1.0]]), np.repeat(tan, 2))

    def at(self, s: Numbers) -> tuple[Numbers, Numbers]:
        """Return radius and tan α at s; complex s gives their derivatives."""
        return _straight(s, self.s, self.radius), _straight(s, self.at_s, self.tan)


def _straight(s: Numbers, knots: Array, values: Array) -> Numbers:
    """Interpolate linearly, and extrapolate beyond the ends."""
    i = np.clip(np.searchsorted(knots, s.real, side="right") - 1, 0, len(knots) - 2)
    slope = (values[i + 1] - values[i]) / (knots[i + 1] - knots[i])
    found: Numbers = values[i] + slope * (s - knots[i])
    return found


def coulomb_residuals(
    z: Numbers,
    before: Array,
    point: Array,
    direction: Array | None,
    profile: SurfaceProfile,
    friction: float,
    stiffness: float | None,
) -> Numbers:
    """Return the residuals of couple, place, edge and Coulomb's law, (9, m), without dimension.

    Args:
        z: [9 unknowns, 12 of the section's tangent, x axis, position and y axis], lengths over the rod's, (21, m);
            the unknowns are force (3), couple (3), s, φ and λ.
        before: s, φ and λ before the step, (3,).
        point: of the object, over the rod's length, (3,).
        direction: of its edge, unit, (3,); None for a point.
        profile: of the rod.
        friction: coefficient μ.
        stiffness: k of the slip law; None for stick.
    """
    F, C, s, angle, way = z[0:3], z[3:6], z[6], z[7], z[8]
    t, x, p, y = z[9:12], z[12:15], z[15:18], z[18:21]
    radius, tan = profile.at(s)
    cos = 1.0 / np.sqrt(1.0 + tan * tan)
    e, h = np.cos(angle) * x + np.sin(angle) * y, np.cos(angle) * y - np.sin(angle) * x
    a, normal = cos * (t - tan * e), cos * (e + tan * t)
    arm = radius * e
    couple = C - cross(arm, F)
    apart = p + arm - point[:, None]
    slide_a, slide_h = (s - before[0]) / cos, radius * (angle - before[1])
    edge = way
    if direction is not None:
        line = direction[:, None]
        apart = apart - way * line
        edge = dot(normal, line)
        slide_a = slide_a - (way - before[2]) * dot(a, line)
        slide_h = slide_h - (way - before[2]) * dot(h, line)
    if stiffness is None:
        law = (slide_a, slide_h)
    else:
        F_a, F_h = dot(F, a), dot(F, h)
        law = (F_a, F_h)
        if friction > 0.0:
            tau_a, tau_h = F_a + stiffness * slide_a, F_h + stiffness * slide_h
            limit = -friction * dot(F, normal) / np.sqrt(tau_a * tau_a + tau_h * tau_h + 1e-300)
            law = (F_a - limit * tau_a, F_h - limit * tau_h)
    return np.stack([*couple, *apart, edge, *law])


def dot(a: Numbers, b: Numbers) -> Numbers:
    """Return the dot products of columns, (m,); complex steps pass through, unlike in `np.vdot`."""
    product: Numbers = (a * b).sum(axis=0)
    return product


def cross(a: Numbers, b: Numbers) -> Numbers:
    """Return the cross products of columns, (3, m)."""
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


DEFAULT_FORCE = 20.0 * MILLINEWTON
"""Default contact force [N], reduced for a probe that it would bend too far."""
MAX_BENDING = 0.85
"""Maximum of F s² r(0)/(E I(0) r(s)): about one radian of bending, for any inclination of the force."""
OUTERMOST = 0.95
"""Largest fraction of the length at which simulated contacts are placed."""


def safe_force(rod: Rod) -> float:
    """Return the default contact force [N], reduced for a probe that it would bend too far."""
    s = OUTERMOST * rod.length
    radius, base = float(rod.radius_at(s)), float(rod.radius[0])
    softer_axis = min(rod.factors[1:3])
    stiffness = softer_axis * rod.youngs_modulus * math.pi / 4.0 * base**4 * radius / base
    return min(DEFAULT_FORCE, MAX_BENDING * stiffness / s**2)
