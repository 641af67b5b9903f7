"""Strip charts: the last seconds of wrench and estimate, thinned to what a page can draw."""

from collections import deque

import numpy as np

from probedesign.frames import Array
from probedesign.live.view.moment import STRIP
from probedesign.units import MILLINEWTON, MM

SECONDS = 15.0
POINTS = 450
"""Of a chart: 30 a second."""
AGAIN = 0.1
"""They are drawn anew when so much has come [s]: all their points are sent each time."""
S, STD, FORCE = STRIP.index("s"), STRIP.index("std_s"), STRIP.index("force")


class Charts:
    """What the charts show, as new rows come; NaN where nothing is known."""

    def __init__(self) -> None:
        self._rows: deque[Array] = deque(maxlen=POINTS)
        self._due = self._drawn = -np.inf

    def add(self, strip: Array) -> bool:
        """Take in rows of `STRIP`, thinned; whether it is worth to draw anew. Time that runs backward begins anew."""
        for row in strip:
            if row[0] < self._due - 2.0 * SECONDS / POINTS:
                self._rows.clear()
                self._due = self._drawn = -np.inf
            if row[0] >= self._due:
                self._rows.append(row)
                self._due = row[0] + 0.9 * SECONDS / POINTS
        worth = self._due >= self._drawn + AGAIN
        if worth:
            self._drawn = self._due
        return worth

    def lines(self) -> dict[str, tuple[Array, ...]]:
        """What is to be drawn: s [mm] and the ends of its 95 %, the contact's force [mN], and force [mN] and moment
        [N·mm] at the base, each after the times [s]."""
        rows = self._last()
        time, s, wide = rows[:, 0], rows[:, S] / MM, 1.96 * rows[:, STD] / MM
        return {
            "place": (time, s, s - wide, s + wide),
            "push": (time, rows[:, FORCE] / MILLINEWTON),
            "forces": (time, *(rows[:, 1:4] / MILLINEWTON).T),
            "moments": (time, *(rows[:, 4:7] / MM).T),
        }

    def window(self) -> tuple[float, float]:
        """From when to when the charts reach [s]."""
        end = float(self._rows[-1][0]) if self._rows else 0.0
        return max(end, SECONDS) - SECONDS, max(end, SECONDS)

    def _last(self) -> Array:
        rows = np.array(self._rows).reshape(-1, len(STRIP))
        kept: Array = rows[rows[:, 0] >= self.window()[0]]
        return kept if len(kept) else np.full((1, len(STRIP)), np.nan)
