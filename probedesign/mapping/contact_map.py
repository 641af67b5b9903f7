"""Map of the touched points, and its files: CSV, JSON, lines of text and a PLY point cloud.

Touches of the same point are recognised and fused, and common errors are estimated jointly. Two touches may belong to
one point if their Mahalanobis distance, with common error sources counted as common, is small, and if their uncertainty
is small enough to distinguish another point: vague touches agree with everything and remain separate.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from probedesign.core import csv_tables, statistics
from probedesign.core.frames import Array
from probedesign.core.units import MILLINEWTON, MM
from probedesign.estimation.fusion_state import HALF_NORMAL
from probedesign.live.processing.estimates import COVARIANCE
from probedesign.mapping.touch_point import RESULT_MEANINGS, ConditionalPoint, LocatedTouch

MIN_SEPARATION = 5e-3  #: Default distance below which points of an object are not distinguished [m].
#: Squared Mahalanobis distance of two touches of one point that is exceeded with probability 0.01.
SAME_POINT_CHI2 = statistics.max_chi2(3, 0.01)


@dataclass(frozen=True)
class MapPoint:
    """A point of the world."""

    p_world: Array  #: on the surface of the object [m], (3,).
    cov_world: Array  #: with all error sources [m²], (3, 3).
    cov_common: Array  #: the part of it due to error sources common to all points [m²], (3, 3).
    touches: tuple[LocatedTouch, ...]  #: touches of the point, in order of time.

    @property
    def rms(self) -> float:
        """Return the RMS distance to the true point [m]."""
        return statistics.rms(self.cov_world)

    @property
    def force(self) -> float:
        """Return the largest contact force [N]."""
        return max(touch.force for touch in self.touches)

    @property
    def direction(self) -> Array | None:
        """Return the direction of that force on the probe in the world, the outward normal of the object, (3,)."""
        return max(self.touches, key=lambda touch: touch.force).direction


@dataclass(frozen=True)
class ContactMap:
    """The points that a run has found."""

    points: tuple[MapPoint, ...]  #: in order of their first touch.
    unlocated: tuple[LocatedTouch, ...]  #: touches without a point, in order of time.
    stiffness: float  #: stiffness, std_stiffness: factor on E by all touches, and its standard deviation.
    std_stiffness: float
    min_separation: float  #: distance below which points were not distinguished [m].
    common: Array  #: error sources common to the touches, in standard deviations of their priors, (J,).
    cov_common: Array  #: their covariance by all touches, (J, J).
    #: object_compliance, std_object_compliance: of the one object of all touches [m/N]; NaN if it was not stated.
    object_compliance: float = math.nan
    std_object_compliance: float = math.nan


def build_map(
    touches: Sequence[LocatedTouch], youngs_modulus: float, min_separation: float = MIN_SEPARATION,
    object_compliance: float = 0.0,
) -> ContactMap:  # fmt: skip
    """Return the map of touches, with the error sources that they share estimated jointly.

    Args:
        touches: of one run, in order of time; those of several probes, each on its robot, as `joint_map` prepares them.
        youngs_modulus: standard deviation of the prior on E, relative.
        min_separation: minimum distance between points of the object [m]; 0 fuses no touches.
        object_compliance: scale of the half-normal prior of its compliance [m/N], for touches of one object.
    """
    groups = [(touch.point, [k]) for k, touch in enumerate(touches) if touch.point is not None]
    while (pair := _closest_pair([point for point, _ in groups], min_separation)) is not None:
        i, j = pair
        (first, of_first), (second, of_second) = groups[i], groups.pop(j)
        groups[i] = (first.fused_with(second), sorted(of_first + of_second))
    common, cov_common = _common_errors([point for point, _ in groups])
    points = tuple(
        MapPoint(
            point.position(common),
            point.covariance(cov_common),
            point.covariance(cov_common) - point.cov,
            tuple(touches[k] for k in members),
        )
        for point, members in groups
    )
    names = groups[0][0].names if groups else ()  # several probes have no common stiffness
    log_E, var_E = (math.nan, math.nan) if any(touch.probe for touch in touches) else (0.0, 1.0)
    if "E" in names:
        i = names.index("E")
        log_E, var_E = float(common[i]), float(cov_common[i, i])
    stiffness = math.exp(youngs_modulus * log_E)
    std_stiffness = stiffness * youngs_modulus * math.sqrt(var_E)
    compliance = (math.nan, math.nan)
    if names[-1:] == ("object",):
        mean, std = object_compliance * np.array(HALF_NORMAL)
        compliance = max(float(mean + std * common[-1]), 0.0), float(std) * math.sqrt(cov_common[-1, -1])
    unlocated = tuple(touch for touch in touches if touch.point is None)
    return ContactMap(points, unlocated, stiffness, std_stiffness, min_separation, common, cov_common, *compliance)


def _common_errors(points: Sequence[ConditionalPoint]) -> tuple[Array, Array]:
    """Return the common error sources by all touches, (J,), and their covariance, (J, J)."""
    J = len(points[0].information_vector) if points else 0
    information = np.eye(J) + sum((point.information for point in points), np.zeros((J, J)))
    cov = np.asarray(np.linalg.inv(information), dtype=float)
    return cov @ sum((point.information_vector for point in points), np.zeros(J)), cov


def _closest_pair(points: Sequence[ConditionalPoint], min_separation: float) -> tuple[int, int] | None:
    """Return the two that most likely are one point; None where no two are."""
    if len(points) < 2 or min_separation <= 0.0:
        return None
    common, cov_common = _common_errors(points)
    p = np.array([point.position(common) for point in points])
    B, S = np.array([point.sensitivity for point in points]), np.array([point.cov for point in points])
    best, smallest = None, SAME_POINT_CHI2
    for i in range(len(points) - 1):
        difference, by = p[i] - p[i + 1 :], B[i] - B[i + 1 :]
        cov = S[i] + S[i + 1 :] + by @ cov_common @ by.transpose(0, 2, 1)
        solved = np.linalg.solve(cov, difference[:, :, None])[:, :, 0]
        chi2 = np.einsum("ka,ka->k", difference, solved)
        distinguishable = statistics.max_chi2(3, 0.05) * np.linalg.eigvalsh(cov)[:, -1] <= min_separation**2
        chi2[~distinguishable | (np.linalg.norm(difference, axis=1) >= min_separation)] = np.inf
        j = int(np.argmin(chi2))
        if chi2[j] < smallest:
            best, smallest = (i, i + 1 + j), float(chi2[j])
    return best


# Tables and text

#: A row is a point, or a touch that was not located: it has a result code, but neither number nor position.
COLUMNS = (
    "point", "result", "x_world_mm", "y_world_mm", "z_world_mm",
    *(f"cov_world_{name}_mm2" for name, _, _ in COVARIANCE),
    "rms_mm", "common_rms_mm", "touches", "touch_numbers", "time_s", "force_N", "s_contact_mm",
)  # fmt: skip
Row = dict[str, Any]
CONTRADICTORY = ("inconsistent", "not_converged")  #: Results of touches whose poses are wrong.
MIN_CONTRADICTORY = 3  #: Minimum number of contradictory touches from which the poses are questioned (assumed).


def map_rows(contact_map: ContactMap) -> list[Row]:
    """Return a row for each point, then one for each touch that was not located; unknown values are None."""
    rows: list[Row] = []
    for number, point in enumerate(contact_map.points, 1):
        s_contact = np.concatenate([touch.s_contact for touch in point.touches if touch.s_contact is not None])
        values = (
            number, "ok", *(point.p_world / MM).tolist(),
            *(float(point.cov_world[i, j]) / MM**2 for _, i, j in COVARIANCE), point.rms / MM,
            statistics.rms(point.cov_common) / MM, len(point.touches), touch_numbers(point),
            point.touches[0].segment.start, point.force, float(s_contact.mean()) / MM,
        )  # fmt: skip
        rows.append(dict(zip(COLUMNS, values, strict=True)))
    for touch in contact_map.unlocated:
        known = {"result": touch.result, "touches": 1, "touch_numbers": touch.label}
        rows.append(dict.fromkeys(COLUMNS) | known | {"time_s": touch.segment.start})
    return rows


def map_csv(contact_map: ContactMap) -> bytes:
    """Return the rows as CSV with a header."""
    return csv_tables.write(COLUMNS, map_rows(contact_map), "z.9g")


def map_document(contact_map: ContactMap) -> dict[str, Any]:
    """Return the map as a JSON document."""
    rows = map_rows(contact_map)
    return {
        "schema": 1,
        "points": [row for row in rows if row["point"] is not None],
        "not_located": [row for row in rows if row["point"] is None],
        "stiffness_factor": _or_none(contact_map.stiffness),
        "std_stiffness_factor": _or_none(contact_map.std_stiffness),
        "object_compliance_m_N": _or_none(contact_map.object_compliance),
        "std_object_compliance_m_N": _or_none(contact_map.std_object_compliance),
        "apart_mm": contact_map.min_separation / MM,
        "doubts": _warnings(contact_map),
    }


def _or_none(value: float) -> float | None:
    return None if math.isnan(value) else value


def map_lines(contact_map: ContactMap) -> list[str]:
    """Return the map as lines of text."""
    points = [point_line(number, point) for number, point in enumerate(contact_map.points, 1)]
    return points + unlocated_lines(contact_map)


def point_line(number: int, point: MapPoint) -> str:
    """Return a point as a line of text."""
    x, y, z = point.p_world / MM
    position = f"point {number:3d}  ({x:z8.2f}, {y:z8.2f}, {z:z8.2f}) mm  ± {point.rms / MM:.2f} mm"
    return f"{position}, up to {point.force / MILLINEWTON:.1f} mN, touch {touch_numbers(point)}"


def unlocated_lines(contact_map: ContactMap) -> list[str]:
    """Return the touches that were not located: a line for each result with their numbers and times, and warnings."""
    lines = []
    for result in dict.fromkeys(touch.result for touch in contact_map.unlocated):
        touches = [touch for touch in contact_map.unlocated if touch.result == result]
        which = ", ".join(f"{touch.label} at {touch.segment.start:.2f} s" for touch in touches)
        lines.append(f"not located: touch {which}: {result}, {RESULT_MEANINGS[result]}")
    return lines + _warnings(contact_map)


def touch_numbers(point: MapPoint, separator: str = " ") -> str:
    """Return the numbers of the touches of a point, with the probe of each in a map of several."""
    several = any(touch.probe for touch in point.touches)
    return (", " if several else separator).join(touch.label for touch in point.touches)


def _warnings(contact_map: ContactMap) -> list[str]:
    """Return a line if most touches are contradictory: the poses are wrong then, and located points are accidental."""
    n_located = sum(len(point.touches) for point in contact_map.points)
    n_contradictory = sum(touch.result in CONTRADICTORY for touch in contact_map.unlocated)
    if n_contradictory < MIN_CONTRADICTORY or n_contradictory <= n_located:
        return []
    return [
        f"{n_contradictory} touches are inconsistent, more than were located; the located points are unreliable. Check "
        "that the poses belong to this base and this run, and that rotations are in the order qx, qy, qz, qw"
    ]


# Colours and PLY

MIN_RMS_MM, MAX_RMS_MM = 0.2, 5.0  #: RMS errors at the ends of the colour scale, which is logarithmic [mm].
#: Red, green and blue, evenly along the scale: blue for accurate points to red for uncertain ones.
_SCALE = ((31, 95, 168), (120, 120, 120), (217, 115, 13), (178, 24, 43))
_PLY_PROPERTIES = (
    "float x", "float y", "float z", "uchar red", "uchar green", "uchar blue", "float rms_mm", "float force_N",
    "int touches",
)  # fmt: skip


def rms_colour(rms_mm: float) -> tuple[int, int, int]:
    """Return red, green and blue, 0 to 255, for the RMS error of a point [mm]."""
    fraction = np.log(max(rms_mm, 1e-9) / MIN_RMS_MM) / np.log(MAX_RMS_MM / MIN_RMS_MM)
    at = np.clip(fraction, 0.0, 1.0) * (len(_SCALE) - 1)
    red, green, blue = (round(float(np.interp(at, range(len(_SCALE)), part))) for part in np.transpose(_SCALE))
    return red, green, blue


def map_ply(contact_map: ContactMap, title: str) -> bytes:
    """Return the located points as PLY in millimetres, which viewers and trimesh open.

    Args:
        contact_map: the map.
        title: one line for a comment.
    """
    lines = [
        "ply", "format ascii 1.0", f"comment {' '.join(title.split())}", "comment x y z in mm, world frame",
        f"element vertex {len(contact_map.points)}", *(f"property {name}" for name in _PLY_PROPERTIES), "end_header",
    ]  # fmt: skip
    for point in contact_map.points:
        x, y, z = point.p_world / MM
        rms = point.rms / MM
        assert math.isfinite(rms), "a located point has a finite covariance"
        red, green, blue = rms_colour(rms)
        vertex = f"{x:z.4f} {y:z.4f} {z:z.4f} {red} {green} {blue} {rms:.4f} {point.force:.6f}"
        lines.append(f"{vertex} {len(point.touches)}")
    return ("\n".join(lines) + "\n").encode("ascii", "replace")
