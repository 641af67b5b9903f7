"""Noise of simulated sensors: white noise of readings and samples, and the random walk of the bias.

All simulators take their noise from here. White noise is that of the frozen probe, which states it for the mean of
`averaging_samples` samples; the bias of each channel walks at a rate stated per √s.
"""

import math

import numpy as np

from probedesign.core.frames import Array
from probedesign.estimation.model import ProbeModel


def reading_std(model: ProbeModel) -> Array:
    """Return the standard deviations of one reading, the mean of `averaging_samples` samples [N, N·m], (6,)."""
    return model.noise.std


def sample_std(model: ProbeModel) -> Array:
    """Return the standard deviations of one sample [N, N·m], (6,); a step of the resolution is taken as large."""
    return reading_std(model) * math.sqrt(model.averaging_samples)


def bias_step(rng: np.random.Generator, rate: float, seconds: float) -> Array:
    """Return how far the bias walks in a time, in the unit of the rate, (6,).

    Args:
        rng: random numbers.
        rate: standard deviation of each channel per √s.
        seconds: the time [s].
    """
    return rng.normal(0.0, rate * math.sqrt(seconds), 6)
