"""Critically damped low-pass filter: a step response without overshoot, so a contact force is never overestimated."""

import math

import numpy as np

from probedesign.core.errors import InputError
from probedesign.core.frames import Array


class LowPass:
    """Low-pass filter with a double real pole (critically damped), 3 dB down at the cut-off.

    Each pole is y += (1 - a)(x - y), with gain (1 - a)² / (1 - 2 a cos ω + a²), which is 1/√2 at the cut-off. At
    low frequencies its delay is exactly a / (1 - a) samples, for any cut-off.

    Attributes:
        delay: delay of signals that are slow compared with the cut-off [s]; about 0.2/cut-off.
    """

    def __init__(self, cutoff: float, rate: float) -> None:
        """Design the filter; it starts in steady state at the first sample.

        Args:
            cutoff: half-power frequency [Hz].
            rate: sampling rate [Hz].

        Raises:
            InputError: the cut-off is not positive or not below half the rate.
        """
        if not 0.0 < cutoff < 0.5 * rate:
            raise InputError(
                f"--filter-hz {cutoff:g} must be positive and below half of {rate:.6g} readings/s"
            )
        cosine = math.cos(2.0 * math.pi * cutoff / rate)
        # (1 - a)² √2 = 1 - 2 a cos ω + a², the root within the unit circle.
        half = (math.sqrt(2.0) - cosine) / (math.sqrt(2.0) - 1.0)
        pole = half - math.sqrt(half * half - 1.0)
        self.delay = 2.0 * pole / (1.0 - pole) / rate
        self._sections = np.array([[1.0 - pole, 0.0, 0.0, 1.0, -pole, 0.0]] * 2)
        self._state: Array | None = None

    def filter(self, samples: Array) -> Array:
        """Return the next samples (n, k), filtered."""
        from scipy.signal import sosfilt  # takes half a second to import, so only if a filter is used

        if self._state is None:  # steady state of each pole is pole × value
            pole = -self._sections[0, 4]
            self._state = np.zeros((2, 2, samples.shape[1]))
            self._state[:, 0] = pole * samples[0]
        filtered, self._state = sosfilt(self._sections, samples, axis=0, zi=self._state)
        return np.asarray(filtered, dtype=float)

    def reset(self) -> None:
        """Discard the filter state: the next sample is treated as the first."""
        self._state = None
