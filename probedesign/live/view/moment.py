"""What there is to see at one moment, as plain numbers that may go to another process."""

from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np

from probedesign.frames import Array

Mood = Literal["good", "fair", "bad", "plain"]


class Said(NamedTuple):
    """One thing in words.

    Attributes:
        name: what it is about.
        text: what there is to say.
        mood: how it is.
    """

    name: str
    text: str
    mood: Mood = "plain"


def _nan(*shape: int) -> Array:
    return np.full(shape, np.nan)


@dataclass(frozen=True)
class Shape:
    """The bent centreline at the nodes of its solve.

    Attributes:
        s: arclengths, base to tip [m], (k,).
        p_base: points [m], (k, 3).
        R_base: sections, their columns x, y and tangent, (k, 3, 3).
    """

    s: Array
    p_base: Array
    R_base: Array


@dataclass(frozen=True)
class Place:
    """A contact that was located.

    Attributes:
        p_surface: the touched point [m], (3,).
        cov: its covariance [m²], (3, 3).
        force: what the object does to the probe [N], (3,).
        s, std_s: arclength and its standard deviation [m].
        in_world: whether all this is told in the world; else in the base frame.
        time: of the source [s].
        number: of the touch, from one.
        friction_ratio: tangential over normal force; NaN where it is not known.
    """

    p_surface: Array
    cov: Array
    force: Array
    s: float
    std_s: float
    in_world: bool
    time: float
    number: int
    friction_ratio: float = float("nan")


STRIP = ("time", "Fx", "Fy", "Fz", "Mx", "My", "Mz", "s", "std_s", "force")
"""What a row of a strip holds: [s], [N], [N·m], [m], [N]."""


@dataclass(frozen=True)
class Moment:
    """One moment.

    Attributes:
        since: of the last answer, from the first on [s].
        result: of the last answer; empty before the first.
        old: whether what is known of probe and contact is not of now: stale, or too long without an answer.
        words: everything in words.
        shape: of the probe, where the answer tells one.
        place: the contact, where the answer is sure of it.
        touches: the surest place of each touch so far, the last ones.
        T_world_base: pose of the base, (4, 4); NaN if it is not known.
        gravity_base: [m/s²], (3,).
        strip: what came since the last moment, rows of `STRIP`, (j, 10).
        events: what was told last, with the source's time [s].
    """

    since: float = 0.0
    result: str = ""
    old: bool = False
    words: tuple[Said, ...] = ()
    shape: Shape | None = None
    place: Place | None = None
    touches: tuple[Place, ...] = ()
    T_world_base: Array = field(default_factory=lambda: _nan(4, 4))
    gravity_base: Array = field(default_factory=lambda: np.array([0.0, 0.0, -9.81]))
    strip: Array = field(default_factory=lambda: np.empty((0, len(STRIP))))
    events: tuple[tuple[float, str], ...] = ()
