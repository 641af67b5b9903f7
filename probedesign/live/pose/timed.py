"""One pose of the base at one moment, and what lies between two of them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from probedesign.errors import InputError
from probedesign.frames import Array, pose

UNIT = 1e-3
"""How far from one the length of a rotation's quaternion may be: it may have been printed with four digits."""
FURTHEST = 100.0
"""No base is further from its world's origin [m]: it is a wrong unit."""
LATEST = 1e11
"""No clock tells more [s], as for recordings: it counts something else than seconds."""


@dataclass(frozen=True)
class TimedPose:
    """Where the base was.

    Attributes:
        time: [s], of whatever clock.
        p: the base's origin in the world [m], three numbers.
        q: its rotation, a quaternion x, y, z, w as it was told.
    """

    time: float
    p: tuple[float, ...]
    q: tuple[float, ...]


def timed_pose(time: float, p: Sequence[float], q: Sequence[float]) -> TimedPose:
    """The pose of these numbers.

    Raises:
        InputError: they are none that a base can have.
    """
    if not abs(time) <= LATEST:
        raise InputError(f"its time {time:g} s is none")
    if not all(abs(value) <= FURTHEST for value in p):
        told = ", ".join(f"{value:g}" for value in p)
        raise InputError(f"its place ({told}) m is none within {FURTHEST:g} m")
    if not abs(math.hypot(*q) - 1.0) <= UNIT:
        told = ", ".join(f"{value:g}" for value in q)
        raise InputError(f"its quaternion ({told}) is no rotation; x, y, z, w have length 1")
    return TimedPose(float(time), tuple(map(float, p)), tuple(map(float, q)))


def between(a: TimedPose, b: TimedPose, time: float) -> Array:
    """T_world_base (4, 4) at a time between two poses: the origin along the line, the rotation along the great
    circle, the shorter way round."""
    share = (time - a.time) / (b.time - a.time)
    q, r = _unit(a.q), _unit(b.q)
    cosine = sum(x * y for x, y in zip(q, r, strict=True))
    if cosine < 0.0:
        r, cosine = tuple(-x for x in r), -cosine
    angle = math.acos(min(cosine, 1.0))
    if angle < 1e-6:  # the circle is its chord, to 1e-12
        weights = (1.0 - share, share)
    else:
        weights = (math.sin((1.0 - share) * angle), math.sin(share * angle))
    turned = tuple(weights[0] * x + weights[1] * y for x, y in zip(q, r, strict=True))
    p = [(1.0 - share) * x + share * y for x, y in zip(a.p, b.p, strict=True)]
    return pose(_rotation(_unit(turned)), p)


def matrix(a: TimedPose) -> Array:
    """T_world_base of it, (4, 4)."""
    return pose(_rotation(_unit(a.q)), a.p)


def _unit(q: tuple[float, ...]) -> tuple[float, ...]:
    length = math.hypot(*q)
    return tuple(x / length for x in q)


def _rotation(q: tuple[float, ...]) -> Array:
    x, y, z, w = q
    return np.array([
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)],
        [2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)],
        [2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)],
    ])  # fmt: skip


def of_matrix(time: float, T: Array) -> TimedPose:
    """The pose at a time [s] of a rigid transform (4, 4); its quaternion by the largest of the four numbers."""
    R = T[:3, :3]
    x, y, z = np.diag(R)
    squares = np.array([1.0 + x - y - z, 1.0 - x + y - z, 1.0 - x - y + z, 1.0 + x + y + z])
    i = int(np.argmax(squares))
    four = np.array([
        [squares[0], R[0, 1] + R[1, 0], R[0, 2] + R[2, 0], R[2, 1] - R[1, 2]],
        [R[0, 1] + R[1, 0], squares[1], R[1, 2] + R[2, 1], R[0, 2] - R[2, 0]],
        [R[0, 2] + R[2, 0], R[1, 2] + R[2, 1], squares[2], R[1, 0] - R[0, 1]],
        [R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1], squares[3]],
    ])  # fmt: skip
    q = four[i] / (2.0 * math.sqrt(squares[i]))
    return TimedPose(time, tuple(T[:3, 3].tolist()), tuple(q.tolist()))
