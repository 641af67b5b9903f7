"""Calibration of a camera: linear from control points, refined by least squares on pixels, without outliers."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats
from scipy.linalg import rq
from scipy.optimize import least_squares

from probedesign.core.errors import InputError
from probedesign.core.frames import Array
from probedesign.core.units import MM
from probedesign.vision.camera import LINEAR, Camera

#: Control points that leave a plane by less [px, RMS] cannot be distinguished from coplanar ones: three times a click's
#: error of about a pixel (assumed).
FLAT_PX = 3.0
CLICK_PX = 1.0  #: Standard deviation of a click where too few points remain to estimate it [px] (assumed).
#: Smallest standard deviation in any picture [px] (assumed); it keeps exact data from having outliers by rounding.
MIN_NOISE_PX = 0.02
FALSE_ALARM = 1e-3  #: Probability that a calibration without outliers reports one.
#: Random samples of points for a robust start, and their size: with three of twenty points wrong, one sample in four
#: has none of them.
SAMPLES, SAMPLE_SIZE = 200, 7
#: Fraction of outliers that is accepted. More are not slips of the hand but points in a wrong order, and a regular box
#: shifted by a row fits itself except for that row.
MAX_OUTLIER_FRACTION = 0.15
#: Residual beyond which control points are not those of the camera of a calibration file: clicks err by a pixel
#: (assumed).
MAX_RESIDUAL_PX = 5.0
MAX_CONDITION = 1e8  #: Condition number of the equations beyond which rounding dominates.
#: Relative standard deviation of the focal length from which on the points do not show depth (assumed).
MAX_FOCAL_STD = 0.2


# control points


@dataclass(frozen=True)
class ControlPoints:
    """Points of known position and their pixels in one picture."""

    camera: str  #: its name.
    labels: tuple[str, ...]  #: names of the points (n,).
    points_world: Array  #: [m], (n, 3).
    pixels: Array  #: u right, v down [px], (n, 2).

    def subset(self, chosen: NDArray[np.bool_]) -> "ControlPoints":
        """Return some of the points."""
        labels = tuple(np.array(self.labels, dtype=object)[chosen])
        return ControlPoints(self.camera, labels, self.points_world[chosen], self.pixels[chosen])

    def named(self, chosen: NDArray[np.bool_]) -> str:
        """Return some of the points by name, for messages."""
        labels = [label for label, yes in zip(self.labels, chosen, strict=True) if yes]
        more = f" and {len(labels) - 6} more" if len(labels) > 6 else ""
        return f"point{'' if len(labels) == 1 else 's'} {', '.join(labels[:6])}{more}"

    def fail(self, problem: str) -> NoReturn:
        """Raise the error of this camera's control points."""
        raise InputError(f"camera {self.camera}: {problem}")

    def check_depth(self, min_px: float) -> None:
        """Refuse coplanar points, which lie nearer to a plane than `min_px` in the picture."""
        centred = self.points_world - self.points_world.mean(axis=0)
        # [m, RMS]; the last one is the distance from the plane that fits best
        extents = np.linalg.svd(centred, compute_uv=False) / np.sqrt(len(centred))
        spread = np.linalg.norm(self.pixels - self.pixels.mean(axis=0)) / np.sqrt(len(self.pixels))
        if extents[2] * spread / np.linalg.norm(extents[:2]) < min_px:
            self.fail(f"its {len(self.labels)} control points lie in one plane, to {extents[2] / MM:.2g} mm; add "
                      "points in front of it or behind it")  # fmt: skip


def min_points(distortion: int) -> int:
    """Return the number of control points that determines a camera with at least one redundant equation."""
    return (LINEAR + distortion) // 2 + 1


def control_points(
    camera: str, points_world: ArrayLike, pixels: ArrayLike, labels: tuple[str, ...] | None, distortion: int
) -> ControlPoints:
    """Return control points (n, 3) [m] with pixels (n, 2) and names, 1 ... n if None, for a calibration.

    Raises:
        InputError: too few or coplanar points.
    """
    world, image = np.asarray(points_world, dtype=float), np.asarray(pixels, dtype=float)
    control = ControlPoints(camera, labels or tuple(str(i + 1) for i in range(len(world))), world, image)
    if len(world) < min_points(distortion):
        bends = f" and {distortion} of distortion" if distortion else ""
        control.fail(f"{len(world)} control points are too few for 11 parameters{bends}; at least "
                     f"{min_points(distortion)}, better 20")  # fmt: skip
    control.check_depth(FLAT_PX)
    return control


# direct linear transformation


def _projections(points_world: Array, pixels: Array) -> Array:
    """Return the projections that map control points onto their pixels, for many choices of points at once.

    Args:
        points_world: at least six [m], (..., n, 3).
        pixels: (..., n, 2).

    Returns:
        P (..., 3, 4) of norm one, its sign such that most of the points lie in front of the camera.

    Source: Y. I. Abdel-Aziz, H. M. Karara, Direct linear transformation from comparator coordinates into object space
        coordinates, Proc. ASP/UI Symposium on Close-Range Photogrammetry, 1971; scaled as R. Hartley, A. Zisserman,
        Multiple View Geometry in Computer Vision, 2nd ed., algorithm 7.1.
    """
    points, to_points = scaled(points_world)
    images, to_images = scaled(pixels)
    ones = np.ones((*points.shape[:-1], 1))
    X = np.concatenate([points, ones], axis=-1)
    zero = np.zeros_like(X)
    rows_u = np.concatenate([X, zero, -images[..., :1] * X], axis=-1)
    rows_v = np.concatenate([zero, X, -images[..., 1:] * X], axis=-1)
    _, _, Vh = np.linalg.svd(np.concatenate([rows_u, rows_v], axis=-2))
    P = np.linalg.solve(to_images, Vh[..., -1, :].reshape(*Vh.shape[:-2], 3, 4) @ to_points)
    P = P / np.linalg.norm(P, axis=(-2, -1), keepdims=True)
    front = np.sum(np.sign(_depths(P, points_world)), axis=-1) >= 0
    return np.asarray(np.where(front[..., None, None], P, -P))


def _depths(P: Array, points_world: Array) -> Array:
    depth: Array = points_world @ P[..., 2, :3, None] + P[..., 2, 3, None, None]
    return depth[..., 0]


def scaled(points: Array) -> tuple[Array, Array]:
    """Return points (..., n, k) about their mean in units of their spread, and the map (..., k + 1, k + 1) to them."""
    k = points.shape[-1]
    mean = points.mean(axis=-2)
    spread = np.sqrt(((points - mean[..., None, :]) ** 2).mean(axis=(-2, -1)))
    to = np.zeros((*points.shape[:-2], k + 1, k + 1))
    to[..., range(k), range(k)] = 1 / spread[..., None]
    to[..., :k, k] = -mean / spread[..., None]
    to[..., k, k] = 1.0
    return (points - mean[..., None, :]) / spread[..., None, None], to


# calibration


def calibrate(
    name: str, points_world: ArrayLike, pixels: ArrayLike, distortion: int = 0, labels: Sequence[str] | None = None
) -> Camera:
    """Calibrate a camera from control points by Direct Linear Transformation, refined by least squares on pixels.

    Outliers are left out; `Camera.outliers` names them. The covariance is that of Student's t, since few residuals
    estimate their own standard deviation badly.

    Args:
        name: of the camera.
        points_world: control points, at least six, seven with distortion [m], (n, 3).
        pixels: where they appear, u right, v down [px], (n, 2).
        distortion: number of coefficients of distortion to fit, of k1, k2, p1, p2, k3: 0, 1, 2, 4 or 5.
        labels: names of the points (n,); 1 ... n if None.

    Returns:
        The camera, with covariance and outliers.

    Raises:
        InputError: too few points, coplanar or mirrored ones, too many outliers, or points that do not determine the
            camera.
    """
    names = None if labels is None else tuple(labels)
    control = control_points(name, points_world, pixels, names, distortion)
    inside = _start(control)
    for _ in range(20):
        camera = _fitted(control.subset(inside), distortion)
        fits = _fits(camera, control, inside)
        if (fits == inside).all() or np.sum(fits) <= (LINEAR + distortion) / 2:
            break
        inside = fits
    left_out = ~inside
    if np.mean(left_out) > MAX_OUTLIER_FRACTION:
        control.fail(f"{np.sum(left_out)} of {len(inside)} control points do not fit with the others "
                     f"({control.named(left_out)}); check their order and their units")  # fmt: skip
    control.subset(inside).check_depth(max(FLAT_PX, 5 * camera.std_px))
    focal = float(np.sqrt(max(camera.cov[0, 0], camera.cov[1, 1])) / min(camera.K[0, 0], camera.K[1, 1]))
    if not focal < MAX_FOCAL_STD:
        control.fail(f"its control points determine the focal length only to ±{focal:.0%}; spread them more in depth")
    if (camera.depth(control.points_world) <= 0).any():
        control.fail("control points lie on both sides of it; check their order and their pixels")
    if camera.folds(control.points_world):
        control.fail(f"{len(camera.distortion)} distortion coefficients fit no lens; fit fewer")
    return replace(camera, outliers=tuple(control.subset(left_out).labels))


def _start(control: ControlPoints) -> NDArray[np.bool_]:
    """Return the points that fit best with the sample of least median residual: free of outliers if half are.

    Source: P. J. Rousseeuw, Least median of squares regression, J. Am. Stat. Assoc. 79, 1984.
    """
    number = len(control.labels)
    if number <= SAMPLE_SIZE + 1:
        return np.ones(number, dtype=bool)
    shuffled = np.random.default_rng(0).random((SAMPLES, number)).argsort(axis=1)[:, :SAMPLE_SIZE]
    P = _projections(control.points_world[shuffled], control.pixels[shuffled])
    images = control.points_world @ np.swapaxes(P[..., :3], -1, -2) + P[..., None, :, 3]
    with np.errstate(divide="ignore", invalid="ignore"):  # a bad choice of points may put one at infinity
        error = np.linalg.norm(images[..., :2] / images[..., 2:] - control.pixels, axis=2)
    error = np.nan_to_num(error, nan=np.inf)
    kept = max(SAMPLE_SIZE + 1, (2 * number) // 3)
    best = error[np.argmin(np.median(error, axis=1))]
    return np.asarray(best <= np.sort(best)[kept - 1])


def _fitted(control: ControlPoints, distortion: int) -> Camera:
    """Return the camera of least squares on pixels, with its covariance."""
    start = _linear(control, distortion)
    scale = _scale(start, control.points_world)

    def residuals(step: Array) -> Array:
        return np.asarray((start.moved(step * scale).project(control.points_world) - control.pixels).ravel())

    def derivative(step: Array) -> Array:
        moved = start.moved(step * scale)
        return np.asarray(moved.by_parameters(control.points_world).reshape(-1, len(scale)) * scale)

    # The rotation is counted from the start's; its derivative at a step of a thousandth is near enough to converge.
    fit = least_squares(residuals, np.zeros(len(scale)), derivative, method="lm", xtol=1e-14, ftol=1e-14)
    camera = start.moved(fit.x * scale)
    spare = 2 * len(control.labels) - len(scale)
    std_px = float(np.sqrt(2 * fit.cost / spare))
    student = std_px * np.sqrt(spare / (spare - 2)) if spare > 2 else max(std_px, CLICK_PX)
    jacobian = camera.by_parameters(control.points_world).reshape(-1, len(scale)) * scale
    if np.linalg.cond(jacobian) > MAX_CONDITION:
        control.fail("more than one camera fits its control points; add points, spread them in depth")
    spread = np.linalg.pinv(jacobian) * scale[:, None]
    cov = max(student, MIN_NOISE_PX) ** 2 * spread @ spread.T
    return replace(camera, cov=cov, std_px=std_px)


def _linear(control: ControlPoints, distortion: int) -> Camera:
    """Return the camera of the linear equations; refuse points that no camera can have seen."""
    P = _projections(control.points_world, control.pixels)
    rear = _depths(P, control.points_world) <= 0
    if rear.any():
        control.fail(f"control {control.named(rear)} would lie behind it; check the order of the points and their "
                     "pixels")  # fmt: skip
    K, R = rq(P[:, :3])
    signs = np.sign(np.diag(K))
    K, R, centre = K * signs, signs[:, None] * R, -np.linalg.solve(P[:, :3], P[:, 3])
    if np.linalg.det(R) < 0:
        control.fail("its control points are mirrored: the world's axes must be right-handed, u count to the right and "
                     "v downwards")  # fmt: skip
    number = LINEAR + distortion
    return Camera(control.camera, np.asarray(K / K[2, 2], dtype=float), np.asarray(R), np.asarray(centre),
                  np.zeros(distortion), np.zeros((number, number)))  # fmt: skip


def _scale(camera: Camera, points_world: Array) -> Array:
    focal, distance = camera.K[0, 0], float(np.mean(camera.depth(points_world)))
    radius = np.max(np.linalg.norm(camera.project(points_world) - camera.K[:2, 2], axis=1)) / focal
    bends = [radius**-power for power in (2, 4, 1, 1, 6)[: len(camera.distortion)]]
    return np.array([*5 * [focal], *3 * [1.0], *3 * [distance], *bends])


def _fits(camera: Camera, control: ControlPoints, inside: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which points agree with a fit to the others.

    Each point is tested by its distance from its projection by a camera fitted without it, with the covariance of both:
    an F test at `FALSE_ALARM`, shared by all points.
    """
    spare = 2 * int(np.sum(inside)) - len(camera.cov)
    rss = spare * max(camera.std_px, MIN_NOISE_PX) ** 2
    jacobian = camera.by_parameters(control.points_world)
    scale = np.sqrt(np.maximum(np.diag(camera.cov), 1e-300))
    design = (jacobian * scale)[inside].reshape(-1, len(scale))
    spread = jacobian * scale @ np.linalg.pinv(design)
    leverage = spread @ np.swapaxes(spread, 1, 2)
    residual = control.pixels - camera.project(control.points_world)
    fits = inside.copy()
    for i, r in enumerate(residual):
        # The residual of a fitted point is smaller than its error, that of a point left out larger.
        share = float(r @ np.linalg.pinv(np.eye(2) + (-1 if inside[i] else 1) * leverage[i]) @ r)
        rest, free = (rss - share, spare - 2) if inside[i] else (rss, spare)
        if free >= 1:
            allowed = stats.f.isf(FALSE_ALARM / len(residual), 2, free)
            fits[i] = share / 2 <= allowed * max(rest / free, MIN_NOISE_PX**2)
    return fits


def locate(camera: Camera, points_world: ArrayLike, pixels: ArrayLike, labels: Sequence[str]) -> Camera:
    """Find the pose in the world of a camera whose lens a calibration file states.

    The pose is started by OpenCV's `solvePnP` and refined, with focal lengths, principal point and distortion, by least
    squares on pixels; `camera.cov` is the prior of the latter. Points beyond the rest by more than the 99.9 % quantile
    of all are left out.

    Args:
        camera: with K, distortion, and their covariance.
        points_world: control points, at least six [m], (n, 3).
        pixels: where they appear, u right, v down [px], (n, 2).
        labels: names of the points (n,).

    Raises:
        InputError: too few points, coplanar ones, or too many that do not fit.
    """
    from probedesign.vision import require_opencv

    require_opencv()
    import cv2

    control = control_points(camera.name, points_world, pixels, tuple(labels), 0)
    points, seen = control.points_world, control.pixels
    bends = np.append(camera.distortion, np.zeros(5 - len(camera.distortion)))
    _, turn, shift = cv2.solvePnP(points, seen, camera.K, bends, flags=cv2.SOLVEPNP_SQPNP)
    R = np.asarray(cv2.Rodrigues(turn)[0], dtype=float)
    start = replace(camera, R_camera_world=R, p_world=np.asarray(-R.T @ shift.ravel()))
    lens = np.array([0, 1, 3, 4, *range(LINEAR, len(camera.cov))])  # what the file states; the skew is fixed at zero
    free = np.array([0, 1, 3, 4, *range(5, len(camera.cov))])
    std_lens, scale = np.sqrt(np.diag(camera.cov))[lens], _scale(start, points)
    prior = (np.eye(len(scale))[lens] / std_lens[:, None])[:, free] * scale[free]
    std_px, inside = max(camera.std_px, MIN_NOISE_PX), np.ones(len(points), dtype=bool)

    def moved(step: Array) -> Camera:
        whole = np.zeros(len(scale))
        whole[free] = step * scale[free]
        return start.moved(whole)

    def rows(step: Array) -> Array:
        by = moved(step).by_parameters(points[inside])[..., free] * scale[free]
        return np.concatenate([by.reshape(-1, len(free)) / std_px, prior])

    def residuals(step: Array) -> Array:
        residual = moved(step).project(points[inside]) - seen[inside]
        return np.concatenate([residual.ravel() / std_px, prior @ step])

    step = np.zeros(len(free))
    for _ in range(8):
        step = least_squares(residuals, step, rows, method="lm").x
        miss, n = seen - moved(step).project(points), inside.sum()
        std_px = max(float(np.sqrt(np.mean(miss[inside] ** 2) * n / max(n - 3, 1))), MIN_NOISE_PX)
        spread = 1.4826 * float(np.median(np.abs(miss)))  # the normal standard deviation, without outliers
        limit = stats.chi2.isf(FALSE_ALARM / len(points), 2) * max(spread, MIN_NOISE_PX) ** 2
        fits = np.sum(miss**2, axis=1) <= limit
        if (fits == inside).all():
            break
        inside = fits
    if np.mean(~inside) > MAX_OUTLIER_FRACTION or std_px > MAX_RESIDUAL_PX:
        control.fail(f"the control points do not fit the calibration file, residual {std_px:.2g} px, {np.sum(~inside)} "
                     f"of {len(points)} left out; check their order, their units, and that the file is of this "
                     "camera")  # fmt: skip
    cov = np.zeros((len(scale), len(scale)))
    J = rows(step)
    cov[np.ix_(free, free)] = np.linalg.inv(J.T @ J) * np.outer(scale[free], scale[free])
    placed = replace(moved(step), cov=cov, std_px=std_px, outliers=control.subset(~inside).labels)
    if (placed.depth(points) <= 0).any():
        control.fail("control points lie behind it; check their order and their pixels")
    return placed
