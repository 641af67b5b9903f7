"""Simulated calibration of cameras by a board or by files: pictures of a board, its corners, and OpenCV's YAML."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

from probedesign.core.frames import Array, pose
from probedesign.core.units import MM
from probedesign.simulation.stereo_rig import ELEVATION, SIZE_PX, Picture, RenderStyle, StereoRig, exposed
from probedesign.vision import require_opencv
from probedesign.vision.boards import Board
from probedesign.vision.camera import Camera
from probedesign.vision.camera_files import assumed_covariance
from probedesign.vision.markers import write_png

SQUARES, DICTIONARY = (9, 7), "DICT_5X5_100"
BOARD_WIDTH = 0.75
"""Width of the board over the largest extent of the space in which the probe moves (assumed)."""
PLACEMENTS = 10
"""Placements of the board besides the one that defines the world."""
SCALE_STD = 1e-3
"""Relative standard deviation of the printed size, as a campaign states it by default."""
CORNER_PX = 0.05
"""Standard deviation of a detected corner without pictures [px]: that of the detection in rendered ones."""
FILE_PX = 0.3
"""Reprojection error that simulated calibration files state [px] (assumed)."""
PAPER, INK, PAPER_MARGIN = 0.8, 0.06, 10.0 * MM  # albedos, and the white border round the squares [m]
_TEXTURE = 20e3  # pixels of the board's picture in a metre: edges of squares of whole millimetres are exact
_FINE = 3  # samples along each side of a pixel


@dataclass(frozen=True, eq=False)
class SimulatedBoard:
    """A board in front of the cameras, printed with an error of its scale."""

    rig: StereoRig  #: the cameras.
    seed: int  #: of placements, scale and noise.
    exact: bool  #: the print has its nominal size.

    def _rng(self, what: int) -> np.random.Generator:
        return np.random.default_rng([self.seed, 2, what])

    @cached_property
    def board(self) -> Board:
        """The board as stated."""
        _, size = self.rig.workspace
        square = max(math.floor(BOARD_WIDTH * float(size.max()) / SQUARES[0] / MM), 4)
        return Board(SQUARES, square * MM, round(0.75 * square) * MM, DICTIONARY)

    @cached_property
    def scale(self) -> float:
        """Printed over stated size."""
        return 1.0 if self.exact else 1.0 + SCALE_STD * float(self._rng(0).normal())

    @cached_property
    def placements(self) -> dict[str, Array]:
        """Poses T_world_board, (4, 4); that of "world" is known, in whole micrometres and millionths of a degree."""
        centre, size = self.rig.workspace
        rng, facing = (
            self._rng(1),
            Rotation.from_rotvec([-ELEVATION, 0.0, 0.0]) * Rotation.from_rotvec([-math.pi / 2, 0.0, 0.0]),
        )
        middle = np.array([*self.board.size, 0.0]) / 2
        poses = {"world": (facing, centre)}
        for number in range(1, PLACEMENTS + 1):
            turn = Rotation.from_rotvec(rng.uniform(-1, 1, 3) * (0.5, 0.5, 0.8))
            poses[f"{number:02d}"] = facing * turn, centre + rng.uniform(-0.15, 0.15, 3) * size.max()
        found = {}
        for name, (turn, place) in poses.items():
            rotvec = np.radians(np.round(np.degrees(turn.as_rotvec()), 6))
            R = Rotation.from_rotvec(rotvec).as_matrix()
            found[name] = pose(R, np.round(place - R @ middle, 6))
        return found

    def manifest_lines(self) -> list[str]:
        """Return `[cameras.board]` of campaign.toml."""
        board, T = self.board, self.placements["world"]
        turn = np.degrees(Rotation.from_matrix(T[:3, :3]).as_rotvec())
        return ["", "[cameras.board]             # its pose in the pictures board/world-CAMERA.png",
                f"squares = {list(board.squares)}", f"square_mm = {board.square / MM:g}",
                f"marker_mm = {board.marker / MM:g}", f'dictionary = "{board.dictionary}"',
                f"scale_std_percent = {100 * SCALE_STD:g}",
                f"p_world_mm = {(np.round(T[:3, 3] / MM, 3) + 0.0).tolist()}",
                f"rotation_world_deg = {(np.round(turn, 6) + 0.0).tolist()}"]  # fmt: skip

    def corners_csv(self) -> str:
        """Return the text of `board_corners.csv`, with noise."""
        rng, rows = self._rng(2), ["placement,camera,corner,u_px,v_px,width_px,height_px"]
        for name, T in self.placements.items():
            points = self.scale * self.board.corners @ T[:3, :3].T + T[:3, 3]
            for camera in self.rig.cameras:
                pixels = camera.project(points) + CORNER_PX * rng.normal(size=(len(points), 2))
                inside = np.all((pixels > 0) & (pixels < np.array(SIZE_PX) - 1), axis=1).tolist()
                rows += [f"{name},{camera.name},{i},{u:.4f},{v:.4f},{SIZE_PX[0]},{SIZE_PX[1]}"
                         for i, (u, v) in enumerate(pixels) if inside[i]]  # fmt: skip
        return "\n".join(rows) + "\n"

    def photograph(self, folder: Path, on_progress: Callable[[str, float | None], None]) -> None:
        """Render the pictures PLACEMENT-CAMERA.png; OpenCV must be installed."""
        folder.mkdir()
        total = len(self.placements) * len(self.rig.cameras)
        for i, (name, T) in enumerate(self.placements.items()):
            for k, camera in enumerate(self.rig.cameras):
                number = i * len(self.rig.cameras) + k
                on_progress("pictures of the board", number / total)
                style = RenderStyle(seed=self.seed * 1000 + 500 + number)
                write_png(
                    folder / f"{name}-{camera.name}.png",
                    render_board(camera, self.board, T, self.scale, SIZE_PX, style),
                )


def render_board(
    camera: Camera, board: Board, T_world_board: Array, scale: float, size_px: tuple[int, int], style: RenderStyle
) -> Picture:
    """Render a picture of a flat board in even light, grey levels (height, width).

    Args:
        camera: that sees it.
        board: as designed.
        T_world_board: its pose, (4, 4).
        scale: printed over designed size.
        size_px: width and height of the picture [px].
        style: background, blur and noise.
    """
    require_opencv()
    import cv2

    rng = np.random.default_rng(style.seed)
    width, height = size_px
    picture = np.full((height, width), style.background)
    border = round(PAPER_MARGIN * _TEXTURE)
    texture = np.where(np.pad(board.picture(_TEXTURE), border, constant_values=255) > 127, PAPER, INK).astype(
        np.float32
    )
    w, h = board.size
    m = PAPER_MARGIN
    outline = np.array([(-m, -m, 0), (w + m, -m, 0), (w + m, h + m, 0), (-m, h + m, 0)])
    outline = scale * outline @ T_world_board[:3, :3].T + T_world_board[:3, 3]
    edge = camera.project(outline)
    low = np.clip(np.floor(edge.min(axis=0)).astype(int) - 12, 0, size_px)
    high = np.clip(np.ceil(edge.max(axis=0)).astype(int) + 13, 0, size_px)
    if (high - low < 3).any():
        return exposed(picture, style, rng)
    v, u = np.mgrid[low[1] : high[1], low[0] : high[0]]
    rays = camera.rays(np.stack([u, v], axis=-1).astype(float))
    normal, origin = T_world_board[:3, 2], T_world_board[:3, 3]
    distance = (origin - camera.p_world) @ normal / (rays @ normal)
    on_board = (camera.p_world + distance[..., None] * rays - origin) @ T_world_board[:3, :2] / scale
    x, y = np.moveaxis(on_board * _TEXTURE + border - 0.5, -1, 0)
    (x_v, x_u), (y_v, y_u) = np.gradient(x), np.gradient(y)  # a ray's place is linear within a pixel
    light = np.zeros(x.shape)
    offsets = (np.arange(_FINE) + 0.5) / _FINE - 0.5
    for down in offsets:
        for right in offsets:
            column = (x + x_u * right + x_v * down).astype(np.float32)
            row = (y + y_u * right + y_v * down).astype(np.float32)
            light += cv2.remap(texture, column, row, cv2.INTER_NEAREST, None, cv2.BORDER_CONSTANT, style.background)
    part = gaussian_filter(rng.normal(size=(height // 8 + 2, width // 8 + 2)), 4.0) * 10.0
    uneven = 1 + style.mottle * np.kron(part, np.ones((8, 8)))[:height, :width]
    picture[low[1] : high[1], low[0] : high[0]] = light / _FINE**2
    return exposed(picture * uneven, style, rng)


# files


def calibration_yaml(camera: Camera, target_world: Array, rng: np.random.Generator) -> str:
    """Return OpenCV's YAML of a camera with its pose in the world in mm, its parameters drawn as far off as assumed."""
    distance = float(np.linalg.norm(camera.p_world - target_world))
    std = np.sqrt(np.diag(assumed_covariance(camera, FILE_PX, distance)))
    stated = camera.moved(std * rng.normal(size=len(std)))
    R = stated.R_camera_world
    matrices = {"camera_matrix": stated.K, "distortion_coefficients": np.append(stated.distortion, 0.0)[:, None],
                "R": R, "T": (-R @ stated.p_world / MM)[:, None]}  # fmt: skip
    lines = ["%YAML:1.0", "---", f"image_width: {SIZE_PX[0]}", f"image_height: {SIZE_PX[1]}"]
    for key, matrix in matrices.items():
        lines += [f"{key}: !!opencv-matrix", f"   rows: {matrix.shape[0]}", f"   cols: {matrix.shape[1]}", "   dt: d",
                  f"   data: [ {', '.join(f'{x:.16e}' for x in matrix.ravel())} ]"]  # fmt: skip
    return "\n".join([*lines, f"avg_reprojection_error: {FILE_PX:.16e}", ""])
