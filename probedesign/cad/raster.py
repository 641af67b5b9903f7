"""Triangles to pixels, without a graphics card, a screen or a driver: one depth buffer, one pass that shades it.

Compiled, since it visits every pixel; the only such loop in `cad`.
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
    normal = np.zeros((height, width, 3), dtype=np.float32)
    owner = np.full((height, width), NOBODY, dtype=np.int16)
    _fill(corners * fine, normals, owners, depth, normal, owner)
    linear = _shade(depth, normal, owner, np.asarray(colours, dtype=float), fine)
    return np.round(255.0 * linear).astype(np.uint8), owner[fine // 2 :: fine, fine // 2 :: fine]


@njit(cache=True)  # type: ignore[misc]
def _fill(corners, normals, owners, depth, normal, owner):  # type: ignore[no-untyped-def]
    """Keep, at each sample, what is nearest to the eye."""
    height, width = depth.shape
    for t in range(len(corners)):
        (xa, ya, za), (xb, yb, zb), (xc, yc, zc) = corners[t]
        area = (xb - xa) * (yc - ya) - (xc - xa) * (yb - ya)
        if area == 0.0:
            continue
        top, bottom = max(0, int(np.ceil(min(ya, yb, yc)))), min(height - 1, int(max(ya, yb, yc)))
        left, right = max(0, int(np.ceil(min(xa, xb, xc)))), min(width - 1, int(max(xa, xb, xc)))
        for y in range(top, bottom + 1):
            for x in range(left, right + 1):
                b = ((x - xa) * (yc - ya) - (xc - xa) * (y - ya)) / area
                c = ((xb - xa) * (y - ya) - (x - xa) * (yb - ya)) / area
                a = 1.0 - b - c
                z = a * za + b * zb + c * zc
                if a >= 0.0 and b >= 0.0 and c >= 0.0 and z > depth[y, x]:
                    depth[y, x], owner[y, x] = z, owners[t]
                    for k in range(3):
                        normal[y, x, k] = a * normals[t, 0, k] + b * normals[t, 1, k] + c * normals[t, 2, k]


@njit(cache=True)  # type: ignore[misc]
def _shade(depth, normal, owner, colours, fine):  # type: ignore[no-untyped-def]
    """Light every sample, ink the outlines, and average over each pixel."""
    height, width = depth.shape
    picture = np.zeros((height // fine, width // fine, 3))
    weight = 1.0 / (fine * fine)
    reach = max(1, fine // 2)
    for y in range(height):
        for x in range(width):
            inked = False
            for dy, dx in ((0, reach), (reach, 0)):
                v, u = min(y + dy, height - 1), min(x + dx, width - 1)
                inked = inked or _edge(depth, normal, owner, y, x, v, u, fine)
            who = owner[y, x]
            light = 1.0
            if who >= 0:
                toward = 0.0
                for k in range(3):
                    toward += normal[y, x, k] * LIGHT[k]
                light = AMBIENT + DIRECT * max(toward, 0.0)
            for k in range(3):
                value = min(1.0, light * (colours[who, k] if who >= 0 else 1.0))
                picture[y // fine, x // fine, k] += weight * (INK if inked else value)
    return picture


@njit(cache=True)  # type: ignore[misc]
def _edge(depth, normal, owner, y, x, v, u, fine):  # type: ignore[no-untyped-def]
    """Whether an outline runs between two neighbouring samples."""
    if owner[y, x] != owner[v, u]:
        return True
    if owner[y, x] < 0:
        return False
    cos = 0.0
    for k in range(3):
        cos += normal[y, x, k] * normal[v, u, k]
    slant = max(abs(normal[y, x, 2]), abs(normal[v, u, 2]), 0.1)
    return cos < CREASE_COS or abs(depth[y, x] - depth[v, u]) > STEP_PX * fine / slant
