"""Triangles to pixels, without a graphics card, a screen or a driver: one depth buffer, one pass that shades it.

Filling triangles is compiled; all else is arrays of pixels.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from probedesign.frames import Array

NOBODY = -1
INK = 0.12
"""Brightness of an outline."""
CREASE_COS = 0.80
"""Faces that meet at more than 37° are told apart by a line; facets of one round face meet at 3°."""
STEP_PX = 6.0
"""A jump in depth of that many pixels' width, along a face seen at a slant, is an outline too."""
# From the upper left in front, in axes of the picture: right, up, towards the eye (chosen by eye).
LIGHT = (-0.40, 0.58, 0.71)
AMBIENT, DIRECT = 0.58, 0.50


def rasterised(
    corners: Array,
    normals: Array,
    owners: NDArray[np.int64],
    colours: Array,
    size: tuple[int, int],
    fine: int,
) -> tuple[NDArray[np.uint8], NDArray[np.int16]]:
    """A picture of triangles on white.

    Args:
        corners: x to the right, y down, depth towards the eye, all in pixels, (m, 3, 3).
        normals: outward unit normals at the corners, in axes right, up, towards the eye, (m, 3, 3).
        owners: which body each triangle belongs to, (m,).
        colours: red, green, blue 0 ... 1 of each body, (n, 3).
        size: width and height [px].
        fine: samples along each side of a pixel.

    Returns:
        Red, green, blue, (height, width, 3), and the body seen at each pixel or `NOBODY`, (height, width).
    """
    width, height = size[0] * fine, size[1] * fine
    depth = np.full((height, width), -np.inf, dtype=np.float32)
    owner = np.full((height, width), NOBODY, dtype=np.int16)
    triangle = np.zeros((height, width), dtype=np.int32)
    planes, first, last = _planes(corners * fine)
    _fill(planes, first, last, owners, depth, owner, triangle)
    drawn = owner != NOBODY
    normal = np.zeros((height, width, 3), dtype=np.float32)
    normal[drawn] = _normals(planes, normals, triangle, drawn)
    light = AMBIENT + DIRECT * np.maximum(normal[drawn] @ np.array(LIGHT, dtype=np.float32), 0.0)
    shaded = np.ones((height, width, 3), dtype=np.float32)
    shaded[drawn] = np.minimum(light[:, None] * colours.astype(np.float32)[owner[drawn]], 1.0)
    shaded[_outlines(depth, normal, owner, fine)] = INK
    total = sum(shaded[i::fine, j::fine] for i in range(fine) for j in range(fine))
    return np.round(255.0 / fine**2 * total).astype(np.uint8), owner[fine // 2 :: fine, fine // 2 :: fine]


def _normals(
    planes: Array, normals: Array, triangle: NDArray[np.int32], drawn: NDArray[np.bool_]
) -> NDArray[np.float32]:
    """At the drawn samples, between the corners' normals of the triangle seen there, (n, 3)."""
    a = normals[:, 0]
    shares = np.einsum(
        "tij,tik->tjk", planes[:, :2], normals[:, 1:] - a[:, None]
    )  # value at 0, along x, along y
    shares[:, 0] += a
    y, x = np.nonzero(drawn)
    at = shares.astype(np.float32)[triangle[drawn]]
    at[:, 0] += at[:, 1] * x[:, None].astype(np.float32) + at[:, 2] * y[:, None].astype(np.float32)
    found: NDArray[np.float32] = at[:, 0]
    return found


def _outlines(
    depth: NDArray[np.float32], normal: NDArray[np.float32], owner: NDArray[np.int16], fine: int
) -> NDArray[np.bool_]:
    """Samples beside which another body, another face or a step in depth begins."""
    ink = np.zeros(depth.shape, dtype=bool)
    reach = max(1, fine // 2)
    for near, far in (
        (np.s_[:, :-reach], np.s_[:, reach:]),
        (np.s_[:-reach], np.s_[reach:]),
    ):
        seen = (owner[near] != NOBODY) & (owner[near] == owner[far])
        cos = np.einsum("yxk,yxk->yx", normal[near], normal[far])
        slant = np.maximum(np.maximum(np.abs(normal[near][..., 2]), np.abs(normal[far][..., 2])), 0.1)
        with np.errstate(invalid="ignore"):  # paper is infinitely far
            step = np.abs(depth[near] - depth[far]) > STEP_PX * fine / slant
        ink[near] |= (owner[near] != owner[far]) | (seen & ((cos < CREASE_COS) | step))
    return ink


@njit(cache=True, error_model="numpy")
def _fill(planes, first, last, owners, depth, owner, triangle):  # type: ignore[no-untyped-def]
    """Keep, at each sample, the triangle that is nearest to the eye.

    Args:
        planes: of each triangle, corner b's share, corner c's share and depth as value at (0, 0), slope along x,
            slope along y, (m, 3, 3).
        first, last: rows that each triangle touches, (m,).
        owners: as for `rasterised`.
        depth, owner, triangle: what is seen so far at each sample, (height, width); changed in place.
    """
    height, width = depth.shape
    for t in range(len(planes)):
        bx, cx, zx = planes[t, 0, 1], planes[t, 1, 1], planes[t, 2, 1]
        ax = -bx - cx
        for y in range(max(0, first[t]), min(height - 1, last[t]) + 1):
            b0 = planes[t, 0, 0] + planes[t, 0, 2] * y
            c0 = planes[t, 1, 0] + planes[t, 1, 2] * y
            z0 = planes[t, 2, 0] + planes[t, 2, 2] * y
            a0 = 1.0 - b0 - c0
            if (bx == 0.0 and b0 < 0.0) or (cx == 0.0 and c0 < 0.0) or (ax == 0.0 and a0 < 0.0):
                continue
            # No corner's share is negative from `left` to `right`.
            left = max(-b0 / bx if bx > 0.0 else 0.0, -c0 / cx if cx > 0.0 else 0.0)
            left = max(left, -a0 / ax if ax > 0.0 else 0.0, 0.0)
            right = min(-b0 / bx if bx < 0.0 else width - 1.0, -c0 / cx if cx < 0.0 else width - 1.0)
            right = min(right, -a0 / ax if ax < 0.0 else width - 1.0, width - 1.0)
            for x in range(int(np.ceil(left)), int(right) + 1):
                z = z0 + zx * x
                if z > depth[y, x]:
                    depth[y, x] = z
                    owner[y, x] = owners[t]
                    triangle[y, x] = t


def _planes(corners: Array) -> tuple[Array, NDArray[np.int64], NDArray[np.int64]]:
    """What `_fill` takes of each triangle; one that is seen edge-on touches no row."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    ab, ac = b - a, c - a
    area = ab[:, 0] * ac[:, 1] - ac[:, 0] * ab[:, 1]
    flat = np.abs(area) < 1e-9
    area = np.where(flat, 1.0, area)
    planes = np.empty((len(corners), 3, 3))
    planes[:, 0, 1], planes[:, 0, 2] = ac[:, 1] / area, -ac[:, 0] / area
    planes[:, 1, 1], planes[:, 1, 2] = -ab[:, 1] / area, ab[:, 0] / area
    planes[:, :2, 0] = -(planes[:, :2, 1] * a[:, :1] + planes[:, :2, 2] * a[:, 1:2])
    planes[:, 2] = planes[:, 0] * ab[:, 2:] + planes[:, 1] * ac[:, 2:]
    planes[:, 2, 0] += a[:, 2]
    rows = corners[:, :, 1]
    first, last = np.ceil(rows.min(axis=1)).astype(int), np.floor(rows.max(axis=1)).astype(int)
    return planes, first, np.where(flat, first - 1, last)
