"""Contact with Coulomb friction between the rod and an object: stick and slip.

A force F acts at the point x = p(s) + r(s) e(φ) of the deformed surface, e(φ) = R(s) [cos φ, sin φ, 0], whose outward
unit normal is N = cos α e + sin α t with tan α = -dr/ds. The rod bears F on its centreline at s together with the
couple C = (x - p) × F. The couple depends on the deformed section and the section on the couple, so both are solved
for together, by Newton's method with the rod's exact sensitivities.

The object is a sharp point, or a straight edge that touches the rod where both are tangent, N · d = 0. It moves along
a path in base axes, x = X. In a step of that path the object slides over the rod by the backward-Euler increment

    g = Δs / cos α a + r Δφ h - Δλ d,    a = cos α t - sin α e,    h = ∂e/∂φ,

with λ the way along the edge, so that a rod that rolls on an edge does not slide. With F_n = -F · N and F_t the part
of F in the tangent plane, Coulomb's law is

    stick:  g = 0,                           |F_t| ≤ μ F_n,
    slip:   F_t = μ F_n (F_t + k g)/|F_t + k g|,    F_t · g > 0,

friction on the rod pointing where the object slides. Any k > 0 has the same solutions; it scales Newton's steps. Stick
is tried and kept inside the cone (return mapping); otherwise slip is solved (P. Wriggers, Computational Contact
Mechanics, 2nd ed., 2006, ch. 5.2 and 9; P. Alart, A. Curnier, Comput. Methods Appl. Mech. Eng. 92, 1991).

Friction is modelled on the flank, whose normal turns smoothly over a short length at the knots of a profile, as the
frictionless contact turns at once. At the rim and the flat end of a blunt tip it is not: there the result is "on_end"
and `probedesign.rod.obstacle` has the contact without friction.
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from probedesign.errors import InputError
from probedesign.frames import Array
from probedesign.rod.approach import FreeRod, Nearest, Obstacle
from probedesign.rod.equilibrium import Equilibrium
from probedesign.rod.rod import Mode, Rod

Numbers = NDArray[Any]
"""Real or complex: derivatives are taken by complex steps."""
ASSUMED_FRICTION = 0.5
"""Friction coefficient of the simulators: assumed, the lower end of about 0.5 to 1 for soft polyurethane on card,
plastic or metal, which is to be measured for each resin."""
ASSUMED_SPREAD = 0.2
"""Standard deviation of ln μ from touch to touch in the simulators: assumed."""
MAX_FRICTION = 3.0
"""Largest friction coefficient that the simulators take: rubber on dry glass reaches 1 to 2 (assumed bound)."""

_U = 9
"""Unknowns: force (3), couple (3), s, φ, λ."""
_CLOSE = {"fast": 1e-8, "reference": 1e-11}
"""Residual allowed, in rod lengths and relative to the force: what the rod's own solve leaves."""
_MIN_FORCE = 1e-6
"""In E I / L²; below it forces are held to an absolute residual."""
_MAX_ITERATIONS = 15
_IMAGINARY = 1e-30
_STEP = 0.005
"""Longest step of the object [rod lengths]: bounds how far the sliding direction turns in one increment."""
_MIN_STEP = 1e-6
"""Shortest step [rod lengths] before the contact is given up."""
_LOST_STEP = 5e-4
"""Step [rod lengths] from which a lost contact is believed: longer ones are cut."""
_MAX_TURN = 0.2
"""Of the tip and of the normal in one step [rad]: keeps the branch."""
_MAX_SLIDE = 0.02
"""In one step [rod lengths]: beyond, the rod has snapped past the object."""
_BLEND = 0.005
"""Half-width over which the normal turns at a knot [rod lengths], at most a quarter of the frusta beside it."""


@dataclass(frozen=True)
class CoulombContact:
    """Contact of the rod with an object under Coulomb friction; vectors are in base axes.

    Attributes:
        result: "ok"; "no_contact": nothing is touched, or the contact was lost; "on_end": the object has come to the
            tip's rim or flat end, or slid off the base end of the flank; "unstable": the rod snaps past the object;
            "not_converged": no equilibrium was found. Numbers of the contact come only with "ok".
        state: "stick" or "slip" in the last step; "" without contact.
        equilibrium: of the rod; without contact, the free rod.
        gravity: [m/s²], (3,).
        friction: coefficient μ.
        s: arclength of the touched material point [m].
        angle: its φ about the tangent, from the section's x axis [rad].
        way: λ, where on the edge the rod touches, from `object_point` [m]; 0 for a point.
        object_point: of the object [m], (3,).
        direction: of the edge, unit, (3,); None for a point.
        force_base: of the object on the rod [N], (3,).
        couple_base: of that force about the centreline at s [N·m], (3,).
        normal: outward, unit, (3,).
        slide: of the object over the rod in the last step of the path [m], (3,).
    """

    result: str
    state: str
    equilibrium: Equilibrium
    gravity: Array
    friction: float
    s: float
    angle: float
    way: float
    object_point: Array
    direction: Array | None
    force_base: Array
    couple_base: Array
    normal: Array
    slide: Array

    @property
    def ok(self) -> bool:
        """Whether there is a contact."""
        return self.result == "ok"

    @property
    def p_surface_base(self) -> Array:
        """Touched point, which is the object's own [m], (3,)."""
        if self.direction is None:
            return self.object_point
        return self.object_point + self.way * self.direction

    @property
    def magnitude(self) -> float:
        """|F| [N]."""
        return float(np.linalg.norm(self.force_base))

    @property
    def normal_force(self) -> float:
        """F_n = -F · N [N], positive where the object pushes."""
        return -float(self.force_base @ self.normal)

    @property
    def tangential_force_base(self) -> Array:
        """F_t, part of the force in the tangent plane [N], (3,)."""
        return np.asarray(self.force_base + self.normal_force * self.normal)

    @property
    def tangential_force(self) -> float:
        """|F_t| [N]."""
        return float(np.linalg.norm(self.tangential_force_base))


class SurfaceForce(NamedTuple):
    """Equilibrium under a force that is given in the axes of the surface it acts on.

    Attributes:
        result: "ok", or the code of the equilibrium that was not found.
        equilibrium: of the rod.
        force_base: [N], (3,).
        p_surface_base: point of the surface where it acts [m], (3,).
    """

    result: str
    equilibrium: Equilibrium
    force_base: Array
    p_surface_base: Array


@dataclass(frozen=True)
class CoulombSolver:
    """Follows the contact of a rod with an object under Coulomb friction.

    Attributes:
        rod: the rod; its section must be round.
        friction: coefficient μ ≥ 0; infinite for a contact that never slips.
        mode: "fast" or "reference".
    """

    rod: Rod
    friction: float
    mode: Mode = "fast"

    def __post_init__(self) -> None:
        """Raise InputError for a friction below 0 or a section that is not round."""
        if not self.friction >= 0.0:
            raise InputError(f"friction = {self.friction} must not be negative")
        if not np.allclose(self.rod.factors[1:], self.rod.factors[1], rtol=1e-9):
            raise InputError("only a rod of round section has the surface that is pressed here")

    def press(
        self, gravity: ArrayLike, point: ArrayLike, travel: ArrayLike, direction: ArrayLike | None = None
    ) -> CoulombContact:
        """Contact after an object has come along a straight path from where it touches nothing.

        The first contact carries no force, at the geometric touching point of the free rod.

        Args:
            gravity: in base axes [m/s²], (3,).
            point: where the object is now, in base axes [m], (3,).
            travel: way that it has come relative to the base [m], (3,).
            direction: of a straight edge, of any length, (3,); None for a sharp point.

        Returns:
            The contact.

        Raises:
            InputError: an argument is not finite, the direction is zero, or the path starts in the rod.
        """
        first = self.touch(gravity, point, travel, direction)
        return self.advance(first, point) if first.ok else first

    def touch(
        self, gravity: ArrayLike, point: ArrayLike, travel: ArrayLike, direction: ArrayLike | None = None
    ) -> CoulombContact:
        """First contact on a straight path, without force yet.

        Args: see `press`.

        Returns:
            The contact, whose `object_point` is where the object was then.
        """
        g, p, v = _vector("gravity", gravity), _vector("point", point), _vector("travel", travel)
        d = None if direction is None else _unit(direction)
        free = self.rod.solve(g, mode=self.mode)
        blank = self._without(free.result if not free.ok else "no_contact", free, g, p, d)
        if not free.ok:
            return blank
        obstacle = Obstacle(p, v, d)
        met = FreeRod(self.rod, free).first_touch(obstacle)
        if met is None:
            return blank
        part, near = met
        if part == 0.0:
            raise InputError(
                "the path must start clear of the rod: travel further, or in the other direction"
            )
        if near.on_end or near.s >= self.rod.length * (1.0 - 1e-9):
            return replace(blank, result="on_end")
        return self._begun(blank, obstacle, part, near)

    def advance(
        self,
        last: CoulombContact,
        point: ArrayLike,
        direction: ArrayLike | None = None,
        gravity: ArrayLike | None = None,
    ) -> CoulombContact:
        """Contact after the object has moved on along a straight path in base axes.

        Args:
            last: where it begins.
            point: where the object is then [m], (3,).
            direction: of its edge then; unchanged if None.
            gravity: then [m/s²], (3,); unchanged if None.

        Returns:
            The contact; the last one itself if that was not "ok".
        """
        if not last.ok:
            return last
        end = _vector("point", point)
        d0, g0 = last.direction, last.gravity
        d1 = d0 if direction is None or d0 is None else _unit(direction)
        g1 = g0 if gravity is None else _vector("gravity", gravity)
        length = self.rod.length
        way = float(np.linalg.norm(end - last.object_point)) / length
        if d0 is not None and d1 is not None:
            way += float(np.linalg.norm(d1 - d0))
        way += float(np.linalg.norm(g1 - g0)) / (1.0 + float(np.linalg.norm(g0)))
        if way == 0.0:
            return last
        whole = 1.0 / math.ceil(way / _STEP)
        at, step, here = 0.0, whole, last
        while at < 1.0:
            goal = 1.0 if at + 1.01 * step >= 1.0 else at + step  # no sliver is left for the last
            d = None if d0 is None or d1 is None else _unit((1.0 - goal) * d0 + goal * d1)
            found = self._increment(
                here, last.object_point + goal * (end - last.object_point), d, g0 + goal * (g1 - g0)
            )
            if isinstance(found, CoulombContact):
                at, here, step = goal, found, min(2.0 * step, whole)
                continue
            cut = _LOST_STEP if found == "no_contact" else _MIN_STEP
            if (goal - at) * way <= cut:
                free = self.rod.solve(g1, mode=self.mode)
                result = "unstable" if found == "far" else found
                return self._without(result, free, g1, end, d1)
            step = 0.25 * (goal - at)
        return here

    def _without(
        self, result: str, eq: Equilibrium, gravity: Array, point: Array, direction: Array | None
    ) -> CoulombContact:
        """No contact."""
        none = np.full(3, np.nan)
        return CoulombContact(result, "", eq, gravity, self.friction, math.nan, math.nan, 0.0, point, direction,
                              none, none, none, none)  # fmt: skip

    def _begun(self, blank: CoulombContact, obstacle: Obstacle, part: float, near: Nearest) -> CoulombContact:
        """Touching point of the free rod to the last digit: x = X along the path, and N · d = 0 of an edge."""
        free, length, d = blank.equilibrium, self.rod.length, obstacle.direction
        line = np.zeros(3) if d is None else d

        def frame(s: float) -> tuple[Array, Array]:
            s = min(max(s, 0.0), length)
            return free.p_at(s), free.R_at(s)

        def residual(v: Array) -> Array:
            p, R = frame(v[0] * length)
            e = math.cos(v[1]) * R[:, 0] + math.sin(v[1]) * R[:, 1]
            radius, tan = (float(f) for f in self._profile.at(np.array(v[0])))
            apart = (p - obstacle.at(v[3])) / length + radius * e - v[2] * line
            flat = v[2] if d is None else float((e + tan * R[:, 2]) @ line)
            return np.append(apart, flat)

        p, R = frame(near.s)
        out = R.T @ (obstacle.at(part) + near.way * line - p)
        v = np.array([near.s / length, math.atan2(out[1], out[0]), near.way / length, part])
        best, size = v, math.inf
        for _ in range(_MAX_ITERATIONS):
            off = residual(v)
            if (new := float(np.abs(off).max())) >= 0.5 * size and size < 1e-10:
                break
            if new < size:
                best, size = v, new
            jacobian = np.empty((4, 4))
            for j in range(4):
                h = np.zeros(4)
                h[j] = 1e-6
                jacobian[:, j] = (residual(v + h) - residual(v - h)) / 2e-6
            v = v - np.linalg.lstsq(jacobian, off, rcond=1e-12)[0]
        if not size < 1e-8:
            return replace(blank, result="not_converged")
        s, angle, way, part = (float(value) for value in best)
        R = free.R_at(min(s, 1.0) * length)
        tan = float(self._profile.at(np.array(s))[1])
        normal = math.cos(angle) * R[:, 0] + math.sin(angle) * R[:, 1] + tan * R[:, 2]
        still = np.zeros(3)
        return replace(
            blank, result="ok", state="stick", s=s * length, angle=angle, way=way * length,
            object_point=obstacle.at(part), force_base=still, couple_base=still,
            normal=normal / float(np.linalg.norm(normal)), slide=still,
        )  # fmt: skip

    def _increment(
        self, last: CoulombContact, point: Array, direction: Array | None, gravity: Array
    ) -> CoulombContact | str:
        """One step of Coulomb's law: the contact, or why there is none."""
        x = self._unknowns(last)
        goal = replace(last, object_point=point, direction=direction, gravity=gravity)
        moved = float(np.linalg.norm(point - last.object_point)) / self.rod.length
        stuck = None if self.friction == 0.0 else self._newton(last, goal, x, None)
        if isinstance(stuck, CoulombContact):
            size, pushes = stuck.tangential_force, stuck.normal_force
            if pushes > 0.0 and size <= self.friction * pushes * (1.0 + 10.0 * _CLOSE[self.mode]):
                return self._checked(last, stuck)
            if pushes > 0.0:  # radial return onto the cone
                back = self.friction * pushes / size
                force = back * stuck.tangential_force_base - pushes * stuck.normal
                x = self._unknowns(replace(stuck, force_base=force, couple_base=back * stuck.couple_base))
        if self.friction == math.inf:
            return "no_contact" if isinstance(stuck, CoulombContact) else str(stuck)
        stiffness = max(float(np.linalg.norm(x[0:3])), _MIN_FORCE) / max(moved, _MIN_STEP)
        guess = stuck if isinstance(stuck, CoulombContact) else last
        slipped = self._newton(goal=goal, last=last, x=x, stiffness=stiffness, guess=guess)
        if isinstance(slipped, str):
            return slipped
        if not slipped.normal_force > 0.0:
            return "no_contact"
        along = float(slipped.slide @ slipped.tangential_force_base)
        least = -10.0 * _CLOSE[self.mode] * self.rod.length * slipped.tangential_force  # rounding of no slide
        if self.friction > 0.0 and not along >= least:
            return "not_converged"
        return self._checked(last, slipped)

    def _checked(self, last: CoulombContact, found: CoulombContact) -> CoulombContact | str:
        """The contact, if it is the last one's continuation."""
        turn = float(np.linalg.norm(found.normal - last.normal))
        turn = max(turn, float(np.linalg.norm(found.equilibrium.tip_tangent - last.equilibrium.tip_tangent)))
        far = turn > _MAX_TURN or float(np.linalg.norm(found.slide)) > _MAX_SLIDE * self.rod.length
        return "far" if far else found

    def _newton(
        self,
        last: CoulombContact,
        goal: CoulombContact,
        x: Array,
        stiffness: float | None,
        guess: CoulombContact | None = None,
    ) -> CoulombContact | str:
        """Contact in one state: stick without a `stiffness` k of the slip law, slip with it."""
        length, unit = self._units
        tip = (guess or last).equilibrium.tip
        before = self._unknowns(last)[6:9]
        close = _CLOSE[self.mode]
        for _ in range(_MAX_ITERATIONS):
            if not 0.0 < x[6] <= 1.0:
                return "on_end"
            eq = self.rod.solve(
                goal.gravity, unit * x[0:3], x[6] * length, couple=unit * length * x[3:6], mode=self.mode,
                guess=tip, guess_only=True, columns="contact",
            )  # fmt: skip
            if not eq.ok or eq.sensitivity is None:
                return eq.result
            scales = np.repeat([1.0, 1.0, 1.0 / length, 1.0], 3)
            loads = np.array([unit] * 3 + [length] + [unit * length] * 3)
            d = scales[:, None] * eq.sensitivity.d_contact * loads
            inputs = np.concatenate([x, scales * eq.sensitivity.frame])
            steps = inputs[:, None] + 1j * _IMAGINARY * np.eye(len(inputs))
            found = self._equations(steps, before, goal, stiffness)
            off, by = found[:, 0].real, found.imag / _IMAGINARY
            of_force = close * max(float(np.linalg.norm(x[0:3])), _MIN_FORCE)
            allowed = np.array([of_force] * 3 + [close] * 4 + [close if stiffness is None else of_force] * 2)
            if (np.abs(off) <= allowed).all():
                return self._contact(goal, x, before, eq, "stick" if stiffness is None else "slip")
            answer = np.zeros((12, _U))
            answer[:, 0:3], answer[:, 3:6], answer[:, 6] = d[:, 0:3], d[:, 4:7], d[:, 3]
            try:
                change = np.linalg.solve(by[:, :_U] + by[:, _U:] @ answer, off)
            except np.linalg.LinAlgError:
                return "not_converged"
            if not np.isfinite(change).all():
                return "not_converged"
            # The surface curves: place and angle are not led further than the linearisation holds.
            shrink = min(1.0, 0.05 / max(abs(change[6]), 1e-300), 0.5 / max(abs(change[7]), 1e-300))
            x, tip = x - shrink * change, eq.tip
        return "not_converged"

    def _equations(self, z: Numbers, before: Array, goal: CoulombContact, stiffness: float | None) -> Numbers:
        """Residuals of couple, place, edge and Coulomb's law, (9, m), without dimension.

        Args:
            z: [9 unknowns, 12 of the section's tangent, x axis, position and y axis], (21, m).
            before: s, φ and λ before the step, (3,).
            goal: where the object is.
            stiffness: k of the slip law; None for stick.
        """
        F, C, s, angle, way = z[0:3], z[3:6], z[6], z[7], z[8]
        t, x, p, y = z[9:12], z[12:15], z[15:18], z[18:21]
        radius, tan = self._profile.at(s)
        cos = 1.0 / np.sqrt(1.0 + tan * tan)
        e, h = np.cos(angle) * x + np.sin(angle) * y, np.cos(angle) * y - np.sin(angle) * x
        a, normal = cos * (t - tan * e), cos * (e + tan * t)
        arm = radius * e
        couple = C - _cross(arm, F)
        apart = p + arm - (goal.object_point / self.rod.length)[:, None]
        slide_a, slide_h = (s - before[0]) / cos, radius * (angle - before[1])
        edge = way
        if goal.direction is not None:
            line = goal.direction[:, None]
            apart = apart - way * line
            edge = _dot(normal, line)
            slide_a = slide_a - (way - before[2]) * _dot(a, line)
            slide_h = slide_h - (way - before[2]) * _dot(h, line)
        if stiffness is None:
            law = (slide_a, slide_h)
        else:
            F_a, F_h = _dot(F, a), _dot(F, h)
            law = (F_a, F_h)
            if self.friction > 0.0:
                tau_a, tau_h = F_a + stiffness * slide_a, F_h + stiffness * slide_h
                limit = -self.friction * _dot(F, normal) / np.sqrt(tau_a * tau_a + tau_h * tau_h + 1e-300)
                law = (F_a - limit * tau_a, F_h - limit * tau_h)
        return np.stack([*couple, *apart, edge, *law])

    def _contact(
        self, goal: CoulombContact, x: Array, before: Array, eq: Equilibrium, state: str
    ) -> CoulombContact:
        """What was found, with its units."""
        length, unit = self._units
        assert eq.sensitivity is not None
        f = eq.sensitivity.frame
        radius, tan = (float(value) for value in self._profile.at(np.array(x[6])))
        cos = 1.0 / math.hypot(1.0, tan)
        t, ex, ey = f[0:3], f[3:6], f[9:12]
        e, h = math.cos(x[7]) * ex + math.sin(x[7]) * ey, math.cos(x[7]) * ey - math.sin(x[7]) * ex
        slide = (x[6] - before[0]) * (t - tan * e) + radius * (x[7] - before[1]) * h
        normal = cos * (e + tan * t)
        if goal.direction is not None:
            slide = slide - (x[8] - before[2]) * (goal.direction - (goal.direction @ normal) * normal)
        if state == "stick":
            slide = np.zeros(3)
        return replace(
            goal, state=state, equilibrium=eq, s=float(x[6]) * length, angle=float(x[7]), way=float(x[8]) * length,
            force_base=unit * x[0:3], couple_base=unit * length * x[3:6], normal=normal, slide=length * slide,
        )  # fmt: skip

    def _unknowns(self, at: CoulombContact) -> Array:
        """Of a contact, without dimension, (9,)."""
        length, unit = self._units
        place = (at.s / length, at.angle, at.way / length)
        return np.concatenate([at.force_base / unit, at.couple_base / (unit * length), place])

    @cached_property
    def _units(self) -> tuple[float, float]:
        """The length [m], and E I(0) / L² [N]."""
        stiffness = self.rod.youngs_modulus * math.pi / 4.0 * float(self.rod.radius[0]) ** 4
        return self.rod.length, stiffness / self.rod.length**2

    @cached_property
    def _profile(self) -> "_Profile":
        return _Profile.of(self.rod)


class _Profile(NamedTuple):
    """Radius and taper of the surface along the rod, in rod lengths.

    Attributes:
        s, radius: at the knots, (K,).
        at_s, tan: tan α at the ends of where it turns, straight between, (j,).
    """

    s: Array
    radius: Array
    at_s: Array
    tan: Array

    @classmethod
    def of(cls, rod: Rod) -> "_Profile":
        """That of a rod."""
        s, r = np.asarray(rod.s) / rod.length, np.asarray(rod.radius) / rod.length
        tan, span = -np.diff(r) / np.diff(s), np.diff(s)
        half = np.minimum(_BLEND, 0.25 * np.minimum(span[:-1], span[1:]))
        ends = np.stack([s[1:-1] - half, s[1:-1] + half], axis=1).ravel()
        return cls(s, r, np.concatenate([[0.0], ends, [1.0]]), np.repeat(tan, 2))

    def at(self, s: Numbers) -> tuple[Numbers, Numbers]:
        """Radius and tan α there, by complex steps too."""
        return _straight(s, self.s, self.radius), _straight(s, self.at_s, self.tan)


def _straight(s: Numbers, knots: Array, values: Array) -> Numbers:
    """Linear interpolation, continued beyond the ends."""
    i = np.clip(np.searchsorted(knots, s.real, side="right") - 1, 0, len(knots) - 2)
    slope = (values[i + 1] - values[i]) / (knots[i + 1] - knots[i])
    found: Numbers = values[i] + slope * (s - knots[i])
    return found


def solve_surface_force(
    rod: Rod,
    gravity: ArrayLike,
    s: float,
    angle: float,
    normal_force: float,
    tangential: tuple[float, float] = (0.0, 0.0),
    mode: Mode = "fast",
) -> SurfaceForce:
    """Equilibrium under a force at a point of the deformed surface, given in the surface's own axes.

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
        The equilibrium; numbers come only with result "ok".
    """
    profile = _Profile.of(rod)
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
        for _ in range(_MAX_ITERATIONS):
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
    """Arclength where the force's line of action passes the centreline, seen across both.

    With the force F at x = p + r e of the section at s, that is s - r (F · t)/(F · e), from where F has no couple about
    h = t × e: r tan α nearer the base than the touched section without friction, up to about μ r to either side with
    friction.

    Args:
        rod: the rod.
        eq: its equilibrium under the force at the touched section.
        p_surface: x, in base axes [m], (3,).

    Returns:
        The arclength [m], held to the rod.
    """
    t, arm, force = eq.R_at(eq.s_contact)[:, 2], np.asarray(p_surface) - eq.p_contact_base, eq.load[0:3]
    radius = float(np.linalg.norm(arm))
    s = eq.s_contact - radius * float(force @ t) / (float(force @ arm) / radius)
    return min(max(s, 0.0), rod.length)


def draw_friction(friction: float, spread: float, rng: np.random.Generator) -> float:
    """Draw the friction coefficient of one touch: lognormal, with the median `friction`.

    Args:
        friction: median μ; 0 stays 0.
        spread: standard deviation of ln μ.
        rng: of the draw; one number is drawn whatever the friction is.

    Returns:
        μ of the touch.
    """
    return float(friction * math.exp(spread * rng.standard_normal()))


def _axes(column: Array) -> Array:
    """[x, y, tangent] as columns from the kernels' [tangent, x, position, y]."""
    return np.stack([column[3:6], column[9:12], column[0:3]], axis=-1)


def _dot(a: Numbers, b: Numbers) -> Numbers:
    product: Numbers = (a * b).sum(axis=0)
    return product


def _cross(a: Numbers, b: Numbers) -> Numbers:
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def _vector(name: str, value: ArrayLike) -> Array:
    try:
        vector = np.array(value, dtype=float)
    except (TypeError, ValueError):
        vector = np.empty(0)
    if vector.shape != (3,) or not np.isfinite(vector).all():
        raise InputError(f"{name} = {value!r} must be three finite numbers")
    return vector


def _unit(direction: ArrayLike) -> Array:
    vector = _vector("direction", direction)
    norm = float(np.linalg.norm(vector))
    if not norm > 0.0:
        raise InputError(f"direction = {direction!r} must not be zero")
    return np.asarray(vector / norm)
