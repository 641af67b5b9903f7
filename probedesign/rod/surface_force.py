"""Equilibrium of a rod under a force that acts at a point of its deformed surface and turns with it."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from probedesign.frames import Array
from probedesign.rod.coulomb_equations import SurfaceProfile
from probedesign.rod.equilibrium import Equilibrium
from probedesign.rod.rod import Mode, Rod

_MAX_ITERATIONS = 15


class SurfaceForce(NamedTuple):
    """Equilibrium under a force that is given in the axes of the surface it acts on.

    Attributes:
        result: "ok", or the code of the equilibrium that was not found.
        equilibrium: of the rod.
        force_base: [N], (3,).
        p_surface_base: point of the surface where it acts [m], (3,).
    """

    result: str
    equilibrium: Equilibrium
    force_base: Array
    p_surface_base: Array


def solve_surface_force(
    rod: Rod,
    gravity: ArrayLike,
    s: float,
    angle: float,
    normal_force: float,
    tangential: tuple[float, float] = (0.0, 0.0),
    mode: Mode = "fast",
) -> SurfaceForce:
    """Solve for the equilibrium under a force at a point of the deformed surface, given in the surface's own axes.

    F = F_n (-N + c_a a + c_h h) with N the outward normal, a towards the tip along the flank and h around it; it turns
    with the surface. (c_a, c_h) inside a circle of radius μ is a contact within Coulomb's cone.

    Args:
        rod: the rod; its section must be round.
        gravity: in base axes [m/s²], (3,).
        s: arclength of the touched point [m].
        angle: φ of the touched point about the tangent, from the section's x axis [rad].
        normal_force: F_n [N].
        tangential: (c_a, c_h), tangential over normal force.
        mode: "fast" or "reference".

    Returns:
        The equilibrium; numbers come only with result "ok".
    """
    profile = SurfaceProfile.of(rod)
    radius, tan = (float(v) for v in profile.at(np.array(min(s, rod.length) / rod.length)))
    radius, cos = radius * rod.length, 1.0 / math.hypot(1.0, tan)
    e, h = (
        np.array([math.cos(angle), math.sin(angle), 0.0]),
        np.array([-math.sin(angle), math.cos(angle), 0.0]),
    )
    t = np.array([0.0, 0.0, 1.0])
    local = -cos * (e + tan * t) + tangential[0] * cos * (t - tan * e) + tangential[1] * h
    both = np.concatenate([local, np.cross(radius * e, local)])  # force and couple of 1 N, section axes
    load, guess, reached, step = np.concatenate([both[0:3], both[3:6]]), None, 0.0, 1.0
    last_load, last_tip = np.zeros(6), None
    none = np.full(3, np.nan)
    while reached < 1.0:
        goal = min(1.0, reached + step)
        size = goal * normal_force
        load = last_load * (goal / reached) if reached else size * both
        guess, found = last_tip, "not_converged"
        for _ in range(_MAX_ITERATIONS):
            eq = rod.solve(gravity, load[0:3], s, couple=load[3:6], mode=mode, guess=guess,
                           guess_only=guess is not None, columns="contact")  # fmt: skip
            if not eq.ok or eq.sensitivity is None:
                found = eq.result
                break
            frame, d = _axes(eq.sensitivity.frame), eq.sensitivity.d_contact
            want = size * np.concatenate([frame @ both[0:3], frame @ both[3:6]])
            off = load - want
            if np.linalg.norm(off[0:3]) <= 1e-9 * normal_force and np.linalg.norm(off[3:6]) <= 1e-9 * (
                normal_force * rod.length
            ):
                found = "ok"
                break
            columns = [*range(3), *range(4, 7)]
            turned = np.stack(
                [np.concatenate([_axes(d[:, j]) @ both[0:3], _axes(d[:, j]) @ both[3:6]]) for j in columns],
                axis=1,
            )
            load = load - np.linalg.solve(np.eye(6) - size * turned, off)
            guess = eq.tip
        if found == "ok":
            reached, last_load, last_tip, step = goal, load, eq.tip, 2.0 * step
            continue
        step *= 0.25
        if step < 1e-3:
            return SurfaceForce(found, eq, none, none)
    point = eq.p_contact_base + radius * (_axes(eq.sensitivity.frame) @ e)  # type: ignore[union-attr]
    return SurfaceForce("ok", eq, load[0:3], np.asarray(point))


def line_of_action(rod: Rod, eq: Equilibrium, p_surface: ArrayLike) -> float:
    """Return the arclength where the force's line of action passes the centreline, seen across both.

    With the force F at x = p + r e of the section at s, that is s - r (F · t)/(F · e), from where F has no couple about
    h = t × e: r tan α nearer the base than the touched section without friction, up to about μ r to either side with
    friction.

    Args:
        rod: the rod.
        eq: its equilibrium under the force at the touched section.
        p_surface: x, in base axes [m], (3,).

    Returns:
        The arclength [m], held to the rod.
    """
    t, arm, force = eq.R_at(eq.s_contact)[:, 2], np.asarray(p_surface) - eq.p_contact_base, eq.load[0:3]
    radius = float(np.linalg.norm(arm))
    s = eq.s_contact - radius * float(force @ t) / (float(force @ arm) / radius)
    return min(max(s, 0.0), rod.length)


def _axes(column: Array) -> Array:
    """[x, y, tangent] as columns from the kernels' [tangent, x, position, y]."""
    return np.stack([column[3:6], column[9:12], column[0:3]], axis=-1)
