"""The base's way through a scene, and what the sensor feels on it."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from probedesign.estimation.model import ProbeModel
from probedesign.frames import Array
from probedesign.live.box.scene import Pressed

REST = 5.0
"""Free of everything at the start of a round [s]: time for a tare."""
MOVE, PRESS, HOLD = 1.0, 1.5, 3.0
"""To the next object; onto it, and off it again; held still [s]."""


@dataclass(frozen=True)
class Motion:
    """Round after round: rest, then for each object there, onto it, hold, off it.

    Attributes:
        model: the probe.
        things: in the order in which they are pressed.
    """

    model: ProbeModel
    things: tuple[Pressed, ...]

    @property
    def round(self) -> float:
        """How long one takes [s]."""
        return REST + len(self.things) * self._each

    @property
    def _each(self) -> float:
        return MOVE + 2.0 * PRESS + HOLD

    def wrench_sensor(self, time: Array) -> Array:
        """What a sensor without bias or noise reads [N, N·m], (n, 6).

        Args:
            time: since the base began to move [s], (n,).
        """
        index, way = self._at(time)
        wrench = np.tile(self._free, (len(time), 1))
        for i in np.unique(index[index >= 0]):
            here, thing = index == i, self.things[i]
            part = np.searchsorted(thing.way, way[here], side="right") - 1
            part = np.clip(part, 0, len(thing.way) - 2)
            low, high = thing.way[part], thing.way[part + 1]
            weight = np.clip((way[here] - low) / (high - low), 0.0, 1.0)[:, None]
            wrench[here] = (1.0 - weight) * thing.wrench_base[part] + weight * thing.wrench_base[part + 1]
        return self.model.to_sensor(wrench, self.model.gravity_base)

    def p_world_base(self, time: Array) -> Array:
        """Where the base is [m], (n, 3), in a world that has its origin and axes while it rests. The objects
        hang in that world where they are met."""
        index, way = self._at(time)
        p = np.zeros((len(time), 3))
        for i in np.unique(index[index >= 0]):
            here = index == i
            p[here] = way[here, None] * self.things[i].towards
        return p

    def _at(self, time: Array) -> tuple[Array, Array]:
        """Which object is next, -1 for none, and how far the base has gone towards it [m]."""
        since = np.mod(time, self.round) - REST
        index = np.floor(since / self._each).astype(int)
        index = np.where(since < 0.0, -1, np.minimum(index, len(self.things) - 1))
        phase = since - index * self._each
        knots = np.cumsum([0.0, MOVE, PRESS, HOLD, PRESS])
        share = np.interp(phase, knots, [0.0, 0.0, 1.0, 1.0, 0.0])
        ends = np.array([thing.way[-1] for thing in self.things] + [0.0])  # index -1 is the last
        return index, share * ends[index]

    @cached_property
    def _free(self) -> Array:
        return self.model.rod.solve(self.model.gravity_base, mode="reference").wrench_base
