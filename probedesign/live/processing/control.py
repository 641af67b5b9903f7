"""What controls a run: its options, the commands of the user, the tare, and the schedule of estimates."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from queue import Empty, SimpleQueue
from time import monotonic
from typing import Literal, NamedTuple, Protocol

import numpy as np

from probedesign.core.errors import InputError, ProbeDesignError, one_line
from probedesign.core.frames import Array
from probedesign.estimation.estimator import Estimator, Method
from probedesign.live import Log
from probedesign.live.blocks import WrenchReading

MIN_READINGS = 10
"""Minimum number of readings in a tare window: the mean of ten adds a tenth to the variance of every later reading."""
MAX_SCATTER = 3.0
"""Maximum standard deviation of a channel, in units of its noise. Ten readings of pure noise exceed it once in 1e12
windows."""
MAX_STEP = 5.0
"""Maximum step from the first half of a rest to the second, in units of its noise; 0.05 resolution steps of drift in a
second add little to it."""
TARE_DURATION = 2.0
"""Duration of a tare requested during a run [s]; at 194 readings per second the noise of the mean is a twentieth of
theirs."""
REST_TIME, REST_WAIT = 1.0, 3.0
"""Duration of the rest that an automatic tare uses, and of the wait after which its reason is reported [s]."""
CHANNELS = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")

Zero = Literal["checked", "auto", "trusted"]
"""Zero of the sensor without a tare window: nothing, unless readings agree with the free probe without one; the first
second at rest; or the sensor's own zero, taken without the probe."""


@dataclass(frozen=True)
class TareWindow:
    """Time window in which the probe is free: start and exclusive end, counted from the first reading [s]."""

    start: float
    end: float


@dataclass(frozen=True)
class Tare:
    """A sensor bias and the readings it was estimated from."""

    bias_sensor: Array  #: bias to subtract from every reading, in the sensor frame [N, N·m], (6,).
    readings: int  #: number of readings.
    window: TareWindow  #: the window.
    time: float  #: time of the last reading, by the source's clock [s].


class TareCollector:
    """Collects the readings of a tare until the first reading after its window, or until a rest is complete.

    Attributes:
        window: time window in which the probe is free; None: the first `REST_TIME` at rest.
        on_request: whether the tare was requested during the run; otherwise it precedes all estimates.
    """

    def __init__(
        self, window: TareWindow | None, estimator: Estimator, on_request: bool = False, log: Log = lambda line: None
    ) -> None:
        """Start with no readings; `log` receives what an automatic tare waits for."""
        self.window, self.on_request, self._estimator, self._log = window, on_request, estimator, log
        self._readings: list[tuple[float, WrenchReading]] = []
        self._unrest, self._reported = f"there were fewer than {MIN_READINGS} readings in it", False

    @property
    def start(self) -> float:
        """Time of the first reading that counts, since the first of the run [s]."""
        return self._readings[0][0] if self._readings else math.inf

    def add(self, reading: WrenchReading, since: float) -> bool:
        """Add a reading, `since` seconds after the first one of the run; return whether the tare is complete."""
        if self.window is None:
            return self._rests(reading, since)
        if since >= self.window.end:
            return True
        if since >= self.window.start:
            self._readings.append((since, reading))
        return False

    def _rests(self, reading: WrenchReading, since: float) -> bool:
        """Add a reading and return whether those of the last `REST_TIME` are at rest; if not, wait for half of it."""
        if since > REST_WAIT and not self._reported:
            self._reported = True
            self._log(f"--tare auto waits for {REST_TIME:g} s at rest: {self._unrest}")
        if reading.fault:
            self._readings.clear()
            self._unrest = reading.fault
            return False
        self._readings.append((since, reading))
        n, span = len(self._readings), since - self.start
        if n < MIN_READINGS or span * n < REST_TIME * (n - 1):
            return False
        try:
            self.tare()
        except InputError as error:
            self._readings, self._unrest = self._readings[n // 2 :], str(error)
            return False
        return True

    def tare(self) -> Tare:
        """Return the tare; see `take_tare`."""
        readings = [reading for _, reading in self._readings]
        if self.window is not None:
            return take_tare(readings, self.window, self._estimator)
        return take_tare(readings, TareWindow(self.start, self._readings[-1][0]), self._estimator, steady=True)

    def at_end(self) -> Tare:
        """Return the tare at the end of the readings, within its window.

        Raises:
            InputError: the window cannot be used, or there was no rest.
        """
        if self.window is not None:
            return self.tare()
        raise InputError(
            f"--tare auto found no {REST_TIME:g} s at rest: {self._unrest}; give the time when the probe is free as "
            "--tare-s START:END"
        )


def find_rest(readings: list[WrenchReading], estimator: Estimator) -> Tare:
    """Return the tare of the first `REST_TIME` at rest.

    Raises:
        InputError: there is none.
    """
    collector = TareCollector(None, estimator)
    for reading in readings:
        if collector.add(reading, reading.time - readings[0].time):
            return collector.tare()
    return collector.at_end()


def parse_window(text: str) -> TareWindow:
    """Return the window given as START:END in seconds.

    Raises:
        InputError: the text is not two numbers with 0 ≤ START < END.
    """
    start, _, end = text.partition(":")
    try:
        window = TareWindow(float(start), float(end))
    except ValueError:
        window = TareWindow(math.nan, math.nan)
    if not 0.0 <= window.start < window.end < math.inf:
        raise InputError(f"--tare-s {text} must be START:END in seconds from the first reading, START < END")
    return window


def parse_tare(tare_s: str | None, tare: Literal["auto", "none"] | None) -> tuple[TareWindow | None, Zero]:
    """Return the window of --tare-s, if it is given, and the zero that is used otherwise, by --tare.

    Raises:
        InputError: both are given, or the window is invalid.
    """
    if tare_s is not None and tare is not None:
        raise InputError(f"--tare {tare} and --tare-s {tare_s} exclude each other; give one of them")
    zeros: dict[str | None, Zero] = {None: "checked", "auto": "auto", "none": "trusted"}
    return (None if tare_s is None else parse_window(tare_s)), zeros[tare]


def take_tare(readings: list[WrenchReading], window: TareWindow, estimator: Estimator, steady: bool = False) -> Tare:
    """Estimate the sensor bias from readings of a window in which nothing touches the probe.

    A constant contact force cannot be distinguished from a bias; the user is responsible for a free probe. With
    `steady`, the means of the two halves of the window must agree, too, and errors do not name the window, which the
    user did not choose.

    Raises:
        InputError: there are too few readings, or they scatter more than those of a free probe.
    """
    label = "" if steady else f"tare window {window.start:g}:{window.end:g} s "
    unsteady = f"{label}is not steady: " if label else ""
    if len(readings) < MIN_READINGS:
        raise InputError(f"{label}has {len(readings)} readings; a tare needs {MIN_READINGS}")
    if fault := next((reading.fault for reading in readings if reading.fault), ""):
        raise InputError(f"{label}has readings with a fault: {fault}")
    free: dict[bytes, Array] = {}  # by gravity, which is mostly the same
    for reading in readings:
        if (key := reading.gravity_base.tobytes()) not in free:
            free[key] = _free_wrench(reading, estimator)
    wrenches = np.array([reading.wrench_sensor for reading in readings])
    excess = wrenches - np.array([free[reading.gravity_base.tobytes()] for reading in readings])
    bias, std = excess.mean(axis=0), excess.std(axis=0, ddof=1)
    noise = estimator.model.noise.std
    if (std > MAX_SCATTER * noise).any():
        i = int(np.argmax(std / noise))
        unit = "mN" if i < 3 else "Nmm"
        scatter = f"{CHANNELS[i]} scatters by {std[i] * 1e3:.3g} {unit}, its noise is {noise[i] * 1e3:.3g} {unit}"
        raise InputError(f"{unsteady}{scatter}; touched, moving or not averaged?")
    half = len(excess) // 2
    step = np.abs(excess[-half:].mean(axis=0) - excess[:half].mean(axis=0))
    if steady and (step > MAX_STEP * noise * math.sqrt(2.0 / half)).any():
        i = int(np.argmax(step / noise))
        raise InputError(f"{unsteady}{CHANNELS[i]} changes; touched or moving?")
    return Tare(bias, len(readings), window, readings[-1].time)


def _free_wrench(reading: WrenchReading, estimator: Estimator) -> Array:
    """Return the wrench that an unbiased sensor measures with the free probe, (6,)."""
    free = estimator.free(reading.gravity_base)
    if not free.ok:
        raise InputError(f"the free probe has no equilibrium under gravity {reading.gravity_base} m/s²")
    return estimator.model.to_sensor(free.wrench_base, reading.gravity_base)


def readings_in(window: TareWindow, readings: list[WrenchReading]) -> list[WrenchReading]:
    """Return the readings inside the window."""
    return [r for r in readings if window.start <= r.time - readings[0].time < window.end]


def describe_tare(tare: Tare) -> str:
    """Return the tare as one line."""
    bias = ", ".join(
        f"{name} {value * 1e3:.3g} {'mN' if name[0] == 'F' else 'Nmm'}"
        for name, value in zip(CHANNELS, tare.bias_sensor.tolist(), strict=True)
    )
    return f"tare from {tare.readings} readings in {tare.window.start:g}:{tare.window.end:g} s: {bias}"


@dataclass(frozen=True)
class ProcessingOptions:
    """Options for processing the readings of a source."""

    window: TareWindow | None = None  #: window of the tare, in which the probe is free; None: see `zero`.
    #: number of readings averaged to one; None: as the noise of the first readings and their rate require.
    samples: int | None = 1
    rate: float = math.inf  #: maximum number of estimates per second of the source's clock [Hz].
    count: int | None = None  #: end after this many estimates.
    seconds: float | None = None  #: end this long after the first reading [s].
    #: cut-off frequency of the low-pass filter before each estimate; None does not filter.
    filter_hz: float | None = None
    #: whether contacts are located as readings arrive; otherwise only phases and touches are reported.
    estimates: bool = True
    method: Method = "ml"  #: method by which a single reading is located.
    zero: Zero = "checked"  #: zero of the sensor that is used without a tare window.
    touches: bool = True  #: whether touches are reported, and fused where poses are known.

    def __post_init__(self) -> None:
        """Check the numbers; raises InputError if one is not positive."""
        limits = {"average": self.samples, "rate-hz": self.rate, "count": self.count, "seconds": self.seconds,
                "filter-hz": self.filter_hz}  # fmt: skip
        for name, value in limits.items():
            if value is not None and not value > 0:
                raise InputError(f"--{name} {value} must be positive")


CommandName = Literal["tare", "mark", "start recording", "stop recording", "stop"]


class CommandDescription(NamedTuple):
    """A command's key in the terminal, and what it does."""

    key: str
    text: str


COMMANDS: dict[CommandName, CommandDescription] = {
    "tare": CommandDescription("t", f"take a tare from the next {TARE_DURATION:g} s"),
    "mark": CommandDescription("m", "mark this time, with a note"),
    "start recording": CommandDescription("r", "start a recording, in a new file"),
    "stop recording": CommandDescription("s", "stop the recording"),
    "stop": CommandDescription("q", "end the run"),
}
"""Every command. Keys, the page, datagrams and services of ROS 2 offer these, and `CommandQueue` executes them."""
MAX_NOTE = 200
"""Maximum number of characters of a mark."""


class CommandResult(NamedTuple):
    """Whether a command was accepted, and the outcome or the reason of the refusal."""

    accepted: bool
    text: str


class Command(NamedTuple):
    """One command of the user, with the text of a mark, and a callback that receives the result."""

    name: CommandName
    text: str = ""
    reply: Callable[[CommandResult], None] = lambda result: None


class CommandQueue:
    """Passes commands from any thread to the processing thread, which executes them between two blocks of readings."""

    def __init__(self) -> None:
        self._queue: SimpleQueue[Command] = SimpleQueue()
        self._handlers: dict[CommandName, Callable[[Command], str | None]] = {}

    def register(self, name: CommandName, handler: Callable[[Command], str | None]) -> None:
        """Register the handler of a command, which is called in the processing thread.

        It returns the outcome, if it does not report that itself, and raises `ProbeDesignError` to refuse the command.
        """
        self._handlers[name] = handler

    def put(
        self, name: CommandName, text: str = "", reply: Callable[[CommandResult], None] = lambda result: None
    ) -> None:
        """Queue a command; the result is reported to every sink as an event, and to `reply`."""
        self._queue.put(Command(name, one_line(text, MAX_NOTE), reply))

    def execute(self, log: Log) -> bool:
        """Execute all commands since the last call in order and report their results; return whether to stop."""
        while True:
            try:
                command = self._queue.get_nowait()
            except Empty:
                return False
            result = self._execute(command)
            if result.text:
                log(result.text)
            command.reply(result)
            if command.name == "stop":
                return True

    def _execute(self, command: Command) -> CommandResult:
        if command.name == "stop":
            return CommandResult(True, "the run is ended by a command")
        handler = self._handlers.get(command.name)
        if handler is None:
            return CommandResult(False, f"{command.name} is not available here")
        try:
            return CommandResult(True, handler(command) or "")
        except ProbeDesignError as error:
            return CommandResult(False, f"{command.name} refused: {error}")


class Recordings(Protocol):
    """What starts and stops recordings, and reports it."""

    def start(self) -> str:
        """Open the next file and return what is recorded; raises `ProbeDesignError` if that is refused."""

    def stop(self) -> str:
        """Close the file and return what was recorded; raises `ProbeDesignError` if there is none."""


def register_recording(commands: CommandQueue, recordings: Recordings) -> None:
    """Register the commands that start and stop recordings."""
    commands.register("start recording", lambda command: recordings.start())
    commands.register("stop recording", lambda command: recordings.stop())


MAX_AGE = 0.012
"""Maximum age of a reading that is still located [s].

An older reading is skipped where a newer one has arrived: its estimate would be replaced at once, and delay all later
ones. It is still recorded, monitored and fused. A reading that no contact explains takes longest, about 8 ms, so every
estimate is available within 20 ms."""

REPORT_PERIOD, MAX_SKIPPED_SHARE = 5.0, 0.05
"""Reporting period by the source's clock [s], and the fraction of skipped estimates that is reported at once."""


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
        self._start, self._reported, self._overloaded = -math.inf, (0, 0), False

    def set_period(self, period: float) -> None:
        """State the interval between readings [s]: the newest reading is never skipped, however late it is."""
        self.max_age = max(self.max_age, period)

    def is_due(self, reading: WrenchReading, ready: float = -math.inf) -> bool:
        """Return whether the reading is to be located.

        `ready` is the time by `time.monotonic` at which the base pose became available [s], if the reading waited.
        """
        # A tolerance of 1 % keeps a source that runs at exactly this rate from losing estimates to rounding.
        if reading.time < self._next - 0.01 * self._period:
            return False
        following = self._next + self._period
        self._next = following if following > reading.time else reading.time + self._period
        if reading.time - self._start > REPORT_PERIOD:
            self._report(reading.time)
        # The age is NaN, and so never too large, without hardware.
        skipped = monotonic() - max(reading.received, ready) > self.max_age
        self.n_due, self.n_skipped = self.n_due + 1, self.n_skipped + skipped
        return not skipped

    def finish(self) -> None:
        """Report the number of skipped estimates, if any."""
        if self.n_skipped:
            self._log(
                f"{self.n_skipped} of {self.n_due} estimates were skipped: each was more than "
                f"{1e3 * self.max_age:.3g} ms late, with newer readings queued"
            )

    def _report(self, time: float) -> None:
        """Report when the fraction of skipped estimates exceeds the limit, and when it recovers."""
        n_due, n_skipped = self.n_due - self._reported[0], self.n_skipped - self._reported[1]
        self._start, self._reported = time, (self.n_due, self.n_skipped)
        overloaded = n_skipped > MAX_SKIPPED_SHARE * n_due
        if overloaded and not self._overloaded:
            self._log(
                f"{n_skipped} of {n_due} estimates skipped in {REPORT_PERIOD:g} s: each was more than "
                f"{1e3 * self.max_age:.3g} ms late; reduce --rate-hz"
            )
        elif self._overloaded and not overloaded:
            self._log("estimates are on time again")
        self._overloaded = overloaded
