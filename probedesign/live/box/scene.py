"""What a simulated probe meets: sharp points and edges, each pressed by a straight move of the base."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from probedesign.errors import InputError
from probedesign.estimation.model import ProbeModel
from probedesign.frames import Array
from probedesign.live.simulate import bearable
from probedesign.rod.equilibrium import Equilibrium
from probedesign.rod.obstacle import Press, press_against_line, press_against_point
from probedesign.units import MILLINEWTON, MM

CLEAR = 0.05
"""Room between probe and object before the base moves towards it, of the length."""
TRIED = 0.005
"""Press by which an object's stiffness is found, of the length."""
DEEPEST = 0.10
"""Press at most, of the length."""
KNOTS = 17
"""Along the press; a force is so nearly straight in it that lines between them are within a thousandth."""


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
        s_contact: at the end of the way [m].
        force: there [N].
    """

    thing: Thing
    towards: Array
    point: Array
    way: Array
    wrench_base: Array
    s_contact: float
    force: float

    @property
    def line(self) -> str:
        """It in one line."""
        return f"{self.thing.name}: s = {self.s_contact / MM:.1f} mm, {self.force / MILLINEWTON:.3g} mN"


def press_scene(model: ProbeModel, scene: str) -> tuple[Pressed, ...]:
    """Every object of a scene, pressed as hard as the probe bears well, in reference mode.

    Args:
        model: the probe.
        scene: one of `SCENES`.

    Raises:
        InputError: there is no such scene, or the probe does not bear it.
    """
    if scene not in SCENES:
        raise InputError(f"--scene {scene} is not known; there are {', '.join(SCENES)}")
    free = model.rod.solve(model.gravity_base, mode="reference")
    return tuple(_pressed(model, free, thing) for thing in SCENES[scene])


def _pressed(model: ProbeModel, free: Equilibrium, thing: Thing) -> Pressed:
    length = model.rod.length
    along = None if thing.lean is None else np.array([math.sin(thing.lean), math.cos(thing.lean), 0.0])
    s = thing.part * length
    tangent = free.R_at(s)[:, 2]
    towards = np.cross(np.array([0.0, 1.0, 0.0]) if along is None else along, tangent)
    towards /= np.linalg.norm(towards)
    surface = free.p_at(s) + towards * float(np.interp(s, model.rod.s, model.rod.radius))
    start = surface + CLEAR * length * towards

    def pressed(depth: float) -> Press:
        travel = -(CLEAR * length + depth) * towards  # the object comes, as the base sees it
        point = start + travel
        if along is None:
            return press_against_point(model.rod, model.gravity_base, point, travel, mode="reference")
        return press_against_line(model.rod, model.gravity_base, point, along, travel, mode="reference")

    depth = _depth(model, thing, pressed)
    end = pressed(depth)
    knots = np.linspace(0.0, depth, KNOTS)[1:]
    presses = [pressed(d) for d in knots]
    touched = float(end.way_touched)
    rows = [free.wrench_base, free.wrench_base] + [press.equilibrium.wrench_base for press in presses]
    way = np.concatenate([[0.0, touched], CLEAR * length + knots])
    keep = np.concatenate([[True], np.diff(way) > 0.0])  # a sagging flank may be met a little before or after
    return Pressed(
        thing, towards, start, way[keep], np.array(rows)[keep], float(end.s_contact), end.magnitude
    )


def _depth(model: ProbeModel, thing: Thing, pressed: Callable[[float], Press]) -> float:
    """How far to press for a force that the probe bears well [m]; less where it would slip away."""
    tried = TRIED * model.rod.length
    while (press := pressed(tried)).result != "ok":
        tried *= 0.5
        if tried < 1e-4 * TRIED * model.rod.length:
            raise InputError(
                f"{thing.name} at {thing.part:g} of the length: {press.result}; no scene for this probe"
            )
    if thing.lean is None:
        return tried  # a sharp point soon lets it slip
    depth = min(tried * bearable(model.rod) / press.magnitude, DEEPEST * model.rod.length)
    while pressed(depth).result != "ok":
        depth *= 0.5
    return depth
