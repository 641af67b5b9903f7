"""The base's way through a scene, and what the sensor feels on it."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

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
        index, way, leaves = self._at(time)
        wrench = np.tile(self._free, (len(time), 1))
        for i in np.unique(index[index >= 0]):
            thing = self.things[i]
            on, off = (index == i) & ~leaves, (index == i) & leaves
            wrench[on] = _between(way[on], thing.way, thing.wrench_base)
            wrench[off] = _between(way[off], thing.way_back, thing.wrench_back)
        return self.model.to_sensor(wrench, self.model.gravity_base)

    def p_world_base(self, time: Array) -> Array:
        """Where the base is [m], (n, 3), in a world that has its origin and axes while it rests. The objects
        hang in that world where they are met."""
        index, way, _ = self._at(time)
        p = np.zeros((len(time), 3))
        for i in np.unique(index[index >= 0]):
            here = index == i
            p[here] = way[here, None] * self.things[i].towards
        return p

    def _at(self, time: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Which object is next, -1 for none, how far the base has gone towards it [m], and whether it moves off it:
        with friction the probe feels another wrench then."""
        since = np.mod(time, self.round) - REST
        index = np.floor(since / self._each).astype(int)
        index = np.where(since < 0.0, -1, np.minimum(index, len(self.things) - 1))
        phase = since - index * self._each
        knots = np.cumsum([0.0, MOVE, PRESS, HOLD, PRESS])
        share = np.interp(phase, knots, [0.0, 0.0, 1.0, 1.0, 0.0])
        ends = np.array([thing.way[-1] for thing in self.things] + [0.0])  # index -1 is the last
        return index, share * ends[index], phase > MOVE + PRESS + HOLD

    @cached_property
    def _free(self) -> Array:
        return self.model.rod.solve(self.model.gravity_base, mode="reference").wrench_base


def _between(at: Array, knots: Array, values: Array) -> Array:
    """Rows of values straight between knots, (n, 6), as they are at the ends beyond them."""
    part = np.clip(np.searchsorted(knots, at, side="right") - 1, 0, len(knots) - 2)
    low, high = knots[part], knots[part + 1]
    weight = np.clip((at - low) / (high - low), 0.0, 1.0)[:, None]
    between: Array = (1.0 - weight) * values[part] + weight * values[part + 1]
    return between
