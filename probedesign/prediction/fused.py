"""How well several fused touches of one point will locate it, over a grid of places, forces and sides."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from probedesign.estimation.equations import channels_of
from probedesign.frames import Array
from probedesign.prediction.fused_budget import FUSED_CAUSES, FusedBudget, Pressed, fused_budget_of
from probedesign.prediction.pressing import Pressing
from probedesign.prediction.quantile import radii_95
from probedesign.prediction.reach import ACCURACIES_MM
from probedesign.prediction.standing import Standing
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
        contact_fraction: s_contact over length.
        force_N: of the last touch; the others are even parts of it.
        direction: which way the object pushes.
        touches: how many.
        result: what `Estimator.fuse` would answer; "gives_way" and "out_of_range" as of the last touch.
        predicted_error_mm: RMS distance between true and estimated contact point as the estimator itself states it:
            noise, drift, robot, common stiffness and the base's place.
        predicted_error_95_mm: 95 % of the estimates lie within this distance, likewise.
        total_error_mm: RMS distance by all causes of `budget_mm` together.
        total_error_95_mm: 95 % of the estimates lie within this distance.
        budget_mm: RMS distance by each cause alone; their squares add up.
    """

    contact_fraction: float
    force_N: float
    direction: str
    touches: int
    result: str
    predicted_error_mm: float | None = None
    predicted_error_95_mm: float | None = None
    total_error_mm: float | None = None
    total_error_95_mm: float | None = None
    budget_mm: dict[str, float] | None = None


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
            np.array([c.total_error_mm for c in here], dtype=float),
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
            if (c.total_error_mm or 0.0) > (worst.total_error_mm or 0.0):
                found[c.contact_fraction] = c
    return [found[place] for place in sorted(found)]


def forces_of(pressing: Pressing, forces_N: Sequence[float]) -> set[float]:
    """Of every touch that presses up to these take."""
    return {force for greatest in forces_N for force in pressing.forces(greatest)}


def fused_conditions(
    lines: Sequence[Line], touches: Mapping[float, Touches], forces_N: Sequence[float], pressing: Pressing
) -> tuple[FusedCondition, ...]:
    """Of all lines, for each greatest force.

    Args:
        lines: the first of those that were touched.
        touches: by force, at least those of `forces_of`.
        forces_N: greatest forces.
        pressing: how the touches are made.
    """
    steps = {force: _Step(touches[force], pressing) for force in forces_of(pressing, forces_N)}
    found = [
        _at(lines, touches, [steps[f] for f in pressing.forces(force)], force, pressing) for force in forces_N
    ]
    places = list(dict.fromkeys(place for place, _ in lines))
    return tuple(c for place in places for at in found for c in at if c.contact_fraction == place)


class _Step:
    """One force's touches, those that there are made ready for the budget."""

    def __init__(self, touches: Touches, pressing: Pressing) -> None:
        model, held = touches.estimator.model, touches.contacts.ok
        self.row = np.where(held, np.cumsum(held) - 1, -1)
        self.pressed: Pressed | None = None
        if held.any():
            standing = Standing(model, model.gravity_base, touches.contacts.rows(held))
            channels = channels_of(model, pressing.moments_about)
            self.pressed = Pressed.of(standing, channels, touches.tolerances)


def _at(
    lines: Sequence[Line],
    touches: Mapping[float, Touches],
    steps: Sequence[_Step],
    force: float,
    pressing: Pressing,
) -> list[FusedCondition]:
    """All lines at one greatest force."""
    last = touches[force]
    held = np.flatnonzero((np.array([step.row[: len(lines)] for step in steps]) >= 0).all(axis=0))
    found = [FusedCondition(place, force, side, pressing.touches, "gives_way") for place, side in lines]
    if not len(held):
        return found
    series = [step.pressed.rows(step.row[held]) for step in steps if step.pressed is not None]
    model = last.estimator.model
    budget = fused_budget_of(series, model, last.tolerances, pressing)
    within = radii_95(budget.cov_told), radii_95(budget.total)
    for j, i in enumerate(held):
        result = _result(budget, j, float(last.sensor_use[i]), model.rod.length, pressing)
        found[i] = _told(found[i], result, budget, j, (within[0][j], within[1][j]))
    return found


def _result(budget: FusedBudget, j: int, use: float, length: float, pressing: Pressing) -> str:
    if use > 1.0:
        return "out_of_range"
    if math.sqrt(float(np.trace(budget.cov_fixed[j]))) < length / math.sqrt(12.0):
        return "ok"
    return "unobservable" if pressing.moments_about else "too_light"


def _told(
    condition: FusedCondition, result: str, budget: FusedBudget, j: int, within: tuple[Array, Array]
) -> FusedCondition:
    return replace(
        condition,
        result=result,
        predicted_error_mm=math.sqrt(float(np.trace(budget.cov_told[j]))) / MM,
        predicted_error_95_mm=float(within[0]) / MM,
        total_error_mm=math.sqrt(float(np.trace(budget.total[j]))) / MM,
        total_error_95_mm=float(within[1]) / MM,
        budget_mm=dict(zip(FUSED_CAUSES, (budget.rms[j] / MM).tolist(), strict=True)),
    )
