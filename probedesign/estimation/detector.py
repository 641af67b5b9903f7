"""Detect contact and its end by a sequential test on gravity-compensated readings.

Means over 1, 4, 16 ... samples are tested as they fill up: a hard touch is significant in one sample, a light one in
many. Each mean is whitened by the sensor's noise and by the observed motion of the free probe, which sways as the robot
moves. Its squared length is Hotelling's

    T² = zᵀ S⁻¹ z,   (ν - 5)/(6 ν) T² ~ F(6, ν - 5),

and its threshold gives one false alarm in `hours_between_alarms`, over all lengths together. The bias is followed while
the probe is free (`bias`). The arithmetic is compiled and takes a bounded time per sample.
"""

import math
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import betainccinv, chdtri

from probedesign.core import statistics
from probedesign.core.errors import InputError
from probedesign.core.frames import Array
from probedesign.estimation.bias import (
    AT,
    BIAS,
    BLOCK_TIME,
    NOW,
    PERIOD,
    RATE,
    SAMPLE,
    WAITING_COUNT,
    BiasFilter,
    observe_block,
    variance_now,
)
from probedesign.estimation.model import WALK_SECONDS, ProbeModel, Tolerances
from probedesign.rod.kernels import inner, kernel
from probedesign.rod.kernels.linalg import forward

LENGTHS = (1, 4, 16, 64, 256, 1024)  #: Samples of each mean.
RATIO = 4
FREE, CONTACT, LOST, INVALID = 0, 1, 2, 3
STATE_NOW, DETECTED_BY = 0, 1


class DetectorState(NamedTuple):
    """State of the test between samples; arrays by length are in the order of `LENGTHS`, as many as are in use."""

    whiten: Array  #: of a sample, (6, 6).
    thresholds: Array  #: of T² for each length, (k,).
    released: float  #: T² below which a touch is over.
    prior_weight: float  #: weight of the identity in the covariances, and the number of means that they average over.
    state: Array  #: the last code, and the index of the length that detected the contact, (2,).
    sums: Array  #: running sums of whitened samples for each length, (k, 6); counts: number of parts in them, (k,).
    counts: Array
    scatter: Array  #: Cholesky factor of S for each length, (k, 6, 6); moments: what S is made from, (k, 6, 6).
    moments: Array
    scratch: Array  #: of one sample, (2, 6).

    @classmethod
    def fresh(cls, whiten: Array, thresholds: Array, released: float, prior_weight: float) -> "DetectorState":
        """Return the state of a free probe."""
        lengths = len(thresholds)
        eye = np.tile(np.eye(6), (lengths, 1, 1))
        return cls(whiten, thresholds, released, prior_weight, np.zeros(2), np.zeros((lengths, 6)), np.zeros(lengths),
                   eye.copy(), eye.copy(), np.empty((2, 6)))  # fmt: skip


@inner
def learn(j, z, share, moments, scatter):
    """Update the exponentially weighted covariance of means of length j with one more, and factor it."""
    for a in range(6):
        for b in range(6):
            moments[j, a, b] += share * (z[a] * z[b] - moments[j, a, b])
    # Never less than the sensor's own noise, so that a quiet period does not raise the false alarm rate.
    for a in range(6):
        for b in range(a + 1):
            value = max(moments[j, a, b], 1.0) if a == b else moments[j, a, b]
            for q in range(b):
                value -= scatter[j, a, q] * scatter[j, b, q]
            if a == b:
                scatter[j, a, a] = np.sqrt(max(value, 0.5))
            else:
                scatter[j, a, b] = value / scatter[j, b, b]


@kernel
def advance(
    samples, whiten, thresholds, released, prior_weight, state, sums, counts, scatter, moments, scratch, mean, cov,
    clock, waiting, constants, codes,
):  # fmt: skip
    """Process samples (n, 6) in order; fill in their codes (n,). The arrays from `mean` on are a `BiasState`.

    Returns:
        The code of the last one.
    """
    lengths = thresholds.shape[0]
    z, y, code = scratch[0], scratch[1], FREE
    for i in range(samples.shape[0]):
        clock[NOW] += constants[PERIOD]
        since = clock[NOW] - clock[AT]
        finite = True
        for a in range(6):
            y[a] = samples[i, a] - mean[BIAS, a] - since * mean[RATE, a]
            finite = finite and np.isfinite(y[a])
        if not finite:
            codes[i] = code = INVALID
            continue
        for a in range(6):
            for b in range(a + 1):
                sums[0, a] += whiten[a, b] * y[b]
        in_contact = state[STATE_NOW] == CONTACT
        code = CONTACT if in_contact else FREE
        counts[0] += 1.0
        j, n = 0, 1.0
        while j < lengths and counts[j] >= (1.0 if j == 0 else RATIO):
            # The bias drifts untracked during contact and between its updates: the variance of a free mean includes
            # that, also at the end of a contact.
            root = np.sqrt(n * (1.0 + n * variance_now(cov, clock, constants) / constants[SAMPLE]))
            for a in range(6):
                z[a] = y[a] = sums[j, a] / root
            far = 0.0
            forward(scatter[j], 6, y)
            for a in range(6):
                far += y[a] * y[a]
            if in_contact:
                # A mean four times as long as the one that detected it: a contact near the threshold does not flicker.
                if j == min(int(state[DETECTED_BY]) + 1, lengths - 1) and far < released:
                    state[STATE_NOW], code = FREE, LOST
            elif far > thresholds[j] and code == FREE:
                state[STATE_NOW], state[DETECTED_BY], code = CONTACT, j, CONTACT
            elif code == FREE:
                learn(j, z, 1.0 / prior_weight, moments, scatter)
                if j == lengths - 1:
                    swaying = 0.0
                    for a in range(6):
                        swaying += moments[j, a, a] / 6.0
                        y[a] = sums[j, a] / n
                    forward(whiten, 6, y)
                    middle = since - 0.5 * n * constants[PERIOD]
                    for a in range(6):
                        y[a] += mean[BIAS, a] + middle * mean[RATE, a]
                    observe_block(mean, cov, clock, waiting, constants, y, n, max(swaying, 1.0))
            if j + 1 < lengths:
                for a in range(6):
                    sums[j + 1, a] += sums[j, a]
                counts[j + 1] += 1.0
            for a in range(6):
                sums[j, a] = 0.0
            counts[j] = 0.0
            j, n = j + 1, n * RATIO
        if code == LOST or (code == CONTACT and not in_contact):
            waiting[WAITING_COUNT] = 0.0
            for j in range(lengths):  # samples before the change do not belong to the new state
                counts[j] = 0.0
                for a in range(6):
                    sums[j, a] = 0.0
        codes[i] = code
    return code


#: `lost` is reported once, for the first reading after a touch.
Touching = Literal["free", "contact", "lost", "out_of_range"]
_STATES: dict[int, Touching] = {FREE: "free", CONTACT: "contact", LOST: "lost", INVALID: "out_of_range"}
#: Weight of the sensor's own noise against the observed motion of the free probe, in means, and the number of means
#: that the covariance averages over.
PRIOR_WEIGHT = 400.0
RELEASE_CHANCE = 1e-4  #: Probability that the mean of a free probe still counts as contact.


@dataclass
class Detector:
    """Sequential contact test for samples as the sensor delivers them."""

    model: ProbeModel  #: the probe.
    rate: float = 7000.0  #: of samples [Hz].
    hours_between_alarms: float = 1.0  #: mean time from one false alarm to the next while the probe is free [h].
    #: number of samples whose mean has the noise of the model; None: `averaging_samples`, as single samples have it.
    #: For readings that are such means already, 1.
    samples: int | None = None
    #: random walk of the bias in `WALK_SECONDS`, in steps of the resolution; that of the model's tolerances if None.
    walk_steps: float | None = None
    start_steps: float = 0.0  #: standard deviation of the bias at the first sample, in the same steps.
    bias_filter: BiasFilter = field(init=False, repr=False)  #: the bias, followed while the probe is free.
    _state: DetectorState = field(init=False, repr=False)

    def __post_init__(self) -> None:
        for name, value in (("rate", self.rate), ("hours_between_alarms", self.hours_between_alarms)):
            if not 0.0 < value < math.inf:
                raise InputError(f"{name} = {value} must be positive and finite")
        averaging = self.model.averaging_samples
        samples = averaging if self.samples is None else self.samples
        walk = Tolerances.of(self.model).walk_steps if self.walk_steps is None else self.walk_steps
        self.bias_filter = BiasFilter(
            walk / math.sqrt(WALK_SECONDS), self.start_steps, samples / averaging, self.rate, self.lengths[-1]
        )
        whiten = statistics.whiten(self.model.noise_base() * samples)
        self._state = DetectorState.fresh(whiten, self._thresholds(), float(chdtri(6, RELEASE_CHANCE)), PRIOR_WEIGHT)

    @property
    def lengths(self) -> tuple[int, ...]:
        """Return the numbers of samples of the means: as many as fit in `BLOCK_TIME`, at least one."""
        return tuple(n for n in LENGTHS if n == 1 or n <= BLOCK_TIME * self.rate)

    def _thresholds(self) -> Array:
        tests_an_hour = 3600.0 * self.rate / np.array(self.lengths)
        chance = 1.0 / self.hours_between_alarms / tests_an_hour / len(self.lengths)
        nu = PRIOR_WEIGHT
        # 6 nu / (nu - 5) times the quantile of Fisher's distribution with 6 and nu - 5 degrees of freedom, by that of
        # the beta distribution: scipy.stats takes as long to import as half of this package.
        share = betainccinv(3.0, (nu - 5.0) / 2.0, np.minimum(chance, 0.5))
        found = nu * share / (1.0 - share)
        return np.asarray(found, dtype=float)

    def update(self, wrench: ArrayLike) -> Touching:
        """Process the next sample.

        Args:
            wrench: at the base, less the free probe's under the same gravity [N, N·m], (6,).
        """
        sample = np.ascontiguousarray(wrench, dtype=float)
        if sample.shape != (6,):
            raise InputError(f"wrench has shape {sample.shape}; it must be (6,)")
        return _STATES[int(advance(sample[None], *self._state, *self.bias_filter.state, np.empty(1, dtype=np.int64)))]

    def run(self, wrenches: ArrayLike, learn: bool = True) -> list[Touching]:
        """Process many samples, (n, 6); with `learn`, bias and motion of the free probe follow them."""
        samples = np.ascontiguousarray(wrenches, dtype=float)
        if samples.ndim != 2 or samples.shape[1] != 6:
            raise InputError(f"wrenches have shape {samples.shape}; they must be (n, 6)")
        codes = np.empty(len(samples), dtype=np.int64)
        bias, state = self.bias_filter.state, self._state
        learnt = [] if learn else [(a, a.copy()) for a in (state.scatter, state.moments, bias.mean, bias.cov)]
        at = bias.clock[AT]
        if len(samples):
            advance(samples, *state, *bias, codes)
        for array, before in learnt:
            array[:] = before
        if not learn:
            bias.clock[AT], bias.waiting[WAITING_COUNT] = at, 0.0
        return [_STATES[code] for code in codes.tolist()]

    def calibrate(self, wrenches: ArrayLike) -> None:
        """Estimate the motion of a probe that is known to be free, such as while the robot moves it, (n, 6).

        Without this calibration the motion is reported as contact.
        """
        thresholds = self._state.thresholds.copy()
        self._state.thresholds[:] = np.inf
        try:
            self.run(wrenches)
        finally:
            self._state.thresholds[:] = thresholds

    def release(self) -> None:
        """End a contact without a test: what was detected is known to be none."""
        self._state.state[STATE_NOW] = FREE
        self._state.sums[:] = self._state.counts[:] = 0.0

    def rest(self, seconds: float) -> None:
        """Account for a gap without samples [s], in which the bias may have drifted."""
        self.bias_filter.rest(seconds)

    @property
    def bias(self) -> Array:
        """Return the tracked bias of the free probe, at the base [N, N·m], (6,)."""
        return self.bias_filter.known().excess
