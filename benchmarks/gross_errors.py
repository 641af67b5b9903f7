"""Estimates from readings with gross errors, and from touches with friction, which are no error."""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from benchmarks.touches import Presses, Touch, random_presses, random_touches, stiffened, with_noise
from probedesign.core.frames import Array
from probedesign.estimation.estimate import FusedEstimate
from probedesign.estimation.estimator import Estimator
from probedesign.estimation.fusion import Fusion, Reading
from probedesign.estimation.fusion_state import channels_of
from probedesign.rod.contact import solve_surface_force

FORCES = (1e-2, 0.5)
"""Range of the normal force [N]."""
FRICTION = (0.3, 0.5)
"""Range of the tangential over the normal force."""


class Outcome(NamedTuple):
    """Result code of an estimate and the error of its best candidate in stated standard deviations."""

    result: str
    error: float


Draws = Callable[[np.random.Generator], Iterator[Outcome]]


def _located(one: Touch, wrench: Array, point: Array, rng: np.random.Generator) -> Outcome:
    """Locate one touch whose true point on the surface is given."""
    c = Estimator(one.model).estimate(with_noise(wrench[None], one.model, rng)[0], one.gravity)
    if not c.candidates:
        return Outcome(c.result, np.inf)
    best = c.candidates[0]
    error = float(np.linalg.norm(best.p_surface_base - point))
    return Outcome(c.result, error / float(np.sqrt(np.trace(best.cov_surface_base))))


def friction(rng: np.random.Generator) -> Iterator[Outcome]:
    """Add a tangential force in a random direction, which the estimator should locate and not refuse."""
    for one in random_touches(FORCES, rng):
        ratio, angle = rng.uniform(*FRICTION), rng.uniform(0.0, 2.0 * np.pi)
        ratios = (ratio * float(np.cos(angle)), ratio * float(np.sin(angle)))
        solved = solve_surface_force(
            one.model.rod, one.gravity, one.s, one.angle + np.pi, one.force, ratios, "reference"
        )
        if solved.result == "ok":
            yield _located(one, solved.equilibrium.wrench_base, solved.p_surface_base, rng)


def two_contacts(rng: np.random.Generator) -> Iterator[Outcome]:
    """Add a second contact with half the force from another side; the touches are light, so that wrenches add."""
    for one in random_touches((5e-3, 5e-2), rng):
        free = one.model.rod.solve(one.gravity)
        across = np.cross([0.0, 0.0, 1.0], one.solved.force_base)
        s = one.model.rod.length * rng.uniform(0.2, 0.9)
        other = one.model.rod.solve(one.gravity, 0.5 * across, s, mode="reference")
        if free.ok and other.ok:
            yield _located(one, one.wrench + other.wrench_base - free.wrench_base, one.p_surface, rng)


def other_stiffness(rng: np.random.Generator) -> Iterator[Outcome]:
    """Increase E and G by 10 %, one touch."""
    for pressed in random_presses(FORCES, rng):
        touches = stiffened(pressed, 1.1)
        if len(touches) == len(pressed.touches):
            yield _located(pressed.touches[-1], touches[-1].wrench, touches[-1].p_surface, rng)


def _fused(pressed: Presses, wrenches: Array, Ts: Array, rng: np.random.Generator) -> Outcome:
    """Fuse five touches of the world's origin."""
    model = pressed.model
    estimator = Estimator(model)
    noisy = with_noise(wrenches, model, rng)
    readings = tuple(Reading(w, model.noise_base(), T, pressed.gravity, True) for w, T in zip(noisy, Ts, strict=True))
    fusion = Fusion(model, readings, estimator.priors, channels_of(model, None), pressed.gravity)
    found = fusion.solutions()
    if isinstance(found, FusedEstimate):
        return Outcome(found.result, np.inf)
    best = found[0]
    error = float(np.linalg.norm(best.x[:3]) / np.sqrt(np.trace(best.cov)))
    return Outcome(fusion.answer(found, brief=True).result, error)


def fused_stiffness(rng: np.random.Generator) -> Iterator[Outcome]:
    """Increase E and G by 10 %, where the prior has 3 %, five touches."""
    for pressed in random_presses(FORCES, rng):
        touches = stiffened(pressed, 1.1)
        if len(touches) == len(pressed.touches):
            Ts = pressed.Ts.copy()
            Ts[:, :3, 3] = [-one.p_surface for one in touches]
            yield _fused(pressed, np.array([one.wrench for one in touches]), Ts, rng)


def moved_object(rng: np.random.Generator) -> Iterator[Outcome]:
    """Move the object by 1 mm in a random direction after the third touch."""
    for pressed in random_presses(FORCES, rng):
        direction = rng.normal(size=3)
        Ts = pressed.Ts.copy()
        Ts[3:, :3, 3] += 1e-3 * direction / np.linalg.norm(direction)
        yield _fused(pressed, pressed.wrenches, Ts, rng)


def bias_step(rng: np.random.Generator) -> Iterator[Outcome]:
    """Change the bias by ten steps of the resolution in a random direction after the third touch."""
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
