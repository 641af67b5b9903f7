"""The tare: what the sensor reads more than it should while the probe is free. Only ever on demand."""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from probedesign.errors import InputError
from probedesign.estimation.estimator import Estimator
from probedesign.frames import Array
from probedesign.live.processing.blocks import Reading

FEWEST = 10
"""Readings of a window: their mean adds a tenth to the variance of every later reading."""
STEADY = 3.0
"""A channel that scatters more than this many times its noise is not the noise of a free probe. Ten readings
of pure noise do so once in 1e12 windows."""
ASKED = 2.0
"""How long a tare takes that is asked for while live runs [s]; with 194 readings a second its mean leaves a twentieth
of their noise."""
CHANNELS = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")


@dataclass(frozen=True)
class Window:
    """When the probe is free.

    Attributes:
        start: from the first reading [s].
        end: from the first reading [s]; not in the window itself.
    """

    start: float
    end: float


@dataclass(frozen=True)
class Tare:
    """A bias and what it was taken from.

    Attributes:
        bias_sensor: to take from every reading, in the sensor frame [N, N·m], (6,).
        std_sensor: scatter of the window's readings [N, N·m], (6,).
        readings: how many there were.
        window: when.
        time: of the last of them, by the source's clock [s].
    """

    bias_sensor: Array
    std_sensor: Array
    readings: int
    window: Window
    time: float


class Taring:
    """A tare that is being taken: readings of its window gather until the first one after it.

    Attributes:
        window: when the probe is free.
        asked: whether it was asked for while live ran.
    """

    def __init__(self, window: Window, estimator: Estimator, asked: bool = False) -> None:
        """Begin.

        Args:
            window: when the probe is free.
            estimator: of the probe.
            asked: while live runs; else it comes before anything else.
        """
        self.window, self.asked = window, asked
        self._estimator = estimator
        self._inside: list[Reading] = []

    def over(self, reading: Reading, since: float) -> bool:
        """Take in a reading that came so long after the first one [s]; whether it lies after the window."""
        if since >= self.window.end:
            return True
        if since >= self.window.start:
            self._inside.append(reading)
        return False

    def tare(self) -> Tare:
        """What was found.

        Raises:
            InputError: as of `take_tare`.
        """
        return take_tare(self._inside, self.window, self._estimator)


def parse_window(text: str) -> Window:
    """The window that START:END in seconds names.

    Raises:
        InputError: these are no two numbers, 0 ≤ START < END.
    """
    start, _, end = text.partition(":")
    try:
        window = Window(float(start), float(end))
    except ValueError:
        window = Window(math.nan, math.nan)
    if not 0.0 <= window.start < window.end < math.inf:
        raise InputError(f"--tare-s {text} must be START:END in seconds from the first reading, START < END")
    return window


def take_tare(readings: list[Reading], window: Window, estimator: Estimator) -> Tare:
    """Bias of the sensor from the readings of a window in which nothing touches the probe.

    A touch that stays perfectly still looks like a bias: that nothing touches is the user's word.

    Args:
        readings: those of the window.
        window: when they were read.
        estimator: of the probe, for what the free probe weighs and for the noise.

    Raises:
        InputError: the readings are too few, or scatter more than a free probe's.
    """
    told = f"tare window {window.start:g}:{window.end:g} s"
    if len(readings) < FEWEST:
        raise InputError(f"{told} holds {len(readings)} readings; a tare needs {FEWEST}")
    if fault := next((reading.fault for reading in readings if reading.fault), ""):
        raise InputError(f"{told} holds readings with a fault: {fault}")
    excess = np.array([reading.wrench_sensor - _free(reading, estimator) for reading in readings])
    bias, std = excess.mean(axis=0), excess.std(axis=0, ddof=1)
    noise = np.sqrt(np.diag(estimator.model.noise.covariance()))
    if (std > STEADY * noise).any():
        raise InputError(f"{told} is not steady: {_worst(std, noise)}; touched, moving or not averaged?")
    return Tare(bias, std, len(readings), window, readings[-1].time)


def _free(reading: Reading, estimator: Estimator) -> Array:
    """What a sensor without bias reads of the free probe, (6,)."""
    free = estimator.free(reading.gravity_base)
    if not free.ok:
        raise InputError(f"the free probe has no equilibrium under gravity {reading.gravity_base} m/s²")
    return estimator.model.to_sensor(free.wrench_base, reading.gravity_base)


def _worst(std: Array, noise: Array) -> str:
    """The channel that scatters most for its noise."""
    i = int(np.argmax(std / noise))
    milli = "mN" if i < 3 else "Nmm"
    return f"{CHANNELS[i]} scatters by {std[i] * 1e3:.3g} {milli}, its noise is {noise[i] * 1e3:.3g} {milli}"


def split(readings: Iterable[Reading], window: Window) -> tuple[list[Reading], Iterator[Reading]]:
    """Readings of the window, read as soon as they are there, and the stream of those after it."""
    stream = iter(readings)
    inside: list[Reading] = []
    start: float | None = None
    for reading in stream:
        start = reading.time if start is None else start
        if reading.time - start >= window.end:
            return inside, chain([reading], stream)
        if reading.time - start >= window.start:
            inside.append(reading)
    return inside, iter(())


def without_bias(reading: Reading, tare: Tare | None) -> Reading:
    """The reading less the bias; itself where no tare was taken."""
    if tare is None:
        return reading
    return replace(reading, wrench_sensor=reading.wrench_sensor - tare.bias_sensor)


def describe_tare(tare: Tare) -> str:
    """The tare in one line."""
    bias = ", ".join(
        f"{name} {value * 1e3:.3g} {'mN' if name[0] == 'F' else 'Nmm'}"
        for name, value in zip(CHANNELS, tare.bias_sensor.tolist(), strict=True)
    )
    return f"tare from {tare.readings} readings in {tare.window.start:g}:{tare.window.end:g} s: {bias}"
