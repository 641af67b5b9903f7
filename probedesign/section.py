"""Section properties of a solid round body along its axis, exact for every piecewise-linear radius."""

import numpy as np
from numpy.typing import ArrayLike

from probedesign.frames import Array
from probedesign.geometry import ProbeGeometry


def area(geometry: ProbeGeometry, s: ArrayLike) -> Array:
    """A(s) = π r² [m²] at arclength s [m]."""
    return np.pi * geometry.radius_at(s) ** 2


def second_moment(geometry: ProbeGeometry, s: ArrayLike) -> Array:
    """I(s) = π r⁴/4 about any diameter [m⁴] at arclength s [m]."""
    return np.pi / 4.0 * geometry.radius_at(s) ** 4


def polar_moment(geometry: ProbeGeometry, s: ArrayLike) -> Array:
    """J(s) = 2 I(s) [m⁴]: the torsion constant of a round section."""
    return 2.0 * second_moment(geometry, s)
