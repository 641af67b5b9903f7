"""Detect contact and its end by a sequential test on gravity-compensated readings.

Means over 1, 4, 16 ... samples are tested as they fill up: a hard touch is significant in one sample, a light one in
many. Each mean is whitened by the sensor's noise and by the observed motion of the free probe, which sways as the robot
moves. Its squared length is Hotelling's

    T² = zᵀ S⁻¹ z,   (ν - 5)/(6 ν) T² ~ F(6, ν - 5),

and its threshold gives one false alarm in `hours_between_alarms`, over all lengths together. A drifting bias is tracked
while the probe is free. The arithmetic is compiled and takes a bounded time per sample.
"""

import math
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import chdtri
from scipy.stats import f as fisher

from probedesign.core.errors import InputError
from probedesign.core.frames import Array
from probedesign.estimation.model import ProbeModel
from probedesign.rod.kernels import inner, kernel
from probedesign.rod.kernels.linalg import forward

LENGTHS = (1, 4, 16, 64, 256, 1024)
"""Samples of each mean."""
RATIO = 4
FREE, CONTACT, LOST, INVALID = 0, 1, 2, 3
STATE_NOW, DETECTED_BY, BIAS_VARIANCE, WALK = 0, 1, 2, 3


class DetectorState(NamedTuple):
    """State of the test between samples; arrays by length are in the order of `LENGTHS`.

    Attributes:
        whiten: of a sample, (6, 6).
        thresholds: of T² for each length, (6,).
        released: T² below which a touch is over.
        gain: of the bias.
        prior_weight: weight of the identity in the covariances, and the number of means that they average over.
        state: the last code, the index of the length that detected the contact, the variance of the bias since it was
            last tracked, and its increase per sample, both over the variance of a sample, (4,).
        bias: whitened, (6,).
        sums: running sums for each length, (6, 6); counts: number of parts in them, (6,).
        scatter: Cholesky factor of S for each length, (6, 6, 6); moments: what S is made from, (6, 6, 6).
    """

    whiten: Array
    thresholds: Array
    released: float
    gain: float
    prior_weight: float
    state: Array
    bias: Array
    sums: Array
    counts: Array
    scatter: Array
    moments: Array

    @classmethod
    def fresh(
        cls, whiten: Array, thresholds: Array, released: float, gain: float, prior_weight: float, walk: float
    ) -> "DetectorState":
        """Return the state of a free probe."""
        lengths = len(LENGTHS)
        eye = np.tile(np.eye(6), (lengths, 1, 1))
        return cls(whiten, thresholds, released, gain, prior_weight, np.array([0.0, 0.0, 0.0, walk]), np.zeros(6),
                   np.zeros((lengths, 6)), np.zeros(lengths), eye.copy(), eye.copy())  # fmt: skip


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
    samples,
    whiten,
    thresholds,
    released,
    gain,
    prior_weight,
    state,
    bias,
    sums,
    counts,
    scatter,
    moments,
    codes,
):
    """Process samples (n, 6) in order; fill in their codes (n,).

    Returns:
        The code of the last one.
    """
    lengths = thresholds.shape[0]
    white = np.empty(6)
    z, y = np.empty(6), np.empty(6)
    code = FREE
    for i in range(samples.shape[0]):
        finite = True
        for a in range(6):
            white[a] = -bias[a]
            for b in range(a + 1):
                white[a] += whiten[a, b] * samples[i, b]
            finite = finite and np.isfinite(white[a])
        if not finite:
            codes[i] = code = INVALID
            continue
        in_contact = state[STATE_NOW] == CONTACT
        code = CONTACT if in_contact else FREE
        state[BIAS_VARIANCE] += state[WALK]
        for a in range(6):
            sums[0, a] += white[a]
        counts[0] += 1.0
        j, n = 0, 1.0
        while j < lengths and counts[j] >= (1.0 if j == 0 else RATIO):
            # The bias drifts untracked during contact and between its updates: the variance of a free mean includes
            # that, also at the end of a contact.
            root = np.sqrt(n * (1.0 + n * state[BIAS_VARIANCE]))
            for a in range(6):
                z[a] = sums[j, a] / root
            far = 0.0
            y[:] = z
            forward(scatter[j], 6, y)
            for a in range(6):
                far += y[a] * y[a]
            if in_contact:
                if j == int(state[DETECTED_BY]) and far < released:
                    state[STATE_NOW], code = FREE, LOST
            elif far > thresholds[j] and code == FREE:
                state[STATE_NOW], state[DETECTED_BY], code = CONTACT, j, CONTACT
            elif code == FREE:
                learn(j, z, 1.0 / prior_weight, moments, scatter)
                if j == lengths - 1:
                    ratio = n * state[BIAS_VARIANCE] + gain / (1.0 - gain)  # over a mean's noise
                    for a in range(6):
                        bias[a] += ratio / (ratio + 1.0) * sums[j, a] / n
                    state[BIAS_VARIANCE] /= ratio + 1.0
            if j + 1 < lengths:
                for a in range(6):
                    sums[j + 1, a] += sums[j, a]
                counts[j + 1] += 1.0
            for a in range(6):
                sums[j, a] = 0.0
            counts[j] = 0.0
            j, n = j + 1, n * RATIO
        if code == LOST or (code == CONTACT and not in_contact):
            for j in range(lengths):  # samples before the change do not belong to the new state
                counts[j] = 0.0
                for a in range(6):
                    sums[j, a] = 0.0
        codes[i] = code
    return code


Touching = Literal["free", "contact", "lost", "out_of_range"]
"""`lost` is reported once, for the first reading after a touch."""
_STATES: dict[int, Touching] = {FREE: "free", CONTACT: "contact", LOST: "lost", INVALID: "out_of_range"}
PRIOR_WEIGHT = 400.0
"""Weight of the sensor's own noise against the observed motion of the free probe, in means, and the number of means
that the covariance averages over."""
RELEASE_CHANCE = 1e-4
"""Probability that the mean of a free probe still counts as contact."""
DRIFT_STEPS = 0.05
"""Random walk of the bias in one second, in steps of the sensor's resolution. Assumed; 0.2 steps between touches."""


@dataclass
class Detector:
    """Sequential contact test for samples as the sensor delivers them, not averaged.

    Attributes:
        model: the probe.
        rate: of samples [Hz].
        hours_between_alarms: mean time from one false alarm to the next while the probe is free [h].
    """

    model: ProbeModel
    rate: float = 7000.0
    hours_between_alarms: float = 1.0
    _state: DetectorState = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Raise InputError for a number that is not positive and finite."""
        for name, value in (("rate", self.rate), ("hours_between_alarms", self.hours_between_alarms)):
            if not 0.0 < value < math.inf:
                raise InputError(f"{name} = {value} must be positive and finite")
        sample = self.model.noise_base() * self.model.averaging_samples
        whiten = np.linalg.inv(np.linalg.cholesky(sample))
        self._state = DetectorState.fresh(
            whiten, self._thresholds(), float(chdtri(6, RELEASE_CHANCE)), self._gain(), PRIOR_WEIGHT,
            DRIFT_STEPS**2 / self.rate,
        )  # fmt: skip

    @property
    def lengths(self) -> tuple[int, ...]:
        """Return the numbers of samples of the means."""
        return LENGTHS

    def _thresholds(self) -> Array:
        """Return the threshold of T² for each length."""
        tests_an_hour = 3600.0 * self.rate / np.array(LENGTHS)
        chance = 1.0 / self.hours_between_alarms / tests_an_hour / len(LENGTHS)
        nu = PRIOR_WEIGHT
        found = 6.0 * nu / (nu - 5.0) * fisher.isf(np.minimum(chance, 0.5), 6, nu - 5.0)
        return np.asarray(found, dtype=float)

    def _gain(self) -> float:
        """Return the gain of the bias by the longest mean: the steady state of a Kalman filter for a random walk."""
        seconds = LENGTHS[-1] / self.rate
        walk, seen = DRIFT_STEPS**2 * seconds, 1.0 / LENGTHS[-1]
        ahead = 0.5 * (walk + math.sqrt(walk * walk + 4.0 * walk * seen))
        return ahead / (ahead + seen)

    def update(self, wrench: ArrayLike) -> Touching:
        """Process the next sample.

        Args:
            wrench: at the base, less the free probe's under the same gravity [N, N·m], (6,).
        """
        sample = np.ascontiguousarray(wrench, dtype=float)
        if sample.shape != (6,):
            raise InputError(f"wrench has shape {sample.shape}; it must be (6,)")
        return _STATES[int(advance(sample[None], *self._state, np.empty(1, dtype=np.int64)))]

    def run(self, wrenches: ArrayLike) -> list[Touching]:
        """Process many samples, (n, 6)."""
        samples = np.ascontiguousarray(wrenches, dtype=float)
        if samples.ndim != 2 or samples.shape[1] != 6:
            raise InputError(f"wrenches have shape {samples.shape}; they must be (n, 6)")
        codes = np.empty(len(samples), dtype=np.int64)
        if len(samples):
            advance(samples, *self._state, codes)
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

    def rest(self, seconds: float) -> None:
        """Account for a gap without samples [s], in which the bias may have drifted."""
        self._state.state[BIAS_VARIANCE] += DRIFT_STEPS**2 * seconds

    @property
    def bias(self) -> Array:
        """Return the tracked bias of the free probe, at the base [N, N·m], (6,)."""
        return np.asarray(np.linalg.solve(self._state.whiten, self._state.bias), dtype=float)

    def detectable(self, wrench_by_force: Array, samples: int) -> float:
        """Return the smallest force [N] that is detected with probability 0.5 within so many samples.

        Args:
            wrench_by_force: change of the base wrench per newton of contact, (6,).
            samples: of which the longest mean that fits is taken.
        """
        fitting = [j for j, length in enumerate(LENGTHS) if length <= samples]
        if not fitting:
            raise InputError(f"samples = {samples} must be 1 or more")
        per_newton = self._state.whiten @ wrench_by_force
        longest = fitting[-1]
        return math.sqrt(float(self._state.thresholds[longest]) / LENGTHS[longest]) / float(
            np.linalg.norm(per_newton)
        )


PENDING, PENDING_SECONDS = 256.0, 0.15
"""Free readings that wait before they count, the fewer: the last ones may be touches not yet detected. The contact test
takes a seventh of a second at most."""
MEAN_SECONDS = 1.0
"""How long free readings count in their mean [s]: the bias drifts meanwhile."""


class FreeMean:
    """The mean of the free readings, less the free probe's wrench: it measures the bias of the sensor.

    Attributes:
        excess: the mean, (6,).
        count: number of readings that it averages.
    """

    def __init__(self, rate: float) -> None:
        """Start without readings; `rate` is that of the readings [Hz]."""
        self.excess, self.count = np.zeros(6), 0.0
        self._batch = min(PENDING, PENDING_SECONDS * rate)
        self._window = MEAN_SECONDS * rate
        self._pending = np.zeros((2, 7))  # sum and number of the readings that wait, the younger batch first

    def add(self, excess: Array) -> None:
        """Take in one free reading less the free probe's wrench, (6,)."""
        younger, older = self._pending
        younger[:6] += excess
        younger[6] += 1.0
        if younger[6] < self._batch:
            return
        added = older[6]
        if added:
            total = min(self.count + added, max(self._window, added))
            self.excess += (older[:6] - added * self.excess) / total
            self.count = total
        self._pending[1], self._pending[0] = self._pending[0], 0.0

    def drop_pending(self) -> None:
        """Drop the readings that wait: a contact was detected, and they may belong to it."""
        self._pending[:] = 0.0
