"""Shaded pictures of parts: bodies, a camera, a PNG. The same bodies give the same bytes on every run."""

import io
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import trimesh
from numpy.typing import NDArray
from PIL import Image

from probedesign.cad.assembly import Part
from probedesign.cad.mesh import Mesh
from probedesign.cad.raster import rasterised
from probedesign.frames import Array
from probedesign.units import MM

SMOOTH_RAD = 0.5
"""Facets that meet at less are one round face."""
SAMPLES = 2
MARGIN = 0.03
"""Of the picture's larger side, left free all around."""
PALE = 0.3
"""Of its colour, what a part keeps that was there before."""
COARSE_MM, COARSE_RAD = 0.02, 0.3
"""Facets of what is shown but not printed."""


@dataclass(frozen=True)
class Body:
    """One part as it is shown.

    Attributes:
        corners: of its triangles in the sensor frame [mm], (m, 3, 3).
        normals: outward unit normals there, (m, 3, 3).
        colour: red, green, blue 0 ... 1.
    """

    corners: Array
    normals: Array
    colour: tuple[float, float, float]

    def lifted(self, height: float) -> "Body":
        """The same, that much higher along z [mm]."""
        return replace(self, corners=self.corners + np.array([0.0, 0.0, height]))

    def paled(self) -> "Body":
        """The same in a paler colour."""
        red, green, blue = (1.0 - PALE * (1.0 - c) for c in self.colour)
        return replace(self, colour=(red, green, blue))

    @property
    def span(self) -> tuple[float, float]:
        """Its lowest and highest z [mm]."""
        z = self.corners[..., 2]
        return float(z.min()), float(z.max())


def body_of(part: Part, mesh: Mesh | None = None) -> Body:
    """A part in its place; of its own mesh where there is one."""
    if mesh is None:
        # Of a copy: a shape keeps its facets, and the kernel would measure them instead of its surfaces.
        points, faces = part.shape.copy().tessellate(COARSE_MM, COARSE_RAD)
        surface = trimesh.Trimesh([p.toTuple() for p in points], faces)
    else:
        surface = trimesh.Trimesh(mesh.vertices.astype(float), mesh.triangles)
    smooth = trimesh.graph.smooth_shade(surface, angle=SMOOTH_RAD)
    R, p = part.T_sensor_part[:3, :3], part.T_sensor_part[:3, 3] / MM
    corners, normals = smooth.vertices[smooth.faces], smooth.vertex_normals[smooth.faces]
    return Body(corners @ R.T + p, normals @ R.T, part.color)


@dataclass(frozen=True)
class Camera:
    """Looks at the axis from one side, without perspective; z of the sensor frame points up.

    Attributes:
        azimuth_deg: where it stands, about +z from +x.
        elevation_deg: how far above the horizontal.
    """

    azimuth_deg: float = 70.0
    elevation_deg: float = 22.0

    @property
    def axes(self) -> Array:
        """Rows: right, up, towards the eye, in the sensor frame, (3, 3)."""
        a, e = np.radians([self.azimuth_deg, self.elevation_deg])
        right = [-np.sin(a), np.cos(a), 0.0]
        up = [-np.sin(e) * np.cos(a), -np.sin(e) * np.sin(a), np.cos(e)]
        return np.array([right, up, np.cross(right, up)])


@dataclass(frozen=True)
class View:
    """A camera that fits its bodies into a picture.

    Attributes:
        axes: of the camera.
        centre: of the picture, along right and up [mm], (2,).
        scale: [px/mm].
        size: width and height [px].
    """

    axes: Array
    centre: Array
    scale: float
    size: tuple[int, int]

    def pixels(self, points: Array) -> Array:
        """x to the right, y down, depth towards the eye [px], of points [mm] (..., 3)."""
        seen = points @ self.axes.T
        x = (seen[..., 0] - self.centre[0]) * self.scale + self.size[0] / 2
        y = (self.centre[1] - seen[..., 1]) * self.scale + self.size[1] / 2
        return np.stack([x, y, seen[..., 2] * self.scale], axis=-1)


def view_of(bodies: Sequence[Body], camera: Camera, largest: tuple[int, int], below: float = np.inf) -> View:
    """The view that shows the bodies as large as fits, and a picture no larger than that needs.

    Args:
        bodies: to be shown.
        camera: that looks at them.
        largest: width and height [px].
        below: what is higher than this z may be cut off [mm].
    """
    points = np.concatenate([body.corners.reshape(-1, 3) for body in bodies])
    seen = points[points[:, 2] <= below] @ camera.axes.T
    low, high = seen[:, :2].min(axis=0), seen[:, :2].max(axis=0)
    margin = MARGIN * max(largest)
    scale = float(min((np.array(largest) - 2 * margin) / (high - low)))
    width, height = np.ceil((high - low) * scale + 2 * margin).astype(int)
    return View(camera.axes, (low + high) / 2, scale, (int(width), int(height)))


def photographed(bodies: Sequence[Body], view: View) -> tuple[NDArray[np.uint8], NDArray[np.int16]]:
    """The bodies in that view.

    Returns:
        Red, green, blue, (height, width, 3), and which body each pixel shows, -1 for none, (height, width).
    """
    counts = [len(body.corners) for body in bodies]
    return rasterised(
        view.pixels(np.concatenate([body.corners for body in bodies])),
        np.concatenate([body.normals for body in bodies]) @ view.axes.T,
        np.repeat(np.arange(len(bodies)), counts),
        np.array([body.colour for body in bodies]),
        view.size,
        SAMPLES,
    )


def png_bytes(pixels: NDArray[np.uint8], colours: int = 128) -> bytes:
    """As a PNG of that many colours: a shaded part needs no more, and the file is a third as large."""
    picture, file = Image.fromarray(pixels), io.BytesIO()
    picture.quantize(colours, dither=Image.Dither.NONE).save(file, "png", optimize=True)
    return file.getvalue()


def preview(
    bodies: Sequence[Body], largest: tuple[int, int], camera: Camera = Camera(), below: float = np.inf
) -> bytes:
    """A PNG of the bodies; the arguments are those of `view_of`."""
    pixels, _ = photographed(bodies, view_of(bodies, camera, largest, below))
    return png_bytes(pixels)
