"""What is cut into the parts so that they can be told apart: where each character stands, and what it takes away."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from probedesign.frames import Array, pose, rotation_z
from probedesign.mass import MassProperties, combined
from probedesign.mounting.glyphs import GLYPHS, ROWS, loops_of, runs_of, width_of
from probedesign.mounting.prism import Point, prism
from probedesign.units import MM

CELL = 0.5 * MM
"""Width of a stroke and of the wall between two: the narrowest that reads in Elastic 50A (assumed)."""
DEPTH = 0.4 * MM
"""Four layers of Elastic 50A; no deeper than wide, so that resin is washed out (assumed)."""
HEIGHT = ROWS * CELL

Arc = tuple[float, float]


@dataclass(frozen=True)
class Engraving:
    """Characters cut into a face that looks up, their tops away from the axis.

    Attributes:
        text: what is cut, as it was given.
        radius: of the middle of the characters [m].
        azimuths: of each character's middle [rad], (n,).
        top: z of the face [m].
    """

    text: str
    radius: float
    azimuths: tuple[float, ...]
    top: float

    def mass(self, density: float) -> MassProperties:
        """Of what is cut away, as if it were of that density [kg/m³]."""
        letters = []
        for character, azimuth in zip(self.text, self.azimuths, strict=True):
            bars = [_bar(run, width_of(character), density) for run in runs_of(character)]
            letters.append(combined(bars).moved(self._placed(azimuth)))
        return combined(letters)

    def outlines(self) -> Iterator[list[list[Point]]]:
        """Polygons (x, y) [m] of each character, islands among them."""
        for character, azimuth in zip(self.text, self.azimuths, strict=True):
            T, width = self._placed(azimuth), width_of(character)
            loops = [np.array(loop) - [width / 2, ROWS / 2] for loop in loops_of(character)]
            yield [[tuple(p) for p in CELL * loop @ T[:2, :2].T + T[:2, 3]] for loop in loops]

    def _placed(self, azimuth: float) -> Array:
        """Pose of a character whose own y axis points up, as one that looks along the axis reads it."""
        p = [self.radius * np.cos(azimuth), self.radius * np.sin(azimuth), self.top]
        return pose(rotation_z(azimuth - np.pi / 2), p)


def engrave(fingerprint: str, name: str, radius: float, top: float, arcs: Sequence[Arc]) -> Engraving:
    """The fingerprint and, after a gap, as much of the name as there is room for, clockwise as seen from above.

    Args:
        fingerprint: cut whole, or nothing is cut at all.
        name: cut as far as it goes; characters that the alphabet lacks are left out.
        radius: of the middle of the characters [m].
        top: z of the face [m].
        arcs: free stretches of the circle, each from a higher to a lower azimuth [rad], in order.
    """
    text = fingerprint + (f" {name}" if name else "")
    text = "".join(c for c in text if c in GLYPHS or c.upper() in GLYPHS)
    azimuths: list[float] = []
    inner = radius - HEIGHT / 2
    for start, end in arcs:
        at = start
        for character in text[len(azimuths) :]:
            wide = width_of(character) * CELL / inner
            if at - wide < end:
                break
            azimuths.append(at - wide / 2)
            at -= wide + CELL / inner
    fits = text[: len(azimuths)].rstrip() if len(azimuths) >= len(fingerprint) else ""
    return Engraving(fits, radius, tuple(azimuths[: len(fits)]), top)


def between(radius: float, azimuths: Sequence[float], clear: float) -> list[Arc]:
    """The arcs of a circle clockwise from each azimuth [rad] to the next, keeping `clear` [m] from both."""
    margin = 2.0 * np.arcsin(clear / 2.0 / radius)
    ordered = sorted(azimuths, reverse=True)
    ends = [*ordered[1:], ordered[0] - 2 * np.pi]
    return [(start - margin, end + margin) for start, end in zip(ordered, ends, strict=True)]


def _bar(run: tuple[int, int, int], width: int, density: float) -> MassProperties:
    start, end, row = run
    a, b = (end - start) * CELL, CELL
    p = ((start + end - width) / 2 * CELL, (row + 0.5 - ROWS / 2) * CELL)
    return prism(a * b, a * b**3 / 12, a**3 * b / 12, (-DEPTH, 0.0), density, p)
