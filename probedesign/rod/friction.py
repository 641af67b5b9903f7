"""Contact with Coulomb friction between the rod and an object: stick and slip.

A force F acts at the point x = p(s) + r(s) c(φ) of the deformed surface, c = g e + k h, with the direction of the
outline's normal e(φ) = R(s) [cos φ, sin φ, 0], h = ∂e/∂φ, its reach g along e and k = dg/dφ (`contact.outline`; g = 1
and k = 0 if round). With ω the rotation of the section per arclength, the surface has the tangents r (g + dk/dφ) h and
t + r' c + r ω × c. Its outward unit normal is N = cos α e + sin α t with

    tan α = (-r' g + r k ω · t)/(1 + r (ω × c) · t),

where shear and stretch are neglected beside t, and ω is the mean of both sides of the contact (`contact_curvature`). On
the centreline at s the force F acts together with the couple C = (x - p) × F. The couple depends on the deformed
section and the section on the couple, so both are solved for together by Newton's method with the rod's exact
sensitivities.

The object is a sharp point, or a straight edge that touches the rod where both are tangent, N · d = 0. It moves along
a path X in base axes and yields by the force on it, x = X - c F with its compliance c. In a step of the path it slides
over the rod by the backward-Euler increment

    g = Δs / cos α a + (r (g + dk/dφ) Δφ + r' k Δs) h - Δλ d,    a = cos α t - sin α e,

with λ the way along the edge, so that a rod that rolls on an edge does not slide. With F_n = -F · N and F_t the part
of F in the tangent plane, Coulomb's law is

    stick:  g = 0,                           |F_t| ≤ μ F_n,
    slip:   F_t = μ F_n (F_t + k g)/|F_t + k g|,    F_t · g > 0,

friction on the rod pointing where the object slides. Any k > 0 has the same solutions; it scales Newton's steps. Stick
is tried and kept inside the cone (return mapping); otherwise slip is solved (P. Wriggers, Computational Contact
Mechanics, 2nd ed., 2006, ch. 5.2 and 9; P. Alart, A. Curnier, Comput. Methods Appl. Mech. Eng. 92, 1991).

The contact is on the flank, whose normal turns smoothly over a short length at the knots of a profile. At the rim and
the flat end of a blunt tip there is no model: the result is "on_end".
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from probedesign.core.errors import InputError
from probedesign.core.frames import Array
from probedesign.rod.contact import Numbers, SurfaceProfile, outline
from probedesign.rod.equilibrium import Equilibrium
from probedesign.rod.kernels.sweep import contact_curvature
from probedesign.rod.rod import Mode, Rod, finite_vector

# the first contact on a straight path with a rod that only gravity bends

_STATIONS = 160
_MIN_ADVANCE = 1e-4  # rod lengths: penetrations shallower than a ten-thousandth of that may be missed
_NEAR = 1e-6  # rod lengths: accuracy; Newton's method continues from there
_FAR = 0.02  # rod lengths: beyond, the distance from spheres about the axis is accurate enough
_MAX_STEPS = 100_000


class Obstacle(NamedTuple):
    """A point, or a straight line, that moves along a straight path."""

    point: Array  #: at the end of the path [m], (3,).
    travel: Array  #: from the start to the end of the path [m], (3,).
    direction: Array | None  #: unit vector of the line, (3,); None for a point.

    def at(self, fraction: float) -> Array:
        """Return its position at a fraction, 0 to 1, of the path [m], (3,)."""
        return self.point - (1.0 - fraction) * self.travel


class NearestPoint(NamedTuple):
    """Point of the rod's surface nearest to an object."""

    distance: float  #: from the surface, negative inside [m].
    s: float  #: arclength of that point [m].
    on_end: bool  #: whether it is on the flat end.
    way: float  #: coordinate along the line [m].


@dataclass(frozen=True)
class FirstContactQuery:
    """Distance between an object and a rod that only gravity bends."""

    rod: Rod  #: the rod.
    equilibrium: Equilibrium  #: of the rod under gravity alone.

    def first_contact(self, obstacle: Obstacle) -> tuple[float, NearestPoint] | None:
        """Return the fraction of the path just behind the first contact, and where it is; None without contact.

        The object advances in each step by a lower bound of its distance from the rod, so that it is at most
        `_MIN_ADVANCE` inside.
        """
        path, length = float(np.linalg.norm(obstacle.travel)), self.rod.length
        fraction = 0.0
        for _ in range(_MAX_STEPS):
            # From the spheres, less the gap between their centres: a lower bound.
            point = obstacle.at(fraction)
            distance = float(self._from_spheres(point, obstacle.direction).min()) - 0.6 * length / _STATIONS
            if distance < _FAR * length:
                near = self._nearest(point, obstacle.direction)
                if near.distance < 0.0:
                    return fraction, near
                distance = max(distance, 0.8 * near.distance, _MIN_ADVANCE * length)
            if fraction >= 1.0:
                return None
            fraction = min(1.0, fraction + distance / max(path, 1e-300))
        return None

    def _nearest(self, point: Array, direction: Array | None) -> NearestPoint:
        """Return the nearest point to a point, or to a line, by refining about the best of the line's points."""
        if direction is None:
            return self._of_points(point[None, :], np.zeros(1))
        j = int(np.argmin(self._from_spheres(point, direction)))
        middle = float((self._p[j] - point) @ direction)
        reach = 2.0 * self.rod.length / _STATIONS + 2.0 * float(self._radius[j])
        while True:
            tries = np.linspace(middle - reach, middle + reach, 17)
            best = self._of_points(point + tries[:, None] * direction, tries)
            if reach < _NEAR * self.rod.length:
                return best
            middle, reach = best.way, reach / 8.0

    def _from_spheres(self, point: Array, direction: Array | None) -> Array:
        """Return the distances from spheres about the axis that fill the rod [m], (k,)."""
        apart = point - self._p
        if direction is not None:
            apart = apart - np.outer(apart @ direction, direction)
        distance: Array = np.linalg.norm(apart, axis=1) - self._radius
        return distance

    def _of_points(self, points: Array, ways: Array) -> NearestPoint:
        """Return the nearest of several points (m, 3); the body about the nearest section counts as straight.

        An elliptic section is scaled to a round one, and distances by the smaller of its half-widths over the radius: a
        lower bound.
        """
        s, from_axis = self._feet(points)
        if self.rod.flatness != 1.0:
            at = np.clip(s, 0.0, self.rod.length)
            xy = np.einsum("ni,nij->nj", points - self.equilibrium.p_at(at), self.equilibrium.R_at(at))[:, :2]
            from_axis = np.hypot(xy[:, 0], xy[:, 1] / self.rod.flatness)
        # The signed distance from the outline, base over flank to the centre of the tip, in the half plane (s, r).
        corners = np.append(np.stack([self.rod.s, self.rod.radius], axis=1), [[self.rod.length, 0.0]], axis=0)
        a, along = corners[:-1], np.diff(corners, axis=0)
        here = np.stack([s, from_axis], axis=1)[:, None]
        c = np.clip(((here - a) * along).sum(axis=2) / (along**2).sum(axis=1), 0.0, 1.0)
        nearest = a + c[:, :, None] * along
        gaps = np.linalg.norm(here - nearest, axis=2)
        k, rows = np.argmin(gaps, axis=1), np.arange(len(s))
        inside = (from_axis < self.rod.radius_at(s)) & (s < self.rod.length) & (s > 0.0)
        distance = np.where(inside, -1.0, 1.0) * gaps[rows, k] * min(1.0, self.rod.flatness)
        j = int(np.argmin(distance))
        return NearestPoint(
            float(distance[j]), float(nearest[j, k[j], 0]), bool(k[j] == len(self.rod.s) - 1), float(ways[j])
        )

    def _feet(self, points: Array) -> tuple[Array, Array]:
        """Return the arclength of each point's foot on the axis, extended at both ends, and its distance."""
        a, along = self._p[:-1], np.diff(self._p, axis=0)
        size = (along**2).sum(axis=1)
        ahead = points @ along.T - (a * along).sum(axis=1)
        c = ahead / size
        c[:, 1:] = np.maximum(c[:, 1:], 0.0)
        c[:, :-1] = np.minimum(c[:, :-1], 1.0)
        away = (points**2).sum(axis=1)[:, None] - 2.0 * points @ a.T + (a**2).sum(axis=1)
        squared = away + c * (c * size - 2.0 * ahead)  # rounds by 1e-16 of the length's square
        past = np.maximum(np.abs(c - 0.5) - 0.5, 0.0)  # so that the extensions do not attract distant points
        k = np.argmin(squared + past**2 * size, axis=1)
        rows = np.arange(len(points))
        s = self._s[k] + c[rows, k] * (self._s[k + 1] - self._s[k])
        return s, np.sqrt(np.maximum(squared[rows, k], 0.0))

    @cached_property
    def _s(self) -> Array:
        even = np.linspace(0.0, self.rod.length, _STATIONS + 1)
        return np.unique(np.concatenate([even, self.rod.s]))

    @cached_property
    def _p(self) -> Array:
        return self.equilibrium.p_at(self._s)

    @cached_property
    def _radius(self) -> Array:
        return self.rod.radius_at(self._s) * max(1.0, self.rod.flatness)


# stick and slip

#: Friction coefficient of the simulators: assumed, the lower end of about 0.5 to 1 for soft polyurethane on card,
#: plastic or metal, which is to be measured for each resin.
ASSUMED_FRICTION = 0.5
ASSUMED_SPREAD = 0.2  #: Standard deviation of ln μ from touch to touch in the simulators: assumed.
#: Largest friction coefficient that the simulators take: rubber on dry glass reaches 1 to 2 (assumed bound).
MAX_FRICTION = 3.0

_MAX_DISTANCE = 1e6  #: Of an object, in rod lengths: beyond, rounding of the path exceeds the tolerance.
_U = 9  #: Unknowns: force (3), couple (3), s, φ, λ.
#: Residual allowed, in rod lengths and relative to the force: the accuracy of the rod's own solve.
_CLOSE = {"fast": 1e-8, "reference": 1e-11}
_MIN_FORCE = 1e-6  #: In E I / L²; below it, the residual of forces is absolute.
_MAX_ITERATIONS = 15
_IMAGINARY = 1e-30  #: Complex step of the derivatives: so small that no digit is lost.
_STEP = 0.005  #: Longest step of the object [rod lengths]: bounds how far the sliding direction turns in one increment.
_MIN_STEP = 1e-6  #: Smallest step [rod lengths]; if it fails, the path ends.
_LOST_STEP = 5e-4  #: Step [rod lengths] up to which a lost contact is accepted; longer steps are repeated shorter.
_MAX_TURN = 0.2  #: Rotation of the tip and of the normal in one step [rad]: stays on the branch.
_MAX_SLIDE = 0.02  #: Slide in one step [rod lengths]: beyond, the rod has snapped past the object.


def coulomb_residuals(
    z: Numbers,
    before: Array,
    point: Numbers,
    direction: Array | None,
    profile: SurfaceProfile,
    curvature: Array,
    friction: float,
    stiffness: float | None,
) -> Numbers:
    """Return the residuals of couple, position, edge and Coulomb's law, (9, m), without dimension.

    Args:
        z: [9 unknowns, 12 of the section's tangent, x axis, position and y axis], lengths over the rod's, (21, m);
            the unknowns are force (3), couple (3), s, φ and λ.
        before: s, φ and λ before the step, (3,).
        point: of the object, over the rod's length, (3, m).
        direction: of its edge, unit, (3,); None for a point.
        profile: of the rod.
        curvature: ω in section axes, times the rod's length, (3,).
        friction: coefficient μ.
        stiffness: k of the slip law; None for stick.
    """
    F, C, s, angle, way = z[0:3], z[3:6], z[6], z[7], z[8]
    t, x, p, y = z[9:12], z[12:15], z[15:18], z[18:21]
    at = SurfacePoint.of(profile, s, angle, curvature)
    cos = 1.0 / np.sqrt(1.0 + at.tan * at.tan)
    e, h = np.cos(angle) * x + np.sin(angle) * y, np.cos(angle) * y - np.sin(angle) * x
    a, normal = cos * (t - at.tan * e), cos * (e + at.tan * t)
    arm = at.reach * e + at.aside * h
    couple = C - cross(arm, F)
    apart = p + arm - point
    slide_a = (s - before[0]) / cos
    slide_h = at.curved * (angle - before[1]) - at.narrowing * (s - before[0])
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


class SurfacePoint(NamedTuple):
    """Point of the bent surface, lengths over the rod's."""

    reach: Numbers  #: r g, along the outline's normal.
    aside: Numbers  #: r k, along the outline.
    curved: Numbers  #: r (g + dk/dφ), its radius of curvature.
    narrowing: Numbers  #: -r' k, how far the point at one φ moves along the outline per arclength.
    tan: Numbers  #: tan α.

    @classmethod
    def of(cls, profile: SurfaceProfile, s: Numbers, angle: Numbers, curvature: Array) -> "SurfacePoint":
        """Return the point at an arclength and a direction of the normal; arguments as in `coulomb_residuals`."""
        (radius, slope), f, x, y = profile.at(s), profile.flatness, np.cos(angle), np.sin(angle)
        g, k = outline(f, x, y)
        turned = curvature[0] * (g * y + k * x) - curvature[1] * (g * x - k * y)
        tan = (slope * g + radius * k * curvature[2]) / (1.0 + radius * turned)
        return cls(radius * g, radius * k, radius * f * f / (g * g * g), slope * k, tan)


def dot(a: Numbers, b: Numbers) -> Numbers:
    """Return the dot products of columns, (m,); complex steps pass through, unlike in `np.vdot`."""
    product: Numbers = (a * b).sum(axis=0)
    return product


def cross(a: Numbers, b: Numbers) -> Numbers:
    """Return the cross products of columns, (3, m)."""
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


@dataclass(frozen=True)
class CoulombContact:
    """Contact of the rod with an object under Coulomb friction; vectors are in base axes."""

    #: "ok"; "no_contact": nothing is touched, or the contact was lost; "on_end": the object has come to the tip's rim
    #: or flat end, or slid off the base end of the flank; "unstable": the rod snaps past the object; "not_converged":
    #: no equilibrium was found. Numbers of the contact come only with "ok".
    result: str
    state: str  #: "stick" or "slip" in the last step; "" without contact.
    equilibrium: Equilibrium  #: of the rod; without contact, the free rod.
    gravity: Array  #: [m/s²], (3,).
    friction: float  #: coefficient μ.
    compliance: float  #: c of the object [m/N].
    s: float  #: arclength of the touched material point [m].
    angle: float  #: φ of the outline's normal there about the tangent, from the section's x axis [rad].
    way: float  #: λ, where on the edge the rod touches, from `object_point` [m]; 0 for a point.
    object_point: Array  #: of the object at rest [m], (3,).
    direction: Array | None  #: of the edge, unit, (3,); None for a point.
    force_base: Array  #: of the object on the rod [N], (3,).
    couple_base: Array  #: of that force about the centreline at s [N·m], (3,).
    normal: Array  #: outward, unit, (3,).
    slide: Array  #: of the object over the rod in the last step of the path [m], (3,).

    @property
    def ok(self) -> bool:
        """Return whether there is a contact."""
        return self.result == "ok"

    @property
    def p_rest_base(self) -> Array:
        """Return the touched point of the object at rest [m], (3,)."""
        if self.direction is None:
            return self.object_point
        return self.object_point + self.way * self.direction

    @property
    def p_surface_base(self) -> Array:
        """Return where the touched point is under the force [m], (3,)."""
        return self.p_rest_base - self.compliance * self.force_base if self.compliance else self.p_rest_base

    @property
    def magnitude(self) -> float:
        """Return |F| [N]."""
        return float(np.linalg.norm(self.force_base))

    @property
    def normal_force(self) -> float:
        """Return F_n = -F · N [N], positive where the object pushes."""
        return -float(self.force_base @ self.normal)

    @property
    def tangential_force_base(self) -> Array:
        """Return F_t, the part of the force in the tangent plane [N], (3,)."""
        return np.asarray(self.force_base + self.normal_force * self.normal)

    @property
    def tangential_force(self) -> float:
        """Return |F_t| [N]."""
        return float(np.linalg.norm(self.tangential_force_base))


@dataclass(frozen=True)
class CoulombSolver:
    """Follows the contact of a rod with an object under Coulomb friction."""

    rod: Rod  #: the rod.
    friction: float  #: coefficient μ ≥ 0; infinite for a contact that never slips.
    mode: Mode = "fast"  #: "fast" or "reference".
    compliance: float = 0.0  #: c of the object [m/N]; 0 is a rigid object.

    def __post_init__(self) -> None:
        if not self.friction >= 0.0:
            raise InputError(f"friction = {self.friction} must not be negative")
        if not 0.0 <= self.compliance < math.inf:
            raise InputError(f"compliance = {self.compliance} must be finite and not negative")

    def press(
        self, gravity: ArrayLike, point: ArrayLike, travel: ArrayLike, direction: ArrayLike | None = None
    ) -> CoulombContact:
        """Return the contact after an object has moved along a straight path that starts clear of the rod.

        The first contact carries no force, at the geometric touching point of the free rod.

        Args:
            gravity: in base axes [m/s²], (3,).
            point: where the object is now, in base axes [m], (3,).
            travel: displacement of the object relative to the base up to now [m], (3,).
            direction: of a straight edge, of any length, (3,); None for a sharp point.

        Returns:
            The contact.

        Raises:
            InputError: an argument is not finite or far out, the direction is zero, or the path starts in the rod.
        """
        first = self.touch(gravity, point, travel, direction)
        return self.advance(first, point) if first.ok else first

    def touch(
        self, gravity: ArrayLike, point: ArrayLike, travel: ArrayLike, direction: ArrayLike | None = None
    ) -> CoulombContact:
        """Return the first contact on a straight path, which carries no force.

        Args: see `press`.

        Returns:
            The contact; its `object_point` is the position of the object at that time.
        """
        g, p = finite_vector("gravity", gravity), finite_vector("point", point)
        v = finite_vector("travel", travel)
        for name, vector in (("point", p), ("travel", v)):
            if not np.abs(vector).max() <= _MAX_DISTANCE * self.rod.length:
                raise InputError(f"{name} = {vector.tolist()} is more than a million lengths away")
        d = None if direction is None else _unit(direction)
        free = self.rod.solve(g, mode=self.mode)
        blank = self._without(free.result if not free.ok else "no_contact", free, g, p, d)
        if not free.ok:
            return blank
        obstacle = Obstacle(p, v, d)
        met = FirstContactQuery(self.rod, free).first_contact(obstacle)
        if met is None:
            return blank
        part, near = met
        if part == 0.0:
            raise InputError("the path must start clear of the rod; use a longer travel or the opposite direction")
        if near.on_end or near.s >= self.rod.length * (1.0 - 1e-9):
            return replace(blank, result="on_end")
        return self._begun(blank, obstacle, part, near)

    def advance(self, last: CoulombContact, point: ArrayLike) -> CoulombContact:
        """Return the contact after a further straight motion of the object in base axes.

        Args:
            last: contact at the start.
            point: of the object at the end [m], (3,).

        Returns:
            The contact; the last one itself if that was not "ok".
        """
        if not last.ok:
            return last
        end, start = finite_vector("point", point), last.object_point
        way = float(np.linalg.norm(end - start)) / self.rod.length
        if way == 0.0:
            return last
        whole = 1.0 / math.ceil(way / _STEP)
        at, step, here = 0.0, whole, last
        while at < 1.0:
            goal = 1.0 if at + 1.01 * step >= 1.0 else at + step  # so that no very short step remains
            contact = self._increment(here, start + goal * (end - start))
            if isinstance(contact, CoulombContact):
                at, here, step = goal, contact, min(2.0 * step, whole)
                continue
            cut = _LOST_STEP if contact == "no_contact" else _MIN_STEP
            if (goal - at) * way <= cut:
                free = self.rod.solve(last.gravity, mode=self.mode)
                result = "unstable" if contact == "far" else contact
                return self._without(result, free, last.gravity, end, last.direction)
            step = 0.25 * (goal - at)
        return here

    def _without(
        self, result: str, eq: Equilibrium, gravity: Array, point: Array, direction: Array | None
    ) -> CoulombContact:
        none = np.full(3, np.nan)
        return CoulombContact(result, "", eq, gravity, self.friction, self.compliance, math.nan, math.nan, 0.0, point,
                              direction, none, none, none, none)  # fmt: skip

    def _begun(self, blank: CoulombContact, obstacle: Obstacle, part: float, near: NearestPoint) -> CoulombContact:
        """Refine the touched point of the free rod to x = X along the path and, for an edge, N · d = 0."""
        free, length, d = blank.equilibrium, self.rod.length, obstacle.direction
        line = np.zeros(3) if d is None else d

        def residual(v: Array) -> Array:
            arm, normal = surface_at(v[0], v[1])
            p = free.p_at(min(max(v[0], 0.0), 1.0) * length)
            apart = (p - obstacle.at(v[3])) / length + arm - v[2] * line
            return np.append(apart, v[2] if d is None else float(normal @ line))

        def surface_at(x: float, angle: float) -> tuple[Array, Array]:
            s = min(max(x, 0.0), 1.0) * length
            R = free.R_at(s)
            curvature = self._curvature(free, s, free.states_at(s)[0], R)
            at = SurfacePoint.of(self._profile, np.array(x), np.array(angle), curvature)
            c, d = math.cos(angle), math.sin(angle)
            e, h = c * R[:, 0] + d * R[:, 1], c * R[:, 1] - d * R[:, 0]
            normal = e + float(at.tan) * R[:, 2]
            return at.reach * e + at.aside * h, normal / float(np.linalg.norm(normal))

        p, R = free.p_at(near.s), free.R_at(near.s)
        out = R.T @ (obstacle.at(part) + near.way * line - p)
        angle = math.atan2(out[1] / self.rod.flatness**2, out[0])
        v = np.array([near.s / length, angle, near.way / length, part])
        best, size = v, math.inf
        for _ in range(_MAX_ITERATIONS):
            misfit = residual(v)
            if (new := float(np.abs(misfit).max())) >= 0.5 * size and size < 1e-10:
                break
            if new < size:
                best, size = v, new
            jacobian = np.empty((4, 4))
            for j in range(4):
                h = np.zeros(4)
                h[j] = 1e-6
                jacobian[:, j] = (residual(v + h) - residual(v - h)) / 2e-6
            v = v - np.linalg.lstsq(jacobian, misfit, rcond=1e-12)[0]
        if not size < 1e-8:
            return replace(blank, result="not_converged")
        s, angle, way, part = (float(value) for value in best)
        still = np.zeros(3)
        return replace(
            blank, result="ok", state="stick", s=s * length, angle=angle, way=way * length,
            object_point=obstacle.at(part), force_base=still, couple_base=still,
            normal=surface_at(s, angle)[1], slide=still,
        )  # fmt: skip

    def _increment(self, last: CoulombContact, point: Array) -> CoulombContact | str:
        """Solve one step of Coulomb's law; return the contact or the reason why there is none."""
        x = self._unknowns(last)
        goal = replace(last, object_point=point)
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
        # Rounding of no slide.
        min_work = -10.0 * _CLOSE[self.mode] * self.rod.length * slipped.tangential_force
        if self.friction > 0.0 and not along >= min_work:
            return "not_converged"
        return self._checked(last, slipped)

    def _checked(self, last: CoulombContact, contact: CoulombContact) -> CoulombContact | str:
        turn = float(np.linalg.norm(contact.normal - last.normal))
        turn = max(turn, float(np.linalg.norm(contact.equilibrium.tip_tangent - last.equilibrium.tip_tangent)))
        far = turn > _MAX_TURN or float(np.linalg.norm(contact.slide)) > _MAX_SLIDE * self.rod.length
        return "far" if far else contact

    def _newton(
        self,
        last: CoulombContact,
        goal: CoulombContact,
        x: Array,
        stiffness: float | None,
        guess: CoulombContact | None = None,
    ) -> CoulombContact | str:
        """Solve for the contact in one state: stick if `stiffness` (k of the slip law) is None, else slip."""
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
            frame = eq.sensitivity.frame
            axes = np.stack([frame[3:6], frame[9:12], frame[0:3]], axis=1)
            curvature = self._curvature(eq, eq.s_contact, eq.contact, axes)
            inputs = np.concatenate([x, scales * frame])
            steps = inputs[:, None] + 1j * _IMAGINARY * np.eye(len(inputs))
            point = (goal.object_point[:, None] - self.compliance * unit * steps[0:3]) / length
            residuals = coulomb_residuals(steps, before, point, goal.direction, self._profile, curvature,
                                          self.friction, stiffness)  # fmt: skip
            misfit, by = residuals[:, 0].real, residuals.imag / _IMAGINARY
            of_force = close * max(float(np.linalg.norm(x[0:3])), _MIN_FORCE)
            allowed = np.array([of_force] * 3 + [close] * 4 + [close if stiffness is None else of_force] * 2)
            if (np.abs(misfit) <= allowed).all():
                return self._contact(goal, x, before, eq, curvature, "stick" if stiffness is None else "slip")
            frame_by_unknowns = np.zeros((12, _U))
            frame_by_unknowns[:, 0:3], frame_by_unknowns[:, 3:6] = d[:, 0:3], d[:, 4:7]
            frame_by_unknowns[:, 6] = d[:, 3]
            try:
                change = np.linalg.solve(by[:, :_U] + by[:, _U:] @ frame_by_unknowns, misfit)
            except np.linalg.LinAlgError:
                return "not_converged"
            if not np.isfinite(change).all():
                return "not_converged"
            # The surface is curved: place and angle move no further than the linearisation is valid.
            shrink = min(1.0, 0.05 / max(abs(change[6]), 1e-300), 0.5 / max(abs(change[7]), 1e-300))
            x, tip = x - shrink * change, eq.tip
        return "not_converged"

    def _contact(
        self, goal: CoulombContact, x: Array, before: Array, eq: Equilibrium, curvature: Array, state: str
    ) -> CoulombContact:
        length, unit = self._units
        assert eq.sensitivity is not None
        f = eq.sensitivity.frame
        at = SurfacePoint.of(self._profile, x[6], x[7], curvature)
        tan = float(at.tan)
        cos = 1.0 / math.hypot(1.0, tan)
        t, ex, ey = f[0:3], f[3:6], f[9:12]
        e, h = math.cos(x[7]) * ex + math.sin(x[7]) * ey, math.cos(x[7]) * ey - math.sin(x[7]) * ex
        ds = x[6] - before[0]
        slide = ds * (t - tan * e) + (at.curved * (x[7] - before[1]) - at.narrowing * ds) * h
        normal = cos * (e + tan * t)
        if goal.direction is not None:
            slide = slide - (x[8] - before[2]) * (goal.direction - (goal.direction @ normal) * normal)
        if state == "stick":
            slide = np.zeros(3)
        return replace(
            goal, state=state, equilibrium=eq, s=float(x[6]) * length, angle=float(x[7]), way=float(x[8]) * length,
            force_base=unit * x[0:3], couple_base=unit * length * x[3:6], normal=normal, slide=length * slide,
        )  # fmt: skip

    def _curvature(self, eq: Equilibrium, s: float, state: Array, axes: Array) -> Array:
        """Return ω at the contact about the section's x and y axes and tangent, the columns of `axes`, in 1/L, (3,)."""
        omega = np.empty(3)
        contact_curvature(s, state, eq.body, eq.load, omega)
        return np.asarray(self.rod.length * (omega @ axes))

    def _unknowns(self, at: CoulombContact) -> Array:
        length, unit = self._units
        on_surface = (at.s / length, at.angle, at.way / length)
        return np.concatenate([at.force_base / unit, at.couple_base / (unit * length), on_surface])

    @cached_property
    def _units(self) -> tuple[float, float]:
        """Return the length [m] and E I(0) / L² [N]."""
        stiffness = self.rod.youngs_modulus * math.pi / 4.0 * float(self.rod.radius[0]) ** 4
        return self.rod.length, stiffness / self.rod.length**2

    @cached_property
    def _profile(self) -> SurfaceProfile:
        return SurfaceProfile.of(self.rod)


def press_against_point(
    rod: Rod, gravity: ArrayLike, point: ArrayLike, travel: ArrayLike, mode: Mode = "fast"
) -> CoulombContact:
    """Solve for the equilibrium of the rod against a sharp point, without friction.

    The point moves along a straight path, which determines the side from which it presses. A round rod that is pushed
    aside by more than about its radius would slip round a point; the contact in the plane of the push is followed all
    the same, as if something held the rod there.

    Args:
        rod: the rod.
        gravity: in base axes [m/s²], (3,).
        point: where the object is now, in base axes [m], (3,).
        travel: displacement of the object relative to the base up to now; at point - travel it is clear of the rod
            [m], (3,).
        mode: "fast" or "reference".

    Returns:
        The contact; its numbers are finite only with result "ok".

    Raises:
        InputError: an argument is not finite or far out, or the path starts in the rod.
    """
    return CoulombSolver(rod, 0.0, mode).press(gravity, point, travel)


def press_against_line(
    rod: Rod, gravity: ArrayLike, point: ArrayLike, direction: ArrayLike, travel: ArrayLike, mode: Mode = "fast"
) -> CoulombContact:
    """Solve for the equilibrium of the rod against a straight, infinitely long edge, without friction.

    See `press_against_point`; `direction` is that of the edge, of any length, (3,). The rod may slide along the edge,
    and the force is normal to both.

    Raises:
        InputError: as there, or the direction is zero.
    """
    return CoulombSolver(rod, 0.0, mode).press(gravity, point, travel, direction)


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


def _unit(direction: ArrayLike) -> Array:
    vector = finite_vector("direction", direction)
    norm = float(np.linalg.norm(vector))
    if not norm > 0.0:
        raise InputError(f"direction = {direction!r} must not be zero")
    return np.asarray(vector / norm)
