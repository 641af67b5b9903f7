"""From the end of a search to numbers with their intervals, and what they do not count."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from scipy.stats import norm, t

from probedesign.frames import Array
from probedesign.identification.fit import Fit, solve_at, units_of
from probedesign.identification.identification import CONFIDENCE, Identified, Outlier, Residual, Shift
from probedesign.identification.misfit import Group
from probedesign.identification.robust import ROBUST, distance
from probedesign.identification.told import Untold
from probedesign.identification.trial import Trial
from probedesign.identification.unknowns import ASKABLE, PARTS, PRINT, ROOT, Shared, parts_of
from probedesign.units import MM, MPA

ROOT_LEFT = 0.05
"""What the ways to hold a flange leave open of root_rigid_radii. Source: docs/decisions/0006."""
GAIN_LEFT = 0.01
"""Of a sensor's gain. Assumed: certificates of the Nano17 state 1 to 1.75 % of full scale."""
REFERENCE_LEFT = 0.005
"""Of the size of a reference's millimetre. Assumed: 0.5 mm on a box of 100 mm."""


def found_of(fit: Fit, asked: Sequence[str], given_up: Sequence[Untold], names: Sequence[str],
             quantile: float) -> tuple[tuple[Identified, ...], Array, tuple[str, ...]]:  # fmt: skip
    """Every number asked for, the correlation of those told, and their names.

    Args:
        fit: the search's end.
        asked: what was fitted.
        given_up: what was not told.
        names: all that the user asked for.
        quantile: of the intervals.
    """
    shared, places = fit.point.problem.shared, parts_of(asked)
    active = np.flatnonzero(fit.point.problem.active)
    at = [int(np.searchsorted(active, place)) for place in places]
    x, cov = fit.point.guess.x[active], fit.cov
    print_ = [i for i, place in enumerate(active) if place >= PRINT]
    held, cov_held = x[at], cov[np.ix_(at, at)]
    powers: list[float | None] = [None] * len(at)
    if print_:
        lever: Array = np.asarray(np.linalg.solve(cov[np.ix_(print_, print_)], cov[np.ix_(print_, at)]).T)
        held = held - lever @ x[print_]
        cov_held = cov_held - lever @ cov[np.ix_(print_, at)]
        powers = _powers(shared, int(active[print_[0]]), places, lever)
    std = np.sqrt(np.diag(cov_held))
    found = {}
    for i, place in enumerate(places):
        own = (held[i], std[i], x[at[i]], float(np.sqrt(cov[at[i], at[i]])))
        found[PARTS[place]] = replace(_identified(shared, place, own, quantile), by_diameter=powers[i])
    why = {one.name: one.words for one in given_up}
    for name in names:
        if name in why:
            found |= {part: _untold(shared, PARTS.index(part), why[name]) for part in ASKABLE[name].parts}
    order = [PARTS[place] for place in parts_of(names)]
    return (
        tuple(found[part] for part in order),
        cov_held / np.outer(std, std),
        tuple(PARTS[p] for p in places),
    )


def _powers(shared: Shared, first: int, places: Sequence[int], lever: Array) -> list[float | None]:
    """Of the base diameter, with which logarithms go where all diameters differ together; None where those are no
    unknown of the fit, or it is no logarithm.

    Args:
        shared: what the tests share.
        first: place of the first of the print's own unknowns that moved.
        places: of the numbers.
        lever: of the numbers by the print's unknowns, (n, q).
    """
    t = shared.tolerances
    if first != PRINT or max(t.diameter_mm, t.diameter_share) == 0.0:
        return [None] * len(places)
    base = shared.print_rows[0, 0]
    return [
        float(row[0] / base) if _scale_of(shared, place)[4] else None
        for place, row in zip(places, lever, strict=True)
    ]


def _scale_of(shared: Shared, place: int) -> tuple[str, str, float, float, bool]:
    """Words, unit, the design's value in it, the unit of the vector in it, and whether that is a logarithm."""
    rod, part = shared.model.rod, PARTS[place]
    if part == "E":
        return "Young's modulus", "MPa", rod.youngs_modulus / MPA, 1.0, True
    if part == "G":
        return "shear modulus", "MPa", rod.shear_modulus / MPA, 1.0, True
    if part == "density":
        return "density", "kg/m³", rod.density, 1.0, True
    if part == "diameters":
        return "factor on all diameters", "", 1.0, 1.0, True
    if part == ROOT:
        return (
            "compliance that the base lacks, in base radii",
            "",
            rod.rigid_length / rod.radius[0],
            1.0,
            False,
        )
    if part.startswith("offset"):
        return f"place of the base along its {part[-1]} axis", "mm", 0.0, 1.0 / MM, False
    words = "turn about z" if part == "clocking" else f"turn about {part[-1]}"
    if part.startswith("gravity"):
        words = f"turn of gravity about the {('first', 'second')[part.endswith('2')]} axis across it"
    return words, "deg", 0.0, 180.0 / np.pi, False


def _identified(
    shared: Shared, place: int, own: tuple[float, float, float, float], quantile: float
) -> Identified:
    """`own`: value and standard deviation with the design's diameters, and with diameters that are not known."""
    words, unit, design, scale, logarithm = _scale_of(shared, place)

    def told(value: float, std: float) -> tuple[float, float, float, float]:
        ends = [value, value - quantile * std, value + quantile * std]
        v, low, high = (design * float(np.exp(e)) if logarithm else design + scale * float(e) for e in ends)
        return v, float(v * std if logarithm else scale * std), low, high

    value, std, low, high = told(own[0], own[1])
    of_print = told(own[2], own[3])
    return Identified(PARTS[place], words, unit, "identified", value, design, std, low, high, *of_print)


def _untold(shared: Shared, place: int, why: str) -> Identified:
    words, unit, design, _, _ = _scale_of(shared, place)
    return Identified(PARTS[place], words, unit, "not_told", design, design, why=why)


def quantile_of(fit: Fit) -> float:
    """Of a 95 % interval: Student's with the least freedom that a measured scatter was told by, else normal."""
    freedom = [one.freedom for one in fit.noise if one.measured]
    share = 0.5 * (1.0 + CONFIDENCE)
    return float(t.ppf(share, min(freedom)) if freedom else norm.ppf(share))


def outliers_of(off: Sequence[tuple[Group, float]]) -> tuple[Outlier, ...]:
    """Readings that noise does not explain, from `robust.outliers`."""
    return tuple(Outlier(group.test, group.kind, group.item, far) for group, far in off)


def residuals_of(fit: Fit) -> tuple[Residual, ...]:
    """Every reading against the fit."""
    bents = {bent.trial.name: bent for bent in fit.point.bents}
    found = []
    for group, weight in zip(fit.point.groups, fit.weight, strict=True):
        scale = fit.scales.get(group.kind, 1.0) if group.kind in ROBUST else 1.0
        s = None
        if group.kind == "markers":
            trial = bents[group.test].trial
            s = float(trial.marker_s[trial.marker_numbers.index(group.item)]) / MM
        elif group.kind in ("touches", "wrenches") and not bents[group.test].trial.free:
            s = bents[group.test].eq.s_contact / MM
        unit = {"wrenches": 1.0, "friction": 1.0, "scales": 1e3}.get(group.kind, 1.0 / MM)
        off = tuple(float(v) * unit for v in group.off)
        far = float(np.sqrt(distance(group) / len(group.r))) / scale
        found.append(Residual(group.test, group.kind, group.item, s, off, far, float(weight) * scale**2))
    return tuple(found)


def shifts_of(fit: Fit, asked: Sequence[str]) -> tuple[Shift, ...]:
    """What root, gain and millimetre would do to moduli, density and diameters, to first order, were they a little
    other."""
    moved = [name for name in asked if ASKABLE[name].logarithm]
    if not moved:
        return ()
    problem, point = fit.point.problem, fit.point
    active = np.flatnonzero(problem.active)
    keep = [i for i in range(problem.size) if i >= len(active) or active[i] < PRINT]
    rows = point.system(fit.weight)[0][:, keep]
    units = units_of(rows)
    columns: dict[str, Array] = {}
    if ROOT not in asked:
        rooted = solve_at(problem, point.guess, [bent.own for bent in point.bents], point, root=True)
        if rooted.ok:
            cause = f"root_rigid_radii {ROOT_LEFT:g} more"
            columns[cause] = ROOT_LEFT * rooted.columns_of([PARTS.index(ROOT)], fit.weight)[:, 0]
    columns[f"a sensor that reads {GAIN_LEFT:.0%} too much"] = GAIN_LEFT * _by_gain(fit)
    columns[f"a reference whose millimetre is {REFERENCE_LEFT:.1%} too short"] = REFERENCE_LEFT * _by_size(
        fit
    )
    found = []
    for cause, column in columns.items():
        if column.any():
            change = -np.linalg.lstsq(rows * units, column)[0] * units
            at = {name: int(np.searchsorted(active, PARTS.index(name))) for name in moved}
            found += [Shift(cause, name, 100.0 * float(np.expm1(change[i]))) for name, i in at.items()]
    return tuple(found)


def counted_in_all(
    numbers: Sequence[Identified], shifts: Sequence[Shift], quantile: float
) -> tuple[Identified, ...]:
    """The numbers with their standard deviations and intervals in all: the fit's and each shift of theirs, as if
    independent.

    Args:
        numbers: as the fit tells them.
        shifts: what it does not count.
        quantile: of the intervals.
    """
    return tuple(_in_all(one, shifts, quantile) if one.identified else one for one in numbers)


def _in_all(one: Identified, shifts: Sequence[Shift], quantile: float) -> Identified:
    assert one.std is not None
    std = math.hypot(one.std, *(one.value * 1e-2 * shift.percent for shift in shifts if shift.of == one.name))
    low, high = one.value - quantile * std, one.value + quantile * std
    if one.name in ASKABLE and ASKABLE[one.name].logarithm:
        low, high = (one.value * math.exp(sign * quantile * std / one.value) for sign in (-1.0, 1.0))
    return replace(one, std_in_all=std, low_in_all=low, high_in_all=high)


def _by_gain(fit: Fit) -> Array:
    """Misfits by the logarithm of the sensor's gain: all that it reads is too much."""

    def read(group: Group, trial: Trial) -> tuple[Array, Array] | None:
        told, cov = trial.wrench_base, trial.cov_wrench
        return (told, cov) if group.kind == "wrenches" and told is not None and cov is not None else None

    return _by_reading(fit, read)


def _by_size(fit: Fit) -> Array:
    """Misfits by the logarithm of the reference's size: places are too far from the base."""

    def read(group: Group, trial: Trial) -> tuple[Array, Array] | None:
        base = trial.T_world_base[:3, 3]
        if group.kind == "markers":
            i = trial.marker_numbers.index(group.item)
            return trial.p_markers_world[i] - base, trial.cov_markers[i]
        if group.kind == "touches" and trial.p_touch_world is not None:
            return trial.p_touch_world - base, trial.std_touch**2 * np.eye(3)
        return None

    return _by_reading(fit, read)


def _by_reading(fit: Fit, read: Callable[[Group, Trial], tuple[Array, Array] | None]) -> Array:
    """Rows of a change of readings, whitened as the misfits are; `read` tells a group's change and covariance."""
    rows = [np.zeros(int(fit.point.problem.active.sum()))]
    trials = {bent.trial.name: bent.trial for bent in fit.point.bents}
    for group, w in zip(fit.point.groups, fit.weight, strict=True):
        change = read(group, trials[group.test]) if group.test in trials else None
        if change is None:
            rows.append(np.zeros(len(group.r)))
        else:
            rows.append(np.sqrt(w) * np.linalg.solve(np.linalg.cholesky(change[1]), change[0]))
    return np.concatenate(rows)
