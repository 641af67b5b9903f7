"""What the cameras saw: pixels of markers, checked before anything is made of them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from probedesign.errors import InputError
from probedesign.frames import Array
from probedesign.vision.camera import Camera

LEAST_ANGLE_DEG = 2.0
"""Lines of sight that meet at less than this tell no depth: there an error is thirty times the one across
(assumed)."""
LEAST_STD_PX = 0.02
"""No picture tells a place better [px] (assumed)."""


@dataclass(frozen=True)
class Sightings:
    """Markers in the pictures of cameras.

    Attributes:
        cameras: (c,).
        labels: names of the markers (m,).
        pixels: u, v [px], NaN where not seen, (c, m, 2).
        std_px: standard deviation of a coordinate [px], (c, m).
    """

    cameras: tuple[Camera, ...]
    labels: tuple[str, ...]
    pixels: Array
    std_px: Array

    @property
    def mask(self) -> NDArray[np.bool_]:
        """Whether a camera saw a marker, (c, m)."""
        return np.asarray(np.isfinite(self.pixels).all(axis=2))

    def with_pixels(self, pixels: Array) -> "Sightings":
        """The same with other pixels."""
        return replace(self, pixels=pixels)


def sightings(
    cameras: Sequence[Camera], pixels: ArrayLike, std_px: ArrayLike | None, labels: Sequence[str] | None
) -> Sightings:
    """Sightings that can be made markers of; see `triangulate`.

    Raises:
        InputError: fewer than two cameras, two along one line of sight, a marker that fewer than two saw.
    """
    places = np.asarray(pixels, dtype=float)
    if len(cameras) < 2:
        raise InputError(
            "markers in space need two cameras at least; where there is one, measure them otherwise"
        )
    if places.ndim != 3 or places.shape[::2] != (len(cameras), 2):
        raise InputError(f"pixels must be {len(cameras)} x markers x 2, not {places.shape}")
    number = places.shape[1]
    names = tuple(labels) if labels is not None else tuple(str(i + 1) for i in range(number))
    own = [max(camera.std_px, LEAST_STD_PX) for camera in cameras]
    std = np.asarray(np.array(own)[:, None] if std_px is None else std_px, dtype=float)
    seen = Sightings(tuple(cameras), names, places, np.broadcast_to(std, places.shape[:2]))
    if not (seen.std_px[seen.mask] > 0).all():
        raise InputError("a pixel's standard deviation must be above 0 px")
    _check_seen_twice(seen)
    _check_base_lines(seen)
    return seen


def _check_seen_twice(seen: Sightings) -> None:
    """Refuse a marker that one camera saw, or none."""
    for label, by in zip(seen.labels, seen.mask.T, strict=True):
        if by.sum() >= 2:
            continue
        who = [camera.name for camera, yes in zip(seen.cameras, by, strict=True) if yes]
        where = f"camera {who[0]} only" if who else "no camera"
        raise InputError(
            f"marker {label} is seen by {where}; two must see it: add the other's pixel or leave it out"
        )


def _check_base_lines(seen: Sightings) -> None:
    """Refuse markers that all cameras see along one line."""
    rays = [c.rays(np.nan_to_num(p)) for c, p in zip(seen.cameras, seen.pixels, strict=True)]
    widest = np.zeros(len(seen.labels))
    for i, j in combinations(range(len(rays)), 2):
        across = np.linalg.norm(np.cross(rays[i], rays[j]), axis=1)
        angle = np.degrees(np.arctan2(across, np.abs(np.sum(rays[i] * rays[j], axis=1))))
        widest = np.maximum(widest, np.where(seen.mask[i] & seen.mask[j], angle, 0.0))
    if len(widest) and np.median(widest) < LEAST_ANGLE_DEG:
        names = " and ".join(camera.name for camera in seen.cameras)
        raise InputError(
            f"cameras {names} look along one line: {np.median(widest):.1f}° between their sights, which tells no "
            f"depth; set them {LEAST_ANGLE_DEG:.0f}° apart at least, better 60 to 90°"
        )
