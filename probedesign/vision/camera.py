"""Perspective camera with lens distortion: projection, derivatives and covariance.

Axes of a camera: x right, y down, z along the optical axis. Pixels: u right, v down, (0, 0) the centre of the upper
left pixel, as OpenCV has it.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from probedesign.core.frames import Array

LINEAR = 11  #: Parameters of a camera without distortion, as many as Direct Linear Transformation has.
DISTORTIONS = (0, 1, 2, 4, 5)  #: Numbers of coefficients of distortion, in OpenCV's order: k1, k2, p1, p2, k3.
_STEP = 1e-5  # of differences: rotations [rad] and displacements over the distance


@dataclass(frozen=True)
class Camera:
    """A perspective camera with radial and tangential distortion.

    Its parameters, in the order of `cov`: focal lengths along u and v [px], skew [px], principal point u, v [px],
    rotation about the camera's axes [rad] (3), centre in the world [m] (3), coefficients of distortion.

    A point (x, y) of the plane at distance one, r from the axis, is displaced to

        x (1 + k1 r² + k2 r⁴ + k3 r⁶) + 2 p1 x y + p2 (r² + 2 x²),
        y (1 + k1 r² + k2 r⁴ + k3 r⁶) + p1 (r² + 2 y²) + 2 p2 x y.

    Source: D. C. Brown, Decentering distortion of lenses, Photogrammetric Engineering 32, 1966; coefficients as in
        OpenCV.
    """

    name: str  #: of the camera.
    K: Array  #: focal lengths, skew and principal point [px], upper triangular, (3, 3).
    R_camera_world: Array  #: rotation into the camera's axes, (3, 3).
    p_world: Array  #: its centre [m], (3,).
    #: the first d of the coefficients k1, k2, p1, p2, k3, (d,).
    distortion: Array = field(default_factory=lambda: np.zeros(0))
    #: covariance of the parameters, (11 + d, 11 + d); zero for an exactly known camera.
    cov: Array = field(default_factory=lambda: np.zeros((LINEAR, LINEAR)))
    size_px: tuple[int, int] | None = None  #: width and height of its pictures [px]; None if not known.
    std_px: float = 0.0  #: standard deviation of a control point's coordinate in the picture, from the residuals [px].
    outliers: tuple[str, ...] = ()  #: names of the control points that do not fit with the others and were left out.

    @classmethod
    def looking(
        cls,
        name: str,
        p_world: ArrayLike,
        at_world: ArrayLike,
        focal_px: float,
        size_px: tuple[int, int],
        distortion: ArrayLike = (),
        up_world: ArrayLike = (0.0, 0.0, 1.0),
    ) -> "Camera":
        """Return an exactly known camera with square pixels that looks at a point.

        Args:
            name: of the camera.
            p_world: its centre [m], (3,).
            at_world: the point in the middle of its picture [m], (3,).
            focal_px: focal length [px].
            size_px: width and height of the picture [px].
            distortion: coefficients k1, k2, p1, p2, k3, or the first of them.
            up_world: what is up in the picture; not along the optical axis, (3,).
        """
        centre, bends = np.asarray(p_world, dtype=float), np.asarray(distortion, dtype=float)
        z = np.asarray(at_world, dtype=float) - centre
        x = np.cross(z, np.asarray(up_world, dtype=float))
        R = np.array([x, np.cross(z, x), z])
        R /= np.linalg.norm(R, axis=1)[:, None]
        u, v = (size_px[0] - 1) / 2, (size_px[1] - 1) / 2
        K = np.array([[focal_px, 0.0, u], [0.0, focal_px, v], [0.0, 0.0, 1.0]])
        number = LINEAR + len(bends)
        return cls(name, K, R, centre, bends, np.zeros((number, number)), size_px=size_px)

    def depth(self, points_world: ArrayLike) -> Array:
        """Return the distance of points (..., 3) along the optical axis [m]; negative behind the camera."""
        return np.asarray((np.asarray(points_world, dtype=float) - self.p_world) @ self.R_camera_world[2])

    def project(self, points_world: ArrayLike) -> Array:
        """Project points in front of the camera [m], (..., 3), into the picture: pixels u, v (..., 2)."""
        return np.asarray(self._bent(self._plane(points_world)) @ self.K[:2, :2].T + self.K[:2, 2])

    def rays(self, pixels: ArrayLike) -> Array:
        """Return the directions of pixels u, v (..., 2) in the world, unit vectors (..., 3)."""
        centred = np.asarray(pixels, dtype=float) - self.K[:2, 2]
        down = centred[..., 1] / self.K[1, 1]
        bent = np.stack([(centred[..., 0] - self.K[0, 1] * down) / self.K[0, 0], down], axis=-1)
        seen = bent.copy()
        # a step gains a factor |3 k1 r²|, a fifth or less for any lens used for measuring
        for _ in range(30 if len(self.distortion) else 0):
            step = bent - self._bent(seen)
            seen = seen + step
            if not np.nanmax(np.abs(step), initial=0.0) > 1e-13:
                break
        directions = np.concatenate([seen, np.ones((*seen.shape[:-1], 1))], axis=-1) @ self.R_camera_world
        return np.asarray(directions / np.linalg.norm(directions, axis=-1, keepdims=True))

    def by_point(self, points_world: Array) -> Array:
        """Return derivatives of the pixels by the points [px/m], (n, 3) -> (n, 2, 3), by central differences."""
        step = _STEP * self._distance(points_world)
        return _differences(lambda shift: self.project(points_world + shift), np.full(3, step))

    def by_parameters(self, points_world: Array) -> Array:
        """Return derivatives of the pixels by the camera's parameters, (n, 3) -> (n, 2, 11 + d), by central
        differences; the pixels are linear in all but the pose."""
        steps = np.ones(LINEAR + len(self.distortion))
        steps[5:8], steps[8:11] = _STEP, _STEP * self._distance(points_world)
        return _differences(lambda step: self.moved(step).project(points_world), steps)

    def _distance(self, points_world: Array) -> float:
        return float(np.linalg.norm(points_world - self.p_world, axis=-1).mean())

    def moved(self, step: Array) -> "Camera":
        """Return the camera with its parameters changed by a step (11 + d,)."""
        K = self.K + np.array([[step[0], step[2], step[3]], [0.0, step[1], step[4]], [0.0, 0.0, 0.0]])
        R = Rotation.from_rotvec(step[5:8]).as_matrix() @ self.R_camera_world
        p_world, distortion = self.p_world + step[8:11], self.distortion + step[11:]
        return replace(self, K=K, R_camera_world=R, p_world=p_world, distortion=distortion)

    def folds(self, points_world: Array) -> bool:
        """Return whether the distortion maps two radii within these points' onto one, which no lens does."""
        square = np.linspace(0.0, float(np.max(np.sum(self._plane(points_world) ** 2, axis=-1))), 100)
        k1, k2, _, _, k3 = self._coefficients
        return bool(np.any(1.0 + square * (3.0 * k1 + square * (5.0 * k2 + square * 7.0 * k3)) <= 0.0))

    @property
    def _coefficients(self) -> Array:
        return np.append(self.distortion, np.zeros(DISTORTIONS[-1] - len(self.distortion)))

    def _plane(self, points_world: ArrayLike) -> Array:
        axes = (np.asarray(points_world, dtype=float) - self.p_world) @ self.R_camera_world.T
        return np.asarray(axes[..., :2] / axes[..., 2:])

    def _bent(self, seen: Array) -> Array:
        (k1, k2, p1, p2, k3), x, y = self._coefficients, seen[..., 0], seen[..., 1]
        square, product = x**2 + y**2, 2.0 * x * y
        radial = 1.0 + square * (k1 + square * (k2 + square * k3))
        return np.stack([x * radial + p1 * product + p2 * (square + 2.0 * x**2),
                         y * radial + p1 * (square + 2.0 * y**2) + p2 * product], axis=-1)  # fmt: skip


def _differences(of: Callable[[Array], Array], steps: Array) -> Array:
    columns = [(of(step) - of(-step)) / (2.0 * step.max()) for step in np.diag(steps)]
    return np.stack(columns, axis=-1)
