"""What a single contact is located from."""

from dataclasses import dataclass
from functools import cached_property

from probedesign.core.frames import Array
from probedesign.estimation.error_sources import ErrorSources
from probedesign.estimation.force_moment import Scan
from probedesign.estimation.model import Observation


@dataclass(eq=False)
class Problem:
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

    @cached_property
    def scan(self) -> Scan:
        """Return the reading's scan along the probe, made when it is first needed."""
        return Scan.of(self.sources.model.rod, self.seen)
