"""Finding the dots of a probe in a photograph: their centres, in order from base to tip."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from probedesign.errors import InputError
from probedesign.frames import Array
from probedesign.vision.dots import Dot, fit_dot
from probedesign.vision.marker_sequence import Base, Row, Rows, Side
from probedesign.vision.picture import read_grey
from probedesign.vision.spots import Spots, spots


@dataclass(frozen=True)
class Found:
    """The dots of a probe in one photograph.

    Attributes:
        pixels: centres from base to tip [px], (m, 2).
        std_px: standard deviation of a coordinate of each [px], (m,).
        dots: as they were fitted, (m,).
        dark: whether they are darker than the probe.
    """

    pixels: Array
    std_px: Array
    dots: tuple[Dot, ...]
    dark: bool


def find_markers(path: Path, s: ArrayLike, base: Array | Side, dark: bool | None = None) -> Found:
    """Find the dots of a probe in a photograph.

    Args:
        path: of the photograph, in a format that OpenCV reads.
        s: arclength of the dots from base to tip, their number and their spacing [m], (m,).
        base: pixel where the base appears (2,), or the side of the picture that is nearer to it.
        dark: whether the dots are darker than the probe; either if None.

    Raises:
        InputError: no such picture, or it shows no row of that many dots.
    """
    places = np.asarray(s, dtype=float)
    if len(places) < 3 or not (np.diff(places) > 0).all():
        raise InputError(
            f"{path}: a row has three dots at least, from base to tip; the markers' s_mm name {len(places)}"
        )
    grey = read_grey(path)
    end = Base(base)
    tried = [_tried(grey, shade, places, end) for shade in ((True, False) if dark is None else (dark,))]
    whole = [(rows, row) for rows, row in tried if len(row.chosen) == len(places)]
    if not whole:
        most = max((row for _, row in tried), key=lambda row: len(row.chosen))
        many = "no row of dots" if len(most.chosen) < 3 else f"{len(most.chosen)} dots in a row"
        raise InputError(
            f"{path}: {many} where {len(places)} are told (the markers' s_mm); dots must be sharp, round and all "
            "in sight; else click them into pixels.csv"
        )
    rows, row = min(whole, key=lambda one: one[1].cost)
    if rows.beyond(row):
        raise InputError(
            f"{path}: more dots in a row than the {len(places)} that are told (the markers' s_mm); a spot that is no "
            "dot must be covered"
        )
    return _found(path, grey, rows.spots, row)


def _tried(grey: NDArray[np.uint8], dark: bool, s: Array, base: Base) -> tuple[Rows, Row]:
    rows = Rows(spots(grey, dark), s, base)
    return rows, rows.best()


def _found(path: Path, grey: NDArray[np.uint8], seen: Spots, row: Row) -> Found:
    """The dots of a row, each fitted.

    Raises:
        InputError: one is not like a dot.
    """
    dots: list[Dot] = []
    ways = np.gradient(seen.pixels[list(row.chosen)], axis=0)
    for number, (i, way) in enumerate(zip(row.chosen, ways, strict=True), 1):
        dot = fit_dot(grey, seen.pixels[i], float(seen.diameter_px[i]), way)
        if dot is None:
            u, v = seen.pixels[i]
            raise InputError(
                f"{path}: dot {number} at u {u:.0f}, v {v:.0f} px is no whole ellipse; it may be half hidden or "
                "touch the probe's edge"
            )
        dots.append(dot)
    pixels = np.array([dot.pixel for dot in dots])
    return Found(pixels, np.array([dot.std_px for dot in dots]), tuple(dots), seen.dark)
