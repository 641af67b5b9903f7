"""Markers of a probe in a photograph: the row of dots along it, in order from base to tip, each fitted."""

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from probedesign.core.errors import InputError
from probedesign.core.frames import Array
from probedesign.vision.dots import DetectedSpots, Dot, detect_spots, fit_dot
from probedesign.vision.images import read_grey

ImageSide = Literal["left", "right", "top", "bottom"]

AWAY = {"left": (1, 0), "right": (-1, 0), "top": (0, 1), "bottom": (0, -1)}
"""Direction in the picture away from each of its sides."""

MAX_STEP_CHANGE = 0.6
"""Largest change of the step from dot to dot, relative to its length: 35° of bending, or as much of foreshortening."""
MAX_GROWTH = 1.7
"""Largest ratio of the sizes of neighbouring dots."""
NEXT = 0.35
"""Distance, in steps, within which a spot at the end of the row is one more dot."""
NEIGHBOURS = 8
"""Nearest spots that may follow the first of a row."""
BEAM = 400
"""Rows kept in each step of the search."""


# the search among spots


@dataclass(frozen=True)
class MarkerSequence:
    """Spots in a row.

    Attributes:
        chosen: which spots, first to last, (k,).
        cost: sum of squared changes of steps and sizes along it.
    """

    chosen: tuple[int, ...]
    cost: float = 0.0


@dataclass(frozen=True)
class SequenceSearch:
    """Beam search for the row of dots among spots.

    Attributes:
        spots: of the photograph.
        s: arclength of the dots, first to last [m], (m,).
        base: the projected base [px], (2,), or the side of the picture nearer to it.
    """

    spots: DetectedSpots
    s: Array
    base: Array | ImageSide
    _steps: Array = field(init=False)

    def __post_init__(self) -> None:
        """Set the lengths of the steps, in units of their mean."""
        object.__setattr__(self, "_steps", np.diff(self.s) / np.mean(np.diff(self.s)))

    def best(self) -> MarkerSequence:
        """Return the longest row with the least cost, at most as long as the dots; empty if there are no two spots."""
        rows, best = self._pairs(), MarkerSequence(())
        while rows:
            best = rows[0]
            if len(best.chosen) == len(self.s):
                break
            rows = sorted((longer for row in rows for longer in self._longer(row)), key=lambda row: row.cost)[
                :BEAM
            ]
        return best

    def continues_beyond(self, row: MarkerSequence) -> bool:
        """Return whether one more dot follows the last, so that there are more dots than expected."""
        points = self.spots.pixels[list(row.chosen)]
        step = points[-1] - points[-2]
        near = np.linalg.norm(self.spots.pixels - (points[-1] + step), axis=1) < NEXT * np.linalg.norm(step)
        return bool(np.any(near & self._alike(row.chosen[-1])))

    def _pairs(self) -> list[MarkerSequence]:
        """Return every spot with each of its neighbours, from the base onwards."""
        rows = []
        for i, pixel in enumerate(self.spots.pixels):
            away = np.linalg.norm(self.spots.pixels - pixel, axis=1)
            for j in np.argsort(np.where(self._alike(i), away, np.inf))[: NEIGHBOURS + 1]:
                if (
                    j != i
                    and self._alike(i)[j]
                    and self._base_distance(pixel) < self._base_distance(self.spots.pixels[j])
                ):
                    rows.append(MarkerSequence((i, int(j)), self._start_cost(pixel, self.spots.pixels[j])))
        return sorted(rows, key=lambda row: row.cost)

    def _base_distance(self, pixel: Array) -> float:
        """Return a measure that increases with the distance of a pixel from the base."""
        if isinstance(self.base, str):
            return float(np.dot(pixel, AWAY[self.base]))
        return float(np.linalg.norm(pixel - self.base))

    def _start_cost(self, first: Array, second: Array) -> float:
        """Return the squared distance of the base from its extrapolation by the first step, in steps."""
        if isinstance(self.base, str):
            return 0.0
        step = (second - first) / self._steps[0]
        extrapolated = first - step * self.s[0] / np.mean(np.diff(self.s))
        return float(np.sum((extrapolated - self.base) ** 2) / np.sum(step**2))

    def _longer(self, row: MarkerSequence) -> list[MarkerSequence]:
        """Return the row with one more spot, for each spot that continues it."""
        number, last = len(row.chosen), row.chosen[-1]
        points = self.spots.pixels[list(row.chosen[-2:])]
        step = (points[1] - points[0]) / self._steps[number - 2] * self._steps[number - 1]
        turn = np.linalg.norm(self.spots.pixels - (points[1] + step), axis=1) / max(math.hypot(*step), 1e-9)
        growth = np.log(self.spots.diameter_px / self.spots.diameter_px[last])
        good = (turn < MAX_STEP_CHANGE) & self._alike(last)
        good[list(row.chosen)] = False
        cost = row.cost + turn**2 + growth**2
        return [MarkerSequence((*row.chosen, int(j)), float(cost[j])) for j in np.flatnonzero(good)]

    def _alike(self, i: int) -> NDArray[np.bool_]:
        """Return which spots may be neighbours of a spot, by their size."""
        ratio = self.spots.diameter_px / self.spots.diameter_px[i]
        return np.asarray((ratio < MAX_GROWTH) & (ratio > 1 / MAX_GROWTH))


# the markers


@dataclass(frozen=True)
class DetectedMarkers:
    """Dots of a probe in one photograph.

    Attributes:
        pixels: centres from base to tip [px], (m, 2).
        std_px: standard deviation of a coordinate of each [px], (m,).
        dots: the fitted dots, (m,).
        dark: whether they are darker than the probe.
    """

    pixels: Array
    std_px: Array
    dots: tuple[Dot, ...]
    dark: bool


def find_markers(
    path: Path, s: ArrayLike, base: Array | ImageSide, dark: bool | None = None
) -> DetectedMarkers:
    """Find the dots of a probe in a photograph.

    Args:
        path: of the photograph, in a format that OpenCV reads.
        s: arclength of the dots from base to tip, their number and their spacing [m], (m,).
        base: pixel of the projected base (2,), or the side of the picture nearer to it.
        dark: whether the dots are darker than the probe; either if None.

    Raises:
        InputError: no such photograph, or it has no row of that many dots.
    """
    places = np.asarray(s, dtype=float)
    if len(places) < 3 or not (np.diff(places) > 0).all():
        raise InputError(
            f"{path}: a row has at least three dots, from base to tip; the markers' s_mm name {len(places)}"
        )
    grey = read_grey(path)
    tried = [_searched(grey, shade, places, base) for shade in ((True, False) if dark is None else (dark,))]
    complete = [(search, row) for search, row in tried if len(row.chosen) == len(places)]
    if not complete:
        longest = max((row for _, row in tried), key=lambda row: len(row.chosen))
        count = "no row of dots" if len(longest.chosen) < 3 else f"{len(longest.chosen)} dots in a row"
        raise InputError(
            f"{path}: {count}, but {len(places)} are expected (the markers' s_mm); dots must be sharp, round and all "
            "visible; otherwise click them into pixels.csv"
        )
    search, row = min(complete, key=lambda one: one[1].cost)
    if search.continues_beyond(row):
        raise InputError(
            f"{path}: more dots in a row than the {len(places)} expected (the markers' s_mm); cover spots that are not "
            "dots"
        )
    return _fitted(path, grey, search.spots, row)


def _searched(
    grey: NDArray[np.uint8], dark: bool, s: Array, base: Array | ImageSide
) -> tuple[SequenceSearch, MarkerSequence]:
    search = SequenceSearch(detect_spots(grey, dark), s, base)
    return search, search.best()


def _fitted(path: Path, grey: NDArray[np.uint8], seen: DetectedSpots, row: MarkerSequence) -> DetectedMarkers:
    """Return the markers of a row, each dot fitted.

    Raises:
        InputError: one does not fit.
    """
    dots: list[Dot] = []
    directions = np.gradient(seen.pixels[list(row.chosen)], axis=0)
    for number, (i, direction) in enumerate(zip(row.chosen, directions, strict=True), 1):
        dot = fit_dot(grey, seen.pixels[i], float(seen.diameter_px[i]), direction)
        if dot is None:
            u, v = seen.pixels[i]
            raise InputError(
                f"{path}: dot {number} at u {u:.0f}, v {v:.0f} px is not a whole ellipse; it may be half hidden "
                "or touch the probe's edge"
            )
        dots.append(dot)
    pixels = np.array([dot.pixel for dot in dots])
    return DetectedMarkers(pixels, np.array([dot.std_px for dot in dots]), tuple(dots), seen.dark)
