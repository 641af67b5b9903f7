"""The cameras of a campaign, calibrated from `control_points.csv`."""

from pathlib import Path

import numpy as np

from probedesign.campaigns.manifest import FILE as MANIFEST
from probedesign.campaigns.manifest import Manifest
from probedesign.campaigns.rows import Kind, Rows, read_rows
from probedesign.errors import InputError
from probedesign.vision.calibrate import calibrate
from probedesign.vision.camera import Camera

FILE = "control_points.csv"
PLACE = ("x_world", "y_world", "z_world")
PIXEL = ("u", "v")
KIND = Kind(
    "table of control points",
    {"point": "name", **dict.fromkeys(PLACE, "length"), "camera": "name", **dict.fromkeys(PIXEL, "pixel")},
    ("point", *PLACE, "camera", *PIXEL),
    "point,x_world_mm,y_world_mm,z_world_mm,camera,u_px,v_px",
    {},
)


def read_cameras(folder: Path, manifest: Manifest) -> tuple[list[Camera], tuple[str, ...]]:
    """Calibrate the cameras that `[cameras]` names.

    Returns:
        The cameras in that order, and what a user should know of them, each one line.

    Raises:
        InputError: there are none, or their control points are no good; one line.
    """
    path = folder / FILE
    if manifest.cameras is None:
        raise InputError(f'{folder / MANIFEST}: has no [cameras]; write there names = ["left", "right"]')
    if not path.exists():
        raise InputError(f"{path}: is missing; cameras are calibrated from it")
    rows = read_rows(path, KIND)
    cameras = camera_of(rows, manifest)
    labels = rows.texts("point")
    rows.once(list(zip(cameras, labels, strict=True)),
              lambda row: f"camera {cameras[row]}, point {labels[row]}")  # fmt: skip
    world, pixels = rows.full(*PLACE), rows.full(*PIXEL)
    found, notes = [], []
    for name in manifest.cameras.names:
        own = np.flatnonzero(np.array(cameras) == name)
        if not len(own):
            raise InputError(f"{path}: holds no point of camera {name}")
        try:
            camera = calibrate(
                name, world[own], pixels[own], manifest.cameras.distortion, [labels[i] for i in own]
            )
        except InputError as error:
            raise InputError(f"{path}: {error}") from None
        out = (
            f"; left out for fitting with none of the others: {', '.join(camera.outliers)}"
            if camera.outliers
            else ""
        )
        notes.append(f"camera {name}: {len(own)} control points, residual {camera.std_px:.2g} px{out}")
        found.append(camera)
    return found, tuple(notes)


def camera_of(rows: Rows, manifest: Manifest) -> list[str]:
    """Which camera each row is of.

    Raises:
        InputError: one that `[cameras]` does not name.
    """
    names = rows.texts("camera")
    known = () if manifest.cameras is None else manifest.cameras.names
    for row, name in enumerate(names):
        if name not in known:
            told = ", ".join(known) or "none"
            rows.fail(row, f"camera {name[:40]!r} is not in cameras.names of campaign.toml; there are {told}")
    return names
