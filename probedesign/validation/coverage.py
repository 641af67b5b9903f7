"""Whether stated errors come true: how often the reference lies within the ellipsoid, and how large errors are beside
what was stated."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import binomtest, chi2

from probedesign.validation.validated_test import Trial

FEW = 20
"""Touches below which a share says little: of 20, between 15 and 20 within is no news."""
SHARE = 0.95


@dataclass(frozen=True)
class Honesty:
    """Of the touches that were located and that the reference saw.

    Attributes:
        touches: how many.
        within: of them within their 95 % ellipsoid.
        low, high: the share that this tells, 95 % interval (Clopper and Pearson).
        nees_ratio: errors squared over what was stated, mean; 1 if all is true, more where too much was promised.
        nees_low, nees_high: what the mean of so many stays within, 95 times in 100, if all is true.
        z_mean, z_std: of the errors over their standard deviations along the base's axes x, y, z; empty with
            less than two.
        words: what to think of it, each one line.
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


def honesty_of(trials: Sequence[Trial], exact: bool) -> Honesty:
    """Judge the stated errors of all trials that count.

    Args:
        trials: of one campaign.
        exact: the probe was taken as exact.
    """
    misses = [trial.miss for trial in trials if trial.counts and trial.miss is not None]
    n, within = len(misses), sum(miss.within_95 for miss in misses)
    nan = float("nan")
    if not n:
        words = ("no touch was located that the reference saw too", *_of_weights(trials))
        return Honesty(0, 0, nan, nan, nan, nan, nan, (), (), words)
    share = binomtest(within, n).proportion_ci(SHARE)
    dof = sum(miss.dof for miss in misses)
    ratio = sum(miss.nees for miss in misses) / dof
    low, high = (float(chi2.ppf(tail, dof)) / dof for tail in (0.025, 0.975))
    z = np.array([miss.z for miss in misses if miss.dof == 3]).reshape(-1, 3)
    mean, std = (z.mean(axis=0), z.std(axis=0, ddof=1)) if len(z) > 1 else (z[0:0], z[0:0])
    lost = sum(trial.kind == "touch" for trial in trials) - n
    words = _words(n, lost, within, (share.low, share.high), ratio, (low, high), exact) + _of_weights(trials)
    return Honesty(n, within, float(share.low), float(share.high), ratio, low, high,
                   tuple(mean.ravel().tolist()), tuple(std.ravel().tolist()), words)  # fmt: skip


def _of_weights(trials: Sequence[Trial]) -> tuple[str, ...]:
    """Weights by themselves: the lightest that are located lie too seldom in their intervals (docs/measurements.md)."""
    misses = [trial.miss for trial in trials if trial.kind == "weight" and trial.miss is not None]
    if not misses:
        return ()
    within = sum(miss.within_95 for miss in misses)
    return (f"not counted with them: {within} of {len(misses)} weights lie within their 95 % interval",)


def _words(
    n: int,
    lost: int,
    within: int,
    share: tuple[float, float],
    ratio: float,
    span: tuple[float, float],
    exact: bool,
) -> tuple[str, ...]:
    told = [f"{within} of {n} touches lie within their 95 % ellipsoid: {within / n:.0%}, of which so many tell "
            f"{share[0]:.0%} to {share[1]:.0%}"]  # fmt: skip
    if lost:
        told.append(
            f"{lost} more were not located, or not seen by the reference: nothing here is said of them"
        )
    if share[1] < SHARE:
        told.append("that is too few: the probe, its mount or the reference is worse known than stated")
    elif n < FEW:
        told.append(f"so few do not tell a good statement from a fair one; {FEW} or more would")
    square = (
        f"errors squared are {ratio:.2g} times what was stated, {span[0]:.2g} to {span[1]:.2g} if all is true"
    )
    if ratio > span[1]:
        told.append(f"{square}: too much was promised" + ("; try without --exact-model" if exact else ""))
    elif ratio < span[0]:
        told.append(f"{square}: less was promised than is kept")
    else:
        told.append(square)
    told.append("touches of one print share its stiffness, its size and its place: they hold or miss together, so "
                "the intervals are narrower than what one campaign can tell")  # fmt: skip
    return tuple(told)
