"""Strip charts: the last seconds of wrench and estimate, thinned to what a page can draw."""

from collections import deque

import numpy as np

from probedesign.frames import Array
from probedesign.live.view.moment import STRIP
from probedesign.units import MILLINEWTON, MM

SECONDS = 15.0
POINTS = 450
"""Of a chart: 30 a second."""
S, STD = STRIP.index("s"), STRIP.index("std_s")


class Charts:
    """What the charts show, as new rows come.

    A chart's arrays are its times and one array a line; NaN leaves a gap.
    """

    def __init__(self) -> None:
        self._rows: deque[Array] = deque(maxlen=POINTS)
        self._due = -np.inf

    def add(self, strip: Array) -> bool:
        """Take in rows of `STRIP`, thinned; whether there is anything new. Time that runs backward begins anew."""
        before = self._due
        for row in strip:
            if row[0] < self._due - 2.0 * SECONDS / POINTS:
                self._rows.clear()
                self._due = -np.inf
            if row[0] >= self._due:
                self._rows.append(row)
                self._due = row[0] + 0.9 * SECONDS / POINTS
        return self._due != before

    def place(self) -> tuple[Array, ...]:
        """Time [s], s [mm], and the edges of its 95 % band [mm]."""
        rows = self._last()
        s, wide = rows[:, S] / MM, 1.96 * rows[:, STD] / MM
        return rows[:, 0], s, s - wide, s + wide

    def forces(self) -> tuple[Array, ...]:
        """Time [s] and Fx, Fy, Fz at the base [mN]."""
        rows = self._last()
        return rows[:, 0], *(rows[:, 1:4] / MILLINEWTON).T

    def moments(self) -> tuple[Array, ...]:
        """Time [s] and Mx, My, Mz at the base [N·mm]."""
        rows = self._last()
        return rows[:, 0], *(rows[:, 4:7] / MM).T

    def push(self) -> tuple[Array, ...]:
        """Time [s] and the contact's force [mN]."""
        rows = self._last()
        return rows[:, 0], rows[:, 9] / MILLINEWTON

    def window(self) -> tuple[float, float]:
        """From when to when the charts reach [s]."""
        end = float(self._rows[-1][0]) if self._rows else 0.0
        return max(end, SECONDS) - SECONDS, max(end, SECONDS)

    def _last(self) -> Array:
        rows = np.array(self._rows).reshape(-1, len(STRIP))
        kept: Array = rows[rows[:, 0] >= self.window()[0]]
        return kept if len(kept) else np.full((1, len(STRIP)), np.nan)
