"""Cameras of a campaign, calibrated from a box of control points or from files of other programs."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from probedesign.campaigns.manifest import FILE as MANIFEST
from probedesign.campaigns.manifest import CamerasTable, Manifest
from probedesign.core.csv_tables import TableRows, TableSchema, read_rows
from probedesign.core.errors import InputError
from probedesign.core.frames import Array
from probedesign.core.units import MM
from probedesign.vision.calibrate import calibrate, locate
from probedesign.vision.camera import Camera
from probedesign.vision.camera_files import read_camera_files

CONTROL_POINTS = "control_points.csv"
POSITION, PIXEL = ("x_world", "y_world", "z_world"), ("u", "v")
LENGTH = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}
CONTROL_POINTS_SCHEMA = TableSchema(
    "table of control points",
    {"point": "name", **dict.fromkeys(POSITION, "length"), "camera": "name", **dict.fromkeys(PIXEL, "pixel")},
    ("point", *POSITION, "camera", *PIXEL),
    "point,x_world_mm,y_world_mm,z_world_mm,camera,u_px,v_px",
    {},
)
Fit = Callable[[str, Array, Array, Sequence[str]], Camera]
"""Name, control points [m], pixels and labels of one camera in; the camera out."""


def read_cameras(folder: Path, manifest: Manifest) -> tuple[list[Camera], tuple[str, ...]]:
    """Return the cameras that `[cameras]` names, calibrated, in that order, and notes for the user, each one line.

    Calibration files that state no poses in the world are completed by `control_points.csv`.

    Raises:
        InputError: there are none, or what they are calibrated from is missing or invalid; one line.
    """
    table = manifest.cameras
    if table is None:
        raise InputError(f'{folder / MANIFEST}: has no [cameras]; add there names = ["left", "right"]')
    path = folder / CONTROL_POINTS
    if not table.calibration:
        if not path.exists():
            raise InputError(f"{path}: is missing; cameras are calibrated from it, or from cameras.calibration")
        return _by_control_points(
            path, table, lambda name, world, uv, labels: calibrate(name, world, uv, table.distortion or 0, labels)
        )
    unit = None if table.length_unit is None else LENGTH[table.length_unit]
    base = np.array(manifest.base.p_world_mm) * MM
    paths = [folder / name for name in table.calibration]
    stated = read_camera_files(paths, table.names, table.reprojection_px, unit, base)
    if stated.in_world and path.exists():
        raise InputError(f"{folder}: has {CONTROL_POINTS} and poses in the files of cameras.calibration; keep one")
    if stated.in_world:
        return list(stated.cameras), stated.notes
    if not path.exists():
        raise InputError(f"{folder / MANIFEST}: the calibration files state no poses in the world; add "
                         f"{CONTROL_POINTS} with at least 6 points that each camera sees")  # fmt: skip
    known = {camera.name: camera for camera in stated.cameras}
    cameras, notes = _by_control_points(
        path, table, lambda name, world, uv, labels: locate(known[name], world, uv, labels)
    )
    return cameras, (*stated.notes, *notes)


def calibration_exists(folder: Path, manifest: Manifest) -> bool:
    """Return whether the folder has something that its cameras are calibrated from."""
    table = manifest.cameras
    return table is not None and bool(table.calibration or (folder / CONTROL_POINTS).exists())


def _by_control_points(path: Path, table: CamerasTable, fit: Fit) -> tuple[list[Camera], tuple[str, ...]]:
    rows = read_rows(path, CONTROL_POINTS_SCHEMA)
    names, labels = camera_names(rows, table.names), rows.texts("point")
    rows.check_unique(list(zip(names, labels, strict=True)), lambda row: f"camera {names[row]}, point {labels[row]}")
    world, pixels = rows.required(*POSITION), rows.required(*PIXEL)
    cameras, notes = [], []
    for name in table.names:
        own = np.flatnonzero(np.array(names) == name)
        if not len(own):
            raise InputError(f"{path}: has no point of camera {name}")
        try:
            camera = fit(name, world[own], pixels[own], [labels[i] for i in own])
        except InputError as error:
            raise InputError(f"{path}: {error}") from None
        outliers = f"; outliers left out: {', '.join(camera.outliers)}" if camera.outliers else ""
        notes.append(f"camera {name}: {len(own)} control points, residual {camera.std_px:.2g} px{outliers}")
        cameras.append(camera)
    return cameras, tuple(notes)


def camera_names(rows: TableRows, known: Sequence[str]) -> list[str]:
    """Return the name of the camera of each row; refuse one that `[cameras]` does not have."""
    names = rows.texts("camera")
    for row, name in enumerate(names):
        if name not in known:
            rows.fail(row, f"camera {name[:40]!r} is not in cameras.names of campaign.toml, which has "
                           f"{', '.join(known) or 'none'}")  # fmt: skip
    return names


def check_inside(rows: TableRows, row: int, camera: Camera, uv: Array) -> None:
    """Refuse a pixel outside the pictures that its camera was calibrated for."""
    size = camera.size_px
    if size is not None and not ((uv >= -0.5) & (uv <= np.array(size) - 0.5)).all():
        rows.fail(row, f"pixel {uv[0]:g}, {uv[1]:g} lies outside the pictures of {size[0]} x {size[1]} px that camera "
                       f"{camera.name} was calibrated for; was the photograph scaled?")  # fmt: skip
