"""Synthetic photographs of a dotted probe: what the marker finder is tried on, and examples come with.

Every pixel is the mean of rays that meet the tube; then come the lens' blur, shot noise and the noise of reading.
How things look is assumed throughout; where things are is exact.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.spatial import cKDTree

from probedesign.frames import Array
from probedesign.simulation.tube import Dots, Hits, Tube
from probedesign.vision.camera import Camera

Picture = NDArray[np.uint8]

FINE = 3  # rays along each side of a pixel
_MOUNT = 0.012  # depth of the mount behind the base [m]


@dataclass(frozen=True)
class Look:
    """How a photograph looks; greys 0 ... 1 are the share of light that comes back.

    Attributes:
        probe, dot, background, mount: greys.
        light_world: direction towards the lamp.
        ambient: share of light from everywhere.
        gloss: of the probe.
        mottle: unevenness of the probe and the background.
        clutter: round dark things in the background, which are no dots.
        blur_px: standard deviation of the lens' blur [px].
        noise: standard deviation of a dark pixel, of 255 grey levels; a bright one has shot noise as well.
        full_well: electrons of a white pixel, which tell the shot noise.
        seed: of all that is random.
    """

    probe: float = 0.75
    dot: float = 0.12
    background: float = 0.28
    mount: float = 0.45
    light_world: tuple[float, float, float] = (-0.3, -0.6, 0.75)
    ambient: float = 0.45
    gloss: float = 0.12
    mottle: float = 0.03
    clutter: int = 6
    blur_px: float = 0.8
    noise: float = 1.5
    full_well: float = 10_000.0
    seed: int = 0


def render(
    camera: Camera, probe: Tube, dots: Dots, size_px: tuple[int, int], look: Look | None = None
) -> Picture:
    """A synthetic photograph of a dotted probe in its mount.

    A part of the probe that another one hides is drawn in front of it where it is nearer in the picture; a probe
    that crosses itself in the picture is not drawn rightly.

    Args:
        camera: in front of which the whole probe lies.
        probe: its surface.
        dots: on it.
        size_px: width and height [px].
        look: of the photograph.

    Returns:
        Grey levels (height, width).
    """
    look = look or Look()
    rng = np.random.default_rng(look.seed)
    picture = _background(size_px, look, rng)
    mount = _mount_of(probe)
    for tube, painted, grey in ((mount, None, look.mount), (probe, dots, look.probe)):
        rows, columns = _window(camera, tube, size_px)
        if len(rows):
            light, share = _drawn(camera, tube, painted, grey, rows, columns, look, rng)
            picture[rows, columns] = (1 - share) * picture[rows, columns] + light
    return _exposed(picture, look, rng)


def _window(
    camera: Camera, tube: Tube, size_px: tuple[int, int]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Pixels that the tube may cover."""
    line = camera.project(tube.p_world)
    radius_px = tube.diameter / 2 * camera.K[0, 0] / camera.depth(tube.p_world) + 3.0
    low = np.floor((line - radius_px[:, None]).min(axis=0)).astype(int)
    high = np.ceil((line + radius_px[:, None]).max(axis=0)).astype(int)
    columns = np.arange(max(low[0], 0), min(high[0] + 1, size_px[0]))
    rows = np.arange(max(low[1], 0), min(high[1] + 1, size_px[1]))
    v, u = (grid.ravel() for grid in np.meshgrid(rows, columns, indexing="ij"))
    away, nearest = (
        cKDTree(line).query(np.column_stack([u, v])) if len(u) else (np.zeros(0), np.zeros(0, int))
    )
    close = away <= radius_px[nearest] + _gap(line)
    return v[close], u[close]


def _gap(line: Array) -> float:
    """Largest distance between neighbours [px]."""
    return float(np.linalg.norm(np.diff(line, axis=0), axis=1).max())


def _drawn(
    camera: Camera,
    tube: Tube,
    dots: Dots | None,
    grey: float,
    rows: NDArray[np.int64],
    columns: NDArray[np.int64],
    look: Look,
    rng: np.random.Generator,
) -> tuple[Array, Array]:
    """Light that comes from the tube at pixels, and the share of each that it covers."""
    streaks = look.mottle * gaussian_filter(rng.normal(size=2000), 3.0) * 3.0
    centres = np.column_stack([columns, rows]).astype(float)
    near = tube.s[cKDTree(camera.project(tube.p_world)).query(centres)[1]]
    near = tube.meet(camera.p_world, camera.rays(centres), near).s
    light, share = np.zeros(len(rows)), np.zeros(len(rows))
    offsets = (np.arange(FINE) + 0.5) / FINE - 0.5
    for down in offsets:
        for right in offsets:
            rays = camera.rays(centres + np.array([right, down]))
            hits = tube.meet(camera.p_world, rays, near, 2)
            met = np.isfinite(hits.distance)
            hits = Hits(hits.distance[met], hits.s[met], hits.normal_world[met])
            albedo = grey * (1 + np.interp(hits.s, np.linspace(0, tube.s[-1], len(streaks)), streaks))
            if dots is not None:
                albedo = np.where(tube.dotted(dots, hits), look.dot, albedo)
            light[met] += _shaded(albedo, hits.normal_world, rays[met], look)
            share[met] += 1
    return light / FINE**2, share / FINE**2


def _shaded(albedo: Array, normal: Array, rays: Array, look: Look) -> Array:
    """Diffuse light and a highlight (Blinn)."""
    lamp = np.array(look.light_world) / np.linalg.norm(look.light_world)
    half = lamp - rays
    half /= np.linalg.norm(half, axis=1)[:, None]
    diffuse = np.clip(normal @ lamp, 0.0, None)
    bright = np.clip(np.einsum("ni,ni->n", normal, half), 0.0, None) ** 30
    return np.asarray(albedo * (look.ambient + (1 - look.ambient) * diffuse) + look.gloss * bright)


def _background(size_px: tuple[int, int], look: Look, rng: np.random.Generator) -> Array:
    """An uneven wall, with round things that are no dots."""
    width, height = size_px
    v, u = np.mgrid[0:height, 0:width]
    rough = gaussian_filter(rng.normal(size=(height // 8 + 2, width // 8 + 2)), 4.0) * 10.0
    wall = look.background * (1 + 0.2 * (u / width - 0.5) - 0.2 * (v / height - 0.5))
    wall *= 1 + look.mottle * np.kron(rough, np.ones((8, 8)))[:height, :width]
    for _ in range(look.clutter):
        centre, radius = rng.uniform((0, 0), size_px), rng.uniform(3, 12)
        edge = np.clip(radius + 0.5 - np.hypot(u - centre[0], v - centre[1]), 0.0, 1.0)
        wall = wall * (1 - 0.6 * edge)
    return np.asarray(wall)


def _mount_of(probe: Tube) -> Tube:
    """A stub behind the base, twice as wide."""
    back = probe.p_world[0] - np.linspace(_MOUNT, 0.0, 60)[:, None] * probe.tangents_world[0]
    return Tube(back, np.full(60, 2 * probe.diameter[0]))


def _exposed(picture: Array, look: Look, rng: np.random.Generator) -> Picture:
    """The lens' blur and the sensor's noise."""
    light = np.clip(gaussian_filter(picture, look.blur_px), 0.0, None)
    std = np.hypot(look.noise / 255, np.sqrt(light / look.full_well))
    return np.asarray(
        np.clip(np.round(255 * (light + std * rng.normal(size=light.shape))), 0, 255), dtype=np.uint8
    )
