"""All touches of a run as one set of points: those of one point told apart from those of two, and fused.

Two touches may be of one point if their places differ by no more than both, together, are uncertain, with what is
common to both counted as common (Mahalanobis' distance), and if that uncertainty is small enough to say so: vague
touches agree with everything and are left apart.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from probedesign.frames import Array
from probedesign.mapping.located import Located
from probedesign.mapping.touch_point import Touched

APART = 5e-3
"""Points of an object that lie closer than this are not told apart [m], unless said otherwise."""
SAME_CHI2 = float(chdtri(3, 0.01))
"""Squared distance of two touches of one point, which one in a hundred exceeds."""
WITHIN_95 = float(chdtri(3, 0.05))


@dataclass(frozen=True)
class Point:
    """One point of the world.

    Attributes:
        p_world: on the object's surface [m], (3,).
        cov_world: with everything unknown counted [m²], (3, 3).
        cov_common: the part of it that error sources common to all points make [m²], (3, 3).
        touches: that tell it, in the order of time.
    """

    p_world: Array
    cov_world: Array
    cov_common: Array
    touches: tuple[Touched, ...]

    @property
    def rms(self) -> float:
        """Of the distance to the true point [m]."""
        return math.sqrt(float(np.trace(self.cov_world)))

    @property
    def force(self) -> float:
        """The strongest that it was touched with [N]."""
        return max(touch.force for touch in self.touches)

    @property
    def direction(self) -> Array | None:
        """Of that force on the probe in the world: the object's outward normal, unit, (3,)."""
        return max(self.touches, key=lambda touch: touch.force).direction


@dataclass(frozen=True)
class Cloud:
    """What a run has found.

    Attributes:
        points: in the order of their first touch.
        unlocated: touches without a place, in the order of time.
        stiffness, std_stiffness: factor on E by all touches together, and its standard deviation.
        apart: points closer than this were not told apart [m].
    """

    points: tuple[Point, ...]
    unlocated: tuple[Touched, ...]
    stiffness: float
    std_stiffness: float
    apart: float


@dataclass(frozen=True)
class _Group:
    """Touches of one point."""

    located: Located
    touches: tuple[Touched, ...]


def cloud_of(touches: Sequence[Touched], youngs_modulus: float, apart: float = APART) -> Cloud:
    """Return the points that touches give, with the error sources that they share estimated jointly.

    Args:
        touches: of one run: one probe on one robot.
        youngs_modulus: standard deviation of the prior on E, relative.
        apart: points of the object lie at least so far from each other [m]; 0 fuses nothing.
    """
    groups = [_Group(touch.located, (touch,)) for touch in touches if touch.located is not None]
    while (pair := _nearest(groups, apart)) is not None:
        i, j = pair
        one, other = groups[i], groups.pop(j)
        groups[i] = _Group(one.located.with_(other.located), (*one.touches, *other.touches))
    common, cov = _common(groups)
    points = tuple(_point(group, common, cov) for group in groups)
    unlocated = tuple(touch for touch in touches if touch.located is None)
    names = groups[0].located.names if groups else ()
    i = names.index("E") if "E" in names else -1
    log_E, var_E = (float(common[i]), float(cov[i, i])) if i >= 0 else (0.0, 1.0)
    stiffness = math.exp(youngs_modulus * log_E)
    return Cloud(points, unlocated, stiffness, stiffness * youngs_modulus * math.sqrt(var_E), apart)


def _point(group: _Group, common: Array, cov: Array) -> Point:
    located = group.located
    shared = located.cov(cov) - located.S
    touches = tuple(sorted(group.touches, key=lambda touch: touch.series.number))
    return Point(located.at(common), located.cov(cov), shared, touches)


def _common(groups: Sequence[_Group]) -> tuple[Array, Array]:
    """Return the common error sources by all touches, (J,), and their covariance, (J, J)."""
    J = len(groups[0].located.vector) if groups else 0
    information = np.eye(J) + sum((group.located.information for group in groups), np.zeros((J, J)))
    cov = np.asarray(np.linalg.inv(information), dtype=float)
    return cov @ sum((group.located.vector for group in groups), np.zeros(J)), cov


def _nearest(groups: Sequence[_Group], apart: float) -> tuple[int, int] | None:
    """The two that are most surely one point; None where no two are."""
    if len(groups) < 2 or apart <= 0.0:
        return None
    common, cov_common = _common(groups)
    a = np.array([group.located.at(common) for group in groups])
    B, S = np.array([group.located.B for group in groups]), np.array([group.located.S for group in groups])
    best, least = None, SAME_CHI2
    for i in range(len(groups) - 1):
        off, by = a[i] - a[i + 1 :], B[i] - B[i + 1 :]
        cov = S[i] + S[i + 1 :] + by @ cov_common @ by.transpose(0, 2, 1)
        chi2 = np.einsum("ka,ka->k", off, np.linalg.solve(cov, off[:, :, None])[:, :, 0])
        told = WITHIN_95 * np.linalg.eigvalsh(cov)[:, -1] <= apart**2
        chi2[~told | (np.linalg.norm(off, axis=1) >= apart)] = np.inf
        j = int(np.argmin(chi2))
        if chi2[j] < least:
            best, least = (i, i + 1 + j), float(chi2[j])
    return best
