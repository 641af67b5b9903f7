"""The axis of a probe: the curvature of its undeformed centreline over arclength, in section axes without twist."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from probedesign.core.errors import InputError
from probedesign.core.frames import Array

#: Knots of a turn of the plane of bending: the linear curvature between them moves a tip at 150 mm by less than 5 µm.
_KNOTS_PER_TURN = 20
_STEPS = 128  #: Fewest steps of the integration; its error is below 0.01 µm for two turns of a radius of 30 mm.
#: Smallest radius of curvature over the probe's own radius. The bending stiffness of a rod, which neglects (r/R)²
#: beside 1, is 6 % off there (Winkler's curved beam).
MIN_RADIUS_RATIO = 2.0


def _exponential(xi: Array) -> Array:
    """Return the poses exp ξ of screws in se(3), (k, 4, 4) both.

    With θ the angle of the rotation part Ω: R = I + a Ω + b Ω², p = (I + b Ω + c Ω²) v, a = sin θ/θ,
    b = (1 - cos θ)/θ², c = (θ - sin θ)/θ³, which is a series up to θ⁶ for small angles.
    """
    omega, v = xi[:, :3, :3], xi[:, :3, 3:]
    theta = np.sqrt(0.5 * (omega**2).sum(axis=(1, 2)))
    square, safe = theta**2, np.maximum(theta, 0.1)
    series = 1.0 / 6.0 - square / 120.0 * (1.0 - square / 42.0 * (1.0 - square / 72.0))
    c = np.where(theta < 0.1, series, (safe - np.sin(safe)) / safe**3)
    a, b = np.sinc(theta / np.pi), 0.5 * np.sinc(theta / (2.0 * np.pi)) ** 2
    a, b, c = (factor[:, None, None] for factor in (a, b, c))
    T = np.tile(np.eye(4), (len(xi), 1, 1))
    T[:, :3, :3] += a * omega + b * omega @ omega
    T[:, :3, 3:] = v + b * omega @ v + c * omega @ (omega @ v)
    return T


@dataclass(frozen=True)
class Axis:
    """The undeformed centreline, dt/ds = κ_x X + κ_y Y, with X and Y carried along it without twist.

    It starts at the base's origin along z, where X and Y are the axes x and y of the base frame.
    """

    s: Array  #: knots, 0 ... length [m], (K,), increasing.
    curvature: Array  #: towards X and Y at the knots, linear between them [1/m], (K, 2).

    def __post_init__(self) -> None:
        s, shape = self.s, (len(self.s), 2)
        if not (
            s.ndim == 1 and len(s) >= 2 and s[0] == 0.0 and (np.diff(s) > 0.0).all() and self.curvature.shape == shape
        ):
            raise InputError("axis: s must increase from 0, with two curvatures at each knot")

    @classmethod
    def helix(cls, length: float, bend: float, turns: float = 0.0, azimuth: float = 0.0) -> "Axis":
        """Return an axis of constant curvature κ = bend/length, whose plane of bending turns; an arc without turns.

        κ_x + i κ_y = κ exp(i (azimuth + 2π turns s/length)). The knots' values are larger by (x/sin x)², with 2x the
        turn between two knots, so that the linear interpolation has this exact first harmonic.

        Args:
            length: of the axis [m].
            bend: total bending angle, curvature times length [rad].
            turns: of the plane of bending from base to tip; either sign.
            azimuth: of the plane of bending at the base, from x towards y [rad].
        """
        count = max(math.ceil(_KNOTS_PER_TURN * abs(turns)), 4 if turns else 1)
        s = np.linspace(0.0, length, count + 1)
        half = math.pi * turns / count
        size = bend / length * (half / math.sin(half)) ** 2 if half else bend / length
        angle = azimuth + 2.0 * math.pi * turns * s / length
        return cls(s, size * np.stack([np.cos(angle), np.sin(angle)], axis=1))

    @property
    def is_straight(self) -> bool:
        """Return whether there is no curvature."""
        return not self.curvature.any()

    @property
    def is_arc(self) -> bool:
        """Return whether the curvature is the same all along, zero included."""
        return not np.ptp(self.curvature, axis=0).any()

    @property
    def length(self) -> float:
        """Return the length [m]."""
        return float(self.s[-1])

    def curvature_at(self, s: ArrayLike) -> Array:
        """Return the curvature towards X and Y [1/m] at arclengths s [m], (k, 2)."""
        return np.stack([np.interp(np.asarray(s, dtype=float), self.s, column) for column in self.curvature.T], axis=-1)

    def rest_curvature(self, s: ArrayLike) -> Array:
        """Return the curvature about X and Y, and the twist [1/m], at arclengths s [m], (k, 3): (-κ_y, κ_x, 0)."""
        towards_x, towards_y = self.curvature_at(s).T
        return np.stack([-towards_y, towards_x, np.zeros(len(towards_x))], axis=1)

    def with_curvature(self, curvature: ArrayLike) -> "Axis":
        """Return the axis with a constant curvature towards X and Y [1/m], (2,), added."""
        return Axis(self.s, self.curvature + np.asarray(curvature, dtype=float))

    def scaled(self, factor: float) -> "Axis":
        """Return the axis with all curvature times a factor."""
        return Axis(self.s, factor * self.curvature)

    def tip_by_factor(self) -> float:
        """Return by how much the tip moves where all curvature is larger, over the relative change [m]."""
        tips = [self.scaled(factor).frames(self.s[-1:])[0, :3, 3] for factor in (0.99, 1.01)]
        return float(np.linalg.norm(tips[1] - tips[0])) / 0.02

    def frames(self, s: ArrayLike) -> Array:
        """Return the undeformed sections as T_base_section, with X, Y and the tangent as axes [m], (k, 4, 4).

        Args:
            s: arclengths [m], (k,).

        Source: Magnus' series of fourth order for T' = T ξ in SE(3), with two Gauss points a step.
        """
        wanted = np.asarray(s, dtype=float)
        grid = np.unique(np.concatenate([np.linspace(0.0, self.length, _STEPS + 1), self.s, wanted]))
        if self.is_straight:
            T = np.tile(np.eye(4), (len(wanted), 1, 1))
            T[:, 2, 3] = wanted
            return T
        h = np.diff(grid)
        gauss = h * (0.5 - math.sqrt(3.0) / 6.0)
        first, second = self._generators(grid[:-1] + gauss), self._generators(grid[1:] - gauss)
        h = h[:, None, None]
        steps = _exponential(
            h / 2.0 * (first + second) + math.sqrt(3.0) / 12.0 * h * h * (first @ second - second @ first)
        )
        T = np.empty((len(grid), 4, 4))
        T[0] = np.eye(4)
        for i, step in enumerate(steps):
            T[i + 1] = T[i] @ step
        return np.asarray(T[np.searchsorted(grid, wanted)])

    def _generators(self, s: Array) -> Array:
        """Return ξ of T' = T ξ at arclengths s, (k, 4, 4)."""
        x, y, _ = self.rest_curvature(s).T
        xi = np.zeros((len(s), 4, 4))
        xi[:, 0, 2], xi[:, 2, 0] = y, -y
        xi[:, 2, 1], xi[:, 1, 2] = x, -x
        xi[:, 2, 3] = 1.0
        return xi

    def conflict(self, s: Array, radius: Array) -> str:
        """Return why a body of these radii cannot follow the axis; empty if it can.

        Args:
            s, radius: of the body at its knots, linear between them [m].
        """
        at = np.unique(np.concatenate([np.linspace(0.0, self.length, 201), self.s, s]))
        r = np.interp(at, s, radius)
        ratio = np.linalg.norm(self.curvature_at(at), axis=1) * r * MIN_RADIUS_RATIO
        if ratio.max() > 1.0:
            i = int(ratio.argmax())
            bent, smallest = 1e3 * MIN_RADIUS_RATIO * r[i] / ratio[i], 1e3 * MIN_RADIUS_RATIO * r[i]
            return f"has a radius of curvature of {bent:.3g} mm at s = {1e3 * at[i]:.3g} mm; at least {smallest:.3g} mm"
        T = self.frames(at)
        p, t_z = T[:, :3, 3], T[:, 2, 2]
        low = p[:, 2] - r * np.sqrt(np.maximum(1.0 - t_z**2, 0.0))
        if low.min() < -1e-9:
            i = int(low.argmin())
            return f"returns into the mount: {-1e3 * low[i]:.3g} mm below the flange's top at s = {1e3 * at[i]:.3g} mm"
        apart = np.linalg.norm(p[:, None] - p[None], axis=2) - (r[:, None] + r[None])
        # Sections nearer along the axis than this cannot meet: their chord is longer at the smallest radius.
        apart[np.abs(at[:, None] - at[None]) < np.pi * np.maximum(r[:, None], r[None])] = np.inf
        if apart.min() < 0.0:
            i, j = divmod(int(apart.argmin()), len(at))
            return f"makes the probe meet itself at s = {1e3 * at[i]:.3g} and {1e3 * at[j]:.3g} mm"
        return ""
