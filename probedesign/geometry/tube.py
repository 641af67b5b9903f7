"""The surface of a bent probe as a tube about its centreline, for drawing."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from probedesign.core.frames import Array

RINGS, SIDES = 72, 36  #: Of the mesh on a screen: uniform rings, and corners of each.


@dataclass(frozen=True)
class BentShape:
    """The bent centreline at the nodes of its solution."""

    s: Array  #: arclengths, base to tip [m], (k,).
    p_base: Array  #: points [m], (k, 3).
    R_base: Array  #: section frames with columns x, y and tangent, (k, 3, 3).


def centreline(shape: BentShape, s: Array) -> tuple[Array, Array, Array]:
    """Return points and the section's x and y axes at arclengths s, each (k, 3).

    Cubic between the nodes of the solution, from their tangents. The rod's axial strain, some thousandths, is
    neglected: the result is for drawing, not for measuring.
    """
    i = np.clip(np.searchsorted(shape.s, s, side="right") - 1, 0, len(shape.s) - 2)
    step = shape.s[i + 1] - shape.s[i]
    t = ((s - shape.s[i]) / step)[:, None]
    p0, p1 = shape.p_base[i], shape.p_base[i + 1]
    m0, m1 = (step[:, None] * shape.R_base[j][:, :, 2] for j in (i, i + 1))
    p = (1 + 2 * t) * (1 - t) ** 2 * p0 + t * (1 - t) ** 2 * m0 + t**2 * (3 - 2 * t) * p1 + t**2 * (t - 1) * m1
    slope = 6 * t * (1 - t) * (p1 - p0) + (1 - t) * (1 - 3 * t) * m0 + t * (3 * t - 2) * m1
    tangent = slope / np.linalg.norm(slope, axis=1, keepdims=True)
    x = (1 - t) * shape.R_base[i][:, :, 0] + t * shape.R_base[i + 1][:, :, 0]
    x = x - np.sum(x * tangent, axis=1, keepdims=True) * tangent
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    return p, x, np.cross(tangent, x)


def tube_rings(shape: BentShape, s: Array, radius: Array, flatness: float, sides: int) -> Array:
    """Return the corners of the rings around the centreline at arclengths s, (k, sides, 3) [m].

    Args:
        shape: of the centreline.
        s: arclengths [m], (k,).
        radius: half-width along the section's x axis there [m], (k,).
        flatness: half-width along y divided by that along x.
        sides: number of corners of a ring.
    """
    p, x, y = centreline(shape, s)
    angle = np.linspace(0.0, 2.0 * np.pi, sides, endpoint=False)[:, None]
    around = np.cos(angle) * x[:, None] + flatness * np.sin(angle) * y[:, None]
    return np.asarray(p[:, None] + radius[:, None, None] * around)


def tube_faces(rings: int, sides: int) -> Array:
    """Return the triangles between so many rings, anticlockwise seen from outside, (2 (rings - 1) sides, 3)."""
    ring = np.arange(sides)
    first = sides * np.arange(rings - 1)[:, None]
    a, b = first + ring, first + (ring + 1) % sides
    return np.stack([a, b, b + sides, a, b + sides, a + sides], axis=-1).reshape(-1, 3)


def disc_faces(rim: int, centre: int, sides: int) -> Array:
    """Return the triangles between a ring, its corners from number `rim` on, and a centre; seen from the tip's side."""
    ring = np.arange(sides)
    return np.stack([rim + ring, rim + (ring + 1) % sides, np.full(sides, centre)], axis=1)


@dataclass(frozen=True)
class TubeMesh:
    """Closed mesh of a round or flattened probe around its bent centreline."""

    s: Array  #: arclengths of the knots [m], (k,).
    radius: Array  #: half-width along the section's x axis at the knots, linear in between [m], (k,).
    flatness: float = 1.0  #: half-width along y divided by that along x.
    rings: int = RINGS  #: number of uniform rings; up to as many more are at knots of the radius.
    sides: int = SIDES  #: number of corners of a ring.

    @cached_property
    def stations(self) -> Array:
        """Arclengths of the rings [m]: uniform, plus the knots of the radius."""
        even = np.linspace(self.s[0], self.s[-1], self.rings)
        knots = self.s if len(self.s) <= self.rings else self.s[:: len(self.s) // self.rings]
        return np.asarray(np.unique(np.concatenate([even, knots, self.s[-1:]])))

    @cached_property
    def faces(self) -> Array:
        """Triangles, anticlockwise seen from outside, (j, 3): the rings, then a cap at each end."""
        base = len(self.stations) * self.sides  # the caps have their own rims, so that shading keeps the edge sharp
        tip = base + self.sides + 1
        caps = [disc_faces(base, base + self.sides, self.sides)[:, [1, 0, 2]],
                disc_faces(tip, tip + self.sides, self.sides)]  # fmt: skip
        return np.concatenate([tube_faces(len(self.stations), self.sides), *caps]).astype(np.uint32)

    def vertices(self, shape: BentShape) -> Array:
        """Return the points of the surface [m], (i, 3), in base axes."""
        radius = np.interp(self.stations, self.s, self.radius)
        rings = tube_rings(shape, self.stations, radius, self.flatness, self.sides)
        ends = centreline(shape, self.stations[[0, -1]])[0]
        caps = [np.vstack([rings[end], ends[end]]) for end in (0, -1)]
        return np.asarray(np.concatenate([rings.reshape(-1, 3), *caps]))
