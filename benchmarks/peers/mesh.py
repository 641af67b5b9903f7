"""Element boundaries of a cone and the nodal weights of its elements."""

import numpy as np

from probedesign.core.frames import Array
from probedesign.rod.rod import Rod


def stations(rod: Rod, s_contact: float, elements: int, behind: float = 0.0) -> Array:
    """Return the ends of the elements [m], (elements + 1,), with one at s_contact and equal lengths on either side.

    Args:
        rod: the cone.
        s_contact: arclength of the contact [m].
        elements: number of elements.
        behind: fraction of the first element behind the clamp.
    """
    if s_contact == rod.length:
        before = elements
    else:
        before = min(max(1, round(elements * s_contact / rod.length)), elements - 1)
    even = (np.arange(before + 1) - behind) * (s_contact / (before - behind))
    return np.append(even, np.linspace(s_contact, rod.length, elements - before + 1)[1:])


def nodal_weights(rod: Rod, s: Array, gravity: Array) -> Array:
    """Return the nodal weights of the frusta between the stations s [N], (k, 3), with their true centres of mass."""
    r0, r1 = rod.radius_at(s[:-1]), rod.radius_at(s[1:])
    squares = r0 * r0 + r0 * r1 + r1 * r1
    mass = rod.density * np.pi / 3.0 * np.diff(s) * squares
    far = (r0 * r0 + 2.0 * r0 * r1 + 3.0 * r1 * r1) / (4.0 * squares)  # centre of mass over the length
    return np.outer(np.append((1.0 - far) * mass, 0.0) + np.append(0.0, far * mass), gravity)
