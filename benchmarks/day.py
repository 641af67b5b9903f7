"""Simulate a working day of `live` with one tare: false touches and errors of located touches over the hours.

The bias has a random walk and a ramp. Two parts run in separate processes. The first counts the false alarms of the
contact test for a free probe at the rate of a Net F/T box. The second feeds the processing chain of `live` with means
at a lower rate and touches of 10 mN at 0.6 of the length, simulated by the reference rod with all error sources drawn
for each touch. Single touches are compared with the bound of a reading after a fresh tare; presses from five poses are
fused with the poses of the base.
"""

import math
import time
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass

import numpy as np

from benchmarks.coverage import MAX_SLIDE, MIN_STD, TOUCHES
from benchmarks.error_statistics import CHI2_95, nees
from benchmarks.reference_probes import Perturbations, PriorStds
from benchmarks.reference_touches import cramer_rao, evaluate_readings, position_rms, solve_presses
from benchmarks.timing import print_table
from benchmarks.touches import paper_models
from probedesign.core.frames import Array, inverse, wrench_map
from probedesign.core.units import MM
from probedesign.estimation.detector import Detector
from probedesign.estimation.estimate import FusedEstimate
from probedesign.estimation.estimator import Estimator
from probedesign.estimation.model import ProbeModel
from probedesign.live.blocks import Block
from probedesign.live.poses.base_poses import BasePoses, TimedPose
from probedesign.live.processing.chain import Chain, ProcessingOptions
from probedesign.live.processing.tare import TareWindow
from probedesign.live.processing.touches import Contact
from tests.reference.cosserat import solve

HOURS = 8.0
#: Random walk [steps/√s] and ramp [steps/s] of the bias, in steps of the resolution; signs of the ramp are random.
WALK, RAMP = 0.05, 10.0 / 3600.0
RATE, RATE_OF_BOX = 25.0, 7000.0  #: Rates of the means and of the samples [Hz].
PLACE, NEWTONS = 0.6, 10e-3  #: Place over the length and force of the touches [N].
#: Times from touch to touch, from the start of a period to its touch, and at each pose [s].
PERIOD, BEGIN, DWELL = 120.0, 60.0, 2.0
TARE = TareWindow(0.0, 3.0)
RETREAT = np.array([0.0, 0.0, 3.0 * MM])  #: Displacement of the base while the probe is free [m].
TRAVEL = 10.0  #: Travel time of the base between touches [s].
PARTS = 4  #: Parts of the day in the table.


def report(hours: float = HOURS) -> None:
    """Print both tables.

    Args:
        hours: length of the day.
    """
    began = time.monotonic()
    with ProcessPoolExecutor(max_workers=2) as pool:
        alarms, day = pool.submit(_false_alarms, hours), pool.submit(_touches, hours)
        false_box, (found, false_means) = alarms.result(), day.result()
    rows = []
    for i in range(PARTS):
        part = [one for one in found if int(PARTS * one.time / (3600.0 * hours)) == i]
        rows.append([f"{hours * i / PARTS:g} ... {hours * (i + 1) / PARTS:g} h", *_columns(part)])
    rows.append(["all", *_columns(found)])
    print_table(
        f"A day with one tare: touches of {1e3 * NEWTONS:g} mN at {PLACE:g} L, all error sources drawn",
        ["", "single", "located", "RMS / bound", "in 95 %", "presses", "located", "RMS [mm]", "in 95 %",
         "other results"],
        rows,
    )  # fmt: skip
    rows = [
        [f"contact test, {RATE_OF_BOX:g} samples/s", f"{false_box / hours:.2g}", "≤ 1"],
        [f"processing chain, {RATE:g} means/s", f"{false_means / hours:.2g}", "≤ 1"],
    ]
    print_table("False touches per hour", ["", "measured", "target"], rows)
    print(
        f"  {hours:g} h simulated in {time.monotonic() - began:.0f} s; bias: {WALK:g} steps/√s, {3600 * RAMP:g} steps/h"
    )


# False touches at full rate


def _false_alarms(hours: float) -> int:
    """Return the number of contacts that the test detects on a free probe."""
    model, rng = paper_models()["large"], np.random.default_rng(1)
    detector, root = Detector(model, RATE_OF_BOX), _root(model) * math.sqrt(model.averaging_samples)
    n, alarms, before = int(60.0 * RATE_OF_BOX), 0, "free"
    bias, sides = np.zeros(6), rng.choice([-1.0, 1.0], 6)
    for minute in range(round(60.0 * hours)):
        walk = WALK / math.sqrt(RATE_OF_BOX) * np.cumsum(rng.standard_normal((n, 6), dtype=np.float32), axis=0)
        ramp = RAMP * (60.0 * minute + np.arange(n)[:, None] / RATE_OF_BOX) * sides
        steps = bias + walk
        bias = steps[-1]
        states = np.array(detector.run((steps + ramp + rng.standard_normal((n, 6), dtype=np.float32)) @ root.T))
        touching = states == "contact"
        alarms += int((touching[1:] & ~touching[:-1]).sum() + (touching[0] and before != "contact"))
        before = str(states[-1])
    return alarms


def _root(model: ProbeModel) -> Array:
    """Return the map of independent normals of the channels to the noise of one reading at the base, (6, 6)."""
    return wrench_map(inverse(model.T_sensor_base)) * model.noise.std


# Touches through the whole chain


@dataclass(frozen=True)
class Scheduled:
    """A simulated touch."""

    begin: float  #: start time [s].
    wrenches: Array  #: readings without noise and bias at each pose, (k, 6).
    places: Array  #: positions of the base at each pose [m], (k, 3).
    point: Array  #: touched point in base axes at the last pose [m], (3,).
    bound: float  #: bound of the RMS error of one reading with a fresh tare [m]; NaN for a press.

    @property
    def end(self) -> float:
        """End time [s]."""
        return self.begin + DWELL * len(self.places)


@dataclass(frozen=True)
class Outcome:
    """Result of a touch."""

    time: float  #: start time [s].
    single: bool  #: whether it is a single touch.
    result: str  #: code of the estimate of one reading, or of the fusion of a press; "missed" without a contact.
    error: float = math.nan  #: distance from the true point [m].
    ratio: float = math.nan  #: error over bound.
    nees: float = math.nan  #: normalised estimation error squared.


def _schedule(model: ProbeModel, hours: float, rng: np.random.Generator) -> list[Scheduled]:
    """Return alternately single touches and presses, each with error sources of its own but without the drift."""
    n = int(3600.0 * hours / PERIOD) // 2
    stated, found = PriorStds.of(model), list[Scheduled]()
    mu = model.friction

    def drawn(touches: int) -> tuple[Perturbations, Array, Array, Array]:
        perturbations = Perturbations.of(model, stated, touches)
        z = perturbations.draw(n, rng)
        z[:, perturbations.slots["drift"]] = 0.0
        return perturbations, z, mu * rng.normal(size=(n, 2)), rng.uniform(-np.pi, np.pi, n)

    perturbations, z, ratios, phi = drawn(1)
    samples = perturbations.samples(z)
    force = NEWTONS * np.column_stack([np.ones(n), ratios]) / np.sqrt(1.0 + (ratios**2).sum(axis=1))[:, None]
    one = solve(samples.at_touch(0), samples.gravity, PLACE * samples.probes.length, phi, force, axes="surface")
    readings = evaluate_readings(samples, z, one, samples.free_wrench())
    bounds = position_rms(cramer_rao(readings, model.noise_base()))
    for i in np.flatnonzero(one.ok):
        begin = 2.0 * i * PERIOD + BEGIN
        place, point = -readings.point[i : i + 1], readings.point[i]
        found.append(Scheduled(begin, readings.wrench[i : i + 1], place, point, float(bounds[i])))
    perturbations, z, ratios, phi = drawn(TOUCHES)
    slide = rng.uniform(0.0, MAX_SLIDE, n)
    pressed = solve_presses(perturbations.samples(z), z, PLACE, phi, ratios, NEWTONS, slide)
    for i in np.flatnonzero(pressed.ok):
        begin = (2.0 * i + 1.0) * PERIOD + BEGIN
        point = pressed.readings[-1].point[i]
        found.append(Scheduled(begin, pressed.wrenches[i], pressed.places[i], point, math.nan))
    return sorted(found, key=lambda touch: touch.begin)


def _poses(model: ProbeModel, touches: list[Scheduled]) -> BasePoses:
    """Return the poses of the base, which is at rest except between touches."""
    stated, t = list[TimedPose](), -1.0
    step = 0.4 / RATE

    def rest(start: float, end: float, p: Array) -> None:
        for at in (start, end):
            stated.append(TimedPose(at, tuple(p.tolist()), (0.0, 0.0, 0.0, 1.0)))

    for touch in touches:
        rest(t, touch.begin - step, touch.places[0] + RETREAT)
        for k, p in enumerate(touch.places):
            rest(touch.begin + k * DWELL, touch.begin + (k + 1) * DWELL - step, p)
        t = touch.end
        rest(t, t + TRAVEL, touch.places[0] + RETREAT)
        t += 2.0 * TRAVEL
    rest(t, t + 2.0 * PERIOD, touches[-1].places[0] + RETREAT)
    return BasePoses("stated", stated, max_gap=math.inf, gravity_world=model.gravity_base)


def _blocks(model: ProbeModel, touches: list[Scheduled], hours: float, rng: np.random.Generator) -> Iterator[Block]:
    """Yield the readings of one period after the other; each is in the middle of the interval since the one before."""
    step = np.sqrt(np.diag(model.noise.cov) * model.averaging_samples)
    bias, sides, n = np.zeros(6), rng.choice([-1.0, 1.0], 6), int(PERIOD * RATE)
    by_period = {int(touch.begin // PERIOD): touch for touch in touches}
    free = Perturbations.of(model, PriorStds.of(model)).nominal_free
    for period in range(int(3600.0 * hours / PERIOD)):
        t = PERIOD * period + (np.arange(n) + 0.25) / RATE
        wrench = np.tile(free, (n, 1))
        touch = by_period.get(period)
        if touch is not None:
            inside = (t >= touch.begin) & (t < touch.end)
            wrench[inside] = touch.wrenches[((t[inside] - touch.begin) // DWELL).astype(int)]
        walk = bias + WALK / math.sqrt(RATE) * np.cumsum(rng.normal(size=(n, 6)), axis=0)
        bias = walk[-1]
        drift = step * (walk + RAMP * t[:, None] * sides)
        read = model.to_sensor(wrench, model.gravity_base) + drift + model.noise.std * rng.normal(size=(n, 6))
        yield Block(t, read, model.gravity_base, np.full(n, math.nan))


def _touches(hours: float) -> tuple[list[Outcome], int]:
    """Return the outcome of each touch and the number of contacts that belong to no touch."""
    model, rng = paper_models()["large"], np.random.default_rng(2)
    touches = _schedule(model, hours, rng)
    chain = Chain(Estimator(model), ProcessingOptions(TARE, 1, rate=2.0), _poses(model, touches), lambda line: None)
    singles: dict[int, str] = {}
    contacts: dict[int, Contact] = {}
    for block in _blocks(model, touches, hours, rng):
        for update in chain.process(block):
            if update.phase == "settled":
                singles[update.contacts[-1].number] = update.estimate.result
        contacts |= {contact.number: contact for contact in chain.contacts[-10:]}
    found, used = list[Outcome](), set[int]()
    for touch in touches:
        mine = [c for c in contacts.values() if touch.begin - 0.1 <= c.start < touch.end]
        used |= {c.number for c in mine}
        found.append(_outcome(touch, mine[-1] if mine else None, singles))
    return found, len(set(contacts) - used)


def _outcome(touch: Scheduled, contact: Contact | None, singles: dict[int, str]) -> Outcome:
    single = math.isfinite(touch.bound)
    if contact is None:
        return Outcome(touch.begin, single, "missed")
    if single:
        e = contact.estimate
        if e is None:
            return Outcome(touch.begin, True, singles.get(contact.number, "missed"))
        return _located(touch, True, e.p_surface_base - touch.point, e.cov_surface_base)
    fused = contact.fused or FusedEstimate("not_converged")
    if not fused.ok:
        return Outcome(touch.begin, False, fused.result)
    return _located(touch, False, fused.p_surface_world, fused.cov_surface_world)


def _located(touch: Scheduled, single: bool, error: Array, cov: Array) -> Outcome:
    size = float(np.linalg.norm(error))
    return Outcome(touch.begin, single, "ok", size, size / touch.bound, nees(error, cov, MIN_STD))


def _columns(found: list[Outcome]) -> list[str]:
    """Return the columns of a row of the table."""
    columns = list[str]()
    for single in (True, False):
        mine = [one for one in found if one.single == single]
        located = [one for one in mine if one.result == "ok"]
        n = max(len(located), 1)
        size = math.sqrt(sum((one.ratio if single else one.error / MM) ** 2 for one in located) / n)
        inside = sum(one.nees <= CHI2_95 for one in located) / n
        columns += [str(len(mine)), f"{len(located) / max(len(mine), 1):.1%}", f"{size:.2f}", f"{inside:.1%}"]
    others = Counter(one.result for one in found if one.result != "ok")
    return [*columns, ", ".join(f"{code} {n}" for code, n in others.items()) or "none"]
