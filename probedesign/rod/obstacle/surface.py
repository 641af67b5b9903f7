"""Divide the rod's bent surface into pieces, each with the equations of frictionless contact with a sharp object.

The object is a point, or a straight line that touches at one of its points, Q. Unknown are the force F on the rod, its
couple C about the centreline where it acts, the place σ on the piece and the coordinate λ along the line. w is the
vector from the centreline to Q; t, x and y are the axes of the section there.

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
from typing import Literal, NamedTuple, Protocol

import numpy as np

from probedesign.core.frames import Array
from probedesign.rod.coulomb_equations import Numbers, cross, dot
from probedesign.rod.rod import Rod

Where = Literal["flank", "rim", "face"]
UNKNOWNS, EQUATIONS = 8, 8
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


class SurfacePiece(Protocol):
    """One piece of the surface.

    Attributes:
        where: its public name.
        at_tip: whether the force acts on the tip's centre, with a couple.
        beyond: whether its normals meet the axis beyond the tip.
    """

    @property
    def where(self) -> Where: ...
    @property
    def at_tip(self) -> bool: ...
    @property
    def beyond(self) -> bool: ...

    def station(self, place: Numbers) -> Numbers:
        """Return the arclength where the force acts, at most the tip's."""
        ...

    def equations(self, state: SurfaceState, direction: Array | None) -> Numbers:
        """Return the residuals, zero where the object touches this piece and F is along the normal, (8, m)."""
        ...

    def excess(self, state: SurfaceState) -> float:
        """Return 0 on the piece, a negative number before its lower end, a positive one beyond its upper end."""
        ...

    def pushes(self, state: SurfaceState) -> bool:
        """Return whether the object pushes the rod and does not pull it."""
        ...

    def entry(self, from_before: bool) -> float:
        """Return the place to start from, coming from the piece before it or from the one beyond it."""
        ...

    def surface(self, place: float) -> float:
        """Return the arclength of the touched section."""
        ...


@dataclass(frozen=True)
class Flank:
    """A frustum; its place is the arclength where the normal meets the axis.

    Attributes:
        low, high: ends of that arclength.
        s0, r0: a section.
        tan: tan α = -dr/ds.
        beyond: where the normals meet the axis beyond the tip of a rod that swells towards it.
    """

    low: float
    high: float
    s0: float
    r0: float
    tan: float
    beyond: bool = False
    where: Where = "flank"

    @property
    def at_tip(self) -> bool:
        """Return True beyond the tip, where the force acts on the tip's centre."""
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

    def pushes(self, state: SurfaceState) -> bool:
        """Return whether the force opposes the outward normal."""
        return bool(dot(state.force, state.w)[0] < 0.0)

    def entry(self, from_before: bool) -> float:
        """Return the end at which it is entered."""
        return self.low if from_before else self.high

    def surface(self, place: float) -> float:
        """Return where the normal through `place` leaves the body."""
        cos2 = 1.0 / (1.0 + self.tan**2)
        return place + (self.r0 - self.tan * (place - self.s0)) * cos2 * self.tan


@dataclass(frozen=True)
class Edge:
    """The circle where two frusta meet; its place is the fraction of the normal's rotation from one to the other.

    At a ridge as in a groove, the normals of both frusta bound the direction of the force.

    Attributes:
        s, r: of the circle.
        before, after: half-angles of the frusta [rad].
    """

    s: float
    r: float
    before: float
    after: float
    beyond: bool = False
    at_tip: bool = False
    where: Where = "flank"

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

    def pushes(self, state: SurfaceState) -> bool:
        """Return whether the force opposes the outward normal."""
        return bool(dot(state.force, state.w)[0] < 0.0)

    def entry(self, from_before: bool) -> float:
        """Return the place of the normal of the frustum that is left."""
        return 0.0 if from_before else 1.0

    def surface(self, place: float) -> float:
        """Return the circle's arclength."""
        return self.s

    def _lean(self, place: Numbers) -> Numbers:
        return self.before + place * (self.after - self.before)


@dataclass(frozen=True)
class Rim:
    """The edge of the blunt tip.

    Attributes:
        r: its radius.
        before: half-angle of the flank that it ends [rad].
    """

    r: float
    before: float
    beyond: bool = False
    at_tip: bool = True
    where: Where = "rim"

    def station(self, place: Numbers) -> Numbers:
        """Return the tip's arclength, 1."""
        return np.ones_like(place)

    def equations(self, state: SurfaceState, direction: Array | None) -> Numbers:
        """Return the residuals: Q is on the rim and F in the plane through the axis."""
        w, t = state.w, state.t
        circle = (dot(w, w) / self.r - self.r) / 2.0
        across = dot(state.force, cross(t, w)) / self.r
        way = state.way if direction is None else dot(state.force, direction[:, None])
        return _stack(circle, dot(w, t), across, state.place, state.couple - cross(w, state.force), way)

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

    def entry(self, from_before: bool) -> float:
        """Return 0: the piece has no place."""
        return 0.0

    def surface(self, place: float) -> float:
        """Return the tip's arclength, 1."""
        return 1.0


@dataclass(frozen=True)
class Face:
    """The flat end.

    Attributes:
        r: its radius.
    """

    r: float
    beyond: bool = False
    at_tip: bool = True
    where: Where = "face"

    def station(self, place: Numbers) -> Numbers:
        """Return the tip's arclength, 1."""
        return np.ones_like(place)

    def equations(self, state: SurfaceState, direction: Array | None) -> Numbers:
        """Return the residuals: Q is in the tip's plane and F along its normal."""
        F, w, t = state.force, state.w, state.t
        along = state.way if direction is None else dot(t, direction[:, None])
        couple = state.couple - cross(w, F)
        return _stack(dot(w, t), dot(F, state.x), dot(F, state.y), state.place, couple, along)

    def excess(self, state: SurfaceState) -> float:
        """Return minus the distance of Q outside the disc: the contact moves back to the rim."""
        return -max(0.0, math.sqrt(float(dot(state.w, state.w)[0])) - self.r - _SLACK)

    def pushes(self, state: SurfaceState) -> bool:
        """Return whether the force opposes the tip's tangent."""
        return bool(dot(state.force, state.t)[0] < 0.0)

    def entry(self, from_before: bool) -> float:
        """Return 0: the piece has no place."""
        return 0.0

    def surface(self, place: float) -> float:
        """Return the tip's arclength, 1."""
        return 1.0


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
    return _stack(
        on_sphere,
        dot(w, t) - radius * lean,
        dot(F, cross(t, normal)),
        dot(F, t - lean * normal),
        couple,
        along,
    )


def _outside(x: float, low: float, high: float, slack: float) -> float:
    """Return how far x is below low (negative) or above high; 0 within the slack."""
    if x < low - slack:
        return x - low
    return x - high if x > high + slack else 0.0


def _stack(a: Numbers, b: Numbers, c: Numbers, d: Numbers, couple: Numbers, along: Numbers) -> Numbers:
    return np.stack([a, b, c, d, couple[0], couple[1], couple[2], along])
