"""The next best touch: the one that is expected to reduce the variance of a goal most.

The parameters of the goal, the pose of a known object or a shape, have a covariance P. A touch at x measures the
distance of the surface along its normal n, with derivative J by the parameters and the variance nᵀ Σ n of its point,
where Σ is that of `LinearizedPresses` for a place on the probe, a direction and a force. To first order it leaves

    P' = P - P Jᵀ (J P Jᵀ + nᵀ Σ n)⁻¹ J P

and the goal's variance is the mean square displacement of its points. The extent of an edge or a plane is the width w
of an interval in which n touches with range R are uniform, with a log-uniform prior; a touch beyond an end is met with
the probability that w reaches so far, and so is one that improves another goal there.

The errors that are common to the next touch and the earlier ones count as independent, so a gain is rather too large
where these dominate. The probe is taken as straight beside a known object: its axis must stay outside.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.special import ndtr

from probedesign.core import statistics
from probedesign.core.errors import InputError
from probedesign.core.frames import Array, pose
from probedesign.core.units import MILLINEWTON, MM
from probedesign.estimation.estimator import Estimator
from probedesign.estimation.model import Tolerances
from probedesign.mapping.known_object import KnownObject, ObjectPose, by_pose
from probedesign.mapping.shapes import KINDS, Shape, by_parameters
from probedesign.prediction.fused import LinearizedPresses, PressSchedule
from probedesign.prediction.touches import SurfaceRod
from probedesign.rod.kernels.surface_contact import DEAD, POINT, VALUE

GOALS = ("shapes", "extent", "pose", "stiffness")
FRACTIONS = (0.6, 0.75, 0.9, 0.98)  #: Places on the probe, as fractions of its length; the last is its tip.
DIRECTIONS = 12  #: Number of directions around the probe in which it is pressed.
N_PRESSES = 3  #: Light and firm presses of a touch, as docs/exploring.md states.
LIGHT = 0.3  #: Light force over the firm one.
#: Largest yielding of an object under the firm press [m], if it is as soft as two standard deviations of its prior;
#: assumed: a card of a house stands 2 mm of it.
MAX_YIELD = 2.0 * MM
#: Turns of the base from its mean orientation about the vertical and about the horizontal across it [deg].
YAWS, PITCHES = (-60.0, -30.0, 0.0, 30.0, 60.0), (-30.0, 0.0, 30.0)
MIN_ALIGNED = 0.75  #: Least cosine between the object's normal and the direction in which the probe is pressed.
MIN_LEAN = 0.15  #: Least sine of the angle between a straight probe and a face that its tip touches.
REACH = 0.1  #: Distance beyond the poses of the run that the base may take [m]; assumed.
CLEAR = 0.5 * MM  #: How far the axis of the probe may lie within an object before it counts as a collision [m].
BEYOND = (0.0, 3.0, 6.0, 10.0, 15.0, 25.0)  #: Distances of candidates beyond the touched part of a shape [mm].
SAME_FACE = math.cos(math.radians(30.0))  #: Least cosine of the normals of one side of a known object; assumed.
N_PLACES = 80  #: Number of candidates on a known object.
NEAR_CONTACT = 10.0 * MM  #: Length of the probe before its contact that may lie at the touched shape; assumed.
FLOOR_MARGIN = 5.0 * MM  #: How far the probe may go below its lowest point in the run; assumed.
MIN_GAIN = 0.01  #: Least reduction of the standard deviation that is a gain.


class Press(NamedTuple):
    """A touch by the model of the probe, in base axes."""

    s: float  #: arclength [m].
    direction: Array  #: of the force on the probe, (3,).
    tangent: Array  #: of the free probe there, (3,).
    contact: Array  #: touched point of the free probe [m], (3,).
    light: Array  #: how far the touched point moves under the light press [m], (3,).
    firm: Array  #: the same of the firm one [m], (3,).
    cov: Array  #: covariance of the located point [m²], (3, 3).
    on_compliance: float  #: information of the touch on the compliance of the object [N²/m²].


class PlaceToTouch(NamedTuple):
    """A place to touch."""

    x: Array  #: the place in the world [m], (3,).
    normal: Array  #: outward normal there, the direction of the force on the probe, (3,).
    J: Array  #: derivative of the measured distances by the parameters of the goal, (k, d).
    N: Array  #: their directions, (k, 3).
    by_tip: bool  #: whether a straight probe touches it with its tip.
    hit: float = 1.0  #: probability that the object is there.


@dataclass(frozen=True)
class Suggestion:
    """The next touch."""

    goal: str  #: what it improves.
    before: float  #: standard deviation of the goal, in `unit`.
    after: float  #: expected after the touch.
    x: Array  #: the place to touch in the world [m], (3,).
    normal: Array  #: outward normal there; the base moves against it, (3,).
    s: float  #: arclength of the contact on the probe [m].
    force: float  #: firm force [N].
    Ts_world_base: Array  #: poses of the base at first contact, at the light and at the firm press, (3, 4, 4).
    cov: Array  #: expected covariance of the located point in the world [m²], (3, 3).
    axis_world: Array  #: axis of the free probe at first contact, from base to tip [m], (k, 3).
    probe: str = ""  #: name of the probe.
    unit: str = "mm"  #: of the goal.

    @property
    def error(self) -> float:
        """Return the expected RMS error of the located point [m]."""
        return statistics.rms(self.cov)

    @property
    def depth(self) -> float:
        """Return the travel from first contact to the firm press [m]."""
        return float(np.linalg.norm(self.Ts_world_base[2, :3, 3] - self.Ts_world_base[0, :3, 3]))

    @property
    def lines(self) -> list[str]:
        """Return what to do and why."""
        base, q = self.Ts_world_base[0, :3, 3] / MM, Rotation.from_matrix(self.Ts_world_base[0, :3, :3]).as_quat()
        return [
            f"next touch{f' by {self.probe}' if self.probe else ''}: ({_numbers(self.x / MM)}) mm, normal "
            f"({_numbers(self.normal, 3)}), at {self.s / MM:.0f} mm of the probe, "
            f"up to {self.force / MILLINEWTON:.1f} mN",
            f"  base at first contact ({_numbers(base)}) mm, quaternion ({_numbers(q, 4)}), "
            f"{self.depth / MM:.2f} mm further for the firm press",
            f"  why: {self.goal} ± {self.before:.2g} {self.unit} becomes ± {self.after:.2g} {self.unit}; "
            f"the point is expected to ± {self.error / MM:.2g} mm",
        ]  # fmt: skip

    @property
    def document(self) -> dict[str, Any]:
        """Return the suggestion for a JSON document."""
        return {
            "goal": self.goal, f"std_{(unit := self.unit.replace('/', '_'))}": self.before,
            f"expected_std_{unit}": self.after,
            "p_world_mm": (self.x / MM).tolist(), "normal_world": self.normal.tolist(), "s_mm": self.s / MM,
            "force_mN": self.force / MILLINEWTON, "depth_mm": self.depth / MM, "expected_error_mm": self.error / MM,
            "T_world_base": {name: T.tolist() for name, T in zip(("contact", "light", "firm"), self.Ts_world_base,
                                                                 strict=True)},
            "probe": self.probe,
        }  # fmt: skip


def _numbers(values: Array, digits: int = 2) -> str:
    return ", ".join(f"{value:z.{digits}f}" for value in values)


def firm_force(limit: float, priors: Tolerances) -> float:
    """Return the firm force of a touch [N]: the limit, or less if an object of the prior yields too far."""
    return min(limit, MAX_YIELD / max(2.0 * priors.object_compliance, 1e-9))


def presses_of(estimator: Estimator, gravity_base: Array, force: float) -> list[Press]:
    """Return the presses of a probe at each place and direction with the covariance of the point, in base axes."""
    model, presses = estimator.model, list[Press]()
    free = estimator.free(gravity_base)
    on = SurfaceRod(model.rod, gravity_base, model.mass, free)
    for s in model.rod.length * np.array(FRACTIONS):
        for angle in 2.0 * math.pi * np.arange(DIRECTIONS) / DIRECTIONS:
            press = on.begin_press(s, angle)
            if press.lin is None:
                continue
            start = press.lin[POINT : POINT + 3, VALUE].copy()
            light = press.increase_to(LIGHT * force)
            if light is None or press.lin is None:
                continue
            by_light = press.lin[POINT : POINT + 3, VALUE] - start
            firm = press.increase_to(force)
            if firm is None or press.lin is None:
                continue
            by_firm = press.lin[POINT : POINT + 3, VALUE] - start
            touches, schedule = np.array([light, firm] * N_PRESSES), PressSchedule(2 * N_PRESSES)
            fused = LinearizedPresses(model, estimator.priors, gravity_base, touches, schedule)
            if fused.converged:
                direction = light[DEAD : DEAD + 3] / np.linalg.norm(light[DEAD : DEAD + 3])
                tangent = free.R_at(min(s, model.rod.length))[:, 2]
                cov, prior = fused.cov(), float(fused.state.compliance[2])
                known = 1.0 / max(float(fused.state.cov[3, 3]), 1e-12) - 1.0
                presses.append(Press(float(s), direction, tangent, start, by_light, by_firm, cov,
                                     known / prior**2 if prior > 0.0 else 0.0))  # fmt: skip
    return presses


def of_shape(shape: Shape) -> Iterator[PlaceToTouch]:
    """Yield the places on a shape and beyond its touched part."""
    free = list(KINDS[shape.kind].free)
    if shape.kind in ("plane", "edge"):
        ranges = [np.unique(np.concatenate([[a - d * MM, b + d * MM] for d in BEYOND] + [[0.5 * (a + b)]]))
                  for a, b in shape.extent]  # fmt: skip
        axes = shape.frame[:, :2] if shape.kind == "plane" else shape.frame[:, 2:]
        x = shape.p + np.stack([grid.ravel() for grid in np.meshgrid(*ranges)], axis=1) @ axes.T
    elif shape.kind in ("sphere", "cylinder"):
        x = shape.p + shape.radius * _sides(shape)
    else:
        x = shape.p[None]
    J, N = by_parameters(shape, x)[:, :, free], shape.distances(x)[1]
    for i, at in enumerate(x):
        if shape.kind in ("plane", "sphere", "cylinder"):
            yield PlaceToTouch(at, N[i, 0], J[i], N[i], shape.kind == "plane", _hit(shape, at))
        else:
            for side in _sides(shape):
                yield PlaceToTouch(at, side, J[i], N[i], False, _hit(shape, at))


def _hit(shape: Shape, x: Array) -> float:
    """Return the probability that a plane or an edge reaches a place, as far beyond its touches at either end."""
    if shape.kind not in ("plane", "edge"):
        return 1.0
    each = zip(_extent_std(shape)[1], _beyond(shape, x), strict=True)
    return math.prod(_excess(len(shape.touches), range_, far)[0] for range_, far in each if far > 0.0)


def _beyond(shape: Shape, x: Array) -> list[float]:
    """Return by how much a plane or an edge is wider than its touches if it reaches a place and as far at the other
    end [m], (k,)."""
    place, (low, high) = shape.places(x[None])[0], shape.extent.T
    return [float(far) for far in 2.0 * np.maximum(low - place, place - high)]


def _sides(shape: Shape) -> Array:
    """Return two directions from which a shape was touched, across an edge or an axis, the most different, (2, 3)."""
    f = shape.forces
    if shape.kind in ("edge", "cylinder"):
        f = f - np.outer(f @ shape.frame[:, 2], shape.frame[:, 2])
    f = f / np.linalg.norm(f, axis=1, keepdims=True)
    return np.asarray(f[list(divmod(int((f @ f.T).argmin()), len(f)))])


def of_object(known: KnownObject, at: ObjectPose) -> Iterator[PlaceToTouch]:
    """Yield places on a known object, evenly spread.

    A place is hit unless the pose is off by more than its distance from the nearest surface of another direction.
    """
    chosen = np.linspace(0, len(known.samples) - 1, N_PLACES).astype(int)
    p, of_samples = known.samples[chosen], known.normals[known.sample_faces]
    x, normals = at.to_world(p), of_samples[chosen] @ at.T_world_object[:3, :3].T
    J = by_pose(at, x, normals)
    for i in range(len(x)):
        other = of_samples @ of_samples[chosen[i]] < SAME_FACE
        room = float(np.linalg.norm(known.samples[other] - p[i], axis=1).min(initial=math.inf))
        axes = np.linalg.svd(normals[i : i + 1])[2][1:]
        aside = by_pose(at, np.tile(x[i], (2, 1)), axes)
        std = math.sqrt(float(np.linalg.eigvalsh(aside @ at.cov @ aside.T)[-1]))
        yield PlaceToTouch(x[i], normals[i], J[i : i + 1], normals[i : i + 1], True, float(ndtr(room / std)))


def suggest(
    estimator: Estimator,
    Ts_world_base: Array,
    gravity_world: Array,
    goal: str,
    shapes: Sequence[Shape],
    known: tuple[KnownObject, ObjectPose] | None = None,
    force_limit: float = 4.0 * MILLINEWTON,
    std_compliance: float = math.nan,
) -> Suggestion:
    """Return the touch with the largest expected reduction of the goal's variance.

    Args:
        estimator: of the probe.
        Ts_world_base: poses of the base in the run, (k, 4, 4).
        gravity_world: gravity in the world [m/s²], (3,).
        goal: one of `GOALS`: the shape that is known worst, its extent, the pose of the known object, or the compliance
            of the one object of all touches, on any of its shapes or on the known object.
        shapes: of the map.
        known: a known object and its pose so far; for the goal "pose".
        force_limit: largest force on the object [N].
        std_compliance: standard deviation of the compliance by all touches [m/N]; for the goal "stiffness".

    Raises:
        InputError: there is nothing to improve, or no reachable touch improves it.
    """
    R0 = Rotation.from_matrix(Ts_world_base[:, :3, :3]).mean().as_matrix()
    force = firm_force(force_limit, estimator.priors)
    presses = presses_of(estimator, R0.T @ gravity_world, force)
    probe, up = estimator.free(R0.T @ gravity_world), -gravity_world / np.linalg.norm(gravity_world)
    arclengths = np.linspace(0.0, estimator.model.rod.length, 57)
    axis = np.array([probe.p_at(s) for s in arclengths])
    radii = np.array([float(estimator.model.rod.radius_at(s)) for s in arclengths])
    heights = (Ts_world_base[:, :3, 3] @ up)[:, None] + (up @ Ts_world_base[:, :3, :3]) @ axis.T
    floor = float(heights.min()) - FLOOR_MARGIN
    sought = (_stiffness(shapes, known, presses, std_compliance) if goal == "stiffness"
              else _pose_or_shape(goal, shapes, known))  # fmt: skip
    name, before, candidates, gains = sought.name, sought.before, sought.candidates, sought.gains
    best: tuple[float, PlaceToTouch, Press, Array] | None = None
    for i in np.argsort(gains)[::-1]:
        if best is not None and gains[i] <= best[0]:
            break  # without any error of the touch it would reduce the variance by less
        for press, T in reachable(candidates[i], presses, R0, Ts_world_base, known):
            Sigma = T[:3, :3] @ press.cov @ T[:3, :3].T
            gain = gains[i]
            if goal == "stiffness":
                gain = candidates[i].hit * (before**2 - 1.0 / (1.0 / before**2 + press.on_compliance))
            elif goal != "extent":
                gain = candidates[i].hit * (before**2 - _left(sought.P, sought.A, candidates[i], Sigma))
            gain -= 1e-6 * float(np.trace(Sigma))  # among equal ones the most accurate
            if best is None or gain > best[0]:
                at = axis @ T[:3, :3].T + T[:3, 3]
                before_contact = arclengths < press.s - NEAR_CONTACT
                if (at @ up).min() > floor and not any(
                    _crosses(each, at[before_contact], radii[before_contact]) for each in shapes
                ):
                    best = gain, candidates[i], press, T
    if best is None or best[0] < (1.0 - (1.0 - MIN_GAIN) ** 2) * before**2:
        raise InputError(f"no touch that the base reaches improves the {name} by more than {100 * MIN_GAIN:g} %")
    gain, candidate, press, T = best
    Ts = np.array([pose(T[:3, :3], T[:3, 3] - T[:3, :3] @ by) for by in (np.zeros(3), press.light, press.firm)])
    after, cov = math.sqrt(max(before**2 - gain, 0.0)), T[:3, :3] @ press.cov @ T[:3, :3].T
    unit, scale = ("m/N", 1.0) if goal == "stiffness" else ("mm", MM)
    return Suggestion(name, before / scale, after / scale, candidate.x, candidate.normal, press.s, force, Ts, cov,
                      axis[::4] @ T[:3, :3].T + T[:3, 3], unit=unit)  # fmt: skip


def _crosses(shape: Shape, axis: Array, radii: Array) -> bool:
    """Return whether an axis with points (k, 3) [m] and radii (k,) crosses the touched part of a plane or an edge."""
    if shape.kind not in ("plane", "edge") or not len(axis):
        return False
    low, high = shape.extent.T
    x = (axis - shape.p) @ shape.frame
    if shape.kind == "plane":
        (i,) = np.nonzero((x[:-1, 2] > 0.0) != (x[1:, 2] > 0.0))
        share = (x[i, 2] / (x[i, 2] - x[i + 1, 2]))[:, None]
        at = (x[i] + share * (x[i + 1] - x[i]))[:, :2]
        return bool(((at >= low) & (at <= high)).all(axis=1).any())
    beside = (x[:, 2] >= low[0]) & (x[:, 2] <= high[0])
    return bool((beside & (np.linalg.norm(x[:, :2], axis=1) < radii)).any())


class _Sought(NamedTuple):
    """What a touch is to improve."""

    name: str
    before: float  #: standard deviation of the goal.
    candidates: list[PlaceToTouch]
    gains: list[float]  #: largest reduction of its square by each candidate.
    P: Array = np.zeros((0, 0))  #: covariance of the parameters of a shape or a pose.
    A: Array = np.zeros((0, 0))  #: derivative of the goal by them.


def _stiffness(
    shapes: Sequence[Shape], known: tuple[KnownObject, ObjectPose] | None, presses: Sequence[Press], std: float
) -> _Sought:
    """Return the compliance of one object, with its standard deviation [m/N]; the presses tell its places apart."""
    if not std > 0.0:
        raise InputError("--goal stiffness needs --one-object and a design that states how far objects yield")
    places = list(of_object(*known)) if known is not None else [place for shape in shapes for place in of_shape(shape)]
    most = std**2 - 1.0 / (1.0 / std**2 + max((press.on_compliance for press in presses), default=0.0))
    return _Sought("compliance of the object", std, places, [each.hit * (1.0 - MIN_GAIN) * most for each in places])


def _pose_or_shape(goal: str, shapes: Sequence[Shape], known: tuple[KnownObject, ObjectPose] | None) -> _Sought:
    """Return the pose of the known object, the shape that is known worst, or the widest extent."""
    if goal == "pose":
        if known is None:
            raise InputError("--goal pose needs the object: --object MESH with --object-at")
        P, A = known[1].cov, np.diag([1.0] * 3 + [known[0].gyration] * 3)
        candidates, name = list(of_object(*known)), "pose of the object"
    else:
        wide = [shape for shape in shapes if goal == "shapes" or shape.kind in ("plane", "edge")]
        if not wide:
            raise InputError(f"--goal {goal}: no shape is known yet; touch one object at three or more places first")
        shape = max(wide, key=lambda each: _extent_std(each)[0] if goal == "extent" else each.rms)
        free = list(KINDS[shape.kind].free)
        P, A = shape.cov[np.ix_(free, free)], by_parameters(shape, shape.ends)[:, :, free].reshape(-1, len(free))
        A = A / math.sqrt(len(shape.ends))
        candidates, name = list(of_shape(shape)), f"{shape.kind} of touches {' '.join(shape.touches)}"
        if goal == "extent":
            gains = [_extent_gain(shape, candidate.x) for candidate in candidates]
            return _Sought(f"extent of the {name}", _extent_std(shape)[0], candidates, gains)
    before = math.sqrt(float(np.trace(A @ P @ A.T)))
    gains = [each.hit * (before**2 - _left(P, A, each)) for each in candidates]
    return _Sought(name, before, candidates, gains, P, A)


def _left(P: Array, A: Array, candidate: PlaceToTouch, Sigma: Array | None = None) -> float:
    """Return the variance of the goal after a touch with the covariance of its point [m²]; exact if None."""
    J, N = candidate.J, candidate.N
    S = J @ P @ J.T + (1e-12 * np.eye(len(J)) if Sigma is None else N @ Sigma @ N.T)
    K = P @ J.T @ np.linalg.pinv(S)
    return float(np.trace(A @ (P - K @ J @ P) @ A.T))


def reachable(
    candidate: PlaceToTouch,
    presses: Sequence[Press],
    R0: Array,
    Ts: Array,
    known: tuple[KnownObject, ObjectPose] | None,
) -> Iterator[tuple[Press, Array]]:
    """Yield the presses that touch a place, with the pose of the base at first contact, without collision."""
    low, high = Ts[:, :3, 3].min(axis=0) - REACH, Ts[:, :3, 3].max(axis=0) + REACH
    across = np.cross([0.0, 0.0, 1.0], R0[:, 2])
    across = across / np.linalg.norm(across) if np.linalg.norm(across) > 1e-3 else np.array([1.0, 0.0, 0.0])
    for yaw in YAWS:
        for pitch in PITCHES:
            turn = Rotation.from_rotvec([[0.0, 0.0, math.radians(yaw)], math.radians(pitch) * across]).as_matrix()
            R = turn[0] @ turn[1] @ R0
            n = R.T @ candidate.normal
            for press in presses:
                tip, lean = press.s >= FRACTIONS[-1] / FRACTIONS[0] * presses[0].s - 1e-9, -float(press.tangent @ n)
                if press.direction @ n < MIN_ALIGNED or (candidate.by_tip and not (tip and lean > MIN_LEAN)):
                    continue
                T = pose(R, candidate.x - R @ press.contact)
                if (T[:3, 3] < low).any() or (T[:3, 3] > high).any():
                    continue
                if known is not None and known[0].contains_any(known[1].to_object(
                    candidate.x + CLEAR * candidate.normal
                    - np.outer(np.linspace(0.01, press.s, 12), R @ press.tangent)), CLEAR):  # fmt: skip
                    continue
                yield press, T


def _extent_std(shape: Shape) -> tuple[float, Array]:
    """Return the largest standard deviation of a width [m], and the range of the touches in each direction, (k,)."""
    ranges = np.maximum(np.ptp(shape.extent, axis=1), 2.0 * MM)
    return max((math.sqrt(_excess(len(shape.touches), r)[1]) for r in ranges), default=0.0), ranges


def _excess(n: int, range_: float, above: float = 0.0, below: float = 0.5) -> tuple[float, float]:
    """Return the probability that the width exceeds the range by `above` to `below` [m], and its variance then [m²]."""
    w = np.linspace(range_, range_ + 0.5, 4001)[1:]
    density = w ** (-n - 1.0) * (w - range_)
    inside = (w - range_ >= above) & (w - range_ <= below)
    weight = density[inside]
    if not weight.sum() > 0.0:
        return 0.0, 0.0
    mean = float((weight * w[inside]).sum() / weight.sum())
    return float(weight.sum() / density.sum()), float((weight * (w[inside] - mean) ** 2).sum() / weight.sum())


def _extent_gain(shape: Shape, x: Array) -> float:
    """Return the expected reduction of the variance of the width by a touch at a place that is met or missed [m²].

    The excess lies beyond either end with equal probability.
    """
    largest, n = 0.0, len(shape.touches)
    for beyond, range_ in zip(_beyond(shape, x), _extent_std(shape)[1], strict=True):
        if beyond > 0.0:
            variance = _excess(n, range_)[1]
            (hit, if_hit), (miss, if_missed) = _excess(n, range_, beyond), _excess(n, range_, 0.0, beyond)
            largest = max(largest, 0.5 * (variance - hit * if_hit - miss * if_missed))
    return largest
