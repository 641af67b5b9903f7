"""Simulated stereo rig: two cameras, control points, the probe's markers, and rendered photographs of them.

The surface is drawn in facets by OpenCV at a finer resolution; the lens' blur, shot noise and read noise are added. The
appearance is assumed throughout; positions are exact.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from probedesign.core.frames import Array
from probedesign.simulation.ground_truth import GroundTruth, SimulatedTest, marker_arclengths
from probedesign.vision import require_opencv
from probedesign.vision.camera import Camera
from probedesign.vision.markers import write_png

Picture = NDArray[np.uint8]
SIZE_PX = (1600, 1200)
#: Picture and focal length of a compact camera, reduced to keep examples small (assumed); the paper's has 20
#: megapixels.
FOCAL_PX = 2200.0
#: Coefficients of distortion by the kind of calibration, as many as it determines by default (assumed: a barrel of 0.8
#: % at the edge of the picture).
LENS = {"box": (), "files": (-0.08, 0.05, 5e-4, -5e-4)}
#: Of each camera to its side: 70° between the lines of sight give depth about the precision of the other axes.
AZIMUTH = math.radians(35.0)
ELEVATION = math.radians(20.0)
FIELD_OF_VIEW = 1.35  #: Width of the field of view, over the largest extent of the box.
#: Standard deviations of clicked markers and control points (assumed: a person, a mouse, a dot of 3 mm).
CLICK_PX, CONTROL_PX = 0.7, 0.5
DOT_RATIO, MAX_DOT = 0.45, 3e-3  #: Diameter of a dot over that of the probe, and its largest value [m].
FINE = 4  # points along each side of a pixel
_AROUND = np.linspace(0.0, 2.0 * math.pi, 73)  # angles of the facets' corners and of those of a dot [rad]
_SHIFT = 8  # bits of the fraction of a corner's coordinates
_MOUNT = 0.012  # length of the mount below the base [m]


# the surface


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


# the picture


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


# the rig


@dataclass(frozen=True, eq=False)
class StereoRig:
    """Two cameras, a box of control points and the markers of the probe."""

    truth: GroundTruth  #: what the cameras see.

    @cached_property
    def marker_s(self) -> Array:
        """Arclengths of the markers, stated and true [m], (k,)."""
        return np.array(marker_arclengths(self.truth.model.rod.length))

    @cached_property
    def side(self) -> float:
        """Side of the section towards the cameras, from the base's x axis about z, in whole degrees [rad]."""
        towards = self.truth.T_world_base[:3, :3].T @ np.array([0.0, -1.0, math.tan(ELEVATION)])
        return math.radians(round(math.degrees(math.atan2(towards[1], towards[0]))))

    @cached_property
    def workspace(self) -> tuple[Array, Array]:
        """Centre and size of the box in which the probe moves, (3,) each [m]."""
        length = self.truth.model.rod.length
        axis = self.truth.T_world_base[:3, 2]
        centre = self.truth.T_world_base[:3, 3] + 0.5 * length * axis
        size = np.maximum(1.1 * length * np.abs(axis), 0.7 * length)
        return np.asarray(np.round(centre, 3)), np.asarray(np.round(size, 3), dtype=float)

    @cached_property
    def control_points(self) -> Array:
        """Twenty points of a box [m]: its corners and the midpoints of its edges, (20, 3)."""
        centre, size = self.workspace
        grid = np.array([(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)], dtype=float)
        on_edges = grid[np.abs(grid).sum(axis=1) >= 2]
        return np.asarray(centre + on_edges * size / 2.0)

    @cached_property
    def cameras(self) -> tuple[Camera, Camera]:
        """Left and right camera."""
        centre, size = self.workspace
        distance = FIELD_OF_VIEW * float(size.max()) * FOCAL_PX / SIZE_PX[0] + size.max() / 2.0
        cameras = []
        for name, angle in (("left", -AZIMUTH), ("right", AZIMUTH)):
            direction = np.array([math.sin(angle), -math.cos(angle), math.tan(ELEVATION)])
            p = centre + distance * direction / np.linalg.norm(direction)
            lens = LENS[self.truth.plan.calibration]
            cameras.append(Camera.looking(name, p, centre, FOCAL_PX, SIZE_PX, lens))
        return cameras[0], cameras[1]

    def tube(self, test: SimulatedTest) -> SurfaceTube:
        """Return the surface of the bent probe in the world."""
        s = np.linspace(0.0, self.truth.rod.length, 400)
        radius = self.truth.rod.radius_at(s)
        return SurfaceTube(test.bench.to_world(test.equilibrium.p_at(s)), 2.0 * radius)

    def dots(self, test: SimulatedTest) -> PaintedDots:
        """Return the dots on the bent probe."""
        _, outward, radius = self._sections(test)
        return PaintedDots(self.marker_s, outward, np.minimum(2.0 * DOT_RATIO * radius, MAX_DOT))

    def markers(self, test: SimulatedTest) -> Array:
        """Return the true positions of the markers in the world [m], (k, 3)."""
        centre, outward, radius = self._sections(test)
        return np.asarray(centre + radius[:, None] * outward)

    def _sections(self, test: SimulatedTest) -> tuple[Array, Array, Array]:
        """Return the centres of the marked sections, the direction to their side, and the distance of the surface."""
        s = np.minimum(self.marker_s, self.truth.rod.length)
        eq, bench = test.equilibrium, test.bench
        R = eq.R_at(s)
        outward = R[:, :, 0] * math.cos(self.side) + R[:, :, 1] * math.sin(self.side)
        radius = self.truth.rod.radius_at(s)
        radius *= self.truth.model.cross_section.reach(self.side)
        return bench.to_world(eq.p_at(s)), outward @ bench.T_world_true[:3, :3].T, radius


def take_photographs(
    rig: StereoRig,
    tests: list[SimulatedTest],
    folder: Path,
    seed: int,
    on_progress: Callable[[str, float | None], None],
) -> None:
    """Render one photograph of each test by each camera, TEST-CAMERA.png; OpenCV must be installed."""
    require_opencv()

    folder.mkdir()
    total = len(tests) * len(rig.cameras)
    for i, test in enumerate(tests):
        tube, dots = rig.tube(test), rig.dots(test)
        for k, camera in enumerate(rig.cameras):
            number = i * len(rig.cameras) + k
            on_progress("photographs", number / total)
            picture = render(camera, tube, dots, SIZE_PX, RenderStyle(seed=seed * 1000 + number))
            write_png(folder / f"{test.name}-{camera.name}.png", picture)
