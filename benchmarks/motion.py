"""The processing chain of `live` where the sensor drifts, with a simulated truth that the estimator does not use.

Twenty minutes with thirty touches of 5 to 25 mN, a bias that warms up, leaps or creeps beside its random walk, and the
rod solved in reference mode.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from benchmarks.error_statistics import CHI2_95, nees
from benchmarks.timing import print_table
from benchmarks.touches import paper_models
from probedesign.core.frames import Array
from probedesign.estimation.bias import WALK_STEPS
from probedesign.estimation.estimator import Estimator
from probedesign.estimation.model import ProbeModel
from probedesign.live.blocks import Block
from probedesign.live.processing.chain import Chain, ProcessingOptions
from probedesign.live.processing.tare import TareWindow
from probedesign.rod.contact import SurfaceForce, solve_surface_force

# Drift ---------------------------------------------------------------------------------------------------------------

RATE = 1000.0  #: Of the samples [Hz].
TOUCHES, PERIOD, BEGIN, DWELL = 30, 40.0, 20.0, 15.0  #: Number, and times within a period [s].
BLOCK_S = 1.0  #: Duration of a block [s].
RAMP = 0.3  #: Time in which the force of a touch grows and vanishes [s].
TARE = TareWindow(0.0, 3.0)
#: Ranges of the place over the length and of the force [N].
PLACES, FORCES = (0.6, 0.85), (5e-3, 25e-3)


def _warm_up(t: Array, steps: Array) -> Array:
    return 50e-3 * (1.0 - np.exp(-t / 120.0))[:, None] * np.array([1.0, -0.5, 0.7, 4e-3, 3e-3, -2e-3])


def _leaps(t: Array, steps: Array) -> Array:
    """Return leaps of 5 mN each 200 s in Fx, Fy and Fz in turn, 15 s after a touch has begun its period."""
    bias = np.zeros((len(t), 6))
    for k in range(6):
        bias[t >= 210.0 + 200.0 * k, k % 3] += 5e-3
    return bias


def _ramp(t: Array, steps: Array) -> Array:
    return t[:, None] * 200.0 / 3600.0 * steps * np.array([1.0, -1.0, 1.0, 1.0, -1.0, 1.0])


DRIFTS: dict[str, Callable[[Array, Array], Array]] = {
    "random walk alone": lambda t, steps: np.zeros((len(t), 6)),
    "warm-up by 50 mN with 120 s": _warm_up,
    "leaps of 5 mN in Fx, Fy, Fz": _leaps,
    "ramp of 200 steps an hour": _ramp,
}


@dataclass(frozen=True)
class DriftOutcome:
    """What a chain made of the twenty minutes."""

    located: int  #: number of touches that were located.
    inside: int  #: number of those within their 95 % ellipsoid.
    false_touches: int  #: number of touches where there was none.
    false_ok: int  #: number of rows with a position while nothing touched.
    warming: int  #: number of rows `warming_up`.


def drift_outcome(model: ProbeModel, drift: Callable[[Array, Array], Array], seed: int = 1) -> DriftOutcome:
    """Simulate the touches with a drift of the bias and return the outcome."""
    rng = np.random.default_rng(seed)
    steps = model.noise.std * math.sqrt(model.averaging_samples)
    touches = list[tuple[float, SurfaceForce]]()
    for k in range(TOUCHES):
        solved = solve_surface_force(
            model.rod, model.gravity_base, float(rng.uniform(*PLACES)) * model.rod.length,
            float(rng.uniform(-math.pi, math.pi)), float(rng.uniform(*FORCES)), (0.0, 0.0), "reference",
        )  # fmt: skip
        touches.append((PERIOD * k + BEGIN, solved))
    free = model.rod.solve(model.gravity_base, mode="reference").wrench_base
    chain = Chain(Estimator(model), ProcessingOptions(TARE, None, rate=10.0), None, lambda line: None)
    false_ok = warming = 0
    for block in _drifting(model, free, touches, drift, steps, rng):
        for update in chain.process(block):
            t = update.reading.time
            touched = any(begin - 0.1 <= t <= begin + DWELL + 0.1 for begin, _ in touches)
            false_ok += update.estimate.ok and not touched
            warming += update.estimate.result == "warming_up"
    located = inside = 0
    used = set[int]()
    for begin, solved in touches:
        mine = [c for c in chain.contacts if begin - 0.1 <= c.start < begin + DWELL]
        used |= {c.number for c in mine}
        estimate = mine[-1].estimate if mine else None
        if estimate is not None and estimate.ok:
            located += 1
            error = estimate.p_surface_base - solved.p_surface_base
            inside += nees(error, estimate.cov_surface_base, 1e-5) <= CHI2_95
    false_touches = len({c.number for c in chain.contacts} - used)
    return DriftOutcome(located, inside, false_touches, false_ok, warming)


def _drifting(
    model: ProbeModel, free: Array, touches: list[tuple[float, SurfaceForce]],
    drift: Callable[[Array, Array], Array], steps: Array, rng: np.random.Generator,
) -> Iterator[Block]:  # fmt: skip
    walked, n = np.zeros(6), int(BLOCK_S * RATE)
    for k in range(int(TOUCHES * PERIOD / BLOCK_S)):
        t = (k * n + np.arange(n)) / RATE
        wrench = np.tile(free, (n, 1))
        for begin, solved in touches:
            share = np.clip(np.minimum(t - begin, begin + DWELL - t) / RAMP, 0.0, 1.0)[:, None]
            wrench += share * (solved.equilibrium.wrench_base - free)
        walk = walked + WALK_STEPS / math.sqrt(RATE) * np.cumsum(rng.standard_normal((n, 6)), axis=0)
        walked = walk[-1]
        read = model.to_sensor(wrench, model.gravity_base) + drift(t, steps)
        yield Block(t, read + steps * (walk + rng.standard_normal((n, 6))), model.gravity_base, np.full(n, math.nan))


def report() -> None:
    """Print the table."""
    model, rows = paper_models()["large"], []
    for name, drift in DRIFTS.items():
        o = drift_outcome(model, drift)
        rows.append([name, f"{o.located} of {TOUCHES}", f"{o.inside}", f"{3.0 * o.false_touches:g}", f"{o.false_ok}",
                     f"{o.warming}"])  # fmt: skip
    print_table("Twenty minutes with one tare, single touches of 5 to 25 mN",
                ["bias", "located", "in 95 %", "false touches an hour", "false ok rows", "warming_up rows"],
                rows)  # fmt: skip
