"""Cameras of a campaign: calibrated from `control_points.csv`, they locate the markers of `pixels.csv` in space."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from probedesign.campaigns.campaign import Markers
from probedesign.campaigns.manifest import FILE as MANIFEST
from probedesign.campaigns.manifest import Manifest
from probedesign.campaigns.tables import MARKERS, POSITION, indices_of_tests, marker_numbers
from probedesign.core.csv_tables import TableRows, TableSchema, read_rows
from probedesign.core.errors import InputError
from probedesign.core.frames import Array
from probedesign.vision.calibrate import calibrate
from probedesign.vision.camera import Camera
from probedesign.vision.triangulate import MIN_STD_PX, triangulate

CONTROL_POINTS, PIXELS, IMAGES = "control_points.csv", "pixels.csv", "images"
PIXEL = ("u", "v")
CONTROL_POINTS_SCHEMA = TableSchema(
    "table of control points",
    {"point": "name", **dict.fromkeys(POSITION, "length"), "camera": "name", **dict.fromkeys(PIXEL, "pixel")},
    ("point", *POSITION, "camera", *PIXEL),
    "point,x_world_mm,y_world_mm,z_world_mm,camera,u_px,v_px",
    {},
)
PIXELS_SCHEMA = TableSchema(
    "table of pixels",
    {"test": "name", "camera": "name", "marker": "number", **dict.fromkeys(PIXEL, "pixel"), "std": "pixel"},
    ("test", "camera", "marker", *PIXEL),
    "test,camera,marker,u_px,v_px,std_px",
    {},
)


def read_cameras(folder: Path, manifest: Manifest) -> tuple[list[Camera], tuple[str, ...]]:
    """Calibrate the cameras that `[cameras]` names.

    Returns:
        The cameras in that order, and notes for the user, each one line.

    Raises:
        InputError: there are none, or their control points are invalid; one line.
    """
    path = folder / CONTROL_POINTS
    if manifest.cameras is None:
        raise InputError(f'{folder / MANIFEST}: has no [cameras]; add there names = ["left", "right"]')
    if not path.exists():
        raise InputError(f"{path}: is missing; cameras are calibrated from it")
    rows = read_rows(path, CONTROL_POINTS_SCHEMA)
    names, labels = _camera_names(rows, manifest), rows.texts("point")
    rows.check_unique(list(zip(names, labels, strict=True)),
                      lambda row: f"camera {names[row]}, point {labels[row]}")  # fmt: skip
    world, pixels = rows.required(*POSITION), rows.required(*PIXEL)
    cameras, notes = [], []
    for name in manifest.cameras.names:
        own = np.flatnonzero(np.array(names) == name)
        if not len(own):
            raise InputError(f"{path}: has no point of camera {name}")
        try:
            camera = calibrate(
                name, world[own], pixels[own], manifest.cameras.distortion, [labels[i] for i in own]
            )
        except InputError as error:
            raise InputError(f"{path}: {error}") from None
        outliers = f"; outliers left out: {', '.join(camera.outliers)}" if camera.outliers else ""
        notes.append(f"camera {name}: {len(own)} control points, residual {camera.std_px:.2g} px{outliers}")
        cameras.append(camera)
    return cameras, tuple(notes)


def _camera_names(rows: TableRows, manifest: Manifest) -> list[str]:
    """Return the name of the camera of each row.

    Raises:
        InputError: `[cameras]` does not have it.
    """
    names = rows.texts("camera")
    known = () if manifest.cameras is None else manifest.cameras.names
    for row, name in enumerate(names):
        if name not in known:
            rows.fail(row, f"camera {name[:40]!r} is not in cameras.names of campaign.toml, which has "
                           f"{', '.join(known) or 'none'}")  # fmt: skip
    return names


def read_pixels(
    folder: Path, manifest: Manifest, tests: dict[str, int]
) -> tuple[list[Markers | None], tuple[str, ...]]:
    """Read `pixels.csv`, if there is one, and locate its markers in space.

    Returns:
        The markers of each test, None where it has none; notes, each one line.

    Raises:
        InputError: it is invalid, or the cameras contradict each other; one line.
    """
    path = folder / PIXELS
    if not path.exists():
        if (folder / IMAGES).is_dir() and not (folder / MARKERS).exists():
            note = f"{IMAGES}/ has photographs, but there is no {PIXELS}; run `probedesign markers {folder}`"
            return [None] * len(tests), (note,)
        return [None] * len(tests), ()
    rows = read_rows(path, PIXELS_SCHEMA)
    which, numbers = np.array(indices_of_tests(rows, tests)), marker_numbers(rows, manifest)
    names, camera_names = rows.texts("test"), _camera_names(rows, manifest)
    keys: list[tuple[object, ...]] = list(zip(names, camera_names, numbers.tolist(), strict=True))
    rows.check_unique(
        keys, lambda row: f"test {names[row]}, camera {camera_names[row]}, marker {numbers[row] + 1}"
    )
    uv, std = rows.required(*PIXEL), rows.std("std", np.zeros(len(rows), dtype=bool), "")
    cameras, notes = read_cameras(folder, manifest)
    order = [camera.name for camera in cameras]
    camera_index = np.array([order.index(name) for name in camera_names])
    found: list[Markers | None] = [None] * len(tests)
    for name, test in tests.items():
        own = np.flatnonzero(which == test)
        if len(own):
            try:
                found[test] = _located(cameras, camera_index[own], numbers[own], uv[own], std[own])
            except InputError as error:
                raise InputError(f"{path}: test {name}: {error}") from None
    return found, notes


def _located(
    cameras: list[Camera], which: NDArray[np.intp], numbers: NDArray[np.intp], uv: Array, std: Array
) -> Markers:
    """Return the markers of one test in space."""
    seen = np.unique(numbers)
    column = np.searchsorted(seen, numbers)
    pixels = np.full((len(cameras), len(seen), 2), np.nan)
    pixels[which, column] = uv
    std_px = np.tile([[max(camera.std_px, MIN_STD_PX)] for camera in cameras], (1, len(seen)))
    given = ~np.isnan(std)
    std_px[which[given], column[given]] = std[given]
    located = triangulate(cameras, pixels, std_px, [str(number + 1) for number in seen])
    return Markers(seen, located.p_world, located.cov_world, PIXELS)
