"""Contact, no contact, touch lost: a sequential test on readings that gravity has been taken off.

Means over 1, 4, 16 ... samples are tested as they fill up: a hard touch shows in one sample, a light one in many.
Of each length, whitened by the sensor's noise and by what the free probe has been seen to do besides (it sways as
the robot moves), the squared length is Hotelling's

    T² = zᵀ S⁻¹ z,   (ν - 5)/(6 ν) T² ~ F(6, ν - 5),

and its threshold is where the chance of a false alarm, over all lengths together, is that of one in
`hours_between_alarms`. A bias that drifts is followed while the probe is free.
"""

import math
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import chdtri
from scipy.stats import f as fisher

from probedesign.errors import InputError
from probedesign.estimation.model import ProbeModel
from probedesign.frames import Array
from probedesign.rod.kernels.compiled import inner, kernel

LENGTHS = (1, 4, 16, 64, 256, 1024)
RATIO = 4
FREE, CONTACT, LOST, INVALID = 0, 1, 2, 3
STATE_NOW, DETECTED_BY, DOUBT, WALK = 0, 1, 2, 3


class Memory(NamedTuple):
    """What the test keeps from sample to sample; lengths have their places in `LENGTHS`.

    Attributes:
        whiten: of a sample, (6, 6).
        thresholds: of T² for each length, (6,).
        released: T² below which a touch is over.
        gain: of the bias.
        trusted: weight of the identity in the covariances, and how many means they remember.
        state: what was said last, by which length a touch was told, the variance by which the bias may have walked
            while it was not followed, and its walk a sample, in those of a sample, (4,).
        bias: whitened, (6,).
        sums: running for each length, (6, 6); counts: of parts in them, (6,).
        scatter: Cholesky factor of S for each length, (6, 6, 6); moments: what S is made from, (6, 6, 6).
    """

    whiten: Array
    thresholds: Array
    released: float
    gain: float
    trusted: float
    state: Array
    bias: Array
    sums: Array
    counts: Array
    scatter: Array
    moments: Array

    @classmethod
    def fresh(
        cls, whiten: Array, thresholds: Array, released: float, gain: float, trusted: float, walk: float
    ) -> "Memory":
        """Of a probe that is free."""
        lengths = len(LENGTHS)
        eye = np.tile(np.eye(6), (lengths, 1, 1))
        return cls(whiten, thresholds, released, gain, trusted, np.array([0.0, 0.0, 0.0, walk]), np.zeros(6),
                   np.zeros((lengths, 6)), np.zeros(lengths), eye.copy(), eye.copy())  # fmt: skip


@inner
def square(z, factor):
    """zᵀ S⁻¹ z by forward substitution with S's Cholesky factor."""
    y0 = z[0] / factor[0, 0]
    y1 = (z[1] - factor[1, 0] * y0) / factor[1, 1]
    y2 = (z[2] - factor[2, 0] * y0 - factor[2, 1] * y1) / factor[2, 2]
    y3 = (z[3] - factor[3, 0] * y0 - factor[3, 1] * y1 - factor[3, 2] * y2) / factor[3, 3]
    y4 = (z[4] - factor[4, 0] * y0 - factor[4, 1] * y1 - factor[4, 2] * y2 - factor[4, 3] * y3) / factor[4, 4]
    y5 = (
        z[5]
        - factor[5, 0] * y0
        - factor[5, 1] * y1
        - factor[5, 2] * y2
        - factor[5, 3] * y3
        - factor[5, 4] * y4
    ) / factor[5, 5]
    return y0 * y0 + y1 * y1 + y2 * y2 + y3 * y3 + y4 * y4 + y5 * y5


@inner
def learn(j, z, share, moments, scatter):
    """Let the covariance of means of length j forget a little and take in one more; factor it anew."""
    for a in range(6):
        for b in range(6):
            moments[j, a, b] += share * (z[a] * z[b] - moments[j, a, b])
    # Never less than the sensor's own noise: a quiet spell does not make the test nervous.
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
    samples, whiten, thresholds, released, gain, trusted, state, bias, sums, counts, scatter, moments, codes
):
    """Take in samples (n, 6), one after another; codes (n,) are filled.

    Returns:
        What the last of them says.
    """
    lengths = thresholds.shape[0]
    white = np.empty(6)
    z = np.empty(6)
    said = FREE
    for i in range(samples.shape[0]):
        finite = True
        for a in range(6):
            white[a] = -bias[a]
            for b in range(a + 1):
                white[a] += whiten[a, b] * samples[i, b]
            finite = finite and np.isfinite(white[a])
        if not finite:
            codes[i] = said = INVALID
            continue
        touching = state[STATE_NOW] == CONTACT
        said = CONTACT if touching else FREE
        state[DOUBT] += state[WALK]
        for a in range(6):
            sums[0, a] += white[a]
        counts[0] += 1.0
        j, n = 0, 1.0
        while j < lengths and counts[j] >= (1.0 if j == 0 else RATIO):
            # The bias walks unseen, while touched and from one step of following it to the next: a free mean may lie
            # off by that, at the end of a touch too.
            root = np.sqrt(n * (1.0 + n * state[DOUBT]))
            for a in range(6):
                z[a] = sums[j, a] / root
            far = square(z, scatter[j])
            if touching:
                if j == int(state[DETECTED_BY]) and far < released:
                    state[STATE_NOW], said = FREE, LOST
            elif far > thresholds[j] and said == FREE:
                state[STATE_NOW], state[DETECTED_BY], said = CONTACT, j, CONTACT
            elif said == FREE:
                learn(j, z, 1.0 / trusted, moments, scatter)
                if j == lengths - 1:
                    doubt = n * state[DOUBT] + gain / (1.0 - gain)  # over a mean's noise
                    for a in range(6):
                        bias[a] += doubt / (doubt + 1.0) * sums[j, a] / n
                    state[DOUBT] /= doubt + 1.0
            if j + 1 < lengths:
                for a in range(6):
                    sums[j + 1, a] += sums[j, a]
                counts[j + 1] += 1.0
            for a in range(6):
                sums[j, a] = 0.0
            counts[j] = 0.0
            j, n = j + 1, n * RATIO
        if said == LOST or (said == CONTACT and not touching):
            for j in range(lengths):  # what lies before the change says nothing of after it
                counts[j] = 0.0
                for a in range(6):
                    sums[j, a] = 0.0
        codes[i] = said
    return said


Touching = Literal["free", "contact", "lost", "out_of_range"]
"""`lost` is reported once, for the first reading after a touch."""
_SAID: dict[int, Touching] = {FREE: "free", CONTACT: "contact", LOST: "lost", INVALID: "out_of_range"}
TRUSTED = 400.0
"""Weight of the sensor's own noise beside what the free probe is seen to do, in means; and how many of those are
remembered."""
RELEASED = 1e-4
"""Chance that the mean of a free probe still counts as touched."""
DRIFT_STEPS = 0.05
"""How far the bias walks in a second, in steps of the sensor's resolution. Assumed; 0.2 steps from touch to touch."""


@dataclass
class Detector:
    """The test, for samples as the sensor gives them: not averaged.

    Attributes:
        model: the probe.
        rate: of samples [Hz].
        hours_between_alarms: mean time from one false alarm to the next while the probe is free [h].
    """

    model: ProbeModel
    rate: float = 7000.0
    hours_between_alarms: float = 1.0
    _memory: Memory = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Raises InputError where a number makes no sense."""
        for name, value in (("rate", self.rate), ("hours_between_alarms", self.hours_between_alarms)):
            if not 0.0 < value < math.inf:
                raise InputError(f"{name} = {value} must be positive and finite")
        sample = self.model.noise_base() * self.model.averaging_samples
        whiten = np.linalg.inv(np.linalg.cholesky(sample))
        self._memory = Memory.fresh(
            whiten, self._thresholds(), float(chdtri(6, RELEASED)), self._gain(), TRUSTED,
            DRIFT_STEPS**2 / self.rate,
        )  # fmt: skip

    @property
    def lengths(self) -> tuple[int, ...]:
        """Return over how many samples the means are."""
        return LENGTHS

    def _thresholds(self) -> Array:
        """Return the threshold of T² for each length."""
        tests_an_hour = 3600.0 * self.rate / np.array(LENGTHS)
        chance = 1.0 / self.hours_between_alarms / tests_an_hour / len(LENGTHS)
        nu = TRUSTED
        found = 6.0 * nu / (nu - 5.0) * fisher.isf(np.minimum(chance, 0.5), 6, nu - 5.0)
        return np.asarray(found, dtype=float)

    def _gain(self) -> float:
        """Return the share of the longest mean's misfit that the bias follows: Kalman's steady state for a walk."""
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
        return _SAID[int(advance(sample[None], *self._memory, np.empty(1, dtype=np.int64)))]

    def run(self, wrenches: ArrayLike) -> list[Touching]:
        """Process many samples, (n, 6)."""
        samples = np.ascontiguousarray(wrenches, dtype=float)
        if samples.ndim != 2 or samples.shape[1] != 6:
            raise InputError(f"wrenches have shape {samples.shape}; they must be (n, 6)")
        codes = np.empty(len(samples), dtype=np.int64)
        if len(samples):
            advance(samples, *self._memory, codes)
        return [_SAID[code] for code in codes.tolist()]

    def calibrate(self, wrenches: ArrayLike) -> None:
        """Learn how a probe sways that is known to be free, as while the robot moves it, (n, 6).

        A sway that was not calibrated is reported as touches.
        """
        thresholds = self._memory.thresholds.copy()
        self._memory.thresholds[:] = np.inf
        try:
            self.run(wrenches)
        finally:
            self._memory.thresholds[:] = thresholds

    def rest(self, seconds: float) -> None:
        """Account for a gap without samples [s], in which the bias may have walked."""
        self._memory.state[DOUBT] += DRIFT_STEPS**2 * seconds

    @property
    def bias(self) -> Array:
        """Return the tracked bias of the free probe, at the base [N, N·m], (6,)."""
        return np.asarray(np.linalg.solve(self._memory.whiten, self._memory.bias), dtype=float)

    def detectable(self, wrench_by_force: Array, samples: int) -> float:
        """Return the smallest force [N] that is detected with probability 0.5 within so many samples.

        Args:
            wrench_by_force: change of the base wrench per newton of contact, (6,).
            samples: of which the longest mean that fits is taken.
        """
        fitting = [j for j, length in enumerate(LENGTHS) if length <= samples]
        if not fitting:
            raise InputError(f"samples = {samples} must be 1 or more")
        per_newton = self._memory.whiten @ wrench_by_force
        longest = fitting[-1]
        return math.sqrt(float(self._memory.thresholds[longest]) / LENGTHS[longest]) / float(
            np.linalg.norm(per_newton)
        )
