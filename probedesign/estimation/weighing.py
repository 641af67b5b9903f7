"""How one reading is known at a touch that may have made it, with its probe's tolerances: compiled.

`doubts.py` says the same with names, and what it means.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from probedesign.estimation import doubt_kernel as kernel
from probedesign.estimation.causes import parameters_of, turns_of
from probedesign.estimation.model import ProbeModel
from probedesign.estimation.observation import Observation
from probedesign.estimation.tolerances import Tolerances
from probedesign.frames import Array, inverse, wrench_map
from probedesign.rod.equilibrium import Equilibrium


@dataclass(frozen=True)
class Causes:
    """What may differ between a probe and its model under one gravity, one standard deviation each.

    Attributes:
        model: of the probe.
        tolerances: how well it is known.
        drift: covariance of the bias since the tare, at the base, (6, 6).
        hanging: what hangs on the sensor, by gravity, told at the base, (6, 3).
        own: of the rod's own causes, log E and what follows it a row, (a, 4 + K).
        turns: of the others, shift and turn of the base and change of gravity a row [m, rad, m/s²], (b, 9).
        still: of the free probe's reading by each cause, which a tare has taken away, (6, a + b).
    """

    model: ProbeModel
    tolerances: Tolerances
    drift: Array
    hanging: Array
    own: Array
    turns: Array
    still: Array

    @classmethod
    def of(cls, model: ProbeModel, tolerances: Tolerances, gravity: Array, free: Equilibrium) -> "Causes":
        """Of a probe that stands free so."""
        drift = tolerances.drift_steps**2 * model.averaging_samples * model.noise_base()
        hanging = np.ascontiguousarray(wrench_map(inverse(model.T_sensor_base)) @ model.hanging_by_gravity)
        own = _some(parameters_of(model.rod, tolerances))
        nowhere = np.empty((6, 0))
        return cls(model, tolerances, drift, hanging, own, nowhere, nowhere).under(gravity, free)

    def under(self, gravity: Array, free: Equilibrium) -> "Causes":
        """The same probe under another gravity."""
        turns = _some(turns_of(gravity, self.tolerances))
        untared = replace(self, turns=turns, still=np.zeros((6, len(self.own) + len(turns))))
        if not self.tolerances.tared:
            return untared
        seen = Observation(free.wrench_base, self.model.whiten, gravity, self.model.mass * gravity, 0.0)
        weighing = Weighing(untared, seen)
        held = weighing.at(np.concatenate([free.tip, np.zeros(3), [self.model.rod.length]]))
        assert held, "asked of a probe that cannot stand"
        return replace(untared, still=weighing.wrench)

    @cached_property
    def room(self) -> int:
        """Numbers that weighing works in."""
        return kernel.room_for(len(self.model.rod.s), self.still.shape[1])


class Weighing:
    """Of one reading; what it tells is of the touch it was last asked `at`.

    Attributes:
        wrench: of the reading by each cause, one standard deviation a column, (6, j).
        point: of the touched point [m], (3, j).
    """

    def __init__(self, causes: Causes, seen: Observation) -> None:
        """Args:
        causes: under the reading's gravity.
        seen: the reading, with its noise alone.
        """
        self.wrench, self.point = np.empty_like(causes.still), np.empty((3, causes.still.shape[1]))
        self._told, self._work = np.empty(kernel.TOLD), np.empty(causes.room)
        self._reading = (
            causes.model.rod.body,
            seen.gravity,
            seen.weight,
            seen.wrench,
            seen.whiten,
            causes.drift,
            causes.own,
            causes.turns,
            causes.hanging,
            causes.still,
        )

    def at(self, touch: Array) -> bool:
        """Weigh the reading as at a touch, (fit.STATE,); whether the probe holds it."""
        return bool(kernel.weigh(*self._reading, touch, self._work, self.wrench, self.point, self._told))

    @property
    def whiten(self) -> Array:
        """Lower triangular, with whitenᵀ whiten the inverse of the reading's covariance, a copy, (6, 6)."""
        return self._told[kernel.WHITEN : kernel.COV].reshape(6, 6).copy()

    @property
    def cov_point(self) -> Array:
        """Of the contact point [m²] to first order, infinite where the reading does not tell it, (3, 3)."""
        if not self._told[kernel.KNOWN]:
            return np.full((3, 3), np.inf)
        return self._told[kernel.COV : kernel.KNOWN].reshape(3, 3).copy()


def _some(rows: dict[str, Array]) -> Array:
    """All rows that are not zero, one below the other."""
    found = np.concatenate(list(rows.values()))
    return np.ascontiguousarray(found[found.any(axis=1)])
