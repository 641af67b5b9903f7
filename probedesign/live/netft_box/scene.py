"""Objects that a simulated probe meets: sharp points and edges, each pressed by a straight move of the base.

With friction the contact sticks and slips by Coulomb's law (`probedesign.rod.friction`), so the wrench on the way off
the object differs from that on the way onto it. Friction 0 is the contact without friction of
`probedesign.rod.obstacle`.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from probedesign.errors import InputError
from probedesign.estimation.model import ProbeModel
from probedesign.frames import Array
from probedesign.live.sources.sim import bearable
from probedesign.rod.equilibrium import Equilibrium
from probedesign.rod.friction import (
    ASSUMED_FRICTION,
    ASSUMED_SPREAD,
    MAX_FRICTION,
    CoulombContact,
    CoulombSolver,
    draw_friction,
)
from probedesign.rod.obstacle import Press, press_against_line, press_against_point
from probedesign.units import MILLINEWTON, MM

CLEAR = 0.05
"""Room between probe and object before the base moves towards it, of the length."""
TRIED = 0.005
"""Press by which an object's stiffness is found, of the length."""
DEEPEST = 0.10
"""Press at most, of the length."""
_LEAVES = 1e-6
"""Of the length: to so much it is found where the probe leaves an object."""
KNOTS = 17
"""Along the press; a force is so nearly straight in it that lines between them are within a thousandth."""
KNOTS_BACK = 65
"""Along the way off an object with friction: where it begins, the friction turns round within a short way."""


@dataclass(frozen=True)
class Thing:
    """An object as a scene names it.

    Attributes:
        name: what it is.
        part: where it meets the free probe, of the length.
        lean: of an edge, its angle from the y axis in the base's xy plane [rad]; None for a sharp point.
    """

    name: str
    part: float
    lean: float | None


SCENES = {
    "edges": tuple(Thing("edge", part, 0.0) for part in (0.4, 0.6, 0.8)),
    "points": tuple(Thing("point", part, None) for part in (0.4, 0.6, 0.8)),
    "card-house": (
        Thing("left card of the first tent", 0.85, math.radians(75.0)),
        Thing("right card of the first tent", 0.85, math.radians(105.0)),
        Thing("left card of the second tent", 0.70, math.radians(75.0)),
        Thing("right card of the second tent", 0.70, math.radians(105.0)),
        Thing("card across both", 0.55, 0.0),
    ),
    "free": (),
}
"""A card leans by 15° from the vertical, which is the base's x axis of a probe held level: assumed, it stands."""


@dataclass(frozen=True)
class Pressed:
    """A thing and what it does to the probe, by how far the base has moved towards it.

    Attributes:
        thing: the object.
        towards: direction of the move in base axes, (3,), unit.
        point: of the object where the base starts, in base axes [m], (3,).
        way: of the base [m], (k,), increasing.
        wrench_base: there [N, N·m], (k, 6).
        s_contact: at the end of the way [m]; with friction that of the touched section.
        force: there [N].
        friction: coefficient μ of this object.
        way_back: of the base as it moves off again [m], (j,), increasing.
        wrench_back: there [N, N·m], (j, 6).
    """

    thing: Thing
    towards: Array
    point: Array
    way: Array
    wrench_base: Array
    s_contact: float
    force: float
    friction: float
    way_back: Array
    wrench_back: Array

    @property
    def line(self) -> str:
        """It in one line."""
        where = f"{self.thing.name}: s = {self.s_contact / MM:.1f} mm, {self.force / MILLINEWTON:.3g} mN"
        return f"{where}, friction {self.friction:.2g}" if self.friction else where


def press_scene(
    model: ProbeModel,
    scene: str,
    friction: float = ASSUMED_FRICTION,
    friction_spread: float = ASSUMED_SPREAD,
    seed: int = 1,
) -> tuple[Pressed, ...]:
    """Every object of a scene, pressed as hard as the probe bears well, in reference mode.

    Args:
        model: the probe.
        scene: one of `SCENES`.
        friction: median of the friction coefficient μ; 0 is the contact without friction.
        friction_spread: standard deviation of ln μ from object to object.
        seed: of that.

    Raises:
        InputError: there is no such scene, the friction is negative, or the probe does not bear the scene.
    """
    if scene not in SCENES:
        raise InputError(f"--scene {scene} is not known; there are {', '.join(SCENES)}")
    if not 0.0 <= friction <= MAX_FRICTION:
        raise InputError(f"--friction {friction:g} must lie in 0 ... {MAX_FRICTION:g}")
    free, rng = model.rod.solve(model.gravity_base, mode="reference"), np.random.default_rng(seed)
    drawn = [draw_friction(friction, friction_spread, rng) for _ in SCENES[scene]]
    return tuple(_pressed(model, free, thing, mu) for thing, mu in zip(SCENES[scene], drawn, strict=True))


def _pressed(model: ProbeModel, free: Equilibrium, thing: Thing, friction: float) -> Pressed:
    length = model.rod.length
    along = None if thing.lean is None else np.array([math.sin(thing.lean), math.cos(thing.lean), 0.0])
    s = thing.part * length
    tangent = free.R_at(s)[:, 2]
    towards = np.cross(np.array([0.0, 1.0, 0.0]) if along is None else along, tangent)
    towards /= np.linalg.norm(towards)
    surface = free.p_at(s) + towards * float(np.interp(s, model.rod.s, model.rod.radius))
    start = surface + CLEAR * length * towards
    if friction > 0.0:
        return _rubbed(
            model, free, thing, CoulombSolver(model.rod, friction, "reference"), towards, start, along
        )

    def pressed(depth: float) -> Press:
        travel = -(CLEAR * length + depth) * towards  # the object comes, as the base sees it
        point = start + travel
        if along is None:
            return press_against_point(model.rod, model.gravity_base, point, travel, mode="reference")
        return press_against_line(model.rod, model.gravity_base, point, along, travel, mode="reference")

    depth = _depth(model, thing, lambda depth: (pressed(depth).result, pressed(depth).magnitude))
    end = pressed(depth)
    knots = np.linspace(0.0, depth, KNOTS)[1:]
    presses = [pressed(d) for d in knots]
    touched = float(end.way_touched)
    rows = [free.wrench_base, free.wrench_base] + [press.equilibrium.wrench_base for press in presses]
    way = np.concatenate([[0.0, touched], CLEAR * length + knots])
    keep = np.concatenate([[True], np.diff(way) > 0.0])  # a sagging flank may be met a little before or after
    felt = np.array(rows)[keep]
    return Pressed(
        thing, towards, start, way[keep], felt, float(end.s_contact), end.magnitude, 0.0, way[keep], felt
    )


def _rubbed(
    model: ProbeModel,
    free: Equilibrium,
    thing: Thing,
    solver: CoulombSolver,
    towards: Array,
    start: Array,
    along: Array | None,
) -> Pressed:
    """An object with friction, onto it and off it again: the contact is followed along the whole way."""
    clear = CLEAR * model.rod.length
    last = start - (clear + DEEPEST * model.rod.length) * towards
    first = solver.touch(model.gravity_base, last, last - start, along)

    def at(contact: CoulombContact, way: float) -> CoulombContact:
        return solver.advance(contact, start - way * towards)

    def tried(depth: float) -> tuple[str, float]:
        contact = at(first, clear + depth)
        return contact.result, contact.magnitude

    depth = _depth(model, thing, tried)
    touched = float((start - first.object_point) @ towards)
    on, way_on = [first], np.linspace(touched, clear + depth, KNOTS)
    for way in way_on[1:]:
        on.append(at(on[-1], float(way)))
    off, way_off = [on[-1]], [clear + depth]
    step = (clear + depth - touched) / (KNOTS_BACK - 1)
    while off[-1].ok and way_off[-1] > 0.0:
        way = max(way_off[-1] - step, 0.0)
        found = at(off[-1], way)
        if not found.ok:  # lost on the way: halved until it is known where
            step *= 0.5
            if step > _LEAVES * model.rod.length:
                continue
        off, way_off = [*off, found], [*way_off, way]
    felt_on = [free.wrench_base, *(contact.equilibrium.wrench_base for contact in on)]
    felt_off = [contact.equilibrium.wrench_base for contact in off]
    end, back = on[-1], np.array([0.0, *way_off[::-1]])
    keep = np.concatenate([np.diff(back) > 0.0, [True]])
    return Pressed(
        thing, towards, start, np.array([0.0, *way_on]), np.array(felt_on), end.s, end.magnitude,
        solver.friction, back[keep], np.array([free.wrench_base, *felt_off[::-1]])[keep],
    )  # fmt: skip


def _depth(model: ProbeModel, thing: Thing, pressed: Callable[[float], tuple[str, float]]) -> float:
    """How far to press for a force that the probe bears well [m]; less where it would slip away.

    Args:
        model: the probe.
        thing: the object.
        pressed: result and force [N] of a press by its depth [m].
    """
    tried = TRIED * model.rod.length
    while (press := pressed(tried))[0] != "ok":
        tried *= 0.5
        if tried < 1e-4 * TRIED * model.rod.length:
            raise InputError(
                f"{thing.name} at {thing.part:g} of the length: {press[0]}; no scene for this probe"
            )
    if thing.lean is None:
        return tried  # a sharp point soon lets it slip
    depth = min(tried * bearable(model.rod) / press[1], DEEPEST * model.rod.length)
    while pressed(depth)[0] != "ok":
        depth *= 0.5
    return depth


REST_TIME = 5.0
"""Free of everything at the start of a round [s]: time for a tare."""
MOVE_TIME, PRESS_TIME, HOLD_TIME = 1.0, 1.5, 3.0
"""To the next object; onto it, and off it again; held still [s]."""


@dataclass(frozen=True)
class Motion:
    """Round after round: rest, then for each object there, onto it, hold, off it.

    Attributes:
        model: the probe.
        things: in the order in which they are pressed.
    """

    model: ProbeModel
    things: tuple[Pressed, ...]

    @property
    def round(self) -> float:
        """How long one takes [s]."""
        return REST_TIME + len(self.things) * self._each

    @property
    def _each(self) -> float:
        return MOVE_TIME + 2.0 * PRESS_TIME + HOLD_TIME

    def wrench_sensor(self, time: Array) -> Array:
        """What a sensor without bias or noise reads [N, N·m], (n, 6).

        Args:
            time: since the base began to move [s], (n,).
        """
        index, way, leaves = self._at(time)
        wrench = np.tile(self._free, (len(time), 1))
        for i in np.unique(index[index >= 0]):
            thing = self.things[i]
            on, off = (index == i) & ~leaves, (index == i) & leaves
            wrench[on] = _interpolated(way[on], thing.way, thing.wrench_base)
            wrench[off] = _interpolated(way[off], thing.way_back, thing.wrench_back)
        return self.model.to_sensor(wrench, self.model.gravity_base)

    def p_world_base(self, time: Array) -> Array:
        """Where the base is [m], (n, 3), in a world that has its origin and axes while it rests. The objects
        hang in that world where they are met."""
        index, way, _ = self._at(time)
        p = np.zeros((len(time), 3))
        for i in np.unique(index[index >= 0]):
            here = index == i
            p[here] = way[here, None] * self.things[i].towards
        return p

    def _at(self, time: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Which object is next, -1 for none, how far the base has gone towards it [m], and whether it moves off it:
        with friction the probe feels another wrench then."""
        since = np.mod(time, self.round) - REST_TIME
        index = np.floor(since / self._each).astype(int)
        index = np.where(since < 0.0, -1, np.minimum(index, len(self.things) - 1))
        phase = since - index * self._each
        knots = np.cumsum([0.0, MOVE_TIME, PRESS_TIME, HOLD_TIME, PRESS_TIME])
        share = np.interp(phase, knots, [0.0, 0.0, 1.0, 1.0, 0.0])
        ends = np.array([thing.way[-1] for thing in self.things] + [0.0])  # index -1 is the last
        return index, share * ends[index], phase > MOVE_TIME + PRESS_TIME + HOLD_TIME

    @cached_property
    def _free(self) -> Array:
        return self.model.rod.solve(self.model.gravity_base, mode="reference").wrench_base


def _interpolated(at: Array, knots: Array, values: Array) -> Array:
    """Rows of values straight between knots, (n, 6), as they are at the ends beyond them."""
    part = np.clip(np.searchsorted(knots, at, side="right") - 1, 0, len(knots) - 2)
    low, high = knots[part], knots[part + 1]
    weight = np.clip((at - low) / (high - low), 0.0, 1.0)[:, None]
    between: Array = (1.0 - weight) * values[part] + weight * values[part + 1]
    return between
