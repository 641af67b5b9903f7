"""The bent surface of a rod: where a moving object first touches it, and its pieces with their equations of contact.

`FirstContactQuery` finds the first contact with a rod that only gravity bends. From there the surface is divided into
pieces, each with the equations of frictionless contact with a sharp object. The object is a point, or a straight line
that touches at one of its points, Q. Unknown are the force F on the rod, its couple C about the centreline where it
acts, the place σ on the piece and the coordinate λ along the line. w is the vector from the centreline to Q; t, x and y
are the axes of the section there.

Without friction F runs along the normal, and on a flank of half-angle α the normal leans towards the tip by
α and meets the axis r tan α nearer the base (see `solve_frictionless`). So the flank is the envelope of the
spheres about p(s_contact) that touch it, of radius ρ = r(s_contact) cos α, bent or not:

    |w| = ρ,   w · t = ρ sin α,   F · (t × w) = 0,   F · (t - sin α w/|w|) = 0

Where two frusta meet, the normal is anywhere between theirs: the same with s_contact = s_k - r_k tan β and
ρ = r_k / cos β, β between both half-angles. The tip is a flat disc of radius R, touched at its rim,
    |w| = R,   w · t = 0,   F · (t × w) = 0,
the normal between the flank's and the disc's, or on its face,
    w · t = 0,   F · x = F · y = 0,
w there being from the tip's centre. Along a line, F · d = 0.

Lengths are in rod lengths and forces in one unit: all numbers are without dimension.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, Literal, NamedTuple

import numpy as np

from probedesign.core.frames import Array
from probedesign.rod.contact import Numbers, cross, dot
from probedesign.rod.equilibrium import Equilibrium
from probedesign.rod.rod import Rod

Where = Literal["flank", "rim", "face"]
UNKNOWNS = 8
_SLACK = 1e-9  # of the rod's length, beyond the end of a piece
_LEAN_SLACK = 1e-6  # [rad]; on a bent rod flank and rim miss each other by less


class SurfaceState(NamedTuple):
    """Variables of the equations, each with one column per variation."""

    force: Numbers
    couple: Numbers
    place: Numbers
    way: Numbers
    t: Numbers
    x: Numbers
    p: Numbers
    y: Numbers
    w: Numbers

    @classmethod
    def of(cls, z: Numbers, direction: Array | None, beyond: bool = False) -> "SurfaceState":
        """Return the state of [8 unknowns, 12 of the frame, 3 of the point], (23, m)."""
        point = z[20:23]
        if direction is not None:
            point = point + z[7] * direction[:, None]
        w = point - z[14:17]
        if beyond:
            w = w - (z[6] - 1.0) * z[8:11]
        return cls(z[0:3], z[3:6], z[6], z[7], z[8:11], z[11:14], z[14:17], z[17:20], w)


class SurfacePiece:
    """One piece of the surface; the defaults are those of the flat end and its rim."""

    where: ClassVar[Where] = "flank"  #: its public name.
    beyond: bool = False  #: whether its normals meet the axis beyond the tip.

    @property
    def at_tip(self) -> bool:
        """Return whether the force acts on the tip's centre, with a couple."""
        return True

    def station(self, place: Numbers) -> Numbers:
        """Return the arclength where the force acts, at most the tip's."""
        return np.ones_like(place)

    def equations(self, state: SurfaceState, direction: Array | None) -> Numbers:
        """Return the residuals, zero where the object touches this piece and F is along the normal, (8, m)."""
        raise NotImplementedError

    def excess(self, state: SurfaceState) -> float:
        """Return 0 on the piece, a negative number before its lower end, a positive one beyond its upper end."""
        raise NotImplementedError

    def pushes(self, state: SurfaceState) -> bool:
        """Return whether the object pushes the rod: the force opposes the outward normal."""
        return bool(dot(state.force, state.w)[0] < 0.0)

    def entry(self, from_before: bool) -> float:
        """Return the place to start from, coming from the piece before it or from the one beyond it."""
        return 0.0

    def surface(self, place: float) -> float:
        """Return the arclength of the touched section."""
        return 1.0


@dataclass(frozen=True)
class Flank(SurfacePiece):
    """A frustum; its place is the arclength where the normal meets the axis."""

    low: float  #: low, high: ends of that arclength.
    high: float
    s0: float  #: s0, r0: a section.
    r0: float
    tan: float  #: tan α = -dr/ds.
    #: where the normals meet the axis beyond the tip of a rod that swells towards it; the force then acts on the tip's
    #: centre.
    beyond: bool = False

    @property
    def at_tip(self) -> bool:
        """Return whether the force acts on the tip's centre."""
        return self.beyond

    def station(self, place: Numbers) -> Numbers:
        """Return the arclength where the force acts."""
        return np.ones_like(place) if self.beyond else place

    def equations(self, state: SurfaceState, direction: Array | None) -> Numbers:
        """Return the residuals of the envelope of spheres."""
        cos = 1.0 / math.hypot(1.0, self.tan)
        radius = (self.r0 - self.tan * (state.place - self.s0)) * cos
        arm = (state.place - 1.0) * state.t if self.beyond else None
        return _sphere(state, radius, self.tan * cos + 0.0 * radius, arm, direction)

    def excess(self, state: SurfaceState) -> float:
        """Return how far the place is off the piece."""
        return _outside(float(state.place[0]), self.low, self.high, _SLACK)

    def entry(self, from_before: bool) -> float:
        """Return the end at which it is entered."""
        return self.low if from_before else self.high

    def surface(self, place: float) -> float:
        """Return where the normal through `place` leaves the body."""
        cos2 = 1.0 / (1.0 + self.tan**2)
        return place + (self.r0 - self.tan * (place - self.s0)) * cos2 * self.tan


@dataclass(frozen=True)
class Edge(SurfacePiece):
    """The circle where two frusta meet; its place is the fraction of the normal's rotation from one to the other.

    At a ridge as in a groove, the normals of both frusta bound the direction of the force.
    """

    s: float  #: s, r: of the circle.
    r: float
    before: float  #: before, after: half-angles of the frusta [rad].
    after: float

    @property
    def at_tip(self) -> bool:
        """Return False: the force acts where the normal meets the axis."""
        return False

    def station(self, place: Numbers) -> Numbers:
        """Return where the normal meets the axis."""
        return self.s - self.r * np.tan(self._lean(place))

    def equations(self, state: SurfaceState, direction: Array | None) -> Numbers:
        """Return the residuals of the envelope of spheres, all of which pass through the circle."""
        lean = self._lean(state.place)
        return _sphere(state, self.r / np.cos(lean), np.sin(lean), None, direction)

    def excess(self, state: SurfaceState) -> float:
        """Return how far the normal is outside the range of both frusta."""
        return _outside(float(state.place[0]), 0.0, 1.0, _LEAN_SLACK)

    def entry(self, from_before: bool) -> float:
        """Return the place of the normal of the frustum that is left."""
        return 0.0 if from_before else 1.0

    def surface(self, place: float) -> float:
        """Return the circle's arclength."""
        return self.s

    def _lean(self, place: Numbers) -> Numbers:
        return self.before + place * (self.after - self.before)


@dataclass(frozen=True)
class Rim(SurfacePiece):
    """The edge of the blunt tip; it has no place."""

    where: ClassVar[Where] = "rim"
    r: float  #: its radius.
    before: float  #: half-angle of the flank that it ends [rad].

    def equations(self, state: SurfaceState, direction: Array | None) -> Numbers:
        """Return the residuals: Q is on the rim and F in the plane through the axis."""
        w, t = state.w, state.t
        circle = (dot(w, w) / self.r - self.r) / 2.0
        across = dot(state.force, cross(t, w)) / self.r
        way = state.way if direction is None else dot(state.force, direction[:, None])
        return np.stack([circle, dot(w, t), across, state.place, *(state.couple - cross(w, state.force)), way])

    def excess(self, state: SurfaceState) -> float:
        """Return how far F is outside the normals of the corner [rad]."""
        out, along = -dot(state.force, state.w)[0] / self.r, -dot(state.force, state.t)[0]
        lean = math.atan2(along, out)
        return _outside(lean, self.before, math.pi / 2.0, _LEAN_SLACK)

    def pushes(self, state: SurfaceState) -> bool:
        """Return whether the force opposes the corner's middle normal."""
        middle = 0.5 * (self.before + math.pi / 2.0)
        normal = math.cos(middle) / self.r * state.w + math.sin(middle) * state.t
        return bool(dot(state.force, normal)[0] < 0.0)


@dataclass(frozen=True)
class Face(SurfacePiece):
    """The flat end; it has no place."""

    where: ClassVar[Where] = "face"
    r: float  #: its radius.

    def equations(self, state: SurfaceState, direction: Array | None) -> Numbers:
        """Return the residuals: Q is in the tip's plane and F along its normal."""
        F, w, t = state.force, state.w, state.t
        along = state.way if direction is None else dot(t, direction[:, None])
        couple = state.couple - cross(w, F)
        return np.stack([dot(w, t), dot(F, state.x), dot(F, state.y), state.place, *couple, along])

    def excess(self, state: SurfaceState) -> float:
        """Return minus the distance of Q outside the disc: the contact moves back to the rim."""
        return -max(0.0, math.sqrt(float(dot(state.w, state.w)[0])) - self.r - _SLACK)

    def pushes(self, state: SurfaceState) -> bool:
        """Return whether the force opposes the tip's tangent."""
        return bool(dot(state.force, state.t)[0] < 0.0)


def surface_pieces(rod: Rod) -> list[SurfacePiece]:
    """Return the pieces of the surface from the base to the centre of the tip, in order."""
    s, r = np.asarray(rod.s) / rod.length, np.asarray(rod.radius) / rod.length
    tan = -np.diff(r) / np.diff(s)
    pieces: list[SurfacePiece] = []
    for i in range(len(tan)):
        lean = float(np.arctan(tan[i]))
        if i > 0 and tan[i] != tan[i - 1]:
            pieces.append(Edge(float(s[i]), float(r[i]), float(np.arctan(tan[i - 1])), lean))
        low, high = float(s[i] - r[i] * tan[i]), float(s[i + 1] - r[i + 1] * tan[i])
        if high > 0.0:  # the clamp covers what is below
            pieces.append(Flank(max(low, 0.0), min(high, 1.0), float(s[i]), float(r[i]), float(tan[i])))
        if high > 1.0:
            pieces.append(Flank(1.0, high, float(s[i]), float(r[i]), float(tan[i]), beyond=True))
    return [*pieces, Rim(float(r[-1]), lean), Face(float(r[-1]))]


def _sphere(
    state: SurfaceState, radius: Numbers, lean: Numbers, arm: Numbers | None, direction: Array | None
) -> Numbers:
    """Return the residuals for Q on a sphere about the axis, the normal inclined by sin⁻¹ `lean`, and F along it."""
    w, t, F = state.w, state.t, state.force
    normal = w / np.sqrt(dot(w, w) + 1e-300)
    on_sphere = (dot(w, w) / radius - radius) / 2.0
    couple = state.couple if arm is None else state.couple - cross(arm, F)
    along = state.way if direction is None else dot(w, direction[:, None])
    across, lengthwise = dot(F, cross(t, normal)), dot(F, t - lean * normal)
    return np.stack([on_sphere, dot(w, t) - radius * lean, across, lengthwise, *couple, along])


def _outside(x: float, low: float, high: float, slack: float) -> float:
    """Return how far x is below low (negative) or above high; 0 within the slack."""
    if x < low - slack:
        return x - low
    return x - high if x > high + slack else 0.0


_STATIONS = 160
_MIN_ADVANCE = 1e-4  # rod lengths: penetrations shallower than a ten-thousandth of that may be missed
_CLOSE = 1e-6  # rod lengths: accuracy; Newton's method continues from there
_FAR = 0.02  # rod lengths: beyond, the distance from spheres about the axis is accurate enough
_FLUSH = 1e-9  # [rad]
_MAX_BISECTIONS = 60
_WITHIN = 1.0 - 1e-9  # of the last interval: the contact begins without penetration
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
    flush: bool = False  #: whether a line is parallel to the flat end.


@dataclass(frozen=True)
class FirstContactQuery:
    """Distance between an object and a rod that only gravity bends."""

    rod: Rod  #: the rod.
    equilibrium: Equilibrium  #: of the rod under gravity alone.

    def first_contact(self, obstacle: Obstacle) -> tuple[float, NearestPoint] | None:
        """Return the fraction of the path at the first contact, and where it is; None without contact.

        The object advances in each step by a lower bound of its distance from the rod.
        """
        way, length = float(np.linalg.norm(obstacle.travel)), self.rod.length
        part, before, gap = 0.0, 0.0, _CLOSE * length
        for _ in range(_MAX_STEPS):
            apart = self._lower_bound(obstacle.at(part), obstacle.direction)
            if apart < _FAR * length:
                near = self.nearest(obstacle.at(part), obstacle.direction)
                if near.distance < 0.0:
                    return self._narrowed(obstacle, (before, gap), (part, near))
                apart = max(apart, 0.8 * near.distance, _MIN_ADVANCE * length)
                gap = near.distance
            if part >= 1.0:
                return None
            before, part = part, min(1.0, part + apart / max(way, 1e-300))
        return None

    def _narrowed(
        self, obstacle: Obstacle, outside: tuple[float, float], inside: tuple[float, NearestPoint]
    ) -> tuple[float, NearestPoint]:
        """Refine the contact between a fraction outside, with its distance [m], and one inside, by false position."""
        for _ in range(_MAX_BISECTIONS):
            (clear, gap), (part, near) = outside, inside
            share = gap / (gap - near.distance)
            if near.distance > -_CLOSE * self.rod.length:
                break
            middle = clear + min(max(share, 0.1), 0.9) * (part - clear)
            found = self.nearest(obstacle.at(middle), obstacle.direction)
            if found.distance > 0.0:
                outside = middle, found.distance
            else:
                inside = middle, found
        return clear + min(share, _WITHIN) * (part - clear), near

    def nearest(self, point: Array, direction: Array | None) -> NearestPoint:
        """Return the nearest point to a point, or to a line, by refining about the best of the line's points."""
        if direction is None:
            return self._of_points(point[None, :], np.zeros(1))
        j = int(np.argmin(self._from_spheres(point, direction)))
        middle = float((self._p[j] - point) @ direction)
        reach = 2.0 * self.rod.length / _STATIONS + 2.0 * float(self._radius[j])
        while True:
            tries = np.linspace(middle - reach, middle + reach, 17)
            best = self._of_points(point + tries[:, None] * direction, tries)
            if reach < _CLOSE * self.rod.length:
                slant = float(direction @ self.equilibrium.tip_tangent)
                return best._replace(flush=abs(slant) < _FLUSH)
            middle, reach = best.way, reach / 8.0

    def _lower_bound(self, point: Array, direction: Array | None) -> float:
        """Return a lower bound of the distance: from the spheres, less the gap between their centres [m]."""
        return float(self._from_spheres(point, direction).min()) - 0.6 * self.rod.length / _STATIONS

    def _from_spheres(self, point: Array, direction: Array | None) -> Array:
        """Return the distances from spheres about the axis that fill the rod [m], (k,)."""
        off = point - self._p
        if direction is not None:
            off = off - np.outer(off @ direction, direction)
        distance: Array = np.linalg.norm(off, axis=1) - self._radius
        return distance

    def _of_points(self, points: Array, ways: Array) -> NearestPoint:
        """Return the nearest of several points (m, 3); the body about the nearest section counts as straight."""
        s, off = self._feet(points)
        distance, element, at = self._to_outline(s, off)
        j = int(np.argmin(distance))
        return NearestPoint(float(distance[j]), float(at[j]), bool(element[j]), float(ways[j]))

    def _feet(self, points: Array) -> tuple[Array, Array]:
        """Return the arclength of each point's foot on the axis, extended at both ends, and its distance."""
        a, along = self._p[:-1], self._along
        size = (along**2).sum(axis=1)
        ahead = points @ along.T - (a * along).sum(axis=1)
        c = ahead / size
        c[:, 1:] = np.maximum(c[:, 1:], 0.0)
        c[:, :-1] = np.minimum(c[:, :-1], 1.0)
        away = (points**2).sum(axis=1)[:, None] - 2.0 * points @ a.T + (a**2).sum(axis=1)
        off = away + c * (c * size - 2.0 * ahead)  # squared; rounds by 1e-16 of the length's square
        past = np.maximum(np.abs(c - 0.5) - 0.5, 0.0)  # so that the extensions do not attract distant points
        k = np.argmin(off + past**2 * size, axis=1)
        rows = np.arange(len(points))
        s = self._s[k] + c[rows, k] * (self._s[k + 1] - self._s[k])
        return s, np.sqrt(np.maximum(off[rows, k], 0.0))

    def _to_outline(self, s: Array, off: Array) -> tuple[Array, Array, Array]:
        """Return the signed distance from the outline in the half plane (s, off), whether it is the end, and s."""
        corners = self._outline
        a, along = corners[:-1], np.diff(corners, axis=0)
        here = np.stack([s, off], axis=1)[:, None]
        c = np.clip(((here - a) * along).sum(axis=2) / (along**2).sum(axis=1), 0.0, 1.0)
        nearest = a + c[:, :, None] * along
        gaps = np.linalg.norm(here - nearest, axis=2)
        k = np.argmin(gaps, axis=1)
        rows = np.arange(len(s))
        inside = (off < self.rod.radius_at(s)) & (s < self.rod.length) & (s > 0.0)
        return np.where(inside, -1.0, 1.0) * gaps[rows, k], k == len(a) - 1, nearest[rows, k, 0]

    @cached_property
    def _s(self) -> Array:
        even = np.linspace(0.0, self.rod.length, _STATIONS + 1)
        return np.unique(np.concatenate([even, self.rod.s]))

    @cached_property
    def _p(self) -> Array:
        return self.equilibrium.p_at(self._s)

    @cached_property
    def _along(self) -> Array:
        return np.diff(self._p, axis=0)

    @cached_property
    def _radius(self) -> Array:
        return self.rod.radius_at(self._s)

    @cached_property
    def _outline(self) -> Array:
        """Return the corners (s, r) from the base over the flank to the centre of the tip."""
        flank = np.stack([self.rod.s, self.rod.radius], axis=1)
        return np.vstack([flank, [self.rod.length, 0.0]])
