"""What a sensor and a robot would tell of touching the card house: to try with, and to measure what `explore` reaches.

The rod is solved in reference mode for a probe whose stiffness, base, poses and bias are off as `Errors` has it. The
base stands at each pose while readings come, and moves between them along straight lines; between objects it is free.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from probedesign.errors import InputError
from probedesign.estimation.detector import DRIFT_STEPS
from probedesign.estimation.model import ProbeModel
from probedesign.exploring.base import Base
from probedesign.exploring.card_house import Spot
from probedesign.exploring.robot_way import Way
from probedesign.frames import Array, pose
from probedesign.rod.equilibrium import Equilibrium
from probedesign.rod.obstacle import Press, press_against_line
from probedesign.rod.rod import Mode, Rod
from probedesign.units import MILLINEWTON, MM

LIGHT, FIRM = 1.0 * MILLINEWTON, 3.5 * MILLINEWTON
"""Between which the base presses to and fro [N]: the firm one leaves room below 5 mN for a robot that is off."""
TIMES = 3
"""To and fro at each point."""
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
    """

    stiffness: float = 0.01
    base_offset: float = 0.05e-3
    base_repeat: float = 0.01e-3
    walk: float = DRIFT_STEPS
    turn: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @classmethod
    def of(cls, model: ProbeModel, base: Base) -> "Errors":
        """As a bundle and a base are said to be known."""
        unknowns, (x, y, z) = base.unknowns(model), base.turn.tolist()
        return cls(unknowns.stiffness, unknowns.base_offset, unknowns.base_repeat, turn=(x, y, z))


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
    touches = [_touch(bench, way, spot, offset, errors, rng) for spot in spots]
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
        """The probe against the edge, the base having come there straight."""
        rod, mode = (self.true, "reference") if true else (self.rod, "fast")
        gone = (p_base - self.start(spot)) @ spot.towards + CLEAR
        point, along = self.R.T @ (spot.p_world - p_base), self.R.T @ spot.card.along
        travel = -gone * (self.R.T @ spot.towards)
        return press_against_line(rod, self.gravity, point, along, travel, mode=_mode(mode))

    def depth(self, spot: Spot, force: float) -> float:
        """How far to press for a force by the probe as it is known [m]."""
        start = self.start(spot)

        def felt(depth: float) -> float:
            press = self.press(spot, start + depth * spot.towards, true=False)
            if press.result == "no_contact":
                return 0.0
            if press.result != "ok":
                raise InputError(f"{spot.card.name} at {spot.fraction:.2f} of the length: {press.result}")
            return press.magnitude

        low, high = 0.0, 0.1 * MM
        while felt(high) < force:
            low, high = high, 2.0 * high
        for _ in range(30):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if felt(middle) < force else (low, middle)
            if high - low < 1e-3 * MM:
                break
        return high


def _mode(name: str) -> Mode:
    return "reference" if name == "reference" else "fast"


def _touch(
    bench: _Bench, way: Way, spot: Spot, offset: Array, errors: Errors, rng: np.random.Generator
) -> TrueTouch:
    """Go there, wait, press to and fro, go back; the truth of it."""
    start = bench.start(spot)
    way.go(start - CLEAR * spot.towards)
    depths = [bench.depth(spot, force) for force in (LIGHT, FIRM)]
    began, points, presses = way.now, list[Array](), list[Press]()
    for depth in depths * TIMES:
        told = start + depth * spot.towards
        true = told + bench.R @ offset + rng.normal(0.0, errors.base_repeat, 3)
        press = bench.press(spot, true, true=True)
        if press.result != "ok":
            missed = f"{spot.card.name} at {spot.fraction:.2f} of the length: {press.result}"
            raise InputError(
                f"{missed}: the base, drawn off its place, does not press it; take another --seed"
            )
        if not presses:
            way.comes(start + (float(press.way_touched) - CLEAR) * spot.towards)
        way.press(told, press.equilibrium.wrench_base)
        points.append(true + bench.R @ press.p_surface_base)
        presses.append(press)
    way.leave(start - CLEAR * spot.towards)
    wrenches = np.array([press.equilibrium.wrench_base for press in presses])
    beyond = wrenches - bench.free_true.wrench_base
    return TrueTouch(
        spot, began, way.now, np.mean(points, axis=0), max(press.magnitude for press in presses),
        float(np.linalg.norm(beyond[:, 3:], axis=1).max()),
        min(_clearance(bench, spot, p, press.equilibrium, press.s_surface)
            for p, press in zip(way.last_told(len(presses)), presses, strict=True)),
        wrenches, np.array([pose(bench.R_told, p) for p in way.last_told(len(presses))]),
    )  # fmt: skip


def _clearance(bench: _Bench, spot: Spot, p_base: Array, eq: Equilibrium, s_contact: float) -> float:
    """Of the probe's surface beyond the contact from the plane of the card, as far as the card reaches [m]."""
    rod = bench.true
    s = np.linspace(s_contact, rod.length, 30)[1:]
    axis = p_base + np.array([bench.R @ eq.p_at(float(at)) for at in s])
    room = (spot.p_world - axis) @ spot.towards - np.interp(s, rod.s, rod.radius)
    within = axis[:, 1] <= spot.card.corners[:, 1].max()
    return float(room[within].min()) if within.any() else np.inf
