"""Empirical coverage: how often the reference lies within the stated ellipsoid, and the NEES of all touches."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import binomtest, chi2

from probedesign.validation.validated_test import ValidatedTest

MIN_TOUCHES = 20
"""Touches from which on the coverage can be judged: of 20, 15 to 20 within are compatible with correct covariances."""
NOMINAL = 0.95


@dataclass(frozen=True)
class Coverage:
    """Coverage of the touches that were located and measured by the reference.

    Attributes:
        touches: number of them.
        within: number within their 95 % ellipsoid.
        low, high: 95 % interval of the coverage (Clopper and Pearson).
        nees_ratio: mean squared error over the stated; 1 if the covariances are correct, more if they are too small.
        nees_low, nees_high: 95 % interval of that mean if the covariances are correct.
        z_mean, z_std: of the errors over their standard deviations along the base's axes x, y, z; empty with less
            than two touches.
        words: assessment, each one line.
    """

    touches: int
    within: int
    low: float
    high: float
    nees_ratio: float
    nees_low: float
    nees_high: float
    z_mean: tuple[float, ...]
    z_std: tuple[float, ...]
    words: tuple[str, ...]


def coverage_of(tests: Sequence[ValidatedTest], exact: bool) -> Coverage:
    """Return the coverage of all touches.

    Args:
        tests: of one campaign.
        exact: whether the probe was taken as exactly known.
    """
    errors = [test.contact_error for test in tests if test.counts and test.contact_error is not None]
    n, within = len(errors), sum(error.within_95 for error in errors)
    nan = float("nan")
    if not n:
        none = "no touch was both located and measured by the reference"
        return Coverage(0, 0, nan, nan, nan, nan, nan, (), (), (none, *_of_weights(tests)))
    share = binomtest(within, n).proportion_ci(NOMINAL)
    dof = sum(error.dof for error in errors)
    ratio = sum(error.nees for error in errors) / dof
    low, high = (float(chi2.ppf(tail, dof)) / dof for tail in (0.025, 0.975))
    z = np.array([error.z for error in errors if error.dof == 3]).reshape(-1, 3)
    mean, std = (z.mean(axis=0), z.std(axis=0, ddof=1)) if len(z) > 1 else (z[0:0], z[0:0])
    excluded = sum(test.kind == "touch" for test in tests) - n
    words = [f"{within} of {n} touches lie within their 95 % ellipsoid: {within / n:.0%}, 95 % interval of the "
             f"coverage {share.low:.0%} to {share.high:.0%}"]  # fmt: skip
    if excluded:
        words.append(
            f"{excluded} more touches were not located, or not measured by the reference, and are excluded"
        )
    if share.high < NOMINAL:
        words.append("coverage too low: the probe, its mount or the reference is less certain than stated")
    elif n < MIN_TOUCHES:
        words.append(f"sample too small to judge the coverage (n < {MIN_TOUCHES})")
    nees = f"NEES ratio {ratio:.2g}, expected {low:.2g} to {high:.2g}"
    if ratio > high:
        words.append(
            f"{nees}: stated covariance too small" + ("; try without --exact-model" if exact else "")
        )
    elif ratio < low:
        words.append(f"{nees}: stated covariance is conservative")
    else:
        words.append(nees)
    words.append("touches of one print share the errors of its stiffness, size and pose, so these intervals are "
                 "narrower than one campaign justifies")  # fmt: skip
    return Coverage(n, within, float(share.low), float(share.high), ratio, low, high, tuple(mean.ravel().tolist()),
                    tuple(std.ravel().tolist()), (*words, *_of_weights(tests)))  # fmt: skip


def _of_weights(tests: Sequence[ValidatedTest]) -> tuple[str, ...]:
    """Return a line on weights, which are separate: the lightest that are located have too low a coverage
    (docs/measurements.md)."""
    errors = [
        test.contact_error for test in tests if test.kind == "weight" and test.contact_error is not None
    ]
    if not errors:
        return ()
    within = sum(error.within_95 for error in errors)
    return (f"weights, counted separately: {within} of {len(errors)} weights lie within their 95 % interval",)
