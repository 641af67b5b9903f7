"""What the kernels are given: a rod and a load, as arrays."""

from typing import NamedTuple

from probedesign.frames import Array


class Body(NamedTuple):
    """What a rod is made of.

    Attributes:
        knots: arclengths where the taper changes [m], (K,).
        radii: half-widths along the section's x axis at the knots [m], (K,).
        volume_beyond: from each knot to the tip [m³], (K,).
        volume_by_knot: its derivative by the logarithm of each knot's radius [m³], (K, K).
        rest: curvature and twist of the unloaded rod at the knots, in section axes, linear between [1/m],
            (3 K,).
        constants: see the indices below, (CONSTANTS,).
    """

    knots: Array
    radii: Array
    volume_beyond: Array
    volume_by_knot: Array
    rest: Array
    constants: Array


CONSTANTS = 12
BEND_X, BEND_Y, TWIST, SHEAR, STRETCH, DENSITY, CONE, GENERAL = range(8)
"""Compliances of a section of half-width 1 m in bending about x and about y, twist [m²/N], shear and stretch
[m²/N]; density [kg/m³]; volume of a cone over r² h; 1 where bending knows direction or the rod is curved at rest,
0 where it is round and straight."""
ROOT_DEPTH, ROOT_REACH = 8, 9
"""Of the bonded root, f(s) = 1 - depth (1 - s/reach)³ up to the reach [m], 1 beyond."""
FINITE_BEND, FINITE_STRETCH = 10, 11
"""c₄ and c₅ of the section's finite strain; zeros: linear elasticity."""

LOAD = 13
FORCE, GRAVITY, TIP_MOMENT, COUPLE, S_CONTACT = 0, 3, 6, 9, 12
"""Where in a load stand force [N], gravity [m/s²], moment at the tip and couple at the contact [N·m], all dead
and in base axes, and s_contact [m]."""

PARAMETERS = (
    "force_x", "force_y", "force_z", "s_contact", "couple_x", "couple_y", "couple_z",
    "gravity_x", "gravity_y", "gravity_z", "log_E", "log_G", "log_density", "log_diameter",
)  # fmt: skip
"""What sensitivities are by; after these, the logarithm of each knot's own diameter."""
LOAD_COLUMNS = 4
CONTACT_COLUMNS = 7
ALL_COLUMNS = len(PARAMETERS)

OK, NOT_CONVERGED, UNSTABLE, STEP_LIMIT = 0, 1, 2, 3
