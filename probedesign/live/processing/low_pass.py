"""A low-pass filter that never overshoots: a touch does not look harder than it is."""

import math

import numpy as np

from probedesign.errors import InputError
from probedesign.frames import Array


class LowPass:
    """Two poles at one place (critically damped), down by 3 dB at the cut-off.

    Each pole is y += (1 - a)(x - y), whose gain (1 - a)² / (1 - 2 a cos ω + a²) is 1/√2 at the cut-off; at low
    frequencies it delays by a / (1 - a) samples, exactly, whatever the cut-off.

    Attributes:
        delay: of anything slow against the cut-off [s]; 0.2/cut-off or so.
    """

    def __init__(self, cutoff: float, rate: float) -> None:
        """At rest at the first sample that comes.

        Args:
            cutoff: where the power is halved [Hz].
            rate: of samples [Hz].

        Raises:
            InputError: the cut-off is not positive and below half the rate.
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

    def run(self, samples: Array) -> Array:
        """The samples that come next (n, k), filtered."""
        from scipy.signal import sosfilt  # half a second that only who filters waits for

        if self._state is None:  # each pole holds pole × value where it has rested at a value
            pole = -self._sections[0, 4]
            self._state = np.zeros((2, 2, samples.shape[1]))
            self._state[:, 0] = pole * samples[0]
        filtered, self._state = sosfilt(self._sections, samples, axis=0, zi=self._state)
        return np.asarray(filtered, dtype=float)

    def rest(self) -> None:
        """Forget: the next sample is the first."""
        self._state = None
