"""Pictures of a board in a campaign: its corners detected in each, written to `board_corners.csv`."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from probedesign.campaigns.cameras import BOARD_CORNERS, BOARD_CORNERS_SCHEMA, BOARD_IMAGES, WORLD
from probedesign.campaigns.manifest import CamerasTable, Manifest
from probedesign.core.errors import InputError
from probedesign.core.files import check_overwrite, write_atomically
from probedesign.core.frames import Array
from probedesign.vision.boards import MIN_CORNERS, detect_board
from probedesign.vision.markers import SUFFIXES, read_grey


@dataclass(frozen=True)
class BoardPicture:
    """One picture of the board."""

    path: Path  #: of the file.
    placement: str  #: placement, camera: as its name has them.
    camera: str
    numbers: NDArray[np.intp]  #: of the detected corners (n,).
    pixels: Array  #: u, v [px], (n, 2).
    size_px: tuple[int, int]  #: width and height of the picture [px].

    @property
    def usable(self) -> bool:
        """Whether it shows enough corners."""
        return len(self.numbers) >= MIN_CORNERS


def find_boards(
    folder: Path, manifest: Manifest, force: bool, on_progress: Callable[[str, float | None], None]
) -> tuple[list[BoardPicture], tuple[str, ...]]:
    """Detect the board of `[cameras.board]` in its pictures and write `board_corners.csv`.

    A table that exists is kept without `force`, if the campaign has photographs of the probe to go on with.

    Args:
        folder: of the campaign.
        manifest: of the campaign.
        force: detect again and replace the table.
        on_progress: called with the step and the fraction done.

    Returns:
        The pictures, none if the campaign has no board or its table is kept, and notes for the user.

    Raises:
        InputError: there are no pictures, or a camera or the placement `world` has no usable one.
    """
    table = manifest.cameras
    if table is None or table.board is None:
        return [], ()
    path = folder / BOARD_CORNERS
    if path.exists() and not force and (folder / "images").is_dir():
        return [], (f"{BOARD_CORNERS} exists and is used; --force detects the board again",)
    check_overwrite(path, force)
    files, board, pictures = _files(folder, table), table.board.board(), []
    for number, (file, placement, camera) in enumerate(files):
        on_progress(f"board in {file.name}", number / len(files))
        grey = read_grey(file)
        numbers, pixels = detect_board(grey, board)
        pictures.append(BoardPicture(file, placement, camera, numbers, pixels, (grey.shape[1], grey.shape[0])))
    used = [one for one in pictures if one.usable]
    what = f"the board of {table.board.squares[0]} x {table.board.squares[1]} squares, {table.board.dictionary}"
    if not used:
        raise InputError(f"{folder / BOARD_IMAGES}: no picture shows {what}; check squares and dictionary")
    for camera in table.names:
        if not any(one.camera == camera for one in used) and not table.calibration:
            raise InputError(f"{folder / BOARD_IMAGES}: no picture by camera {camera} shows {what}")
    if not any(one.placement == WORLD for one in used):
        raise InputError(f"{folder / BOARD_IMAGES}: no usable picture {WORLD}-CAMERA, which defines the world")
    lines = [
        f"{one.placement},{one.camera},{number},{u:.4f},{v:.4f},{one.size_px[0]},{one.size_px[1]}"
        for one in used
        for number, (u, v) in zip(one.numbers, one.pixels, strict=True)
    ]
    write_atomically(path, "\n".join([BOARD_CORNERS_SCHEMA.like, *lines, ""]).encode())
    notes = tuple(
        f"{one.path.name}: left out, {len(one.numbers)} corners of the board are seen, {MIN_CORNERS} are needed"
        for one in pictures
        if not one.usable
    )
    return pictures, notes


def _files(folder: Path, table: CamerasTable) -> list[tuple[Path, str, str]]:
    """Return path, placement and camera of each picture; refuse a name that has none."""
    images = folder / BOARD_IMAGES
    if not images.is_dir():
        raise InputError(
            f"{images}: no such folder; put the pictures of the board there as {WORLD}-CAMERA.png, 01-CAMERA.png ..."
        )
    found: dict[tuple[str, str], Path] = {}
    for path in sorted(images.iterdir()):
        if path.suffix.lower() not in SUFFIXES:
            continue
        camera = next((name for name in table.names if path.stem.lower().endswith(f"-{name}".lower())), None)
        placement = "" if camera is None else path.stem[: -len(camera) - 1]
        if camera is None or not placement:
            raise InputError(f"{path}: is not named PLACEMENT-CAMERA with one of the cameras {', '.join(table.names)}")
        if "," in placement or '"' in placement:
            raise InputError(f"{path}: rename it; a placement has letters, digits, - and _")
        placement = WORLD if placement.lower() == WORLD else placement
        if (placement, camera) in found:
            raise InputError(f"{path}: a second picture of placement {placement} by {camera}; keep one")
        found[placement, camera] = path
    if not found:
        raise InputError(f"{images}: has no pictures of the board; name them {WORLD}-CAMERA.png, 01-CAMERA.png ...")
    return [(path, placement, camera) for (placement, camera), path in found.items()]


def board_overlay(picture: BoardPicture) -> NDArray[np.uint8]:
    """Return the picture with its detected corners and their numbers, for inspection."""
    import cv2

    drawn = cv2.cvtColor(read_grey(picture.path), cv2.COLOR_GRAY2BGR)
    if len(picture.numbers):
        pixels = picture.pixels.astype(np.float32).reshape(-1, 1, 2)
        cv2.aruco.drawDetectedCornersCharuco(
            drawn, pixels, picture.numbers.astype(np.int32).reshape(-1, 1), (0, 0, 255)
        )
    return np.asarray(drawn, dtype=np.uint8)
