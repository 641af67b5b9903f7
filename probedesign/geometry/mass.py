"""Volume, mass, centre of mass and inertia of rigid and undeformed bodies, in closed form."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from probedesign.core.frames import Array, skew
from probedesign.geometry import ProbeGeometry
from probedesign.geometry.axis import Axis
from probedesign.geometry.cross_section import FULL_ROUND, CrossSection


@dataclass(frozen=True)
class MassProperties:
    """Mass properties of a body in some frame."""

    volume: float  #: [m³].
    mass: float  #: [kg].
    p_com: Array  #: centre of mass in that frame [m], (3,).
    inertia: Array  #: about the centre of mass, in that frame's axes [kg·m²], (3, 3).

    def moved(self, T_a_b: Array) -> "MassProperties":
        """Return the properties in frame a of a body whose properties here are in frame b."""
        R = T_a_b[:3, :3]
        return MassProperties(self.volume, self.mass, R @ self.p_com + T_a_b[:3, 3], R @ self.inertia @ R.T)

    def inertia_about(self, p: Array) -> Array:
        """Return the inertia about point p [kg·m²], (3, 3), by the parallel-axis theorem."""
        d = skew(self.p_com - p)
        return self.inertia - self.mass * d @ d

    def wrench(self, gravity: Array) -> Array:
        """Return the wrench [m g; p_com × m g] about the origin of the frame for gravity [m/s²] in its axes, (6,)."""
        weight = self.mass * np.asarray(gravity, dtype=float)
        return np.concatenate([weight, np.cross(self.p_com, weight)])


_PIECES = 32  #: Fewest pieces of a curved body, with four Gauss points each.
NOTHING = MassProperties(0.0, 0.0, np.zeros(3), np.zeros((3, 3)))


def combined(bodies: Iterable[MassProperties]) -> MassProperties:
    """Return the properties of several bodies, all in one frame, as one body."""
    bodies = [b for b in bodies if b.mass > 0.0]
    if not bodies:
        return NOTHING
    masses, p = np.array([b.mass for b in bodies]), np.array([b.p_com for b in bodies])
    mass = float(masses.sum())
    p_com = masses @ p / mass
    d = p - p_com
    steiner = np.eye(3) * float(masses @ (d * d).sum(axis=1)) - (masses * d.T) @ d
    inertia = np.sum([b.inertia for b in bodies], axis=0) + steiner
    return MassProperties(sum(b.volume for b in bodies), mass, p_com, inertia)


def frustum(
    r1: float, r2: float, height: float, z: float, density: float, section: CrossSection = FULL_ROUND
) -> MassProperties:
    """Return the properties of a cone frustum on the z axis, radius r1 at z and r2 at z + height [m], density [kg/m³].

    Full and round: V = π h (r1² + r1 r2 + r2²)/3; z̄ = h (r1² + 2 r1 r2 + 3 r2²)/(4 (r1² + r1 r2 + r2²));
    ∫r⁴ = h (r1⁴ + r1³r2 + r1²r2² + r1r2³ + r2⁴)/5; ∫z² dV = π h³ (r1² + 3 r1 r2 + 6 r2²)/30.

    For another section, which is similar to itself along z, each integral over a slice is multiplied by its factor.

    Source: integration of a linear radius; agrees with any table of solids for r1 = r2 and r2 = 0.
    """
    of = section.factors
    q = r1 * r1 + r1 * r2 + r2 * r2
    volume = of.area * np.pi * height * q / 3.0
    z_com = height * (r1 * r1 + 2 * r1 * r2 + 3 * r2 * r2) / (4.0 * q)
    r4 = height * (r1**4 + r1**3 * r2 + r1**2 * r2**2 + r1 * r2**3 + r2**4) / 5.0
    y2, x2 = (factor * density * np.pi / 4.0 * r4 for factor in (of.xx, of.yy))
    z2 = of.area * density * np.pi * height**3 * (r1 * r1 + 3 * r1 * r2 + 6 * r2 * r2) / 30.0
    mass = density * volume
    z2_com = z2 - mass * z_com**2
    inertia = np.diag([y2 + z2_com, x2 + z2_com, x2 + y2])
    return MassProperties(volume, mass, np.array([0.0, 0.0, z + z_com]), inertia)


def flexible_part(geometry: ProbeGeometry, density: float, axis: Axis | None = None) -> MassProperties:
    """Return the properties of the undeformed body from s = 0 to the tip in the base frame.

    Along a curved axis, the slice at s has the volume element (1 - κ·x) dA ds, so that its volume is A ds, and
    ∫x (1 - κ·x) dA = -I κ: the outer side of a bend weighs more.

    Args:
        geometry: of the probe.
        density: [kg/m³].
        axis: another axis than that of the geometry.
    """
    s, r, section = geometry.s, geometry.radius, geometry.cross_section
    axis = geometry.axis if axis is None else axis
    if axis.is_straight:
        return combined(frustum(r[i], r[i + 1], s[i + 1] - s[i], s[i], density, section) for i in range(len(s) - 1))
    ends = np.unique(np.concatenate([s, axis.s, np.linspace(0.0, s[-1], _PIECES + 1)]))
    x, w = np.polynomial.legendre.leggauss(4)
    half = np.diff(ends)[:, None] / 2.0
    at, weights = ((ends[:-1, None] + half * (1.0 + x)).ravel(), (half * w).ravel())
    A, I_x, I_y = geometry.area_at(at), geometry.second_moment_yy_at(at), geometry.second_moment_xx_at(at)
    T, k = axis.frames(at), axis.curvature_at(at)
    p, X, Y = T[:, :3, 3], T[:, :3, 0], T[:, :3, 1]
    shift = -(I_x * k[:, 0])[:, None] * X - (I_y * k[:, 1])[:, None] * Y
    mass, first = density * float(weights @ A), density * weights @ (A[:, None] * p + shift)
    outer = np.einsum("i,ij,ik->jk", weights * A, p, p) + np.einsum("i,ij,ik->jk", weights * I_x, X, X)
    outer += np.einsum("i,ij,ik->jk", weights * I_y, Y, Y)
    crossed = np.einsum("i,ij,ik->jk", weights, p, shift)
    outer = density * (outer + crossed + crossed.T) - np.outer(first, first) / mass
    return MassProperties(mass / density, mass, first / mass, np.trace(outer) * np.eye(3) - outer)


def flange_part(geometry: ProbeGeometry, density: float) -> MassProperties:
    """Return the properties of the flange with the bore of a hollow probe in the base frame; density [kg/m³]."""
    r, t = geometry.flange.diameter / 2.0, geometry.flange.thickness
    return frustum(r, r, t, -t, density, CrossSection(bore_ratio=geometry.bore_radius / r))
