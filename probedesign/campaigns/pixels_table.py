"""`pixels.csv`: markers in the pictures of two cameras or more, placed in space."""

from pathlib import Path

import numpy as np

from probedesign.campaigns.cameras import PIXEL, camera_of, read_cameras
from probedesign.campaigns.campaign import Markers
from probedesign.campaigns.manifest import Manifest
from probedesign.campaigns.markers_table import marker_numbers
from probedesign.campaigns.rows import Kind, read_rows
from probedesign.campaigns.tables import known_test
from probedesign.errors import InputError
from probedesign.vision.camera import Camera
from probedesign.vision.sightings import LEAST_STD_PX
from probedesign.vision.triangulate import triangulate

FILE = "pixels.csv"
IMAGES = "images"
KIND = Kind(
    "table of pixels",
    {"test": "name", "camera": "name", "marker": "number", **dict.fromkeys(PIXEL, "pixel"), "std": "pixel"},
    ("test", "camera", "marker", *PIXEL),
    "test,camera,marker,u_px,v_px,std_px",
    {},
)


def read_pixels(
    folder: Path, manifest: Manifest, tests: dict[str, int]
) -> tuple[list[Markers | None], tuple[str, ...]]:
    """Read `pixels.csv`, if there is one, and place its markers in space.

    Returns:
        The markers of each test, None where it has none; notes, each one line.

    Raises:
        InputError: it says something wrong, or the cameras contradict each other; one line.
    """
    path = folder / FILE
    if not path.exists():
        if (folder / IMAGES).is_dir() and not (folder / "markers.csv").exists():
            note = f"images/ holds photographs and there is no {FILE}; probedesign markers {folder} makes it"
            return [None] * len(tests), (note,)
        return [None] * len(tests), ()
    rows = read_rows(path, KIND)
    which, numbers = np.array(known_test(rows, tests)), marker_numbers(rows, manifest)
    names, cameras_of = rows.texts("test"), camera_of(rows, manifest)
    keys: list[tuple[object, ...]] = list(zip(names, cameras_of, numbers.tolist(), strict=True))
    rows.once(keys, lambda row: f"test {names[row]}, camera {cameras_of[row]}, marker {numbers[row] + 1}")
    uv, std = rows.full(*PIXEL), rows.spread("std", np.zeros(len(rows), dtype=bool), "")
    cameras, notes = read_cameras(folder, manifest)
    order = [camera.name for camera in cameras]
    camera_index = np.array([order.index(name) for name in cameras_of])
    found: list[Markers | None] = [None] * len(tests)
    for name, test in tests.items():
        own = np.flatnonzero(which == test)
        if len(own):
            try:
                found[test] = _placed(cameras, camera_index[own], numbers[own], uv[own], std[own])
            except InputError as error:
                raise InputError(f"{path}: test {name}: {error}") from None
    return found, notes


def _placed(
    cameras: list[Camera], which: np.ndarray, numbers: np.ndarray, uv: np.ndarray, std: np.ndarray
) -> Markers:
    """The markers of one test."""
    held = np.unique(numbers)
    column = np.searchsorted(held, numbers)
    pixels = np.full((len(cameras), len(held), 2), np.nan)
    pixels[which, column] = uv
    spread = np.tile([[max(camera.std_px, LEAST_STD_PX)] for camera in cameras], (1, len(held)))
    said = ~np.isnan(std)
    spread[which[said], column[said]] = std[said]
    placed = triangulate(cameras, pixels, spread, [str(number + 1) for number in held])
    return Markers(held, placed.p_world, placed.cov_world, FILE)
