"""Statistics of estimates with known truth: coverage with its confidence interval, NEES and error over bound."""

import math
from collections import Counter
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.stats import binomtest

from probedesign.core.frames import Array
from probedesign.core.statistics import max_chi2
from probedesign.core.units import MM

CHI2_95 = max_chi2(3, 0.05)  #: NEES of a point on the boundary of its 95 % ellipsoid.


def proportion_interval(hits: int, n: int) -> tuple[float, float]:
    """Return the 95 % confidence interval of a proportion; 0 to 1 if n is 0.

    Source: C. J. Clopper, E. S. Pearson, Biometrika 26, 1934.
    """
    if n == 0:
        return 0.0, 1.0
    interval = binomtest(hits, n).proportion_ci(0.95)
    return float(interval.low), float(interval.high)


def proportion_cells(hits: int, n: int) -> tuple[str, str]:
    """Return table cells with a proportion and with its 95 % confidence interval."""
    low, high = proportion_interval(hits, n)
    return f"{hits / n:.1%}", f"{low:.1%} – {high:.1%}"


def nees(error: Array, cov: Array, min_std: float = 0.0) -> float:
    """Return the normalised estimation error squared, eᵀ P⁻¹ e.

    Args:
        error: of a point [m], (3,).
        cov: its covariance P [m²], (3, 3).
        min_std: smallest standard deviation [m] in any direction, for a covariance that may be singular because the
            point is on a surface; 0 if it is regular.
    """
    values, vectors = np.linalg.eigh(np.asarray(cov, dtype=float))
    if min_std:
        values = np.maximum(values, 1e-9 * values[-1] + min_std**2)
    return float(((vectors.T @ error) ** 2 / values).sum())


@dataclass
class ErrorStatistics:
    """Errors of estimates, collected one by one."""

    min_std: float = 0.0  #: smallest standard deviation of a point in any direction for its NEES [m], see `nees`.
    results: Counter[str] = field(default_factory=Counter)  #: number of estimates by result code.
    #: mean square error of the Cramér–Rao bound, of all estimates [m²].
    squared_bounds: list[float] = field(default_factory=list)
    squared_errors: list[float] = field(default_factory=list)  #: of located estimates [m²].
    squared_ratios: list[float] = field(default_factory=list)  #: squared error over squared bound of located estimates.
    nees: list[float] = field(default_factory=list)  #: of located estimates.
    beyond_3_std: int = 0  #: number of located estimates with an error above three stated standard deviations.
    stated: list[float] = field(default_factory=list)  #: traces of the covariances of located estimates [m²].
    #: other quantities by name, of which the summary has the means.
    others: dict[str, list[float]] = field(default_factory=dict)

    def add(self, result: str, error: Array, cov: Array, bound: float, **others: float) -> None:
        """Add an estimate by its result code, error [m], covariance [m²] and bound of the RMS error [m].

        `others` are further quantities of a located estimate.
        """
        self.results[result] += 1
        self.squared_bounds.append(bound**2)
        if result != "ok":
            return
        squared = float(error @ error)
        self.squared_errors.append(squared)
        self.squared_ratios.append(squared / bound**2)
        self.beyond_3_std += bool(squared > 9.0 * np.trace(cov))
        self.nees.append(nees(error, cov, self.min_std))
        self.stated.append(float(np.trace(cov)))
        for name, value in others.items():
            self.others.setdefault(name, []).append(value)

    def join(self, other: "ErrorStatistics") -> None:
        """Add the estimates of another collection."""
        self.results += other.results
        self.squared_bounds += other.squared_bounds
        self.squared_errors += other.squared_errors
        self.squared_ratios += other.squared_ratios
        self.nees += other.nees
        self.beyond_3_std += other.beyond_3_std
        self.stated += other.stated
        for name, values in other.others.items():
            self.others[name] = self.others.get(name, []) + values

    @property
    def n_inside_95(self) -> int:
        """Number of located estimates whose truth lies in their 95 % ellipsoid."""
        return int((np.array(self.nees) <= CHI2_95).sum())

    @property
    def other_results(self) -> str:
        """Result codes of the estimates that are not located, with their numbers."""
        return ", ".join(f"{code} {n}" for code, n in self.results.items() if code != "ok") or "none"

    def rms_over_bound(self) -> float:
        """Return the root mean square of error over bound of the located estimates."""
        return math.sqrt(np.mean(self.squared_ratios))

    def summary(self) -> dict[str, Any]:
        """Return all statistics by name; None where there are no estimates to compute them from.

        `flagged_of_wrong_share` relates the estimates that are not "ok" to those that are not "ok" or have an error
        above three stated standard deviations.
        """
        n, located, inside = self.results.total(), len(self.nees), self.n_inside_95
        wrong = n - located + self.beyond_3_std
        return {
            "draws": n,
            "ok_share": located / n if n else None,
            "rms_mm": math.sqrt(np.mean(self.squared_errors)) / MM if located else None,
            "bound_mm": math.sqrt(np.mean(self.squared_bounds)) / MM if n else None,
            "rms_over_bound": self.rms_over_bound() if located else None,
            "rms_over_stated": math.sqrt(np.mean(self.squared_errors) / np.mean(self.stated)) if located else None,
            "inside_95_share": inside / located if located else None,
            "inside_95_std": math.sqrt(inside * (located - inside) / located**3) if located else None,
            "mean_nees": float(np.mean(self.nees)) if located else None,
            "median_nees": float(np.median(self.nees)) if located else None,
            "ok_and_outside_share": (located - inside) / n if n else None,
            "beyond_3_std": self.beyond_3_std,
            "flagged_of_wrong_share": (n - located) / wrong if wrong else None,
            "results": dict(self.results),
            **{name: float(np.mean(values)) for name, values in self.others.items()},
        }
