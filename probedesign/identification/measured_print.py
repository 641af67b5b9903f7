"""Diameters and axis of a print by least squares with the tolerances as prior, and their place in a design.

The diameters d of the K knots have the prior N(d₀, c cᵀ + ε² d₀ d₀ᵀ + σ² I), d₀ as drawn: of the design's tolerances
a deviation c of all knots together and a scatter σ of each for itself, and a scale ε of the whole print, by which
diameters that were not measured follow those that were. A reading at s is y = A(s) d + o + e, linear between the
knots, with an error e of its own and an error o of the calipers that all readings share. The posterior covariance C
goes into the design as a² 1 1ᵀ + b² I that covers it, so that no direction becomes more certain than C.
Where readings contradict the prior, by the chi-square test of the least-squares knots, the prior's covariance is
widened by that chi-square over its degrees of freedom. A reading far from what the others predict is left out and
named: of a third of them at most, because beyond that nobody knows which are wrong.

Source: normal linear model with known covariance; the scales of e and of the prior follow from the residuals where
these are greater than stated (R. T. Birge, Physical Review 40 (1932) 207).
"""

import json
import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from probedesign.core.csv_tables import TableRows, TableSchema, read_lines, read_rows
from probedesign.core.errors import InputError
from probedesign.core.frames import Array
from probedesign.core.statistics import max_chi2
from probedesign.core.units import MM
from probedesign.design import Design
from probedesign.design.edit import Change
from probedesign.design.schema import SCALE_RANGE
from probedesign.estimation.model import Tolerances
from probedesign.geometry import Axis, ProbeGeometry
from probedesign.geometry.probe_geometry import filleted
from probedesign.mount import build_geometry

#: Standard deviation of one reading where its cell is empty [mm]: the jaws indent a soft resin. Assumed.
READING_STD_MM = 0.03
#: Standard deviation of the error that all readings share [mm]: ±0.03 mm of digital calipers (DIN 862), and the force
#: of the jaws on a soft resin. Assumed.
CALIPERS_STD_MM = 0.02
#: Standard deviation of the scale of a whole print, relative. Assumed: the shrinkage of the resins is not published; a
#: change of size by 2 % is taken as two standard deviations.
PRINT_SCALE_STD = 0.01
CONTRADICTION = 0.001  #: Chance of the chi-square test below which the readings contradict the prior.
#: Standard deviations, of what the other readings predict, beyond which a reading is left out: of 14 good readings one
#: is lost in one of 26 sheets, which costs little. The bound grows with the median deviation where all scatter more.
OUTLIER, MAX_OUTLIERS = 3.0, 1.0 / 3.0
MAX_DEVIATIONS = 4.0  #: Standard deviations from the drawn diameter beyond which a reading is of another probe.
SCHEMA = TableSchema(
    what="table of measured diameters",
    kinds={"s": "length", "diameter": "length", "diameter_y": "length", "std": "length"},
    required=("s", "diameter"),
    like="s_mm,diameter_mm,diameter_y_mm,std_mm",
    aliases={"d": "diameter"},
)


@dataclass(frozen=True)
class Calipers:
    """Measured diameters of one print, in one or two directions at a station; of an elliptic section as along x."""

    s: Array  #: arclength of each reading [mm], (n,).
    diameter: Array  #: [mm], (n,).
    std: Array  #: of each reading by itself [mm], (n,).
    places: tuple[str, ...]  #: file and line of each reading, for messages.


@dataclass(frozen=True)
class MeasuredDiameters:
    """Diameters of the knots after a measurement."""

    s: Array  #: knots of the blunt body [mm], (K,).
    drawn: Array  #: diameters of the design [mm], (K,).
    measured: Array  #: posterior mean [mm], (K,).
    cov: Array  #: posterior covariance [mm²], (K, K); of a cylinder that of its one diameter, (1, 1).
    readings: int  #: number of readings that count.
    dropped: tuple[str, ...]  #: readings that were left out, with what the others predict there.
    scale: float  #: factor on the readings' standard deviations; above 1 where they scatter more than stated.
    prior_scale: float  #: factor on the prior's standard deviations; above 1 where the readings contradict it.
    #: before, after: standard deviations before and after: of all diameters together, and of each for itself [mm].
    before: tuple[float, float]
    after: tuple[float, float]

    @property
    def std(self) -> Array:
        """Return the standard deviation of each measured diameter [mm], (K,)."""
        return np.asarray(np.sqrt(np.diag(self.cov))) * np.ones(len(self.s))

    def as_dict(self) -> dict[str, Any]:
        """Return the measurement as plain data."""
        return {
            "s_mm": self.s.tolist(),
            "drawn_mm": self.drawn.tolist(),
            "measured_mm": self.measured.tolist(),
            "std_mm": self.std.tolist(),
            "readings": self.readings,
            "dropped": list(self.dropped),
            "scale": self.scale,
            "prior_scale": self.prior_scale,
            "diameter_mm": {"before": self.before[0], "after": self.after[0]},
            "diameter_scatter_mm": {"before": self.before[1], "after": self.after[1]},
        }


def read_calipers(path: Path, design: Design) -> Calipers:
    """Read a table of measured diameters.

    Args:
        path: CSV file with the columns s, diameter and, optionally, diameter_y (along y, a reading by itself) and std,
            each with its unit; a comment `# fingerprint: DIGITS` names the geometry that was printed.
        design: of the printed probe.

    Raises:
        InputError: the file cannot be used, is of another probe, or a place is not on the flank.
    """
    rows, geometry, probe = read_rows(path, SCHEMA), build_geometry(design), design.probe
    _check_named(rows, "fingerprint", geometry.fingerprint, "the calipers are of geometry {!r}, the design has {}; "
                 "name the design as it was printed, without measured diameters")  # fmt: skip
    values = np.column_stack([rows.required("s", "diameter"), rows.numbers("diameter_y")]) / MM
    std = rows.std("std", np.zeros(len(rows), dtype=bool), "") / MM
    first = 0.0 if probe.base_fillet_mm is None else filleted(probe.blunt_mm, probe.base_fillet_mm)[1]
    last = probe.flank_end_mm
    for row in np.flatnonzero((values[:, 0] < first) | (values[:, 0] > last))[:1]:
        rows.fail(int(row), f"s = {values[row, 0]:g} mm is not on the flank, {first:.4g} ... {last:.4g} mm from the "
                            "base")  # fmt: skip
    for row, column in np.argwhere(values[:, 1:] <= 0.0)[:1]:
        rows.fail(int(row), f"diameter = {values[row, 1 + column]:g} mm is not positive; write the reading of the "
                            "calipers")  # fmt: skip
    std = np.where(np.isnan(std), READING_STD_MM, std)
    row, column = np.nonzero(np.isfinite(values[:, 1:]))
    # along y the section is narrower by its flatness, and so is the error of what is taken as along x
    factor = np.where(column == 1, 1.0 / geometry.cross_section.flatness, 1.0)
    places = tuple(f"{path}:{rows.lines.numbers[i]}" for i in row)
    return Calipers(values[row, 0], factor * values[row, 1 + column], factor * std[row], places)


def _check_named(rows: TableRows, key: str, expected: str, problem: str) -> None:
    """Refuse a comment `# key: NAME` with another name than expected."""
    for number, line in rows.lines.comments:
        match = re.match(rf"\s*#\s*{key}\s*[:=]\s*(\S*)", line, re.IGNORECASE)
        if match and match[1].lower() != expected:
            rows.lines.fail(number, problem.format(match[1], expected))


def _check_shared_error(calipers_std_mm: float) -> None:
    if not 0.0 <= calipers_std_mm <= 1.0:
        raise InputError(f"calipers_std_mm = {calipers_std_mm:g} must lie in 0 ... 1")


def fit_diameters(
    design: Design, tolerances: Tolerances, calipers: Calipers, calipers_std_mm: float = CALIPERS_STD_MM
) -> MeasuredDiameters:
    """Return the diameters of the knots by least squares, with the print's tolerance as prior.

    Args:
        design: the drawn probe.
        tolerances: standard deviations before the measurement.
        calipers: the readings.
        calipers_std_mm: standard deviation of the error that all readings share [mm].

    Raises:
        InputError: a reading deviates more than the print's tolerance allows, the standard deviation is not one, or the
            design has measured diameters already: as a prior, they would count their readings and the calipers' error
            twice.
    """
    if set(design.probe.measured) - {"bow_mm"}:
        raise InputError(
            f"{design.name}: its diameters are measured already; put all readings of the print into one table and "
            "apply it to the design as drawn, whose values the file keeps as comments"
        )
    _check_shared_error(calipers_std_mm)
    s, drawn = (np.array(column) for column in zip(*design.probe.blunt_mm, strict=True))
    common = np.maximum(tolerances.diameter_mm, tolerances.diameter_share * drawn)
    scatter, is_cylinder = tolerances.diameter_scatter_mm, design.probe.shape == "cylinder"
    # a cylinder's one diameter is the mean of its knots, whose scatter the readings have as well
    knots = np.ones((1, len(s))) if is_cylinder else np.eye(len(s))  # by the diameters that are fitted
    A = np.column_stack([np.interp(calipers.s, s, knot) for knot in knots])
    x, c = drawn[: len(knots)], common[: len(knots)]
    of_knot, of_reading = (0.0, scatter) if is_cylinder else (scatter, 0.0)
    prior = np.outer(c, c) + PRINT_SCALE_STD**2 * np.outer(x, x) + of_knot**2 * np.eye(len(x))
    variance, deviation = calipers.std**2 + of_reading**2, calipers.diameter - A @ x
    stated = A @ prior @ A.T + np.diag(variance) + calipers_std_mm**2  # not widened: another probe scatters, too
    kept, dropped = _outliers(stated, deviation, [
        f"{where}: {read:g} mm at s = {at:g} mm"
        for where, read, at in zip(calipers.places, calipers.diameter, calipers.s, strict=True)
    ])  # fmt: skip
    A, variance, deviation = A[kept], variance[kept], deviation[kept]
    W, y = A / np.sqrt(variance)[:, None], deviation / np.sqrt(variance)
    best, _, rank, _ = np.linalg.lstsq(W, y, rcond=None)
    scale = max(1.0, float(np.linalg.norm(W @ best - y)) / math.sqrt(max(len(y) - int(rank), 1)))
    noise = np.diag(scale**2 * variance) + calipers_std_mm**2
    allowed = MAX_DEVIATIONS * np.sqrt(np.diag(stated))[kept]
    worst = int(np.argmax(np.abs(deviation) / allowed))
    if abs(deviation[worst]) > allowed[worst]:
        at, read = calipers.s[kept[worst]], calipers.diameter[kept[worst]]
        raise InputError(f"{calipers.places[kept[worst]]}: diameter = {read:g} mm where the design has "
                         f"{read - deviation[worst]:.3f} mm at s = {at:g} mm; the tolerance of the print allows "
                         f"±{allowed[worst]:.2f} mm: check probe, unit and place, or widen diameter_mm in "
                         "[tolerances]")  # fmt: skip
    prior_scale = _contradiction(A, prior, noise, deviation)
    prior = prior_scale**2 * prior
    gain = np.linalg.solve(A @ prior @ A.T + noise, A @ prior).T
    joseph = np.eye(len(x)) - gain @ A  # the form that stays positive
    cov = joseph @ prior @ joseph.T + gain @ noise @ gain.T
    together, each = (float(np.sqrt(cov[0, 0])), scatter) if is_cylinder else covering(cov)
    measured = np.round((x + gain @ deviation) @ knots, 3)  # a design gets micrometres
    return MeasuredDiameters(s, drawn, measured, cov, len(kept), dropped, scale, prior_scale,
                             (float(common.max()), scatter), (together, each))  # fmt: skip


def _outliers(cov: Array, deviation: Array, names: list[str]) -> tuple[list[int], tuple[str, ...]]:
    """Return the readings that count, and the names of those that are far from what all others predict.

    With P the covariance of all deviations r, the others predict r_i with the residual (P⁻¹r)_i / (P⁻¹)_ii, of variance
    1/(P⁻¹)_ii (C. E. Rasmussen, C. Williams, Gaussian Processes for Machine Learning, 2006, eq. 5.12).
    """
    kept, dropped = list(range(len(deviation))), list[str]()
    for _ in range(int(MAX_OUTLIERS * len(deviation))):
        precision = np.linalg.inv(cov[np.ix_(kept, kept)])
        residual = precision @ deviation[kept] / np.diag(precision)
        t = np.abs(residual) * np.sqrt(np.diag(precision))
        worst = int(np.argmax(t))
        if t[worst] <= OUTLIER * max(1.0, float(np.median(t)) / 0.6745):  # the median of a normal deviate
            break
        dropped.append(f"{names[kept[worst]]}, {residual[worst]:+.2f} mm off what the others predict")
        del kept[worst]
    return kept, tuple(dropped)


def _contradiction(A: Array, prior: Array, noise: Array, deviation: Array) -> float:
    """Return the factor on the prior's standard deviations by which it agrees with the readings; 1 if it does.

    The chi-square of all readings less that of their residuals about straight pieces is that of the knots, with as many
    degrees of freedom as the readings determine.
    """
    L = np.linalg.cholesky(noise)
    W, y = np.linalg.solve(L, A), np.linalg.solve(L, deviation)
    x, _, rank, _ = np.linalg.lstsq(W, y, rcond=None)
    residual = float(np.sum((W @ x - y) ** 2))
    whole = float(deviation @ np.linalg.solve(A @ prior @ A.T + noise, deviation))
    square = max(whole - residual, 0.0)
    return float(np.sqrt(square / rank)) if square > max_chi2(int(rank), CONTRADICTION) else 1.0


def covering(cov: Array) -> tuple[float, float]:
    """Return a and b with a² 1 1ᵀ + b² I ⪰ C: by the mean covariance of two knots.

    Args:
        cov: C, positive definite, (K, K).
    """
    n = len(cov)
    together = max(float(cov.sum() - np.trace(cov)) / (n * (n - 1)), 0.0)
    rest = float(np.linalg.eigvalsh(cov - together)[-1])
    return float(np.sqrt(together)), float(np.sqrt(max(rest, 0.0)))


def diameter_changes(measurement: MeasuredDiameters, design: Design, day: str) -> tuple[Change, ...]:
    """Return the changes of a design by measured diameters: the dimensions, their provenance and the tolerances.

    Where E was identified with the former diameters, it changes with the base diameter as
    `youngs_modulus_by_diameter` states, because it is E·d⁴ that was measured.

    Args:
        measurement: the measured diameters.
        design: that was measured.
        day: for the comments.
    """
    probe = design.probe
    mean = [float(d) for d in measurement.measured]
    note = f"measured {day}, {measurement.readings} readings: ± {{:.2g}} mm (one standard deviation)"
    changes = [Change("probe", "base_d_mm", repr(mean[0]), note.format(measurement.std[0]))]
    if probe.tip_d_mm is not None:
        changes.append(Change("probe", "tip_d_mm", repr(mean[-1]), note.format(measurement.std[-1])))
    if probe.profile_mm is not None:
        pairs = json.dumps([[float(s), d] for s, d in zip(measurement.s, mean, strict=True)])
        changes.append(Change("probe", "profile_mm", pairs, note.format(measurement.std.max())))
    keys = [change.key for change in changes]
    changes.append(_measured(design, *keys))
    if set(probe.assumed) & set(keys):
        changes.append(Change("probe", "assumed", json.dumps([key for key in probe.assumed if key not in keys])))
    together, each = measurement.after
    after = f"measured {day}: "
    changes += [
        Change("tolerances", "diameter_mm", f"{together:.3g}", after + "of all diameters together"),
        Change("tolerances", "diameter_share", "0.0", after + "diameter_mm holds for all diameters"),
        Change("tolerances", "diameter_scatter_mm", f"{each:.3g}", after + "of each diameter for itself"),
    ]
    power = design.tolerances.youngs_modulus_by_diameter or 0.0
    if power and design.material.youngs_modulus_mpa is not None:
        E = design.material.youngs_modulus_mpa * (mean[0] / float(measurement.drawn[0])) ** power
        because = f"changed {day} with the base diameter, to the power {power:g}; identify again"
        changes.append(Change("material", "youngs_modulus_mpa", f"{E:.4g}", because))
    return tuple(changes)


def bow_changes(design: Design, bow_mm: tuple[float, float], std_mm: float, note: str) -> tuple[Change, ...]:
    """Return the changes of a design by the measured bow of a print.

    Args:
        design: that was measured.
        bow_mm: deviation of the unloaded tip from the axis of the base, towards x and y [mm].
        std_mm: standard deviation of the measurement, in each direction [mm].
        note: for the comments: how and when it was found.

    Raises:
        InputError: the bow is not smaller than the length, or the standard deviation is not one.
    """
    length = design.probe.length_mm
    if not math.hypot(*bow_mm) < length:
        x, y = bow_mm
        raise InputError(f"--bow-mm {x:g} {y:g} must be a deviation smaller than the length, {length:g} mm")
    if not 0.0 <= std_mm < length:
        raise InputError(f"--bow-std-mm {std_mm:g} is a standard deviation; it must lie in 0 ... {length:g}")
    return (
        Change("probe", "bow_mm", json.dumps(list(bow_mm)), f"{note}: deviation of the tip towards x and y"),
        _measured(design, "bow_mm"),
        Change("tolerances", "bow_mm", f"{std_mm:g}", f"{note}: standard deviation of the measurement"),
    )


def _measured(design: Design, *keys: str) -> Change:
    values = list(dict.fromkeys((*design.probe.measured, *keys)))
    return Change("probe", "measured", json.dumps(values), "measured on the print")


# the scale of the next print, from a coupon that was printed unscaled


MIN_ROWS = 3
LENGTH_ROWS = "coupon_length"  #: Name in the column `part` of the rows with lengths.
COUPON_SCHEMA = TableSchema(
    what="table of a coupon's diameters",
    kinds={"part": "name", "s": "length", "drawn": "length", "diameter_x": "length", "diameter_y": "length"},
    required=("part", "drawn", "diameter_x"),
    like="part,s_mm,drawn_mm,diameter_x_mm,diameter_y_mm",
    aliases={},
)


@dataclass(frozen=True)
class CouponScale:
    """Scale and offset that compensate for how a coupon came out: measured = drawn / scale_xy + offset."""

    scale_xy: float  #: scale_xy, std: the scale of the diameters, and its standard deviation.
    std: float
    #: offset_mm, offset_std_mm: by how much all diameters are wider, whatever their size [mm]; 0 where it is within two
    #: of its standard deviations, so that the scale alone explains the readings.
    offset_mm: float
    offset_std_mm: float
    scale_z: float | None  #: scale_z, std_z: the scale of the lengths; None where none was read.
    std_z: float | None
    left_mm: float  #: largest deviation of a diameter from what these explain [mm].
    rows: int  #: number of diameters with a reading.


def is_coupon_sheet(path: Path) -> bool:
    """Return whether a file is the sheet of a coupon: its header has the column of drawn diameters."""
    if not path.is_file():
        return False
    lines = read_lines(path, COUPON_SCHEMA.what, COUPON_SCHEMA.like)
    return any(name.strip().startswith("drawn") for name in lines.header)


def read_coupon(path: Path, resin: str) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
    """Read the sheet of a coupon.

    Args:
        path: of the sheet; a comment `# resin: NAME` states what the coupon was printed in.
        resin: name of the resin of the probe.

    Returns:
        Drawn and mean measured size of each place with a reading [mm], its number of readings, and whether it is a
        length, (n,) each.

    Raises:
        InputError: the file cannot be used, is of another resin, or too few places have a reading.
    """
    rows = read_rows(path, COUPON_SCHEMA)
    _check_named(rows, "resin", resin, "the coupon is of {!r}, the design of {}; a shrinkage is that of one resin")
    values = rows.numbers("drawn", "diameter_x", "diameter_y") / MM
    for row in np.flatnonzero(~(values[:, 0] > 0.0) | (values[:, 1:] <= 0.0).any(axis=1))[:1]:
        rows.fail(int(row), "drawn_mm and the diameters must be positive; leave what was not measured empty")
    count = np.isfinite(values[:, 1:]).sum(axis=1)
    read = count > 0
    is_length = np.array([name == LENGTH_ROWS for name in rows.texts("part")])
    across = read & ~is_length
    if across.sum() < MIN_ROWS or len(set(values[across, 0])) < 2:
        raise InputError(f"{path}: {int(across.sum())} places with a reading; fill in at least {MIN_ROWS}, of two "
                         "diameters")  # fmt: skip
    return values[read, 0], np.nanmean(values[read, 1:], axis=1), count[read], is_length[read]


def fit_scale(
    drawn: Array, measured: Array, count: Array, is_length: NDArray[np.bool_], calipers_std_mm: float
) -> CouponScale:
    """Return scale and offset of the next print by weighted least squares.

    Args:
        drawn, measured: diameters and lengths of the coupon [mm], (n,).
        count: number of readings of each, (n,).
        is_length: which of them are lengths, (n,).
        calipers_std_mm: standard deviation of the error that all readings share [mm].

    Raises:
        InputError: a scale is out of the range of a shrinkage.
    """
    _check_shared_error(calipers_std_mm)
    scale_z: tuple[float | None, float | None] = (None, None)
    if is_length.any():
        scale_z = _scale_of(drawn[is_length], measured[is_length], count[is_length], calipers_std_mm, False)[:2]
    d, y, count = drawn[~is_length], measured[~is_length], count[~is_length]
    scale, std, offset, offset_std, left = _scale_of(d, y, count, calipers_std_mm, True)
    if abs(offset) <= 2.0 * offset_std:
        scale, std, offset, _, left = _scale_of(d, y, count, calipers_std_mm, False)
    return CouponScale(scale, std, offset, offset_std, *scale_z, left, len(d))


def _scale_of(
    drawn: Array, measured: Array, count: Array, calipers_std_mm: float, with_offset: bool
) -> tuple[float, float, float, float, float]:
    """Return scale, offset and their standard deviations, and the largest residual."""
    A = np.column_stack([drawn, np.ones(len(drawn))][: 1 + with_offset])
    W = A * np.sqrt(count)[:, None] / READING_STD_MM
    gain = np.linalg.pinv(W) * np.sqrt(count) / READING_STD_MM
    x = gain @ measured
    size, offset = float(x[0]), float(x[1]) if with_offset else 0.0
    if not SCALE_RANGE[0] <= 1.0 / size <= SCALE_RANGE[1]:
        raise InputError(f"the coupon is {size:.4g} times as large as drawn; allowed is 1/{SCALE_RANGE[1]:g} ... "
                         f"1/{SCALE_RANGE[0]:g}: check the unit and the sheet")  # fmt: skip
    residuals = measured - A @ x
    # Readings that scatter more than stated count less (R. T. Birge, Physical Review 40 (1932) 207).
    square = float(count @ residuals**2) / READING_STD_MM**2
    scatter = max(1.0, square / max(len(drawn) - len(x), 1))
    shared = calipers_std_mm * gain.sum(axis=1)
    std = np.sqrt(scatter * np.diag(np.linalg.inv(W.T @ W)) + shared**2)
    return 1.0 / size, float(std[0]) / size**2, offset, float(std[-1]), float(np.abs(residuals).max())


def scale_changes(coupon: CouponScale, day: str) -> tuple[Change, ...]:
    """Return the changes of a design by a coupon; `day` is for the comment."""
    note = f"measured {day} on a coupon"
    more = f"{coupon.rows} places: ± {{:.2g}} (one standard deviation)"
    changes = [
        Change("print", "scale_xy", f"{coupon.scale_xy:.4f}", f"{note}, {more.format(coupon.std)}"),
        Change("print", "offset_xy_mm", f"{coupon.offset_mm:.3f}", f"{note}, {more.format(coupon.offset_std_mm)}"),
    ]
    if coupon.scale_z is not None:
        changes.append(Change("print", "scale_z", f"{coupon.scale_z:.4f}", f"{note}: ± {coupon.std_z:.2g}"))
    return tuple(changes)


# the axis of a print from points of its outline
#
# The measured axis is the designed one with a constant curvature added, the bow, which any design states as `bow_mm`;
# an arc's change of amplitude is one. A helix or an axis by knots also has a factor on its curvature, which the design
# states in the keys of its axis. A residual is the distance of a point from the tube about the axis, in its standard
# deviation. The pose of the readings to the base is free within the accuracy of aligning them: two tilts, two offsets.

#: Standard deviation of a point where its cell is empty [mm]: a pixel of a photograph, or calipers on a soft body
#: (assumed).
POINT_STD_MM = 0.3
#: Standard deviations of aligning the readings with the base: tilt [deg] and offset [mm] (assumed), and of the factor
#: on the curvature of a helix [%]: the shrinkage of a resin bends it less by far (assumed).
TILT_STD_DEG, OFFSET_STD_MM, FACTOR_STD = 0.3, 0.2, 5.0
UNOBSERVED = 1e-8  #: Information on each parameter that is added [1/mm²]: the inverse exists where points show none.
MAX_OUTLINE_DEVIATIONS = 5.0  #: Of a point, beyond which it does not belong to this surface.
STATIONS = 401  #: Of the axis; the section of a point between two is then exact to 1e-5 mm.
OUTLINE_SCHEMA = TableSchema(
    what="table of points of the outline",
    kinds={"x": "length", "y": "length", "z": "length", "std": "length"},
    required=("x", "y", "z"),
    like="x_mm,y_mm,z_mm",
    aliases={},
)


@dataclass(frozen=True)
class OutlinePoints:
    """Points on the surface of a print in base axes."""

    p_mm: Array  #: (n, 3) [mm].
    std_mm: Array  #: standard deviation of each along the normal of the surface [mm], (n,).
    places: tuple[str, ...]  #: file and line of each point, for messages.


@dataclass(frozen=True)
class MeasuredAxis:
    """The axis of a print."""

    bow_mm: tuple[float, float]  #: deviation of the tip towards X and Y by the constant curvature [mm].
    bow_std_mm: float  #: standard deviation, in the worse direction, with that of the factor as a deviation of the tip.
    factor: float  #: on the designed curvature of a helix or of knots; 1 where the points do not determine it.
    factor_std: float  #: its standard deviation; 0 where it is not determined.
    before_mm: float  #: tolerance of the bow before [mm].
    points: int  #: number of points.
    rms_mm: float  #: of their distances from the fitted surface [mm].
    scale: float  #: factor on their standard deviations; above 1 where they scatter more than stated.


def read_outline(path: Path) -> OutlinePoints:
    """Read points of the outline.

    Args:
        path: CSV file with the columns x, y, z and, optionally, std, each with its unit.

    Raises:
        InputError: the file cannot be used.
    """
    rows = read_rows(path, OUTLINE_SCHEMA)
    p = rows.required("x", "y", "z") / MM
    std = rows.std("std", np.zeros(len(rows), dtype=bool), "") / MM
    places = tuple(f"{path}:{number}" for number in rows.lines.numbers)
    return OutlinePoints(p, np.where(np.isnan(std), POINT_STD_MM, std), places)


def fit_axis(design: Design, outline: OutlinePoints, before_mm: float) -> MeasuredAxis:
    """Return the axis of a print by least squares.

    Args:
        design: that was printed.
        outline: the readings.
        before_mm: standard deviation of the bow before [mm].

    Raises:
        InputError: a point is not on this probe, or the points do not determine the bow better than before.
    """
    geometry, count = build_geometry(design), len(outline.p_mm)
    prior = np.array([np.inf, np.inf, TILT_STD_DEG, TILT_STD_DEG, OFFSET_STD_MM, OFFSET_STD_MM, FACTOR_STD])
    bends = not geometry.axis.is_arc
    if count < 4:
        raise InputError(f"{outline.places[0]}: {count} points of the outline; at least 4, on two sides of the probe")
    start = _distances(geometry, np.zeros(7), outline)
    far = int(np.argmax(np.abs(start)))
    if abs(start[far]) > 0.25 * geometry.length / MM:
        raise InputError(f"{outline.places[far]}: {abs(start[far]):.3g} mm from the surface of the design; check the "
                         "unit, and that x, y, z are in base axes: z along the axis at the base, x through the "
                         "clocking mark")  # fmt: skip
    for free in [7, 6] if bends else [6]:  # with the factor, where the points determine it to half of its prior
        x, J, residual = _solve(geometry, outline, prior[:free])
        cov = np.linalg.inv(J.T @ J + UNOBSERVED * np.eye(free))
        if free == 6 or math.sqrt(cov[6, 6]) < 0.5 * FACTOR_STD:
            break
    distances = _distances(geometry, np.pad(x, (0, 7 - free)), outline)
    scale = max(1.0, math.sqrt(float(residual[:count] @ residual[:count]) / max(count - 2 - (free == 7), 1)))
    worst = int(np.argmax(np.abs(distances) / outline.std_mm))
    others = np.delete(distances / outline.std_mm, worst)
    typical = max(1.0, float(np.sqrt(np.mean(others**2))))
    if abs(distances[worst]) > MAX_OUTLINE_DEVIATIONS * typical * outline.std_mm[worst]:
        raise InputError(f"{outline.places[worst]}: {abs(distances[worst]):.3g} mm from the surface that the other "
                         "points show; correct or remove it")  # fmt: skip
    cov = scale**2 * cov
    factor_std = math.sqrt(cov[6, 6]) / 100.0 if free == 7 else 0.0
    shape = [0, 1, 6] if free == 7 else [0, 1]
    unit = np.array([1.0, 1.0, 0.01])[: len(shape)]
    std = deviation_std_mm(geometry.axis, np.asarray(cov[np.ix_(shape, shape)] * np.outer(unit, unit), dtype=float))
    if std > 1.0 / math.sqrt(10.0 * UNOBSERVED):
        raise InputError(f"{outline.places[0]}: these {count} points show the bow in one plane only; add points of the "
                         "sides at right angles to it, as of a second photograph")  # fmt: skip
    if not std < before_mm:
        raise InputError(f"{outline.places[0]}: these {count} points determine the bow to ± {std:.2g} mm, its "
                         f"tolerance is ± {before_mm:.2g} mm already; measure more points on two sides, up to the "
                         "tip")  # fmt: skip
    factor, rms = 1.0 + (x[6] / 100.0 if free == 7 else 0.0), math.sqrt(float(distances @ distances) / count)
    return MeasuredAxis((float(x[0]), float(x[1])), std, factor, factor_std, before_mm, count, rms, scale)


def _solve(geometry: ProbeGeometry, outline: OutlinePoints, prior: Array) -> tuple[Array, Array, Array]:
    unused = np.zeros(7 - len(prior))

    def residuals(x: Array) -> Array:
        away = _distances(geometry, np.append(x, unused), outline) / outline.std_mm
        return np.concatenate([away, x / prior])

    def jacobian(x: Array) -> Array:
        return np.stack([(residuals(x + d) - residuals(x - d)) / 2e-3 for d in 1e-3 * np.eye(len(x))], axis=1)

    minimum = least_squares(residuals, np.zeros(len(prior)), jacobian, x_scale=np.minimum(prior, 1.0))
    return minimum.x, np.asarray(minimum.jac), minimum.fun


def _distances(geometry: ProbeGeometry, x: Array, outline: OutlinePoints) -> Array:
    """Return the distances of points from the surface, outside positive [mm].

    Args:
        geometry: as designed.
        x: bow towards X and Y [mm], tilts about x and y [deg], offsets along x and y [mm], factor less one [%].
        outline: the points.
    """
    axis = geometry.axis.scaled(1.0 + x[6] / 100.0).with_curvature(2.0 * MM / geometry.length**2 * x[:2])
    s = np.linspace(0.0, geometry.length, STATIONS)
    T = axis.frames(s)
    turn = Rotation.from_rotvec(np.radians([x[2], x[3], 0.0]))
    p = turn.apply(outline.p_mm * MM) + np.array([x[4], x[5], 0.0]) * MM
    i = np.argmin(np.linalg.norm(p[:, None] - T[None, :, :3, 3], axis=2), axis=1)
    local = np.einsum("nji,nj->ni", T[i, :3, :3], p - T[i, :3, 3])
    k = axis.curvature_at(s[i])
    ds = local[:, 2] / (1.0 - np.sum(k * local[:, :2], axis=1))
    q = local[:, :2] - 0.5 * k * ds[:, None] ** 2
    beyond = ((i == 0) & (ds < 0.0)) | ((i == STATIONS - 1) & (ds > 0.0))
    side = np.arctan2(q[:, 1], q[:, 0])
    reach = np.array([geometry.cross_section.reach(float(a)) for a in side])
    away = np.linalg.norm(q, axis=1) - reach * geometry.radius_at(s[i] + ds)
    return np.asarray(np.where(beyond, np.hypot(ds, np.maximum(away, 0.0)), away) / MM)


def deviation_std_mm(axis: Axis, cov: Array) -> float:
    """Return the standard deviation of the bow in its worse direction, with that of the factor on the curvature [mm].

    The factor moves the tip as the nearest bow does, which counts with its correlation, and across what any bow does.

    Args:
        axis: as designed.
        cov: covariance of the bow towards X and Y [mm] and, where it is 3×3, of the factor.
    """
    if len(cov) == 2:
        return math.sqrt(float(np.linalg.eigvalsh(cov)[-1]))
    per_mm = 2.0 * MM / axis.length**2 * np.eye(2)
    moved = [axis.with_curvature(sign * bow) for bow in per_mm for sign in (1.0, -1.0)]
    moved += [axis.scaled(factor) for factor in (1.005, 0.995)]
    tips = np.array([other.frames([axis.length])[0, :3, 3] / MM for other in moved])
    x, y, by_factor = (tips[0::2] - tips[1::2]) / [[2.0], [2.0], [0.01]]
    nearest, across = np.linalg.lstsq(np.stack([x, y], axis=1), by_factor)[:2]
    A = np.column_stack([np.eye(2), nearest])
    return math.sqrt(float(np.linalg.eigvalsh(A @ cov @ A.T)[-1]) + float(across[0]) * cov[2, 2])


def axis_changes(
    design: Design, bow_mm: tuple[float, float] | None, std_mm: float, factor: tuple[float, float] | None, note: str
) -> tuple[Change, ...]:
    """Return the changes of a design by the axis of a print.

    Args:
        design: of the print.
        bow_mm: towards X and Y [mm]; None where it is not known.
        std_mm: standard deviation of the bow, with that of the factor [mm].
        factor: on the curvature of the design, and its standard deviation; None where it is not known.
        note: for the comments: how and when it was found.
    """
    changes: list[Change] = []
    if bow_mm is not None:
        x, y = (round(value, 2) for value in bow_mm)
        changes += bow_changes(design, (x, y), max(float(f"{std_mm:.2g}"), 0.01), note)
    if factor is not None:
        key, curvature = design.probe.scaled_axis(factor[0])
        text = json.dumps(np.round(curvature, 4).tolist())
        changes.append(Change("probe", key, text, f"{note}: {factor[0]:.4f} ± {factor[1]:.2g} of the curvature drawn"))
    return tuple(changes)
