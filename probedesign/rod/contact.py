"""Contact forces that turn with the deformed surface on which they act: without friction, and of given direction.

`solve_frictionless` takes the arclength where the force's line of action meets the centreline, `solve_surface_force`
the touched point itself: both are a force and a couple that are fixed in the axes of the section (`_solve_following`).
`probedesign.rod.friction` finds the force from the position of an object instead. The estimators have a compiled
counterpart that is linearised from one sweep (`rod.kernels.surface_contact`); simulated truth does not share it.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from probedesign.core.errors import InputError
from probedesign.core.frames import Array
from probedesign.core.units import MILLINEWTON
from probedesign.rod.equilibrium import Equilibrium
from probedesign.rod.rod import Mode, Rod

_MAX_ITERATIONS = 20  # of Newton's method; where they do not suffice, the load is increased in smaller steps
_CLOSE = 1e-10  # relative residual of force and couple: below the error of the rod's fast mode
_MIN_STEP = 1e-3  # of the magnitude: a smaller one means that the rod buckles
_BY_LOAD = [0, 1, 2, 4, 5, 6]  # columns of the rod by force and couple
_AXIS = np.array([0.0, 0.0, 1.0])


class _FollowingLoad(NamedTuple):
    """An equilibrium under a load that turns with its section."""

    result: str  #: "ok" or the code of the failed equilibrium.
    equilibrium: Equilibrium
    axes: Array  #: of the section as columns x, y, tangent, (3, 3); meaningful only with "ok", as all that follows.
    load: Array  #: force, or force and couple, [N, N·m], (n,).
    jacobian: Array  #: of the residual by the load, (n, n).


def _solve_following(rod: Rod, gravity: Array, s: float, unit: Array, magnitude: float, mode: Mode) -> _FollowingLoad:
    """Solve for the equilibrium under the load f R u, with R the axes of the deformed section at s.

    Newton's method on the load, with the rod's exact sensitivities. Where it fails, f is increased from zero in steps.

    Args:
        rod: the rod.
        gravity: in base axes [m/s²], (3,).
        s: where it acts [m].
        unit: u in section axes, a force or a force and a couple [m], (3,) or (6,).
        magnitude: f [N].
        mode: "fast" or "reference".
    """
    solved = _newton(rod, gravity, s, unit, magnitude, mode, None)
    if solved.result == "ok":
        return solved
    reached, step, last = 0.0, magnitude / 4.0, None
    while reached < magnitude:
        goal = min(reached + step, magnitude)
        solved = _newton(rod, gravity, s, unit, goal, mode, last)
        if solved.result == "ok":
            reached, last, step = goal, solved, 2.0 * step
        elif step < _MIN_STEP * magnitude:
            break
        else:
            step /= 4.0
    return solved


def _newton(
    rod: Rod, gravity: Array, s: float, unit: Array, magnitude: float, mode: Mode, last: _FollowingLoad | None
) -> _FollowingLoad:
    """Solve for one magnitude, from the equilibrium at a smaller one or from the unbent rod."""
    with_couple = len(unit) == 6
    if last is None:
        load, tip = magnitude * unit, None
    else:
        ahead = magnitude - float(np.linalg.norm(last.load[0:3])) / float(np.linalg.norm(unit[0:3]))
        load = last.load + ahead * np.linalg.solve(last.jacobian, _turned(last.axes, unit))
        tip = last.equilibrium.tip
    close = _CLOSE * max(magnitude, 1e-12) * np.array([1.0] * 3 + [rod.length] * 3)[: len(unit)]
    result = "not_converged"
    for _ in range(_MAX_ITERATIONS):
        eq = rod.solve(
            gravity, load[0:3], s, couple=load[3:6] if with_couple else np.zeros(3), mode=mode, guess=tip,
            guess_only=True, columns="contact" if with_couple else "load",
        )  # fmt: skip
        if not eq.ok or eq.sensitivity is None:
            result = eq.result
            break
        axes, d = _axes(eq.sensitivity.frame), eq.sensitivity.d_contact
        turning = magnitude * np.stack([_turned(_axes(column), unit) for column in d.T], axis=1)
        jacobian = np.eye(len(unit)) - turning[:, _BY_LOAD[: len(unit)]]
        misfit = load - magnitude * _turned(axes, unit)
        if (np.abs(misfit) <= close).all():
            return _FollowingLoad("ok", eq, axes, load, jacobian)
        load = load - np.linalg.solve(jacobian, misfit)
        if np.linalg.norm(load[0:3]) > 3.0 * magnitude * np.linalg.norm(unit[0:3]):  # left the sphere of all forces
            break
        tip = eq.tip
    nothing = np.full((len(unit), len(unit)), np.nan)
    return _FollowingLoad(result, eq, nothing[:3, :3], nothing[0], nothing)


def _turned(axes: Array, unit: Array) -> Array:
    return np.asarray((unit.reshape(-1, 3) @ axes.T).ravel())


def _axes(column: Array) -> Array:
    """Return [x, y, tangent] as columns from the kernels' [tangent, x, position, y], (12,) to (3, 3)."""
    return np.stack([column[3:6], column[9:12], column[0:3]], axis=-1)


class RodContact(NamedTuple):
    """A contact with the rod; all but `result` and `equilibrium` is meaningful only with result "ok"."""

    result: str  #: "ok" or the code of the equilibrium that was not found.
    equilibrium: Equilibrium  #: of the rod under the contact.
    s_contact: float  #: arclength where the line of action of the force passes the centreline [m].
    p_contact_base: Array  #: point of the centreline there [m], (3,).
    force_base: Array  #: force of the object on the probe [N], (3,).
    p_surface_base: Array  #: touched point of the surface [m], (3,).


def solve_frictionless(
    rod: Rod, gravity: ArrayLike, s_contact: float, angle: float, magnitude: float, mode: Mode = "fast"
) -> RodContact:
    """Solve for the equilibrium under an object that pushes without friction.

    F = f (cos α u - sin α t), where u = x cos φ + y sin φ is the push seen in the bent section's own axes,
    t the bent tangent and α the lean of the flank: the outward normal leans towards the tip, so the push leans towards
    the base. The line of action meets the axis of a round rod; it passes that of an elliptic one at a distance, which
    leaves a couple along the flank.

    Args:
        rod: the rod.
        gravity: in base axes [m/s²], (3,).
        s_contact: where the force's line of action comes nearest to the axis [m], at most `rod.flank_end`, beyond which
            no frictionless contact acts.
        angle: φ of the push about the tangent, from the section's x axis [rad].
        magnitude: f [N].
        mode: "fast" or "reference".

    Returns:
        The contact, its equilibrium with columns "load" or "contact"; its numbers are finite only with result "ok". If
        the rod buckles, the result is "not_converged".
    """
    s = min(s_contact, rod.flank_end)
    e, t = np.array([-math.cos(angle), -math.sin(angle), 0.0]), _AXIS
    reach, aside = (float(value) for value in outline(rod.flatness, e[0], e[1]))
    tan = float(rod.taper_at(s)) * reach
    cos = 1.0 / math.hypot(1.0, tan)
    unit = -cos * (e + tan * t)
    if rod.flatness != 1.0:  # the touched section is thinner by cos² α
        unit = np.concatenate([unit, float(rod.radius_at(s)) * cos**3 * aside * (t - tan * e)])
    solved = _solve_following(rod, np.asarray(gravity, dtype=float), s, unit, magnitude, mode)
    eq, none = solved.equilibrium, np.full(3, np.nan)
    p_contact, p_surface = (eq.p_contact_base, surface_point(rod, eq)) if solved.result == "ok" else (none, none)
    return RodContact(solved.result, eq, s, p_contact, solved.load[0:3], p_surface)


def solve_surface_force(
    rod: Rod,
    gravity: ArrayLike,
    s: float,
    angle: float,
    normal_force: float,
    tangential: tuple[float, float] = (0.0, 0.0),
    mode: Mode = "fast",
) -> RodContact:
    """Solve for the equilibrium under a force at a point of the deformed surface, given in the surface's own axes.

    F = F_n (-N + c_a a + c_h h) with N the outward normal, a towards the tip along the flank and h around it; it turns
    with the surface. (c_a, c_h) inside a circle of radius μ is a contact within Coulomb's cone.

    Args:
        rod: the rod.
        gravity: in base axes [m/s²], (3,).
        s: arclength of the touched point [m].
        angle: φ of the outward normal about the tangent, from the section's x axis [rad].
        normal_force: F_n [N].
        tangential: (c_a, c_h), tangential over normal force.
        mode: "fast" or "reference".

    Returns:
        The equilibrium; its numbers are finite only with result "ok".
    """
    radius, slope = (float(v) for v in SurfaceProfile.of(rod).at(np.array(min(s, rod.length) / rod.length)))
    e, h = (np.array([math.cos(angle), math.sin(angle), 0.0]), np.array([-math.sin(angle), math.cos(angle), 0.0]))
    reach, aside = (float(value) for value in outline(rod.flatness, e[0], e[1]))
    tan, arm, t = slope * reach, radius * rod.length * (reach * e + aside * h), _AXIS
    cos = 1.0 / math.hypot(1.0, tan)
    force = -cos * (e + tan * t) + tangential[0] * cos * (t - tan * e) + tangential[1] * h
    unit = np.concatenate([force, np.cross(arm, force)])
    solved = _solve_following(rod, np.asarray(gravity, dtype=float), s, unit, normal_force, mode)
    eq, ok = solved.equilibrium, solved.result == "ok"
    point = np.asarray(eq.p_contact_base + solved.axes @ arm)
    s_axis = line_of_action(rod, eq, point) if ok else s
    p_axis = eq.p_at(s_axis) if ok else np.full(3, np.nan)
    return RodContact(solved.result, eq, s_axis, p_axis, solved.load[0:3], point)


def press_poses(
    rod: Rod,
    gravity: ArrayLike,
    s: float,
    angle: float,
    normal_forces: Sequence[float],
    point: ArrayLike = (0.0, 0.0, 0.0),
    object_compliance: float = 0.0,
) -> tuple[Array, Array]:
    """Return where the base stands while it presses on one point of an object, and what a reading is there.

    The base keeps its axes, those of the world, and the probe touches without friction: x_base = x - c F - p(F), with x
    the point at rest, F the force on the probe, p the touched point in base axes. With c > 0 the object yields.

    Args:
        rod: the rod.
        gravity: in base axes [m/s²], (3,).
        s: arclength of the touched point [m].
        angle: of the outward normal about the tangent, from the section's x axis [rad].
        normal_forces: [N], (n,).
        point: of the object at rest, in world axes [m], (3,).
        object_compliance: c [m/N].

    Returns:
        Wrenches at the base [N, N·m], (n, 6), and poses of the base in the world, (n, 4, 4).

    Raises:
        InputError: the probe buckles before it pushes so hard.
    """
    wrenches, poses = np.zeros((len(normal_forces), 6)), np.tile(np.eye(4), (len(normal_forces), 1, 1))
    for k, force in enumerate(normal_forces):
        touch = solve_surface_force(rod, gravity, s, angle, force)
        if touch.result != "ok":
            raise InputError(f"the probe has no equilibrium under {1e3 * force:g} mN at s = {1e3 * s:g} mm")
        wrenches[k] = touch.equilibrium.wrench_base
        poses[k, :3, 3] = np.asarray(point) - object_compliance * touch.force_base - touch.p_surface_base
    return wrenches, poses


def line_of_action(rod: Rod, eq: Equilibrium, p_surface: ArrayLike) -> float:
    """Return the arclength where the force's line of action passes the centreline, seen across both.

    With the force F at x = p + ρ of the section at s and e the direction of its normal there, that is
    s - (ρ · e)(F · t)/(F · e), from where F has no couple about t × e: r tan α nearer the base than the touched section
    of a round rod without friction, up to about μ r to either side with friction.

    Args:
        rod: the rod.
        eq: its equilibrium under the force at the touched section.
        p_surface: x, in base axes [m], (3,).

    Returns:
        The arclength [m], clipped to the rod.
    """
    R, force = eq.R_at(eq.s_contact), eq.load[0:3]
    arm = (np.asarray(p_surface) - eq.p_contact_base) @ R
    e = R @ [arm[0], arm[1] / rod.flatness**2, 0.0]  # of any length: across the ellipse
    s = eq.s_contact - float(arm @ R.T @ e) * float(force @ R[:, 2]) / float(force @ e)
    return min(max(s, 0.0), rod.length)


def surface_point(rod: Rod, eq: Equilibrium) -> Array:
    """Return the touched surface point, where the line of action leaves the body.

    The outward normal at the touched section leans towards the tip by α, tan α = -g dr/ds, so with r the radius at
    s_contact the touched section lies r g cos α sin α further out and has radius r cos² α.
    """
    s = there = eq.s_contact
    taper = float(rod.taper_at(s))
    for _ in range(2):  # g is that of the force in the touched section's axes
        R = eq.R_at(there)
        across = -(eq.load[0:3] @ R)[:2]
        norm = float(np.linalg.norm(across))
        x, y = across / norm if norm > 0.0 else np.zeros(2)
        reach, aside = (float(value) for value in outline(rod.flatness, x, y)) if norm > 0.0 else (1.0, 0.0)
        tan = taper * reach
        radius = float(rod.radius_at(s)) / (1.0 + tan * tan)
        there = min(s + radius * reach * tan, rod.length)
    return np.asarray(eq.p_at(there) + radius * (R @ [reach * x - aside * y, reach * y + aside * x, 0.0]))


def solve_contact(
    rod: Rod,
    gravity_base: Array,
    s: float,
    push_angle: float,
    normal_force: float,
    friction_ratios: tuple[float, float] | None = None,
    mode: Mode = "fast",
) -> RodContact:
    """Return the contact of an object that pushes on the section at s.

    Args:
        rod: the rod.
        gravity_base: gravity in base axes [m/s²], (3,).
        s: arclength of the contact [m]; with friction, of the touched section.
        push_angle: direction of the push about the tangent, from the x axis of the section [rad].
        normal_force: force normal to the surface [N].
        friction_ratios: axial and circumferential force over normal force; None for a contact without friction.
        mode: "fast" or "reference".
    """
    if friction_ratios is not None:  # the touched point lies opposite to the direction of the push
        return solve_surface_force(rod, gravity_base, s, push_angle + math.pi, normal_force, friction_ratios, mode)
    return solve_frictionless(rod, gravity_base, s, push_angle, normal_force, mode)


Numbers = NDArray[Any]  #: Real or complex: derivatives are taken by complex steps.
#: Half-width over which the normal rotates at a knot [rod lengths], at most a quarter of the adjacent frusta.
_BLEND = 0.005


def outline(flatness: float, x: Numbers | float, y: Numbers | float) -> tuple[Numbers, Numbers]:
    """Return how far an elliptic outline of half-width 1 along x reaches along its normal e = (x, y), and how far its
    point there lies aside, along (-y, x).

    The reach is the support function g = √(x² + f² y²), the other is its derivative by the direction of the normal; the
    radius of curvature is f²/g³. Complex numbers give derivatives.
    """
    reach = np.sqrt(x * x + flatness * flatness * y * y)
    return reach, (flatness * flatness - 1.0) * x * y / reach


class SurfaceProfile(NamedTuple):
    """Radius and taper of the surface along a rod, in rod lengths."""

    s: Array  #: s, radius: at the knots, (K,).
    radius: Array
    at_s: Array  #: at_s, tan: knots of -dr/ds, linear between them, (j,).
    tan: Array
    flatness: float  #: half-width along y over the radius, which is that along x.

    @classmethod
    def of(cls, rod: Rod) -> "SurfaceProfile":
        """Return the profile of a rod."""
        s, r = np.asarray(rod.s) / rod.length, np.asarray(rod.radius) / rod.length
        tan, span = -np.diff(r) / np.diff(s), np.diff(s)
        half = np.minimum(_BLEND, 0.25 * np.minimum(span[:-1], span[1:]))
        ends = np.stack([s[1:-1] - half, s[1:-1] + half], axis=1).ravel()
        return cls(s, r, np.concatenate([[0.0], ends, [1.0]]), np.repeat(tan, 2), rod.flatness)

    def at(self, s: Numbers) -> tuple[Numbers, Numbers]:
        """Return radius and -dr/ds at s; complex s gives their derivatives."""
        return _straight(s, self.s, self.radius), _straight(s, self.at_s, self.tan)


def _straight(s: Numbers, knots: Array, values: Array) -> Numbers:
    i = np.clip(np.searchsorted(knots, s.real, side="right") - 1, 0, len(knots) - 2)
    slope = (values[i + 1] - values[i]) / (knots[i + 1] - knots[i])
    interpolated: Numbers = values[i] + slope * (s - knots[i])
    return interpolated


DEFAULT_FORCE = 20.0 * MILLINEWTON  #: Default contact force [N], reduced for a probe that it would bend too far.
#: Maximum of F s² r(0)/(E I(0) r(s)): about one radian of bending, for any inclination of the force.
MAX_BENDING = 0.85
OUTERMOST = 0.95  #: Largest fraction of the length at which simulated contacts are placed.


def safe_force(rod: Rod) -> float:
    """Return the default contact force [N], reduced for a probe that it would bend too far."""
    s = OUTERMOST * rod.length
    radius, base = float(rod.radius_at(s)), float(rod.radius[0])
    softer_axis = min(rod.factors[1:3])
    stiffness = softer_axis * rod.youngs_modulus * math.pi / 4.0 * base**4 * radius / base
    return min(DEFAULT_FORCE, MAX_BENDING * stiffness / s**2)
