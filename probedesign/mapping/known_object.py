"""Pose of an object of known mesh from touches, from a first guess with its uncertainty.

The residuals are those of `shapes`: the distances of the points from the surface, whitened by their joint covariance,
and the angles of the forces from the outward normals there. The first guess is a normal prior on position and rotation.
Touches that are far from the surface are left out. With d the distances from the surface and b the shift from the first
guess, both whitened, |d|² + |b|² is χ² with as many degrees of freedom as touches, so a mesh of another object is
noticed where it differs by more than the errors of the touches. Needs trimesh, in the extra `mesh`.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from probedesign.core import statistics
from probedesign.core.errors import InputError
from probedesign.core.frames import Array
from probedesign.core.units import MM
from probedesign.mapping.shapes import FORCE_NOISE, TouchSet

if TYPE_CHECKING:
    import trimesh

SAMPLES = 8000  #: Number of points of the surface from which the nearest triangles are found.
#: Length by which a difference of unit normals counts as a distance [m]: some millimetres over half a radian; assumed.
FORCE_LENGTH = 0.012
NEAREST = 4  #: Number of nearest samples whose triangles are compared.
STARTS = 12  #: Number of starts of a fit, drawn from the prior.
MAX_SIGMAS = 4.0  #: Distance of a touch from the surface in standard deviations beyond which it is left out.
MIN_CHANCE = 1e-3  #: Chance of so large residuals below which the touches contradict the object.
MIN_STD = 0.2e-3  #: Least standard deviation of a distance [m]: the mesh is not the object. Assumed.


@dataclass(frozen=True)
class KnownObject:
    """The mesh of an object, in metres, in its own frame."""

    triangles: Array  #: corners of each triangle [m], (m, 3, 3).
    normals: Array  #: outward normal of each, (m, 3).
    samples: Array  #: points of the surface [m], (SAMPLES, 3).
    sample_faces: NDArray[np.intp]  #: triangle of each, (SAMPLES,).

    @classmethod
    def of(cls, mesh: "trimesh.Trimesh") -> "KnownObject":
        """Return the object of a mesh in metres."""
        import trimesh

        samples, faces = trimesh.sample.sample_surface(mesh, SAMPLES, seed=1)
        return cls(np.asarray(mesh.triangles), np.asarray(mesh.face_normals), np.asarray(samples), np.asarray(faces))

    @classmethod
    def load(cls, path: Path) -> "KnownObject":
        """Return the object of a mesh file in millimetres, of any format that trimesh reads.

        Raises:
            InputError: the file is no closed mesh, or trimesh is missing.
        """
        try:
            import trimesh
        except ImportError:
            raise InputError('--object needs trimesh: pip install "probedesign[mesh]"') from None
        try:
            mesh: trimesh.Trimesh = trimesh.load_mesh(path)
            closed = bool(mesh.is_watertight)
        except Exception as error:  # readers of trimesh raise errors of many types
            raise InputError(f"{path}: is not a readable mesh ({' '.join(str(error).split())[:80]})") from None
        if not closed:
            raise InputError(f"{path}: is not a closed mesh, so its outside is undefined")
        mesh.apply_transform(np.diag([MM, MM, MM, 1.0]))
        return cls.of(mesh)

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(np.concatenate([self.samples, FORCE_LENGTH * self.normals[self.sample_faces]], axis=1))

    @cached_property
    def _points(self) -> cKDTree:
        return cKDTree(self.samples)

    @cached_property
    def gyration(self) -> float:
        """Return the RMS distance of the surface from its middle [m], by which rotations count as lengths."""
        return math.sqrt(float(((self.samples - self.samples.mean(axis=0)) ** 2).sum(axis=1).mean()))

    def nearest(self, x: Array, force: Array) -> tuple[Array, Array, Array]:
        """Return the faces that touches touch, near the points and with a normal near the force.

        Args:
            x: points in the frame of the object [m], (n, 3).
            force: directions of the forces there, (n, 3).

        Returns:
            Signed distances from the planes of the faces, positive outside [m], (n,), their normals, (n, 3), and how
            far the points lie beside the faces [m], (n, 3).
        """
        from trimesh import triangles

        query = np.concatenate([x, FORCE_LENGTH * force], axis=1)
        candidates = self.sample_faces[self._tree.query(query, NEAREST)[1]]
        flat = candidates.ravel()
        q = triangles.closest_point(self.triangles[flat], np.repeat(x, NEAREST, axis=0))  # type: ignore[no-untyped-call]
        q = q.reshape(len(x), NEAREST, 3)
        turned = FORCE_LENGTH * (self.normals[candidates] - force[:, None])
        best = (((x[:, None] - q) ** 2).sum(axis=2) + (turned**2).sum(axis=2)).argmin(axis=1)
        rows = np.arange(len(x))
        d, normals = x - q[rows, best], self.normals[candidates[rows, best]]
        distance = np.einsum("na,na->n", d, normals)
        return distance, normals, d - distance[:, None] * normals

    def contains_any(self, x: Array, depth: float) -> bool:
        """Return whether any of points (n, 3) lies deeper in the object than `depth` [m]; by the nearest samples."""
        far, i = self._points.query(x)
        d = np.einsum("na,na->n", x - self.samples[i], self.normals[self.sample_faces[i]])
        return bool(((d < -depth) & (far < self.gyration)).any())


@dataclass(frozen=True)
class ObjectPose:
    """Pose of an object with its covariance."""

    T_world_object: Array  #: (4, 4).
    #: covariance of its position in the world [m] and of the rotation vector in the world by which the true object is
    #: turned about its origin [rad], (6, 6).
    cov: Array
    touches: tuple[str, ...] = ()  #: labels of the touches that were used.
    left_out: tuple[str, ...] = ()  #: labels of those that are far from the surface.
    chance: float = 1.0  #: of residuals as large as those of the touches; 0 if a force points into the surface.

    @property
    def contradicted(self) -> bool:
        """Whether the touches are hardly those of this object: their residuals are too large, or most are left out."""
        return self.chance < MIN_CHANCE or len(self.left_out) > len(self.touches)

    @classmethod
    def prior(cls, T_world_object: Array, std: float, std_angle: float) -> "ObjectPose":
        """Return a first guess, with standard deviations on each axis: of the position [m] and the rotation [rad]."""
        return cls(T_world_object, np.diag([std**2] * 3 + [std_angle**2] * 3))

    def moved(self, by: Array) -> "ObjectPose":
        """Return the pose after a shift [m] and a rotation [rad] about its origin, (6,)."""
        T = self.T_world_object.copy()
        T[:3, :3] = Rotation.from_rotvec(by[3:]).as_matrix() @ T[:3, :3]
        T[:3, 3] += by[:3]
        return replace(self, T_world_object=T)

    def to_object(self, x: Array) -> Array:
        """Return points of the world (n, 3) in the frame of the object [m]."""
        return np.asarray((x - self.T_world_object[:3, 3]) @ self.T_world_object[:3, :3])

    def to_world(self, x: Array) -> Array:
        """Return points of the object (n, 3) in the world [m]."""
        return np.asarray(x @ self.T_world_object[:3, :3].T + self.T_world_object[:3, 3])

    @property
    def rms(self) -> tuple[float, float]:
        """Return the RMS errors of the position [m] and of the rotation [rad]."""
        return math.sqrt(float(np.trace(self.cov[:3, :3]))), math.sqrt(float(np.trace(self.cov[3:, 3:])))

    @property
    def text(self) -> str:
        """Return the pose in one line."""
        p, q = self.T_world_object[:3, 3] / MM, Rotation.from_matrix(self.T_world_object[:3, :3]).as_quat()
        left = f", without touch {' '.join(self.left_out)}" if self.left_out else ""
        return (f"object at ({', '.join(f'{part:z.2f}' for part in p)}) mm ± {self.rms[0] / MM:.2g} mm, quaternion "
                f"({', '.join(f'{part:z.4f}' for part in q)}) ± {math.degrees(self.rms[1]):.2g}°, "
                f"{len(self.touches)} touches{left}"
                + ("; the touches contradict this object: check the mesh, its unit (mm) and --object-at"
                   if self.contradicted else ""))  # fmt: skip


def by_pose(pose: ObjectPose, x: Array, normals: Array) -> Array:
    """Return the derivative of the distances of points (n, 3) from the surface by the pose, (n, 6).

    A shift of the object by δ and a turn by θ about its origin o moves the surface at x by δ + θ × (x - o).
    """
    return -np.concatenate([normals, np.cross(x - pose.T_world_object[:3, 3], normals)], axis=1)


def locate_object(
    touches: TouchSet, of: KnownObject, prior: ObjectPose, friction: float = 0.5, seed: int = 1
) -> ObjectPose:
    """Return the pose of an object from touches.

    Args:
        touches: of a map.
        of: the object.
        prior: first guess with its uncertainty.
        friction: coefficient μ, as in `ShapeFit`.
        seed: of the random starts.
    """
    if not len(touches):
        return prior
    std_force = math.sqrt(0.5 * friction**2 + FORCE_NOISE**2)
    L = np.linalg.cholesky(prior.cov)
    starts = [np.zeros(6), *(L @ np.random.default_rng(seed).normal(size=(STARTS - 1, 6)).T).T]
    fits = [_fitted(touches, of, prior, start, std_force, robust=True) for start in starts]
    by = min(fits, key=lambda fit: fit[0])[1]
    distance, normals, _ = _faces(touches, of, prior.moved(by))
    std = np.sqrt(np.einsum("na,nab,nb->n", normals, touches.own_cov, normals) + MIN_STD**2)
    near = np.abs(distance) <= MAX_SIGMAS * std
    used = touches.subset(np.flatnonzero(near))
    for _ in range(3):
        _, by, H = _fitted(used, of, prior, by, std_force, robust=False)
    distance, normals, beside = _faces(used, of, prior.moved(by))
    d = statistics.whiten(_across(used, normals)) @ distance
    b = np.concatenate([np.einsum("nab,nb->na", statistics.whiten(used.own_cov), beside).ravel(),
                        statistics.whiten(prior.cov) @ by])  # fmt: skip
    inward = bool((np.einsum("na,na->n", used.force, normals) < 0.0).any())
    return replace(
        prior.moved(by),
        cov=np.asarray(np.linalg.inv(H), dtype=float),
        touches=used.labels,
        left_out=tuple(touches.labels[i] for i in np.flatnonzero(~near)),
        chance=0.0 if inward else float(chi2.sf(d @ d + b @ b, len(used))),
    )


def _across(touches: TouchSet, normals: Array) -> Array:
    """Return the covariance of the distances of touches from a surface with normals (n, 3) [m²], (n, n)."""
    cov = np.einsum("ia,iajb,jb->ij", normals, touches.cov, normals) + MIN_STD**2 * np.eye(len(touches))
    return np.asarray(cov, dtype=float)


def _faces(touches: TouchSet, of: KnownObject, pose: ObjectPose) -> tuple[Array, Array, Array]:
    """Return `KnownObject.nearest` of touches with normals and offsets in the world."""
    R = pose.T_world_object[:3, :3]
    distance, normals, beside = of.nearest(pose.to_object(touches.p), touches.force @ R)
    return distance, normals @ R.T, beside @ R.T


def _fitted(
    touches: TouchSet, of: KnownObject, prior: ObjectPose, start: Array, std_force: float, robust: bool
) -> tuple[float, Array, Array]:
    """Return the cost, the six parameters from the prior and the information of a fit from a start."""
    normals, n = _faces(touches, of, prior.moved(start))[1], len(touches)
    S = _across(touches, normals)
    W = np.diag(1.0 / np.sqrt(S.diagonal())) if robust else statistics.whiten(S)
    W_prior, W_each = statistics.whiten(prior.cov), statistics.whiten(touches.own_cov)

    def residuals(by: Array) -> Array:
        distance, normals, beside = _faces(touches, of, prior.moved(by))
        cosine = np.clip(np.einsum("na,na->n", touches.force, normals), -1.0, 1.0)
        axis = np.cross(touches.force, normals)
        axis /= np.maximum(np.linalg.norm(axis, axis=1, keepdims=True), 1e-12)
        turned = axis * (np.arccos(cosine) / std_force)[:, None]
        lateral = np.linalg.norm(np.einsum("nab,nb->na", W_each, beside), axis=1)
        return np.concatenate([W @ distance, lateral, turned.ravel(), W_prior @ by])

    scale = np.array([1e-3] * 3 + [1e-3 / of.gyration] * 3)
    # The loss of scipy softens the prior too; the fit of the touches that stay has the full one.
    loss: Literal["huber", "linear"] = "huber" if robust else "linear"
    fit = least_squares(residuals, start, x_scale=scale, ftol=1e-4, max_nfev=15, loss=loss, f_scale=2.0)
    jac = np.delete(np.asarray(fit.jac), np.arange(n, 2 * n), axis=0)  # beside a face is a bound, not a measurement
    return float(fit.cost), np.asarray(fit.x), jac.T @ jac


def parse_pose(text: str) -> Array:
    """Return T_world_object (4, 4) of "x,y,z" in mm, or "x,y,z,qx,qy,qz,qw".

    Raises:
        InputError: the text is neither.
    """
    try:
        values: Sequence[float] = [float(part) for part in text.split(",")]
    except ValueError:
        values = ()
    if len(values) not in (3, 7) or not np.isfinite(values).all() or (len(values) == 7 and not any(values[3:])):
        raise InputError(f"--object-at {text}: give x,y,z in mm, or x,y,z,qx,qy,qz,qw")
    T = np.eye(4)
    T[:3, 3] = np.array(values[:3]) * MM
    if len(values) == 7:
        T[:3, :3] = Rotation.from_quat(values[3:]).as_matrix()
    return T
