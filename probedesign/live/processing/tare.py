"""Tare: the sensor bias, estimated from readings of the free probe. It is taken only on request."""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from probedesign.core.errors import InputError
from probedesign.core.frames import Array
from probedesign.estimation.estimator import Estimator
from probedesign.live.processing.blocks import WrenchReading

MIN_READINGS = 10
"""Minimum number of readings in a tare window: the mean of ten adds a tenth to the variance of every later reading."""
MAX_SCATTER = 3.0
"""Maximum standard deviation of a channel, in units of its noise. Ten readings of pure noise exceed it once in 1e12
windows."""
TARE_DURATION = 2.0
"""Duration of a tare requested during a run [s]; at 194 readings per second the noise of the mean is a twentieth of
theirs."""
CHANNELS = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")


@dataclass(frozen=True)
class TareWindow:
    """Time window in which the probe is free.

    Attributes:
        start: start, counted from the first reading [s].
        end: end, counted from the first reading [s]; exclusive.
    """

    start: float
    end: float


@dataclass(frozen=True)
class Tare:
    """A sensor bias and the readings it was estimated from.

    Attributes:
        bias_sensor: bias to subtract from every reading, in the sensor frame [N, N·m], (6,).
        std_sensor: standard deviation of the readings in the window [N, N·m], (6,).
        readings: number of readings.
        window: the window.
        time: time of the last reading, by the source's clock [s].
    """

    bias_sensor: Array
    std_sensor: Array
    readings: int
    window: TareWindow
    time: float


class TareCollector:
    """Collects the readings of a tare window until the first reading after it.

    Attributes:
        window: time window in which the probe is free.
        on_request: whether the tare was requested during the run.
    """

    def __init__(self, window: TareWindow, estimator: Estimator, on_request: bool = False) -> None:
        """Start with no readings.

        Args:
            window: time window in which the probe is free.
            estimator: estimator of the probe.
            on_request: whether the tare was requested during the run; otherwise it precedes all estimates.
        """
        self.window, self.on_request = window, on_request
        self._estimator = estimator
        self._readings: list[WrenchReading] = []

    def add(self, reading: WrenchReading, since: float) -> bool:
        """Add a reading, `since` seconds after the first one of the run; return whether it lies after the window."""
        if since >= self.window.end:
            return True
        if since >= self.window.start:
            self._readings.append(reading)
        return False

    def tare(self) -> Tare:
        """Return the tare.

        Raises:
            InputError: see `take_tare`.
        """
        return take_tare(self._readings, self.window, self._estimator)


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


def take_tare(readings: list[WrenchReading], window: TareWindow, estimator: Estimator) -> Tare:
    """Estimate the sensor bias from readings of a window in which nothing touches the probe.

    A constant contact force cannot be distinguished from a bias; the user is responsible for a free probe.

    Args:
        readings: readings of the window.
        window: the window.
        estimator: estimator of the probe, for the weight of the free probe and the noise.

    Raises:
        InputError: there are too few readings, or they scatter more than those of a free probe.
    """
    label = f"tare window {window.start:g}:{window.end:g} s"
    if len(readings) < MIN_READINGS:
        raise InputError(f"{label} has {len(readings)} readings; a tare needs {MIN_READINGS}")
    if fault := next((reading.fault for reading in readings if reading.fault), ""):
        raise InputError(f"{label} has readings with a fault: {fault}")
    excess = np.array([reading.wrench_sensor - _free_wrench(reading, estimator) for reading in readings])
    bias, std = excess.mean(axis=0), excess.std(axis=0, ddof=1)
    noise = estimator.model.noise.std
    if (std > MAX_SCATTER * noise).any():
        raise InputError(
            f"{label} is not steady: {_largest_scatter(std, noise)}; touched, moving or not averaged?"
        )
    return Tare(bias, std, len(readings), window, readings[-1].time)


def _free_wrench(reading: WrenchReading, estimator: Estimator) -> Array:
    """Return the wrench that an unbiased sensor measures with the free probe, (6,)."""
    free = estimator.free(reading.gravity_base)
    if not free.ok:
        raise InputError(f"the free probe has no equilibrium under gravity {reading.gravity_base} m/s²")
    return estimator.model.to_sensor(free.wrench_base, reading.gravity_base)


def _largest_scatter(std: Array, noise: Array) -> str:
    """Describe the channel with the largest scatter relative to its noise."""
    i = int(np.argmax(std / noise))
    milli = "mN" if i < 3 else "Nmm"
    return f"{CHANNELS[i]} scatters by {std[i] * 1e3:.3g} {milli}, its noise is {noise[i] * 1e3:.3g} {milli}"


def split_at_tare(
    readings: Iterable[WrenchReading], window: TareWindow
) -> tuple[list[WrenchReading], Iterator[WrenchReading]]:
    """Return the readings inside the window, consumed at once, and the iterator of the readings after it."""
    stream = iter(readings)
    inside: list[WrenchReading] = []
    start: float | None = None
    for reading in stream:
        start = reading.time if start is None else start
        if reading.time - start >= window.end:
            return inside, chain([reading], stream)
        if reading.time - start >= window.start:
            inside.append(reading)
    return inside, iter(())


def without_bias(reading: WrenchReading, tare: Tare | None) -> WrenchReading:
    """Return the reading minus the bias; the reading itself if there is no tare."""
    if tare is None:
        return reading
    return replace(reading, wrench_sensor=reading.wrench_sensor - tare.bias_sensor)


def describe_tare(tare: Tare) -> str:
    """Return the tare as one line."""
    bias = ", ".join(
        f"{name} {value * 1e3:.3g} {'mN' if name[0] == 'F' else 'Nmm'}"
        for name, value in zip(CHANNELS, tare.bias_sensor.tolist(), strict=True)
    )
    return f"tare from {tare.readings} readings in {tare.window.start:g}:{tare.window.end:g} s: {bias}"
