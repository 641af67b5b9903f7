"""A bent probe as a thing to look at: a tube about a centreline, with dots on its surface."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from probedesign.frames import Array


@dataclass(frozen=True)
class Dots:
    """Dots painted on a tube.

    Attributes:
        s: arclength of each centre from the tube's start [m], (m,).
        outward_world: direction from the axis to the side that bears it, need not be a normal, (m, 3).
        diameter: of each, measured along the surface [m], (m,).
    """

    s: Array
    outward_world: Array
    diameter: Array


@dataclass(frozen=True)
class Hits:
    """Where rays meet a tube: NaN where they do not.

    Attributes:
        distance: from the rays' origin [m], (n,).
        s: arclength [m], (n,).
        normal_world: outward (n, 3).
    """

    distance: Array
    s: Array
    normal_world: Array


@dataclass(frozen=True)
class Tube:
    """A tube about a polygon of points.

    Attributes:
        p_world: centreline from base to tip [m], dense enough that a chord is its arc, (k, 3).
        diameter: there [m], (k,).
    """

    p_world: Array
    diameter: Array

    @cached_property
    def s(self) -> Array:
        """Arclength of the centreline's points [m], (k,)."""
        return np.append(0.0, np.cumsum(np.linalg.norm(np.diff(self.p_world, axis=0), axis=1)))

    @cached_property
    def tangents_world(self) -> Array:
        """Unit tangents at the points, (k, 3)."""
        tangents = np.gradient(self.p_world, self.s, axis=0)
        return np.asarray(tangents / np.linalg.norm(tangents, axis=1, keepdims=True))

    @cached_property
    def _table(self) -> Array:
        """Point, tangent, radius and its slope at evenly spaced arclengths, (n, 8)."""
        values = np.column_stack(
            [self.p_world, self.tangents_world, self.diameter / 2, np.gradient(self.diameter / 2, self.s)]
        )
        even = np.linspace(0.0, self.s[-1], 4 * len(self.s))
        return np.column_stack([np.interp(even, self.s, column) for column in values.T])

    def at(self, s: ArrayLike) -> tuple[Array, Array, Array, Array]:
        """Centre (n, 3), unit tangent (n, 3), radius and its slope (n,) at arclengths (n,) within the tube."""
        steps = len(self._table) - 1
        place = np.clip(np.asarray(s, dtype=float) / self.s[-1], 0.0, 1.0) * steps
        low = np.minimum(place.astype(int), steps - 1)
        told = self._table[low] + (place - low)[:, None] * (self._table[low + 1] - self._table[low])
        return told[:, :3], told[:, 3:6], told[:, 6], told[:, 7]

    def places(self, dots: Dots) -> Array:
        """Centres of dots on the surface [m], (m, 3)."""
        centre, tangent, radius, _ = self.at(dots.s)
        return centre + radius[:, None] * _across(dots.outward_world, tangent)

    def meet(self, origin: Array, rays: Array, near: Array, steps: int = 5) -> Hits:
        """Where rays meet the tube or its flat ends first.

        Args:
            origin: of all rays [m], (3,).
            rays: unit vectors (n, 3).
            near: arclength of the centreline that each passes near [m], (n,).
            steps: each meets the cone that touches the tube where the last one led; the tube bends little within it.
        """
        s = near.copy()
        for _ in range(steps):
            centre, tangent, radius, slope = self.at(s)
            distance = _meet_cone(origin - centre, rays, tangent, radius, slope)
            along = np.einsum("ni,ni->n", origin + distance[:, None] * rays - centre, tangent)
            s = s + np.nan_to_num(along)
        centre, tangent, radius, slope = self.at(s)
        normal = _across(origin + distance[:, None] * rays - centre, tangent) - slope[:, None] * tangent
        distance = np.where((s >= 0) & (s <= self.s[-1]), distance, np.nan)
        hits = Hits(distance, s, normal / np.linalg.norm(normal, axis=1)[:, None])
        return self._meet_end(0, self._meet_end(-1, hits, origin, rays), origin, rays)

    def _meet_end(self, end: int, hits: Hits, origin: Array, rays: Array) -> Hits:
        """The hits, or those on a flat end where they come first."""
        outward = self.tangents_world[end] * (-1 if end == 0 else 1)
        with np.errstate(divide="ignore"):
            distance = (self.p_world[end] - origin) @ outward / (rays @ outward)
        off = np.linalg.norm(origin + distance[:, None] * rays - self.p_world[end], axis=1)
        first = (off <= self.diameter[end] / 2) & ~(hits.distance < distance)
        return Hits(
            np.where(first, distance, hits.distance),
            np.where(first, self.s[end], hits.s),
            np.where(first[:, None], outward, hits.normal_world),
        )

    def dotted(self, dots: Dots, hits: Hits) -> NDArray[np.bool_]:
        """Whether points of the surface lie in a dot, (n,)."""
        _, tangent, radius, _ = self.at(hits.s)
        side = _across(hits.normal_world, tangent)
        inked = np.zeros(len(side), dtype=bool)
        for s, outward, diameter in zip(dots.s, dots.outward_world, dots.diameter, strict=True):
            close = np.abs(hits.s - s) <= diameter / 2
            facing = np.einsum(
                "ni,ni->n",
                side[close],
                _across(np.broadcast_to(outward, (int(close.sum()), 3)), tangent[close]),
            )
            around = radius[close] * np.arccos(np.clip(facing, -1.0, 1.0))
            inked[close] |= np.hypot(hits.s[close] - s, around) <= diameter / 2
        return inked


def _across(vectors: Array, tangent: Array) -> Array:
    """Unit vectors in the section's plane (n, 3)."""
    across = vectors - np.sum(vectors * tangent, axis=1)[:, None] * tangent
    length = np.linalg.norm(across, axis=1)[:, None]
    return np.asarray(across / np.maximum(length, 1e-12))  # on a flat end nothing is across


def _meet_cone(start: Array, rays: Array, axis: Array, radius: Array, slope: Array) -> Array:
    """Distance at which rays meet cones about an axis through 0, NaN where they pass, (n,).

    Args:
        start: of each ray, from the cone's point of the axis [m], (n, 3).
        rays, axis: unit vectors (n, 3).
        radius, slope: at that point [m], and how it grows along the axis, (n,).
    """
    start_along, ray_along = np.sum(start * axis, axis=1), np.sum(rays * axis, axis=1)
    start_across, ray_across = start - start_along[:, None] * axis, rays - ray_along[:, None] * axis
    wide, grows = radius + slope * start_along, slope * ray_along
    a = np.sum(ray_across**2, axis=1) - grows**2
    b = np.sum(ray_across * start_across, axis=1) - grows * wide
    c = np.sum(start_across**2, axis=1) - wide**2
    under = b**2 - a * c
    return np.asarray((-b - np.sqrt(np.where(under >= 0, under, np.nan))) / a)
