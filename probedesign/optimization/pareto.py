"""Pareto front of error, contact force and reach, by NSGA-II."""

import csv
import io
from dataclasses import dataclass
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

import numpy as np

from probedesign.core.errors import InputError, MissingDependencyError
from probedesign.core.frames import Array
from probedesign.core.parallel import OnProgress
from probedesign.design import Design
from probedesign.optimization.constraints import FORCES, SPARE, NonlinearProgram
from probedesign.optimization.design_space import DesignSpace
from probedesign.optimization.evaluator import DesignEvaluator
from probedesign.optimization.optimum import OptimizationProblem, Optimum

if TYPE_CHECKING:
    from optuna.trial import FrozenTrial
    from optuna.trial import Trial as Drawn

POPULATION = 40
MAX_BASE_D_MM = 25.0
"""Largest base diameter tried: wider than the sensor, and no softer for it."""
LENGTHS_MM = (60.0, 200.0)
_VARIABLES = ("base_d_mm", "tip_d_mm", "length_mm", "force_mN", "error_mm", "reach_mm", "sag_mm")


@dataclass(frozen=True)
class ParetoFront:
    """Designs of which none is better than another in all objectives.

    Attributes:
        rows: one per design: `_VARIABLES`, by increasing error.
        n_evaluations: number of designs computed.
    """

    rows: list[dict[str, float]]
    n_evaluations: int

    def csv(self) -> bytes:
        """Return the front as a CSV table."""
        text = io.StringIO()
        writer = csv.DictWriter(text, _VARIABLES, lineterminator="\n")
        writer.writeheader()
        writer.writerows(self.rows)
        return text.getvalue().encode()


def check_installed() -> None:
    """Check that optuna is installed, before a long search begins.

    Raises:
        MissingDependencyError: optuna is not installed.
    """
    if find_spec("optuna") is None:
        raise MissingDependencyError.of_extra("--pareto", "optuna", "optimize")


def pareto_front(
    search: OptimizationProblem,
    trials: int,
    seed: int,
    on_progress: OnProgress,
    best: Optimum | None = None,
) -> ParetoFront:
    """Return feasible cones of any length: smallest error, smallest force, largest reach.

    Args:
        search: start, task and limits; base, tip, length and force vary.
        trials: number of designs to evaluate.
        seed: of the search.
        on_progress: receives the completed fraction.
        best: an optimum found before; evaluated first if it is a cone.

    Raises:
        MissingDependencyError: optuna is not installed.
        InputError: no evaluated design satisfies the limits.
    """
    check_installed()
    import optuna

    optuna.logging.set_verbosity(optuna.logging.ERROR)
    problem = NonlinearProgram(
        DesignEvaluator(DesignSpace.of(search.start, ("cone", "length")), search.task, True),
        search.all_limits,
    )
    sampler = optuna.samplers.NSGAIISampler(population_size=min(POPULATION, max(trials, 2)), seed=seed)
    study = optuna.create_study(directions=["minimize", "minimize", "maximize"], sampler=sampler)
    if best is not None and best.design.probe.shape == "cone":
        study.enqueue_trial(_known(best.design, best.task.force_N / search.task.force_N))
    study.enqueue_trial(_known(search.start, 1.0))
    study.optimize(lambda drawn: _evaluate(problem, drawn), n_trials=trials,
                   callbacks=[lambda _, t: on_progress("Pareto front", (t.number + 1) / trials)])  # fmt: skip
    kept = {trial.values[0]: trial for trial in study.best_trials if trial.user_attrs["feasible"]}
    if not kept:
        raise InputError(
            f"none of {trials} designs satisfies every limit; evaluate more, or relax --subject-to"
        )
    return ParetoFront(
        sorted((_row(trial) for trial in kept.values()), key=lambda row: row["error_mm"]), trials
    )


def _known(design: Design, force: float) -> dict[str, float]:
    """Return the variables of a known design, at a multiple of the task's force."""
    probe = design.probe
    tip = probe.blunt_mm[-1][1]
    low, high = FORCES
    return {"base_d_mm": probe.base_d_mm, "taper": min(tip / probe.base_d_mm, 1.0), "length_mm": probe.length_mm,
            "force": min(max(force, low), high)}  # fmt: skip


def _evaluate(problem: NonlinearProgram, drawn: "Drawn") -> tuple[float, float, float]:
    base = drawn.suggest_float("base_d_mm", 2.0, MAX_BASE_D_MM, log=True)
    tip = base * drawn.suggest_float("taper", 0.05, 1.0, log=True)
    length = drawn.suggest_float("length_mm", *LENGTHS_MM)
    force = drawn.suggest_float("force", *FORCES, log=True)
    x: Array = np.array([base, tip, length / 10.0, np.log(force)])
    metrics = problem.evaluator.metrics(x)
    # The margin that the search reserves for rounding may be used up by the optimum.
    broken = {c.text: -c.min_margin(x) - SPARE for c in problem.constraints}
    broken["stable"] = 0.0 if problem.evaluator.is_stable(x) else 1.0
    for text, by in broken.items():
        drawn.set_constraint(text, by)
    drawn.set_user_attr("feasible", max(broken.values()) <= 0.0)
    kept = {name: metrics[name] for name in ("error_mm", "reach_mm", "sag_mm", "length_mm")}
    force_mN = 1e3 * problem.evaluator.task_at(x).force_N
    drawn.set_user_attr("row", {"base_d_mm": base, "tip_d_mm": tip, "force_mN": force_mN, **kept})
    return metrics["error_mm"], force_mN, metrics["reach_mm"]


def _row(trial: "FrozenTrial") -> dict[str, float]:
    row: dict[str, Any] = trial.user_attrs["row"]
    return {name: float(row[name]) for name in _VARIABLES}
