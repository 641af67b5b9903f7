"""Readings that lie far off: how much they count, and how much their kind scatters.

A group of k misfits at distance d counts whole up to c², the 99 % quantile of χ²_k, and by c²/d² beyond: with normal
noise hardly anything is lost, and a gross error pulls with a force that falls as 1/d, whatever it is. That loss has
more than one minimum, so the distances are first told in the median's own measure, which falls to 1 as the fit comes
near.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.stats import chi2

from probedesign.frames import Array
from probedesign.identification.residuals import Group

TRUSTED = 0.99
ROBUST = ("markers", "wrenches", "touches")
"""Kinds that come in numbers; the others say what is known beforehand, or stand alone."""
DOUBTED = 1e-3
"""Chance, by noise as stated, of a scatter that is taken to show more noise."""
NAMED = 0.01
"""Chance, by normal noise, that a campaign names any outlier at all."""


@dataclass(frozen=True)
class Noise:
    """How much one kind of reading scatters.

    Attributes:
        kind: of readings.
        groups: how many there are.
        scale: of their standard deviations, over those stated; at least 1.
        freedom: degrees of freedom it was told by.
        measured: whether the scatter was taken from the misfits, being more than stated noise makes.
    """

    kind: str
    groups: int
    scale: float
    freedom: float
    measured: bool


@cache
def _bound(k: int) -> float:
    """c²."""
    return float(chi2.ppf(TRUSTED, k))


@cache
def _median(k: int) -> float:
    return float(chi2.median(k))


def distance(group: Group) -> float:
    """Squared, over the stated noise."""
    return float(group.r @ group.r)


def weights(groups: Sequence[Group], scales: dict[str, float]) -> Array:
    """How much each group counts, in units of its stated information, (n,)."""
    found = np.ones(len(groups))
    for i, group in enumerate(groups):
        if group.kind in ROBUST:
            scale = scales.get(group.kind, 1.0) ** 2
            d = distance(group) / scale
            found[i] = min(1.0, _bound(len(group.r)) / max(d, 1e-12)) / scale
    return found


def loss(groups: Sequence[Group], scales: dict[str, float]) -> float:
    """What a fit makes small."""
    total = 0.0
    for group in groups:
        d = distance(group)
        if group.kind in ROBUST:
            d /= scales.get(group.kind, 1.0) ** 2
            c = _bound(len(group.r))
            d = d if d <= c else c * (1.0 + np.log(d / c))
        total += 0.5 * d
    return total


def median_scales(groups: Sequence[Group]) -> dict[str, float]:
    """Of each kind, by the median of its distances; never below 1."""
    found = {}
    for kind in ROBUST:
        own = [distance(group) / _median(len(group.r)) for group in groups if group.kind == kind]
        if own:
            found[kind] = max(1.0, float(np.sqrt(np.median(own))))
    return found


def noise_of(
    groups: Sequence[Group], weight: Array, leverage: Array, scales: dict[str, float]
) -> list[Noise]:
    """How much each kind scatters about the fit.

    Args:
        groups: of the whole campaign.
        weight: of each, with the scales so far.
        leverage: how many of each group's misfits the fit takes up, (n,).
        scales: so far.
    """
    found = []
    for kind in dict.fromkeys(group.kind for group in groups):
        at = [i for i, group in enumerate(groups) if group.kind == kind]
        if kind not in ROBUST:
            continue
        share = weight[at] * scales.get(kind, 1.0) ** 2  # 1 of what is trusted
        squares = float(np.sum(share * [distance(groups[i]) for i in at]))
        freedom = float(np.sum(share * [len(groups[i].r) for i in at]) - leverage[at].sum())
        measured = freedom > 1.0 and chi2.sf(squares, freedom) < DOUBTED
        scale = float(np.sqrt(squares / freedom)) if measured else 1.0
        found.append(Noise(kind, len(at), scale, max(freedom, 0.0), bool(measured)))
    return found


def outliers(groups: Sequence[Group], scales: dict[str, float]) -> list[tuple[Group, float]]:
    """Groups that noise does not explain, farthest first, with their distance in standard deviations of one number."""
    count = sum(group.kind in ROBUST for group in groups)
    found = []
    for group in groups:
        if group.kind in ROBUST:
            d = distance(group) / scales.get(group.kind, 1.0) ** 2
            if chi2.sf(d, len(group.r)) < NAMED / max(count, 1):
                found.append((group, float(np.sqrt(d))))
    return sorted(found, key=lambda pair: -pair[1])
