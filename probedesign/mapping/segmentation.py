"""Segmentation of a stream of estimates into touches, each with stationary intervals and the free probe around it."""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from probedesign.core.frames import Array
from probedesign.live.processing.estimates import EstimateUpdate
from probedesign.live.processing.motion import LEVER
from probedesign.live.processing.touches import SPAN

#: Largest difference of poses of a stationary base [m], for rotations times `LEVER`: the repeatability of a robot
#: (`Tolerances.robot_mm`, assumed).
STATIONARY = 10e-6
#: Minimum number of readings and duration [s] of a valid interval; a shorter one is the end of a move.
MIN_READINGS, MIN_DURATION = 3, 0.1
FREE_SPAN = 2.0  #: Longest interval of the free probe next to a touch [s], since the bias keeps walking.
MAX_INTERVALS = 20  #: Maximum number of intervals of a touch that are used; of more, as many evenly chosen.
#: A touch that is lost before any valid interval and detected again within this time [s] is one touch: where it begins
#: the force is close to the noise, and consecutive means may differ in their detection. `live` reports "released", not
#: "free", for the same time.
REJOIN_TIME = SPAN


@dataclass
class StationaryInterval:
    """Consecutive readings at one pose."""

    T_world_base: Array  #: pose of the first reading, (4, 4).
    gravity: Array  #: gravity in base axes [m/s²], (3,).
    start: float  #: time of the first reading [s].
    end: float  #: time of the last reading [s].
    n_readings: int = 0  #: number of readings.
    #: sum of the wrenches at the base, tare removed [N, N·m], (6,).
    total: Array = field(default_factory=lambda: np.zeros(6))

    @classmethod
    def begin(cls, update: EstimateUpdate) -> "StationaryInterval":
        """Return an interval that begins with this reading."""
        time = update.reading.time
        interval = cls(update.T_world_base, update.reading.gravity_base, time, time)
        interval.add(update)
        return interval

    @property
    def wrench(self) -> Array:
        """Return the mean wrench [N, N·m], (6,)."""
        return np.asarray(self.total / self.n_readings)

    @property
    def is_valid(self) -> bool:
        """Return whether it is long enough not to be the end of a move."""
        return self.n_readings >= MIN_READINGS and self.end - self.start >= MIN_DURATION

    def contains(self, T_world_base: Array) -> bool:
        """Return whether a pose is that of the interval."""
        shift = float(np.linalg.norm(T_world_base[:3, 3] - self.T_world_base[:3, 3]))
        # The Frobenius norm of R - R' is √2 times the angle for small angles.
        angle = float(np.linalg.norm(T_world_base[:3, :3] - self.T_world_base[:3, :3])) / np.sqrt(2.0)
        return bool(max(shift, LEVER * angle) <= STATIONARY)

    def add(self, update: EstimateUpdate) -> None:
        """Add a reading."""
        self.end = update.reading.time
        self.n_readings += 1
        # The free readings around a touch determine its bias, so the bias must be the same in all of them.
        self.total = self.total + update.wrench_base + update.drift_base


@dataclass(frozen=True)
class TouchSegment:
    """The readings of one touch."""

    number: int  #: number of the touch, from 1.
    start: float  #: time of its detection [s].
    free_before: StationaryInterval | None  #: free probe just before it; None if the base was not stationary.
    intervals: tuple[StationaryInterval, ...]  #: stationary intervals in contact, in order of time.
    free_after: StationaryInterval | None  #: free probe just after it; None if the base was not stationary.


class TouchSegmenter:
    """Collects touch segments from the estimates of a processing chain, which must include every reading.

    Attributes:
        count: number of touches so far.
    """

    def __init__(self, count: int = 0) -> None:
        self.count, self._start = count, np.nan
        self._open, self._last = 0, np.nan  # number of the open touch as given by `live`; 0 for none
        self._before: StationaryInterval | None = None
        self._older: StationaryInterval | None = None
        self._intervals: list[StationaryInterval] = []
        self._after: StationaryInterval | None = None

    def update(self, update: EstimateUpdate) -> Iterator[TouchSegment]:
        """Process an estimate and yield the segment that it completes, if any."""
        if update.phase == "" or not np.isfinite(update.wrench_base).all():
            return
        contact = update.contacts[-1] if update.contacts and update.contacts[-1].ongoing else None
        if contact is not None and contact.number != self._open:
            # Where the touch just lost had hardly begun, this is its continuation.
            had_valid = any(interval.is_valid for interval in self._intervals)
            if not self._open or had_valid or contact.start - self._last >= REJOIN_TIME:
                yield from self.finish()
                self.count, self._start = self.count + 1, contact.start
                newest, older = self._before, self._older
                if older is not None and (newest is None or 2 * newest.n_readings < older.n_readings):
                    self._before = older  # the newest interval of the free probe has hardly begun
                elif newest is not None and not newest.is_valid:
                    self._before = None
            self._open = contact.number
        if contact is not None:
            self._last = update.reading.time
            if update.phase == "settled":
                if self._intervals and self._intervals[-1].contains(update.T_world_base):
                    self._intervals[-1].add(update)
                else:
                    if self._intervals and not self._intervals[-1].is_valid:
                        self._intervals.pop()  # or they would be kept for hours where the base creeps
                    self._intervals.append(StationaryInterval.begin(update))
        elif update.phase == "free":
            yield from self._update_free(update)

    def finish(self) -> Iterator[TouchSegment]:
        """Yield the open segment, if any."""
        if self._open:
            after = self._after if self._after is not None and self._after.is_valid else None
            valid = [interval for interval in self._intervals if interval.is_valid]
            if len(valid) > MAX_INTERVALS:
                valid = [valid[round(i)] for i in np.linspace(0, len(valid) - 1, MAX_INTERVALS)]
            yield TouchSegment(self.count, self._start, self._before, tuple(valid), after)
            if after is not None:
                self._before, self._older = after, None
        self._open, self._intervals, self._after = 0, [], None

    def _update_free(self, update: EstimateUpdate) -> Iterator[TouchSegment]:
        """Process a reading of the free probe on a stationary base, after a touch or before one."""
        if not self._open:
            self._update_before(update)
            return
        after = self._after
        if after is None:
            self._after = StationaryInterval.begin(update)
        elif after.contains(update.T_world_base) and update.reading.time - after.start < FREE_SPAN:
            after.add(update)
        else:
            yield from self.finish()
            self._update_before(update)

    def _update_before(self, update: EstimateUpdate) -> None:
        """Keep the last one or two intervals of the free probe."""
        before = self._before
        if before is None or not before.contains(update.T_world_base):
            # A base that begins to move is still reported as free for a short time.
            self._older = before if before is not None and before.is_valid else self._older
            self._before = StationaryInterval.begin(update)
        elif update.reading.time - before.start >= FREE_SPAN:
            self._older, self._before = before, StationaryInterval.begin(update)
        else:
            before.add(update)
