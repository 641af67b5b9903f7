"""Triangulation: positions of markers in space from their pixels in two or more cameras, with consistency checks."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from probedesign.core.errors import InputError
from probedesign.core.frames import Array
from probedesign.vision.camera import Camera

#: Angle between lines of sight below which there is no depth information: there an error is thirty times the one across
#: (assumed).
MIN_ANGLE_DEG = 2.0
MIN_STD_PX = 0.02  #: Smallest standard deviation of a pixel in any picture [px] (assumed).
FALSE_ALARM = 1e-6  #: Probability that valid pixels of a marker are refused.
#: Smallest residual of a wrong marker: dots are further apart (assumed). A smaller one means that the cameras are worse
#: than stated, which `Triangulated.agreement` shows.
MIN_RESIDUAL_PX = 2.0
_ITERATIONS = 10  # Gauss-Newton from the midpoint of the rays is exact to rounding after three or four


@dataclass(frozen=True)
class MarkerObservations:
    """Pixels of markers in the pictures of several cameras."""

    cameras: tuple[Camera, ...]  #: (c,).
    labels: tuple[str, ...]  #: names of the markers (m,).
    pixels: Array  #: u, v [px], NaN where not seen, (c, m, 2).
    std_px: Array  #: standard deviation of a coordinate [px], (c, m).

    @property
    def mask(self) -> NDArray[np.bool_]:
        """Whether a camera saw a marker, (c, m)."""
        return np.asarray(np.isfinite(self.pixels).all(axis=2))


@dataclass(frozen=True)
class Triangulated:
    """Positions of markers in space."""

    p_world: Array  #: [m], (m, 3).
    #: covariance of each, by the noise in the pictures and the cameras' calibration [m²], (m, 3, 3). The calibration's
    #: share is common to all markers of these cameras.
    cov_world: Array
    residual_px: Array  #: pixel minus projection [px], NaN where not seen, (c, m, 2).
    #: χ² of the residuals per degree of freedom, near one if the stated standard deviations hold, (m,).
    agreement: Array


def triangulate(
    cameras: Sequence[Camera], pixels: ArrayLike, std_px: ArrayLike | None = None, labels: Sequence[str] | None = None
) -> Triangulated:
    """Locate markers in space by maximum likelihood on pixels.

    The covariance of a marker's pixels includes their own noise and that of the calibration.

    Args:
        cameras: at least two.
        pixels: of each camera each marker's u, v, NaN where it was not seen [px], (c, m, 2).
        std_px: of a coordinate, a number or one for each camera and marker [px], (c, m); each camera's own residual
            if None.
        labels: names of the markers (m,); 1 ... m if None.

    Raises:
        InputError: two cameras along one line of sight, a marker that fewer than two saw, or pixels that contradict
            each other: swapped cameras, markers out of order.
    """
    seen = observations(cameras, pixels, std_px, labels)
    located = _located(seen)
    _check_agreement(seen, located)
    return located


def _located(seen: MarkerObservations) -> Triangulated:
    """Return the markers, whatever their residuals."""
    # Start from the point with the least squared distances from the rays of each marker.
    across, target = np.zeros((seen.mask.shape[1], 3, 3)), np.zeros((seen.mask.shape[1], 3))
    for camera, pixels, mask in zip(seen.cameras, seen.pixels, seen.mask, strict=True):
        d = camera.rays(np.where(mask[:, None], pixels, 0.0))
        projector = mask[:, None, None] * (np.eye(3) - d[:, :, None] * d[:, None, :])
        across += projector
        target += projector @ camera.p_world
    points: Array = np.asarray(np.linalg.solve(across, target[..., None])[..., 0])
    weights = _weights(seen, points)
    for _ in range(_ITERATIONS):
        residual, by_point = _linearised(seen, points)
        weighted = np.swapaxes(by_point, 1, 2) @ weights
        points = points + np.linalg.solve(weighted @ by_point, weighted @ residual[..., None])[..., 0]
    weights = _weights(seen, points)
    residual, by_point = _linearised(seen, points)
    weighted = np.swapaxes(by_point, 1, 2) @ weights
    cov = np.linalg.inv(weighted @ by_point)
    square = np.einsum("ma,mab,mb->m", residual, weights, residual)
    agreement = square / (2 * seen.mask.sum(axis=0) - 3)
    by_camera = np.moveaxis(residual.reshape(len(points), len(seen.cameras), 2), 1, 0)
    residual_px = np.where(seen.mask[..., None], by_camera, np.nan)
    return Triangulated(points, np.asarray(cov), residual_px, agreement)


def _weights(seen: MarkerObservations, points: Array) -> Array:
    """Return the inverse covariance of the pixels of each marker in all cameras, (m, 2c, 2c); zero where unseen."""
    cameras, number = seen.cameras, len(points)
    by = [camera.by_parameters(points) for camera in cameras]
    cov = np.zeros((number, len(cameras), 2, len(cameras), 2))
    for i, camera in enumerate(cameras):
        calibration = by[i] @ camera.cov @ np.swapaxes(by[i], 1, 2)
        cov[:, i, :, i] = calibration + seen.std_px[i][:, None, None] ** 2 * np.eye(2)
    size = 2 * len(cameras)
    mask = np.repeat(seen.mask.T, 2, axis=1)
    both = mask[:, :, None] & mask[:, None, :]
    inverse = np.linalg.inv(np.where(both, cov.reshape(number, size, size), np.eye(size)))
    return np.asarray(np.where(both, inverse, 0.0))


def _linearised(seen: MarkerObservations, points: Array) -> tuple[Array, Array]:
    residual = np.stack([p - c.project(points) for c, p in zip(seen.cameras, seen.pixels, strict=True)], axis=1)
    by_point = np.stack([camera.by_point(points) for camera in seen.cameras], axis=1)
    residual = np.where(seen.mask.T[..., None], residual, 0.0)
    return residual.reshape(len(points), -1), by_point.reshape(len(points), -1, 3)


# checks


def observations(
    cameras: Sequence[Camera], pixels: ArrayLike, std_px: ArrayLike | None, labels: Sequence[str] | None
) -> MarkerObservations:
    """Return checked observations; see `triangulate`."""
    places = np.asarray(pixels, dtype=float)
    number = places.shape[1]
    names = tuple(labels) if labels is not None else tuple(str(i + 1) for i in range(number))
    of_cameras = [[max(camera.std_px, MIN_STD_PX)] for camera in cameras]
    std = np.asarray(of_cameras if std_px is None else std_px, dtype=float)
    seen = MarkerObservations(tuple(cameras), names, places, np.broadcast_to(std, places.shape[:2]))
    for label, by in zip(seen.labels, seen.mask.T, strict=True):
        by_cameras = [camera.name for camera, yes in zip(cameras, by, strict=True) if yes]
        if len(by_cameras) < 2:
            where = f"camera {by_cameras[0]} only" if by_cameras else "no camera"
            raise InputError(f"marker {label} is seen by {where}; two must see it: add the other camera's pixel or "
                             "leave it out")  # fmt: skip
    # The lines of sight must cross.
    rays = [c.rays(np.nan_to_num(p)) for c, p in zip(seen.cameras, seen.pixels, strict=True)]
    widest = np.zeros(number)
    for i, j in combinations(range(len(rays)), 2):
        across = np.linalg.norm(np.cross(rays[i], rays[j]), axis=1)
        angle = np.degrees(np.arctan2(across, np.abs(np.sum(rays[i] * rays[j], axis=1))))
        widest = np.maximum(widest, np.where(seen.mask[i] & seen.mask[j], angle, 0.0))
    if number and np.median(widest) < MIN_ANGLE_DEG:
        raise InputError(
            f"cameras {' and '.join(camera.name for camera in cameras)} look along one line: {np.median(widest):.1f}° "
            f"between their lines of sight give no depth; set them at least {MIN_ANGLE_DEG:.0f}° apart, better 60 to "
            "90°"
        )
    return seen


def _check_agreement(seen: MarkerObservations, located: Triangulated) -> None:
    """Refuse pixels that are not of one point, or of one behind a camera.

    The error names the likely mistake, a hypothesis in which all pixels agree: swapped cameras, or a camera's markers
    numbered from the other end; else the marker with the largest residual.
    """
    wrong = _wrong(seen, located)
    if not wrong.any():
        return
    for mistake, corrected in _outlier_hypotheses(seen):
        if not _wrong(corrected, _located(corrected)).any():
            raise InputError(f"{mistake}: the pictures agree with this corrected, but not as given")
    worst = int(np.argmax(np.where(wrong, np.nan_to_num(_max_residual(located), nan=np.inf), -1.0)))
    apart = " and ".join(f"{np.linalg.norm(r):.1f} px in {camera.name}"
                       for camera, r in zip(seen.cameras, located.residual_px[:, worst], strict=True)
                       if np.isfinite(r).all())  # fmt: skip
    many = f" ({np.sum(wrong)} of {len(wrong)} markers are)" if np.sum(wrong) > 1 else ""
    raise InputError(
        f"marker {seen.labels[worst]}: its pixels are not of one point in front of the cameras, off by {apart}{many}; "
        "check that it is the same dot in each picture, and that no camera moved after its calibration"
    )


def _wrong(seen: MarkerObservations, located: Triangulated) -> NDArray[np.bool_]:
    free = 2 * seen.mask.sum(axis=0) - 3
    rear = np.array([(c.depth(located.p_world) <= 0) & m for c, m in zip(seen.cameras, seen.mask, strict=True)])
    improbable = located.agreement * free > stats.chi2.isf(FALSE_ALARM, free)
    apart = improbable & (_max_residual(located) > MIN_RESIDUAL_PX)
    return np.asarray(rear.any(axis=0) | apart | ~np.isfinite(located.p_world).all(axis=1))


def _max_residual(located: Triangulated) -> Array:
    return np.asarray(np.nanmax(np.linalg.norm(located.residual_px, axis=2), axis=0))


def _outlier_hypotheses(seen: MarkerObservations) -> Iterator[tuple[str, MarkerObservations]]:
    """Yield likely mistakes and the observations with each of them corrected."""
    names = [camera.name for camera in seen.cameras]
    for i, j in combinations(range(len(names)), 2):
        order = np.arange(len(names))
        order[[i, j]] = j, i
        if (seen.mask.sum(axis=0) == seen.mask[order].sum(axis=0)).all():
            yield f"cameras {names[i]} and {names[j]} are swapped", replace(seen, pixels=seen.pixels[order])
    # With two cameras it is not known which one is wrong.
    suspects = names if len(names) > 2 else [" or ".join(names)]
    for i, name in enumerate(suspects):
        pixels = seen.pixels.copy()
        pixels[i, seen.mask[i]] = pixels[i, seen.mask[i]][::-1]
        yield f"camera {name} numbers the markers from the other end", replace(seen, pixels=pixels)
