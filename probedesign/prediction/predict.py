"""How well a probe will feel, before it is printed: sensitivity, detection, saturation, localisation error."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from probedesign.estimation.causes import CAUSES
from probedesign.estimation.estimator import Estimator
from probedesign.estimation.model import ProbeModel
from probedesign.estimation.tolerances import Tolerances
from probedesign.prediction.fused import FusedCondition, FusedReach, forces_of, fused_conditions, fused_reach
from probedesign.prediction.pressing import Pressing
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
PRESSING, NO_WORKSPACE = Pressing(), Workspace()
_WEAK_N = 1e-6  # a push so light that everything answers in proportion


@dataclass(frozen=True)
class Condition:
    """One touch and what it will give. Numbers that do not exist are None.

    Attributes:
        contact_fraction: s_contact over length.
        force_N: how hard the object pushes.
        direction: which way it pushes, a key of `DIRECTIONS`.
        result: what the estimator would answer; "ok" is a located contact. "gives_way": the probe cannot
            push back so hard.
        predicted_error_mm: RMS distance between true and estimated contact point, sensor noise only.
        predicted_error_95_mm: 95 % of the estimates lie within this distance.
        std_s_mm: the part of it along the probe.
        deflection_mm: how far the contact point moved from where the free probe had it.
        moment_per_N_Nmm, force_per_N_N: change of the base's moment and force per newton more.
        moment_per_mm_Nmm, force_per_mm_N: the same per millimetre of pressing on at the same s.
        sensor_use: largest share of a channel's range that the reading takes.
        total_error_mm: RMS distance by all causes of `budget_mm` together.
        total_error_95_mm: 95 % of the estimates lie within this distance, all causes together.
        budget_mm: RMS distance by each cause alone; their squares add up.
    """

    contact_fraction: float
    force_N: float
    direction: str
    result: str
    predicted_error_mm: float | None = None
    predicted_error_95_mm: float | None = None
    std_s_mm: float | None = None
    deflection_mm: float | None = None
    moment_per_N_Nmm: float | None = None
    force_per_N_N: float | None = None
    moment_per_mm_Nmm: float | None = None
    force_per_mm_N: float | None = None
    sensor_use: float | None = None
    total_error_mm: float | None = None
    total_error_95_mm: float | None = None
    budget_mm: dict[str, float] | None = None


@dataclass(frozen=True)
class Detection:
    """Smallest force that one reading tells from no contact, at one place from one side; None where so much is not
    borne. It stands out of the noise and, where tolerances are weighed, of the drift."""

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
    conditions: tuple[Condition, ...]
    detection: tuple[Detection, ...]
    reach: tuple[Reach, ...]
    tolerances: Tolerances
    fused: tuple[FusedCondition, ...] = ()
    fused_reach: tuple[FusedReach, ...] = ()
    pressing: Pressing = PRESSING
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
    pressing: Pressing = PRESSING,
) -> Prediction:
    """Predict sensitivity and contact error over a grid of touches.

    The error by noise is Cramér and Rao's bound, by the rod's exact sensitivities, which the default estimator
    reaches; the other causes are counted to first order (`budget.py`). The touch counts as free of friction.

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
    estimator, known = Estimator(model), tolerances or Tolerances.of(model)
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
        touches = touches_of(estimator, known, lines + ends, (_WEAK_N, *LADDER_N, *forces_N, *pressed))
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
    known, line = tolerances or Tolerances.of(estimator.model), (fraction, direction)
    return conditions_of(touches_of(estimator, known, [line], [force_N])[force_N], [line])[0]


def conditions_of(touches: Touches, lines: Sequence[tuple[float, str]]) -> list[Condition]:
    """What touches of some lines at one force will give."""
    results = touches.results()
    return [
        _condition(touches, i, line, result)
        for i, (line, result) in enumerate(zip(lines, results, strict=False))
    ]


def _condition(touches: Touches, i: int, line: tuple[float, str], result: str) -> Condition:
    force = float(touches.contacts.magnitude[i])
    if result == "gives_way":
        return Condition(line[0], force, line[1], result)
    per_N, press = touches.contacts.d_wrench_by_touch[i, :, 2], float(touches.press_per_N[i])
    by_moment, by_force = float(np.linalg.norm(per_N[3:6])), float(np.linalg.norm(per_N[0:3]))
    rms = touches.budget.rms[i] / MM
    return Condition(
        line[0],
        force,
        line[1],
        result,
        predicted_error_mm=_finite(touches.rms[0][i] / MM),
        predicted_error_95_mm=_finite(touches.within_95[0][i] / MM),
        std_s_mm=_finite(math.sqrt(touches.budget.cov_touch[i, 0, 0]) / MM),
        deflection_mm=float(touches.deflection[i] / MM),
        moment_per_N_Nmm=1e3 * by_moment,
        force_per_N_N=by_force,
        moment_per_mm_Nmm=_finite(1e3 * by_moment / press * MM) if press > 0 else None,
        force_per_mm_N=_finite(by_force / press * MM) if press > 0 else None,
        sensor_use=float(touches.sensor_use[i]),
        total_error_mm=_finite(touches.rms[1][i] / MM),
        total_error_95_mm=_finite(touches.within_95[1][i] / MM),
        budget_mm=dict(zip(CAUSES, rms.tolist(), strict=True)) if np.isfinite(rms).all() else None,
    )


def tip_sag_mm(estimator: Estimator) -> float | None:
    """How far gravity alone moves the tip [mm]; None if the probe cannot stand."""
    free, length = estimator.free(), estimator.model.rod.length
    return float(np.linalg.norm(free.p_at(length) - [0.0, 0.0, length]) / MM) if free.ok else None


def _detection(touches: Touches, i: int, line: tuple[float, str], most: float | None) -> Detection:
    """In proportion to a weak push; none where the probe gives way before."""
    if not touches.contacts.ok[i] or most is None:
        return Detection(*line, None)
    felt = touches.judge.detectable(touches.contacts.d_wrench_by_touch[i, :, 2])
    return Detection(*line, 1e3 * felt if felt <= most else None)


def _nothing(lines: Sequence[tuple[float, str]]) -> tuple[Reach, ...]:
    """What a probe that cannot stand can do."""
    return tuple(Reach(*line, None, None, None, None, "gives_way", None) for line in lines)


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
