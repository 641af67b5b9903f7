"""Equations of a contact with Coulomb friction on the surface of a round rod, for complex steps.

See `friction.py` for the law. The normal turns smoothly over a short length at the knots of a profile, where the taper
changes, so that Newton's method has derivatives there.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from probedesign.core.frames import Array
from probedesign.rod.rod import Rod

Numbers = NDArray[Any]
"""Real or complex: derivatives are taken by complex steps."""
_BLEND = 0.005
"""Half-width over which the normal rotates at a knot [rod lengths], at most a quarter of the adjacent frusta."""


class SurfaceProfile(NamedTuple):
    """Radius and taper of the surface along a rod, in rod lengths.

    Attributes:
        s, radius: at the knots, (K,).
        at_s, tan: knots of tan α, linear between them, (j,).
    """

    s: Array
    radius: Array
    at_s: Array
    tan: Array

    @classmethod
    def of(cls, rod: Rod) -> "SurfaceProfile":
        """Return the profile of a rod."""
        s, r = np.asarray(rod.s) / rod.length, np.asarray(rod.radius) / rod.length
        tan, span = -np.diff(r) / np.diff(s), np.diff(s)
        half = np.minimum(_BLEND, 0.25 * np.minimum(span[:-1], span[1:]))
        ends = np.stack([s[1:-1] - half, s[1:-1] + half], axis=1).ravel()
        return cls(s, r, np.concatenate([[0.0], ends, [1.0]]), np.repeat(tan, 2))

    def at(self, s: Numbers) -> tuple[Numbers, Numbers]:
        """Return radius and tan α at s; complex s gives their derivatives."""
        return _straight(s, self.s, self.radius), _straight(s, self.at_s, self.tan)


def _straight(s: Numbers, knots: Array, values: Array) -> Numbers:
    """Interpolate linearly, and extrapolate beyond the ends."""
    i = np.clip(np.searchsorted(knots, s.real, side="right") - 1, 0, len(knots) - 2)
    slope = (values[i + 1] - values[i]) / (knots[i + 1] - knots[i])
    found: Numbers = values[i] + slope * (s - knots[i])
    return found


def coulomb_residuals(
    z: Numbers,
    before: Array,
    point: Array,
    direction: Array | None,
    profile: SurfaceProfile,
    friction: float,
    stiffness: float | None,
) -> Numbers:
    """Return the residuals of couple, place, edge and Coulomb's law, (9, m), without dimension.

    Args:
        z: [9 unknowns, 12 of the section's tangent, x axis, position and y axis], lengths over the rod's, (21, m);
            the unknowns are force (3), couple (3), s, φ and λ.
        before: s, φ and λ before the step, (3,).
        point: of the object, over the rod's length, (3,).
        direction: of its edge, unit, (3,); None for a point.
        profile: of the rod.
        friction: coefficient μ.
        stiffness: k of the slip law; None for stick.
    """
    F, C, s, angle, way = z[0:3], z[3:6], z[6], z[7], z[8]
    t, x, p, y = z[9:12], z[12:15], z[15:18], z[18:21]
    radius, tan = profile.at(s)
    cos = 1.0 / np.sqrt(1.0 + tan * tan)
    e, h = np.cos(angle) * x + np.sin(angle) * y, np.cos(angle) * y - np.sin(angle) * x
    a, normal = cos * (t - tan * e), cos * (e + tan * t)
    arm = radius * e
    couple = C - cross(arm, F)
    apart = p + arm - point[:, None]
    slide_a, slide_h = (s - before[0]) / cos, radius * (angle - before[1])
    edge = way
    if direction is not None:
        line = direction[:, None]
        apart = apart - way * line
        edge = dot(normal, line)
        slide_a = slide_a - (way - before[2]) * dot(a, line)
        slide_h = slide_h - (way - before[2]) * dot(h, line)
    if stiffness is None:
        law = (slide_a, slide_h)
    else:
        F_a, F_h = dot(F, a), dot(F, h)
        law = (F_a, F_h)
        if friction > 0.0:
            tau_a, tau_h = F_a + stiffness * slide_a, F_h + stiffness * slide_h
            limit = -friction * dot(F, normal) / np.sqrt(tau_a * tau_a + tau_h * tau_h + 1e-300)
            law = (F_a - limit * tau_a, F_h - limit * tau_h)
    return np.stack([*couple, *apart, edge, *law])


def dot(a: Numbers, b: Numbers) -> Numbers:
    """Return the dot products of columns, (m,); complex steps pass through, unlike in `np.vdot`."""
    product: Numbers = (a * b).sum(axis=0)
    return product


def cross(a: Numbers, b: Numbers) -> Numbers:
    """Return the cross products of columns, (3, m)."""
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])
