"""Samples that no working sensor gives: spikes, which are replaced, and channels that are saturated or stuck.

A **spike** leaves the samples before it by more than 6.7 of their standard deviations and returns after a few. Until a
sample is known to stay, the mean of those before it takes its place; one that stays is a touch. The standard deviation
is followed by the median of the steps m between samples,

    m ← m exp(± η),  + where a step is larger than m;  σ = m / (0.6745 √2).

A **stuck** channel repeats one value for longer than the sensor's resolution explains. With the share p of samples that
repeat the one before, n in a row have a chance of about pⁿ.
"""

import math
from dataclasses import replace

import numpy as np

from probedesign.core.frames import Array
from probedesign.estimation.model import ProbeModel
from probedesign.live import Log
from probedesign.live.processing.averaging import AveragedBatch
from probedesign.live.processing.tare import CHANNELS
from probedesign.rod.kernels import kernel

FROZEN_READINGS = 8  #: Least number of readings, identical in all channels, from which the signal counts as frozen.
#: Duration [s] and number of identical readings of one channel from which it counts as dead, however often it repeats.
DEAD_TIME, DEAD_READINGS = 1.0, 20
#: -ln of the chance of a run of repeats from which a channel is stuck. p is a mean, and in the middle of a step of the
#: resolution repeats are likelier: noise of 0.2 to 1 steps then has such a run once in 10¹² samples.
STUCK = 55.0
#: Share of repeats that is assumed at least, and the number of samples and of runs of equal ones from which it begins.
LEAST_SHARE, FIRST_SAMPLES, FIRST_RUNS = 0.1, 64.0, 8.0
MEMORY = 256.0  #: Number of runs over which the share is measured.
#: Longest spike: as many samples as come in `SPIKE_TIME`, and up to three in `WAIT`, in which no touch is missed [s].
SPIKE_TIME, WAIT = 1e-3, 20e-3
SLOW = 10.0  #: Rate up to which one sample may be a touch [Hz]; assumed: none is shorter than a tenth of a second.
#: Distance of a spike from the mean before it, in medians of a step (6.7 standard deviations) and in steps of the
#: resolution.
FAR, FAR_STEPS = 7.0, 1.2
NOTE_PERIOD = 10.0  #: Least time between two lines about spikes [s].
QUIET = 8  #: Number of samples without a leap after a touch until the next leap may be a spike.
GROWTH, SHARE = math.exp(1.0 / 128.0), 0.25  #: Factor on the median for one step, and weight of a sample in the mean.

LAST, MEAN, MEDIAN, SINCE, RUN, SAMPLES, RUNS = range(7)  # what is known of each channel
HELD, STAYS, CALM, FROZEN = range(4)  # samples that are held, whether a leap stays, samples since it, identical ones


@kernel
def screen(samples, time, limit, floor, most, channels, state, stuck, replaced):
    """Replace spikes in samples (n, 6) at their times [s].

    Args:
        samples: not changed.
        time: of each.
        limit: of saturation, (6,).
        floor: least distance of a spike, (6,).
        most: number of samples in a spike.
        channels: `LAST` ... `RUNS` of each channel, (7, 6).
        state: `HELD` ... `FROZEN`, (4,).
        stuck: largest -ln of the chance of a run in each channel, filled in, (6,).
        replaced: the samples without spikes, filled in, (n, 6).

    Returns:
        Number of samples that were spikes, of samples that were replaced, and of identical ones in a row where chance
        does not explain them.
    """
    spikes, n_replaced, frozen = 0, 0, 0
    stuck[:] = 0.0
    for i in range(samples.shape[0]):
        far, beyond, same, rarity = False, False, True, 0.0
        for c in range(6):
            x, step = samples[i, c], abs(samples[i, c] - channels[LAST, c])
            if step == 0.0:
                channels[RUN, c] += 1.0
                share = max(1.0 - channels[RUNS, c] / channels[SAMPLES, c], LEAST_SHARE)
                stuck[c] = max(stuck[c], -channels[RUN, c] * np.log(share))
                rarity -= np.log(share)
            else:
                same = False
                channels[SAMPLES, c] += channels[RUN, c] - channels[SAMPLES, c] / MEMORY
                channels[RUNS, c] += 1.0 - channels[RUNS, c] / MEMORY
                channels[RUN, c], channels[SINCE, c] = 1.0, time[i]
            if np.isfinite(step):
                channels[MEDIAN, c] *= GROWTH if step > channels[MEDIAN, c] else 1.0 / GROWTH
            if np.isnan(channels[MEAN, c]):
                channels[MEAN, c] = x
            channels[LAST, c] = replaced[i, c] = x
            beyond = beyond or not abs(x) <= limit[c]
            far = far or abs(x - channels[MEAN, c]) > max(FAR * channels[MEDIAN, c], floor[c])
        state[FROZEN] = state[FROZEN] + 1.0 if same else 1.0
        if rarity * state[FROZEN] >= STUCK:
            frozen = max(frozen, state[FROZEN])
        if (far or beyond) and state[STAYS] == 0.0:
            state[HELD] += 1.0
            if state[HELD] <= most:
                if not beyond:  # a saturated one is a fault of its own
                    n_replaced += 1
                    for c in range(6):
                        replaced[i, c] = channels[MEAN, c]
                continue
            state[STAYS], state[CALM] = 1.0, 0.0
        elif state[HELD] > 0.0:
            spikes += state[HELD]
        state[HELD] = 0.0
        state[CALM] = 0.0 if far or beyond else state[CALM] + 1.0
        if state[CALM] >= QUIET:
            state[STAYS] = 0.0
        for c in range(6):
            if abs(samples[i, c]) <= limit[c]:
                channels[MEAN, c] += SHARE * (samples[i, c] - channels[MEAN, c])
    return spikes, n_replaced, frozen


class SampleScreen:
    """Screens the samples of one sensor, in order.

    Attributes:
        spikes: number of samples that were spikes.
    """

    def __init__(self, model: ProbeModel, samples: int, rate: float = 3.0 / WAIT) -> None:
        """Start without samples; `samples` of them and `rate` are as those of `SignalMonitor`.

        A rate that is unknown, as of a few readings, is taken as too slow for spikes.
        """
        self.spikes, self._noted, self._limit = 0, (-math.inf, 0), model.saturation_limit
        resolution = model.noise.std * math.sqrt(model.averaging_samples)
        self._floor, self._most = FAR_STEPS * resolution, 0.0
        if rate > SLOW:
            self._most = max(1.0, min(round(WAIT * rate), 3.0), float(round(SPIKE_TIME * rate)))
        unknown, ones = np.full(6, np.nan), np.ones(6)
        std = model.noise.std * math.sqrt(samples)
        self._channels = np.stack([unknown, unknown, std, unknown, ones, FIRST_SAMPLES * ones, FIRST_RUNS * ones])
        self._state, self._stuck, self._clean = np.zeros(4), np.zeros(6), np.empty((0, 6))

    def start(self, rows: Array) -> None:
        """Take the steps between the first samples (n, 6) where they are larger than the stated noise."""
        steps = np.median(np.abs(np.diff(rows, axis=0)), axis=0)
        self._channels[MEDIAN] = np.fmax(self._channels[MEDIAN], steps)

    def report(self, time: float, log: Log) -> None:
        """Report the number of spikes at a time [s] if it has grown, at most once in `NOTE_PERIOD`."""
        if self.spikes > self._noted[1] and time - self._noted[0] >= NOTE_PERIOD:
            self._noted = time, self.spikes
            log(f"{time:.2f} s: {self.spikes} samples so far leapt and returned at once: spikes, which do not count")

    def check(self, batch: AveragedBatch) -> tuple[AveragedBatch, str]:
        """Return a batch without spikes, and its fault."""
        rows, time = batch.block.wrench_sensor, batch.block.time
        clean, frozen = self.screened(time, rows)
        if clean is not rows:
            reading = replace(batch.reading, wrench_sensor=clean.mean(axis=0))
            batch = AveragedBatch(replace(batch.block, wrench_sensor=clean.copy()), reading)
        if (beyond := ~(np.abs(rows) <= self._limit)).any():
            i, c = np.argwhere(beyond)[0]
            return batch, f"{CHANNELS[c]} is at its limit or not a number: {rows[i, c]:.4g}"
        if frozen >= FROZEN_READINGS:
            return batch, f"frozen: {frozen} readings in a row are identical"
        run = self._channels[RUN]
        if run.max() >= DEAD_READINGS or self._stuck.max() >= STUCK:
            lasting = float(time[-1]) - self._channels[SINCE]
            dead = ((lasting >= DEAD_TIME) & (run >= DEAD_READINGS)) | (self._stuck >= STUCK)
            if dead.any():
                c = int(np.argmax(dead))
                return batch, f"{CHANNELS[c]} has not changed for {lasting[c]:.3g} s: dead, or rounded too coarsely"
        return batch, ""

    def screened(self, time: Array, rows: Array) -> tuple[Array, int]:
        """Return samples (n, 6) at their times [s] without spikes, and the third result of `screen`.

        Without spikes these are the samples that were given, else memory that the next call uses.
        """
        if len(self._clean) < len(rows):
            self._clean = np.empty((len(rows), 6))
        clean = self._clean[: len(rows)]
        if np.isnan(self._channels[LAST]).all() and len(rows) > QUIET:
            self.start(rows)
        spikes, replaced, frozen = screen(
            np.ascontiguousarray(rows), np.ascontiguousarray(time), self._limit, self._floor, self._most,
            self._channels, self._state, self._stuck, clean,
        )  # fmt: skip
        self.spikes += int(spikes)
        return clean if replaced else rows, int(frozen)
