"""Map of the touched points: touches of the same point are recognised and fused, common errors are estimated jointly.

Two touches may belong to one point if their Mahalanobis distance, with common error sources counted as common, is
small, and if their uncertainty is small enough to distinguish another point: vague touches agree with everything and
stay apart.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from probedesign.core.frames import Array
from probedesign.mapping.touch_point import ConditionalPoint, LocatedTouch

MIN_SEPARATION = 5e-3
"""Default distance below which points of an object are not distinguished [m]."""
SAME_POINT_CHI2 = float(chdtri(3, 0.01))
"""Squared Mahalanobis distance of two touches of one point that is exceeded with probability 0.01."""
CHI2_95 = float(chdtri(3, 0.05))
"""Squared Mahalanobis distance of the 95 % ellipsoid."""


@dataclass(frozen=True)
class MapPoint:
    """A point of the world.

    Attributes:
        p_world: on the surface of the object [m], (3,).
        cov_world: with all error sources [m²], (3, 3).
        cov_common: the part of it due to error sources common to all points [m²], (3, 3).
        touches: touches of the point, in order of time.
    """

    p_world: Array
    cov_world: Array
    cov_common: Array
    touches: tuple[LocatedTouch, ...]

    @property
    def rms(self) -> float:
        """RMS distance to the true point [m]."""
        return math.sqrt(float(np.trace(self.cov_world)))

    @property
    def force(self) -> float:
        """Largest contact force [N]."""
        return max(touch.force for touch in self.touches)

    @property
    def direction(self) -> Array | None:
        """Direction of that force on the probe in the world, the outward normal of the object, unit vector, (3,)."""
        return max(self.touches, key=lambda touch: touch.force).direction


@dataclass(frozen=True)
class ContactMap:
    """The points that a run has found.

    Attributes:
        points: in order of their first touch.
        unlocated: touches without a point, in order of time.
        stiffness, std_stiffness: factor on E by all touches, and its standard deviation.
        min_separation: distance below which points were not distinguished [m].
    """

    points: tuple[MapPoint, ...]
    unlocated: tuple[LocatedTouch, ...]
    stiffness: float
    std_stiffness: float
    min_separation: float


_Group = tuple[ConditionalPoint, tuple[LocatedTouch, ...]]
"""A point and its touches."""


def build_map(
    touches: Sequence[LocatedTouch], youngs_modulus: float, min_separation: float = MIN_SEPARATION
) -> ContactMap:
    """Return the map of touches, with the error sources that they share estimated jointly.

    Args:
        touches: of one run, one probe on one robot.
        youngs_modulus: standard deviation of the prior on E, relative.
        min_separation: minimum distance between points of the object [m]; 0 fuses no touches.
    """
    groups: list[_Group] = [(touch.point, (touch,)) for touch in touches if touch.point is not None]
    while (pair := _closest_pair([point for point, _ in groups], min_separation)) is not None:
        i, j = pair
        (first, of_first), (second, of_second) = groups[i], groups.pop(j)
        groups[i] = (first.fused_with(second), (*of_first, *of_second))
    common, cov_common = _common_errors([point for point, _ in groups])
    points = tuple(
        MapPoint(
            point.position(common),
            point.covariance(cov_common),
            point.covariance(cov_common) - point.cov,
            tuple(sorted(members, key=lambda touch: touch.segment.number)),
        )
        for point, members in groups
    )
    unlocated = tuple(touch for touch in touches if touch.point is None)
    names = groups[0][0].names if groups else ()
    log_E, var_E = 0.0, 1.0
    if "E" in names:
        i = names.index("E")
        log_E, var_E = float(common[i]), float(cov_common[i, i])
    stiffness = math.exp(youngs_modulus * log_E)
    std_stiffness = stiffness * youngs_modulus * math.sqrt(var_E)
    return ContactMap(points, unlocated, stiffness, std_stiffness, min_separation)


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
        distinguishable = CHI2_95 * np.linalg.eigvalsh(cov)[:, -1] <= min_separation**2
        chi2[~distinguishable | (np.linalg.norm(difference, axis=1) >= min_separation)] = np.inf
        j = int(np.argmin(chi2))
        if chi2[j] < smallest:
            best, smallest = (i, i + 1 + j), float(chi2[j])
    return best
