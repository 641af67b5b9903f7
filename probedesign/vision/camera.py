"""Perspective camera with radial distortion: projection, derivatives and covariance.

Axes of a camera: x right, y down, z along the optical axis. Pixels: u right, v down, (0, 0) the centre of the upper
left pixel, as OpenCV has it.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from probedesign.core.frames import Array, skew

LINEAR = 11
"""Parameters of a camera without distortion, as many as Direct Linear Transformation has."""


@dataclass(frozen=True)
class Camera:
    """A perspective camera with radial distortion.

    Its parameters, in the order of `cov`: focal lengths along u and v [px], skew [px], principal point u, v [px],
    rotation about the camera's axes [rad] (3), centre in the world [m] (3), coefficients of distortion.

    Attributes:
        name: of the camera.
        K: focal lengths, skew and principal point [px], upper triangular, (3, 3).
        R_camera_world: rotation into the camera's axes, (3, 3).
        p_world: its centre [m], (3,).
        distortion: coefficients k1, k2 of a point's radius on the plane at distance one: r (1 + k1 r² + k2 r⁴), (d,).
        cov: covariance of the parameters, (11 + d, 11 + d); zero for an exactly known camera.
        std_px: standard deviation of a control point's coordinate in the picture, from the residuals [px].
        residuals_px: pixels of the control points minus their projections [px], outliers included, (n, 2).
        outliers: names of the control points that do not fit with the others and were left out.
    """

    name: str
    K: Array
    R_camera_world: Array
    p_world: Array
    distortion: Array = field(default_factory=lambda: np.zeros(0))
    cov: Array = field(default_factory=lambda: np.zeros((LINEAR, LINEAR)))
    std_px: float = 0.0
    residuals_px: Array = field(default_factory=lambda: np.zeros((0, 2)))
    outliers: tuple[str, ...] = ()

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
            distortion: coefficients, at most two.
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
        return cls(name, K, R, centre, bends, np.zeros((number, number)))

    @property
    def P(self) -> Array:
        """Projection matrix of homogeneous points of the world, before distortion, (3, 4)."""
        return self.K @ self.R_camera_world @ np.column_stack([np.eye(3), -self.p_world])

    def depth(self, points_world: ArrayLike) -> Array:
        """Return the distance of points (..., 3) along the optical axis [m]; negative behind the camera."""
        return np.asarray((np.asarray(points_world, dtype=float) - self.p_world) @ self.R_camera_world[2])

    def project(self, points_world: ArrayLike) -> Array:
        """Project points in front of the camera [m], (..., 3), into the picture: pixels u, v (..., 2)."""
        seen = self._plane(points_world)
        return np.asarray(self._pixels(seen * self._stretch(seen)[..., None]))

    def rays(self, pixels: ArrayLike) -> Array:
        """Return the directions of pixels u, v (..., 2) in the world, unit vectors (..., 3)."""
        bent = np.asarray(np.linalg.solve(self.K, _homogeneous(pixels)[..., None])[..., :2, 0], dtype=float)
        seen = bent.copy()
        # a step gains a factor |2 k1 r²|, a tenth or less for any lens used for measuring
        for _ in range(20 if len(self.distortion) else 0):
            seen = bent / self._stretch(seen)[..., None]
        directions = _homogeneous(seen) @ self.R_camera_world
        return np.asarray(directions / np.linalg.norm(directions, axis=-1, keepdims=True))

    def by_point(self, points_world: Array) -> Array:
        """Return derivatives of the pixels by the points [px/m], (n, 3) -> (n, 2, 3)."""
        return self._by_axes(points_world) @ self.R_camera_world

    def by_parameters(self, points_world: Array) -> Array:
        """Return derivatives of the pixels by the camera's parameters, (n, 3) -> (n, 2, 11 + d)."""
        seen, by_axes = self._plane(points_world), self._by_axes(points_world)
        bent = seen * self._stretch(seen)[:, None]
        one, zero = np.ones(len(seen)), np.zeros(len(seen))
        u = np.column_stack([bent[:, 0], zero, bent[:, 1], one, zero])
        v = np.column_stack([zero, bent[:, 1], zero, zero, one])
        axes = (points_world - self.p_world) @ self.R_camera_world.T
        turned = by_axes @ -np.array([skew(a) for a in axes])
        moved = -by_axes @ self.R_camera_world
        powers = np.sum(seen**2, axis=1)[:, None] ** np.arange(1, 1 + len(self.distortion))
        bends = (seen @ self.K[:2, :2].T)[:, :, None] * powers[:, None, :]
        return np.concatenate([np.stack([u, v], axis=1), turned, moved, bends], axis=2)

    def moved(self, step: Array) -> "Camera":
        """Return the camera with its parameters changed by a step (11 + d,)."""
        K = self.K + np.array([[step[0], step[2], step[3]], [0.0, step[1], step[4]], [0.0, 0.0, 0.0]])
        R = Rotation.from_rotvec(step[5:8]).as_matrix() @ self.R_camera_world
        return Camera(self.name, K, R, self.p_world + step[8:11], self.distortion + step[11:], self.cov)

    def folds(self, points_world: Array) -> bool:
        """Return whether the distortion maps two radii within these points' onto one, which no lens does."""
        square = np.linspace(0.0, float(np.max(np.sum(self._plane(points_world) ** 2, axis=-1))), 100)
        powers = np.arange(1, 1 + len(self.distortion))
        return bool(np.any(1 + square[:, None] ** powers @ ((2 * powers + 1) * self.distortion) <= 0))

    def _plane(self, points_world: ArrayLike) -> Array:
        """Return points on the plane at distance one, before distortion, (..., 2)."""
        axes = (np.asarray(points_world, dtype=float) - self.p_world) @ self.R_camera_world.T
        return np.asarray(axes[..., :2] / axes[..., 2:])

    def _stretch(self, seen: Array) -> Array:
        """Return the factor of distortion at points of the plane (..., 2), (...)."""
        square: Array = np.sum(seen**2, axis=-1)
        stretch = np.ones(seen.shape[:-1])
        for power, coefficient in enumerate(self.distortion, 1):
            stretch = stretch + coefficient * square**power
        return stretch

    def _pixels(self, bent: Array) -> Array:
        return bent @ self.K[:2, :2].T + self.K[:2, 2]

    def _by_axes(self, points_world: Array) -> Array:
        """Return derivatives of the pixels by the point in the camera's axes, (n, 2, 3)."""
        seen, depth = self._plane(points_world), self.depth(points_world)
        square, slope = np.sum(seen**2, axis=1), np.zeros(len(seen))
        for power, coefficient in enumerate(self.distortion, 1):
            slope += 2 * power * coefficient * square ** (power - 1)
        bending = self._stretch(seen)[:, None, None] * np.eye(2)
        bending = bending + slope[:, None, None] * seen[:, :, None] * seen[:, None, :]
        plane = np.concatenate([np.broadcast_to(np.eye(2), (len(seen), 2, 2)), -seen[:, :, None]], axis=2)
        return np.asarray(self.K[:2, :2] @ bending @ plane / depth[:, None, None])


def _homogeneous(points: ArrayLike) -> Array:
    """Return points (..., k) with a last coordinate 1, (..., k + 1)."""
    points = np.asarray(points, dtype=float)
    return np.concatenate([points, np.ones((*points.shape[:-1], 1))], axis=-1)
