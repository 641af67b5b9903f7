"""Where the base stood still: what was read there, in the mean."""

from dataclasses import dataclass, field

import numpy as np

from probedesign.frames import Array
from probedesign.live.processing.estimates import EstimateUpdate
from probedesign.live.processing.touches import LEVER

STANDS = 10e-6
"""Poses of a base that stands differ by no more [m], their rotations over `LEVER` likewise: a robot's own scatter
(`Tolerances.robot_mm`, assumed)."""
FEWEST, SHORTEST = 3, 0.1
"""Readings of a dwell that counts, and how long they last [s]: less is the end of a move."""


@dataclass
class Dwell:
    """Readings from one pose, one after the other.

    Attributes:
        T_world_base: the first one's pose, (4, 4).
        gravity: base axes [m/s²], (3,).
        start: when the first was read [s].
        end: when the last was read [s].
        readings: how many there are.
        total: sum of their wrenches at the base, bias of the tare taken off [N, N·m], (6,).
    """

    T_world_base: Array
    gravity: Array
    start: float
    end: float
    readings: int = 0
    total: Array = field(default_factory=lambda: np.zeros(6))

    @classmethod
    def at(cls, answer: EstimateUpdate) -> "Dwell":
        """One that begins with this reading."""
        time = answer.reading.time
        dwell = cls(answer.T_world_base, answer.reading.gravity_base, time, time)
        dwell.add(answer)
        return dwell

    @property
    def wrench(self) -> Array:
        """The mean [N, N·m], (6,)."""
        mean: Array = self.total / self.readings
        return mean

    @property
    def counts(self) -> bool:
        """Whether it is one, not the end of a move."""
        return self.readings >= FEWEST and self.end - self.start >= SHORTEST

    def holds(self, T_world_base: Array) -> bool:
        """Whether a pose is still this one."""
        gone = float(np.linalg.norm(T_world_base[:3, 3] - self.T_world_base[:3, 3]))
        # |R - R'| by Frobenius is √2 of the angle where that is small.
        turned = float(np.linalg.norm(T_world_base[:3, :3] - self.T_world_base[:3, :3])) / np.sqrt(2.0)
        return bool(max(gone, LEVER * turned) <= STANDS)

    def add(self, answer: EstimateUpdate) -> None:
        """Take in a reading."""
        self.end = answer.reading.time
        self.readings += 1
        self.total = self.total + answer.wrench_base
