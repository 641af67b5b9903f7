"""State of a run for the views: a sink that stores the latest data, and snapshots of it with status lines."""

import math
import re
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np

from probedesign.core.frames import Array
from probedesign.core.units import MILLINEWTON, MM
from probedesign.estimation.estimate import RESULTS
from probedesign.geometry.tube import BentShape
from probedesign.live.blocks import Block
from probedesign.live.outputs.sinks import Sink
from probedesign.live.processing.estimates import ContactMarker, EstimateUpdate, bent_shape, contact_marker

Level = Literal["good", "fair", "bad", "plain"]


class StatusLine(NamedTuple):
    """One line of the status: its topic, its text, and how good or bad it is."""

    name: str
    text: str
    level: Level = "plain"


class Event(NamedTuple):
    """An event, or several similar ones of which it is the last: its source's time [s], its text, their number."""

    time: float
    line: str
    number: int = 1


#: Columns of a row of a strip chart: [s], [N], [N·m], [m], [N].
STRIP = ("time", "Fx", "Fy", "Fz", "Mx", "My", "Mz", "s", "std_s", "force")


@dataclass(frozen=True)
class Snapshot:
    """State of a run at one time."""

    time: float = 0.0  #: time of the last estimate, by the source's clock [s].
    age: float = math.nan  #: time since the last estimate by the computer's clock [s]; NaN before the first.
    result: str = ""  #: result of the last estimate; empty before the first.
    #: whether probe and contact are not current: no recent reading or estimate, or the run has ended.
    stale: bool = False
    recording: str = ""  #: what is recorded, if anything is.
    status: tuple[StatusLine, ...] = ()  #: the status lines.
    shape: BentShape | None = None  #: shape of the probe, if estimated.
    marker: ContactMarker | None = None  #: the contact, if the estimate is ok.
    touches: tuple[ContactMarker, ...] = ()  #: best contact of each touch so far, the last ones.
    #: pose of the base, (4, 4); NaN if unknown.
    T_world_base: Array = field(default_factory=lambda: np.full((4, 4), np.nan))
    gravity_base: Array = field(default_factory=lambda: np.array([0.0, 0.0, -9.81]))  #: gravity vector [m/s²], (3,).
    #: rows of `STRIP` since the last snapshot, (j, 10).
    strip: Array = field(default_factory=lambda: np.empty((0, len(STRIP))))
    events: tuple[Event, ...] = ()  #: last events, oldest first; similar ones are one.


NEWTON_MM = 1e-3  #: One N·mm in N·m.


@dataclass(frozen=True)
class RunHealth:
    """Condition of the run."""

    stale: bool = False  #: no reading for longer than usual.
    no_estimate: bool = False  #: no estimate for longer than usual.
    silent_for: float = float("nan")  #: time since the last reading [s].
    rate: float = float("nan")  #: rate, estimate_rate: readings and estimates per second.
    estimate_rate: float = float("nan")
    fault: str = ""  #: fault of the last readings.
    n_readings: int = 0  #: number of readings so far.
    counts: Mapping[str, int] = field(default_factory=dict)  #: counters of the source.
    tare: str = ""  #: last event on it; empty if there was none.
    recording: str = ""  #: what is recorded; empty if nothing is.
    recording_failed: str = ""  #: why the last recording ended by itself; empty if it did not.
    ended: bool = False  #: whether the source has ended.


def status_lines(
    update: EstimateUpdate | None, marker: ContactMarker | None, health: RunHealth
) -> tuple[StatusLine, ...]:
    """Return all status lines, most important first."""
    lines = [_result_line(update, health)]
    if update is not None:
        lines.append(StatusLine("phase", update.phase or "not monitored"))
        lines += _contact_lines(marker)
        lines += _fused_lines(update)
        lines += _wrench_lines(update.wrench_base)
    return (*lines, *_health_lines(update, health))


def _result_line(update: EstimateUpdate | None, health: RunHealth) -> StatusLine:
    if health.ended:
        return StatusLine("result", f"the run has ended: all values are {_age_text(health.silent_for)} old")
    if health.stale:
        return StatusLine("result", f"stale: no reading for {_age_text(health.silent_for)}", "bad")
    if update is None:
        return StatusLine("result", "no estimate yet" if health.n_readings else "no reading yet", "fair")
    if health.no_estimate:
        return StatusLine("result", "no recent estimate: the values shown are old", "bad")
    result = update.estimate.result
    levels: dict[str, Level] = {"ok": "good", "no_contact": "plain", "too_light": "fair", "ambiguous": "fair"}
    return StatusLine("result", f"{result}: {RESULTS[result]}", levels.get(result, "bad"))


def _contact_lines(marker: ContactMarker | None) -> list[StatusLine]:
    """Return the lines of the contact; dashes if it is unknown, so that the lines keep their positions."""
    if marker is None:
        return [StatusLine(name, "–") for name in ("contact", "point", "force")]
    frame = "world" if marker.in_world else "base"
    stds = _numbers(np.sqrt(np.maximum(np.diag(marker.cov), 0.0)), MM)
    ratio = marker.friction_ratio
    friction = f", tangential over normal {ratio:.2f}" if np.isfinite(ratio) else ""  # not with every method
    return [
        StatusLine("contact", f"s {marker.s / MM:.1f} ± {marker.std_s / MM:.1f} mm"),
        StatusLine("point", f"{_numbers(marker.p_surface, MM)} mm, {frame}; ± {stds} mm"),
        StatusLine("force", f"{float(np.linalg.norm(marker.force)) / MILLINEWTON:.1f} mN{friction}"),
    ]


def _fused_lines(update: EstimateUpdate) -> list[StatusLine]:
    fused = update.fused
    if fused is None:
        return [StatusLine("fused", f"no {update.stale}", "fair")] if update.stale else []
    place = f"{_numbers(fused.p_surface_world, MM)} mm, world, ± {fused.rms / MM:.1f} mm"
    return [StatusLine("fused", place if fused.ok else fused.result)]


def _wrench_lines(wrench: Array) -> list[StatusLine]:
    """Return the lines of the wrench at the base."""
    if not np.isfinite(wrench).all():
        return [StatusLine("forces", "–"), StatusLine("moments", "–")]
    return [
        StatusLine("forces", f"{_numbers(wrench[:3], MILLINEWTON)} mN at the base"),
        StatusLine("moments", f"{_numbers(wrench[3:], NEWTON_MM, 2)} N·mm"),
    ]


def _health_lines(update: EstimateUpdate | None, health: RunHealth) -> list[StatusLine]:
    rates = [f"{health.rate:.0f} readings/s", f"{health.estimate_rate:.0f} estimates/s"]
    if update is not None and np.isfinite(latency := update.computed - update.reading.received):
        rates.append(f"{1e3 * latency:.1f} ms from reading to estimate")
    names = ("lost", "late", "dropped", "faults")
    lost = ", ".join(f"{health.counts[name]} {name}" for name in names if health.counts.get(name))
    loss = f"{lost or 'none known'} of {health.n_readings} readings"
    return [
        *([StatusLine("fault", health.fault, "bad")] if health.fault else []),
        StatusLine("rate", ", ".join(rates).replace("nan", "–")),
        StatusLine("loss", loss, "fair" if lost else "plain"),
        StatusLine("tare", health.tare.removeprefix("tare").lstrip(": ") or "none taken"),
        _recording_line(health),
    ]


def _recording_line(health: RunHealth) -> StatusLine:
    if health.recording:
        return StatusLine("recording", health.recording, "good")
    if health.recording_failed:
        return StatusLine("recording", health.recording_failed, "bad")
    return StatusLine("recording", "no")


def _age_text(age: float) -> str:
    """Return an age [s] in seconds, or in minutes beyond two."""
    if not math.isfinite(age):
        return "–"
    return f"{age:.1f} s" if age < 120.0 else f"{age / 60.0:.0f} min"


def _numbers(values: Array, unit: float, digits: int = 1) -> str:
    return "(" + ", ".join(f"{float(value) / unit:z.{digits}f}" for value in values) + ")"


MIN_STALE_TIME = 0.05  #: Minimum silence that is stale [s], as for a Net F/T box.
STALE_GAPS = 5.0  #: Silence that is stale, in units of the usual interval.


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


MAX_TOUCHES = 64  #: Maximum number of earlier touches that are stored.
FREE_PHASES = ("free", "moving", "released")  #: Phases without contact.
MAX_EVENTS = 12  #: Maximum number of events that are kept, of those of the user and of the others each.
#: First words of the events that a user caused: each is kept, however many others follow.
USER_EVENTS = ("tare", "mark", "recording", "recorded")
MAX_STRIP_ROWS = 4096  #: Maximum number of queued chart rows; at 30 snapshots per second there are a few.


class EventList:
    """The last events: those of the user one by one, others with similar ones as one, so that none hides the rest."""

    def __init__(self) -> None:
        self._user: deque[Event] = deque(maxlen=MAX_EVENTS)
        self._others: dict[tuple[str, ...], Event] = {}

    def add(self, time: float, line: str) -> None:
        """Add an event; a similar earlier one is replaced and counted."""
        words = re.findall(r"[A-Za-z]{2,}", line)
        if words and words[0].lower() in USER_EVENTS:
            self._user.append(Event(time, line))
            return
        kind = ("touch",) if words[:1] == ["touch"] else tuple(words[:3])
        former = self._others.pop(kind, None)
        self._others[kind] = Event(time, line, former.number + 1 if former else 1)
        if len(self._others) > MAX_EVENTS:
            del self._others[next(iter(self._others))]

    def last(self) -> tuple[Event, ...]:
        """Return the events, oldest first; those without a time come first."""
        both = (*self._others.copy().values(), *tuple(self._user))
        return tuple(sorted(both, key=lambda event: event.time if math.isfinite(event.time) else -math.inf))


Counts = Callable[[], Mapping[str, int]]
#: Returns what is recorded, and why the last recording ended by itself; each may be empty.
RecordingState = Callable[[], tuple[str, str]]


def not_recording() -> tuple[str, str]:
    """Return that nothing is recorded."""
    return "", ""


class ViewState(Sink):
    """Stores the latest data of a run without blocking, and returns a `Snapshot` on request."""

    def __init__(
        self,
        counts: Counts = dict,
        clock: Callable[[], float] = time.monotonic,
        recording: RecordingState = not_recording,
    ) -> None:
        """Start before the first reading; `counts` returns the counters of the source, `clock` the time [s]."""
        self._counts, self._clock, self._recording = counts, clock, recording
        self._update: EstimateUpdate | None = None
        self._has_ended = False
        self._fault, self._n_readings = "", 0
        self._readings, self._updates = RateMeter(clock), RateMeter(clock)
        self._strip: deque[tuple[float, ...]] = deque(maxlen=MAX_STRIP_ROWS)
        self._events, self._tare = EventList(), ""
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
        self._update = update
        self._follow(update)
        force, estimate = float(np.linalg.norm(update.estimate.force_base)), update.estimate
        contact = (estimate.s_contact, estimate.std_s, force if estimate.ok else math.nan)
        self._strip.append((update.reading.time, *update.wrench_base.tolist(), *contact))

    def on_event(self, time: float, line: str) -> None:
        """Store an event."""
        self._events.add(time, line)
        if line.startswith("tare"):
            self._tare = line

    def on_end(self) -> None:
        """Store that no further reading will come."""
        self._has_ended = True

    def snapshot(self, shaped: bool = True) -> Snapshot:
        """Return the current snapshot; the probe's shape is solved here, in the calling thread, if requested."""
        update = self._update
        health = RunHealth(
            self._readings.stale, self._updates.stale, self._readings.silent_for, self._readings.rate,
            self._updates.rate, self._fault, self._n_readings, dict(self._counts()), self._tare, *self._recording(),
            self._has_ended,
        )  # fmt: skip
        events, strip = self._events.last(), self._pop_strip()
        if update is None:
            lines = status_lines(None, None, health)
            return Snapshot(status=lines, events=events, strip=strip, recording=health.recording)
        marker = contact_marker(update, self._touch_number(update))
        return Snapshot(
            time=update.reading.time,
            age=self._updates.silent_for,
            result=update.estimate.result,
            stale=health.stale or health.no_estimate or health.ended,
            recording=health.recording,
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
        rows = [self._strip.popleft() for _ in range(len(self._strip))]
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
