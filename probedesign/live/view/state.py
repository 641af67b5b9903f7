"""State of a run for the views: a sink that stores the latest data, snapshots of it, status lines, and chart data.

A snapshot is made of one update, so that everything drawn is of one instant.
"""

import math
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import starmap
from typing import Any, Literal, NamedTuple

import numpy as np

from probedesign.core.frames import Array
from probedesign.core.units import MILLINEWTON, MM, N_MM
from probedesign.estimation.estimate import RESULTS, Estimate
from probedesign.estimation.model import ProbeModel
from probedesign.geometry.tube import BentShape, TubeMesh
from probedesign.live.blocks import Block
from probedesign.live.outputs.sinks import Sink
from probedesign.live.poses.base_poses import TimedPose
from probedesign.live.processing.estimates import (
    ContactMarker,
    EstimateUpdate,
    bent_shape,
    contact_marker,
    interval_text,
)
from probedesign.live.processing.payload import AVERAGING, MEASURED, MIN_ORIENTATIONS, Guide, RestCollector
from probedesign.live.processing.touches import Contact
from probedesign.web.scene import RigidPart

Level = Literal["good", "fair", "bad", "plain"]


class StatusLine(NamedTuple):
    """One line of the status: its topic, its text, and how good or bad it is."""

    name: str
    text: str
    level: Level = "plain"


class Event(NamedTuple):
    """An event: its source's time [s] and its text."""

    time: float
    line: str


#: Number of a touch, the touched point [m], (3,), and whether that is in the world or the base frame.
TouchPoint = tuple[int, Array, bool]
MAX_TOUCHES = 24  #: Maximum number of earlier touches that are drawn.


def touch_points(contacts: tuple[Contact, ...]) -> list[TouchPoint]:
    """Return the touches that have ended and were located: fused, or of a base that does not move."""
    points: list[TouchPoint] = []
    for contact in (contact for contact in contacts[-MAX_TOUCHES:] if not contact.ongoing):
        if contact.fused is not None and contact.fused.ok:
            points.append((contact.number, contact.fused.p_surface_world, True))
        elif contact.fused is None and contact.estimate is not None:
            points.append((contact.number, contact.estimate.p_surface_base, False))
    return points


#: Columns of a row of a strip chart: wall clock [s], [N], [N·m], [m], [N], drift of the bias [N], whether the probe
#: touches, and whether the user marked this time.
STRIP = ("time", "Fx", "Fy", "Fz", "Mx", "My", "Mz", "s", "std_s", "force", "bias_x", "bias_y", "bias_z", "touch",
         "mark")  # fmt: skip


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
    touches: Sequence[TouchPoint] = ()  #: the earlier touches that were located, the last ones.
    #: pose of the base, (4, 4); NaN if unknown.
    T_world_base: Array = field(default_factory=lambda: np.full((4, 4), np.nan))
    gravity_base: Array = field(default_factory=lambda: np.array([0.0, 0.0, -9.81]))  #: gravity vector [m/s²], (3,).
    #: rows of `STRIP` since the last snapshot, (j, 15).
    strip: Array = field(default_factory=lambda: np.empty((0, len(STRIP))))
    events: tuple[Event, ...] = ()  #: last events, oldest first.
    #: touched points of the last single readings, of the world where the pose is known, else of the base [m], (k, 3).
    cloud: Array = field(default_factory=lambda: np.empty((0, 3)))
    guide: Guide | None = None  #: of a calibration.

    @property
    def has_pose(self) -> bool:
        """Whether the pose of the base is known."""
        return bool(np.isfinite(self.T_world_base).all())


#: Level of each result, "bad" of all others.
LEVELS: dict[str, Level] = {
    "ok": "good", "no_contact": "plain", "too_light": "fair", "ambiguous": "fair", "interval_only": "fair",
    "in_motion": "fair", "warming_up": "fair",
}  # fmt: skip
LOSSES = ("lost", "late", "dropped", "faults")  #: Counters of the source that are shown.


def _contact_lines(marker: ContactMarker | None, estimate: Estimate) -> list[StatusLine]:
    if marker is None:
        interval = interval_text(estimate)
        text = f"s {interval}" if interval else "–"
        return [StatusLine("contact", text), StatusLine("point", "–"), StatusLine("force", "–")]
    frame = "world" if marker.in_world else "base"
    stds = _numbers(np.sqrt(np.maximum(np.diag(marker.cov), 0.0)), MM)
    ratio = marker.friction_ratio
    friction = f", tangential over normal {ratio:.2f}" if np.isfinite(ratio) else ""  # not with every method
    return [
        StatusLine("contact", f"s {marker.s / MM:.1f} ± {marker.std_s / MM:.1f} mm"),
        StatusLine("point", f"{_numbers(marker.p_surface, MM)} mm, {frame}; ± {stds} mm"),
        StatusLine("force", f"{float(np.linalg.norm(marker.force)) / MILLINEWTON:.1f} mN{friction}"),
    ]


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


MAX_EVENTS = 12  #: Maximum number of events that are kept: the last ones. All are on standard error and in a recording.
CLOUD = 200  #: Number of estimates in a cloud.
MAX_STRIP_ROWS = 4096  #: Maximum number of queued chart rows; at 30 snapshots per second there are a few.


class ViewState(Sink):
    """Stores the latest data of a probe without blocking, and returns a `Snapshot` on request."""

    def __init__(
        self,
        counts: Callable[[], Mapping[str, int]] = dict,  # of the source
        clock: Callable[[], float] = time.monotonic,
        recording: Callable[[], tuple[str, str]] = lambda: ("", ""),  # what is recorded, and why it ended by itself
        name: str = "",
    ) -> None:
        """Start before the first reading; events of a probe begin with its `name` in a run with several."""
        self._prefix = f"{name}: " if name else ""
        self._counts, self._clock, self._recording = counts, clock, recording
        self._update: EstimateUpdate | None = None
        self._has_ended = False
        self._fault, self._n_readings = "", 0
        self._readings, self._updates = RateMeter(clock), RateMeter(clock)
        self._strip: deque[tuple[float, ...]] = deque(maxlen=MAX_STRIP_ROWS)
        self._events, self._tare, self._marked = deque[Event](maxlen=MAX_EVENTS), "", False
        self._cloud = deque[tuple[Array, bool]](maxlen=CLOUD)  # points, and whether each is of the world
        self._wall_offset = math.nan  # wall clock minus the source's clock [s]

    def on_samples(self, block: Block) -> None:
        """Store the fault and the rate of readings."""
        self._fault = block.fault
        if len(block):
            self._n_readings += len(block)
            self._readings.add(len(block))

    def on_estimate(self, update: EstimateUpdate) -> None:
        """Store an estimate."""
        self._updates.add(1)
        estimate, now = update.estimate, update.reading.time
        if self._update is None or now < self._update.reading.time:
            self._wall_offset = time.time() - now
        self._update = update
        force = float(np.linalg.norm(estimate.force_base)) if estimate.ok else math.nan
        if estimate.ok:
            T, known = update.T_world_base, bool(np.isfinite(update.T_world_base).all())
            p = estimate.p_surface_base
            self._cloud.append((T[:3, :3] @ p + T[:3, 3] if known else p, known))
        state = (update.phase in ("touching", "settled"), self._marked)
        self._marked = False
        self._strip.append((self._wall_offset + now, *update.wrench_base.tolist(), estimate.s_contact, estimate.std_s,
                            force, *update.drift_base[:3].tolist(), *state))  # fmt: skip

    def on_event(self, time: float, line: str) -> None:
        """Store an event; the next estimate carries a mark."""
        self._events.append(Event(time, line))
        text = line.removeprefix(self._prefix)
        self._marked |= text.startswith("mark")
        if text.startswith("tare"):
            self._tare = text

    def on_end(self) -> None:
        """Store that no further reading will come."""
        self._has_ended = True

    def snapshot(self, shaped: bool = True) -> Snapshot:
        """Return the current snapshot; the probe's shape is solved here, in the calling thread, if requested."""
        update, recording = self._update, self._recording()
        marker = None if update is None else contact_marker(update)
        rows = [self._strip.popleft() for _ in range(len(self._strip))]
        known = Snapshot(
            recording=recording[0],
            status=tuple(self._status(update, marker, *recording)),
            events=tuple(self._events.copy()),
            strip=np.array(rows).reshape(-1, len(STRIP)),
        )
        if update is None:
            return known
        has_pose = bool(np.isfinite(update.T_world_base).all())
        return replace(
            known,
            cloud=np.array([p for p, world in self._cloud.copy() if world is has_pose]).reshape(-1, 3),
            time=update.reading.time,
            age=self._updates.silent_for,
            result=update.estimate.result,
            stale=self._readings.stale or self._updates.stale or self._has_ended,
            shape=bent_shape(update) if shaped else None,
            marker=marker,
            touches=touch_points(update.contacts),
            T_world_base=update.T_world_base,
            gravity_base=update.reading.gravity_base,
        )

    def _status(
        self, update: EstimateUpdate | None, marker: ContactMarker | None, recording: str, recording_failed: str
    ) -> Iterator[StatusLine]:
        """Yield all status lines, most important first; dashes where unknown, so that lines keep their positions."""
        yield self._result_line(update)
        rates = [f"{self._readings.rate:.0f} readings/s", f"{self._updates.rate:.0f} estimates/s"]
        if update is not None:
            yield StatusLine("phase", update.phase or "not monitored")
            yield from _contact_lines(marker, update.estimate)
            if (fused := update.fused) is not None:
                low, high = fused.object_compliance_interval_95 / MM
                yields = f", yields {low:.0f} to {high:.0f} mm/N" if high > 0.0 else ""
                point = f"{_numbers(fused.p_surface_world, MM)} mm, world, ± {fused.rms / MM:.1f} mm{yields}"
                yield StatusLine("fused", point if fused.ok else fused.result)
            elif update.stale:
                yield StatusLine("fused", f"no {update.stale}", "fair")
            known, wrench = bool(np.isfinite(update.wrench_base).all()), update.wrench_base
            forces, moments = _numbers(wrench[:3], MILLINEWTON), _numbers(wrench[3:], N_MM, 2)
            yield StatusLine("forces", f"{forces} mN at the base" if known else "–")
            yield StatusLine("moments", f"{moments} N·mm" if known else "–")
            if np.isfinite(latency := update.computed - update.reading.received):
                rates.append(f"{1e3 * latency:.1f} ms from reading to estimate")
        if self._fault:
            yield StatusLine("fault", self._fault, "bad")
        yield StatusLine("rate", ", ".join(rates).replace("nan", "–"))
        counts = dict(self._counts())
        lost = ", ".join(f"{counts[name]} {name}" for name in LOSSES if counts.get(name))
        yield StatusLine("loss", f"{lost or 'none known'} of {self._n_readings} readings", "fair" if lost else "plain")
        yield StatusLine("tare", self._tare.removeprefix("tare").lstrip(": ") or "none taken")
        level: Level = "good" if recording else "bad" if recording_failed else "plain"
        yield StatusLine("recording", recording or recording_failed or "no", level)

    def _result_line(self, update: EstimateUpdate | None) -> StatusLine:
        age = self._readings.silent_for
        text = f"{age:.1f} s" if age < 120.0 else f"{age / 60.0:.0f} min" if math.isfinite(age) else "–"
        if self._has_ended:
            return StatusLine("result", f"the run has ended: all values are {text} old")
        if self._readings.stale:
            return StatusLine("result", f"stale: no reading for {text}", "bad")
        if update is None:
            return StatusLine("result", "no estimate yet" if self._n_readings else "no reading yet", "fair")
        if self._updates.stale:
            return StatusLine("result", "no recent estimate: the values shown are old", "bad")
        result = update.estimate.result
        return StatusLine("result", f"{result}: {RESULTS[result]}", LEVELS.get(result, "bad"))


class GuideState(ViewState):
    """State of a calibration: its guide, and at the end its result."""

    def __init__(
        self, collector: RestCollector, model: ProbeModel, gravity_world: Array,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:  # fmt: skip
        super().__init__(clock=clock)
        self._collector, self._model, self._gravity = collector, model, gravity_world
        self._result: tuple[StatusLine, ...] = ()

    def show_result(self, verdict: str, good: bool, rows: Mapping[str, str]) -> None:
        """Show the verdict and the results by name from now on."""
        self._result = (StatusLine("result", verdict, "good" if good else "bad"), *starmap(StatusLine, rows.items()))

    def snapshot(self, shaped: bool = True) -> Snapshot:
        """Return the current snapshot; the base stays where it is and turns."""
        guide, T, stale = self._collector.guide, np.eye(4), self._readings.stale and not self._result
        T[:3, :3] = self._collector.R
        free = self._model.rod.solve(T[:3, :3].T @ self._gravity) if shaped else None
        level: Level = "good" if guide.state == MEASURED else "fair" if guide.state == AVERAGING else "plain"
        state = f"{guide.state}: {guide.progress:.0%}" if guide.state == AVERAGING else guide.state
        lines = (
            StatusLine("state", f"no reading for {self._readings.silent_for:.0f} s" if stale else state,
                       "bad" if stale else level),
            StatusLine("guide", guide.text, "good" if guide.enough else "plain"),
            StatusLine("measured", f"{len(guide.measured)} orientations, of at least {MIN_ORIENTATIONS}"),
            StatusLine("rate", f"{self._readings.rate:.0f} readings/s".replace("nan", "–")),
        )  # fmt: skip
        shape = None if free is None or not free.ok else BentShape(free.s, free.p_base, free.R_base)
        return Snapshot(status=self._result or lines, events=tuple(self._events.copy()), guide=guide, stale=stale,
                        shape=shape, T_world_base=T, result="ended" if self._result else "")  # fmt: skip


CHART_SECONDS = 30.0
CHART_POINTS = 450  #: Points of a chart: 15 per second.
REDRAW_PERIOD = 0.1  #: Minimum interval between redraws [s]: all points are sent each time.


class StripCharts:
    """Data of the strip charts over the last seconds; NaN where unknown."""

    def __init__(self) -> None:
        self._rows: deque[Array] = deque(maxlen=CHART_POINTS)
        self._due = self._last_drawn = -np.inf

    def add(self, strip: Array) -> bool:
        """Add rows of `STRIP`, thinned, with every mark; return whether to redraw. Decreasing time clears them."""
        for row in strip:
            if row[0] < self._due - 2.0 * CHART_SECONDS / CHART_POINTS:
                self._rows.clear()
                self._due = self._last_drawn = -np.inf
            if row[0] >= self._due or row[-1]:
                self._rows.append(row)
                self._due = row[0] + 0.9 * CHART_SECONDS / CHART_POINTS
        due = self._due >= self._last_drawn + REDRAW_PERIOD
        if due:
            self._last_drawn = self._due
        return due

    def columns(self) -> dict[str, Array]:
        """Return the columns of `STRIP` over the last seconds, each (j,), with one row of NaN at least."""
        rows = np.array(self._rows or [np.full(len(STRIP), np.nan)])
        rows = rows[~(rows[:, 0] < rows[-1, 0] - CHART_SECONDS)]
        return dict(zip(STRIP, np.ascontiguousarray(rows.T), strict=True))


class RunView(Sink):
    """What a view stores: the state of each probe of a run."""

    def __init__(self, states: Mapping[str, ViewState]) -> None:
        self.states = states

    def pass_on(self, call: str, *data: Any) -> None:
        """Store data of a probe, and an event or the end for each."""
        named = [each.probe for each in data if isinstance(each, Block | EstimateUpdate | TimedPose)]
        for state in [self.states[name] for name in named] or self.states.values():
            getattr(state, call)(*data)

    def snapshots(self, shaped: bool = True) -> list[Snapshot]:
        """Return the current snapshot of each probe; see `ViewState.snapshot`."""
        return [state.snapshot(shaped) for state in self.states.values()]


@dataclass(frozen=True)
class SceneSetup:
    """Static content of the page for one probe."""

    title: str  #: name and fingerprint of the probe.
    tube: TubeMesh  #: mesh of the probe.
    free: BentShape  #: shape of the free probe.
    parts: tuple[RigidPart, ...]  #: parts at its base.
    gravity_base: Array  #: gravity vector [m/s²], (3,).
    limits: tuple[float, float, float]  #: of force and moment at the base and of the contact's force [N, N·m, N].
    note: str = ""  #: note on what is drawn, if any.


@dataclass(frozen=True)
class PageSetup:
    """Static content of the page."""

    host: str  #: host, port: address of the server; the next free port is used.
    port: int
    scenes: tuple[SceneSetup, ...]  #: that of each probe.
    token: str = ""  #: secret that a browser must know; empty on an address of this machine only.
    guided: bool = False  #: whether a calibration is guided, instead of a run shown.

    @property
    def title(self) -> str:
        """Title of the page."""
        return "probedesign " + ", ".join(scene.title for scene in self.scenes)
