"""The row of dots along a probe: which spots they are, and in which order."""

import math
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from probedesign.frames import Array
from probedesign.vision.spots import Spots

Side = Literal["left", "right", "top", "bottom"]

AWAY = {"left": (1, 0), "right": (-1, 0), "top": (0, 1), "bottom": (0, -1)}
"""Direction in the picture that leads away from each of its sides."""

TURN = 0.6
"""Most that the step from dot to dot changes against the one before, as a share of its length: 35° of bending, or as
much of foreshortening."""
GROWTH = 1.7
"""Most that a dot's size changes from one to the next."""
NEXT = 0.35
"""A spot that lies this near to where one more dot would be, in steps, is one more dot."""
NEIGHBOURS = 8
KEPT = 400


@dataclass(frozen=True)
class Row:
    """Spots in line.

    Attributes:
        chosen: which spots, first to last, (k,).
        cost: how much the steps and sizes change along it, squared and summed.
    """

    chosen: tuple[int, ...]
    cost: float = 0.0


@dataclass(frozen=True)
class Base:
    """Where the base end is: a pixel, or a side of the picture.

    Attributes:
        at: the projected base [px], or the side.
    """

    at: Array | Side

    def nearness(self, pixel: Array) -> float:
        """Less for a pixel that is nearer to the base."""
        if isinstance(self.at, str):
            return float(np.dot(pixel, AWAY[self.at]))
        return float(np.linalg.norm(pixel - self.at))


@dataclass(frozen=True)
class Rows:
    """The search for a row among spots.

    Attributes:
        spots: of the photograph.
        s: arclength of the dots, first to last [m], (m,).
        base: where the base end is.
    """

    spots: Spots
    s: Array
    base: Base
    _steps: Array = field(init=False)

    def __post_init__(self) -> None:
        """Lengths of the steps, in units of their mean."""
        object.__setattr__(self, "_steps", np.diff(self.s) / np.mean(np.diff(self.s)))

    def best(self) -> Row:
        """The longest row with the least cost, at most as long as the dots; empty if there are no two spots."""
        rows, best = self._pairs(), Row(())
        while rows:
            best = rows[0]
            if len(best.chosen) == len(self.s):
                break
            rows = sorted((longer for row in rows for longer in self._longer(row)), key=lambda row: row.cost)[
                :KEPT
            ]
        return best

    def beyond(self, row: Row) -> bool:
        """Whether one more dot stands behind the last: then there are more dots than said."""
        points = self.spots.pixels[list(row.chosen)]
        step = points[-1] - points[-2]
        near = np.linalg.norm(self.spots.pixels - (points[-1] + step), axis=1) < NEXT * np.linalg.norm(step)
        return bool(np.any(near & self._alike(row.chosen[-1])))

    def _pairs(self) -> list[Row]:
        """Every spot with each of its neighbours, from the base onwards."""
        rows = []
        for i, pixel in enumerate(self.spots.pixels):
            away = np.linalg.norm(self.spots.pixels - pixel, axis=1)
            for j in np.argsort(np.where(self._alike(i), away, np.inf))[: NEIGHBOURS + 1]:
                if j != i and self._alike(i)[j] and self._starts(pixel, self.spots.pixels[j]):
                    rows.append(Row((i, int(j)), self._start_cost(pixel, self.spots.pixels[j])))
        return sorted(rows, key=lambda row: row.cost)

    def _starts(self, first: Array, second: Array) -> bool:
        """Whether a row may start so: away from the base."""
        return self.base.nearness(first) < self.base.nearness(second)

    def _start_cost(self, first: Array, second: Array) -> float:
        """How far the base is from where the first step says, in steps, squared."""
        if isinstance(self.base.at, str):
            return 0.0
        step = (second - first) / self._steps[0]
        said = first - step * self.s[0] / np.mean(np.diff(self.s))
        return float(np.sum((said - self.base.at) ** 2) / np.sum(step**2))

    def _longer(self, row: Row) -> list[Row]:
        """The row with one more spot, each that goes on well."""
        number, last = len(row.chosen), row.chosen[-1]
        points = self.spots.pixels[list(row.chosen[-2:])]
        step = (points[1] - points[0]) / self._steps[number - 2] * self._steps[number - 1]
        turn = np.linalg.norm(self.spots.pixels - (points[1] + step), axis=1) / max(math.hypot(*step), 1e-9)
        growth = np.log(self.spots.diameter_px / self.spots.diameter_px[last])
        good = (turn < TURN) & self._alike(last)
        good[list(row.chosen)] = False
        cost = row.cost + turn**2 + growth**2
        return [Row((*row.chosen, int(j)), float(cost[j])) for j in np.flatnonzero(good)]

    def _alike(self, i: int) -> NDArray[np.bool_]:
        """Which spots may stand beside a spot, by their size."""
        ratio = self.spots.diameter_px / self.spots.diameter_px[i]
        return np.asarray((ratio < GROWTH) & (ratio > 1 / GROWTH))
