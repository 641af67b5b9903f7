"""Synthetic presses: a base that presses a probe on against one fixed point, solved by the reference rod."""

import numpy as np

from probedesign.frames import pose
from probedesign.rod.contact import solve_frictionless


def reference(probe, gravity, s, angle, force):
    """(wrench, centreline's point, touched point) of one touch, to reference accuracy."""
    touch = solve_frictionless(probe.rod, gravity, s, angle, force, "reference")
    assert touch.result == "ok"
    p = touch.equilibrium.p_contact_base
    tan = probe.rod.taper_at(s)
    radius = np.interp(s, probe.rod.s, probe.rod.radius) / np.hypot(1.0, tan)
    return touch.equilibrium.wrench_base, p, p - radius * touch.force_base / force


def presses(probe, gravity, s, angle, forces, fixed="surface", slide=0.0, turn=None):
    """Wrenches (k, 6) and poses (k, 4, 4) of touches of the world's origin, and the mean centreline point there.

    Each touch is made first, wherever it is in base axes; the pose that brings its fixed point to the origin follows.

    Args:
        slide: how far the contact moves along the probe from one touch to the next [m].
        turn: rotation of the base in the world, (3, 3).
    """
    R = np.eye(3) if turn is None else turn
    wrenches, Ts, centres = [], [], []
    for k, force in enumerate(forces):
        wrench, p_contact, p_surface = reference(probe, gravity, s + k * slide, angle, force)
        still = p_surface if fixed == "surface" else p_contact
        wrenches.append(wrench)
        Ts.append(pose(R, -R @ still))
        centres.append(R @ (p_contact - still))
    return np.array(wrenches), np.array(Ts), np.mean(centres, axis=0)
