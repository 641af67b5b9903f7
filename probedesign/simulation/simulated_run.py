"""What a sensor and a robot would tell of touching the card house: to try with, and to measure what `explore` reaches.

The rod is solved in reference mode for a probe whose stiffness, base, poses and bias are off as `Errors` has it. The
base stands at each pose while readings come, and moves between them along straight lines; between objects it is free.

An edge sticks and slips by Coulomb's law, with a friction coefficient of its own at each touch; the contact is followed
from pose to pose, as friction depends on where the base came from. Friction 0 is the contact without friction.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from probedesign.errors import InputError
from probedesign.estimation.detector import DRIFT_STEPS
from probedesign.estimation.model import ProbeModel
from probedesign.estimation.tolerances import Tolerances
from probedesign.frames import Array, pose
from probedesign.mapping.base_pose import Base
from probedesign.rod.equilibrium import Equilibrium
from probedesign.rod.friction import (
    ASSUMED_FRICTION,
    ASSUMED_SPREAD,
    CoulombContact,
    CoulombSolver,
    draw_friction,
)
from probedesign.rod.obstacle import Press, press_against_line
from probedesign.rod.rod import Mode, Rod
from probedesign.simulation.card_house import Spot
from probedesign.simulation.trajectory import Way
from probedesign.units import MILLINEWTON, MM

LIGHT, FIRM = 1.0 * MILLINEWTON, 3.5 * MILLINEWTON
"""Between which the base presses to and fro [N]: the firm one leaves room below 5 mN for a robot that is off."""
TIMES = 3
"""To and fro at each point."""
_REACH = 5.0 * MM
"""Past where the free probe should touch: so far the base is led to find where it does [m]."""
CLEAR = 3.0 * MM
"""From where the base begins to move towards an edge [m]."""
PITCH = np.radians(5.0)
"""By which the probe's base looks up, so that the probe beyond an edge keeps off the card behind it."""


@dataclass(frozen=True)
class Errors:
    """Standard deviations of what the estimator does not know; the issue's numbers of a known E.

    Attributes:
        stiffness: of a common factor on E and G.
        base_offset: of the base's place, the same all along, on each axis [m].
        base_repeat: of the base's place at each pose for itself, on each axis [m].
        walk: of the bias in a second, in steps of the sensor's resolution; 0.2 from touch to touch.
        turn: of base and sensor together about the base's axes, the same all along [rad], (3,). The poses do not tell
            it; where the base goes is taught at the object by feel, so that the presses are as firm as without it.
        friction: median friction coefficient μ of the edges; 0 is without friction.
        friction_spread: standard deviation of ln μ from touch to touch.
    """

    stiffness: float = 0.01
    base_offset: float = 0.05e-3
    base_repeat: float = 0.01e-3
    walk: float = DRIFT_STEPS
    turn: tuple[float, float, float] = (0.0, 0.0, 0.0)
    friction: float = ASSUMED_FRICTION
    friction_spread: float = ASSUMED_SPREAD

    @classmethod
    def of(
        cls,
        model: ProbeModel,
        base: Base,
        friction: float = ASSUMED_FRICTION,
        friction_spread: float = ASSUMED_SPREAD,
    ) -> "Errors":
        """As a bundle and a base are said to be known, with the friction of the object."""
        x, y, z = base.turn.tolist()
        return cls(Tolerances.of(model).youngs_modulus, base.base_offset_mm * MM, base.base_repeat_mm * MM,
                   turn=(x, y, z), friction=friction, friction_spread=friction_spread)  # fmt: skip


@dataclass(frozen=True)
class TrueTouch:
    """What truly happened at one spot.

    Attributes:
        spot: that was meant.
        start, end: between which the base pressed [s].
        p_world: the touched point, the mean over the poses [m], (3,).
        force: the strongest [N].
        moment: of it about the base, the strongest [N·m].
        clearance: least room between the probe beyond the contact and the card behind its edge [m].
        wrenches: at the base at each pose, without bias and noise, (k, 6).
        Ts_told: poses as the robot tells them, (k, 4, 4).
        friction: coefficient μ of this touch.
        friction_ratios: tangential over normal force at each pose, (k,).
    """

    spot: Spot
    start: float
    end: float
    p_world: Array
    force: float
    moment: float
    clearance: float
    wrenches: Array
    Ts_told: Array
    friction: float
    friction_ratios: Array


@dataclass(frozen=True)
class Rehearsal:
    """A run through the house.

    Attributes:
        way: of the base, and what the sensor truly feels on it.
        touches: the truth, in the order of time.
        free: wrench of the free probe at the base [N, N·m], (6,).
        gravity_base: [m/s²], (3,).
    """

    way: Way
    touches: tuple[TrueTouch, ...]
    free: Array
    gravity_base: Array


def base_turn(pitch: float = PITCH) -> Array:
    """R_world_base of a probe that points along the world's y, its base's x down, then looks up by `pitch`, (3, 3)."""
    level = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]])
    c, s = np.cos(pitch), np.sin(pitch)
    return np.asarray(np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]]) @ level)


def rehearse(
    model: ProbeModel,
    spots: Sequence[Spot],
    rng: np.random.Generator,
    errors: Errors | None = None,
    pace: float = 1.0,
) -> Rehearsal:
    """Touch one spot after the other.

    Args:
        model: the probe as the estimator has it.
        spots: of a card house.
        rng: of what is off.
        errors: of what is not known.
        pace: as of `Way`.

    Raises:
        InputError: the probe gives way, or misses an edge.
    """
    errors = errors or Errors()
    factor = float(np.exp(rng.normal(0.0, errors.stiffness)))
    offset = rng.normal(0.0, errors.base_offset, 3)
    # Drawn from a stream of its own: with a turn and without, all else is the same.
    turn = Rotation.from_rotvec(rng.spawn(1)[0].normal(0.0, errors.turn)).as_matrix()
    bench = _Bench(model, _stiffened(model.rod, factor), base_turn(), turn)
    way = Way(bench.R_told, bench.free_true.wrench_base, rng, pace, errors.walk)
    rubbing = rng.spawn(1)[0]
    touches = [
        _touch(
            bench,
            way,
            spot,
            offset,
            errors,
            rng,
            draw_friction(errors.friction, errors.friction_spread, rubbing),
        )
        for spot in spots
    ]
    return Rehearsal(way, tuple(touches), bench.free_true.wrench_base, bench.gravity)


def _stiffened(rod: Rod, factor: float) -> Rod:
    return replace(rod, youngs_modulus=factor * rod.youngs_modulus, shear_modulus=factor * rod.shear_modulus)


class _Bench:
    """The probe as it is known and as it is, hanging free."""

    def __init__(self, model: ProbeModel, true: Rod, R_told: Array, turn: Array) -> None:
        self.rod, self.true = model.rod, true
        self.R_told, self.R = R_told, R_told @ turn
        self.gravity = self.R.T @ np.array([0.0, 0.0, -9.81])
        self.free = self.rod.solve(self.gravity)
        self.free_true = true.solve(self.gravity, mode="reference")

    def start(self, spot: Spot) -> Array:
        """Where the base is when the free probe, as it is known, comes to the edge [m], (3,)."""
        s = spot.fraction * self.rod.length
        radius = float(np.interp(s, self.rod.s, self.rod.radius))
        start: Array = spot.p_world - self.R @ self.free.p_at(s) - radius * spot.towards
        return start

    def press(self, spot: Spot, p_base: Array, true: bool) -> Press:
        """The probe against the edge without friction, the base having come there straight."""
        point, along, travel = self._seen(spot, p_base)
        rod, mode = self._rod(true)
        return press_against_line(rod, self.gravity, point, along, travel, mode=mode)

    def first(self, spot: Spot, p_base: Array, solver: CoulombSolver) -> CoulombContact:
        """First touch of the probe and an edge with friction on the straight way of the base to a place."""
        point, along, travel = self._seen(spot, p_base)
        return solver.touch(self.gravity, point, travel, along)

    def moved(self, spot: Spot, p_base: Array, solver: CoulombSolver, last: CoulombContact) -> CoulombContact:
        """The contact with friction after the base has moved on."""
        return solver.advance(last, self._seen(spot, p_base)[0])

    def solver(self, friction: float, true: bool) -> CoulombSolver:
        """Of contacts with friction, for the probe as it is or as it is known."""
        rod, mode = self._rod(true)
        return CoulombSolver(rod, friction, mode)

    def depths(self, spot: Spot, forces: Sequence[float], friction: float) -> list[float]:
        """How far to press for forces, in increasing order, by the probe as it is known [m]."""
        if friction == 0.0:
            return [self._depth(lambda depth: self._felt(spot, depth), force) for force in forces]
        solver, start = self.solver(friction, true=False), self.start(spot)
        first = self.first(spot, start + _REACH * spot.towards, solver)
        _require_ok(spot, first.result)
        here, found = first, list[float]()

        def contact(depth: float) -> CoulombContact:
            met = self.moved(spot, start + depth * spot.towards, solver, here)
            _require_ok(spot, met.result)
            return met

        touched = float((spot.p_world - start - self.R @ first.object_point) @ spot.towards)
        for force in forces:
            past = max([touched, *found])
            depth = self._depth(lambda depth: contact(depth).magnitude, force, past)
            found.append(depth)
            here = contact(depth)
        return found

    def _depth(self, felt: Callable[[float], float], force: float, past: float = 0.0) -> float:
        """How far to press for a force, further than `past` [m]."""
        low, high = past, past + 0.1 * MM
        while felt(high) < force:
            low, high = high, 2.0 * high - past
        for _ in range(30):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if felt(middle) < force else (low, middle)
            if high - low < 1e-3 * MM:
                break
        return high

    def _felt(self, spot: Spot, depth: float) -> float:
        """Force of the probe as it is known, without friction [N]."""
        press = self.press(spot, self.start(spot) + depth * spot.towards, true=False)
        if press.result == "no_contact":
            return 0.0
        _require_ok(spot, press.result)
        return press.magnitude

    def _rod(self, true: bool) -> tuple[Rod, Mode]:
        return (self.true, "reference") if true else (self.rod, "fast")

    def _seen(self, spot: Spot, p_base: Array) -> tuple[Array, Array, Array]:
        """A point of the edge, its direction and the way it has come, in base axes."""
        gone = (p_base - self.start(spot)) @ spot.towards + CLEAR
        point, along = self.R.T @ (spot.p_world - p_base), self.R.T @ spot.card.along
        return point, along, -gone * (self.R.T @ spot.towards)


def _require_ok(spot: Spot, result: str, why: str = "") -> None:
    if result != "ok":
        raise InputError(f"{spot.card.name} at {spot.fraction:.2f} of the length: {result}{why}")


class _Pose(NamedTuple):
    """The probe at one pose of the base.

    Attributes:
        p_base: where the base truly is [m], (3,).
        equilibrium: of the probe.
        p_surface_base: touched point [m], (3,).
        s_surface: arclength of the touched section [m].
        force: [N].
        ratio: tangential over normal force.
    """

    p_base: Array
    equilibrium: Equilibrium
    p_surface_base: Array
    s_surface: float
    force: float
    ratio: float


def _poses(
    bench: _Bench, spot: Spot, bases: Iterable[Array], friction: float
) -> Iterator[tuple[float, _Pose]]:
    """What happens at each place of the base in turn, with the way at which it first touched [m].

    Raises:
        InputError: the probe gives way, or does not touch.
    """
    off = ": the base, drawn off its place, does not press it; take another --seed"
    solver, contact, touched = bench.solver(friction, true=True), None, np.nan
    for base in bases:
        if friction == 0.0:
            press = bench.press(spot, base, true=True)
            _require_ok(spot, press.result, off)
            eq, s = press.equilibrium, press.s_surface
            yield float(press.way_touched), _Pose(base, eq, press.p_surface_base, s, press.magnitude, 0.0)
            continue
        if contact is None:
            contact = bench.first(spot, base, solver)
            _require_ok(spot, contact.result, off)
            begun = base + bench.R @ (bench.R.T @ (spot.p_world - base) - contact.object_point)
            touched = float((begun - bench.start(spot)) @ spot.towards) + CLEAR
        contact = bench.moved(spot, base, solver, contact)
        _require_ok(spot, contact.result, off)
        ratio = contact.tangential_force / contact.normal_force
        yield (
            touched,
            _Pose(base, contact.equilibrium, contact.p_surface_base, contact.s, contact.magnitude, ratio),
        )


def _touch(
    bench: _Bench,
    way: Way,
    spot: Spot,
    offset: Array,
    errors: Errors,
    rng: np.random.Generator,
    friction: float,
) -> TrueTouch:
    """Go there, wait, press to and fro, go back; the truth of it."""
    start = bench.start(spot)
    way.go(start - CLEAR * spot.towards)
    depths = bench.depths(spot, (LIGHT, FIRM), friction)
    commanded = [start + depth * spot.towards for depth in depths * TIMES]
    began, poses = way.now, list[_Pose]()
    offset_world = bench.R @ offset
    drawn = (p + offset_world + rng.normal(0.0, errors.base_repeat, 3) for p in commanded)
    for goal, (touched, here) in zip(commanded, _poses(bench, spot, drawn, friction), strict=True):
        if not poses:
            way.comes(start + (touched - CLEAR) * spot.towards)
        way.press(goal, here.equilibrium.wrench_base)
        poses.append(here)
    way.leave(start - CLEAR * spot.towards)
    wrenches = np.array([here.equilibrium.wrench_base for here in poses])
    beyond = wrenches - bench.free_true.wrench_base
    points = [here.p_base + bench.R @ here.p_surface_base for here in poses]
    return TrueTouch(
        spot, began, way.now, np.mean(points, axis=0), max(here.force for here in poses),
        float(np.linalg.norm(beyond[:, 3:], axis=1).max()),
        min(_clearance(bench, spot, p, here.equilibrium, here.s_surface)
            for p, here in zip(way.last_told(len(poses)), poses, strict=True)),
        wrenches, np.array([pose(bench.R_told, p) for p in way.last_told(len(poses))]),
        friction, np.array([here.ratio for here in poses]),
    )  # fmt: skip


def _clearance(bench: _Bench, spot: Spot, p_base: Array, eq: Equilibrium, s_contact: float) -> float:
    """Of the probe's surface beyond the contact from the plane of the card, as far as the card reaches [m]."""
    rod = bench.true
    s = np.linspace(s_contact, rod.length, 30)[1:]
    axis = p_base + np.array([bench.R @ eq.p_at(float(at)) for at in s])
    room = (spot.p_world - axis) @ spot.towards - np.interp(s, rod.s, rod.radius)
    within = axis[:, 1] <= spot.card.corners[:, 1].max()
    return float(room[within].min()) if within.any() else np.inf
