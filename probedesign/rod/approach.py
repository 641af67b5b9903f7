"""An object on its straight way to a rod that it has not touched yet."""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from probedesign.frames import Array
from probedesign.rod.equilibrium import Equilibrium
from probedesign.rod.rod import Rod

_STATIONS = 160
_LEAST_ADVANCE = 1e-4  # of the length: dips shallower than a ten-thousandth of that are passed over
_CLOSE = 1e-6  # of the length; Newton takes it from there
_FAR = 0.02  # of the length: from further away, balls about the axis tell the distance well enough
_FLUSH = 1e-9  # [rad]
_MOST_HALVINGS = 60
_WITHIN = 1.0 - 1e-9  # of the last interval: a touch begins before it presses
_MOST_STEPS = 100_000


class Obstacle(NamedTuple):
    """A point, or a straight line, that has come along a straight path.

    Attributes:
        point: where it is at last [m], (3,).
        travel: the way it has come [m], (3,).
        direction: of the line, (3,), unit; None for a point.
    """

    point: Array
    travel: Array
    direction: Array | None

    def at(self, part: float) -> Array:
        """Where it is after a part, 0 to 1, of its way [m], (3,)."""
        return self.point - (1.0 - part) * self.travel


class Nearest(NamedTuple):
    """What of the rod lies nearest to an object.

    Attributes:
        distance: from the surface, negative inside [m].
        s: arclength of the surface there [m].
        on_end: whether it is the flat end.
        way: along the line [m].
        flush: whether a line lies along the flat end.
    """

    distance: float
    s: float
    on_end: bool
    way: float
    flush: bool = False


@dataclass(frozen=True)
class FreeRod:
    """A rod that only its weight bends.

    Attributes:
        rod: the rod.
        equilibrium: under gravity alone.
    """

    rod: Rod
    equilibrium: Equilibrium

    def first_touch(self, obstacle: Obstacle) -> tuple[float, Nearest] | None:
        """Part of the way after which the object touches, and where; None if it touches nothing.

        It advances by what separates it from the rod, which no surface can lie nearer than.
        """
        way, length = float(np.linalg.norm(obstacle.travel)), self.rod.length
        part, before, gap = 0.0, 0.0, _CLOSE * length
        for _ in range(_MOST_STEPS):
            apart = self._apart(obstacle.at(part), obstacle.direction)
            if apart < _FAR * length:
                near = self.nearest(obstacle.at(part), obstacle.direction)
                if near.distance < 0.0:
                    return self._narrowed(obstacle, (before, gap), (part, near))
                apart = max(apart, 0.8 * near.distance, _LEAST_ADVANCE * length)
                gap = near.distance
            if part >= 1.0:
                return None
            before, part = part, min(1.0, part + apart / max(way, 1e-300))
        return None

    def _narrowed(
        self, obstacle: Obstacle, outside: tuple[float, float], inside: tuple[float, Nearest]
    ) -> tuple[float, Nearest]:
        """The touch between a part of the way outside, with its distance [m], and one inside, by false position."""
        for _ in range(_MOST_HALVINGS):
            (clear, gap), (part, near) = outside, inside
            share = gap / (gap - near.distance)
            if near.distance > -_CLOSE * self.rod.length:
                break
            middle = clear + min(max(share, 0.1), 0.9) * (part - clear)
            found = self.nearest(obstacle.at(middle), obstacle.direction)
            if found.distance > 0.0:
                outside = middle, found.distance
            else:
                inside = middle, found
        return clear + min(share, _WITHIN) * (part - clear), near

    def nearest(self, point: Array, direction: Array | None) -> Nearest:
        """Of a point, or of a line: there by narrowing in about the best of its points beside a station."""
        if direction is None:
            return self._of_points(point[None, :], np.zeros(1))
        j = int(np.argmin(self._from_balls(point, direction)))
        middle = float((self._p[j] - point) @ direction)
        reach = 2.0 * self.rod.length / _STATIONS + 2.0 * float(self._radius[j])
        while True:
            tries = np.linspace(middle - reach, middle + reach, 17)
            best = self._of_points(point + tries[:, None] * direction, tries)
            if reach < _CLOSE * self.rod.length:
                slant = float(direction @ self.equilibrium.tip_tangent)
                return best._replace(flush=abs(slant) < _FLUSH)
            middle, reach = best.way, reach / 8.0

    def _apart(self, point: Array, direction: Array | None) -> float:
        """Less than the distance from the rod: of the balls, less what lies between stations [m]."""
        return float(self._from_balls(point, direction).min()) - 0.6 * self.rod.length / _STATIONS

    def _from_balls(self, point: Array, direction: Array | None) -> Array:
        """Distance from the balls about the axis that fill the rod [m], (k,)."""
        off = point - self._p
        if direction is not None:
            off = off - np.outer(off @ direction, direction)
        distance: Array = np.linalg.norm(off, axis=1) - self._radius
        return distance

    def _of_points(self, points: Array, ways: Array) -> Nearest:
        """The nearest of several points (m, 3): the body about the nearest section taken for straight."""
        s, off = self._feet(points)
        distance, element, at = self._to_outline(s, off)
        j = int(np.argmin(distance))
        return Nearest(float(distance[j]), float(at[j]), bool(element[j]), float(ways[j]))

    def _feet(self, points: Array) -> tuple[Array, Array]:
        """Arclength of each point's nearest place on the axis, straight on at both ends, and its distance."""
        a, along = self._p[:-1], self._along
        size = (along**2).sum(axis=1)
        ahead = points @ along.T - (a * along).sum(axis=1)
        c = ahead / size
        c[:, 1:] = np.maximum(c[:, 1:], 0.0)
        c[:, :-1] = np.minimum(c[:, :-1], 1.0)
        away = (points**2).sum(axis=1)[:, None] - 2.0 * points @ a.T + (a**2).sum(axis=1)
        off = away + c * (c * size - 2.0 * ahead)  # squared; rounds by 1e-16 of the length's square
        past = np.maximum(np.abs(c - 0.5) - 0.5, 0.0)  # so that the ends do not win from afar
        k = np.argmin(off + past**2 * size, axis=1)
        rows = np.arange(len(points))
        s = self._s[k] + c[rows, k] * (self._s[k + 1] - self._s[k])
        return s, np.sqrt(np.maximum(off[rows, k], 0.0))

    def _to_outline(self, s: Array, off: Array) -> tuple[Array, Array, Array]:
        """Signed distance from the outline in the half plane (s, off), whether of the end, and nearest s."""
        corners = self._outline
        a, along = corners[:-1], np.diff(corners, axis=0)
        here = np.stack([s, off], axis=1)[:, None]
        c = np.clip(((here - a) * along).sum(axis=2) / (along**2).sum(axis=1), 0.0, 1.0)
        nearest = a + c[:, :, None] * along
        gaps = np.linalg.norm(here - nearest, axis=2)
        k = np.argmin(gaps, axis=1)
        rows = np.arange(len(s))
        inside = (off < np.interp(s, self.rod.s, self.rod.radius)) & (s < self.rod.length) & (s > 0.0)
        return np.where(inside, -1.0, 1.0) * gaps[rows, k], k == len(a) - 1, nearest[rows, k, 0]

    @cached_property
    def _s(self) -> Array:
        even = np.linspace(0.0, self.rod.length, _STATIONS + 1)
        return np.unique(np.concatenate([even, self.rod.s]))

    @cached_property
    def _p(self) -> Array:
        return self.equilibrium.p_at(self._s)

    @cached_property
    def _along(self) -> Array:
        return np.diff(self._p, axis=0)

    @cached_property
    def _radius(self) -> Array:
        return np.interp(self._s, self.rod.s, self.rod.radius)

    @cached_property
    def _outline(self) -> Array:
        """Corners (s, r) from the base over the flank to the middle of the tip."""
        flank = np.stack([self.rod.s, self.rod.radius], axis=1)
        return np.vstack([flank, [self.rod.length, 0.0]])
