"""Averaging of readings to one; by default as many as their noise and rate require."""

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from probedesign.core.errors import InputError
from probedesign.core.frames import Array
from probedesign.estimation.model import ProbeModel
from probedesign.live import Log
from probedesign.live.blocks import Block, TrueContact, WrenchReading, joined

MAX_MEAN_RATE = 500.0  #: Rate above which readings are single samples unless their noise shows that they are not [Hz].
#: Least and largest number of first readings that decide, and their duration [s].
MIN_READINGS, MAX_READINGS, MAX_TIME = 8, 64, 1.0
#: Correlation of successive second differences below which readings scatter by noise: -2/3 for noise, positive for a
#: slow signal.
WHITE = -0.35
#: Factor between the measured variance and that of single samples, or of the model's means, within which readings are
#: taken for those: 64 readings measure it to 15 %.
NEAR = 2.0
MEDIAN = 0.4549  #: Median of χ² with one degree of freedom.


MIN_PERIOD = 2  #: Least number of readings in a period of the mains.
LONG_MEAN = 0.25  #: Duration of a mean from which it is stated [s]: a touch counts as settled after so long.


class Averaging(NamedTuple):
    """How many readings are averaged to one, why, and how long a mean takes [s]."""

    samples: int
    reason: str
    duration: float = 0.0

    @property
    def summary(self) -> str:
        """The number and its reason in one line; empty if readings are used as they are."""
        if self.samples == 1:
            return ""
        long = f", a mean takes {self.duration:.2g} s" if self.duration > LONG_MEAN else ""
        return f"{self.reason}: {self.samples} are averaged to one{long}"


def readings_needed(time: Array) -> int:
    """Return how many of the first readings at these times [s] decide; 0 if there are not enough yet."""
    inside = int(np.searchsorted(time, time[0] + MAX_TIME)) if len(time) else 0
    needed = min(max(inside, MIN_READINGS), MAX_READINGS)
    complete = len(time) >= MAX_READINGS or (len(time) > inside and len(time) >= MIN_READINGS)
    return needed if complete else 0


def second_differences(wrench_sensor: Array, std: Array) -> Array:
    """Return the second differences of readings (n, 6), (n - 2, 6), of variance one for white noise of `std`, (6,).

    A slow signal does not show in them.
    """
    return np.asarray(np.diff(wrench_sensor, 2, axis=0) / (math.sqrt(6.0) * std), dtype=float)


def choose_averaging(time: Array, wrench_sensor: Array, model: ProbeModel) -> Averaging:
    """Return how many readings are to be averaged for the noise that the model states.

    The variance of the readings is measured by their second differences, in which a slow signal does not show. Where
    these do not scatter like noise, the rate decides. At most `averaging_samples` are averaged: readings that scatter
    more than single samples do so for another reason than the missing mean, and a longer mean would only hide it.

    Args:
        time: of the first readings [s], (n,).
        wrench_sensor: the readings [N, N·m], (n, 6).
        model: states the noise of the mean of `averaging_samples` samples.
    """
    most = model.averaging_samples
    step = float(np.median(np.diff(time))) if len(time) > 1 else math.inf
    rate = 1.0 / step if step > 0.0 else math.inf
    n = most if rate > MAX_MEAN_RATE else 1
    by_rate = Averaging(n, f"{rate:.4g} readings/s", n * step)
    if most == 1 or len(time) < MIN_READINGS:
        return by_rate
    bends = second_differences(wrench_sensor, model.noise.std)
    power = float((bends * bends).sum())
    variance = float(np.median(bends * bends)) / MEDIAN
    white = power > 0.0 and float((bends[1:] * bends[:-1]).sum()) < WHITE * power
    if not white or not variance > 0.0:
        return by_rate
    if variance > most * NEAR:
        times = math.sqrt(variance / most)
        return Averaging(most, f"the readings scatter by {times:.2g} times the noise of single samples", most * step)
    if variance > most / NEAR:
        return Averaging(most, "the readings scatter like single samples", most * step)
    if variance < NEAR:
        return Averaging(1, "the readings scatter like means", step)
    n = round(variance)
    return Averaging(n, f"the readings scatter by {math.sqrt(variance):.2g} times the stated noise", n * step)


class AveragedBatch(NamedTuple):
    """n consecutive samples of one stretch, with the gravity vector of the mean and the first fault, and their mean."""

    block: Block
    reading: WrenchReading


def averaged(blocks: list[Block]) -> AveragedBatch:
    """Return all readings of blocks and their mean, at their mean time and with the last arrival time.

    The fault of any block becomes the fault of the mean. The true contact is free if it is free in any reading.
    """
    whole = joined(blocks)
    gravity = whole.gravity_base  # the same object if it is constant
    if any(block.gravity_base is not gravity for block in blocks):
        rows = np.concatenate([np.tile(block.gravity_base, (len(block), 1)) for block in blocks])
        gravity = gravity if (rows == gravity).all() else np.asarray(rows.mean(axis=0))
    fault, n, truths = next((block.fault for block in blocks if block.fault), ""), len(whole), whole.truths
    if gravity is not whole.gravity_base or fault != whole.fault:
        whole = replace(whole, gravity_base=gravity, fault=fault)
    reading = WrenchReading(
        float(whole.time.sum()) / n, whole.wrench_sensor.sum(axis=0) / n, gravity,
        TrueContact(*(np.mean(values, axis=0) for values in zip(*truths, strict=True))) if truths else None,
        fault, whole.stretch, float(whole.received[-1]),
    )  # fmt: skip
    return AveragedBatch(whole, reading)


class Averager:
    """Cuts blocks into batches of the readings that are averaged to one, independent of how the source cut its blocks.

    Attributes:
        samples: number of readings in a batch; 0 until it is known.
        n_pending: number of readings of the incomplete batch.
    """

    def __init__(self, samples: int | None, model: ProbeModel, log: Log, mains: float | None = None) -> None:
        """Start with no readings; without `samples` the first readings decide, and `log` receives the reason.

        With `mains`, the frequency of the mains [Hz], the chosen number is extended to whole periods of it.
        """
        self.samples, self.n_pending, self._model, self._log, self._mains = samples or 0, 0, model, log, mains
        self._pending: list[Block] = []  # those of the incomplete batch, or all until the size of a batch is known

    def add(self, block: Block) -> Iterator[AveragedBatch]:
        """Yield each batch that a block completes; an incomplete batch is dropped at the end of a stretch.

        Yield none while the size of a batch is not known.
        """
        if not self.samples:
            self._pending.append(block)
            if readings_needed(np.concatenate([block.time for block in self._pending])):
                yield from self.finish()
            return
        if self._pending and self._pending[0].stretch != block.stretch:
            self._pending, self.n_pending = [], 0
        start = 0
        while self.n_pending + len(block) - start >= self.samples:
            end = start + self.samples - self.n_pending
            parts = [*self._pending, block if end - start == len(block) else block[start:end]]
            self._pending, self.n_pending, start = [], 0, end
            if len(parts) == 1 and len(parts[0]) == 1:
                yield AveragedBatch(parts[0], next(parts[0].readings()))
                continue
            yield averaged(parts)
        if start < len(block):
            self._pending.append(block[start:] if start else block)
            self.n_pending += len(block) - start

    def finish(self) -> Iterator[AveragedBatch]:
        """Choose the size of a batch by the readings so far, if it is not known, and yield their batches."""
        if self.samples or not self._pending:
            return
        blocks, self._pending = self._pending, []
        whole = joined(blocks)
        needed = readings_needed(whole.time) or len(whole)
        chosen = choose_averaging(whole.time[:needed], whole.wrench_sensor[:needed], self._model)
        if self._mains is not None:
            step = float(whole.time[needed - 1] - whole.time[0]) / max(needed - 1, 1)
            period = 1.0 / (self._mains * step) if step > 0.0 else 0.0
            if period < MIN_PERIOD:
                raise InputError(f"--mains-hz {self._mains:g} needs {MIN_PERIOD * self._mains:g} readings a second or "
                                 f"more; these are {period * self._mains:.3g}")  # fmt: skip
            count = math.ceil(chosen.samples / period - 0.01)
            n = round(count * period)
            chosen = Averaging(n, f"whole periods of {self._mains:g} Hz", n * step)
        if chosen.summary:
            self._log(chosen.summary)
        self.samples = chosen.samples
        for block in blocks:
            yield from self.add(block)
