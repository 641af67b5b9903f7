"""Metrics of a design for a task, by which designs are compared, swept and optimised."""

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from probedesign.core.frames import Array
from probedesign.core.units import MM
from probedesign.design import Design
from probedesign.estimation.error_sources import ErrorSources
from probedesign.estimation.estimator import Estimator
from probedesign.estimation.fusion import BETTER_THAN_NOTHING
from probedesign.estimation.model import ProbeModel
from probedesign.optimization.task import Case, Task, side_of
from probedesign.prediction.budget import error_budget
from probedesign.prediction.fused import LinearizedPresses
from probedesign.prediction.predict import tip_sag
from probedesign.prediction.touches import SurfaceRod, slide, touches_of
from probedesign.printing.check import check_print
from probedesign.probe import build_probe

DETECTION_FRACTION = 0.8
"""Contact fraction whose detectable force is reported."""
SHARED_PARTS = ("flange_adapter",)
"""Parts that do not depend on the flexible part."""
_WEAK_N = 1e-6


@dataclass(frozen=True)
class TaskErrors:
    """Predicted errors of the touches of a task.

    Attributes:
        cases: of the task.
        errors: RMS error of the touched point in each case, by all error sources [m]; infinite where the probe buckles.
        sensor_use: largest fraction of a channel's range that a reading takes; infinite likewise.
        slide: largest distance that the object slides along the probe while the base presses on along a straight line,
            without friction [m]; 0 for single touches, infinite where it slips off or the probe buckles.
    """

    cases: tuple[Case, ...]
    errors: tuple[float, ...]
    sensor_use: float
    slide: float


@dataclass(frozen=True)
class DesignMetrics:
    """Metrics of one design. Numbers that do not exist are None.

    Attributes:
        error_mm: RMS distance between the estimated and the true touched point, by all error sources, over the task's
            cases as the task combines them.
        worst_error_mm: largest error of a case.
        detectable_mN: force that one reading detects with probability 0.5 at 0.8 of the length, noise and drift
            included (`Estimator.detectable`).
        sag_mm: displacement of the tip along gravity, as mounted.
        reach_mm: distance from the base to the tip of the free probe.
        sensor_use: largest fraction of a channel's range in the task.
        slide_mm: slide of the object along the probe in a straight press without friction; None for single touches and
            where it slips off.
        mass_g: of the flexible part.
        length_mm, thinnest_mm: of the flexible part, undeformed.
        print_errors, print_warnings: findings of the print rules, except for `SHARED_PARTS`.
    """

    error_mm: float | None
    worst_error_mm: float | None
    detectable_mN: float | None
    sag_mm: float | None
    reach_mm: float | None
    sensor_use: float | None
    slide_mm: float | None
    mass_g: float
    length_mm: float
    thinnest_mm: float
    print_errors: int
    print_warnings: int

    @property
    def is_observable(self) -> bool:
        """Whether the error of every case is smaller than that of a uniform prior along the probe, L/√12."""
        return self.worst_error_mm is not None and self.worst_error_mm < self.length_mm * BETTER_THAN_NOTHING

    def as_dict(self) -> dict[str, Any]:
        """Return plain data; every key ends in its unit."""
        return asdict(self)


METRICS = tuple(DesignMetrics.__dataclass_fields__)


def design_metrics(design: Design, task: Task) -> DesignMetrics:
    """Compute the metrics of a design; this takes about 50 ms."""
    probe = build_probe(design)
    touched = predict_task(probe.model, task)
    found = [f.severity for f in check_print(design).findings if f.part not in SHARED_PARTS]
    free = probe.rod.solve(probe.model.gravity_base)
    return DesignMetrics(
        error_mm=_finite(task.combined(touched.errors) / MM),
        worst_error_mm=_finite(max(touched.errors) / MM),
        detectable_mN=_detectable_mN(probe.model, task),
        sag_mm=tip_sag(free, probe.length, probe.model.gravity_base) / MM if free.ok else None,
        reach_mm=float(np.linalg.norm(free.p_at(probe.length)) / MM) if free.ok else None,
        sensor_use=_finite(touched.sensor_use),
        slide_mm=_finite(touched.slide / MM) if task.touches > 1 else None,
        mass_g=float(1e3 * probe.mass),
        length_mm=probe.length / MM,
        thinnest_mm=probe.geometry.thinnest / MM,
        print_errors=found.count("error"),
        print_warnings=found.count("warning"),
    )


def predict_task(model: ProbeModel, task: Task, slipping: bool = True) -> TaskErrors:
    """Predict the errors of a task's touches, including all error sources.

    Args:
        model: of the probe.
        task: how it is used.
        slipping: whether the slide is computed too; otherwise it is 0.
    """
    cases, errors, use, slid = list[Case](), list[float](), 0.0, 0.0
    for under in task.models(model):
        estimator = Estimator(under, task.priors(under))
        free = estimator.free()
        on = SurfaceRod(under.rod, under.gravity_base, under.mass, free)
        sources = ErrorSources.of(under, estimator.priors, under.gravity_base, free) if free.ok else None
        for fraction in task.fractions:
            found = _errors_at(estimator, on, sources, fraction, task) if sources is not None else None
            for force in task.forces_N:
                cases.append(Case(fraction, force, _vector(under.gravity_base)))
                error, used = (
                    (math.inf, math.inf) if found is None else found.get(force, (math.inf, math.inf))
                )
                errors.append(error)
                use = max(use, used)
            if slipping and task.schedule is not None and free.ok:
                s, phi = fraction * under.rod.length, side_of(under.gravity_base) + math.pi
                slid = max(slid, slide(on, s, phi, task.schedule.forces(task.force_N)))
    return TaskErrors(tuple(cases), tuple(errors), use, slid)


def _errors_at(
    estimator: Estimator, on: SurfaceRod, sources: ErrorSources, fraction: float, task: Task
) -> dict[float, tuple[float, float]]:
    """Return the error [m] and the used fraction of the sensor's range at one position, by force, where there is a
    result."""
    model, schedule = estimator.model, task.schedule
    press = on.begin_press(fraction * on.rod.length, side_of(on.gravity) + math.pi)
    parts = {force: (force,) if schedule is None else schedule.forces(force) for force in task.forces_N}
    reached = dict[float, Array]()
    for force in sorted({part for of in parts.values() for part in of}):
        touch = press.increase_to(force)
        if touch is None:
            break
        reached[force] = touch
    found = dict[float, tuple[float, float]]()
    for force, of in parts.items():
        if force not in reached:
            continue
        if schedule is None:
            touch = reached[force][None].copy()
            lin, D = sources.columns_at(touch[0])
            cov = error_budget(touch, lin[None], D[None], sources, model.friction).total[0]
            wrench = lin[0:6, 0]
        else:
            fused = LinearizedPresses(
                model, estimator.priors, on.gravity, np.array([reached[p] for p in of]), schedule
            )
            if not fused.converged:
                continue
            cov, wrench = fused.cov(), fused.wrenches[-1]
        if np.isfinite(cov).all():
            found[force] = math.sqrt(max(float(np.trace(cov)), 0.0)), _sensor_use(model, wrench)
    return found


def _sensor_use(model: ProbeModel, wrench: Array) -> float:
    return float((np.abs(model.to_sensor(wrench, model.gravity_base)) / model.wrench_range).max())


def _vector(gravity: Array) -> tuple[float, float, float]:
    x, y, z = (float(part) for part in gravity)
    return x, y, z


def _detectable_mN(model: ProbeModel, task: Task) -> float | None:
    estimator = Estimator(model, task.priors(model))
    if not estimator.free().ok:
        return None
    weak = touches_of(estimator, [(DETECTION_FRACTION, "+y")], [_WEAK_N])[_WEAK_N]
    return 1e3 * estimator.detectable(weak.wrench_by_force[0]) if weak.ok[0] else None


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
