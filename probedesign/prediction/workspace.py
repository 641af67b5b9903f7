"""Force thresholds along the probe, and the workspace of the contact point with a fixed base."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from probedesign.core.frames import Array
from probedesign.core.units import MM
from probedesign.prediction.touches import Touches, angle_of

ACCURACIES_MM = (1.0, 2.0, 5.0)  #: RMS errors for which the required force is computed.
#: Forces that are evaluated, from a sixth of one reading's resolution up to the range of the finest calibration.
LADDER_N = tuple(float(f) for f in np.geomspace(5e-4, 12.0, 36))


@dataclass(frozen=True)
class ForceThresholds:
    """Force limits and thresholds at one position and direction; None where there is no such force."""

    contact_fraction: float  #: contact_fraction, direction: where and in which direction.
    direction: str
    #: force_mN_for_1_mm, force_mN_for_2_mm, force_mN_for_5_mm: smallest force at which the RMS error of one reading, by
    #: all error sources, is no larger.
    force_mN_for_1_mm: float | None
    force_mN_for_2_mm: float | None
    force_mN_for_5_mm: float | None
    greatest_force_N: float | None  #: largest force that can be read.
    #: what limits it: "sensor", a channel is at its range; "gives_way", the probe buckles; "slips_off", an object at
    #: constant distance from the base has reached the tip; "none" up to 12 N.
    limit: str
    deflection_mm: float | None  #: of the touched point at that force.


def force_thresholds(
    lines: Sequence[tuple[float, str]], touches: Mapping[float, Touches], end: float
) -> tuple[ForceThresholds, ...]:
    """Compute the thresholds of several lines.

    Args:
        lines: contact fraction and direction, among them one at `end` for each direction.
        touches: of these lines by force.
        end: fraction at which the flank ends, where objects slip off.
    """
    forces = np.array(sorted(touches))
    errors = np.array([touches[f].rms[0] for f in forces])
    use = np.array([touches[f].sensor_use for f in forces])
    bent = np.array([touches[f].deflection for f in forces])
    depth = np.array([touches[f].centre[:, 2] for f in forces])
    if touches[forces[0]].estimator.model.rod.is_curved:  # the tip of a curved probe is not its furthest point
        depth = np.full_like(depth, np.nan)
    max_stable_force = touches[forces[-1]].max_stable_force
    rows = []
    for i, (fraction, direction) in enumerate(lines):
        tip = lines.index((end, direction))
        slips = _slip_force(forces, depth[:, tip], depth[0, i], i == tip)
        max_force, limit = _max_force(forces, use[:, i], max_stable_force[i], slips)
        usable = use[:, i] <= 1.0
        needed = (force_for_accuracy(forces, errors[:, i], mm * MM, usable) for mm in ACCURACIES_MM)
        for_1, for_2, for_5 = (None if f is None or f > max_force else 1e3 * f for f in needed)
        there = np.isfinite(bent[:, i]) & (forces <= 1.3 * max_force)
        deflection = float(np.interp(max_force, forces[there], bent[there, i])) / MM if there.any() else None
        rows.append(ForceThresholds(fraction, direction, for_1, for_2, for_5, max_force, limit, deflection))
    return tuple(rows)


def _slip_force(forces: Array, tip_depth: Array, depth: float, at_tip: bool) -> float:
    """Return the force at which the tip, pushed itself, is as near to the base as the object; infinite if it never is.

    An object slides along the probe as the probe bends away; when it slips off it touches the tip.
    """
    good = np.isfinite(tip_depth)
    below = np.flatnonzero(good & (tip_depth <= depth))
    if at_tip or not len(below) or below[0] == 0:
        return float("inf")
    j = below[0]
    share = (tip_depth[j - 1] - depth) / (tip_depth[j - 1] - tip_depth[j])
    return float(forces[j - 1] + share * (forces[j] - forces[j - 1]))


def _max_force(forces: Array, use: Array, max_stable_force: float, slips: float) -> tuple[float, str]:
    """Return the largest force [N] and the code of its limit."""
    limits = {"slips_off": slips, "sensor": float("inf"), "gives_way": float("inf")}
    if max_stable_force < forces[-1]:
        limits["gives_way"] = float(max_stable_force)
    beyond = np.flatnonzero(use > 1.0)
    if len(beyond):
        j = int(beyond[0])
        limits["sensor"] = float(np.interp(1.0, use[j - 1 : j + 1], forces[j - 1 : j + 1])) if j else 0.0
    limit = min(limits, key=lambda name: limits[name])
    return (limits[limit], limit) if np.isfinite(limits[limit]) else (float(forces[-1]), "none")


def force_for_accuracy(
    forces: Array, errors: Array, accuracy: float, usable: NDArray[np.bool_] | None = None
) -> float | None:
    """Return the smallest force [N] with an error no larger than `accuracy`, interpolated linearly in logarithms.

    Args:
        forces: ascending [N], (n,).
        errors: at each force, (n,); NaN where there is none.
        accuracy: in the unit of the errors.
        usable: forces that may be the result, (n,); all if None.
    """
    enough = errors <= accuracy
    sufficient = np.flatnonzero(enough if usable is None else enough & usable)
    if not len(sufficient):
        return None
    j = int(sufficient[0])
    if not j or not np.isfinite(errors[j - 1]):
        return float(forces[j])
    x, y = np.log(forces[j - 1 : j + 1]), np.log(errors[j - 1 : j + 1])
    return float(np.exp(np.interp(-np.log(accuracy), -y, x)))


STEPS = 12  #: Number of points of a path, evenly spaced from the untouched one.
_TURNS = 24  # of the angle, for the volume
_MIRRORED = 1e-3  #: Largest fraction of gravity along y at which both sides across it count as symmetric.


@dataclass(frozen=True)
class PressPath:
    """Path of one point of the centreline that is pressed with increasing force in one direction."""

    contact_fraction: float  #: contact_fraction, direction: where and in which direction.
    direction: str
    greatest_force_N: float  #: largest force that can be read, as in `ForceThresholds`.
    limit: str  #: what limits it.
    pressed_mm: float  #: distance from the free position at that force.
    x_mm: tuple[float, ...]  #: x_mm, y_mm, z_mm: points in base axes, evenly spaced from zero to the largest force.
    y_mm: tuple[float, ...]
    z_mm: tuple[float, ...]

    @property
    def points(self) -> Array:
        """Return the points of the path [mm], (STEPS, 3)."""
        return np.stack([self.x_mm, self.y_mm, self.z_mm], axis=-1)


@dataclass(frozen=True)
class Workspace:
    """Paths of all positions, and what they sweep."""

    paths: tuple[PressPath, ...] = ()  #: of every position and direction that can be touched.
    #: of the sheet that the positions sweep together, by direction; overlapping parts count repeatedly.
    area_mm2: dict[str, float] | None = None
    #: that they sweep when pushed from all around, interpolated smoothly between the directions; overlapping parts
    #: count repeatedly. None where directions are missing: fewer than four, or uneven ones.
    volume_mm3: float | None = None


def workspace_of(reach: Sequence[ForceThresholds], touches: Mapping[float, Touches], gravity: Array) -> Workspace:
    """Compute the workspace from touches at all forces.

    Args:
        reach: thresholds of the lines, in their order.
        touches: by force, of the same lines.
        gravity: base axes [m/s²], (3,).
    """
    forces = np.array(sorted(touches))
    free = touches[forces[0]].free_centre[: len(reach)] / MM
    points = np.array([touches[f].centre[: len(reach)] for f in forces]) / MM
    paths = tuple(
        _path(row, row.greatest_force_N, forces, points[:, i], free[i])
        for i, row in enumerate(reach)
        if row.greatest_force_N is not None
    )
    directions = sorted({path.direction for path in paths}, key=_turned)
    sheets = {side: _sheet(paths, side) for side in directions}
    if "+y" in sheets and "-y" not in sheets and abs(gravity[1]) <= _MIRRORED * np.linalg.norm(gravity):
        sheets["-y"] = sheets["+y"] * np.array([1.0, -1.0, 1.0])
    return Workspace(paths, {side: _area(sheet) for side, sheet in sheets.items()}, _volume(sheets))


def _path(row: ForceThresholds, max_force: float, forces: Array, points: Array, free: Array) -> PressPath:
    """Return the path of one line up to its largest force; it is linear between the forces."""
    there = np.isfinite(points[:, 0]) & (forces <= max_force)
    way = np.vstack([free, points[there]])
    if there.any() and not there[-1]:
        after = int(np.flatnonzero(there)[-1]) + 1
        if np.isfinite(points[after, 0]):
            share = (max_force - forces[after - 1]) / (forces[after] - forces[after - 1])
            way = np.vstack([way, (1.0 - share) * points[after - 1] + share * points[after]])
    gone = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(way, axis=0), axis=1))])
    even = np.linspace(0.0, gone[-1], STEPS)
    x, y, z = (tuple(np.interp(even, gone, part).tolist()) for part in way.T)
    pressed = float(np.linalg.norm(way[-1] - free))
    return PressPath(row.contact_fraction, row.direction, max_force, row.limit, pressed, x, y, z)


def _turned(side: str) -> float:
    """Return the angle of a direction from +x, from 0 up to a turn [rad]."""
    return angle_of(side) % (2.0 * np.pi)


def _sheet(paths: Sequence[PressPath], side: str) -> Array:
    along = sorted((path for path in paths if path.direction == side), key=lambda path: path.contact_fraction)
    return np.array([np.zeros((STEPS, 3)), *(path.points for path in along)])


def _area(sheet: Array) -> float:
    """Return the area of a sheet, made of triangles [mm²]."""
    a, b, c, d = sheet[:-1, :-1], sheet[1:, :-1], sheet[1:, 1:], sheet[:-1, 1:]
    halves = (np.linalg.norm(np.cross(q - a, r - a), axis=-1).sum() / 2.0 for q, r in ((b, c), (c, d)))
    return float(sum(halves))


def _volume(sheets: Mapping[str, Array]) -> float | None:
    """Return the swept volume [mm³]; a position's paths are a Fourier series of the angle through the directions."""
    sides, n = sorted(sheets, key=_turned), len(sheets)
    even = np.allclose([_turned(side) for side in sides], 2.0 * np.pi / max(n, 1) * np.arange(n))
    if n < 4 or not even or len({len(sheet) for sheet in sheets.values()}) > 1:
        return None
    terms = np.fft.rfft([sheets[side] for side in sides], axis=0)
    turns = np.exp(1j * np.outer(np.linspace(0.0, 2.0 * np.pi, _TURNS + 1), np.arange(len(terms))))
    once = (np.arange(len(terms)) == 0) | (2 * np.arange(len(terms)) == n)  # their conjugates are no terms of their own
    p = np.tensordot(turns, terms * np.where(once, 1.0, 2.0)[:, None, None, None], 1).real / n
    by = [_between(np.diff(p, axis=axis), axis) for axis in range(3)]
    return float(np.abs(np.einsum("...i,...i->...", by[0], np.cross(by[1], by[2]))).sum())


def _between(change: Array, along: int) -> Array:
    for axis in range(3):
        if axis != along:
            n = change.shape[axis]
            change = (np.take(change, range(n - 1), axis) + np.take(change, range(1, n), axis)) / 2.0
    return change
