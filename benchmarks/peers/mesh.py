"""Where the elements of a cone end, and what each of them weighs."""

import numpy as np

from probedesign.core.frames import Array
from probedesign.rod.rod import Rod


def stations(rod: Rod, s_contact: float, elements: int, behind: float = 0.0) -> Array:
    """Ends of the elements [m], (elements + 1,): one at s_contact, even before it and even after it.

    `behind` is how much of the first element lies behind the clamp.
    """
    if s_contact == rod.length:
        before = elements
    else:
        before = min(max(1, round(elements * s_contact / rod.length)), elements - 1)
    even = (np.arange(before + 1) - behind) * (s_contact / (before - behind))
    return np.append(even, np.linspace(s_contact, rod.length, elements - before + 1)[1:])


def nodal_weights(rod: Rod, s: Array, gravity: Array) -> Array:
    """Weight of the frusta between s [N], (k, 3): each on its two ends so that its centre of mass stays."""
    r0, r1 = rod.radius_at(s[:-1]), rod.radius_at(s[1:])
    squares = r0 * r0 + r0 * r1 + r1 * r1
    mass = rod.density * np.pi / 3.0 * np.diff(s) * squares
    far = (r0 * r0 + 2.0 * r0 * r1 + 3.0 * r1 * r1) / (4.0 * squares)  # centre of mass over the length
    return np.outer(np.append((1.0 - far) * mass, 0.0) + np.append(0.0, far * mass), gravity)
