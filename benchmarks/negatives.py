"""Readings that one contact of a fixed point did not make, and touches with friction: what do the estimators answer?"""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from benchmarks.touches import Presses, Touch, random_presses, random_touches, read, stiffened, surface_point
from probedesign.core.frames import Array
from probedesign.estimation.estimate import FusedEstimate
from probedesign.estimation.estimator import Estimator
from probedesign.estimation.fusion import Fusion, Reading, channels_of
from probedesign.rod.contact import solve_surface_force

FORCES = (1e-2, 0.5)
"""[N]."""
FRICTION = (0.3, 0.5)


class Outcome(NamedTuple):
    """What was answered.

    Attributes:
        result: the code.
        off: distance of the best place from the true one over the standard deviation it comes with.
    """

    result: str
    off: float


Draws = Callable[[np.random.Generator], Iterator[Outcome]]


def _located(one: Touch, wrench: Array, point: Array, rng: np.random.Generator) -> Outcome:
    """One touch of the model's probe that truly is at that point of the surface."""
    c = Estimator(one.model).estimate(read(wrench[None], one.model, rng)[0], one.gravity)
    if not c.candidates:
        return Outcome(c.result, np.inf)
    best = c.candidates[0]
    off = float(np.linalg.norm(best.p_surface_base - point))
    return Outcome(c.result, off / float(np.sqrt(np.trace(best.cov_surface_base))))


def friction(rng: np.random.Generator) -> Iterator[Outcome]:
    """A tangential force of 0.3 to 0.5 of the normal one, any way along the surface: to be located, not refused."""
    for one in random_touches(FORCES, rng):
        size, turn = rng.uniform(*FRICTION), rng.uniform(0.0, 2.0 * np.pi)
        ratios = (size * float(np.cos(turn)), size * float(np.sin(turn)))
        rubbed = solve_surface_force(
            one.model.rod, one.gravity, one.s, one.angle + np.pi, one.force, ratios, "reference"
        )
        if rubbed.result == "ok":
            yield _located(one, rubbed.equilibrium.wrench_base, rubbed.p_surface_base, rng)


def two_contacts(rng: np.random.Generator) -> Iterator[Outcome]:
    """A second object, from another side and place, half as strong; light touches, so that wrenches add up."""
    for one in random_touches((5e-3, 5e-2), rng):
        free = one.model.rod.solve(one.gravity)
        across = np.cross([0.0, 0.0, 1.0], one.solved.force_base)
        s = one.model.rod.length * rng.uniform(0.2, 0.9)
        other = one.model.rod.solve(one.gravity, 0.5 * across, s, mode="reference")
        if free.ok and other.ok:
            yield _located(one, one.wrench + other.wrench_base - free.wrench_base, surface_point(one), rng)


def other_stiffness(rng: np.random.Generator) -> Iterator[Outcome]:
    """E and G are 10 % greater than the model's, one touch."""
    for pressed in random_presses(FORCES, rng):
        touches = stiffened(pressed, 1.1)
        if len(touches) == len(pressed.touches):
            yield _located(pressed.touches[-1], touches[-1].wrench, surface_point(touches[-1]), rng)


def _fused(pressed: Presses, wrenches: Array, Ts: Array, rng: np.random.Generator) -> Outcome:
    """Five touches; the true place is the world's origin."""
    model = pressed.model
    estimator = Estimator(model)
    seen = read(wrenches, model, rng)
    readings = tuple(
        Reading(w, model.noise_base(), T, pressed.gravity, True) for w, T in zip(seen, Ts, strict=True)
    )
    fusion = Fusion(model, readings, estimator.priors, channels_of(model, None), pressed.gravity)
    found = fusion.solutions()
    if isinstance(found, FusedEstimate):
        return Outcome(found.result, np.inf)
    best = found[0]
    off = float(np.linalg.norm(best.x[:3]) / np.sqrt(np.trace(best.cov)))
    return Outcome(fusion.answer(found, brief=True).result, off)


def fused_stiffness(rng: np.random.Generator) -> Iterator[Outcome]:
    """E and G are 10 % greater than the model's, whose prior says 3 %: five touches."""
    for pressed in random_presses(FORCES, rng):
        touches = stiffened(pressed, 1.1)
        if len(touches) == len(pressed.touches):
            Ts = pressed.Ts.copy()
            Ts[:, :3, 3] = [-surface_point(one) for one in touches]
            yield _fused(pressed, np.array([one.wrench for one in touches]), Ts, rng)


def moved_object(rng: np.random.Generator) -> Iterator[Outcome]:
    """After the third touch the object gives way by 1 mm, any way."""
    for pressed in random_presses(FORCES, rng):
        way = rng.normal(size=3)
        Ts = pressed.Ts.copy()
        Ts[3:, :3, 3] += 1e-3 * way / np.linalg.norm(way)
        yield _fused(pressed, pressed.wrenches, Ts, rng)


def bias_step(rng: np.random.Generator) -> Iterator[Outcome]:
    """After the third touch the bias jumps by ten steps of the resolution, any way."""
    for pressed in random_presses(FORCES, rng):
        model = pressed.model
        jump = np.linalg.cholesky(model.noise_base() * model.averaging_samples) @ rng.normal(size=6)
        wrenches = pressed.wrenches
        wrenches[3:] += 10.0 * jump / np.sqrt(6.0)
        yield _fused(pressed, wrenches, pressed.Ts, rng)


KINDS: dict[str, Draws] = {
    "friction 0.3-0.5, one touch": friction,
    "two contacts, one touch": two_contacts,
    "stiffness off by 10 %, one touch": other_stiffness,
    "stiffness off by 10 %, five touches": fused_stiffness,
    "object moves by 1 mm, five touches": moved_object,
    "bias jumps, five touches": bias_step,
}
