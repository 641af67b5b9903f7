"""Task of a probe: forces, positions, gravity, number of touches, and which parts of the readings are used."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple

import numpy as np

from probedesign.core.errors import InputError
from probedesign.core.frames import Array
from probedesign.estimation.fused import MomentsAbout
from probedesign.estimation.model import ProbeModel
from probedesign.estimation.tolerances import Tolerances
from probedesign.prediction.fused import MAX_TOUCHES, PressSchedule

FRACTIONS = (0.4, 0.5, 0.6, 0.7, 0.8, 0.9)
"""Contact positions over the length whose error is averaged: the part that touches, without the tip itself."""
MAX_GRAVITY = 100.0
"""Largest gravity of a task on each axis [m/s²]."""
Combine = Literal["mean", "worst"]
Vector = tuple[float, float, float]


class Case(NamedTuple):
    """One position, force and gravity of a task.

    Attributes:
        contact_fraction: arclength of the touched section over the length.
        force_N: normal force; of several touches the largest.
        gravity_base_m_s2: gravity in base axes.
    """

    contact_fraction: float
    force_N: float
    gravity_base_m_s2: Vector


@dataclass(frozen=True)
class Task:
    """How a probe is used: every combination of position, force and gravity is one case.

    Attributes:
        forces_N: normal contact forces; of several touches the largest, the others are equal steps up to it.
        touches: number of touches of one fixed point as the base presses on; 1 is a single reading.
        moments_about: with several touches, the point whose moments alone are used; None: forces too.
        base_repeat_mm: standard deviation of the base position at each touch, on each axis; None: the design's.
        bias_walk_steps: walk of the bias between touches, in steps of resolution; None: the design's.
        fractions: contact positions over the length.
        gravities: in base axes [m/s²]; empty: that of the design's mount.
        combine: "mean": the error is the RMS over the cases; "worst": the largest.
    """

    forces_N: tuple[float, ...] = (0.005,)
    touches: int = 5
    moments_about: MomentsAbout | None = "sensor"
    base_repeat_mm: float | None = None
    bias_walk_steps: float | None = None
    fractions: tuple[float, ...] = FRACTIONS
    gravities: tuple[Vector, ...] = ()
    combine: Combine = "mean"

    def __post_init__(self) -> None:
        """Raises InputError for a value out of range."""
        if not self.forces_N:
            raise InputError("forces: a task needs at least one")
        for force in self.forces_N:
            if not 0.0 < force <= 100.0:
                raise InputError(f"force = {force:g} N must lie in (0, 100]")
        if not 1 <= self.touches <= MAX_TOUCHES:
            raise InputError(f"touches = {self.touches} must lie in 1 ... {MAX_TOUCHES}")
        for name, value in (("base repeat", self.base_repeat_mm), ("bias walk", self.bias_walk_steps)):
            if value is not None and not 0.0 <= value <= 100.0:
                raise InputError(f"{name} = {value:g} must lie in 0 ... 100")
        if not self.fractions or not all(0.0 < f <= 1.0 for f in self.fractions):
            raise InputError(f"fractions {list(self.fractions)} must lie in (0, 1]")
        for gravity in self.gravities:
            if len(gravity) != 3 or not all(abs(g) <= MAX_GRAVITY for g in gravity):
                raise InputError(
                    f"gravity {list(gravity)} must be three numbers within ±{MAX_GRAVITY:g} m/s²"
                )
        if self.combine not in ("mean", "worst"):
            raise InputError(f"combine = {self.combine!r} is not known; known: mean, worst")

    @property
    def force_N(self) -> float:
        """Largest force."""
        return max(self.forces_N)

    @property
    def schedule(self) -> PressSchedule | None:
        """How several touches are made; None: one reading."""
        return None if self.touches == 1 else PressSchedule(self.touches, self.moments_about)

    def priors(self, model: ProbeModel) -> Tolerances:
        """Return the standard deviations of the error sources: the design's, except for those that the task sets."""
        changed: dict[str, Any] = {"robot_mm": self.base_repeat_mm, "walk_steps": self.bias_walk_steps}
        return replace(
            Tolerances.of(model), **{name: value for name, value in changed.items() if value is not None}
        )

    def models(self, model: ProbeModel) -> Iterator[ProbeModel]:
        """Yield the probe under each gravity of the task."""
        if not self.gravities:
            yield model
        for gravity in self.gravities:
            yield replace(model, gravity_base=np.array(gravity, dtype=float))

    def combined(self, errors: tuple[float, ...]) -> float:
        """Combine the errors of all cases to the error of the task."""
        if self.combine == "worst":
            return max(errors)
        return math.sqrt(sum(error**2 for error in errors) / len(errors))

    @property
    def text(self) -> str:
        """Description in one line, for users."""
        over = "RMS over" if self.combine == "mean" else "worst of"
        where = f"{over} {min(self.fractions):g}-{max(self.fractions):g} of the length"
        if len(self.gravities) > 1:
            where += f" and {len(self.gravities)} directions of gravity"
        forces = ", ".join(f"{1e3 * force:g}" for force in self.forces_N)
        schedule = self.schedule
        if schedule is None:
            return f"one reading at {forces} mN, all causes, {where}"
        changed = "".join(
            f", {name} {value:g} {unit}"
            for name, value, unit in (("base repeats to", self.base_repeat_mm, "mm"),
                                      ("bias walks", self.bias_walk_steps, "steps"))
            if value is not None
        )  # fmt: skip
        counts = schedule.text.split(", ")[1]
        return f"{self.touches} touches up to {forces} mN fused, {counts}{changed}, all causes, {where}"


def side_of(gravity: Array) -> float:
    """Return the direction in which an object pushes across gravity, as an angle about the axis [rad]; +y without
    gravity."""
    return math.atan2(gravity[1], gravity[0]) + math.pi / 2.0
