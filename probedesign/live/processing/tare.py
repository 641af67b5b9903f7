"""Tare: the bias of the sensor, from readings of a free probe in a given window or in the first second at rest."""

import math
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from probedesign.core.errors import InputError
from probedesign.core.frames import Array
from probedesign.estimation.estimator import Estimator
from probedesign.estimation.model import WALK_SECONDS
from probedesign.live import Log
from probedesign.live.blocks import WrenchReading

#: Minimum number of readings in a tare window: the mean of ten adds a tenth to the variance of every later reading.
MIN_READINGS = 10
#: Maximum standard deviation of a channel, in units of its noise. Ten readings of pure noise exceed it once in 1e12
#: windows.
MAX_SCATTER = 3.0
#: Maximum step from the first half of a rest to the second, in units of its noise; 0.05 resolution steps of drift in a
#: second add little to it.
MAX_STEP = 5.0
#: Duration of a tare requested during a run [s]; at 194 readings per second the noise of the mean is a twentieth of
#: theirs.
TARE_DURATION = 2.0
#: Duration of the rest that an automatic tare uses, and of the wait after which its reason is reported [s].
REST_TIME, REST_WAIT = 1.0, 3.0
#: Maximum drift, in steps of the resolution a second: twice the fastest that was measured of three Nano17 that
#: warmed up. A change that is faster is a touch. Assumed.
MAX_DRIFT = 10.0
CHANNELS = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")

#: Zero of the sensor without a tare window: nothing, unless readings agree with the free probe without one; the first
#: second at rest; or the sensor's own zero, taken without the probe.
Zero = Literal["checked", "auto", "trusted"]


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
    rate_sensor: Array = field(default_factory=lambda: np.zeros(6))  #: its drift in the window [N/s, N·m/s], (6,).
    #: covariance of level and rate in units of the variance of one reading [1, 1/s; 1/s, 1/s²], (2, 2).
    cov: Array = field(default_factory=lambda: np.zeros((2, 2)))
    #: rate of the channel that drifts fastest, in steps of the resolution a minute; 0 if it is not significant.
    steps_min: float = 0.0
    assumed: str = ""  #: what a tare that was taken by force took for granted.


class TareCollector:
    """Collects the readings of a tare until the first reading after its window, or until a rest is complete.

    Without a window that is the first `REST_TIME` at rest. A tare that was not requested precedes all estimates.
    """

    def __init__(
        self, window: TareWindow | None, estimator: Estimator, on_request: bool = False, log: Log = lambda line: None,
        forced: bool = False,
    ) -> None:  # fmt: skip
        """Start with no readings; `log` receives what an automatic tare waits for; see `take_tare` for `forced`."""
        self.window, self.on_request, self._estimator, self._log = window, on_request, estimator, log
        self.forced = forced
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
            return take_tare(readings, self.window, self._estimator, forced=self.forced)
        return take_tare(readings, TareWindow(self.start, self._readings[-1][0]), self._estimator, steady=True)

    def at_end(self) -> Tare:
        """Return the tare at the end of the readings, within its window.

        Raises:
            InputError: the window cannot be used, or there was no rest.
        """
        if self.window is not None:
            return self.tare()
        raise InputError(f"--tare auto found no {REST_TIME:g} s at rest: {self._unrest}; give the time when the probe "
                         "is free as --tare-s START:END")  # fmt: skip


def tare_of(readings: list[WrenchReading], window: TareWindow | None, estimator: Estimator) -> Tare:
    """Return the tare of the readings of a recording: in a window, or else in the first `REST_TIME` at rest.

    Raises:
        InputError: the window cannot be used, or there is no rest.
    """
    collector = TareCollector(window, estimator)
    for reading in readings:
        if collector.add(reading, reading.time - readings[0].time):
            return collector.tare()
    return collector.at_end()


def is_free(reading: WrenchReading, estimator: Estimator) -> bool:
    """Return whether a reading agrees with the free probe, without a tare: then the sensor's own zero is right."""
    gravity = reading.gravity_base
    if reading.fault or not estimator.free(gravity).ok:
        return False
    return not estimator.detects(estimator.model.to_base(reading.wrench_sensor, gravity), gravity)


def parse_window(text: str) -> TareWindow:
    """Return the window given as START:END in seconds; raises InputError if they are not 0 ≤ START < END."""
    start, _, end = text.partition(":")
    try:
        window = TareWindow(float(start), float(end))
    except ValueError:
        window = TareWindow(math.nan, math.nan)
    if not 0.0 <= window.start < window.end < math.inf:
        raise InputError(f"--tare-s {text} must be START:END in seconds from the first reading, START < END")
    return window


def parse_tare(tare_s: str | None, tare: Literal["auto", "none"] | None) -> tuple[TareWindow | None, Zero]:
    """Return the window of --tare-s, if it is given, and the zero that is used otherwise, by --tare."""
    if tare_s is not None and tare is not None:
        raise InputError(f"--tare {tare} and --tare-s {tare_s} exclude each other; give one of them")
    zeros: dict[str | None, Zero] = {None: "checked", "auto": "auto", "none": "trusted"}
    return (None if tare_s is None else parse_window(tare_s)), zeros[tare]


def take_tare(
    readings: list[WrenchReading], window: TareWindow, estimator: Estimator, steady: bool = False, forced: bool = False
) -> Tare:
    """Estimate the sensor bias and its drift from readings of a window in which nothing touches the probe.

    Level and rate are those of a straight line by least squares. A constant contact force cannot be distinguished from
    a bias, nor one that grows steadily from a drift; the user is responsible for a free probe. With `steady`, the means
    of the two halves of the window must agree or differ by a drift rather than by a step, too, and errors do not name
    the window, which the user did not choose. With `forced`, readings that scatter are accepted.

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
    for gravity in {reading.gravity_base.tobytes(): reading.gravity_base for reading in readings}.values():
        equilibrium = estimator.free(gravity)
        if not equilibrium.ok:
            raise InputError(f"the free probe has no equilibrium under gravity {gravity} m/s²")
        free[gravity.tobytes()] = estimator.model.to_sensor(equilibrium.wrench_base, gravity)
    wrenches = np.array([reading.wrench_sensor for reading in readings])
    excess = wrenches - np.array([free[reading.gravity_base.tobytes()] for reading in readings])
    n, time = len(readings), np.array([reading.time for reading in readings])
    since = time - time.mean()
    spread = max(float(since @ since), 1e-300)
    bias, rate = excess.mean(axis=0), since @ excess / spread
    std = (excess - bias - since[:, None] * rate).std(axis=0, ddof=2)
    noise, assumed = estimator.model.noise.std, ""
    if (std > MAX_SCATTER * noise).any():
        i = int(np.argmax(std / noise))
        unit = "mN" if i < 3 else "Nmm"
        assumed = f"{CHANNELS[i]} scatters by {std[i] * 1e3:.3g} {unit}, its noise is {noise[i] * 1e3:.3g} {unit}"
        if not forced:
            raise InputError(f"{unsteady}{assumed}; touched, moving or not averaged?")
    half = n // 2
    step = np.abs(excess[-half:].mean(axis=0) - excess[:half].mean(axis=0))
    if steady and (step > MAX_STEP * noise * math.sqrt(2.0 / half)).any():
        i = int(np.argmax(step / noise))
        # What a line and what a step at the best time explain of the channel's scatter.
        k, sums = np.arange(1, n), np.cumsum(excess[:, i] - bias[i])[:-1]
        if float((sums**2 * n / (k * (n - k))).max()) > rate[i] ** 2 * spread:
            raise InputError(f"{unsteady}{CHANNELS[i]} changes at once; touched or moving?")
    steps = noise * math.sqrt(estimator.model.averaging_samples)
    # A walk of variance q t adds 6 q/(5 T) to the variance of the slope of a line over T.
    q = estimator.priors.walk_steps**2 / WALK_SECONDS
    doubt = steps * math.sqrt(1.0 / estimator.model.averaging_samples / spread + 1.2 * q / (time[-1] - time[0] or 1.0))
    drifts = np.abs(rate) > MAX_STEP * doubt
    fastest = 60.0 * float((np.abs(rate) / steps)[drifts].max(initial=0.0))
    if not forced and (np.abs(rate) > MAX_DRIFT * steps).any():
        i = int(np.argmax(np.abs(rate) / steps))
        raise InputError(f"{unsteady}{CHANNELS[i]} changes faster than a sensor drifts; touched or moving?")
    cov = np.diag([1.0 / n, 1.0 / spread])
    return Tare(bias, n, window, readings[-1].time, rate, cov, fastest, assumed)


MAINS = (50.0, 60.0)  #: Frequencies of the mains [Hz].
MIN_HUM = 70.0  #: χ² of twelve degrees of freedom that noise alone exceeds once in 3·10⁹ tares.


def mains_hum(time: Array, wrench_sensor: Array) -> str:
    """Return the hum of the mains in samples of a free probe, and the remedy; empty without.

    Sine and cosine of 50 and 60 Hz are fitted beside a straight line; n A²/(2 σ²) of amplitude A in scatter σ is χ² of
    two degrees of freedom in each channel.

    Args:
        time: of the samples [s], (n,).
        wrench_sensor: the samples [N, N·m], (n, 6).
    """
    n, since = len(time), time - time[:1]
    if n < 100 or not n / since[-1] > 4.0 * MAINS[-1]:
        return ""
    for frequency in MAINS:
        angle = 2.0 * math.pi * frequency * since
        columns = np.stack([np.ones(n), since, np.cos(angle), np.sin(angle)], axis=1)
        fitted = np.linalg.lstsq(columns, wrench_sensor)[0]
        amplitude = np.hypot(fitted[2], fitted[3])
        scatter = np.maximum((wrench_sensor - columns @ fitted).std(axis=0), 1e-12)
        if float((n * (amplitude / scatter) ** 2).sum() / 2.0) > MIN_HUM:
            i = int(np.argmax(amplitude / scatter))
            size = f"{1e3 * amplitude[i]:.2g} {'mN' if i < 3 else 'Nmm'} in {CHANNELS[i]}"
            return f"hum of the mains, {size}; with --mains-hz {frequency:g} each mean covers whole periods"
    return ""


def describe_tare(tare: Tare) -> str:
    """Return the tare as one line."""
    bias = ", ".join(
        f"{name} {value * 1e3:.3g} {'mN' if name[0] == 'F' else 'Nmm'}"
        for name, value in zip(CHANNELS, tare.bias_sensor.tolist(), strict=True)
    )
    drift = f"; the zero drifts by {tare.steps_min:.3g} steps of the resolution a minute" if tare.steps_min else ""
    return f"tare from {tare.readings} readings in {tare.window.start:g}:{tare.window.end:g} s: {bias}{drift}"
