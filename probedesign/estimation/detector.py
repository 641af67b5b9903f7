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
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import chdtri
from scipy.stats import f as fisher

from probedesign.errors import InputError
from probedesign.estimation.detector_kernel import (
    CONTACT,
    DOUBT,
    FREE,
    INVALID,
    LENGTHS,
    LOST,
    Memory,
    advance,
)
from probedesign.estimation.model import ProbeModel
from probedesign.frames import Array

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
