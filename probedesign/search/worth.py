"""What a design is worth for a task: a few figures that designs are compared, swept and optimised by."""

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from probedesign.design import Design
from probedesign.estimation.bound import contact_bound
from probedesign.estimation.estimator import Estimator
from probedesign.estimation.model import ProbeModel
from probedesign.frames import Array
from probedesign.printing.check import check_print
from probedesign.probe import build_probe
from probedesign.rod.contact import solve_frictionless
from probedesign.search.press_series import SIDE, press_series, unknowns_of
from probedesign.search.task import Task
from probedesign.units import MM

FELT_AT = 0.8
"""Fraction of the length whose detectable force is told."""
NOT_OF_THE_BODY = ("flange_adapter",)
"""Parts that are the same whatever the body."""
_WEAK_N = 1e-6


@dataclass(frozen=True)
class Touched:
    """What touches say of a probe.

    Attributes:
        errors: RMS of the located point at each of the task's places [m]; infinite where the probe gives way.
        sensor_use: largest share of a channel's range that a reading takes; infinite likewise.
    """

    errors: tuple[float, ...]
    sensor_use: float

    @property
    def rms(self) -> float:
        """Over the places [m]."""
        return math.sqrt(sum(error**2 for error in self.errors) / len(self.errors))


@dataclass(frozen=True)
class Worth:
    """The figures of one design. What does not exist is None.

    Attributes:
        error_mm: RMS of the located point over the task's places, by the bound.
        worst_error_mm: at the worst of them.
        detectable_mN: smallest force told from none at 0.8 of the length.
        sag_mm: of the tip, under gravity as mounted.
        reach_mm: from the base to the tip as it hangs.
        sensor_use: largest share of a channel's range in the task.
        mass_g: of the flexible part.
        length_mm, thinnest_mm: of the flexible part, as drawn.
        print_errors, print_warnings: that the rules of printing find, `NOT_OF_THE_BODY` left out.
    """

    error_mm: float | None
    worst_error_mm: float | None
    detectable_mN: float | None
    sag_mm: float | None
    reach_mm: float | None
    sensor_use: float | None
    mass_g: float
    length_mm: float
    thinnest_mm: float
    print_errors: int
    print_warnings: int

    @property
    def locates(self) -> bool:
        """Whether every place is told at all: better than anywhere along the probe alike, L/√12."""
        return self.worst_error_mm is not None and self.worst_error_mm < self.length_mm / math.sqrt(12.0)

    def as_dict(self) -> dict[str, Any]:
        """Plain data; every key ends in its unit."""
        return asdict(self)


FIGURES = tuple(Worth.__dataclass_fields__)


def worth(design: Design, task: Task) -> Worth:
    """The figures of a design; about 50 ms."""
    probe = build_probe(design)
    touched = touches(probe.model, task)
    found = [f.severity for f in check_print(design).findings if f.part not in NOT_OF_THE_BODY]
    tip = tip_place(probe.model)
    return Worth(
        error_mm=_finite(touched.rms / MM),
        worst_error_mm=_finite(max(touched.errors) / MM),
        detectable_mN=_detectable_mN(probe.model),
        sag_mm=None if tip is None else float(np.linalg.norm(tip - [0.0, 0.0, probe.length]) / MM),
        reach_mm=None if tip is None else float(np.linalg.norm(tip) / MM),
        sensor_use=_finite(touched.sensor_use),
        mass_g=float(1e3 * probe.mass),
        length_mm=probe.length / MM,
        thinnest_mm=probe.geometry.thinnest / MM,
        print_errors=found.count("error"),
        print_warnings=found.count("warning"),
    )


def tip_place(model: ProbeModel) -> Array | None:
    """Where the free tip hangs, base axes [m], (3,); None if the probe cannot stand."""
    eq = model.rod.solve(model.gravity_base)
    return eq.p_at(model.rod.length) if eq.ok else None


def touches(model: ProbeModel, task: Task) -> Touched:
    """Of a probe in a task, sensor noise and all else that is not known counted as the task says."""
    one = _once if task.touches == 1 else _fused
    found = [one(model, fraction, task) for fraction in task.fractions]
    return Touched(tuple(error for error, _ in found), max(use for _, use in found))


def _fused(model: ProbeModel, fraction: float, task: Task) -> tuple[float, float]:
    series = press_series(model, fraction, task)
    if series is None:
        return math.inf, math.inf
    return series.rms(unknowns_of(model, task), task), _use(model, series.wrenches[-1])


def _once(model: ProbeModel, fraction: float, task: Task) -> tuple[float, float]:
    contact = solve_frictionless(
        model.rod, model.gravity_base, fraction * model.rod.length, SIDE, task.force_N
    )
    if contact.result != "ok":
        return math.inf, math.inf
    cov = contact_bound(contact, model.noise_base()).cov_p
    return math.sqrt(float(np.trace(cov))), _use(model, contact.equilibrium.wrench_base)


def _use(model: ProbeModel, wrench: Array) -> float:
    return float((np.abs(model.to_sensor(wrench, model.gravity_base)) / model.wrench_range).max())


def _detectable_mN(model: ProbeModel) -> float | None:
    contact = solve_frictionless(model.rod, model.gravity_base, FELT_AT * model.rod.length, SIDE, _WEAK_N)
    return 1e3 * Estimator(model).detectable(contact.d_wrench[:, 2]) if contact.result == "ok" else None


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
