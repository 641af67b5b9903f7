"""Solve one contact on the deformed surface by repeated solves of the rod, the reference of the compiled solver.

The model is that of `probedesign/rod/kernels/surface_contact.py`; derivatives are central differences.
"""

from dataclasses import dataclass, replace

import numpy as np

from probedesign.core.frames import Array
from probedesign.rod.equilibrium import Equilibrium
from probedesign.rod.rod import Rod


@dataclass(frozen=True)
class SurfaceTouch:
    """Unknowns: s [m], direction φ of the normal [rad], normal force [N], friction ratios around and along."""

    s: float
    phi: float
    normal: float
    around: float = 0.0
    along: float = 0.0

    def moved(self, j: int, by: float) -> "SurfaceTouch":
        """Return the touch with its j-th unknown changed."""
        name = ("s", "phi", "normal", "around", "along")[j]
        return replace(self, **{name: getattr(self, name) + by})


@dataclass(frozen=True)
class SolvedTouch:
    """Base wrench, touched point, point of the centreline nearest to the line of action, and force, in SI units."""

    wrench: Array
    p_surface: Array
    p_contact: Array
    s_contact: float
    force: Array
    normal: Array
    equilibrium: Equilibrium


def solve_touch(rod: Rod, gravity: Array, touch: SurfaceTouch) -> SolvedTouch:
    """Solve a touch by fixed-point iteration on force and couple until they agree with the bent section.

    The iteration diverges if a rotation of the force rotates the section by a larger angle. The steps are therefore
    halved every 80 iterations.
    """
    r, taper, f = float(rod.radius_at(touch.s)), float(rod.taper_at(touch.s)), rod.flatness
    # The outline cos ψ X + f sin ψ Y of unit half-width has the normal (f cos ψ, sin ψ): tan ψ = f tan φ.
    psi = np.arctan2(f * np.sin(touch.phi), np.cos(touch.phi))
    tip, R = None, np.eye(3)
    force = couple = np.zeros(3)
    for iteration in range(400):
        spoke = R @ [np.cos(psi), f * np.sin(psi), 0.0]
        around = R @ [-np.sin(psi), f * np.cos(psi), 0.0]
        around /= np.linalg.norm(around)
        normal = np.cross(around, R[:, 2] - taper * spoke)
        normal /= np.linalg.norm(normal)
        along = np.cross(normal, around)
        wanted = touch.normal * (-normal + touch.around * around + touch.along * along)
        done = np.abs(wanted - force).max() <= 1e-15 + 1e-13 * np.abs(wanted).max()
        share = 0.5 ** (iteration // 80)
        force = force + share * (wanted - force)
        couple = couple + share * (np.cross(r * spoke, wanted) - couple)
        eq = rod.solve(gravity, force, touch.s, couple=couple, mode="reference", guess=tip)
        assert eq.ok, eq.result
        tip, R = eq.tip, eq.R_at(touch.s)
        if done:
            break
    else:
        raise AssertionError(f"no equilibrium of {touch}")
    p = eq.p_contact_base
    t = R[:, 2]
    shift = -r * float(spoke @ force) * float(force @ t) / float(force @ force - (force @ t) ** 2)
    there = float(np.clip(touch.s + shift, 0.0, rod.length))
    return SolvedTouch(eq.wrench_base, p + r * spoke, eq.p_at(there), touch.s + shift, force, normal, eq)


def derivatives(rod: Rod, gravity: Array, touch: SurfaceTouch) -> Array:
    """Return the derivatives of [wrench, p_surface, p_contact] by the unknowns, (12, 5)."""
    steps = (1e-6, 1e-5, 1e-5 * max(touch.normal, 1e-3), 1e-5, 1e-5)
    columns = []
    for j, h in enumerate(steps):
        high, low = (solve_touch(rod, gravity, touch.moved(j, step)) for step in (h, -h))
        rows = [np.concatenate([one.wrench, one.p_surface, one.p_contact]) for one in (high, low)]
        columns.append((rows[0] - rows[1]) / (2.0 * h))
    return np.array(columns).T
