"""Perspective camera with lens distortion: projection, derivatives and covariance.

Axes of a camera: x right, y down, z along the optical axis. Pixels: u right, v down, (0, 0) the centre of the upper
left pixel, as OpenCV has it.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from probedesign.core.frames import Array

LINEAR = 11  #: Parameters of a camera without distortion, as many as Direct Linear Transformation has.
DISTORTIONS = (0, 1, 2, 4, 5)  #: Numbers of coefficients of distortion, in OpenCV's order: k1, k2, p1, p2, k3.

_RADIAL = (1, 2, 0, 0, 3)  # power of r² of each coefficient; 0 for the tangential ones
_P1, _P2 = 2, 3


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
    #: pixels of the control points minus their projections [px], outliers included, (n, 2).
    residuals_px: Array = field(default_factory=lambda: np.zeros((0, 2)))
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

    @property
    def P(self) -> Array:
        """Projection matrix of homogeneous points of the world, before distortion, (3, 4)."""
        return self.K @ self.R_camera_world @ np.column_stack([np.eye(3), -self.p_world])

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
        """Return derivatives of the pixels by the points [px/m], (n, 3) -> (n, 2, 3)."""
        return self._by_axes(points_world) @ self.R_camera_world

    def by_parameters(self, points_world: Array) -> Array:
        """Return derivatives of the pixels by the camera's parameters, (n, 3) -> (n, 2, 11 + d)."""
        seen, by_axes = self._plane(points_world), self._by_axes(points_world)
        bent = self._bent(seen)
        one, zero = np.ones(len(seen)), np.zeros(len(seen))
        u = np.column_stack([bent[:, 0], zero, bent[:, 1], one, zero])
        v = np.column_stack([zero, bent[:, 1], zero, zero, one])
        axes = (points_world - self.p_world) @ self.R_camera_world.T
        turned = np.cross(axes[:, None, :], by_axes)  # by_axes @ -skew(axes)
        moved = -by_axes @ self.R_camera_world
        bends = self.K[:2, :2] @ self._bends(seen)
        return np.concatenate([np.stack([u, v], axis=1), turned, moved, bends], axis=2)

    def moved(self, step: Array) -> "Camera":
        """Return the camera with its parameters changed by a step (11 + d,)."""
        K = self.K + np.array([[step[0], step[2], step[3]], [0.0, step[1], step[4]], [0.0, 0.0, 0.0]])
        R = Rotation.from_rotvec(step[5:8]).as_matrix() @ self.R_camera_world
        p_world, distortion = self.p_world + step[8:11], self.distortion + step[11:]
        return replace(self, K=K, R_camera_world=R, p_world=p_world, distortion=distortion)

    def folds(self, points_world: Array) -> bool:
        """Return whether the distortion maps two radii within these points' onto one, which no lens does."""
        square = np.linspace(0.0, float(np.max(np.sum(self._plane(points_world) ** 2, axis=-1))), 100)
        k = np.zeros(len(_RADIAL))
        k[: len(self.distortion)] = self.distortion
        slope = 1 + sum((2 * n + 1) * k[i] * square**n for i, n in enumerate(_RADIAL) if n)
        return bool(np.any(slope <= 0))

    def _plane(self, points_world: ArrayLike) -> Array:
        axes = (np.asarray(points_world, dtype=float) - self.p_world) @ self.R_camera_world.T
        return np.asarray(axes[..., :2] / axes[..., 2:])

    def _bent(self, seen: Array) -> Array:
        return np.asarray(seen + self._bends(seen) @ self.distortion)

    def _bends(self, seen: Array) -> Array:
        """Return the displacement of points of the plane (..., 2) by one unit of each coefficient, (..., 2, d)."""
        x, y = seen[..., 0], seen[..., 1]
        square = x**2 + y**2
        shift = {_P1: (2 * x * y, square + 2 * y**2), _P2: (square + 2 * x**2, 2 * x * y)}
        bends = np.empty((*seen.shape, len(self.distortion)))
        for i, power in enumerate(_RADIAL[: len(self.distortion)]):
            u, v = shift.get(i) or (x * square**power, y * square**power)
            bends[..., 0, i], bends[..., 1, i] = u, v
        return bends

    def _bending(self, seen: Array) -> Array:
        """Return the derivative of `_bent` by the points (n, 2), (n, 2, 2)."""
        x, y = seen.T
        square = x**2 + y**2
        bending = np.tile(np.eye(2), (len(seen), 1, 1))
        for i, coefficient in enumerate(self.distortion):
            n = _RADIAL[i]
            if n:
                along = 2 * n * square ** (n - 1)
                slope = (
                    square[:, None, None] ** n * np.eye(2) + along[:, None, None] * seen[:, :, None] * seen[:, None, :]
                )
            elif i == _P1:
                slope = 2 * np.stack([np.stack([y, x], 1), np.stack([x, 3 * y], 1)], 1)
            else:
                slope = 2 * np.stack([np.stack([3 * x, y], 1), np.stack([y, x], 1)], 1)
            bending = bending + coefficient * slope
        return bending

    def _by_axes(self, points_world: Array) -> Array:
        seen, depth = self._plane(points_world), self.depth(points_world)
        plane = np.concatenate([np.broadcast_to(np.eye(2), (len(seen), 2, 2)), -seen[:, :, None]], axis=2)
        return np.asarray(self.K[:2, :2] @ self._bending(seen) @ plane / depth[:, None, None])
