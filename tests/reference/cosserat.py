"""A second Cosserat rod, in plain numpy, to judge the package's own rod and its estimators by.

The same mechanics as docs/decisions/0001 and 0006 solved another way: section quaternions and moments in section axes,
the classical Runge-Kutta scheme on a graded grid from the tip to the base, and Newton's method on the tip's
orientation with columns by finite differences, for many rods at once. With the state (p, q, m), m in section axes,

    p' = R v,   q' = q (0, u)/2,   m' = -u × m - v × Rᵀn,   n = F [s ≤ s_c] + ρ V(s) g
    v = (n₁/(k G A), n₂/(k G A), 1 + e + e² + c₅ f B),   e = n₃/(E A),   B = r² (m₁² + m₂²)/(E I)²
    u = (f β m₁/(E I), f β m₂/(E I), m₃/(G J)),   β = 1 + 3 e + c₄ B,   f(s) = 1 - depth (1 - s/reach)³

The force F acts at the point x = p(s_c) + r(s_c) R(s_c) e(φ) of the deformed surface, so that m jumps there by its
couple (x - p) × F. The surface frame there is the one of the section: with α the half-angle of the cone,

    inward normal -(cos α e + sin α t),   circumferential e'(φ),   along cos α t - sin α e

Only full round, straight rods. Axes of arrays: components first, cases last, so that every operation is on whole rows;
the functions for users take and give one case a row.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from probedesign.rod.rod import Rod

Array = NDArray[Any]

ROOT_CENTRE = 0.375
"""Centre of the compliance that a bonded root lacks, in base radii. Source: docs/decisions/0006."""
C4, C5 = 0.369, 0.374
"""Finite bending of a neo-Hookean round section. Source: docs/decisions/0006."""
COARSE, FINE = 8, 32
"""Steps between two places where the equations change; FINE keeps wrench and points within 1e-6 relative
(test_cosserat.py)."""
CHUNK = 400
"""Cases solved at once, so that the arrays stay in the cache."""
STEP = 1e-7
"""Of finite differences, over the scale of each unknown."""
TURN = 0.4
"""Largest turn of the tip in one iteration [rad]."""
CONVERGED = 1e-10
"""Of the residuals, in radians and lengths of the rod."""


@dataclass(frozen=True)
class Probes:
    """n full round rods with equally many knots.

    Attributes:
        s: knots [m], (K, n).
        radius: at the knots [m], (K, n).
        E, G, density, shear: Young's and shear modulus [Pa], [kg/m³], shear coefficient, (n,).
        missing: bending compliance that the root lacks, as a length of rigid rod [m], (n,).
        finite: 1 with finite strain, 0 without, (n,).
    """

    s: Array
    radius: Array
    E: Array
    G: Array
    density: Array
    shear: Array
    missing: Array
    finite: Array

    @classmethod
    def of(cls, rods: Rod | Sequence[Rod]) -> "Probes":
        """Return the same rods, from their definitions alone."""
        rods = [rods] if isinstance(rods, Rod) else list(rods)
        assert all(rod.factors == (1.0, 1.0, 1.0, 1.0) and rod.rest_curvature is None for rod in rods)

        def row(name: str) -> Array:
            return np.array([getattr(rod, name) for rod in rods], dtype=float)

        return cls(row("s").T, row("radius").T, row("youngs_modulus"), row("shear_modulus"), row("density"),
                   row("shear_coefficient"), row("rigid_length"), row("finite_strain"))  # fmt: skip

    @classmethod
    def joined(cls, parts: Sequence["Probes"]) -> "Probes":
        """Return the rods of all parts, one after the other."""
        return cls(*(np.concatenate([getattr(part, e.name) for part in parts], axis=-1) for e in fields(cls)))

    def __len__(self) -> int:
        return self.E.shape[-1]

    def take(self, rows: ArrayLike) -> "Probes":
        """Return the rods of these rows, which may repeat."""
        return Probes(*(getattr(self, entry.name)[..., np.asarray(rows)] for entry in fields(self)))

    @property
    def length(self) -> Array:
        """[m], (n,)."""
        return self.s[-1]

    @property
    def root(self) -> tuple[Array, Array]:
        """Depth and reach [m] of f(s), (n,) each; reach 0 for none."""
        least = 5.0 * ROOT_CENTRE * self.radius[0]
        reach = np.where(self.missing == 0.0, 0.0, np.maximum(least, 4.0 * self.missing / 0.9))
        depth = np.divide(4.0 * self.missing, reach, out=np.zeros_like(reach), where=reach > 0.0)
        return depth, reach

    def frustum(self, s: Array) -> tuple[Array, Array, Array, Array, Array]:
        """Return lower and upper knot [m], radius there [m], and the volume beyond the upper one [m³], (n,) each."""
        K, n = self.s.shape
        i = np.zeros(n, dtype=int)
        for k in range(1, K - 1):
            i += s > self.s[k]
        r, h = self.radius, np.diff(self.s, axis=0)
        volumes = np.pi / 3.0 * h * (r[:-1] ** 2 + r[:-1] * r[1:] + r[1:] ** 2)
        beyond = np.concatenate([np.cumsum(volumes[::-1], axis=0)[::-1], np.zeros((1, n))])
        at = np.arange(n)
        return self.s[i, at], self.s[i + 1, at], r[i, at], r[i + 1, at], beyond[i + 1, at]

    def radius_at(self, s: Array) -> Array:
        """Radius at s [m], (n,)."""
        low, high, r0, r1, _ = self.frustum(s)
        return r0 + (r1 - r0) * (s - low) / (high - low)

    def taper_at(self, s: Array) -> Array:
        """tan α = -dr/ds at s, (n,)."""
        low, high, r0, r1, _ = self.frustum(s)
        return (r0 - r1) / (high - low)

    @property
    def mass(self) -> Array:
        """[kg], (n,)."""
        r, h = self.radius, np.diff(self.s, axis=0)
        return self.density * (np.pi / 3.0 * h * (r[:-1] ** 2 + r[:-1] * r[1:] + r[1:] ** 2)).sum(axis=0)


@dataclass(frozen=True)
class Touches:
    """Solved touches, a row each; rows that are not `ok` are NaN.

    Attributes:
        ok: found, and stable under the force as a dead load, (n,).
        s, phi: touched place: arclength [m] and angle about the section [rad], (n,).
        force: on the probe, base axes [N], (n, 3).
        surface_force: the same along inward normal, circumference and length [N], (n, 3).
        wrench: of the probe on its mount about the base's origin [N, N·m], (n, 6).
        p_surface: touched point of the surface, base axes [m], (n, 3).
        p_centre: centre of the touched section [m], (n, 3).
        frame: columns inward normal, circumferential and along the surface, (n, 3, 3).
        R: orientation of the touched section, (n, 3, 3).
        tip: quaternion of the tip's section (w, x, y, z), the start for a neighbour, (n, 4).
        residual: largest residual left [rad or lengths of the rod], (n,).
    """

    ok: Array
    s: Array
    phi: Array
    force: Array
    surface_force: Array
    wrench: Array
    p_surface: Array
    p_centre: Array
    frame: Array
    R: Array
    tip: Array
    residual: Array

    def take(self, rows: ArrayLike) -> "Touches":
        """Return these rows, which may repeat."""
        return Touches(*(getattr(self, entry.name)[np.asarray(rows)] for entry in fields(self)))


# Integration from the tip to the base


@dataclass
class _Load:
    """What acts on n rods; vectors have components first.

    Attributes:
        gravity: (3, n). s, phi: (n,). force: (3, n), along base axes, or in the surface frame if `local`.
        couple: one more dead couple at s [N·m], (3, n).
        arm: 1 where the force acts on the surface, 0 on the centreline, (n,).
    """

    gravity: Array
    s: Array
    phi: Array
    force: Array
    couple: Array
    arm: Array
    local: bool


@dataclass
class _Ends:
    """Where an integration arrives: base's quaternion and moment, and the touch seen from the base's point."""

    q: Array
    m: Array
    p: Array
    touch_q: Array
    touch_p: Array
    force: Array
    arm: Array


def _integrate(probes: Probes, tip: Array, load: _Load, steps: int) -> _Ends:
    """Integrate from the tip, whose section is `tip` (4, n), to the base."""
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
        p, q, m = _segment(probes, p, q, m, bounds[k], bounds[k + 1], pushed, load.gravity, steps)
        here = place == k
        if k < len(inner) and here.any():
            F, d = _push(probes, q, load)
            couple = _back(q, _cross(d, F) + load.couple)
            m = np.where(here, m + couple, m)
            pushed = np.where(here, F, pushed)
            at_p, at_q = np.where(here, p, at_p), np.where(here, q, at_q)
            force, arm = np.where(here, F, force), np.where(here, d, arm)
    return _Ends(q, m, p, at_q, at_p - p, force, arm)


def _push(probes: Probes, q: Array, load: _Load) -> tuple[Array, Array]:
    """Force in base axes and arm from the section's centre to where it acts."""
    e = np.stack([np.cos(load.phi), np.sin(load.phi), np.zeros(len(probes))])
    arm = _turn(q, e) * (load.arm * probes.radius_at(load.s))
    if not load.local:
        return load.force, arm
    normal, around, along = _surface_axes(probes, load.s, load.phi)
    a, b, c = load.force
    return _turn(q, a * normal + b * around + c * along), arm


def _surface_axes(probes: Probes, s: Array, phi: Array) -> tuple[Array, Array, Array]:
    """Inward normal, circumferential and along, in section axes, (3, n) each."""
    tan = probes.taper_at(s)
    cosine = 1.0 / np.sqrt(1.0 + tan * tan)
    sine, zero = tan * cosine, np.zeros_like(s)
    x, y = np.cos(phi), np.sin(phi)
    return (np.stack([-cosine * x, -cosine * y, -sine]), np.stack([-y, x, zero]),
            np.stack([-sine * x, -sine * y, cosine]))  # fmt: skip


def _segment(probes: Probes, p: Array, q: Array, m: Array, start: Array, end: Array, force: Array,
             gravity: Array, steps: int) -> tuple[Array, Array, Array]:  # fmt: skip
    """RK4 over a piece without jumps, with steps in proportion to the radius."""
    if not (start > end).any():
        return p, q, m
    middle = 0.5 * (start + end)
    low, high, r0, r1, beyond = probes.frustum(middle)
    slope = (r1 - r0) / (high - low)
    depth, reach = probes.root
    depth = np.where((middle < reach) & (start > end), depth, 0.0)
    reach = np.where(reach > 0.0, reach, 1.0)
    ratio = (r0 + slope * (end - low)) / (r0 + slope * (start - low))
    flat = np.abs(ratio - 1.0) < 1e-3
    safe = np.where(flat, 2.0, ratio)

    def at(tau: float) -> Array:
        return start + (end - start) * np.where(flat, tau, (safe**tau - 1.0) / (safe - 1.0))

    def medium(s: Array) -> tuple[Array, ...]:
        r = r0 + slope * (s - low)
        area = np.pi * r * r
        stiff = probes.E * area * r * r / 4.0
        weight = beyond + np.pi / 3.0 * (high - s) * (r * r + r * r1 + r1 * r1)
        f = 1.0 - depth * (1.0 - s / reach) ** 3
        large = probes.finite * (r / stiff) ** 2
        twist = 2.0 / (probes.G * area * r * r)
        n = force + probes.density * weight * gravity
        return (f, 1.0 / stiff, twist, 1.0 / (probes.shear * probes.G * area), 1.0 / (probes.E * area), large,
                probes.finite, n)  # fmt: skip

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


def _slopes(q: Array, m: Array, medium: tuple[Array, ...]) -> tuple[Array, Array, Array]:
    """p', q', m' of the module's docstring."""
    f, bend, twist, shear, stretch, large, finite, n_base = medium
    n = _back(q, n_base)
    e, B = stretch * n[2], large * (m[0] * m[0] + m[1] * m[1])
    yields = f * bend * (1.0 + finite * 3.0 * e + C4 * B)
    u, v = np.empty_like(m), np.empty_like(m)
    u[0], u[1], u[2] = yields * m[0], yields * m[1], twist * m[2]
    v[0], v[1], v[2] = shear * n[0], shear * n[1], 1.0 + e + finite * e * e + C5 * f * B
    w, x, y, z = q
    dq = 0.5 * np.stack([
        -x * u[0] - y * u[1] - z * u[2], w * u[0] + y * u[2] - z * u[1],
        w * u[1] + z * u[0] - x * u[2], w * u[2] + x * u[1] - y * u[0],
    ])  # fmt: skip
    return _turn(q, v), dq, -_cross(u, m) - _cross(v, n)


def _cross(a: Array, b: Array) -> Array:
    found = np.empty_like(b)
    found[0] = a[1] * b[2] - a[2] * b[1]
    found[1] = a[2] * b[0] - a[0] * b[2]
    found[2] = a[0] * b[1] - a[1] * b[0]
    return found


def _turn(q: Array, v: Array) -> Array:
    """R(q) v, for quaternions of length one up to the scheme's own error."""
    w, axis = q[0], q[1:]
    twice = 2.0 * _cross(axis, v)
    return v + w * twice + _cross(axis, twice)


def _back(q: Array, v: Array) -> Array:
    """R(q)ᵀ v."""
    twice = 2.0 * _cross(q[1:], v)
    return v - q[0] * twice + _cross(q[1:], twice)


def _turned(q: Array, by: Array) -> Array:
    """q followed by a turn about its own axes by the vector `by` [rad], (4, n)."""
    angle = np.sqrt((by * by).sum(axis=0))
    x, y, z = 0.5 * np.sinc(angle / (2.0 * np.pi)) * by
    w, (a, b, c, d) = np.cos(0.5 * angle), q
    return np.stack([a * w - b * x - c * y - d * z, a * x + b * w + c * z - d * y,
                     a * y - b * z + c * w + d * x, a * z + b * y - c * x + d * w])  # fmt: skip


def _matrices(q: Array) -> Array:
    """R(q), (n, 3, 3)."""
    return np.stack([_turn(q, np.tile(e[:, None], q.shape[1])) for e in np.eye(3)], axis=-1).transpose(
        1, 0, 2
    )


# Newton's method


Problem = Callable[[Probes, Array, Array], tuple[_Load, Callable[[_Ends], Array]]]
"""From rods, unknowns beside the tip's turn (j, m) and the case of each column (m,): the load, and what else must be
zero, (j, m)."""


def _columns(probes: Probes, tip: Array, z: Array, scale: Array, problem: Problem, steps: int,
             rows: Array) -> tuple[Array, Array, _Ends]:  # fmt: skip
    """Residuals (k, n) and their derivatives (n, k, k) by turn of the tip and unknowns over their scale."""
    k, n = 3 + len(z), len(probes)
    many, which = np.tile(np.arange(n), k + 1), np.tile(rows, k + 1)
    turns, moved = np.zeros((3, k + 1, n)), np.repeat(z[:, None], k + 1, axis=1)
    for j in range(3):
        turns[j, j + 1] = STEP
    for j in range(len(z)):
        moved[j, j + 4] += STEP * scale[j]
    found, ends = _residual(probes.take(many), _turned(tip[:, many], turns.reshape(3, -1)),
                            moved.reshape(len(z), (k + 1) * n), problem, steps, which)  # fmt: skip
    table = found.reshape(k, k + 1, n)
    jacobian = (table[:, 1:] - table[:, :1]) / STEP
    first = _Ends(*(getattr(ends, entry.name)[..., :n] for entry in fields(_Ends)))
    return table[:, 0], jacobian.transpose(2, 0, 1), first


def _residual(probes: Probes, tip: Array, z: Array, problem: Problem, steps: int, rows: Array
              ) -> tuple[Array, _Ends]:  # fmt: skip
    """The base's turn away from the identity [rad], then what else must be zero."""
    load, more = problem(probes, z, rows)
    ends = _integrate(probes, tip, load, steps)
    turn = 2.0 * np.where(ends.q[0] < 0.0, -1.0, 1.0) * ends.q[1:]
    return np.concatenate([turn, more(ends)]), ends


def _newton(probes: Probes, tip: Array, z: Array, scale: Array, problem: Problem, steps: int, iterations: int,
            rows: Array) -> tuple[Array, Array, Array, Array]:  # fmt: skip
    """Newton's method with fresh columns; returns tip, unknowns, last Jacobians and largest residuals."""
    jacobian, worst = np.empty(0), np.full(len(probes), np.inf)
    for _ in range(iterations):
        found, jacobian, _ends = _columns(probes, tip, z, scale, problem, steps, rows)
        worst = np.abs(found).max(axis=0)
        tip, z = _stepped(tip, z, scale, jacobian, found)
        if (worst < 1e-6).all():
            break
    return tip, z, jacobian, worst


def _stepped(tip: Array, z: Array, scale: Array, jacobian: Array, found: Array) -> tuple[Array, Array]:
    """Take one step, shortened where the tip would turn far or an unknown move by more than half its scale."""
    good = np.isfinite(jacobian).all(axis=(1, 2)) & np.isfinite(found).all(axis=0)
    safe = np.where(good[:, None, None], jacobian, np.eye(len(found)))
    safe = safe + 1e-14 * np.eye(len(found))
    step = -np.linalg.solve(safe, np.where(good, found, 0.0).T[:, :, None])[:, :, 0].T
    size = np.maximum(np.abs(step[:3]).max(axis=0) / TURN, 1.0)
    if len(z):
        size = np.maximum(size, np.abs(step[3:]).max(axis=0) / 0.5)
    step = step / size
    return _turned(tip, step[:3]), z + step[3:] * scale


def _polished(probes: Probes, tip: Array, z: Array, scale: Array, problem: Problem, jacobian: Array, rows: Array
              ) -> tuple[Array, Array, _Ends, Array, _Load]:  # fmt: skip
    """Repeat on the fine grid with the columns of the coarse one; the last residuals are of what is returned."""
    for turn in range(8):
        found, ends = _residual(probes, tip, z, problem, FINE, rows)
        worst = np.abs(found).max(axis=0)
        near = worst < 1e-2
        if turn == 7 or not (near & (worst > CONVERGED)).any():
            break
        moved = _stepped(tip, z, scale, jacobian, found)
        tip, z = np.where(near, moved[0], tip), np.where(near, moved[1], z)
    return tip, z, ends, worst, problem(probes, z, rows)[0]


def _stable(probes: Probes, tip: Array, ends: _Ends, load: _Load) -> Array:
    """Whether the Jacobian by the tip's turn under the dead load has kept its sign, (n,)."""
    dead = replace(load, force=ends.force, couple=_cross(ends.arm, ends.force) + load.couple,
                   arm=np.zeros_like(load.arm), local=False)  # fmt: skip
    none = np.zeros((0, len(probes)))

    def problem(many: Probes, z: Array, rows: Array) -> tuple[_Load, Callable[[_Ends], Array]]:
        return _rows_of(dead, rows), lambda ends: np.zeros((0, len(rows)))

    rows = np.arange(len(probes))
    _, jacobian, _ = _columns(probes, tip, none, none, problem, COARSE, rows)
    good = np.isfinite(jacobian).all(axis=(1, 2))
    return good & (np.linalg.det(np.where(good[:, None, None], jacobian, np.eye(3))) > 0.0)


def _rows_of(load: _Load, rows: Array) -> _Load:
    return _Load(*(getattr(load, entry.name)[..., rows] for entry in fields(_Load)[:-1]), load.local)


def _touches(probes: Probes, tip: Array, ends: _Ends, load: _Load, worst: Array) -> Touches:
    """What is found, a row a case."""
    ok = (worst < 100.0 * CONVERGED) & _stable(probes, tip, ends, load)
    axes = [_turn(ends.touch_q, a) for a in _surface_axes(probes, load.s, load.phi)]
    frame = np.stack(axes, axis=-1).transpose(1, 0, 2)
    force = ends.force.T
    centre = ends.touch_p.T
    wrench = np.concatenate([force + (probes.mass * load.gravity).T, ends.m.T], axis=1)
    local = np.einsum("nij,ni->nj", frame, force)
    found = (force, local, wrench, centre + ends.arm.T, centre, frame, _matrices(ends.touch_q), tip.T)
    clean = [np.where(ok.reshape(-1, *[1] * (a.ndim - 1)), a, np.nan) for a in found]
    return Touches(ok, load.s, load.phi, *clean, worst)


def _chunked(n: int, solve: Callable[[Array], Touches]) -> Touches:
    """Solve in chunks of cases."""
    parts = [solve(np.arange(first, min(first + CHUNK, n))) for first in range(0, max(n, 1), CHUNK)]
    return Touches(*(np.concatenate([getattr(p, e.name) for p in parts]) for e in fields(Touches)))


# What users call


def solve(
    probes: Probes,
    gravity: ArrayLike,
    s: ArrayLike = 0.0,
    phi: ArrayLike = 0.0,
    force: ArrayLike = (0.0, 0.0, 0.0),
    *,
    axes: str = "base",
    on_surface: bool = True,
    couple: ArrayLike = (0.0, 0.0, 0.0),
    start: Array | None = None,
    loads: int = 6,
) -> Touches:
    """Solve the equilibria under forces at given places of the probe.

    Args:
        probes: n rods.
        gravity: base axes [m/s²], (3,) or (n, 3).
        s, phi: place of the force: arclength [m] and angle about the section [rad], numbers or (n,).
        force: on the probe [N], (3,) or (n, 3).
        axes: "base" for a force along base axes, "surface" for one along inward normal, circumference and length
            of the deformed surface.
        on_surface: whether the force acts on the surface, with its couple, or on the centreline.
        couple: one more couple there, base axes [N·m], (3,) or (n, 3).
        start: `tip` of neighbours, (n, 4); from the unloaded rod in `loads` steps without it.
        loads: steps in which gravity and force grow.

    Returns:
        The touches. With a force of zero they are the free probes.
    """
    n = len(probes)
    whole = _Load(_vectors(gravity, n), _numbers(s, n), _numbers(phi, n), _vectors(force, n), _vectors(couple, n),
                  np.full(n, float(on_surface)), axes == "surface")  # fmt: skip
    none = np.zeros((0, 1))

    def chunk(rows: Array) -> Touches:
        mine, load = probes.take(rows), _rows_of(whole, rows)
        empty = np.zeros((0, len(rows)))

        def grown(share: float) -> Problem:
            part = replace(
                load, gravity=share * load.gravity, force=share * load.force, couple=share * load.couple
            )
            return lambda many, z, which: (_rows_of(part, which), lambda ends: np.zeros((0, len(which))))

        own = np.arange(len(rows))
        if start is None:
            tip = np.tile(np.array([1.0, 0.0, 0.0, 0.0])[:, None], len(rows))
            shares = np.linspace(0.0, 1.0, loads + 1)[1:]
        else:
            tip, shares = np.nan_to_num(start[rows].T, nan=0.5), np.ones(1)
        for share in shares:
            tip, _, jacobian, _ = _newton(mine, tip, empty, none, grown(share), COARSE, 8, own)
        tip, _, ends, worst, _ = _polished(mine, tip, empty, none, grown(1.0), jacobian, own)
        return _touches(mine, tip, ends, load, worst)

    return _chunked(n, chunk)


def press(
    probes: Probes,
    gravity: ArrayLike,
    point: ArrayLike,
    start: Touches,
    *,
    friction: ArrayLike = (0.0, 0.0),
    sticks: bool = False,
    moves: int = 4,
) -> Touches:
    """Solve touches of given points: where on the probe, and with which force.

    Without sticking, the force is Fₙ (normal + a₁ circumferential + a₂ along) with given a₁, a₂, and (s, φ, Fₙ) are
    found; sticking, (s, φ) stay those of `start` and the force is found. In both the touched point of the deformed
    surface lies at the point given.

    Args:
        probes: n rods.
        gravity: base axes [m/s²], (3,) or (n, 3).
        point: of the object, base axes [m], (n, 3).
        start: touches of points nearby, to follow from.
        friction: (a₁, a₂), (2,) or (n, 2); of no account if it sticks.
        sticks: whether the material point stays.
        moves: steps in which the object moves from the start's touched point to `point`.

    Returns:
        The touches; not ok where none is found, the probe pulls, or the touch leaves the flank.
    """
    n = len(probes)
    goal = _vectors(point, n)
    ratios = np.broadcast_to(np.asarray(friction, dtype=float), (n, 2)).T
    g = _vectors(gravity, n)
    size = np.maximum(np.linalg.norm(start.force, axis=1), 1e-4)
    came, from_there = start.p_surface.T, start.surface_force.T

    def chunk(rows: Array) -> Touches:
        mine, own = probes.take(rows), np.arange(len(rows))
        length, newtons = mine.length, np.nan_to_num(size[rows], nan=1.0)
        scale = np.tile(newtons, (3, 1)) if sticks else np.stack([length, np.ones(len(rows)), newtons])
        first = (
            from_there[:, rows] if sticks else np.stack([start.s[rows], start.phi[rows], from_there[0, rows]])
        )
        place = np.stack([start.s[rows], start.phi[rows]])

        def towards(share: float) -> Problem:
            target = came[:, rows] + share * (goal[:, rows] - came[:, rows])

            def problem(many: Probes, z: Array, which: Array) -> tuple[_Load, Callable[[_Ends], Array]]:
                zero, one = np.zeros((3, len(which))), np.ones(len(which))
                a, b = ratios[:, rows][:, which]
                if sticks:
                    (s, phi), force = place[:, which], z
                else:
                    s, phi = np.clip(z[0], 0.0, many.length), z[1]
                    force = z[2] * np.stack([one, a, b])
                load = _Load(g[:, rows][:, which], s, phi, force, zero, one, True)
                return load, lambda ends: (ends.touch_p + ends.arm - target[:, which]) / many.length

            return problem

        z = np.nan_to_num(first, nan=0.0)
        tip = np.nan_to_num(start.tip[rows].T, nan=0.5)
        for share in np.linspace(0.0, 1.0, moves + 1)[1:]:
            tip, z, jacobian, _ = _newton(mine, tip, z, scale, towards(share), COARSE, 8, own)
        tip, z, ends, worst, load = _polished(mine, tip, z, scale, towards(1.0), jacobian, own)
        found = _touches(mine, tip, ends, load, worst)
        lost = ~start.ok[rows] | ~(found.surface_force[:, 0] > 0.0) | (load.s >= length)
        return replace(found, ok=found.ok & ~lost)

    return _chunked(n, chunk)


def _vectors(value: ArrayLike, n: int) -> Array:
    """(3,) or (n, 3) as (3, n)."""
    return np.broadcast_to(np.asarray(value, dtype=float), (n, 3)).T.copy()


def _numbers(value: ArrayLike, n: int) -> Array:
    return np.broadcast_to(np.asarray(value, dtype=float), (n,)).copy()


Variant = tuple[Probes, Array, Array, Array, Array]
"""Rods, gravity (n, 3), s, phi (n,) and force in the surface frame (n, 3) of touches that are changed a little."""


def differences(
    probes: Probes, gravity: ArrayLike, touches: Touches, variants: Sequence[Variant]
) -> tuple[Array, Array]:
    """Return how base wrench and touched point change from solved touches to nearby ones, to first order.

    One integration a variant from the tip as it is, and the tip's turn by the implicit function theorem. On a grid
    between the coarse and the fine one: the error is a share of 1e-4 of the difference.

    Args:
        probes: n rods.
        gravity: base axes [m/s²], (3,) or (n, 3).
        touches: solved, the same n.
        variants: j of them.

    Returns:
        Changes of the wrench [N, N·m], (n, 6, j), and of the touched point [m], (n, 3, j); not divided by a step.
    """
    n, g = len(probes), _vectors(gravity, len(probes))
    if not variants:
        return np.zeros((n, 6, 0)), np.zeros((n, 3, 0))
    parts = [_differences(probes.take(rows), g[:, rows], touches.take(rows), [
        (variant[0].take(rows), *(np.asarray(value)[rows] for value in variant[1:])) for variant in variants
    ]) for rows in np.array_split(np.arange(n), max(1, -(-n // CHUNK)))]  # fmt: skip
    return np.concatenate([w for w, _ in parts]), np.concatenate([p for _, p in parts])


def _differences(probes: Probes, gravity: Array, touches: Touches, variants: Sequence[Variant]
                 ) -> tuple[Array, Array]:  # fmt: skip
    n, count = len(probes), 4 + len(variants)
    tip = np.nan_to_num(touches.tip.T, nan=0.5)
    own: Variant = (probes, gravity.T, touches.s, touches.phi, touches.surface_force)
    # The touch itself, with its tip turned about each axis, and the variants, in one integration.
    every = [own] * 4 + list(variants)
    rods = Probes.joined([v[0] for v in every])
    g, force = (np.concatenate([np.asarray(v[i]) for v in every]).T for i in (1, 4))
    s, phi = (np.concatenate([np.asarray(v[i]) for v in every]) for i in (2, 3))
    turns = np.zeros((3, count, n))
    turns[:, 1:4] = STEP * np.eye(3)[:, :, None]
    load = _Load(g, s, phi, np.nan_to_num(force), np.zeros((3, count * n)), np.ones(count * n), True)
    turn, ends = _residual(rods, _turned(np.tile(tip, count), turns.reshape(3, -1)), np.zeros((0, count * n)),
                           lambda *_: (load, lambda ends: np.zeros((0, count * n))), 2 * COARSE,
                           np.arange(count * n))  # fmt: skip
    found = np.concatenate([turn, ends.force + rods.mass * g, ends.m, ends.touch_p + ends.arm])
    found = found.reshape(12, count, n) - found.reshape(12, count, n)[:, :1]
    by_turn = found[:, 1:4] / STEP
    jacobian = by_turn[:3].transpose(2, 0, 1)
    good = np.isfinite(jacobian).all(axis=(1, 2)) & (np.abs(np.linalg.det(np.nan_to_num(jacobian))) > 0.0)
    inverse = np.linalg.inv(np.where(good[:, None, None], jacobian, np.eye(3)))
    change = found[:, 4:]
    back = -np.einsum("nij,jvn->ivn", inverse, change[:3])
    total = (change[3:] + np.einsum("rjn,jvn->rvn", by_turn[3:], back)).transpose(2, 0, 1)
    return total[:, :6], total[:, 6:]
