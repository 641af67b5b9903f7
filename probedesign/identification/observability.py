"""Observability: singular values of the whitened Jacobian after all other parameters are projected out."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from probedesign.core.frames import Array
from probedesign.identification.parameters import DIAMETERS, OWNER, PARAMETERS, PRINT, columns_of
from probedesign.identification.solver import Fit, Linearization, column_scales

MIN_SHARE = 0.2
"""Component of a unit direction from which on a parameter takes part in what cannot be separated."""


@dataclass(frozen=True)
class UnobservableDirection:
    """A combination of requested parameters that the tests do not determine.

    Attributes:
        name: of the parameter that is left at the design value for it.
        description: what is not observable, and what is instead.
    """

    name: str
    description: str


def unobservable_direction(
    point: Linearization, weight: Array, requested: Sequence[str], tolerance: float = 1.0
) -> UnobservableDirection | None:
    """Return the least observable direction among the requested parameters if its uncertainty exceeds the limits.

    Args:
        point: the campaign, solved.
        weight: of its blocks.
        requested: names of `PARAMETERS`.
        tolerance: factor on the limits `Parameter.max_std`.
    """
    columns = columns_of(requested)
    limits = np.array(
        [PARAMETERS[name].max_std for name in requested for _ in PARAMETERS[name].labels], dtype=float
    )
    _, sizes, directions = np.linalg.svd(_marginal_information_root(point, weight, columns) * limits)
    if sizes[-1] * tolerance >= 1.0:
        return None
    direction = directions[-1] * limits  # in units of the parameters
    by_name = {
        name: [i for i, column in enumerate(columns) if OWNER[column].name == name] for name in requested
    }
    part = [name for name in requested if np.abs(directions[-1][by_name[name]]).max() > MIN_SHARE]
    std = float(np.linalg.norm(direction)) / max(float(sizes[-1]), 1e-12)
    components = {name: float(direction[by_name[name][0]]) for name in part}
    return UnobservableDirection(part[-1], _description(components, std))


def _marginal_information_root(point: Linearization, weight: Array, columns: Sequence[int]) -> Array:
    """Return the square root of the information on these columns, all other unknowns marginalised."""
    rows, _ = point.system(weight)
    active = np.flatnonzero(point.problem.active)
    at = [int(np.searchsorted(active, column)) for column in columns]
    others = rows[:, [i for i in range(rows.shape[1]) if i not in at]]
    R = np.asarray(np.linalg.qr(np.hstack([others * column_scales(others), rows[:, at]]), mode="r"))
    return R[others.shape[1] :, others.shape[1] :]


def _description(components: dict[str, float], std: float) -> str:
    names = list(components)
    if len(names) == 1:
        parameter = PARAMETERS[names[0]]
        assert parameter.max_std is not None
        return (f"{names[0]}: weakly observable in these tests; its standard deviation would be "
                f"{parameter.format_std(std)} (limit {parameter.format_std(parameter.max_std)})")  # fmt: skip
    if len(names) == 2 and all(PARAMETERS[name].logarithm for name in names):
        kept, fixed = names
        power = -components[kept] / components[fixed]
        text = "" if abs(abs(power) - 1.0) < 0.05 else f"^{abs(power):.1f}".removesuffix(".0")
        return (
            f"{kept} and {fixed}: these tests determine only {kept}{'/' if power < 0.0 else '·'}{fixed}{text}"
        )
    return f"{', '.join(names[:-1])} and {names[-1]}: these tests cannot separate them"


class ConditionalEstimate(NamedTuple):
    """An entry of the parameter vector, conditional on the design's dimensions.

    Attributes:
        value: of it.
        std: of it.
        by_diameter: derivative by the logarithm of the base diameter, where the tolerances let all diameters differ
            together, or one factor on them was requested; None where neither is estimated.
    """

    value: float
    std: float
    by_diameter: float | None


def conditional_estimate(fit: Fit, column: int) -> ConditionalEstimate:
    """Return one entry of the parameter vector given the design's dimensions; the diameters are not conditioned."""
    active = np.flatnonzero(fit.point.problem.active)
    x, cov, i = fit.point.values.x[active], fit.cov, int(np.searchsorted(active, column))
    given = np.flatnonzero((active == DIAMETERS) | (active >= PRINT))
    if column == DIAMETERS or not len(given):
        return ConditionalEstimate(float(x[i]), float(np.sqrt(cov[i, i])), None)
    gain = np.linalg.solve(cov[np.ix_(given, given)], cov[given, i])
    variance = cov[i, i] - gain @ cov[given, i]
    common, first = fit.point.problem.common, int(active[given[0]])
    # what a unit of the first dimension changes in the logarithm of the base diameter, if it is of all diameters
    base = 1.0 if first == DIAMETERS else None
    if first == PRINT and max(common.tolerances.diameter_mm, common.tolerances.diameter_share) > 0.0:
        base = float(common.print_modes[0, 0])
    return ConditionalEstimate(float(x[i] - gain @ x[given]), float(np.sqrt(variance)),
                               None if base is None else float(gain[0] / base))  # fmt: skip


def cov_conditional(fit: Fit, columns: Sequence[int]) -> Array:
    """Return the covariance of some entries of the parameter vector given the print's dimensions, (n, n)."""
    active = np.flatnonzero(fit.point.problem.active)
    at, given = np.searchsorted(active, columns), np.flatnonzero(active >= PRINT)
    across = fit.cov[np.ix_(at, given)]
    return np.asarray(
        fit.cov[np.ix_(at, at)] - across @ np.linalg.solve(fit.cov[np.ix_(given, given)], across.T)
    )
