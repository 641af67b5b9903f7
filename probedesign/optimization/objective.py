"""Task of a probe, and the metrics by which designs are compared, swept and optimised for it."""

import itertools
import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal, NamedTuple

import numpy as np

from probedesign.core.errors import InputError
from probedesign.core.frames import Array
from probedesign.core.statistics import rms, whiten
from probedesign.core.units import MM
from probedesign.design import Design
from probedesign.estimation.contact_fit import MIN_FRICTION
from probedesign.estimation.error_sources import ErrorSources
from probedesign.estimation.estimator import Estimator
from probedesign.estimation.model import ProbeModel
from probedesign.prediction.budget import error_budget
from probedesign.prediction.fused import MAX_TOUCHES, LinearizedPresses, PressSchedule
from probedesign.prediction.predict import finite_or_none, tip_sag
from probedesign.prediction.touches import SurfaceRod, slide, touches_of
from probedesign.printing.check import check_print
from probedesign.probe import Probe, build_probe
from probedesign.rod.kernels.surface_contact import DEAD, S

#: Contact positions over the length whose error is averaged: the outer part without the tip itself.
FRACTIONS = (0.4, 0.5, 0.6, 0.7, 0.8, 0.9)
_NORM = 16.0  #: Power of the norm in place of the largest error: at most 10 % below it of five errors.
MAX_GRAVITY = 100.0  #: Largest gravity of a task on each axis [m/s²].
Combine = Literal["mean", "worst"]
Vector = tuple[float, float, float]


class Case(NamedTuple):
    """One position, force, gravity and direction of a task."""

    contact_fraction: float  #: arclength of the touched section over the length.
    force_N: float  #: normal force; of several touches the largest.
    gravity_base_m_s2: Vector  #: gravity in base axes.
    direction_deg: float  #: of the push, about the tangent from the section's X axis.


@dataclass(frozen=True)
class Task:
    """How a probe is used: every combination of position, force, gravity and direction is one case."""

    #: normal contact forces; of several touches the largest, the others are equal steps up to it.
    forces_N: tuple[float, ...] = (0.005,)
    touches: int = 5  #: number of touches of one fixed point as the base presses on; 1 is a single reading.
    fractions: tuple[float, ...] = FRACTIONS  #: contact positions over the length.
    gravities: tuple[Vector, ...] = ()  #: in base axes [m/s²]; empty: that of the design's mount.
    #: of the pushes, about the tangent from the section's X axis; empty: across gravity.
    directions_deg: tuple[float, ...] = ()
    combine: Combine = "mean"  #: "mean": the error is the RMS over the cases; "worst": the largest.

    def __post_init__(self) -> None:
        """Raise InputError if a value is out of range."""
        if not self.forces_N:
            raise InputError("forces: a task needs at least one")
        for force in self.forces_N:
            if not 0.0 < force <= 100.0:
                raise InputError(f"force = {force:g} N must lie in (0, 100]")
        if not 1 <= self.touches <= MAX_TOUCHES:
            raise InputError(f"touches = {self.touches} must lie in 1 ... {MAX_TOUCHES}")
        if not self.fractions or not all(0.0 < f <= 1.0 for f in self.fractions):
            raise InputError(f"fractions {list(self.fractions)} must lie in (0, 1]")
        for gravity in self.gravities:
            if len(gravity) != 3 or not all(abs(g) <= MAX_GRAVITY for g in gravity):
                raise InputError(f"gravity {list(gravity)} must be three numbers within ±{MAX_GRAVITY:g} m/s²")
        if not all(abs(angle) <= 720.0 for angle in self.directions_deg):
            raise InputError(f"directions {list(self.directions_deg)} must lie within ±720°")
        if self.combine not in ("mean", "worst"):
            raise InputError(f"combine = {self.combine!r} is not known; known: mean, worst")

    @property
    def force_N(self) -> float:
        """Return the largest force."""
        return max(self.forces_N)

    @property
    def schedule(self) -> PressSchedule | None:
        """Return how several touches are made; None: one reading."""
        return None if self.touches == 1 else PressSchedule(self.touches)

    def models(self, model: ProbeModel) -> Iterator[ProbeModel]:
        """Yield the probe under each gravity of the task."""
        if not self.gravities:
            yield model
        for gravity in self.gravities:
            yield replace(model, gravity_base=np.array(gravity, dtype=float))

    def angles(self, gravity: Array) -> list[float]:
        """Return the directions of the pushes under a gravity (3,), about the tangent from the section's X axis [rad].

        Without directions it is the push across gravity, to +y without gravity.
        """
        across = math.atan2(gravity[1], gravity[0]) + math.pi / 2.0
        return [math.radians(angle) for angle in self.directions_deg] or [across]

    def combined(self, errors: tuple[float, ...]) -> float:
        """Combine the errors of all cases to the error of the task."""
        if self.combine == "worst":
            return max(errors)
        return math.sqrt(sum(error**2 for error in errors) / len(errors))

    def sought(self, errors: tuple[float, ...]) -> float:
        """Return what a search minimises: the combined error, the largest one as a norm, which has derivatives."""
        if self.combine == "mean":
            return self.combined(errors)
        largest = max(errors)
        return float(largest * np.mean((np.array(errors) / largest) ** _NORM) ** (1.0 / _NORM))

    @property
    def text(self) -> str:
        """Return the description in one line, for users."""
        over = "RMS over" if self.combine == "mean" else "worst of"
        low, high = min(self.fractions), max(self.fractions)
        where = f"{over} {low:g}-{high:g} of the length" if low < high else f"at {low:g} of the length"
        if len(self.gravities) > 1:
            where += f" and {len(self.gravities)} directions of gravity"
        if self.directions_deg:
            low, high, n = min(self.directions_deg), max(self.directions_deg), len(self.directions_deg)
            where += f", forces at {low:g}°" if n == 1 else f", {n} directions of the force from {low:g} to {high:g}°"
        return f"{self.touches_text}, all error sources, {where}"

    @property
    def touches_text(self) -> str:
        """Return the description of the touches, for users."""
        forces = ", ".join(f"{1e3 * force:g}" for force in self.forces_N)
        if self.schedule is None:
            return f"one reading at {forces} mN"
        return f"{self.touches} touches up to {forces} mN fused, forces and moments"


DETECTION_FRACTION = 0.8  #: Contact fraction whose detectable force is reported.
SHARED_PARTS = ("flange_adapter",)  #: Parts that do not depend on the flexible part.
_WEAK_N = 1e-6


@dataclass(frozen=True)
class TaskErrors:
    """Predicted errors of the touches of a task."""

    cases: tuple[Case, ...]  #: of the task.
    #: RMS error of the touched point in each case, by all error sources [m]; infinite where the probe buckles.
    errors: tuple[float, ...]
    sensor_use: float  #: largest fraction of a channel's range that a reading takes; infinite where the probe buckles.
    #: largest distance that the object slides along the probe while the base presses on along a straight line, without
    #: friction [m]; 0 for single touches, infinite where it slips off or the probe buckles.
    slide: float
    #: smallest number of standard deviations by which a reading tells the touched place from others of a curved probe,
    #: see `distinction`; infinite for straight probes and fused touches.
    distinction: float = math.inf


@dataclass(frozen=True)
class DesignMetrics:
    """Metrics of one design. Numbers that do not exist are None."""

    #: RMS distance between the estimated and the true touched point, by all error sources, over the task's cases as the
    #: task combines them.
    error_mm: float | None
    worst_error_mm: float | None  #: largest error of a case.
    #: force that one reading detects with probability 0.5 at 0.8 of the length, noise and drift included
    #: (`Estimator.detectable`).
    detectable_mN: float | None
    sag_mm: float | None  #: displacement of the tip along gravity, as mounted.
    reach_mm: float | None  #: distance from the base to the tip of the free probe.
    tip_offset_mm: float  #: distance of the tip of the unloaded probe from the base's z axis; 0 of a straight probe.
    sensor_use: float | None  #: largest fraction of a channel's range in the task.
    #: standard deviations by which single readings tell the touched place of a curved probe from others; None for
    #: straight probes and fused touches.
    distinction: float | None
    #: slide of the object along the probe in a straight press without friction; None for single touches and where it
    #: slips off.
    slide_mm: float | None
    mass_g: float  #: of the flexible part.
    length_mm: float  #: length_mm, thinnest_mm: of the flexible part, undeformed.
    thinnest_mm: float
    print_errors: int  #: print_errors, print_warnings: findings of the print rules, except for `SHARED_PARTS`.
    print_warnings: int

    def as_dict(self) -> dict[str, Any]:
        """Return plain data; every key ends in its unit."""
        return asdict(self)


#: Contact fractions at which designs are compared.
COMPARED_FRACTIONS = tuple(round(0.2 + 0.05 * k, 2) for k in range(16))
METRICS = tuple(DesignMetrics.__dataclass_fields__)


def design_metrics(design: Design, task: Task) -> DesignMetrics:
    """Compute the metrics of a design; this takes about 50 ms."""
    probe = build_probe(design)
    touched = predict_task(probe.model, task)
    severities = [f.severity for f in check_print(design).findings if f.part not in SHARED_PARTS]
    free = probe.rod.solve(probe.model.gravity_base)
    return DesignMetrics(
        error_mm=finite_or_none(task.combined(touched.errors) / MM),
        worst_error_mm=finite_or_none(max(touched.errors) / MM),
        detectable_mN=detectable_mN(probe.model, task),
        sag_mm=tip_sag(free, probe.rod, probe.model.gravity_base) / MM if free.ok else None,
        reach_mm=float(np.linalg.norm(free.p_at(probe.length)) / MM) if free.ok else None,
        tip_offset_mm=tip_offset(probe) / MM,
        sensor_use=finite_or_none(touched.sensor_use),
        distinction=finite_or_none(touched.distinction),
        slide_mm=finite_or_none(touched.slide / MM) if task.touches > 1 else None,
        mass_g=float(1e3 * probe.mass),
        length_mm=probe.length / MM,
        thinnest_mm=probe.geometry.thinnest / MM,
        print_errors=severities.count("error"),
        print_warnings=severities.count("warning"),
    )


def tip_offset(probe: Probe) -> float:
    """Return the distance of the unloaded tip from the z axis of the base [m]."""
    return float(np.linalg.norm(probe.axis.frames([probe.length])[0, :2, 3]))


def predict_task(model: ProbeModel, task: Task, slipping: bool = True) -> TaskErrors:
    """Predict the errors of a task's touches, including all error sources; without `slipping` the slide is 0."""
    cases, errors, use, slid, distinct = list[Case](), list[float](), 0.0, 0.0, math.inf
    for under in task.models(model):
        estimator = Estimator(under)
        free = estimator.free()
        on = SurfaceRod(under.rod, under.gravity_base, under.mass, free)
        sources = ErrorSources.of(under, estimator.priors, under.gravity_base, free) if free.ok else None
        for fraction, angle in itertools.product(task.fractions, task.angles(under.gravity_base)):
            by_force = {} if sources is None else _errors_at(estimator, on, sources, fraction, angle, task)
            for force in task.forces_N:
                cases.append(Case(fraction, force, tuple(under.gravity_base.tolist()), math.degrees(angle)))
                error, used, separation = by_force.get(force, (math.inf, math.inf, math.inf))
                errors.append(error)
                use, distinct = max(use, used), min(distinct, separation)
            if slipping and task.schedule is not None and free.ok:
                s, phi = fraction * under.rod.length, angle + math.pi
                slid = max(slid, slide(on, s, phi, task.schedule.forces(task.force_N)))
    return TaskErrors(tuple(cases), tuple(errors), use, slid, distinct)


def _errors_at(
    estimator: Estimator, on: SurfaceRod, sources: ErrorSources, fraction: float, angle: float, task: Task
) -> dict[float, tuple[float, float, float]]:
    """Return the error [m], the used fraction of the sensor's range and the distinction at one position and direction
    [rad], by force, where there is a result."""
    model, schedule = estimator.model, task.schedule
    press = on.begin_press(fraction * on.rod.length, angle + math.pi)
    parts = {force: (force,) if schedule is None else schedule.forces(force) for force in task.forces_N}
    reached = dict[float, Array]()
    for force in sorted({part for of in parts.values() for part in of}):
        touch = press.increase_to(force)
        if touch is None:
            break
        reached[force] = touch
    errors = dict[float, tuple[float, float, float]]()
    for force, of in parts.items():
        if force not in reached:
            continue
        separation = math.inf
        if schedule is None:
            touch = reached[force][None].copy()
            lin, D = sources.columns_at(touch[0])
            cov = error_budget(touch, lin[None], D[None], sources, model.friction).total[0]
            wrench = lin[0:6, 0]
            if on.rod.is_curved:
                noise = model.noise_base() + sources.drift + D[:6] @ D[:6].T
                separation = distinction(on, touch[0], noise, model.friction)
        else:
            pressed = np.array([reached[part] for part in of])
            fused = LinearizedPresses(model, estimator.priors, on.gravity, pressed, schedule)
            if not fused.converged:
                continue
            cov, wrench = fused.cov(), fused.wrenches[-1]
        if np.isfinite(cov).all():
            use = np.abs(model.to_sensor(wrench, model.gravity_base)) / model.wrench_range
            errors[force] = rms(cov), float(use.max()), separation
    return errors


def distinction(on: SurfaceRod, touch: Array, cov: Array, friction: float) -> float:
    """Return the number of standard deviations by which a reading differs from those of touches of other places.

    The force of a touch at s that comes nearest to the reading (F, M) of the touched place minimises
    |W (F' - F, p(s) × F' - M)|² + (F'·t(s) / (μ |F|))², W the whitening of the reading and t the tangent: a linear
    problem. M · p(s) = 0 may have a second root, where the minimum is small; the error to first order does not show it.

    Args:
        on: the rod.
        touch: unknowns, dead loads and tip, (TOUCH,).
        cov: covariance of the reading, (6, 6).
        friction: prior standard deviation of the friction ratio μ.

    Returns:
        Its square root, the smallest over the places at least `APART` of the length away.
    """
    length, force = on.rod.length, touch[DEAD : DEAD + 3]
    shape = on.rod.solve(on.gravity, force, float(touch[S]))
    s = np.linspace(0.0, length, _PLACES)[1:]
    p, at = shape.p_at(s), shape.p_contact_base
    A = np.zeros((len(s), 7, 3))
    A[:, :3], A[:, 3:6] = np.eye(3), np.cross(p[:, None], np.eye(3)).swapaxes(1, 2)
    reading, W = np.concatenate([force, np.cross(at, force)]), whiten(cov)
    A[:, :6] = W @ A[:, :6]
    A[:, 6] = np.gradient(p, s, axis=0) / (max(friction, MIN_FRICTION) * np.linalg.norm(force))
    y = np.append(W @ reading, 0.0)
    forces = np.linalg.pinv(A) @ y
    misfit = np.linalg.norm(np.einsum("kij,kj->ki", A, forces) - y, axis=1)
    return float(misfit[np.abs(s - touch[S]) > APART * length].min())


#: Share of the length from the touched place on at which another one counts, and number of places along the probe.
APART, _PLACES = 0.15, 41


def detectable_mN(model: ProbeModel, task: Task) -> float | None:
    """Return the force that one reading detects with probability 0.5 at `DETECTION_FRACTION` [mN]; None if none is."""
    estimator = Estimator(model)
    if not estimator.free().ok:
        return None
    sides = [f"{angle:g}deg" for angle in task.directions_deg] or ["+y"]
    weak = touches_of(estimator, [(DETECTION_FRACTION, side) for side in sides], [_WEAK_N])[_WEAK_N]
    return 1e3 * max(map(estimator.detectable, weak.wrench_by_force)) if weak.ok.all() else None
