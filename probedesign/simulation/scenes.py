"""Scenes of the simulated Net F/T box: sharp points and edges, and the wrench while the base presses each of them.

With friction the contact sticks and slips by Coulomb's law (`probedesign.rod.friction`), so the wrench during
retraction differs from that during the press. Friction 0 is the frictionless contact of `probedesign.rod.obstacle`.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from probedesign.core.errors import InputError
from probedesign.core.frames import Array
from probedesign.core.units import MILLINEWTON, MM
from probedesign.estimation.model import ProbeModel
from probedesign.rod.equilibrium import Equilibrium
from probedesign.rod.friction import (
    ASSUMED_FRICTION,
    ASSUMED_SPREAD,
    MAX_FRICTION,
    CoulombContact,
    CoulombSolver,
    draw_friction,
)
from probedesign.rod.obstacle import ObstacleContact, press_against_line, press_against_point
from probedesign.simulation.card_house import LEAN
from probedesign.simulation.rod_contact import safe_force

CLEARANCE = 0.05
"""Distance between probe and object before the base moves towards it, as a fraction of the length."""
TRIAL_DEPTH = 0.005
"""Depth of the press that determines the stiffness of an object, as a fraction of the length."""
MAX_DEPTH = 0.10
"""Maximum depth of a press, as a fraction of the length."""
_RELEASE_TOLERANCE = 1e-6
"""Tolerance of the position where the probe leaves an object, as a fraction of the length."""
N_KNOTS = 17
"""Number of knots of a press; linear interpolation of the force between them is within a thousandth."""
N_KNOTS_BACK = 65
"""Number of knots of the retraction with friction: at its start the friction reverses within a short distance."""


@dataclass(frozen=True)
class SceneObject:
    """An object of a scene.

    Attributes:
        name: its name.
        fraction: where it meets the free probe, as a fraction of the length.
        tilt: for an edge, angle from the y axis in the base's xy plane [rad]; None for a sharp point.
    """

    name: str
    fraction: float
    tilt: float | None


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
"""Scenes by name. Cards lean from the vertical, which is the x axis of the base of a horizontal probe."""


@dataclass(frozen=True)
class PressedObject:
    """An object and the wrench it causes, by the travel of the base.

    Attributes:
        obj: the object.
        direction: direction of travel in base axes, (3,), unit vector.
        point: point of the object at the start of the travel, in base axes [m], (3,).
        travel: travel of the base [m], (k,), increasing.
        wrench_base: wrench there [N, N·m], (k, 6).
        s_contact: arclength of the contact at the end of the travel [m]; with friction, of the touched section.
        force: force there [N].
        friction: coefficient μ of this object.
        travel_back: travel of the base during retraction [m], (j,), increasing.
        wrench_back: wrench there [N, N·m], (j, 6).
    """

    obj: SceneObject
    direction: Array
    point: Array
    travel: Array
    wrench_base: Array
    s_contact: float
    force: float
    friction: float
    travel_back: Array
    wrench_back: Array

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
) -> tuple[PressedObject, ...]:
    """Press every object of a scene, with as much force as the probe can safely bear, in reference mode.

    Args:
        model: the probe.
        scene: one of `SCENES`.
        friction: median of the friction coefficient μ; 0 is the contact without friction.
        friction_spread: standard deviation of ln μ between objects.
        seed: seed of the random numbers.

    Raises:
        InputError: the scene is unknown, the friction is out of range, or the probe has no equilibrium in the scene.
    """
    if scene not in SCENES:
        raise InputError(f"--scene {scene} is unknown; available are {', '.join(SCENES)}")
    if not 0.0 <= friction <= MAX_FRICTION:
        raise InputError(f"--friction {friction:g} must lie in 0 ... {MAX_FRICTION:g}")
    free, rng = model.rod.solve(model.gravity_base, mode="reference"), np.random.default_rng(seed)
    drawn = [draw_friction(friction, friction_spread, rng) for _ in SCENES[scene]]
    return tuple(_pressed(model, free, obj, mu) for obj, mu in zip(SCENES[scene], drawn, strict=True))


def _pressed(model: ProbeModel, free: Equilibrium, obj: SceneObject, friction: float) -> PressedObject:
    length = model.rod.length
    along = None if obj.tilt is None else np.array([math.sin(obj.tilt), math.cos(obj.tilt), 0.0])
    s = obj.fraction * length
    tangent = free.R_at(s)[:, 2]
    direction = np.cross(np.array([0.0, 1.0, 0.0]) if along is None else along, tangent)
    direction /= np.linalg.norm(direction)
    surface = free.p_at(s) + direction * float(model.rod.radius_at(s))
    start = surface + CLEARANCE * length * direction
    if friction > 0.0:
        return _press_with_friction(
            model, free, obj, CoulombSolver(model.rod, friction, "reference"), direction, start, along
        )

    def pressed(depth: float) -> ObstacleContact:
        travel = -(CLEARANCE * length + depth) * direction  # the object moves, seen from the base
        point = start + travel
        if along is None:
            return press_against_point(model.rod, model.gravity_base, point, travel, mode="reference")
        return press_against_line(model.rod, model.gravity_base, point, along, travel, mode="reference")

    depth = _press_depth(model, obj, lambda depth: (pressed(depth).result, pressed(depth).magnitude))
    end = pressed(depth)
    knots = np.linspace(0.0, depth, N_KNOTS)[1:]
    presses = [pressed(d) for d in knots]
    touched = float(end.way_touched)
    rows = [free.wrench_base, free.wrench_base] + [press.equilibrium.wrench_base for press in presses]
    travel = np.concatenate([[0.0, touched], CLEARANCE * length + knots])
    kept = np.concatenate(
        [[True], np.diff(travel) > 0.0]
    )  # the sagging probe may be touched slightly earlier or later
    wrenches = np.array(rows)[kept]
    return PressedObject(
        obj,
        direction,
        start,
        travel[kept],
        wrenches,
        float(end.s_contact),
        end.magnitude,
        0.0,
        travel[kept],
        wrenches,
    )


def _press_with_friction(
    model: ProbeModel,
    free: Equilibrium,
    obj: SceneObject,
    solver: CoulombSolver,
    direction: Array,
    start: Array,
    along: Array | None,
) -> PressedObject:
    """Press an object with friction and retract; the contact is tracked along the whole travel."""
    clear = CLEARANCE * model.rod.length
    last = start - (clear + MAX_DEPTH * model.rod.length) * direction
    first = solver.touch(model.gravity_base, last, last - start, along)

    def at(contact: CoulombContact, travel: float) -> CoulombContact:
        return solver.advance(contact, start - travel * direction)

    def trial(depth: float) -> tuple[str, float]:
        contact = at(first, clear + depth)
        return contact.result, contact.magnitude

    depth = _press_depth(model, obj, trial)
    touched = float((start - first.object_point) @ direction)
    on, travel_on = [first], np.linspace(touched, clear + depth, N_KNOTS)
    for travel in travel_on[1:]:
        on.append(at(on[-1], float(travel)))
    off, travel_off = [on[-1]], [clear + depth]
    step = (clear + depth - touched) / (N_KNOTS_BACK - 1)
    while off[-1].ok and travel_off[-1] > 0.0:
        travel = max(travel_off[-1] - step, 0.0)
        found = at(off[-1], travel)
        if not found.ok:  # contact lost: bisect the position
            step *= 0.5
            if step > _RELEASE_TOLERANCE * model.rod.length:
                continue
        off, travel_off = [*off, found], [*travel_off, travel]
    wrenches_on = [free.wrench_base, *(contact.equilibrium.wrench_base for contact in on)]
    wrenches_off = [contact.equilibrium.wrench_base for contact in off]
    end, back = on[-1], np.array([0.0, *travel_off[::-1]])
    kept = np.concatenate([np.diff(back) > 0.0, [True]])
    return PressedObject(
        obj, direction, start, np.array([0.0, *travel_on]), np.array(wrenches_on), end.s, end.magnitude,
        solver.friction, back[kept], np.array([free.wrench_base, *wrenches_off[::-1]])[kept],
    )  # fmt: skip


def _press_depth(model: ProbeModel, obj: SceneObject, pressed: Callable[[float], tuple[str, float]]) -> float:
    """Return the depth of a press for a force that the probe can bear [m], reduced where it would slip off.

    Args:
        model: the probe.
        obj: the object.
        pressed: result and force [N] of a press as a function of its depth [m].
    """
    trial = TRIAL_DEPTH * model.rod.length
    while (press := pressed(trial))[0] != "ok":
        trial *= 0.5
        if trial < 1e-4 * TRIAL_DEPTH * model.rod.length:
            raise InputError(
                f"{obj.name} at {obj.fraction:g} of the length: {press[0]}; this probe cannot be used in the scene"
            )
    if obj.tilt is None:
        return trial  # the probe soon slips off a sharp point
    depth = min(trial * safe_force(model.rod) / press[1], MAX_DEPTH * model.rod.length)
    while pressed(depth)[0] != "ok":
        depth *= 0.5
    return depth
