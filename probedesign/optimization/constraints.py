"""The optimisation problem: goal and limits on metrics as users state them, and its solution by sequential quadratic
programming."""

import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, NamedTuple

import numpy as np
from scipy.optimize import minimize

from probedesign.core.errors import InputError, unknown_name
from probedesign.core.frames import Array
from probedesign.design import Design
from probedesign.optimization.design_space import (
    SAFETY_FACTOR,
    SOUGHT,
    DesignEvaluator,
    DesignSpace,
    FreeParameter,
    finite_differences,
)
from probedesign.optimization.objective import Task

Goal = Literal["error-at-force", "force-for-error"]
NO_WARNINGS = "print_warnings"
#: Metrics that may be limited. `buckling_margin` is the critical load over the task's force; `print_warnings` can only
#: be excluded.
LIMITED_METRICS = (
    "error_mm", "worst_error_mm", "sag_mm", "reach_mm", "tip_offset_mm", "distinction", "sensor_use", "slide_mm",
    "mass_g", "length_mm", "thinnest_mm", "detectable_mN", "buckling_margin", "natural_frequency_Hz", NO_WARNINGS,
)  # fmt: skip
_LIMIT = re.compile(r"\s*([A-Za-z_]+)\s*(<=|>=)\s*(\S+)\s*")


@dataclass(frozen=True)
class Limit:
    """A bound on a metric."""

    metric: str  #: one of `LIMITED_METRICS`.
    is_upper: bool  #: whether it is an upper bound.
    value: float  #: in the unit at the end of the metric's name.

    @property
    def text(self) -> str:
        """Return the limit as it is written on the command line."""
        return f"{self.metric} {'<=' if self.is_upper else '>='} {self.value:g}"

    def margin(self, figure: float) -> float:
        """Return the distance to the bound relative to its value; negative where the limit is violated."""
        distance = self.value - figure if self.is_upper else figure - self.value
        return distance / abs(self.value)


def parse_limit(text: str) -> Limit:
    """Parse a limit such as `sag_mm<=60` or `reach_mm>=100`.

    Raises:
        InputError: the text is not a limit, or the metric is unknown.
    """
    match = _LIMIT.fullmatch(text)
    if match is None:
        raise InputError(f"--subject-to {text!r}: write FIGURE<=NUMBER or FIGURE>=NUMBER, such as 'sag_mm<=60'")
    figure, sign, number = match.groups()
    if figure not in LIMITED_METRICS:
        raise unknown_name("--subject-to", figure, LIMITED_METRICS)
    try:
        value = float(number)
    except ValueError:
        value = float("nan")
    if figure == NO_WARNINGS:
        if sign != "<=" or value != 0.0:
            raise InputError(f"--subject-to {text!r}: a count cannot be limited; write '{NO_WARNINGS}<=0'")
    elif not 0.0 < value < 1e9:
        raise InputError(f"--subject-to {text!r}: {number} must be a positive number")
    return Limit(figure, sign == "<=", value)


def check_limits(limits: list[Limit]) -> None:
    """Check that limits do not contradict each other by themselves.

    Raises:
        InputError: a metric would have to be above and below.
    """
    for low in limits:
        for high in limits:
            if low.metric == high.metric and not low.is_upper and high.is_upper and low.value > high.value:
                raise InputError(f"--subject-to {low.text} and {high.text} contradict; drop one of them")


SPARE = 1e-3  #: Relative margin of a limit during the search, so that rounding the dimensions does not violate it.
FORCES = (0.05, 20.0)  #: Bounds of the optimised force, over the task's.
_OPTIONS = {"maxiter": 40, "ftol": 1e-4}  # of a logarithm: smaller improvements of the error do not matter
#: Searches from one start, and halvings of the way back from one that ended beyond a limit: to a hundredth.
_SEARCHES, _HALVINGS = 4, 7
#: Slide that is allowed at the tip itself, where every press would otherwise count as slipping off.
_SLIP_ALLOWANCE_MM = 0.5
_BROKEN = 1e-6
#: Constraints violated by this fraction of the largest violation, at the least infeasible point, are reported as
#: conflicting.
_CONFLICT_SHARE = 0.5


class Constraint(NamedTuple):
    """An inequality constraint: its margin must not be negative."""

    text: str  #: name for users.
    margin: Callable[[Array], Array]  #: of a point, one number or several.
    slope: Callable[[Array], Array]  #: derivatives of the margin.

    def min_margin(self, x: Array) -> float:
        """Return the smallest margin."""
        return float(np.min(self.margin(x)))


def _by_differences(text: str, margin: Callable[[Array], Array], central: bool) -> Constraint:
    return Constraint(text, margin, lambda x: finite_differences(margin, x, central=central).T)


@dataclass(frozen=True)
class NonlinearProgram:
    """The objective over a design space, with its constraints."""

    evaluator: DesignEvaluator  #: the design space with its task.
    limits: tuple[Limit, ...]  #: on its metrics.

    def objective(self, x: Array) -> float:
        """Return the logarithm of the error [mm], or of the force over the task's where the force is minimised."""
        return float(x[-1] if self.evaluator.with_force else np.log(self.evaluator.metrics(x)[SOUGHT]))

    def slope(self, x: Array) -> Array:
        """Return the gradient of the objective, (n,)."""
        if self.evaluator.with_force:
            return np.asarray(np.eye(len(x))[-1])
        return np.asarray(self.evaluator.gradient(SOUGHT, x) / self.evaluator.metrics(x)[SOUGHT])

    @property
    def bounds(self) -> list[tuple[float, float]]:
        """Return the lower and upper bound of each coordinate."""
        low, high = (float(np.log(force)) for force in FORCES)
        return [*self.evaluator.space.bounds, *([(low, high)] if self.evaluator.with_force else [])]

    def clip(self, x: Array) -> Array:
        """Return the point within its bounds."""
        low, high = np.array(self.bounds).T
        return np.asarray(np.clip(x, low, high))

    @cached_property
    def constraints(self) -> list[Constraint]:
        """Return one constraint for each limit and print rule, for buckling and for slipping."""
        space = self.evaluator.space
        rules = space.printable(space.x_of(space.start), without_warnings=self.without_warnings)
        limits = [self._limit(limit) for limit in self.limits if limit.metric != NO_WARNINGS]
        task, metrics = self.evaluator.task, self.evaluator.metrics

        def bears(x: Array) -> Array:
            return np.array([np.log(metrics(x)["critical_load"] / SAFETY_FACTOR) - SPARE])

        def slips(x: Array) -> Array:
            left = (1.0 - max(task.fractions)) * metrics(x)["length_mm"] + _SLIP_ALLOWANCE_MM
            return np.array([np.log(left / metrics(x)["slide_mm"]) - SPARE])

        def printable(name: str) -> Callable[[Array], Array]:
            return lambda x: space.printable(x[: space.size], without_warnings=self.without_warnings)[name]

        return [
            *limits,
            _by_differences(f"bears {SAFETY_FACTOR:g} x the force", bears, central=False),
            *([_by_differences("does not slip off", slips, central=False)] if task.touches > 1 else []),
            *(_by_differences(name, printable(name), central=True) for name in rules),
        ]

    @property
    def without_warnings(self) -> bool:
        """Return whether designs with warnings of the print check are excluded."""
        return any(limit.metric == NO_WARNINGS for limit in self.limits)

    def _limit(self, limit: Limit) -> Constraint:
        # In logarithms: an error may be a hundred times too large, and SQP linearises the constraints.
        sign, name, evaluator = (-1.0 if limit.is_upper else 1.0), limit.metric, self.evaluator
        return Constraint(
            limit.text,
            lambda x: np.array([sign * np.log(evaluator.metrics(x)[name] / limit.value) - SPARE]),
            lambda x: sign * evaluator.gradient(name, x)[None] / evaluator.metrics(x)[name],
        )

    def solve(self, x0: Array) -> Array:
        """Return the local optimum reached from a start; feasible if the start is, or if it is found so.

        A search that ends beyond a limit, where for example the object slides off and no derivative leads back, is
        taken back towards a feasible start as far as needed, and begins there anew.
        """
        constraints = [{"type": "ineq", "fun": c.margin, "jac": c.slope} for c in self.constraints]
        for _ in range(_SEARCHES):
            x = self._slsqp(self.objective, self.slope, x0, self.bounds, constraints)
            if self.is_feasible(x) or not self.is_feasible(x0):
                return x
            for _ in range(_HALVINGS):
                middle = 0.5 * (x0 + x)
                x0, x = (middle, x) if self.is_feasible(middle) else (x0, middle)
        return x0

    def is_feasible(self, x: Array) -> bool:
        """Return whether every constraint is satisfied."""
        return all(c.min_margin(x) >= -SPARE for c in self.constraints)

    def active_constraints(self, x: Array) -> tuple[str, ...]:
        """Return the names of the constraints with no margin left."""
        return tuple(c.text for c in self.constraints if c.min_margin(x) < 5.0 * SPARE)

    def infeasibility_report(self, starts: list[Array]) -> str:
        """Return a message with the conflicting constraints at the least infeasible point."""
        nearest = min(map(self._least_infeasible, starts), key=self._max_violation)
        limit, conflicts = -_CONFLICT_SHARE * self._max_violation(nearest), []
        metrics, of = self.evaluator.metrics(nearest), {limit.text: limit.metric for limit in self.limits}
        for c in self.constraints:
            if c.min_margin(nearest) <= limit:
                conflicts.append(f"{c.text} (there {metrics[of[c.text]]:.4g})" if c.text in of else c.text)
        where = "no design satisfies every limit; at the least infeasible design these limits conflict"
        return f"{where}: {'; '.join(conflicts)}"

    def _max_violation(self, x: Array) -> float:
        return max(_BROKEN, *(-c.min_margin(x) for c in self.constraints))

    def _least_infeasible(self, x0: Array) -> Array:
        """Return the point whose largest violation is smallest: a slack added to every margin is minimised."""

        def slope(z: Array, c: Constraint) -> Array:
            rows = c.slope(z[:-1])
            return np.hstack([rows, np.ones((len(rows), 1))])

        constraints = [
            {"type": "ineq", "fun": lambda z, c=c: c.margin(z[:-1]) + z[-1], "jac": lambda z, c=c: slope(z, c)}
            for c in self.constraints
        ]
        start, bounds = np.append(x0, self._max_violation(x0)), [*self.bounds, (0.0, 1e3)]
        z = self._slsqp(lambda z: float(z[-1]), lambda z: np.eye(len(z))[-1], start, bounds, constraints)
        return self.clip(z[:-1])

    def _slsqp(self, f: Callable[[Array], float], slope: Callable[[Array], Array], x0: Array,
               bounds: list[tuple[float, float]], constraints: list[dict[str, Any]]) -> Array:  # fmt: skip
        solve: Any = minimize  # its stubs have no overload for a list of constraints
        solution = solve(f, x0, jac=slope, method="SLSQP", bounds=bounds, constraints=constraints, options=_OPTIONS)
        low, high = np.array(bounds).T
        return np.asarray(np.clip(solution.x, low, high))


@dataclass(frozen=True)
class OptimizationProblem:
    """Statement of an optimisation."""

    start: Design  #: the design to improve.
    free: tuple[FreeParameter, ...]  #: what of it may change.
    task: Task  #: by which designs are judged.
    goal: Goal = "error-at-force"  #: what is minimised.
    error_mm: float | None = None  #: to be reached, for the goal "force-for-error".
    limits: tuple[Limit, ...] = ()  #: on metrics, in addition to the print rules and the sensor's range.

    def __post_init__(self) -> None:
        """Raise InputError if the options contradict each other."""
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
        length_mm = self.start.probe.length_mm
        for limit in self.limits:
            if limit.metric == "length_mm" and "length" not in self.free and limit.margin(length_mm) < 0.0:
                raise InputError(
                    f"--subject-to {limit.text}: the length stays {length_mm:g} mm; name it too: --over ... length"
                )

    @property
    def all_limits(self) -> tuple[Limit, ...]:
        """Return all limits on metrics, including the sensor's range and the error to be reached."""
        wanted = () if self.error_mm is None else (Limit("error_mm", True, self.error_mm),)
        return (*self.limits, Limit("sensor_use", True, 1.0), *wanted)

    @cached_property
    def problem(self) -> NonlinearProgram:
        """Return the problem in the form of the solver."""
        space = DesignSpace.of(self.start, self.free)
        limits = self.all_limits
        margins = [limit.value for limit in limits if limit.metric == "buckling_margin"]
        max_load = 1.1 * max([SAFETY_FACTOR, *margins])  # beyond the limit, so that the constraint is smooth there
        limited = frozenset(limit.metric for limit in limits)
        with_force = self.goal == "force-for-error"
        return NonlinearProgram(DesignEvaluator(space, self.task, with_force, limited, max_load), limits)
