"""Monte Carlo check of a prediction: perturbed probes, noisy readings, and the real estimator.

The truth is the fast rod, whose error is micrometres, with a force of any direction at a point of its surface. The
estimator starts cold, does not know the draw, and uses the priors that it was drawn from. All conditions share the same
print samples.
"""

import hashlib
import json
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from probedesign.core.errors import InputError
from probedesign.core.files import write_atomically
from probedesign.core.frames import Array, pose
from probedesign.core.parallel import process_map
from probedesign.core.statistics import max_chi2
from probedesign.core.units import MM
from probedesign.estimation.estimator import Estimator
from probedesign.estimation.model import ProbeModel
from probedesign.estimation.tolerances import Tolerances
from probedesign.prediction.fused import FusedCondition, PressSchedule
from probedesign.prediction.predict import PRESSING, Condition, MonteCarloResult, Prediction
from probedesign.prediction.print_samples import PrintSamples
from probedesign.prediction.touches import DIRECTIONS

MAX_DIFFERENCE = 0.10
"""Relative difference between Monte Carlo and first order that is flagged, beyond two standard errors of Monte
Carlo."""
SAVE_EVERY_S = 2.0
MAX_DRAWS = 1_000_000
LOCATED_RESULTS = ("ok", "inconsistent")
"""Results whose best candidate is counted. "inconsistent" is included: without it the errors would be those of the
draws
that pass the consistency test."""
Touch = tuple[float, float, str, int]
"""Contact fraction, force [N], direction, and number of fused touches."""


@dataclass(frozen=True)
class MonteCarloPlan:
    """Everything that the results of a Monte Carlo run depend on.

    Attributes:
        model, tolerances: of the probe.
        draws: print samples per condition.
        seed: of all random numbers.
        pressing: how several touches are made.
    """

    model: ProbeModel
    tolerances: Tolerances
    draws: int
    seed: int
    pressing: PressSchedule = PRESSING

    def __post_init__(self) -> None:
        """Raises InputError for a number of draws or a seed out of range."""
        if not 2 <= self.draws <= MAX_DRAWS:
            raise InputError(f"--monte-carlo {self.draws} must lie in 2 ... {MAX_DRAWS} draws per condition")
        if self.seed < 0:
            raise InputError(f"--seed {self.seed} must not be negative")

    def samples(self) -> PrintSamples:
        """Draw the print samples, which all conditions share."""
        return PrintSamples.draw(self.model, self.tolerances, self.draws, self.seed)

    @property
    def key(self) -> str:
        """Hash of the plan, twelve hex digits."""
        model, rod = self.model, self.model.rod
        numbers = [*rod.body, rod.rigid_length, model.gravity_base, model.T_sensor_base, model.wrench_range,
                   *((model.noise.force, model.noise.moment) if model.noise.is_isotropic else model.noise.cov),
                   model.averaging_samples, model.payload.mass, model.payload.p_com]  # fmt: skip
        text = json.dumps([[np.asarray(n, dtype=float).ravel().tolist() for n in numbers], rod.rounded_from,
                           rod.factors, asdict(self.tolerances), self.draws, self.seed,
                           asdict(self.pressing), model.friction, 3])  # fmt: skip
        return hashlib.sha256(text.encode()).hexdigest()[:12]

    def sample_condition(self, touch: Touch, samples: PrintSamples) -> dict[str, Any]:
        """Return the summary of the errors of one condition over all samples."""
        key = json.dumps([self.seed, *(touch if touch[3] > 1 else touch[:3])]).encode()
        rng = np.random.default_rng(np.frombuffer(hashlib.sha256(key).digest(), dtype=np.uint32))
        fraction, force, direction, touches = touch
        schedule = self.pressing if touches > 1 else None
        results = locate_draws(samples, fraction, force, DIRECTIONS[direction], schedule, rng)
        off = [result.error for result in results if result.error is not None]
        located = [result for result in results if result.result == "ok"]
        inside = sum(result.inside for result in located)
        return _summary(np.array(off), len(located)) | {"inside": inside}


class DrawResult(NamedTuple):
    """Result of the estimator for one draw.

    Attributes:
        result: its code.
        error: distance of the best candidate from the true touched point [m]; None where no candidate is counted.
        inside: whether the true point lies in the estimator's 95 % ellipsoid.
    """

    result: str
    error: float | None
    inside: bool = False


def locate_draws(
    samples: PrintSamples,
    fraction: float,
    force: float,
    angle: float,
    schedule: PressSchedule | None,
    rng: np.random.Generator,
) -> list[DrawResult]:
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
    places = -points + samples.draw_robot_error(n, k, rng)
    return [_fused(estimator, schedule, read[i], places[i]) for i in range(n)]


def _located(estimator: Estimator, wrench: Array, point: Array) -> DrawResult:
    found = estimator.estimate(wrench)
    best = found.candidates[0] if found.candidates else None
    if best is None or found.result not in LOCATED_RESULTS:
        return DrawResult(found.result, None)
    off = best.p_surface_base - point
    return DrawResult(found.result, float(np.linalg.norm(off)), _contains(best.cov_surface_base, off))


def _fused(estimator: Estimator, schedule: PressSchedule, wrenches: Array, places: Array) -> DrawResult:
    """Locate one point, which is the world's origin, from several touches."""
    if not np.isfinite(wrenches).all():
        return DrawResult("gives_way", None)
    found = estimator.fuse(
        wrenches, [pose(p=place) for place in places], estimator.model.gravity_base,
        moments_only=schedule.moments_about is not None, moments_about=schedule.moments_about or "base",
    )  # fmt: skip
    if found.result not in LOCATED_RESULTS or not len(found.candidates_world):
        return DrawResult(found.result, None)
    off = found.candidates_world[0]
    return DrawResult(
        found.result, float(np.linalg.norm(off)), found.ok and _contains(found.cov_surface_world, off)
    )


def _contains(cov: Array, off: Array) -> bool:
    """Return whether the 95 % ellipsoid of a covariance contains an offset from its centre."""
    return bool(off @ np.linalg.lstsq(cov, off, rcond=1e-12)[0] <= max_chi2(3, 0.05))


def run_monte_carlo(
    plan: MonteCarloPlan,
    prediction: Prediction,
    folder: Path | None,
    progress: Callable[[float], None] = lambda share: None,
    workers: int | None = None,
    fused: Sequence[FusedCondition] = (),
) -> tuple[MonteCarloResult, ...]:
    """Sample every condition that is predicted to be located, and some fused ones.

    Args:
        plan: what to draw.
        prediction: of the same probe.
        folder: for the checkpoint, with which an interrupted run resumes; None: no checkpoint.
        progress: receives the completed fraction.
        workers: processes; all cores if None, only this one if 1.
        fused: conditions of fused touches; each draw takes some hundred times as long as for a single touch.

    Returns:
        Results of the sampled conditions.

    Raises:
        InputError: the checkpoint cannot be read.
        KeyboardInterrupt: with the number of completed conditions.
    """
    path = None if folder is None else folder / f"monte-carlo-{plan.key}.json"
    conditions: tuple[Condition | FusedCondition, ...] = (*prediction.conditions, *fused)
    wanted = {_name(touch): touch for touch in map(_touch, conditions) if touch}
    done = {name: row for name, row in _load_checkpoint(path).items() if name in wanted}
    left, saved = {name: touch for name, touch in wanted.items() if name not in done}, time.monotonic()
    try:
        names = list(left)
        for i, row in process_map(
            _sample_in_worker, left.values(), workers, _initialize, (plan,), preload=[__name__]
        ):
            done[names[i]] = row
            progress(len(done) / max(len(wanted), 1))
            if path and time.monotonic() - saved > SAVE_EVERY_S:
                _save_checkpoint(path, done)
                saved = time.monotonic()
    except KeyboardInterrupt:
        kept = (
            f"; {len(done)} of {len(wanted)} conditions are saved, the same command resumes" if path else ""
        )
        raise KeyboardInterrupt(f"interrupted{kept}") from None
    finally:
        if path and done:
            _save_checkpoint(path, done)
    return tuple(_result(plan, c, done[name]) for c in conditions if (name := _name(_touch(c))) in done)


_worker_state: tuple[MonteCarloPlan, PrintSamples] | None = None
"""Plan and print samples of a worker process."""


def _initialize(plan: MonteCarloPlan) -> None:
    """Draw the print samples of a worker process."""
    global _worker_state
    _worker_state = plan, plan.samples()


def _sample_in_worker(touch: Touch) -> dict[str, Any]:
    assert _worker_state is not None, "the worker is initialised with its plan"
    plan, samples = _worker_state
    return plan.sample_condition(touch, samples)


def _summary(off: np.ndarray[Any, Any], located: int) -> dict[str, Any]:
    if len(off) < 2:
        return {"located": located, "error": None, "error_95": None, "standard_error": None}
    rms = float(np.sqrt((off**2).mean()))
    spread = float((off**2).std(ddof=1) / math.sqrt(len(off)) / (2.0 * max(rms, 1e-300)))
    return {
        "located": located,
        "error": rms,
        "error_95": float(np.quantile(off, 0.95)),
        "standard_error": spread,
    }


def _result(
    plan: MonteCarloPlan, condition: Condition | FusedCondition, row: dict[str, Any]
) -> MonteCarloResult:
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


def _touch(condition: Condition | FusedCondition) -> Touch | None:
    """Return the touch of a condition that is predicted to be located; None for others."""
    if condition.result != "ok":
        return None
    return condition.contact_fraction, condition.force_N, condition.direction, _touches(condition)


def _touches(condition: Condition | FusedCondition) -> int:
    return condition.touches if isinstance(condition, FusedCondition) else 1


def _name(touch: Touch | None) -> str:
    return json.dumps(touch)


def _load_checkpoint(path: Path | None) -> dict[str, dict[str, Any]]:
    """Return the conditions that an earlier run completed.

    Raises:
        InputError: the file is not a checkpoint.
    """
    if path is None or not path.exists():
        return {}
    try:
        found = json.loads(path.read_bytes())["conditions"]
        for row in found.values():
            _ = (
                int(row["located"]),
                int(row["inside"]),
                *(float(row[k] or 0.0) for k in ("error", "error_95", "standard_error")),
            )
    except (OSError, ValueError, TypeError, KeyError, AttributeError):
        raise InputError(f"{path}: is not a Monte Carlo checkpoint; remove it to start again") from None
    return dict(found)


def _save_checkpoint(path: Path, done: dict[str, dict[str, Any]]) -> None:
    write_atomically(
        path, (json.dumps({"schema": 1, "unit": "m", "conditions": done}, indent=0) + "\n").encode()
    )
