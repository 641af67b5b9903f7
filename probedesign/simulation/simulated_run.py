"""A simulated mapping run: sensor readings, robot poses and ground truth of touching the card house, written as files.

The rod is solved in reference mode for a probe whose stiffness, base, poses and bias deviate as `RunErrors` states. The
base dwells at each pose while readings are taken, and moves along straight lines in between.

Contacts stick and slip by Coulomb's law with a friction coefficient drawn for each touch. Since friction depends on
where the base came from, the contact is followed from pose to pose.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from probedesign.core import csv_tables, statistics
from probedesign.core.errors import InputError
from probedesign.core.files import check_overwrite, write_atomically
from probedesign.core.frames import Array, pose
from probedesign.core.units import MILLINEWTON, MM
from probedesign.estimation.bias import WALK_STEPS
from probedesign.estimation.error_sources import BEFORE_KNOTS
from probedesign.estimation.model import ProbeModel, Tolerances
from probedesign.geometry import Axis
from probedesign.live.blocks import Block
from probedesign.live.poses.base_poses import TimedPose, pose_from_matrix
from probedesign.live.poses.pose_sources import POSE_COLUMNS
from probedesign.live.recordings.mcap_write import McapRecorder
from probedesign.mapping.contact_map import ContactMap
from probedesign.prediction.monte_carlo import perturbed_rod
from probedesign.rod.friction import ASSUMED_FRICTION, ASSUMED_SPREAD, CoulombContact, CoulombSolver, draw_friction
from probedesign.rod.rod import Rod
from probedesign.simulation.scenes import SOURCE, StraightPress, TouchTarget

#: Forces between which the base alternates [N]; the firm one stays below 5 mN when the robot is off its place.
LIGHT_FORCE, FIRM_FORCE = 1.0 * MILLINEWTON, 3.5 * MILLINEWTON
N_CYCLES = 3  #: Number of light and firm presses of each target.
MAX_LATE = 0.25  #: Part of the light press that errors of the base may take: after the firm one it must still touch.
_SEARCH_DEPTH = 5.0 * MM  #: Travel beyond the expected first contact within which it is searched [m].
CLEARANCE = 3.0 * MM  #: Distance from the expected first contact at which the base starts towards an edge [m].
#: Pitch of the base upwards [rad], so that the probe beyond an edge stays clear of the card behind it.
PITCH = np.radians(5.0)


@dataclass(frozen=True)
class RunErrors:
    """Standard deviations of the errors of a run that the estimator does not know."""

    stiffness: float = 0.01  #: of a common factor on E and G.
    base_offset: float = 0.05e-3  #: of the base position, constant during the run, on each axis [m].
    base_repeat: float = 0.01e-3  #: of the base position at each pose, on each axis [m].
    bias_rate: float = WALK_STEPS  #: random walk of the bias, in steps of the sensor's resolution per √s.
    #: of base and sensor together about the base axes, constant during the run [rad], (3,). The poses do not contain
    #: it; the robot is taught at the object by feel, so the presses are as firm as without it.
    rotation: tuple[float, float, float] = (0.0, 0.0, 0.0)
    friction: float = ASSUMED_FRICTION  #: median friction coefficient μ of the edges; 0 is without friction.
    friction_spread: float = ASSUMED_SPREAD  #: standard deviation of ln μ from touch to touch.

    @classmethod
    def from_priors(
        cls, priors: Tolerances, friction: float = ASSUMED_FRICTION, friction_spread: float = ASSUMED_SPREAD
    ) -> "RunErrors":
        """Return the errors that the priors of a probe and of its base pose state, with the friction of the object."""
        tilt, clocking = math.radians(priors.tilt_deg), math.radians(priors.clocking_deg)
        return cls(priors.youngs_modulus, priors.base_mm * MM, priors.robot_mm * MM,
                   rotation=(tilt, tilt, clocking), friction=friction, friction_spread=friction_spread)  # fmt: skip


TARE_TIME = 4.0  #: Free time at the start [s], for a tare.
#: Durations of the move to the next object, of the approach and the retreat, and from one press to the next [s].
TRAVEL_TIME, APPROACH_TIME, STEP_TIME = 1.5, 1.0, 0.4
DWELL_TIME, FREE_TIME = 1.0, 2.0  #: Durations of the dwell at each press, and free before and after each touch [s].
#: Rates of sensor samples and of robot poses [Hz]. A Net F/T box sends 7000 samples; fewer make smaller files.
SAMPLE_RATE, POSE_RATE = 3500.0, 50.0
BLOCK_LENGTH = 200  #: Number of samples of a block.
STD_OFFSET_STEPS = 50.0  #: Standard deviation of the constant bias, in steps of the resolution.


@dataclass
class SimulatedTrajectory:
    """Trajectory of the base, linear between waypoints, with the wrench and the sensor bias at each of them."""

    R_world_base: Array  #: rotation of the base, which is constant, (3, 3).
    wrench_free: Array  #: wrench of the free probe at the base [N, N·m], (6,).
    rng: np.random.Generator  #: random numbers of the bias.
    bias_rate: float = WALK_STEPS  #: random walk of the bias, in steps of the sensor's resolution per √s.
    times: list[float] = field(default_factory=list)  #: times of the waypoints [s].
    positions: list[Array] = field(default_factory=list)  #: positions of the base reported by the robot [m], (3,) each.
    wrenches: list[Array] = field(default_factory=list)  #: wrenches of the probe at its base [N, N·m], (6,) each.
    biases: list[Array] = field(default_factory=list)  #: bias of the sensor, in steps of its resolution, (6,) each.

    def __post_init__(self) -> None:
        self._add(0.0, np.array([0.0, -0.2, 0.0]), self.wrench_free, np.zeros(6))
        self._add(TARE_TIME, self.positions[0], self.wrench_free, np.zeros(6))

    @property
    def end(self) -> float:
        """Time of the last waypoint [s]."""
        return self.times[-1]

    def go(self, seconds: float, p: Array, wrench_base: Array | None = None, dwell: float = 0.0) -> None:
        """Move the base in a straight line, and dwell.

        Args:
            seconds: duration of the move [s].
            p: position that the robot reports at its end [m], (3,).
            wrench_base: wrench of the probe there [N, N·m], (6,); that of the free probe if None.
            dwell: duration of the dwell [s].
        """
        wrench = self.wrench_free if wrench_base is None else wrench_base
        # The bias also walks during the dwell before the move; that part is added here.
        walk = self.rng.normal(0.0, self.bias_rate * math.sqrt(self.end - self.times[-2] + seconds), 6)
        self._add(self.end + seconds, p, wrench, self.biases[-1] + walk)
        if dwell:
            self._add(self.end + dwell, p, wrench, self.biases[-1])

    def poses(self) -> list[TimedPose]:
        """Return the poses that the robot reports."""
        time = self._sample_times(POSE_RATE)
        p = np.stack([np.interp(time, self.times, [p[i] for p in self.positions]) for i in range(3)], axis=1)
        q = pose_from_matrix(0.0, pose(self.R_world_base)).q
        return [TimedPose(t, tuple(at), q) for t, at in zip(time.tolist(), p.tolist(), strict=True)]

    def blocks(self, model: ProbeModel, rng: np.random.Generator) -> Iterator[Block]:
        """Yield single samples of the sensor: constant bias, random walk, white noise and finite resolution."""
        gravity = self.R_world_base.T @ np.array([0.0, 0.0, -9.81])
        step = model.noise.std * math.sqrt(model.averaging_samples)  # the noise of a sample is a step of the resolution
        time = self._sample_times(SAMPLE_RATE)
        wrench = model.to_sensor(self._interpolate(time, self.wrenches), gravity)
        offset = rng.normal(0.0, STD_OFFSET_STEPS, 6)
        steps = offset + self._interpolate(time, self.biases) + rng.standard_normal(wrench.shape)
        wrench = np.round(wrench / step + steps) * step
        for i in range(0, len(time), BLOCK_LENGTH):
            part = slice(i, i + BLOCK_LENGTH)
            yield Block(time[part], wrench[part], gravity, np.full(len(time[part]), np.nan))

    def _sample_times(self, rate: float) -> Array:
        return np.arange(0.0, self.end, 1.0 / rate)

    def _interpolate(self, time: Array, values: list[Array]) -> Array:
        columns = np.array(values)
        return np.stack([np.interp(time, self.times, columns[:, i]) for i in range(6)], axis=1)

    def _add(self, time: float, p: Array, wrench_base: Array, bias: Array) -> None:
        self.times.append(time)
        self.positions.append(p)
        self.wrenches.append(wrench_base)
        self.biases.append(bias)


@dataclass(frozen=True)
class TrueTouch:
    """Ground truth of one touch."""

    target: TouchTarget  #: the intended point.
    start: float  #: start, end: times between which the base presses [s].
    end: float
    p_world: Array  #: touched point of the card at rest, the mean over the poses [m], (3,).
    force: float  #: largest force [N].
    clearance: float  #: smallest distance between the probe beyond the contact and the card behind its edge [m].
    wrenches_base: Array  #: wrench at the base at each pose, without bias and noise [N, N·m], (k, 6).
    Ts_world_base: Array  #: poses reported by the robot, (k, 4, 4).
    friction: float  #: friction coefficient μ of this touch.
    friction_ratios: Array  #: tangential over normal force at each pose, (k,).


@dataclass(frozen=True)
class SimulatedRun:
    """A simulated run through the card house."""

    trajectory: SimulatedTrajectory  #: motion of the base, with the true wrench.
    touches: tuple[TrueTouch, ...]  #: ground truth, in order of time.
    wrench_free: Array  #: wrench of the free probe at the base [N, N·m], (6,).


TOUCHING = 0.75  #: Place along a curved probe whose tangent is that of a straight one, as a fraction of the length.


def base_rotation(pitch: float = PITCH, axis: Axis | None = None) -> Array:
    """Return R_world_base (3, 3) of a probe that touches along the world's y axis, pitched upwards.

    The x axis of a straight probe's base points down. A curved one comes from above, bent in a vertical plane, so that
    cards are pushed across that plane, where it is most sensitive.

    Args:
        pitch: of the probe [rad].
        axis: of a curved probe.
    """
    level = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]])
    if axis is not None:
        tangent = axis.frames([TOUCHING * axis.length])[0, :3, 2]
        aside = np.array([0.0, 0.0, 1.0]) - tangent[2] * tangent
        if np.linalg.norm(aside) > 1e-3:
            aside /= np.linalg.norm(aside)
            level = level[:, [2, 0, 1]] @ np.stack([tangent, aside, np.cross(tangent, aside)])
    c, s = np.cos(pitch), np.sin(pitch)
    return np.asarray(np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]]) @ level)


def simulate_run(
    model: ProbeModel, targets: Sequence[TouchTarget], rng: np.random.Generator, errors: RunErrors | None = None
) -> SimulatedRun:
    """Simulate touching the targets one after the other.

    Args:
        model: the probe as the estimator knows it.
        targets: points of a card house.
        rng: random numbers of the errors.
        errors: standard deviations of the unknown errors.

    Raises:
        InputError: the probe has no stable equilibrium, or misses an edge.
    """
    errors = errors or RunErrors()
    log_changes = np.zeros(BEFORE_KNOTS + len(model.rod.s))
    log_changes[0:2] = rng.normal(0.0, errors.stiffness)  # E and G
    offset = rng.normal(0.0, errors.base_offset, 3)
    # A separate random stream: all other draws are the same with and without a rotation error.
    rotation = Rotation.from_rotvec(rng.spawn(1)[0].normal(0.0, errors.rotation)).as_matrix()
    bench = _Bench(model.rod, perturbed_rod(model.rod, log_changes), base_rotation(axis=model.axis), rotation)
    free = bench.true_free.wrench_base
    trajectory = SimulatedTrajectory(bench.R_reported, free, rng, errors.bias_rate)
    friction_rng = rng.spawn(1)[0]
    touches = []
    for target in targets:
        friction = draw_friction(errors.friction, errors.friction_spread, friction_rng)
        touches.append(_touch(bench, trajectory, target, offset, errors.base_repeat, rng, friction))
    return SimulatedRun(trajectory, tuple(touches), free)


class _Bench:
    """The probe as designed and as it is, free and against an edge, on a base with a fixed rotation."""

    def __init__(self, rod: Rod, true_rod: Rod, R_reported: Array, rotation_error: Array) -> None:
        self.rod, self.true_rod = rod, true_rod
        self.R_reported, self.R = R_reported, R_reported @ rotation_error
        self.gravity = self.R.T @ np.array([0.0, 0.0, -9.81])
        self.free = self.rod.solve(self.gravity)
        self.true_free = true_rod.solve(self.gravity, mode="reference")

    def start(self, target: TouchTarget) -> Array:
        s = target.fraction * self.rod.length
        radius = float(self.rod.radius_at(s))
        return np.asarray(target.p_world - self.R @ self.free.p_at(s) - radius * target.direction)

    def press(self, target: TouchTarget, p_base: Array, friction: float, true: bool) -> StraightPress:
        """Return the press of the true or the designed probe onto an edge, from `CLEARANCE` before it."""
        clear = (p_base - self.start(target)) @ target.direction + CLEARANCE
        rod = self.true_rod if true else self.rod
        solver = CoulombSolver(rod, friction, "reference" if true else "fast", target.compliance)
        point, direction = self.R.T @ (target.p_world - p_base), self.R.T @ target.direction
        along = self.R.T @ target.card.along
        return StraightPress(solver, self.gravity, point + clear * direction, direction, along)

    def depths(self, target: TouchTarget, forces: Sequence[float], friction: float, offset: Array) -> list[float]:
        """Return how far the base goes beyond the expected first contact for forces on the designed probe [m].

        Where an offset of the base (3,) [m] would leave the light press without contact, all begin at the true one, as
        of a robot that stops at the first force.
        """
        press = self.press(target, self.start(target), friction, true=False)
        contact, depths = press.first_contact(CLEARANCE + _SEARCH_DEPTH), list[float]()
        _require_ok(target, contact.result)
        for force in forces:
            travel = press.travel_for(force, contact)
            contact = press.at(travel, contact)
            _require_ok(target, contact.result if contact.magnitude >= force else "unstable")
            depths.append(travel - CLEARANCE)
        press = self.press(target, self.start(target) + self.R @ offset, friction, true=True)
        contact = press.first_contact(CLEARANCE + 2.0 * _SEARCH_DEPTH)
        _require_ok(target, contact.result)
        late = press.travel_of(contact) - CLEARANCE - float(self.R @ offset @ target.direction)
        return [depth + late for depth in depths] if late > MAX_LATE * depths[0] else depths


def _require_ok(target: TouchTarget, result: str) -> None:
    if result != "ok":
        raise InputError(f"{target.card.name} at {target.fraction:.2f} of the length: {result}")


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
    trajectory.go(TRAVEL_TIME, ready, dwell=FREE_TIME)
    depths = bench.depths(target, (LIGHT_FORCE, FIRM_FORCE), friction, offset)
    commanded = [start + depth * target.direction for depth in depths * N_CYCLES]
    begin = trajectory.end
    p_true, contacts = list[Array](), list[CoulombContact]()
    for goal in commanded:
        p = goal + bench.R @ offset + rng.normal(0.0, base_repeat, 3)
        if not contacts:
            press = bench.press(target, p, friction, true=True)
            first = press.first_contact(float((press.start - bench.R.T @ (target.p_world - p)) @ press.direction))
            _require_ok(target, first.result)
            trajectory.go(0.5 * APPROACH_TIME, start + (press.travel_of(first) - CLEARANCE) * target.direction)
        contact = press.solver.advance(contacts[-1] if contacts else first, bench.R.T @ (target.p_world - p))
        _require_ok(target, contact.result)
        trajectory.go(STEP_TIME, goal, contact.equilibrium.wrench_base, DWELL_TIME)
        p_true.append(p)
        contacts.append(contact)
    trajectory.go(APPROACH_TIME, ready, dwell=FREE_TIME)
    wrenches = np.array([contact.equilibrium.wrench_base for contact in contacts])
    points = [p + bench.R @ contact.p_rest_base for p, contact in zip(p_true, contacts, strict=True)]
    return TrueTouch(
        target, begin, trajectory.end, np.mean(points, axis=0), max(contact.magnitude for contact in contacts),
        min(_clearance(bench, target, p, contact) for p, contact in zip(commanded, contacts, strict=True)),
        wrenches, np.array([pose(bench.R_reported, p) for p in commanded]),
        friction, np.array([contact.tangential_force / contact.normal_force for contact in contacts]),
    )  # fmt: skip


def _clearance(bench: _Bench, target: TouchTarget, p_base: Array, contact: CoulombContact) -> float:
    """Return the distance of the probe beyond the contact from the card, as far as the card reaches [m]."""
    rod = bench.true_rod
    s = np.linspace(contact.s, rod.length, 30)[1:]
    axis = p_base + np.array([bench.R @ contact.equilibrium.p_at(float(at)) for at in s])
    distance = (target.p_world - axis) @ target.direction - rod.radius_at(s)
    within = axis[:, 1] <= target.card.corners[:, 1].max()
    return float(distance[within].min()) if within.any() else np.inf


# files

CHUNK_SECONDS = 0.5  #: Source time between the chunks of a recording [s], as `live` flushes its recordings.
FILES = ("house.mcap", "poses.csv", "truth.csv")
TRUTH_COLUMNS = ("time_s", "x_world_mm", "y_world_mm", "z_world_mm", "fraction", "force_N", "again", "friction")


def check_run_files(folder: Path, force: bool, recording: str = FILES[0]) -> tuple[Path, ...]:
    """Return the files that `write_run` writes; call it before the simulation.

    Raises:
        InputError: one exists and `force` is not set.
    """
    paths = tuple(folder / name for name in (recording, *FILES[1:]))
    for path in paths:
        check_overwrite(path, force)
    return paths


def write_run(
    run: SimulatedRun,
    model: ProbeModel,
    folder: Path,
    rng: np.random.Generator,
    force: bool = False,
    recording: str = FILES[0],
    source: str = SOURCE,
) -> tuple[Path, ...]:
    """Write the recording and the poses, which `explore` reads, and the ground truth; return the paths.

    `rng` draws the noise of the sensor; `source` is what the recording states as its origin.

    Raises:
        InputError: files exist and `force` is not set, or they cannot be written.
    """
    paths = check_run_files(folder, force, recording)
    file = McapRecorder(paths[0], model, force=force, about={"source": source})
    try:
        flushed = 0.0
        for block in run.trajectory.blocks(model, rng):
            file.on_samples(block)
            # A chunk every half second, as `live` writes them: what is cut off later can be recovered.
            if block.time[-1] - flushed >= CHUNK_SECONDS:
                file.flush()
                flushed = float(block.time[-1])
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


def score(contact_map: ContactMap, recordings: Mapping[str, Path]) -> str:
    """Return how far the points of a map are from the truth beside its recordings, in one line; empty without truth.

    A point is compared with the true one of the touch that began when its first touch did.

    Args:
        contact_map: the map.
        recordings: recording of each probe by its name.
    """
    truth = {probe: recording.parent / FILES[2] for probe, recording in recordings.items()}
    if not truth or not contact_map.points or not all(path.is_file() for path in truth.values()):
        return ""
    tables = {probe: np.genfromtxt(path, delimiter=",", skip_header=1, ndmin=2) for probe, path in truth.items()}
    if not all(t.shape[1] == len(TRUTH_COLUMNS) and np.isfinite(t).all() for t in tables.values()):
        return ""
    inside, squares = 0, 0.0
    for point in contact_map.points:
        true = tables[point.touches[0].probe or next(iter(tables))]
        row = int(np.abs(true[:, 0] - point.touches[0].segment.start).argmin())
        error = point.p_world - true[row, 1:4] * MM
        inside += float(error @ np.linalg.solve(point.cov_world, error)) <= statistics.max_chi2(3, 0.05)
        squares += float(error @ error)
    n = len(contact_map.points)
    return (f"{inside} of {n} points lie inside their 95 % ellipsoids, {math.sqrt(squares / n) / MM:.2g} mm RMS from "
            "the simulated truth")  # fmt: skip


def _csv(columns: Sequence[str], rows: Iterable[Iterable[float]]) -> bytes:
    named = (dict(zip(columns, (round(number, 9) for number in row), strict=True)) for row in rows)
    return csv_tables.write(columns, named, "z.9g")
