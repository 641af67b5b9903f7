"""Robust loss: weights of blocks of residuals, noise scales of their kinds, outliers.

A block of k residuals at distance d has full weight up to c², the 99 % quantile of χ²_k, and weight c²/d² beyond: with
normal noise hardly any information is lost, and the pull of a gross error falls as 1/d. That loss has more than one
minimum, so distances are first measured against their median, whose scale falls to 1 as the fit converges.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.stats import chi2

from probedesign.core.frames import Array
from probedesign.identification.residuals import ResidualBlock

READING_KINDS = ("markers", "wrenches", "touches", "places", "weights")  #: Kinds of readings that most tests have.
#: Kinds whose scatter is estimated where it exceeds the stated one; the others are prior knowledge or single readings.
#: Stiffness and friction of each touch scatter as readings do, and one may be far from the others.
ROBUST_KINDS = (*READING_KINDS, "stiffness", "friction")
MIN_FREEDOM = 1.0  #: Degrees of freedom from which on a scatter is judged.
#: Equivalent degrees of freedom of a stated standard deviation, which has an uncertainty of about a third (assumed).
STATED_FREEDOM = 4.0
FULL_WEIGHT = 0.99  #: Quantile of χ² up to which a block has full weight.
REJECTION_CHANCE = 1e-3  #: Chance, with noise as stated, that a prior is rejected.
#: Chance, with noise as stated, that a scatter is judged larger than stated and reported; it refuses nothing.
SCATTER_CHANCE = 0.05
OUTLIER_CHANCE = 0.01  #: Chance, with normal noise, that a campaign reports any outlier at all.


@dataclass(frozen=True)
class NoiseScale:
    """Scatter of one kind of reading."""

    kind: str  #: of readings.
    groups: int  #: how many there are.
    scale: float  #: standard deviation over the stated one; at least 1.
    freedom: float  #: degrees of freedom of the scale, those of the stated value included.
    measured: bool  #: whether the residuals scatter significantly more than stated.


@cache
def _full_weight_limit(k: int) -> float:
    return float(chi2.ppf(FULL_WEIGHT, k))


@cache
def _median(k: int) -> float:
    return float(chi2.median(k))


def weights(blocks: Sequence[ResidualBlock], scales: dict[str, float]) -> Array:
    """Return the weight of each block, relative to its stated information, (n,)."""
    result = np.ones(len(blocks))
    for i, block in enumerate(blocks):
        if block.kind in ROBUST_KINDS:
            variance = scales.get(block.kind, 1.0) ** 2
            d2 = block.squared_distance / variance
            result[i] = min(1.0, _full_weight_limit(len(block.r)) / max(d2, 1e-12)) / variance
    return result


def robust_loss(blocks: Sequence[ResidualBlock], scales: dict[str, float]) -> float:
    """Return the loss that a fit minimises, half a χ² of blocks with full weight."""
    total = 0.0
    for block in blocks:
        d2 = block.squared_distance
        if block.kind in ROBUST_KINDS:
            d2 /= scales.get(block.kind, 1.0) ** 2
            limit = _full_weight_limit(len(block.r))
            d2 = d2 if d2 <= limit else limit * (1.0 + np.log(d2 / limit))
        total += 0.5 * d2
    return total


def median_scales(blocks: Sequence[ResidualBlock]) -> dict[str, float]:
    """Return the scale of each kind by the median of its distances, at least 1."""
    result = {}
    for kind in ROBUST_KINDS:
        relative = [block.squared_distance / _median(len(block.r)) for block in blocks if block.kind == kind]
        if relative:
            result[kind] = max(1.0, float(np.sqrt(np.median(relative))))
    return result


def noise_scales(
    blocks: Sequence[ResidualBlock], weight: Array, leverage: Array, scales: dict[str, float]
) -> list[NoiseScale]:
    """Estimate the scatter of each kind about the fit; `leverage` is what the fit absorbs of each block, (n,).

    The stated variance is itself uncertain: its prior is the scaled inverse χ² distribution with `STATED_FREEDOM`
    degrees of freedom, and the scale is that of the posterior, never below the stated one.
    """
    result = []
    for kind in dict.fromkeys(block.kind for block in blocks if block.kind in ROBUST_KINDS):
        at = [i for i, block in enumerate(blocks) if block.kind == kind]
        # 1 for blocks with full weight; the square lets far outliers have no part in the scale.
        relative = (weight[at] * scales.get(kind, 1.0) ** 2) ** 2
        squares = float(np.sum(relative * [blocks[i].squared_distance for i in at]))
        freedom = float(np.sum(relative * [len(blocks[i].r) for i in at]) - leverage[at].sum())
        measured = freedom > MIN_FREEDOM and chi2.sf(squares, freedom) < SCATTER_CHANCE
        freedom = max(freedom, 0.0) + STATED_FREEDOM
        scale = max(math.sqrt((squares + STATED_FREEDOM) / freedom), 1.0)
        result.append(NoiseScale(kind, len(at), scale, freedom, bool(measured)))
    return result


def chi2_words(squares: float, freedom: int) -> str:
    """Return a χ², its degrees of freedom and the probability of one as large, as text."""
    chance = max(float(chi2.sf(squares, freedom)), 1e-99)
    return f"χ² {squares:.3g} of {freedom} degree{'s' * (freedom != 1)} of freedom, probability {chance:.1g}"


def outliers(blocks: Sequence[ResidualBlock], scales: dict[str, float]) -> list[tuple[ResidualBlock, float]]:
    """Return the blocks that noise does not explain, farthest first, with their Mahalanobis distance."""
    count = sum(block.kind in ROBUST_KINDS for block in blocks)
    result = []
    for block in blocks:
        if block.kind in ROBUST_KINDS:
            d2 = block.squared_distance / scales.get(block.kind, 1.0) ** 2
            if chi2.sf(d2, len(block.r)) < OUTLIER_CHANCE / max(count, 1):
                result.append((block, float(np.sqrt(d2))))
    return sorted(result, key=lambda pair: -pair[1])
