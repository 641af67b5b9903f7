"""The probe's skin: a smooth closed mesh around a bent centreline."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from probedesign.frames import Array
from probedesign.live.view.moment import Shape

STATIONS, AROUND = 72, 36


@dataclass(frozen=True)
class Tube:
    """A round or flattened body of varying width, by arclength.

    Attributes:
        s: knots [m], (k,).
        radius: half-width along the section's x there, linear between [m], (k,).
        flatness: half-width along y over that along x.
    """

    s: Array
    radius: Array
    flatness: float = 1.0

    @cached_property
    def stations(self) -> Array:
        """Arclengths of the rings [m]: evenly along the probe, and wherever its width bends."""
        even = np.linspace(self.s[0], self.s[-1], STATIONS)
        knots = self.s if len(self.s) <= STATIONS else self.s[:: len(self.s) // STATIONS]
        found: Array = np.unique(np.concatenate([even, knots, self.s[-1:]]))
        return found

    @cached_property
    def faces(self) -> Array:
        """Triangles, seen from outside anticlockwise, (j, 3): the rings, then a cap at either end."""
        rings, ring = len(self.stations), np.arange(AROUND)
        after = (ring + 1) % AROUND
        first = AROUND * np.arange(rings - 1)[:, None]
        a, b = first + ring, first + after
        side = np.stack([a, b, b + AROUND, a, b + AROUND, a + AROUND], axis=-1).reshape(-1, 3)
        base = rings * AROUND  # the caps have rims of their own, so that their edge stays sharp
        tip = base + AROUND + 1
        caps = [
            np.stack([base + after, base + ring, np.full(AROUND, base + AROUND)], axis=1),
            np.stack([tip + ring, tip + after, np.full(AROUND, tip + AROUND)], axis=1),
        ]
        return np.concatenate([side, *caps]).astype(np.uint32)

    def vertices(self, shape: Shape) -> Array:
        """Points of the skin [m], (i, 3), in base axes."""
        p, x, y = centreline(shape, self.stations)
        angle = np.linspace(0.0, 2.0 * np.pi, AROUND, endpoint=False)
        round_x, round_y = np.cos(angle)[:, None], self.flatness * np.sin(angle)[:, None]
        radius = np.interp(self.stations, self.s, self.radius)[:, None, None]
        rings = p[:, None] + radius * (round_x * x[:, None] + round_y * y[:, None])
        caps = [np.vstack([rings[end], p[end]]) for end in (0, -1)]
        found: Array = np.concatenate([rings.reshape(-1, 3), *caps])
        return found


def centreline(shape: Shape, s: Array) -> tuple[Array, Array, Array]:
    """Points and the section's x and y axes at arclengths s, each (k, 3).

    Cubic between the nodes of the solve, by their tangents; the rod's stretch, some thousandths, is left out of
    these, so that it is a picture and no measure.
    """
    i = np.clip(np.searchsorted(shape.s, s, side="right") - 1, 0, len(shape.s) - 2)
    step = shape.s[i + 1] - shape.s[i]
    t = ((s - shape.s[i]) / step)[:, None]
    p0, p1 = shape.p_base[i], shape.p_base[i + 1]
    m0, m1 = (step[:, None] * shape.R_base[j][:, :, 2] for j in (i, i + 1))
    p = (
        (1 + 2 * t) * (1 - t) ** 2 * p0
        + t * (1 - t) ** 2 * m0
        + t**2 * (3 - 2 * t) * p1
        + t**2 * (t - 1) * m1
    )
    slope = 6 * t * (1 - t) * (p1 - p0) + (1 - t) * (1 - 3 * t) * m0 + t * (3 * t - 2) * m1
    tangent = slope / np.linalg.norm(slope, axis=1, keepdims=True)
    x = (1 - t) * shape.R_base[i][:, :, 0] + t * shape.R_base[i + 1][:, :, 0]
    x = x - np.sum(x * tangent, axis=1, keepdims=True) * tangent
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    return p, x, np.cross(tangent, x)
