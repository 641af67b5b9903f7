"""Solve touches of one fixed point as one dense least-squares problem in numpy, the reference of `fusion_kernel.py`.

The unknowns are the error sources m (J, unit priors), the friction that is common to all touches (2, unit priors), the
object's compliance in units of its prior z, the first value of the bias and its steps in units of their standard
deviations (6 for each reading), for each touch its own unknowns y (5), stiffness e and the step of the object before it
in units of its standard deviation (3), and the touched point X at the first touch (3). No unknown is eliminated: one
matrix has the rows of all poses.
"""

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
    weight: Array  #: of the probe in base axes [N], (3,).
    ramp: float  #: progress of creep, 0 to 1.
    touched: bool  #: whether there was contact.


class Priors(NamedTuple):
    """Priors and channels of all rows."""

    channels: Array  #: map of the base wrench to the channels, (m, 6).
    bias: Array  #: map of the bias in steps to the channels, (m, 6).
    friction: float  #: standard deviation of the friction ratio; inf for none.
    friction_parts: tuple[float, float]  #: of its part common to all touches and of the other, over that one.
    robot: float  #: standard deviation of the base position at each pose [m].
    start: float  #: start, walk: standard deviations of the bias at the first reading and of its steps [steps].
    walk: float
    #: scatter, creep: columns of D that are independent at each touch, and that grow by the ramp; -1 for none.
    scatter: int
    creep: int
    #: compliance of the object [m/N]: where it is linearised, mean and standard deviation of its prior.
    compliance: tuple[float, float, float]
    object_walk: float  #: standard deviation of the step of the object between two touches, on each axis [m].


class DenseSolution(NamedTuple):
    """Least-squares solution."""

    #: m, common friction, z, X at the last touch and the bias of the last reading, (J + 12,), as `solve_reduced`.
    x: Array
    cov: Array  #: covariance of X and z, (4, 4).
    chi2: float  #: minimum of χ², including the priors.
    own: Array  #: change of the touch and stiffness at each pose, (k, 6); NaN without contact.
    points: Array  #: touched point and centreline point of the last touch in the world, (2, 3), and the covariance of
    covs: Array  #: each, (2, 3, 3).


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
    z_at, first_bias = J + 2, J + 3
    first_own, first_walk = first_bias + 6 * k, first_bias + 12 * k
    first_step = first_walk + 3 * k
    first_point = first_step + (0 if step is None else 3)
    n = first_point + 3
    rows: list[Array] = []
    right: list[float] = []

    def add(A: Array, b: Array) -> None:
        rows.extend(np.atleast_2d(A))
        right.extend(np.atleast_1d(b))

    add(np.eye(n)[:first_own], np.zeros(first_own))
    add(np.eye(n)[first_walk:first_point], np.zeros(first_point - first_walk))
    stds = np.array([priors.start] + [priors.walk] * (k - 1))
    touched = np.array([pose.touched for pose in poses])
    moves = priors.object_walk * (touched & (np.cumsum(touched) > 1))
    X = np.zeros((3, n))  # the touched point at the last touch
    X[:, first_point:] = np.eye(3)
    for i, pose in enumerate(poses):
        own = slice(first_own + 6 * i, first_own + 6 * i + 6)
        X[:, first_walk + 3 * i : first_walk + 3 * i + 3] = moves[i] * np.eye(3)
        A = np.zeros((len(priors.channels), n))
        to = pose.whiten @ priors.channels
        A[:, :J] = to @ common(pose.D[WRENCH], pose, priors)
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
            own_ratio, common_ratio = np.eye(n)[own.start + 3 : own.start + 5], np.eye(n)[J:z_at]
            shared, per = mu * priors.friction_parts[0], 1.0 / (mu * priors.friction_parts[1])
            add(per * (own_ratio - shared * common_ratio), -per * pose.ratios)
        per = 1.0 / max(priors.robot, 1e-8)
        R, (at, mean, std) = pose.T[:3, :3], priors.compliance
        force = pose.lin[:3, 0] - pose.weight
        A = -X
        if step is not None and i >= step[0]:
            A[:, first_step : first_step + 3] = -step[1] * np.eye(3)
        A[:, :J] = R @ common(pose.D[POINT], pose, priors)
        A[:, z_at] = std * R @ force
        A[:, own] = R @ _own(pose, POINT, priors)
        A[:, own.start : own.start + 5] += at * R @ pose.lin[:3, 1:6]
        add(per * A, -per * (pose.T[:3, 3] + R @ (pose.lin[POINT, 0] + mean * force)))
    A, b = np.array(rows), np.array(right)
    scale = np.linalg.norm(A, axis=0)
    scale[scale == 0.0] = 1.0
    Q, R = np.linalg.qr(A / scale)
    z = np.linalg.solve(R, Q.T @ b) / scale
    inverse = np.linalg.inv(R) / scale[:, None]
    chi2 = float(((A @ z - b) ** 2).sum())
    bias = (stds[:, None] * z[first_bias:first_own].reshape(k, 6)).sum(axis=0)
    steps = np.array([z[first_own + 6 * i : first_own + 6 * i + 6] for i in range(k)])
    steps[~touched] = np.nan
    last = int(np.flatnonzero(touched)[-1])
    pose, own = poses[last], slice(first_own + 6 * last, first_own + 6 * last + 6)
    points, covs, R = [], [], pose.T[:3, :3]
    for of in (POINT, CENTRE):
        row = np.zeros((3, n))
        row[:, :J] = R @ common(pose.D[of], pose, priors)
        row[:, own] = R @ _own(pose, of, priors)
        points.append(pose.T[:3, 3] + R @ pose.lin[of, 0] + row @ z)
        covs.append(row @ inverse @ inverse.T @ row.T)
    root = np.vstack([X, np.eye(n)[z_at]]) @ inverse
    x = np.concatenate([z[:first_bias], X @ z, bias])
    return DenseSolution(x, root @ root.T, chi2, steps, np.array(points), np.array(covs))


def _own(pose: LinearPose, rows: slice, priors: Priors) -> Array:
    """Return the derivatives by the unknowns of one pose, (n, 6)."""
    by_e = pose.D[rows, priors.scatter] if priors.scatter >= 0 else np.zeros(rows.stop - rows.start)
    return np.column_stack([pose.lin[rows, 1:6], by_e])
