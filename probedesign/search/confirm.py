"""Whether the real estimator reaches what the bound promises: drawn readings of drawn probes, fused as a user would."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from probedesign.design import Design
from probedesign.errors import InputError
from probedesign.estimator.estimator import Estimator
from probedesign.estimator.model import ProbeModel
from probedesign.estimator.unknowns import Unknowns
from probedesign.frames import Array
from probedesign.probe import build_probe
from probedesign.search.press_series import press_series, unknowns_of
from probedesign.search.task import Task
from probedesign.units import MM


@dataclass(frozen=True)
class Confirmed:
    """What drawn touches gave.

    Attributes:
        rms_mm: of the touched point's place, over all places and draws.
        bound_mm: what was promised.
        located, drawn: how many were answered, of how many.
    """

    rms_mm: float
    bound_mm: float
    located: int
    drawn: int


def confirm(
    design: Design, task: Task, draws: int, seed: int, tell: Callable[[str, float | None], None]
) -> Confirmed:
    """Fuse drawn readings at each of the task's places.

    Drawn are the stiffness, the base's place at all poses and at each, the bias's walk and the noise, each as the
    estimator is told to expect it.

    Args:
        design: of the probe.
        task: how it is used; more than one touch.
        draws: at each place.
        seed: of the draws.
        tell: told how far it is.

    Raises:
        InputError: a single touch is asked for, or the probe gives way.
    """
    if task.touches < 2:
        raise InputError("--confirm is of fused touches; give --touches 2 or more")
    model, rng = build_probe(design).model, np.random.default_rng(seed)
    unknowns, errors, bounds = unknowns_of(model, task), list[float](), list[float]()
    for n, fraction in enumerate(task.fractions):
        tell("confirming by drawn touches", n / len(task.fractions))
        series = press_series(model, fraction, task)
        if series is None:
            raise InputError(f"{design.name}: gives way at {fraction:g} of its length")
        bounds.append(series.rms(unknowns, task))
        errors += [_error(model, fraction, task, unknowns, rng) for _ in range(draws)]
    found = np.array(errors)
    good = found[np.isfinite(found)]
    rms = math.sqrt(float((good**2).mean())) if len(good) else math.nan
    return Confirmed(rms / MM, float(np.sqrt(np.mean(np.square(bounds)))) / MM, len(good), len(found))


def _error(
    model: ProbeModel, fraction: float, task: Task, unknowns: Unknowns, rng: np.random.Generator
) -> float:
    """How far off the touched point is located [m]; NaN where it is not."""
    factor = math.exp(rng.normal(0.0, unknowns.stiffness))
    rod = replace(model.rod, youngs_modulus=factor * model.rod.youngs_modulus,
                  shear_modulus=factor * model.rod.shear_modulus)  # fmt: skip
    series = press_series(replace(model, rod=rod), fraction, task)
    if series is None:
        return math.nan
    answer = Estimator(model).fuse(
        series.wrenches + _noise(model, task, unknowns, rng), _believed(series.Ts_world_base, unknowns, rng),
        model.gravity_base, moments_only=task.moments_about is not None,
        moments_about=task.moments_about or "base", unknowns=unknowns,
    )  # fmt: skip
    return float(np.linalg.norm(answer.p_surface_world)) if answer.ok else math.nan


def _noise(model: ProbeModel, task: Task, unknowns: Unknowns, rng: np.random.Generator) -> Array:
    """Of the readings, with the bias as it walks, (k, 6)."""
    k, cov = task.touches, model.noise_base()
    noise = rng.multivariate_normal(np.zeros(6), cov, k)
    steps = rng.multivariate_normal(np.zeros(6), cov * model.averaging_samples, k)
    bias = rng.multivariate_normal(np.zeros(6), cov * model.averaging_samples)
    drawn: Array = noise + unknowns.bias_steps * bias + unknowns.bias_walk_steps * np.cumsum(steps, axis=0)
    return drawn


def _believed(Ts: Array, unknowns: Unknowns, rng: np.random.Generator) -> Array:
    """Poses as the robot tells them, (k, 4, 4)."""
    told = Ts.copy()
    told[:, :3, 3] += rng.normal(0.0, max(unknowns.base_offset, 0.0), 3)
    told[:, :3, 3] += rng.normal(0.0, unknowns.base_repeat, (len(Ts), 3))
    return told
