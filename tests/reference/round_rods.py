"""Integrate the equations of `cosserat.py` for round and elliptic rods from the tip to the base.

Arrays have the components first and the cases last, so that operations are on whole rows.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from probedesign.rod.rod import Rod

Array = NDArray[Any]

ROOT_CENTRE = 0.375  #: Centre of the missing compliance of a bonded root, in base radii. Source: docs/decisions/0006.
C4, C5 = 0.369, 0.374  #: Coefficients of finite bending of a neo-Hookean round section. Source: docs/decisions/0006.


@dataclass(frozen=True)
class Probes:
    """n rods with solid round or elliptic sections and equal numbers of knots."""

    s: Array  #: arclengths of the knots [m], (K, n).
    radius: Array  #: half-widths of the section along its x axis at the knots [m], (K, n).
    E: Array  #: E, G, density, shear: Young's and shear modulus [Pa], density [kg/m³] and shear coefficient, (n,).
    G: Array
    density: Array
    shear: Array
    missing: Array  #: missing bending compliance of the root as a length of rigid rod [m], (n,).
    finite: Array  #: 1 with finite strain, 0 without, (n,).
    flatness: Array  #: half-width along y over that along x, (n,).
    rest: (
        Array  #: curvature and twist of the unloaded rod at the knots in section axes, linear between [1/m], (K, 3, n).
    )

    @classmethod
    def of(cls, rods: Rod | Sequence[Rod]) -> "Probes":
        """Return rods of the package in this form."""
        rods = [rods] if isinstance(rods, Rod) else list(rods)
        f, *others = np.array([rod.factors for rod in rods]).T
        assert np.allclose(others, [f**3, f, 2.0 * f**3 / (1.0 + f**2)])  # of solid ellipses

        def row(name: str) -> Array:
            return np.array([getattr(rod, name) for rod in rods], dtype=float)

        return cls(row("s").T, row("radius").T, row("youngs_modulus"), row("shear_modulus"), row("density"),
                   row("shear_coefficient"), row("rigid_length"), row("finite_strain"), f,
                   np.stack([np.zeros((len(rod.s), 3)) if rod.rest_curvature is None else rod.rest_curvature
                             for rod in rods], axis=-1))  # fmt: skip

    @classmethod
    def joined(cls, parts: Sequence["Probes"]) -> "Probes":
        """Concatenate the rods of all parts."""
        return cls(*(np.concatenate([getattr(part, e.name) for part in parts], axis=-1) for e in fields(cls)))

    def __len__(self) -> int:
        return self.E.shape[-1]

    def take(self, rows: ArrayLike) -> "Probes":
        """Return the rods of the given rows, which may repeat."""
        return Probes(*(getattr(self, entry.name)[..., np.asarray(rows)] for entry in fields(self)))

    @property
    def length(self) -> Array:
        """Length of the rods [m], (n,)."""
        return self.s[-1]

    @property
    def root(self) -> tuple[Array, Array]:
        """Depth and reach [m] of f(s), (n,) each; the reach is 0 without a missing compliance."""
        min_reach = 5.0 * ROOT_CENTRE * self.radius[0]
        reach = np.where(self.missing == 0.0, 0.0, np.maximum(min_reach, 4.0 * self.missing / 0.9))
        depth = np.divide(4.0 * self.missing, reach, out=np.zeros_like(reach), where=reach > 0.0)
        return depth, reach

    def frustum(self, s: Array) -> tuple[Array, Array, Array, Array, Array]:
        """Return the knots around s [m], their radii [m] and the volume beyond the upper knot [m³], (n,) each."""
        K, n = self.s.shape
        i = np.zeros(n, dtype=int)
        for k in range(1, K - 1):
            i += s > self.s[k]
        r, h = self.radius, np.diff(self.s, axis=0)
        volumes = self.flatness * np.pi / 3.0 * h * (r[:-1] ** 2 + r[:-1] * r[1:] + r[1:] ** 2)
        beyond = np.concatenate([np.cumsum(volumes[::-1], axis=0)[::-1], np.zeros((1, n))])
        at = np.arange(n)
        return self.s[i, at], self.s[i + 1, at], r[i, at], r[i + 1, at], beyond[i + 1, at]

    def rest_at(self, s: Array, middle: Array) -> Array:
        """Return curvature and twist of the unloaded rod at s [1/m], (3, n), on the frustum that `middle` [m] is in."""
        upper = np.clip((middle > self.s).sum(axis=0), 1, len(self.s) - 1)
        at = np.arange(len(self))
        low, high = self.s[upper - 1, at], self.s[upper, at]
        share = (s - low) / (high - low)
        return (1.0 - share) * self.rest[upper - 1, :, at].T + share * self.rest[upper, :, at].T

    def radius_at(self, s: Array) -> Array:
        """Return the half-width along x at s [m], (n,)."""
        low, high, r0, r1, _ = self.frustum(s)
        return r0 + (r1 - r0) * (s - low) / (high - low)

    def taper_at(self, s: Array) -> Array:
        """Return -dr/ds at s, (n,)."""
        low, high, r0, r1, _ = self.frustum(s)
        return (r0 - r1) / (high - low)

    @property
    def mass(self) -> Array:
        """Mass of the rods [kg], (n,)."""
        r, h = self.radius, np.diff(self.s, axis=0)
        volumes = np.pi / 3.0 * h * (r[:-1] ** 2 + r[:-1] * r[1:] + r[1:] ** 2)
        return self.density * self.flatness * volumes.sum(axis=0)


# Integration from the tip to the base


@dataclass
class Load:
    """Loads of n rods; vectors have their components first."""

    gravity: Array  #: in base axes [m/s²], (3, n).
    s: Array  #: s, phi: place of the force, arclength [m] and angle of the section's normal [rad], (n,).
    phi: Array
    force: Array  #: in base axes, or in the frame of the surface if `local` [N], (3, n).
    couple: Array  #: additional dead couple at s [N·m], (3, n).
    arm: Array  #: 1 if the force acts on the surface, 0 if on the centreline, (n,).
    local: bool  #: whether the force is in the frame of the surface.


@dataclass
class Ends:
    """Result of an integration: quaternion, moment and point of the base, and the touch relative to that point."""

    q: Array
    m: Array
    p: Array
    touch_q: Array
    touch_p: Array
    force: Array
    arm: Array


def integrate(probes: Probes, tip: Array, load: Load, steps: int) -> Ends:
    """Integrate to the base from the tip, whose section has the orientation `tip`, (4, n)."""
    n = len(probes)
    zero = np.zeros(n)
    inner = np.stack([*probes.s[1:-1], probes.root[1], load.s])
    order = np.argsort(-inner, axis=0, kind="stable")
    place = np.argmax(order == len(inner) - 1, axis=0)
    bounds = np.concatenate([probes.length[None], np.take_along_axis(inner, order, axis=0), zero[None]])
    p, q, m = np.zeros((3, n)), tip.copy(), np.zeros((3, n))
    pushed = np.zeros((3, n))
    at_p, at_q, force, arm = np.zeros((3, n)), tip.copy(), np.zeros((3, n)), np.zeros((3, n))
    for k in range(len(bounds) - 1):
        p, q, m = _segment(probes, p, q, m, bounds[k], bounds[k + 1], pushed, load.gravity, steps=steps)
        here = place == k
        if k < len(inner) and here.any():
            F, d = _push(probes, q, load)
            couple = rotate_back(q, cross(d, F) + load.couple)
            m = np.where(here, m + couple, m)
            pushed = np.where(here, F, pushed)
            at_p, at_q = np.where(here, p, at_p), np.where(here, q, at_q)
            force, arm = np.where(here, F, force), np.where(here, d, arm)
    return Ends(q, m, p, at_q, at_p - p, force, arm)


def _push(probes: Probes, q: Array, load: Load) -> tuple[Array, Array]:
    """Return the force in base axes [N] and its arm from the centre of the section [m]."""
    spoke = np.stack([*_outline(probes, load.phi)[0], np.zeros(len(probes))])
    arm = rotate(q, spoke) * (load.arm * probes.radius_at(load.s))
    if not load.local:
        return load.force, arm
    normal, around, along = surface_axes(probes, load.s, load.phi)
    a, b, c = load.force
    return rotate(q, a * normal + b * around + c * along), arm


def surface_axes(probes: Probes, s: Array, phi: Array) -> tuple[Array, Array, Array]:
    """Return inward normal, circumferential and longitudinal tangent in section axes, (3, n) each."""
    (a, b), around = _outline(probes, phi)
    around = np.stack([*around, np.zeros_like(s)])
    around /= np.sqrt((around * around).sum(axis=0))
    # Tangents are the outline's and, at one place of the outlines, (r' a, r' b, 1).
    outward = cross(around, np.stack([-probes.taper_at(s) * a, -probes.taper_at(s) * b, np.ones_like(s)]))
    outward /= np.sqrt((outward * outward).sum(axis=0))
    return -outward, around, cross(outward, around)


def _outline(probes: Probes, phi: Array) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Return the point of the outline of half-width 1 whose normal has the angle φ, and its derivative by ψ.

    The outline (cos ψ, f sin ψ) has the normal (f cos ψ, sin ψ).
    """
    f = probes.flatness
    psi = np.arctan2(f * np.sin(phi), np.cos(phi))
    return (np.cos(psi), f * np.sin(psi)), (-np.sin(psi), f * np.cos(psi))


def _segment(probes: Probes, p: Array, q: Array, m: Array, start: Array, end: Array, force: Array,
             gravity: Array, *, steps: int) -> tuple[Array, Array, Array]:  # fmt: skip
    """Integrate by RK4 over a segment without discontinuities, with steps proportional to the radius."""
    if not (start > end).any():
        return p, q, m
    middle = 0.5 * (start + end)
    low, high, r0, r1, beyond = probes.frustum(middle)
    slope, curved = (r1 - r0) / (high - low), bool(probes.rest.any())
    depth, reach = probes.root
    depth = np.where((middle < reach) & (start > end), depth, 0.0)
    reach = np.where(reach > 0.0, reach, 1.0)
    ratio = (r0 + slope * (end - low)) / (r0 + slope * (start - low))
    flat = np.abs(ratio - 1.0) < 1e-3
    safe = np.where(flat, 2.0, ratio)

    def at(tau: float) -> Array:
        return start + (end - start) * np.where(flat, tau, (safe**tau - 1.0) / (safe - 1.0))

    def medium(s: Array) -> tuple[Any, ...]:
        r = r0 + slope * (s - low)
        f_y = probes.flatness
        area = np.pi * r * r * f_y
        stiff = probes.E * area * r * r / 4.0  # about y
        weight = beyond + f_y * np.pi / 3.0 * (high - s) * (r * r + r * r1 + r1 * r1)
        f = 1.0 - depth * (1.0 - s / reach) ** 3
        large = probes.finite * (r / stiff) ** 2
        twist = (1.0 + f_y * f_y) / (probes.G * area * r * r * f_y * f_y)
        n = force + probes.density * weight * gravity
        return (f, 1.0 / (stiff * f_y * f_y), 1.0 / stiff, twist, 1.0 / (probes.shear * probes.G * area),
                1.0 / (probes.E * area), large, probes.finite,
                probes.rest_at(s, middle) if curved else 0.0, n)  # fmt: skip

    s, here = at(0.0), medium(at(0.0))
    for step in range(steps):
        after = at((step + 1.0) / steps)
        h = after - s
        half, there = medium(s + 0.5 * h), medium(after)
        k1 = _slopes(q, m, here)
        k2 = _slopes(q + 0.5 * h * k1[1], m + 0.5 * h * k1[2], half)
        k3 = _slopes(q + 0.5 * h * k2[1], m + 0.5 * h * k2[2], half)
        k4 = _slopes(q + h * k3[1], m + h * k3[2], there)
        p, q, m = (
            value + h / 6.0 * (a + 2.0 * (b + c) + d)
            for value, a, b, c, d in zip((p, q, m), k1, k2, k3, k4, strict=True)
        )
        q = q / np.sqrt((q * q).sum(axis=0))
        s, here = after, there
    return p, q, m


def _slopes(q: Array, m: Array, medium: tuple[Any, ...]) -> tuple[Array, Array, Array]:
    """Return p', q', m' of the equations in `cosserat.py`."""
    f, bend_x, bend_y, twist, shear, stretch, large, finite, rest, n_base = medium
    n = rotate_back(q, n_base)
    e, B = stretch * n[2], large * (m[0] * m[0] + m[1] * m[1])
    more = f * (1.0 + finite * 3.0 * e + C4 * B)
    u, v = np.empty_like(m), np.empty_like(m)
    u[0], u[1], u[2] = more * bend_x * m[0], more * bend_y * m[1], twist * m[2]
    u += rest
    v[0], v[1], v[2] = shear * n[0], shear * n[1], 1.0 + e + finite * e * e + C5 * f * B
    w, x, y, z = q
    dq = 0.5 * np.stack([
        -x * u[0] - y * u[1] - z * u[2], w * u[0] + y * u[2] - z * u[1],
        w * u[1] + z * u[0] - x * u[2], w * u[2] + x * u[1] - y * u[0],
    ])  # fmt: skip
    return rotate(q, v), dq, -cross(u, m) - cross(v, n)


def cross(a: Array, b: Array) -> Array:
    """Return a × b, (3, n)."""
    found = np.empty_like(b)
    found[0] = a[1] * b[2] - a[2] * b[1]
    found[1] = a[2] * b[0] - a[0] * b[2]
    found[2] = a[0] * b[1] - a[1] * b[0]
    return found


def rotate(q: Array, v: Array) -> Array:
    """Return R(q) v; the norm of q may differ from 1 by the error of the integration."""
    w, axis = q[0], q[1:]
    twice = 2.0 * cross(axis, v)
    return v + w * twice + cross(axis, twice)


def rotate_back(q: Array, v: Array) -> Array:
    """Return R(q)ᵀ v."""
    twice = 2.0 * cross(q[1:], v)
    return v - q[0] * twice + cross(q[1:], twice)


def rotated_by(q: Array, by: Array) -> Array:
    """Return q followed by a rotation about its own axes by the vector `by` [rad], (4, n)."""
    angle = np.sqrt((by * by).sum(axis=0))
    x, y, z = 0.5 * np.sinc(angle / (2.0 * np.pi)) * by
    w, (a, b, c, d) = np.cos(0.5 * angle), q
    return np.stack([a * w - b * x - c * y - d * z, a * x + b * w + c * z - d * y,
                     a * y - b * z + c * w + d * x, a * z + b * y - c * x + d * w])  # fmt: skip


def matrices(q: Array) -> Array:
    """Return R(q), (n, 3, 3)."""
    return np.stack([rotate(q, np.tile(e[:, None], q.shape[1])) for e in np.eye(3)], axis=-1).transpose(1, 0, 2)
