"""Monte Carlo check of a prediction: perturbed probes, noisy readings, and the real estimator.

Every error source of `ErrorSources` is drawn once per print sample: the rod itself, its root, its mount and gravity,
the gain of the sensor, the creep. Drawn for each touch are friction ratio, stiffness, noise, bias walk and robot error.
The truth is the fast rod, whose error is micrometres. The estimator starts cold, does not know the draw, and uses the
priors that it was drawn from. All conditions share the same print samples.
"""

import hashlib
import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from probedesign.core.errors import InputError
from probedesign.core.frames import Array, inverse, pose, wrench_map
from probedesign.core.parallel import process_map
from probedesign.core.statistics import max_chi2
from probedesign.core.units import MM
from probedesign.estimation.error_sources import BEFORE_KNOTS, parameters_of, turns_of
from probedesign.estimation.estimator import Estimator
from probedesign.estimation.model import ProbeModel, Tolerances
from probedesign.prediction.fused import FusedCondition, PressSchedule
from probedesign.prediction.predict import PRESSING, Condition, MonteCarloResult, Prediction
from probedesign.prediction.touches import SurfaceRod, angle_of
from probedesign.rod.equilibrium import Equilibrium
from probedesign.rod.kernels.surface_contact import POINT, VALUE
from probedesign.rod.rod import Rod

#: Sources that a single touch cannot distinguish: of fused touches the first grows, the second is drawn for each.
_PER_TOUCH = ("creep", "stiffness scatter")


@dataclass(frozen=True)
class PrintSample:
    """One perturbed probe with its mount and sensor."""

    model: ProbeModel  #: the nominal probe, which the estimator uses.
    rod: Rod  #: as printed, before it creeps.
    gravity: Array  #: in the true base frame [m/s²], (3,).
    gravity_in_model: Array  #: the same in the model's base frame.
    R: Array  #: rotation of the true base, (3, 3).
    translation: Array  #: of the true base [m], (3,).
    gain: Array  #: relative error of each channel of the sensor, (6,).
    creep: float  #: change of the logarithm of the stiffness at the last of several touches.
    tared: bool  #: whether the sensor was tared with this probe free.

    @classmethod
    def draw(cls, model: ProbeModel, tolerances: Tolerances, rng: np.random.Generator) -> "PrintSample":
        """Draw one sample from the priors."""
        gravity = model.gravity_base
        parameters, turns = np.zeros(BEFORE_KNOTS + len(model.rod.s)), np.zeros(9)
        for name, rows in parameters_of(model.rod, tolerances).items():
            z = rng.normal(size=len(rows))
            if name not in _PER_TOUCH:
                parameters += z @ rows
        for rows in turns_of(gravity, tolerances).values():
            turns += rng.normal(size=len(rows)) @ rows
        R = Rotation.from_rotvec(turns[3:6]).as_matrix()
        gravity_in_model = gravity + turns[6:9]
        rod = perturbed_rod(model.rod, parameters)
        base = float(rod.radius[0])
        root = rod.rigid_length + tolerances.root_radii * base * rng.normal()
        rod = replace(rod, rigid_length=min(max(root, -0.99 * base), 0.9 * rod.length))
        gain = tolerances.gain * rng.normal(size=6)
        creep = float(tolerances.creep * rng.normal())
        at_base = R.T @ gravity_in_model
        return cls(model, rod, at_base, gravity_in_model, R, turns[0:3], gain, creep, tolerances.tared)

    def press(
        self, fraction: float, phi: float, forces: Sequence[float], ratios: Array, log_stiffness: Array
    ) -> tuple[Array, Array]:
        """Press one point of the surface.

        Args:
            fraction: arclength of the touched section over the length.
            phi: angle around the section [rad].
            forces: normal forces, ascending [N], (k,).
            ratios: of friction, around and along, (k, 2).
            log_stiffness: change of the logarithm of the stiffness at each touch, beside the creep, (k,).

        Returns:
            Readings without noise and touched points, both in the model's base frame, (k, 6) and (k, 3); NaN from the
            force on at which the probe buckles.
        """
        k = len(forces)
        ramp = np.ones(1) if k == 1 else np.linspace(0.0, 1.0, k)
        wrenches, points = np.full((k, 6), np.nan), np.full((k, 3), np.nan)
        for j, force in enumerate(forces):
            # The sensor counts as tared with the changed stiffness, as in the error sources.
            factor = math.exp(ramp[j] * self.creep + log_stiffness[j])
            E, G = factor * self.rod.youngs_modulus, factor * self.rod.shear_modulus
            rod = replace(self.rod, youngs_modulus=E, shear_modulus=G)
            mass = replace(self.model, rod=rod).mass
            on = SurfaceRod(rod, self.gravity, mass, rod.solve(self.gravity))
            press = on.begin_press(fraction * on.rod.length, phi, ratios[j])
            if press.increase_to(float(force)) is None or press.lin is None:
                break
            wrenches[j] = self.reading(on.free, press.lin[0:6, VALUE])
            points[j] = self.R @ press.lin[POINT : POINT + 3, VALUE] + self.translation
        return wrenches, points

    def reading(self, free: Equilibrium, wrench: Array) -> Array:
        """Return the reading at the model's base, without noise, of a wrench (6,) at the true base."""
        model = self.model
        seen = self._in_nominal_frame(wrench)
        to_sensor, base_from_sensor = (wrench_map(model.T_sensor_base), wrench_map(inverse(model.T_sensor_base)))
        if self.tared:
            zero = self._in_nominal_frame(free.wrench_base)
            at = model.rod.solve(model.gravity_base).wrench_base
            change = seen - zero
            return np.asarray(at + change + base_from_sensor @ (self.gain * (to_sensor @ change)))
        hanging = base_from_sensor @ model.gravity_wrench_sensor(self.gravity_in_model - model.gravity_base)
        whole = seen + base_from_sensor @ model.gravity_wrench_sensor(self.gravity_in_model)
        return np.asarray(seen + hanging + base_from_sensor @ (self.gain * (to_sensor @ whole)))

    def _in_nominal_frame(self, wrench: Array) -> Array:
        force, moment = self.R @ wrench[0:3], self.R @ wrench[3:6]
        return np.concatenate([force, moment + np.cross(self.translation, force)])


@dataclass(frozen=True)
class PrintSamples:
    """Draws of everything that a prediction does not know, except noise."""

    model: ProbeModel  #: of the nominal probe.
    tolerances: Tolerances  #: standard deviations they were drawn with.
    samples: tuple[PrintSample, ...]  #: the draws.

    @classmethod
    def draw(cls, model: ProbeModel, tolerances: Tolerances, n: int, seed: int) -> "PrintSamples":
        """Draw n samples; the same seed gives the same samples."""
        rng = np.random.default_rng(seed)
        return cls(model, tolerances, tuple(PrintSample.draw(model, tolerances, rng) for _ in range(n)))

    def simulate_touches(
        self, fraction: float, phi: float, forces: Sequence[float], rng: np.random.Generator
    ) -> tuple[Array, Array]:
        """Press the same position of every sample, friction and stiffness drawn for each touch.

        Returns:
            Readings without noise and touched points in the model's base frame, (n, k, 6) and (n, k, 3); NaN where
            the probe buckles.
        """
        n, k = len(self.samples), len(forces)
        friction = self.model.friction if math.isfinite(self.model.friction) else 1.0
        ratios = friction * rng.normal(size=(n, k, 2))
        log_stiffness = self.tolerances.stiffness_scatter * rng.normal(size=(n, k))
        presses = [
            sample.press(fraction, phi, forces, of_touch, change)
            for sample, of_touch, change in zip(self.samples, ratios, log_stiffness, strict=True)
        ]
        wrenches, points = (np.array(part) for part in zip(*presses, strict=True))
        return wrenches, points

    def draw_noise(self, n: int, k: int, rng: np.random.Generator) -> Array:
        """Draw noise, bias since the tare and its walk for n presses of k readings, at the base, (n, k, 6)."""
        root = np.linalg.cholesky(self.model.noise_base())
        steps = np.full((1, k, 1), self.tolerances.walk_steps)
        steps[0, 0] = self.tolerances.drift_steps
        bias = math.sqrt(self.model.averaging_samples) * np.cumsum(steps * rng.normal(size=(n, k, 6)), axis=1)
        return np.asarray((rng.normal(size=(n, k, 6)) + bias) @ root.T)


def perturbed_rod(rod: Rod, by: Array) -> Rod:
    """Return a rod with changed logarithms of E, G, density, length and radii, and another curvature at rest.

    A longer rod keeps the shape of its axis.

    Args:
        rod: nominal.
        by: changes, as in `error_sources.parameters_of`, (6 + knots,).
    """
    E, G, density, length = np.exp(by[:4]).tolist()
    radius = rod.radius * np.exp(by[BEFORE_KNOTS:])
    rest = rod.rest_curvature
    if rest is not None or by[4:BEFORE_KNOTS].any():
        rest = (0.0 if rest is None else rest / length) + np.tile([*by[4:BEFORE_KNOTS], 0.0], (len(rod.s), 1))
    return replace(
        rod,
        s=rod.s * length,
        radius=radius,
        youngs_modulus=rod.youngs_modulus * E,
        shear_modulus=rod.shear_modulus * G,
        density=rod.density * density,
        rigid_length=rod.rigid_length * float(radius[0] / rod.radius[0]),
        rounded_from=None if rod.rounded_from is None else rod.rounded_from * length,
        rest_curvature=rest,
    )


#: Relative difference between Monte Carlo and first order that is flagged, beyond two standard errors.
MAX_DIFFERENCE = 0.10
MAX_DRAWS = 1_000_000
#: Results whose best candidate is counted; without "inconsistent" the draws would be selected by their error.
LOCATED_RESULTS = ("ok", "inconsistent")
Touch = tuple[float, float, str, int]  #: Contact fraction, force [N], direction, and number of fused touches.


@dataclass(frozen=True)
class MonteCarloPlan:
    """Everything that the results of a Monte Carlo run depend on."""

    model: ProbeModel  #: model, tolerances: of the probe.
    tolerances: Tolerances
    draws: int  #: print samples per condition.
    seed: int  #: of all random numbers.
    pressing: PressSchedule = PRESSING  #: how several touches are made.

    def __post_init__(self) -> None:
        """Raise InputError if the number of draws or the seed is out of range."""
        if not 2 <= self.draws <= MAX_DRAWS:
            raise InputError(f"--monte-carlo {self.draws} must lie in 2 ... {MAX_DRAWS} draws per condition")
        if self.seed < 0:
            raise InputError(f"--seed {self.seed} must not be negative")

    def samples(self) -> PrintSamples:
        """Draw the print samples, which all conditions share."""
        return PrintSamples.draw(self.model, self.tolerances, self.draws, self.seed)

    def sample_condition(self, touch: Touch, samples: PrintSamples) -> dict[str, Any]:
        """Return the summary of the errors of one condition over all samples."""
        key = json.dumps([self.seed, *(touch if touch[3] > 1 else touch[:3])]).encode()
        rng = np.random.default_rng(np.frombuffer(hashlib.sha256(key).digest(), dtype=np.uint32))
        fraction, force, direction, touches = touch
        schedule = self.pressing if touches > 1 else None
        results = locate_draws(samples, fraction, force, angle_of(direction), schedule, rng)
        errors = np.array([result.error for result in results if result.error is not None])
        located = [result for result in results if result.result == "ok"]
        counts = {"located": len(located), "inside": sum(result.inside for result in located)}
        if len(errors) < 2:
            return counts | {"error": None, "error_95": None, "standard_error": None}
        rms = float(np.sqrt((errors**2).mean()))
        # The standard error of an RMS is that of the mean square over twice the RMS.
        spread = float((errors**2).std(ddof=1) / math.sqrt(len(errors)) / (2.0 * max(rms, 1e-300)))
        return counts | {"error": rms, "error_95": float(np.quantile(errors, 0.95)), "standard_error": spread}


class DrawResult(NamedTuple):
    """Result of the estimator for one draw."""

    result: str  #: its code.
    #: distance of the best candidate from the true touched point [m]; None where no candidate is counted.
    error: float | None
    inside: bool = False  #: whether the true point lies in the estimator's 95 % ellipsoid.


def locate_draws(
    samples: PrintSamples, fraction: float, force: float, angle: float, schedule: PressSchedule | None,
    rng: np.random.Generator,
) -> list[DrawResult]:  # fmt: skip
    """Touch one position of every print sample and locate it with the real estimator.

    Args:
        samples: perturbed probes.
        fraction: arclength of the touched section over the length.
        force: normal force, that of the last touch [N].
        angle: direction in which the object pushes, about the tangent from the section's x axis [rad].
        schedule: how several touches are made; None: a single one.
        rng: of friction, stiffness scatter, noise, bias and robot.
    """
    forces = (force,) if schedule is None else schedule.forces(force)
    wrenches, points = samples.simulate_touches(fraction, angle + math.pi, forces, rng)
    n, k = wrenches.shape[:2]
    read = wrenches + samples.draw_noise(n, k, rng)
    estimator = Estimator(samples.model, samples.tolerances)
    if schedule is None:
        return [_located(estimator, read[i, 0], points[i, 0]) for i in range(n)]
    places = rng.normal(0.0, samples.tolerances.robot_mm * MM, (n, k, 3))
    # Of a reported rotation that is off, the tare in the same pose leaves little but the turn of the points.
    turns = Rotation.from_rotvec(rng.normal(0.0, math.radians(samples.tolerances.pose_deg), (n, 3)))
    places -= np.einsum("nij,nkj->nki", turns.as_matrix(), points)
    # The object yields by the force of the probe, whose weight is that of the model up to an error of its share.
    compliance = np.abs(rng.normal(0.0, samples.tolerances.object_compliance, n))
    pushes = wrenches[:, :, :3] - samples.model.mass * samples.model.gravity_base
    places -= compliance[:, None, None] * pushes
    return [_fused(estimator, schedule, read[i], places[i]) for i in range(n)]


def _located(estimator: Estimator, wrench: Array, point: Array) -> DrawResult:
    estimate = estimator.estimate(wrench)
    best = estimate.candidates[0] if estimate.candidates else None
    if best is None or estimate.result not in LOCATED_RESULTS:
        return DrawResult(estimate.result, None)
    error = best.p_surface_base - point
    return DrawResult(estimate.result, float(np.linalg.norm(error)), _contains(best.cov_surface_base, error))


def _fused(estimator: Estimator, schedule: PressSchedule, wrenches: Array, places: Array) -> DrawResult:
    if not np.isfinite(wrenches).all():
        return DrawResult("gives_way", None)
    fused = estimator.fuse(
        wrenches, [pose(p=point) for point in places], estimator.model.gravity_base,
        moments_only=schedule.moments_about is not None, moments_about=schedule.moments_about or "base",
    )  # fmt: skip
    if fused.result not in LOCATED_RESULTS or not len(fused.candidates_world):
        return DrawResult(fused.result, None)
    error = fused.p_surface_world if fused.ok else fused.candidates_world[0]
    inside = fused.ok and _contains(fused.cov_surface_world, error)
    return DrawResult(fused.result, float(np.linalg.norm(error)), inside)


def _contains(cov: Array, error: Array) -> bool:
    return bool(error @ np.linalg.lstsq(cov, error, rcond=1e-12)[0] <= max_chi2(3, 0.05))


def run_monte_carlo(
    plan: MonteCarloPlan,
    prediction: Prediction,
    progress: Callable[[float], None] = lambda share: None,
    workers: int | None = None,
    fused: Sequence[FusedCondition] = (),
) -> tuple[MonteCarloResult, ...]:
    """Sample every condition that is predicted to be located, and some fused ones.

    Args:
        plan: what to draw.
        prediction: of the same probe.
        progress: receives the completed fraction.
        workers: processes; all cores if None, only this one if 1.
        fused: conditions of fused touches; each draw takes some hundred times as long as for a single touch.

    Returns:
        Results of the sampled conditions.
    """
    conditions: tuple[Condition | FusedCondition, ...] = (*prediction.conditions, *fused)
    located = [condition for condition in conditions if condition.result == "ok"]
    touches = [(c.contact_fraction, c.force_N, c.direction, _touches(c)) for c in located]
    rows = dict[int, dict[str, Any]]()
    for i, row in process_map(_sample_in_worker, touches, workers, _initialize, (plan,), preload=[__name__]):
        rows[i] = row
        progress(len(rows) / len(touches))
    return tuple(_result(plan, condition, rows[i]) for i, condition in enumerate(located))


_worker_state: tuple[MonteCarloPlan, PrintSamples] | None = None  #: Plan and print samples of a worker process.


def _initialize(plan: MonteCarloPlan) -> None:
    global _worker_state
    _worker_state = plan, plan.samples()


def _sample_in_worker(touch: Touch) -> dict[str, Any]:
    assert _worker_state is not None, "the worker is initialised with its plan"
    plan, samples = _worker_state
    return plan.sample_condition(touch, samples)


def _result(plan: MonteCarloPlan, condition: Condition | FusedCondition, row: dict[str, Any]) -> MonteCarloResult:
    first, error = condition.predicted_error_mm, row["error"]
    differs = False
    if error is not None and first is not None:
        differs = abs(error / MM - first) > MAX_DIFFERENCE * first + 2.0 * row["standard_error"] / MM
    shown = {name: None if row[key] is None else row[key] / MM for name, key in
            (("error_mm", "error"), ("error_95_mm", "error_95"), ("standard_error_mm", "standard_error"))}  # fmt: skip
    return MonteCarloResult(
        condition.contact_fraction, condition.force_N, condition.direction, plan.draws, row["located"],
        first_order_mm=first, differs=differs, touches=_touches(condition), inside=row["inside"], **shown,
    )  # fmt: skip


def _touches(condition: Condition | FusedCondition) -> int:
    return condition.touches if isinstance(condition, FusedCondition) else 1
