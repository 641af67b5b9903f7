"""Monte Carlo check of a design for a task: does the real estimator reach the predicted error?"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from probedesign.core.errors import InputError
from probedesign.core.frames import Array
from probedesign.core.parallel import OnProgress, process_map
from probedesign.core.units import MM
from probedesign.design import Design
from probedesign.estimation.model import ProbeModel
from probedesign.optimization.objective import predict_task
from probedesign.optimization.task import Task, side_of
from probedesign.prediction.monte_carlo import locate_draws
from probedesign.prediction.print_samples import PrintSamples
from probedesign.probe import build_probe

_CHUNK = 10
"""Draws that a worker takes at a time: a few seconds."""


@dataclass(frozen=True)
class MonteCarloCheck:
    """Errors of drawn touches over all cases of a task.

    Attributes:
        rms_mm: RMS distance between the estimated and the true touched point, over all draws with a candidate.
        standard_error_mm: of that RMS.
        bound_mm: RMS of the predicted errors over the same cases.
        located, drawn: number of draws with the result "ok", and of all draws.
        inside: number of those located whose 95 % ellipsoid contains the true point.
    """

    rms_mm: float
    standard_error_mm: float
    bound_mm: float
    located: int
    drawn: int
    inside: int


class _Chunk(NamedTuple):
    """Some draws of one case."""

    model: ProbeModel
    task: Task
    fraction: float
    force: float
    draws: int
    seed: tuple[int, int, int]


def confirm(
    design: Design,
    task: Task,
    draws: int,
    seed: int,
    on_progress: OnProgress,
    workers: int | None = None,
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
            raise InputError(
                f"{design.name}: buckles at {case.contact_fraction:g} of its length under {1e3 * case.force_N:g} mN"
            )
    cases = [(under, fraction, force) for under in task.models(model)
             for fraction in task.fractions for force in task.forces_N]  # fmt: skip
    chunks = [
        _Chunk(under, task, fraction, force, min(_CHUNK, draws - first), (seed, place, first))
        for place, (under, fraction, force) in enumerate(cases)
        for first in range(0, draws, _CHUNK)
    ]
    found = dict[int, Array]()
    for i, part in process_map(_errors, chunks, workers):
        found[i] = part
        on_progress("Monte Carlo check", len(found) / len(chunks))
    errors, located, inside = np.concatenate([found[i] for i in range(len(chunks))]).T
    squares = errors[np.isfinite(errors)] ** 2 / MM**2
    rms = float(np.sqrt(squares.mean())) if len(squares) else math.nan
    spread = float(squares.std() / math.sqrt(len(squares)) / (2.0 * rms)) if len(squares) > 1 else math.nan
    bound = float(np.sqrt(np.mean(np.square(predicted.errors)))) / MM
    return MonteCarloCheck(rms, spread, bound, int(located.sum()), len(errors), int(inside.sum()))


def _errors(chunk: _Chunk) -> Array:
    """Return, for each draw, the error [m] (NaN without a candidate), whether it is located, and whether the 95 %
    ellipsoid contains the true point, (n, 3).
    """
    model, task = chunk.model, chunk.task
    rng = np.random.default_rng(chunk.seed)
    samples = PrintSamples.draw(model, task.priors(model), chunk.draws, int(rng.integers(2**31)))
    results = locate_draws(
        samples, chunk.fraction, chunk.force, side_of(model.gravity_base), task.schedule, rng
    )
    return np.array(
        [
            (math.nan if a.error is None else a.error, a.result == "ok", a.result == "ok" and a.inside)
            for a in results
        ],
        dtype=float,
    )
