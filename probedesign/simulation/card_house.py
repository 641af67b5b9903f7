"""A house of cards in the world frame, and the targets on its front edges that a mapping run touches.

Seen from the front, x points to the right and z up; the probe comes along y and passes beside a card, under it or
within a tent. The cards lie behind the plane y = 0, their front edges in it. A tapered probe that is pushed onto a card
meets the front edge first and bends away from the card behind it.
"""

import math
from dataclasses import dataclass

import numpy as np

from probedesign.core.frames import Array

CARD = (63.5e-3, 88.9e-3)
"""Size of a poker card, 2.5 by 3.5 inches: depth and width in the house [m]; its thickness is neglected."""
LEAN = math.radians(15.0)
"""Angle of a card of a tent from the vertical [rad]; assumed, such tents are stable."""
RIDGE = 30e-3
"""Distance of the ridge of a lower tent from the middle of the house [m]; assumed."""
SOURCE = "card house"
"""Source stated in the recording of a simulated run, by which it is recognised."""


@dataclass(frozen=True)
class Card:
    """A card of the house.

    Attributes:
        name: its name.
        start, end: ends of its front edge [m], (3,).
        normal: unit normal of one of its sides, perpendicular to y, (3,).
    """

    name: str
    start: Array
    end: Array
    normal: Array

    @property
    def along(self) -> Array:
        """Direction of its front edge, unit vector, (3,)."""
        edge = self.end - self.start
        return np.asarray(edge / np.linalg.norm(edge))

    @property
    def corners(self) -> Array:
        """Corners in order around the card, the front edge first [m], (4, 3)."""
        depth = np.array([0.0, CARD[0], 0.0])
        return np.array([self.start, self.end, self.end + depth, self.start + depth])


@dataclass(frozen=True)
class TouchTarget:
    """A point of a front edge to be touched.

    Attributes:
        card: the touched card.
        p_world: the point [m], (3,).
        direction: direction of the push onto the card, unit vector, (3,).
        fraction: place along the probe, as a fraction of its length.
        repeated: whether the point is touched for the second time.
    """

    card: Card
    p_world: Array
    direction: Array
    fraction: float
    repeated: bool = False


def _card(name: str, start: tuple[float, float], end: tuple[float, float]) -> Card:
    a, b = (np.array([x, 0.0, z]) for x, z in (start, end))
    along = (b - a) / np.linalg.norm(b - a)
    return Card(name, a, b, np.cross(along, (0.0, 1.0, 0.0)))


def _tent(name: str, ridge: float, foot: float) -> list[Card]:
    half_width, height = CARD[1] * math.sin(LEAN), CARD[1] * math.cos(LEAN)
    top = (ridge, foot + height)
    return [
        _card(f"{name}, left", (ridge - half_width, foot), top),
        _card(f"{name}, right", (ridge + half_width, foot), top),
    ]


def card_house() -> tuple[Card, ...]:
    """Return the cards: two tents, a card across both, a tent on top of it."""
    floor = CARD[1] * math.cos(LEAN)
    across = _card("roof", (-0.5 * CARD[1], floor), (0.5 * CARD[1], floor))
    return (*_tent("left tent", -RIDGE, 0.0), *_tent("right tent", RIDGE, 0.0), across,
            *_tent("upper tent", 0.0, floor))  # fmt: skip


def true_outlines(source: str) -> tuple[Array, ...]:
    """Return the outlines of the objects touched in a recording, if it is that of a simulated run.

    Args:
        source: source that the recording states.

    Returns:
        The corners of the cards [m], (4, 3) each, front edges first; empty for any other recording.
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
"""Heights above the foot of a card at which it is touched from outside and from within its tent [mm]."""
_ROOF_X = (-20.0, 0.0, 20.0)
"""Places where the roof is touched from below [mm]."""
MIN_FRACTION, MAX_FRACTION = 0.50, 0.95
"""Range of fractions of the length that touch: the distal half."""
N_REPEATED = 5
"""Number of targets that are touched twice, from another depth."""


def touch_targets() -> tuple[TouchTarget, ...]:
    """Return the targets in touching order: 25 points, then five of them again at another fraction of the length."""
    found = []
    for card in card_house():
        middle = np.array([0.5 * (card.start[0] + card.end[0]), 0.0, card.start[2]])
        if card.name == "roof":
            found += [
                (card, np.array([1e-3 * x, 0.0, middle[2]]), np.array([0.0, 0.0, 1.0])) for x in _ROOF_X
            ]
            continue
        rise = card.along / card.along[2]
        # The outer side of a leaning card faces upwards.
        outward = card.normal if card.normal[2] > 0.0 else -card.normal
        for heights, direction in zip(_HEIGHTS[card.name], (-outward, outward), strict=True):
            found += [(card, card.start + 1e-3 * height * rise, direction) for height in heights]
    n = len(found)
    # Neighbours on a card get fractions far apart: 7 and 25 have no common divisor.
    fractions = [MIN_FRACTION + (MAX_FRACTION - MIN_FRACTION) * (7 * i % n) / (n - 1) for i in range(n)]
    first = [TouchTarget(*one, fraction) for one, fraction in zip(found, fractions, strict=True)]
    again = [first[i] for i in range(0, n, n // N_REPEATED)][:N_REPEATED]
    total = MIN_FRACTION + MAX_FRACTION
    return (
        *first,
        *(TouchTarget(t.card, t.p_world, t.direction, total - t.fraction, True) for t in again),
    )
