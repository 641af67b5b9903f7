"""A cloud as CSV, as JSON and in a few lines for people."""

from typing import Any

import numpy as np

from probedesign.frames import Array
from probedesign.mapping.contact_map import Cloud, Point
from probedesign.mapping.touch_point import MEANINGS, Touched
from probedesign.units import MILLINEWTON, MM

PAIRS = (("xx", 0, 0), ("xy", 0, 1), ("xz", 0, 2), ("yy", 1, 1), ("yz", 1, 2), ("zz", 2, 2))
COLUMNS = (
    "point", "result", "x_world_mm", "y_world_mm", "z_world_mm", *(f"cov_world_{name}_mm2" for name, _, _ in PAIRS),
    "rms_mm", "common_rms_mm", "touches", "touch_numbers", "time_s", "force_N", "s_contact_mm",
)  # fmt: skip
"""A row is a point, or a touch without one: that has no number, no place, and its code for a result."""
Row = dict[str, Any]
CONTRADICTED = ("inconsistent", "not_converged")
"""What touches come to whose poses are wrong."""
FEWEST = 3
"""Touches that contradict themselves before the poses are doubted (assumed)."""


def rows_of(cloud: Cloud) -> list[Row]:
    """A row a point, then a row a touch that was not located; what is not known is None."""
    points = [_located(number, point) for number, point in enumerate(cloud.points, 1)]
    return points + [_unlocated(touch) for touch in cloud.unlocated]


def csv_of(cloud: Cloud) -> bytes:
    """The rows as CSV with a header."""
    lines = [",".join(COLUMNS)]
    lines += [",".join(_cell(row[name]) for name in COLUMNS) for row in rows_of(cloud)]
    return ("\n".join(lines) + "\n").encode()


def document_of(cloud: Cloud) -> dict[str, Any]:
    """Everything, for JSON."""
    return {
        "schema": 1,
        "points": [row for row in rows_of(cloud) if row["point"] is not None],
        "not_located": [row for row in rows_of(cloud) if row["point"] is None],
        "stiffness_factor": cloud.stiffness,
        "std_stiffness_factor": cloud.std_stiffness,
        "apart_mm": cloud.apart / MM,
        "doubts": _doubts(cloud),
    }


def lines_of(cloud: Cloud) -> list[str]:
    """For people."""
    found = [line_of(number, point) for number, point in enumerate(cloud.points, 1)]
    return found + unlocated_lines(cloud)


def line_of(number: int, point: Point) -> str:
    """A point in one line."""
    x, y, z = point.p_world / MM
    told = f"point {number:3d}  ({x:z8.2f}, {y:z8.2f}, {z:z8.2f}) mm  ± {point.rms / MM:.2f} mm"
    return f"{told}, to {point.force / MILLINEWTON:.1f} mN, touch {_numbers(point)}"


def unlocated_lines(cloud: Cloud) -> list[str]:
    """The touches without a place: a line a result, with their numbers and times and what it means."""
    lines = []
    for result in dict.fromkeys(touch.result for touch in cloud.unlocated):
        series = [touch.series for touch in cloud.unlocated if touch.result == result]
        which = ", ".join(f"{one.number} at {one.start:.2f} s" for one in series)
        lines.append(f"no place: touch {which}: {result}, {MEANINGS[result]}")
    return lines + _doubts(cloud)


def _doubts(cloud: Cloud) -> list[str]:
    """A line where most touches contradict themselves: then the poses are wrong, and what was located is by chance."""
    located = sum(len(point.touches) for point in cloud.points)
    against = sum(touch.result in CONTRADICTED for touch in cloud.unlocated)
    if against < FEWEST or against <= located:
        return []
    return [
        f"{against} touches contradict themselves, more than were located, so those are not to be trusted: are the "
        "poses of this base and this run, and their rotations told as they are read (qx, qy, qz, qw)"
    ]


def _located(number: int, point: Point) -> Row:
    places = np.concatenate([touch.s_contact for touch in point.touches if touch.s_contact is not None])
    return {
        "point": number, "result": "ok", **dict(zip(COLUMNS[2:5], (point.p_world / MM).tolist(), strict=True)),
        **_covariance(point.cov_world), "rms_mm": point.rms / MM,
        "common_rms_mm": float(np.sqrt(np.trace(point.cov_common))) / MM, "touches": len(point.touches),
        "touch_numbers": _numbers(point), "time_s": point.touches[0].series.start, "force_N": point.force,
        "s_contact_mm": float(places.mean()) / MM,
    }  # fmt: skip


def _unlocated(touch: Touched) -> Row:
    row: Row = dict.fromkeys(COLUMNS)
    return row | {"result": touch.result, "touches": 1, "touch_numbers": str(touch.series.number),
                  "time_s": touch.series.start}  # fmt: skip


def _covariance(cov: Array) -> Row:
    return {f"cov_world_{name}_mm2": float(cov[i, j]) / MM**2 for name, i, j in PAIRS}


def _numbers(point: Point) -> str:
    return " ".join(str(touch.series.number) for touch in point.touches)


def _cell(value: object) -> str:
    if value is None:
        return ""
    return f"{value:z.9g}" if isinstance(value, float) else str(value)
