"""Where an object that moves along a straight path first touches a rod that only gravity bends."""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from probedesign.core.frames import Array
from probedesign.rod.contact import outline
from probedesign.rod.equilibrium import Equilibrium
from probedesign.rod.rod import Rod

_STATIONS = 160
_MIN_ADVANCE = 1e-4  # rod lengths: penetrations shallower than a ten-thousandth of that may be missed
_CLOSE = 1e-6  # rod lengths: accuracy; Newton's method continues from there
_FAR = 0.02  # rod lengths: beyond, the distance from spheres about the axis is accurate enough
_MAX_BISECTIONS = 60
_WITHIN = 1.0 - 1e-9  # of the last interval: the contact begins without penetration
_MAX_STEPS = 100_000
_TANGENTS, _NEWTON_STEPS = 32, 4  # of an elliptic outline, to find the one next to a point


class Obstacle(NamedTuple):
    """A point, or a straight line, that moves along a straight path."""

    point: Array  #: at the end of the path [m], (3,).
    travel: Array  #: from the start to the end of the path [m], (3,).
    direction: Array | None  #: unit vector of the line, (3,); None for a point.

    def at(self, fraction: float) -> Array:
        """Return its position at a fraction, 0 to 1, of the path [m], (3,)."""
        return self.point - (1.0 - fraction) * self.travel


class NearestPoint(NamedTuple):
    """Point of the rod's surface nearest to an object."""

    distance: float  #: from the surface, negative inside [m].
    s: float  #: arclength of that point [m].
    on_end: bool  #: whether it is on the flat end.
    way: float  #: coordinate along the line [m].


@dataclass(frozen=True)
class FirstContactQuery:
    """Distance between an object and a rod that only gravity bends."""

    rod: Rod  #: the rod.
    equilibrium: Equilibrium  #: of the rod under gravity alone.

    def first_contact(self, obstacle: Obstacle) -> tuple[float, NearestPoint] | None:
        """Return the fraction of the path at the first contact, and where it is; None without contact.

        The object advances in each step by a lower bound of its distance from the rod.
        """
        path, length = float(np.linalg.norm(obstacle.travel)), self.rod.length
        fraction, before, gap = 0.0, 0.0, _CLOSE * length
        for _ in range(_MAX_STEPS):
            # From the spheres, less the gap between their centres: a lower bound.
            point = obstacle.at(fraction)
            distance = float(self._from_spheres(point, obstacle.direction).min()) - 0.6 * length / _STATIONS
            if distance < _FAR * length:
                near = self._nearest(point, obstacle.direction)
                if near.distance < 0.0:
                    return self._narrowed(obstacle, (before, gap), (fraction, near))
                distance = max(distance, 0.8 * near.distance, _MIN_ADVANCE * length)
                gap = near.distance
            if fraction >= 1.0:
                return None
            before, fraction = fraction, min(1.0, fraction + distance / max(path, 1e-300))
        return None

    def _narrowed(
        self, obstacle: Obstacle, outside: tuple[float, float], inside: tuple[float, NearestPoint]
    ) -> tuple[float, NearestPoint]:
        """Refine the contact between a fraction outside, with its distance [m], and one inside, by false position."""
        for _ in range(_MAX_BISECTIONS):
            (clear, gap), (fraction, near) = outside, inside
            weight = gap / (gap - near.distance)
            if near.distance > -_CLOSE * self.rod.length:
                break
            middle = clear + min(max(weight, 0.1), 0.9) * (fraction - clear)
            there = self._nearest(obstacle.at(middle), obstacle.direction)
            if there.distance > 0.0:
                outside = middle, there.distance
            else:
                inside = middle, there
        return clear + min(weight, _WITHIN) * (fraction - clear), near

    def _nearest(self, point: Array, direction: Array | None) -> NearestPoint:
        """Return the nearest point to a point, or to a line, by refining about the best of the line's points."""
        if direction is None:
            return self._of_points(point[None, :], np.zeros(1))
        j = int(np.argmin(self._from_spheres(point, direction)))
        middle = float((self._p[j] - point) @ direction)
        reach = 2.0 * self.rod.length / _STATIONS + 2.0 * float(self._radius[j])
        while True:
            tries = np.linspace(middle - reach, middle + reach, 17)
            best = self._of_points(point + tries[:, None] * direction, tries)
            if reach < _CLOSE * self.rod.length:
                return best
            middle, reach = best.way, reach / 8.0

    def _from_spheres(self, point: Array, direction: Array | None) -> Array:
        """Return the distances from spheres about the axis that fill the rod [m], (k,)."""
        apart = point - self._p
        if direction is not None:
            apart = apart - np.outer(apart @ direction, direction)
        distance: Array = np.linalg.norm(apart, axis=1) - self._radius
        return distance

    def _of_points(self, points: Array, ways: Array) -> NearestPoint:
        """Return the nearest of several points (m, 3); the body about the nearest section counts as straight."""
        s, from_axis = self._feet(points)
        reach = np.ones(len(s))
        if self.rod.flatness != 1.0:
            from_axis, reach = self._across(points, s)
        # The signed distance from the outline, base over flank to the centre of the tip, in the half plane (s, r).
        corners = np.zeros((len(s), len(self.rod.s) + 1, 2))
        corners[:, :-1, 0], corners[:, :-1, 1], corners[:, -1, 0] = (
            self.rod.s,
            np.outer(reach, self.rod.radius),
            self.rod.length,
        )
        a, along = corners[:, :-1], np.diff(corners, axis=1)
        here = np.stack([s, from_axis], axis=1)[:, None]
        c = np.clip(((here - a) * along).sum(axis=2) / (along**2).sum(axis=2), 0.0, 1.0)
        nearest = a + c[:, :, None] * along
        gaps = np.linalg.norm(here - nearest, axis=2)
        k, rows = np.argmin(gaps, axis=1), np.arange(len(s))
        inside = (from_axis < reach * self.rod.radius_at(s)) & (s < self.rod.length) & (s > 0.0)
        distance = np.where(inside, -1.0, 1.0) * gaps[rows, k]
        j = int(np.argmin(distance))
        return NearestPoint(
            float(distance[j]), float(nearest[j, k[j], 0]), bool(k[j] == len(self.rod.s) - 1), float(ways[j])
        )

    def _across(self, points: Array, s: Array) -> tuple[Array, Array]:
        """Return how far points lie from the axis along the normal of the section's outline next to them [m], and how
        far the outline reaches along it, over the radius, (n,) each.

        The signed distance from a convex outline is the greatest of those from its tangents, e·x - r g(φ).
        """
        f, radius, at = self.rod.flatness, self.rod.radius_at(s), np.clip(s, 0.0, self.rod.length)
        xy = np.einsum("ni,nij->nj", points - self.equilibrium.p_at(at), self.equilibrium.R_at(at))[:, :2]

        def beyond(phi: Array) -> tuple[Array, Array, Array]:
            x, y = np.cos(phi), np.sin(phi)
            g, k = outline(f, x, y)
            along = xy[:, :1] * x + xy[:, 1:] * y
            slope = xy[:, 1:] * x - xy[:, :1] * y - radius[:, None] * k
            return along - radius[:, None] * g, slope, along + radius[:, None] * (f * f / g**3 - g)

        grid = np.linspace(-np.pi, np.pi, _TANGENTS, endpoint=False)
        phi = grid[np.argmax(beyond(np.tile(grid, (len(s), 1)))[0], axis=1)][:, None]
        for _ in range(_NEWTON_STEPS):
            distance, slope, bends = beyond(phi)
            ahead = phi + np.clip(slope / np.maximum(bends, 1e-300), -2.0 / _TANGENTS, 2.0 / _TANGENTS)
            phi = np.where(beyond(ahead)[0] > distance, ahead, phi)
        reach = outline(f, np.cos(phi), np.sin(phi))[0][:, 0]
        return beyond(phi)[0][:, 0] + radius * reach, reach

    def _feet(self, points: Array) -> tuple[Array, Array]:
        """Return the arclength of each point's foot on the axis, extended at both ends, and its distance."""
        a, along = self._p[:-1], np.diff(self._p, axis=0)
        size = (along**2).sum(axis=1)
        ahead = points @ along.T - (a * along).sum(axis=1)
        c = ahead / size
        c[:, 1:] = np.maximum(c[:, 1:], 0.0)
        c[:, :-1] = np.minimum(c[:, :-1], 1.0)
        away = (points**2).sum(axis=1)[:, None] - 2.0 * points @ a.T + (a**2).sum(axis=1)
        squared = away + c * (c * size - 2.0 * ahead)  # rounds by 1e-16 of the length's square
        past = np.maximum(np.abs(c - 0.5) - 0.5, 0.0)  # so that the extensions do not attract distant points
        k = np.argmin(squared + past**2 * size, axis=1)
        rows = np.arange(len(points))
        s = self._s[k] + c[rows, k] * (self._s[k + 1] - self._s[k])
        return s, np.sqrt(np.maximum(squared[rows, k], 0.0))

    @cached_property
    def _s(self) -> Array:
        even = np.linspace(0.0, self.rod.length, _STATIONS + 1)
        return np.unique(np.concatenate([even, self.rod.s]))

    @cached_property
    def _p(self) -> Array:
        return self.equilibrium.p_at(self._s)

    @cached_property
    def _radius(self) -> Array:
        return self.rod.radius_at(self._s) * max(1.0, self.rod.flatness)
