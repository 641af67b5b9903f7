"""Direct Linear Transformation: the projection that control points tell, from linear equations.

Source: Y. I. Abdel-Aziz, H. M. Karara, Direct linear transformation from comparator coordinates into object space
coordinates, Proc. ASP/UI Symposium on Close-Range Photogrammetry, 1971; scaled as R. Hartley, A. Zisserman, Multiple
View Geometry in Computer Vision, 2nd ed., algorithm 7.1.
"""

import numpy as np
from scipy.linalg import rq

from probedesign.frames import Array


def projections(points_world: Array, pixels: Array) -> Array:
    """Projections that map control points onto their pixels, of many choices of points at once.

    Args:
        points_world: at least six [m], (..., n, 3).
        pixels: (..., n, 2).

    Returns:
        P (..., 3, 4) of norm one, its sign such that most of the points lie in front.
    """
    points, to_points = _scaled(points_world)
    images, to_images = _scaled(pixels)
    ones = np.ones((*points.shape[:-1], 1))
    X = np.concatenate([points, ones], axis=-1)
    zero = np.zeros_like(X)
    rows_u = np.concatenate([X, zero, -images[..., :1] * X], axis=-1)
    rows_v = np.concatenate([zero, X, -images[..., 1:] * X], axis=-1)
    _, _, Vh = np.linalg.svd(np.concatenate([rows_u, rows_v], axis=-2))
    P = np.linalg.solve(to_images, Vh[..., -1, :].reshape(*Vh.shape[:-2], 3, 4) @ to_points)
    P = P / np.linalg.norm(P, axis=(-2, -1), keepdims=True)
    front = np.sum(np.sign(depths(P, points_world)), axis=-1) >= 0
    return np.asarray(np.where(front[..., None, None], P, -P))


def depths(P: Array, points_world: Array) -> Array:
    """Last homogeneous coordinate of projected points (..., n): its sign tells front from behind."""
    depth: Array = points_world @ P[..., 2, :3, None] + P[..., 2, 3, None, None]
    return depth[..., 0]


def seen(P: Array, points_world: Array) -> Array:
    """Pixels of points (n, 3) by projections (..., 3, 4), (..., n, 2)."""
    images = points_world @ np.swapaxes(P[..., :3], -1, -2) + P[..., None, :, 3]
    with np.errstate(divide="ignore", invalid="ignore"):  # a wild choice of points may put one at infinity
        return np.asarray(images[..., :2] / images[..., 2:])


def parts(P: Array) -> tuple[Array, Array, Array]:
    """K, R and centre of a projection; R has determinant -1 where the picture is mirrored."""
    K, R = rq(P[:, :3])
    signs = np.sign(np.diag(K))
    K, R = K * signs, signs[:, None] * R
    centre = -np.linalg.solve(P[:, :3], P[:, 3])
    return np.asarray(K / K[2, 2], dtype=float), np.asarray(R), np.asarray(centre)


def _scaled(points: Array) -> tuple[Array, Array]:
    """Points (..., n, k) about their middle in units of their spread, and the map (..., k + 1, k + 1) to them."""
    k = points.shape[-1]
    middle = points.mean(axis=-2)
    spread = np.sqrt(((points - middle[..., None, :]) ** 2).mean(axis=(-2, -1)))
    to = np.zeros((*points.shape[:-2], k + 1, k + 1))
    to[..., range(k), range(k)] = 1 / spread[..., None]
    to[..., :k, k] = -middle / spread[..., None]
    to[..., k, k] = 1.0
    return (points - middle[..., None, :]) / spread[..., None, None], to
