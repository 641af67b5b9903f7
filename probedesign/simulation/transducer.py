"""The simulated transducer: from load to counts and status, with noise, drift, bias and limits."""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from probedesign.estimation.model import ProbeModel
from probedesign.frames import Array
from probedesign.live.sources.netft.configuration import NetFTConfiguration
from probedesign.live.sources.netft.wire import LATCHED, SATURATED, SUMMARY

Load = Callable[[Array], Array]
"""Returns the wrench in the sensor frame [N, N·m], (n, 6), at times [s], (n,)."""

OFFSET = (0.3, -0.2, 0.5, 0.002, -0.003, 0.001)
"""Reading of the unloaded transducer [N, N·m]: assumed; in reality caused by mounting stress."""
DRIFT = 0.2 / math.sqrt(10.0)
"""Random walk of each channel, in units of the noise of one sample per √s: 0.2 after 10 s, assumed."""
MAX_COUNTS = 2**31 - 1


class SimulatedTransducer:
    """Simulates the samples of the box.

    Attributes:
        saturated: whether a fault holds it at its limit.
        latched: whether a monitor condition is latched.
    """

    def __init__(self, model: ProbeModel, load: Load, seed: int, drift: float = DRIFT) -> None:
        """Start at rest.

        Args:
            model: the probe, for the sensor's noise and range.
            load: load on the sensor.
            seed: seed of noise and drift.
            drift: see `DRIFT`.
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
        self, time: Array, spacing: float, configuration: NetFTConfiguration
    ) -> tuple[Array, NDArray[np.int64]]:
        """Return counts (n, 6) and status words (n,) at times.

        Args:
            time: times of the samples [s], (n,).
            spacing: interval between them [s].
            configuration: configuration that defines the counts.
        """
        self._zero = self._zero + self._drift * math.sqrt(spacing * len(time)) * self._random.standard_normal(
            6
        )
        wrench = self._load(time) + self._zero + self._noise * self._random.standard_normal((len(time), 6))
        if self.saturated:
            wrench[:, 0] = 2.0 * self._range[0]
        over = (np.abs(wrench) > self._range).any(axis=1)
        wrench = np.clip(wrench, -self._range, self._range)
        self._last = wrench.mean(axis=0)
        counts = np.rint((wrench - self._bias) @ np.linalg.inv(configuration.to_sensor).T)
        status = np.where(over, SUMMARY | SATURATED, 0) | (SUMMARY | LATCHED if self.latched else 0)
        return np.clip(counts, -MAX_COUNTS, MAX_COUNTS), status

    def bias(self) -> None:
        """Store the current wrench as the software bias."""
        self._bias = self._last.copy()

    def clear_bias(self) -> None:
        """Clear the software bias, as a restart does."""
        self._bias = np.zeros(6)

    def gauges(self) -> tuple[float, ...]:
        """Return the bias as shown on the page: six integers, here in ten-thousandths of the range."""
        return tuple(float(v) for v in np.rint(1e4 * self._bias / self._range))
