"""Cameras of a campaign, calibrated from a box of control points, from files of other programs, or from a board."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from probedesign.campaigns.manifest import FILE as MANIFEST
from probedesign.campaigns.manifest import CamerasTable, Manifest
from probedesign.core.csv_tables import TableRows, TableSchema, read_rows
from probedesign.core.errors import InputError
from probedesign.core.frames import Array, pose
from probedesign.core.units import MM
from probedesign.vision.boards import MIN_CORNERS
from probedesign.vision.bundle import BoardView, BundleProblem, calibrate_with_board
from probedesign.vision.calibrate import calibrate
from probedesign.vision.camera import Camera
from probedesign.vision.camera_files import StatedCalibration, read_camera_files

CONTROL_POINTS, BOARD_CORNERS, BOARD_IMAGES = "control_points.csv", "board_corners.csv", "board"
WORLD = "world"
"""Placement of the board in which its pose in the world is known."""
POSITION, PIXEL = ("x_world", "y_world", "z_world"), ("u", "v")
LENGTH = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}
BOARD_DISTORTION = 2
"""Default of `[cameras] distortion`: number of distortion coefficients fitted to pictures of a board."""
CONTROL_POINTS_SCHEMA = TableSchema(
    "table of control points",
    {"point": "name", **dict.fromkeys(POSITION, "length"), "camera": "name", **dict.fromkeys(PIXEL, "pixel")},
    ("point", *POSITION, "camera", *PIXEL),
    "point,x_world_mm,y_world_mm,z_world_mm,camera,u_px,v_px",
    {},
)
BOARD_CORNERS_SCHEMA = TableSchema(
    "table of board corners",
    {"placement": "name", "camera": "name", "corner": "number", **dict.fromkeys(PIXEL, "pixel"), "width": "pixel",
     "height": "pixel"},
    ("placement", "camera", "corner", *PIXEL, "width", "height"),
    "placement,camera,corner,u_px,v_px,width_px,height_px",
    {},
)  # fmt: skip


def read_cameras(folder: Path, manifest: Manifest) -> tuple[list[Camera], tuple[str, ...]]:
    """Return the cameras that `[cameras]` names, calibrated, in that order, and notes for the user, each one line.

    Raises:
        InputError: there are none, or what they are calibrated from is missing or invalid; one line.
    """
    table = manifest.cameras
    if table is None:
        raise InputError(f'{folder / MANIFEST}: has no [cameras]; add there names = ["left", "right"]')
    if (folder / CONTROL_POINTS).exists() and (table.calibration or table.board):
        other = "cameras.calibration" if table.calibration else "[cameras.board]"
        raise InputError(f"{folder}: has {CONTROL_POINTS} and {other}; keep one calibration")
    if not table.calibration:
        return _by_board(folder, table, None) if table.board else _by_control_points(folder, table)
    unit = None if table.length_unit is None else LENGTH[table.length_unit]
    base = np.array(manifest.base.p_world_mm) * MM
    paths = [folder / name for name in table.calibration]
    stated = read_camera_files(paths, table.names, table.reprojection_px, unit, base)
    if stated.in_world and table.board:
        raise InputError(f"{folder / MANIFEST}: the calibration files state poses in the world, and [cameras.board] "
                         "defines another world; remove one")  # fmt: skip
    if stated.in_world:
        return list(stated.cameras), stated.notes
    if table.board is None:
        raise InputError(f"{folder / MANIFEST}: the calibration files state no poses in the world; add [cameras.board] "
                         f"and pictures {BOARD_IMAGES}/{WORLD}-CAMERA.png of it")  # fmt: skip
    return _by_board(folder, table, stated)


def calibration_exists(folder: Path, manifest: Manifest) -> bool:
    """Return whether the folder has something that its cameras are calibrated from."""
    table = manifest.cameras
    return table is not None and bool(table.calibration or table.board or (folder / CONTROL_POINTS).exists())


# control points


def _by_control_points(folder: Path, table: CamerasTable) -> tuple[list[Camera], tuple[str, ...]]:
    path = folder / CONTROL_POINTS
    if not path.exists():
        raise InputError(f"{path}: is missing; cameras are calibrated from it, from cameras.calibration or from a "
                         "[cameras.board]")  # fmt: skip
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
            camera = calibrate(name, world[own], pixels[own], table.distortion or 0, [labels[i] for i in own])
        except InputError as error:
            raise InputError(f"{path}: {error}") from None
        notes.append(f"camera {name}: {len(own)} control points, {_residual(camera)}")
        cameras.append(camera)
    return cameras, tuple(notes)


def _residual(camera: Camera) -> str:
    outliers = f"; outliers left out: {', '.join(camera.outliers)}" if camera.outliers else ""
    return f"residual {camera.std_px:.2g} px{outliers}"


# boards


def _by_board(
    folder: Path, table: CamerasTable, stated: StatedCalibration | None
) -> tuple[list[Camera], tuple[str, ...]]:
    """Return cameras calibrated by pictures of a board, with what their files state."""
    assert table.board is not None  # checked by the caller
    path = folder / BOARD_CORNERS
    if not path.exists():
        raise InputError(f"{path}: is missing; photograph the board as {BOARD_IMAGES}/{WORLD}-CAMERA.png, "
                         f"{BOARD_IMAGES}/01-CAMERA.png ..., and run `probedesign markers {folder}`")  # fmt: skip
    views = _read_corners(path, table)
    if not any(view.placement == WORLD for view in views):
        raise InputError(f"{path}: has no usable picture of the placement {WORLD!r}, which defines the world; "
                         f"photograph the board there as {BOARD_IMAGES}/{WORLD}-CAMERA.png")  # fmt: skip
    R = Rotation.from_rotvec(np.radians(table.board.rotation_world_deg)).as_matrix()
    T_world_board = pose(R, np.array(table.board.p_world_mm) * MM)
    known = {} if stated is None else {camera.name: camera for camera in stated.cameras}
    for view in views:
        size = known[view.camera].size_px if view.camera in known else None
        if size not in (None, view.size_px):
            raise InputError(f"{path}: pictures of camera {view.camera} have {_pixels(view.size_px)} px, but its "
                             f"calibration file is of {_pixels(size)}; take them as for the calibration")  # fmt: skip
    relative = () if stated is None else stated.relative
    scale_std = table.board.scale_std_percent / 100
    problem = BundleProblem(table.board.board(), views, WORLD, T_world_board, scale_std, known, relative)
    try:
        distortion = BOARD_DISTORTION if table.distortion is None else table.distortion
        cameras = calibrate_with_board(table.names, problem, distortion)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    notes = [] if stated is None else list(stated.notes)
    for camera in cameras:
        own = [view for view in views if view.camera == camera.name]
        corners = sum(len(view.numbers) for view in own)
        pictures = f"{len(own)} picture{'' if len(own) == 1 else 's'} of the board"
        notes.append(f"camera {camera.name}: {pictures}, {corners} corners, {_residual(camera)}")
    return cameras, tuple(notes)


def _pixels(size: tuple[int, int] | None) -> str:
    return "unknown size" if size is None else f"{size[0]} x {size[1]}"


def _read_corners(path: Path, table: CamerasTable) -> tuple[BoardView, ...]:
    """Return the pictures of `board_corners.csv` that show enough corners."""
    assert table.board is not None  # checked by the caller
    rows = read_rows(path, BOARD_CORNERS_SCHEMA)
    placements, names, texts = rows.texts("placement"), camera_names(rows, table.names), rows.texts("corner")
    rows.check_unique(list(zip(placements, names, texts, strict=True)),
                      lambda row: f"placement {placements[row]}, camera {names[row]}, corner {texts[row]}")  # fmt: skip
    count = len(table.board.board().corners)
    for row, text in enumerate(texts):
        if not (text.isascii() and text.isdigit() and len(text) < 9 and int(text) < count):
            rows.fail(row, f"corner {text[:20]!r} is not one of the board, whose {count} corners count from 0")
    uv, sizes = rows.required(*PIXEL), rows.required("width", "height")
    views = []
    for placement, name in dict.fromkeys(zip(placements, names, strict=True)):
        own = [i for i, pair in enumerate(zip(placements, names, strict=True)) if pair == (placement, name)]
        width, height = sizes[own[0]]
        if not (sizes[own] == sizes[own[0]]).all() or width % 1 or height % 1 or min(width, height) < 1:
            rows.fail(
                own[0], f"the picture of placement {placement} by camera {name} has no single size in whole pixels"
            )
        for i in own:
            if not ((uv[i] >= -0.5) & (uv[i] <= sizes[i] - 0.5)).all():
                rows.fail(i, f"pixel {uv[i, 0]:g}, {uv[i, 1]:g} lies outside the picture of {width:g} x {height:g}")
        if len(own) >= MIN_CORNERS:
            numbers = np.array([int(texts[i]) for i in own], dtype=np.intp)
            views.append(BoardView(placement, name, numbers, uv[own], (int(width), int(height))))
    return tuple(views)


# shared checks


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
        rows.fail(row, f"pixel {uv[0]:g}, {uv[1]:g} lies outside the pictures of {_pixels(size)} px that camera "
                       f"{camera.name} was calibrated for; was the photograph scaled?")  # fmt: skip
