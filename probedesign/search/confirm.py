"""Whether the real estimator reaches the predicted error: drawn readings of drawn probes, located as a user would."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from probedesign.core.parallel import process_map
from probedesign.design import Design
from probedesign.errors import InputError
from probedesign.estimation.model import ProbeModel
from probedesign.frames import Array
from probedesign.prediction.monte_carlo import drawn_errors
from probedesign.prediction.worlds import Worlds
from probedesign.probe import build_probe
from probedesign.search.task import Task, side_of
from probedesign.search.worth import touches
from probedesign.units import MM

_PIECE = 10
"""Draws that a worker takes at a time: a few seconds."""


@dataclass(frozen=True)
class Confirmed:
    """What drawn touches gave, over all cases of a task.

    Attributes:
        rms_mm: RMS distance of the located from the touched point, of all draws with a best place.
        standard_error_mm: of that RMS.
        bound_mm: RMS of the predicted errors over the same cases.
        located, drawn: how many were answered "ok", of how many.
        inside: how many of those located state a 95 % ellipsoid that holds the true point.
    """

    rms_mm: float
    standard_error_mm: float
    bound_mm: float
    located: int
    drawn: int
    inside: int


class _Piece(NamedTuple):
    """Some draws of one case; the rest of the problem is the same for all."""

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
    tell: Callable[[str, float | None], None],
    workers: int | None = None,
) -> Confirmed:
    """Locate drawn touches in each of the task's cases.

    Drawn are all error sources and the friction of each touch, from the priors that the estimator counts.

    Args:
        design: of the probe.
        task: how it is used.
        draws: in each case.
        seed: of the draws.
        tell: told how far it is.
        workers: processes; all cores if None, this one alone if 1. The answer does not depend on it.

    Raises:
        InputError: the probe gives way in one of the cases.
    """
    model = build_probe(design).model
    predicted = touches(model, task, slipping=False)
    for case, error in zip(predicted.cases, predicted.errors, strict=True):
        if not math.isfinite(error):
            raise InputError(
                f"{design.name}: gives way at {case.contact_fraction:g} of its length under {1e3 * case.force_N:g} mN"
            )
    cases = [(under, fraction, force) for under in task.models(model)
             for fraction in task.fractions for force in task.forces_N]  # fmt: skip
    pieces = [
        _Piece(under, task, fraction, force, min(_PIECE, draws - first), (seed, place, first))
        for place, (under, fraction, force) in enumerate(cases)
        for first in range(0, draws, _PIECE)
    ]
    found = dict[int, Array]()
    for i, part in process_map(_errors, pieces, workers):
        found[i] = part
        tell("confirming by drawn touches", len(found) / len(pieces))
    errors, located, inside = np.concatenate([found[i] for i in range(len(pieces))]).T
    squares = errors[np.isfinite(errors)] ** 2 / MM**2
    rms = float(np.sqrt(squares.mean())) if len(squares) else math.nan
    spread = float(squares.std() / math.sqrt(len(squares)) / (2.0 * rms)) if len(squares) > 1 else math.nan
    bound = float(np.sqrt(np.mean(np.square(predicted.errors)))) / MM
    return Confirmed(rms, spread, bound, int(located.sum()), len(errors), int(inside.sum()))


def _errors(piece: _Piece) -> Array:
    """Error of each draw [m], NaN where there is no best place, whether it was located, and whether the stated
    ellipsoid holds the truth, (n, 3)."""
    model, task = piece.model, piece.task
    rng = np.random.default_rng(piece.seed)
    worlds = Worlds.draw(model, task.priors(model), piece.draws, int(rng.integers(2**31)))
    answers = drawn_errors(
        worlds, piece.fraction, piece.force, side_of(model.gravity_base), task.schedule, rng
    )
    return np.array(
        [
            (math.nan if a.error is None else a.error, a.result == "ok", a.result == "ok" and a.inside)
            for a in answers
        ],
        dtype=float,
    )
