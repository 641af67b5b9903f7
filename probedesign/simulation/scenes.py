"""Objects that simulated probes press: sharp points and edges of the Net F/T box, and a house of cards for mapping.

A press follows the contact by Coulomb's law (`probedesign.rod.friction`) while the object moves relative to the base.
The contact sticks and slips, so the wrench during retraction differs from that during the press; friction 0 slides
freely.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import accumulate

import numpy as np
from scipy.optimize import brentq

from probedesign.core.errors import InputError
from probedesign.core.frames import Array
from probedesign.core.units import MILLINEWTON, MM
from probedesign.estimation.model import ProbeModel
from probedesign.rod.contact import safe_force
from probedesign.rod.equilibrium import Equilibrium
from probedesign.rod.friction import (
    ASSUMED_FRICTION,
    ASSUMED_SPREAD,
    MAX_FRICTION,
    CoulombContact,
    CoulombSolver,
    draw_friction,
)

# a press along a straight line

#: First step of the search for the travel that gives a force, and its tolerance [m].
FIRST_STEP, DEPTH_TOLERANCE = 0.1 * MM, 1e-3 * MM


@dataclass(frozen=True)
class StraightPress:
    """Press of a rod against a sharp point or an edge that approaches along a straight line, with Coulomb friction."""

    solver: CoulombSolver  #: of the contact.
    gravity_base: Array  #: gravity in base axes [m/s²], (3,).
    start: Array  #: point of the object before it travels, in base axes [m], (3,).
    direction: Array  #: of the base towards the object, so the object travels along its opposite, unit vector, (3,).
    along: Array | None  #: direction of the edge, (3,); None for a sharp point.

    def first_contact(self, max_travel: float) -> CoulombContact:
        """Return the first contact within a travel [m], which carries no force."""
        travel = -max_travel * self.direction
        return self.solver.touch(self.gravity_base, self.start + travel, travel, self.along)

    def travel_of(self, contact: CoulombContact) -> float:
        """Return the travel of the object at a contact [m]."""
        return float((self.start - contact.object_point) @ self.direction)

    def at(self, travel: float, last: CoulombContact) -> CoulombContact:
        """Return the contact at a travel [m], continued from another one."""
        return self.solver.advance(last, self.start - travel * self.direction)

    def follow(self, first: CoulombContact, travels: Sequence[float]) -> list[CoulombContact]:
        """Return the first contact and those at each travel [m] in turn."""
        return list(accumulate(travels, lambda last, travel: self.at(travel, last), initial=first))

    def travel_for(self, force: float, last: CoulombContact, limit: float = math.inf) -> float:
        """Return the travel beyond a contact that gives a force [m]: bracketed by doubled steps, then a root finder.

        Less, where the contact is lost before it has the force, and at most `limit` [m].
        """

        @lru_cache
        def excess(travel: float) -> float:
            contact = self.at(travel, last)
            return contact.magnitude - force if contact.ok else math.inf

        start = low = self.travel_of(last)
        high = min(start + FIRST_STEP, limit)
        while excess(high) < 0.0:
            if high >= limit:
                return limit
            low, high = high, min(2.0 * high - start, limit)
        while not math.isfinite(excess(high)):  # lost on the way
            if high - low < DEPTH_TOLERANCE:
                return low
            middle = 0.5 * (low + high)
            low, high = (middle, high) if excess(middle) < 0.0 else (low, middle)
        if excess(low) >= 0.0:
            return high
        root: float = brentq(excess, low, high, xtol=0.5 * DEPTH_TOLERANCE)
        return min(root + 0.5 * DEPTH_TOLERANCE, high)


# scenes of the simulated box

LEAN = math.radians(15.0)  #: Angle of a card of a tent from the vertical [rad]; assumed, such tents are stable.
CLEARANCE = 0.05  #: Distance between probe and object before the base moves towards it, as a fraction of the length.
#: Maximum depth of a press, as a fraction of the length: of an edge, and of a sharp point, off which it soon slips.
MAX_DEPTH, MAX_POINT_DEPTH = 0.10, 0.005
_RELEASE_TOLERANCE = 1e-6  #: Tolerance of the position where the probe leaves an object, as a fraction of the length.
N_KNOTS = 17  #: Number of knots of a press; linear interpolation of the force between them is within a thousandth.
#: Number of knots of the retraction with friction: at its start the friction reverses within a short distance.
N_KNOTS_BACK = 65


@dataclass(frozen=True)
class SceneObject:
    """An object of a scene."""

    name: str  #: its name.
    fraction: float  #: where it meets the free probe, as a fraction of the length.
    tilt: float | None  #: for an edge, angle from the y axis in the base's xy plane [rad]; None for a sharp point.


#: Scenes by name. Cards lean from the vertical, which is the x axis of the base of a horizontal probe.
SCENES = {
    "edges": tuple(SceneObject("edge", fraction, 0.0) for fraction in (0.4, 0.6, 0.8)),
    "points": tuple(SceneObject("point", fraction, None) for fraction in (0.4, 0.6, 0.8)),
    "card-house": (
        SceneObject("left card of the first tent", 0.85, 0.5 * math.pi - LEAN),
        SceneObject("right card of the first tent", 0.85, 0.5 * math.pi + LEAN),
        SceneObject("left card of the second tent", 0.70, 0.5 * math.pi - LEAN),
        SceneObject("right card of the second tent", 0.70, 0.5 * math.pi + LEAN),
        SceneObject("card across both", 0.55, 0.0),
    ),
    "free": (),
}


@dataclass(frozen=True)
class PressedObject:
    """An object and the wrench it causes, by the travel of the base."""

    obj: SceneObject  #: the object.
    direction: Array  #: direction of travel in base axes, (3,), unit vector.
    point: Array  #: point of the object at the start of the travel, in base axes [m], (3,).
    travel: Array  #: travel of the base [m], (k,), increasing.
    wrench_base: Array  #: wrench there [N, N·m], (k, 6).
    s_contact: float  #: arclength of the touched section at the end of the travel [m].
    force: float  #: force there [N].
    friction: float  #: coefficient μ of this object.
    travel_back: Array  #: travel of the base during retraction [m], (j,), increasing.
    wrench_back: Array  #: wrench there [N, N·m], (j, 6).

    @property
    def summary(self) -> str:
        """The object in one line."""
        where = f"{self.obj.name}: s = {self.s_contact / MM:.1f} mm, {self.force / MILLINEWTON:.3g} mN"
        return f"{where}, friction {self.friction:.2g}" if self.friction else where


def press_scene(
    model: ProbeModel,
    scene: str,
    friction: float = ASSUMED_FRICTION,
    friction_spread: float = ASSUMED_SPREAD,
    seed: int = 1,
    compliance: float = 0.0,
) -> tuple[PressedObject, ...]:
    """Press every object of a scene with a force below the limit of the probe, in reference mode.

    Args:
        model: the probe.
        scene: one of `SCENES`.
        friction: median of the friction coefficient μ; 0 is the contact without friction.
        friction_spread: standard deviation of ln μ between objects.
        seed: seed of the random numbers.
        compliance: how far every object yields by the force on it [m/N].

    Raises:
        InputError: the scene is unknown, friction or compliance is out of range, or the probe has no equilibrium in the
            scene.
    """
    if scene not in SCENES:
        raise InputError(f"--scene {scene} is unknown; available are {', '.join(SCENES)}")
    if not 0.0 <= friction <= MAX_FRICTION:
        raise InputError(f"--friction {friction:g} must lie in 0 ... {MAX_FRICTION:g}")
    if not 0.0 <= compliance < math.inf:
        raise InputError(f"--object-compliance-m-N {compliance:g} must be finite and not negative; 0 is a rigid object")
    free, rng = model.rod.solve(model.gravity_base, mode="reference"), np.random.default_rng(seed)
    drawn = [draw_friction(friction, friction_spread, rng) for _ in SCENES[scene]]
    solvers = (CoulombSolver(model.rod, mu, "reference", compliance) for mu in drawn)
    return tuple(_pressed(model, free, obj, solver) for obj, solver in zip(SCENES[scene], solvers, strict=True))


def _pressed(model: ProbeModel, free: Equilibrium, obj: SceneObject, solver: CoulombSolver) -> PressedObject:
    """Press an object until the force is the safe one, and retract; the contact is followed along the whole travel."""
    rod, length, clear = model.rod, model.rod.length, CLEARANCE * model.rod.length
    along = None if obj.tilt is None else np.array([math.sin(obj.tilt), math.cos(obj.tilt), 0.0])
    s = obj.fraction * length
    direction = np.cross(np.array([0.0, 1.0, 0.0]) if along is None else along, free.R_at(s)[:, 2])
    direction /= np.linalg.norm(direction)
    start = free.p_at(s) + (float(rod.radius_at(s)) + clear) * direction
    friction = solver.friction
    press = StraightPress(solver, model.gravity_base, start, direction, along)
    limit = clear + (MAX_POINT_DEPTH if along is None else MAX_DEPTH) * length
    first = press.first_contact(limit)
    end = press.travel_for(safe_force(rod), first, limit) if first.ok else 0.0
    touched = press.travel_of(first)
    if not first.ok or end <= touched:
        why = "unstable" if first.ok else first.result
        raise InputError(f"{obj.name} at {obj.fraction:g} of the length: {why}; this probe cannot be used in the scene")
    travel_on = np.linspace(touched, end, N_KNOTS)
    on = press.follow(first, travel_on[1:].tolist())
    travel, wrench = np.array([0.0, *travel_on]), _wrenches(free, on)
    travel_back, wrench_back = (travel, wrench) if friction == 0.0 else _retract(press, free, on[-1], touched)
    return PressedObject(obj, direction, start, travel, wrench, on[-1].s, on[-1].magnitude, friction, travel_back,
                         wrench_back)  # fmt: skip


def _wrenches(free: Equilibrium, contacts: Sequence[CoulombContact]) -> Array:
    return np.array([free.wrench_base, *(contact.equilibrium.wrench_base for contact in contacts)])


def _retract(press: StraightPress, free: Equilibrium, end: CoulombContact, touched: float) -> tuple[Array, Array]:
    """Return travels [m], increasing, and wrenches of the way back from a press; steps are halved at the release."""
    contacts, travels = [end], [press.travel_of(end)]
    step = (travels[0] - touched) / (N_KNOTS_BACK - 1)
    while contacts[-1].ok and travels[-1] > 0.0:
        travel = max(travels[-1] - step, 0.0)
        contact = press.at(travel, contacts[-1])
        if not contact.ok:
            step *= 0.5
            if step > _RELEASE_TOLERANCE * press.solver.rod.length:
                continue
        contacts, travels = [*contacts, contact], [*travels, travel]
    back = np.array([0.0, *travels[::-1]])
    kept = np.concatenate([np.diff(back) > 0.0, [True]])
    return back[kept], _wrenches(free, contacts[::-1])[kept]


# the card house
#
# Seen from the front, x points to the right and z up; the probe comes along y and passes beside a card, under it or
# within a tent. The cards extend from the plane y = 0, where their front edges are, to positive y. A tapered probe that
# is pushed onto a card meets the front edge first and bends away from the card.

#: Size of a poker card, 2.5 by 3.5 inches: depth and width in the house [m]; its thickness is neglected.
CARD = (63.5e-3, 88.9e-3)
RIDGE = 30e-3  #: Distance of the ridge of a lower tent from the middle of the house [m]; assumed.
SOURCE = "card house"  #: Source stated in the recording of a simulated run, by which it is recognised.


@dataclass(frozen=True)
class Card:
    """A card of the house."""

    name: str  #: its name.
    start: Array  #: start, end: ends of its front edge [m], (3,).
    end: Array
    normal: Array  #: unit normal of one of its sides, perpendicular to y, (3,).

    @property
    def along(self) -> Array:
        """Direction of its front edge, unit vector, (3,)."""
        edge = self.end - self.start
        return np.asarray(edge / np.linalg.norm(edge))

    @property
    def corners(self) -> Array:
        """Corners in order around the card, the front edge first [m], (4, 3)."""
        depth = np.array([0.0, CARD[0], 0.0])
        return np.array([self.start, self.end, self.end + depth, self.start + depth])


@dataclass(frozen=True)
class TouchTarget:
    """A point of a front edge to be touched."""

    card: Card  #: the touched card.
    p_world: Array  #: the point [m], (3,).
    direction: Array  #: direction of the push onto the card, unit vector, (3,).
    fraction: float  #: place along the probe, as a fraction of its length.
    repeated: bool = False  #: whether the point is touched for the second time.
    compliance: float = 0.0  #: how far the card yields there by the force on it [m/N].


def _card(name: str, start: tuple[float, float], end: tuple[float, float]) -> Card:
    a, b = (np.array([x, 0.0, z]) for x, z in (start, end))
    along = (b - a) / np.linalg.norm(b - a)
    return Card(name, a, b, np.cross(along, (0.0, 1.0, 0.0)))


def _tent(name: str, ridge: float, foot: float) -> list[Card]:
    half_width, height = CARD[1] * math.sin(LEAN), CARD[1] * math.cos(LEAN)
    feet = {"left": ridge - half_width, "right": ridge + half_width}
    return [_card(f"{name}, {side}", (x, foot), (ridge, foot + height)) for side, x in feet.items()]


def card_house() -> tuple[Card, ...]:
    """Return the cards: two tents, a card across both, a tent on top of it."""
    floor = CARD[1] * math.cos(LEAN)
    across = _card("roof", (-0.5 * CARD[1], floor), (0.5 * CARD[1], floor))
    return (*_tent("left tent", -RIDGE, 0.0), *_tent("right tent", RIDGE, 0.0), across,
            *_tent("upper tent", 0.0, floor))  # fmt: skip


def true_outlines(source: str) -> tuple[Array, ...]:
    """Return the corners of the cards [m], (4, 3) each, if `source` is that of a simulated run; else nothing."""
    return tuple(card.corners for card in card_house()) if source == SOURCE else ()


#: Heights above the foot of a card at which it is touched from outside and from within its tent [mm].
_HEIGHTS = {
    "left tent, left": ((20, 45, 70), (32, 57)),
    "left tent, right": ((25, 50), (37,)),
    "right tent, left": ((30, 60), (45,)),
    "right tent, right": ((20, 45, 70), (33,)),
    "upper tent, left": ((20, 45, 70), (33,)),
    "upper tent, right": ((25, 55), (40,)),
}
_ROOF_X = (-20.0, 0.0, 20.0)  #: Places where the roof is touched from below [mm].
MIN_FRACTION, MAX_FRACTION = 0.50, 0.95  #: Range of fractions of the length that touch: the distal half.
N_REPEATED = 5  #: Number of targets that are touched twice, from another depth.


def shared_targets(targets: Sequence[TouchTarget], n: int) -> list[list[TouchTarget]]:
    """Return the targets of each of several probes that touch at the same time, from the left part to the right one."""
    order = sorted(range(len(targets)), key=lambda i: float(targets[i].p_world[0]))
    return [[targets[i] for i in sorted(part.tolist())] for part in np.array_split(order, n)]


def touch_targets(compliance: Callable[[], float] = lambda: 0.0) -> tuple[TouchTarget, ...]:
    """Return the targets in touching order: 25 points, then five of them again at another fraction of the length.

    Args:
        compliance: draws how far the card yields by the force on it at a point [m/N].
    """
    points = []
    for card in card_house():
        middle = np.array([0.5 * (card.start[0] + card.end[0]), 0.0, card.start[2]])
        if card.name == "roof":
            points += [(card, np.array([1e-3 * x, 0.0, middle[2]]), np.array([0.0, 0.0, 1.0])) for x in _ROOF_X]
            continue
        rise = card.along / card.along[2]
        # The outer side of a leaning card faces upwards.
        outward = card.normal if card.normal[2] > 0.0 else -card.normal
        for heights, direction in zip(_HEIGHTS[card.name], (-outward, outward), strict=True):
            points += [(card, card.start + 1e-3 * height * rise, direction) for height in heights]
    n = len(points)
    # Neighbours on a card get fractions far apart: 7 and 25 have no common divisor.
    fractions = [MIN_FRACTION + (MAX_FRACTION - MIN_FRACTION) * (7 * i % n) / (n - 1) for i in range(n)]
    first = [TouchTarget(*point, fraction, compliance=compliance())
             for point, fraction in zip(points, fractions, strict=True)]  # fmt: skip
    again = [first[i] for i in range(0, n, n // N_REPEATED)][:N_REPEATED]
    total = MIN_FRACTION + MAX_FRACTION
    return (*first, *(replace(t, fraction=total - t.fraction, repeated=True) for t in again))
