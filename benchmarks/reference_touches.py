"""Touches of perturbed probes, solved by the reference rod, and the Cramér–Rao bounds of the touched point.

The bounds are computed from derivatives by finite differences of the reference rod, without `probedesign.estimation`
and `probedesign.prediction`.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.reference_probes import ProbeSamples
from probedesign.core.frames import Array
from probedesign.core.units import MM
from tests.reference.cosserat import Touches, differences, press, solve
from tests.reference.round_rods import Probes

COLUMN_STEP = 0.05  #: Step of the finite differences by the perturbations [standard deviations].
#: Largest tangential over normal force of a sticking touch; presses beyond it are left out. Assumed.
MAX_STICKING_RATIO = 1.0
SAME_POINT_STD = 1e-6  #: Standard deviation of the constraint that all touches are at one point [m].


@dataclass(frozen=True)
class Readings:
    """One touch of each of n probe samples."""

    touches: Touches  #: solved touches, in the axes of the true bases.
    wrench: Array  #: reading without noise, about the model's base, (n, 6).
    point: Array  #: touched point of the surface in the model's base frame [m], (n, 3).
    #: J, P: derivatives of reading and point by (s, φ, normal, circumferential, axial force), (n, 6, 5), (n, 3, 5).
    J: Array
    P: Array
    D: Array  #: D, Q: derivatives of reading and point by each perturbation, (n, 6, j), (n, 3, j).
    Q: Array


def evaluate_readings(
    samples: ProbeSamples, z: Array, touches: Touches, free: Array, k: int = 0, columns: bool = True
) -> Readings:
    """Return the readings of solved touches and, if `columns` is set, their derivatives.

    Args:
        samples: n probe samples.
        z: their perturbations, (n, size).
        touches: solved touches of the samples.
        free: base wrenches without contact in the axes of the true bases, (n, 6).
        k: index of the touch.
        columns: whether to compute the derivatives.
    """
    n, bare = len(z), samples.perturbations.nominal_free
    wrench = samples.reading(touches.wrench, free, k, bare)
    point = samples.point_in_nominal_frame(touches.p_surface)
    if not columns:
        none = np.zeros((n, 0, 0))
        return Readings(touches, wrench, point, none, none, none, none)
    probes, force = samples.at_touch(k), touches.surface_force
    size = np.linalg.norm(np.nan_to_num(force, nan=1.0), axis=1)
    steps = [1e-4 * samples.probes.length, np.full(n, 1e-4), *(1e-3 * size,) * 3]
    variants = [(probes, samples.gravity, touches.s + steps[0], touches.phi, force),
                (probes, samples.gravity, touches.s, touches.phi + steps[1], force)]  # fmt: skip
    variants += [(probes, samples.gravity, touches.s, touches.phi, force + steps[2 + i][:, None] * e)
                 for i, e in enumerate(np.eye(3))]  # fmt: skip
    dw, dp = differences(probes, samples.gravity, touches, variants)
    over = np.stack(steps, axis=1)[:, None, :]
    J = np.stack([samples.reading(touches.wrench + dw[:, :, i], free, k, bare) - wrench for i in range(5)], axis=2)
    P = np.stack([samples.point_in_nominal_frame(touches.p_surface + dp[:, :, i]) - point for i in range(5)], axis=2)
    D, Q = _error_columns(samples, z, touches, free, k, wrench, point, bare)
    return Readings(touches, wrench, point, J / over, P / over, D, Q)


def _error_columns(samples: ProbeSamples, z: Array, touches: Touches, free: Array, k: int, wrench: Array,
                   point: Array, bare: Array) -> tuple[Array, Array]:  # fmt: skip
    """Return the derivatives of reading and point by the perturbations, which change both touch and tare."""
    perturbations, n = samples.perturbations, len(z)
    D, Q = np.zeros((n, 6, perturbations.size)), np.zeros((n, 3, perturbations.size))
    if not perturbations.size:
        return D, Q
    force, none, zero = touches.surface_force, np.zeros(n), np.zeros((n, 3))
    shape_columns = perturbations.affecting_shape(k)
    stepped = {j: perturbations.samples(z + COLUMN_STEP * np.eye(perturbations.size)[j])
               for j in perturbations.affecting_reading(k)}  # fmt: skip
    rods = [stepped[j] for j in shape_columns]
    dw, dp = differences(samples.at_touch(k), samples.gravity, touches, [
        (one.at_touch(k), one.gravity, touches.s * one.probes.length / samples.probes.length, touches.phi, force)
        for one in rods
    ])  # fmt: skip
    df, _ = differences(samples.probes, samples.gravity, samples.free_touches,
                        [(one.probes, one.gravity, none, none, zero) for one in rods])  # fmt: skip
    for j, one in stepped.items():
        i = shape_columns.index(j) if j in shape_columns else -1
        by_touch, by_free, by_point = (dw[:, :, i], df[:, :, i], dp[:, :, i]) if i >= 0 else (0.0, 0.0, 0.0)
        D[:, :, j] = one.reading(touches.wrench + by_touch, free + by_free, k, bare) - wrench
        Q[:, :, j] = one.point_in_nominal_frame(touches.p_surface + by_point) - point
    return D / COLUMN_STEP, Q / COLUMN_STEP


def cramer_rao(readings: Readings, noise: Array, friction: float = math.inf) -> Array:
    """Return the Cramér–Rao bound of the touched point of one touch, its covariance [m²], (n, 3, 3).

    The unknowns are (s, φ, F) and the perturbations, which have unit priors. The tangential components of F have a
    prior if `friction` is finite, and are known if it is 0.

    Args:
        readings: of the touches.
        noise: covariance of a reading about the base, (6, 6).
        friction: standard deviation of the tangential over the normal force.
    """
    count = 3 if friction == 0.0 else 5
    J = np.concatenate([readings.J[:, :, :count], readings.D], axis=2)
    P = np.concatenate([readings.P[:, :, :count], readings.Q], axis=2)
    information = np.einsum("nai,ab,nbj->nij", J, np.linalg.inv(noise), J)
    prior = np.zeros(information.shape[:2])
    prior[:, count:] = 1.0
    if count == 5 and math.isfinite(friction):
        prior[:, 3:5] = 1.0 / (friction * readings.touches.surface_force[:, :1]) ** 2
    information[:, np.arange(J.shape[2]), np.arange(J.shape[2])] += prior
    return propagated_covariance(information, P)


def propagated_covariance(information: Array, P: Array) -> Array:
    """Return P I⁻¹ Pᵀ, (n, a, a), of information matrices I; infinite where P depends on a direction I lacks."""
    good = np.isfinite(information).all(axis=(1, 2)) & np.isfinite(P).all(axis=(1, 2))
    safe = np.where(good[:, None, None], information, np.eye(information.shape[1]))
    scale = np.sqrt(np.maximum(np.diagonal(safe, axis1=1, axis2=2), 1e-300))
    values, vectors = np.linalg.eigh(safe / (scale[:, :, None] * scale[:, None, :]))
    gain = (np.where(good[:, None, None], P, 0.0) / scale[:, None, :]) @ vectors
    known = values > 1e-12
    cov = np.einsum("nai,ni,nbi->nab", gain, known / np.where(known, values, 1.0), gain)
    missing = np.where(known[:, None, :], 0.0, gain)
    cov[(np.abs(missing) > 1e-3 * np.abs(gain).max(axis=(1, 2), initial=0.0)[:, None, None]).any(axis=(1, 2))] = np.inf
    cov[~good] = np.nan
    return cov


def position_rms(cov: Array) -> Array:
    """Return the square root of the trace of each covariance [m], (n,)."""
    return np.sqrt(np.trace(cov, axis1=1, axis2=2))


# Several touches of one point


@dataclass(frozen=True)
class Presses:
    """k touches of one point by each of n probe samples whose base presses on without rotation.

    At rest, the point is at the world's origin, from where a loose object walks between the touches. At each touch it
    yields by -c F, where F is the force on the probe and c the compliance of the object.
    """

    ok: Array  #: whether all touches were solved, (n,).
    readings: tuple[Readings, ...]  #: one for each touch.
    places: Array  #: position of the base as the robot reports it [m], (n, k, 3).
    samples: ProbeSamples  #: the probes.
    rest: Array  #: rest, yielded: point at rest and displacement from there at each touch [m], (n, k, 3).
    yielded: Array

    @property
    def wrenches(self) -> Array:
        """Readings without noise, about the model's base, (n, k, 6)."""
        return np.stack([one.wrench for one in self.readings], axis=1)


def solve_presses(samples: ProbeSamples, z: Array, fraction: float, phi: Array, ratios: Array, newtons: float,
                  slide: Array, *, aside: Array | None = None, columns: bool = False) -> Presses:  # fmt: skip
    """Press probes against one point of an object, with about even steps from a fifth of the normal force to all of it.

    A sliding touch has the given friction ratios. The object drags the touched place along the probe in the mean
    direction of the tangential force, and the base moves accordingly. A sticking touch stays at one material point;
    the base moves slightly sideways, and the tangential force follows from that.

    Args:
        samples: n probe samples, for k touches.
        z: their perturbations, (n, size).
        fraction: place of the first touch over the length.
        phi: angle of the first touch about the section [rad], (n,).
        ratios: tangential over normal force, (n, 2), or (k, n, 2) where it differs between touches; of a sticking
            touch, at the first touch.
        newtons: largest normal force [N].
        slide: distance along the surface from the first to the last touch [m], (n,); ignored if it sticks.
        aside: None for a sliding touch. Otherwise the touch sticks, and the base moves sideways by this fraction of
            its travel, (n,). Beyond a tenth the probe is stretched and no friction can hold it.
        columns: whether the readings have derivatives, as `fused_cramer_rao` needs them.
    """
    n, k = len(z), samples.perturbations.touches
    s, free = fraction * samples.probes.length, samples.free_wrench()
    each = np.broadcast_to(ratios, (k, n, 2))
    push = np.concatenate([np.ones((k, n, 1)), each], axis=2).reshape(k * n, 3)
    mean = each.mean(axis=0)
    travel = slide[:, None] * mean / np.maximum(np.linalg.norm(mean, axis=1), 1e-9)[:, None]
    if aside is not None:
        travel = np.zeros((n, 2))

    def repeated(value: Array) -> Array:
        return np.concatenate([value] * k)

    rods, g = Probes.joined([samples.at_touch(i) for i in range(k)]), repeated(samples.gravity)
    shares, passed = (np.repeat(row, n) for row in (np.arange(1, k + 1) / k, np.arange(k) / (k - 1)))
    around = repeated(phi) + passed * repeated(travel[:, 0] / samples.probes.radius_at(s))
    found = solve(rods, g, repeated(s) + passed * repeated(travel[:, 1]), around, newtons * shares[:, None] * push,
                  axes="surface", loads=3)  # fmt: skip
    if aside is not None:
        distance = np.linalg.norm(found.p_surface[-n:] - found.p_surface[:n], axis=1)
        sideways = repeated((aside * distance)[:, None] * found.frame[:n, :, 1])
        goal = np.nan_to_num(found.p_surface + passed[:, None] * sideways)
        found = press(rods, g, goal, found, sticks=True, moves=2)
        tangential = np.linalg.norm(found.surface_force[:, 1:], axis=1)
        found = replace(found, ok=found.ok & (tangential <= MAX_STICKING_RATIO * found.surface_force[:, 0]))
    solved = [found.take(np.arange(i * n, (i + 1) * n)) for i in range(k)]
    readings = tuple(evaluate_readings(samples, z, touch, free, i, columns) for i, touch in enumerate(solved))
    forces = np.stack([np.einsum("nij,nj->ni", samples.R, touch.force) for touch in solved], axis=1)
    yielded = -samples.compliance[:, None, None] * forces
    rest = np.concatenate([np.zeros((n, 1, 3)), np.cumsum(samples.walk, axis=1)], axis=1)
    places = rest + yielded - np.stack([one.point for one in readings], axis=1) - samples.robot
    return Presses(np.all([touch.ok for touch in solved], axis=0), readings, places, samples, rest, yielded)


def fused_cramer_rao(pressed: Presses, noise: Array, friction: float, moments_only: bool) -> Array:
    """Return the Cramér–Rao bound of the point at rest and of the object's compliance, (n, 4, 4) [m, m/N].

    The unknowns are the point at the last touch, (s, φ, F) of each touch and the perturbations. The half-normal prior
    of the compliance counts as a normal one with mean zero, and the bound is that at the compliance of the samples.

    Args:
        pressed: touches with derivatives, of probes and mounts as designed.
        noise: covariance of a reading about the base, (6, 6).
        friction: standard deviation of the tangential over the normal force; 0 for no friction, inf for no prior.
        moments_only: whether only the moments about the base are used.
    """
    k, samples = len(pressed.readings), pressed.samples
    perturbations, slots, priors = samples.perturbations, samples.perturbations.slots, samples.perturbations.priors
    compliance = samples.compliance[:, None, None]
    on_force = np.ones(perturbations.size)  # Bias and gain change the reading but not the force.
    for source in {"drift", "gain"} & slots.keys():
        on_force[slots[source]] = 0.0
    n, count = len(pressed.ok), 3 if friction == 0.0 else 5
    channels = slice(3, 6) if moments_only else slice(0, 6)
    weight = np.linalg.inv(noise[channels, channels])
    size = 3 + count * k + perturbations.size
    shared = slice(3 + count * k, size)
    information = np.zeros((n, size, size))
    for i, one in enumerate(pressed.readings):
        own = slice(3 + count * i, 3 + count * (i + 1))
        H = np.zeros((n, weight.shape[0], size))
        H[:, :, own], H[:, :, shared] = one.J[:, channels, :count], one.D[:, channels]
        C = np.zeros((n, 3, size))
        C[:, :, :3], C[:, :, own] = -np.eye(3), one.P[:, :, :count] + compliance * one.J[:, :3, :count]
        C[:, :, shared] = one.Q + compliance * one.D[:, :3] * on_force
        if "robot" in slots:
            start = shared.start + slots["robot"].start + 3 * i
            C[:, :, start : start + 3] += MM * priors["robot_mm"] * np.eye(3)
        if "object" in slots:
            C[:, :, shared.start + slots["object"].start] += priors["object_compliance"] * one.touches.force
        if "object walk" in slots:
            for start in range(
                shared.start + slots["object walk"].start + 3 * i, shared.start + slots["object walk"].stop, 3
            ):
                C[:, :, start : start + 3] += MM * priors["object_walk_mm"] * np.eye(3)
        tie = np.einsum("nai,naj->nij", C, C) / SAME_POINT_STD**2
        information += np.einsum("nai,ab,nbj->nij", H, weight, H) + tie
        if count == 5 and math.isfinite(friction):
            at = np.arange(own.stop - 2, own.stop)
            information[:, at, at] += 1.0 / (friction * one.touches.surface_force[:, :1]) ** 2
    at = np.arange(shared.start, size)
    information[:, at, at] += 1.0
    wanted = np.eye(4, size)
    wanted[3] = 0.0
    if "object" in slots:
        wanted[3, shared.start + slots["object"].start] = priors["object_compliance"]
    return propagated_covariance(information, np.tile(wanted, (n, 1, 1)))
