"""Engraved fingerprint and name of a part: the alphabet, and where each character is cut.

The alphabet is made of square cells, five high: it is identical on every machine and its volume has a closed form. No
two cells of a character meet at a corner alone, because the wall there would have no thickness. Lower-case letters are
cut as capitals except b and d, whose capitals would be misread as 8 and 0 at this size.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from probedesign.core.frames import Array, pose, rotation_z
from probedesign.core.units import MM

XY = tuple[float, float]  #: A point (x, y) [m].
ROWS = 5
#: Width of a stroke and of the wall between two strokes: the narrowest that is legible in Elastic 50A (assumed).
CELL = 0.5 * MM
#: Four layers of Elastic 50A; not deeper than wide, so that uncured resin can be washed out (assumed).
DEPTH = 0.4 * MM
HEIGHT = ROWS * CELL

_GLYPHS = """
0 ### #.# #.# #.# ###
1 ##. .#. .#. .#. ###
2 ### ..# ### #.. ###
3 ### ..# ### ..# ###
4 #.# #.# ### ..# ..#
5 ### #.. ### ..# ###
6 ### #.. ### #.# ###
7 ### ..# ..# ..# ..#
8 ### #.# ### #.# ###
9 ### #.# ### ..# ###
A ### #.# ### #.# #.#
B ###. #.## ###. #.## ###.
C ### #.. #.. #.. ###
D ###. #.## #..# #.## ###.
E ### #.. ### #.. ###
F ### #.. ### #.. #..
G #### #... #.## #..# ####
H #.# #.# ### #.# #.#
I ### .#. .#. .#. ###
J ..# ..# ..# #.# ###
K #..# #.## ###. #.## #..#
L #.. #.. #.. #.. ###
M #...# ##.## ##### #.#.# #...#
N #..# ##.# #### #.## #..#
O #### #..# #..# #..# ####
P ### #.# ### #.. #..
Q #### #..# #..# #.## ####
R ###. #.## ###. #.## #..#
S .### ##.. .##. ..## ###.
T ### .#. .#. .#. .#.
U #.# #.# #.# #.# ###
V #.# #.# #.# ### .#.
W #...# #.#.# ##### ##.## #...#
X #.# ### .#. ### #.#
Y #.# ### .#. .#. .#.
Z #### ..## .##. ##.. ####
b #.. #.. ### #.# ###
d ..# ..# ### #.# ###
- .. .. ## .. ..
_ ... ... ... ... ###
. . . . . #
"""
_DRAWN = {line[0]: tuple(line[2:].split()) for line in _GLYPHS.strip().splitlines()} | {" ": ("..",) * ROWS}
#: Rows of each character from top to bottom; # is cut. Lower-case letters without a glyph take that of their capital.
GLYPHS = {character.lower(): rows for character, rows in _DRAWN.items()} | _DRAWN

Run = tuple[int, int, int]
Loop = tuple[tuple[int, int], ...]
Arc = tuple[float, float]


def glyph_width(character: str) -> int:
    """Return the width of a character in cells."""
    return len(GLYPHS[character][0])


def cut_runs(character: str) -> list[Run]:
    """Return the cut cells as horizontal bars: first column, one past the last column, row from the bottom."""
    runs = []
    for row, cells in zip(reversed(range(ROWS)), GLYPHS[character], strict=True):
        edges = [i for i in range(len(cells) + 1) if (cells[i : i + 1] == "#") != (i > 0 and cells[i - 1] == "#")]
        runs += [(start, end, row) for start, end in zip(edges[::2], edges[1::2], strict=True)]
    return runs


def cut_outlines(character: str) -> list[Loop]:
    """Return the boundary of the cut cells as closed polygons: outer ones counter-clockwise, islands clockwise."""
    cells = {(x, row) for start, end, row in cut_runs(character) for x in range(start, end)}
    ahead = {}
    for x, y in cells:
        for start, end, beyond in (
            ((x, y), (x + 1, y), (x, y - 1)),
            ((x + 1, y), (x + 1, y + 1), (x + 1, y)),
            ((x + 1, y + 1), (x, y + 1), (x, y + 1)),
            ((x, y + 1), (x, y), (x - 1, y)),
        ):
            if beyond not in cells:
                ahead[start] = end
    loops = []
    while ahead:
        loop = [min(ahead)]
        while loop[-1] in ahead:
            loop.append(ahead.pop(loop[-1]))
        around = zip([loop[-2], *loop[:-2]], loop[:-1], loop[1:], strict=True)
        loops.append(tuple(b for a, b, c in around if a[0] != c[0] and a[1] != c[1]))  # the corners
    return loops


@dataclass(frozen=True)
class Engraving:
    """Characters cut into an upward face, their tops away from the axis, or into the side of a disc, upright."""

    text: str  #: the characters that are cut.
    radius: float  #: distance of the characters' centres from the axis [m].
    azimuths: tuple[float, ...]  #: of each character's centre [rad], (n,).
    top: float  #: z of the face, or of the characters' centres on a side [m].
    on_side: bool = False  #: whether the face is the side of a disc of that radius.

    def placed(self) -> Iterator[tuple[str, Array]]:
        """Yield each character with the pose (4, 4) of its own frame, whose y axis points to the character's top."""
        for character, azimuth in zip(self.text, self.azimuths, strict=True):
            p = [self.radius * np.cos(azimuth), self.radius * np.sin(azimuth), self.top]
            upright = pose([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])[:3, :3]  # z of the character outwards
            turn = rotation_z(azimuth) @ upright if self.on_side else rotation_z(azimuth - np.pi / 2)
            yield character, pose(turn, p)


NOTHING_CUT = Engraving("", 0.0, (), 0.0)  #: No engraving.


def engrave(fingerprint: str, name: str, radius: float, top: float, arcs: Sequence[Arc]) -> Engraving:
    """Fit the fingerprint and, after a gap, the beginning of the name, clockwise as seen from above.

    Args:
        fingerprint: cut whole; where it does not fit, nothing is cut.
        name: cut as far as it fits; characters outside the alphabet are left out.
        radius: distance of the characters' centres from the axis [m].
        top: z of the face [m].
        arcs: free stretches of the circle, each from a higher to a lower azimuth [rad], in order.
    """
    text = fingerprint + (f" {name}" if name else "")
    text = "".join(c for c in text if c in GLYPHS)
    azimuths: list[float] = []
    inner = radius - HEIGHT / 2
    for start, end in arcs:
        at = start
        for character in text[len(azimuths) :]:
            wide = glyph_width(character) * CELL / inner
            if at - wide < end:
                break
            azimuths.append(at - wide / 2)
            at -= wide + CELL / inner
    fits = text[: len(azimuths)].rstrip() if len(azimuths) >= len(fingerprint) else ""
    return Engraving(fits, radius, tuple(azimuths[: len(fits)]), top)


def free_arcs(radius: float, azimuths: Sequence[float], clearances: Sequence[float]) -> list[Arc]:
    """Return the arcs of a circle clockwise from each azimuth [rad] to the next, clear of the obstacles at both ends.

    Args:
        radius: of the circle [m].
        azimuths: of the obstacles [rad].
        clearances: from each obstacle [m].
    """
    margins = 2.0 * np.arcsin(np.asarray(clearances) / 2.0 / radius)
    around = sorted(((a % (2 * np.pi), float(m)) for a, m in zip(azimuths, margins, strict=True)), reverse=True)
    ahead = [*around[1:], (around[0][0] - 2 * np.pi, around[0][1])]
    return [(a - m, b + n) for (a, m), (b, n) in zip(around, ahead, strict=True)]
