"""Touches of a probe over places, sides and forces, and what a reading of each is worth."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from probedesign.errors import InputError
from probedesign.estimation.error_sources import ErrorSources
from probedesign.estimation.estimator import Estimator
from probedesign.estimation.surface_contact_kernel import (
    BY_TOUCH,
    CENTRE,
    DEAD,
    NORMAL,
    OWN,
    POINT,
    ROWS,
    TOUCH,
    UNKNOWNS,
    VALUE,
    S,
)
from probedesign.frames import Array
from probedesign.prediction.budget import Budget, budget_of
from probedesign.prediction.model_touch import SurfaceRod
from probedesign.prediction.quantile import radii_95

DIRECTIONS = {"+x": 0.0, "-x": math.pi, "+y": math.pi / 2, "-y": -math.pi / 2}
"""Direction in which the object pushes, as an angle about the tangent from the section's x axis [rad]."""


@dataclass(frozen=True)
class Touches:
    """The touches of several lines, a line being one place and one side, at one normal force without friction.

    Rows of numbers are NaN where the probe gives way.

    Attributes:
        estimator: that the readings are for; its priors and its model's friction are those of the budget.
        sources: its error sources under the mount's gravity.
        force_N: normal force [N].
        touch: unknowns, dead loads and tip of each, (n, TOUCH).
        lin: linearisations, (n, ROWS, 1 + UNKNOWNS + parameters), see `surface_contact_kernel`.
        D: one standard deviation of each error source, (n, 12, J), see `ErrorSources.columns_at`.
        held: greatest normal force up to this one that each line holds [N], (n,).
    """

    estimator: Estimator
    sources: ErrorSources
    force_N: float
    touch: Array
    lin: Array
    D: Array
    held: Array

    @property
    def ok(self) -> NDArray[np.bool_]:
        """Which the probe holds, (n,)."""
        return np.asarray(np.isfinite(self.lin[:, 0, VALUE]))

    @property
    def wrench(self) -> Array:
        """At the base, free of noise [N, N·m], (n, 6)."""
        return self.lin[:, 0:6, VALUE]

    @property
    def centre(self) -> Array:
        """Points of the centreline where the forces act without a couple [m], (n, 3)."""
        return self.lin[:, CENTRE : CENTRE + 3, VALUE]

    @property
    def wrench_by_force(self) -> Array:
        """Change of the base wrench by a newton more, (n, 6)."""
        return self.lin[:, 0:6, BY_TOUCH + NORMAL]

    @cached_property
    def budget(self) -> Budget:
        """Errors of each."""
        return budget_of(self.touch, self.lin, self.D, self.sources, self.estimator.model.friction)

    @cached_property
    def rms(self) -> tuple[Array, Array]:
        """Error of the touched point by all causes and by the sensor's noise alone [m], (n,) each."""
        total, noise = (np.sqrt(np.trace(cov, axis1=1, axis2=2))
                        for cov in (self.budget.total, self.budget.cov_noise))  # fmt: skip
        return total, noise

    @cached_property
    def within_95(self) -> tuple[Array, Array]:
        """The distance that 95 of 100 such errors stay within [m], (n,) each."""
        return radii_95(self.budget.total), radii_95(self.budget.cov_noise)

    @cached_property
    def sensor_use(self) -> Array:
        """Largest share of a channel's range that the readings take, (n,)."""
        model = self.estimator.model
        read = model.to_sensor(self.wrench, model.gravity_base)
        return np.asarray((np.abs(read) / model.wrench_range).max(axis=1))

    @cached_property
    def press_per_N(self) -> Array:
        """How much further one newton more presses in, along the force [m/N], (n,)."""
        force = self.touch[:, DEAD : DEAD + 3]
        by = self.lin[:, POINT : POINT + 3, BY_TOUCH + NORMAL]
        return np.asarray(np.einsum("ni,ni->n", force, by) / np.linalg.norm(force, axis=1))

    @cached_property
    def free_centre(self) -> Array:
        """Where the free probe has the centreline's points that are touched [m], (n, 3)."""
        rod = self.estimator.model.rod
        at = [s - float(rod.radius_at(s)) * rod.taper_at(s) for s in np.nan_to_num(self.touch[:, S])]
        return self.estimator.free().p_at(np.clip(at, 0.0, rod.length))

    @cached_property
    def deflection(self) -> Array:
        """How far that point has moved from there [m], (n,)."""
        return np.asarray(np.linalg.norm(self.centre - self.free_centre, axis=1))

    def results(self) -> list[str]:
        """What the estimator answers to readings without noise; "gives_way" where the probe cannot push back so
        hard."""
        return [self._result(i) for i in range(len(self.touch))]

    def _result(self, i: int) -> str:
        if not self.ok[i]:
            return "gives_way"
        if self.sensor_use[i] > 1.0:
            return "out_of_range"
        if not self.estimator.detects(self.wrench[i]):
            return "no_contact"
        located = self.estimator.locates(float(self.budget.std_s[i]), self.touch[i, DEAD : DEAD + 3])
        return "ok" if located else "too_light"


def touches_of(
    estimator: Estimator, lines: Sequence[tuple[float, str]], forces_N: Sequence[float]
) -> dict[float, Touches]:
    """Touches of all lines, by force.

    Args:
        estimator: of a probe that can stand; its priors count.
        lines: contact fraction (arclength of the touched section over the length) and direction of each.
        forces_N: normal forces [N], in any order.
    """
    model, forces = estimator.model, sorted(set(forces_N))
    gravity = model.gravity_base
    free = estimator.free()
    sources = ErrorSources.of(model, estimator.priors, gravity, free)
    on = SurfaceRod(model.rod, gravity, model.mass, free)
    n, m = len(lines), len(forces)
    touch = np.full((m, n, TOUCH), np.nan)
    lin = np.full((m, n, ROWS, 1 + UNKNOWNS + OWN + len(model.rod.s)), np.nan)
    D = np.full((m, n, 12, len(sources.names)), np.nan)
    held = np.zeros((m, n))
    for i, (fraction, direction) in enumerate(lines):
        # An object that pushes towards +x touches the side at -x.
        press = on.press(fraction * model.rod.length, DIRECTIONS[direction] + math.pi)
        for j, force in enumerate(forces):
            found = press.to(force)
            held[j:, i] = press.force
            if found is None:
                break
            touch[j, i] = found
            lin[j, i], D[j, i] = sources.columns_at(touch[j, i])
    return {
        force: Touches(estimator, sources, force, touch[j], lin[j], D[j], held[j])
        for j, force in enumerate(forces)
    }


def check_grid(fractions: Sequence[float], forces_N: Sequence[float], directions: Sequence[str]) -> None:
    """Refuse touches that make no sense.

    Raises:
        InputError: a fraction, force or direction is none.
    """
    for fraction in fractions:
        if not 0.0 < fraction <= 1.0:
            raise InputError(f"contact fraction {fraction:g} must lie in (0, 1]")
    for force in forces_N:
        if not 0.0 < force <= 100.0:
            raise InputError(f"force {force:g} N must lie in (0, 100]")
    for direction in directions:
        if direction not in DIRECTIONS:
            raise InputError(f"direction '{direction}' is unknown; known: {', '.join(DIRECTIONS)}")
