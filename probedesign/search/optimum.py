"""The best body of a family, from several starts."""

import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from probedesign.design import Design, check_design
from probedesign.errors import InputError
from probedesign.frames import Array
from probedesign.probe import build_probe
from probedesign.search.body import DIGITS, Body, Free
from probedesign.search.goal import Goal, Limit, check_limits
from probedesign.search.problem import FORCES, Problem
from probedesign.search.task import Task, Vector
from probedesign.search.trial import Trial
from probedesign.search.worth import Worth, touches, worth
from probedesign.units import MM

STARTS = (1.0, 0.6)
"""Factors on the diameters of the design that is to be bettered, to start from."""
PLACES = tuple(round(0.2 + 0.05 * k, 2) for k in range(16))
"""Fractions of the length at which start and best are compared."""
AROUND = (0.5, 1.0, 2.0)
"""Factors on the task's forces at which they are."""
_THICKER, _TIMES = 1.25, 8
"""Factor on the diameters of a start that gives way, and how often: nothing leads a search out of there."""

Tell = Callable[[str, float | None], None]


@dataclass(frozen=True)
class Search:
    """What is sought.

    Attributes:
        start: the design to better.
        free: what of it may change.
        task: what it is for.
        goal: what is to be least.
        error_mm: to be reached, for the goal "force-for-error".
        limits: to keep, beside the rules of printing and the sensor's range.
    """

    start: Design
    free: tuple[Free, ...]
    task: Task
    goal: Goal = "error-at-force"
    error_mm: float | None = None
    limits: tuple[Limit, ...] = ()

    def __post_init__(self) -> None:
        """Raises InputError where the goals contradict."""
        if self.goal == "force-for-error" and self.error_mm is None:
            raise InputError("--goal force-for-error needs --error-mm, the error to be reached")
        if self.goal == "error-at-force" and self.error_mm is not None:
            raise InputError(
                f"--error-mm {self.error_mm:g} contradicts --goal error-at-force, which makes the error least; "
                "take --goal force-for-error, or --subject-to 'error_mm<=...'"
            )
        if self.error_mm is not None and not 0.0 < self.error_mm <= 1e3:
            raise InputError(f"--error-mm {self.error_mm:g} must lie in (0, 1000]")
        check_limits([*self.kept])
        self._check_length()

    def _check_length(self) -> None:
        """Raises InputError where a limit asks for another length than the one that is to stay."""
        length_mm = self.start.probe.length_mm
        for limit in self.limits:
            if limit.figure == "length_mm" and "length" not in self.free and limit.room(length_mm) < 0.0:
                raise InputError(
                    f"--subject-to {limit.text}: the length stays {length_mm:g} mm; name it too: --over ... length"
                )

    @property
    def kept(self) -> tuple[Limit, ...]:
        """All limits on figures: the sensor's range and the error to be reached among them."""
        wanted = () if self.error_mm is None else (Limit("error_mm", True, self.error_mm),)
        return (*self.limits, Limit("sensor_use", True, 1.0), *wanted)

    @property
    def problem(self) -> Problem:
        """For the solver."""
        body = Body.of(self.start, self.free)
        return Problem(Trial(body, self.task, self.goal == "force-for-error"), self.kept)


@dataclass(frozen=True)
class Worse:
    """A place and force at which the best body found errs more than the start.

    Attributes:
        contact_fraction: arclength of the touched section over the length.
        force_N: normal force; of several touches that of the strongest.
        gravity_base_m_s2: gravity in base axes.
        start_error_mm: RMS error of the start.
        best_error_mm: of the best body; None where it gives way.
    """

    contact_fraction: float
    force_N: float
    gravity_base_m_s2: Vector
    start_error_mm: float
    best_error_mm: float | None


@dataclass(frozen=True)
class Optimum:
    """The best body found.

    Attributes:
        design: it, under its name.
        task: with the force found, where the force was sought.
        before, after: what the start and it are worth in that task.
        binding: what keeps it from being better.
        looked: bodies computed.
        starts: what each start led to: error [mm] or force over the task's; None where limits are broken.
        worse: where the best body errs more than the start by more than a hundredth, over places and forces around
            those of the task.
    """

    design: Design
    task: Task
    before: Worth
    after: Worth
    binding: tuple[str, ...]
    looked: int
    starts: tuple[float | None, ...]
    worse: tuple[Worse, ...] = ()


def optimum(search: Search, name: str, tell: Tell) -> Optimum:
    """The best body.

    A free taper starts from the best cone too, so it is not worse than that.

    Args:
        search: what is sought.
        name: of the design found.
        tell: told what is at work.

    Raises:
        InputError: nothing keeps the limits; it says which ones bind.
    """
    problem, designs = search.problem, [search.start]
    if "taper" in search.free:
        cones = replace(search, free=tuple("cone" if part == "taper" else part for part in search.free))
        with suppress(InputError):  # where no cone will do, a taper still may
            designs.append(_named(cones.problem, _best(cones.problem, designs, tell)[0], "cone"))
    x, values = _best(problem, designs, tell)
    best, task = _named(problem, x, name), problem.trial.task_at(x)
    return Optimum(best, task, worth(search.start, task), worth(best, task), problem.touching(x),
                   problem.trial.looked, values, _worse(search.start, best, task))  # fmt: skip


def _worse(start: Design, best: Design, task: Task) -> tuple[Worse, ...]:
    """Places and forces, the task's own and around them, at which the best errs more than the start."""
    forces = tuple(sorted({factor * force for force in task.forces_N for factor in AROUND}))
    wide = replace(task, fractions=tuple(sorted({*PLACES, *task.fractions})), forces_N=forces)
    before, after = (touches(build_probe(design).model, wide, slipping=False) for design in (start, best))
    return tuple(
        Worse(*case, was / MM, now / MM if math.isfinite(now) else None)
        for case, was, now in zip(before.cases, before.errors, after.errors, strict=True)
        if math.isfinite(was) and not now <= 1.01 * was
    )


def _named(problem: Problem, x: Array, name: str) -> Design:
    body = problem.trial.body
    return check_design(body.tables(x[: body.size], DIGITS) | {"name": name})


def _best(problem: Problem, designs: list[Design], tell: Tell) -> tuple[Array, tuple[float | None, ...]]:
    """The best point from the designs given and from a thinner one, with what each led to."""
    starts, reached, values = _starts(problem, designs), list[Array](), list[float | None]()
    for n, x0 in enumerate(starts, 1):
        tell(f"{problem.trial.body.size} dimensions, start {n} of {len(starts)}", None)
        x = problem.solve(x0)
        good = problem.keeps(x)
        values.append(float(np.exp(problem.objective(x))) if good else None)
        reached += [x] if good else []
    if not reached:
        raise InputError(problem.why_not(starts))
    return min(reached, key=problem.objective), tuple(values)


def _starts(problem: Problem, designs: list[Design]) -> list[Array]:
    """The designs, and the first of them thinner, or shorter where its diameters stay."""
    body, found = problem.trial.body, list[Array]()
    for design, factor in [(designs[0], factor) for factor in STARTS] + [
        (design, 1.0) for design in designs[1:]
    ]:
        x = body.x_of(design)
        x[: body.controls or None] *= factor
        force = [float(np.log(FORCES[1]) / 2.0)] if problem.trial.with_force else []
        found.append(_standing(problem, problem.clipped(np.append(x, force))))
    return found


def _standing(problem: Problem, x: Array) -> Array:
    """The start, or one that is so much thicker that it bears the force; the same if none does."""
    thicker, diameters = x, slice(problem.trial.body.controls)
    for _ in range(_TIMES):
        if problem.trial.stands(thicker):
            return thicker
        thicker = thicker.copy()
        thicker[diameters] *= _THICKER
        thicker = problem.clipped(thicker)
    return x
