"""How well a probe will feel, before it is printed: sensitivity, detection, saturation, localisation error."""

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from probedesign.errors import InputError
from probedesign.estimator.bound import contact_bound
from probedesign.estimator.estimator import Estimator
from probedesign.estimator.model import ProbeModel
from probedesign.prediction.quantile import radius_95
from probedesign.rod.contact import FrictionlessContact, solve_frictionless
from probedesign.units import MM

DIRECTIONS = {"+x": 0.0, "-x": math.pi, "+y": math.pi / 2, "-y": -math.pi / 2}
"""Way the object pushes, as an angle about the tangent from the section's x axis [rad]."""
FRACTIONS = tuple(round(0.1 * k, 1) for k in range(1, 11))
FORCES_N = (0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2)
_NO_TOUCH = {"unstable": "gives_way", "not_converged": "not_converged"}
"""Why there is no touch to predict: the probe buckles or bends away before it pushes back so hard."""
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


@dataclass(frozen=True)
class Detection:
    """Smallest force that is told from no contact, at one place from one side."""

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

    def as_dict(self) -> dict[str, Any]:
        """Plain data for JSON; every key ends in its unit."""
        return {"schema": 1, **asdict(self)}


def predict(
    model: ProbeModel,
    fractions: tuple[float, ...] = FRACTIONS,
    forces_N: tuple[float, ...] = FORCES_N,
    directions: tuple[str, ...] = ("+x", "-x", "+y"),
) -> Prediction:
    """Predict sensitivity and contact error over a grid of touches.

    The error is Cramér and Rao's bound for the sensor's noise, by the rod's exact sensitivities, which the default
    estimator reaches; E, geometry and mount count as known, the touch as free of friction.

    Args:
        model: the probe.
        fractions: of the length where it is touched, in (0, 1].
        forces_N: how hard [N].
        directions: keys of `DIRECTIONS`: which way the object pushes.

    Raises:
        InputError: a fraction, force or direction that makes no sense.
    """
    _check_grid(fractions, forces_N, directions)
    estimator = Estimator(model)
    conditions = tuple(
        predict_touch(estimator, fraction, force, direction)
        for fraction in fractions for force in forces_N for direction in directions
    )  # fmt: skip
    detection = tuple(
        Detection(fraction, direction, _detectable_mN(estimator, fraction, direction))
        for fraction in fractions for direction in directions
    )  # fmt: skip
    return Prediction(
        name=model.name,
        fingerprint=model.fingerprint,
        assumptions=model.assumptions,
        mass_g=1e3 * model.mass,
        tip_sag_mm=tip_sag_mm(estimator),
        noise_force_mN=1e3 * model.noise.force,
        noise_moment_Nmm=1e3 * model.noise.moment,
        conditions=conditions,
        detection=detection,
    )


def predict_touch(estimator: Estimator, fraction: float, force_N: float, direction: str) -> Condition:
    """One condition; see `predict`."""
    if not estimator.free().ok:  # it cannot even stand
        return Condition(fraction, force_N, direction, "gives_way")
    contact = _touch(estimator, fraction, force_N, direction)
    if contact.result != "ok":
        return Condition(fraction, force_N, direction, _NO_TOUCH[contact.result])
    model, eq = estimator.model, contact.equilibrium
    bound = contact_bound(contact, estimator.cov_wrench)
    per_N, p_per_N = contact.d_wrench[:, 2], contact.d_position[:, 2]
    press = float(contact.force_base @ p_per_N) / force_N  # metres that one newton more presses in
    use = np.abs(model.to_sensor(eq.wrench_base, model.gravity_base)) / model.wrench_range
    moment, force = float(np.linalg.norm(per_N[3:6])), float(np.linalg.norm(per_N[0:3]))
    return Condition(
        fraction,
        force_N,
        direction,
        _result(estimator, contact, bound.std_s, float(use.max())),
        predicted_error_mm=_finite(math.sqrt(np.trace(bound.cov_p)) / MM),
        predicted_error_95_mm=_finite(radius_95(bound.cov_p) / MM),
        std_s_mm=_finite(bound.std_s / MM),
        deflection_mm=float(np.linalg.norm(eq.p_contact_base - estimator.free().p_at(eq.s_contact)) / MM),
        moment_per_N_Nmm=1e3 * moment,
        force_per_N_N=force,
        moment_per_mm_Nmm=_finite(1e3 * moment / press * MM) if press > 0 else None,
        force_per_mm_N=_finite(force / press * MM) if press > 0 else None,
        sensor_use=float(use.max()),
    )


def tip_sag_mm(estimator: Estimator) -> float | None:
    """How far gravity alone moves the tip [mm]; None if the probe cannot stand."""
    free, length = estimator.free(), estimator.model.rod.length
    return float(np.linalg.norm(free.p_at(length) - [0.0, 0.0, length]) / MM) if free.ok else None


def _touch(estimator: Estimator, fraction: float, force_N: float, direction: str) -> FrictionlessContact:
    model = estimator.model
    return solve_frictionless(
        model.rod, model.gravity_base, fraction * model.rod.length, DIRECTIONS[direction], force_N
    )


def _result(estimator: Estimator, contact: FrictionlessContact, std_s: float, use: float) -> str:
    """What the estimator would say of this reading free of noise."""
    if use > 1.0:
        return "out_of_range"
    if not estimator.detects(contact.equilibrium.wrench_base):
        return "no_contact"
    return "ok" if estimator.locates(std_s, contact.force_base) else "too_light"


def _detectable_mN(estimator: Estimator, fraction: float, direction: str) -> float | None:
    contact = _touch(estimator, fraction, _WEAK_N, direction)
    return 1e3 * estimator.detectable(contact.d_wrench[:, 2]) if contact.result == "ok" else None


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _check_grid(
    fractions: tuple[float, ...], forces_N: tuple[float, ...], directions: tuple[str, ...]
) -> None:
    for fraction in fractions:
        if not 0.0 < fraction <= 1.0:
            raise InputError(f"contact fraction {fraction:g} must lie in (0, 1]")
    for force in forces_N:
        if not 0.0 < force <= 100.0:
            raise InputError(f"force {force:g} N must lie in (0, 100]")
    for direction in directions:
        if direction not in DIRECTIONS:
            raise InputError(f"direction '{direction}' is unknown; known: {', '.join(DIRECTIONS)}")
