"""Content of the page without viser: its static objects and chart data."""

from collections import deque
from dataclasses import dataclass

import numpy as np

from probedesign.core.frames import Array
from probedesign.core.units import MILLINEWTON, MM
from probedesign.geometry.tube import BentShape, TubeMesh
from probedesign.live.view.state import STRIP
from probedesign.web.rigid_parts import RigidPart


@dataclass(frozen=True)
class SceneSetup:
    """Static content of the page."""

    title: str  #: title of the page.
    host: str  #: host, port: address of the server; the next free port is used.
    port: int
    tube: TubeMesh  #: mesh of the probe.
    free: BentShape  #: shape of the free probe.
    parts: tuple[RigidPart, ...]  #: parts at its base.
    gravity_base: Array  #: gravity vector [m/s²], (3,).
    note: str = ""  #: note on what is drawn, if any.
    token: str = ""  #: secret that a browser must know; empty on an address of this machine only.


CHART_SECONDS = 15.0
CHART_POINTS = 450  #: Points of a chart: 30 per second.
REDRAW_PERIOD = 0.1  #: Minimum interval between redraws [s]: all points are sent each time.
S, STD, FORCE = STRIP.index("s"), STRIP.index("std_s"), STRIP.index("force")


class StripCharts:
    """Data of the strip charts over the last seconds; NaN where unknown."""

    def __init__(self) -> None:
        self._rows: deque[Array] = deque(maxlen=CHART_POINTS)
        self._due = self._last_drawn = -np.inf

    def add(self, strip: Array) -> bool:
        """Add rows of `STRIP`, thinned; return whether to redraw. Decreasing time clears the charts."""
        for row in strip:
            if row[0] < self._due - 2.0 * CHART_SECONDS / CHART_POINTS:
                self._rows.clear()
                self._due = self._last_drawn = -np.inf
            if row[0] >= self._due:
                self._rows.append(row)
                self._due = row[0] + 0.9 * CHART_SECONDS / CHART_POINTS
        due = self._due >= self._last_drawn + REDRAW_PERIOD
        if due:
            self._last_drawn = self._due
        return due

    def lines(self, age: float = 0.0) -> dict[str, tuple[Array, ...]]:
        """Return the data of the charts, each after the times [s], which are negative: seconds before now.

        Position s [mm] with its 95 % interval, contact force [mN], and force [mN] and moment [N·mm] at the base.

        Args:
            age: time since the last row [s]: old data move out of the charts.
        """
        rows = self._recent(age)
        last = float(self._rows[-1][0]) if self._rows else 0.0
        time, s, wide = rows[:, 0] - last - age, rows[:, S] / MM, 1.96 * rows[:, STD] / MM
        return {
            "place": (time, s, s - wide, s + wide),
            "push": (time, rows[:, FORCE] / MILLINEWTON),
            "forces": (time, *(rows[:, 1:4] / MILLINEWTON).T),
            "moments": (time, *(rows[:, 4:7] / MM).T),
        }

    def _recent(self, age: float) -> Array:
        rows = np.array(self._rows).reshape(-1, len(STRIP))
        recent: Array = rows[rows[:, 0] >= rows[-1, 0] + age - CHART_SECONDS] if len(rows) else rows
        return recent if len(recent) else np.full((1, len(STRIP)), np.nan)
