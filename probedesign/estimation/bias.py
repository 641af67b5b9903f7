"""The bias of the sensor, followed while nothing touches: one Kalman filter for contact test, fusion and estimates.

The bias b of each channel walks, and drifts at a rate r that changes slowly (temperature):

    db = r dt + q dW,   dr = -r/τ dt + σ √(2/τ) dV,   reading of a free probe = free wrench + b + noise.

Noise, walk and rate have the same size in every channel if they are counted in steps of the sensor's resolution. All
channels then share one gain and one covariance of (b, r), and a filter of two states follows all six.

Free readings count in blocks, each of them one block late: a touch is detected within a block, so its first readings
do not count. docs/decisions/0016-bias.md has the equations and the sources of the numbers.
"""

import math
from typing import NamedTuple

import numpy as np

from probedesign.core.frames import Array
from probedesign.rod.kernels import inner, kernel

#: Random walk of the bias in one second, in steps of the resolution, by default: `Tolerances.walk_steps`. Assumed.
WALK_STEPS = 0.05
#: Standard deviation of the rate at which the bias drifts, in steps a second: ten in an hour. Assumed.
RAMP_STEPS = 10.0 / 3600.0
RAMP_TIME = 3600.0  #: Time in which that rate changes [s]: an hour. Assumed.
BLOCK_TIME = 0.2  #: Longest duration of a block [s]: 1024 samples of a Net F/T box take 0.15 s.

BIAS, RATE = 0, 1
NOW, AT = 0, 1
WAITING_COUNT, WAITING_TIME = 6, 7
Q, RAMP, DECAY, SAMPLE, PERIOD = 0, 1, 2, 3, 4


class BiasState(NamedTuple):
    """State of the filter; all of it is changed in place, also by the compiled contact test."""

    mean: Array  #: bias at the base [N, N·m] and its rate [1/s], (2, 6).
    cov: Array  #: variance of the bias [steps²], covariance with its rate, variance of the rate [steps²/s²], (3,).
    clock: Array  #: time of the last sample, and time for which mean and covariance are given [s], (2,).
    waiting: Array  #: mean of the last block (6,), its number of samples, and the time of its middle [s], (8,).
    #: q² [steps²/s], σ² [steps²/s²], 1/τ [1/s], variance of a sample [steps²], and time from one to the next [s], (5,).
    constants: Array


@inner
def variance_now(cov, clock, constants):
    """Return the variance of the bias at the last sample [steps²]."""
    t = clock[NOW] - clock[AT]
    return cov[0] + t * (2.0 * cov[1] + constants[Q]) + t * t * cov[2]


@inner
def predict(mean, cov, clock, constants, time):
    """Move the state on to a later time."""
    t = max(time - clock[AT], 0.0)
    kept = math.exp(-t * constants[DECAY])
    for i in range(6):
        mean[BIAS, i] += t * mean[RATE, i]
        mean[RATE, i] *= kept
    cov[0] += t * (2.0 * cov[1] + constants[Q]) + t * t * cov[2]
    cov[1] = kept * (cov[1] + t * cov[2])
    cov[2] = kept * kept * cov[2] + (1.0 - kept * kept) * constants[RAMP]
    clock[AT] += t


@inner
def observe_block(mean, cov, clock, waiting, constants, block, count, scale):
    """Update the state by the block that waited, and let the next one wait.

    Args:
        block: mean of its samples [N, N·m], (6,).
        count: number of its samples.
        scale: variance of a sample over its noise: more than 1 while the free probe sways.
    """
    if waiting[WAITING_COUNT] > 0.0:
        predict(mean, cov, clock, constants, waiting[WAITING_TIME])
        total = cov[0] + scale * constants[SAMPLE] / waiting[WAITING_COUNT]
        gain, gain_rate = cov[0] / total, cov[1] / total
        for i in range(6):
            off = waiting[i] - mean[BIAS, i]
            mean[BIAS, i] += gain * off
            mean[RATE, i] += gain_rate * off
        cov[2] -= gain_rate * cov[1]
        cov[1] *= 1.0 - gain
        cov[0] *= 1.0 - gain
    for i in range(6):
        waiting[i] = block[i]
    waiting[WAITING_COUNT] = count
    waiting[WAITING_TIME] = clock[NOW] - 0.5 * count * constants[PERIOD]


@kernel
def add_block(mean, cov, clock, waiting, constants, block, count):
    """Call `observe_block` from Python, for a probe that does not sway."""
    observe_block(mean, cov, clock, waiting, constants, block, count, 1.0)


class KnownBias(NamedTuple):
    """What is known of the bias at one time."""

    excess: Array  #: the bias at the base [N, N·m], (6,).
    rate: Array  #: its change [N/s, N·m/s], (6,).
    steps: float  #: standard deviation in steps of the resolution.
    steps_rate: tuple[float, float]  #: covariance of bias and rate [steps²/s], and variance of the rate [steps²/s²].

    def after(self, seconds: float) -> Array:
        """Return the bias expected after that time [N, N·m], (6,)."""
        return self.excess + seconds * self.rate

    def variance_after(self, seconds: float, walk: float) -> float:
        """Return its variance then [steps²], for a walk of that variance a second."""
        return self.steps**2 + seconds * (2.0 * self.steps_rate[0] + walk + seconds * self.steps_rate[1])


class BiasFilter:
    """The filter of a probe's sensor.

    Attributes:
        state: its state, for the compiled contact test.
        walk: variance of the bias after one second [steps²/s].
    """

    def __init__(self, walk_steps: float, start_steps: float, sample_variance: float, rate: float, block: int) -> None:
        """Start with a bias of zero, as after a tare.

        Args:
            walk_steps: random walk in one second, in steps of the resolution; without a walk the bias is constant.
            start_steps: standard deviation of the bias, in the same steps.
            sample_variance: noise of a sample [steps²].
            rate: of samples [Hz].
            block: number of samples of a block.
        """
        self._block, self._sum, self._count = block, np.zeros(6), 0
        self.walk = walk_steps**2
        ramp = RAMP_STEPS**2 if walk_steps > 0.0 else 0.0
        self.state = BiasState(
            np.zeros((2, 6)), np.array([start_steps**2, 0.0, ramp]), np.zeros(2), np.zeros(8),
            np.array([self.walk, ramp, 1.0 / RAMP_TIME, sample_variance, 1.0 / rate]),
        )  # fmt: skip

    def known(self) -> KnownBias:
        """Return what is known of the bias at the last sample."""
        s = self.state
        t = float(s.clock[NOW] - s.clock[AT])
        b, c, r = s.cov.tolist()
        variance = b + t * (2.0 * c + self.walk) + t * t * r
        return KnownBias(s.mean[BIAS] + t * s.mean[RATE], s.mean[RATE].copy(), math.sqrt(variance), (c + t * r, r))

    def rest(self, seconds: float) -> None:
        """Account for time without samples [s]."""
        self.state.clock[NOW] += seconds
        self.drop_waiting()

    def drop_waiting(self) -> None:
        """Drop the samples that wait: a contact was detected, or readings are missing after them."""
        self.state.clock[NOW] += self._count * self.state.constants[PERIOD]
        self.state.waiting[WAITING_COUNT] = self._count = 0
        self._sum = np.zeros(6)

    def add(self, sample: Array) -> None:
        """Add a sample of the free probe less its wrench [N, N·m], (6,), where no contact test does it."""
        self._sum = self._sum + sample
        self._count += 1
        if self._count == self._block:
            self.state.clock[NOW] += self._count * self.state.constants[PERIOD]
            add_block(*self.state, self._sum / self._count, float(self._count))
            self._sum, self._count = np.zeros(6), 0
