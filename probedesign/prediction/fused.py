"""How well several fused touches of one point will locate it, over a grid of places, forces and sides."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from probedesign.estimation.fusion import BETTER_THAN_NOTHING
from probedesign.frames import Array
from probedesign.prediction.fused_budget import FUSED_CAUSES, FusedBudget, ModelPress
from probedesign.prediction.press_schedule import PressSchedule
from probedesign.prediction.quantile import radius_95
from probedesign.prediction.reach import ACCURACIES_MM
from probedesign.prediction.touches import Touches
from probedesign.units import MM

SHOWN_N = 0.005
"""Greatest force at which fused touches are shown: too light for a single one to say much."""
Line = tuple[float, str]
"""Contact fraction and direction."""


@dataclass(frozen=True)
class FusedCondition:
    """Several touches of one point, pressed on. Numbers that do not exist are None.

    Attributes:
        contact_fraction: arclength of the touched section over length.
        force_N: of the last touch; the others are even parts of it.
        direction: which way the object pushes.
        touches: how many.
        result: what `Estimator.fuse` would answer; "gives_way" and "out_of_range" as of the last touch.
        predicted_error_mm: RMS distance between true and estimated contact point, the touched point of the surface in
            the world, by all causes of `budget_mm` together, as the estimator states it.
        predicted_error_95_mm: 95 % of the estimates lie within this distance.
        noise_error_mm: RMS distance by the sensor's noise and the prior on friction where all else is exactly known.
        noise_error_95_mm: 95 % of the estimates lie within this distance, likewise.
        budget_mm: RMS distance by each cause; their squares add up to that of predicted_error_mm.
        total_error_mm, total_error_95_mm: the predicted errors under their former names.
    """

    contact_fraction: float
    force_N: float
    direction: str
    touches: int
    result: str
    predicted_error_mm: float | None = None
    predicted_error_95_mm: float | None = None
    noise_error_mm: float | None = None
    noise_error_95_mm: float | None = None
    budget_mm: dict[str, float] | None = None
    total_error_mm: float | None = None
    total_error_95_mm: float | None = None


@dataclass(frozen=True)
class FusedReach:
    """Greatest force from which fused touches of one place are so well located, all causes counted: straight in
    logarithms between the forces of the grid; None where no force of the grid does. The lightest force of the grid
    where that is enough already.
    """

    contact_fraction: float
    direction: str
    force_mN_for_1_mm: float | None
    force_mN_for_2_mm: float | None
    force_mN_for_5_mm: float | None


def fused_reach(conditions: Sequence[FusedCondition]) -> tuple[FusedReach, ...]:
    """Along the probe."""
    lines = dict.fromkeys((c.contact_fraction, c.direction) for c in conditions)
    found = []
    for line in lines:
        here = sorted((c for c in conditions if (c.contact_fraction, c.direction) == line and c.result == "ok"),
                      key=lambda c: c.force_N)  # fmt: skip
        forces, errors = (
            np.array([c.force_N for c in here]),
            np.array([c.predicted_error_mm for c in here], dtype=float),
        )
        found.append(FusedReach(*line, *(_needed(forces, errors, accuracy) for accuracy in ACCURACIES_MM)))
    return tuple(found)


def _needed(forces: Array, errors: Array, accuracy_mm: float) -> float | None:
    """[mN]"""
    enough = np.flatnonzero(errors <= accuracy_mm)
    if not len(enough):
        return None
    j = int(enough[0])
    if j == 0:
        return 1e3 * float(forces[0])
    x, y = np.log(forces[j - 1 : j + 1]), np.log(errors[j - 1 : j + 1])
    return 1e3 * float(np.exp(np.interp(-np.log(accuracy_mm), -y, x)))


def shown(conditions: Sequence[FusedCondition], force_N: float = SHOWN_N) -> list[FusedCondition]:
    """One a place, at the force nearest to that: the worst of the located directions."""
    nearest = min((c.force_N for c in conditions), key=lambda force: abs(force - force_N), default=0.0)
    found: dict[float, FusedCondition] = {}
    for c in conditions:
        if c.force_N == nearest and c.result == "ok":
            worst = found.setdefault(c.contact_fraction, c)
            if (c.predicted_error_mm or 0.0) > (worst.predicted_error_mm or 0.0):
                found[c.contact_fraction] = c
    return [found[place] for place in sorted(found)]


def forces_of(schedule: PressSchedule, forces_N: Sequence[float]) -> set[float]:
    """Of every touch that presses up to these take."""
    return {force for greatest in forces_N for force in schedule.forces(greatest)}


def fused_conditions(
    lines: Sequence[Line],
    touches: Mapping[float, Touches],
    forces_N: Sequence[float],
    schedule: PressSchedule,
) -> tuple[FusedCondition, ...]:
    """Of all lines, for each greatest force.

    Args:
        lines: the first of those that were touched.
        touches: by force, at least those of `forces_of`.
        forces_N: greatest forces.
        schedule: how the touches are made.
    """
    places = list(dict.fromkeys(place for place, _ in lines))
    return tuple(
        fused_condition(line, [touches[f] for f in schedule.forces(force)], i, force, schedule)
        for place in places
        for force in forces_N
        for i, line in enumerate(lines)
        if line[0] == place
    )


def fused_condition(
    line: Line, touches: Sequence[Touches], i: int, force: float, schedule: PressSchedule
) -> FusedCondition:
    """One condition.

    Args:
        line: which.
        touches: of it, in the order of time; i: its row in them.
        force: of the last.
        schedule: how they are made.
    """
    found = FusedCondition(line[0], force, line[1], schedule.touches, "gives_way")
    if not all(of.ok[i] for of in touches):
        return found
    last = touches[-1]
    estimator = last.estimator
    press = ModelPress(estimator.model, estimator.priors, estimator.model.gravity_base,
                       np.array([of.touch[i] for of in touches]), schedule)  # fmt: skip
    if not press.held:
        return found
    budget = press.split()
    result = _result(budget, float(last.sensor_use[i]), estimator.model.rod.length, schedule)
    if result != "ok":
        return replace(found, result=result)
    error, within = _mm(budget.total)
    noise, noise_within = _mm(budget.cov_noise)
    return replace(
        found,
        result=result,
        predicted_error_mm=error,
        predicted_error_95_mm=within,
        noise_error_mm=noise,
        noise_error_95_mm=noise_within,
        budget_mm=dict(zip(FUSED_CAUSES, (budget.rms / MM).tolist(), strict=True)),
        total_error_mm=error,
        total_error_95_mm=within,
    )


def _mm(cov: Array) -> tuple[float, float]:
    """RMS and 95 % distance of a covariance."""
    return math.sqrt(max(float(np.trace(cov)), 0.0)) / MM, radius_95(cov) / MM


def _result(budget: FusedBudget, sensor_use: float, length: float, schedule: PressSchedule) -> str:
    """What the estimator answers: better than no reading at all or nothing."""
    if sensor_use > 1.0:
        return "out_of_range"
    rms = math.sqrt(max(float(np.trace(budget.total)), 0.0))
    if rms < length * BETTER_THAN_NOTHING:
        return "ok"
    return "unobservable" if schedule.moments_about else "too_light"
