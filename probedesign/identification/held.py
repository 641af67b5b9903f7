"""A number with the design's dimensions taken as they are: what is left of the fit when those are held."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from probedesign.frames import Array
from probedesign.identification.parameters import PARTS, PRINT
from probedesign.identification.solver import Fit

DIAMETERS = PARTS.index("diameters")


class Held(NamedTuple):
    """One of the shared vector.

    Attributes:
        value: of it.
        std: of it.
        by_diameter: by the logarithm of the base diameter, where all diameters differ together as the tolerances have
            it, or by one factor where that was asked for; None where neither is an unknown.
    """

    value: float
    std: float
    by_diameter: float | None


def held_of(fit: Fit, place: int) -> Held:
    """One unknown by its place in the shared vector; the diameters themselves are held by nothing."""
    active = np.flatnonzero(fit.point.problem.active)
    x, cov, i = fit.point.guess.x[active], fit.cov, int(np.searchsorted(active, place))
    given = np.flatnonzero((active == DIAMETERS) | (active >= PRINT))
    if place == DIAMETERS or not len(given):
        return Held(float(x[i]), float(np.sqrt(cov[i, i])), None)
    lever = np.linalg.solve(cov[np.ix_(given, given)], cov[given, i])
    left = cov[i, i] - lever @ cov[given, i]
    base = _base_of(fit, int(active[given[0]]))
    by_diameter = None if base is None else float(lever[0] / base)
    return Held(float(x[i] - lever @ x[given]), float(np.sqrt(left)), by_diameter)


def cov_held(fit: Fit, places: Sequence[int]) -> Array:
    """Covariance of some of the shared vector, the print's own dimensions held, (n, n)."""
    active = np.flatnonzero(fit.point.problem.active)
    at, given = np.searchsorted(active, places), np.flatnonzero(active >= PRINT)
    across = fit.cov[np.ix_(at, given)]
    return np.asarray(
        fit.cov[np.ix_(at, at)] - across @ np.linalg.solve(fit.cov[np.ix_(given, given)], across.T)
    )


def _base_of(fit: Fit, first: int) -> float | None:
    """What a unit of the first dimension does to the logarithm of the base diameter, if it is of all diameters."""
    shared = fit.point.problem.shared
    if first == DIAMETERS:
        return 1.0
    together = first == PRINT and max(shared.tolerances.diameter_mm, shared.tolerances.diameter_share) > 0.0
    return float(shared.print_rows[0, 0]) if together else None
