"""What the data tell of what is asked for, and what they cannot tell apart: singular values of what is left of the
whitened derivatives when everything else has taken its share."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from probedesign.frames import Array
from probedesign.identification.parameters import ASKABLE, parts_of
from probedesign.identification.solver import Point, units_of

SHARE = 0.2
"""Of a direction: an unknown that has more of it takes part in what cannot be told apart."""


@dataclass(frozen=True)
class Untold:
    """Something that the tests do not tell.

    Attributes:
        name: what is left at the design's value for it.
        words: what cannot be told, and why.
    """

    name: str
    words: str


def untold(point: Point, weight: Array, asked: Sequence[str], patience: float = 1.0) -> Untold | None:
    """The worst told direction among those asked for, if it is told so badly that it would mislead.

    Args:
        point: the campaign, solved.
        weight: of its groups.
        asked: names, of `ASKABLE`.
        patience: how many times `Askable.told` a standard deviation may be.
    """
    parts, owner = parts_of(asked), [name for name in asked for _ in ASKABLE[name].parts]
    limits = np.array([ASKABLE[name].told for name in owner])
    left = _left(point, weight, parts) * limits
    _, sizes, ways = np.linalg.svd(left)
    if sizes[-1] * patience >= 1.0:
        return None
    way = ways[-1] * limits  # of the unknowns themselves
    share = {name: max(abs(ways[-1][i]) for i, own in enumerate(owner) if own == name) for name in asked}
    part = [name for name in asked if share[name] > SHARE]
    given_up = part[-1]
    std = float(np.linalg.norm(way)) / max(float(sizes[-1]), 1e-12)
    return Untold(given_up, _words(part, {n: way[owner.index(n)] for n in part}, std))


def _left(point: Point, weight: Array, parts: Sequence[int]) -> Array:
    """Square matrix whose square is the information on these parts, all other unknowns left free."""
    rows, _ = point.system(weight)
    active = np.flatnonzero(point.problem.active)
    at = [int(np.searchsorted(active, part)) for part in parts]
    rest = [i for i in range(rows.shape[1]) if i not in at]
    others = rows[:, rest]
    others = others * units_of(others)
    R = np.asarray(np.linalg.qr(np.hstack([others, rows[:, at]]), mode="r"))
    return R[len(rest) :, len(rest) :]


def _words(part: Sequence[str], way: dict[str, float], std: float) -> str:
    """What is told instead, of two; else that nothing is."""
    if len(part) == 1:
        name = part[0]
        return f"{name}: these tests hardly see it; its standard deviation would be {_much(name, std)}"
    if len(part) == 2 and all(ASKABLE[name].logarithm for name in part):
        kept, given_up = part
        power = -way[kept] / way[given_up]
        told = f"{kept}/{given_up}{_power(-power)}" if power < 0.0 else f"{kept}·{given_up}{_power(power)}"
        return f"{kept} and {given_up}: these tests tell only {told}, not both"
    return f"{', '.join(part[:-1])} and {part[-1]}: these tests do not tell them apart"


def _power(power: float) -> str:
    return "" if abs(power - 1.0) < 0.05 else f"^{power:.1f}".removesuffix(".0")


def _much(name: str, std: float) -> str:
    one = ASKABLE[name]
    if one.logarithm:
        return f"{std:.0%}" if std < 10.0 else "without bound"
    if one.parts[0] == one.name == "root":
        return f"{std:.2g}"
    if name == "offset":
        return f"{1e3 * std:.2g} mm"
    return f"{np.degrees(std):.2g}°" if np.degrees(std) < 180.0 else "without bound"
