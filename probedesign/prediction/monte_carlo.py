"""Monte Carlo of a prediction: probes that differ from their model, noisy readings, and the real estimator on them.

The truth is the fast rod, whose error is micrometres, with a force of any direction at a point of its surface; the
estimator starts cold, knows nothing of the draw, and counts the priors that it was drawn from. Every condition meets
the same worlds, so a few prints serve all.
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

from probedesign.core.parallel import process_map
from probedesign.errors import InputError
from probedesign.estimation.estimator import Estimator
from probedesign.estimation.model import ProbeModel
from probedesign.estimation.tolerances import Tolerances
from probedesign.files import write_atomically
from probedesign.frames import Array, pose
from probedesign.prediction.fused import FusedCondition
from probedesign.prediction.predict import PRESSING, Condition, Prediction
from probedesign.prediction.press_schedule import PressSchedule
from probedesign.prediction.sampled import Sampled
from probedesign.prediction.touches import DIRECTIONS
from probedesign.prediction.worlds import Worlds
from probedesign.statistics import max_chi2
from probedesign.units import MM

DIFFERS = 0.10
"""Share by which Monte Carlo and the first order must differ, beyond two of Monte Carlo's own standard errors."""
SAVE_EVERY_S = 2.0
MAX_DRAWS = 1_000_000
COUNTED = ("ok", "inconsistent")
"""Answers whose best place counts: also where the consistency test refuses it, else the errors would be those of the
luckier worlds."""
Touch = tuple[float, float, str, int]
"""Contact fraction, force [N], direction, and how many touches are fused."""


@dataclass(frozen=True)
class Plan:
    """One Monte Carlo: all that its answers depend on.

    Attributes:
        model, tolerances: of the probe.
        draws: worlds a condition.
        seed: of everything random.
        pressing: how several touches are made.
    """

    model: ProbeModel
    tolerances: Tolerances
    draws: int
    seed: int
    pressing: PressSchedule = PRESSING

    def __post_init__(self) -> None:
        """Raises InputError where the numbers make no sense."""
        if not 2 <= self.draws <= MAX_DRAWS:
            raise InputError(
                f"--monte-carlo {self.draws} must lie in 2 ... {MAX_DRAWS}, estimates of each condition"
            )
        if self.seed < 0:
            raise InputError(f"--seed {self.seed} must not be negative")

    def worlds(self) -> Worlds:
        """What every condition of the plan meets."""
        return Worlds.draw(self.model, self.tolerances, self.draws, self.seed)

    @property
    def key(self) -> str:
        """A hash of all of it, twelve characters."""
        model, rod = self.model, self.model.rod
        numbers = [*rod.body, rod.rigid_length, model.gravity_base, model.T_sensor_base, model.wrench_range,
                   model.noise.force, model.noise.moment, model.averaging_samples, model.hanging.mass,
                   model.hanging.p_com]  # fmt: skip
        told = json.dumps([[np.asarray(n, dtype=float).ravel().tolist() for n in numbers], rod.rounded_from,
                           rod.factors, asdict(self.tolerances), self.draws, self.seed,
                           asdict(self.pressing), model.friction, 3])  # fmt: skip
        return hashlib.sha256(told.encode()).hexdigest()[:12]

    def sample(self, touch: Touch, worlds: Worlds) -> dict[str, Any]:
        """Errors of one condition over all worlds."""
        key = json.dumps([self.seed, *(touch if touch[3] > 1 else touch[:3])]).encode()
        rng = np.random.default_rng(np.frombuffer(hashlib.sha256(key).digest(), dtype=np.uint32))
        fraction, force, direction, touches = touch
        schedule = self.pressing if touches > 1 else None
        answers = drawn_errors(worlds, fraction, force, DIRECTIONS[direction], schedule, rng)
        off = [answer.error for answer in answers if answer.error is not None]
        located = [answer for answer in answers if answer.result == "ok"]
        inside = sum(answer.inside for answer in located)
        return _summary(np.array(off), len(located)) | {"inside": inside}


class Answer(NamedTuple):
    """What the estimator made of one draw.

    Attributes:
        result: its code.
        error: distance of its best touched point from the true one [m]; None where nothing counts.
        inside: whether the true point lies in the 95 % ellipsoid that it states.
    """

    result: str
    error: float | None
    inside: bool = False


def drawn_errors(
    worlds: Worlds,
    fraction: float,
    force: float,
    angle: float,
    schedule: PressSchedule | None,
    rng: np.random.Generator,
) -> list[Answer]:
    """Touch one place of every world and locate it by the real estimator.

    Args:
        worlds: drawn probes.
        fraction: arclength of the touched section over the length.
        force: normal force, that of the last touch [N].
        angle: direction in which the object pushes, about the tangent from the section's x axis [rad].
        schedule: how several touches are made; None: a single one.
        rng: of friction, stiffness scatter, noise, bias and robot.
    """
    forces = (force,) if schedule is None else schedule.forces(force)
    wrenches, points = worlds.touched(fraction, angle + math.pi, forces, rng)
    n, k = wrenches.shape[:2]
    read = wrenches + worlds.noise(n, k, rng)
    estimator = Estimator(worlds.model, worlds.tolerances)
    if schedule is None:
        return [_located(estimator, read[i, 0], points[i, 0]) for i in range(n)]
    places = -points + worlds.robot(n, k, rng)
    return [_fused(estimator, schedule, read[i], places[i]) for i in range(n)]


def _located(estimator: Estimator, wrench: Array, point: Array) -> Answer:
    found = estimator.estimate(wrench)
    best = found.candidates[0] if found.candidates else None
    if best is None or found.result not in COUNTED:
        return Answer(found.result, None)
    off = best.p_surface_base - point
    return Answer(found.result, float(np.linalg.norm(off)), _holds(best.cov_surface_base, off))


def _fused(estimator: Estimator, schedule: PressSchedule, wrenches: Array, places: Array) -> Answer:
    """Of one point, which is the world's origin."""
    if not np.isfinite(wrenches).all():
        return Answer("gives_way", None)
    found = estimator.fuse(
        wrenches, [pose(p=place) for place in places], estimator.model.gravity_base,
        moments_only=schedule.moments_about is not None, moments_about=schedule.moments_about or "base",
    )  # fmt: skip
    if found.result not in COUNTED or not len(found.candidates_world):
        return Answer(found.result, None)
    off = found.candidates_world[0]
    return Answer(found.result, float(np.linalg.norm(off)), found.ok and _holds(found.cov_surface_world, off))


def _holds(cov: Array, off: Array) -> bool:
    """Whether a 95 % ellipsoid holds a point that is so far from its centre."""
    return bool(off @ np.linalg.lstsq(cov, off, rcond=1e-12)[0] <= max_chi2(3, 0.05))


def sample(
    plan: Plan,
    prediction: Prediction,
    folder: Path | None,
    progress: Callable[[float], None] = lambda share: None,
    workers: int | None = None,
    fused: Sequence[FusedCondition] = (),
) -> tuple[Sampled, ...]:
    """Run a Monte Carlo of every condition that is expected to be located, and of some fused ones.

    Args:
        plan: what to draw.
        prediction: of the same probe.
        folder: where what is done is kept, so that an interrupted run goes on; nowhere if None.
        progress: told the share done.
        workers: processes; all cores if None, this one alone if 1.
        fused: conditions of fused touches; each draw takes some hundred times as long as a single touch's.

    Returns:
        What came of each condition.

    Raises:
        InputError: what was kept cannot be read.
        KeyboardInterrupt: with where to go on from.
    """
    path = None if folder is None else folder / f"monte-carlo-{plan.key}.json"
    conditions: tuple[Condition | FusedCondition, ...] = (*prediction.conditions, *fused)
    wanted = {_name(touch): touch for touch in map(_touch, conditions) if touch}
    done = {name: row for name, row in _kept(path).items() if name in wanted}
    left, saved = {name: touch for name, touch in wanted.items() if name not in done}, time.monotonic()
    try:
        names = list(left)
        for i, row in process_map(_sample_there, left.values(), workers, _begin, (plan,), preload=[__name__]):
            done[names[i]] = row
            progress(len(done) / max(len(wanted), 1))
            if path and time.monotonic() - saved > SAVE_EVERY_S:
                _keep(path, done)
                saved = time.monotonic()
    except KeyboardInterrupt:
        kept = f"; {len(done)} of {len(wanted)} conditions are kept, the same command goes on" if path else ""
        raise KeyboardInterrupt(f"interrupted{kept}") from None
    finally:
        if path and done:
            _keep(path, done)
    return tuple(_sampled(plan, c, done[name]) for c in conditions if (name := _name(_touch(c))) in done)


_here: tuple[Plan, Worlds] | None = None
"""Of a worker process."""


def _begin(plan: Plan) -> None:
    """Make a worker ready."""
    global _here
    _here = plan, plan.worlds()


def _sample_there(touch: Touch) -> dict[str, Any]:
    assert _here is not None, "a worker begins with its plan"
    plan, worlds = _here
    return plan.sample(touch, worlds)


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


def _sampled(plan: Plan, condition: Condition | FusedCondition, row: dict[str, Any]) -> Sampled:
    first, error = condition.predicted_error_mm, row["error"]
    differs = False
    if error is not None and first is not None:
        differs = abs(error / MM - first) > DIFFERS * first + 2.0 * row["standard_error"] / MM
    shown = {name: None if row[key] is None else row[key] / MM for name, key in
            (("error_mm", "error"), ("error_95_mm", "error_95"), ("standard_error_mm", "standard_error"))}  # fmt: skip
    return Sampled(condition.contact_fraction, condition.force_N, condition.direction, plan.draws, row["located"],
                   first_order_mm=first, differs=differs, touches=_touches(condition), inside=row["inside"],
                   **shown)  # fmt: skip


def _touch(condition: Condition | FusedCondition) -> Touch | None:
    """Of a condition that is expected to be located."""
    if condition.result != "ok":
        return None
    return condition.contact_fraction, condition.force_N, condition.direction, _touches(condition)


def _touches(condition: Condition | FusedCondition) -> int:
    return condition.touches if isinstance(condition, FusedCondition) else 1


def _name(touch: Touch | None) -> str:
    return json.dumps(touch)


def _kept(path: Path | None) -> dict[str, dict[str, Any]]:
    """What an earlier run left.

    Raises:
        InputError: it is no such file.
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
        raise InputError(f"{path}: is not what a Monte Carlo left; remove it to begin anew") from None
    return dict(found)


def _keep(path: Path, done: dict[str, dict[str, Any]]) -> None:
    write_atomically(
        path, (json.dumps({"schema": 1, "unit": "m", "conditions": done}, indent=0) + "\n").encode()
    )
