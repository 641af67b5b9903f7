"""The search as sequential quadratic programming takes it: minimise a logarithm, keep every constraint's room."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import minimize

from probedesign.frames import Array
from probedesign.search.goal import Limit
from probedesign.search.trial import HELD, Trial, differences

SPARE = 1e-3
"""Share of a limit that is kept free, so that rounding the dimensions does not break it."""
FORCES = (0.05, 20.0)
"""Least and most force sought for an error, over the task's."""
_OPTIONS = {"maxiter": 40, "ftol": 1e-4}  # of a logarithm: a ten-thousandth of an error is no better body
_SHORT_MM = 0.5
"""Slide that is let pass at the tip itself, where every press would else count as slipping off."""
_BROKEN = 1e-6
_AGAINST = 0.5
"""Constraints broken by this share of the worst, where the worst is broken least, stand against each other."""


class Constraint(NamedTuple):
    """What must not be negative.

    Attributes:
        text: for people.
        room: of a point: how far it is kept, one number or several.
        slope: their derivatives.
    """

    text: str
    room: Callable[[Array], Array]
    slope: Callable[[Array], Array]

    def least(self, x: Array) -> float:
        """The worst of it."""
        return float(np.min(self.room(x)))


@dataclass(frozen=True)
class Problem:
    """What is minimised over a family of bodies, and what is kept.

    Attributes:
        trial: the family in its task.
        limits: on its figures.
    """

    trial: Trial
    limits: tuple[Limit, ...]

    def objective(self, x: Array) -> float:
        """Logarithm of the error [mm], or of the force over the task's where that is sought."""
        return float(x[-1] if self.trial.with_force else np.log(self.trial.figures(x)["error_mm"]))

    def slope(self, x: Array) -> Array:
        """Of the objective, (n,)."""
        if self.trial.with_force:
            last: Array = np.eye(len(x))[-1]
            return last
        by_error: Array = self.trial.gradient("error_mm", x) / self.trial.figures(x)["error_mm"]
        return by_error

    @property
    def bounds(self) -> list[tuple[float, float]]:
        """Of every number of a point."""
        low, high = (float(np.log(force)) for force in FORCES)
        return [*self.trial.body.bounds, *([(low, high)] if self.trial.with_force else [])]

    def clipped(self, x: Array) -> Array:
        """Within its bounds."""
        low, high = np.array(self.bounds).T
        found: Array = np.clip(x, low, high)
        return found

    @cached_property
    def constraints(self) -> list[Constraint]:
        """One a limit, and one a rule of printing."""
        rules = self.trial.body.printable(self.trial.body.x_of(self.trial.body.start))
        slips = [self._staying] if self.trial.task.touches > 1 else []
        return [*map(self._limit, self.limits), self._bearing, *slips, *map(self._rule, rules)]

    @property
    def _staying(self) -> Constraint:
        """That the object does not slip off the tip as the base presses on."""
        trial = self.trial

        def room(x: Array) -> Array:
            # From the outermost place on: a slide that long ends at the tip.
            left = (1.0 - max(trial.task.fractions)) * trial.figures(x)["length_mm"] + _SHORT_MM
            return np.array([np.log(left / trial.figures(x)["slide_mm"]) - SPARE])

        return Constraint("does not slip off", room, lambda x: differences(room, x, central=False).T)

    @property
    def _bearing(self) -> Constraint:
        """That a body bears more than the task's force."""
        trial = self.trial

        def room(x: Array) -> Array:
            return np.array([np.log(trial.figures(x)["borne"] / HELD) - SPARE])

        return Constraint(
            f"bears {HELD:g} x the force", room, lambda x: differences(room, x, central=False).T
        )

    def _limit(self, limit: Limit) -> Constraint:
        # In logarithms: an error may be a hundred times too large, and a search lives by straight lines.
        sign, name, trial = (-1.0 if limit.at_most else 1.0), limit.figure, self.trial
        return Constraint(
            limit.text,
            lambda x: np.array([sign * np.log(trial.figures(x)[name] / limit.value) - SPARE]),
            lambda x: sign * trial.gradient(name, x)[None] / trial.figures(x)[name],
        )

    def _rule(self, name: str) -> Constraint:
        body = self.trial.body

        def room(x: Array) -> Array:
            return body.printable(x[: body.size])[name]

        def slope(x: Array) -> Array:
            return differences(room, x, central=True).T

        return Constraint(name, room, slope)

    def solve(self, x0: Array) -> Array:
        """From one start to the optimum near it, wherever that ends."""
        kept = [{"type": "ineq", "fun": c.room, "jac": c.slope} for c in self.constraints]
        return self._slsqp(self.objective, self.slope, x0, self.bounds, kept)

    def keeps(self, x: Array) -> bool:
        """Whether every limit is kept there."""
        return all(c.least(x) >= -SPARE for c in self.constraints)

    def touching(self, x: Array) -> tuple[str, ...]:
        """The constraints that a point lies on."""
        return tuple(c.text for c in self.constraints if c.least(x) < 5.0 * SPARE)

    def why_not(self, starts: list[Array]) -> str:
        """Which constraints stand against each other, where the worst of them is broken least."""
        nearest = min((self._nearest(x0) for x0 in starts), key=self._worst)
        limit, against = -_AGAINST * self._worst(nearest), []
        figures, of = self.trial.figures(nearest), {limit.text: limit.figure for limit in self.limits}
        for c in self.constraints:
            if c.least(nearest) <= limit:
                against.append(f"{c.text} (there {figures[of[c.text]]:.4g})" if c.text in of else c.text)
        return (
            f"no body keeps every limit; at the one that breaks them least these bind: {'; '.join(against)}"
        )

    def _worst(self, x: Array) -> float:
        """How far the worst constraint is broken."""
        return max(_BROKEN, *(-c.least(x) for c in self.constraints))

    def _nearest(self, x0: Array) -> Array:
        """Where the worst is broken least: a number t is added to every constraint's room and minimised."""

        def slope(z: Array, c: Constraint) -> Array:
            rows = c.slope(z[:-1])
            return np.hstack([rows, np.ones((len(rows), 1))])

        kept = [
            {"type": "ineq", "fun": lambda z, c=c: c.room(z[:-1]) + z[-1], "jac": lambda z, c=c: slope(z, c)}
            for c in self.constraints
        ]  # fmt: skip
        start, bounds = np.append(x0, self._worst(x0)), [*self.bounds, (0.0, 1e3)]
        z = self._slsqp(lambda z: float(z[-1]), lambda z: np.eye(len(z))[-1], start, bounds, kept)
        return self.clipped(z[:-1])

    def _slsqp(self, f: Callable[[Array], float], slope: Callable[[Array], Array], x0: Array,
               bounds: list[tuple[float, float]], kept: list[dict[str, Any]]) -> Array:  # fmt: skip
        options: Any = _OPTIONS
        answer: Any = minimize(
            f, x0, jac=slope, method="SLSQP", bounds=bounds, constraints=kept, options=options
        )  # type: ignore[call-overload]
        low, high = np.array(bounds).T
        found: Array = np.clip(answer.x, low, high)
        return found
