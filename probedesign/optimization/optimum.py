"""Optimisation of a design from several starts, and its Monte Carlo check."""

import itertools
import math
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from probedesign.core.errors import InputError
from probedesign.core.frames import Array
from probedesign.core.parallel import OnProgress, process_map
from probedesign.core.units import MM
from probedesign.design import Design, check_design
from probedesign.design.io import render_design
from probedesign.estimation.model import ProbeModel, Tolerances
from probedesign.optimization.constraints import FORCES, SPARE, NonlinearProgram, OptimizationProblem
from probedesign.optimization.design_space import DIGITS
from probedesign.optimization.objective import DesignMetrics, Task, design_metrics, predict_task
from probedesign.prediction.monte_carlo import PrintSamples, locate_draws
from probedesign.probe import build_probe

STARTS = (1.0, 0.6)  #: Factors on the diameters of the design, one start each.
#: Axes from which an optimisation over the axis starts: total bend, turns and azimuth [deg].
BENDS_DEG, TURNS, AZIMUTHS_DEG = (60.0, 100.0, 160.0), (0.0, 0.5, 1.0), tuple(45.0 * k for k in range(8))
#: Factor on the diameters of a start that buckles, and maximum number of times: its metrics have no gradient.
_THICKER, _TIMES = 1.25, 8


@dataclass(frozen=True)
class Optimum:
    """The best design found."""

    design: Design  #: under its new name.
    task: Task  #: with the optimised force, where the force is minimised.
    before: DesignMetrics  #: before, after: metrics of the start and of the optimum for that task.
    after: DesignMetrics
    active_constraints: tuple[str, ...]  #: names of the constraints that limit it.
    n_evaluations: int  #: number of designs computed.
    #: result of each start: error [mm] or force over the task's; None where it is infeasible.
    starts: tuple[float | None, ...]


def optimum(search: OptimizationProblem, name: str, on_progress: OnProgress) -> Optimum:
    """Return the best design.

    A free taper is also started from the best cone, so it is not worse than that.

    Raises:
        InputError: no design satisfies the limits; the message names the conflicting ones.
    """
    problem, designs = search.problem, [search.start]
    if "taper" in search.free:
        cones = replace(search, free=tuple("cone" if part == "taper" else part for part in search.free))
        with suppress(InputError):  # a taper may be feasible where no cone is
            designs.append(_named(cones.problem, _solve(cones.problem, designs, on_progress)[0], "cone"))
    x, values = _solve(problem, designs, on_progress)
    best, task = _named(problem, x, name), problem.evaluator.task_at(x)
    return Optimum(best, task, design_metrics(search.start, task), design_metrics(best, task),
                   problem.active_constraints(x), problem.evaluator.n_evaluations, values)  # fmt: skip


def _named(problem: NonlinearProgram, x: Array, name: str) -> Design:
    space = problem.evaluator.space
    return check_design(space.tables(x[: space.size], DIGITS) | {"name": name})


def _solve(
    problem: NonlinearProgram, designs: list[Design], on_progress: OnProgress
) -> tuple[Array, tuple[float | None, ...]]:
    """Return the best point from the given designs and from a thinner one, with the result of each start."""
    starts, reached, values = _starts(problem, designs), list[Array](), list[float | None]()
    for n, x0 in enumerate(starts, 1):
        on_progress(f"{problem.evaluator.space.size} dimensions, start {n} of {len(starts)}", None)
        x = problem.solve(x0)
        good = problem.is_feasible(x)
        values.append(float(np.exp(problem.objective(x))) if good else None)
        reached += [x] if good else []
    if not reached:
        raise InputError(problem.infeasibility_report(starts))
    return min(reached, key=problem.objective), tuple(values)


def _starts(problem: NonlinearProgram, designs: list[Design]) -> list[Array]:
    """Return the designs, and the first of them thinner, or shorter where its diameters are fixed.

    A start that buckles under the force is replaced by one that is thick enough, if there is one.
    """
    space, starts = problem.evaluator.space, list[Array]()
    force = [float(np.log(FORCES[1]) / 2.0)] if problem.evaluator.with_force else []
    for design, factor in [(designs[0], factor) for factor in STARTS] + [(design, 1.0) for design in designs[1:]]:
        x = space.x_of(design)
        x[: space.controls or None] *= factor
        start = thicker = problem.clip(np.append(x, force))
        for _ in range(_TIMES):
            if problem.evaluator.is_stable(thicker):
                start = thicker
                break
            thicker = thicker.copy()
            thicker[: space.controls] *= _THICKER
            thicker = problem.clip(thicker)
        starts.append(start)
    if "axis" in space.free:
        starts = [*_bent(problem, starts[0]), *_bent(problem, starts[1])[:1], *starts[2:]]
    return starts


def _bent(problem: NonlinearProgram, x: Array) -> list[Array]:
    """Return a point with other axes, an arc and two helices: each the best of `BENDS_DEG` and `AZIMUTHS_DEG`."""
    best = []
    for turns in TURNS:
        tried = []
        for bend, azimuth in itertools.product(BENDS_DEG, AZIMUTHS_DEG):
            keys = {"axis_bend_deg": bend, "axis_turns": turns, "axis_azimuth_deg": azimuth}
            point = problem.clip(problem.evaluator.space.with_axis(x, keys))
            short = max(0.0, *(-SPARE - c.min_margin(point) for c in problem.constraints))
            tried.append((short, problem.objective(point), point))
        best.append(min(tried, key=lambda of: of[:2]))
    return [point for _, _, point in sorted(best, key=lambda of: of[:2])]


# Monte Carlo check

_CHUNK = 10  #: Draws that a worker takes at a time: a few seconds.


@dataclass(frozen=True)
class MonteCarloCheck:
    """Errors of drawn touches over all cases of a task."""

    rms_mm: float  #: RMS distance between the estimated and the true touched point, over all draws with a candidate.
    standard_error_mm: float  #: of that RMS.
    bound_mm: float  #: RMS of the predicted errors over the same cases.
    located: int  #: located, drawn: number of draws with the result "ok", and of all draws.
    drawn: int
    inside: int  #: number of those located whose 95 % ellipsoid contains the true point.


class _Chunk(NamedTuple):
    """Some draws of one case."""

    model: ProbeModel
    task: Task
    fraction: float
    angle: float
    force: float
    draws: int
    seed: tuple[int, int, int]


def confirm(
    design: Design, task: Task, draws: int, seed: int, on_progress: OnProgress, workers: int | None = None
) -> MonteCarloCheck:
    """Locate drawn touches in each of the task's cases.

    All error sources and the friction of each touch are drawn from the priors of the estimator.

    Args:
        design: of the probe.
        task: how it is used.
        draws: per case.
        seed: of the draws.
        on_progress: receives the completed fraction.
        workers: processes; all cores if None, only this one if 1. The result does not depend on it.

    Raises:
        InputError: the probe buckles in one of the cases.
    """
    model = build_probe(design).model
    predicted = predict_task(model, task, slipping=False)
    for case, error in zip(predicted.cases, predicted.errors, strict=True):
        if not math.isfinite(error):
            where = f"{case.contact_fraction:g} of its length under {1e3 * case.force_N:g} mN"
            raise InputError(f"{design.name}: buckles at {where}")
    cases = [(under, fraction, angle, force) for under in task.models(model) for fraction in task.fractions
             for angle in task.angles(under.gravity_base) for force in task.forces_N]  # fmt: skip
    chunks = [
        _Chunk(under, task, fraction, angle, force, min(_CHUNK, draws - first), (seed, number, first))
        for number, (under, fraction, angle, force) in enumerate(cases)
        for first in range(0, draws, _CHUNK)
    ]
    parts = dict[int, Array]()
    for i, part in process_map(_errors, chunks, workers):
        parts[i] = part
        on_progress("Monte Carlo check", len(parts) / len(chunks))
    errors, located, inside = np.concatenate([parts[i] for i in range(len(chunks))]).T
    squares = errors[np.isfinite(errors)] ** 2 / MM**2
    rms = float(np.sqrt(squares.mean())) if len(squares) else math.nan
    spread = float(squares.std() / math.sqrt(len(squares)) / (2.0 * rms)) if len(squares) > 1 else math.nan
    bound = float(np.sqrt(np.mean(np.square(predicted.errors)))) / MM
    return MonteCarloCheck(rms, spread, bound, int(located.sum()), len(errors), int(inside.sum()))


def _errors(chunk: _Chunk) -> Array:
    """Return error [m] (NaN without a candidate), located and inside the 95 % ellipsoid for each draw, (n, 3)."""
    model, task = chunk.model, chunk.task
    rng = np.random.default_rng(chunk.seed)
    samples = PrintSamples.draw(model, Tolerances.of(model), chunk.draws, int(rng.integers(2**31)))
    results = locate_draws(samples, chunk.fraction, chunk.force, chunk.angle, task.schedule, rng)
    rows = [
        (math.nan if a.error is None else a.error, a.result == "ok", a.result == "ok" and a.inside) for a in results
    ]
    return np.array(rows, dtype=float)


# Result


def design_text(search: OptimizationProblem, best: Optimum) -> str:
    """Return the design file of the optimum; its first lines describe the task and the result."""
    before, after = best.before.error_mm, best.after.error_mm
    was = "none: it buckles" if before is None else f"{before:.3g} mm"
    kept = ", ".join(limit.text for limit in search.limits) or "no further limits"
    about = (
        f"Optimised for {search.goal} from {search.start.name}; {kept}.\n"
        f"{best.task.text}:\npredicted error {after:.3g} mm by all error sources; {search.start.name}: {was}."
    )
    return render_design(best.design, {"": about})
