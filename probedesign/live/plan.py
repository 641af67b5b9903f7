"""What `live` does with the readings of a source."""

import math
from dataclasses import dataclass

from probedesign.errors import InputError
from probedesign.estimation.estimator import Method
from probedesign.live.tare import Window


@dataclass(frozen=True)
class Plan:
    """What `live` does with the readings of a source.

    Attributes:
        window: when the probe is free, for the tare; None takes none.
        samples: how many readings are averaged to one.
        rate: at most so many estimates a second of the source's clock [Hz].
        count: end after so many estimates.
        seconds: end so long after the first reading [s].
        filter_hz: cut-off of the low-pass before each estimate; None filters nothing.
        method: by which a single reading is located.
        estimates: whether contacts are located as readings come; else phases and touches alone are told.
    """

    window: Window | None = None
    samples: int = 1
    rate: float = math.inf
    count: int | None = None
    seconds: float | None = None
    filter_hz: float | None = None
    estimates: bool = True
    method: Method = "ml"

    def __post_init__(self) -> None:
        """Raises InputError where a number cannot be meant."""
        said = {"average": self.samples, "rate-hz": self.rate, "count": self.count, "seconds": self.seconds,
                "filter-hz": self.filter_hz}  # fmt: skip
        for name, value in said.items():
            if value is not None and not value > 0:
                raise InputError(f"--{name} {value} must be positive")
