"""Shapes, poses and the next best touch on meshes: kinds, coverage, a card house, and touches until a pose is known.

Touches are drawn on the surface of a mesh: the point, the outward normal, a force in the friction cone, the tangent of
a probe that can touch there, and errors of the point with the standard deviations of the located touches of the
rehearsed card house: along the probe, across it, common by stiffness and by the base. No rod is solved here.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from time import perf_counter

import numpy as np
import trimesh
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from benchmarks.timing import print_table
from benchmarks.touches import paper_models
from probedesign.core import statistics
from probedesign.core.frames import Array, pose
from probedesign.core.units import MILLINEWTON, MM
from probedesign.estimation.estimator import Estimator
from probedesign.mapping.known_object import KnownObject, ObjectPose, locate_object
from probedesign.mapping.next_touch import of_object, presses_of, reachable, suggest
from probedesign.mapping.shapes import KINDS, Shape, ShapeFit, TouchSet
from probedesign.simulation.scenes import CARD, card_house
from probedesign.simulation.simulated_run import base_rotation

FRICTION, FRICTION_SPREAD = 0.5, 0.2  #: Median μ and standard deviation of ln μ.
#: Standard deviations of a point along the probe and across it [m], relative of E, and of the base [m].
ALONG, ACROSS, STIFFNESS, BASE = 2.5e-3, 0.4e-3, 0.03, 0.083e-3
LEVER = 0.05  #: How far a contact shifts along the probe by the relative error of E [m].
PER_CARD = 5  #: Touches of each card.
FORCE, MOST = 4.0 * MILLINEWTON, 30  #: Firm force [N] of the touches of a known object, and the most of them.
GRAVITY = np.array([0.0, 0.0, -9.81])  #: In the world [m/s²].
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
    of: TouchedObject, n: int, rng: np.random.Generator, along: Array | None = None
) -> tuple[TouchSet, Array]:
    """Return touches of places of an object with their errors, and all its places without error, (k, 3).

    Random places by a probe of any direction, or the first ones by a probe about along a direction (3,).
    """
    chosen = rng.choice(len(of.points), n, replace=False) if along is None else np.arange(n)
    p, normal = of.points[chosen], of.normals[chosen]
    mu = FRICTION * np.exp(FRICTION_SPREAD * rng.normal(size=n)) * np.sqrt(rng.uniform(size=n))
    force = normal + mu[:, None] * _perpendicular(normal, rng)
    tangent = _perpendicular(normal, rng)
    if along is not None:
        tangent = along + 0.2 * rng.normal(size=(n, 3))
        tangent -= np.einsum("na,na->n", tangent, normal)[:, None] * normal
        tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
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
    labels = tuple(str(i) for i in range(1, n + 1))
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


def house_touches(by_tip: bool, rng: np.random.Generator) -> tuple[TouchSet, Array]:
    """Return five touches of the front edge, or of the face, of each card of the house, and the number of its card."""
    points, normals, cards = list[Array](), list[Array](), card_house()
    for card in cards:
        u, v = rng.uniform(0.05, 0.95, (2, PER_CARD, 1))
        depth = v * np.array([0.0, 0.8 * CARD[0], 0.0]) if by_tip else 0.0
        points.append(card.start + u * (card.end - card.start) + depth)
        side = card.normal * (1.0 if by_tip else np.where(np.arange(PER_CARD) % 2, 1.0, -1.0)[:, None])
        turned = side - (0.0 if by_tip else rng.uniform(0.0, 0.6, (PER_CARD, 1))) * np.array([0.0, 1.0, 0.0])
        normals.append(turned / np.linalg.norm(turned, axis=-1, keepdims=True) * np.ones((PER_CARD, 1)))
    n = PER_CARD * len(cards)
    order = TouchedObject(trimesh.Trimesh(), np.concatenate(points), np.concatenate(normals), by_tip)
    return draw_touches(order, n, rng, np.array([0.0, 1.0, 0.0]))[0], np.repeat(np.arange(len(cards)), PER_CARD)


def _house_row(by_tip: bool, houses: int) -> list[str]:
    """Return a row on the planes (touched by the tip) or the edges of the cards of some houses."""
    kind, rng, cards = "plane" if by_tip else "edge", np.random.default_rng(2), card_house()
    known = within = inside = invented = 0
    for _ in range(houses):
        touches, of_card = house_touches(by_tip, rng)
        seen = set[int]()
        for shape in ShapeFit(touches).shapes():
            numbers = {int(of_card[int(label) - 1]) for label in shape.touches}
            if shape.kind != kind or len(numbers) > 1:
                invented += 1
                continue
            (number,) = numbers - seen or {None}
            if number is None:
                continue
            seen.add(number)
            card = cards[number]
            truth = card.corners if by_tip else np.linspace(card.start, card.end, 4)
            off = np.linalg.norm(shape.distances(truth)[0], axis=1)
            axis = card.normal if by_tip else card.along
            angle = np.degrees(np.arccos(min(abs(float(axis @ shape.frame[:, 2])), 1.0)))
            within += off.max() <= 1.5 * MM and angle <= 2.0
            inside += errors_of(shape, truth) <= statistics.max_chi2(len(KINDS[kind].free), 0.05)
        known += len(seen)
    total = houses * len(cards)
    return [f"{kind}s", f"{known} of {total}", str(invented), f"{within} of {total}", f"{inside} of {known}"]


def touches_until(method: str, seed: int, estimator: Estimator) -> tuple[int, float]:
    """Return the touches until the pose of a box is within 2 mm and 2°, and the longest time of a suggestion [s]."""
    rng, mesh = np.random.default_rng(seed), trimesh.creation.box((0.09, 0.06, 0.04))
    of, longest = KnownObject.of(mesh), 0.0
    prior = ObjectPose.prior(pose(p=(0.0, 0.1, 0.05)), 10.0 * MM, np.radians(10.0))
    truth = prior.moved(np.sqrt(prior.cov.diagonal()) * rng.normal(size=6))
    Ts = np.array([pose(base_rotation(), p) for p in ((-0.05, -0.1, 0.0), (0.05, -0.12, 0.1))])
    presses, touches, now = presses_of(estimator, base_rotation().T @ GRAVITY, FORCE), list[Array](), prior
    for k in range(1, MOST + 1):
        start = perf_counter()
        if method == "suggested":
            best = suggest(estimator, Ts, GRAVITY, "pose", [], (of, now))
            longest = max(longest, perf_counter() - start)
            x, normal, cov = best.x, best.normal, best.cov
        else:
            candidates = list(of_object(of, now))
            order = rng.permutation(len(candidates)) if method == "random" else np.lexsort(
                np.round([c.x / (20.0 * MM) for c in candidates]).T)[(7 * k) % len(candidates) :]  # fmt: skip
            reached = (
                (candidates[i], press, T)
                for i in order
                for press, T in reachable(candidates[i], presses, base_rotation(), Ts, (of, now))
            )
            candidate, press, T = next(reached)
            x, normal, cov = candidate.x, candidate.normal, T[:3, :3] @ press.cov @ T[:3, :3].T
        # The probe moves along the normal until it meets the true object.
        q, m = truth.to_world(of.samples), of.normals[of.sample_faces] @ truth.T_world_object[:3, :3].T
        beside = np.linalg.norm(np.cross(q - x, normal), axis=1) + 1.0 * (m @ normal < 0.3)
        i = int(beside.argmin())
        if beside[i] < 4.0 * MM:
            met = x + normal * float((q[i] - x) @ m[i] / (normal @ m[i]))
            force = m[i] + FRICTION * np.sqrt(rng.uniform()) * _perpendicular(m[i][None], rng)[0]
            touches.append(np.concatenate([met + np.linalg.cholesky(cov) @ rng.normal(size=3),
                                           force / np.linalg.norm(force), cov.ravel()]))  # fmt: skip
            now = locate_object(_independent(np.array(touches)), of, prior)
        turn = Rotation.from_matrix(truth.T_world_object[:3, :3] @ now.T_world_object[:3, :3].T).magnitude()
        if np.linalg.norm((truth.T_world_object - now.T_world_object)[:3, 3]) < 2.0 * MM and np.degrees(turn) < 2.0:
            return k, longest
    return MOST, longest


def _independent(rows: Array) -> TouchSet:
    """Return touches with independent errors from rows of point, force and covariance, (n, 15)."""
    n = len(rows)
    cov = np.zeros((n, 3, n, 3))
    for i, row in enumerate(rows):
        cov[i, :, i] = row[6:].reshape(3, 3)
    none = np.full((n, 3), np.nan)
    return TouchSet(rows[:, :3], cov, rows[:, 3:6], none, none[:, 0], tuple(str(i + 1) for i in range(n)))


def report(draws: int = 100) -> None:
    """Print the tables; `draws` objects of each kind, a tenth of them as houses and as known objects."""
    rng, rows = np.random.default_rng(1), list[Sequence[str]]()
    for kind in KINDS:
        right = inside = fitted = 0
        for _ in range(draws):
            touches, truth = draw_touches(object_of(kind, rng), 12, rng)
            shapes = ShapeFit(touches).shapes()
            right += [shape.kind for shape in shapes] == [kind]
            shape = ShapeFit(touches).best_of(kind, touches, rng)
            if shape is not None:
                fitted += 1
                inside += errors_of(shape, truth) <= statistics.max_chi2(len(KINDS[kind].free), 0.05)
        rows.append([kind, f"{right} of {draws}", f"{inside} of {fitted}"])
    print_table("Shapes from 12 touches", ["truth", "this kind, alone", "inside the 95 % region"], rows)
    few = max(draws // 10, 1)
    print_table(f"Card house of seven cards, {PER_CARD} touches of each",
                ["shapes", "known", "of another kind or card", "within 1.5 mm and 2°", "inside the 95 % region"],
                [_house_row(by_tip, few) for by_tip in (False, True)])  # fmt: skip
    estimator, rows = Estimator(paper_models()["large"]), []
    for method in ("suggested", "raster", "random"):
        counts, times = zip(*(touches_until(method, seed, estimator) for seed in range(few)), strict=True)
        took = f"{max(times[1:], default=times[0]):.2f} s" if method == "suggested" else ""
        rows.append([method, f"{np.mean(counts):.1f}", f"{np.median(counts):.0f}", f"{max(counts)}", took])
    print_table(f"Touches until the pose of a box is within 2 mm and 2°, at most {MOST}, {few} boxes",
                ["choice", "mean", "median", "most", "longest suggestion"], rows)  # fmt: skip
