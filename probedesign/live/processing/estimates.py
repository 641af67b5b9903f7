"""What live says of one moment."""

import json
import math
from dataclasses import dataclass, field

import numpy as np

from probedesign.estimation.estimate import Estimate
from probedesign.estimation.estimator import Estimator, Method
from probedesign.estimation.fused import FusedEstimate
from probedesign.frames import Array
from probedesign.live.processing.blocks import Reading
from probedesign.live.processing.tare import Tare, without_bias
from probedesign.live.processing.touches import Contact, Phase
from probedesign.units import MILLINEWTON, MM


def _unknown_pose() -> Array:
    return np.full((4, 4), np.nan)


@dataclass(frozen=True)
class Answer:
    """One estimate and what belongs to it.

    Attributes:
        reading: what was estimated from, averaged, its bias included.
        estimate: from this reading alone, in the base frame.
        phase: of the touch, as in the paper's figure 8: free, moving, touching, settled or released; empty where
            nobody watches.
        fused: the touched point from all readings of this touch; None where nothing is fused.
        T_world_base: pose of the base, (4, 4); NaN if it is not known.
        wrench_base: what was estimated from, without bias, at the base [N, N·m], (6,); NaN where there is a fault.
        made: when it was there, by `time.monotonic` [s].
        stale: what is too old or missing to be used: "pose", or nothing.
        contacts: every touch so far, the present one included.
    """

    reading: Reading
    estimate: Estimate
    phase: Phase = ""
    fused: FusedEstimate | None = None
    T_world_base: Array = field(default_factory=_unknown_pose)
    wrench_base: Array = field(default_factory=lambda: np.full(6, np.nan))
    made: float = float("nan")
    stale: str = ""
    contacts: tuple[Contact, ...] = ()


def locate(estimator: Estimator, read: Reading, tare: Tare | None = None, method: Method = "ml") -> Estimate:
    """Return the estimate of one reading; a channel at its limit counts as read, before the bias is taken off.

    The variance of the bias grows with the age of the tare.

    Args:
        estimator: of the probe.
        read: bias included.
        tare: of the bias; None where none was taken.
        method: as in `Estimator.estimate`.
    """
    if read.fault or not estimator.model.reads(read.wrench_sensor):
        return Estimate("out_of_range")
    reading = without_bias(read, tare)
    wrench_base = estimator.model.to_base(reading.wrench_sensor, reading.gravity_base)
    if tare is not None:
        estimator = estimator.since_tare(read.time - tare.time)
    return estimator.estimate(wrench_base, reading.gravity_base, method=method)


Row = dict[str, float | str]

COVARIANCE = (("xx", 0, 0), ("xy", 0, 1), ("xz", 0, 2), ("yy", 1, 1), ("yz", 1, 2), ("zz", 2, 2))
COLUMNS = (
    "time_s",
    "result",
    "s_contact_mm",
    "std_s_mm",
    *(f"p_contact_base_{axis}_mm" for axis in "xyz"),
    *(f"p_surface_base_{axis}_mm" for axis in "xyz"),
    *(f"force_base_{axis}_N" for axis in "xyz"),
    *(f"cov_contact_base_{pair}_mm2" for pair, _, _ in COVARIANCE),
    "detection_chi2",
    *(f"cov_surface_base_{pair}_mm2" for pair, _, _ in COVARIANCE),
    "force_normal_N",
    "force_tangential_N",
    "friction_ratio",
)
"""Contact: the centreline point where the force's line of action comes nearest; surface: the touched point."""
WORLD_COLUMNS = (
    "phase",
    "fused_result",
    *(f"p_contact_world_{axis}_mm" for axis in "xyz"),
    *(f"p_surface_world_{axis}_mm" for axis in "xyz"),
    *(f"cov_contact_world_{pair}_mm2" for pair, _, _ in COVARIANCE),
    "touch",
    "stale",
    *(f"cov_surface_world_{pair}_mm2" for pair, _, _ in COVARIANCE),
)
"""Where poses of the base are known, after `COLUMNS`."""
TRUE_COLUMNS = ("true_s_contact_mm", *(f"true_p_contact_base_{axis}_mm" for axis in "xyz"),
                *(f"true_p_surface_base_{axis}_mm" for axis in "xyz"))  # fmt: skip


def estimate_row(reading: Reading, estimate: Estimate) -> Row:
    """The estimate in the units of `COLUMNS`, and of `TRUE_COLUMNS` where the truth is known; what the result
    does not tell is NaN."""
    values: list[float | str] = [reading.time, estimate.result, estimate.s_contact / MM, estimate.std_s / MM]
    values += [*_mm(estimate.p_contact_base), *_mm(estimate.p_surface_base), *map(float, estimate.force_base)]
    values += [*_mm2(estimate.cov_contact_base), estimate.detection_chi2, *_mm2(estimate.cov_surface_base)]
    values += [estimate.force_normal, estimate.force_tangential, estimate.friction_ratio]
    answer: Row = dict(zip(COLUMNS, values, strict=True))
    if (truth := reading.truth) is not None:
        true = [truth.s_contact / MM, *_mm(truth.p_contact_base), *_mm(truth.p_surface_base)]
        answer |= dict(zip(TRUE_COLUMNS, true, strict=True))
    return answer


def world_row(answer: Answer) -> Row:
    """The answer in the units of `WORLD_COLUMNS`; what it does not tell is NaN."""
    fused = answer.fused or FusedEstimate("out_of_range")
    values: list[float | str] = [answer.phase, fused.result]
    values += [*_mm(fused.p_contact_world), *_mm(fused.p_surface_world)]
    values += _mm2(fused.cov_contact_world)
    present = answer.contacts[-1].number if answer.contacts and answer.contacts[-1].lasts else math.nan
    values += [present, answer.stale, *_mm2(fused.cov_surface_world)]
    return dict(zip(WORLD_COLUMNS, values, strict=True))


def _mm2(cov: Array) -> list[float]:
    return [float(cov[i, j]) / MM**2 for _, i, j in COVARIANCE]


def _mm(p: Array) -> list[float]:
    return [float(value) / MM for value in p]


def csv_line(estimate_row: Row) -> str:
    """The row's `COLUMNS` as a line of CSV: nine digits, the time to its last bit, nothing for NaN."""
    return ",".join(_csv_field(name, estimate_row[name]) for name in COLUMNS) + "\n"


def _csv_field(name: str, value: float | str) -> str:
    if isinstance(value, str):
        return value
    if math.isnan(value):
        return ""
    return repr(value) if name == "time_s" else f"{value:.9g}"


def json_line(estimate_row: Row) -> str:
    """The row as one line of JSON, null for what is not finite."""
    return json.dumps({name: _finite_or_null(value) for name, value in estimate_row.items()}, allow_nan=False)


def _finite_or_null(value: float | str) -> float | str | None:
    return value if isinstance(value, str) or math.isfinite(value) else None


def readable_line(since: float, reading: Reading, estimate: Estimate, answer: Answer | None = None) -> str:
    """One line of fixed columns for a person; what the result does not tell is left blank.

    Args:
        since: when it was read, counted from the first line [s].
        reading: what was estimated from.
        estimate: the answer.
        answer: for phase and place in the world, where poses of the base are known.
    """
    force = math.sqrt(sum(float(f) ** 2 for f in estimate.force_base)) / MILLINEWTON
    cells = [
        f"{since:9.2f} s",
        f"{estimate.result:<13}",
        _cell("s {:6.1f} ± {:5.1f} mm", estimate.s_contact / MM, estimate.std_s / MM),
        _cell("p ({:6.1f}, {:6.1f}, {:6.1f}) mm", *_mm(estimate.p_surface_base)),
        _cell("F {:7.1f} mN", force),
    ]
    if answer is not None and answer.fused is not None:
        fused = answer.fused
        cells.append(f"{answer.phase:<8}")
        place = _cell(
            "world ({:7.2f}, {:7.2f}, {:7.2f}) ± {:5.2f} mm", *_mm(fused.p_surface_world), fused.rms / MM
        )
        told = answer.stale and f"world: no {answer.stale}"
        cells.append(place if fused.ok or not told else told)
    if reading.truth is not None:
        true_s = reading.truth.s_contact / MM
        cells.append(_cell("true s {:6.1f} mm", true_s) if math.isfinite(true_s) else "true: free")
    return "  ".join(cells).rstrip()


def _cell(template: str, *values: float) -> str:
    """The template with its numbers; blanks as wide where there are none."""
    if all(math.isfinite(value) for value in values):
        return template.format(*values)
    return " " * len(template.format(*[0.0] * len(values)))
