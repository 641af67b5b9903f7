"""Processing chain from blocks of raw readings to estimates: gravity, tare, phase and fusion, estimate.

The output does not depend on how the source cuts its blocks: all processing is on batches of as many samples as are
averaged to one reading. A replay therefore reproduces the estimates of the live run.
"""

import math
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import islice
from time import monotonic

import numpy as np

from probedesign.core.errors import InputError
from probedesign.core.frames import Array
from probedesign.estimation.estimate import Estimate, FusedEstimate
from probedesign.estimation.estimator import Estimator, Method
from probedesign.live import Log
from probedesign.live.blocks import Block, WrenchReading, joined
from probedesign.live.poses.base_poses import BasePoses
from probedesign.live.processing.averaging import AveragedBatch, Averager
from probedesign.live.processing.estimates import (
    NO_DRIFT,
    UNKNOWN_POSE,
    UNKNOWN_WRENCH,
    EstimateUpdate,
    locate,
    wrench_without_bias,
)
from probedesign.live.processing.motion import MotionMonitor
from probedesign.live.processing.payload import PayloadCheck
from probedesign.live.processing.plausibility import FaultReport, PoseMonitor, SignalMonitor
from probedesign.live.processing.screen import SampleScreen
from probedesign.live.processing.tare import (
    CHANNELS,
    TARE_DURATION,
    Tare,
    TareCollector,
    TareWindow,
    Zero,
    describe_tare,
    is_free,
    mains_hum,
)
from probedesign.live.processing.touches import Contact, ContactHistory, TouchMonitor, TouchState


@dataclass(frozen=True)
class ProcessingOptions:
    """Options for processing the readings of a source."""

    window: TareWindow | None = None  #: window of the tare, in which the probe is free; None: see `zero`.
    #: number of readings averaged to one; None: as the noise of the first readings and their rate require.
    samples: int | None = 1
    rate: float = math.inf  #: maximum number of estimates per second of the source's clock [Hz].
    count: int | None = None  #: end after this many estimates.
    seconds: float | None = None  #: end this long after the first reading [s].
    #: whether contacts are located as readings arrive; otherwise only phases and touches are reported.
    estimates: bool = True
    method: Method = "ml"  #: method by which a single reading is located.
    zero: Zero = "checked"  #: zero of the sensor that is used without a tare window.
    #: frequency of the mains, whose hum each mean excludes by covering whole periods [Hz]; None: not considered.
    mains_hz: float | None = None
    deadline: float | None = None  #: age from which a reading is not located any more [s]; None: `MAX_AGE`.
    touches: bool = True  #: whether touches are reported, and fused where poses are known.

    def __post_init__(self) -> None:
        limits = {"average": self.samples, "rate-hz": self.rate, "count": self.count, "seconds": self.seconds,
                "mains-hz": self.mains_hz, "deadline-ms": self.deadline and 1e3 * self.deadline}  # fmt: skip
        for name, value in limits.items():
            if value is not None and not value > 0:
                raise InputError(f"--{name} {value} must be positive")
        if self.mains_hz is not None and self.samples is not None:
            raise InputError(f"--average {self.samples} and --mains-hz {self.mains_hz:g} exclude each other")


#: Maximum age of a reading that is still located [s]. An older reading is skipped where a newer one has arrived: its
#: estimate would be replaced at once, and delay all later ones. It is still recorded, monitored and fused. A reading
#: that no contact explains takes longest, about 8 ms, so every estimate is available within 20 ms.
MAX_AGE = 0.012
MAX_BURST = 0.2  #: Longest burst of readings that are all located although they arrive together [s].


class EstimateScheduler:
    """Limits the rate of estimates by the source's clock and skips readings that are too old.

    Attributes:
        n_due: number of estimates that were due.
        n_skipped: number of due estimates that were skipped because their reading was too old.
        max_age: age from which a reading is skipped [s].
    """

    def __init__(self, rate: float, log: Log, max_age: float = MAX_AGE) -> None:
        """Start with nothing due; `rate` is a maximum [Hz], `max_age` [s] is infinite if no consumer waits."""
        self.max_age, self._log = max_age, log
        self._period, self._next = 1.0 / rate, -math.inf
        self.n_due = self.n_skipped = 0

    def is_due(self, reading: WrenchReading, ready: float = -math.inf) -> bool:
        """Return whether the reading is to be located.

        `ready` is the time by `time.monotonic` at which the base pose became available [s], if the reading waited.
        """
        # A tolerance of 1 % keeps a source that runs at exactly this rate from losing estimates to rounding.
        if reading.time < self._next - 0.01 * self._period:
            return False
        following = self._next + self._period
        self._next = following if following > reading.time else reading.time + self._period
        # The age is NaN, and so never too large, without hardware.
        skipped = monotonic() - max(reading.received, ready) > self.max_age
        self.n_due, self.n_skipped = self.n_due + 1, self.n_skipped + skipped
        return not skipped

    def finish(self) -> None:
        """Report the number of skipped estimates, if any."""
        if self.n_skipped:
            self._log(
                f"{self.n_skipped} of {self.n_due} estimates were skipped: each was more than "
                f"{1e3 * self.max_age:.3g} ms late, with newer readings queued; reduce --rate-hz"
            )


MIN_RATE_SAMPLES = 8  #: Number of samples from which the rate of the source is determined before processing starts.
MAX_TARE_BATCHES = 1000  #: Maximum number of batches of a tare window that calibrate the detector: the last ones.
NO_TARE = (
    "no tare: the readings are not those of a free probe, so there is no position; give --tare auto if the probe is "
    "free in its first second at rest, --tare-s START:END, or --tare none if the sensor's zero was taken without the "
    "probe"
)


class Chain:
    """Processes blocks and yields estimates.

    Attributes:
        tare: bias subtracted from every reading; None without a tare.
        scheduler: counts the estimates that were due and skipped.
        averager: has the number of readings averaged to one.
    """

    def __init__(
        self,
        estimator: Estimator,
        options: ProcessingOptions,
        poses: BasePoses | None,
        log: Log,
        tare: Tare | None = None,
    ) -> None:
        """Start with no readings; with a `tare` that was taken beforehand, that of the options is not taken."""
        self.tare = tare
        self._estimator, self._options, self._poses, self._log = estimator, options, poses, log
        mains = options.mains_hz
        self._periods = None if mains is None else Averager(None, estimator.model, log, mains)
        self._raw = SampleScreen(estimator.model, estimator.model.averaging_samples)
        samples = options.samples if mains is None else 1
        self.averager, self._waiting = Averager(samples, estimator.model, log), deque[AveragedBatch]()
        takes_tare = tare is None and (options.window is not None or options.zero == "auto")
        self._tare_collector = TareCollector(options.window, estimator, log=log) if takes_tare else None
        self._zero_known = tare is not None or takes_tare or options.zero == "trusted"
        self._zero_reported = False
        self._signals = SignalMonitor(estimator.model, 1, math.nan)
        self._base = PoseMonitor()
        self._motion = None if poses is None else MotionMonitor(estimator.model, poses)
        self._payload = PayloadCheck(estimator.model, log)
        self._faults = FaultReport(log)
        self._free = deque[AveragedBatch](maxlen=MAX_TARE_BATCHES)
        self._contacts = ContactHistory()
        self._monitor: TouchMonitor | None = None
        self._rate = self._first = math.nan
        self._now = -math.inf
        age = (options.deadline or MAX_AGE) if options.estimates else math.inf
        self.scheduler = EstimateScheduler(options.rate, log, age)
        self._stretch = 0
        self._state = TouchState("", None)
        self._pose_missing, self._touched_at_tare = False, ""

    @property
    def contacts(self) -> tuple[Contact, ...]:
        """Every touch so far."""
        return self._contacts.contacts

    def process(self, block: Block) -> Iterator[EstimateUpdate]:
        """Yield the estimates that a block completes."""
        if len(block) == 0:
            return
        self._now = float(block.time[-1])
        n_waiting, now = len(self._waiting), monotonic()  # readings that waited for a pose
        if self._poses is not None:
            self._poses.refresh(block)
        # What was read over a while and arrives at once is as late as that, without the processing being slow.
        burst = float((block.time[-1] - block.time[0]) - (block.received[-1] - block.received[0]))
        if self._options.deadline is None and burst > self.scheduler.max_age:
            self.scheduler.max_age = min(burst, MAX_BURST)
        if self._periods is not None:
            for raw in self._periods.add(block):
                (_, reading), fault = self._raw.check(raw)
                mean = Block(np.array([reading.time]), reading.wrench_sensor[None], reading.gravity_base,
                             np.array([reading.received]), reading.fault or fault, reading.stretch)  # fmt: skip
                self._waiting.extend(self.averager.add(mean))
        else:
            self._waiting.extend(self.averager.add(block))
        if math.isnan(self._rate) and not self._initialize():
            return
        while self._waiting and not (
            self._poses is not None and self._poses.may_arrive(self._waiting[0].reading.time, self._now)
        ):
            yield from self._step(self._waiting.popleft(), now if n_waiting > 0 else -math.inf)
            n_waiting -= 1

    def finish(self) -> Iterator[EstimateUpdate]:
        """Yield the remaining estimates after the source has ended.

        Raises:
            InputError: the tare window was not complete and cannot be used.
        """
        if not self.averager.samples:
            self._waiting.extend(self.averager.finish())
            self._initialize()
        while self._waiting:
            yield from self._step(self._waiting.popleft(), math.inf)
        if math.isnan(self._first) and self.averager.n_pending:
            readings, samples = self.averager.n_pending, self.averager.samples
            self._log(f"{readings} readings are fewer than the {samples} of a mean: no estimate")
        if self._tare_collector is not None and not self._tare_collector.on_request:
            self._log(describe_tare(self._tare_collector.at_end()))

    def take_tare(self, force: bool = False) -> str:
        """Start a tare from the next readings; return what to do meanwhile. Its outcome is reported.

        Args:
            force: take it whatever the phase; what it takes for granted is stated.

        Raises:
            InputError: the tare is refused.
        """
        if math.isnan(self._first):
            raise InputError("there is no reading yet")
        if self._tare_collector is not None:
            raise InputError("a tare is already being taken")
        if not force and (why := self._tare_refusal()):
            raise InputError(why)
        start = self._now - self._first
        window = TareWindow(start, start + TARE_DURATION)
        self._tare_collector = TareCollector(window, self._estimator, on_request=True, forced=force)
        self._touched_at_tare = self._tare_refusal() and self._state.phase
        return f"tare: keep the probe free and still for {TARE_DURATION:g} s"

    def _initialize(self) -> bool:
        """Determine the sampling rate and set up what depends on it; return False while there are too few samples."""
        samples = self.averager.samples
        needed = math.ceil(MIN_RATE_SAMPLES / samples) if samples else 1
        if len(self._waiting) < needed:
            return False
        time = np.concatenate([batch.block.time for batch in islice(self._waiting, needed)])
        step = float(np.median(np.diff(time))) or float(time[-1] - time[0]) / (len(time) - 1)
        self._rate = 1.0 / step if step > 0.0 else math.inf
        known = self._rate if math.isfinite(self._rate) else math.nan
        self._signals = SignalMonitor(self._estimator.model, samples, known)
        self._signals.preview(islice(self._waiting, needed))
        if math.isinf(self._rate):
            self._log("the source's clock does not advance: phases are off")
            return True
        # The newest reading is never skipped, however late it is.
        self.scheduler.max_age = max(self.scheduler.max_age, samples / self._rate)
        self._reset_monitor()
        if self.tare is not None and self._monitor is not None:
            # It was taken beforehand, or is that of a later window of the same recording.
            age = max(self.tare.window.start, float(time[0]) - self.tare.time)
            if age > 0.0:
                self._monitor.rest(age)
        return True

    def _reset_monitor(self) -> None:
        self._monitor = TouchMonitor(
            self._estimator, self._contacts, self._rate, self.averager.samples, self._poses, self._log,
            self._options.estimates and self._options.touches,
        )  # fmt: skip

    def _step(self, batch: AveragedBatch, ready: float) -> Iterator[EstimateUpdate]:
        """Yield the estimate of a batch, if one is due; see `EstimateScheduler.is_due` for `ready`."""
        time, reported, monitor = batch.reading.time, batch.reading.fault, self._monitor
        if math.isnan(self._first):
            self._first = time
        # A fault of one sample is a fault of the whole batch: the mean would not show it.
        batch, fault = self._signals.check(batch)
        self._signals.screen.report(time, self._log)
        T = None if self._poses is None else self._poses.at(time)
        if self._poses is not None and (T is None) != self._pose_missing:
            self._pose_missing = T is None
            why = f"{self._poses.reason(time)}; no estimates until one is available"
            self._log(why if T is None else "the base pose is available again")
        batch = self._at_pose(batch, fault, T)
        reading = batch.reading
        self._faults.update(time, "" if reported or self._pose_missing else reading.fault)
        if monitor is not None and self._base.leapt == time:
            monitor.on_leap(time)
        if reading.stretch != self._stretch:  # readings are missing before this one
            self._stretch = reading.stretch
            if monitor is not None:
                monitor.on_interruption()
        self._collect_tare(batch)
        if self._tare_collector is not None and not self._tare_collector.on_request:
            return
        if not self._zero_known and not reading.fault:
            self._zero_known = is_free(reading, self._estimator)
            if not self._zero_known and not self._zero_reported:
                self._zero_reported = True
                self._log(NO_TARE)
        if self._monitor is None or reading.fault or not self._zero_known:
            self._state = TouchState("", None if self._poses is None else FusedEstimate("out_of_range"))
        else:
            self._state = self._monitor.update(batch, self.tare, T, self._motion)
        if self.scheduler.is_due(reading, ready):
            yield self._estimate(reading, T)

    def _at_pose(self, batch: AveragedBatch, fault: str, T: Array | None) -> AveragedBatch:
        """Return a batch with the effective gravity at its time and without what a turning base adds, or with a fault.

        `T` is the pose of the base; None if it is fixed, or its pose unknown.
        """
        block, reading = batch
        if self._poses is None or self._motion is None:
            return AveragedBatch(block, replace(reading, fault=fault)) if fault else batch
        self._motion.update(reading.time)
        if T is None:
            reading = replace(reading, fault=fault or self._poses.reason(reading.time))
        else:
            leap, added = self._base.fault(reading.time, T), self._motion.inertia(T)
            wrench, gravity = reading.wrench_sensor - added, self._motion.gravity(T)
            reading = replace(reading, gravity_base=gravity, wrench_sensor=wrench, fault=fault or leap)
            if added.any():
                block = replace(block, wrench_sensor=block.wrench_sensor - added)
        if self._base.leapt == reading.time:
            self._motion.reset()
        self._payload.add(reading, self._motion.at_rest and self._motion.explained)
        return AveragedBatch(block, reading)

    def _estimate(self, reading: WrenchReading, T: Array | None) -> EstimateUpdate:
        """Return the estimate of a reading at a pose of the base, if that is known, with the current state."""
        monitor, options, estimator = self._monitor, self._options, self._estimator
        drift, moving = (None, False) if monitor is None else (monitor.drift, monitor.in_motion)
        excess, wrench, estimate = NO_DRIFT if drift is None else drift.excess, UNKNOWN_WRENCH, Estimate("unobservable")
        if not reading.fault:
            wrench = wrench_without_bias(estimator.model, reading, self.tare) - excess
        if reading.fault:
            estimate = Estimate("out_of_range")
        elif not self._zero_known:
            estimate = Estimate("no_tare")
        elif monitor is not None and monitor.warming_up:
            estimate = Estimate("warming_up")
        elif drift is not None and moving and estimator.with_drift(drift.steps).detects(wrench, reading.gravity_base):
            estimate = Estimate("in_motion")
        elif options.estimates:
            estimate = locate(estimator, reading, self.tare, options.method, drift)
            self._contacts.locate(estimate, self._state.phase)
        stale = "pose" if self._poses is not None and T is None else ""
        return EstimateUpdate(reading, estimate, *self._state, UNKNOWN_POSE if T is None else T, wrench, monotonic(),
                              stale, self.contacts, excess,
                              math.nan if self._motion is None else self._motion.time_to_rest)  # fmt: skip

    def _collect_tare(self, batch: AveragedBatch) -> None:
        """Add a batch to the active tare; take the tare when its window is over."""
        collector, reading = self._tare_collector, batch.reading
        if collector is None:
            return
        if collector.on_request and not collector.forced and (why := self._tare_refusal()):
            self._tare_collector = None
            self._free.clear()
            return self._log(f"tare refused: {why}")
        if not collector.add(reading, reading.time - self._first):
            self._free.append(batch)
            return
        free, self._tare_collector, last = tuple(self._free), None, self.tare
        self._free.clear()
        raw = joined([batch.block for batch in free]) if free else None
        hum = "" if raw is None else mains_hum(raw.time, raw.wrench_sensor)
        try:
            self.tare = collector.tare()
        except InputError as error:
            refusal = f"{error}; {hum}" if hum else str(error)
            if not collector.on_request:
                raise InputError(refusal) from None
            return self._log(f"tare refused: {refusal}")
        self._log(describe_tare(self.tare))
        if hum:
            self._log(f"tare: {hum}")
        doubts = [self.tare.assumed] if self.tare.assumed else []
        if self._touched_at_tare:
            known = last.bias_sensor if last else np.zeros(6)
            change = (self.tare.bias_sensor - known) / self._estimator.model.noise.std
            i = int(np.argmax(np.abs(change)))
            doubts.append(f"it counted as {self._touched_at_tare}, and {CHANNELS[i]} is {abs(change[i]):.3g} standard "
                          "deviations of a reading from the previous zero")  # fmt: skip
        if doubts:
            self._log(f"tare: the probe was taken to be free although {'; '.join(doubts)}")
        self._touched_at_tare = ""
        self._zero_known = True
        self._contacts.update(reading.time, "", None)
        if self._monitor is not None:
            self._reset_monitor()
            since = self._first + collector.start
            self._monitor.calibrate([b for b in free if b.reading.time >= since], self.tare)

    def _tare_refusal(self) -> str:
        """Return why a requested tare is refused: the probe is not free; empty if it may be taken.

        While the sensor's zero is unknown this cannot be decided: a bias looks like a touch.
        """
        phase = self._state.phase
        free = not self._zero_known or phase in ("", "free")
        return "" if free else f'the probe is {phase}; the previous tare is kept, unless it is asked for with "force"'
