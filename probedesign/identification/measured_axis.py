"""The axis of a print from points of its outline, by least squares, and its place in a design.

The measured axis is the designed one with a constant curvature added, the bow, which any design states as `bow_mm`; an
arc's change of amplitude is one. A helix or an axis by knots also has a factor on its curvature, which the design
states in the keys of its axis. A residual is the distance of a point from the tube about the axis, in its standard
deviation. The pose of the readings to the base is free within the accuracy of aligning them: two tilts, two offsets.
"""

import json
import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from probedesign.core.csv_tables import TableSchema, read_rows
from probedesign.core.errors import InputError
from probedesign.core.frames import Array
from probedesign.core.units import MM
from probedesign.design import Design
from probedesign.design.edit import Change
from probedesign.geometry import Axis, ProbeGeometry
from probedesign.identification.measured_diameters import bow_changes
from probedesign.mount import build_geometry

#: Standard deviation of a point where its cell is empty [mm]: a pixel of a photograph, or calipers on a soft body
#: (assumed).
POINT_STD_MM = 0.3
#: Standard deviations of aligning the readings with the base: tilt [deg] and offset [mm] (assumed), and of the factor
#: on the curvature of a helix [%]: the shrinkage of a resin bends it less by far (assumed).
TILT_STD_DEG, OFFSET_STD_MM, FACTOR_STD = 0.3, 0.2, 5.0
UNOBSERVED = 1e-8  #: Information on each parameter that is added [1/mm²]: the inverse exists where points show none.
MAX_DEVIATIONS = 5.0  #: Of a point, beyond which it does not belong to this surface.
STATIONS = 401  #: Of the axis; the section of a point between two is then exact to 1e-5 mm.
SCHEMA = TableSchema(
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

    def as_dict(self) -> dict[str, Any]:
        """Return plain data."""
        return asdict(self)


def read_outline(path: Path) -> OutlinePoints:
    """Read points of the outline.

    Args:
        path: CSV file with the columns x, y, z and, optionally, std, each with its unit.

    Raises:
        InputError: the file cannot be used.
    """
    rows = read_rows(path, SCHEMA)
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
    if abs(distances[worst]) > MAX_DEVIATIONS * typical * outline.std_mm[worst]:
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

    found = least_squares(residuals, np.zeros(len(prior)), jacobian, x_scale=np.minimum(prior, 1.0))
    return found.x, np.asarray(found.jac), found.fun


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
