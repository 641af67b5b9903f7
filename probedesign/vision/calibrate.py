"""Calibrating a camera: linear from control points, refined on pixels, without those that fit with none."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats
from scipy.optimize import least_squares

from probedesign.errors import InputError
from probedesign.frames import Array
from probedesign.vision import dlt
from probedesign.vision.camera import LINEAR, Camera
from probedesign.vision.control import FLAT_PX, ControlPoints, control_points

CLICK_PX = 1.0
"""What a click errs by where too few points are left to tell [px] (assumed)."""
LEAST_PX = 0.02
"""No picture tells a place better [px] (assumed); it keeps exact data from having outliers by rounding."""
FALSE_ALARM = 1e-3
"""Probability that a calibration without outliers is said to have one."""
CHOICES, CHOSEN = 200, 7
"""Random choices of that many points that a robust start is sought among: with three of twenty points wrong, one
choice in four has none of them."""
MOST_LEFT_OUT = 0.15
"""Share of the points that may fit with none of the others. More are no slips of the hand but points in a wrong order,
and a regular box shifted by a row fits itself but for that row."""
SINGULAR = 1e8
"""Condition of the equations beyond which rounding decides."""
VAGUE = 0.2
"""A focal length that is not known better than this tells that the points do not show depth (assumed)."""


def calibrate(
    name: str,
    points_world: ArrayLike,
    pixels: ArrayLike,
    distortion: int = 0,
    labels: Sequence[str] | None = None,
) -> Camera:
    """Calibrate a camera from control points by Direct Linear Transformation, refined by least squares on pixels.

    Points that fit with none of the others are left out; `Camera.outliers` names them. The covariance is the one of
    Student's t: residuals of few points tell their own size badly.

    Args:
        name: of the camera.
        points_world: control points, at least six, seven with distortion [m], (n, 3).
        pixels: where they appear, u right, v down [px], (n, 2).
        distortion: coefficients of radial distortion to fit, 0, 1 or 2.
        labels: names of the points (n,); 1 ... n if not said.

    Returns:
        The camera, with covariance, residuals and outliers.

    Raises:
        InputError: too few points, coplanar, doubled or mirrored ones, no finite number, too many that do not
            fit, or points that do not tell the camera.
    """
    names = None if labels is None else tuple(labels)
    control = control_points(name, points_world, pixels, names, distortion)
    inside = _start(control)
    for _ in range(20):
        camera = _fitted(control.of(inside), distortion)
        fits = _fits(camera, control, inside)
        if (fits == inside).all() or np.sum(fits) <= (LINEAR + distortion) / 2:
            break
        inside = fits
    left_out = ~inside
    if np.mean(left_out) > MOST_LEFT_OUT:
        control.fail(
            f"{np.sum(left_out)} of {len(inside)} control points do not fit with the others "
            f"({control.named(left_out)}); check their order and their units"
        )
    control.of(inside).check_flat(max(FLAT_PX, 5 * camera.std_px))
    _check_known(camera, control)
    residuals = control.pixels - camera.project(control.points_world)
    outliers = tuple(label for label, out in zip(control.labels, left_out, strict=True) if out)
    return replace(camera, residuals_px=residuals, outliers=outliers)


def _start(control: ControlPoints) -> NDArray[np.bool_]:
    """The points that fit best with the choice whose median residual is least: free of outliers if half are.

    Source: P. J. Rousseeuw, Least median of squares regression, J. Am. Stat. Assoc. 79, 1984.
    """
    number = len(control.labels)
    if number <= CHOSEN + 1:
        return np.ones(number, dtype=bool)
    shuffled = np.random.default_rng(0).random((CHOICES, number)).argsort(axis=1)[:, :CHOSEN]
    P = dlt.projections(control.points_world[shuffled], control.pixels[shuffled])
    error = np.linalg.norm(dlt.seen(P, control.points_world) - control.pixels, axis=2)
    error = np.nan_to_num(error, nan=np.inf)
    kept = max(CHOSEN + 1, (2 * number) // 3)
    best = error[np.argmin(np.median(error, axis=1))]
    return np.asarray(best <= np.sort(best)[kept - 1])


def _fitted(control: ControlPoints, distortion: int) -> Camera:
    """The camera of least squares on pixels, with its covariance."""
    start = _linear(control, distortion)
    scale = _scale(start, control.points_world)

    def residuals(step: Array) -> Array:
        return np.asarray((start.moved(step * scale).project(control.points_world) - control.pixels).ravel())

    def derivative(step: Array) -> Array:
        moved = start.moved(step * scale)
        return np.asarray(moved.by_parameters(control.points_world).reshape(-1, len(scale)) * scale)

    # The rotation is counted from the start's; its derivative at a step of a thousandth is near enough to converge.
    found = least_squares(residuals, np.zeros(len(scale)), derivative, method="lm", xtol=1e-14, ftol=1e-14)
    camera = start.moved(found.x * scale)
    spare = 2 * len(control.labels) - len(scale)
    std_px = float(np.sqrt(2 * found.cost / spare))
    told = std_px * np.sqrt(spare / (spare - 2)) if spare > 2 else max(std_px, CLICK_PX)
    jacobian = camera.by_parameters(control.points_world).reshape(-1, len(scale)) * scale
    if np.linalg.cond(jacobian) > SINGULAR:
        control.fail("more than one camera fits its control points; add points, spread them in depth")
    spread = np.linalg.pinv(jacobian) * scale[:, None]
    cov = max(told, LEAST_PX) ** 2 * spread @ spread.T
    return replace(camera, cov=cov, std_px=std_px)


def _linear(control: ControlPoints, distortion: int) -> Camera:
    """The camera of the linear equations, refused where no camera can have taken the picture."""
    P = dlt.projections(control.points_world, control.pixels)
    behind = dlt.depths(P, control.points_world) <= 0
    if behind.any():
        control.fail(
            f"control {control.named(behind)} would lie behind it; check the order of the points and their pixels"
        )
    K, R, centre = dlt.parts(P)
    if np.linalg.det(R) < 0:
        control.fail(
            "its control points are mirrored: the world's axes must be right-handed, u count to the right and v "
            "downwards"
        )
    number = LINEAR + distortion
    return Camera(control.camera, K, R, centre, np.zeros(distortion), np.zeros((number, number)))


def _scale(camera: Camera, points_world: Array) -> Array:
    """Size of each parameter, so that the equations are of one size."""
    focal, distance = camera.K[0, 0], float(np.mean(camera.depth(points_world)))
    radius = np.max(np.linalg.norm(camera.project(points_world) - camera.K[:2, 2], axis=1)) / focal
    bends = [radius ** (-2 * power) for power in range(1, 1 + len(camera.distortion))]
    return np.array([*5 * [focal], *3 * [1.0], *3 * [distance], *bends])


def _fits(camera: Camera, control: ControlPoints, inside: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which points agree with a fit to the others.

    Each point is judged by its distance from where a camera without it has it, in standard deviations that count the
    camera's own: an F test at `FALSE_ALARM` shared by all points.
    """
    spare = 2 * int(np.sum(inside)) - len(camera.cov)
    rss = spare * max(camera.std_px, LEAST_PX) ** 2
    jacobian = camera.by_parameters(control.points_world)
    scale = np.sqrt(np.maximum(np.diag(camera.cov), 1e-300))
    design = (jacobian * scale)[inside].reshape(-1, len(scale))
    spread = jacobian * scale @ np.linalg.pinv(design)
    leverage = spread @ np.swapaxes(spread, 1, 2)
    residual = control.pixels - camera.project(control.points_world)
    fits = inside.copy()
    for i, r in enumerate(residual):
        # Of a point that was fitted the residual is smaller than its error, of one left out larger.
        share = float(r @ np.linalg.pinv(np.eye(2) + (-1 if inside[i] else 1) * leverage[i]) @ r)
        rest, free = (rss - share, spare - 2) if inside[i] else (rss, spare)
        if free >= 1:
            allowed = stats.f.isf(FALSE_ALARM / len(residual), 2, free)
            fits[i] = share / 2 <= allowed * max(rest / free, LEAST_PX**2)
    return fits


def _check_known(camera: Camera, control: ControlPoints) -> None:
    """Refuse a camera that the points do not tell."""
    focal = float(np.sqrt(max(camera.cov[0, 0], camera.cov[1, 1])) / min(camera.K[0, 0], camera.K[1, 1]))
    if not focal < VAGUE:
        control.fail(
            f"its control points tell the focal length to ±{focal:.0%} only; spread them more in depth"
        )
    if (camera.depth(control.points_world) <= 0).any():
        control.fail("control points lie on both sides of it; check their order and their pixels")
    if camera.folds(control.points_world):
        raise InputError(
            f"camera {camera.name}: {len(camera.distortion)} coefficients of distortion fit no lens; fit fewer"
        )
