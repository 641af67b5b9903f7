"""Solve the rod by shooting from the base as in the paper, in Python with scipy."""

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import fsolve

from probedesign.core.frames import Array
from probedesign.rod.rod import Rod


def shoot_rk45(rod: Rod, gravity: Array, force: Array, s_contact: float, s: Array, rtol: float) -> Array:
    """Return the centreline at the stations s [m], (k, 3), by integration with RK45 and fsolve for n(0), m(0).

    Args:
        rod: the rod; its rigid root is ignored.
        gravity: in base axes [m/s²], (3,).
        force: on the rod in base axes [N], (3,).
        s_contact: arclength of the force [m].
        s: increasing stations [m], (k,).
        rtol: relative tolerance of RK45; the absolute tolerance is a thousandth of it, as in scipy's defaults.
    """
    E, G, kG = rod.youngs_modulus, rod.shear_modulus, rod.shear_coefficient * rod.shear_modulus
    mass = rod.density * float(rod.body.volume_beyond[0])
    size = np.array([1.0, 1.0, 1.0, rod.length, rod.length, rod.length]) * np.linalg.norm(force + mass * gravity)

    def rates(at: float, y: Array) -> Array:
        R, n, m = y[3:12].reshape(3, 3), y[12:15], y[15:18]
        radius = rod.radius_at(at)
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
        after = solve_ivp(rates, (s_contact, rod.length), y, t_eval=_within(stations, s_contact, rod.length), **options)
        return np.column_stack([before.y[:, : int((stations <= s_contact).sum())], after.y])

    def misfit(guess: Array) -> Array:
        return integrate(guess, np.array([rod.length]))[12:18, -1] / size

    start = np.concatenate([force + mass * gravity, np.zeros(3)]) / size
    return integrate(fsolve(misfit, start), s)[0:3].T[: len(s)]


def _within(stations: Array, low: float, high: float) -> Array:
    """Return the stations in (low, high], with 0 in the first interval, and high itself."""
    inside = stations[((stations > low) | (stations == 0.0) & (low == 0.0)) & (stations <= high)]
    return np.unique(np.append(inside, high))
