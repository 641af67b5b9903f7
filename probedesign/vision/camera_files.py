"""Calibration files of other programs: OpenCV's storage (YAML, XML), ROS camera_info and Kalibr's camchain.

Such a file states no covariance. Its cameras get one from the reprojection error: a projected point is assumed to err
by that, shared equally among the camera's parameters.
"""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate, combinations
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from probedesign.core.csv_tables import read_text
from probedesign.core.errors import InputError, one_line, quoted, require
from probedesign.core.frames import Array, pose
from probedesign.vision.camera import DISTORTIONS, LINEAR, Camera

MAX_BYTES = 5_000_000
MAX_DEPTH = 100  #: Of nested values. OpenCV reads them by recursion, and its stack ends after some 100 000.
#: Reprojection error of a file that states none [px] (assumed: a careful calibration reaches 0.1 to 0.5 px).
ASSUMED_PX = 0.5
ROTATION_TOLERANCE = 1e-3  #: Largest deviation of Rᵀ R from the identity: files round to three digits or more.
BASELINE = (0.02, 10.0)  #: Plausible distances between two cameras that see a probe [m] (assumed).
DISTANCE = (0.05, 20.0)  #: Plausible distances of a camera from the base of the probe [m] (assumed).
MATRIX = ("camera_matrix", "Camera_Matrix", "cameraMatrix", "K", "M", "mtx")
BENDS = ("distortion_coefficients", "Distortion_Coefficients", "distCoeffs", "dist_coeffs", "D", "dist")
ROTATION, TRANSLATION = ("R", "rvec"), ("T", "tvec")
WIDTH, HEIGHT = ("image_width", "image_Width"), ("image_height", "image_Height")
SIZE = ("image_size", "imageSize", "resolution")  #: Width and height together.
ERROR = ("avg_reprojection_error", "Avg_Reprojection_Error", "reprojection_error", "rms", "RMS")
#: Names of the distortion models with k1, k2, p1, p2, k3 in ROS and Kalibr, and of none.
PINHOLE = {"plumb_bob", "radtan", "none"}
KEYS = {name + end for names in (MATRIX, BENDS, ROTATION, TRANSLATION, WIDTH, HEIGHT, SIZE, ERROR) for name in names
        for end in ("", "1", "2")} | {"distortion_model"}  # fmt: skip


@dataclass(frozen=True)
class StatedCalibration:
    """Cameras as their files state them."""

    cameras: tuple[Camera, ...]  #: with covariance, in the order of their names.
    in_world: bool  #: whether their poses are those in the world; else they are meaningless.
    notes: tuple[str, ...]  #: lines for the user.


@dataclass(frozen=True)
class _Document:
    """Contents of one or more files."""

    name: str  #: of the files, for messages.
    values: Mapping[str, Any]  #: by key.

    def fail(self, problem: str) -> InputError:
        return InputError(f"{self.name}: {problem}")

    def key(self, names: Sequence[str], suffix: str = "") -> str | None:
        return next((name + suffix for name in names if name + suffix in self.values), None)

    def numbers(self, key: str, counts: Sequence[int]) -> Array:
        """Return a matrix, its rows one after the other, (n,), with one of the counts of numbers."""
        value = self.values[key]
        if isinstance(value, Mapping):
            value = value.get("data")
        try:
            numbers = np.array(value, dtype=float).ravel()
        except (TypeError, ValueError, OverflowError):
            raise self.fail(f"{key} is not a matrix of numbers") from None
        if len(numbers) not in counts:
            raise self.fail(f"{key} has {len(numbers)} numbers; {' or '.join(map(str, counts))} are needed")
        if not np.isfinite(numbers).all():
            raise self.fail(f"{key} has a number that is not finite")
        return numbers

    def number(self, key: str) -> float:
        return float(self.numbers(key, (1,))[0])


def read_camera_files(
    paths: Sequence[Path], names: Sequence[str], reprojection_px: float | None, unit: float | None, target_world: Array
) -> StatedCalibration:
    """Read the calibration of cameras from files.

    Args:
        paths: one file of each camera, in their order; or one or two files of a stereo pair; or a camchain.
        names: of the cameras.
        reprojection_px: reprojection error [px]; None for that in the files, or `ASSUMED_PX`.
        unit: of the translations in OpenCV's files [m]; None if it was not said.
        target_world: a point near which the cameras look [m], (3,).

    Raises:
        InputError: a file is missing, damaged, incomplete, of another lens model, or its numbers are not those of a
            camera; one line.
    """
    documents = [_read(path) for path in paths]
    values = {key: value for document in documents for key, value in document.values.items()}
    merged = _Document(", ".join(map(str, paths)), values)
    poses: dict[str, Array] = {}
    if "cam0" in merged.values:
        cameras = _kalibr(merged, names)
        errors: list[float | None] = [None] * len(cameras)
    elif merged.key(MATRIX, "1") and merged.key(MATRIX, "2"):
        if len(names) != 2:
            raise merged.fail(f"is of a stereo pair, but cameras.names has {len(names)}")
        cameras = [_opencv(merged, name, suffix) for name, suffix in zip(names, ("1", "2"), strict=True)]
        errors = [_error(merged)] * 2
    elif len(documents) != len(names):
        raise merged.fail(f"{len(documents)} files for {len(names)} cameras; give one file of each camera, a stereo "
                          "pair or a camchain")  # fmt: skip
    else:
        cameras = [_opencv(document, name, "") for document, name in zip(documents, names, strict=True)]
        errors = [_error(document) for document in documents]
        stated = {name: _stated_pose(document, unit) for document, name in zip(documents, names, strict=True)}
        poses = {name: T for name, T in stated.items() if T is not None}
        if poses and len(poses) < len(names):
            lacking = next(name for name in names if name not in poses)
            raise merged.fail(f"camera {lacking} has no R and T, but another camera has; all or none state their pose")
    located, notes = [], []
    for camera, error in zip(cameras, errors, strict=True):
        px = reprojection_px or error or ASSUMED_PX
        source = "given in campaign.toml" if reprojection_px else "of the file" if error else "assumed"
        notes.append(f"camera {camera.name}: calibration file, reprojection error {px:g} px ({source})")
        distance, T = 0.0, poses.get(camera.name)  # T_camera_world
        if T is not None:
            centre = -T[:3, :3].T @ T[:3, 3]
            distance = float(np.linalg.norm(centre - target_world))
            if not DISTANCE[0] < distance < DISTANCE[1]:
                raise merged.fail(f"camera {camera.name} would be {distance:.3g} m from the base of the probe; check "
                                  "cameras.length_unit and base.p_world_mm in campaign.toml")  # fmt: skip
            camera = replace(camera, R_camera_world=T[:3, :3], p_world=centre)
        located.append(replace(camera, cov=assumed_covariance(camera, px, distance), std_px=px))
    for a, b in combinations(located if poses else (), 2):
        baseline = float(np.linalg.norm(a.p_world - b.p_world))
        if not BASELINE[0] < baseline < BASELINE[1]:
            raise merged.fail(f"cameras {a.name} and {b.name} would be {baseline:.3g} m apart; check "
                              "cameras.length_unit in campaign.toml")  # fmt: skip
    return StatedCalibration(tuple(located), bool(poses), tuple(notes))


# formats


def _read(path: Path) -> _Document:
    text = read_text(path, "calibration file", MAX_BYTES, "YAML or XML")
    opencv = text.lstrip().startswith(("<", "%YAML"))
    values = _from_opencv(path, text) if opencv else _from_yaml(path, text)
    if not isinstance(values, dict) or not values:
        raise InputError(f"{path}: is not a calibration file; OpenCV's, ROS's and Kalibr's can be read")
    return _Document(str(path), values)


def _from_opencv(path: Path, text: str) -> dict[str, Any]:
    """Return what OpenCV's storage has, in YAML or XML, of the keys that are read."""
    require("cv2", "reading calibration files", "vision", "opencv")
    import cv2

    def value(node: Any) -> Any:
        if node.isSeq():
            return [node.at(i).real() for i in range(node.size())]
        return node.mat() if node.isMap() else node.string() if node.isString() else node.real()

    nested = accumulate(1 if each[-1] not in "]}/>" else -1 for each in re.findall(r"[][{}]|<(?=\w)|</|/>", text))
    damaged = InputError(f"{path}: is not a calibration file of OpenCV, or is cut off")
    if max(nested, default=0) > MAX_DEPTH or re.search(rf"(?:-[ \t]+){{{MAX_DEPTH}}}", text):
        raise damaged
    try:
        storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        return {key: value(storage.getNode(key)) for key in storage.root().keys() if key in KEYS}  # noqa: SIM118
    except (cv2.error, SystemError):
        raise damaged from None


def _from_yaml(path: Path, text: str) -> Any:
    require("yaml", "reading calibration files", "vision", "pyyaml")
    import yaml

    try:
        return yaml.safe_load(text)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        mark = getattr(error, "problem_mark", None)
        line, problem = f":{mark.line + 1}" if mark else "", one_line(getattr(error, "problem", None) or "", 80)
        raise InputError(f"{path}{line}: is not valid YAML, or is cut off: {problem}") from None


def _opencv(document: _Document, name: str, suffix: str) -> Camera:
    """Return a camera of OpenCV or ROS, without pose."""
    key, bends = document.key(MATRIX, suffix), document.key(BENDS, suffix)
    if key is None or bends is None:
        lacking, like = ("camera matrix", MATRIX) if key is None else ("coefficients of distortion", BENDS)
        raise document.fail(f"has no {lacking} of camera {name}, as {like[0] if not suffix else like[-2] + suffix}")
    model = str(document.values.get("distortion_model", "plumb_bob"))
    if model not in PINHOLE:
        raise document.fail(f"distortion_model {quoted(model)} is not supported; calibrate with plumb_bob")
    K = document.numbers(key, (9,)).reshape(3, 3)
    if not np.allclose(K[[1, 2, 2, 2], [0, 0, 1, 2]], [0, 0, 0, 1], atol=1e-9):
        raise document.fail(f"{key} is not a camera matrix: its last row is not 0 0 1, or it has a number below the "
                            "diagonal")  # fmt: skip
    return _camera(document, name, K, document.numbers(bends, (0, 1, 2, 4, 5, 8, 12, 14)), _size(document))


def _kalibr(document: _Document, names: Sequence[str]) -> list[Camera]:
    """Return cameras of Kalibr without poses, in the order cam0, cam1 ..."""
    chain = [document.values[key] for key in sorted(document.values, key=_number) if re.fullmatch(r"cam\d+", key)]
    if len(chain) != len(names):
        raise document.fail(f"has {len(chain)} cameras, but cameras.names {len(names)}")
    cameras: list[Camera] = []
    for i, (name, values) in enumerate(zip(names, chain, strict=True)):
        of_camera = _Document(f"{document.name}: cam{i}", values if isinstance(values, dict) else {})
        for key in ("camera_model", "distortion_model", "intrinsics", "distortion_coeffs"):
            if key not in of_camera.values:
                raise of_camera.fail(f"has no {key}")
        for key, known in (("camera_model", {"pinhole"}), ("distortion_model", PINHOLE)):
            model = str(of_camera.values[key])
            if model not in known:
                raise of_camera.fail(f"{key} {quoted(model)} is not supported; calibrate with pinhole-radtan")
        fu, fv, u, v = of_camera.numbers("intrinsics", (4,))
        K = np.array([[fu, 0.0, u], [0.0, fv, v], [0.0, 0.0, 1.0]])
        size = _size(of_camera)
        cameras.append(_camera(of_camera, name, K, of_camera.numbers("distortion_coeffs", (0, 4)), size))
    return cameras


def _number(key: str) -> int:
    return int(key[3:]) if re.fullmatch(r"cam\d{1,6}", key) else -1


# numbers


def _camera(document: _Document, name: str, K: Array, bends: Array, size: tuple[int, int] | None) -> Camera:
    """Return a camera without pose, its numbers checked."""
    if len(bends) > 5 and np.any(bends[5:]):
        raise document.fail(f"has {len(bends)} coefficients of distortion, of a model that is not supported; calibrate "
                            "with the five k1, k2, p1, p2, k3")  # fmt: skip
    used = int(np.max(np.flatnonzero(bends), initial=-1)) + 1
    bends = bends[: next(number for number in DISTORTIONS if number >= used)]
    focal, (u, v) = np.diag(K)[:2], K[:2, 2]
    width, height = size or (2 * u, 2 * v)
    if not (0 < u < width and 0 < v < height and (focal > 0.1 * width).all() and (focal < 100 * width).all()):
        of = f"of a picture of {width} x {height}" if size else "in pixels"
        stated = f"focal lengths {focal[0]:.5g}, {focal[1]:.5g} and principal point {u:.5g}, {v:.5g}"
        raise document.fail(f"{stated} are not those {of}")
    number = LINEAR + len(bends)
    return Camera(name, K, np.eye(3), np.zeros(3), bends, np.zeros((number, number)), size_px=size)


def _size(document: _Document) -> tuple[int, int] | None:
    width, height, both = document.key(WIDTH), document.key(HEIGHT), document.key(SIZE)
    if width and height:
        size = np.array([document.number(width), document.number(height)])
    elif both is not None:
        size = document.numbers(both, (2,))
    else:
        return None
    if (size < 16).any() or (size % 1).any():
        raise document.fail(f"picture size {size[0]:g} x {size[1]:g} is not one of whole pixels")
    return int(size[0]), int(size[1])


def _error(document: _Document) -> float | None:
    key = document.key(ERROR)
    error = None if key is None else document.number(key)
    if error is not None and not 0 < error < 20:
        raise document.fail(f"{key} = {error:g} px is not the error of a calibration")
    return error


def _stated_pose(document: _Document, unit: float | None) -> Array | None:
    """Return the pose R, T of a document, (4, 4); None if it has none."""
    turn, shift = document.key(ROTATION), document.key(TRANSLATION)
    if turn is None and shift is None:
        return None
    if turn is None or shift is None:
        raise document.fail(f"has {turn or shift}, but no {'translation T' if turn else 'rotation R'}")
    if unit is None:
        raise document.fail(f'{shift} is in the unit of the calibration board; name it, as length_unit = "mm" in '
                            "[cameras]")  # fmt: skip
    numbers = document.numbers(turn, (3, 9))
    if len(numbers) == 3:
        R = Rotation.from_rotvec(numbers).as_matrix()
    else:
        R = numbers.reshape(3, 3)
        if np.abs(R.T @ R - np.eye(3)).max() > ROTATION_TOLERANCE or np.linalg.det(R) < 0:
            raise document.fail(
                f"{turn} is not a rotation: its columns are not of unit length at right angles, or it mirrors"
            )
        U, _, Vh = np.linalg.svd(R)  # the nearest rotation, without the rounding
        R = U @ Vh
    return pose(R, unit * document.numbers(shift, (3,)))


# uncertainty


def assumed_covariance(camera: Camera, px: float, distance: float) -> Array:
    """Return the covariance of a camera whose reprojection error is all that is known, (11 + d, 11 + d).

    Each parameter alone displaces a point at the edge of the picture by the reprojection error over the square root of
    their number, so that all together displace it by the reprojection error.

    Args:
        camera: its parameters.
        px: reprojection error [px].
        distance: of the points that it sees [m]; 0 if its pose is not stated.
    """
    focal = float(camera.K[0, 0])
    radius = float(camera.K[0, 2]) / focal
    share = px / math.sqrt(LINEAR - 1 + len(camera.distortion))
    bends = [share / (focal * size) for size in (radius**3, radius**5, 3 * radius**2, 3 * radius**2, radius**7)]
    std = [*2 * [share / radius], 0.0, *2 * [share], *3 * [share / focal], *3 * [share * distance / focal],
           *bends[: len(camera.distortion)]]  # fmt: skip
    return np.diag(np.square(std))
