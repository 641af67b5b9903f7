"""State of a run for the views: a sink that stores the latest data and returns snapshots to other threads."""

import math
import time
from collections import deque
from collections.abc import Callable, Mapping

import numpy as np

from probedesign.core.frames import Array
from probedesign.live.processing.blocks import Block
from probedesign.live.processing.estimates import EstimateUpdate
from probedesign.live.view.snapshot import STRIP, BentShape, ContactMarker, RunHealth, Snapshot, status_lines

MIN_STALE_TIME = 0.05
"""Minimum silence that is stale [s], as for a Net F/T box."""
STALE_GAPS = 5.0
"""Silence that is stale, in units of the usual interval."""


class RateMeter:
    """Measures the rate of arrivals in one thread, read from another."""

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._arrivals: deque[tuple[float, int]] = deque(maxlen=64)

    def add(self, count: int) -> None:
        """Register the simultaneous arrival of `count` items."""
        self._arrivals.append((self._clock(), count))

    @property
    def silent_for(self) -> float:
        """Time since the last arrival [s]; NaN before the first."""
        arrivals = tuple(self._arrivals)
        return self._clock() - arrivals[-1][0] if arrivals else math.nan

    @property
    def rate(self) -> float:
        """Items per second in the last arrivals; NaN before the second."""
        arrivals = tuple(self._arrivals)
        span = arrivals[-1][0] - arrivals[0][0] if arrivals else 0.0
        return sum(count for _, count in arrivals[1:]) / span if span > 0.0 else math.nan

    @property
    def stale(self) -> bool:
        """Whether the last arrival is older than usual."""
        arrivals = tuple(self._arrivals)
        if not arrivals:
            return False
        usual = (arrivals[-1][0] - arrivals[0][0]) / max(len(arrivals) - 1, 1)
        return self._clock() - arrivals[-1][0] > max(MIN_STALE_TIME, STALE_GAPS * usual)


MAX_TOUCHES = 64
"""Maximum number of earlier touches that are stored."""
FREE_PHASES = ("free", "moving", "released")
"""Phases without contact."""
MAX_EVENTS = 8
STATUS_EVENTS = {"tare": "tare", "recording": "recording", "recorded": "recording"}
"""First words of the events that update the status of tare and recording."""
MAX_STRIP_ROWS = 4096
"""Maximum number of queued chart rows; at 30 snapshots per second there are a few."""


Counts = Callable[[], Mapping[str, int]]


class ViewState:
    """Stores the latest data of a run without blocking, and returns a `Snapshot` on request."""

    def __init__(self, counts: Counts = dict, clock: Callable[[], float] = time.monotonic) -> None:
        """Start before the first reading.

        Args:
            counts: returns the counters of the source: lost, dropped.
            clock: clock of the arrival times [s].
        """
        self._counts, self._clock = counts, clock
        self._update: EstimateUpdate | None = None
        self._first = math.nan
        self._fault, self._n_readings = "", 0
        self._readings, self._updates = RateMeter(clock), RateMeter(clock)
        self._strip: deque[tuple[float, ...]] = deque(maxlen=MAX_STRIP_ROWS)
        self._events: deque[tuple[float, str]] = deque(maxlen=MAX_EVENTS)
        self._last_events = {"tare": "", "recording": ""}
        self._earlier: deque[ContactMarker] = deque(maxlen=MAX_TOUCHES)
        self._current: ContactMarker | None = None
        self._settled = False
        self._number = 1

    def on_samples(self, block: Block) -> None:
        """Store the fault and the rate of readings."""
        self._fault = block.fault
        if len(block):
            self._n_readings += len(block)
            self._readings.add(len(block))

    def on_estimate(self, update: EstimateUpdate) -> None:
        """Store an estimate."""
        self._updates.add(1)
        if self._update is None:
            self._first = update.reading.time
        self._update = update
        self._follow(update)
        force, estimate = float(np.linalg.norm(update.estimate.force_base)), update.estimate
        contact = (estimate.s_contact, estimate.std_s, force if estimate.ok else math.nan)
        self._strip.append((update.reading.time - self._first, *update.wrench_base.tolist(), *contact))

    def on_event(self, time: float, line: str) -> None:
        """Store an event."""
        self._events.append((time, line))
        if topic := STATUS_EVENTS.get(line.partition(" ")[0].rstrip(":")):
            self._last_events[topic] = line

    def close(self) -> None:
        """Do nothing: there is nothing to close."""

    def snapshot(self, shaped: bool = True) -> Snapshot:
        """Return the current snapshot; the probe's shape is solved here, in the calling thread, if requested."""
        update = self._update
        health = RunHealth(
            self._readings.stale, self._updates.stale, self._readings.silent_for, self._readings.rate,
            self._updates.rate, self._fault, self._n_readings, dict(self._counts()), **self._last_events,
        )  # fmt: skip
        events, strip = tuple(self._events), self._pop_strip()
        if update is None:
            return Snapshot(status=status_lines(None, None, health), events=events, strip=strip)
        marker = contact_marker(update, self._touch_number(update))
        return Snapshot(
            since=update.reading.time - self._first,
            result=update.estimate.result,
            stale=health.stale or health.no_estimate,
            status=status_lines(update, marker, health),
            shape=bent_shape(update) if shaped else None,
            marker=marker,
            touches=tuple(self._earlier),
            T_world_base=update.T_world_base,
            gravity_base=update.reading.gravity_base,
            strip=strip,
            events=events,
        )

    def _pop_strip(self) -> Array:
        rows = []
        while self._strip:
            rows.append(self._strip.popleft())
        return np.array(rows).reshape(-1, len(STRIP))

    def _touch_number(self, update: EstimateUpdate) -> int:
        """Return the number of the current touch, from the contacts if they are monitored."""
        return update.contacts[-1].number if update.contacts else self._number

    def _follow(self, update: EstimateUpdate) -> None:
        """Store the best contact of a touch: the last settled one, otherwise that of least standard deviation."""
        marker = contact_marker(update, self._touch_number(update))
        if marker is not None and update.phase in ("", "touching", "settled"):
            settled = update.phase == "settled"
            better = self._current is None or marker.std_s <= self._current.std_s
            if settled or (better and not self._settled):
                self._current = marker
            self._settled |= settled
        free = update.phase in FREE_PHASES if update.phase else update.estimate.result == "no_contact"
        if free and self._current is not None:
            self._earlier.append(self._current)
            self._current, self._settled, self._number = None, False, self._number + 1


def contact_marker(update: EstimateUpdate, number: int) -> ContactMarker | None:
    """Return the contact, fused if available, otherwise of this reading; None if the estimate is not ok."""
    estimate, fused, T = update.estimate, update.fused, update.T_world_base
    if not estimate.ok:
        return None
    contact = (estimate.force_base, estimate.s_contact, estimate.std_s)
    when = (update.reading.time, number, estimate.friction_ratio)
    if not np.isfinite(T).all():
        return ContactMarker(estimate.p_surface_base, estimate.cov_surface_base, *contact, False, *when)
    R, origin = T[:3, :3], T[:3, 3]
    contact = (R @ estimate.force_base, estimate.s_contact, estimate.std_s)
    if fused is not None and fused.ok:
        return ContactMarker(fused.p_surface_world, fused.cov_surface_world, *contact, True, *when)
    surface = R @ estimate.p_surface_base + origin
    return ContactMarker(surface, R @ estimate.cov_surface_base @ R.T, *contact, True, *when)


def bent_shape(update: EstimateUpdate) -> BentShape | None:
    """Return the estimated shape of the probe; None if it is unknown."""
    eq = update.estimate.shape
    return BentShape(eq.s, eq.p_base, eq.R_base) if eq is not None and eq.ok else None
