"""The chain of `live` where the sensor drifts and the base moves, with a truth that the estimator does not use.

Payload: twenty minutes with thirty touches by an arm that turns to another orientation before each, with 3 g on the
sensor that the frozen probe does not know, before and after `calibrate` from twelve rests.

Drift: twenty minutes with thirty touches of 5 to 25 mN, a bias that warms up, leaps or creeps beside its random walk,
and the rod solved in reference mode. Motion: a free probe is moved by 100 mm; drawn probes are pressed on an object and
dragged over it. The sway is that of the modes of a beam (`tests/reference/beam.py`), free and held at the object.
"""

import math
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, replace

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, Slerp

from benchmarks.error_statistics import CHI2_95, nees
from benchmarks.reference_probes import Perturbations, PriorStds
from benchmarks.reference_touches import evaluate_readings
from benchmarks.timing import print_table
from benchmarks.touches import paper_models
from probedesign.core.frames import Array, rotation_under_gravity
from probedesign.core.units import MM
from probedesign.estimation.bias import WALK_STEPS
from probedesign.estimation.estimator import Estimator
from probedesign.estimation.model import ProbeModel, Tolerances
from probedesign.geometry.mass import MassProperties, combined
from probedesign.live.blocks import Block
from probedesign.live.poses.base_poses import BasePoses, TimedPose
from probedesign.live.processing.chain import Chain, ProcessingOptions
from probedesign.live.processing.estimates import EstimateUpdate
from probedesign.live.processing.payload import Rest, calibrate
from probedesign.live.processing.tare import TareWindow
from probedesign.rod.contact import RodContact, solve_surface_force
from tests.reference.beam import SwayingBeam
from tests.reference.cosserat import solve

# Drift ---------------------------------------------------------------------------------------------------------------

RATE = 1000.0  #: Of the samples [Hz].
TOUCHES, PERIOD, BEGIN, DWELL = 30, 40.0, 20.0, 15.0  #: Number, and times within a period [s].
BLOCK_S = 1.0  #: Duration of a block [s].
RAMP = 0.3  #: Time in which the force of a touch grows and vanishes [s].
TARE = TareWindow(0.0, 3.0)
#: Ranges of the place over the length and of the force [N].
PLACES, FORCES = (0.6, 0.85), (5e-3, 25e-3)


def _warm_up(t: Array, steps: Array) -> Array:
    return 50e-3 * (1.0 - np.exp(-t / 120.0))[:, None] * np.array([1.0, -0.5, 0.7, 4e-3, 3e-3, -2e-3])


def _leaps(t: Array, steps: Array) -> Array:
    """Return leaps of 5 mN each 200 s in Fx, Fy and Fz in turn, 15 s after a touch has begun its period."""
    bias = np.zeros((len(t), 6))
    for k in range(6):
        bias[t >= 210.0 + 200.0 * k, k % 3] += 5e-3
    return bias


def _ramp(t: Array, steps: Array) -> Array:
    return t[:, None] * 200.0 / 3600.0 * steps * np.array([1.0, -1.0, 1.0, 1.0, -1.0, 1.0])


DRIFTS: dict[str, Callable[[Array, Array], Array]] = {
    "random walk alone": lambda t, steps: np.zeros((len(t), 6)),
    "warm-up by 50 mN with 120 s": _warm_up,
    "leaps of 5 mN in Fx, Fy, Fz": _leaps,
    "ramp of 200 steps an hour": _ramp,
}


@dataclass(frozen=True)
class DriftOutcome:
    """What a chain made of the twenty minutes."""

    located: int  #: number of touches that were located.
    inside: int  #: number of those within their 95 % ellipsoid.
    false_touches: int  #: number of touches where there was none.
    false_ok: int  #: number of rows with a position while nothing touched.
    warming: int  #: number of rows `warming_up`.


def drift_outcome(
    model: ProbeModel, drift: Callable[[Array, Array], Array], seed: int = 1, truth: ProbeModel | None = None
) -> DriftOutcome:
    """Simulate the touches with a drift of the bias and return the outcome.

    Args:
        model: of the chain.
        drift: of the bias.
        seed: of the touches and the noise.
        truth: of an arm that turns before each touch; None: the base is at rest, and `model` is right.
    """
    rng = np.random.default_rng(seed)
    steps = model.noise.std * math.sqrt(model.averaging_samples)
    touches = list[tuple[float, RodContact]]()
    arm = None if truth is None else Arm.drawn(truth, rng)
    for k in range(TOUCHES):
        gravity = model.gravity_base if arm is None else arm.gravity(PERIOD * k + BEGIN)
        solved = solve_surface_force(
            model.rod, gravity, float(rng.uniform(*PLACES)) * model.rod.length,
            float(rng.uniform(-math.pi, math.pi)), float(rng.uniform(*FORCES)), (0.0, 0.0), "reference",
        )  # fmt: skip
        touches.append((PERIOD * k + BEGIN, solved))
    chain = Chain(Estimator(model), ProcessingOptions(TARE, None, rate=10.0 if arm is None else 2.0),
                  None if arm is None else arm.poses, lambda line: None)  # fmt: skip
    false_ok = warming = 0
    for block in _drifting(truth or model, arm, touches, drift, steps, rng):
        for update in chain.process(block):
            t = update.reading.time
            touched = any(begin - 0.1 <= t <= begin + DWELL + 0.1 for begin, _ in touches)
            false_ok += update.estimate.ok and not touched
            warming += update.estimate.result == "warming_up"
    located = inside = 0
    used = set[int]()
    for begin, solved in touches:
        mine = [c for c in chain.contacts if begin - 0.1 <= c.start < begin + DWELL]
        used |= {c.number for c in mine}
        estimate, fused = (mine[-1].estimate, mine[-1].fused) if mine else (None, None)
        if estimate is not None and estimate.ok:
            located += 1
            error = estimate.p_surface_base - solved.p_surface_base
            inside += nees(error, estimate.cov_surface_base, 1e-5) <= CHI2_95
        elif arm is not None and fused is not None and fused.ok:  # a touch too light for one reading
            located += 1
            error = fused.p_surface_world - arm.turns(float(_turned(np.array(begin)))).apply(solved.p_surface_base)
            inside += nees(error - HEIGHT, fused.cov_surface_world, 1e-5) <= CHI2_95
    false_touches = len({c.number for c in chain.contacts} - used)
    return DriftOutcome(located, inside, false_touches, false_ok, warming)


def _drifting(
    model: ProbeModel, arm: "Arm | None", touches: list[tuple[float, RodContact]],
    drift: Callable[[Array, Array], Array], steps: Array, rng: np.random.Generator,
) -> Iterator[Block]:  # fmt: skip
    rate = RATE if arm is None else RATE_OF_ARM
    walked, n = np.zeros(6), int(BLOCK_S * rate)
    free, gravity = model.rod.solve(model.gravity_base, mode="reference").wrench_base, model.gravity_base
    for k in range(int(TOUCHES * PERIOD / BLOCK_S)):
        t = (k * n + np.arange(n)) / rate
        if arm is not None and k % round(PERIOD / BLOCK_S) >= TURN / BLOCK_S:
            gravity = arm.gravity(float(t[0]))
            free = model.rod.solve(gravity, mode="reference").wrench_base
        wrench = np.tile(free, (n, 1))
        for begin, solved in touches:
            share = np.clip(np.minimum(t - begin, begin + DWELL - t) / RAMP, 0.0, 1.0)[:, None]
            wrench += share * (solved.equilibrium.wrench_base - free)
        walk = walked + WALK_STEPS / math.sqrt(rate) * np.cumsum(rng.standard_normal((n, 6)), axis=0)
        walked = walk[-1]
        read = model.to_sensor(wrench, gravity)
        if arm is not None and k % round(PERIOD / BLOCK_S) < TURN / BLOCK_S:
            knots = np.linspace(t[0], t[0] + BLOCK_S, TURN_STEPS + 1)
            turning = np.array([arm.free(at) for at in knots])
            read = np.stack([np.interp(t, knots, turning[:, i]) for i in range(6)], axis=1)
        read += drift(t, steps)
        yield Block(t, read + steps * (walk + rng.standard_normal((n, 6))), model.gravity_base, np.full(n, math.nan))


def report_drift(model: ProbeModel) -> None:
    """Print the table of a sensor that drifts."""
    rows = []
    for name, drift in DRIFTS.items():
        o = drift_outcome(model, drift)
        rows.append([name, f"{o.located} of {TOUCHES}", f"{o.inside}", f"{3.0 * o.false_touches:g}", f"{o.false_ok}",
                     f"{o.warming}"])  # fmt: skip
    print_table("Twenty minutes with one tare, single touches of 5 to 25 mN",
                ["bias", "located", "in 95 %", "false touches an hour", "false ok rows", "warming_up rows"],
                rows)  # fmt: skip


# Payload -------------------------------------------------------------------------------------------------------------

RATE_OF_ARM = 200.0  #: Of the samples [Hz].
TURN, TURN_STEPS = 5.0, 20  #: Duration of a turn [s], and knots between which its readings are linear, in a second.
UNKNOWN = MassProperties(0.0, 3e-3, np.array([4e-3, -3e-3, 35e-3]), np.zeros((3, 3)))  #: In the sensor frame.
HEIGHT = np.array([0.0, 0.0, 0.5])  #: Origin of the base in the world [m].
WORLD_GRAVITY = np.array([0.0, 0.0, -9.81])


@dataclass(frozen=True)
class Arm:
    """Orientations of a base that turns at the start of each period, and a probe that does not sway."""

    truth: ProbeModel  #: with what really hangs on the sensor.
    turns: Slerp  #: orientation by the number of the touch.
    poses: BasePoses  #: of the base.

    @classmethod
    def drawn(cls, truth: ProbeModel, rng: np.random.Generator) -> "Arm":
        """Return an arm whose orientations differ by some 60 degrees."""
        level = Rotation.from_matrix(rotation_under_gravity(truth.gravity_base))
        turns = Slerp(
            np.arange(TOUCHES), level * Rotation.from_rotvec(rng.normal(size=(TOUCHES, 3)) * math.radians(35.0))
        )
        t = np.arange(-0.02, TOUCHES * PERIOD + 0.04, 0.02)
        q = turns(_turned(t)).as_quat().tolist()
        stated = [TimedPose(at, tuple(HEIGHT.tolist()), tuple(each)) for at, each in zip(t.tolist(), q, strict=True)]
        return cls(truth, turns, BasePoses("stated", stated, gravity_world=WORLD_GRAVITY))

    def gravity(self, time: float) -> Array:
        """Return gravity in base axes [m/s²], (3,)."""
        return np.asarray(self.turns(float(_turned(np.array(time)))).inv().apply(WORLD_GRAVITY), dtype=float)

    def free(self, time: float) -> Array:
        """Return the reading of the free probe without noise and bias, (6,), with the inertia of every section."""
        gravity, rod, h = self.gravity(time), self.truth.rod, 1e-3
        R0, R, R1 = (self.turns(float(_turned(np.array(time + dt)))).as_matrix() for dt in (-h, 0.0, h))
        turning = R.T @ (R1 - 2.0 * R + R0) / h**2  # of a point p of the base: its acceleration in base axes
        eq = rod.solve(gravity)
        share = np.gradient(eq.s) * rod.radius_at(eq.s) ** 2
        loads = -(self.truth.mass * share / share.sum())[:, None] * (eq.p_base @ turning.T)
        inertia = np.concatenate([loads.sum(axis=0), np.cross(eq.p_base, loads).sum(axis=0)])
        payload, T = self.truth.payload, self.truth.T_sensor_base
        at = T[:3, :3].T @ (payload.p_com - T[:3, 3])
        load = -payload.mass * T[:3, :3] @ turning @ at
        read = self.truth.to_sensor(eq.wrench_base + inertia, gravity)
        return read + np.concatenate([load, np.cross(payload.p_com, load)])


def _turned(t: Array) -> Array:
    """Return the number of the orientation at a time [s], with a minimum-jerk turn before each but the first."""
    k = np.clip(np.floor(t / PERIOD), 0, TOUCHES - 1)
    share = jerk_limited(TURN)(t - PERIOD * k)
    return np.asarray(np.maximum(k - 1.0 + share, 0.0), dtype=float)


def calibrated(model: ProbeModel, truth: ProbeModel, seed: int = 1) -> ProbeModel:
    """Return the model after a calibration from twelve rests, five seconds apart."""
    rng = np.random.default_rng(seed)
    std, walk = model.noise.std / 3.0, np.zeros(6)
    step, rests = model.noise.std * math.sqrt(model.averaging_samples), list[Rest]()
    for i, R in enumerate(Rotation.random(12, rng=rng).as_matrix()):
        walk = walk + WALK_STEPS * math.sqrt(5.0) * step * rng.standard_normal(6)
        gravity = R.T @ WORLD_GRAVITY
        read = truth.to_sensor(truth.rod.solve(gravity, mode="reference").wrench_base, gravity)
        rests.append(Rest(5.0 * i, read + walk + std * rng.standard_normal(6), std, R))
    return calibrate(model, rests, WORLD_GRAVITY).calibrated()


def report_payload(model: ProbeModel) -> None:
    """Print the table of an arm with an unknown payload."""
    truth, rows = replace(model, payload=combined([model.payload, UNKNOWN])), []
    for name, known in (("3 g unknown", model), ("after calibration", calibrated(model, truth))):
        o = drift_outcome(known, DRIFTS["random walk alone"], truth=truth)
        rows.append([name, f"{o.located} of {TOUCHES}", f"{o.inside}", f"{3.0 * o.false_touches:g}", f"{o.false_ok}"])
    print_table("Twenty minutes with one tare, an arm that turns before each touch of 5 to 25 mN",
                ["payload", "located", "in 95 %", "false touches an hour", "false ok rows"], rows)  # fmt: skip


# Motion --------------------------------------------------------------------------------------------------------------

SAMPLES_HZ, POSES_HZ = 2000.0, 125.0  #: Rates of samples and poses.
POSE_NOISE = 5e-6  #: Standard deviation of a reported position on each axis [m].
DISTANCE, PAUSE, MOVES = 0.1, 1.5, 11  #: Length of a move [m], pause after it [s], and their number.
ALONG = np.array([0.6, 0.64, 0.48])  #: Direction of the moves in base axes.
DAMPINGS = (0.05, 0.1)
SEEDS = (1, 2, 3)  #: Of the moves.


def jerk_limited(duration: float) -> Callable[[Array], Array]:
    """Return the position over the distance of a minimum-jerk move of that duration, by the time since its start."""

    def position(t: Array) -> Array:
        x = np.clip(t / duration, 0.0, 1.0)
        return x**3 * (10.0 - 15.0 * x + 6.0 * x**2)

    return position


def trapezoid(speed: float, acceleration: float, distance: float = DISTANCE) -> Callable[[Array], Array]:
    """Return the same of a move with constant accelerations [m/s, m/s²]."""
    speed = min(speed, math.sqrt(acceleration * distance))
    ramp = speed / acceleration
    total = distance / speed + ramp

    def position(t: Array) -> Array:
        t = np.clip(t, 0.0, total)
        up, down = np.minimum(t, ramp), np.maximum(t - total + ramp, 0.0)
        return (0.5 * acceleration * (up**2 - down**2) + speed * np.maximum(t - ramp, 0.0)) / distance

    return position


def base_readings(
    model: ProbeModel, path: Array, wrench: Array, damping: float, rng: np.random.Generator,
    held: tuple[int, float] | None = None,
) -> Array:  # fmt: skip
    """Return readings of the sensor (n, 6) while the base travels without turning.

    Args:
        model: probe and sensor.
        path: of the base at each sample [m], (n, 3).
        wrench: quasi-static one at the base, (n, 6).
        damping: ratio of every mode.
        rng: of the noise.
        held: sample at which the probe hits an object, and the arclength there [m]; None: it stays free.
    """
    v = np.gradient(path, 1.0 / SAMPLES_HZ, axis=0)
    a = np.gradient(v, 1.0 / SAMPLES_HZ, axis=0)
    free, dynamic = SwayingBeam.of(model.rod), np.zeros((len(a), 6))
    for axis, sign in ((0, 1.0), (1, -1.0)):
        load = free.base_load(a[:, axis], SAMPLES_HZ, damping)
        if held is not None:
            at, s = held
            load[at:] = SwayingBeam.of(model.rod, s).base_load(a[at:, axis], SAMPLES_HZ, damping, float(v[at, axis]))
        dynamic[:, axis], dynamic[:, 4 - axis] = load[:, 0], sign * load[:, 1]
    dynamic[:, 2] = -float(free.rigid[0]) * a[:, 2]
    read = model.to_sensor(wrench + dynamic, np.zeros(3)) + (model.gravity_base - a) @ model.payload_by_gravity.T
    steps = model.noise.std * math.sqrt(model.averaging_samples)
    return np.asarray(read + steps * rng.standard_normal(read.shape))


def run_chain(
    model: ProbeModel, path: Array, read: Array, rng: np.random.Generator
) -> tuple[list[EstimateUpdate], Chain]:
    """Return what the chain gives for the readings, with poses of the base that scatter about a path (n, 3)."""
    t, every = np.arange(len(path)) / SAMPLES_HZ, int(SAMPLES_HZ / POSES_HZ)
    p = path[::every] + POSE_NOISE * rng.standard_normal((len(path[::every]), 3))
    stated = [
        TimedPose(at, tuple(x), (0.0, 0.0, 0.0, 1.0)) for at, x in zip(t[::every].tolist(), p.tolist(), strict=True)
    ]
    poses = BasePoses("stated", stated, gravity_world=model.gravity_base)
    chain = Chain(Estimator(model), ProcessingOptions(TARE, None), poses, lambda line: None)
    updates = list[EstimateUpdate]()
    for i in range(0, len(t), 100):
        part = slice(i, i + 100)
        updates += chain.process(Block(t[part], read[part], model.gravity_base, np.full(len(t[part]), math.nan)))
    return updates, chain


@dataclass(frozen=True)
class MoveOutcome:
    """What a chain made of moves of a free probe."""

    touches: int  #: number of touches.
    ok: int  #: number of rows with a position from one reading.
    fused: int  #: number of rows with a fused position.
    unexplained: int  #: number of rows `in_motion`.
    rows: int  #: number of rows.


def move_outcome(model: ProbeModel, position: Callable[[Array], Array], damping: float, seed: int = 1) -> MoveOutcome:
    """Move a free probe there and back and return the outcome."""
    rng = np.random.default_rng(seed)
    duration = float(np.argmax(position(np.arange(0.0, 20.0, 0.01)) >= 1.0)) * 0.01 + PAUSE
    t = np.arange(int((TARE.end + 1.0 + MOVES * duration) * SAMPLES_HZ)) / SAMPLES_HZ - TARE.end - 1.0
    n = np.clip(np.floor(t / duration), 0, MOVES - 1)
    share = position(t - n * duration)
    travel = DISTANCE * np.where(n % 2 == 0, share, 1.0 - share)
    free = model.rod.solve(model.gravity_base, mode="reference").wrench_base
    path = travel[:, None] * ALONG
    read = base_readings(model, path, np.tile(free, (len(t), 1)), damping, rng)
    updates, chain = run_chain(model, path, read, rng)
    results = Counter(u.estimate.result for u in updates)
    fused = sum(u.fused is not None and u.fused.ok for u in updates)
    return MoveOutcome(len(chain.contacts), results["ok"], fused, results["in_motion"], len(updates))


def report_moves(model: ProbeModel) -> None:
    """Print the table of a free probe that is moved."""
    moves: dict[str, Callable[[Array], Array]] = {
        f"minimum jerk, {duration:g} s": jerk_limited(duration) for duration in (0.5, 1.0, 2.0, 4.0)
    }
    for speed, acceleration in ((0.01, 0.5), (0.05, 2.0), (0.1, 2.0)):
        moves[f"{1e3 * speed:.0f} mm/s, {acceleration:g} m/s²"] = trapezoid(speed, acceleration)
    rows = []
    for damping in DAMPINGS:
        for name, position in moves.items():
            m = [move_outcome(model, position, damping, seed) for seed in SEEDS]
            touches, ok, fused, unexplained, n = (
                sum(getattr(x, field.name) for x in m) for field in fields(MoveOutcome)
            )
            rows.append([name, f"{damping:g}", f"{touches}", f"{ok}", f"{fused}", f"{unexplained} of {n}"])
    print_table(f"{MOVES} moves of {1e3 * DISTANCE:.0f} mm of a free probe, {len(SEEDS)} times",
                ["move", "damping", "false touches", "false ok rows", "false fused", "in_motion rows"],
                rows)  # fmt: skip


# Touches of drawn probes ----------------------------------------------------------------------------------------------

KNOTS = 9  #: Of the path of a base that touches; places and wrenches between them are cubic splines.
AWAY = 0.04  #: Length of the straight approach [m].
BEFORE = 0.05  #: Time before the stop at which a position of the moving base counts [s].
DRAWS = 40, 10  #: Probes drawn for each drag, and for each press.


@dataclass(frozen=True)
class Contact:
    """A touch of the world's origin by a probe that its model does not know exactly, while the base moves on."""

    true: Array  #: true, stated: positions of the base, and as the robot states them [m], (KNOTS, 3).
    stated: Array
    wrench: Array  #: quasi-static, at the base [N, N·m], (KNOTS, 6); the first one is that of the free probe.
    s: float  #: arclength in the middle [m].


def drawn_contacts(model: ProbeModel, n: int, start: float, slide: float, newtons: float, seed: int) -> list[Contact]:
    """Draw probes, mounts, sensors and friction from their priors, and touch with each.

    Args:
        model: as designed.
        n: number of probes.
        start, slide: place where the touch begins, and how far it slides to one end, over the length.
        newtons: normal force at the end; it grows in proportion to the slide.
        seed: of the draws.
    """
    rng = np.random.default_rng(seed)
    perturbations = Perturbations.of(model, PriorStds.of(model), KNOTS)
    z = perturbations.draw(n, rng)
    z[:, perturbations.slots["drift"]] = 0.0  # the bias walks during the run instead
    samples = perturbations.samples(z)
    free, phi, ratios = samples.free_wrench(), rng.uniform(-math.pi, math.pi, n), rng.normal(size=(n, 2))
    push = np.column_stack([np.ones(n), model.friction * ratios])
    towards = np.sign(ratios[:, 1])  # the object pulls the place along
    stated = Tolerances.of(model)  # of the pose as the robot states it, beside `samples.robot`
    turned = Rotation.from_rotvec(np.deg2rad(stated.pose_deg * rng.normal(size=(n, 3)))).as_matrix()
    shifted = MM * stated.base_mm * rng.normal(size=(n, 1, 3))
    true, wrenches, ok = np.empty((n, KNOTS, 3)), np.empty((n, KNOTS, 6)), np.ones(n, dtype=bool)
    for k, share in enumerate(np.linspace(0.0, 1.0, KNOTS)):
        s = (start + share * slide * towards) * samples.probes.length
        touch = solve(samples.at_touch(k), samples.gravity, s, phi, share * newtons * push, axes="surface", loads=3)
        reading = evaluate_readings(samples, z, touch, free, k, columns=False)
        yielded = samples.compliance[:, None] * np.einsum("nij,nj->ni", samples.R, touch.force)
        true[:, k] = -np.einsum("nij,nj->ni", turned, reading.point + yielded)
        wrenches[:, k], ok = reading.wrench, ok & touch.ok
    middle = (start + 0.5 * slide * towards) * model.rod.length
    read = true - samples.robot - shifted
    return [Contact(true[i], read[i], wrenches[i], float(middle[i])) for i in np.flatnonzero(ok)]


@dataclass(frozen=True)
class Located:
    """Fused points of a touch in motion."""

    #: errors [m], and whether they are within the ellipsoid: `BEFORE` the stop, at the first reading after it from
    #: which positions are given throughout, and after four seconds; None without a position.
    moving: tuple[float, bool] | None
    first: tuple[float, bool] | None
    rest: tuple[float, bool] | None
    after: float  #: time of the first one after the stop [s]; NaN if there is none.


def contact_outcome(model: ProbeModel, contact: Contact, speed: float, damping: float, seed: int) -> Located:
    """Approach straight on at a speed [m/s], touch, stop with 2 m/s² at the last knot, and return the outcome."""
    rng, knots = np.random.default_rng(seed), np.linspace(0.0, 1.0, KNOTS)
    true, stated, quasi_static = (CubicSpline(knots, x) for x in (contact.true, contact.stated, contact.wrench))
    fine = np.linspace(0.0, 1.0, 401)
    arclength = CubicSpline(fine, np.linalg.norm(true(fine, 1), axis=1)).antiderivative()(fine)
    share = CubicSpline(arclength, fine)
    distance = AWAY + float(arclength[-1])
    stop, towards = distance / speed + speed / 2.0, true(0.0, 1) / np.linalg.norm(true(0.0, 1))
    t = np.arange(int((TARE.end + 1.0 + stop + 4.0) * SAMPLES_HZ)) / SAMPLES_HZ - TARE.end - 1.0
    travel = distance * trapezoid(speed, 2.0, distance)(t) - AWAY
    at, before = share(np.clip(travel, 0.0, arclength[-1])), np.minimum(travel, 0.0)[:, None] * towards
    hit = int(np.argmax(travel > 0.0))
    read = base_readings(model, true(at) + before, quasi_static(at), damping, rng, (hit, contact.s))
    walk = WALK_STEPS / math.sqrt(SAMPLES_HZ) * np.cumsum(rng.standard_normal(read.shape), axis=0)
    read += model.noise.std * math.sqrt(model.averaging_samples) * walk
    updates, _ = run_chain(model, stated(at) + before, read, rng)
    end, moving, rows = TARE.end + 1.0 + stop, None, list[tuple[float, tuple[float, bool]]]()
    for update in updates:
        fused, since, row = update.fused, update.reading.time - end, None
        if fused is not None and fused.ok:
            error = fused.p_surface_world
            row = float(np.linalg.norm(error)), nees(error, fused.cov_surface_world, 1e-5) <= CHI2_95
        if since < -BEFORE:
            moving = row
        elif row is None or since < 0.0:
            rows.clear()
        else:
            rows.append((since, row))
    if not rows:
        return Located(moving, None, None, math.nan)
    return Located(moving, rows[0][1], rows[-1][1], rows[0][0])


def _cells(found: list[tuple[float, bool] | None], others: list[tuple[float, bool] | None]) -> list[str]:
    """Return the number of positions, their RMS error, that over another one of the same draws, and those in 95 %."""
    both = [(a, b) for a, b in zip(found, others, strict=True) if a is not None and b is not None]
    if not both:
        return ["0", "", "", ""]
    rms, other = (math.sqrt(sum(x[0] ** 2 for x in pair) / len(both)) for pair in zip(*both, strict=True))
    inside = sum(a[1] for a, _ in both) / len(both)
    return [f"{len(both)} of {len(found)}", f"{1e3 * rms:.2f} mm", f"{rms / other:.2f}", f"{100.0 * inside:.0f} %"]


def report_contacts(model: ProbeModel, seed: int = 1) -> None:
    """Print the table of touches by probes that are drawn."""
    rows = []
    for speed, slide in ((0.02, 0.2), (0.02, 0.0), (0.05, 0.0), (0.1, 0.0)):
        contacts = drawn_contacts(model, DRAWS[slide == 0.0], 0.7, slide, 15e-3, seed)
        name = "dragged by 30 mm" if slide else "pressed"
        for damping in DAMPINGS:
            found = [contact_outcome(model, c, speed, damping, seed + i) for i, c in enumerate(contacts)]
            rest = [x.rest for x in found]
            after = sorted(x.after for x in found)
            rows.append([f"{name}, {1e3 * speed:.0f} mm/s", f"{damping:g}", *_cells([x.moving for x in found], rest),
                         f"{after[len(after) // 2]:.2f} to {after[int(0.95 * len(after))]:.2f} s",
                         *_cells([x.first for x in found], rest), *_cells(rest, rest)[1::2]])  # fmt: skip
    columns = ["positions", "RMS error", "over rest", "in 95 %"]
    print_table("Touches at 0.7 L up to 15 mN by drawn probes: moving, stopped (median to 95 %), 4 s later",
                ["touch", "damping", *columns, "after the stop", *columns, "RMS error", "in 95 %"], rows)  # fmt: skip


def report(only: str | None = None) -> None:
    """Print the tables.

    Args:
        only: "payload", "drift", "moves" or "touches" prints that table alone.
    """
    tables = {"payload": report_payload, "drift": report_drift, "moves": report_moves, "touches": report_contacts}
    for name, table in tables.items():
        if only in (None, name):
            table(paper_models()["large"])
