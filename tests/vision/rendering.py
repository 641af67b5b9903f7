"""Photographs of a dotted probe, rendered for the tests of the detection of dots.

The surface is drawn in facets by OpenCV at a finer resolution; the lens' blur, shot noise and read noise are added. The
appearance is assumed throughout; positions are exact.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from probedesign.core.frames import Array
from probedesign.simulation.ground_truth import SimulatedTest
from probedesign.simulation.stereo_rig import StereoRig
from probedesign.vision.camera import Camera

Picture = NDArray[np.uint8]
DOT_RATIO, MAX_DOT = 0.45, 3e-3  # diameter of a dot over that of the probe, and its largest value [m]
FINE = 4  # points along each side of a pixel
_AROUND = np.linspace(0.0, 2.0 * np.pi, 73)  # angles of the facets' corners and of those of a dot [rad]
_SHIFT = 8  # bits of the fraction of a corner's coordinates
_MOUNT = 0.012  # length of the mount below the base [m]


@dataclass(frozen=True)
class PaintedDots:
    """Dots painted on a tube."""

    s: Array  #: arclength of each centre from the tube's start [m], (m,).
    outward_world: Array  #: direction from the axis to its side, not necessarily a normal, (m, 3).
    diameter: Array  #: of each, measured along the surface [m], (m,).


@dataclass(frozen=True)
class SurfaceTube:
    """Surface of a bent probe: a tube about a polygon of points."""

    p_world: Array  #: centreline from base to tip [m], dense enough that a chord is its arc, (k, 3).
    diameter: Array  #: there [m], (k,).

    @cached_property
    def s(self) -> Array:
        """Arclength of the centreline's points [m], (k,)."""
        return np.append(0.0, np.cumsum(np.linalg.norm(np.diff(self.p_world, axis=0), axis=1)))

    @cached_property
    def tangents_world(self) -> Array:
        """Unit tangents at the points, (k, 3)."""
        tangents = np.gradient(self.p_world, self.s, axis=0)
        return np.asarray(tangents / np.linalg.norm(tangents, axis=1, keepdims=True))

    def at(self, s: Array) -> tuple[Array, Array, Array]:
        """Return centre (..., 3), tangent (..., 3) and radius (...) at arclengths within the tube."""
        values = np.column_stack([self.p_world, self.tangents_world, self.diameter / 2])
        row = np.stack([np.interp(s, self.s, column) for column in values.T], axis=-1)
        return row[..., :3], row[..., 3:6], row[..., 6]

    def surface(self, s: Array, outward: Array, angle: Array) -> tuple[Array, Array]:
        """Return points of the surface (m, n, 3) and their directions from the axis.

        Args:
            s: arclengths [m], (m, n).
            outward: directions about which the angles count, (m, 1, 3).
            angle: about the tangent [rad], (m, n).
        """
        centre, tangent, radius = self.at(s)
        side = _across(outward, tangent)
        side = np.cos(angle)[..., None] * side + np.sin(angle)[..., None] * np.cross(tangent, side)
        return centre + radius[..., None] * side, side

    def dot_positions(self, dots: PaintedDots) -> Array:
        """Return the centres of dots on the surface [m], (m, 3)."""
        at = dots.s[:, None]
        return self.surface(at, dots.outward_world[:, None], np.zeros_like(at))[0][:, 0]


def _across(vectors: Array, tangent: Array) -> Array:
    across = vectors - np.sum(vectors * tangent, axis=-1, keepdims=True) * tangent
    return np.asarray(across / np.linalg.norm(across, axis=-1, keepdims=True))


@dataclass(frozen=True)
class RenderStyle:
    """Appearance of a photograph; greys 0 ... 1 are albedos."""

    probe: float = 0.75  #: probe, dot, background, mount: greys.
    dot: float = 0.12
    background: float = 0.28
    mount: float = 0.45
    light_world: tuple[float, float, float] = (-0.3, -0.6, 0.75)  #: direction towards the lamp.
    ambient: float = 0.45  #: fraction of ambient light.
    gloss: float = 0.12  #: strength of the highlight.
    mottle: float = 0.03  #: unevenness of the probe and the background.
    clutter: int = 6  #: number of round dark objects in the background, which are not dots.
    blur_px: float = 0.8  #: standard deviation of the lens' blur [px].
    #: standard deviation of a dark pixel in grey levels of 255; a bright one has shot noise as well.
    noise: float = 1.5
    full_well: float = 10_000.0  #: electrons of a white pixel, which determine the shot noise.
    seed: int = 0  #: of all random numbers.


def render(
    camera: Camera, probe: SurfaceTube, dots: PaintedDots, size_px: tuple[int, int], style: RenderStyle | None = None
) -> Picture:
    """Render a photograph of a dotted probe in its mount, grey levels (height, width); OpenCV must be installed.

    The whole probe must lie in front of the camera; one that crosses itself in the picture is not rendered correctly.
    """
    import cv2

    style = style or RenderStyle()
    rng = np.random.default_rng(style.seed)
    picture = _background(size_px, style, rng)
    mount = _mount_of(probe)
    drawn = [_facets(camera, mount, style.mount, style, rng), _facets(camera, probe, style.probe, style, rng)]
    seen = np.concatenate([corners for corners, _ in drawn]).reshape(-1, 2)
    low = np.clip(np.floor(seen.min(axis=0)).astype(int), 0, size_px)
    high = np.clip(np.ceil(seen.max(axis=0)).astype(int) + 1, 0, size_px)
    width, height = high - low
    shade = np.zeros((height * FINE, width * FINE, 3), dtype=np.float32)  # diffuse light, highlight, coverage
    ink = np.zeros(shade.shape[:2], dtype=np.uint8)

    def fixed(corners: Array) -> NDArray[np.int32]:
        return np.asarray(np.round(((corners - low + 0.5) * FINE - 0.5) * 2**_SHIFT), dtype=np.int32)

    for corners, lights in drawn:
        for facet, light in zip(fixed(corners), lights.tolist(), strict=True):
            cv2.fillConvexPoly(shade, facet, light, shift=_SHIFT)
    around = np.tile(_AROUND[:-1], (len(dots.s), 1))
    s = np.clip(dots.s[:, None] + 0.5 * dots.diameter[:, None] * np.cos(around), 0.0, probe.s[-1])
    angle = 0.5 * dots.diameter[:, None] * np.sin(around) / probe.at(s)[2]
    for points, sides in zip(*probe.surface(s, dots.outward_world[:, None], angle), strict=True):
        visible = points[np.sum((camera.p_world - points) * sides, axis=1) > 0.0]
        if len(visible) > 2:
            cv2.fillPoly(ink, [fixed(camera.project(visible))], 1, shift=_SHIFT)
    shade[..., 0] *= np.where(ink, style.dot / style.probe, 1.0)
    diffuse, gloss, coverage = shade.reshape(height, FINE, width, FINE, 3).mean(axis=(1, 3)).transpose(2, 0, 1)
    window = picture[low[1] : high[1], low[0] : high[0]]  # a view
    window[:] = (1.0 - coverage) * window + diffuse + gloss
    return exposed(picture, style, rng)


def _facets(
    camera: Camera, tube: SurfaceTube, grey: float, style: RenderStyle, rng: np.random.Generator
) -> tuple[Array, Array]:
    streaks = style.mottle * gaussian_filter(rng.normal(size=2000), 3.0) * 3.0
    p, tangent, s = tube.p_world[:, None], tube.tangents_world[:, None], np.pad(tube.s[:-1], (1, 1), "edge")
    around, n = np.tile(_AROUND, (len(p), 1)), len(_AROUND) - 1
    points, sides = tube.surface(np.tile(tube.s[:, None], n + 1), camera.p_world - p, around)
    points = np.concatenate([np.tile(p[:1], (n + 1, 1)), points, np.tile(p[-1:], (n + 1, 1))])  # with the flat ends
    quads = np.stack([points[:-1, :-1], points[1:, :-1], points[1:, 1:], points[:-1, 1:]], axis=2).reshape(-1, 4, 3)
    normal = sides - np.gradient(tube.diameter / 2, tube.s)[:, None, None] * tangent
    normal = np.concatenate([np.tile(-tangent[:1], (n, 1)), normal[:-1, :-1] + normal[1:, 1:],
                             np.tile(tangent[-1:], (n, 1))]).reshape(-1, 3)  # fmt: skip
    albedo = np.repeat(grey * (1.0 + np.interp(s, np.linspace(0.0, tube.s[-1], len(streaks)), streaks)), n)
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    rays = quads.mean(axis=1) - camera.p_world
    distance = np.linalg.norm(rays, axis=1)
    rays /= distance[:, None]
    lamp = np.array(style.light_world) / np.linalg.norm(style.light_world)
    half = lamp - rays
    half /= np.linalg.norm(half, axis=1)[:, None]
    diffuse = albedo * (style.ambient + (1 - style.ambient) * np.clip(normal @ lamp, 0.0, None))
    gloss = style.gloss * np.clip(np.sum(normal * half, axis=1), 0.0, None) ** 30
    lights = np.column_stack([diffuse, gloss, np.ones(len(quads))])
    order = np.argsort(-distance)
    order = order[np.sum(normal * rays, axis=1)[order] < 0.0]
    return camera.project(quads[order].reshape(-1, 3)).reshape(-1, 4, 2), lights[order]


def _background(size_px: tuple[int, int], style: RenderStyle, rng: np.random.Generator) -> Array:
    width, height = size_px
    v, u = np.mgrid[0:height, 0:width]
    rough = gaussian_filter(rng.normal(size=(height // 8 + 2, width // 8 + 2)), 4.0) * 10.0
    wall = style.background * (1 + 0.2 * (u / width - 0.5) - 0.2 * (v / height - 0.5))
    wall *= 1 + style.mottle * np.kron(rough, np.ones((8, 8)))[:height, :width]
    for _ in range(style.clutter):
        centre, radius = rng.uniform((0, 0), size_px), rng.uniform(3, 12)
        edge = np.clip(radius + 0.5 - np.hypot(u - centre[0], v - centre[1]), 0.0, 1.0)
        wall = wall * (1 - 0.6 * edge)
    return np.asarray(wall)


def _mount_of(probe: SurfaceTube) -> SurfaceTube:
    back = probe.p_world[0] - np.linspace(_MOUNT, 0.0, 60)[:, None] * probe.tangents_world[0]
    return SurfaceTube(back, np.full(60, 2 * probe.diameter[0]))


def exposed(picture: Array, style: RenderStyle, rng: np.random.Generator) -> Picture:
    """Return the picture of light 0 ... 1 (height, width) with the lens' blur and the sensor's noise."""
    light = np.clip(gaussian_filter(picture, style.blur_px), 0.0, None)
    std = np.hypot(style.noise / 255, np.sqrt(light / style.full_well))
    return np.asarray(np.clip(np.round(255 * (light + std * rng.normal(size=light.shape))), 0, 255), dtype=np.uint8)


def tube_of(rig: StereoRig, test: SimulatedTest) -> SurfaceTube:
    """Return the surface of the bent probe in the world."""
    s = np.linspace(0.0, rig.truth.rod.length, 400)
    return SurfaceTube(test.bench.to_world(test.equilibrium.p_at(s)), 2.0 * rig.truth.rod.radius_at(s))


def dots_of(rig: StereoRig, test: SimulatedTest) -> PaintedDots:
    """Return the dots on the bent probe."""
    _, outward, radius = rig.sections(test)
    return PaintedDots(rig.marker_s, outward, np.minimum(2.0 * DOT_RATIO * radius, MAX_DOT))
