"""The rod's bent surface in pieces, each with the equations of a sharp object that pushes without friction.

The object is a point, or a straight line that touches at one of its points, Q. Unknown are the force F that
it puts on the rod, the couple C that F makes about the centreline where it is put, the place σ on the piece
and the way λ along the line. w leads from the centreline to Q; t, x and y are the axes of the section there.

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

Every length here is in units of the rod's, every force in one unit: numbers without dimension.
"""

import math
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from probedesign.frames import Array
from probedesign.rod.rod import Rod

Where = Literal["flank", "rim", "face"]
Numbers = NDArray[Any]
"""Real or complex: derivatives are taken by complex steps."""
UNKNOWNS, EQUATIONS = 8, 8
_SLACK = 1e-9  # of the rod's length, beyond the end of a piece
_LEAN_SLACK = 1e-6  # [rad]; on a bent rod flank and rim miss each other by less


class State(NamedTuple):
    """What the equations are written in, each with a column for every variation."""

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
    def of(cls, z: Numbers, direction: Array | None, beyond: bool = False) -> "State":
        """From [8 unknowns, 12 of the frame, 3 of the point], (23, m)."""
        point = z[20:23]
        if direction is not None:
            point = point + z[7] * direction[:, None]
        w = point - z[14:17]
        if beyond:
            w = w - (z[6] - 1.0) * z[8:11]
        return cls(z[0:3], z[3:6], z[6], z[7], z[8:11], z[11:14], z[14:17], z[17:20], w)


class Piece(Protocol):
    """One piece of the surface.

    Attributes:
        where: what a user calls it.
        at_tip: whether the force is put on the tip's centre, with a couple.
        beyond: whether its normals meet the axis beyond the tip.
    """

    @property
    def where(self) -> Where: ...
    @property
    def at_tip(self) -> bool: ...
    @property
    def beyond(self) -> bool: ...

    def station(self, place: Numbers) -> Numbers:
        """Arclength where the force is put, not beyond the tip."""
        ...

    def equations(self, state: State, direction: Array | None) -> Numbers:
        """Zero where the object touches this piece and F is along the normal, (8, m)."""
        ...

    def excess(self, state: State) -> float:
        """0 on the piece; negative where the touch lies before its end, positive beyond it."""
        ...

    def pushes(self, state: State) -> bool:
        """Whether the object pushes the rod and does not pull it."""
        ...

    def entry(self, from_before: bool) -> float:
        """Place to start from, coming from the piece before it or from the one beyond it."""
        ...

    def surface(self, place: float) -> float:
        """Arclength of the touched section."""
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
        """Beyond the tip the force is put on the tip's centre."""
        return self.beyond

    def station(self, place: Numbers) -> Numbers:
        """Arclength where the force is put."""
        return np.ones_like(place) if self.beyond else place

    def equations(self, state: State, direction: Array | None) -> Numbers:
        """Of the envelope of spheres."""
        cos = 1.0 / math.hypot(1.0, self.tan)
        radius = (self.r0 - self.tan * (state.place - self.s0)) * cos
        arm = (state.place - 1.0) * state.t if self.beyond else None
        return _sphere(state, radius, self.tan * cos + 0.0 * radius, arm, direction)

    def excess(self, state: State) -> float:
        """How far the place lies off the piece."""
        return _outside(float(state.place[0]), self.low, self.high, _SLACK)

    def pushes(self, state: State) -> bool:
        """Against the outward normal."""
        return bool(_dot(state.force, state.w)[0] < 0.0)

    def entry(self, from_before: bool) -> float:
        """The end that it is entered by."""
        return self.low if from_before else self.high

    def surface(self, place: float) -> float:
        """Where the normal through `place` leaves the body."""
        cos2 = 1.0 / (1.0 + self.tan**2)
        return place + (self.r0 - self.tan * (place - self.s0)) * cos2 * self.tan


@dataclass(frozen=True)
class Edge:
    """The circle where two frusta meet; its place is how far the normal has turned from one's to the other's.

    A ridge holds a point as a groove does: two frusta's normals span where the force may point.

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
        """Where the normal meets the axis."""
        return self.s - self.r * np.tan(self._lean(place))

    def equations(self, state: State, direction: Array | None) -> Numbers:
        """Of the envelope of spheres, all of which pass through the circle."""
        lean = self._lean(state.place)
        return _sphere(state, self.r / np.cos(lean), np.sin(lean), None, direction)

    def excess(self, state: State) -> float:
        """How far the normal leans out of what both frusta leave it."""
        return _outside(float(state.place[0]), 0.0, 1.0, _LEAN_SLACK)

    def pushes(self, state: State) -> bool:
        """Against the outward normal."""
        return bool(_dot(state.force, state.w)[0] < 0.0)

    def entry(self, from_before: bool) -> float:
        """The frustum's normal that it is entered with."""
        return 0.0 if from_before else 1.0

    def surface(self, place: float) -> float:
        """The circle's own arclength."""
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
        """The tip."""
        return np.ones_like(place)

    def equations(self, state: State, direction: Array | None) -> Numbers:
        """Q lies on the rim and F in the plane through the axis."""
        w, t = state.w, state.t
        circle = (_dot(w, w) / self.r - self.r) / 2.0
        across = _dot(state.force, _cross(t, w)) / self.r
        way = state.way if direction is None else _dot(state.force, direction[:, None])
        return _stack(circle, _dot(w, t), across, state.place, state.couple - _cross(w, state.force), way)

    def excess(self, state: State) -> float:
        """How far F leans out of the corner [rad]."""
        out, along = -_dot(state.force, state.w)[0] / self.r, -_dot(state.force, state.t)[0]
        lean = math.atan2(along, out)
        return _outside(lean, self.before, math.pi / 2.0, _LEAN_SLACK)

    def pushes(self, state: State) -> bool:
        """Inwards of the corner's middle normal."""
        middle = 0.5 * (self.before + math.pi / 2.0)
        normal = math.cos(middle) / self.r * state.w + math.sin(middle) * state.t
        return bool(_dot(state.force, normal)[0] < 0.0)

    def entry(self, from_before: bool) -> float:
        """It has no place."""
        return 0.0

    def surface(self, place: float) -> float:
        """The tip."""
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
        """The tip."""
        return np.ones_like(place)

    def equations(self, state: State, direction: Array | None) -> Numbers:
        """Q lies in the tip's plane and F along its normal."""
        F, w, t = state.force, state.w, state.t
        along = state.way if direction is None else _dot(t, direction[:, None])
        couple = state.couple - _cross(w, F)
        return _stack(_dot(w, t), _dot(F, state.x), _dot(F, state.y), state.place, couple, along)

    def excess(self, state: State) -> float:
        """How far Q lies outside of the disc: it goes back over the rim."""
        return -max(0.0, math.sqrt(float(_dot(state.w, state.w)[0])) - self.r - _SLACK)

    def pushes(self, state: State) -> bool:
        """Against the tip's tangent."""
        return bool(_dot(state.force, state.t)[0] < 0.0)

    def entry(self, from_before: bool) -> float:
        """It has no place."""
        return 0.0

    def surface(self, place: float) -> float:
        """The tip."""
        return 1.0


def pieces_of(rod: Rod) -> list[Piece]:
    """The surface from the base to the middle of the tip, each piece beside its neighbours."""
    s, r = np.asarray(rod.s) / rod.length, np.asarray(rod.radius) / rod.length
    tan = -np.diff(r) / np.diff(s)
    pieces: list[Piece] = []
    for i in range(len(tan)):
        lean = float(np.arctan(tan[i]))
        if i > 0 and tan[i] != tan[i - 1]:
            pieces.append(Edge(float(s[i]), float(r[i]), float(np.arctan(tan[i - 1])), lean))
        low, high = float(s[i] - r[i] * tan[i]), float(s[i + 1] - r[i + 1] * tan[i])
        if high > 0.0:  # what lies below is the clamp's
            pieces.append(Flank(max(low, 0.0), min(high, 1.0), float(s[i]), float(r[i]), float(tan[i])))
        if high > 1.0:
            pieces.append(Flank(1.0, high, float(s[i]), float(r[i]), float(tan[i]), beyond=True))
    return [*pieces, Rim(float(r[-1]), lean), Face(float(r[-1]))]


def _sphere(
    state: State, radius: Numbers, lean: Numbers, arm: Numbers | None, direction: Array | None
) -> Numbers:
    """Q on a sphere about the axis, where the normal leans by sin⁻¹ `lean`, and F against it."""
    w, t, F = state.w, state.t, state.force
    normal = w / np.sqrt(_dot(w, w) + 1e-300)
    on_sphere = (_dot(w, w) / radius - radius) / 2.0
    couple = state.couple if arm is None else state.couple - _cross(arm, F)
    along = state.way if direction is None else _dot(w, direction[:, None])
    return _stack(
        on_sphere,
        _dot(w, t) - radius * lean,
        _dot(F, _cross(t, normal)),
        _dot(F, t - lean * normal),
        couple,
        along,
    )


def _outside(x: float, low: float, high: float, slack: float) -> float:
    """How far x lies below low (negative) or above high; 0 within the slack."""
    if x < low - slack:
        return x - low
    return x - high if x > high + slack else 0.0


def _dot(a: Numbers, b: Numbers) -> Numbers:
    product: Numbers = (a * b).sum(axis=0)
    return product


def _cross(a: Numbers, b: Numbers) -> Numbers:
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def _stack(a: Numbers, b: Numbers, c: Numbers, d: Numbers, couple: Numbers, along: Numbers) -> Numbers:
    return np.stack([a, b, c, d, couple[0], couple[1], couple[2], along])
