"""Upright prisms and what is cut out of them: the closed forms that the adapter is made of."""

from collections.abc import Iterable

import numpy as np

from probedesign.mass import MassProperties, combined

Point = tuple[float, float]


def without(body: MassProperties, voids: Iterable[MassProperties]) -> MassProperties:
    """A body less what is cut out of it; the voids lie wholly inside and do not overlap."""
    hole = combined(voids)
    mass = body.mass - hole.mass
    p_com = (body.mass * body.p_com - hole.mass * hole.p_com) / mass
    inertia = body.inertia_about(p_com) - hole.inertia_about(p_com)
    return MassProperties(body.volume - hole.volume, mass, p_com, inertia)


def prism(
    area: float, Ix: float, Iy: float, z: tuple[float, float], density: float, p: Point
) -> MassProperties:
    """An upright prism between z[0] and z[1]: area [m²], ∫y² and ∫x² [m⁴] about its centroid p."""
    h = z[1] - z[0]
    mass = density * area * h
    slab = mass * h * h / 12.0
    inertia = np.diag([density * h * Ix + slab, density * h * Iy + slab, density * h * (Ix + Iy)])
    return MassProperties(area * h, mass, np.array([*p, (z[0] + z[1]) / 2]), inertia)


def cylinder(d: float, z0: float, z1: float, density: float, p: Point = (0.0, 0.0)) -> MassProperties:
    """An upright cylinder of diameter d about p."""
    second = np.pi * d**4 / 64.0
    return prism(np.pi * d * d / 4.0, second, second, (z0, z1), density, p)


def hexagon(af: float, z0: float, z1: float, density: float, p: Point) -> MassProperties:
    """Regular hexagon across flats `af`: A = √3/2 af², I = 5√3/144 af⁴ about any diameter."""
    second = 5.0 * np.sqrt(3.0) / 144.0 * af**4
    return prism(np.sqrt(3.0) / 2.0 * af * af, second, second, (z0, z1), density, p)


def segment(r: float, x: float, z0: float, z1: float, density: float) -> MassProperties:
    """What a plane at distance x cuts off a round of radius r, on the +x side.

    With cos φ = x/r: A = r²(φ − sin φ cos φ), x̄ A = 2/3 r³ sin³ φ,
    ∫x² = r⁴/4 (φ − sin φ cos φ + 2 sin³ φ cos φ), ∫y² = r⁴/12 (3φ − 3 sin φ cos φ − 2 sin³ φ cos φ).

    Source: any table of plane areas (circular segment); the tests integrate it again.
    """
    phi = float(np.arccos(x / r))
    s, c = np.sin(phi), np.cos(phi)
    area = r * r * (phi - s * c)
    x_mean = 2.0 / 3.0 * r**3 * s**3 / area
    Iy = r**4 / 4.0 * (phi - s * c + 2 * s**3 * c) - area * x_mean**2
    Ix = r**4 / 12.0 * (3 * phi - 3 * s * c - 2 * s**3 * c)
    return prism(area, Ix, Iy, (z0, z1), density, (x_mean, 0.0))
