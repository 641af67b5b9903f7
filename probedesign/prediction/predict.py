"""How well a probe will feel, before it is printed: sensitivity, detection, saturation, localisation error."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from probedesign.estimation.estimator import Estimator
from probedesign.estimation.model import ProbeModel
from probedesign.estimation.tolerances import Tolerances
from probedesign.prediction.budget import CAUSES
from probedesign.prediction.fused import FusedCondition, FusedReach, forces_of, fused_conditions, fused_reach
from probedesign.prediction.press_schedule import PressSchedule
from probedesign.prediction.reach import LADDER_N, Reach, reach_of
from probedesign.prediction.sampled import Sampled
from probedesign.prediction.touches import DIRECTIONS, Touches, check_grid, touches_of
from probedesign.prediction.workspace import Workspace, workspace_of
from probedesign.units import MM

__all__ = [
    "DIRECTIONS",
    "PRESSING",
    "Condition",
    "Detection",
    "Prediction",
    "predict",
    "predict_touch",
    "tip_sag_mm",
]

FRACTIONS = tuple(round(0.1 * k, 1) for k in range(1, 11))
FORCES_N = (0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2)
PRESSING, NO_WORKSPACE = PressSchedule(), Workspace()
_WEAK_N = 1e-6  # a push so light that everything answers in proportion


@dataclass(frozen=True)
class Condition:
    """One touch and what it will give. Numbers that do not exist are None.

    Attributes:
        contact_fraction: arclength of the touched section over length.
        force_N: how hard the object pushes, normal to the surface.
        direction: which way it pushes, a key of `DIRECTIONS`.
        result: what the estimator would answer; "ok" is a located contact. "gives_way": the probe cannot
            push back so hard.
        predicted_error_mm: RMS distance between true and estimated contact point, the touched point of the surface,
            by all causes of `budget_mm` together.
        predicted_error_95_mm: 95 % of the estimates lie within this distance.
        noise_error_mm: RMS distance by the sensor's noise and the prior on friction where all else is exactly known.
        noise_error_95_mm: 95 % of the estimates lie within this distance, likewise.
        std_s_mm: standard deviation of s_contact, by all causes.
        deflection_mm: how far the contact point moved from where the free probe had it.
        moment_per_N_Nmm, force_per_N_N: change of the base's moment and force per newton more.
        moment_per_mm_Nmm, force_per_mm_N: the same per millimetre of pressing on at the same s.
        sensor_use: largest share of a channel's range that the reading takes.
        budget_mm: RMS distance by each cause; their squares add up to that of predicted_error_mm.
        total_error_mm, total_error_95_mm: the predicted errors under their former names.
    """

    contact_fraction: float
    force_N: float
    direction: str
    result: str
    predicted_error_mm: float | None = None
    predicted_error_95_mm: float | None = None
    noise_error_mm: float | None = None
    noise_error_95_mm: float | None = None
    std_s_mm: float | None = None
    deflection_mm: float | None = None
    moment_per_N_Nmm: float | None = None
    force_per_N_N: float | None = None
    moment_per_mm_Nmm: float | None = None
    force_per_mm_N: float | None = None
    sensor_use: float | None = None
    budget_mm: dict[str, float] | None = None
    total_error_mm: float | None = None
    total_error_95_mm: float | None = None


@dataclass(frozen=True)
class Detection:
    """Force that one reading detects with probability one half, at one place from one side, noise and drift counted
    (`Estimator.detectable`); None where the probe does not hold as much."""

    contact_fraction: float
    direction: str
    detectable_force_mN: float | None


@dataclass(frozen=True)
class Prediction:
    """What a probe will feel.

    Attributes:
        name, fingerprint: of the probe.
        assumptions: what of the design is assumed; the numbers rest on it.
        mass_g: of the flexible part.
        tip_sag_mm: how far gravity alone moves the tip.
        noise_force_mN, noise_moment_Nmm: standard deviation of a reading's channels that was counted with.
        friction: prior standard deviation of tangential over normal force; None where the direction is free.
        conditions: the grid.
        detection: along the probe.
        reach: what a touch costs the object, along the probe.
        tolerances: how well the probe is known, standard deviations, and where each number comes from.
        fused: the same grid, each point touched several times and fused.
        fused_reach: force that they take for a wanted accuracy, along the probe.
        pressing: how they are made.
        workspace: where the contact point can be, the base standing still.
        monte_carlo: of the conditions that are located; empty if none was run.
    """

    name: str
    fingerprint: str
    assumptions: tuple[str, ...]
    mass_g: float
    tip_sag_mm: float | None
    noise_force_mN: float
    noise_moment_Nmm: float
    friction: float | None
    conditions: tuple[Condition, ...]
    detection: tuple[Detection, ...]
    reach: tuple[Reach, ...]
    tolerances: Tolerances
    fused: tuple[FusedCondition, ...] = ()
    fused_reach: tuple[FusedReach, ...] = ()
    pressing: PressSchedule = PRESSING
    workspace: Workspace = NO_WORKSPACE
    monte_carlo: tuple[Sampled, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """Plain data for JSON; every key ends in its unit."""
        return {"schema": 1, **asdict(self), "tolerance_sources": self.tolerances.sources()}


def predict(
    model: ProbeModel,
    fractions: tuple[float, ...] = FRACTIONS,
    forces_N: tuple[float, ...] = FORCES_N,
    directions: tuple[str, ...] = ("+x", "-x", "+y"),
    tolerances: Tolerances | None = None,
    pressing: PressSchedule = PRESSING,
) -> Prediction:
    """Predict sensitivity and contact error over a grid of touches.

    The error is the first-order covariance of the estimator's own residuals at touches of the model without friction,
    with all error sources and the prior on friction (`budget.py`): what `estimate` and `fuse` state at such a touch.

    Args:
        model: the probe.
        fractions: of the length where it is touched, in (0, 1].
        forces_N: how hard [N].
        directions: keys of `DIRECTIONS`: which way the object pushes.
        tolerances: how well the probe is known; as `Tolerances.of` the model has it if None.
        pressing: how the touches of one point are made that are fused.

    Raises:
        InputError: a fraction, force or direction that makes no sense.
    """
    check_grid(fractions, forces_N, directions)
    estimator = Estimator(model, tolerances)
    known = estimator.priors
    end = model.rod.flank_end / model.rod.length
    lines = [(fraction, direction) for fraction in fractions for direction in directions]
    ends = [(end, direction) for direction in directions if (end, direction) not in lines]
    workspace, reach, detection = (
        NO_WORKSPACE,
        _nothing(lines),
        tuple(Detection(*line, None) for line in lines),
    )
    conditions = {(*line, force): Condition(line[0], force, line[1], "gives_way")
                  for line in lines for force in forces_N}  # fmt: skip
    fused = tuple(FusedCondition(place, force, side, pressing.touches, "gives_way")
                  for place in fractions for force in forces_N for side in directions)  # fmt: skip
    if estimator.free().ok:  # else it cannot even stand
        pressed = forces_of(pressing, forces_N)
        touches = touches_of(estimator, lines + ends, (_WEAK_N, *LADDER_N, *forces_N, *pressed))
        reach = reach_of(lines + ends, {f: touches[f] for f in LADDER_N}, end)[: len(lines)]
        detection = tuple(
            _detection(touches[_WEAK_N], i, line, reach[i].greatest_force_N) for i, line in enumerate(lines)
        )
        told = {force: conditions_of(touches[force], lines) for force in forces_N}
        conditions = {(*line, force): told[force][i] for i, line in enumerate(lines) for force in forces_N}
        fused = fused_conditions(lines, touches, forces_N, pressing)
        workspace = workspace_of(reach, touches, model.gravity_base)
    return Prediction(
        name=model.name,
        fingerprint=model.fingerprint,
        assumptions=model.assumptions,
        mass_g=1e3 * model.mass,
        tip_sag_mm=tip_sag_mm(estimator),
        noise_force_mN=1e3 * model.noise.force,
        noise_moment_Nmm=1e3 * model.noise.moment,
        friction=_finite(model.friction),
        conditions=tuple(
            conditions[fraction, direction, force]
            for fraction in fractions for force in forces_N for direction in directions
        ),
        detection=detection,
        reach=reach,
        tolerances=known,
        fused=fused,
        fused_reach=fused_reach(fused),
        workspace=workspace,
        pressing=pressing,
    )  # fmt: skip


def predict_touch(
    estimator: Estimator,
    fraction: float,
    force_N: float,
    direction: str,
    tolerances: Tolerances | None = None,
) -> Condition:
    """One condition; see `predict`."""
    if not estimator.free().ok:  # it cannot even stand
        return Condition(fraction, force_N, direction, "gives_way")
    if tolerances is not None:
        estimator = estimator.with_tolerances(tolerances)
    line = (fraction, direction)
    return conditions_of(touches_of(estimator, [line], [force_N])[force_N], [line])[0]


def conditions_of(touches: Touches, lines: Sequence[tuple[float, str]]) -> list[Condition]:
    """What touches of some lines at one force will give."""
    results = touches.results()
    return [
        _condition(touches, i, line, result)
        for i, (line, result) in enumerate(zip(lines, results, strict=False))
    ]


def _condition(touches: Touches, i: int, line: tuple[float, str], result: str) -> Condition:
    force = touches.force_N
    if result == "gives_way":
        return Condition(line[0], force, line[1], result)
    per_N, press = touches.wrench_by_force[i], float(touches.press_per_N[i])
    by_moment, by_force = float(np.linalg.norm(per_N[3:6])), float(np.linalg.norm(per_N[0:3]))
    rms = touches.budget.rms[i] / MM
    error, within = _finite(touches.rms[0][i] / MM), _finite(touches.within_95[0][i] / MM)
    return Condition(
        line[0],
        force,
        line[1],
        result,
        predicted_error_mm=error,
        predicted_error_95_mm=within,
        noise_error_mm=_finite(touches.rms[1][i] / MM),
        noise_error_95_mm=_finite(touches.within_95[1][i] / MM),
        std_s_mm=_finite(touches.budget.std_s[i] / MM),
        deflection_mm=float(touches.deflection[i] / MM),
        moment_per_N_Nmm=1e3 * by_moment,
        force_per_N_N=by_force,
        moment_per_mm_Nmm=_finite(1e3 * by_moment / press * MM) if press > 0 else None,
        force_per_mm_N=_finite(by_force / press * MM) if press > 0 else None,
        sensor_use=float(touches.sensor_use[i]),
        budget_mm=dict(zip(CAUSES, rms.tolist(), strict=True)) if np.isfinite(rms).all() else None,
        total_error_mm=error,
        total_error_95_mm=within,
    )


def tip_sag_mm(estimator: Estimator) -> float | None:
    """How far gravity alone moves the tip [mm]; None if the probe cannot stand."""
    free, length = estimator.free(), estimator.model.rod.length
    return float(np.linalg.norm(free.p_at(length) - [0.0, 0.0, length]) / MM) if free.ok else None


def _detection(touches: Touches, i: int, line: tuple[float, str], most: float | None) -> Detection:
    """In proportion to a weak push; none where the probe gives way before."""
    if not touches.ok[i] or most is None:
        return Detection(*line, None)
    felt = touches.estimator.detectable(touches.wrench_by_force[i])
    return Detection(*line, 1e3 * felt if felt <= most else None)


def _nothing(lines: Sequence[tuple[float, str]]) -> tuple[Reach, ...]:
    """What a probe that cannot stand can do."""
    return tuple(Reach(*line, None, None, None, None, "gives_way", None) for line in lines)


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
