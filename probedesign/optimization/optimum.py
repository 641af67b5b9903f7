"""Optimisation of a design from several starts, and its result."""

import math
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from probedesign.core.errors import InputError
from probedesign.core.frames import Array
from probedesign.core.parallel import OnProgress
from probedesign.core.units import MM
from probedesign.design import Design, check_design
from probedesign.design.io import render_design
from probedesign.optimization.constraints import FORCES, Goal, Limit, NonlinearProgram, check_limits
from probedesign.optimization.design_space import DIGITS, DesignSpace, FreeParameter
from probedesign.optimization.evaluator import DesignEvaluator
from probedesign.optimization.grid import design_dict
from probedesign.optimization.objective import DesignMetrics, design_metrics, predict_task
from probedesign.optimization.task import Task, Vector
from probedesign.probe import build_probe

if TYPE_CHECKING:
    from probedesign.optimization.confirm import MonteCarloCheck
    from probedesign.optimization.pareto import ParetoFront

STARTS = (1.0, 0.6)
"""Factors on the diameters of the design, one start each."""
PLACES = tuple(round(0.2 + 0.05 * k, 2) for k in range(16))
"""Contact fractions at which start and optimum are compared."""
AROUND = (0.5, 1.0, 2.0)
"""Factors on the task's forces at which they are compared."""
_THICKER, _TIMES = 1.25, 8
"""Factor on the diameters of a start that gives way, and how often: nothing leads a search out of there."""


@dataclass(frozen=True)
class OptimizationProblem:
    """Statement of an optimisation.

    Attributes:
        start: the design to improve.
        free: what of it may change.
        task: by which designs are judged.
        goal: what is minimised.
        error_mm: to be reached, for the goal "force-for-error".
        limits: on metrics, in addition to the print rules and the sensor's range.
    """

    start: Design
    free: tuple[FreeParameter, ...]
    task: Task
    goal: Goal = "error-at-force"
    error_mm: float | None = None
    limits: tuple[Limit, ...] = ()

    def __post_init__(self) -> None:
        """Raises InputError where the options contradict."""
        if self.goal == "force-for-error" and self.error_mm is None:
            raise InputError("--goal force-for-error needs --error-mm, the error to be reached")
        if self.goal == "error-at-force" and self.error_mm is not None:
            raise InputError(
                f"--error-mm {self.error_mm:g} contradicts --goal error-at-force, which minimises the error; "
                "use --goal force-for-error, or --subject-to 'error_mm<=...'"
            )
        if self.error_mm is not None and not 0.0 < self.error_mm <= 1e3:
            raise InputError(f"--error-mm {self.error_mm:g} must lie in (0, 1000]")
        check_limits([*self.all_limits])
        self._check_length()

    def _check_length(self) -> None:
        """Raises InputError where a limit requires another length although the length is fixed."""
        length_mm = self.start.probe.length_mm
        for limit in self.limits:
            if limit.metric == "length_mm" and "length" not in self.free and limit.margin(length_mm) < 0.0:
                raise InputError(
                    f"--subject-to {limit.text}: the length stays {length_mm:g} mm; name it too: --over ... length"
                )

    @property
    def all_limits(self) -> tuple[Limit, ...]:
        """All limits on metrics, including the sensor's range and the error to be reached."""
        wanted = () if self.error_mm is None else (Limit("error_mm", True, self.error_mm),)
        return (*self.limits, Limit("sensor_use", True, 1.0), *wanted)

    @property
    def problem(self) -> NonlinearProgram:
        """The problem in the form of the solver."""
        space = DesignSpace.of(self.start, self.free)
        return NonlinearProgram(
            DesignEvaluator(space, self.task, self.goal == "force-for-error"), self.all_limits
        )


@dataclass(frozen=True)
class WorseCase:
    """A position and force at which the optimum has a larger error than the start.

    Attributes:
        contact_fraction: arclength of the touched section over the length.
        force_N: normal force; of several touches the largest.
        gravity_base_m_s2: gravity in base axes.
        start_error_mm: RMS error of the start.
        best_error_mm: of the optimum; None where it buckles.
    """

    contact_fraction: float
    force_N: float
    gravity_base_m_s2: Vector
    start_error_mm: float
    best_error_mm: float | None


@dataclass(frozen=True)
class Optimum:
    """The best design found.

    Attributes:
        design: under its new name.
        task: with the optimised force, where the force is minimised.
        before, after: metrics of the start and of the optimum for that task.
        active_constraints: names of the constraints that limit it.
        n_evaluations: number of designs computed.
        starts: result of each start: error [mm] or force over the task's; None where it is infeasible.
        worse: cases in which the optimum has an error more than 1 % larger than the start, over positions and forces
            around those of the task.
    """

    design: Design
    task: Task
    before: DesignMetrics
    after: DesignMetrics
    active_constraints: tuple[str, ...]
    n_evaluations: int
    starts: tuple[float | None, ...]
    worse: tuple[WorseCase, ...] = ()


def optimum(search: OptimizationProblem, name: str, on_progress: OnProgress) -> Optimum:
    """Return the best design.

    A free taper is also started from the best cone, so it is not worse than that.

    Args:
        search: statement of the problem.
        name: of the resulting design.
        on_progress: receives the current step.

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
    return Optimum(
        best, task, design_metrics(search.start, task), design_metrics(best, task), problem.active_constraints(x),
        problem.evaluator.n_evaluations, values, _worse(search.start, best, task),
    )  # fmt: skip


def _worse(start: Design, best: Design, task: Task) -> tuple[WorseCase, ...]:
    """Return the cases, at and around the task's, in which the optimum has a larger error than the start."""
    forces = tuple(sorted({factor * force for force in task.forces_N for factor in AROUND}))
    wide = replace(task, fractions=tuple(sorted({*PLACES, *task.fractions})), forces_N=forces)
    before, after = (
        predict_task(build_probe(design).model, wide, slipping=False) for design in (start, best)
    )
    return tuple(
        WorseCase(*case, was / MM, now / MM if math.isfinite(now) else None)
        for case, was, now in zip(before.cases, before.errors, after.errors, strict=True)
        if math.isfinite(was) and not now <= 1.01 * was
    )


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
    """Return the designs, and the first of them thinner, or shorter where its diameters are fixed."""
    space, found = problem.evaluator.space, list[Array]()
    for design, factor in [(designs[0], factor) for factor in STARTS] + [
        (design, 1.0) for design in designs[1:]
    ]:
        x = space.x_of(design)
        x[: space.controls or None] *= factor
        force = [float(np.log(FORCES[1]) / 2.0)] if problem.evaluator.with_force else []
        found.append(_stable_start(problem, problem.clip(np.append(x, force))))
    return found


def _stable_start(problem: NonlinearProgram, x: Array) -> Array:
    """Return the start, or one thick enough to be stable under the force; unchanged if none is."""
    thicker, diameters = x, slice(problem.evaluator.space.controls)
    for _ in range(_TIMES):
        if problem.evaluator.is_stable(thicker):
            return thicker
        thicker = thicker.copy()
        thicker[diameters] *= _THICKER
        thicker = problem.clip(thicker)
    return x


@dataclass(frozen=True)
class OptimizeResult:
    """Result of `optimize`.

    Attributes:
        search: statement of the problem.
        optimum: the best design.
        confirmed: Monte Carlo check of start and optimum; None if not requested, or for a start that buckles.
        front: Pareto front; None if not requested.
        files: written.
    """

    search: OptimizationProblem
    optimum: Optimum
    confirmed: "tuple[MonteCarloCheck | None, MonteCarloCheck] | None"
    front: "ParetoFront | None"
    files: tuple[Path, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """Return plain data for JSON."""
        best, confirmed = self.optimum, self.confirmed
        return {
            "schema": 1,
            "goal": self.search.goal,
            "task": asdict(best.task),
            "subject_to": [limit.text for limit in self.search.limits],
            "start": best.before.as_dict(),
            "best": best.after.as_dict(),
            "design": design_dict(best.design),
            "binding": list(best.active_constraints),
            "bodies_looked_at": best.n_evaluations,
            "worse_than_start": [asdict(row) for row in best.worse],
            "confirmed": None
            if confirmed is None
            else {
                name: None if one is None else asdict(one)
                for name, one in zip(("start", "best"), confirmed, strict=True)
            },
            "front": None if self.front is None else self.front.rows,
            "files": [str(file) for file in self.files],
        }


def design_text(search: OptimizationProblem, found: Optimum) -> str:
    """Return the design file of the optimum; its first lines describe the task and the result."""
    before, after = found.before.error_mm, found.after.error_mm
    was = "none: it buckles" if before is None else f"{before:.3g} mm"
    kept = ", ".join(limit.text for limit in search.limits) or "no further limits"
    about = (
        f"Optimised for {search.goal} from {search.start.name}; {kept}.\n"
        f"{found.task.text}:\npredicted error {after:.3g} mm by all error sources; {search.start.name}: {was}."
    )
    return render_design(found.design, {"": about})
