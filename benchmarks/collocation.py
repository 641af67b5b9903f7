"""Solve the rod by collocation with scipy's solve_bvp, which chooses its own mesh."""

import numpy as np
from scipy.integrate import solve_bvp

from probedesign.core.frames import Array
from probedesign.rod.rod import Rod


def solve_by_bvp(
    rod: Rod, gravity: Array, force: Array, s_contact: float, s: Array, tol: float = 1e-3, nodes: int = 8
) -> Array:
    """Return the centreline at the stations s [m], (k, 3), from solve_bvp with the state [p, quaternion, m].

    The parts before and after the force are solved together on one interval; n is known in closed form.

    Args:
        rod: the rod; its rigid root is ignored.
        gravity: in base axes [m/s²], (3,).
        force: on the rod in base axes [N], (3,).
        s_contact: arclength of the force [m].
        s: increasing stations [m], (k,).
        tol: tolerance of solve_bvp.
        nodes: nodes of the initial mesh.

    Raises:
        ArithmeticError: solve_bvp fails.
    """
    E, G, kG = rod.youngs_modulus, rod.shear_modulus, rod.shear_coefficient * rod.shear_modulus
    spans = ((0.0, s_contact), (s_contact, rod.length))
    scale = rod.youngs_modulus * np.pi / 4.0 * float(rod.radius[0]) ** 4 / rod.length

    def weight(at: Array) -> Array:
        """Return ρ V(s) g of a single frustum."""
        r, r1, h = rod.radius_at(at), rod.radius[-1], rod.length - at
        return rod.density * np.pi / 3.0 * h * (r * r + r * r1 + r1 * r1) * gravity[:, None]

    def part(at: Array, y: Array, n: Array) -> Array:
        radius = rod.radius_at(at)
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
