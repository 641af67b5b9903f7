"""The flange's lip between clamp ring and land: the force that compresses it, and how far the ring bends under it.

The lip is a thin pad of rubber, which bulges more than it is compressed. By Gent and Lindley a pad that sticks to both
plates has the apparent modulus E (1 + 2 S²), with S the loaded area over the area that is free to bulge, and at a
stretch λ of its height the pressure E (1 + 2 S²) (1/λ² - λ)/3. For a ring of width w and thickness t, free at both
edges, S = w/(2 t). Here soft resin lies beside both edges and impedes the bulging; S = (w + t)/(2 t), as if the pad
were wider by half its thickness on each side, reproduces finite elements (`benchmarks/clamp.py` of commit 04ffc97).

The clamp ring rests on the wall around the recess and is loaded at its inner part. It is an annular plate with a free
inner edge; its outer edge is held between simply supported and clamped.

Sources: A. N. Gent, P. B. Lindley, The compression of bonded rubber blocks, Proc. Inst. Mech. Eng. 173, 111-122, 1959;
Roark's Formulas for Stress and Strain, table 11.2, cases 1a and 1e.
"""

import math

from probedesign.core.units import MM, MPA
from probedesign.design.sensors import ScrewPattern

RIGID_MODULUS = 2500.0 * MPA  #: E of the rigid parts: a cured rigid resin (assumed; data sheets state 2.2 to 2.8 GPa).
MIN_LIP = 1.5 * MM  #: Least width of the lip between the ring and the land.
#: Outer width of the lip below which the floor lies lower, so that pressed resin has room, and the least of it where a
#: bulge of the probe or the heads below need a wide land (assumed; without room the lip of a wide flange needs
#: thousands of newtons).
LAND_RELIEF, MIN_RELIEF = 1.0 * MM, 0.4 * MM
#: Of a head's room, from its middle: where the land's edge crosses it there or further in, the land ends in corners of
#: at least 30°, not in blades.
BLUNT = 0.7
#: Bending of the clamp ring over the compression of the lip: the lip keeps four fifths of it (assumed).
MAX_BENDING_SHARE = 0.25
#: Least E that the ring's thickness is chosen for: the greatest of the published fits for Elastic 50A.
STIFF_RESIN = 3.15 * MPA
_POISSON = 0.35  #: Of a rigid resin (assumed).


def pad_force(modulus: float, inner_d: float, outer_d: float, thickness: float, compression: float) -> float:
    """Return the force [N] that compresses a ring of rubber beside more rubber; zero without compression.

    Args:
        modulus: E [Pa].
        inner_d, outer_d: of the ring [m].
        thickness: uncompressed [m].
        compression: of the thickness [m].
    """
    width, stretch = (outer_d - inner_d) / 2, 1.0 - max(compression, 0.0) / thickness
    shape_factor = (width + thickness) / (2.0 * thickness)
    area = math.pi / 4 * (outer_d**2 - inner_d**2)
    return modulus * (1.0 + 2.0 * shape_factor**2) * (stretch**-2 - stretch) / 3.0 * area


def plate_bending(
    modulus: float, thickness: float, inner_d: float, outer_d: float, load_d: float, force: float
) -> tuple[float, float]:
    """Return by how much the inner edge of an annular plate bends [m], its outer edge clamped and simply supported.

    Args:
        modulus: E of the plate [Pa].
        thickness: of the plate [m].
        inner_d, outer_d: of the free and the supported edge [m].
        load_d: diameter of the circle that the force is distributed along [m].
        force: [N].
    """
    v, stiffness = _POISSON, modulus * thickness**3 / 12.0 / (1.0 - _POISSON**2)
    ratio, load = inner_d / outer_d, load_d / outer_d
    c1 = (1.0 + v) / 2.0 * ratio * math.log(1.0 / ratio) + (1.0 - v) / 4.0 * (1.0 / ratio - ratio)
    c4 = ((1.0 + v) * ratio + (1.0 - v) / ratio) / 2.0
    c7 = (1.0 - v**2) / 2.0 * (1.0 / ratio - ratio)
    rise = math.log(1.0 / load)
    l3 = load / 4.0 * ((load**2 + 1.0) * rise + load**2 - 1.0)
    l6 = load / 4.0 * (load**2 - 1.0 + 2.0 * rise)
    l9 = load * ((1.0 + v) / 2.0 * rise + (1.0 - v) / 4.0 * (1.0 - load**2))
    scale = force / (math.pi * load_d) * (outer_d / 2.0) ** 3 / stiffness
    return scale * (c1 * l6 / c4 - l3), scale * (c1 * l9 / c7 - l3)


def stiff_thickness(
    modulus: float, least: float, inner_d: float, outer_d: float, load_d: float, force: float, squeeze: float
) -> float:
    """Return the thickness of a ring that bends by `MAX_BENDING_SHARE` of the lip's compression, the mean of both
    supports, in steps of half a millimetre [m].

    Args:
        modulus, inner_d, outer_d, load_d, force: as in `plate_bending`.
        least: thickness [m].
        squeeze: compression of the lip [m].
    """
    bending = sum(plate_bending(modulus, least, inner_d, outer_d, load_d, force)) / 2.0
    stiff = least * math.pow(bending / (MAX_BENDING_SHARE * squeeze), 1.0 / 3.0)
    return max(least, math.ceil(stiff / (0.5 * MM) - 1e-6) * 0.5 * MM)


def land_diameter(base_d: float, lip: float, flange_d: float, bore_d: float, heads: ScrewPattern, wall: float) -> float:
    """Return the diameter of the land that supports the lip [m].

    It does not follow the flange, which a tool face may widen. Its edge keeps a wall to the room of each head in it, or
    crosses that room bluntly.

    Args:
        base_d, lip, flange_d: of the probe, radial width under the ring, and diameter of the flange [m].
        bore_d: of the ring [m].
        heads: screws whose heads lie in the land.
        wall: least thickness between the room of a head and the land's edge [m].
    """
    middle, room = heads.bolt_circle_d / 2, heads.screw.counterbore_d / 2
    flange_r, least = flange_d / 2, bore_d / 2 + MIN_LIP
    around = least if middle else max(least, room + MIN_LIP)  # the lip surrounds a head on the axis
    land_r = max(base_d / 2 + lip - LAND_RELIEF, min(around, flange_r - MIN_RELIEF))
    if middle + BLUNT * room < land_r < middle + room + wall:
        land_r = middle + room + wall
        if land_r > flange_r - MIN_RELIEF:
            land_r = max(middle + BLUNT * room, least)
    return 2 * land_r
