"""Touches of a probe over places, sides and forces, solved together, with what a reading of each would be worth."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from probedesign.errors import InputError
from probedesign.estimation.estimator import Estimator
from probedesign.estimation.tolerances import Tolerances
from probedesign.frames import Array
from probedesign.prediction.budget import Budget, budget_of
from probedesign.prediction.quantile import radii_95
from probedesign.rod.contacts import Contacts, follow_contacts

DIRECTIONS = {"+x": 0.0, "-x": math.pi, "+y": math.pi / 2, "-y": -math.pi / 2}
"""Way the object pushes, as an angle about the tangent from the section's x axis [rad]."""


@dataclass(frozen=True)
class Touches:
    """The touches of several lines, a line being one place and one side, at one force.

    Attributes:
        estimator: of the probe.
        tolerances: how well the probe is known.
        contacts: one a line, with all columns.
        weighed: whether readings are weighed by the tolerances, or the probe is taken as exact.
    """

    estimator: Estimator
    tolerances: Tolerances
    contacts: Contacts
    weighed: bool = True

    @cached_property
    def budget(self) -> Budget:
        """Of each line."""
        model = self.estimator.model
        return budget_of(self.contacts, model, model.gravity_base, self.tolerances, weighed=self.weighed)

    @cached_property
    def rms(self) -> tuple[Array, Array]:
        """Error of the contact point by the sensor's noise alone and by all causes [m], (n,) each."""
        noise, total = (np.sqrt(np.trace(cov, axis1=1, axis2=2))
                        for cov in (self.budget.cov_noise, self.budget.total))  # fmt: skip
        return noise, total

    @cached_property
    def within_95(self) -> tuple[Array, Array]:
        """The distance that 95 of 100 such errors stay within [m], (n,) each."""
        return radii_95(self.budget.cov_noise), radii_95(self.budget.total)

    @cached_property
    def sensor_use(self) -> Array:
        """Largest share of a channel's range that the readings take, (n,)."""
        model = self.estimator.model
        read = model.to_sensor(self.contacts.batch.wrench_base, model.gravity_base)
        return np.asarray((np.abs(read) / model.wrench_range).max(axis=1))

    @cached_property
    def press_per_N(self) -> Array:
        """How much further one newton more presses in [m/N], (n,)."""
        c = self.contacts
        return np.asarray(np.einsum("ni,ni->n", c.force, c.d_point_by_touch[:, :, 2]) / c.magnitude)

    @cached_property
    def deflection(self) -> Array:
        """How far the touched point is from where the free probe has it [m], (n,)."""
        free = self.estimator.free().p_at(self.contacts.s)
        return np.asarray(np.linalg.norm(self.contacts.batch.p_contact_base - free, axis=1))

    def results(self) -> list[str]:
        """What the estimator would say of readings without noise; "gives_way" where the probe cannot push back so
        hard."""
        return [self._result(i) for i in range(len(self.contacts.s))]

    def _result(self, i: int) -> str:
        if not self.contacts.ok[i]:
            return "gives_way"
        if self.sensor_use[i] > 1.0:
            return "out_of_range"
        if not self.judge.detects(self.contacts.batch.wrench_base[i]):
            return "no_contact"
        std_s = math.sqrt(self.budget.cov_touch[i, 0, 0])
        return "ok" if self.judge.locates(std_s, self.contacts.force[i]) else "too_light"

    @cached_property
    def judge(self) -> Estimator:
        """The estimator that the readings are for."""
        return self.estimator.with_tolerances(self.tolerances) if self.weighed else self.estimator


def touches_of(
    estimator: Estimator,
    tolerances: Tolerances,
    lines: Sequence[tuple[float, str]],
    forces_N: Sequence[float],
    weighed: bool = True,
) -> dict[float, Touches]:
    """Touches of all lines, by force.

    Args:
        estimator: of a probe that can stand.
        tolerances: how well the probe is known.
        lines: contact fraction and direction of each.
        forces_N: how hard [N], in any order.
        weighed: see `Touches`.
    """
    model = estimator.model
    s = np.array([fraction for fraction, _ in lines]) * model.rod.length
    angle = np.array([DIRECTIONS[direction] for _, direction in lines])
    forces = sorted(set(forces_N))
    steps = follow_contacts(model.rod, model.gravity_base, s, angle, forces)
    return {
        force: Touches(estimator, tolerances, step, weighed)
        for force, step in zip(forces, steps, strict=True)
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
