"""A house of cards in the world: the front edges of its cards, which a probe that reaches into it touches.

Seen from the front, x to the right and z up; the probe comes along y and passes beside a card, under it or within a
tent. The cards lie behind the plane y = 0, their front edges in it. A tapered probe that is pushed onto a card meets
the card's front edge first and bends away from the card behind it.
"""

import math
from dataclasses import dataclass

import numpy as np

from probedesign.frames import Array

CARD = (63.5e-3, 88.9e-3)
"""A card of poker size, 2.5 by 3.5 inches: into the house and across it [m]; its thickness is left out."""
LEAN = math.radians(15.0)
"""Of a card from the vertical. Assumed: such tents stand."""
RIDGE = 30e-3
"""Of a lower tent from the middle of the house [m]. Assumed."""
SOURCE = "card house"
"""What a rehearsal's recording says that it was read from: by that it is known."""


@dataclass(frozen=True)
class Card:
    """One card.

    Attributes:
        name: of it.
        start, end: of its front edge [m], (3,).
        normal: of one of its sides, across y, unit, (3,).
    """

    name: str
    start: Array
    end: Array
    normal: Array

    @property
    def along(self) -> Array:
        """Of its front edge, unit, (3,)."""
        way = self.end - self.start
        return np.asarray(way / np.linalg.norm(way))

    @property
    def corners(self) -> Array:
        """In order round it [m], (4, 3)."""
        depth = np.array([0.0, CARD[0], 0.0])
        return np.array([self.start, self.end, self.end + depth, self.start + depth])


@dataclass(frozen=True)
class Spot:
    """A point of a front edge to be touched.

    Attributes:
        card: whose.
        p_world: of it [m], (3,).
        towards: way of the probe onto the card, unit, (3,).
        fraction: where along the probe, of its length.
        again: whether it was touched before.
    """

    card: Card
    p_world: Array
    towards: Array
    fraction: float
    again: bool = False


def _card(name: str, start: tuple[float, float], end: tuple[float, float]) -> Card:
    a, b = (np.array([x, 0.0, z]) for x, z in (start, end))
    along = (b - a) / np.linalg.norm(b - a)
    return Card(name, a, b, np.cross(along, (0.0, 1.0, 0.0)))


def _tent(name: str, ridge: float, foot: float) -> list[Card]:
    wide, high = CARD[1] * math.sin(LEAN), CARD[1] * math.cos(LEAN)
    top = (ridge, foot + high)
    return [
        _card(f"{name}, left", (ridge - wide, foot), top),
        _card(f"{name}, right", (ridge + wide, foot), top),
    ]


def card_house() -> tuple[Card, ...]:
    """Two tents, a card across both, a tent on that."""
    floor = CARD[1] * math.cos(LEAN)
    across = _card("roof", (-0.5 * CARD[1], floor), (0.5 * CARD[1], floor))
    return (*_tent("left tent", -RIDGE, 0.0), *_tent("right tent", RIDGE, 0.0), across,
            *_tent("upper tent", 0.0, floor))  # fmt: skip


def true_outlines(source: str) -> tuple[Array, ...]:
    """What was touched in a recording, where that is known: in a rehearsal.

    Args:
        source: that the recording says it was read from.

    Returns:
        The cards' corners [m], (4, 3) each, their front edges first; nothing of any other recording.
    """
    return tuple(card.corners for card in card_house()) if source == SOURCE else ()


_HEIGHTS = {
    "left tent, left": ((20, 45, 70), (32, 57)),
    "left tent, right": ((25, 50), (37,)),
    "right tent, left": ((30, 60), (45,)),
    "right tent, right": ((20, 45, 70), (33,)),
    "upper tent, left": ((20, 45, 70), (33,)),
    "upper tent, right": ((25, 55), (40,)),
}
"""Heights over the card's foot at which it is touched from outside and from within its tent [mm]."""
_ROOF = (-20.0, 0.0, 20.0)
"""Places across the house where the roof is touched from below [mm]."""
NEAREST, FARTHEST = 0.50, 0.95
"""Fractions of the length that touch: the distal half."""
AGAIN = 5
"""Spots that are touched twice, from another depth."""


def spots() -> tuple[Spot, ...]:
    """All of them in the order of touching: 25 points, five of them once more at another fraction of the probe."""
    found = []
    for card in card_house():
        middle = np.array([0.5 * (card.start[0] + card.end[0]), 0.0, card.start[2]])
        if card.name == "roof":
            found += [(card, np.array([1e-3 * x, 0.0, middle[2]]), np.array([0.0, 0.0, 1.0])) for x in _ROOF]
            continue
        rise = card.along / card.along[2]
        outward = (
            card.normal if card.normal[2] > 0.0 else -card.normal
        )  # a leaning card's outer side looks up
        for heights, towards in zip(_HEIGHTS[card.name], (-outward, outward), strict=True):
            found += [(card, card.start + 1e-3 * height * rise, towards) for height in heights]
    n = len(found)
    # Neighbours on a card get fractions far apart: 7 has no divisor in common with 25.
    fractions = [NEAREST + (FARTHEST - NEAREST) * (7 * i % n) / (n - 1) for i in range(n)]
    first = [Spot(*one, fraction) for one, fraction in zip(found, fractions, strict=True)]
    more = [first[i] for i in range(0, n, n // AGAIN)][:AGAIN]
    other = NEAREST + FARTHEST
    return (*first, *(Spot(s.card, s.p_world, s.towards, other - s.fraction, True) for s in more))
