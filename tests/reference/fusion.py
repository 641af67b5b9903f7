"""Solve touches of one fixed point as one dense least-squares problem in numpy, the reference of `fusion_kernel.py`.

The unknowns are the touched point X (3), the error sources m (J, unit priors), the friction that is common to all
touches (2, unit priors), the first value of the bias and its steps in units of their standard deviations (6 for each
reading), and for each touch its own unknowns y (5) and stiffness e. No unknown is eliminated: one matrix has the rows
of all poses.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from probedesign.core.frames import Array

WRENCH, POINT, CENTRE = slice(0, 6), slice(6, 9), slice(9, 12)


@dataclass(frozen=True)
class LinearPose:
    """Linearised reading at one pose."""

    #: values and derivatives by the touch, (12, 6). For a reading without contact the first column has the wrench of
    #: the free probe and the derivatives are ignored.
    lin: Array
    D: Array  #: error columns, (12, J).
    ratios: Array  #: friction ratios at the linearisation point, (2,).
    wrench: Array  #: measured at the base, (6,).
    T: Array  #: pose of the base, (4, 4).
    whiten: Array  #: whitening matrix of the channels, (m, m).
    ramp: float  #: progress of creep, 0 to 1.
    touched: bool  #: whether there was contact.


class Priors(NamedTuple):
    """Priors and channels of all rows."""

    channels: Array  #: map of the base wrench to the channels, (m, 6).
    bias: Array  #: map of the bias in steps to the channels, (m, 6).
    friction: float  #: standard deviation of the friction ratio; inf for none.
    common_friction: float  #: share of its variance that is common to all touches.
    robot: float  #: standard deviation of the base position at each pose [m].
    start: float  #: start, walk: standard deviations of the bias at the first reading and of its steps [steps].
    walk: float
    #: scatter, creep: columns of D that are independent at each touch, and that grow by the ramp; -1 for none.
    scatter: int
    creep: int


class DenseSolution(NamedTuple):
    """Least-squares solution."""

    x: Array  #: X, m, common friction and the bias of the last reading, (3 + J + 2 + 6,), as `solve_reduced` has them.
    cov: Array  #: covariance of X, (3, 3).
    chi2: float  #: minimum of χ², including the priors.
    own: Array  #: change of the touch and stiffness at each pose, (k, 6); NaN without contact.
    centre: Array  #: centre, cov_centre: mean of the centreline points in the world (3,) and its covariance (3, 3).
    cov_centre: Array


def common(D: Array, pose: LinearPose, priors: Priors) -> Array:
    """Return the error columns that all poses have in common."""
    shared = D.copy()
    if priors.creep >= 0:
        shared[:, priors.creep] *= pose.ramp
    if pose.touched and priors.scatter >= 0:
        shared[:, priors.scatter] = 0.0
    return shared


def solve(poses: list[LinearPose], priors: Priors, step: tuple[int, float] | None = None) -> DenseSolution:
    """Solve by a QR factorisation of the scaled matrix.

    Args:
        poses: linearised readings.
        priors: priors and channels.
        step: first pose after a motion of the object and the standard deviation of the motion on each axis [m]; None
            if it does not move.
    """
    k, J = len(poses), poses[0].D.shape[1]
    first_friction, first_bias = 3 + J, 3 + J + 2
    first_own, first_step = first_bias + 6 * k, first_bias + 12 * k
    n = first_step + (0 if step is None else 3)
    rows: list[Array] = []
    right: list[float] = []

    def add(A: Array, b: Array) -> None:
        rows.extend(np.atleast_2d(A))
        right.extend(np.atleast_1d(b))

    add(np.eye(n)[3:first_own], np.zeros(first_own - 3))
    if step is not None:
        add(np.eye(n)[first_step:], np.zeros(3))
    stds = np.array([priors.start] + [priors.walk] * (k - 1))
    for i, pose in enumerate(poses):
        own = slice(first_own + 6 * i, first_own + 6 * i + 6)
        A = np.zeros((len(priors.channels), n))
        to = pose.whiten @ priors.channels
        A[:, 3:first_friction] = to @ common(pose.D[WRENCH], pose, priors)
        for j in range(i + 1):
            A[:, first_bias + 6 * j : first_bias + 6 * j + 6] = stds[j] * pose.whiten @ priors.bias
        if pose.touched:
            A[:, own] = to @ _own(pose, WRENCH, priors)
        add(A, to @ (pose.wrench - pose.lin[WRENCH, 0]))
        add(np.eye(n)[own.start + 5], np.zeros(1))  # prior of e; without scatter or contact e is zero
        if not pose.touched:
            add(np.eye(n)[own.start : own.start + 5], np.zeros(5))
            continue
        if np.isfinite(priors.friction):
            mu = max(priors.friction, 1e-4)
            own_ratio, common_ratio = (np.eye(n)[own.start + 3 : own.start + 5], np.eye(n)[first_friction:first_bias])
            per = 1.0 / (math.sqrt(1.0 - priors.common_friction) * mu)
            shared = mu * math.sqrt(priors.common_friction)
            add(per * (own_ratio - shared * common_ratio), -per * pose.ratios)
        A = np.zeros((3, n))
        per = 1.0 / max(priors.robot, 1e-8)
        R = pose.T[:3, :3]
        A[:, :3] = -np.eye(3)
        if step is not None and i >= step[0]:
            A[:, first_step:] = -step[1] * np.eye(3)
        A[:, 3:first_friction] = R @ common(pose.D[POINT], pose, priors)
        A[:, own] = R @ _own(pose, POINT, priors)
        add(per * A, -per * (pose.T[:3, 3] + R @ pose.lin[POINT, 0]))
    A, b = np.array(rows), np.array(right)
    scale = np.linalg.norm(A, axis=0)
    Q, R = np.linalg.qr(A / scale)
    z = np.linalg.solve(R, Q.T @ b) / scale
    inverse = np.linalg.inv(R) / scale[:, None]
    chi2 = float(((A @ z - b) ** 2).sum())
    bias = (stds[:, None] * z[first_bias:first_own].reshape(k, 6)).sum(axis=0)
    steps = np.array([z[first_own + 6 * i : first_own + 6 * i + 6] for i in range(k)])
    touched = np.array([pose.touched for pose in poses])
    steps[~touched] = np.nan
    centre, by = np.zeros(3), np.zeros((3, n))
    for i in np.flatnonzero(touched):
        pose, own = poses[i], slice(first_own + 6 * i, first_own + 6 * i + 6)
        R = pose.T[:3, :3]
        row = np.zeros((3, n))
        row[:, 3:first_friction] = R @ common(pose.D[CENTRE], pose, priors)
        row[:, own] = R @ _own(pose, CENTRE, priors)
        centre += (pose.T[:3, 3] + R @ pose.lin[CENTRE, 0] + row @ z) / touched.sum()
        by += row / touched.sum()
    root = by @ inverse
    x = np.concatenate([z[:first_bias], bias])
    return DenseSolution(x, inverse[:3] @ inverse[:3].T, chi2, steps, centre, root @ root.T)


def _own(pose: LinearPose, rows: slice, priors: Priors) -> Array:
    """Return the derivatives by the unknowns of one pose, (n, 6)."""
    by_e = pose.D[rows, priors.scatter] if priors.scatter >= 0 else np.zeros(rows.stop - rows.start)
    return np.column_stack([pose.lin[rows, 1:6], by_e])
