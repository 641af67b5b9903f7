"""Solve the Cosserat rod in numpy, independently of the package, as a reference for its rod and its estimators.

The mechanics is that of docs/decisions/0001 and 0006 with another method: quaternions and moments in section axes, the
classical Runge–Kutta scheme on a graded grid from the tip to the base, and Newton's method for the orientation of the
tip with derivatives by finite differences, for many rods at once. With the state (p, q, m), m in section axes,

    p' = R v,   q' = q (0, u)/2,   m' = -u × m - v × Rᵀn,   n = F [s ≤ s_c] + ρ V(s) g
    v = (n₁/(k G A), n₂/(k G A), 1 + e + e² + c₅ f B),   e = n₃/(E A),   B = r² (m₁² + m₂²)/(E I)²
    u = u* + (f β m₁/(E I₁), f β m₂/(E I₂), m₃/(G J)),   β = 1 + 3 e + c₄ B,   f(s) = 1 - depth (1 - s/reach)³

The force F acts at the point x = p(s_c) + r(s_c) R(s_c) c(φ) of the deformed surface, so that m jumps there by its
couple (x - p) × F. c = e = (cos φ, sin φ) if round, or the point of the ellipse (cos ψ, b/a sin ψ) whose normal is e.
The frame of the surface moves with the section: with tan α = -r' c·e,

    inward normal -(cos α e + sin α t),   circumferential e'(φ),   along cos α t - sin α e

u* is the curvature of the undeformed axis. Only solid sections are supported, round or elliptic, the latter without
finite strain. The public functions have one case per row; internally the cases are the last axis (`round_rods.py`).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import ArrayLike

from tests.reference.round_rods import (
    Array,
    Ends,
    Load,
    Probes,
    cross,
    integrate,
    matrices,
    rotate,
    rotated_by,
    surface_axes,
)

#: Steps between two discontinuities; with FINE the relative error of wrench and points is below 1e-6
#: (test_cosserat.py).
COARSE, FINE = 8, 32
CHUNK = 400  #: Cases solved at once; their arrays fit the cache.
STEP = 1e-7  #: Step of finite differences over the scale of each unknown.
MAX_ROTATION = 0.4  #: Largest rotation of the tip in one iteration [rad].
CONVERGED = 1e-10  #: Largest residual at convergence [rad or lengths of the rod].


@dataclass(frozen=True)
class Touches:
    """Solved touches, one per row; rows that are not `ok` are NaN."""

    ok: Array  #: whether the solution converged and is stable under the force as a dead load, (n,).
    s: Array  #: s, phi: place of the touch, arclength [m] and angle about the section [rad], (n,).
    phi: Array
    force: Array  #: on the probe in base axes [N], (n, 3).
    surface_force: Array  #: components of the force along inward normal, circumference and length [N], (n, 3).
    wrench: Array  #: of the probe on its mount about the base's origin [N, N·m], (n, 6).
    p_surface: Array  #: touched point of the surface, base axes [m], (n, 3).
    p_centre: Array  #: centre of the touched section [m], (n, 3).
    frame: Array  #: columns inward normal, circumferential and along the surface, (n, 3, 3).
    R: Array  #: orientation of the touched section, (n, 3, 3).
    tip: Array  #: quaternion of the tip's section (w, x, y, z), the initial value for a neighbouring touch, (n, 4).
    residual: Array  #: largest residual [rad or lengths of the rod], (n,).

    def take(self, rows: ArrayLike) -> "Touches":
        """Return the touches of the given rows, which may repeat."""
        return Touches(*(getattr(self, entry.name)[np.asarray(rows)] for entry in fields(self)))


# Newton's method


#: Function of rods, unknowns other than the rotation of the tip, (j, m), and the case of each column, (m,). It returns
#: the load and the function of the additional residuals, (j, m).
Problem = Callable[[Probes, Array, Array], tuple[Load, Callable[[Ends], Array]]]


def _columns(probes: Probes, tip: Array, z: Array, scale: Array, problem: Problem, steps: int,
             rows: Array) -> tuple[Array, Array, Ends]:  # fmt: skip
    """Return residuals (k, n) and their derivatives (n, k, k) by rotation of the tip and scaled unknowns."""
    k, n = 3 + len(z), len(probes)
    many, which = np.tile(np.arange(n), k + 1), np.tile(rows, k + 1)
    rotations, stepped = np.zeros((3, k + 1, n)), np.repeat(z[:, None], k + 1, axis=1)
    for j in range(3):
        rotations[j, j + 1] = STEP
    for j in range(len(z)):
        stepped[j, j + 4] += STEP * scale[j]
    found, ends = _residual(probes.take(many), rotated_by(tip[:, many], rotations.reshape(3, -1)),
                            stepped.reshape(len(z), (k + 1) * n), problem, steps, which)  # fmt: skip
    table = found.reshape(k, k + 1, n)
    jacobian = (table[:, 1:] - table[:, :1]) / STEP
    first = Ends(*(getattr(ends, entry.name)[..., :n] for entry in fields(Ends)))
    return table[:, 0], jacobian.transpose(2, 0, 1), first


def _residual(probes: Probes, tip: Array, z: Array, problem: Problem, steps: int, rows: Array) -> tuple[Array, Ends]:
    """Return the rotation of the base relative to the clamp [rad] and the additional residuals, (k, n)."""
    load, more = problem(probes, z, rows)
    ends = integrate(probes, tip, load, steps)
    rotation = 2.0 * np.where(ends.q[0] < 0.0, -1.0, 1.0) * ends.q[1:]
    return np.concatenate([rotation, more(ends)]), ends


def _newton(probes: Probes, tip: Array, z: Array, scale: Array, problem: Problem, steps: int, iterations: int,
            rows: Array) -> tuple[Array, Array, Array, Array]:  # fmt: skip
    """Apply Newton's method; return tip, unknowns, last Jacobians and largest residuals."""
    jacobian, worst = np.empty(0), np.full(len(probes), np.inf)
    for _ in range(iterations):
        found, jacobian, _ends = _columns(probes, tip, z, scale, problem, steps, rows)
        worst = np.abs(found).max(axis=0)
        tip, z = _stepped(tip, z, scale, jacobian, found)
        if (worst < 1e-6).all():
            break
    return tip, z, jacobian, worst


def _stepped(tip: Array, z: Array, scale: Array, jacobian: Array, found: Array) -> tuple[Array, Array]:
    """Take a Newton step with limits for the rotation of the tip and, at half their scale, for the unknowns."""
    good = np.isfinite(jacobian).all(axis=(1, 2)) & np.isfinite(found).all(axis=0)
    safe = np.where(good[:, None, None], jacobian, np.eye(len(found)))
    safe = safe + 1e-14 * np.eye(len(found))
    step = -np.linalg.solve(safe, np.where(good, found, 0.0).T[:, :, None])[:, :, 0].T
    size = np.maximum(np.abs(step[:3]).max(axis=0) / MAX_ROTATION, 1.0)
    if len(z):
        size = np.maximum(size, np.abs(step[3:]).max(axis=0) / 0.5)
    step = step / size
    return rotated_by(tip, step[:3]), z + step[3:] * scale


def _polished(probes: Probes, tip: Array, z: Array, scale: Array, problem: Problem, jacobian: Array, rows: Array
              ) -> tuple[Array, Array, Ends, Array, Load]:  # fmt: skip
    """Iterate on the fine grid with the Jacobian of the coarse one; the residuals are those of the returned values."""
    for iteration in range(8):
        found, ends = _residual(probes, tip, z, problem, FINE, rows)
        worst = np.abs(found).max(axis=0)
        near = worst < 1e-2
        if iteration == 7 or not (near & (worst > CONVERGED)).any():
            break
        new = _stepped(tip, z, scale, jacobian, found)
        tip, z = np.where(near, new[0], tip), np.where(near, new[1], z)
    return tip, z, ends, worst, problem(probes, z, rows)[0]


def _stable(probes: Probes, tip: Array, ends: Ends, load: Load) -> Array:
    """Return whether the Jacobian by the rotation of the tip under the dead load has a positive determinant, (n,)."""
    dead = replace(load, force=ends.force, couple=cross(ends.arm, ends.force) + load.couple,
                   arm=np.zeros_like(load.arm), local=False)  # fmt: skip
    none = np.zeros((0, len(probes)))

    def problem(many: Probes, z: Array, rows: Array) -> tuple[Load, Callable[[Ends], Array]]:
        return _rows_of(dead, rows), lambda ends: np.zeros((0, len(rows)))

    rows = np.arange(len(probes))
    _, jacobian, _ = _columns(probes, tip, none, none, problem, COARSE, rows)
    good = np.isfinite(jacobian).all(axis=(1, 2))
    return good & (np.linalg.det(np.where(good[:, None, None], jacobian, np.eye(3))) > 0.0)


def _rows_of(load: Load, rows: Array) -> Load:
    return Load(*(getattr(load, entry.name)[..., rows] for entry in fields(Load)[:-1]), load.local)


def _touches(probes: Probes, tip: Array, ends: Ends, load: Load, worst: Array) -> Touches:
    """Return the solutions as touches."""
    ok = (worst < 100.0 * CONVERGED) & _stable(probes, tip, ends, load)
    axes = [rotate(ends.touch_q, a) for a in surface_axes(probes, load.s, load.phi)]
    frame = np.stack(axes, axis=-1).transpose(1, 0, 2)
    force = ends.force.T
    centre = ends.touch_p.T
    wrench = np.concatenate([force + (probes.mass * load.gravity).T, ends.m.T], axis=1)
    local = np.einsum("nij,ni->nj", frame, force)
    found = (force, local, wrench, centre + ends.arm.T, centre, frame, matrices(ends.touch_q), tip.T)
    clean = [np.where(ok.reshape(-1, *[1] * (a.ndim - 1)), a, np.nan) for a in found]
    return Touches(ok, load.s, load.phi, *clean, worst)


def _chunked(n: int, solve: Callable[[Array], Touches]) -> Touches:
    """Solve in chunks of cases."""
    parts = [solve(np.arange(first, min(first + CHUNK, n))) for first in range(0, max(n, 1), CHUNK)]
    return Touches(*(np.concatenate([getattr(p, e.name) for p in parts]) for e in fields(Touches)))


# Public functions


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
    """Solve the equilibria under forces at given places of the probes.

    Args:
        probes: n rods.
        gravity: in base axes [m/s²], (3,) or (n, 3).
        s, phi: place of the force: arclength [m] and angle about the section [rad], numbers or (n,).
        force: on the probe [N], (3,) or (n, 3).
        axes: "base" for force components along base axes, "surface" for components along inward normal,
            circumference and length of the deformed surface.
        on_surface: whether the force acts on the surface, with its couple, or on the centreline.
        couple: additional couple at s in base axes [N·m], (3,) or (n, 3).
        start: `tip` of neighbouring solutions, (n, 4); None to start from the unloaded rods in `loads` steps.
        loads: number of steps in which gravity and force increase.

    Returns:
        The touches; with a force of zero they are the probes without contact.
    """
    n = len(probes)
    whole = Load(_vectors(gravity, n), _numbers(s, n), _numbers(phi, n), _vectors(force, n), _vectors(couple, n),
                  np.full(n, float(on_surface)), axes == "surface")  # fmt: skip
    none = np.zeros((0, 1))

    def chunk(rows: Array) -> Touches:
        mine, load = probes.take(rows), _rows_of(whole, rows)
        empty = np.zeros((0, len(rows)))

        def grown(share: float) -> Problem:
            part = replace(load, gravity=share * load.gravity, force=share * load.force, couple=share * load.couple)
            return lambda many, z, which: (_rows_of(part, which), lambda ends: np.zeros((0, len(which))))

        own = np.arange(len(rows))
        if start is None:
            tip = _tip_at_rest(mine)
            shares = np.linspace(0.0, 1.0, loads + 1)[1:]
        else:
            tip, shares = np.nan_to_num(start[rows].T, nan=0.5), np.ones(1)
        for share in shares:
            tip, _, jacobian, _ = _newton(mine, tip, empty, none, grown(share), COARSE, 8, own)
        tip, _, ends, worst, _ = _polished(mine, tip, empty, none, grown(1.0), jacobian, own)
        return _touches(mine, tip, ends, load, worst)

    return _chunked(n, chunk)


def _tip_at_rest(probes: Probes) -> Array:
    """Return the quaternions of the tips without any load, (4, n): the base's with the tip as it is, inverted."""
    n, unit = len(probes), np.array([1.0, 0.0, 0.0, 0.0])
    zero = np.zeros((3, n))
    load = Load(zero, np.zeros(n), np.zeros(n), zero, zero, np.zeros(n), False)
    base = integrate(probes, np.tile(unit[:, None], n), load, COARSE).q
    return base * np.array([1.0, -1.0, -1.0, -1.0])[:, None]


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
    """Solve touches of given points for the place on the probe and the force.

    Without sticking, the force is Fₙ (normal + a₁ circumferential + a₂ along) with given a₁, a₂, and the unknowns are
    (s, φ, Fₙ). With sticking, (s, φ) are those of `start` and the force is unknown. In both cases the touched point of
    the deformed surface is at the given point.

    Args:
        probes: n rods.
        gravity: in base axes [m/s²], (3,) or (n, 3).
        point: of the object in base axes [m], (n, 3).
        start: touches of nearby points to start from.
        friction: (a₁, a₂), (2,) or (n, 2); ignored with sticking.
        sticks: whether the touched material point stays the same.
        moves: number of steps in which the object moves from the touched point of `start` to `point`.

    Returns:
        The touches; not ok without a solution, if the force pulls, or if the touch leaves the flank.
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
        first = from_there[:, rows] if sticks else np.stack([start.s[rows], start.phi[rows], from_there[0, rows]])
        place = np.stack([start.s[rows], start.phi[rows]])

        def towards(share: float) -> Problem:
            target = came[:, rows] + share * (goal[:, rows] - came[:, rows])

            def problem(many: Probes, z: Array, which: Array) -> tuple[Load, Callable[[Ends], Array]]:
                zero, one = np.zeros((3, len(which))), np.ones(len(which))
                a, b = ratios[:, rows][:, which]
                if sticks:
                    (s, phi), force = place[:, which], z
                else:
                    s, phi = np.clip(z[0], 0.0, many.length), z[1]
                    force = z[2] * np.stack([one, a, b])
                load = Load(g[:, rows][:, which], s, phi, force, zero, one, True)
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
    """Return vectors (3,) or (n, 3) as (3, n)."""
    return np.broadcast_to(np.asarray(value, dtype=float), (n, 3)).T.copy()


def _numbers(value: ArrayLike, n: int) -> Array:
    return np.broadcast_to(np.asarray(value, dtype=float), (n,)).copy()


#: Rods, gravity (n, 3), s, phi (n,) and force in the surface frame (n, 3) of slightly changed touches.
Variant = tuple[Probes, Array, Array, Array, Array]


def differences(
    probes: Probes, gravity: ArrayLike, touches: Touches, variants: Sequence[Variant]
) -> tuple[Array, Array]:
    """Return how base wrench and touched point change from solved touches to nearby ones, to first order.

    Each variant is integrated once from the unchanged tip, and the rotation of the tip follows from the implicit
    function theorem. The grid is between the coarse and the fine one; the relative error of the difference is 1e-4.

    Args:
        probes: n rods.
        gravity: in base axes [m/s²], (3,) or (n, 3).
        touches: solved touches of these rods.
        variants: j changed touches.

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


def _differences(probes: Probes, gravity: Array, touches: Touches, variants: Sequence[Variant]) -> tuple[Array, Array]:
    n, count = len(probes), 4 + len(variants)
    tip = np.nan_to_num(touches.tip.T, nan=0.5)
    own: Variant = (probes, gravity.T, touches.s, touches.phi, touches.surface_force)
    # One integration has the touch itself, the touch with its tip rotated about each axis, and the variants.
    every = [own] * 4 + list(variants)
    rods = Probes.joined([v[0] for v in every])
    g, force = (np.concatenate([np.asarray(v[i]) for v in every]).T for i in (1, 4))
    s, phi = (np.concatenate([np.asarray(v[i]) for v in every]) for i in (2, 3))
    rotations = np.zeros((3, count, n))
    rotations[:, 1:4] = STEP * np.eye(3)[:, :, None]
    load = Load(g, s, phi, np.nan_to_num(force), np.zeros((3, count * n)), np.ones(count * n), True)
    tips = rotated_by(np.tile(tip, count), rotations.reshape(3, -1))
    rotation, ends = _residual(rods, tips, np.zeros((0, count * n)),
                               lambda *_: (load, lambda ends: np.zeros((0, count * n))), 2 * COARSE,
                               np.arange(count * n))  # fmt: skip
    found = np.concatenate([rotation, ends.force + rods.mass * g, ends.m, ends.touch_p + ends.arm])
    found = found.reshape(12, count, n) - found.reshape(12, count, n)[:, :1]
    by_rotation = found[:, 1:4] / STEP
    jacobian = by_rotation[:3].transpose(2, 0, 1)
    good = np.isfinite(jacobian).all(axis=(1, 2)) & (np.abs(np.linalg.det(np.nan_to_num(jacobian))) > 0.0)
    inverse = np.linalg.inv(np.where(good[:, None, None], jacobian, np.eye(3)))
    change = found[:, 4:]
    back = -np.einsum("nij,jvn->ivn", inverse, change[:3])
    total = (change[3:] + np.einsum("rjn,jvn->rvn", by_rotation[3:], back)).transpose(2, 0, 1)
    return total[:, :6], total[:, 6:]
