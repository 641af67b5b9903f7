"""Section properties along the axis, exact for every piecewise-linear radius; x and y are the base frame's."""

import numpy as np
from numpy.typing import ArrayLike

from probedesign.frames import Array
from probedesign.geometry import ProbeGeometry


def area(geometry: ProbeGeometry, s: ArrayLike) -> Array:
    """A(s) [m²] at arclength s [m]; π r² of a full round section."""
    return geometry.cross_section.factors.area * np.pi * geometry.radius_at(s) ** 2


def second_moment_xx(geometry: ProbeGeometry, s: ArrayLike) -> Array:
    """I_xx(s) = ∫y² dA [m⁴] at arclength s [m]: bending about x; π r⁴/4 of a full round section."""
    return geometry.cross_section.factors.xx * np.pi / 4.0 * geometry.radius_at(s) ** 4


def second_moment_yy(geometry: ProbeGeometry, s: ArrayLike) -> Array:
    """I_yy(s) = ∫x² dA [m⁴] at arclength s [m]: bending about y; π r⁴/4 of a full round section."""
    return geometry.cross_section.factors.yy * np.pi / 4.0 * geometry.radius_at(s) ** 4


def torsion_constant(geometry: ProbeGeometry, s: ArrayLike) -> Array:
    """J(s) [m⁴] at arclength s [m], Saint-Venant's; I_xx + I_yy of a round section, less of a flattened one."""
    return geometry.cross_section.factors.torsion * np.pi / 2.0 * geometry.radius_at(s) ** 4
