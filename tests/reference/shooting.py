"""Solve the paper's equations 1 and 2 by shooting from the base, in numpy and scipy: the reference of the compiled rod.

It shares nothing with `probedesign.rod.kernels` except the rod's dimensions: the full frame R and the force n are
integrated, the unknown is the moment at the base and the condition is the moment at the tip. Signs are the standard
ones: n' + f = 0, m' + p' × n = 0, with n, m the load of the material beyond s on the material before s.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike
from scipy.integrate import solve_ivp
from scipy.optimize import root

from probedesign.core.errors import CheckFailedError
from probedesign.core.frames import Array
from probedesign.rod.rod import FINITE_BEND, FINITE_STRETCH, Rod

LOOSE, TIGHT = 1e-7, 3e-13  #: Relative tolerances of the integration: while the load is increased, and of the solution.
MAX_TURN = 0.6  #: Largest rotation of the tip in one load step [rad]: a larger one may land on another branch.
MIN_LOAD_STEP = 1e-3  #: Smallest load step, as a fraction of the load, before the load counts as out of reach.


@dataclass(frozen=True)
class ShootingLoad:
    """Gravity [m/s²], a dead force [N] and couple [N·m] at s_contact [m], a dead moment at the tip [N·m]; base axes."""

    gravity: Array
    force: Array
    tip_moment: Array
    couple: Array
    s_contact: float

    def at_tip(self, length: float) -> Array:
        """Return the moment applied at the tip itself [N·m], (3,)."""
        return self.tip_moment + self.couple if self.s_contact == length else self.tip_moment

    def scaled(self, share: float) -> "ShootingLoad":
        """Return the load multiplied by `share`."""
        vectors = (self.gravity, self.force, self.tip_moment, self.couple)
        gravity, force, tip_moment, couple = (share * v for v in vectors)
        return ShootingLoad(gravity, force, tip_moment, couple, self.s_contact)


@dataclass(frozen=True)
class ShootingEquilibrium:
    """The bent rod at arclengths s, in base axes."""

    s: Array  #: [m], (k,).
    p: Array  #: centreline [m], (k, 3).
    R: Array  #: sections' axes as columns, (k, 3, 3).
    n: Array  #: internal force [N], (k, 3); at s_contact itself the force is counted.
    m: Array  #: internal moment [N·m], (k, 3).
    wrench_base: Array  #: what the rod does to its mount [N, N·m], (6,).
    misfit: float  #: what is left of the moment's condition at the tip [N·m].


def solve_by_shooting(
    rod: Rod,
    gravity: ArrayLike,
    force: ArrayLike,
    s_contact: float,
    tip_moment: ArrayLike = (0.0, 0.0, 0.0),
    s: ArrayLike | None = None,
    couple: ArrayLike = (0.0, 0.0, 0.0),
) -> ShootingEquilibrium:
    """Solve for the static equilibrium on the branch connected to the unloaded rod.

    Args:
        rod: the rod.
        gravity: in base axes [m/s²], (3,).
        force: dead, in base axes, on the centreline [N], (3,).
        s_contact: where it acts [m].
        tip_moment: dead, in base axes [N·m], (3,).
        s: arclengths of the output [m], (k,); 17 even ones if None.
        couple: dead, where the force acts [N·m], (3,).

    Returns:
        The equilibrium.

    Raises:
        CheckFailedError: the load could not be reached.
    """
    vectors = np.array([gravity, force, tip_moment, couple], dtype=float)
    load = ShootingLoad(vectors[0], vectors[1], vectors[2], vectors[3], float(s_contact))
    stations = np.linspace(0.0, rod.length, 17) if s is None else np.asarray(s, dtype=float)
    m_base = _shoot(rod, load, _grow(rod, load), TIGHT)
    y = integrate(rod, load, m_base, TIGHT, stations)
    end = integrate(rod, load, m_base, TIGHT, np.array([rod.length]))[0]
    return ShootingEquilibrium(
        s=stations,
        p=y[:, 0:3],
        R=y[:, 3:12].reshape(-1, 3, 3),
        n=y[:, 12:15],
        m=y[:, 15:18],
        wrench_base=np.concatenate([n_base(rod, load), m_base]),
        misfit=float(np.linalg.norm(end[15:18] - load.at_tip(rod.length))),
    )


def rates(s: float, y: Array, rod: Rod, gravity: Array) -> Array:
    """Return the right-hand side of equation 1 with the stiffness of equation 2; y = [p, R row by row, n, m], (18,).

    Args:
        s: arclength [m].
        y: the state.
        rod: the rod.
        gravity: in base axes [m/s²], (3,).
    """
    R, n, m = y[3:12].reshape(3, 3), y[12:15], y[15:18]
    r = rod.radius_at(s)
    f_area, f_xx, f_yy, f_torsion = rod.factors
    area, inertia = f_area * np.pi * r**2, np.pi / 4.0 * r**4
    E, G, k = rod.youngs_modulus, rod.shear_modulus, rod.shear_coefficient
    # The diagonals of K_se and K_bt; this function takes nearly all of the time.
    k_se = np.array([k * G * area, k * G * area, E * area])
    k_bt = np.array([E * inertia * f_xx, E * inertia * f_yy, G * 2.0 * inertia * f_torsion])
    v = np.array([0.0, 0.0, 1.0]) + (0.0 if rod.inextensible else n @ R / k_se)
    u = m @ R / k_bt
    f = _root(rod, s)
    if rod.finite_strain:
        e, large = v[2] - 1.0, (u[0] ** 2 + u[1] ** 2) * r**2
        v[2] += e**2 + FINITE_STRETCH * f * large
        u[:2] *= 1.0 + 3.0 * e + FINITE_BEND * large
    u[:2] *= f
    u += _rest(rod, s)
    u_hat = np.array([[0.0, -u[2], u[1]], [u[2], 0.0, -u[0]], [-u[1], u[0], 0.0]])
    p_s = R @ v
    R_s = R @ u_hat
    n_s = -rod.density * area * gravity
    m_s = [p_s[2] * n[1] - p_s[1] * n[2], p_s[0] * n[2] - p_s[2] * n[0], p_s[1] * n[0] - p_s[0] * n[1]]
    return np.concatenate([p_s, R_s.ravel(), n_s, m_s])


def _root(rod: Rod, s: float) -> float:
    """Return f(s), the fraction of the bending compliance that the bonded root retains."""
    depth, reach = rod.root
    return 1.0 - depth * (1.0 - s / reach) ** 3 if s < reach else 1.0


def _rest(rod: Rod, s: float) -> Array:
    """Return the curvature and twist of the unloaded rod [1/m], (3,)."""
    if rod.rest_curvature is None:
        return np.zeros(3)
    return np.array([np.interp(s, rod.s, column) for column in np.transpose(rod.rest_curvature)])


def n_base(rod: Rod, load: ShootingLoad) -> Array:
    """Return n(0) = F + m g by equation 3 [N], (3,)."""
    r0, r1 = rod.radius[:-1], rod.radius[1:]
    volume = rod.factors[0] * float(np.sum(np.pi / 3.0 * np.diff(rod.s) * (r0 * r0 + r0 * r1 + r1 * r1)))
    return load.force + rod.density * volume * load.gravity


def integrate(rod: Rod, load: ShootingLoad, m_base: Array, tol: float, stations: Array) -> Array:
    """Integrate outwards from the base, restarting at discontinuities; return the states at the stations, (k, 18)."""
    y = np.concatenate([np.zeros(3), np.eye(3).ravel(), n_base(rod, load), m_base])
    size = np.concatenate([np.full(3, rod.length), np.ones(9), np.full(3, 1.0), np.full(3, rod.length)])
    size[12:18] *= max(float(np.linalg.norm(y[12:15])), float(np.linalg.norm(m_base)) / rod.length, 1e-12)
    points = np.unique(np.concatenate([rod.s, [load.s_contact, np.clip(rod.root[1], 0.0, rod.length)], stations]))
    states = {0.0: y}
    for low, high in pairwise(points.tolist()):
        if low == load.s_contact:
            y = y - np.concatenate([np.zeros(12), load.force, load.couple])
        arguments = (rod, load.gravity)
        with np.errstate(all="ignore"):  # a distant trial may overflow; its steps then fail
            piece = solve_ivp(rates, (low, high), y, "DOP853", args=arguments, rtol=tol, atol=tol * size)
        if not piece.success:
            raise CheckFailedError(f"the integration by shooting failed: {piece.message}")
        states[high] = y = piece.y[:, -1]
    return np.array([states[s] for s in stations.tolist()])


def _shoot(rod: Rod, load: ShootingLoad, guess: Array, tol: float) -> Array:
    """Return the moment at the base for which the tip carries its applied moment, from a guess [N·m], (3,)."""
    force = np.linalg.norm(n_base(rod, load))
    moment = np.linalg.norm(load.tip_moment) + np.linalg.norm(load.couple)
    size = float(rod.length * force + moment) or 1.0
    tip = np.array([rod.length])

    def misfit(m: Array) -> Array:
        """Return the residual of the moment at the tip, relative to the load's own moment."""
        end = integrate(rod, load, m * size, tol, tip)[0, 15:18]
        return np.asarray((end - load.at_tip(rod.length)) / size, dtype=float)

    found = root(misfit, guess / size, options={"xtol": tol, "eps": 1e-6})
    # The residual ends at the integration's own error, a few times its tolerance a step.
    if not np.abs(found.fun).max() <= 1e3 * tol:
        raise CheckFailedError(f"shooting did not converge: {found.message}")
    return np.asarray(found.x * size, dtype=float)


def _grow(rod: Rod, load: ShootingLoad) -> Array:
    """Increase the load from zero in steps of small tip rotation; return the moment at the base [N·m], (3,)."""
    at, step, m, tangent = 0.0, 0.25, np.zeros(3), np.array([0.0, 0.0, 1.0])
    while at < 1.0:
        goal = min(1.0, at + step)
        part = load.scaled(goal)
        try:
            m_new = _shoot(rod, part, m * (goal / at if at else 1.0), LOOSE)
            new = integrate(rod, part, m_new, LOOSE, np.array([rod.length]))[0, [5, 8, 11]]
        except CheckFailedError:
            new = -tangent
        if float(new @ tangent) > np.cos(MAX_TURN):
            at, m, tangent = goal, m_new, new
        else:
            step *= 0.5
            if step < MIN_LOAD_STEP:
                raise CheckFailedError(f"shooting reached {at:.3g} of the load only")
    return m
