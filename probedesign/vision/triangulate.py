"""Markers in space from their places in the pictures of two or more cameras."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from probedesign.frames import Array
from probedesign.vision.camera import Camera
from probedesign.vision.sightings import Sightings, sightings
from probedesign.vision.suspicion import check_agreement

_STEPS = 10  # Gauss-Newton from the rays' meeting is exact to rounding in three or four


@dataclass(frozen=True)
class Triangulated:
    """Markers in space.

    Attributes:
        p_world: [m], (m, 3).
        cov_world: covariance of each, of the noise in the pictures and of the cameras' calibration together [m²],
            (m, 3, 3). The calibration's share is common to all markers of these cameras.
        cov_noise: of the noise alone, independent from marker to marker [m²], (m, 3, 3).
        residual_px: pixel minus where the camera has the marker [px], NaN where not seen, (c, m, 2).
        agreement: residuals over their own standard deviations, squared, summed and divided by their degrees of
            freedom: near one if cameras and pixels are as good as they say, (m,).
    """

    p_world: Array
    cov_world: Array
    cov_noise: Array
    residual_px: Array
    agreement: Array


def triangulate(
    cameras: Sequence[Camera],
    pixels: ArrayLike,
    std_px: ArrayLike | None = None,
    labels: Sequence[str] | None = None,
) -> Triangulated:
    """Place markers in space by maximum likelihood on pixels.

    A pixel errs by its own noise and by what its camera's calibration leaves open; both weigh it, and both are in the
    covariance.

    Args:
        cameras: at least two.
        pixels: of each camera each marker's u, v, NaN where it was not seen [px], (c, m, 2).
        std_px: of a coordinate, a number or one for each camera and marker [px], (c, m); each camera's own residual
            if not said.
        labels: names of the markers (m,); 1 ... m if not said.

    Raises:
        InputError: fewer than two cameras, two along one line of sight, a marker that fewer than two saw, or pixels
            that contradict each other: swapped cameras, markers out of order.
    """
    seen = sightings(cameras, pixels, std_px, labels)
    found = placed(seen)
    check_agreement(seen, found, placed)
    return found


def placed(seen: Sightings) -> Triangulated:
    """The markers, whatever their residuals say."""
    points = _meetings(seen)
    weights = _weights(seen, points)
    for _ in range(_STEPS):
        residual, by_point = _linearised(seen, points)
        points = (
            points
            + np.linalg.solve(_information(by_point, weights), _pull(by_point, weights, residual))[..., 0]
        )
    weights = _weights(seen, points)
    residual, by_point = _linearised(seen, points)
    cov = np.linalg.inv(_information(by_point, weights))
    gain = cov @ np.swapaxes(by_point, 2, 3) @ weights
    noise = np.where(seen.mask, seen.std_px, 0.0) ** 2
    cov_noise = np.einsum("cmia,cm,cmja->mij", gain, noise, gain)
    square = np.einsum("cma,cmab,cmb->m", residual, weights, residual)
    agreement = square / (2 * seen.mask.sum(axis=0) - 3)
    told = np.where(seen.mask[..., None], residual, np.nan)
    return Triangulated(points, np.asarray(cov), np.asarray(cov_noise), told, agreement)


def _meetings(seen: Sightings) -> Array:
    """Where the rays of each marker come nearest to each other, (m, 3)."""
    across = np.zeros((seen.mask.shape[1], 3, 3))
    target = np.zeros((seen.mask.shape[1], 3))
    for camera, pixels, mask in zip(seen.cameras, seen.pixels, seen.mask, strict=True):
        d = camera.rays(np.where(mask[:, None], pixels, 0.0))
        off = mask[:, None, None] * (np.eye(3) - d[:, :, None] * d[:, None, :])
        across += off
        target += off @ camera.p_world
    return np.asarray(np.linalg.solve(across, target[..., None])[..., 0])


def _weights(seen: Sightings, points: Array) -> Array:
    """Inverse covariance of each pixel, of its noise and its camera's calibration, (c, m, 2, 2); zero where unseen."""
    weights = np.zeros((*seen.mask.shape, 2, 2))
    for i, camera in enumerate(seen.cameras):
        by = camera.by_parameters(points)
        cov = seen.std_px[i][:, None, None] ** 2 * np.eye(2) + by @ camera.cov @ np.swapaxes(by, 1, 2)
        weights[i] = np.where(seen.mask[i][:, None, None], np.linalg.inv(cov), 0.0)
    return weights


def _linearised(seen: Sightings, points: Array) -> tuple[Array, Array]:
    """Residuals (c, m, 2), zero where unseen, and their derivatives by the points with the sign changed."""
    residual = np.stack([p - c.project(points) for c, p in zip(seen.cameras, seen.pixels, strict=True)])
    by_point = np.stack([camera.by_point(points) for camera in seen.cameras])
    return np.where(seen.mask[..., None], residual, 0.0), by_point


def _information(by_point: Array, weights: Array) -> Array:
    return np.asarray((np.swapaxes(by_point, 2, 3) @ weights @ by_point).sum(axis=0))


def _pull(by_point: Array, weights: Array, residual: Array) -> Array:
    return np.asarray((np.swapaxes(by_point, 2, 3) @ weights @ residual[..., None]).sum(axis=0))
