"""The transducer and the box's arithmetic: load in, counts and status out, with noise, drift, bias and limits."""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from probedesign.estimation.model import ProbeModel
from probedesign.frames import Array
from probedesign.live.sources.netft.configuration import Configuration
from probedesign.live.sources.netft.wire import LATCHED, SATURATED, SUMMARY

Load = Callable[[Array], Array]
"""Wrench in the sensor frame [N, N·m], (n, 6), at times [s], (n,)."""

OFFSET = (0.3, -0.2, 0.5, 0.002, -0.003, 0.001)
"""What an unloaded transducer reads [N, N·m]: assumed; real ones read such things from stress of mounting."""
DRIFT = 0.2 / math.sqrt(10.0)
"""Random walk of each channel, in noise of one sample after one second: 0.2 after ten, assumed."""
FULL = 2**31 - 1


class Transducer:
    """What the box reads, sample after sample.

    Attributes:
        saturated: whether a fault holds it at its limit.
        latched: whether a monitor condition is latched.
    """

    def __init__(self, model: ProbeModel, load: Load, seed: int, drift: float = DRIFT) -> None:
        """At rest.

        Args:
            model: the probe, for the sensor's noise and range.
            load: that the sensor feels.
            seed: of noise and drift.
            drift: as `DRIFT`.
        """
        self.saturated = self.latched = False
        self._load = load
        self._random = np.random.default_rng(seed)
        std = np.sqrt(np.diag(model.noise.covariance()))
        self._noise = std * math.sqrt(model.averaging_samples)  # of one sample
        self._drift = drift * self._noise
        self._zero = np.array(OFFSET)
        self._bias = np.zeros(6)
        self._range = model.wrench_range
        self._last = self._zero

    def read(
        self, time: Array, spacing: float, configuration: Configuration
    ) -> tuple[Array, NDArray[np.int64]]:
        """Counts (n, 6) and status words (n,) at times.

        Args:
            time: of each sample [s], (n,).
            spacing: between them [s].
            configuration: what the box counts in.
        """
        self._zero = self._zero + self._drift * math.sqrt(spacing * len(time)) * self._random.standard_normal(
            6
        )
        felt = self._load(time) + self._zero + self._noise * self._random.standard_normal((len(time), 6))
        if self.saturated:
            felt[:, 0] = 2.0 * self._range[0]
        over = (np.abs(felt) > self._range).any(axis=1)
        felt = np.clip(felt, -self._range, self._range)
        self._last = felt.mean(axis=0)
        counts = np.rint((felt - self._bias) @ np.linalg.inv(configuration.to_sensor).T)
        status = np.where(over, SUMMARY | SATURATED, 0) | (SUMMARY | LATCHED if self.latched else 0)
        return np.clip(counts, -FULL, FULL), status

    def bias(self) -> None:
        """Call what is felt now zero."""
        self._bias = self._last.copy()

    def unbias(self) -> None:
        """Forget that, as a restart does."""
        self._bias = np.zeros(6)

    def gauges(self) -> tuple[float, ...]:
        """The bias as the page shows it: six whole numbers, here in ten-thousandths of the range, since there are
        no gauges."""
        return tuple(float(v) for v in np.rint(1e4 * self._bias / self._range))
