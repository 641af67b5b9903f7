"""Poses and wrenches between frames. `T_a_b` maps b's coordinates into a's, so inner names cancel: T_a_b @ T_b_c."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def pose(R: ArrayLike | None = None, p: ArrayLike | None = None) -> Array:
    """Return the homogeneous transform of a rotation and an origin.

    Args:
        R: rotation matrix (3, 3); identity if None.
        p: origin [m], (3,); zero if None.

    Returns:
        T (4, 4).
    """
    T = np.eye(4)
    if R is not None:
        T[:3, :3] = R
    if p is not None:
        T[:3, 3] = p
    return T


def rotation_z(angle: float) -> Array:
    """Return the rotation about z by `angle` [rad], (3, 3)."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def rotation_under_gravity(gravity_base: Array) -> Array:
    """Return R_world_base with gravity down and the probe's axis along the world's x as far as possible."""
    up = -gravity_base / np.linalg.norm(gravity_base)
    axis = np.array([0.0, 0.0, 1.0])
    across = axis - up * (up @ axis)
    if np.linalg.norm(across) < 0.1:  # it is vertical
        across = np.array([1.0, 0.0, 0.0]) - up * up[0]
    across /= np.linalg.norm(across)
    return np.array([across, np.cross(up, across), up])


def inverse(T_a_b: Array) -> Array:
    """Return T_b_a of a rigid transform T_a_b (4, 4)."""
    R = T_a_b[:3, :3]
    return pose(R.T, -R.T @ T_a_b[:3, 3])


def wrench_map(T_a_b: Array) -> Array:
    """Return the matrix X (6, 6) with wrench_a = X @ wrench_b: the same load, about a's origin in a's axes.

    force_a = R force_b, moment_a = R moment_b + p × R force_b, with R, p from T_a_b.
    """
    R, p = T_a_b[:3, :3], T_a_b[:3, 3]
    X = np.zeros((6, 6))
    X[:3, :3] = X[3:, 3:] = R
    X[3:, :3] = skew(p) @ R
    return X


def skew(a: ArrayLike) -> Array:
    """Return the matrix (3, 3) with skew(a) @ b = a × b, for each vector of (..., 3)."""
    a = np.asarray(a, dtype=float)
    matrices = np.zeros((*a.shape, 3))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        matrices[..., k, j], matrices[..., j, k] = a[..., i], -a[..., i]
    return matrices


def is_pose(T: ArrayLike, tolerance: float = 1e-6) -> bool:
    """Return whether T (4, 4) is finite with an orthonormal right-handed rotation and a last row 0 0 0 1.

    The tolerance allows for poses written with seven digits.
    """
    T = np.asarray(T, dtype=float)
    if T.shape != (4, 4) or not np.isfinite(T).all():
        return False
    R = T[:3, :3]
    return bool(
        np.abs(R @ R.T - np.eye(3)).max() <= tolerance
        and np.linalg.det(R) > 0
        and np.abs(T[3] - (0.0, 0.0, 0.0, 1.0)).max() <= tolerance
    )
