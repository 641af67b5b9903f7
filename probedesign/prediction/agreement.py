"""Agreement of predicted with measured errors, and of simple laws that any prediction must surpass.

The mechanics of a prediction of the paper's Table I are only justified if it agrees better than laws without mechanics.
Two such laws are compared: a constant, and the error of the lever. A force error δF moves the point that a moment
M = s F indicates by s δF / F, which together with the error of the reference is √((δF s/F)² + r²). Their one and two
constants are fitted to the table; the model has one, the error of the reference. Left-out scores fit the constants on
the other two probes, so that no law is judged on rows that it was fitted to.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize
from scipy.stats import spearmanr

from probedesign.core.frames import Array

FACTOR = 2.0
CONSTANT_MM = 2.25
"""Constant with the most rows of Table I within a factor of two: 2.09 to 2.28 mm have 18."""
LEVER_MN, LEVER_REFERENCE_MM = 0.52, 1.3
"""Force error [mN] and error of the reference [mm] with which the lever law has the most rows within a factor of two,
fitted by hand to the whole table."""


@dataclass(frozen=True)
class AgreementScore:
    """Agreement of a setting with the table."""

    setting: str  #: name of the setting.
    within: int  #: number of rows within a factor of two.
    predicted: int  #: number of rows with a prediction.
    rank_correlation: float | None  #: Spearman's, of the rows predicted; None for a constant.
    typical_factor: float  #: exponential of the RMS of ln(predicted / measured), of the rows predicted.
    constants: int = 0  #: number of constants that were fitted to the table or assumed.


@dataclass(frozen=True, eq=False)
class PublishedErrors:
    """Conditions and measured errors of the rows of a table."""

    probes: tuple[str, ...]  #: name of the probe of each row.
    s_mm: Array  #: arclength of the contact, (n,).
    force_mN: Array  #: (n,).
    measured_mm: Array  #: contact error, (n,).


@dataclass(frozen=True)
class Comparison:
    """The model beside the simple laws."""

    #: model, lever and constant, with the constants stated or fitted to the whole table.
    fitted: tuple[AgreementScore, ...]
    left_out: tuple[AgreementScore, ...]  #: the same, each probe predicted with the constants fitted to the other two.
    #: rank correlation, by probe and over `all`, of measured with predicted error where both are divided by the lever
    #: law's: above 0 the model knows something that the law does not.
    beyond_lever: dict[str, float]


Law = Callable[[Sequence[float]], Array]
"""Predicted errors of all rows [mm] by the constants of a law."""


def agreement(setting: str, predicted: Array, measured: Array, constants: int = 0) -> AgreementScore:
    """Return the agreement of predicted with measured errors [mm], (n,); NaN where there is no prediction."""
    known = np.isfinite(predicted)
    logarithms = np.log(predicted[known] / measured[known])
    within = int((np.abs(logarithms) <= math.log(FACTOR)).sum())
    varies = bool(np.ptp(predicted[known]) > 0.0)
    rank = float(spearmanr(predicted[known], measured[known]).statistic) if varies else None
    typical = math.exp(math.sqrt(float(np.mean(logarithms**2))))
    return AgreementScore(setting, within, int(known.sum()), rank, typical, constants)


def compare(table: PublishedErrors, own_mm: Array, reference_mm: float) -> Comparison:
    """Compare the model with the simple laws.

    Args:
        table: the published errors.
        own_mm: error that the model predicts without a reference, (n,); NaN where it predicts none.
        reference_mm: error of the reference that the model assumes.
    """
    lever = table.s_mm / table.force_mN
    laws: list[tuple[str, Law, tuple[float, ...]]] = [
        ("this model", lambda c: np.hypot(own_mm, c[0]), (reference_mm,)),
        ("lever law", lambda c: np.hypot(c[0] * lever, c[1]), (LEVER_MN, LEVER_REFERENCE_MM)),
        ("constant", lambda c: np.full(len(lever), c[0]), (CONSTANT_MM,)),
    ]
    names = dict.fromkeys(table.probes)
    of = {name: np.array([probe == name for probe in table.probes]) for name in names}
    fitted, left_out = [], []
    for name, law, constants in laws:
        n = len(constants)
        fitted.append(agreement(name, law(constants), table.measured_mm, n))
        predicted = np.full(len(lever), np.nan)
        for rows in of.values():
            others = _fit(law, constants, table.measured_mm, ~rows)
            predicted[rows] = law(others)[rows]
        left_out.append(agreement(name, predicted, table.measured_mm, n))
    model, by_lever = laws[0][1]((reference_mm,)), laws[1][1]((LEVER_MN, LEVER_REFERENCE_MM))
    known = np.isfinite(model)
    beyond = {
        name: float(spearmanr((table.measured_mm / by_lever)[rows & known], (model / by_lever)[rows & known]).statistic)
        for name, rows in {"all": known, **of}.items()
    }
    return Comparison(tuple(fitted), tuple(left_out), beyond)


def _fit(law: Law, start: Sequence[float], measured: Array, rows: Array) -> list[float]:
    """Return the constants with the least squared logarithms of predicted over measured in some rows."""

    def loss(logarithms: Array) -> float:
        """Return the sum of squares for the logarithms of the constants."""
        ratio = law(np.exp(logarithms).tolist())[rows] / measured[rows]
        return float(np.nansum(np.log(ratio) ** 2))

    found = minimize(loss, np.log(start), method="Nelder-Mead", options={"xatol": 1e-6, "fatol": 1e-9})
    best: list[float] = np.exp(found.x).tolist()
    return best
