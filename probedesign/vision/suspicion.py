"""Pixels that contradict each other: what is wrong with them, tried out."""

from collections.abc import Callable, Iterator
from itertools import combinations
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from probedesign.errors import InputError
from probedesign.frames import Array
from probedesign.vision.sightings import Sightings

FALSE_ALARM = 1e-6
"""Probability that good pixels of a marker are refused."""
LEAST_PX = 2.0
"""A residual below this is none that a wrong marker makes: dots stand further apart (assumed). It says that the
cameras are worse than they think, which `Triangulated.agreement` tells."""


class Found(Protocol):
    """Of `Triangulated`, what is judged here."""

    @property
    def p_world(self) -> Array: ...
    @property
    def residual_px(self) -> Array: ...
    @property
    def agreement(self) -> Array: ...


def check_agreement(seen: Sightings, found: Found, place: Callable[[Sightings], Found]) -> None:
    """Refuse pixels that are not of one point, or of one behind a camera.

    Args:
        seen: by the cameras.
        found: of it.
        place: makes markers of sightings, to try out what would mend them.

    Raises:
        InputError: naming what would: swapped cameras, a camera's markers numbered from the other end, two exchanged
            markers; or the marker that fits worst.
    """
    wrong = _wrong(seen, found)
    if not wrong.any():
        return
    for words, mended in _mendings(seen, wrong):
        if not _wrong(mended, place(mended)).any():
            raise InputError(f"{words}: so the pictures agree, as given they do not")
    worst = int(np.argmax(np.where(wrong, np.nan_to_num(_largest(found), nan=np.inf), -1.0)))
    off = " and ".join(
        f"{np.linalg.norm(r):.1f} px in {camera.name}"
        for camera, r in zip(seen.cameras, found.residual_px[:, worst], strict=True)
        if np.isfinite(r).all()
    )
    many = f" ({np.sum(wrong)} of {len(wrong)} markers so)" if np.sum(wrong) > 1 else ""
    raise InputError(
        f"marker {seen.labels[worst]}: its pixels are not of one point in front of the cameras, off by {off}{many}; "
        "check that it is the same dot in each picture, and that no camera moved after its calibration"
    )


def _wrong(seen: Sightings, found: Found) -> NDArray[np.bool_]:
    """Which markers cannot be, (m,)."""
    free = 2 * seen.mask.sum(axis=0) - 3
    behind = np.array(
        [(c.depth(found.p_world) <= 0) & m for c, m in zip(seen.cameras, seen.mask, strict=True)]
    )
    off = (found.agreement * free > stats.chi2.isf(FALSE_ALARM, free)) & (_largest(found) > LEAST_PX)
    return np.asarray(behind.any(axis=0) | off | ~np.isfinite(found.p_world).all(axis=1))


def _largest(found: Found) -> Array:
    """Largest distance between a marker's pixel and where it should be [px], (m,)."""
    return np.asarray(np.nanmax(np.linalg.norm(found.residual_px, axis=2), axis=0))


def _mendings(seen: Sightings, wrong: NDArray[np.bool_]) -> Iterator[tuple[str, Sightings]]:
    """Likely mistakes undone, with the words for each."""
    names = [camera.name for camera in seen.cameras]
    for i, j in combinations(range(len(names)), 2):
        order = np.arange(len(names))
        order[[i, j]] = j, i
        if (seen.mask.sum(axis=0) == seen.mask[order].sum(axis=0)).all():
            yield f"cameras {names[i]} and {names[j]} are swapped", seen.with_pixels(seen.pixels[order])
    # Of two cameras nobody can say which one has it wrong.
    blamed = names if len(names) > 2 else [" or ".join(names)]
    for i, name in enumerate(blamed):
        pixels = seen.pixels.copy()
        pixels[i, seen.mask[i]] = pixels[i, seen.mask[i]][::-1]
        yield f"camera {name} numbers the markers from the other end", seen.with_pixels(pixels)
    if 2 <= wrong.sum() <= 3:
        for a, b in combinations(np.flatnonzero(wrong), 2):
            for i, name in enumerate(blamed):
                pixels = seen.pixels.copy()
                pixels[i, [a, b]] = pixels[i, [b, a]]
                pair = f"{seen.labels[a]} and {seen.labels[b]}"
                if np.isfinite(pixels[i, [a, b]]).all():
                    yield f"markers {pair} are exchanged in camera {name}", seen.with_pixels(pixels)
