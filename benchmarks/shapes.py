"""Shapes, poses and the next best touch on meshes: kinds, coverage, a card house, and touches until a pose is known.

The card house is touched by `simulated_map`: a probe with all its errors, solved by the reference rod, and located by
the estimator. For the other tables, touches are drawn on the surface of a mesh: the point, the outward normal, a force
in the friction cone, the tangent of a probe that can touch there, and errors of the point with assumed standard
deviations: along the probe, across it, common by stiffness and by the base. No rod is solved there.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np
import trimesh
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from benchmarks.simulated_map import FORCE, GRAVITY, Place, SimulatedMap, towards
from benchmarks.timing import print_table
from benchmarks.touches import paper_models
from probedesign.core import statistics
from probedesign.core.frames import Array, pose
from probedesign.core.units import MM
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
PROBE = 150.0 * MM, 6.0 * MM, 1.0 * MM  #: Length and radii of the large probe [m].
SIDE, TIP = 0.93, 0.99  #: Places on the probe that touch an edge and a face, as fractions of its length.
LEAN = np.radians(12.0)  #: Angle of the probe to a face that its tip touches [rad].
WEIGHT = 9.81 * 0.31 * CARD[0] * CARD[1]  #: Of a card of 310 g/m² [N]; assumed.
ROOF = 4  #: Number of the card across both tents.
CLEAR = 1.5 * MM  #: Least distance of the probe from other cards [m].
MOST = 30  #: Largest number of touches of a known object.
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


def draw_touches(of: TouchedObject, n: int, rng: np.random.Generator) -> tuple[TouchSet, Array]:
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
    exact = least_squares(lambda by: shape.moved(by).distances(truth)[0].ravel() / MM, np.zeros(len(free))).x
    return float(exact @ np.linalg.solve(shape.cov[np.ix_(free, free)], exact))


def _clearance(x: Array, R: Array, fraction: float, touched: int) -> float:
    """Return the distance of a straight probe that touches at a point from the other cards and the table [m].

    The touched card may be near the contact only.
    """
    s = (np.linspace(0.0, 1.0, 60) - fraction) * PROBE[0]
    axis, radius = x + s[:, None] * R[:, 2], np.interp(s / PROBE[0] + fraction, [0.0, 1.0], PROBE[1:])
    least = (axis[:, 2] - radius).min() + 1.0 * MM
    for k, card in enumerate(card_house()):
        d = axis - card.start
        along, deep = np.clip(d @ card.along, 0.0, CARD[1]), np.clip(d[:, 1], 0.0, CARD[0])
        far = np.linalg.norm(d - along[:, None] * card.along - deep[:, None] * np.array([0.0, 1.0, 0.0]), axis=1)
        away = np.abs(s) > (8.0 * MM if k == touched else 0.0)
        least = min(least, (far - radius)[away].min())
    return float(least)


def _at_edge(k: int, u: float, compliance: float) -> list[tuple[float, Place]]:
    """Return touches of the front edge of a card at a fraction of its length, with their clearances [m].

    Their directions are up to 60° about the edge; the card lies behind its edge.
    """
    card, options = card_house()[k], list[tuple[float, Place]]()
    x = card.start + u * (card.end - card.start)
    for turn in np.radians(np.arange(-60.0, 61.0, 15.0)):
        t = Rotation.from_rotvec(turn * card.along).apply(np.array([0.0, 1.0, 0.0]))
        for normal in (np.cross(card.along, t), np.cross(t, card.along)):
            if normal[1] < 0.05:
                R = towards(normal, t)
                clearance = _clearance(x + 1.3 * MM * normal, R, SIDE, k)
                options.append((clearance, Place(x, normal, R, SIDE, compliance)))
    return options


def house_places(rng: np.random.Generator, compliance: Array) -> tuple[list[Place], list[int]]:
    """Return 40 touches of the house, and the number of the card of each.

    The front edge of a card is touched at three or four places, in turn from the two most different directions about
    the edge of which the probe is clear of all cards. Two touches of its face, one near the front edge and one far
    from it, are made by the tip. Every second touch has the base turned by half a turn about its axis.
    """
    places, of_card, y = list[Place](), list[int](), np.array([0.0, 1.0, 0.0])

    def add(k: int, options: list[tuple[float, Place]], which: int) -> bool:
        clear = [place for clearance, place in options if clearance > CLEAR]
        if clear:
            place = clear[which]
            half = np.diag([-1.0, -1.0, 1.0]) if len(places) % 2 else np.eye(3)
            places.append(replace(place, R=place.R @ half))
            of_card.append(k)
        return bool(clear)

    for k, card in enumerate(card_house()):
        count, first = 4 if k < 5 else 3, int(rng.integers(2))
        for j in range(count):
            options = list[tuple[float, Place]]()
            while sum(clearance > CLEAR for clearance, _ in options) < 2:
                options = _at_edge(k, 0.08 + 0.77 * (j + rng.uniform()) / count, float(compliance[k]))
            add(k, options, -((first + j) % 2))
        for j in range(2):
            done = False
            while not done:
                u, v = 0.15 + 0.3 * (j + rng.uniform()), (0.3, 0.85)[(j + k) % 2] + rng.uniform(-0.05, 0.05)
                x = card.start + u * (card.end - card.start) + v * CARD[0] * y
                options = []
                for normal in (card.normal, -card.normal):
                    for turn in np.radians((-40.0, -20.0, 0.0, 20.0, 40.0)):
                        R = towards(normal, Rotation.from_rotvec(turn * normal).apply(y), LEAN)
                        clearance = _clearance(x + 1.2 * MM * normal, R, TIP, k)
                        options.append((clearance, Place(x, normal, R, TIP, compliance[k])))
                done = add(k, sorted(options, key=lambda option: option[0]), -1)
    return places, of_card


def lifts(place: Place, k: int) -> bool:
    """Return whether a press at a place lifts a card of a tent off the ridge, about its foot.

    Against it act the weight of the card and, at the ridge of a lower tent, its share of the roof and the upper tent:
    three cards on four.
    """
    card = card_house()[k]
    sine = abs(card.along[0])
    out = card.normal if card.normal[2] > 0.0 else -card.normal
    moment = -FORCE * float(place.normal @ out) * abs(float((place.x - card.start) @ card.along))
    return k != ROOF and moment > WEIGHT * CARD[1] * sine * (0.5 + 0.75 * (k < ROOF))


def house_rows(houses: int) -> list[list[str]]:
    """Return a row on the front edges and one on the planes of the cards of some houses, each by a drawn probe."""
    cards = card_house()
    counts = {kind: np.zeros(4, dtype=int) for kind in ("edge", "plane")}
    stated: dict[str, list[float]] = {kind: [] for kind in counts}
    lost = toppled = 0
    for seed in range(300, 300 + houses):  # the plan of touches and the fit were developed on lower ones
        simulated = SimulatedMap(seed)
        compliance = np.array([simulated.compliance() for _ in cards])
        places, of_card = house_places(simulated.rng, compliance)
        simulated.touch(places)
        touches = TouchSet.of(simulated.map)
        lost += len(places) - len(touches)
        toppled += sum(lifts(place, k) for place, k in zip(places, of_card, strict=True))
        seen = set[tuple[str, int]]()
        for shape in ShapeFit(touches).shapes():
            numbers = {of_card[int(label) - 1] for label in shape.touches}
            k = numbers.pop()
            if shape.kind not in counts or numbers or (shape.kind, k) in seen:
                counts[shape.kind if shape.kind in counts else "edge"][1] += 1
                continue
            seen.add((shape.kind, k))
            stated[shape.kind].append(shape.rms / MM)
            card, plane = cards[k], shape.kind == "plane"
            truth = card.corners if plane else np.linspace(card.start, card.end, 4)
            off = np.linalg.norm(shape.distances(truth)[0], axis=1).max()
            axis = card.normal if plane else card.along
            angle = np.degrees(np.arccos(min(abs(float(axis @ shape.frame[:, 2])), 1.0)))
            holds = errors_of(shape, truth) <= statistics.max_chi2(len(KINDS[shape.kind].free), 0.05)
            counts[shape.kind] += [1, 0, off <= 1.5 * MM and angle <= 2.0, holds]
    total = houses * len(cards)
    print(f"{lost} of {40 * houses} touches are not located; {toppled} lift a card off its ridge")
    return [[f"{kind}s", f"{n[0]} of {total}", str(n[1]), f"{n[2]} of {total}", f"{n[3]} of {n[0]}",
             f"{np.median(stated[kind] or [np.nan]):.2f}"]
            for kind, n in counts.items()]  # fmt: skip


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


def report(draws: int = 100, scenes: int = 10) -> None:
    """Print the tables of `draws` objects of each kind, `scenes` card houses and `scenes` known objects."""
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
    print_table(f"Card house of seven cards, 40 touches of up to {1e3 * FORCE:g} mN, {scenes} houses",
                ["shapes", "known", "of another kind or card", "within 1.5 mm and 2°", "inside the 95 % region",
                 "median of the stated ± [mm]"], house_rows(scenes))  # fmt: skip
    estimator, rows = Estimator(paper_models()["large"]), []
    for method in ("suggested", "raster", "random"):
        counts, times = zip(*(touches_until(method, seed, estimator) for seed in range(scenes)), strict=True)
        took = f"{max(times[1:], default=times[0]):.2f} s" if method == "suggested" else ""
        rows.append([method, f"{np.mean(counts):.1f}", f"{np.median(counts):.0f}", f"{max(counts)}", took])
    print_table(f"Touches until the pose of a box is within 2 mm and 2°, at most {MOST}, {scenes} boxes",
                ["choice", "mean", "median", "most", "longest suggestion"], rows)  # fmt: skip
