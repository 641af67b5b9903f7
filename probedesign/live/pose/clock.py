"""How far one clock is from another, told by what arrives with its stamp, now and then late."""

import math

KEPT = 10
"""Seconds over which the least delay is looked for: crystals that differ by 50 ppm part by half a millisecond."""


class Offset:
    """Least of arrival less stamp over the last seconds: of what came without waiting anywhere."""

    def __init__(self) -> None:
        self._least: dict[int, float] = {}

    def add(self, stamp: float, arrival: float) -> float:
        """Take in one, told by both clocks [s]; the offset as it is known now [s]."""
        second = math.floor(arrival)
        if second not in self._least:
            for old in [s for s in self._least if not second - KEPT < s <= second]:
                del self._least[old]
        self._least[second] = min(self._least.get(second, math.inf), arrival - stamp)
        return min(self._least.values())

    @property
    def known(self) -> bool:
        """Whether anything was taken in."""
        return bool(self._least)

    @property
    def value(self) -> float:
        """As it is known now [s]."""
        return min(self._least.values())
