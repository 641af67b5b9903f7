"""A simulated mapping run: sensor readings, robot poses and ground truth of touching the card house, written as files.

The rod is solved in reference mode for a probe whose stiffness, base, poses and bias deviate as `RunErrors` states. The
base dwells at each pose while readings are taken, and moves along straight lines in between.

Contacts stick and slip by Coulomb's law with a friction coefficient drawn for each touch. Since friction depends on
where the base came from, the contact is tracked from pose to pose. Friction 0 is the contact without friction.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from probedesign.core.errors import InputError
from probedesign.core.files import write_atomically
from probedesign.core.frames import Array, pose
from probedesign.core.units import MILLINEWTON, MM
from probedesign.estimation.detector import DRIFT_STEPS
from probedesign.estimation.model import ProbeModel
from probedesign.estimation.tolerances import Tolerances
from probedesign.live.poses.pose_sources import POSE_COLUMNS
from probedesign.live.recordings.csv import CsvRecorder
from probedesign.live.recordings.mcap_write import McapRecorder
from probedesign.mapping.base_pose import BasePoseUncertainty
from probedesign.rod.equilibrium import Equilibrium
from probedesign.rod.friction import (
    ASSUMED_FRICTION,
    ASSUMED_SPREAD,
    CoulombContact,
    CoulombSolver,
    draw_friction,
)
from probedesign.rod.obstacle import ObstacleContact, press_against_line
from probedesign.rod.rod import Mode, Rod
from probedesign.simulation.card_house import SOURCE, TouchTarget
from probedesign.simulation.robot import SimulatedTrajectory

LIGHT_FORCE, FIRM_FORCE = 1.0 * MILLINEWTON, 3.5 * MILLINEWTON
"""Forces between which the base alternates [N]; the firm one stays below 5 mN when the robot is off its place."""
N_CYCLES = 3
"""Number of light and firm presses of each target."""
_SEARCH_DEPTH = 5.0 * MM
"""Travel beyond the expected first contact within which it is searched [m]."""
CLEARANCE = 3.0 * MM
"""Distance from the expected first contact at which the base starts towards an edge [m]."""
PITCH = np.radians(5.0)
"""Pitch of the base upwards [rad], so that the probe beyond an edge stays clear of the card behind it."""


@dataclass(frozen=True)
class RunErrors:
    """Standard deviations of the errors of a run that the estimator does not know.

    Attributes:
        stiffness: of a common factor on E and G.
        base_offset: of the base position, constant during the run, on each axis [m].
        base_repeat: of the base position at each pose, on each axis [m].
        bias_rate: random walk of the bias, in steps of the sensor's resolution per √s.
        rotation: of base and sensor together about the base axes, constant during the run [rad], (3,). The poses do not
            contain it; the robot is taught at the object by feel, so the presses are as firm as without it.
        friction: median friction coefficient μ of the edges; 0 is without friction.
        friction_spread: standard deviation of ln μ from touch to touch.
    """

    stiffness: float = 0.01
    base_offset: float = 0.05e-3
    base_repeat: float = 0.01e-3
    bias_rate: float = DRIFT_STEPS
    rotation: tuple[float, float, float] = (0.0, 0.0, 0.0)
    friction: float = ASSUMED_FRICTION
    friction_spread: float = ASSUMED_SPREAD

    @classmethod
    def from_priors(
        cls,
        model: ProbeModel,
        base: BasePoseUncertainty,
        friction: float = ASSUMED_FRICTION,
        friction_spread: float = ASSUMED_SPREAD,
    ) -> "RunErrors":
        """Return the errors that the priors of a probe and of its base pose state, with the friction of the object."""
        x, y, z = base.rotation_std.tolist()
        return cls(Tolerances.of(model).youngs_modulus, base.base_offset_mm * MM, base.base_repeat_mm * MM,
                   rotation=(x, y, z), friction=friction, friction_spread=friction_spread)  # fmt: skip


@dataclass(frozen=True)
class TrueTouch:
    """Ground truth of one touch.

    Attributes:
        target: the intended point.
        start, end: times between which the base presses [s].
        p_world: touched point, the mean over the poses [m], (3,).
        force: largest force [N].
        moment: largest moment of the contact about the base [N·m].
        clearance: smallest distance between the probe beyond the contact and the card behind its edge [m].
        wrenches_base: wrench at the base at each pose, without bias and noise [N, N·m], (k, 6).
        Ts_world_base: poses reported by the robot, (k, 4, 4).
        friction: friction coefficient μ of this touch.
        friction_ratios: tangential over normal force at each pose, (k,).
    """

    target: TouchTarget
    start: float
    end: float
    p_world: Array
    force: float
    moment: float
    clearance: float
    wrenches_base: Array
    Ts_world_base: Array
    friction: float
    friction_ratios: Array


@dataclass(frozen=True)
class SimulatedRun:
    """A simulated run through the card house.

    Attributes:
        trajectory: motion of the base, with the true wrench.
        touches: ground truth, in order of time.
        wrench_free: wrench of the free probe at the base [N, N·m], (6,).
        gravity_base: gravity in base axes [m/s²], (3,).
    """

    trajectory: SimulatedTrajectory
    touches: tuple[TrueTouch, ...]
    wrench_free: Array
    gravity_base: Array


def base_rotation(pitch: float = PITCH) -> Array:
    """Return R_world_base (3, 3) of a probe along the world's y axis, x of its base down, pitched upwards [rad]."""
    level = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]])
    c, s = np.cos(pitch), np.sin(pitch)
    return np.asarray(np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]]) @ level)


def simulate_run(
    model: ProbeModel,
    targets: Sequence[TouchTarget],
    rng: np.random.Generator,
    errors: RunErrors | None = None,
    time_scale: float = 1.0,
) -> SimulatedRun:
    """Simulate touching the targets one after the other.

    Args:
        model: the probe as the estimator knows it.
        targets: points of a card house.
        rng: random numbers of the errors.
        errors: standard deviations of the unknown errors.
        time_scale: as in `SimulatedTrajectory`.

    Raises:
        InputError: the probe has no stable equilibrium, or misses an edge.
    """
    errors = errors or RunErrors()
    stiffness = float(np.exp(rng.normal(0.0, errors.stiffness)))
    offset = rng.normal(0.0, errors.base_offset, 3)
    # A separate random stream: all other draws are the same with and without a rotation error.
    rotation = Rotation.from_rotvec(rng.spawn(1)[0].normal(0.0, errors.rotation)).as_matrix()
    true_rod = replace(model.rod, youngs_modulus=stiffness * model.rod.youngs_modulus,
                       shear_modulus=stiffness * model.rod.shear_modulus)  # fmt: skip
    bench = _Bench(model.rod, true_rod, base_rotation(), rotation)
    trajectory = SimulatedTrajectory(
        bench.R_reported, bench.true_free.wrench_base, rng, time_scale, errors.bias_rate
    )
    friction_rng = rng.spawn(1)[0]
    touches = []
    for target in targets:
        friction = draw_friction(errors.friction, errors.friction_spread, friction_rng)
        touches.append(_touch(bench, trajectory, target, offset, errors.base_repeat, rng, friction))
    return SimulatedRun(trajectory, tuple(touches), bench.true_free.wrench_base, bench.gravity)


class _Bench:
    """The probe as designed and as it is, free and against an edge, on a base with a fixed rotation."""

    def __init__(self, rod: Rod, true_rod: Rod, R_reported: Array, rotation_error: Array) -> None:
        self.rod, self.true_rod = rod, true_rod
        self.R_reported, self.R = R_reported, R_reported @ rotation_error
        self.gravity = self.R.T @ np.array([0.0, 0.0, -9.81])
        self.free = self.rod.solve(self.gravity)
        self.true_free = true_rod.solve(self.gravity, mode="reference")

    def start(self, target: TouchTarget) -> Array:
        """Return the base position at which the free designed probe meets the edge [m], (3,)."""
        s = target.fraction * self.rod.length
        radius = float(self.rod.radius_at(s))
        start: Array = target.p_world - self.R @ self.free.p_at(s) - radius * target.direction
        return start

    def press(self, target: TouchTarget, p_base: Array, true: bool) -> ObstacleContact:
        """Return the press against the edge without friction, after a straight approach to a base position."""
        point, along, travel = self._edge(target, p_base)
        rod, mode = self._rod(true)
        return press_against_line(rod, self.gravity, point, along, travel, mode=mode)

    def first_contact(self, target: TouchTarget, p_base: Array, solver: CoulombSolver) -> CoulombContact:
        """Return the first contact with friction during a straight approach to a base position."""
        point, along, travel = self._edge(target, p_base)
        return solver.touch(self.gravity, point, travel, along)

    def advance(
        self, target: TouchTarget, p_base: Array, solver: CoulombSolver, last: CoulombContact
    ) -> CoulombContact:
        """Return the contact with friction after the base has moved on to a position."""
        return solver.advance(last, self._edge(target, p_base)[0])

    def solver(self, friction: float, true: bool) -> CoulombSolver:
        """Return the solver of contacts with friction, for the true or the designed probe."""
        rod, mode = self._rod(true)
        return CoulombSolver(rod, friction, mode)

    def depths(self, target: TouchTarget, forces: Sequence[float], friction: float) -> list[float]:
        """Return the depths at which the designed probe has given forces [m], for forces in increasing order [N]."""
        start = self.start(target)
        if friction == 0.0:

            def force_at(depth: float) -> float:
                press = self.press(target, start + depth * target.direction, true=False)
                if press.result == "no_contact":
                    return 0.0
                _require_ok(target, press.result)
                return press.magnitude

            return [_depth(force_at, force) for force in forces]
        solver = self.solver(friction, true=False)
        first = self.first_contact(target, start + _SEARCH_DEPTH * target.direction, solver)
        _require_ok(target, first.result)
        last, depths = first, list[float]()

        def contact(depth: float) -> CoulombContact:
            found = self.advance(target, start + depth * target.direction, solver, last)
            _require_ok(target, found.result)
            return found

        touched = float((target.p_world - start - self.R @ first.object_point) @ target.direction)
        for force in forces:
            depth = _depth(lambda depth: contact(depth).magnitude, force, max([touched, *depths]))
            depths.append(depth)
            last = contact(depth)
        return depths

    def _rod(self, true: bool) -> tuple[Rod, Mode]:
        return (self.true_rod, "reference") if true else (self.rod, "fast")

    def _edge(self, target: TouchTarget, p_base: Array) -> tuple[Array, Array, Array]:
        """Return a point of the edge, its direction and its travel relative to the base, in base axes."""
        travel = (p_base - self.start(target)) @ target.direction + CLEARANCE
        point, along = self.R.T @ (target.p_world - p_base), self.R.T @ target.card.along
        return point, along, -travel * (self.R.T @ target.direction)


def _depth(force_at: Callable[[float], float], force: float, minimum: float = 0.0) -> float:
    """Return the depth for a force [m], at least `minimum`: bracketed by doubling, then bisected."""
    low, high = minimum, minimum + 0.1 * MM
    while force_at(high) < force:
        low, high = high, 2.0 * high - minimum
    for _ in range(30):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if force_at(middle) < force else (low, middle)
        if high - low < 1e-3 * MM:
            break
    return high


def _require_ok(target: TouchTarget, result: str, hint: str = "") -> None:
    if result != "ok":
        raise InputError(f"{target.card.name} at {target.fraction:.2f} of the length: {result}{hint}")


class _PoseTruth(NamedTuple):
    """Ground truth at one pose of the base.

    Attributes:
        p_base: true position of the base [m], (3,).
        equilibrium: of the true probe.
        p_surface_base: touched point [m], (3,).
        s_surface: arclength of the touched section [m].
        force: contact force [N].
        ratio: tangential over normal force.
    """

    p_base: Array
    equilibrium: Equilibrium
    p_surface_base: Array
    s_surface: float
    force: float
    ratio: float


def _press_poses(
    bench: _Bench, target: TouchTarget, p_bases: Iterable[Array], friction: float
) -> Iterator[tuple[float, _PoseTruth]]:
    """Yield the travel at first contact [m] and the ground truth at each base position in turn.

    Raises:
        InputError: the probe has no stable equilibrium, or does not touch.
    """
    hint = ": the base with its position error does not press it; try another --seed"
    solver, contact, touched = bench.solver(friction, true=True), None, np.nan
    for p in p_bases:
        if friction == 0.0:
            press = bench.press(target, p, true=True)
            _require_ok(target, press.result, hint)
            eq, s = press.equilibrium, press.s_surface
            yield float(press.way_touched), _PoseTruth(p, eq, press.p_surface_base, s, press.magnitude, 0.0)
            continue
        if contact is None:
            contact = bench.first_contact(target, p, solver)
            _require_ok(target, contact.result, hint)
            p_first = p + bench.R @ (bench.R.T @ (target.p_world - p) - contact.object_point)
            touched = float((p_first - bench.start(target)) @ target.direction) + CLEARANCE
        contact = bench.advance(target, p, solver, contact)
        _require_ok(target, contact.result, hint)
        ratio, eq = contact.tangential_force / contact.normal_force, contact.equilibrium
        yield touched, _PoseTruth(p, eq, contact.p_surface_base, contact.s, contact.magnitude, ratio)


def _touch(
    bench: _Bench,
    trajectory: SimulatedTrajectory,
    target: TouchTarget,
    offset: Array,
    base_repeat: float,
    rng: np.random.Generator,
    friction: float,
) -> TrueTouch:
    """Append a touch to the trajectory: travel, press alternately, retreat; return its ground truth."""
    start = bench.start(target)
    ready = start - CLEARANCE * target.direction
    trajectory.travel_to(ready)
    depths = bench.depths(target, (LIGHT_FORCE, FIRM_FORCE), friction)
    commanded = [start + depth * target.direction for depth in depths * N_CYCLES]
    begin, found = trajectory.end, list[_PoseTruth]()
    offset_world = bench.R @ offset
    true_positions = (p + offset_world + rng.normal(0.0, base_repeat, 3) for p in commanded)
    for goal, (touched, truth) in zip(
        commanded, _press_poses(bench, target, true_positions, friction), strict=True
    ):
        if not found:
            trajectory.approach(start + (touched - CLEARANCE) * target.direction)
        trajectory.press(goal, truth.equilibrium.wrench_base)
        found.append(truth)
    trajectory.retreat(ready)
    reported = trajectory.press_positions(len(found))
    wrenches = np.array([truth.equilibrium.wrench_base for truth in found])
    moments = np.linalg.norm((wrenches - bench.true_free.wrench_base)[:, 3:], axis=1)
    points = [truth.p_base + bench.R @ truth.p_surface_base for truth in found]
    return TrueTouch(
        target, begin, trajectory.end, np.mean(points, axis=0), max(truth.force for truth in found),
        float(moments.max()),
        min(_clearance(bench, target, p, truth) for p, truth in zip(reported, found, strict=True)),
        wrenches, np.array([pose(bench.R_reported, p) for p in reported]),
        friction, np.array([truth.ratio for truth in found]),
    )  # fmt: skip


def _clearance(bench: _Bench, target: TouchTarget, p_base: Array, truth: _PoseTruth) -> float:
    """Return the distance of the probe beyond the contact from the card, as far as the card reaches [m]."""
    rod = bench.true_rod
    s = np.linspace(truth.s_surface, rod.length, 30)[1:]
    axis = p_base + np.array([bench.R @ truth.equilibrium.p_at(float(at)) for at in s])
    distance = (target.p_world - axis) @ target.direction - rod.radius_at(s)
    within = axis[:, 1] <= target.card.corners[:, 1].max()
    return float(distance[within].min()) if within.any() else np.inf


# files

FILES = ("house.mcap", "poses.csv", "truth.csv")
TRUTH_COLUMNS = (
    "time_s",
    "x_world_mm",
    "y_world_mm",
    "z_world_mm",
    "fraction",
    "force_N",
    "again",
    "friction",
)


def write_run(
    run: SimulatedRun,
    model: ProbeModel,
    folder: Path,
    rng: np.random.Generator,
    force: bool = False,
    recording: str = FILES[0],
) -> tuple[Path, ...]:
    """Write the recording and the poses, which `explore` reads, and the ground truth.

    Args:
        run: the simulated run.
        model: the probe on the sensor.
        folder: folder to write to.
        rng: random numbers of the sensor noise.
        force: replace existing files.
        recording: name of the recording, .mcap or .csv.

    Returns:
        The written files.

    Raises:
        InputError: files exist, or cannot be written.
    """
    paths = tuple(folder / name for name in (recording, *FILES[1:]))
    for path in paths:
        if path.exists() and not force:
            raise InputError(f"{path}: exists; add --force to replace it, or name another folder")
    file = (
        CsvRecorder(paths[0], force)
        if recording.endswith(".csv")
        else McapRecorder(paths[0], model, force, {"source": SOURCE})
    )
    try:
        for block in run.trajectory.blocks(model, rng):
            file.on_samples(block)
    finally:
        file.close()
    poses = [(at.time, *(value / MM for value in at.p), *at.q) for at in run.trajectory.poses()]
    truth = [
        (touch.start, *(touch.p_world / MM), touch.target.fraction, touch.force,
         float(touch.target.repeated), touch.friction)
        for touch in run.touches
    ]  # fmt: skip
    write_atomically(paths[1], _csv(POSE_COLUMNS, poses))
    write_atomically(paths[2], _csv(TRUTH_COLUMNS, truth))
    return paths


def _csv(columns: Sequence[str], rows: Iterable[Iterable[float]]) -> bytes:
    """Return a CSV table; numbers are rounded to the ninth decimal, beyond which they are rounding errors."""
    lines = [",".join(f"{round(number, 9):z.9g}" for number in row) for row in rows]
    return "\n".join([",".join(columns), *lines, ""]).encode()
