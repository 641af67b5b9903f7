"""Shaded pictures of parts, rendered without a graphics card, a display or a driver.

Bodies and a camera give a PNG, the same bytes on every run. Filling and shading of triangles are compiled.
"""

import io
from collections.abc import Sequence
from dataclasses import dataclass, replace

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


@njit(cache=True, error_model="numpy")
def _shade(slopes, colours, depth, owner, triangle, fine, normal, sums):  # type: ignore[no-untyped-def]  # noqa: C901
    """Add the colour and opacity of each sample to its pixel: shaded, an outline, or nothing.

    Args:
        slopes: normal of each triangle at (0, 0) and its slopes along x and along y, (m, 3, 3).
        colours: of each body, with its opacity, (n, 4).
        depth, owner, triangle: of each sample, from `_fill`, (height, width).
        fine: samples along each side of a pixel.
        normal: of each sample, (height, width, 3); changed in place.
        sums: of each pixel, (height / fine, width / fine, 4); changed in place.
    """
    height, width = owner.shape
    for y in range(height):
        for x in range(width):
            if owner[y, x] != BACKGROUND:
                t = triangle[y, x]
                for k in range(3):
                    normal[y, x, k] = slopes[t, 0, k] + slopes[t, 1, k] * x + slopes[t, 2, k] * y
    reach = max(1, fine // 2)
    for y in range(height):
        for x in range(width):
            who = owner[y, x]
            ink = False
            for dy, dx in ((0, reach), (reach, 0)):  # next to another body, another face or a depth step
                v, u = y + dy, x + dx
                if v < height and u < width:
                    if owner[v, u] != who:
                        ink = True
                    elif who != BACKGROUND:
                        cos = 0.0
                        for k in range(3):
                            cos += normal[y, x, k] * normal[v, u, k]
                        slant = max(abs(normal[y, x, 2]), abs(normal[v, u, 2]), 0.1)
                        step = abs(depth[y, x] - depth[v, u]) > STEP_PX * fine / slant
                        ink = ink or cos < CREASE_COS or step
            light = 1.0
            if who != BACKGROUND and not ink:
                light = AMBIENT
                for k in range(3):
                    light += DIRECT * normal[y, x, k] * LIGHT[k]
                light = max(light, AMBIENT)
            if ink or who != BACKGROUND:
                alpha = 1.0 if ink else colours[who, 3]
                for k in range(3):
                    sums[y // fine, x // fine, k] += alpha * (INK if ink else min(light * colours[who, k], 1.0))
                sums[y // fine, x // fine, 3] += alpha


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
SAMPLES = 2  #: Samples along each side of a pixel.
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


@dataclass(frozen=True)
class OrthographicCamera:
    """A camera without perspective that looks at the axis; z of the sensor frame points up."""

    azimuth_deg: float = 70.0  #: of the camera, about +z from +x.
    elevation_deg: float = 22.0  #: of the camera above the horizontal.

    @property
    def axes(self) -> Array:
        """Return the rows right, up, towards the eye, in the sensor frame, (3, 3)."""
        a, e = np.radians([self.azimuth_deg, self.elevation_deg])
        right = [-np.sin(a), np.cos(a), 0.0]
        up = [-np.sin(e) * np.cos(a), -np.sin(e) * np.sin(a), np.cos(e)]
        return np.array([right, up, np.cross(right, up)])


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
    bodies: Sequence[RenderBody], camera: OrthographicCamera, largest: tuple[int, int], below: float = np.inf
) -> ImageView:
    """Return the view that shows the bodies as large as possible, in an image that is no larger than needed.

    Args:
        bodies: to be shown.
        camera: that looks at them.
        largest: width and height [px].
        below: points above this z may be cut off [mm].
    """
    points = np.concatenate([body.corners.reshape(-1, 3) for body in bodies])
    seen = points[points[:, 2] <= below] @ camera.axes.T
    low, high = seen[:, :2].min(axis=0), seen[:, :2].max(axis=0)
    margin = MARGIN * max(largest)
    scale = float(min((np.array(largest) - 2 * margin) / (high - low)))
    width, height = np.ceil((high - low) * scale + 2 * margin).astype(int)
    return ImageView(camera.axes, (low + high) / 2, scale, (int(width), int(height)))


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
    normal = np.zeros((height, width, 3), dtype=np.float32)
    sums = np.zeros((view.size[1], view.size[0], 4), dtype=np.float32)
    _shade(slopes, colours, depth, owner, triangle, SAMPLES, normal, sums)
    sums[..., :3] /= np.where(sums[..., 3:] > 0.0, sums[..., 3:], 1.0)
    sums[..., 3] /= SAMPLES**2
    middle = SAMPLES // 2
    return np.round(255.0 * sums).astype(np.uint8), owner[middle::SAMPLES, middle::SAMPLES]


def png_bytes(pixels: NDArray[np.uint8], paper: bool = False) -> bytes:
    """Return a PNG with a palette, on white paper or transparent: 255 colours suffice for shaded parts and make the
    file a third as large."""
    picture, file = Image.fromarray(pixels), io.BytesIO()
    if paper:
        picture = Image.alpha_composite(Image.new("RGBA", picture.size, "white"), picture).convert("RGB")
    picture.quantize(255, dither=Image.Dither.NONE).save(file, "png", optimize=True)
    return file.getvalue()


def render_png(bodies: Sequence[RenderBody], largest: tuple[int, int]) -> bytes:
    """Return a PNG of the bodies on white paper, no larger than a width and height."""
    return png_bytes(render_bodies(bodies, fit_view(bodies, OrthographicCamera(), largest))[0], paper=True)
