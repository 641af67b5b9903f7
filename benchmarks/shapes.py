"""Shapes, poses and the next best touch on meshes: kinds, coverage, a card house, and touches until a pose is known.

Touches are drawn on the surface of a mesh: the point, the outward normal, a force in the friction cone, the tangent of
a probe that can touch there, and errors of the point with the standard deviations of the located touches of the
rehearsed card house: along the probe, across it, common by stiffness and by the base. No rod is solved here.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import trimesh
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from benchmarks.timing import print_table
from probedesign.core import statistics
from probedesign.core.frames import Array
from probedesign.core.units import MM
from probedesign.mapping.shapes import KINDS, Shape, ShapeFit, TouchSet

FRICTION, FRICTION_SPREAD = 0.5, 0.2  #: Median μ and standard deviation of ln μ.
#: Standard deviations of a point along the probe and across it [m], relative of E, and of the base [m].
ALONG, ACROSS, STIFFNESS, BASE = 2.5e-3, 0.4e-3, 0.03, 0.083e-3
LEVER = 0.05  #: How far a contact shifts along the probe by the relative error of E [m].
TILT = np.radians(35.0)  #: Of a straight probe against a face that its tip touches.


@dataclass(frozen=True)
class TouchedObject:
    """A mesh and where it is touched."""

    mesh: trimesh.Trimesh  #: the object, in metres.
    points: Array  #: touched places, (k, 3).
    normals: Array  #: outward normals there, (k, 3).
    by_tip: bool = False  #: whether the tip touches.


def object_of(kind: str, rng: np.random.Generator, k: int = 400) -> TouchedObject:
    """Return an object with a shape of a kind, in a random pose, and places on that shape.

    At an edge, a corner and the tip of a thin cone the normals are drawn from the normal cone, which is that between
    the normals of the adjacent faces.
    """
    if kind in ("plane", "edge", "corner"):
        mesh = trimesh.creation.box(extents=rng.uniform(0.05, 0.09, 3))
        mesh.apply_translation(-mesh.bounds[1])  # a corner at the origin, three faces and edges through it
        size = -mesh.bounds[0]
        points, normals = np.zeros((k, 3)), np.abs(rng.normal(size=(k, 3)))
        if kind == "plane":
            points[:, :2], normals = -size[:2] * rng.uniform(0.1, 0.9, (k, 2)), np.tile([0.0, 0.0, 1.0], (k, 1))
        elif kind == "edge":
            points[:, 0], normals[:, 0] = -size[0] * rng.uniform(0.05, 0.95, k), 0.0
            angle = rng.uniform(0.0, 0.5 * np.pi, k)
            normals[:, 1], normals[:, 2] = np.cos(angle), np.sin(angle)
    elif kind == "tip":
        mesh = trimesh.creation.cone(radius=2e-3, height=0.06)
        mesh.apply_translation((0.0, 0.0, -0.06))
        points, normals = np.zeros((k, 3)), rng.normal(size=(k, 3))
        normals[:, 2] = np.abs(normals[:, 2])
    else:
        radius = rng.uniform(0.01, 0.03)
        mesh = (trimesh.creation.icosphere(5, radius) if kind == "sphere"
                else trimesh.creation.cylinder(radius, 0.09, sections=256))  # fmt: skip
        points, faces = trimesh.sample.sample_surface(mesh, 20 * k, seed=int(rng.integers(2**31)))
        side = (np.abs(points[:, 2]) < 0.04) & (np.abs(mesh.face_normals[faces, 2]) < 0.5) & (points[:, 0] > 0.0)
        chosen = np.flatnonzero(side if kind == "cylinder" else points[:, 2] > 0.0)[:k]
        points, normals = points[chosen], mesh.face_normals[faces[chosen]]
    normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    T = np.eye(4)
    T[:3, :3] = Rotation.from_quat(rng.normal(size=4)).as_matrix()
    T[:3, 3] = rng.uniform(-0.05, 0.05, 3)
    mesh.apply_transform(T)
    return TouchedObject(mesh, points @ T[:3, :3].T + T[:3, 3], normals @ T[:3, :3].T, kind == "plane")


def draw_touches(
    of: TouchedObject, n: int, rng: np.random.Generator, first: int = 1, across: Array | None = None
) -> tuple[TouchSet, Array]:
    """Return touches of random places of an object with their errors, and all its places without error, (k, 3)."""
    chosen = rng.choice(len(of.points), n, replace=False)
    p, normal = of.points[chosen], of.normals[chosen]
    mu = FRICTION * np.exp(FRICTION_SPREAD * rng.normal(size=n)) * np.sqrt(rng.uniform(size=n))
    force = normal + mu[:, None] * _perpendicular(normal, rng)
    tangent = _perpendicular(normal, rng)
    if of.by_tip:
        tangent = np.cos(TILT) * tangent - np.sin(TILT) * normal
    beyond = np.zeros(n) if of.by_tip else rng.uniform(0.0, 0.06, n)
    lever = LEVER * rng.uniform(0.5, 1.0, n)
    B = np.concatenate([np.tile(BASE * np.eye(3), (n, 1, 1)), (STIFFNESS * lever[:, None] * tangent)[:, :, None]], 2)
    B = B.reshape(3 * n, 4)
    cov = (B @ B.T).reshape(n, 3, n, 3)
    for i, t in enumerate(tangent):
        cov[i, :, i] += ACROSS**2 * np.eye(3) + (ALONG**2 - ACROSS**2) * np.outer(t, t)
    error = np.linalg.cholesky(cov.reshape(3 * n, 3 * n)) @ rng.normal(size=3 * n)
    force = force / np.linalg.norm(force, axis=1, keepdims=True)
    labels = tuple(str(i) for i in range(first, first + n))
    seen = np.abs(beyond + ALONG * rng.normal(size=n))
    return TouchSet(p + error.reshape(n, 3), cov, force, tangent, seen, labels), of.points


def _perpendicular(normal: Array, rng: np.random.Generator) -> Array:
    """Return a random unit vector perpendicular to each normal, (n, 3)."""
    t = np.cross(normal, rng.normal(size=normal.shape))
    return np.asarray(t / np.linalg.norm(t, axis=1, keepdims=True))


def errors_of(shape: Shape, truth: Array) -> float:
    """Return the normalised squared error of a shape against exact places of the true one, (k, 3)."""
    free = list(KINDS[shape.kind].free)

    def moved(by: Array) -> Shape:
        return shape.moved(np.bincount(free, by, 6))

    exact = least_squares(lambda by: moved(by).distances(truth)[0].ravel() / MM, np.zeros(len(free))).x
    return float(exact @ np.linalg.solve(shape.cov[np.ix_(free, free)], exact))


def report(draws: int = 20) -> None:
    """Print the tables."""
    rng, rows = np.random.default_rng(1), list[Sequence[str]]()
    for kind in KINDS:
        right = inside = fitted = 0
        for _ in range(draws):
            touches, truth = draw_touches(object_of(kind, rng), 12, rng)
            shapes = ShapeFit(touches).shapes()
            right += [shape.kind for shape in shapes] == [kind]
            shape = ShapeFit(touches).best_of(kind, touches, rng, True)
            if shape is not None:
                fitted += 1
                inside += errors_of(shape, truth) <= statistics.max_chi2(len(KINDS[kind].free), 0.05)
        rows.append([kind, f"{right} of {draws}", f"{inside} of {fitted}"])
    print_table("Shapes from 12 touches", ["truth", "this kind, alone", "inside the 95 % region"], rows)
