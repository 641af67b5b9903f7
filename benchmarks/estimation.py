"""Errors of located contacts against the Cramér–Rao bound, by force, and on Table I; time of an estimate.

All readings are synthetic. They are computed in the reference mode of the rod, not with the kernels of the estimator,
and have the noise of the sensor.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from itertools import count, islice

import numpy as np

from benchmarks.cases import GRAVITY, TABLE_I
from benchmarks.error_statistics import ErrorStatistics
from benchmarks.figures import draw_fusion, draw_table_one
from benchmarks.timing import format_seconds, interleaved, print_table
from benchmarks.touches import (
    DECADES,
    Presses,
    Touch,
    paper_models,
    presses,
    random_presses,
    random_touches,
    stiffened,
    table_one,
    touch,
    with_noise,
)
from probedesign.core.frames import Array
from probedesign.core.units import MM
from probedesign.estimation.estimate import FusedEstimate
from probedesign.estimation.estimator import Estimator, Method
from probedesign.estimation.model import ProbeModel, Tolerances
from probedesign.estimation.tracker import Tracker

#: Number of draws of each row, by table, and rounds of the timed calls.
SINGLES, FUSIONS, ON_TABLE, CASES, TIMING_ROUNDS = 2000, 100, 200, 20, 9
MAX_BOUND = 5.0 * MM  #: Largest bound of a draw that is counted.
#: Error sources of a fusion in these tables, with the values assumed in `Tolerances`.
PRIORS = replace(
    Tolerances.none(), youngs_modulus=0.03, shear_modulus=0.03, base_mm=0.05, robot_mm=0.01, walk_steps=0.2
)
IDENTIFIED = replace(PRIORS, youngs_modulus=0.005, shear_modulus=0.005)


HEAD = ["RMS / bound", "in 95 %", "NEES (expected 3)", "located", "other results"]


def _row(statistics: ErrorStatistics) -> list[str]:
    """Return the cells for `HEAD`; the mean NEES has its standard error."""
    nees = np.array(statistics.nees)
    return [f"{statistics.rms_over_bound():.3f}", f"{statistics.n_inside_95 / len(nees):.1%}",
            f"{nees.mean():.2f} ± {nees.std() / math.sqrt(len(nees)):.2f}",
            f"{statistics.results['ok']} of {statistics.results.total()}", statistics.other_results]  # fmt: skip


def report() -> None:
    """Print all tables and draw the figures."""
    print_times()
    print_table_one()
    print_singles()
    print_fusions()
    print_large()


# Random probes


def print_singles() -> None:
    """Print the errors of single touches by force."""
    rows = []
    for name, decade in DECADES.items():
        rng, statistics = np.random.default_rng(1), ErrorStatistics()
        for one in islice(_with_small_bound(random_touches(decade, rng)), SINGLES):
            c = frictionless(one.model).estimate(with_noise(one.wrench[None], one.model, rng)[0], one.gravity)
            statistics.add(c.result, c.p_surface_base - one.p_surface, c.cov_surface_base, one.bound)
        rows.append([name, *_row(statistics)])
    print_table(f"One touch, method ml, {SINGLES} random probes each, bound below 5 mm", ["force", *HEAD], rows)


def frictionless(model: ProbeModel) -> Estimator:
    """Return the estimator for an exact probe and a force normal to its surface, which the readings have."""
    return Estimator(model, Tolerances.none()).with_friction(0.0)


def _with_small_bound(touches: Iterator[Touch]) -> Iterator[Touch]:
    """Return the touches whose bound is below `MAX_BOUND`."""
    return (one for one in touches if one.bound < MAX_BOUND)


def print_fusions() -> None:
    """Print the errors of five fused touches by force; the errors are drawn from the priors."""
    rows = []
    for moments_only in (False, True):
        for name, decade in DECADES.items():
            rng, statistics = np.random.default_rng(2), ErrorStatistics()
            for pressed in islice(random_presses(decade, rng), FUSIONS):
                fuse_drawn(pressed, PRIORS, moments_only, rng, statistics)
            rows.append([f"{name}, {'moments alone' if moments_only else 'force and moment'}", *_row(statistics)])
    title = (f"Five touches of a press, {FUSIONS} random probes each; stiffness 3 %, base position 0.05 mm and "
             "0.01 mm per touch, bias random walk 0.2 steps per touch")  # fmt: skip
    print_table(title, ["largest force", *HEAD], rows)


def fuse_drawn(
    pressed: Presses, priors: Tolerances, moments_only: bool, rng: np.random.Generator, statistics: ErrorStatistics
) -> FusedEstimate:
    """Fuse readings with all error sources drawn from their priors, and add the error to the statistics.

    The covariance of the estimate serves as the bound.
    """
    model = pressed.model
    Ts = pressed.Ts.copy()
    factor = math.exp(rng.normal(0.0, priors.youngs_modulus))
    touches = pressed.touches if factor == 1.0 else stiffened(pressed, factor)
    base_error = rng.normal(0.0, priors.base_mm * MM, 3)
    points = np.array([one.p_surface for one in touches])
    # At the true base positions the touched point is the world's origin; the robot reports them with errors.
    Ts[:, :3, 3] = -points - base_error - rng.normal(0.0, priors.robot_mm * MM, (len(Ts), 3))
    step = model.noise_base() * model.averaging_samples
    steps = rng.multivariate_normal(np.zeros(6), priors.walk_steps**2 * step, len(Ts))
    steps[0] = rng.multivariate_normal(np.zeros(6), priors.drift_steps**2 * step)  # bias at the first touch
    walk = steps.cumsum(axis=0)
    wrenches = with_noise(np.array([one.wrench for one in touches]), model, rng) + walk
    estimator = frictionless(model).with_tolerances(priors)
    c = estimator.fuse(wrenches, Ts, pressed.gravity, moments_only=moments_only, moments_about="sensor")
    if c.rms < MAX_BOUND or not math.isfinite(c.rms):
        statistics.add(c.result, c.p_surface_world, c.cov_surface_world, c.rms)
    return c


# The large probe, pressed lightly


def print_large() -> None:
    """Print and draw the errors of five fused touches of the large probe from moments alone."""
    model = paper_models()["large"]
    kinds = {"exact stiffness, pose, bias": Tolerances.none(), "stiffness 3 %, robot, bias walk": PRIORS,
             "stiffness identified to 0.5 %": IDENTIFIED}  # fmt: skip
    rows, drawn = [], {}
    for kind, priors in kinds.items():
        for max_force in (2e-3, 5e-3, 1e-2):
            errors, bounds = [], []
            for fraction in (0.5, 0.6, 0.7, 0.8, 0.9):
                rng = np.random.default_rng(3)
                statistics, rms = ErrorStatistics(), []
                pressed = presses(
                    model, GRAVITY, fraction * model.rod.length, math.pi / 2, np.linspace(0.2, 1.0, 5) * max_force
                )
                if pressed is None:
                    continue
                for _ in range(CASES):
                    rms.append(fuse_drawn(pressed, priors, True, rng, statistics).rms)
                errors.append(statistics.rms_over_bound() * float(np.median(rms)) / MM)
                bounds.append(float(np.median(rms)) / MM)
            drawn[kind, max_force] = (errors, bounds)
            rows.append([f"{kind}, to {max_force * 1e3:g} mN", f"{min(errors):.2f} – {max(errors):.2f} mm",
                         f"{min(bounds):.2f} – {max(bounds):.2f} mm",
                         f"{math.sqrt(np.mean(np.square(errors)) / np.mean(np.square(bounds))):.2f}"])  # fmt: skip
    print_table(f"Large probe, five touches, moments alone, at 0.5 ... 0.9 L, {CASES} draws each",
                ["error sources", "RMS error", "bound", "RMS / bound"], rows)  # fmt: skip
    draw_fusion(drawn)


# Table I


def print_table_one() -> None:
    """Print and draw the errors of both methods on the conditions of Table I, with the same noise."""
    rows, drawn = [], []
    for one in table_one():
        rng, estimator = np.random.default_rng(4), frictionless(one.model)
        errors: dict[Method, list[float]] = {"ml": [], "force_moment": []}
        for wrench in with_noise(np.tile(one.wrench, (ON_TABLE, 1)), one.model, rng):
            for method in errors:
                c = estimator.estimate(wrench, one.gravity, method=method)
                errors[method].append(float(np.linalg.norm(c.candidates[0].p_surface_base - one.p_surface)))
        rms = {method: float(np.sqrt(np.mean(np.square(found)))) for method, found in errors.items()}
        outliers = {method: float(np.mean(np.array(found) > 5.0 * one.bound)) for method, found in errors.items()}
        place = one.s / one.model.rod.length
        drawn.append((one.model.name, one.force, place, one.bound, rms["ml"], rms["force_moment"]))
        rows.append([f"{one.model.name} {one.force:g} N at {place:.3g} L", f"{one.bound / MM:.2f}",
                     f"{rms['ml'] / MM:.2f}", f"{rms['force_moment'] / MM:.2f}",
                     f"{rms['force_moment'] / rms['ml']:.2f}",
                     f"{outliers['ml']:.1%}", f"{outliers['force_moment']:.1%}"])  # fmt: skip
    head = ["condition", "bound", "ml", "force–moment", "ratio", "ml > 5 × bound", "force–moment > 5 × bound"]
    title = f"{len(rows)} of the 23 conditions of Table I; the others have no equilibrium without friction"
    print_table(f"{title}; {ON_TABLE} readings each with the same noise; RMS in mm", head, rows)
    draw_table_one(drawn)


def print_times() -> None:
    """Print the time of an estimate."""
    model = paper_models()["large"]
    estimator = Estimator(model)
    calls: dict[str, Callable[[], object]] = {
        "free probe": partial(estimator.estimate, estimator.free(GRAVITY).wrench_base, GRAVITY)
    }
    for force, fraction in TABLE_I:
        solved = touch(model, GRAVITY, fraction * model.rod.length, np.pi / 2, force)
        assert solved is not None, "the large probe has an equilibrium under these touches of the paper"
        name, wrench = f"{force:g} N at {fraction:g} L", solved.wrench
        near = estimator.estimate(wrench, GRAVITY)
        calls[f"{name}, ml, cold"] = partial(estimator.estimate, wrench, GRAVITY)
        calls[f"{name}, ml, from a neighbour"] = partial(estimator.estimate, 1.0001 * wrench, GRAVITY, near=near)
        calls[f"{name}, force–moment"] = partial(estimator.estimate, wrench, GRAVITY, method="force_moment")
    pressed = presses(model, GRAVITY, 0.7 * model.rod.length, np.pi / 2, np.linspace(2e-3, 1e-2, 5))
    assert pressed is not None, "the large probe has an equilibrium under a light press"
    calls["fuse, five touches"] = partial(estimator.fuse, pressed.wrenches, pressed.Ts, GRAVITY)
    calls["tracker, one more reading after five touches"] = _tracking(estimator, pressed.wrenches, pressed.Ts)
    seconds = interleaved(calls, TIMING_ROUNDS)
    print_table(
        f"Time of one call from Python, large probe. Median of {TIMING_ROUNDS} interleaved rounds",
        ["call", "time", "calls per second"],
        [[name, format_seconds(t), f"{1.0 / t:.0f}"] for name, t in seconds.items()],
    )


def _tracking(estimator: Estimator, wrenches: Array, Ts: Array) -> Callable[[], object]:
    """Return a call that updates a tracker after five touches."""
    tracker, ticks = Tracker(estimator, gravity_world=GRAVITY), count(1)
    for wrench, T in zip(wrenches, Ts, strict=True):
        for _ in range(36):
            tracker.update(wrench, T, next(ticks) / 7000.0)
    return lambda: tracker.update(wrenches[-1], Ts[-1], next(ticks) / 7000.0)
