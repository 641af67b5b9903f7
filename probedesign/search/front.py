"""What one thing costs in another: error against contact force against reach, by NSGA-II."""

import csv
import io
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

import numpy as np

from probedesign.design import Design
from probedesign.errors import InputError, MissingDependencyError
from probedesign.frames import Array
from probedesign.search.body import Body
from probedesign.search.optimum import Optimum, Search
from probedesign.search.problem import FORCES, SPARE, Problem
from probedesign.search.trial import Trial

if TYPE_CHECKING:
    from optuna.trial import FrozenTrial
    from optuna.trial import Trial as Drawn

POPULATION = 40
WIDEST_MM = 25.0
"""Diameters beyond it are not tried: wider than the sensor, and no softer for it."""
LENGTHS_MM = (60.0, 200.0)
_VARIABLES = ("base_d_mm", "tip_d_mm", "length_mm", "force_mN", "error_mm", "reach_mm", "sag_mm")


@dataclass(frozen=True)
class Front:
    """Bodies none of which is better than another in everything.

    Attributes:
        rows: one a body: `_VARIABLES`, by rising error.
        looked: bodies computed.
    """

    rows: list[dict[str, float]]
    looked: int

    def csv(self) -> bytes:
        """As a table."""
        text = io.StringIO()
        writer = csv.DictWriter(text, _VARIABLES, lineterminator="\n")
        writer.writeheader()
        writer.writerows(self.rows)
        return text.getvalue().encode()


def check_installed() -> None:
    """Refuse to begin what cannot be ended.

    Raises:
        MissingDependencyError: optuna is not installed.
    """
    if find_spec("optuna") is None:
        raise MissingDependencyError("--pareto needs optuna: pip install 'probedesign[optimize]'")


def front(
    search: Search,
    trials: int,
    seed: int,
    tell: Callable[[str, float | None], None],
    best: Optimum | None = None,
) -> Front:
    """Cones of any length that keep the limits: least error, least force, most reach.

    Args:
        search: the start, the task and the limits; what varies are base, tip, length and force.
        trials: bodies to look at.
        seed: of the search.
        tell: told how much is done.
        best: a body that was found already; looked at first if it is a cone.

    Raises:
        MissingDependencyError: optuna is not installed.
        InputError: no body among them keeps the limits.
    """
    check_installed()
    import optuna

    optuna.logging.set_verbosity(optuna.logging.ERROR)
    problem = Problem(Trial(Body.of(search.start, ("cone", "length")), search.task, True), search.kept)
    sampler = optuna.samplers.NSGAIISampler(population_size=min(POPULATION, max(trials, 2)), seed=seed)
    study = optuna.create_study(directions=["minimize", "minimize", "maximize"], sampler=sampler)
    if best is not None and best.design.probe.shape == "cone":
        study.enqueue_trial(_known(best.design, best.task.force_N / search.task.force_N))
    study.enqueue_trial(_known(search.start, 1.0))
    study.optimize(lambda drawn: _look(problem, drawn), n_trials=trials,
                   callbacks=[lambda _, t: tell("Pareto front", (t.number + 1) / trials)])  # fmt: skip
    kept = {trial.values[0]: trial for trial in study.best_trials if trial.user_attrs["keeps"]}
    if not kept:
        raise InputError(f"none of {trials} bodies keeps every limit; try more, or widen --subject-to")
    return Front(sorted((_row(trial) for trial in kept.values()), key=lambda row: row["error_mm"]), trials)


def _known(design: Design, force: float) -> dict[str, float]:
    """A body to begin with, at so many times the task's force."""
    probe = design.probe
    tip = probe.blunt_mm[-1][1]
    low, high = FORCES
    return {"base_d_mm": probe.base_d_mm, "taper": min(tip / probe.base_d_mm, 1.0), "length_mm": probe.length_mm,
            "force": min(max(force, low), high)}  # fmt: skip


def _look(problem: Problem, drawn: "Drawn") -> tuple[float, float, float]:
    base = drawn.suggest_float("base_d_mm", 2.0, WIDEST_MM, log=True)
    tip = base * drawn.suggest_float("taper", 0.05, 1.0, log=True)
    length = drawn.suggest_float("length_mm", *LENGTHS_MM)
    force = drawn.suggest_float("force", *FORCES, log=True)
    x: Array = np.array([base, tip, length / 10.0, np.log(force)])
    figures = problem.trial.figures(x)
    # What a search spares for rounding, the body that it found may have taken.
    broken = {c.text: -c.least(x) - SPARE for c in problem.constraints}
    broken["stands"] = 0.0 if problem.trial.stands(x) else 1.0
    for text, by in broken.items():
        drawn.set_constraint(text, by)
    drawn.set_user_attr("keeps", max(broken.values()) <= 0.0)
    told = {name: figures[name] for name in ("error_mm", "reach_mm", "sag_mm", "length_mm")}
    force_mN = 1e3 * problem.trial.task_at(x).force_N
    drawn.set_user_attr("row", {"base_d_mm": base, "tip_d_mm": tip, "force_mN": force_mN, **told})
    return figures["error_mm"], force_mN, figures["reach_mm"]


def _row(trial: "FrozenTrial") -> dict[str, float]:
    row: dict[str, Any] = trial.user_attrs["row"]
    return {name: float(row[name]) for name in _VARIABLES}
