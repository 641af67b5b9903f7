"""Shapes of touched objects: planes, edges, corners, tips, spheres and cylinders, fitted to the touches of a map.

A touch gives a point of the surface with its covariance, and the direction of the force on the probe, which lies in the
friction cone about the outward normal. For each kind of shape the residuals are the distances of the points from the
shape, whitened by the joint covariance of all points, and the angles of the forces from the normals. The fit minimises
their squares (`scipy.optimize.least_squares`). Candidates grow from small sets of touches, touch by touch, and those
without a common touch are chosen that have the largest sum of log odds (set packing, `scipy.optimize.milp`).

The kind is chosen by the evidence, the integral of likelihood times prior by Laplace's approximation at the fit:

    log Z = log p(touches | θ) + log p(θ) + d/2 log 2π - ½ log det H

A touched place is uniform over the extent of the shape, and the extent is log-uniform, so an edge that explains the
touches of a line is more probable than a plane through them. Without a shape, points are uniform in the workspace and
forces have any direction. A straight probe touches a plane with its tip, or at the edge that bounds it (`_sheets`).

Source: P. H. S. Torr and A. Zisserman, MLESAC, Computer Vision and Image Understanding 78 (2000); D. J. C. MacKay,
Bayesian interpolation, Neural Computation 4 (1992), for the evidence.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations, product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import Bounds, LinearConstraint, least_squares, milp
from scipy.spatial.transform import Rotation
from scipy.special import betaln, log_ndtr, ndtr

from probedesign.core import statistics
from probedesign.core.frames import Array
from probedesign.core.units import MM
from probedesign.mapping.contact_map import ContactMap
from probedesign.mapping.touch_point import LocatedTouch

WORKSPACE = 0.3  #: Length within which a shape is expected, each way [m]; assumed.
RADII = (3e-3, 0.15)  #: Radii of spheres and cylinders [m], log-uniform; assumed. Smaller ones are edges.
EXTENTS = (2e-3, 0.5)  #: Smallest and largest extent of a shape [m], log-uniform; assumed.
#: Half angle of the cone of the normals of a corner [rad], with the solid angle of an octant as at the corner of a box;
#: a tip has all normals of a half-space. Assumed.
CORNER_CONE, TIP_CONE = math.acos(0.75), 0.5 * math.pi
TIP_CONTACT = 1e-3  #: Standard deviation of the contact of a tip with a plane along the probe [m]; assumed.
#: Share of touches of edges and round shapes by the side of the probe; assumed. Their normal is across the probe.
SHARE_ACROSS = 0.9
BENT = 0.15  #: Standard deviation of the angle by which a press bends the probe at the contact [rad]; assumed.
FORCE_NOISE = 0.1  #: Standard deviation of the direction of a force by the sensor's noise [rad]: 0.5 mN of 5 mN.
#: Log density of a touch without a shape: anywhere, with a force of any direction [1/m³ 1/sr].
ALONE = -3.0 * math.log(WORKSPACE) - math.log(4.0 * math.pi)
MISSED = 0.003  #: Probability with which a touch of a shape is too far from it to count as one.
MIN_ODDS = math.log(20.0)  #: Logarithm of the least odds of a shape against separate touches.
SAME_NORMAL = math.cos(math.radians(5.0))  #: Least cosine of the normals of two planes that are one; assumed.
SEEDS = 150  #: Number of random sets of touches from which each kind of shape is begun.
ROUNDS = 6  #: Largest number of choices of candidates.


class Kind(NamedTuple):
    """A kind of shape."""

    free: tuple[int, ...]  #: its parameters: shifts along the frame 0, 1, 2, rotations about u, v 3, 4, log radius 5.
    extents: int  #: number of directions in which it extends.
    fewest: int  #: least number of touches that make one.
    seed: int  #: number of touches of a random set.


KINDS = {
    "plane": Kind((2, 3, 4), 2, 3, 3),
    "edge": Kind((0, 1, 3, 4), 1, 3, 2),
    "corner": Kind((0, 1, 2), 0, 3, 1),
    "tip": Kind((0, 1, 2), 0, 3, 1),
    "sphere": Kind((0, 1, 2, 5), 2, 5, 4),
    "cylinder": Kind((0, 1, 3, 4, 5), 2, 6, 5),
}


@dataclass(frozen=True)
class TouchSet:
    """Touches as the shapes see them, with the joint covariance of their points."""

    p: Array  #: touched points in the world [m], (n, 3).
    cov: Array  #: joint covariance of the points [m²], (n, 3, n, 3).
    force: Array  #: directions of the forces on the probe, unit vectors; zero where they say nothing, (n, 3).
    tangent: Array  #: tangents of the probe, NaN where unknown, (n, 3).
    beyond: Array  #: length of the probe beyond the contact [m], NaN where it says nothing, (n,).
    labels: tuple[str, ...]  #: numbers of the touches.

    @classmethod
    def of(cls, contact_map: ContactMap) -> "TouchSet":
        """Return the located touches of a map, in order of their points."""
        touches: list[LocatedTouch] = [touch for point in contact_map.points for touch in point.touches]
        n, points = len(touches), [touch.point for touch in touches if touch.point is not None]
        B = np.array([point.sensitivity for point in points]).reshape(3 * n, len(contact_map.common))
        cov = (B @ contact_map.cov_common @ B.T).reshape(n, 3, n, 3)
        for i, point in enumerate(points):
            cov[i, :, i] += point.cov
        none = np.full(3, np.nan)
        return cls(
            np.array([point.position(contact_map.common) for point in points]).reshape(n, 3), cov,
            np.array([none if touch.direction is None else touch.direction for touch in touches]).reshape(n, 3),
            np.array([none if touch.tangent is None else touch.tangent for touch in touches]).reshape(n, 3),
            np.array([touch.beyond for touch in touches]), tuple(touch.label for touch in touches),
        )  # fmt: skip

    def __len__(self) -> int:
        """Return the number of touches."""
        return len(self.p)

    def subset(self, which: NDArray[np.intp]) -> "TouchSet":
        """Return some of the touches."""
        return TouchSet(
            self.p[which], self.cov[which][:, :, which], self.force[which], self.tangent[which], self.beyond[which],
            tuple(self.labels[i] for i in which),
        )  # fmt: skip

    @property
    def own_cov(self) -> Array:
        """Return the covariance of each point [m²], (n, 3, 3)."""
        return np.asarray(np.einsum("iaib->iab", self.cov))


@dataclass(frozen=True)
class Shape:
    """A shape with the covariance of its parameters."""

    kind: str  #: a key of `KINDS`.
    p: Array  #: middle of the touched part of a plane or an edge, a corner, a centre, a point of an axis [m], (3,).
    #: axes u, v, w as columns, (3, 3): w is the outward normal of a plane, the direction of an edge or of an axis, the
    #: middle of the forces on a corner; u and v are the directions in which a plane extends most and least.
    frame: Array
    radius: float = 0.0  #: of a sphere or a cylinder [m].
    cov: Array = field(default_factory=lambda: np.zeros((6, 6)))  #: of all six parameters of `Kind`, (6, 6).
    #: range of the touched places [m], (extents, 2): along u and v, along w of an edge, along w and around a cylinder.
    extent: Array = field(default_factory=lambda: np.zeros((0, 2)))
    touches: tuple[str, ...] = ()  #: labels of the touches that support it.
    forces: Array = field(default_factory=lambda: np.zeros((0, 3)))  #: directions of their forces, (n, 3).
    rim: tuple[str, ...] = ()  #: of a plane that an edge bounds, labels of the touches of the edge.
    odds: float = 0.0  #: logarithm of the odds against touches without a shape.
    probabilities: dict[str, float] = field(default_factory=dict)  #: of each kind, for its touches.

    def moved(self, by: Array) -> "Shape":
        """Return the shape with other free parameters of its kind, (k,)."""
        every = np.zeros(6)
        every[list(KINDS[self.kind].free)] = by
        turn = Rotation.from_rotvec([every[3], every[4], 0.0]).as_matrix()
        p, radius = self.p + self.frame @ every[:3], self.radius * math.exp(every[5])
        return Shape(self.kind, p, self.frame @ turn, radius, self.cov, self.extent, self.touches, self.forces)

    def distances(self, x: Array) -> tuple[Array, Array]:
        """Return how far points (n, 3) are from the shape [m], (n, k), and the derivative by the points, (n, k, 3)."""
        local, n = np.asarray((x - self.p) @ self.frame), len(x)
        if self.kind == "plane":
            return local[:, 2:], np.broadcast_to(self.frame[:, 2:].T, (n, 1, 3))
        if self.kind in ("sphere", "cylinder"):
            if self.kind == "cylinder":
                local = local * (1.0, 1.0, 0.0)
            far = np.maximum(np.linalg.norm(local, axis=1), 1e-9)
            return (far - self.radius)[:, None], ((local / far[:, None]) @ self.frame.T)[:, None, :]
        k = 2 if self.kind == "edge" else 3
        return local[:, :k], np.broadcast_to(self.frame[:, :k].T, (n, k, 3))

    def normals(self, x: Array) -> Array:
        """Return the outward normals of a plane, a sphere or a cylinder at points (n, 3), unit vectors, (n, 3)."""
        return np.asarray(self.distances(x)[1][:, 0, :])

    def places(self, x: Array) -> Array:
        """Return where points (n, 3) lie along the directions in which the shape extends [m], (n, extents)."""
        local = np.asarray((x - self.p) @ self.frame)
        if self.kind == "cylinder":
            around = np.arctan2(local[:, 1], local[:, 0])
            middle = np.angle(np.exp(1j * around).sum())
            return np.column_stack([local[:, 2], self.radius * np.angle(np.exp(1j * (around - middle)))])
        if self.kind == "sphere":  # on the plane about the middle of the touched part, equal distances
            unit = local / np.linalg.norm(local, axis=1, keepdims=True)
            middle = unit.sum(axis=0) / max(np.linalg.norm(unit.sum(axis=0)), 1e-9)
            across = unit - np.outer(unit @ middle, middle)
            angle = np.arccos(np.clip(unit @ middle, -1.0, 1.0)) / np.maximum(np.linalg.norm(across, axis=1), 1e-9)
            flat: Array = self.radius * (across * angle[:, None]) @ np.linalg.svd(across)[2][:2].T
            return flat
        return np.asarray(local[:, {"plane": [0, 1], "edge": [2]}.get(self.kind, [])])

    def cov_at(self, x: Array) -> Array:
        """Return the covariance of the shape's points next to points (n, 3), across the shape alone [m²], (n, k, k)."""
        J = by_parameters(self, x)
        return np.asarray(J @ self.cov @ J.transpose(0, 2, 1))

    @property
    def ends(self) -> Array:
        """Return the ends of the touched part of an edge, the corners of that of a plane, the point otherwise [m]."""
        if self.kind == "edge":
            return np.asarray(self.p + self.extent[0][:, None] * self.frame[:, 2])
        if self.kind == "plane":
            (a, b), (c, d) = self.extent
            return np.asarray(self.p + np.array([[a, c], [b, c], [b, d], [a, d]]) @ self.frame[:, :2].T)
        return self.p[None]

    @property
    def outlines(self) -> list[Array]:
        """Return lines that show the touched part [m], (k, 3) each."""
        if self.kind == "plane":
            return [self.ends[[0, 1, 2, 3, 0]]]
        if not self.radius:
            return [self.ends]
        circle = np.linspace(0.0, 2.0 * math.pi, 49)
        ring = self.radius * np.stack([np.cos(circle), np.sin(circle), np.zeros(49)], axis=1)
        if self.kind == "sphere":
            return [self.p + np.roll(ring, k, axis=1) for k in range(3)]
        rings = [self.p + (ring + np.array([0.0, 0.0, end])) @ self.frame.T for end in self.extent[0]]
        return [*rings, *(np.array([rings[0][k], rings[1][k]]) for k in (0, 12, 24, 36))]

    @property
    def end_covs(self) -> Array:
        """Return the covariance of the shape across itself at its ends, as one of points [m²], (k, 3, 3)."""
        if self.radius:
            return (self.frame @ self.cov[:3, :3] @ self.frame.T)[None]
        N = self.distances(self.ends)[1]
        return np.asarray(N.transpose(0, 2, 1) @ self.cov_at(self.ends) @ N)

    @property
    def rms(self) -> float:
        """Return the largest RMS distance of the touched part from the true shape, across it [m]."""
        if self.kind in ("sphere", "cylinder"):
            return math.sqrt(float(np.trace(self.cov[:3, :3])))
        return math.sqrt(float(np.trace(self.cov_at(self.ends), axis1=1, axis2=2).max()))

    @property
    def tilt(self) -> float:
        """Return the standard deviation of the direction, the larger of two [rad]; NaN of a shape without one."""
        if not {3, 4} <= set(KINDS[self.kind].free):
            return math.nan
        return math.sqrt(float(np.linalg.eigvalsh(self.cov[3:5, 3:5])[-1]))

    @property
    def text(self) -> str:
        """Return the shape in one line."""
        at = " to ".join(_mm(end) for end in self.ends) if self.kind == "edge" else _mm(self.p)
        parts = [f"{self.kind} {at} mm ± {self.rms / MM:.2g} mm"]
        if math.isfinite(self.tilt):
            what = {"plane": "normal", "edge": "direction"}.get(self.kind, "axis")
            parts.append(f"{what} ({', '.join(f'{part:z.3f}' for part in self.frame[:, 2])}) ± "
                         f"{math.degrees(self.tilt):.2g}°")  # fmt: skip
        if self.radius:
            parts.append(f"radius {self.radius / MM:.2f} ± {self.radius * math.sqrt(self.cov[5, 5]) / MM:.2g} mm")
        if self.kind == "plane":
            parts.append("at least " + " × ".join(f"{np.ptp(range_) / MM:.0f}" for range_ in self.extent) + " mm")
        sure = self.probabilities.get(self.kind, 1.0)
        return ", ".join([*parts, f"{100 * sure:.0f} %", f"touches {' '.join(self.touches)}"])


def _mm(p: Array) -> str:
    return f"({', '.join(f'{part / MM:z.2f}' for part in p)})"


def by_parameters(shape: Shape, x: Array) -> Array:
    """Return the derivative of the distances of points by the six parameters, (n, k, 6)."""
    N = shape.distances(x)[1] @ shape.frame
    J = N @ _local_by_parameters(shape, x)
    if shape.radius:
        J[:, :, 5] = -shape.radius
    return np.asarray(J)


def _local_by_parameters(shape: Shape, x: Array) -> Array:
    """Return the derivative of points (n, 3) in the axes of a shape by its six parameters, (n, 3, 6)."""
    a, b, c = np.asarray((x - shape.p) @ shape.frame).T
    J = np.zeros((len(x), 3, 6))
    J[:, :, :3] = -np.eye(3)
    J[:, 1, 3], J[:, 2, 3], J[:, 0, 4], J[:, 2, 4] = c, -b, -c, a
    return J


@dataclass(frozen=True)
class ShapeFit:
    """Fits shapes to touches.

    Args:
        touches: of a map.
        friction: coefficient μ of the object on the probe. A sliding contact has a tangential force of μ times the
            normal one in any direction, so the force deviates from the normal by μ/√2 about each of two axes.
    """

    touches: TouchSet
    friction: float = 0.5

    def _log_forces(self, shape: Shape, which: TouchSet) -> Array:
        """Return the log density of the force directions [1/sr], and of the contact along the probe [1/m], (n,)."""
        f, std = which.force, self._std(shape, which)
        if shape.kind in ("corner", "tip"):
            cone = CORNER_CONE if shape.kind == "corner" else TIP_CONE
            inside = cone - np.arccos(np.clip(f @ shape.frame[:, 2], -1.0, 1.0))
            theta = np.linspace(0.0, math.pi, 181)
            density = ndtr((cone - theta) / std[0]) * 2.0 * math.pi * np.sin(theta)
            return np.asarray(log_ndtr(inside / std) - math.log(float(density.sum()) * float(theta[1])))
        if shape.kind == "edge":
            w = shape.frame[:, 2]
            along = -0.5 * (np.arcsin(np.clip(f @ w, -1.0, 1.0)) / std) ** 2 - np.log(math.sqrt(2.0 * math.pi) * std)
            across = _cross(np.nan_to_num(which.tangent), w)
            length, flat = np.linalg.norm(across, axis=1), f - np.outer(f @ w, w)
            aligned = np.abs((flat * across).sum(axis=1))  # the normal of an edge is perpendicular to the probe as well
            aligned /= np.maximum(length * np.linalg.norm(flat, axis=1), 1e-9)
            off = np.arccos(np.clip(aligned, 0.0, 1.0))
            near = SHARE_ACROSS * np.exp(-0.5 * (off / std) ** 2) / (2.0 * math.sqrt(2.0 * math.pi) * std)
            near = np.where(length > 0.3, near, SHARE_ACROSS / (2.0 * math.pi))
            return along + np.log(near + (1.0 - SHARE_ACROSS) / (2.0 * math.pi))
        angle = np.arccos(np.clip(np.einsum("na,na->n", f, shape.normals(which.p)), -1.0, 1.0))
        log_forces = -0.5 * (angle / std) ** 2 - np.log(2.0 * math.pi * std**2)
        log_forces = np.where(np.any(f != 0.0, axis=1), log_forces, -math.log(4.0 * math.pi))
        if shape.kind == "plane":
            log_forces += _log_tip_contact(which)
        else:
            # The side of a straight probe touches a round surface where its tangent is perpendicular to the normal.
            # Places on the surface are uniform already, so agreement adds nothing.
            sine = np.einsum("na,na->n", np.nan_to_num(which.tangent), shape.normals(which.p))
            variance = BENT**2 + np.trace(which.own_cov, axis1=1, axis2=2) / 3.0 / shape.radius**2
            side = SHARE_ACROSS * np.exp(-0.5 * np.arcsin(np.clip(sine, -1.0, 1.0)) ** 2 / variance)
            log_forces += np.where(np.isfinite(which.beyond), np.log(side + 1.0 - SHARE_ACROSS), 0.0)
        return np.asarray(log_forces)

    def _std(self, shape: Shape, which: TouchSet) -> Array:
        """Return the standard deviation of the angle between force and normal about each axis [rad], (n,)."""
        variance = np.full(len(which), 0.5 * self.friction**2 + FORCE_NOISE**2)
        if shape.radius:
            variance += np.trace(which.own_cov, axis1=1, axis2=2) / 3.0 / shape.radius**2
        return np.asarray(np.sqrt(np.minimum(variance, 1.0)))

    def _log_each(self, shape: Shape, which: TouchSet, extents: Array) -> Array:
        """Return the log density of each touch for itself if the shape has extents [m], (n,)."""
        g, N = shape.distances(which.p)
        S = N @ which.own_cov @ N.transpose(0, 2, 1) + shape.cov_at(which.p)
        chi2 = np.einsum("nk,nk->n", g, np.linalg.solve(S, g[:, :, None])[:, :, 0])
        place = -0.5 * chi2 - 0.5 * np.log(np.linalg.det(2.0 * math.pi * S)) - np.log(extents).sum()
        place[chi2 > statistics.max_chi2(g.shape[1], MISSED)] = -np.inf
        return np.asarray(place + self._log_forces(shape, which))

    def fitted(self, seed: Shape, which: TouchSet, quick: bool = False) -> Shape | None:
        """Return the shape of a kind that fits touches best, with its covariance; None where they do not fix it.

        A quick fit is one step of Gauss and Newton.
        """
        free, n, shape = list(KINDS[seed.kind].free), len(which), seed
        H = np.zeros((0, 0))
        for _ in range(1 if quick else 2):
            shape = self._framed(shape, which)
            N, std = shape.distances(which.p)[1], self._std(shape, which)
            k = N.shape[1]
            S = np.einsum("iax,ixjy,jby->iajb", N, which.cov, N).reshape(n * k, n * k)
            W, start = statistics.whiten(S), shape

            def residuals(by: Array, start: Shape = start, W: Array = W, std: Array = std) -> Array:
                at = start.moved(by)
                return np.concatenate([W @ at.distances(which.p)[0].ravel(), _turned(at, which, std)[0]])

            def derivative(by: Array, start: Shape = start, W: Array = W, std: Array = std) -> Array:
                at = start.moved(by)
                J = W @ by_parameters(at, which.p).reshape(len(W), 6)
                return np.concatenate([J, _turned(at, which, std)[1]])[:, free]

            zero, scale = np.zeros(len(free)), np.array([1e-3] * 3 + [1e-3 / max(shape.radius, 0.02)] * 3)[free]
            try:
                if quick:
                    jac = derivative(zero)
                    by = -scale * np.linalg.lstsq(jac * scale, residuals(zero), rcond=1e-9)[0]
                else:
                    solved = least_squares(residuals, zero, derivative, x_scale=scale, ftol=1e-4, method="lm",
                                           max_nfev=12)  # fmt: skip
                    jac, by = np.asarray(solved.jac), solved.x
            except (ValueError, np.linalg.LinAlgError):
                return None
            shape, H = start.moved(by), jac.T @ jac
            if shape.radius and not RADII[0] < shape.radius < RADII[1]:
                return None
        if np.linalg.cond(H) > 1e14:
            return None
        cov = np.zeros((6, 6))
        cov[np.ix_(free, free)] = np.linalg.inv(H)
        places = shape.places(which.p)
        extent = np.stack([places.min(axis=0), places.max(axis=0)], axis=1)
        shape = replace(shape, cov=cov, extent=extent, touches=which.labels, forces=which.force)
        return replace(shape, odds=self._log_evidence(shape, which, H) - n * ALONE)

    def _framed(self, shape: Shape, which: TouchSet) -> Shape:
        """Return the shape at the middle of its touches, the axes of a plane along their spread."""
        p, F, middle = shape.p, shape.frame, which.p.mean(axis=0)
        if shape.kind == "plane":
            flat = (which.p - middle) - np.outer((which.p - middle) @ F[:, 2], F[:, 2])
            u = np.linalg.svd(flat)[2][0]
            u = u - (u @ F[:, 2]) * F[:, 2]
            u = u / np.linalg.norm(u)
            F, p = np.column_stack([u, _cross(F[:, 2], u), F[:, 2]]), middle - ((middle - p) @ F[:, 2]) * F[:, 2]
        elif shape.kind in ("edge", "cylinder"):
            p = p + ((middle - p) @ F[:, 2]) * F[:, 2]
        elif shape.kind in ("corner", "tip"):
            F = _frame(which.force.sum(axis=0))
        return replace(shape, p=p, frame=F)

    def _log_evidence(self, shape: Shape, which: TouchSet, H: Array) -> float:
        """Return log Z of a fitted shape, with H the information on its free parameters."""
        n, free = len(which), KINDS[shape.kind].free
        g, N = shape.distances(which.p)
        S = np.einsum("iax,ixjy,jby->iajb", N, which.cov, N).reshape(g.size, g.size)
        L = np.linalg.cholesky(S)
        z = np.linalg.solve(L, g.ravel())
        log_Z = -0.5 * float(z @ z) - float(np.log(L.diagonal()).sum()) - 0.5 * g.size * math.log(2.0 * math.pi)
        log_Z += float(self._log_forces(shape, which).sum())
        log_Z += sum(_log_extent(max(float(np.ptp(range_)), EXTENTS[0]), n) for range_ in shape.extent)
        log_prior = -sum(i < 3 for i in free) * math.log(WORKSPACE)
        if 3 in free:
            log_prior -= math.log(4.0 * math.pi if shape.kind == "plane" else 2.0 * math.pi)
        if 5 in free:
            log_prior -= math.log(math.log(RADII[1] / RADII[0]))
        return log_Z + log_prior + 0.5 * len(free) * math.log(2.0 * math.pi) - 0.5 * float(np.linalg.slogdet(H)[1])

    def best_of(self, kind: str, which: TouchSet, rng: np.random.Generator) -> Shape | None:
        """Return the shape of a kind with the largest odds that all touches support."""
        extents = np.full(KINDS[kind].extents, 0.05)
        starts = [seed for _, seed in _seeds(kind, which, rng)]
        scores = [float(self._log_each(seed, which, extents).sum()) for seed in starts]
        fits = [self.fitted(starts[i], which) for i in np.argsort(scores)[::-1][:3]]
        return max((shape for shape in fits if shape is not None), key=lambda shape: shape.odds, default=None)

    def shapes(self, seed: int = 1) -> list[Shape]:
        """Return the shapes of the touches, the most certain first; touches that no shape explains are left.

        Of all candidates, those without a common touch are chosen that have the largest sum of odds. The search goes on
        with the parts of the chosen ones, with planes that they bound, and with what they leave of other candidates.
        """
        rng, every = np.random.default_rng(seed), dict[tuple[str, ...], Shape]()

        def add(shape: Shape | None) -> None:
            if shape is not None and shape.odds >= MIN_ODDS:
                every.setdefault((shape.kind, *shape.touches, "", *shape.rim), shape)

        for kind in [kind for kind, of in KINDS.items() if of.fewest <= len(self.touches)]:
            for shape in self._grown(kind, rng):
                add(shape)
        chosen, bounded = list[Shape](), set[tuple[str, ...]]()
        for _ in range(ROUNDS):
            before, chosen = chosen, self._packed(list(every.values()))
            if before and all(former is shape for former, shape in zip(before, chosen, strict=False)):
                break
            for part in (part for shape in chosen if not shape.rim for part in self._parts(shape)):
                add(part)
            free = [shape for shape in every.values() if not shape.rim]
            # The best edge of each touch, and those that are chosen without the planes that they bound.
            best = {label: shape for shape in sorted(free, key=lambda shape: shape.odds) if shape.kind == "edge"
                    for label in shape.touches}  # fmt: skip
            pool = [*best.values(), *(shape for shape in self._packed(free) if shape.kind == "edge")]
            pool += [part for edge in pool for part in self._parts(edge) if part.odds >= MIN_ODDS]
            for edge in [*pool, *(shape for shape in chosen if shape.kind == "edge")]:
                for more in (edge, *self._sheets(edge)) if edge.touches not in bounded else ():
                    add(more)
                bounded.add(edge.touches)
            sets = {(shape.kind, *shape.touches) for shape in every.values()}
            for shape, other in (*product(free, chosen), *product(pool, pool)):
                rest = tuple(label for label in shape.touches if label not in other.touches)
                if KINDS[shape.kind].fewest <= len(rest) < len(shape.touches) and (shape.kind, *rest) not in sets:
                    sets.add((shape.kind, *rest))
                    add(self.fitted(shape, self.touches.subset(self._indices(rest)), quick=True))
        judged = (self.of_one(self._indices(shape.rim or shape.touches), rng) for shape in chosen)
        known = [shape for shape in judged if shape is not None and shape.odds >= MIN_ODDS]
        return sorted([*known, *self._sure_sheets(chosen, list(every.values()))], key=lambda shape: -shape.odds)

    def _sure_sheets(self, chosen: list[Shape], candidates: list[Shape]) -> Iterator[Shape]:
        """Yield the chosen planes that edges bound, fitted, without those that another choice explains nearly as well.

        The probability of a plane follows from the largest sum of odds of candidates among which it is not.
        """
        total = sum(shape.odds for shape in chosen)
        for sheet in [shape for shape in chosen if shape.rim]:
            # The same sheet has two touches of the rim in common, and the normal by a few degrees.
            rivals = [shape for shape in candidates if len(set(shape.rim) & set(sheet.rim)) < 2
                      or abs(float(shape.frame[:, 2] @ sheet.frame[:, 2])) <= SAME_NORMAL]  # fmt: skip
            margin = total - sum(shape.odds for shape in self._packed(rivals))
            at_rim = np.isin(self.touches.labels, sheet.rim)  # these touches are points of the plane alone
            side = np.where(self.touches.force @ sheet.frame[:, 2] < 0.0, -1.0, 1.0)  # a thin body has two sides
            force = np.where(at_rim, 0.0, side)[:, None] * self.touches.force
            touches = replace(self.touches, force=force, beyond=np.where(at_rim, np.nan, self.touches.beyond))
            of_sheet = touches.subset(self._indices(sheet.touches))
            fit = self.fitted(sheet, of_sheet) if margin >= MIN_ODDS else None
            if fit is not None:
                sure = {"plane": 1.0 / (1.0 + math.exp(-margin))}
                yield replace(fit, rim=sheet.rim, odds=sheet.odds, probabilities=sure)

    def _grown(self, kind: str, rng: np.random.Generator) -> Iterator[Shape]:
        """Yield shapes of a kind to which the touch that agrees best is added, one after the other."""
        tried = set[bytes]()
        for chosen, start in _seeds(kind, self.touches, rng):
            inside, shape = np.isin(np.arange(len(self.touches)), chosen), start
            extents = np.full(KINDS[kind].extents, 0.05)
            while True:
                gain = np.where(inside, -math.inf, self._log_each(shape, self.touches, extents) - ALONE)
                inside[gain.argmax()] = True
                if not gain.max() > 0.0 or inside.tobytes() in tried:
                    break
                tried.add(inside.tobytes())
                if inside.sum() >= KINDS[kind].fewest:
                    fit = self.fitted(shape, self.touches.subset(np.flatnonzero(inside)), quick=True)
                    if fit is None or fit.odds < 0.0:
                        break
                    yield fit
                    shape, extents = fit, np.maximum(np.ptp(fit.extent, axis=1), EXTENTS[0]) * 1.5

    def _packed(self, shapes: list[Shape]) -> list[Shape]:
        """Return the shapes without a common touch whose sum of odds is largest, the most certain first."""
        if not shapes:
            return []
        rows = {label: i for i, label in enumerate(self.touches.labels)}
        uses = np.zeros((len(rows), len(shapes)))
        for j, shape in enumerate(shapes):
            uses[[rows[label] for label in shape.touches], j] = 1.0
        packed = milp([-shape.odds for shape in shapes], integrality=np.ones(len(shapes), dtype=int),
                      bounds=Bounds(0.0, 1.0), constraints=LinearConstraint(uses, ub=np.ones(len(uses))))  # fmt: skip
        chosen = [shape for shape, share in zip(shapes, np.asarray(packed.x), strict=True) if share > 0.5]
        return sorted(chosen, key=lambda shape: -shape.odds)

    def _sheets(self, edge: Shape) -> Iterator[Shape]:
        """Yield half-planes that an edge bounds, through other touches, with their odds and without their covariance.

        They turn about the edge by one angle. The touches of the edge have normals on the side away from the sheet, and
        those of the face lie behind the edge, uniform in a width along the edge and in a depth, both log-uniform.
        """
        i = self._indices(edge.touches)
        others = np.setdiff1d(np.arange(len(self.touches)), i)
        if not len(others):
            return
        of, E = self.touches.subset(others), edge.frame
        local, J = (of.p - edge.p) @ E, _local_by_parameters(edge, of.p)
        along = (self.touches.p[i] - edge.p) @ E[:, 2]
        std, tip = self._std(edge, of), _log_tip_contact(of)
        std_edge, f_edge, f = self._std(edge, self.touches.subset(i)), edge.forces @ E, of.force @ E
        cov = np.einsum("xa,ixjy,yb->iajb", E, of.cov, E)
        own = np.einsum("iaib->iab", cov)

        def axes(angle: float) -> tuple[Array, Array]:
            """Return the direction of a sheet away from the edge, and its normal."""
            c, s = math.cos(angle), math.sin(angle)
            return np.array([c, s, 0.0]), np.array([-s, c, 0.0])

        def sheet(k: NDArray[np.intp], angle: float) -> tuple[float, float, float]:
            """Return the log odds of a sheet against separate touches of the face, its angle and the variance of it."""
            C = cov[k[:, None], :, k[None]]
            for _ in range(2):
                d, n = axes(angle)
                g, depth, N = local[k] @ n, local[k] @ d, J[k].transpose(0, 2, 1) @ n
                S = C @ n @ n + N @ edge.cov @ N.T
                side = np.where(f[k] @ n < 0.0, -1.0, 1.0)
                turn = np.arctan2(side * (f[k] @ -d), side * (f[k] @ n))
                solved = np.linalg.solve(S, np.column_stack([g, depth]))
                h = float(depth @ solved[:, 1] + (1.0 / std[k] ** 2).sum())
                by = float(depth @ solved[:, 0] + (turn / std[k] ** 2).sum()) / h
                angle += by
            chi2 = float(g @ solved[:, 0])
            if chi2 > statistics.max_chi2(len(k), MISSED):
                return -math.inf, angle, 1.0 / h
            off = np.arccos(np.clip(side * (f[k] @ n), -1.0, 1.0)) / std[k]
            log_Z = -0.5 * chi2 - 0.5 * float(np.linalg.slogdet(2.0 * math.pi * S)[1])
            log_Z += float((tip[k] - 0.5 * off**2 - np.log(2.0 * math.pi * std[k] ** 2) - ALONE).sum())
            log_Z += float((math.log(2.0) + log_ndtr(-np.arcsin(np.clip(f_edge @ d, -1.0, 1.0)) / std_edge)).sum())
            log_Z += float(log_ndtr(depth / np.sqrt((C @ d @ d).diagonal())).sum())
            log_Z -= len(k) * math.log(max(depth.max(), EXTENTS[0])) + math.log(
                len(k) * math.log(EXTENTS[1] / EXTENTS[0])
            )
            both = np.concatenate([along, local[k, 2]])
            log_Z += _log_extent(float(np.ptp(both)), len(both)) - _log_extent(float(np.ptp(along)), len(along))
            log_Z += math.log(0.5 * 0.5 ** len(k) + 0.25 * (abs(side.sum()) == len(k)))
            return log_Z - math.log(2.0 * math.pi) + 0.5 * math.log(2.0 * math.pi / h), angle, 1.0 / h

        tried = set[bytes]()
        of_face = np.flatnonzero(tip >= 0.0)
        alone = [(sheet(np.array([j]), math.atan2(local[j, 1], local[j, 0])), j) for j in of_face]
        for (odds, angle, variance), j in alone:
            if odds < 0.0:
                continue
            inside = np.array([j])
            while True:
                d, n = axes(angle)
                if inside.tobytes() not in tried:
                    tried.add(inside.tobytes())
                    side = math.copysign(1.0, float(f[inside].sum(axis=0) @ n))
                    frame = E @ np.column_stack([(0.0, 0.0, side), d, side * n])
                    labels = edge.touches + tuple(of.labels[k] for k in inside)
                    # Any share of the touches of edge and face may be of the face, in any choice of them.
                    total = edge.odds + odds + float(betaln(len(inside) + 1, len(i) + 1))
                    yield Shape("plane", edge.p, frame, touches=labels, rim=edge.touches, odds=total)
                N, depth = J.transpose(0, 2, 1) @ n, local @ d
                std_g = np.sqrt(n @ own @ n + ((N @ edge.cov) * N).sum(axis=1) + depth**2 * variance)
                near = (np.abs(local @ n) < 4.0 * std_g) & (depth > -3.0 * np.sqrt(d @ own @ d))
                grown = [(sheet(np.append(inside, k), angle), k) for k in of_face if near[k] and k not in inside]
                better = max(grown, key=lambda candidate: candidate[0][0], default=None)
                if better is None or better[0][0] < odds:
                    break
                (odds, angle, variance), k = better
                inside = np.sort(np.append(inside, k))

    def _parts(self, shape: Shape) -> Iterator[Shape]:
        """Yield the parts of a shape on either side of each gap between its touches."""
        i, fewest = self._indices(shape.touches), KINDS[shape.kind].fewest
        for places in shape.places(self.touches.p[i]).T:
            order = i[np.argsort(places)]
            for k in range(1, len(order)):
                for part in (part for part in (order[:k], order[k:]) if len(part) >= fewest):
                    fit = self.fitted(shape, self.touches.subset(np.sort(part)), quick=True)
                    if fit is not None:
                        yield fit

    def of_one(self, indices: NDArray[np.intp], rng: np.random.Generator) -> Shape | None:
        """Return the most probable shape that all of some touches support, with the probability of each kind."""
        which = self.touches.subset(indices)
        fits = [self.best_of(kind, which, rng) for kind, of in KINDS.items() if len(which) >= of.fewest]
        known = [shape for shape in fits if shape is not None]
        if not known:
            return None
        best = max(known, key=lambda shape: shape.odds)
        weights = {shape.kind: math.exp(shape.odds - best.odds) for shape in known}
        return replace(best, probabilities={kind: w / sum(weights.values()) for kind, w in weights.items()})

    def _indices(self, labels: tuple[str, ...]) -> NDArray[np.intp]:
        return np.array(sorted(self.touches.labels.index(label) for label in labels), dtype=np.intp)


def missing(touches: TouchSet, shapes: Sequence[Shape]) -> str:
    """Return a line with the touches that no shape explains and what a shape takes; empty if there are none."""
    used = {label for shape in shapes for label in shape.touches}
    left = [label for label in touches.labels if label not in used]
    if not left:
        return ""
    fewest = ", ".join(f"{'an' if kind == 'edge' else 'a'} {kind} {of.fewest}" for kind, of in KINDS.items())
    return f"no shape: touch {' '.join(left)}; needed are touches that agree: {fewest}"


def _turned(shape: Shape, which: TouchSet, std: Array) -> tuple[Array, Array]:
    """Return the residuals of the force directions, and their derivative by the six parameters.

    They are the angle from the normal as a vector, or the angle from across an edge.
    """
    f, F = which.force, shape.frame
    if shape.kind in ("corner", "tip"):
        return np.zeros(0), np.zeros((0, 6))
    if shape.kind == "edge":
        sine = np.clip(f @ F[:, 2], -1.0, 1.0)
        J = np.zeros((len(f), 6))
        J[:, 3], J[:, 4] = -f @ F[:, 1], f @ F[:, 0]
        return np.arcsin(sine) / std, J / (std * np.sqrt(np.maximum(1.0 - sine**2, 1e-6)))[:, None]
    n = shape.normals(which.p)
    axis = _cross(f, n)
    sine, cosine = np.linalg.norm(axis, axis=1), np.einsum("na,na->n", f, n)
    turned = axis * (np.arctan2(sine, cosine) / np.maximum(sine, 1e-12) / std)[:, None]
    by = np.zeros((len(f), 3, 6))  # of the normal; the residual follows its rotation
    by[:, :, 3:5] = -_cross(n[:, None], F[:, :2].T).transpose(0, 2, 1)
    if shape.radius:
        flat = np.eye(3) - np.einsum("na,nb->nab", n, n)
        if shape.kind == "cylinder":
            flat = flat - np.outer(F[:, 2], F[:, 2])
        by += flat @ F @ _local_by_parameters(shape, which.p) / shape.radius
    known = np.linalg.norm(f, axis=1) / std
    by = _cross(n[:, None], by.transpose(0, 2, 1)).transpose(0, 2, 1) * known[:, None, None]
    return turned.ravel(), by.reshape(-1, 6)


def _log_tip_contact(which: TouchSet) -> Array:
    """Return the log density of contacts along the probe if its tip touches, over that of any contact, (n,)."""
    t, known = np.nan_to_num(which.tangent), np.isfinite(which.beyond)
    variance = np.einsum("na,nab,nb->n", t, which.own_cov, t) + TIP_CONTACT**2
    density = 2.0 * np.exp(-0.5 * np.nan_to_num(which.beyond) ** 2 / variance) / np.sqrt(2.0 * math.pi * variance)
    anywhere = 1.0 / (0.25 * WORKSPACE)  # along the distal half of a probe of half the workspace
    return np.where(known, np.log(np.maximum(density, 1e-300) / anywhere), 0.0)


def _log_extent(range_: float, n: int) -> float:
    """Return the log density of n places with a range [m], uniform in an interval of log-uniform width.

    ∫ w⁻ⁿ (w - R)/L dw/(w log(b/a)) from R to infinity = R¹⁻ⁿ / (n (n - 1) L log(b/a)).
    """
    return (1 - n) * math.log(range_) - math.log(n * (n - 1) * WORKSPACE * math.log(EXTENTS[1] / EXTENTS[0]))


def _cross(a: Array, b: Array) -> Array:
    """Return a × b of vectors (..., 3), faster than `numpy.cross` for few of them."""
    return np.asarray(a[..., [1, 2, 0]] * b[..., [2, 0, 1]] - a[..., [2, 0, 1]] * b[..., [1, 2, 0]])


def _frame(w: Array) -> Array:
    """Return a rotation whose third column is along a vector, (3, 3)."""
    w = w / max(float(np.linalg.norm(w)), 1e-12)
    u = _cross(w, np.eye(3)[np.argmin(np.abs(w))])
    u = u / np.linalg.norm(u)
    return np.column_stack([u, _cross(w, u), w])


def _seeds(kind: str, which: TouchSet, rng: np.random.Generator) -> Iterator[tuple[list[int], Shape]]:
    """Yield small sets of touches, each a touch and some of its neighbours, and shapes of a kind through them."""
    n, size = len(which), min(KINDS[kind].seed, len(which))
    far = np.linalg.norm(which.p[:, None] - which.p[None], axis=2)
    near = np.argsort(far, axis=1)[:, : max(12, size + 3)]
    sets = {tuple(sorted(rng.choice(near[i % n], size, replace=False))) for i in range(SEEDS if size > 1 else n)}
    for chosen in sorted(combinations(range(n), size) if size == 2 else sets):
        i, free = list(chosen), list(KINDS[kind].free)
        shape = _through(kind, which.p[i], which.force[i])
        if shape is not None:
            J, N = by_parameters(shape, which.p[i]).reshape(-1, 6)[:, free], shape.distances(which.p[i])[1]
            S = np.einsum("iax,ixjy,jby->iajb", N, which.cov[i][:, :, i], N).reshape(len(J), len(J))
            cov, by = np.zeros((6, 6)), np.linalg.pinv(J)
            cov[np.ix_(free, free)] = by @ S @ by.T
            yield i, replace(shape, cov=cov)


def _through(kind: str, p: Array, f: Array) -> Shape | None:
    """Return the shape of a kind through points (n, 3) with forces (n, 3); None where they define none."""
    middle, mean = p.mean(axis=0), f.sum(axis=0)
    if kind in ("corner", "tip"):
        return Shape(kind, middle, _frame(mean))
    spread = np.linalg.svd(p - middle)
    if kind == "edge":
        return Shape(kind, middle, _frame(spread[2][0])) if spread[1][0] > 1e-4 else None
    if kind == "plane":
        normal = spread[2][2] if spread[1][1] > 1e-4 else mean - (mean @ spread[2][0]) * spread[2][0]
        return Shape(kind, middle, _frame(normal * math.copysign(1.0, normal @ mean)))
    F = np.eye(3)
    if kind == "cylinder":
        # The forces of a cylinder are perpendicular to its axis.
        F = _frame(np.linalg.svd(f)[2][2])
    flat = ((p - middle) @ F)[:, : 3 if kind == "sphere" else 2]
    # A centre c and a radius r along the forces: p - r f = c, in least squares.
    along = (f @ F)[:, : flat.shape[1]]
    d_along, d_flat = along - along.mean(axis=0), flat - flat.mean(axis=0)
    radius = float((d_along * d_flat).sum() / max(float((d_along**2).sum()), 1e-9))
    if not RADII[0] < radius < RADII[1]:
        return None
    centre = flat.mean(axis=0) - radius * along.mean(axis=0)
    return Shape(kind, middle + F[:, : len(centre)] @ centre, F, radius)


def shapes_document(shapes: Sequence[Shape]) -> list[dict[str, Any]]:
    """Return the shapes for a JSON document, lengths in mm and angles in degrees."""
    return [
        {
            "kind": shape.kind, "p_mm": (shape.p / MM).tolist(), "axes": shape.frame.T.tolist(),
            "radius_mm": float(shape.radius) / MM or None, "extent_mm": (shape.extent / MM).tolist(),
            "cov": shape.cov.tolist(), "rms_mm": shape.rms / MM,
            "tilt_deg": None if math.isnan(shape.tilt) else math.degrees(shape.tilt),
            "touches": list(shape.touches), "rim": list(shape.rim), "probabilities": shape.probabilities,
        }
        for shape in shapes
    ]  # fmt: skip
