"""Estimates of single readings: rows for CSV and JSON, the line for the terminal, and what is drawn of them."""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from probedesign.core.frames import Array
from probedesign.core.units import MILLINEWTON, MM
from probedesign.estimation.bias import KnownBias
from probedesign.estimation.estimate import Estimate, FusedEstimate
from probedesign.estimation.estimator import Estimator, Method
from probedesign.estimation.model import ProbeModel
from probedesign.geometry.tube import BentShape
from probedesign.live.blocks import WrenchReading
from probedesign.live.processing.tare import Tare
from probedesign.live.processing.touches import Contact, Phase

UNKNOWN_POSE, UNKNOWN_WRENCH = np.full((4, 4), np.nan), np.full(6, np.nan)
NO_DRIFT = np.zeros(6)
for _shared in (UNKNOWN_POSE, UNKNOWN_WRENCH, NO_DRIFT):
    _shared.setflags(write=False)


@dataclass(frozen=True)
class EstimateUpdate:
    """One estimate and the state of the run at its time."""

    reading: WrenchReading  #: the averaged reading that was located, bias included.
    estimate: Estimate  #: estimate from this reading alone, in the base frame.
    phase: Phase = ""  #: phase of the touch: free, moving, touching, settled or released; empty if not monitored.
    fused: FusedEstimate | None = None  #: touched point from all readings of this touch; None without fusion.
    T_world_base: Array = field(default_factory=UNKNOWN_POSE.copy)  #: pose of the base, (4, 4); NaN if unknown.
    #: wrench at the base without bias [N, N·m], (6,); NaN for a reading with a fault.
    wrench_base: Array = field(default_factory=UNKNOWN_WRENCH.copy)
    computed: float = float("nan")  #: time at which the estimate was available, by `time.monotonic` [s].
    stale: str = ""  #: input that is too old or missing: "pose", or empty.
    contacts: tuple[Contact, ...] = ()  #: every touch so far, including the current one.
    #: drift of the bias since the tare, which `wrench_base` does not contain either [N, N·m], (6,).
    drift_base: Array = field(default_factory=NO_DRIFT.copy)
    #: time until the sway of the probe is within the noise if the base rests from now on [s]; NaN without poses.
    time_to_rest: float = float("nan")
    probe: str = ""  #: name of the probe in a run with several; otherwise empty.


def locate(
    estimator: Estimator,
    reading: WrenchReading,
    tare: Tare | None = None,
    method: Method = "ml",
    drift: KnownBias | None = None,
) -> Estimate:
    """Return the estimate of one reading, bias included. Saturation is tested before the bias is removed.

    `drift` is that of the bias since the tare, as it was followed; without it, its variance grows with the age.
    """
    if reading.fault or not estimator.model.in_range(reading.wrench_sensor):
        return Estimate("out_of_range")
    wrench_base = wrench_without_bias(estimator.model, reading, tare)
    if drift is not None:
        wrench_base, estimator = wrench_base - drift.excess, estimator.with_drift(drift.steps)
    elif tare is not None:
        estimator = estimator.with_tare_age(abs(reading.time - tare.time))
    return estimator.estimate(wrench_base, reading.gravity_base, method=method)


def wrench_without_bias(model: ProbeModel, reading: WrenchReading, tare: Tare | None) -> Array:
    """Return the wrench at the base of a reading, without the bias of the tare, if one was taken [N, N·m], (6,)."""
    wrench = reading.wrench_sensor if tare is None else reading.wrench_sensor - tare.bias_sensor
    return model.to_base(wrench, reading.gravity_base)


Row = dict[str, float | str]

COVARIANCE = (("xx", 0, 0), ("xy", 0, 1), ("xz", 0, 2), ("yy", 1, 1), ("yz", 1, 2), ("zz", 2, 2))
#: Columns of an estimate. Contact: the point of the centreline nearest to the line of action of the force; surface: the
#: touched point.
COLUMNS = (
    "time_s", "result", "s_contact_mm", "std_s_mm",
    *(f"p_contact_base_{axis}_mm" for axis in "xyz"),
    *(f"p_surface_base_{axis}_mm" for axis in "xyz"),
    *(f"force_base_{axis}_N" for axis in "xyz"),
    *(f"cov_contact_base_{pair}_mm2" for pair, _, _ in COVARIANCE),
    "detection_chi2",
    *(f"cov_surface_base_{pair}_mm2" for pair, _, _ in COVARIANCE),
    "force_normal_N", "force_tangential_N", "friction_ratio", "s_interval_95_low_mm", "s_interval_95_high_mm",
)  # fmt: skip
#: Additional columns with poses of the base; surface: the touched point at rest, surface_now: after the object yielded,
#: with its compliance and the interval that holds it with a probability of 95 %.
WORLD_COLUMNS = (
    "phase", "fused_result",
    *(f"p_contact_world_{axis}_mm" for axis in "xyz"),
    *(f"p_surface_world_{axis}_mm" for axis in "xyz"),
    *(f"cov_contact_world_{pair}_mm2" for pair, _, _ in COVARIANCE),
    "touch", "stale",
    *(f"cov_surface_world_{pair}_mm2" for pair, _, _ in COVARIANCE),
    *(f"p_surface_now_world_{axis}_mm" for axis in "xyz"),
    *(f"cov_surface_now_world_{pair}_mm2" for pair, _, _ in COVARIANCE),
    "object_compliance_m_N", "object_compliance_low_m_N", "object_compliance_high_m_N",
    "time_to_rest_s",
)  # fmt: skip
TRUE_COLUMNS = ("true_s_contact_mm", *(f"true_p_contact_base_{axis}_mm" for axis in "xyz"),
                *(f"true_p_surface_base_{axis}_mm" for axis in "xyz"))  # fmt: skip


def update_row(update: EstimateUpdate) -> Row:
    """Return the estimate, and what is known in the world, in the units of `COLUMNS` and `WORLD_COLUMNS`."""
    world = {} if update.fused is None else world_row(update)
    return estimate_row(update.reading, update.estimate) | world


def estimate_row(reading: WrenchReading, estimate: Estimate) -> Row:
    """Return the estimate in the units of `COLUMNS`, with `TRUE_COLUMNS` if the truth is known; NaN where unknown."""
    values: list[float | str] = [reading.time, estimate.result, estimate.s_contact / MM, estimate.std_s / MM]
    values += [*_mm(estimate.p_contact_base), *_mm(estimate.p_surface_base), *map(float, estimate.force_base)]
    values += [*_mm2(estimate.cov_contact_base), estimate.detection_chi2, *_mm2(estimate.cov_surface_base)]
    values += [estimate.force_normal, estimate.force_tangential, estimate.friction_ratio]
    values += [bound / MM for bound in interval_only(estimate)]
    return dict(zip(COLUMNS, values, strict=True)) | true_values(reading)


def interval_only(estimate: Estimate) -> tuple[float, float]:
    """Return the 95 % interval of s_contact [m] where that is all that is known; NaN with any other result.

    Of a located contact it would cost as much as the estimate itself, see `Estimate.s_interval_95`.
    """
    return estimate.s_interval_95 if estimate.result == "interval_only" else (math.nan, math.nan)


def true_values(reading: WrenchReading) -> Row:
    """Return the true contact of a simulated reading in the units of `TRUE_COLUMNS`; empty if it is unknown."""
    truth = reading.truth
    if truth is None:
        return {}
    true = [truth.s_contact / MM, *_mm(truth.p_contact_base), *_mm(truth.p_surface_base)]
    return dict(zip(TRUE_COLUMNS, true, strict=True))


def world_row(update: EstimateUpdate) -> Row:
    """Return the fused estimate in the units of `WORLD_COLUMNS`; unknown values are NaN."""
    fused = update.fused or FusedEstimate("out_of_range")
    values: list[float | str] = [update.phase, fused.result]
    values += [*_mm(fused.p_contact_world), *_mm(fused.p_surface_world), *_mm2(fused.cov_contact_world)]
    present = update.contacts[-1].number if update.contacts and update.contacts[-1].ongoing else math.nan
    values += [present, update.stale, *_mm2(fused.cov_surface_world)]
    values += [*_mm(fused.p_surface_now_world), *_mm2(fused.cov_surface_now_world)]
    values += [fused.object_compliance, *map(float, fused.object_compliance_interval_95), update.time_to_rest]
    return dict(zip(WORLD_COLUMNS, values, strict=True))


def _mm2(cov: Array) -> list[float]:
    return [float(cov[i, j]) / MM**2 for _, i, j in COVARIANCE]


def _mm(p: Array) -> list[float]:
    return [float(value) / MM for value in p]


def csv_line(row: Row) -> str:
    """Return the row's `COLUMNS` as a line of CSV: nine digits, the time exactly, empty fields for NaN."""
    time, *values = (row[name] for name in COLUMNS)
    fields = [v if isinstance(v, str) else "" if math.isnan(v) else f"{v:.9g}" for v in values]
    return ",".join([repr(time), *fields]) + "\n"


def json_line(row: Mapping[str, Any]) -> str:
    """Return the row as one line of JSON, with null for non-finite numbers."""
    finite = {n: None if isinstance(v, float) and not math.isfinite(v) else v for n, v in row.items()}
    return json.dumps(finite, allow_nan=False)


def readable_line(update: EstimateUpdate) -> str:
    """Return one line of fixed columns for the terminal; unknown values are blank."""
    reading, estimate = update.reading, update.estimate
    force = math.sqrt(sum(float(f) ** 2 for f in estimate.force_base)) / MILLINEWTON
    s = _format_or_blank("s {:6.1f} ± {:5.1f} mm", estimate.s_contact / MM, estimate.std_s / MM)
    if interval := interval_text(estimate):
        s = interval.ljust(len(s))
    cells = [
        f"{reading.time:9.2f} s",
        f"{estimate.result:<13}",
        s,
        _format_or_blank("p ({:6.1f}, {:6.1f}, {:6.1f}) mm", *_mm(estimate.p_surface_base)),
        _format_or_blank("F {:7.1f} mN", force),
    ]
    if (fused := update.fused) is not None:
        cells.append(f"{update.phase:<8}")
        world = _format_or_blank(
            "world ({:7.2f}, {:7.2f}, {:7.2f}) ± {:5.2f} mm", *_mm(fused.p_surface_world), fused.rms / MM
        )
        note = update.stale and f"world: no {update.stale}"
        cells.append(world if fused.ok or not note else note)
    if reading.truth is not None:
        true_s = reading.truth.s_contact / MM
        cells.append(_format_or_blank("true s {:6.1f} mm", true_s) if math.isfinite(true_s) else "true: free")
    return "  ".join(cells).rstrip()


def interval_text(estimate: Estimate) -> str:
    """Return the interval of `interval_only` in whole millimetres; empty with any other result."""
    low, high = interval_only(estimate)
    return f"between {low / MM:.0f} and {high / MM:.0f} mm" if math.isfinite(low) else ""


def _format_or_blank(template: str, *values: float) -> str:
    if all(math.isfinite(value) for value in values):
        return template.format(*values)
    return " " * len(template.format(*[0.0] * len(values)))


@dataclass(frozen=True)
class ContactMarker:
    """A located contact."""

    p_surface: Array  #: touched point [m], (3,).
    cov: Array  #: its covariance [m²], (3, 3).
    force: Array  #: force of the object on the probe [N], (3,).
    s: float  #: s, std_s: arclength and its standard deviation [m].
    std_s: float
    in_world: bool  #: whether all this is in the world frame; otherwise in the base frame.
    friction_ratio: float = float("nan")  #: tangential over normal force; NaN if unknown.


def contact_marker(update: EstimateUpdate) -> ContactMarker | None:
    """Return the contact, fused if available, otherwise of this reading; None if the estimate is not ok."""
    estimate, fused, T = update.estimate, update.fused, update.T_world_base
    if not estimate.ok:
        return None
    known = bool(np.isfinite(T).all())
    R, origin = (T[:3, :3], T[:3, 3]) if known else (np.eye(3), np.zeros(3))
    surface, cov = R @ estimate.p_surface_base + origin, R @ estimate.cov_surface_base @ R.T
    if known and fused is not None and fused.ok:
        surface, cov = fused.p_surface_world, fused.cov_surface_world
    return ContactMarker(
        surface, cov, R @ estimate.force_base, estimate.s_contact, estimate.std_s, known, estimate.friction_ratio
    )


def bent_shape(update: EstimateUpdate) -> BentShape | None:
    """Return the estimated shape of the probe; None if it is unknown."""
    eq = update.estimate.shape
    return BentShape(eq.s, eq.p_base, eq.R_base) if eq is not None and eq.ok else None
