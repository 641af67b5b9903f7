"""A small alphabet of square cells, five high: the same on every machine, and weighed in closed form.

No two cells of a character meet at a corner alone, or its walls would have no thickness there. Small letters are cut
as capitals but for b and d, which as capitals of this size would be taken for 8 and 0.
"""

ROWS = 5

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
GLYPHS = {line[0]: tuple(line[2:].split()) for line in _GLYPHS.strip().splitlines()} | {" ": ("..",) * ROWS}
"""Rows of each character from top to bottom; # is cut."""

Run = tuple[int, int, int]
Loop = tuple[tuple[int, int], ...]


def glyph_of(character: str) -> tuple[str, ...]:
    """Rows of a character; of a small letter without one, of its capital.

    Raises:
        KeyError: there is none.
    """
    return GLYPHS[character] if character in GLYPHS else GLYPHS[character.upper()]


def width_of(character: str) -> int:
    """How many cells wide it is."""
    return len(glyph_of(character)[0])


def runs_of(character: str) -> list[Run]:
    """Its cut cells as horizontal bars: first column, one past the last, row from the bottom."""
    runs = []
    for row, cells in zip(reversed(range(ROWS)), glyph_of(character), strict=True):
        edges = [
            i for i in range(len(cells) + 1) if (cells[i : i + 1] == "#") != (i > 0 and cells[i - 1] == "#")
        ]
        runs += [(start, end, row) for start, end in zip(edges[::2], edges[1::2], strict=True)]
    return runs


def loops_of(character: str) -> list[Loop]:
    """The edges of its cut cells as closed polygons: outer ones counter-clockwise, islands clockwise."""
    cells = {(x, row) for start, end, row in runs_of(character) for x in range(start, end)}
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
        loops.append(_corners(loop[:-1]))
    return loops


def _corners(loop: list[tuple[int, int]]) -> Loop:
    """A loop without the points that lie straight between their neighbours."""
    around = zip([loop[-1], *loop[:-1]], loop, [*loop[1:], loop[0]], strict=True)
    return tuple(b for a, b, c in around if a[0] != c[0] and a[1] != c[1])
