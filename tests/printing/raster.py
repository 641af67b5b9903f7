"""Layers of a part in its printing orientation: overhangs, bridges, islands, cups and trapped volumes.

The part stands on the platform and grows along z. Each layer is a raster of material. What a layer adds beyond the
layer below, farther than a surface of the least angle to the horizontal reaches, hangs: it is a bridge if it lies
between two supported places of the same layer, otherwise an overhang. A void that is connected to the outside only
through layers that are not printed yet is a cup: suction pulls at it when the layer is peeled off.
"""

import math
from dataclasses import dataclass

import numpy as np
import scipy
import trimesh
from numpy.typing import NDArray

Mask = NDArray[np.bool_]
MIN_ANGLE_DEG = 19.0  #: Least angle of an unsupported surface to the horizontal. Source: Formlabs' design guide.
ALONG = ((1, 0), (0, 1), (1, 1), (1, -1))  #: Directions in which bridges are sought, in pixels.


@dataclass(frozen=True)
class LayerReport:
    """What the layers of a part show, in millimetres."""

    overhang: float  #: longest horizontal overhang that nothing carries.
    overhang_z: float  #: its height above the platform.
    bridge: float  #: longest bridge, between two supported places.
    hanging_area: float  #: largest area of a layer's overhangs that are longer than the limit [mm²].
    islands: int  #: number of places that begin in mid-air.
    cup_d: float  #: diameter of the largest circle in a cup.
    trapped: float  #: volume that is enclosed on all sides [mm³].


def grid_of(reach: float, pixel: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the pixels' centres about the axis, beyond a distance `reach` from it, (n, n) each [mm]."""
    half = pixel * (math.ceil(reach / pixel) + 2)
    along = np.arange(-half + pixel / 2, half, pixel)
    return np.meshgrid(along, along, indexing="ij")


def layers_of_mesh(mesh: trimesh.Trimesh, pixel: float, layer: float) -> Mask:
    """Return the layers of a closed mesh that stands on z = 0, (k, n, n): a point is inside if the surface above it
    faces up once more often than down."""
    x, y = grid_of(float(np.abs(mesh.vertices[:, :2]).max()), pixel)
    first = x[0, 0]
    heights = np.arange(layer / 2, mesh.bounds[1, 2], layer)
    crossings = np.zeros((len(heights) + 1, *x.shape), dtype=np.int16)
    corners = mesh.triangles + np.array([1.7e-6, 3.1e-6, 0.0])  # no pixel's centre lies on an edge
    for a, b, c in corners:
        area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        low, high = np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)
        (i0, j0), (i1, j1) = np.ceil((low[:2] - first) / pixel).astype(int), np.floor((high[:2] - first) / pixel)
        i, j = np.arange(i0, int(i1) + 1), np.arange(j0, int(j1) + 1)
        if abs(area) < 1e-12 or not len(i) or not len(j):
            continue
        u, v = (x[i, 0] - a[0])[:, None], (y[0, j] - a[1])[None, :]
        beta = (u * (c[1] - a[1]) - v * (c[0] - a[0])) / area
        gamma = (v * (b[0] - a[0]) - u * (b[1] - a[1])) / area
        p, q = np.nonzero((beta >= 0.0) & (gamma >= 0.0) & (beta + gamma <= 1.0))
        z = a[2] + beta[p, q] * (b[2] - a[2]) + gamma[p, q] * (c[2] - a[2])
        np.add.at(crossings, (np.searchsorted(heights, z), i[p], j[q]), int(np.sign(area)))
    return np.cumsum(crossings[::-1], axis=0, dtype=np.int16)[::-1][1:] > 0


def examine_layers(solids: Mask, max_overhang: float, max_bridge: float, pixel: float, layer: float) -> LayerReport:
    """Return what the layers of a part on the platform show.

    Args:
        solids: material of each pixel of each layer, the lowest first, (k, n, n).
        max_overhang, max_bridge: lengths that print without supports [mm].
        pixel, layer: width of a pixel and height of a layer [mm].
    """
    changes = [0, *(k for k in range(1, len(solids)) if not np.array_equal(solids[k], solids[k - 1]))]
    volume = solids[changes]  # equal layers hang nowhere and close nothing
    tops = layer * (np.array(changes) + 0.5)
    # A layer may reach so far beyond the one below. What it reaches beyond is carried on to the next layers.
    reach_of_layer = layer / math.tan(math.radians(MIN_ANGLE_DEG))
    overhang = overhang_z = bridge = area = 0.0
    islands = 0
    beyond = np.zeros(volume[0].shape)  # overhang of each pixel of the layer below
    for below, solid, z, rise in zip(volume, volume[1:], tops[1:], np.diff(tops), strict=False):
        distance, nearest = scipy.ndimage.distance_transform_edt(~below, return_indices=True)
        beyond = np.maximum(beyond - (rise - layer) * reach_of_layer / layer, 0.0)  # equal layers between
        beyond = np.maximum(beyond[tuple(nearest)] + distance * pixel - reach_of_layer, 0.0) * solid
        parts, count = scipy.ndimage.label(solid)
        islands += count - len(np.unique(parts[solid & below]))
        hanging = beyond > pixel
        if not hanging.any():
            continue
        span = _spans(hanging, solid & ~hanging, max_bridge / pixel) * pixel
        bridged = hanging & (span <= max_bridge)
        if bridged.any():
            bridge = max(bridge, float(span[bridged].max()))
            to_bridge = scipy.ndimage.distance_transform_edt(~bridged) * pixel - reach_of_layer
            beyond = np.where(solid, np.minimum(beyond, np.maximum(to_bridge, 0.0)), 0.0)
        out = np.where(beyond > pixel, beyond + reach_of_layer, 0.0)
        longest = float(out.max())
        if longest > overhang:
            overhang, overhang_z = longest, float(z - layer / 2)
        if longest > max_overhang:
            excess = float((out > max_overhang).sum()) * pixel**2
            area = max(area, excess)
    return LayerReport(
        overhang, overhang_z, bridge, area, islands, _largest_cup(volume, pixel),
        _trapped(volume, np.diff([*tops, layer * (len(solids) + 0.5)])) * pixel**2,
    )  # fmt: skip


def _spans(hanging: Mask, supported: Mask, limit: float) -> NDArray[np.float64]:
    """Return the shortest way across each hanging pixel between two supported ones [pixels]; infinite if none."""
    best = np.full(hanging.shape, np.inf)
    for direction in ALONG:
        length = math.hypot(*direction)
        ways = [_steps(hanging, supported, sign, direction, int(limit / length) + 1) for sign in (1, -1)]
        best = np.minimum(best, (ways[0] + ways[1] - 1.0) * length)
    return np.where(hanging, best, np.inf)


def _steps(hanging: Mask, supported: Mask, sign: int, direction: tuple[int, int], limit: int) -> NDArray[np.float64]:
    """Return the number of steps from each hanging pixel through material to a supported one; infinite if none."""
    found = np.full(hanging.shape, np.inf)
    reached = supported.copy()
    shift = (-sign * direction[0], -sign * direction[1])
    for step in range(1, limit + 1):
        reached = np.roll(reached, shift, (0, 1)) & hanging & np.isinf(found)
        if not reached.any():
            break
        found[reached] = step
    return found


def _largest_cup(volume: Mask, pixel: float) -> float:
    """Return the diameter of the largest circle in a void that is closed while its layer is printed."""
    outside = np.zeros_like(volume[0])  # the platform closes the first layer's holes
    largest = 0.0
    for solid in volume:
        void = ~solid
        seeds = outside & void
        seeds[0, :] = seeds[-1, :] = seeds[:, 0] = seeds[:, -1] = True
        outside = scipy.ndimage.binary_propagation(seeds, mask=void)
        closed = void & ~outside
        if closed.any():
            largest = max(largest, 2.0 * float(scipy.ndimage.distance_transform_edt(closed).max()) * pixel)
    return largest


def _trapped(volume: Mask, thickness: NDArray[np.float64]) -> float:
    """Return the void that no way connects to the outside once the part is off the platform [pixels × mm]."""
    padded = np.pad(~volume, 1, constant_values=True)
    labels, _ = scipy.ndimage.label(padded)
    closed = (padded & (labels != labels[0, 0, 0]))[1:-1]
    return float(closed.sum(axis=(1, 2)) @ thickness)
