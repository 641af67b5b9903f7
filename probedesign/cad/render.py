"""Shaded pictures of parts, rendered without a graphics card, a display or a driver.

Bodies and a camera give a PNG, the same bytes on every run. The filling of triangles is compiled.
"""

import io
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray
from PIL import Image
from trimesh.graph import smooth_shade

from probedesign.cad.mesh import facets_of
from probedesign.cad.model import CadPart
from probedesign.core.frames import Array
from probedesign.core.units import MM

BACKGROUND = -1
INK = 0.12  #: Brightness of an outline.
CREASE_COS = 0.80  #: Faces that meet at more than 37° are separated by a line; facets of one round face meet at 3°.
STEP_PX = 6.0  #: A depth step of this many pixels on an oblique face is drawn as an outline.
# From the upper left front, in image axes: right, up, towards the eye (chosen by eye).
LIGHT = (-0.40, 0.58, 0.71)
AMBIENT, DIRECT = 0.58, 0.50
SAMPLES = 2  #: Samples along each side of a pixel.


def _shaded(slopes: Array, colours: Array, depth: NDArray[Any], owner: NDArray[Any], triangle: NDArray[Any]) -> Array:
    """Return colour and opacity of each sample: shaded, an outline, or nothing, (height, width, 4).

    Args:
        slopes: normal of each triangle at (0, 0) and its slopes along x and along y, (m, 3, 3).
        colours: of each body, with its opacity, (n, 4).
        depth, owner, triangle: of each sample, from `_fill`, (height, width).
    """
    part = owner != BACKGROUND
    (y, x), plane = np.nonzero(part), slopes[triangle[part]]
    normal = np.zeros((*owner.shape, 3), dtype=np.float32)
    normal[part] = plane[:, 0] + plane[:, 1] * x[:, None] + plane[:, 2] * y[:, None]
    slant, ink = np.maximum(np.abs(normal[..., 2].astype(float)), 0.1), np.zeros(owner.shape, dtype=bool)
    for here, beside in ((np.s_[:-1], np.s_[1:]), (np.s_[:, :-1], np.s_[:, 1:])):  # other body, other face, depth step
        cos = (normal[here] * normal[beside]).sum(axis=2, dtype=float)
        with np.errstate(invalid="ignore"):  # of the background's infinite depths
            step = np.abs(depth[here] - depth[beside]) > STEP_PX * SAMPLES / np.maximum(slant[here], slant[beside])
        ink[here] |= (owner[here] != owner[beside]) | (part[here] & ((cos < CREASE_COS) | step))
    light = np.maximum(sum((DIRECT * normal[..., k].astype(float) * LIGHT[k] for k in range(3)), AMBIENT), AMBIENT)
    sample = np.zeros((*owner.shape, 4))
    sample[..., 3] = np.where(part, colours[owner, 3], 0.0)
    sample[..., :3] = sample[..., 3:] * np.minimum(light[..., None] * colours[owner, :3], 1.0)
    sample[ink] = (INK, INK, INK, 1.0)
    return sample


@njit(cache=True, error_model="numpy")
def _fill(planes, first, last, owners, depth, owner, triangle):  # type: ignore[no-untyped-def]  # numba infers the types
    """Keep, at each sample, the triangle nearest to the eye.

    Args:
        planes: per triangle, weights of corners b and c and depth, each as value at (0, 0), slope along x,
            slope along y, (m, 3, 3).
        first, last: rows that each triangle covers, (m,).
        owners: index of each triangle's body, (m,).
        depth, owner, triangle: nearest so far at each sample, (height, width); changed in place.
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
            # All weights are non-negative from `left` to `right`.
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
    """Return the planes and rows of each triangle for `_fill`; one seen edge-on covers no row."""
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


SMOOTH_RAD = 0.5  #: Facets that meet at a smaller angle are shaded as one round face.
MARGIN = 0.03  #: Free margin, as a share of the picture's larger side.
PALE = 0.3  #: Opacity of a part mounted earlier.


@dataclass(frozen=True)
class RenderBody:
    """The triangles of one part, for rendering."""

    corners: Array  #: of its triangles in the sensor frame [mm], (m, 3, 3).
    normals: Array  #: outward unit normals there, (m, 3, 3).
    colour: tuple[float, float, float]  #: red, green, blue 0 ... 1.
    opacity: float = 1.0  #: 0 ... 1; what is behind the body is hidden all the same.

    def translated(self, height: float) -> "RenderBody":
        """Return the body moved along z [mm]."""
        return replace(self, corners=self.corners + np.array([0.0, 0.0, height]))

    @property
    def span(self) -> tuple[float, float]:
        """Return its lowest and highest z [mm]."""
        z = self.corners[..., 2]
        return float(z.min()), float(z.max())


def render_body(part: CadPart) -> RenderBody:
    """Return a part at its position."""
    mesh = smooth_shade(facets_of(part.displayed), SMOOTH_RAD, facet_minarea=None)
    corners, normals = mesh.triangles, mesh.vertex_normals[mesh.faces]
    poses = part.Ts_sensor_piece.values()
    return RenderBody(
        np.concatenate([corners @ T[:3, :3].T + T[:3, 3] / MM for T in poses]),
        np.concatenate([normals @ T[:3, :3].T for T in poses]),
        part.color,
    )


def camera_axes(azimuth_deg: float, elevation_deg: float) -> Array:
    """Return the rows right, up, towards the eye of a camera without perspective, in the sensor frame, (3, 3).

    Args:
        azimuth_deg: of the camera, about +z from +x.
        elevation_deg: of the camera above the horizontal.
    """
    a, e = np.radians([azimuth_deg, elevation_deg])
    right = [-np.sin(a), np.cos(a), 0.0]
    up = [-np.sin(e) * np.cos(a), -np.sin(e) * np.sin(a), np.cos(e)]
    return np.array([right, up, np.cross(right, up)])


FROM_ABOVE = camera_axes(70.0, 22.0)  #: Camera of all pictures.


@dataclass(frozen=True)
class ImageView:
    """A camera with the position and scale of its image."""

    axes: Array  #: of the camera.
    centre: Array  #: of the picture, along right and up [mm], (2,).
    scale: float  #: [px/mm].
    size: tuple[int, int]  #: width and height [px].

    def pixels(self, points: Array) -> Array:
        """Return x to the right, y down and depth towards the eye [px] of points [mm] (..., 3)."""
        seen = points @ self.axes.T
        x = (seen[..., 0] - self.centre[0]) * self.scale + self.size[0] / 2
        y = (self.centre[1] - seen[..., 1]) * self.scale + self.size[1] / 2
        return np.stack([x, y, seen[..., 2] * self.scale], axis=-1)


def fit_view(
    bodies: Sequence[RenderBody], largest: tuple[int, int], below: float = np.inf, axes: Array = FROM_ABOVE
) -> ImageView:
    """Return the view that shows the bodies as large as possible, in an image that is no larger than needed.

    Args:
        bodies: to be shown.
        largest: width and height [px].
        below: points above this z may be cut off [mm].
        axes: of the camera, see `camera_axes`.
    """
    points = np.concatenate([body.corners.reshape(-1, 3) for body in bodies])
    seen = points[points[:, 2] <= below] @ axes.T
    low, high = seen[:, :2].min(axis=0), seen[:, :2].max(axis=0)
    margin = MARGIN * max(largest)
    scale = float(min((np.array(largest) - 2 * margin) / (high - low)))
    width, height = np.ceil((high - low) * scale + 2 * margin).astype(int)
    return ImageView(axes, (low + high) / 2, scale, (int(width), int(height)))


def render_bodies(bodies: Sequence[RenderBody], view: ImageView) -> tuple[NDArray[np.uint8], NDArray[np.int16]]:
    """Render the bodies on a transparent ground.

    Returns:
        Red, green, blue and opacity, (height, width, 4), and the index of each pixel's body or `BACKGROUND`,
        (height, width).
    """
    corners = view.pixels(np.concatenate([body.corners for body in bodies]))
    normals = np.concatenate([body.normals for body in bodies]) @ view.axes.T
    owners = np.repeat(np.arange(len(bodies)), [len(body.corners) for body in bodies])
    colours = np.array([(*body.colour, body.opacity) for body in bodies])
    width, height = view.size[0] * SAMPLES, view.size[1] * SAMPLES
    depth = np.full((height, width), -np.inf, dtype=np.float32)
    owner = np.full((height, width), BACKGROUND, dtype=np.int16)
    triangle = np.zeros((height, width), dtype=np.int32)
    planes, first, last = _planes(corners * SAMPLES)
    _fill(planes, first, last, owners, depth, owner, triangle)
    # normal at 0, its change along x and along y
    slopes = np.einsum("tij,tik->tjk", planes[:, :2], normals[:, 1:] - normals[:, :1])
    slopes[:, 0] += normals[:, 0]
    sample = _shaded(slopes, colours, depth, owner, triangle)
    sums = np.zeros((view.size[1], view.size[0], 4), dtype=np.float32)
    for row, column in np.ndindex(SAMPLES, SAMPLES):
        sums += sample[row::SAMPLES, column::SAMPLES]
    sums[..., :3] /= np.where(sums[..., 3:] > 0.0, sums[..., 3:], 1.0)
    sums[..., 3] /= SAMPLES**2
    middle = SAMPLES // 2
    return np.round(255.0 * sums).astype(np.uint8), owner[middle::SAMPLES, middle::SAMPLES]


def png_bytes(pixels: NDArray[np.uint8]) -> bytes:
    """Return a transparent PNG with a palette: 255 colours suffice for shaded parts and make the file a third as
    large."""
    picture, file = Image.fromarray(pixels), io.BytesIO()
    picture.quantize(255, dither=Image.Dither.NONE).save(file, "png", optimize=True)
    return file.getvalue()
