"""How one would solve the rod in plain Python with scipy: the two opponents of the compiled rod.

Both are written as their user would write them, with care and without tricks, for a bare cone under gravity
and one dead force. Neither is part of the package.
"""

import numpy as np
from scipy.integrate import solve_bvp, solve_ivp
from scipy.optimize import fsolve

from probedesign.frames import Array
from probedesign.rod.rod import Rod

Curve = Array
"""A centreline at the stations asked for [m], (k, 3)."""


def shoot_rk45(rod: Rod, gravity: Array, force: Array, s_contact: float, s: Array, rtol: float) -> Curve:
    """The paper's way: guess the six numbers n(0), m(0), integrate its equation 1 by RK45, correct by fsolve.

    Args:
        rod: the rod; its rigid root is ignored.
        gravity: [m/s²], (3,).
        force: [N], (3,).
        s_contact: [m].
        s: increasing stations [m], (k,).
        rtol: of RK45; the absolute tolerance is a thousandth of it, as in scipy's defaults.
    """
    E, G, kG = rod.youngs_modulus, rod.shear_modulus, rod.shear_coefficient * rod.shear_modulus
    mass = rod.density * float(rod.body.volume_beyond[0])
    size = np.array([1.0, 1.0, 1.0, rod.length, rod.length, rod.length]) * np.linalg.norm(
        force + mass * gravity
    )

    def rates(at: float, y: Array) -> Array:
        R, n, m = y[3:12].reshape(3, 3), y[12:15], y[15:18]
        radius = np.interp(at, rod.s, rod.radius)
        A = np.pi * radius * radius
        EI, GJ = E * A * radius * radius / 4.0, G * A * radius * radius / 2.0
        v = n @ R / (kG * A, kG * A, E * A)
        v[2] += 1.0
        u = m @ R / (EI, EI, GJ)
        ux, uy, uz = u
        f = np.empty(18)
        f[0:3] = R @ v
        f[3:12] = (R @ np.array([[0.0, -uz, uy], [uz, 0.0, -ux], [-uy, ux, 0.0]])).ravel()
        f[12:15] = -rod.density * A * gravity
        (px, py, pz), (nx, ny, nz) = f[0:3], n
        f[15:18] = py * -nz + pz * ny, pz * -nx + px * nz, px * -ny + py * nx
        return f

    def integrate(guess: Array, stations: Array) -> Array:
        y = np.concatenate([np.zeros(3), np.eye(3).ravel(), guess * size])
        jump = np.concatenate([np.zeros(12), force, np.zeros(3)])
        options = {"method": "RK45", "rtol": rtol, "atol": 1e-3 * rtol}
        before = solve_ivp(rates, (0.0, s_contact), y, t_eval=_within(stations, 0.0, s_contact), **options)
        y = before.y[:, -1] - jump
        if s_contact == rod.length:
            return np.column_stack([before.y[:, : int((stations <= s_contact).sum())], y])
        after = solve_ivp(
            rates, (s_contact, rod.length), y, t_eval=_within(stations, s_contact, rod.length), **options
        )
        return np.column_stack([before.y[:, : int((stations <= s_contact).sum())], after.y])

    def misfit(guess: Array) -> Array:
        return integrate(guess, np.array([rod.length]))[12:18, -1] / size

    start = np.concatenate([force + mass * gravity, np.zeros(3)]) / size
    return integrate(fsolve(misfit, start), s)[0:3].T[: len(s)]


def _within(stations: Array, low: float, high: float) -> Array:
    """The stations in (low, high], and 0 with the first of them, and high itself."""
    inside = stations[((stations > low) | (stations == 0.0) & (low == 0.0)) & (stations <= high)]
    return np.unique(np.append(inside, high))


def solve_by_bvp(
    rod: Rod, gravity: Array, force: Array, s_contact: float, s: Array, tol: float = 1e-3, nodes: int = 8
) -> Curve:
    """Collocation: scipy's solve_bvp on [p, quaternion, m], the parts before and after the force side by side.

    n is put in as known. Arguments as for `shoot_rk45`; `tol` and the first mesh are solve_bvp's own.
    """
    E, G, kG = rod.youngs_modulus, rod.shear_modulus, rod.shear_coefficient * rod.shear_modulus
    spans = ((0.0, s_contact), (s_contact, rod.length))
    scale = rod.youngs_modulus * np.pi / 4.0 * float(rod.radius[0]) ** 4 / rod.length

    def weight(at: Array) -> Array:
        """ρ V(s) g of a single frustum."""
        r, r1, h = np.interp(at, rod.s, rod.radius), rod.radius[-1], rod.length - at
        return rod.density * np.pi / 3.0 * h * (r * r + r * r1 + r1 * r1) * gravity[:, None]

    def part(at: Array, y: Array, n: Array) -> Array:
        radius = np.interp(at, rod.s, rod.radius)
        A = np.pi * radius * radius
        EI, GJ = E * A * radius * radius / 4.0, G * A * radius * radius / 2.0
        (x, yy, z, w), m = y[3:7], scale * y[7:10]
        R = np.array([[1 - 2 * (yy * yy + z * z), 2 * (x * yy - w * z), 2 * (x * z + w * yy)],
                      [2 * (x * yy + w * z), 1 - 2 * (x * x + z * z), 2 * (yy * z - w * x)],
                      [2 * (x * z - w * yy), 2 * (yy * z + w * x), 1 - 2 * (x * x + yy * yy)]])  # fmt: skip
        v = np.einsum("jik,jk->ik", R, n) / np.array([kG * A, kG * A, E * A])
        v[2] += 1.0
        u = np.einsum("jik,jk->ik", R, m) / np.array([EI, EI, GJ])
        p = np.einsum("ijk,jk->ik", R, v)
        q = 0.5 * np.array([w * u[0] + yy * u[2] - z * u[1], w * u[1] + z * u[0] - x * u[2],
                            w * u[2] + x * u[1] - yy * u[0], -x * u[0] - yy * u[1] - z * u[2]])  # fmt: skip
        torque = np.array([p[1] * n[2] - p[2] * n[1], p[2] * n[0] - p[0] * n[2], p[0] * n[1] - p[1] * n[0]])
        return np.vstack([p, q, -torque / scale])

    def rates(x: Array, y: Array) -> Array:
        found = []
        for (low, high), loaded, half in zip(spans, (force, np.zeros(3)), (y[:10], y[10:]), strict=True):
            at = low + (high - low) * x
            found.append((high - low) * part(at, half, weight(at) + loaded[:, None]))
        return np.vstack(found)

    clamp = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])

    def ends(a: Array, b: Array) -> Array:
        return np.concatenate([a[:7] - clamp, b[:10] - a[10:], b[17:]])

    x = np.linspace(0.0, 1.0, nodes)
    guess = np.zeros((20, nodes))
    guess[2], guess[12] = s_contact * x, s_contact + (rod.length - s_contact) * x
    guess[6] = guess[16] = 1.0
    found = solve_bvp(rates, ends, x, guess, tol=tol)
    if not found.success:
        raise ArithmeticError(found.message)
    before = found.sol(np.clip(s / s_contact, 0.0, 1.0))[0:3].T
    after = found.sol(np.clip((s - s_contact) / (rod.length - s_contact), 0.0, 1.0))[10:13].T
    return np.where((s <= s_contact)[:, None], before, after)
