"""Rods that the tests of this folder share."""

import numpy as np

from probedesign.rod.rod import Rod

E, G, RHO = 2.32e6, 0.761e6, 1010.0
"""Elastic 50A as the paper identified it [Pa, Pa], its datasheet's density [kg/m³]."""

CONE = Rod(np.array([0.0, 0.15]), np.array([6e-3, 1e-3]), E, G, RHO)
ROOTED_CONE = Rod(np.array([0.0, 0.15]), np.array([6e-3, 1e-3]), E, G, RHO, rigid_length=0.72e-3)
CYLINDER = Rod(np.array([0.0, 0.1]), np.array([2e-3, 2e-3]), E, G, RHO)
PROFILE = Rod(
    np.array([0.0, 0.03, 0.07, 0.12]), np.array([6e-3, 5e-3, 2e-3, 1.5e-3]), 1e6, 0.3e6, 1100.0, 0.9, 4e-3
)
"""Two breaks of the taper, a shear coefficient and a rigid root."""

RODS = {"cone": CONE, "rooted": ROOTED_CONE, "cylinder": CYLINDER, "profile": PROFILE}


def turned(angle, vector):
    """A vector turned about z by an angle [rad]."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ np.asarray(vector, dtype=float)


def bending_force(rod, s_contact, strength):
    """The force [N] whose moment at the base turns the rod to s_contact by about `strength` rad.

    strength = F s² / (E I(0) r(s)/r(0)), exact for a cone bent little.
    """
    r0, r = rod.radius[0], np.interp(s_contact, rod.s, rod.radius)
    return strength * rod.youngs_modulus * np.pi / 4.0 * r0**4 * (r / r0) / s_contact**2
