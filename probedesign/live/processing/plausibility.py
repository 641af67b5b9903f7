"""Plausibility of the signals: readings that no working sensor gives, and poses that no robot can have.

A reading with a fault has no position. Each check has a limit far beyond what a working sensor or robot does, and the
fault ends with the first readings that pass it. All checks are the same in a replay.
"""

import math
from collections import deque
from collections.abc import Iterable

import numpy as np

from probedesign.core.frames import Array
from probedesign.estimation.model import ProbeModel
from probedesign.live import Log
from probedesign.live.processing.averaging import AveragedBatch, second_differences
from probedesign.live.processing.screen import SampleScreen
from probedesign.live.processing.tare import CHANNELS

#: Interval over which the noise is measured, and time from one measurement to the next [s]. A knock is shorter than
#: half of the interval, and noise is found after that half.
NOISE_WINDOW, NOISE_PERIOD = 0.25, 0.1
#: Least number of readings of the first measurement, and of a complete window. Too little noise shows in the last
#: readings of a window alone.
MIN_NOISE_READINGS, WINDOW_READINGS = 8, 16
#: Limits of the measured noise over the stated one. Beyond the upper one, free readings count as touches; the lower one
#: is that of values in a unit a thousand times too large, or of a filter far below the rate of the readings. Noise as
#: stated exceeded the upper one in none of 300,000 simulated windows of the least number of readings.
MAX_NOISE, MIN_NOISE = 4.0, 0.02
#: Rate below which the noise of a channel is not separated from motion [Hz]: second differences of a sway at 5 Hz by 3
#: mN at mid-length reach the stated noise of means at 150 Hz. Below it, and while there are few readings, noise is
#: measured in the dimensions that no force explains.
MIN_NOISE_RATE = 150.0
#: Dimensions in which one force on the probe changes the six channels. Sway and touch change them in so many.
FORCE_DIMENSIONS = 3
#: Largest speed [m/s] and rate of rotation [rad/s] of a base. Assumed: faster than any arm moves a probe; light arms
#: reach 2 m/s and 7 rad/s.
MAX_SPEED, MAX_TURN = 5.0, 15.0
LEAP_HOLD = 0.25  #: Time without a leap after which poses count again [s]: poses that flicker are not used in between.
QUANTILE = 0.6745  #: Median of the magnitude of a standard normal.


class FaultReport:
    """Reports a fault where it begins, and its end, at most once a second."""

    def __init__(self, log: Log) -> None:
        self._log, self._ongoing, self._reported = log, "", -math.inf

    def update(self, time: float, fault: str) -> None:
        """Take in the fault of a reading at a time [s]; empty without one."""
        if bool(fault) == bool(self._ongoing):
            return
        if fault and time - self._reported < 1.0:
            return
        self._log(f"fault: {fault}; no position until it ends" if fault else "the fault has ended")
        self._ongoing, self._reported = fault, time


class SignalMonitor:
    """Checks the readings of a sensor, batch by batch."""

    def __init__(self, model: ProbeModel, samples: int, rate: float) -> None:
        """Start without readings at a rate [Hz], NaN if unknown; the mean of `samples` has the noise of the model."""
        self._noise = model.noise.std * math.sqrt(samples)
        self.screen = SampleScreen(model, samples, rate)
        self._samples, self._rate = samples, rate
        self._window_readings = max(WINDOW_READINGS, NOISE_WINDOW * rate)  # the first one where the rate is NaN
        self._window = deque[Array]()
        self._in_window, self._noise_fault = 0, ""
        self._next_noise, self._next_count = math.inf, MIN_NOISE_READINGS
        self._stretch = 0

    def preview(self, batches: Iterable[AveragedBatch]) -> None:
        """Measure the noise of the first batches, so that it is known when the first of them is checked."""
        rows = np.concatenate([batch.block.wrench_sensor for batch in batches])
        self._noise_fault = self._noise_of(rows)
        self.screen.start(rows)

    def check(self, batch: AveragedBatch) -> tuple[AveragedBatch, str]:
        """Return a batch without spikes and its fault; empty without one. One that the source reports comes first."""
        block = batch.block
        if block.fault:
            return batch, block.fault
        if block.stretch != self._stretch:  # a fault of the noise lasts until it is measured again
            self._stretch, self._in_window = block.stretch, 0
            self._next_noise, self._next_count = math.inf, MIN_NOISE_READINGS
            self._window.clear()
        batch, fault = self.screen.check(batch)
        if fault:
            return batch, fault
        # The noise of a channel is a median, in which spikes do not count.
        rows = (block if self._rate >= MIN_NOISE_RATE else batch.block).wrench_sensor
        time = block.time
        self._window.append(rows)
        self._in_window += len(rows)
        while self._in_window - len(self._window[0]) >= self._window_readings:
            self._in_window -= len(self._window.popleft())
        now = float(time[-1])
        if self._in_window >= self._next_count or now >= self._next_noise:  # twice as many as before, or periodically
            self._next_noise, self._next_count = now + NOISE_PERIOD, 2 * self._in_window
            self._noise_fault = self._noise_of(np.concatenate(self._window))
        return batch, self._noise_fault

    def _noise_of(self, rows: Array) -> str:
        """Return the fault of the noise of readings (n, 6), by second differences, which no slow signal shows in."""
        if len(rows) < MIN_NOISE_READINGS:
            return ""
        bends = second_differences(rows, self._noise)
        if self._rate >= MIN_NOISE_RATE and len(rows) >= WINDOW_READINGS:
            usual = np.median(np.abs(bends), axis=0) / QUANTILE
            largest, name = float(usual.max()), CHANNELS[int(np.argmax(usual))]
        else:
            largest, name = _unexplained(bends), "the sensor"
        if largest > MAX_NOISE:
            hint = "; readings are not averaged?" if self._samples == 1 else ""
            return f"{name} scatters by {largest:.2g} times its stated noise{hint}"
        last = bends[-WINDOW_READINGS:]
        size = float(np.sqrt(np.mean(last * last, axis=0)).max())
        if size < MIN_NOISE:
            return f"readings scatter by {size:.1g} times their stated noise; a wrong unit?"
        return ""


def _unexplained(bends: Array) -> float:
    """Return the standard deviation of scaled second differences (n, 6) in the dimensions that no force explains.

    The principal components of a touch and of a sway are removed with those of the largest variance. Without motion
    these contain noise, and the rest has less: for few rows the result is divided by a value between the fraction
    that is left then (0.37 for six rows, 0.72 for 28, simulated) and one. Noise of eight times the stated one is found
    in 80 % of windows of eight readings, and in 99.8 % of 16.
    """
    n, k = len(bends) - FORCE_DIMENSIONS, 6 - FORCE_DIMENSIONS
    values = np.linalg.svd(bends, compute_uv=False)[FORCE_DIMENSIONS:]
    return math.sqrt(float(values @ values) / (n * k)) / (1.0 - 1.1 / math.sqrt(len(bends)))


class PoseMonitor:
    """Checks that the base moves as a robot can.

    Attributes:
        leapt: time of the last leap [s]; minus infinity without one.
    """

    def __init__(self) -> None:
        self._last: tuple[float, Array] | None = None
        self.leapt = -math.inf
        self._reason = ""

    def fault(self, time: float, T_world_base: Array) -> str:
        """Return the fault of the pose at a time [s], (4, 4); empty without one."""
        last, self._last = self._last, (time, T_world_base)
        if last is None or not time > last[0]:
            return self._reason if time - self.leapt < LEAP_HOLD else ""
        seconds = time - last[0]
        squares = np.square(T_world_base[:3] - last[1][:3])
        travel = math.sqrt(squares[:, 3].sum())
        chord = math.sqrt(squares[:, :3].sum())  # the Frobenius norm |R - R'|, which is 2√2 sin(angle/2)
        turn = 2.0 * math.asin(min(chord / (2.0 * math.sqrt(2.0)), 1.0))
        if travel > MAX_SPEED * seconds or turn > MAX_TURN * seconds:
            self.leapt = time
            degrees = math.degrees(turn)
            self._reason = (
                f"the base leapt by {1e3 * travel:.3g} mm and {degrees:.2g}° in {1e3 * seconds:.3g} ms; "
                "positions in the wrong unit?"
            )
        return self._reason if time - self.leapt < LEAP_HOLD else ""
