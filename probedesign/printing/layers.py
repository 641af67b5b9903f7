"""Layers of a part in its printing orientation: overhangs, bridges, islands, cups and trapped volumes.

The part stands on the platform and grows along z. Each layer is a raster of material. What a layer adds beyond the
layer below, farther than a surface of the least angle to the horizontal reaches, hangs: it is a bridge if it lies
between two supported places of the same layer, otherwise an overhang. A void that is connected to the outside only
through layers that are not printed yet is a cup: suction pulls at it when the layer is peeled off.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

Mask = NDArray[np.bool_]
Interior = Callable[[NDArray[np.float64], NDArray[np.float64], float], Mask]
"""Return which points (x, y) at height z lie in the part; all in one unit of length."""
MIN_ANGLE_DEG = 19.0
"""Least angle of an unsupported surface to the horizontal. Source: Formlabs' design guide."""
ALONG = ((1, 0), (0, 1), (1, 1), (1, -1))
"""Directions in which bridges are sought, in pixels."""


@dataclass(frozen=True)
class LayerReport:
    """What the layers of a part show, in millimetres."""

    overhang: float  #: longest horizontal overhang that nothing carries.
    overhang_z: float  #: its height above the platform.
    bridge: float  #: longest bridge, between two supported places.
    hanging_area: float  #: largest area of a layer's overhangs that are longer than the limit [mm²].
    datum_area: float  #: the same on faces that carry a dimension [mm²].
    islands: int  #: number of places that begin in mid-air.
    cup_d: float  #: diameter of the largest circle in a cup.
    trapped: float  #: volume that is enclosed on all sides [mm³].


def examine_layers(
    interior: Interior, size: tuple[float, float], datums: tuple[float, ...], max_overhang: float,
    max_bridge: float, pixel: float, layer: float,
) -> LayerReport:  # fmt: skip
    """Return what the layers of a part show.

    Args:
        interior: of the part on the platform, z = 0, about the axis x = y = 0 [mm].
        size: greatest distance from the axis, and height [mm].
        datums: heights of the downward faces that carry a dimension [mm].
        max_overhang, max_bridge: lengths that print without supports [mm].
        pixel, layer: width of a pixel and height of a layer of the raster [mm].
    """
    reach = pixel * (math.ceil(size[0] / pixel) + 2)
    grid = np.arange(-reach + pixel / 2, reach, pixel)
    x, y = np.meshgrid(grid, grid, indexing="ij")
    heights = np.arange(layer / 2, size[1], layer)
    layers, tops = [interior(x, y, float(heights[0]))], [float(heights[0])]
    for z in heights[1:]:
        solid = interior(x, y, float(z))
        if not np.array_equal(solid, layers[-1]):  # equal layers hang nowhere and close nothing
            layers.append(solid)
            tops.append(float(z))
    volume = np.stack(layers)
    # A layer may reach so far beyond the one below. What it reaches beyond is carried on to the next layers.
    reach_of_layer = layer / math.tan(math.radians(MIN_ANGLE_DEG))
    overhang = overhang_z = bridge = area = datum_area = 0.0
    islands = 0
    beyond = np.zeros(x.shape)  # overhang of each pixel of the layer below
    for below, solid, z, rise in zip(layers, layers[1:], tops[1:], np.diff(tops), strict=False):
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
            if any(abs(z - layer / 2 - d) <= layer for d in datums):
                datum_area = max(datum_area, excess)
    return LayerReport(
        overhang, overhang_z, bridge, area, datum_area, islands, _largest_cup(volume, pixel),
        _trapped(volume, np.diff([*tops, float(heights[-1]) + layer])) * pixel**2,
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
