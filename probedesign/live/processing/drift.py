"""Drift of the sensor's zero: how fast it changes, whether it can be followed, and how long that takes.

The bias filter of the estimator assumes a rate of drift that changes within an hour. A sensor that warms up drifts
faster. Here the same filter runs with several time constants τ side by side,

    db = r dt + q dW,   dr = -r/τ dt + σ √(2/τ) dV,   σ τ = 10 steps,

so that each expects a drift of about ten steps of the resolution, in an hour or in seconds. The likelihood of the
readings of the last `MEMORY` decides which of them the contact test and the estimates use. A drift with one of the
`WARMING` time constants is not known well enough during a touch: no position is given while it lasts.
"""

import math

import numpy as np

from probedesign.core import statistics
from probedesign.core.frames import Array
from probedesign.estimation.bias import AT, BIAS, BLOCK_TIME, DECAY, NOW, RAMP, RAMP_STEPS, RAMP_TIME, RATE, BiasFilter
from probedesign.estimation.model import ProbeModel

#: Time constants [s], from an hour to 3.5 s. The ratio is assumed; a factor of two either way costs little likelihood.
TIMES = RAMP_TIME / 4.0 ** np.arange(6)
#: Number of the first time constant that counts as warming up: 14 s. In a touch of 4 s the rate then changes so much
#: that the bias becomes uncertain by a step; with the constant before it (56 s) by a seventh of a step.
WARMING = 4
MEMORY = 20.0  #: Time over which readings decide [s]; assumed.
LEAP_STEPS = 0.05  #: Standard deviation of a leap that was measured in a quarter of a second: the walk in a second.
#: Log likelihood behind the best at which a filter starts anew from the best one's bias: it has lost the drift.
MAX_LAG = 6.0
#: Time for which a drift must have been slow [s]: a real sensor paused for a second. Assumed.
HOLD = 10.0
MIN_GAIN = 3.0  #: Log likelihood by which another time constant must be better.
SLOW = float(RAMP_STEPS * RAMP_TIME / TIMES[WARMING - 1])  #: Rate that is expected of a drift that can be followed.


class DriftFollower:
    """Follows the bias with every time constant while the probe is free, and tells the bias filter which to use.

    Attributes:
        chosen: number of the time constant in use.
    """

    def __init__(self, model: ProbeModel, used: BiasFilter, start_steps: float) -> None:
        """Start with a bias of zero, known to `start_steps` of the resolution; `used` is the filter to be set."""
        self._used, self._samples = used, model.averaging_samples
        self._whiten = statistics.whiten(model.noise_base() * model.averaging_samples)  # to steps
        self._sigma2 = (RAMP_STEPS * RAMP_TIME / TIMES) ** 2 if used.walk > 0.0 else np.zeros(len(TIMES))
        self._mean = np.zeros((len(TIMES), 2, 6))  # bias and rate [steps, steps/s]
        self._cov = np.stack([np.full(len(TIMES), start_steps**2), np.zeros(len(TIMES)), self._sigma2])
        self._at, self._until, self.chosen, self._evidence = math.nan, -math.inf, 0, np.zeros(len(TIMES))
        self._sum, self._times = np.zeros(6), list[float]()
        self._waiting: tuple[Array, float, int] | None = None

    @property
    def warming_up(self) -> bool:
        """Whether the bias drifts faster than it can be followed."""
        return self._at < self._until

    @property
    def rate(self) -> float:
        """Rate of the channel that drifts fastest, in steps of the resolution a second."""
        return float(np.abs(self._mean[self.chosen, RATE]).max())

    @property
    def wait(self) -> float:
        """Time until the drift can be followed if it levels off exponentially with its time constant [s].

        Meaningful while the sensor warms up.
        """
        levelling = float(TIMES[max(self.chosen, WARMING)])
        return levelling * max(math.log(self.rate / SLOW), 1.0) + HOLD

    def rest(self, seconds: float) -> None:
        """Account for time without readings [s]."""
        self._predict(seconds)
        self._at += seconds

    def drop(self) -> None:
        """Drop the readings that wait: the probe was touched after them."""
        self._sum, self._times, self._waiting = np.zeros(6), [], None

    def leap(self, change: Array) -> None:
        """Account for a sudden change of the bias [N, N·m], (6,), measured in a fraction of a second."""
        self.drop()
        self._mean[:, BIAS] += self._whiten @ change
        used = self._used
        used.drop_waiting()
        used.state.mean[BIAS] += change
        for cov in (self._cov, used.state.cov):
            cov[0] += LEAP_STEPS**2

    def add(self, mean: Array, time: float) -> None:
        """Add a reading of the free probe less its wrench [N, N·m], (6,); blocks of them count one block late."""
        if self._times and time - self._times[0] >= BLOCK_TIME:
            n = len(self._times)
            block = (self._whiten @ self._sum / n, math.fsum(self._times) / n, n)
            self._sum, self._times = np.zeros(6), []
            waiting, self._waiting = self._waiting, block
            if waiting is not None:
                self._observe(*waiting, time)
        self._sum = self._sum + mean
        self._times.append(time)

    def _predict(self, t: float) -> None:
        kept, (b, c, r) = np.exp(-t / TIMES), self._cov
        self._mean[:, BIAS] += t * self._mean[:, RATE]
        self._mean[:, RATE] *= kept[:, None]
        self._cov = np.stack([b + t * (2.0 * c + self._used.walk) + t * t * r, kept * (c + t * r),
                              kept**2 * r + (1.0 - kept**2) * self._sigma2])  # fmt: skip

    def _observe(self, steps: Array, time: float, count: int, now: float) -> None:
        t = 0.0 if math.isnan(self._at) else max(time - self._at, 0.0)
        self._at = time
        self._predict(t)
        b, c, r = self._cov
        total = b + 1.0 / (self._samples * count)  # the noise of a reading is that of the mean of so many samples
        residual = steps - self._mean[:, BIAS]
        chi2 = (residual**2).sum(axis=1) / total
        self._evidence = self._evidence * math.exp(-t / MEMORY) - 3.0 * np.log(total) - 0.5 * chi2
        self._mean += np.stack([b / total, c / total], axis=1)[:, :, None] * residual[:, None]
        self._cov = np.stack([b * (1.0 - b / total), c * (1.0 - b / total), r - c * c / total])
        best = int(np.argmax(self._evidence))
        lost = self._evidence < self._evidence[best] - MAX_LAG
        self._evidence[lost] = self._evidence[best] - MAX_LAG
        self._mean[lost] = [self._mean[best, BIAS], np.zeros(6)]
        self._cov[:, lost] = [np.full(lost.sum(), self._cov[0, best]), np.zeros(lost.sum()), self._sigma2[lost]]
        if self._evidence[best] > self._evidence[self.chosen] + MIN_GAIN:
            self.chosen = best
            state = self._used.state
            state.mean[:] = np.linalg.solve(self._whiten, self._mean[best].T).T
            state.cov[:] = self._cov[:, best]
            state.clock[AT] = state.clock[NOW] - (now - time)
            state.constants[RAMP], state.constants[DECAY] = self._sigma2[best], 1.0 / TIMES[best]
            self._used.drop_waiting()
        if self.chosen >= WARMING or self.rate > 3.0 * SLOW:
            self._until = time + HOLD
