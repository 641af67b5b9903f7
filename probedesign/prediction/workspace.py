"""Where the contact point can be with the base standing still: how far each place of the probe can be pressed, and what
it sweeps meanwhile."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from probedesign.frames import Array
from probedesign.prediction.reach import Reach
from probedesign.prediction.touches import DIRECTIONS, Touches
from probedesign.units import MM

STEPS = 12
"""Points of a path that are told, evenly along it from the untouched one."""
_TURNS = 24  # of the angle, for the volume
_MIRRORED = 1e-3
"""Of gravity that may lie along y for the two sides across it to count as alike."""


@dataclass(frozen=True)
class Path:
    """Where one place of the centreline goes as it is pressed ever harder from one side.

    Attributes:
        contact_fraction, direction: where and from which side.
        greatest_force_N: up to which the touch can be read, as `Reach` has it.
        limit: what ends it.
        pressed_mm: how far it is then from where it hangs free.
        x_mm, y_mm, z_mm: on the way, base axes, evenly along it from no force to the greatest.
    """

    contact_fraction: float
    direction: str
    greatest_force_N: float
    limit: str
    pressed_mm: float
    x_mm: tuple[float, ...]
    y_mm: tuple[float, ...]
    z_mm: tuple[float, ...]

    @property
    def points(self) -> Array:
        """[mm], (STEPS, 3)."""
        return np.stack([self.x_mm, self.y_mm, self.z_mm], axis=-1)


@dataclass(frozen=True)
class Workspace:
    """All of them.

    Attributes:
        paths: of every place and side that can be touched.
        area_mm2: of the sheet that the places sweep together, by side; what several places reach counts for each.
        volume_mm3: that they sweep pushed from all round, between the sides on smooth curves; likewise. None where
            a side across to gravity is missing.
    """

    paths: tuple[Path, ...] = ()
    area_mm2: dict[str, float] | None = None
    volume_mm3: float | None = None


def workspace_of(reach: Sequence[Reach], touches: Mapping[float, Touches], gravity: Array) -> Workspace:
    """From the touches of all forces.

    Args:
        reach: of the lines, in their order.
        touches: by force, of the same lines.
        gravity: base axes [m/s²], (3,).
    """
    forces = np.array(sorted(touches))
    free = touches[forces[0]].free_centre[: len(reach)] / MM
    points = np.array([touches[f].centre[: len(reach)] for f in forces]) / MM
    paths = tuple(
        _path(row, forces, points[:, i], free[i])
        for i, row in enumerate(reach)
        if row.greatest_force_N is not None
    )
    sheets = {
        side: _sheet(paths, side) for side in DIRECTIONS if any(path.direction == side for path in paths)
    }
    if "+y" in sheets and "-y" not in sheets and abs(gravity[1]) <= _MIRRORED * np.linalg.norm(gravity):
        sheets["-y"] = sheets["+y"] * np.array([1.0, -1.0, 1.0])
    return Workspace(paths, {side: _area(sheet) for side, sheet in sheets.items()}, _volume(sheets))


def _path(row: Reach, forces: Array, points: Array, free: Array) -> Path:
    """Of one line; between the forces straight."""
    assert row.greatest_force_N is not None, "asked of what can be touched"
    there = np.isfinite(points[:, 0]) & (forces <= row.greatest_force_N)
    way = np.vstack([free, points[there]])
    if there.any() and not there[-1]:
        after = int(np.flatnonzero(there)[-1]) + 1
        if np.isfinite(points[after, 0]):
            share = (row.greatest_force_N - forces[after - 1]) / (forces[after] - forces[after - 1])
            way = np.vstack([way, (1.0 - share) * points[after - 1] + share * points[after]])
    gone = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(way, axis=0), axis=1))])
    even = np.linspace(0.0, gone[-1], STEPS)
    x, y, z = (tuple(np.interp(even, gone, part).tolist()) for part in way.T)
    pressed = float(np.linalg.norm(way[-1] - free))
    return Path(row.contact_fraction, row.direction, row.greatest_force_N, row.limit, pressed, x, y, z)


def _sheet(paths: Sequence[Path], side: str) -> Array:
    """Paths of one side from the clamp to the tip, (n + 1, STEPS, 3)."""
    along = sorted((path for path in paths if path.direction == side), key=lambda path: path.contact_fraction)
    return np.array([np.zeros((STEPS, 3)), *(path.points for path in along)])


def _area(sheet: Array) -> float:
    """[mm²], of triangles."""
    a, b, c, d = sheet[:-1, :-1], sheet[1:, :-1], sheet[1:, 1:], sheet[:-1, 1:]
    halves = (np.linalg.norm(np.cross(q - a, r - a), axis=-1).sum() / 2.0 for q, r in ((b, c), (c, d)))
    return float(sum(halves))


def _volume(sheets: Mapping[str, Array]) -> float | None:
    """[mm³], a place's paths as a Fourier series of the angle that has the four sides right."""
    if set(sheets) != set(DIRECTIONS) or len({len(sheet) for sheet in sheets.values()}) > 1:
        return None
    plus, minus, left, right = (sheets[side] for side in ("+x", "-x", "+y", "-y"))
    mean, twice = (plus + minus + left + right) / 4.0, (plus + minus - left - right) / 4.0
    angle = np.linspace(0.0, 2.0 * np.pi, _TURNS + 1)[:, None, None, None]
    p = (
        mean
        + (plus - minus) / 2.0 * np.cos(angle)
        + (left - right) / 2.0 * np.sin(angle)
        + twice * np.cos(2.0 * angle)
    )
    by = [_between(np.diff(p, axis=axis), axis) for axis in range(3)]
    return float(np.abs(np.einsum("...i,...i->...", by[0], np.cross(by[1], by[2]))).sum())


def _between(change: Array, along: int) -> Array:
    """Differences along one axis as means over each cell's four edges."""
    for axis in range(3):
        if axis != along:
            n = change.shape[axis]
            change = (np.take(change, range(n - 1), axis) + np.take(change, range(1, n), axis)) / 2.0
    return change
