"""Simulated stereo rig: two cameras, control points, the probe's markers, and rendered photographs of them.

Every pixel is the mean of rays that intersect the probe's surface; the lens' blur, shot noise and read noise are added.
The appearance is assumed throughout; positions are exact.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import gaussian_filter
from scipy.spatial import cKDTree

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
FINE = 3  # rays along each side of a pixel
_MOUNT = 0.012  # length of the mount below the base [m]


# the surface


@dataclass(frozen=True)
class PaintedDots:
    """Dots painted on a tube."""

    s: Array  #: arclength of each centre from the tube's start [m], (m,).
    outward_world: Array  #: direction from the axis to its side, not necessarily a normal, (m, 3).
    diameter: Array  #: of each, measured along the surface [m], (m,).


@dataclass(frozen=True)
class RayHits:
    """Intersections of rays with a tube; NaN where there are none."""

    distance: Array  #: from the rays' origin [m], (n,).
    s: Array  #: arclength [m], (n,).
    normal_world: Array  #: outward (n, 3).


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

    @cached_property
    def _table(self) -> Array:
        """Table of point, tangent, radius and its slope at equidistant arclengths, (n, 8)."""
        values = np.column_stack(
            [self.p_world, self.tangents_world, self.diameter / 2, np.gradient(self.diameter / 2, self.s)]
        )
        even = np.linspace(0.0, self.s[-1], 4 * len(self.s))
        return np.column_stack([np.interp(even, self.s, column) for column in values.T])

    def at(self, s: ArrayLike) -> tuple[Array, Array, Array, Array]:
        """Return centre (n, 3), unit tangent (n, 3), radius and its slope (n,) at arclengths (n,) within the tube."""
        steps = len(self._table) - 1
        position = np.clip(np.asarray(s, dtype=float) / self.s[-1], 0.0, 1.0) * steps
        low = np.minimum(position.astype(int), steps - 1)
        row = self._table[low] + (position - low)[:, None] * (self._table[low + 1] - self._table[low])
        return row[:, :3], row[:, 3:6], row[:, 6], row[:, 7]

    def dot_positions(self, dots: PaintedDots) -> Array:
        """Return the centres of dots on the surface [m], (m, 3)."""
        centre, tangent, radius, _ = self.at(dots.s)
        return centre + radius[:, None] * _across(dots.outward_world, tangent)

    def intersect(self, origin: Array, rays: Array, near: Array, steps: int = 5) -> RayHits:
        """Return the first intersections of rays with the tube or its flat ends.

        Args:
            origin: of all rays [m], (3,).
            rays: unit vectors (n, 3).
            near: arclength of the centreline near each ray [m], (n,).
            steps: iterations; each intersects the cone tangent to the tube at the last point.
        """
        s = near.copy()
        for _ in range(steps):
            centre, tangent, radius, slope = self.at(s)
            distance = _intersect_cone(origin - centre, rays, tangent, radius, slope)
            along = np.einsum("ni,ni->n", origin + distance[:, None] * rays - centre, tangent)
            s = s + np.nan_to_num(along)
        centre, tangent, radius, slope = self.at(s)
        normal = _across(origin + distance[:, None] * rays - centre, tangent) - slope[:, None] * tangent
        distance = np.where((s >= 0) & (s <= self.s[-1]), distance, np.nan)
        hits = RayHits(distance, s, normal / np.linalg.norm(normal, axis=1)[:, None])
        return self._intersect_end(0, self._intersect_end(-1, hits, origin, rays), origin, rays)

    def _intersect_end(self, end: int, hits: RayHits, origin: Array, rays: Array) -> RayHits:
        """Return the hits, or those on a flat end where they come first."""
        outward = self.tangents_world[end] * (-1 if end == 0 else 1)
        with np.errstate(divide="ignore"):
            distance = (self.p_world[end] - origin) @ outward / (rays @ outward)
        from_axis = np.linalg.norm(origin + distance[:, None] * rays - self.p_world[end], axis=1)
        first = (from_axis <= self.diameter[end] / 2) & ~(hits.distance < distance)
        return RayHits(
            np.where(first, distance, hits.distance),
            np.where(first, self.s[end], hits.s),
            np.where(first[:, None], outward, hits.normal_world),
        )

    def in_dot(self, dots: PaintedDots, hits: RayHits) -> NDArray[np.bool_]:
        """Return whether points of the surface are in a dot, (n,)."""
        _, tangent, radius, _ = self.at(hits.s)
        side = _across(hits.normal_world, tangent)
        inked = np.zeros(len(side), dtype=bool)
        for s, outward, diameter in zip(dots.s, dots.outward_world, dots.diameter, strict=True):
            close = np.abs(hits.s - s) <= diameter / 2
            outwards = np.broadcast_to(outward, (int(close.sum()), 3))
            facing = np.einsum("ni,ni->n", side[close], _across(outwards, tangent[close]))
            around = radius[close] * np.arccos(np.clip(facing, -1.0, 1.0))
            inked[close] |= np.hypot(hits.s[close] - s, around) <= diameter / 2
        return inked


def _across(vectors: Array, tangent: Array) -> Array:
    across = vectors - np.sum(vectors * tangent, axis=1)[:, None] * tangent
    length = np.linalg.norm(across, axis=1)[:, None]
    return np.asarray(across / np.maximum(length, 1e-12))  # zero on a flat end


def _intersect_cone(start: Array, rays: Array, axis: Array, radius: Array, slope: Array) -> Array:
    """Return the distance at which rays intersect cones about an axis through 0, NaN if they do not, (n,).

    Args:
        start: of each ray, from the cone's point of the axis [m], (n, 3).
        rays, axis: unit vectors (n, 3).
        radius, slope: at that point [m], and how it grows along the axis, (n,).
    """
    start_along, ray_along = np.sum(start * axis, axis=1), np.sum(rays * axis, axis=1)
    start_across, ray_across = start - start_along[:, None] * axis, rays - ray_along[:, None] * axis
    wide, grows = radius + slope * start_along, slope * ray_along
    a = np.sum(ray_across**2, axis=1) - grows**2
    b = np.sum(ray_across * start_across, axis=1) - grows * wide
    c = np.sum(start_across**2, axis=1) - wide**2
    under = b**2 - a * c
    return np.asarray((-b - np.sqrt(np.where(under >= 0, under, np.nan))) / a)


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
    """Render a photograph of a dotted probe in its mount, grey levels (height, width).

    The whole probe must lie in front of the camera; one that crosses itself in the picture is not rendered correctly.
    """
    style = style or RenderStyle()
    rng = np.random.default_rng(style.seed)
    picture = _background(size_px, style, rng)
    mount = _mount_of(probe)
    for tube, painted, grey in ((mount, None, style.mount), (probe, dots, style.probe)):
        rows, columns = _window(camera, tube, size_px)
        if len(rows):
            light, coverage = _drawn(camera, tube, painted, grey, rows, columns, style, rng)
            picture[rows, columns] = (1 - coverage) * picture[rows, columns] + light
    return exposed(picture, style, rng)


def _window(camera: Camera, tube: SurfaceTube, size_px: tuple[int, int]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the pixels that the tube may cover."""
    line = camera.project(tube.p_world)
    radius_px = tube.diameter / 2 * camera.K[0, 0] / camera.depth(tube.p_world) + 3.0
    low = np.floor((line - radius_px[:, None]).min(axis=0)).astype(int)
    high = np.ceil((line + radius_px[:, None]).max(axis=0)).astype(int)
    columns = np.arange(max(low[0], 0), min(high[0] + 1, size_px[0]))
    rows = np.arange(max(low[1], 0), min(high[1] + 1, size_px[1]))
    v, u = (grid.ravel() for grid in np.meshgrid(rows, columns, indexing="ij"))
    if not len(u):
        return v, u
    away, nearest = cKDTree(line).query(np.column_stack([u, v]))
    gap = float(np.linalg.norm(np.diff(line, axis=0), axis=1).max())  # between neighbours of the line
    close = away <= radius_px[nearest] + gap
    return v[close], u[close]


def _drawn(
    camera: Camera,
    tube: SurfaceTube,
    dots: PaintedDots | None,
    grey: float,
    rows: NDArray[np.int64],
    columns: NDArray[np.int64],
    style: RenderStyle,
    rng: np.random.Generator,
) -> tuple[Array, Array]:
    """Return the light from the tube at pixels, and the fraction of each pixel that it covers."""
    streaks = style.mottle * gaussian_filter(rng.normal(size=2000), 3.0) * 3.0
    centres = np.column_stack([columns, rows]).astype(float)
    near = tube.s[cKDTree(camera.project(tube.p_world)).query(centres)[1]]
    near = tube.intersect(camera.p_world, camera.rays(centres), near).s
    light, coverage = np.zeros(len(rows)), np.zeros(len(rows))
    offsets = (np.arange(FINE) + 0.5) / FINE - 0.5
    for down in offsets:
        for right in offsets:
            rays = camera.rays(centres + np.array([right, down]))
            hits = tube.intersect(camera.p_world, rays, near, 2)
            met = np.isfinite(hits.distance)
            hits = RayHits(hits.distance[met], hits.s[met], hits.normal_world[met])
            albedo = grey * (1 + np.interp(hits.s, np.linspace(0, tube.s[-1], len(streaks)), streaks))
            if dots is not None:
                albedo = np.where(tube.in_dot(dots, hits), style.dot, albedo)
            light[met] += _shaded(albedo, hits.normal_world, rays[met], style)
            coverage[met] += 1
    return light / FINE**2, coverage / FINE**2


def _shaded(albedo: Array, normal: Array, rays: Array, style: RenderStyle) -> Array:
    """Return diffuse light and a highlight (Blinn)."""
    lamp = np.array(style.light_world) / np.linalg.norm(style.light_world)
    half = lamp - rays
    half /= np.linalg.norm(half, axis=1)[:, None]
    diffuse = np.clip(normal @ lamp, 0.0, None)
    bright = np.clip(np.einsum("ni,ni->n", normal, half), 0.0, None) ** 30
    return np.asarray(albedo * (style.ambient + (1 - style.ambient) * diffuse) + style.gloss * bright)


def _background(size_px: tuple[int, int], style: RenderStyle, rng: np.random.Generator) -> Array:
    """Return an uneven wall with round objects that are not dots."""
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
