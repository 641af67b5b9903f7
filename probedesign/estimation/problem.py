"""What a single contact is located from."""

from typing import NamedTuple

from probedesign.estimation.error_sources import ErrorSources
from probedesign.estimation.observation import Observation
from probedesign.frames import Array


class Problem(NamedTuple):
    """What one reading is located from.

    Attributes:
        sources: error sources under its gravity.
        seen: the reading.
        friction: prior standard deviation of the friction ratio.
        noise: covariance of the reading by noise and drift, (6, 6).
    """

    sources: ErrorSources
    seen: Observation
    friction: float
    noise: Array
