"""Rods that the tests of this folder share."""

import math
from dataclasses import replace

import numpy as np

from probedesign.geometry.cross_section import CrossSection
from probedesign.rod.rod import Rod

#: Elastic 50A as the paper identified it [Pa, Pa], its datasheet's density [kg/m³].
E, G, RHO = 2.32e6, 0.761e6, 1010.0

CONE = Rod(np.array([0.0, 0.15]), np.array([6e-3, 1e-3]), E, G, RHO)
ROOTED_CONE = Rod(np.array([0.0, 0.15]), np.array([6e-3, 1e-3]), E, G, RHO, rigid_length=0.72e-3)
CYLINDER = Rod(np.array([0.0, 0.1]), np.array([2e-3, 2e-3]), E, G, RHO)
#: Two breaks of the taper, a shear coefficient and a rigid root.
PROFILE = Rod(np.array([0.0, 0.03, 0.07, 0.12]), np.array([6e-3, 5e-3, 2e-3, 1.5e-3]), 1e6, 0.3e6, 1100.0, 0.9, 4e-3)

#: Round and straight rods, which are invariant under rotation about their axis.
RODS = {"cone": CONE, "rooted": ROOTED_CONE, "cylinder": CYLINDER, "profile": PROFILE}

FLAT = CrossSection(flatness=0.7).factors
TUBE = CrossSection(bore_ratio=0.6).factors
#: Curvature and twist at the profile's knots [1/m]; unloaded, the tip tilts by 28°, sections rotate by up to 42°.
CURVATURE = np.array([[6.0, -4.0, 5.0], [-4.0, 8.0, 20.0], [0.0, 6.0, -8.0], [10.0, 0.0, 2.0]])

YIELDING = replace(CONE, rigid_length=-1.5e-3)  #: A root softer than the rod.
FINITE = replace(ROOTED_CONE, finite_strain=True)
HOLLOW = replace(CONE, factors=TUBE)
ELLIPTIC = replace(CONE, factors=FLAT)
CURVED = replace(PROFILE, rest_curvature=CURVATURE)
#: Options that a rod with finite strain cannot have.
EVERYTHING = replace(PROFILE, factors=FLAT, rest_curvature=CURVATURE, rigid_length=-3e-3)

MORE_RODS = {
    "yielding": YIELDING, "finite": FINITE, "hollow": HOLLOW, "elliptic": ELLIPTIC, "curved": CURVED,
    "everything": EVERYTHING,
}  # fmt: skip
ALL_RODS = RODS | MORE_RODS


def turned(angle, vector):
    """Return a vector rotated about z by an angle [rad]."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ np.asarray(vector, dtype=float)


def bending_force(rod, s_contact, strength):
    """Return the force [N] whose moment at the base rotates the rod at s_contact by about `strength` rad.

    strength = F s² / (E I(0) r(s)/r(0)), exact for a cone bent little; I that of the softer way.
    """
    r0, r = rod.radius[0], rod.radius_at(s_contact)
    stiffness = rod.youngs_modulus * min(rod.factors[1:3]) * np.pi / 4.0 * r0**4
    return strength * stiffness * (r / r0) / s_contact**2


def rest_shape(rod, s):
    """Return curvature and twist of the unloaded rod at s [1/m], (j, 3)."""
    if rod.rest_curvature is None:
        return np.zeros((len(s), 3))
    return np.stack([np.interp(s, rod.s, column) for column in rod.rest_curvature.T], axis=1)


#: Side of the rod, in section axes, from which an object presses.
SIDE = np.array([math.cos(0.4), math.sin(0.4), 0.0])


def approach(rod, gravity, fraction=0.5, depth=0.5, offset=0.2, line=False):
    """Return point, travel and direction or None of an object that moves `depth` radii into the free rod's flank."""
    free = rod.solve(gravity, mode="reference")
    s = fraction * rod.length
    R, r = free.R_at(s), float(rod.radius_at(s))
    out, across = R @ SIDE, R @ np.cross([0.0, 0.0, 1.0], SIDE)
    point = free.p_at(s) + r * ((math.sqrt(1.0 - offset**2) - depth) * out + offset * across)
    travel = -(depth + 3.0) * r * (out + 0.1 * R[:, 2])
    return point, travel, across + 0.3 * R[:, 2] + 0.2 * out if line else None


def surface_point(rod, eq, s, angle):
    """Return point and unit normal of the bent body at a material point, from its shape and radius; not for blends.

    The angle is that of the outline's normal e. The surface has the tangents r ∂c/∂φ and t + r' c + r ∂c/∂s, the last
    the mean of both sides by differences, with c = (cos ψ, f sin ψ), whose normal has the angle if tan ψ = f tan φ.
    """
    f = rod.flatness
    psi = math.atan2(f * math.sin(angle), math.cos(angle))

    def out(place):
        return eq.R_at(place) @ [math.cos(psi), f * math.sin(psi), 0.0]

    R, r, step = eq.R_at(s), float(rod.radius_at(s)), 1e-5 * rod.length
    once, twice = out(s + step) - out(s - step), out(s + 2.0 * step) - out(s - 2.0 * step)
    e, turned_e = out(s), (4.0 * once - twice) / (4.0 * step)
    along = R[:, 2] - rod.taper_at(s) * e + r * turned_e
    normal = np.cross(R @ [-math.sin(psi), f * math.cos(psi), 0.0], along)
    return eq.p_at(s) + r * e, normal / np.linalg.norm(normal)
