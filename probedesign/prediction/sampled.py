"""What Monte Carlo made of a condition."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Sampled:
    """What Monte Carlo made of one condition; None where nothing was located.

    Attributes:
        contact_fraction, force_N, direction: which.
        draws: how many worlds.
        located: how many of them the estimator answered with "ok".
        error_mm, error_95_mm: RMS distance of the best places, those called inconsistent among them, and what
            95 of 100 stay within.
        standard_error_mm: of that RMS.
        first_order_mm: what the budget predicts.
        differs: whether the two differ by more than a tenth and two standard errors.
        inside: how many of those answered "ok" state a 95 % ellipsoid that holds the true point.
        touches: how many were fused; 1 is a single reading.
    """

    contact_fraction: float
    force_N: float
    direction: str
    draws: int
    located: int
    error_mm: float | None
    error_95_mm: float | None
    standard_error_mm: float | None
    first_order_mm: float | None
    differs: bool
    touches: int = 1
    inside: int = 0
