"""Whether the real estimator reaches what the bound promises: drawn readings of drawn probes, fused as a user would."""

import math
import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from probedesign.design import Design
from probedesign.errors import InputError
from probedesign.estimation.equations import POINT, UNKNOWNS
from probedesign.estimation.estimator import Estimator
from probedesign.estimation.model import ProbeModel
from probedesign.estimation.unknowns import Unknowns
from probedesign.frames import Array
from probedesign.probe import build_probe
from probedesign.search.press_series import PressSeries, press_series, unknowns_of
from probedesign.search.task import Task
from probedesign.units import MM

_PIECE = 10
"""Draws that a worker takes at a time: a few seconds."""


@dataclass(frozen=True)
class Confirmed:
    """What drawn touches gave.

    Attributes:
        rms_mm: of the touched point's place, over all places and draws that were answered.
        linear_mm: of the same draws, had the probe been linear; other draws would give the bound on average.
        bound_mm: what was promised.
        located, drawn: how many were answered, of how many.
    """

    rms_mm: float
    linear_mm: float
    bound_mm: float
    located: int
    drawn: int

    @property
    def expected_mm(self) -> float:
        """What other draws are likely to give: the luck of these, which a linear probe shares, is taken out."""
        return self.rms_mm * self.bound_mm / self.linear_mm


class _Piece(NamedTuple):
    """Some draws at one place; the rest of the problem is the same for all."""

    model: ProbeModel
    task: Task
    fraction: float
    draws: int
    seed: tuple[int, int, int]


class _Drawn(NamedTuple):
    """What was different from what the estimator believes.

    Attributes:
        log_stiffness: of the probe.
        noise: of the readings, with the bias as it walks, (k, 6).
        off: of the poses as the robot tells them [m], (k, 3).
    """

    log_stiffness: float
    noise: Array
    off: Array


def check_confirmable(task: Task) -> None:
    """Refuse what is not fused.

    Raises:
        InputError: it is of a single touch.
    """
    if task.touches < 2:
        raise InputError("--confirm is of fused touches; give --touches 2 or more")


def confirm(
    design: Design,
    task: Task,
    draws: int,
    seed: int,
    tell: Callable[[str, float | None], None],
    workers: int | None = None,
) -> Confirmed:
    """Fuse drawn readings at each of the task's places.

    Drawn are the stiffness, the base's place at all poses and at each, the bias's walk and the noise, each as the
    estimator is told to expect it.

    Args:
        design: of the probe.
        task: how it is used; more than one touch.
        draws: at each place.
        seed: of the draws.
        tell: told how far it is.
        workers: processes; all cores if None, this one alone if 1. The answer does not depend on it.

    Raises:
        InputError: a single touch is asked for, or the probe gives way.
    """
    check_confirmable(task)
    model, bounds = build_probe(design).model, list[float]()
    for fraction in task.fractions:
        series = press_series(model, fraction, task)
        if series is None:
            raise InputError(f"{design.name}: gives way at {fraction:g} of its length")
        bounds.append(series.rms(unknowns_of(model, task), task))
    pieces = [_Piece(model, task, fraction, min(_PIECE, draws - first), (seed, place, first))
              for place, fraction in enumerate(task.fractions) for first in range(0, draws, _PIECE)]  # fmt: skip
    found = list[Array]()
    for part in _run(pieces, workers or len(os.sched_getaffinity(0))):
        found.append(part)
        tell("confirming by drawn touches", len(found) / len(pieces))
    errors = np.concatenate(found)
    good = errors[np.isfinite(errors[:, 0])]
    rms, linear = np.sqrt((good**2).mean(axis=0)) / MM if len(good) else (math.nan, math.nan)
    bound = float(np.sqrt(np.mean(np.square(bounds)))) / MM
    return Confirmed(float(rms), float(linear), bound, len(good), len(errors))


def _run(pieces: list[_Piece], workers: int) -> Iterator[Array]:
    """The errors of each piece, in order."""
    if workers == 1:
        yield from map(_errors, pieces)
        return
    method = "forkserver" if "forkserver" in multiprocessing.get_all_start_methods() else "spawn"
    deaf = (signal.SIGINT, signal.SIG_IGN)  # an interrupt is the parent's business
    with ProcessPoolExecutor(workers, multiprocessing.get_context(method), signal.signal, deaf) as pool:
        try:
            yield from pool.map(_errors, pieces)
        except BaseException:
            pool.shutdown(wait=True, cancel_futures=True)
            raise


def _errors(piece: _Piece) -> Array:
    """How far off the touched point is located, and would be on a linear probe [m], (n, 2); NaN where it is not."""
    model, task, rng = piece.model, piece.task, np.random.default_rng(piece.seed)
    unknowns, series = unknowns_of(model, task), press_series(model, piece.fraction, task)
    assert series is not None, "it was solved before"
    found = list[tuple[float, float]]()
    for _ in range(piece.draws):
        drawn = _draw(model, task, unknowns, rng)
        found.append((_real(piece, unknowns, drawn), _linear(series, task, unknowns, drawn)))
    return np.array(found)


def _draw(model: ProbeModel, task: Task, unknowns: Unknowns, rng: np.random.Generator) -> _Drawn:
    k, cov, none = task.touches, model.noise_base(), np.zeros(6)
    step = cov * model.averaging_samples
    bias = unknowns.bias_steps * rng.multivariate_normal(none, step)
    walk = unknowns.bias_walk_steps * np.cumsum(rng.multivariate_normal(none, step, k), axis=0)
    off = rng.normal(0.0, unknowns.base_offset, 3) + rng.normal(0.0, unknowns.base_repeat, (k, 3))
    noise = rng.multivariate_normal(none, cov, k) + bias + walk
    return _Drawn(float(rng.normal(0.0, unknowns.stiffness)), noise, off)


def _real(piece: _Piece, unknowns: Unknowns, drawn: _Drawn) -> float:
    """By the estimator [m]."""
    model, task, factor = piece.model, piece.task, math.exp(drawn.log_stiffness)
    rod = replace(model.rod, youngs_modulus=factor * model.rod.youngs_modulus,
                  shear_modulus=factor * model.rod.shear_modulus)  # fmt: skip
    series = press_series(replace(model, rod=rod), piece.fraction, task)
    if series is None:
        return math.nan
    told = series.Ts_world_base
    told[:, :3, 3] += drawn.off
    answer = Estimator(model).fuse(
        series.wrenches + drawn.noise, told, model.gravity_base, moments_only=task.moments_about is not None,
        moments_about=task.moments_about or "base", unknowns=unknowns,
    )  # fmt: skip
    return float(np.linalg.norm(answer.p_surface_world)) if answer.ok else math.nan


def _linear(series: PressSeries, task: Task, unknowns: Unknowns, drawn: _Drawn) -> float:
    """Were the probe as linear as the bound takes it for [m]."""
    equations = series.equations(unknowns, task)
    touches, none = series.touches, np.zeros(UNKNOWNS)
    by_stiffness = np.array([touch.by_stiffness for touch in touches]) * drawn.log_stiffness
    by_place = np.array([touch.stiffness @ off for touch, off in zip(touches, drawn.off, strict=True)])
    misfit = (drawn.noise + by_stiffness + by_place) @ equations.channels.T
    linear = replace(equations.linear(touches, none), misfit=misfit.ravel())
    return float(np.linalg.norm(equations.normal(linear, none).step[POINT]))
