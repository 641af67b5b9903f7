"""Bundle adjustment: cameras calibrated together from pictures of a board, with their joint covariance.

Unknown are the cameras, the pose of the board in each placement but one, and the scale of the print. The placement
whose pose is known defines the world. What a calibration file states of a camera enters as a prior.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from scipy.spatial.transform import Rotation

from probedesign.core.errors import InputError
from probedesign.core.frames import Array, pose, skew
from probedesign.vision.boards import Board
from probedesign.vision.calibrate import (
    FALSE_ALARM,
    MAX_CONDITION,
    MAX_FOCAL_STD,
    MAX_OUTLIER_FRACTION,
    MIN_NOISE_PX,
    scaled,
)
from probedesign.vision.camera import LINEAR, Camera

MIN_PLACEMENTS = 3
"""Placements of a board that determine focal lengths, principal point and their agreement."""
START_STD_PX = 0.3
"""Standard deviation of a detected corner before the residuals estimate it [px] (assumed)."""
MAX_RESIDUAL_PX = 3.0
"""RMS residual beyond which the pictures are not of this board: a corner is detected to a tenth of a pixel, and a sheet
that bends by a hundredth of its width displaces its corners by a few pixels (assumed)."""
CONTRADICTION = 1e-6
"""Probability that a valid prior is refused."""
SKEW = 2  # index of the skew among a camera's parameters
INTRINSIC = (0, 1, 3, 4)


@dataclass(frozen=True)
class BoardView:
    """Corners of one placement of the board in one camera's picture."""

    placement: str  #: name of the placement.
    camera: str  #: name of the camera.
    numbers: NDArray[np.intp]  #: of the corners, rows of `Board.corners`, (n,).
    pixels: Array  #: u, v [px], (n, 2).
    size_px: tuple[int, int]  #: width and height of the picture [px].


@dataclass(frozen=True)
class RelativePose:
    """Pose of a camera relative to another, as a calibration file states it."""

    camera: str  #: camera, other: names.
    other: str
    T_camera_other: Array  #: maps the other's axes into the camera's, (4, 4).
    std_rad: float  #: standard deviation of its rotation about each axis [rad].
    std_m: float  #: of its translation along each axis [m].


@dataclass(frozen=True)
class BundleProblem:
    """What the cameras are fitted to."""

    board: Board  #: in the pictures.
    views: tuple[BoardView, ...]  #: of it.
    world: str  #: name of the placement whose pose is known.
    T_world_board: Array  #: its pose there, (4, 4).
    scale_std: float  #: relative standard deviation of the printed squares' size.
    #: cameras with intrinsic parameters, `cov` and `std_px` of a calibration file, by name.
    stated: Mapping[str, Camera]
    relative: tuple[RelativePose, ...]  #: stated poses between cameras.


@dataclass(frozen=True)
class _State:
    """Unknowns: the cameras, the poses T_world_board of the placements and the relative error of the scale."""

    cameras: Mapping[str, Camera]
    boards: Mapping[str, Array]
    scale: float = 0.0


def calibrate_with_board(names: Sequence[str], problem: BundleProblem, distortion: int) -> list[Camera]:
    """Calibrate cameras from pictures of a board by least squares on pixels.

    Corners that contradict all others are left out. The noise of each camera's corners is estimated from its residuals.
    The covariance includes that of the board's scale and of the stated parameters.

    Args:
        names: of the cameras.
        problem: pictures, board and priors.
        distortion: number of coefficients to fit for cameras that no file states.

    Returns:
        The cameras in the order of the names, with joint covariance (`Camera.common`), residuals and outliers.

    Raises:
        InputError: too few pictures, pictures that do not determine a camera, fit no camera, or contradict a file.
    """
    views = list(problem.views)
    state = _placed(problem, {name: _intrinsics(name, problem, distortion) for name in names})
    std = {name: max(camera.std_px, START_STD_PX) for name, camera in state.cameras.items()}
    inside = [np.ones(len(view.numbers), dtype=bool) for view in views]
    for _ in range(8):
        fit = _Fit(problem, tuple(views), tuple(inside), std)
        state = fit.solved(state)
        residuals = [fit.residuals(state, view) for view in views]
        std = fit.noise(residuals)
        limit = stats.chi2.isf(FALSE_ALARM / sum(map(len, inside)), 2)
        fits = [np.sum(r**2, axis=1) <= limit * std[view.camera] ** 2 for r, view in zip(residuals, views, strict=True)]
        if all((a == b).all() for a, b in zip(fits, inside, strict=True)):
            break
        inside = fits
    fit = _Fit(problem, tuple(views), tuple(inside), std)
    state = fit.solved(state)
    cameras = fit.with_covariance(state)
    found = [_with_residuals(camera, fit, state, std) for camera in cameras]
    for camera in found:
        _check_fit(camera, fit)
    fit.check_priors(state)
    return found


# start


def _intrinsics(name: str, problem: BundleProblem, distortion: int) -> Camera:
    """Return a camera as its file states it, or with focal lengths from the pictures' homographies.

    The principal point is taken in the middle: ω = diag(1/fu², 1/fv², 1) is orthogonal for the columns of each
    homography, h1ᵀ ω h2 = 0 and h1ᵀ ω h1 = h2ᵀ ω h2.

    Source: Z. Zhang, A flexible new technique for camera calibration, IEEE Trans. PAMI 22, 2000.
    """
    own = [view for view in problem.views if view.camera == name]
    sizes = {view.size_px for view in own}
    if len(sizes) > 1:
        (a, b), (c, d) = sorted(sizes)[:2]
        raise InputError(f"camera {name}: its pictures have different sizes, {a} x {b} and {c} x {d}; take all with "
                         "one setting")  # fmt: skip
    if name in problem.stated:
        return problem.stated[name]
    if len(own) < MIN_PLACEMENTS:
        raise InputError(f"camera {name}: sees the board in {len(own)} usable pictures; at least {MIN_PLACEMENTS} are "
                         "needed, better 10 or more")  # fmt: skip
    size = own[0].size_px
    middle = (np.array(size) - 1) / 2
    equations, right = [], []
    for view in own:
        H = _homography(problem.board.corners[view.numbers, :2], view.pixels - middle)
        h, k = H[:, 0], H[:, 1]
        equations += [h[:2] * k[:2], h[:2] ** 2 - k[:2] ** 2]
        right += [-h[2] * k[2], k[2] ** 2 - h[2] ** 2]
    inverse_square = np.linalg.lstsq(np.array(equations), np.array(right), rcond=None)[0]
    usual = 1.2 * max(size)
    with np.errstate(invalid="ignore", divide="ignore"):
        focal = 1 / np.sqrt(inverse_square)
    focal = np.where(np.isfinite(focal) & (focal > 0.2 * max(size)) & (focal < 50 * max(size)), focal, usual)
    K = np.array([[focal[0], 0.0, middle[0]], [0.0, focal[1], middle[1]], [0.0, 0.0, 1.0]])
    number = LINEAR + distortion
    return Camera(name, K, np.eye(3), np.zeros(3), np.zeros(distortion), np.zeros((number, number)), size_px=size)


def _homography(points: Array, pixels: Array) -> Array:
    """Return H of points of a plane (n, 2) to pixels (n, 2), (3, 3), with the plane in front of the camera."""
    plane, to_plane = scaled(points)
    image, to_image = scaled(pixels)
    one, zero = np.ones((len(points), 1)), np.zeros((len(points), 3))
    X = np.hstack([plane, one])
    rows = np.vstack([np.hstack([X, zero, -image[:, :1] * X]), np.hstack([zero, X, -image[:, 1:] * X])])
    H = np.linalg.solve(to_image, np.linalg.svd(rows)[2][-1].reshape(3, 3) @ to_plane)
    depth = np.hstack([points, one]) @ H[2]
    return np.asarray(H * np.sign(depth.sum()) / np.linalg.norm(H))


def _seen_pose(camera: Camera, view: BoardView, board: Board) -> Array:
    """Return T_camera_board of one picture, (4, 4)."""
    rays = camera.rays(view.pixels) @ camera.R_camera_world.T
    H = _homography(board.corners[view.numbers, :2], rays[:, :2] / rays[:, 2:])
    H = H / np.sqrt(np.linalg.norm(H[:, 0]) * np.linalg.norm(H[:, 1]))
    U, _, Vh = np.linalg.svd(np.column_stack([H[:, 0], H[:, 1], np.cross(H[:, 0], H[:, 1])]))
    return pose(U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vh)]) @ Vh, H[:, 2])


def _placed(problem: BundleProblem, cameras: Mapping[str, Camera]) -> _State:
    """Return a first state: from the known placement on, each camera by a placement and each placement by a camera."""
    seen = {(v.camera, v.placement): _seen_pose(cameras[v.camera], v, problem.board) for v in problem.views}
    boards = {problem.world: problem.T_world_board}
    poses: dict[str, Array] = {}  # T_world_camera
    while True:
        before = len(boards) + len(poses)
        for (camera, placement), T_camera_board in seen.items():
            if placement in boards and camera not in poses:
                poses[camera] = boards[placement] @ np.linalg.inv(T_camera_board)
            elif camera in poses and placement not in boards:
                boards[placement] = poses[camera] @ T_camera_board
        for one in problem.relative:
            if one.other in poses and one.camera not in poses:
                poses[one.camera] = poses[one.other] @ np.linalg.inv(one.T_camera_other)
            elif one.camera in poses and one.other not in poses:
                poses[one.other] = poses[one.camera] @ one.T_camera_other
        if len(boards) + len(poses) == before:
            break
    for name in cameras:
        if name not in poses:
            raise InputError(f"camera {name}: no picture of the board connects it with the world; photograph the board "
                             f"in the placement {problem.world!r} with it")  # fmt: skip
    placed = {name: replace(camera, R_camera_world=poses[name][:3, :3].T, p_world=poses[name][:3, 3])
              for name, camera in cameras.items()}  # fmt: skip
    return _State(placed, boards)


# fit


@dataclass(frozen=True)
class _Fit:
    """Least squares for given noise and outliers."""

    problem: BundleProblem  #: of it.
    views: tuple[BoardView, ...]  #: of the problem.
    inside: tuple[NDArray[np.bool_], ...]  #: corners of each view that are used.
    std: Mapping[str, float]  #: standard deviation of a corner in each camera [px].

    def residuals(self, state: _State, view: BoardView) -> Array:
        """Return pixels minus projections of one picture [px], (n, 2)."""
        return np.asarray(view.pixels - state.cameras[view.camera].project(self._points(state, view)[1]))

    def _points(self, state: _State, view: BoardView) -> tuple[Array, Array]:
        """Return the corners of a picture from the board's origin in world axes, and in the world, (n, 3) each."""
        T = state.boards[view.placement]
        arms = (1 + state.scale) * self.problem.board.corners[view.numbers] @ T[:3, :3].T
        return arms, arms + T[:3, 3]

    def _columns(self, state: _State) -> tuple[dict[str, NDArray[np.intp]], dict[str, slice], int]:
        """Return which unknowns belong to each camera (its parameters without the skew) and each placement."""
        cameras, boards, at = {}, {}, 0
        for name, camera in state.cameras.items():
            number = len(camera.cov) - 1
            cameras[name] = np.arange(at, at + number)
            at += number
        for name in state.boards:
            if name != self.problem.world:
                boards[name] = slice(at, at + 6)
                at += 6
        return cameras, boards, at + 1  # the last is the scale

    def system(self, state: _State) -> tuple[Array, Array]:
        """Return weighted residuals (k,) and their derivatives by the unknowns (k, p), the priors' last."""
        cameras, boards, number = self._columns(state)
        rows, right = [], []
        for view, inside in zip(self.views, self.inside, strict=True):
            camera, weight = state.cameras[view.camera], 1 / self.std[view.camera]
            arms, points = self._points(state, view)
            J = np.zeros((len(points), 2, number))
            J[:, :, cameras[view.camera]] = np.delete(camera.by_parameters(points), SKEW, axis=2)
            by_point = camera.by_point(points)
            if view.placement in boards:
                turned = np.cross(arms[:, None, :], by_point)  # by_point @ -skew(arms)
                J[:, :, boards[view.placement]] = np.concatenate([turned, by_point], axis=2)
            J[:, :, -1] = (by_point @ arms[..., None])[..., 0] / (1 + state.scale)
            rows.append(-weight * J[inside].reshape(-1, number))
            right.append(weight * (view.pixels - camera.project(points))[inside].ravel())
        for values, derivative in self._priors(state):
            rows.append(derivative)
            right.append(values)
        return np.concatenate(right), np.concatenate(rows)

    def _priors(self, state: _State) -> list[tuple[Array, Array]]:
        """Return weighted residuals of the scale, the stated cameras and the stated relative poses."""
        cameras, _, number = self._columns(state)
        scale = np.zeros((1, number))
        scale[0, -1] = 1 / self.problem.scale_std
        found = [(np.array([state.scale / self.problem.scale_std]), scale)]
        for name, stated in self.problem.stated.items():
            own = [*INTRINSIC, *range(LINEAR, len(stated.cov))]
            weight = 1 / np.sqrt(np.diag(stated.cov)[own])
            J = np.zeros((len(own), number))
            columns = np.delete(np.arange(len(stated.cov)), SKEW)
            J[:, cameras[name][np.searchsorted(columns, own)]] = np.diag(weight)
            found.append((weight * (_parameters(state.cameras[name]) - _parameters(stated)), J))
        for one in self.problem.relative:
            a, b = state.cameras[one.camera], state.cameras[one.other]
            R, centre = a.R_camera_world @ b.R_camera_world.T, a.R_camera_world @ (b.p_world - a.p_world)
            turn = Rotation.from_matrix(R @ one.T_camera_other[:3, :3].T).as_rotvec()
            J = np.zeros((6, number))
            # parameters of a camera without its skew: four intrinsic ones, rotation, centre
            J[:3, cameras[one.camera][4:7]], J[:3, cameras[one.other][4:7]] = np.eye(3), -R
            J[3:, cameras[one.camera][4:7]] = -skew(centre)
            J[3:, cameras[one.camera][7:10]] = -a.R_camera_world
            J[3:, cameras[one.other][7:10]] = a.R_camera_world
            weight = 1 / np.repeat([one.std_rad, one.std_m], 3)
            off = np.concatenate([turn, centre - one.T_camera_other[:3, 3]])
            found.append((weight * off, weight[:, None] * J))
        return found

    def moved(self, state: _State, step: Array) -> _State:
        """Return the state with its unknowns changed by a step (p,)."""
        cameras, boards, _ = self._columns(state)
        poses = dict(state.boards)
        for name, own in boards.items():
            turn, shift = np.split(step[own], 2)
            T = poses[name]
            poses[name] = pose(Rotation.from_rotvec(turn).as_matrix() @ T[:3, :3], T[:3, 3] + shift)
        seen = {name: one.moved(np.insert(step[cameras[name]], SKEW, 0.0)) for name, one in state.cameras.items()}
        return _State(seen, poses, state.scale + float(step[-1]))

    def solved(self, state: _State) -> _State:
        """Return the state of least squares (Levenberg-Marquardt)."""
        damping, (r, J) = 1e-3, self.system(state)
        for _ in range(200):
            H, g = J.T @ J, J.T @ r
            size = np.sqrt(np.maximum(np.diag(H), 1e-300))
            scaled_H = H / size / size[:, None]
            step = -np.linalg.solve(scaled_H + damping * np.eye(len(g)), g / size) / size
            with np.errstate(all="ignore"):  # a step too far may put a corner behind a camera
                trial = self.moved(state, step)
                r_trial, J_trial = self.system(trial)
            gain = r @ r - r_trial @ r_trial
            if gain >= 0 and np.isfinite(J_trial).all():
                state, r, J, damping = trial, r_trial, J_trial, max(damping / 10, 1e-12)
                if gain <= 1e-12 * (1 + r @ r):
                    break
            else:
                damping *= 10
                if damping > 1e12:
                    break
        return state

    def noise(self, residuals: list[Array]) -> dict[str, float]:
        """Return the standard deviation of a corner in each camera [px], by its residuals."""
        number = 2 * sum(int(np.sum(inside)) for inside in self.inside)
        placements = {view.placement for view in self.views} - {self.problem.world}
        fitted = 6 * len(placements) + sum(6 if c in self.problem.stated else 10 for c in self.std)
        share = max(1 - fitted / number, 0.1)
        found = {}
        for name in self.std:
            own = [r[inside] for r, view, inside in zip(residuals, self.views, self.inside, strict=True)
                   if view.camera == name]  # fmt: skip
            square = np.concatenate(own).ravel() ** 2 if own else np.zeros(0)
            mean = float(np.mean(square)) if len(square) else START_STD_PX**2
            found[name] = max(np.sqrt(mean / share), MIN_NOISE_PX)
        return found

    def with_covariance(self, state: _State) -> list[Camera]:
        """Return the cameras with the factor of their joint covariance.

        Raises:
            InputError: the pictures do not determine the cameras.
        """
        _, J = self.system(state)
        size = np.sqrt(np.sum(J**2, axis=0))
        if not (size > 0).all() or np.linalg.cond(J / size) > MAX_CONDITION:
            raise InputError("the pictures of the board do not determine the cameras; take more, with the board tilted "
                             "by 20 to 40° in different directions")  # fmt: skip
        columns, _, _ = self._columns(state)
        # J = Q R, so the unknowns err by R⁻¹ z with independent standard normals z
        factor = np.linalg.inv(np.linalg.qr(J / size, mode="r")) / size[:, None]
        cameras = []
        for name, camera in state.cameras.items():
            common = np.insert(factor[columns[name]], SKEW, 0.0, axis=0)
            cameras.append(replace(camera, cov=common @ common.T, common=common))
        return cameras

    def check_priors(self, state: _State) -> None:
        """Refuse pictures that contradict the stated parameters."""
        values = np.concatenate([value for value, _ in self._priors(state)])
        square = float(values @ values)
        if len(values) > 1 and square > stats.chi2.isf(CONTRADICTION, len(values)):
            raise InputError(
                f"the pictures of the board contradict the calibration files by {np.sqrt(square / len(values)):.0f} "
                "standard deviations; check square_mm, the unit of lengths, and that the files are of these cameras"
            )


def _parameters(camera: Camera) -> Array:
    """Return the focal lengths, principal point and distortion, (4 + d,)."""
    K = camera.K
    return np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2], *camera.distortion])


def _with_residuals(camera: Camera, fit: _Fit, state: _State, std: Mapping[str, float]) -> Camera:
    """Return a camera with its residuals and the names of the corners that were left out."""
    residuals, outliers = [np.zeros((0, 2))], []
    for view, inside in zip(fit.views, fit.inside, strict=True):
        if view.camera == camera.name:
            residuals.append(fit.residuals(state, view))
            outliers += [f"{view.placement}/{number}" for number in view.numbers[~inside]]
    return replace(
        camera, residuals_px=np.concatenate(residuals), outliers=tuple(outliers), std_px=float(std[camera.name])
    )


def _check_fit(camera: Camera, fit: _Fit) -> None:
    """Refuse a camera that the pictures do not fit or do not determine."""
    total = len(camera.residuals_px)
    if camera.std_px > MAX_RESIDUAL_PX or len(camera.outliers) > MAX_OUTLIER_FRACTION * total:
        raise InputError(
            f"camera {camera.name}: the pictures of the board do not fit one camera, residual {camera.std_px:.2g} px, "
            f"{len(camera.outliers)} of {total} corners left out; is the board plane, and did no camera move?"
        )
    focal = float(np.sqrt(max(camera.cov[0, 0], camera.cov[1, 1])) / min(camera.K[0, 0], camera.K[1, 1]))
    if not focal < MAX_FOCAL_STD:
        raise InputError(f"camera {camera.name}: the pictures of the board determine the focal length only to "
                         f"±{focal:.0%}; tilt it by 20 to 40° in different directions")  # fmt: skip
